"""A simulated take in which somebody knocks against a camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from markerloom.errors import InputError
from markerloom.rig import Camera
from markerloom.simulate import SimulatedTake


def knock(
    take: SimulatedTake, camera: str, *, frame: int, turn_rad: ArrayLike, shift_m: ArrayLike
) -> tuple[SimulatedTake, Camera]:
    """The take with a camera that stands elsewhere from ``frame`` on, and that camera.

    ``turn_rad``: rotation vector (3,) in the camera's axes; ``shift_m``: (3,) in the world. The take keeps the rig of
    before. Dots of markers move as the markers' images do; clutter and hidden views stay.
    """
    if camera not in take.rig.ids:
        raise InputError(f"the take has no camera {camera}; it has {', '.join(take.rig.ids)}")
    index = take.rig.ids.index(camera)
    before = take.rig.cameras[index]
    after = replace(
        before,
        rotation=Rotation.from_rotvec(np.asarray(turn_rad, float)).as_matrix() @ before.rotation,
        position_m=before.position_m + np.asarray(shift_m, float),
    )
    moved = replace(take.rig, cameras=tuple(after if c is before else c for c in take.rig.cameras))
    rows, places_m = _dots_of(take, camera, frame)
    pixel = take.observations.pixel.copy()
    pixel[rows] += moved.project(index, places_m) - take.rig.project(index, places_m)
    return replace(take, observations=replace(take.observations, pixel=pixel)), after


def _dots_of(take: SimulatedTake, camera: str, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the camera's dots of markers from a frame on, and the markers' true places (m)."""
    dots = take.observations
    own = np.flatnonzero(dots.camera == dots.camera_ids.index(camera))
    own = own[np.argsort(dots.frame[own], kind="stable")]
    first = dict(zip(*np.unique(dots.frame[own], return_index=True), strict=True))
    place = {(f, m): p for f, m, p in zip(take.truth.frame, take.truth.label, take.truth.xyz_mm / 1000.0, strict=True)}
    table = take.truth_assignments.to_pydict()
    found = {}
    for f, c, o, label in zip(*(table[k] for k in ("frame", "camera", "observation", "label")), strict=True):
        if c == camera and f >= frame:
            found[int(own[first[f] + o])] = place[f, label]
    return np.array(list(found), np.int64), np.array(list(found.values())).reshape(-1, 3)
