"""Rigid bodies (props, tools, plates): made from markers of a take, followed in six degrees of freedom.

The layout is the mean shape over the frames (generalised Procrustes; Gower 1975); a pose is the rotation and
translation that bring it nearest to the markers (Kabsch 1976, weighted by their sigmas). Uncertainty by first order:
the noise of the markers through the normal matrix of the fit, in a small rotation about the pivot and a translation.
"""

from __future__ import annotations

import itertools
import json
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from markerloom.errors import FormatError, InputError
from markerloom.formats import table_file
from markerloom.formats.c3d_file import Segments
from markerloom.formats.files import read_text, write_text
from markerloom.points import Points
from markerloom.trajectories import Trajectories

Array = NDArray[np.floating[Any]]

FEWEST = 3
ROUNDS = 10
APART_MM = 3.0
"""Layouts that can be laid onto themselves within this distance (mm, rms) are ambiguous, unless noise is larger."""
FLAT = 0.02
"""Markers whose second spread is below this part of the first lie on a line: the turn about it is not known."""
NOISE_MM = 0.5
"""Noise per axis of markers that do not state theirs."""


@dataclass(frozen=True)
class RigidBody:
    """A layout: ``places_mm`` (n, 3) of its markers in its own axes, whose origin is the pivot."""

    name: str
    markers: tuple[str, ...]
    places_mm: Array
    residual_mm: float = 0.0


@dataclass(frozen=True)
class Poses:
    """The poses of a body. ``position_mm`` (n, 3) of the pivot; ``quaternion`` (n, 4), scalar last, body to world;
    ``sigma_mm`` and ``sigma_deg``: √trace of their covariances; ``residual_mm``: rms of the markers; ``markers``: how
    many were seen. Frames in which fewer than three were seen are not there."""

    body: str
    frame: NDArray[np.int64]
    position_mm: Array
    quaternion: Array
    sigma_mm: Array
    sigma_deg: Array
    residual_mm: Array
    markers: NDArray[np.int64]

    def to_arrow(self) -> pa.Table:
        """A table, one row per frame."""
        names = ("x_mm", "y_mm", "z_mm")
        turn = ("qx", "qy", "qz", "qw")
        return pa.table(
            {
                "frame": self.frame,
                "body": [self.body] * len(self.frame),
                **{name: self.position_mm[:, i] for i, name in enumerate(names)},
                **{name: self.quaternion[:, i] for i, name in enumerate(turn)},
                "sigma_mm": self.sigma_mm,
                "sigma_deg": self.sigma_deg,
                "residual_mm": self.residual_mm,
                "markers": self.markers,
            }
        )

    def segments(self, frames: NDArray[np.int64]) -> Segments:
        """The poses at all frames of a take, for its C3D."""
        place, turn = np.full((len(frames), 1, 3), np.nan), np.full((len(frames), 1, 3, 3), np.nan)
        row = np.searchsorted(frames, self.frame)
        place[row, 0] = self.position_mm
        turn[row, 0] = Rotation.from_quat(self.quaternion.reshape(-1, 4)).as_matrix()
        return Segments([self.body], place, turn)

    def save(self, path: str | Path) -> None:
        """Write the table as .parquet or .csv."""
        table_file.write(self.to_arrow(), path)


def create_rigid_body(
    points: Points,
    markers: list[str],
    *,
    name: str = "body",
    pivot: str | None = None,
    axis: tuple[str, str] | None = None,
) -> RigidBody:
    """A rigid body from markers of a take, as they are in the frames that show them all.

    ``pivot``: the marker at its origin; their middle without one. ``axis``: its x axis points from one marker to
    another; without it, its axes are those of the world in the first of the frames. Raises ``InputError`` where markers
    are missing, lie on a line, do not keep their distances, or where the layout fits itself in another way.
    """
    take = Trajectories.of(points)
    missing = [m for m in markers if m not in take.names]
    if missing:
        raise InputError(f"the take has no marker '{missing[0]}' ({points.source})")
    if len(set(markers)) < FEWEST:
        raise InputError(f"a rigid body needs {FEWEST} markers, not {len(set(markers))}")
    seen = take.xyz_mm[:, [take.names.index(m) for m in markers]]
    seen = seen[np.isfinite(seen).all(axis=(1, 2))]
    if len(seen) == 0:
        raise InputError(f"no frame shows all of {', '.join(markers)} ({points.source})")
    shape, residual = _mean_shape(seen)
    origin = shape[markers.index(pivot)] if pivot is not None else shape.mean(axis=0)
    shape = shape - origin
    if axis is not None:
        along = shape[markers.index(axis[1])] - shape[markers.index(axis[0])]
        shape = _onto_x(along).apply(shape)
    body = RigidBody(name, tuple(markers), shape, residual)
    _refuse_bad_layouts(body)
    return body


def ambiguities(body: RigidBody, *, within_mm: float | None = None) -> list[tuple[tuple[str, ...], float]]:
    """Other orders of the markers in which the layout fits itself, with the rms distance (mm), the worst first.

    Only proper rotations count: a mirror image is no ambiguity.
    """
    bound = max(APART_MM, 3.0 * body.residual_mm) if within_mm is None else within_mm
    found = []
    apart = np.linalg.norm(body.places_mm[:, None] - body.places_mm, axis=2)
    for order in itertools.permutations(range(len(body.markers))):
        if order == tuple(range(len(order))):
            continue
        # Distances tell cheaply that most orders do not fit.
        if np.sqrt(np.mean((apart[np.ix_(order, order)] - apart) ** 2)) > 2.0 * bound:
            continue
        _, rms = _fit(body.places_mm, body.places_mm[list(order)])
        if rms <= bound:
            found.append((tuple(body.markers[i] for i in order), float(rms)))
    return sorted(found, key=lambda f: f[1])


def track_rigid_body(points: Points, body: RigidBody) -> Poses:
    """Where a body is in every frame that shows at least three of its markers, none of them on a line."""
    take = Trajectories.of(points)
    present = [m for m in body.markers if m in take.names]
    if len(present) < FEWEST:
        raise InputError(f"the take has {len(present)} of the markers of '{body.name}', {FEWEST} are needed")
    slots = [take.names.index(m) for m in present]
    places = body.places_mm[[body.markers.index(m) for m in present]]
    rows: list[tuple[int, Array, Array, float, float, float, int]] = []
    for i, frame in enumerate(take.frames):
        seen = np.isfinite(take.xyz_mm[i, slots]).all(axis=1)
        if seen.sum() < FEWEST or _is_flat(places[seen]):
            continue
        sigma = take.sigma_mm[i, slots][seen] / np.sqrt(3.0)
        sigma = np.where(np.isfinite(sigma) & (sigma > 0), sigma, NOISE_MM)
        pose, rms = _fit(places[seen], take.xyz_mm[i, slots][seen], 1.0 / sigma**2)
        spread_mm, spread_deg = _uncertainty(pose[0].apply(places[seen]), sigma)
        rows.append((int(frame), pose[1], pose[0].as_quat(), spread_mm, spread_deg, rms, int(seen.sum())))
    columns = list(zip(*rows, strict=True)) if rows else [[]] * 7
    return Poses(
        body=body.name,
        frame=np.array(columns[0], np.int64),
        position_mm=np.array(columns[1], float).reshape(-1, 3),
        quaternion=np.array(columns[2], float).reshape(-1, 4),
        sigma_mm=np.array(columns[3], float),
        sigma_deg=np.array(columns[4], float),
        residual_mm=np.array(columns[5], float),
        markers=np.array(columns[6], np.int64),
    )


def write_rigid_body(body: RigidBody, path: str | Path) -> None:
    """Write a body as TOML: the form of wands, so that a wand is a rigid body too."""
    lines = [f"name = {json.dumps(body.name)}", 'units = "mm"', f"residual_mm = {body.residual_mm:.4f}"]
    for marker, place in zip(body.markers, body.places_mm, strict=True):
        position = ", ".join(f"{v:.4f}" for v in place)
        lines += ["", "[[markers]]", f"name = {json.dumps(marker)}", f"position = [{position}]"]
    write_text(path, "\n".join(lines) + "\n")


def read_rigid_body(path: str | Path) -> RigidBody:
    """Read a body, or a wand of at least three markers."""
    try:
        content = tomllib.loads(read_text(path))
        scale = {"mm": 1.0, "m": 1000.0}[content["units"]]
        rows = content["markers"]
        places = scale * np.array([row["position"] for row in rows], float).reshape(-1, 3)
        names = tuple(str(row["name"]) for row in rows)
    except (tomllib.TOMLDecodeError, KeyError, TypeError, ValueError) as error:
        raise FormatError(path, f"no rigid body: {error}") from None
    return RigidBody(str(content.get("name", Path(path).stem)), names, places, float(content.get("residual_mm", 0.0)))


def _mean_shape(seen: Array) -> tuple[Array, float]:
    """The mean shape in the axes of the first frame, and the rms distance of markers from it."""
    shape = seen[0] - seen[0].mean(axis=0)
    about = seen - seen.mean(axis=1, keepdims=True)
    turned = about
    for _ in range(ROUNDS):
        turned = np.array([_fit(frame, shape)[0][0].apply(frame) for frame in about])
        shape = turned.mean(axis=0)
    rms = float(np.sqrt(((turned - shape) ** 2).sum(axis=2).mean()))
    return shape + seen[0].mean(axis=0), rms


def _fit(places: Array, points: Array, weight: Array | None = None) -> tuple[tuple[Rotation, Array], float]:
    """Rotation and translation that bring places nearest to points, and the rms distance left."""
    weight = np.ones(len(places)) if weight is None else weight
    middle, target = np.average(places, axis=0, weights=weight), np.average(points, axis=0, weights=weight)
    u, _, vt = np.linalg.svd((points - target).T @ (weight[:, None] * (places - middle)))
    turn = Rotation.from_matrix(u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt)
    shift = target - turn.apply(middle)
    return (turn, shift), float(np.sqrt(((turn.apply(places) + shift - points) ** 2).sum(axis=1).mean()))


def _onto_x(along: Array) -> Rotation:
    """The smallest rotation that turns a direction onto the x axis."""
    direction = along / np.linalg.norm(along)
    cross = np.cross(direction, [1.0, 0.0, 0.0])
    sine = float(np.linalg.norm(cross))
    if sine < 1e-12:
        return Rotation.identity() if direction[0] > 0 else Rotation.from_rotvec([0.0, 0.0, np.pi])
    return Rotation.from_rotvec(cross / sine * np.arctan2(sine, direction[0]))


def _uncertainty(arms_mm: Array, sigma_mm: Array) -> tuple[float, float]:
    """√trace of the covariances of the pivot (mm) and of the rotation (degrees)."""
    normal = np.zeros((6, 6))
    for arm, sigma in zip(arms_mm, sigma_mm, strict=True):
        x, y, z = arm
        turned = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
        rows = np.hstack([turned, np.eye(3)]) / sigma
        normal += rows.T @ rows
    covariance = np.linalg.inv(normal)
    turn, shift = np.trace(covariance[:3, :3]), np.trace(covariance[3:, 3:])
    return float(np.sqrt(shift)), float(np.degrees(np.sqrt(turn)))


def _is_flat(places: Array) -> bool:
    spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    return bool(spread[1] < FLAT * spread[0])


def _refuse_bad_layouts(body: RigidBody) -> None:
    if _is_flat(body.places_mm):
        raise InputError(
            f"the markers of '{body.name}' lie on a line: the turn about it cannot be seen; add one beside it"
        )
    size = float(np.linalg.norm(np.ptp(body.places_mm, axis=0)))
    if body.residual_mm > 0.05 * size:
        raise InputError(
            f"the markers of '{body.name}' are {body.residual_mm:.1f} mm off a rigid layout of {size:.0f} mm:"
            " do they all belong to it?"
        )
    other = ambiguities(body)
    if other:
        order, rms = other[0]
        raise InputError(
            f"the layout of '{body.name}' fits itself: {', '.join(body.markers)} may be"
            f" {', '.join(order)} within {rms:.1f} mm; move a marker by a few centimetres"
        )
