"""A clock from what every recording shows: flashes, claps, or time codes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from markerloom.errors import InputError
from markerloom.observations import Observations

EVENTS = ("flash", "clap")

Array = NDArray[np.floating[Any]]
AROUND_S = 0.5
"""Length of time (s) from which the usual number of dots is taken."""
CLEAR, USUAL_PERCENT = 3.0, 98.0
"""An event is so many times what this percentage of the frames stays below."""
SAME = 0.5
"""Events this strong beside the strongest count."""
APART_S = 0.2
"""Events nearer than this are one."""


def clock_from_events(first: Observations, second: Observations, by: str) -> dict[str, Any]:
    """Offset (s), drift (ppm) and standard deviations of the second recording's clock against the first's."""
    if by == "timecode":
        return _from_timecodes(first, second)
    times = [_times_s(take, by) for take in (first, second)]
    if len(times[0]) != len(times[1]):
        raise InputError(
            f"{len(times[0])} times a {by} in {first.source or 'the first recording'}, {len(times[1])} times in "
            f"{second.source or 'the second'}: cut the recordings, or state the offset by hand"
        )
    quantum = max(1.0 / float(t.rate_hz or 1.0) for t in (first, second)) / np.sqrt(12.0)
    a, b = times
    spread = b - b.mean()
    drift, drift_sigma = 0.0, 0.0
    # Events tell a drift only where a frame's error in them is less than crystals differ by in the time between.
    if len(a) > 1 and np.ptp(b) * 1e-4 > 2.0 * quantum:
        drift = float(spread @ (a - a.mean()) / (spread @ spread)) - 1.0
        drift_sigma = np.sqrt(2.0) * quantum / np.sqrt(spread @ spread)
    offset = float(a.mean() - (1.0 + drift) * b.mean())
    return {
        "offset_s": offset,
        "drift_ppm": 1e6 * drift,
        "sigma_s": float(np.sqrt(2.0) * quantum / np.sqrt(len(a))),
        "drift_sigma_ppm": 1e6 * drift_sigma,
        "details": {"events": len(a)},
    }


def _times_s(take: Observations, by: str) -> Array:
    """Times (s, by the recording's own clock) of the events that stand out."""
    rate = float(take.rate_hz or 1.0)
    signal = _flashes(take) if by == "flash" else _stops(take)
    length = max(3, int(AROUND_S * rate) | 1)
    excess = np.abs(signal - median_filter(signal, size=length, mode="nearest"))
    usual = float(np.percentile(excess, USUAL_PERCENT))
    if excess.max(initial=0.0) <= CLEAR * max(usual, 1e-9):
        raise InputError(f"no {by} stands out in it: state the offset by hand ({take.source})")
    order = np.argsort(-excess, kind="stable")
    times: list[float] = []
    for frame in order[excess[order] >= SAME * excess[order[0]]]:
        at = (take.frames[0] + frame) / rate
        if all(abs(at - other) > APART_S for other in times):
            times.append(float(at))
    return np.sort(np.array(times))


def _flashes(take: Observations) -> Array:
    """Change of the number of dots (or, where it is known, of their brightness) against the frame before."""
    at = take.frame - take.frames[0]
    counts = np.bincount(at, minlength=len(take.frames)).astype(float)
    brightness = take.optional.get("brightness")
    if brightness is not None and np.isfinite(brightness).any():
        counts = np.bincount(at, weights=np.nan_to_num(brightness), minlength=len(take.frames))
    return np.concatenate([[0.0], np.maximum(np.diff(counts), 0.0)])


def _stops(take: Observations) -> Array:
    """How suddenly the dots stop: the largest loss of speed (px per frame) of a dot from one frame to the next."""
    lost = np.zeros(len(take.frames))
    for camera in np.unique(take.camera):
        own = take.camera == camera
        frame, pixel = take.frame[own] - take.frames[0], take.pixel[own]
        starts = np.searchsorted(frame, np.arange(len(take.frames) + 1))
        before: tuple[Array, Array] | None = None
        for k in range(len(take.frames)):
            here = pixel[starts[k] : starts[k + 1]]
            speed = np.full(len(here), np.nan)
            if before is not None and len(before[0]) and len(here):
                distance = np.linalg.norm(here[:, None] - before[0][None], axis=2)
                nearest = distance.argmin(axis=1)
                speed = distance[np.arange(len(here)), nearest]
                loss = before[1][nearest] - speed
                lost[k] = max(lost[k], np.nanmax(loss, initial=0.0))
            before = (here, speed)
    return lost


def _from_timecodes(first: Observations, second: Observations) -> dict[str, Any]:
    starts = []
    for take in (first, second):
        codes = take.optional.get("timecode_s")
        if codes is None or not np.isfinite(codes).any():
            raise InputError(f"it has no time codes: a column 'timecode' with HH:MM:SS:FF is needed ({take.source})")
        good = np.isfinite(codes)
        # A code stands for some frames: its first one is where it begins.
        starts.append(float(np.max(codes[good] - take.frame[good] / float(take.rate_hz or 1.0))))
    quantum = max(1.0 / float(t.rate_hz or 1.0) for t in (first, second)) / np.sqrt(12.0)
    return {
        "offset_s": starts[1] - starts[0],
        "drift_ppm": 0.0,
        "sigma_s": float(np.sqrt(2.0) * quantum),
        "drift_sigma_ppm": 0.0,
        "details": {"timecode_s": starts[1]},
    }
