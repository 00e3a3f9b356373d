"""Observations and a rig to points, each frame on its own."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa

from markerloom import _core
from markerloom.bumped import Moves
from markerloom.errors import InputError
from markerloom.moments import has_several_clocks
from markerloom.observations import DotArrays, MatchedDots, Observations, match
from markerloom.points import Points
from markerloom.rig import Rig

METHODS = ("optimal", "relaxation", "epipolar")
CHUNK_FRAMES = 64
Progress = Callable[[int, int], None]


def in_parts(progress: Progress | None, total: int) -> Callable[[float], None] | None:
    """For what tells how much of it is done as a number from 0 to 1."""
    return progress and (lambda part: progress(round(part * total), total))


@dataclass(frozen=True)
class Reconstruction(Points):
    """Points of a take without identity over time, with the dots they come from and a report."""

    assignments: pa.Table = field(default_factory=lambda: pa.table({}))
    report: dict[str, Any] = field(default_factory=dict)


def reconstruct(
    observations: Observations,
    rig: Rig,
    *,
    method: str = "optimal",
    frames: tuple[int | None, int | None] | None = None,
    threads: int = 0,
    noise_px: float | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Join the dots of each frame into 3D points.

    ``method``: ``optimal`` (maximum likelihood, proven), ``relaxation`` (the seed paper's) or ``epipolar`` (every
    match). ``frames``: first and one past the last. ``threads``: 0 = all cores; the result does not depend on it.
    ``noise_px``: noise of the dots where it is known; estimated from the take otherwise.
    ``progress(done, total)`` is called now and then.

    Raises ``InputError`` when observations and rig do not belong together, ``RigError`` when the cameras cannot give
    a depth.
    """
    if method not in METHODS:
        raise InputError(f"method '{method}': choose one of {', '.join(METHODS)}")
    if frames is not None:
        observations = observations.select(*frames)
    clock = time.perf_counter()
    stages = {}
    rig, dots, notes = usable_dots(observations, rig)
    if has_several_clocks(observations):
        notes.append(
            "the cameras saw the frames at different moments (time_s): the rays of markers that move do not meet; "
            "track knows of that, single frames do not"
        )
    stages["match"] = time.perf_counter() - clock
    model = _core.estimate_model(rig.core, dot_arrays(dots, 0, len(dots.frames)), noise_px)
    stages["estimate"] = time.perf_counter() - clock - stages["match"]
    parts, ms_per_frame = [], []
    for first in range(0, len(dots.frames), CHUNK_FRAMES):
        last = min(first + CHUNK_FRAMES, len(dots.frames))
        start = time.perf_counter()
        part = _core.reconstruct(rig.core, dot_arrays(dots, first, last), model, method, threads)
        ms_per_frame += [1000 * (time.perf_counter() - start) / (last - first)] * (last - first)
        parts.append(_offset(part, first, int(dots.starts[first])))
        if progress:
            progress(last, len(dots.frames))
    stages["correspond"] = sum(ms_per_frame) / 1000
    solved = _joined(parts)
    report = _report(solved, dots, rig, model.describe(), method, notes)
    report["residual_px_by_camera"] = residual_by_camera(solved, dots, Moves(rig))
    report["timing"] = timing(time.perf_counter() - clock, ms_per_frame, stages)
    return as_points(solved, dots, rig, observations, report)


def usable_dots(observations: Observations, rig: Rig) -> tuple[Rig, MatchedDots, list[str]]:
    """The cameras that take part, and their dots."""
    dots = match(observations, rig)
    notes = list(dots.warnings)
    if len(observations) == 0:
        raise InputError(f"there are no observations to reconstruct ({observations.source})")
    used = np.unique(dots.camera)
    if len(used) < 2:
        only = rig.cameras[used[0]].id if len(used) else "none"
        raise InputError(f"usable observations come from one camera only ({only}): a 3D point needs at least 2")
    if len(used) < len(rig):
        silent = [c.id for i, c in enumerate(rig.cameras) if i not in set(used.tolist())]
        notes.append(f"cameras without any observation are left out: {', '.join(silent)}")
        rig = Rig(tuple(rig.cameras[i] for i in used), rig.source)
        dots = MatchedDots(**{**vars(dots), "camera": np.searchsorted(used, dots.camera)})
    if len({tuple(np.round(c.position_m, 4)) for c in rig.cameras}) < 2:
        raise InputError("all cameras stand at the same place: no depth can be measured; check the calibration")
    return rig, dots, notes


def dot_arrays(dots: MatchedDots, first: int, last: int) -> DotArrays:
    """The dots of some frames, as the engine takes them."""
    return DotArrays(*dots.of_frames(first, last))


def _offset(part: dict[str, Any], frame: int, dot: int) -> dict[str, Any]:
    part["frame"] = part["frame"] + frame
    part["dots"] = part["dots"] + dot
    part["sizes"] = np.diff(part.pop("dot_starts"))
    return part


def _joined(parts: list[dict[str, Any]]) -> dict[str, Any]:
    return {key: np.concatenate([p[key] for p in parts]) for key in parts[0]}


def as_points(
    solved: dict[str, Any], dots: MatchedDots, rig: Rig, observations: Observations, report: dict[str, Any]
) -> Reconstruction:
    """The engine's arrays as points with their assignments; ``track`` and ``kind`` where there are trajectories."""
    n = len(solved["frame"])
    frame_index = solved["frame"]
    track = solved.get("track", _number_within_frame(frame_index))
    owner = np.repeat(np.arange(n), solved["sizes"])
    camera = dots.camera[solved["dots"]]
    mask = np.zeros(n, np.int64)
    np.bitwise_or.at(mask, owner, np.where(camera < 7, 1 << np.minimum(camera, 7), 0))
    variance = np.trace(solved["covariance_m2"], axis1=1, axis2=2)
    assignments = pa.table(
        {
            "frame": dots.frames[frame_index[owner]],
            "camera": [rig.cameras[c].id for c in camera],
            "observation": dots.observation[solved["dots"]],
            "track": track[owner],
        }
    )
    return Reconstruction(
        frame=dots.frames[frame_index].astype(np.int64),
        track=track.astype(np.int64),
        label=_told_names(track, solved["hardware"]) if "hardware" in solved else np.full(n, "", dtype="<U1"),
        xyz_mm=1000.0 * solved["point_m"],
        sigma_mm=1000.0 * np.sqrt(variance),
        rays=solved["sizes"].astype(np.int64),
        residual_px=solved["residual_px"],
        confidence=solved["confidence"],
        kind=solved.get("kind", np.zeros(n, np.int64)),
        residual_mm=1000.0 * solved["ray_distance_m"],
        camera_mask=mask,
        rate_hz=observations.rate_hz,
        frames=dots.frames,
        tracked="track" in solved,
        source=observations.source,
        assignments=assignments,
        report=report,
    )


def _told_names(track: np.ndarray, hardware: np.ndarray) -> np.ndarray:
    """Names of active markers' trajectories, by the identity that each told most often: "id17"; else empty."""
    label = np.full(len(track), "", dtype="<U12")
    told = hardware >= 0
    for one in np.unique(track[told]):
        identities, counts = np.unique(hardware[told & (track == one)], return_counts=True)
        label[track == one] = f"id{identities[counts.argmax()]}"
    return label


def _number_within_frame(frame_index: np.ndarray) -> np.ndarray:
    n = len(frame_index)
    new_frame = np.ones(n, bool)
    new_frame[1:] = np.diff(frame_index) != 0
    return np.arange(n) - np.maximum.accumulate(np.where(new_frame, np.arange(n), 0)) if n else np.zeros(0, np.int64)


def _report(
    solved: dict[str, Any], dots: MatchedDots, rig: Rig, model: dict[str, Any], method: str, notes: list[str]
) -> dict[str, Any]:
    frames = len(dots.frames)
    residual = solved["residual_px"]
    return {
        "frames": frames,
        "warnings": notes,
        "method": method,
        "cameras": rig.ids,
        "points_per_frame": len(solved["frame"]) / max(frames, 1),
        "rays_mean": float(solved["sizes"].mean()) if len(residual) else 0.0,
        "residual_px": statistics(residual),
        "certified_frames": float(solved["certified"].mean()) if frames else 0.0,
        "largest_gap_nats": float(np.max(solved["bound"] - solved["objective"], initial=0.0)),
        "noise_px": dict(zip(rig.ids, model["noise"], strict=True)),
        "model": model,
        "trajectories": 0,
    }


def residual_by_camera(
    solved: dict[str, Any], dots: MatchedDots, cameras: Moves, lag_s: np.ndarray | None = None
) -> dict[str, float]:
    """Root mean square distance of dots and reprojections by camera (px). ``lag_s``: of each dot behind its frame."""
    owner = np.repeat(np.arange(len(solved["frame"])), solved["sizes"])
    camera, pixel = dots.camera[solved["dots"]], dots.pixel[solved["dots"]]
    frame = dots.frames[solved["frame"]][owner]
    # Where cameras saw a frame at different moments, each marker as it was at its camera's.
    place = solved["point_m"][owner]
    if lag_s is not None:
        place = place + solved["velocity_mps"][owner] * lag_s[solved["dots"], None]
    error = np.zeros_like(pixel)
    for first, last, rig in cameras.parts():
        for i in range(len(rig)):
            rows = (camera == i) & (first <= frame) & (frame < last)
            error[rows] = rig.project(i, place[rows]) - pixel[rows]
    length = np.linalg.norm(error, axis=1)
    return {one.id: statistics(length[camera == i])["rms"] for i, one in enumerate(cameras.rig.cameras)}


def statistics(values: np.ndarray) -> dict[str, float]:
    """Median, root mean square and 95th percentile; NaN where there is nothing."""
    if len(values) == 0:
        return {"median": float("nan"), "rms": float("nan"), "p95": float("nan")}
    return {
        "median": float(np.median(values)),
        "rms": float(np.sqrt(np.mean(np.square(values)))),
        "p95": float(np.percentile(values, 95)),
    }


def timing(seconds: float, ms_per_frame: list[float], stages: dict[str, float]) -> dict[str, Any]:
    """The part of a report that differs from run to run."""
    values = np.array(ms_per_frame) if ms_per_frame else np.zeros(1)
    spread = {"mean": float(values.mean()), "p50": float(np.median(values))}
    spread |= {"p99": float(np.percentile(values, 99)), "p999": float(np.percentile(values, 99.9))}
    return {"seconds": seconds, "ms_per_frame": spread, "stages": stages}
