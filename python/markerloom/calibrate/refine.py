"""A rig refined from a take's own markers: camera poses follow, lenses, scale and origin stay."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from markerloom import _core
from markerloom.bumped import between
from markerloom.errors import InputError
from markerloom.moments import refuse_several_clocks
from markerloom.observations import Observations
from markerloom.reconstruct import Reconstruction, reconstruct
from markerloom.rig import Rig

FRAMES = 100
"""Frames adjusted to, evenly spread; as many others judge."""
ROUNDS = 3
"""Points are found anew with the refined rig: better cameras find more of them."""
FEWEST_RAYS = 3
"""Two rays meet wherever a camera stands: such points tell nothing."""
FEWEST_POINTS = 50
LEAST_GAIN = 0.02
"""A rig is changed where frames left out then fit better by this part; less is the noise of the adjustment itself."""


def refine_rig(rig: Rig, observations: Observations) -> tuple[Rig, dict[str, Any]]:
    """The rig with its cameras' places and directions adjusted to the take.

    Returns the rig and a report: ``residual_px_before`` and ``residual_px_after`` (rms over frames that the adjustment
    did not see), by camera as well, ``moved_mm`` and ``turned_deg`` by camera, ``verdict`` (``ok``, or ``refused`` with
    ``reasons`` where the refined rig explains those frames no better).

    Raises ``InputError`` for fewer than three cameras, for a take that shows too few points, and for one whose cameras
    saw the frames at different moments.
    """
    seeing = {observations.camera_ids[i] for i in np.unique(observations.camera)}
    given, rig = rig, Rig(tuple(c for c in rig.cameras if c.id in seeing), rig.source)
    if len(rig) < 3:
        raise InputError(
            f"{len(rig)} cameras of the calibration saw anything: refining without a wand needs three or more "
            f"({observations.source})"
        )
    refuse_several_clocks(observations)
    chosen, judging = _split(observations)
    refined, points = rig, 0
    for _ in range(ROUNDS):
        refined, points = _round(refined, observations, chosen)
    before, after = _residuals(rig, observations, judging), _residuals(refined, observations, judging)
    worse = after["rms"] > (1.0 - LEAST_GAIN) * before["rms"]
    reasons = [f"frames left out fit no better: {before['rms']:.3f} px before, {after['rms']:.3f} px after"]
    report = {
        "frames": len(chosen),
        "points": points,
        "warnings": _silent(given, rig),
        "residual_px_before": before,
        "residual_px_after": after,
        **_changes(rig, refined),
        "verdict": "refused" if worse else "ok",
        "reasons": reasons if worse else [],
    }
    adjusted = dict(zip(refined.ids, refined.cameras, strict=True))
    return replace(given, cameras=tuple(adjusted.get(c.id, c) for c in given.cameras)), report


def _silent(given: Rig, rig: Rig) -> list[str]:
    silent = [c for c in given.ids if c not in rig.ids]
    return [f"cameras without any observation stay as they were: {', '.join(silent)}"] if silent else []


def _split(observations: Observations) -> tuple[np.ndarray, np.ndarray]:
    """Frames to adjust to, and as many between them to judge by."""
    frames = np.unique(observations.frame)
    step = max(2, len(frames) // FRAMES)
    return frames[::step], frames[step // 2 :: step]


def _points(rig: Rig, observations: Observations, frames: np.ndarray) -> Reconstruction:
    return reconstruct(observations._keep(np.isin(observations.frame, frames)), rig)


def _sightings(rig: Rig, observations: Observations, points: Reconstruction) -> tuple[np.ndarray, ...]:
    """Point, camera and pixel of every dot of the points with enough rays; points are numbered among those."""
    good = np.flatnonzero(points.rays >= FEWEST_RAYS)
    index = {(f, t): i for i, (f, t) in enumerate(zip(points.frame[good], points.track[good], strict=True))}
    camera_of = {c: i for i, c in enumerate(rig.ids)}
    names = [rig.ids.index(c) if c in camera_of else -1 for c in observations.camera_ids]
    pixels: dict[tuple[int, int], list[int]] = {}
    for row, (frame, camera) in enumerate(zip(observations.frame, observations.camera, strict=True)):
        pixels.setdefault((int(frame), names[camera]), []).append(row)
    table = points.assignments.to_pydict()
    rows = []
    for frame, camera, observation, track in zip(*(table[k] for k in table), strict=True):
        at = index.get((frame, track))
        if at is not None:
            own = camera_of[camera]
            rows.append((at, own, pixels[frame, own][observation]))
    point, camera, row = np.array(rows, np.int64).reshape(-1, 3).T
    return good, point, camera, observations.pixel[row]


def _round(rig: Rig, observations: Observations, frames: np.ndarray) -> tuple[Rig, int]:
    points = _points(rig, observations, frames)
    good, point, camera, pixel = _sightings(rig, observations, points)
    if len(good) < FEWEST_POINTS:
        raise InputError(
            f"the take shows {len(good)} points of {FEWEST_RAYS} rays and more ({FEWEST_POINTS} needed): "
            f"record more markers, or calibrate with a wand ({observations.source})"
        )
    described, _ = _core.refine_rig(
        rig.core, (points.xyz_mm[good] / 1000.0).tolist(), point.tolist(), camera.tolist(), pixel.tolist()
    )
    cameras = [
        replace(c, rotation=np.array(d["rotation"]), position_m=np.array(d["position_m"]))
        for c, d in zip(rig.cameras, described, strict=True)
    ]
    return Rig(tuple(cameras), rig.source, rig.warnings), len(good)


def _residuals(rig: Rig, observations: Observations, frames: np.ndarray) -> dict[str, Any]:
    """Rms, median and, by camera, rms of the dots' distances (px) from their points' projections."""
    points = _points(rig, observations, frames)
    good, point, camera, pixel = _sightings(rig, observations, points)
    places = points.xyz_mm[good] / 1000.0
    length = np.zeros(len(point))
    for i in range(len(rig)):
        own = camera == i
        length[own] = np.linalg.norm(rig.project(i, places[point[own]]) - pixel[own], axis=1)
    by_camera = {c: float(np.sqrt(np.mean(length[camera == i] ** 2))) for i, c in enumerate(rig.ids) if i in camera}
    return {"rms": float(np.sqrt(np.mean(length**2))), "median": float(np.median(length)), "cameras": by_camera}


def _changes(before: Rig, after: Rig) -> dict[str, dict[str, float]]:
    apart = {a.id: between(a, b) for a, b in zip(before.cameras, after.cameras, strict=True)}
    return {"moved_mm": {c: d[0] for c, d in apart.items()}, "turned_deg": {c: d[1] for c, d in apart.items()}}
