"""The world of a rig from an object on the floor: its markers' places in the world are known, its dots are seen."""

from __future__ import annotations

from itertools import combinations, permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.calibrate.wands import Wand
from markerloom.calibrate.world import mean_rotation, moved, rigid
from markerloom.errors import InputError
from markerloom.observations import Observations
from markerloom.reconstruct import reconstruct
from markerloom.rig import Rig

Array = NDArray[np.floating[Any]]

LOOKED_AT = 50
"""Frames looked at, evenly spread."""
DISTANCE_M, DISTANCE_PART = 0.003, 0.01
"""A distance on the object fits within this much, plus this part of it (a scale that is a little off)."""
STILL_M = 0.003
"""An object that wanders more than this from frame to frame does not lie still."""
MOST_POINTS = 40


def calibrate_origin(
    rig: Rig, observations: Observations, floor_object: Wand, *, height_m: float = 0.0
) -> tuple[Rig, dict[str, Any]]:
    """The rig in the world in which an object's markers lie at their stated places, lifted by ``height_m``.

    ``floor_object``: three markers or more, not on one line, places (m) in the world that is wanted: +Z up, z = 0 the
    floor or, with ``height_m``, that far below the markers. Only the world changes, neither the cameras' places to each
    other nor the scale. Returns the rig and a report: ``frames`` used, ``misfit_mm`` (rms), ``scale_error``, and
    ``warnings``.

    Raises ``InputError`` where the object is not seen, is not the stated one, moves, or would put the cameras below the
    floor.
    """
    places = floor_object.places_m + np.array([0.0, 0.0, height_m])
    if len(places) < 3 or np.linalg.svd(places - places.mean(axis=0))[1][1] < 0.01:
        raise InputError(f"'{floor_object.name}' has no three markers off one line: it cannot fix a world")
    frames = observations.frames[:: max(1, len(observations.frames) // LOOKED_AT)]
    rows = np.isin(observations.frame, frames)
    points = reconstruct(observations._keep(rows), rig)
    poses, misfits, scales = [], [], []
    for frame in frames.tolist():
        found = _find(points.xyz_mm[points.frame == frame] / 1000.0, places)
        if found is not None:
            poses.append(found[:2])
            misfits.append(found[2])
            scales.append(found[3])
    if not poses:
        raise InputError(
            f"no frame shows '{floor_object.name}' in 3D ({len(frames)} looked at): lay it where several cameras see "
            f"all its markers, and check its stated places ({observations.source})"
        )
    centres = np.array([r @ places.mean(axis=0) + t for r, t in poses])
    if float(np.median(np.linalg.norm(centres - np.median(centres, axis=0), axis=1))) > STILL_M:
        raise InputError(
            f"'{floor_object.name}' moves in this take: lay it down and record again ({observations.source})"
        )
    turn = mean_rotation(np.array([r for r, _ in poses]))
    shift = np.median(centres, axis=0) - turn @ places.mean(axis=0)
    cameras = moved(list(rig.cameras), turn.T, shift)
    below = [c.id for c in cameras if c.position_m[2] < 0]
    if 2 * len(below) > len(cameras):
        raise InputError(
            f"cameras {', '.join(below)} would stand below the floor: the object's z axis must point up "
            f"({floor_object.name})"
        )
    scale_error = float(np.median(scales)) - 1.0
    warnings = [f"cameras below the floor: {', '.join(below)}"] if below else []
    if abs(scale_error) > DISTANCE_PART / 2:
        warnings.append(f"distances on the object measure {scale_error:+.2%} off: the rig's scale or the stated places")
    report = {
        "frames": len(poses),
        "misfit_mm": float(1000.0 * np.median(misfits)),
        "scale_error": scale_error,
        "warnings": warnings,
    }
    return Rig(tuple(cameras), rig.source, rig.warnings), report


def _find(points: Array, places: Array) -> tuple[Array, Array, float, float] | None:
    """Rotation, shift, rms misfit (m) and scale of the object among points (n, 3); ``None`` if it is not there."""
    if not len(places) <= len(points) <= MOST_POINTS:
        return None
    basis = max(combinations(range(len(places)), 3), key=lambda b: _area(places[list(b)]))
    best = None
    for chosen in permutations(range(len(points)), 3):
        if not _fits(points[list(chosen)], places[list(basis)]):
            continue
        turn, shift = rigid(places[list(basis)], points[list(chosen)])
        expected = places @ turn.T + shift
        apart = np.linalg.norm(expected[:, None] - points[None], axis=2)
        nearest = apart.argmin(axis=1)
        reach = 2.0 * (DISTANCE_M + DISTANCE_PART * np.linalg.norm(places - places.mean(axis=0), axis=1))
        if len(set(nearest.tolist())) < len(places) or np.any(apart.min(axis=1) > reach):
            continue
        turn, shift = rigid(places, points[nearest])
        misfit = float(np.sqrt(np.mean(np.sum((places @ turn.T + shift - points[nearest]) ** 2, axis=1))))
        if best is None or misfit < best[2]:
            a, b = places - places.mean(axis=0), points[nearest] - points[nearest].mean(axis=0)
            best = (turn, shift, misfit, float(np.linalg.norm(b) / np.linalg.norm(a)))
    return best


def _area(corners: Array) -> float:
    return float(np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0])))


def _fits(points: Array, places: Array) -> bool:
    for i, j in ((0, 1), (0, 2), (1, 2)):
        true = np.linalg.norm(places[i] - places[j])
        if abs(np.linalg.norm(points[i] - points[j]) - true) > DISTANCE_M + DISTANCE_PART * true:
            return False
    return True
