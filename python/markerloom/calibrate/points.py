"""A rig from markers whose places in the world are known (lecture notes §6.3)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom import _core
from markerloom.calibrate.wand import GRID, _camera, _sizes, _start, _usable
from markerloom.calibrate.wands import Wand
from markerloom.errors import InputError
from markerloom.observations import DotArrays, Observations
from markerloom.rig import Camera, Rig

Array = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]

FEWEST = 6
FLAT = 0.02
"""Places whose smallest extent is this part of the largest lie in one plane."""
REACH = 0.1
"""With an old calibration, a marker's dot is looked for within this part of the image's width."""
FEWEST_STILL = 5
"""Frames for which a marker that is carried from place to place must lie still."""
STILL_PX = 0.5
WEAK = 0.005
"""A camera's place should be known to this part of its distance from the markers."""


def calibrate_points(
    observations: Observations,
    places: Wand,
    *,
    image_sizes: dict[str, tuple[float, float]] | None = None,
    intrinsics: Rig | None = None,
    start: Rig | None = None,
    in_order: bool = False,
) -> tuple[Rig, dict[str, Any]]:
    """Calibrate every camera from six or more markers at known places, not in one plane; their world is the rig's.

    Which dot is which marker is told by the column ``id`` (equal to a marker's name), or by ``start``, an old
    calibration that is right to a tenth of the image, or, with ``in_order``, by one marker that was laid on the places
    one after the other. Dots of a marker in several frames count as one, their median. ``intrinsics``: a rig whose
    lenses are kept. Returns the rig and a report with the figures of ``calibrate_wand``, and ``verdict``.

    Raises ``InputError`` where it is not known which dot is which, and for places in one plane.
    """
    if len(places.places_m) < FEWEST or _is_flat(places.places_m):
        raise InputError(f"'{places.name}': six known places or more are needed, and not all in one plane")
    ids, dots, notes = _usable(observations)
    known = intrinsics if intrinsics is not None else start
    sizes, size_notes = _sizes(ids, dots, image_sizes, known)
    first = [_start(camera, sizes[camera], known) for camera in ids]
    named = _named(observations, ids, dots, places, start, in_order)
    cameras, rows, reasons = [], {}, []
    for index, camera in enumerate(first):
        seen = [m for m in range(len(places.markers)) if (index, m) in named]
        pixel = np.array([named[index, m] for m in seen])
        solved = None
        if len(seen) >= FEWEST and not _is_flat(places.places_m[seen]):
            described = replace(camera, rotation=np.eye(3), position_m=np.zeros(3))._described()
            solved = _core.calibrate_points(
                described, places.places_m[seen].tolist(), pixel.tolist(), intrinsics is not None
            )
        if solved is None:
            reasons.append(
                f"camera {camera.id} sees {len(seen)} of the known markers: six or more are needed, not in one plane"
            )
            continue
        cameras.append(_camera(camera, solved["camera"]))
        rows[camera.id] = _of_camera(cameras[-1], solved, pixel, places.places_m[seen])
        reasons += _reasons(camera.id, rows[camera.id])
    report = {
        "frames": len(dots.starts) - 1,
        "warnings": [*notes, *size_notes],
        "markers": len(places.markers),
        "cameras": rows,
        "reprojection_px": _overall(rows),
        "scale_error": 0.0,
        "verdict": "refused" if reasons else "ok",
        "reasons": reasons,
    }
    return Rig(tuple(cameras), f"calibrated from {observations.source}"), report


def _is_flat(places: Array) -> bool:
    extent = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    return bool(extent[-1] < FLAT * extent[0])


def _named(
    observations: Observations, ids: list[str], dots: DotArrays, places: Wand, start: Rig | None, in_order: bool
) -> dict[tuple[int, int], Array]:
    """Pixel of every marker in every camera: (camera, marker) → (2,)."""
    if in_order:
        return _by_order(dots, len(ids), places)
    told = observations.optional.get("id")
    if told is not None and np.any(np.isfinite(told) & (told >= 0)):
        return _by_id(observations, ids, told, places)
    if start is not None:
        return _by_start(dots, ids, places, start)
    raise InputError(
        "nothing tells which dot is which marker: give a column id, an old calibration (--start), or one marker laid "
        f"on the places one after the other (--in-order) ({observations.source})"
    )


def _by_id(observations: Observations, ids: list[str], told: Array, places: Wand) -> dict[tuple[int, int], Array]:
    good = np.isfinite(told) & (told >= 0) & np.isfinite(observations.pixel).all(axis=1)
    number = {name: m for m, name in enumerate(places.markers)}
    found = {}
    for index, camera in enumerate(ids):
        own = good & (observations.camera == observations.camera_ids.index(camera))
        for value in np.unique(told[own]).tolist():
            marker = number.get(str(int(value)))
            if marker is not None:
                found[index, marker] = np.median(observations.pixel[own & (told == value)], axis=0)
    if not found:
        raise InputError(f"no id of the dots is the name of a marker of '{places.name}' ({observations.source})")
    return found


def _by_start(dots: DotArrays, ids: list[str], places: Wand, start: Rig) -> dict[tuple[int, int], Array]:
    """The dots nearest to where the old calibration sees the markers; each is the other's nearest."""
    found = {}
    for index, camera in enumerate(ids):
        old = start.find(camera)
        if old is None:
            continue
        own = dots.pixel[dots.camera == index]
        expected = Rig((old,)).project(0, places.places_m)
        apart = np.nan_to_num(np.linalg.norm(own[:, None] - expected[None], axis=2), nan=np.inf)
        shift = np.median((own - expected[apart.argmin(axis=1)])[apart.min(axis=1) < REACH * old.size_px[0]], axis=0)
        apart = np.nan_to_num(np.linalg.norm(own[:, None] - (expected + shift)[None], axis=2), nan=np.inf)
        marker = apart.argmin(axis=1)
        for m in np.unique(marker).tolist():
            mine = (marker == m) & (apart[:, m] < REACH * old.size_px[0] / 2)
            if mine.any():
                found[index, m] = np.median(own[mine], axis=0)
    return found


def _by_order(dots: DotArrays, cameras: int, places: Wand) -> dict[tuple[int, int], Array]:
    """A single marker that lies still at one place after the other: the rests of the recording in order."""
    frames = len(dots.starts) - 1
    pixel = np.full((frames, cameras, 2), np.nan)
    for frame in range(frames):
        own = slice(int(dots.starts[frame]), int(dots.starts[frame + 1]))
        for camera in range(cameras):
            mine = dots.pixel[own][dots.camera[own] == camera]
            if len(mine) == 1:
                pixel[frame, camera] = mine[0]
    rests = _rests(pixel)
    if len(rests) != len(places.markers):
        raise InputError(
            f"the marker rests {len(rests)} times, but '{places.name}' has {len(places.markers)} places: lay it on "
            f"each once, for {FEWEST_STILL} frames or more, and show no other marker"
        )
    found = {}
    for m, (first, last) in enumerate(rests):
        for camera in range(cameras):
            own = pixel[first:last, camera]
            own = own[np.isfinite(own).all(axis=1)]
            if len(own) >= FEWEST_STILL:
                found[camera, m] = np.median(own, axis=0)
    return found


def _rests(pixel: Array) -> list[tuple[int, int]]:
    """Runs of frames (first, one past the last) in which no camera sees the marker move, and some see it."""
    with np.errstate(invalid="ignore"):
        step = np.linalg.norm(np.diff(pixel, axis=0), axis=2)
    seen = np.isfinite(step).any(axis=1)
    still = np.append(False, seen & (np.nanmax(np.where(np.isfinite(step), step, 0.0), axis=1) < STILL_PX))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    runs = [(int(a) - 1, int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return [(a, b) for a, b in runs if b - a >= FEWEST_STILL]


def _of_camera(camera: Camera, solved: dict[str, Any], pixel: Array, places_m: Array) -> dict[str, Any]:
    used = solved["used"]
    length = np.linalg.norm(solved["residual_px"][used], axis=1)
    size = np.array(camera.size_px)
    cells = np.unique(np.clip((pixel[used] / size * GRID).astype(int), 0, GRID - 1), axis=0)
    row: dict[str, Any] = {
        "reprojection_px": {"median": float(np.median(length)), "rms": float(solved["noise_px"])},
        "observations": int(used.sum()),
        "markers_left_out": int((~used).sum()),
        "coverage": len(cells) / GRID**2,
        "parameters_free": int(np.sum(solved["parameters_free"])),
        "distance_mm": float(1000.0 * np.linalg.norm(camera.position_m - places_m.mean(axis=0))),
    }
    if "covariance" in solved:
        matrix = solved["covariance"]
        row["position_sigma_mm"] = float(1000.0 * np.sqrt(max(np.trace(matrix[3:6, 3:6]), 0.0)))
        row["angle_sigma_deg"] = float(np.degrees(np.sqrt(max(np.trace(matrix[:3, :3]), 0.0))))
        row["focal_sigma_px"] = float(np.sqrt(max(matrix[6, 6], 0.0)))
    return row


def _reasons(camera: str, own: dict[str, Any]) -> list[str]:
    if own["markers_left_out"] * 3 > own["observations"]:
        return [f"camera {camera}: {own['markers_left_out']} markers do not fit the others: check names and places"]
    sigma = own.get("position_sigma_mm", np.inf)
    if not sigma < WEAK * own["distance_mm"]:
        return [
            f"camera {camera}: its place is known to ± {sigma:.0f} mm only: add markers far apart in its image, "
            "measure them better, or give --intrinsics"
        ]
    return []


def _overall(rows: dict[str, dict[str, Any]]) -> float:
    values = [own["reprojection_px"]["rms"] for own in rows.values()]
    return float(np.sqrt(np.mean(np.square(values)))) if values else float("nan")
