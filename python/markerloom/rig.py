"""Cameras and rigs: the calibrated side of a take."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom import _core
from markerloom.errors import InputError

Array = NDArray[np.floating[Any]]

LENS_SIZES = {"ideal": 0, "vicon_radial": 5, "brown_conrady": 8, "fisheye": 4}
MAX_CAMERA_DISTANCE_M = 1000.0
SAME_PLACE_M = 1e-4


@dataclass(frozen=True)
class Lens:
    """A lens model and its coefficients.

    - ``ideal``: none.
    - ``vicon_radial``: cx, cy (px), k1, k2, k3; maps measured to ideal pixels.
    - ``brown_conrady``: OpenCV's k1, k2, p1, p2, k3, k4, k5, k6.
    - ``fisheye``: OpenCV's k1, k2, k3, k4.
    """

    model: str = "ideal"
    coefficients: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        """Refuse a wrong number of coefficients."""
        if len(self.coefficients) != LENS_SIZES.get(self.model, -1):
            raise InputError(f"{len(self.coefficients)} coefficients do not fit a lens of model '{self.model}'")


@dataclass(frozen=True)
class Mask:
    """Tiles of an image that are ignored: tile size (px), grid (columns, rows), flags row by row."""

    tile_px: tuple[float, float]
    grid: tuple[int, int]
    tiles: tuple[bool, ...]

    def covers(self, pixels: Array) -> NDArray[np.bool_]:
        """Which pixels (n, 2) lie in an ignored tile; pixels outside the grid and NaN do not."""
        tile = np.floor((np.nan_to_num(pixels, nan=-1e6) + 0.5) / np.array(self.tile_px))
        inside = np.asarray(((tile >= 0) & (tile < np.array(self.grid))).all(axis=1))
        column, row = np.where(inside[:, None], tile, 0).astype(np.int64).T
        return inside & np.array(self.tiles, bool)[row * self.grid[0] + column]


@dataclass(frozen=True)
class Conditions:
    """When, and how warm (°C), a camera was at its calibration and at the capture, where a file tells."""

    calibrated: datetime | None = None
    calibrated_celsius: float | None = None
    captured: datetime | None = None
    captured_celsius: float | None = None


@dataclass(frozen=True)
class Camera:
    """One calibrated camera. ``rotation`` turns world axes into camera axes; the camera looks along its +Z."""

    id: str
    size_px: tuple[float, float]
    focal_px: tuple[float, float]
    principal_px: tuple[float, float]
    rotation: Array
    position_m: Array
    lens: Lens = field(default_factory=Lens)
    mask: Mask | None = None
    name: str = ""
    conditions: Conditions = field(default_factory=Conditions)

    @property
    def translation_m(self) -> Array:
        """OpenCV's translation: the world's origin in camera axes."""
        return -self.rotation @ self.position_m

    def _described(self) -> dict[str, Any]:
        mask = None if self.mask is None else (self.mask.tile_px, self.mask.grid, list(self.mask.tiles))
        return {
            "id": self.id,
            "size_px": self.size_px,
            "focal_px": self.focal_px,
            "principal_px": self.principal_px,
            "rotation": np.asarray(self.rotation, float).tolist(),
            "position_m": np.asarray(self.position_m, float).tolist(),
            "lens": self.lens.model,
            "coefficients": list(self.lens.coefficients),
            "mask": mask,
        }


def natural_key(text: str) -> list[tuple[int, int | str]]:
    """Sort key in which "cam10" follows "cam9"."""
    parts = re.split(r"(\d+)", text)
    return [(0, int(p)) if p.isdigit() else (1, p) for p in parts if p]


@dataclass(frozen=True)
class Rig:
    """All cameras of a capture, in ascending order of id."""

    cameras: tuple[Camera, ...]
    source: str = ""
    warnings: tuple[str, ...] = ()

    @staticmethod
    def of(cameras: Iterable[Camera], *, source: str = "", warnings: Iterable[str] = ()) -> Rig:
        """Check cameras against each other and put them in order."""
        ordered = tuple(sorted(cameras, key=lambda c: natural_key(c.id)))
        notes = list(warnings)
        for before, after in pairwise(ordered):
            if before.id == after.id:
                raise InputError(f"two cameras have the id {before.id}: give each camera its own ({source})")
        for camera in ordered:
            _check(camera, source)
        notes += _same_places(ordered)
        return Rig(ordered, source, tuple(notes))

    @property
    def ids(self) -> list[str]:
        """Ids in the order of the cameras."""
        return [c.id for c in self.cameras]

    def find(self, camera: str) -> Camera | None:
        """The camera of an id, or else of a name; ``None`` if there is none."""
        for key in (lambda c: c.id, lambda c: c.name):
            for one in self.cameras:
                if key(one) == camera:
                    return one
        return None

    @cached_property
    def core(self) -> _core.Rig:
        """The engine's rig."""
        return _core.Rig([c._described() for c in self.cameras])

    def __len__(self) -> int:
        """Return the number of cameras."""
        return len(self.cameras)

    def project(self, camera: int, points_m: Array) -> Array:
        """Pixels (n, 2) of points (n, 3) in world metres; NaN where the camera has none."""
        return self.core.project(camera, np.ascontiguousarray(points_m, float))

    def normalise(self, camera: int, pixels: Array) -> Array:
        """Normalised image points (n, 2) of measured pixels (n, 2); NaN where the lens model has folded over."""
        return self.core.normalise(camera, np.ascontiguousarray(pixels, float))

    def rays(self, camera: int, pixels: Array) -> Array:
        """Unit directions (n, 3) in world of measured pixels (n, 2)."""
        return self.core.rays(camera, np.ascontiguousarray(pixels, float))

    def subset(self, ids: Sequence[str]) -> Rig:
        """The rig with only these cameras."""
        missing = [i for i in ids if i not in self.ids]
        if missing:
            raise InputError(f"the calibration has no camera {', '.join(missing)}; it has {', '.join(self.ids)}")
        return Rig(tuple(c for c in self.cameras if c.id in set(ids)), self.source, self.warnings)


def _check(camera: Camera, source: str) -> None:
    values = np.concatenate([np.ravel(camera.rotation), camera.position_m, camera.focal_px, camera.principal_px])
    if not np.all(np.isfinite(values)):
        raise InputError(f"camera {camera.id} has values that are not finite: calibrate it again ({source})")
    if min(camera.focal_px) <= 0 or min(camera.size_px) <= 0:
        raise InputError(f"camera {camera.id} has no focal length or no sensor size ({source})")
    turn = np.asarray(camera.rotation)
    if np.abs(turn @ turn.T - np.eye(3)).max() > 1e-3 or np.linalg.det(turn) < 0:
        raise InputError(f"camera {camera.id}: its rotation is not a rotation (mirrored or not orthogonal) ({source})")
    if np.linalg.norm(camera.position_m) > MAX_CAMERA_DISTANCE_M:
        metres = np.linalg.norm(camera.position_m)
        raise InputError(
            f"camera {camera.id} stands {metres:.0f} m from the origin: the unit of the calibration is wrong; "
            f"state it with --calibration-units mm or m ({source})"
        )


def _same_places(cameras: Sequence[Camera]) -> list[str]:
    notes = []
    for i, a in enumerate(cameras):
        for b in cameras[i + 1 :]:
            if np.linalg.norm(a.position_m - b.position_m) < SAME_PLACE_M:
                notes.append(f"cameras {a.id} and {b.id} stand at the same place: together they give no depth")
    return notes
