"""How alike moments of motions are, and how one is laid onto another.

Two measures: the distance of clouds of points around two moments, wherever they happen and wherever they face (Kovar,
Gleicher & Pighin 2002, section 3.1), and the sum of differences over all degrees of freedom (lecture notes, section
6.7.3), which does not see where somebody is.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom import _core
from markerloom.motion.rotations import about_vertical
from markerloom.skeleton.motion import Motion

Array = NDArray[np.floating[Any]]
AROUND_S = 0.15
"""A moment's cloud reaches so far before and after it (s): its speed belongs to it."""
MEASURES = ("cloud", "dof")


def clouds(motion: Motion, step: int = 1) -> _core.Clouds:
    """Clouds of joints around every ``step``-th frame; joints weigh as much as the bones that meet in them are long."""
    skeleton = motion.skeleton
    weights = np.full(len(skeleton), 1e-3)
    lengths = skeleton.bone_lengths_m()
    for j in range(1, len(skeleton)):
        weights[j] += lengths[j]
        weights[skeleton.parents[j]] += lengths[j]
    places = motion.joints_m()[::step]
    half = max(1, round(AROUND_S * motion.rate_hz / step))
    return _core.Clouds(np.ascontiguousarray(places), weights.tolist(), half)


def distances(a: Motion, b: Motion, measure: str = "cloud", step: int = 1) -> Array:
    """Distance of every moment of one motion from every moment of another (frames of a, frames of b): for clouds the
    root mean square distance of points (m); for degrees of freedom that of all joints' turns (rad), a metre of the
    root's height counting as a radian.
    """
    if measure == "cloud":
        return clouds(a, step).distances(clouds(b, step))
    if measure != "dof":
        raise ValueError(measure)
    return _by_dof(a, b, step)


def _by_dof(a: Motion, b: Motion, step: int) -> Array:
    one, two = _features(a)[::step], _features(b)[::step]
    square = (one**2).sum(axis=1)[:, None] + (two**2).sum(axis=1)[None] - 2.0 * np.einsum("ik,jk->ij", one, two)
    return np.sqrt(np.maximum(square, 0.0) / len(a.skeleton))


def _features(motion: Motion) -> Array:
    """Numbers whose differences are those of the degrees of freedom: for small ones |R₁ − R₂|² is twice the angle's
    square. The root's heading and place do not count, its tilt and height do.
    """
    tilt = motion.turns[:, 0, 2, :]
    turns = motion.turns[:, 1:].reshape(len(motion), -1)
    return np.concatenate([motion.root_m[:, 2:], tilt, turns], axis=1) * np.concatenate(
        [[1.0], np.ones(3), np.full(turns.shape[1], np.sqrt(0.5))]
    )


def laid(motion: Motion, turn: float, shift: tuple[float, float] | Array) -> Motion:
    """The motion turned about the vertical axis of the world (rad), then moved on the floor (m)."""
    about = about_vertical(turn)
    turns = motion.turns.copy()
    turns[:, 0] = about @ motion.turns[:, 0]
    root_m = motion.root_m @ about.T
    root_m[:, :2] += np.asarray(shift)[:2]
    return replace(motion, root_m=root_m, turns=turns)


def laid_onto(a: Motion, at: int, b: Motion, b_at: int) -> Motion:
    """Motion ``b`` moved and turned so that its moment lies onto one of ``a``."""
    turn, shift, _ = clouds(a).alignment(at, clouds(b), b_at)
    return laid(b, turn, np.array(shift))


def minima(table: Array, least: float) -> list[tuple[int, int]]:
    """Places of a table that are not larger than their eight neighbours, and below a threshold; in order of rows."""
    padded = np.pad(table, 1, mode="constant", constant_values=np.inf)
    low = table <= least
    for di in (-1, 0, 1):
        for dj in (-1, 0, 1):
            if di or dj:
                other = padded[1 + di : 1 + di + table.shape[0], 1 + dj : 1 + dj + table.shape[1]]
                # Of equal neighbours the first counts.
                low &= (table < other) | ((table == other) & ((di, dj) > (0, 0)))
    return [(int(i), int(j)) for i, j in np.argwhere(low)]
