"""What a head looks at, found in a motion: stretches in which it turns, and faces the same place all the while.

Eyes are taken to look straight ahead of the head's segment. A stretch is a look where these lines meet at some distance
and the head turns by much more than the lines miss the place by: lines of a head that only turns meet in its neck,
those of a head that only moves do not meet.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.motion.body import Body
from markerloom.skeleton.motion import Motion

Array = NDArray[np.floating[Any]]
LOOKS_S, STEP_S = 0.6, 0.1
"""A look lasts so long, and begins and ends to so much (s)."""
MISSES_RAD = np.deg2rad(2.0)
"""A head faces what it looks at to within this (rms)."""
TURNS_RAD, TURNS = np.deg2rad(5.0), 4.0
"""Meanwhile it turns by this much, and by so many times what it misses by (rms about its mean direction)."""
NEAR_M, FAR_M = 0.35, 8.0
"""What somebody with legs of usual length looks at is not nearer, and not farther."""


def lines(motion: Motion, body: Body) -> tuple[Array, Array]:
    """Where the head is and the direction that it faces (frames, 3 each; m and unit vectors, world)."""
    turn, place = motion.segments()
    ahead = np.cross(body.lateral(), [0.0, 0.0, 1.0])
    return place[:, body.parts["head"]], turn[:, body.parts["head"]] @ ahead


def meeting(eyes: Array, ahead: Array) -> Array:
    """The place (m) that lines pass nearest to, in the sense of least squares."""
    across = np.eye(3) - ahead[:, :, None] * ahead[:, None, :]
    return np.linalg.lstsq(across.sum(axis=0), np.einsum("fab,fb->a", across, eyes), rcond=None)[0]


def find_looks(motion: Motion, body: Body, scale: float) -> list[tuple[int, int]]:
    """Stretches (first frame, frame after the last) in which the head looks at one place; ``scale``: the size of the
    body, 1 for legs of usual length. The rest pose has to be one of somebody who stands and faces ahead.
    """
    if "head" not in body.parts:
        return []
    eyes, ahead = lines(motion, body)
    step, least = max(1, round(STEP_S * motion.rate_hz)), round(LOOKS_S / STEP_S)
    grid = np.arange(0, len(motion) + 1, step)
    sums = _Sums(eyes, ahead)
    out, at = [], 0
    while at + least < len(grid):
        good = np.flatnonzero(sums.meet(int(grid[at]), grid[at + least :], scale))
        if len(good):
            last = at + least + int(good[-1])
            out.append((int(grid[at]), int(grid[last])))
            at = last
        else:
            at += 1
    return out


class _Sums:
    """Sums over frames from the first on, so that those of any stretch are differences of two."""

    def __init__(self, eyes: Array, ahead: Array) -> None:
        across = np.eye(3) - ahead[:, :, None] * ahead[:, None, :]
        onto = np.einsum("fab,fb->fa", across, eyes)
        parts = across, onto, np.einsum("fa,fa->f", eyes, onto), eyes, ahead
        self.across, self.onto, self.square, self.eyes, self.ahead = (
            np.concatenate([np.zeros((1, *p.shape[1:])), np.cumsum(p, axis=0)]) for p in parts
        )

    def meet(self, start: int, stops: NDArray[np.integer[Any]], scale: float) -> Array:
        """Whether the lines from a frame to each of several others are a look."""
        count = (stops - start)[:, None]
        across = (self.across[stops] - self.across[start]) / count[:, :, None]
        onto = (self.onto[stops] - self.onto[start]) / count
        eyes, ahead = ((s[stops] - s[start]) / count for s in (self.eyes, self.ahead))
        # Lines that are all parallel meet at no place: the small number takes theirs far away.
        place = np.linalg.solve(across + 1e-9 * np.eye(3), onto[:, :, None])[:, :, 0]
        square = (self.square[stops] - self.square[start]) / count[:, 0] - (onto * place).sum(axis=1)
        way = place - eyes
        away = np.linalg.norm(way, axis=1)
        missed = np.sqrt(np.maximum(square, 0.0)) / np.maximum(away, 1e-9)
        length = np.linalg.norm(ahead, axis=1)
        turned = np.sqrt(2.0 * np.maximum(1.0 - length, 0.0))
        before = (way * ahead).sum(axis=1) > 0.9 * away * length
        distant = (away > NEAR_M * scale) & (away < FAR_M * scale)
        return before & distant & (missed < MISSES_RAD) & (turned > np.maximum(TURNS_RAD, TURNS * missed))
