"""Motion warping: a clip bent so that it goes through key poses (Witkin & Popović 1995, "Motion warping").

θ′(t) = a(t)·θ(t) + b(t). Shifting, the turn that takes a joint to its key is spread over time by a spline and goes on
top of the joint's own turns; scaling, the components of the turns against the rest pose are multiplied by a spline
through the factors that the keys ask for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from markerloom.errors import InputError
from markerloom.motion.edited import Edited, moved_mm
from markerloom.motion.keys import Key, merged
from markerloom.motion.rotations import REACH_RAD, exp, log
from markerloom.skeleton.motion import Motion

Array = NDArray[np.floating[Any]]
BY = ("shift", "scale")
LARGEST_SCALE = 5.0
"""A component that scaling would make more than so many times as large, or turn around, is shifted."""


def warp(motion: Motion, keys: list[Key], *, by: str = "shift", reach_s: float | None = None) -> Edited:
    """A clip bent so that it goes through its keys, to the bit of a rotation, and keeps its detail elsewhere.

    The change eases in from the key before (or the clip's beginning) and out to the next one (or the end), or over
    ``reach_s`` seconds on both sides. Without keys the clip is unchanged. Raises ``InputError`` for keys outside of the
    clip and for keys that contradict each other.
    """
    if by not in BY:
        raise InputError(f"warping goes by {' or '.join(BY)}, not '{by}'")
    if reach_s is not None and not reach_s > 0.0:
        raise InputError(f"the reach of a key is a time above 0, not {reach_s:g} s")
    keys = merged(keys, motion)
    reach = len(motion) if reach_s is None else max(1, round(reach_s * motion.rate_hz))
    turns, root_m, warnings = motion.turns.copy(), motion.root_m.copy(), []
    for j in sorted({j for key in keys for j in key.turns}):
        own = [key for key in keys if j in key.turns]
        at, wanted = [key.frame for key in own], np.stack([key.turns[j] for key in own])
        _bend(turns, motion.turns[:, j], j, at, wanted, reach, by, warnings, motion.skeleton.joints[j])
    for axis in range(3):
        own = [key for key in keys if np.isfinite(key.root_m[axis])]
        if own:
            at = [key.frame for key in own]
            missing = np.array([key.root_m[axis] - motion.root_m[key.frame, axis] for key in own])
            root_m[:, axis] += through(at, missing[:, None], len(motion), reach)[:, 0]
            root_m[at, axis] = [key.root_m[axis] for key in own]
    out = replace(motion, turns=turns, root_m=root_m)
    moved = moved_mm(motion, out) if keys else {"rms": 0.0, "p99": 0.0, "max": 0.0}
    return Edited(out, {"keys": len(keys), "key_error": key_error(out, keys), "moved_mm": moved, "warnings": warnings})


def key_error(motion: Motion, keys: list[Key]) -> dict[str, float]:
    """By how much a motion misses its keys: turns (rad) and the root's place (m), the largest."""
    angle, place = 0.0, 0.0
    for key in keys:
        for j, wanted in key.turns.items():
            # An angle from the sine: the cosine of a small one says nothing.
            off = wanted.T @ motion.turns[key.frame, j]
            sine = 0.5 * np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]])
            angle = max(angle, float(np.arctan2(np.linalg.norm(sine), 0.5 * (np.trace(off) - 1.0))))
        known = np.isfinite(key.root_m)
        off_m = np.abs(motion.root_m[key.frame, known] - key.root_m[known])
        place = max(place, float(off_m.max(initial=0.0)))
    return {"rad": angle, "m": place}


def _bend(
    turns: Array,
    own: Array,
    joint: int,
    at: list[int],
    wanted: Array,
    reach: int,
    by: str,
    warnings: list[str],
    name: str,
) -> None:
    """One joint through its keys; frames that no key reaches stay as they are, to the bit."""
    if by == "scale":
        vectors, target = log(own), log(wanted)
        if max(np.linalg.norm(vectors, axis=1).max(), np.linalg.norm(target, axis=1).max()) < REACH_RAD:
            changed = _scaled(vectors, at, target, reach, warnings, name)
            moves = np.abs(changed - vectors).max(axis=1) > 0.0
            turns[moves, joint] = exp(changed[moves])
            turns[at, joint] = wanted
            return
        warnings.append(f"'{name}' turns too far from the rest pose to be scaled: it was shifted")
    missing = log(np.swapaxes(own[at], -1, -2) @ wanted)
    change = through(at, missing, len(own), reach)
    moves = np.abs(change).max(axis=1) > 0.0
    turns[moves, joint] = own[moves] @ exp(change[moves])


def _scaled(vectors: Array, at: list[int], target: Array, reach: int, warnings: list[str], name: str) -> Array:
    out = vectors.copy()
    for axis in range(3):
        here = vectors[at, axis]
        with np.errstate(divide="ignore", invalid="ignore"):
            factors = target[:, axis] / here
        if np.isfinite(factors).all() and (factors >= 0.0).all() and (factors <= LARGEST_SCALE).all():
            out[:, axis] *= 1.0 + through(at, factors[:, None] - 1.0, len(vectors), reach)[:, 0]
            continue
        if np.abs(target[:, axis] - here).max() > np.deg2rad(1.0):
            warnings.append(f"'{name}' cannot be scaled about {'XYZ'[axis]} to its keys: it was shifted")
        out[:, axis] += through(at, (target[:, axis] - here)[:, None], len(vectors), reach)[:, 0]
    return out


def through(at: list[int], values: Array, frames: int, reach: int) -> Array:
    """Cubic splines (frames, columns) through values at frames: twice smooth within a group of keys, level where it
    begins and ends, and 0 further than ``reach`` frames from all keys.
    """
    out = np.zeros((frames, values.shape[1]))
    order = np.argsort(at)
    groups: list[list[int]] = []
    for k in order:
        if groups and at[k] - at[groups[-1][-1]] < 2 * reach:
            groups[-1].append(k)
        else:
            groups.append([k])
    for group in groups:
        _through_group([at[k] for k in group], values[group], frames, reach, out)
    return out


def _through_group(at: list[int], values: Array, frames: int, reach: int, out: Array) -> None:
    low, high = max(at[0] - reach, 0), min(at[-1] + reach, frames - 1)
    knots, heights = list(at), list(values)
    if low < at[0]:
        knots, heights = [low, *knots], [np.zeros(values.shape[1]), *heights]
    if high > at[-1]:
        knots, heights = [*knots, high], [*heights, np.zeros(values.shape[1])]
    span = np.arange(knots[0], knots[-1] + 1)
    shape: Callable[[Any], Array]
    shape = CubicSpline(knots, np.array(heights), bc_type="clamped") if len(knots) > 1 else lambda _: np.array(heights)
    out[span] = shape(span)
    out[at] = values
