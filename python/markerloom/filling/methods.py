"""Ways to fill a gap, each a function of the gap and its surroundings; NumPy along the frames of the gap.

Own motion: linear, cubic and quintic splines (Woltring 1986 for the orders). Neighbours: the donor's path (pattern),
the rigid frame, distances (links), ridge regression in the neighbours' frame (low rank; cf. Gløersen & Federolf
2016), and moments in which the neighbours stood alike (cyclic). What comes from neighbours is led into the samples on
both sides by fading out what it is off there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from markerloom.filling.surroundings import Surroundings

Array = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]

KNOTS = 8
"""Samples on each side from which a spline is made."""
RIDGE = 0.02
NOISE_MM = 0.7
ALIKE = 6
MOMENTS = 240
"""Moments averaged by the cyclic method, and how many it chooses from at most."""
LEADING = 3
"""Samples beside the gap from which is told what a prediction is off."""
ROUNDS = 6
HELD_MM = 15.0
"""How far distances may pull a marker from its rigid place (mm, standard deviation)."""


@dataclass(frozen=True)
class Gap:
    """A gap from frame ``first`` to before ``last``, and the rows of the surroundings one may learn from."""

    around: Surroundings
    own: Array
    first: int
    last: int
    learn: Ints

    @property
    def rows(self) -> Ints:
        """Rows of the surroundings within the gap."""
        return self.around.rows(self.first, self.last)


def constant(gap: Gap) -> Array | None:
    """The nearer of the values on both sides."""
    times = np.arange(gap.first, gap.last)
    nearer = times - gap.first < gap.last - 1 - times
    return np.where(nearer[:, None], gap.own[gap.first - 1], gap.own[gap.last])


def linear(gap: Gap) -> Array | None:
    """A straight line."""
    return _spline(gap, 1)


def cubic(gap: Gap) -> Array | None:
    """A cubic spline through the samples on both sides."""
    return _spline(gap, 3)


def quintic(gap: Gap) -> Array | None:
    """A quintic spline: continuous in acceleration."""
    return _spline(gap, 5)


def _spline(gap: Gap, order: int) -> Array | None:
    low, high = max(0, gap.first - KNOTS), min(len(gap.own), gap.last + KNOTS)
    times = np.r_[low : gap.first, gap.last : high]
    times = times[np.isfinite(gap.own[times]).all(axis=1)]
    if len(times) <= order or not (times < gap.first).any() or not (times >= gap.last).any():
        return None
    if order == 1:
        times = np.array([gap.first - 1, gap.last])
    return make_interp_spline(times, gap.own[times], k=order)(np.arange(gap.first, gap.last))


def pattern(gap: Gap) -> Array | None:
    """The path of the most rigid neighbour, shifted."""
    if not len(gap.around.neighbours):
        return None
    return _led(gap, lambda rows: gap.around.neighbours_mm[rows, 0])


def rigid(gap: Gap) -> Array | None:
    """The place in the rigid frame of the neighbours, as it was on both sides."""
    around = gap.around
    if len(gap.learn) < FEW:
        return None
    distance = np.minimum(np.abs(around.frames[gap.learn] - gap.first), np.abs(around.frames[gap.learn] - gap.last))
    weight = np.exp(-distance / max(1.0, distance.max() / 4.0))
    place = weight @ around.local[gap.learn] / weight.sum()
    return _led(gap, lambda rows: _to_world(around, rows, np.broadcast_to(place, (len(rows), 3))))


def links(gap: Gap) -> Array | None:
    """The place that keeps the distances to the neighbours, held near the rigid one (damped least squares)."""
    around = gap.around
    start = rigid(gap)
    if start is None:
        return None
    apart = np.linalg.norm(around.neighbours_mm[gap.learn] - around.world[gap.learn, None], axis=2)
    mean, sd = apart.mean(axis=0), np.maximum(apart.std(axis=0), NOISE_MM)
    places = around.neighbours_mm[gap.rows]
    found = start
    for _ in range(ROUNDS):
        ray = found[:, None] - places
        length = np.maximum(np.linalg.norm(ray, axis=2), 1e-6)
        direction = ray / length[:, :, None] / sd[:, None]
        off = (length - mean) / sd
        normal = np.einsum("fki,fkj->fij", direction, direction) + np.eye(3) / HELD_MM**2
        gradient = np.einsum("fki,fk->fi", direction, off) + (found - start) / HELD_MM**2
        found = found - np.linalg.solve(normal, gradient[:, :, None])[:, :, 0]
    return found


def regression(gap: Gap) -> Array | None:
    """The place in the neighbours' frame as it goes with how they stand to each other (ridge regression)."""
    around = gap.around
    if len(gap.learn) < 3 * FEW:
        return None
    features, places = around.features[gap.learn], around.local[gap.learn]
    mean, middle = features.mean(axis=0), places.mean(axis=0)
    centred = features - mean
    covariance = centred.T @ centred / len(centred)
    strength = RIDGE * np.trace(covariance) / len(mean) + NOISE_MM**2 * len(mean) / len(centred)
    covariance[np.diag_indices_from(covariance)] += strength
    weights = np.linalg.solve(covariance, centred.T @ (places - middle) / len(centred))
    return _led(gap, lambda rows: _to_world(around, rows, middle + (around.features[rows] - mean) @ weights))


def cyclic(gap: Gap) -> Array | None:
    """The place in the neighbours' frame at the moments in which they stood most alike."""
    around = gap.around
    if len(gap.learn) < 3 * FEW:
        return None
    learn = gap.learn[:: max(1, len(gap.learn) // MOMENTS)]
    spread = around.features[learn].std(axis=0) + NOISE_MM
    known = around.features[learn] / spread
    square = (known**2).sum(axis=1)

    def at(rows: Ints) -> Array:
        asked = around.features[rows] / spread
        apart = np.maximum((asked**2).sum(axis=1)[:, None] + square - 2.0 * asked @ known.T, 0.0)
        nearest = np.argpartition(apart, ALIKE, axis=1)[:, :ALIKE]
        weight = 1.0 / (np.take_along_axis(apart, nearest, axis=1) + 0.1)
        place = np.einsum("fk,fki->fi", weight, around.local[learn][nearest]) / weight.sum(axis=1, keepdims=True)
        return _to_world(around, rows, place)

    return _led(gap, at)


FEW = 8
"""Frames to learn from, at least."""
METHODS: dict[str, Callable[[Gap], Array | None]] = {
    "constant": constant,
    "linear": linear,
    "cubic": cubic,
    "quintic": quintic,
    "pattern": pattern,
    "rigid": rigid,
    "links": links,
    "regression": regression,
    "cyclic": cyclic,
}
TRIED = ("linear", "cubic", "quintic", "pattern", "rigid", "links", "regression", "cyclic")
"""What ``auto`` chooses from: everything but holding a value."""


def _to_world(around: Surroundings, rows: Ints, local: Array) -> Array:
    return np.einsum("fij,fj->fi", around.turn[rows], local) + around.middle[rows]


def _led(gap: Gap, predict: Callable[[Ints], Array]) -> Array | None:
    """A prediction led into the samples on both sides: what it is off there fades over the gap."""
    around = gap.around
    before = around.rows(gap.first - LEADING, gap.first)
    after = around.rows(gap.last, gap.last + LEADING)
    rows = gap.rows
    before = before[np.isfinite(around.world[before]).all(axis=1)]
    after = after[np.isfinite(around.world[after]).all(axis=1)]
    if len(rows) != gap.last - gap.first or len(before) == 0 or len(after) == 0:
        return None
    every = np.concatenate([before, rows, after])
    found = predict(every)
    off_before = (around.world[before] - found[: len(before)])[-1]
    off_after = (around.world[after] - found[len(found) - len(after) :])[0]
    share = (around.frames[rows] - (gap.first - 1)) / (gap.last - gap.first + 1)
    off = off_before * (1.0 - share)[:, None] + off_after * share[:, None]
    return found[len(before) : len(before) + len(rows)] + off
