"""Ways to fill a gap, each a function of the gap and its surroundings.

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

from markerloom import _core
from markerloom.filling.surroundings import Surroundings

Array = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]

KNOTS = 8
"""Samples on each side from which a spline is made."""


@dataclass(frozen=True)
class Gap:
    """A gap from frame ``first`` to before ``last``, and the rows of the surroundings one may learn from. ``own``: the
    marker from frame ``begins`` on, NaN where it is not seen.
    """

    around: Surroundings
    own: Array
    first: int
    last: int
    learn: Ints
    begins: int = 0


def constant(gap: Gap) -> Array | None:
    """The nearer of the values on both sides."""
    times = np.arange(gap.first, gap.last)
    nearer = times - gap.first < gap.last - 1 - times
    return np.where(nearer[:, None], gap.own[gap.first - 1 - gap.begins], gap.own[gap.last - gap.begins])


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
    low, high = max(gap.begins, gap.first - KNOTS), min(gap.begins + len(gap.own), gap.last + KNOTS)
    times = np.concatenate([np.arange(low, gap.first), np.arange(gap.last, high)])
    times = times[np.isfinite(gap.own[times - gap.begins]).all(axis=1)]
    if len(times) <= order or not (times < gap.first).any() or not (times >= gap.last).any():
        return None
    if order == 1:
        times = np.array([gap.first - 1, gap.last])
    return make_interp_spline(times, gap.own[times - gap.begins], k=order)(np.arange(gap.first, gap.last))


def _from_neighbours(way: str) -> Callable[[Gap], Array | None]:
    """A way of the engine (`crates/core/src/fill.rs`)."""
    return lambda gap: _core.fill_gap(way, gap.around.core, gap.first, gap.last, gap.learn)


METHODS: dict[str, Callable[[Gap], Array | None]] = {
    "constant": constant,
    "linear": linear,
    "cubic": cubic,
    "quintic": quintic,
    "pattern": _from_neighbours("pattern"),
    "rigid": _from_neighbours("rigid"),
    "links": _from_neighbours("links"),
    "regression": _from_neighbours("regression"),
    "cyclic": _from_neighbours("cyclic"),
}
TRIED = ("linear", "cubic", "quintic", "pattern", "rigid", "links", "regression", "cyclic")
"""What ``auto`` chooses from: everything but holding a value."""
