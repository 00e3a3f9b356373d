"""When the frames of a take were seen: one moment for each, and how much later each camera saw it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom import _core
from markerloom.errors import InputError
from markerloom.observations import DotArrays, MatchedDots, Observations
from markerloom.rig import Rig

Array = NDArray[np.floating[Any]]

NEAR_FRAMES = 0.75
"""Where every camera saw a frame within so many frames of number / rate, that is the frame's moment."""
ONE_MOMENT = 1e-3
"""Cameras whose times differ by less than this part of a frame share a clock."""


@dataclass(frozen=True)
class Moments:
    """``times_s``: of each frame, ``None`` = by number and rate. ``lags_s``: for each frame, how much later (s) each
    camera saw it; an empty row where all saw one moment."""

    times_s: list[float | None]
    lags_s: list[list[float]]

    @property
    def has_several_clocks(self) -> bool:
        """Whether cameras saw frames at different moments."""
        return any(self.lags_s)

    def of_dots(self, dots: MatchedDots) -> Array | None:
        """How much later than its frame's moment each dot was seen (s); ``None`` where all saw one moment."""
        if not self.has_several_clocks:
            return None
        owner = np.repeat(np.arange(len(dots.frames)), np.diff(dots.starts))
        return np.array(self.lags_s)[owner, dots.camera]


def moments_of(observations: Observations, dots: MatchedDots, cameras: int) -> Moments:
    """The moments of a take's frames, from the column ``time_s`` where there is one."""
    n = len(dots.frames)
    column = observations.optional.get("time_s")
    if column is None or not np.isfinite(column[dots.row]).any():
        return Moments([None] * n, [[]] * n)
    rate = observations.rate_hz or 1.0
    seen = _by_camera(column[dots.row], dots, cameras)
    spread = np.nanmax(seen, axis=1, initial=-np.inf) - np.nanmin(seen, axis=1, initial=np.inf)
    if spread.max() > ONE_MOMENT / rate:
        both = [moment(int(f), row, rate) for f, row in zip(dots.frames, seen, strict=True)]
        return Moments([m[0] for m in both], [m[1] for m in both])
    known = np.isfinite(seen).any(axis=1)
    mean = np.nanmean(seen[known], axis=1)
    at = dots.frames.astype(float)
    times = np.interp(at, at[known], mean)
    first, last = np.flatnonzero(known)[[0, -1]]
    times[:first] = times[first] - (at[first] - at[:first]) / rate
    times[last + 1 :] = times[last] + (at[last + 1 :] - at[last]) / rate
    return Moments(times.tolist(), [[]] * n)


def has_several_clocks(observations: Observations) -> bool:
    """Whether dots of one frame were seen at different moments."""
    time_s = observations.optional.get("time_s")
    if time_s is None or len(observations) == 0:
        return False
    order = np.lexsort((time_s, observations.frame))
    same = np.diff(observations.frame[order]) == 0
    apart = np.diff(time_s[order])[same]
    return bool(np.any(apart > ONE_MOMENT / (observations.rate_hz or 100.0)))


def refuse_several_clocks(observations: Observations) -> None:
    """For what looks at single frames: markers that move do not meet where cameras saw a frame at different moments."""
    if has_several_clocks(observations):
        raise InputError(
            "the cameras saw the frames at different moments (time_s), and markers move between: only track knows of "
            "that; use a take of genlocked cameras, or one in which nothing moves, without time_s "
            f"({observations.source})"
        )


def moment(frame: int, camera_times_s: Array, rate_hz: float) -> tuple[float, list[float]]:
    """A frame's moment (s) and the cameras' lags behind it (s), from the times at which they saw it (NaN: one did not).

    The moment is number / rate where that is near; otherwise the cameras' mean.
    """
    known = camera_times_s[np.isfinite(camera_times_s)]
    time_s = frame / rate_hz
    if len(known) and np.abs(known - time_s).max() > NEAR_FRAMES / rate_hz:
        time_s = float(known.mean())
    return time_s, np.where(np.isfinite(camera_times_s), camera_times_s - time_s, 0.0).tolist()


def dots_for_estimates(dots: MatchedDots, moments: Moments, rig: Rig, rate_hz: float) -> DotArrays:
    """The dots from which noise, volume and so on are estimated: as of their frames' moments."""
    whole = DotArrays(*dots.of_frames(0, len(dots.frames)))
    if not moments.has_several_clocks:
        return whole
    times: Sequence[float] = [0.0 if t is None else t for t in moments.times_s]
    moved = _core.dots_at_moments(rig.core, whole, times, moments.lags_s, rate_hz)
    return DotArrays(moved["starts"], moved["camera"], moved["pixel"], moved["sigma"], moved["hardware"])


def _by_camera(time_s: Array, dots: MatchedDots, cameras: int) -> Array:
    """Time (frames, cameras) at which each camera saw each frame; NaN where it saw none."""
    owner = np.repeat(np.arange(len(dots.frames)), np.diff(dots.starts))
    seen = np.full((len(dots.frames), cameras), np.nan)
    good = np.isfinite(time_s)
    seen[owner[good], dots.camera[good]] = time_s[good]
    if not np.array_equal(seen[owner[good], dots.camera[good]], time_s[good]):
        uneven = np.flatnonzero(seen[owner[good], dots.camera[good]] != time_s[good])[0]
        raise InputError(
            f"frame {dots.frames[owner[good][uneven]]}: dots of one camera have different times; a camera sees a frame "
            "at one moment"
        )
    return seen
