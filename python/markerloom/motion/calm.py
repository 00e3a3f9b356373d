"""A motion kept as calm as another: where joints are jerked more than they may, all of the body is smoothed there.

Bodies differ: what trembles in the hips of one and is taken back by its spine reaches the head of another that has
fewer joints there. Smoothing is diffusion in time, in these frames and, less and less, in those around them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.motion.edited import AROUND, accelerations
from markerloom.motion.rotations import exp, log
from markerloom.skeleton.motion import Motion
from markerloom.skeleton.skeleton import Skeleton

Array = NDArray[np.floating[Any]]
ROUNDS = 100
"""Smoothed so often at most; what is too sharp after that stays so."""
LEAST = 0.1
"""Part of a whole smoothing where a joint is hardly too sharp; from a quarter above what is allowed on it is whole."""


def calmed(motion: Motion, allowed: Array) -> Motion:
    """The motion with accelerations (frames, joints; m/s²) that are allowed, as far as smoothing takes them there.

    Only joints change that carry one that is too sharp, and only around frames in which it is; never the first and the
    last frame.
    """
    for _ in range(ROUNDS):
        over = np.clip(accelerations(motion) / allowed - 1.0, 0.0, 0.25) / 0.25
        if not over.any():
            break
        share = np.where(over > 0.0, np.maximum(over, LEAST), 0.0)
        motion = _smoothed(motion, near(above(share, motion.skeleton)))
    return motion


def above(values: Array, skeleton: Skeleton) -> Array:
    """Of every joint (columns) the largest of what it and the joints below it have."""
    out = values.copy()
    for j in range(len(skeleton) - 1, 0, -1):
        p = skeleton.parents[j]
        out[:, p] = np.maximum(out[:, p], out[:, j])
    return out


def near(over: Array) -> Array:
    """The largest within `AROUND` frames (frames, joints), less and less within as many more."""
    ramp = 0.5 + 0.5 * np.cos(np.pi * np.arange(AROUND + 1) / (AROUND + 1.0))
    weight = np.zeros(over.shape)
    for off, size in enumerate([1.0] * AROUND + ramp.tolist()):
        weight[off:] = np.maximum(weight[off:], size * over[: len(over) - off])
        weight[: len(over) - off] = np.maximum(weight[: len(over) - off], size * over[off:])
    weight[[0, -1]] = 0.0
    return weight


def _smoothed(motion: Motion, weight: Array) -> Motion:
    """The kernel (1/4, 1/2, 1/4) on every joint's turn and the root's place, by their weights (0 to 1)."""
    root_m, turns = motion.root_m.copy(), motion.turns.copy()
    root_m[1:-1] += weight[1:-1, :1] / 4.0 * (root_m[:-2] - 2.0 * root_m[1:-1] + root_m[2:])
    f, j = np.nonzero(weight)
    own = motion.turns[f, j]
    back = np.swapaxes(own, -1, -2)
    ways = log(back @ motion.turns[f - 1, j]) + log(back @ motion.turns[f + 1, j])
    turns[f, j] = own @ exp(weight[f, j][:, None] / 4.0 * ways)
    return replace(motion, root_m=root_m, turns=turns)
