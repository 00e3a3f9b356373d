"""Moments between frames, and clips whose time runs in another way.

Between frames, places and turns follow cubics through the two frames on each side (Catmull & Rom 1974), turns in the
exponential map about the frame before. A moment that is a frame is that frame, to the bit.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from markerloom.errors import InputError
from markerloom.motion.edited import Edited
from markerloom.motion.rotations import exp, log
from markerloom.skeleton.motion import Motion

Array = NDArray[np.floating[Any]]
ON_A_FRAME = 1e-9
"""A moment this near to a frame (frames) is that frame."""


def sampled(motion: Motion, at: Array) -> Motion:
    """The motion at moments (frames of the clip, from 0, may lie between two)."""
    last = len(motion) - 1
    at = np.clip(at, 0.0, last)
    near = np.round(at)
    at = np.where(np.abs(at - near) < ON_A_FRAME, near, at)
    before = np.minimum(np.floor(at), max(last - 1, 0)).astype(int)
    part = at - before
    on_frame = (part == 0.0) | (part == 1.0) | (last == 0)
    whole = np.where(part == 1.0, before + 1, before)
    root_m, turns = motion.root_m[whole], motion.turns[whole]
    between = np.flatnonzero(~on_frame)
    if len(between):
        b, t = before[between], part[between]
        ids = np.stack([np.maximum(b - 1, 0), b, b + 1, np.minimum(b + 2, last)])
        ends = (b == 0, b + 1 == last)
        root_m[between] += _cubic(motion.root_m[ids] - motion.root_m[b], t[:, None], ends)
        here = np.swapaxes(motion.turns[b], -1, -2)
        vectors = np.stack([log(here @ motion.turns[i]) for i in ids])
        turns[between] = motion.turns[b] @ exp(_cubic(vectors, t[:, None, None], ends))
    sigma = np.maximum(motion.sigma_mm[before], motion.sigma_mm[np.minimum(before + 1, last)])
    kind = np.maximum(motion.kind[before], motion.kind[np.minimum(before + 1, last)])
    sigma = np.where(on_frame[:, None], motion.sigma_mm[whole], sigma)
    kind = np.where(on_frame[:, None], motion.kind[whole], kind)
    shifts = None if motion.shifts_m is None else _between(motion.shifts_m, before, part)
    return replace(motion, root_m=root_m, turns=turns, sigma_mm=sigma, kind=kind, shifts_m=shifts)


def _between(values: Array, before: NDArray[np.int64], part: Array) -> Array:
    after = np.minimum(before + 1, len(values) - 1)
    share = part.reshape(-1, *[1] * (values.ndim - 1))
    return values[before] * (1.0 - share) + values[after] * share


def _cubic(points: Array, t: Array, ends: tuple[Array, Array]) -> Array:
    """Catmull–Rom from the second of four points (which is 0) to the third; beyond the ends of a clip it goes on."""
    first, _, third, fourth = points
    shape = (-1, *[1] * (third.ndim - 1))
    first = np.where(ends[0].reshape(shape), -third, first)
    fourth = np.where(ends[1].reshape(shape), 2.0 * third, fourth)
    out, into = (third - first) / 2.0, fourth / 2.0
    return t * (out + t * ((3.0 * third - 2.0 * out - into) + t * (out + into - 2.0 * third)))


def resample(motion: Motion, rate_hz: float) -> Edited:
    """The same motion with another frame rate; first and last moment stay as near as its frames allow."""
    if not 0.0 < rate_hz <= 10000.0:
        raise InputError(f"a frame rate is above 0 and at most 10000 Hz, not {rate_hz:g}")
    ratio = motion.rate_hz / rate_hz
    frames = int(np.floor((len(motion) - 1) / ratio + ON_A_FRAME)) + 1 if len(motion) else 0
    out = replace(sampled(motion, np.arange(frames) * ratio), rate_hz=rate_hz, first_frame=0)
    return Edited(out, {"rate_hz": [motion.rate_hz, rate_hz], "frames_in_out": [len(motion), frames], "warnings": []})


def timewarp(motion: Motion, keys: list[tuple[float, float]]) -> Edited:
    """A motion whose moments happen at other times (Witkin & Popović 1995, section 3): ``keys`` are pairs (time in the
    clip, time instead; s). Between them time runs smoothly and never backwards (Fritsch & Carlson 1980); the clip
    begins where it began, and after the last key it runs as it did.

    Raises ``InputError`` for keys outside of the clip, and for such that would turn time back or stop it.
    """
    if not keys:
        return Edited(motion, {"keys": 0, "speed": {"least": 1.0, "largest": 1.0}, "warnings": []})
    rate, end = motion.rate_hz, (len(motion) - 1) / motion.rate_hz
    pairs = sorted({(0.0, 0.0), *((float(a), float(b)) for a, b in keys)})
    for a, b in pairs:
        if not -1e-9 <= a <= end + 1e-9:
            raise InputError(f"time {a:g} s is not in the clip, which ends at {end:g} s ({motion.source})")
        if not np.isfinite(b):
            raise InputError(f"a moment cannot happen at {b:g} s")
    for (a, b), (c, d) in pairwise(pairs):
        if c - a < 1e-9 or d - b < 1e-9:
            how = "run backwards" if d < b else "stop or jump"
            raise InputError(f"time would {how}: {a:g} s happens at {b:g} s, then {c:g} s at {d:g} s")
    if pairs[-1][0] < end - 1e-9:
        pairs.append((end, pairs[-1][1] + end - pairs[-1][0]))
    old, new = np.array(pairs).T
    frames = int(np.floor(new[-1] * rate + ON_A_FRAME)) + 1
    times = PchipInterpolator(new, old)(np.minimum(np.arange(frames) / rate, new[-1]))
    speed = np.diff(times) * rate
    span = {"least": float(speed.min(initial=1.0)), "largest": float(speed.max(initial=1.0))}
    out = replace(sampled(motion, times * rate), first_frame=0)
    return Edited(out, {"keys": len(keys), "frames_in_out": [len(motion), frames], "speed": span, "warnings": []})
