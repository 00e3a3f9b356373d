"""Observations and a rig, or points of any system, to trajectories."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pyarrow as pa

from markerloom import _core
from markerloom.errors import InputError
from markerloom.observations import MatchedDots, Observations
from markerloom.reconstruct import (
    CHUNK_FRAMES,
    Progress,
    Reconstruction,
    _arrays,
    _timing,
    _usable,
)
from markerloom.rig import Rig


def track(
    observations: Observations,
    rig: Rig,
    *,
    rate_hz: float | None = None,
    causal: bool = False,
    frames: tuple[int | None, int | None] | None = None,
    noise_px: float | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Follow every marker of a take through time.

    ``causal``: exactly what a live user would have seen; otherwise the whole take decides about identities, and gaps
    are carried from both ends. ``frames``: first and one past the last. ``noise_px``: noise of the dots where it is
    known. ``progress(done, total)`` is called now and then.

    Raises ``InputError`` when observations and rig do not belong together or the frame rate is not known.
    """
    if frames is not None:
        observations = observations.select(*frames)
    rate = rate_hz or observations.rate_hz
    if rate is None:
        raise InputError("tracking needs the frame rate")
    clock = time.perf_counter()
    rig, dots, notes = _usable(observations, rig)
    model = _core.estimate_model(rig.core, _arrays(dots, 0, len(dots.frames)), noise_px)
    tracker = _core.Tracker(rig.core, model, rate)
    estimated = time.perf_counter()
    ms = []
    for first in range(0, len(dots.frames), CHUNK_FRAMES):
        last = min(first + CHUNK_FRAMES, len(dots.frames))
        start = time.perf_counter()
        tracker.record(_arrays(dots, first, last), dots.frames[first:last].tolist(), [None] * (last - first))
        if progress:
            progress(last, len(dots.frames))
        ms += [1000 * (time.perf_counter() - start) / (last - first)] * (last - first)
    solved = tracker.recorded(causal)
    solved["sizes"] = np.diff(solved["dot_starts"])
    report = {"warnings": notes, "timing": _timing(time.perf_counter() - clock, ms, {"estimate": estimated - clock})}
    report["searched_dots"] = float(solved["searched_dots"].mean())
    return _as_points(solved, dots, rig, observations, rate, report)


def _as_points(
    solved: dict[str, Any], dots: MatchedDots, rig: Rig, observations: Observations, rate: float, report: dict[str, Any]
) -> Reconstruction:
    n = len(solved["frame"])
    owner = np.repeat(np.arange(n), solved["sizes"])
    camera = dots.camera[solved["dots"]]
    mask = np.zeros(n, np.int64)
    np.bitwise_or.at(mask, owner, np.where(camera < 7, 1 << np.minimum(camera, 7), 0))
    variance = np.trace(solved["covariance_m2"], axis1=1, axis2=2)
    frame = dots.frames[solved["frame"]].astype(np.int64)
    assignments = pa.table(
        {
            "frame": frame[owner],
            "camera": [rig.cameras[c].id for c in camera],
            "observation": dots.observation[solved["dots"]],
            "track": solved["track"][owner],
        }
    )
    return Reconstruction(
        frame=frame,
        track=solved["track"],
        label=np.full(n, "", dtype="<U1"),
        xyz_mm=1000.0 * solved["point_m"],
        sigma_mm=1000.0 * np.sqrt(variance),
        rays=solved["sizes"].astype(np.int64),
        residual_px=solved["residual_px"],
        confidence=solved["confidence"],
        kind=solved["kind"],
        residual_mm=1000.0 * solved["ray_distance_m"],
        camera_mask=mask,
        rate_hz=rate,
        frames=dots.frames,
        tracked=True,
        source=observations.source,
        assignments=assignments,
        report=report,
    )
