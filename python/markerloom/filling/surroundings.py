"""What surrounds a gap: the marker's most rigid neighbours, and the frames in which all of them are seen."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom import _core

Array = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]

NEIGHBOURS = 5
FEWEST = 3
SAMPLED = 400
"""Frames of the take looked at for the spread of distances."""
WINDOW_S = 10.0
LEARNED = 480
"""Frames around a gap, at most so far away (s), from which is learned, and how many of them at most."""
SMALLEST_AREA_MM2 = 300.0
"""Area of the triangle of the first three neighbours, below which they make no frame."""


@dataclass(frozen=True)
class Surroundings:
    """A gap of a marker seen in the frame of its neighbours.

    ``frames`` (n,): frames looked at, in order; ``local`` (n, 3): the marker in the neighbours' frame (mm), NaN where
    it is not seen; ``features`` (n, 3 k): the neighbours there; ``turn`` (n, 3, 3) and ``middle`` (n, 3) lead back:
    world = turn · local + middle. ``neighbours`` is empty where there are too few.
    """

    marker: int
    neighbours: Ints
    frames: Ints
    world: Array
    local: Array
    features: Array
    neighbours_mm: Array
    turn: Array
    middle: Array

    @cached_property
    def core(self) -> _core.Surroundings:
        """For the engine."""
        flat = self.turn.reshape(-1, 3, 3)
        every = (self.world, self.local, self.features, self.neighbours_mm, flat, self.middle)
        world, local, features, neighbours, turn, middle = (np.ascontiguousarray(a, float) for a in every)
        return self.frames.astype(np.int64), world, local, features, neighbours, turn, middle

    def rows(self, first: int, last: int) -> Ints:
        """Rows of the frames from ``first`` to before ``last``."""
        return np.arange(*np.searchsorted(self.frames, [first, last]))


def spreads(xyz_mm: Array) -> Array:
    """Standard deviation of the distance of every two markers (mm), about its running level; infinite where unknown."""
    step = max(1, len(xyz_mm) // SAMPLED)
    seen = xyz_mm[::step]
    n = xyz_mm.shape[1]
    found = np.full((n, n), np.inf)
    for a in range(n):
        distance = np.linalg.norm(seen - seen[:, a : a + 1], axis=2)
        count = np.isfinite(distance).sum(axis=0)
        enough = count >= max(5, len(seen) // 20)
        if enough.any():
            found[a, enough] = np.nanstd(distance[:, enough], axis=0)
    np.fill_diagonal(found, np.inf)
    return found


def surroundings(xyz_mm: Array, marker: int, first: int, last: int, neighbours: Ints, rate_hz: float) -> Surroundings:
    """The surroundings of a gap from frame ``first`` to before ``last`` (rows of ``xyz_mm``, (frames, markers, 3)), as
    these ``neighbours`` see it (see `neighbours_of`).
    """
    reach = round(WINDOW_S * rate_hz) + 2 * (last - first)
    low, high = max(0, first - reach), min(len(xyz_mm), last + reach)
    seen = np.isfinite(xyz_mm[low:high, neighbours]).all(axis=(1, 2)) if len(neighbours) else np.zeros(0, bool)
    if len(neighbours) < FEWEST:
        frames = np.arange(low, high)
        nothing = np.zeros((len(frames), 0))
        return Surroundings(
            marker, np.zeros(0, np.int64), frames, xyz_mm[frames, marker], np.full((len(frames), 3), np.nan), nothing,
            np.zeros((len(frames), 0, 3)), np.zeros((len(frames), 3, 3)), np.zeros((len(frames), 3)),
        )  # fmt: skip
    frames = low + np.flatnonzero(seen)
    places = xyz_mm[frames[:, None], neighbours]
    world = xyz_mm[frames, marker]
    near = min(int(np.searchsorted(frames, first)), len(frames) - 1)
    middle, turn, local, features = _core.in_frames_of(places, world, near)
    return Surroundings(marker, neighbours, frames, world, local, features, places, turn, middle)


def neighbours_of(xyz_mm: Array, marker: int, first: int, last: int, spread: Array) -> Ints:
    """The most rigid neighbours that are there during the gap and beside it, the first three of which span a plane."""
    inside = slice(max(0, first - 1), min(len(xyz_mm), last + 1))
    usable = np.isfinite(xyz_mm[inside]).all(axis=(0, 2)) & np.isfinite(spread[marker])
    order = [int(m) for m in np.argsort(spread[marker], kind="stable") if usable[m]]
    place = xyz_mm[max(0, first - 1)]
    chosen: list[int] = []
    for m in order:
        if len(chosen) == 2:
            area = 0.5 * np.linalg.norm(np.cross(place[chosen[1]] - place[chosen[0]], place[m] - place[chosen[0]]))
            if area < SMALLEST_AREA_MM2:
                continue
        chosen.append(m)
        if len(chosen) == NEIGHBOURS:
            break
    return np.array(chosen, np.int64)
