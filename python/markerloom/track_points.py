"""Anonymous or broken 3D points of any system to trajectories."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from markerloom import _core
from markerloom.errors import InputError
from markerloom.known_before import StartPose
from markerloom.points import KINDS, MEASURED, Points
from markerloom.reconstruct import Progress, Reconstruction, in_parts

Array = NDArray[np.floating[Any]]

JUMPS = 0.012
"""Points of other systems are smooth and jump now and then, by the exchange of a camera or a merged image: a tracker
must reckon with this much, as a part of the distance of neighbouring markers."""
LARGEST_JUMP_MM = 2.0


def track_points(
    points: Points,
    *,
    rate_hz: float | None = None,
    causal: bool = False,
    frames: tuple[int | None, int | None] | None = None,
    method: str = "default",
    start_pose: StartPose | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Follow every marker of a take of points through time; their names and trajectories are not looked at.

    Only measured rows count; positions that were predicted, filled or edited are found anew. Where the take does not
    state the uncertainty of its points, it is estimated from how unevenly they move. ``causal``, ``frames``,
    ``method``, ``start_pose`` and ``progress`` as in ``track``. Raises ``InputError`` where there is no measured
    point or no frame rate.
    """
    clock = time.perf_counter()
    if frames is not None:
        points = points.select(*frames)
    rate = points.rate_hz if rate_hz is None else rate_hz
    if rate is None or not 0 < rate < 1e6:
        raise InputError(f"tracking needs the frame rate: state it with --rate-hz ({points.source})")
    usable = (points.kind == MEASURED) & np.isfinite(points.xyz_mm).all(axis=1)
    dropped = int(np.sum((points.kind == MEASURED) & ~usable))
    notes = [f"{dropped} points without finite coordinates were left out"] if dropped else []
    take = points.keep(usable)
    if len(take) == 0:
        raise InputError(f"there are no measured points to track ({points.source})")
    order = np.lexsort((take.xyz_mm[:, 2], take.xyz_mm[:, 1], take.xyz_mm[:, 0], take.frame))
    sigma_mm = take.sigma_mm[order] / np.sqrt(3.0)
    stated = np.isfinite(sigma_mm) & (sigma_mm > 0)
    jumps_mm = _jumps_mm(take)
    noise_mm = jumps_mm
    followed = np.where(stated, np.maximum(sigma_mm, jumps_mm), jumps_mm)
    if method == "default" and not causal and not stated.all():
        first = _solve(take, order, followed, rate, start_pose, causal=True, method=method)
        seen = np.diff(first["dot_starts"]) == 1
        xyz_mm = take.xyz_mm[order][first["dots"]]
        noise_mm = estimated_noise_mm(first["track"][seen], first["frame"][seen], xyz_mm, jumps_mm)
        followed = np.maximum(followed, np.where(stated, 0.0, noise_mm))
    told = in_parts(progress, len(take.frames))
    solved = _solve(take, order, followed, rate, start_pose, causal=causal, method=method, told=told)
    tracked = _as_points(solved, take, order, rate, np.where(stated, sigma_mm, noise_mm))
    report = _report(tracked, noise_mm if not stated.all() else float(np.median(sigma_mm)), notes, causal, method)
    report["timing"] = {"seconds": time.perf_counter() - clock}
    return replace(tracked, report=report)


def _solve(
    take: Points,
    order: NDArray[np.int64],
    sigma_mm: Array,
    rate_hz: float,
    start_pose: StartPose | None,
    *,
    causal: bool,
    method: str,
    told: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    starts = np.searchsorted(take.frame[order], np.append(take.frames, take.frames[-1] + 1))
    return _core.track_points(
        starts.tolist(),
        np.ascontiguousarray(take.xyz_mm[order] / 1000.0),
        np.ascontiguousarray(sigma_mm / 1000.0),
        take.frames.tolist(),
        rate_hz,
        causal,
        method == "paper",
        told,
        None if start_pose is None else start_pose.core,
    )


def _jumps_mm(take: Points) -> float:
    """How far a point may be off (mm per axis): by the median distance of the nearest neighbour in up to 50 frames."""
    nearest = []
    for frame in np.unique(take.frame)[:: max(1, len(take.frames) // 50)]:
        xyz_mm = take.xyz_mm[take.frame == frame]
        if len(xyz_mm) > 1:
            distance = cdist(xyz_mm, xyz_mm)
            np.fill_diagonal(distance, np.inf)
            nearest.append(distance.min(axis=1))
    return min(LARGEST_JUMP_MM, JUMPS * float(np.median(np.concatenate(nearest)))) if nearest else LARGEST_JUMP_MM


def estimated_noise_mm(
    track: NDArray[np.int64], frame: NDArray[np.int64], xyz_mm: NDArray[np.floating[Any]], unknown_mm: float
) -> float:
    """Noise per axis (mm) from third differences along trajectories: white noise has 20 times its variance there.

    The median over trajectories and axes; motion adds to it, so the estimate is rather too large than too small.
    ``unknown_mm`` where the trajectories are too short to tell.
    """
    found = []
    for one in np.unique(track):
        rows = np.flatnonzero(track == one)
        steady = np.diff(frame[rows]) == 1
        run = steady[:-2] & steady[1:-1] & steady[2:]
        third = np.diff(xyz_mm[rows], n=3, axis=0)[run]
        if len(third) >= 20:
            found.append(np.median(np.abs(third), axis=0) / (0.6745 * np.sqrt(20.0)))
    return float(np.median(np.concatenate(found))) if found else unknown_mm


def _as_points(
    solved: dict[str, Any], take: Points, order: NDArray[np.int64], rate_hz: float, sigma_mm: Array
) -> Reconstruction:
    """The engine's rows; measured ones keep what their input row says about rays and residuals."""
    n = len(solved["frame"])
    sizes = np.diff(solved["dot_starts"])
    source = np.full(n, -1, np.int64)
    source[sizes == 1] = order[solved["dots"]]
    measured = source >= 0
    row = np.where(measured, source, 0)
    own_sigma_mm = np.zeros(len(take))
    own_sigma_mm[order] = np.sqrt(3.0) * sigma_mm
    variance = np.trace(solved["covariance_m2"], axis1=1, axis2=2)
    return Reconstruction(
        frame=take.frames[solved["frame"]].astype(np.int64),
        track=solved["track"].astype(np.int64),
        label=np.full(n, "", dtype="<U1"),
        xyz_mm=np.where(measured[:, None], take.xyz_mm[row], 1000.0 * solved["point_m"]),
        sigma_mm=np.where(measured, own_sigma_mm[row], 1000.0 * np.sqrt(variance)),
        rays=np.where(measured, take.rays[row], 0),
        residual_px=np.where(measured, take.residual_px[row], np.nan),
        confidence=solved["confidence"],
        kind=solved["kind"],
        residual_mm=np.where(measured, take.residual_mm[row], np.nan),
        camera_mask=np.where(measured, take.camera_mask[row], 0),
        rate_hz=rate_hz,
        frames=take.frames,
        up_axis=take.up_axis,
        source=take.source,
    )


def _report(tracked: Points, noise_mm: float, notes: list[str], causal: bool, method: str) -> dict[str, Any]:
    frames = max(len(tracked.frames), 1)
    measured = tracked.kind == KINDS.index("measured")
    return {
        "frames": len(tracked.frames),
        "warnings": notes,
        "method": method,
        "causal": causal,
        "points_per_frame": float(measured.sum() / frames),
        "predicted_per_frame": float((~measured).sum() / frames),
        "noise_mm": noise_mm,
        "trajectories": len(np.unique(tracked.track[measured])),
    }
