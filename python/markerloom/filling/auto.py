"""The way to fill a gap, chosen by leaving out stretches like it in that marker's own neighbourhood.

Stretches of the gap's length, with the same neighbours there, are filled by every method as if they were gaps. The
methods are then mixed with the weights that would have been best on the stretches (non-negative, summing to one; the
errors' covariance is shrunk, since stretches are few), and the errors of that mix are the gap's expected ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from markerloom.filling.methods import KNOTS, METHODS, Gap
from markerloom.filling.surroundings import LEARNED, Surroundings

Array = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]

STRETCHES = 8
HOPELESS_AFTER = 3
HOPELESS = 5.0
"""A method that is off so many times as much as the best after so many stretches is not tried on the others."""
BELIEVED = 12.0
"""What the belief before any stretch is worth, in stretches."""
APART_S = 0.25
"""What is nearer to a stretch than this is not learned from when it is left out (s)."""
ALIKE = 0.7
"""Stretches are alike whose neighbours moved as much, within this factor's logarithm."""
STILL_MM = 0.5
ALIKE_ERRORS = 0.7
"""Correlation of the methods' errors that is believed; like ``BELIEVED`` chosen on benches/filling.py, seed 0."""
SHRINK = 0.05
LEAST_WEIGHT = 0.02
SHAPE = np.linspace(0.0, 1.0, 11)
"""Places within a gap for which the expected error is kept."""


@dataclass(frozen=True)
class Choice:
    """How to fill gaps of a kind: the weight of each method, the expected error (rms, mm), and its shape over the gap
    (mm, at ``SHAPE``)."""

    weights: dict[str, float]
    error_mm: float
    shape_mm: Array
    stretches: int = 0

    @property
    def method(self) -> str:
        """The method of the largest weight."""
        return max(self.weights, key=lambda m: self.weights[m])


def choose(
    around: Surroundings, own: Array, first: int, last: int, methods: tuple[str, ...], rate_hz: float
) -> Choice | None:
    """The choice for a gap; ``None`` where there is nothing like it to learn from."""
    length = last - first
    stretches = _stretches(around, own, first, last)
    errors: dict[str, list[Array]] = {m: [] for m in methods}
    apart = round(APART_S * rate_hz)
    usable = learnable(around)
    tried = list(methods)
    begins = max(0, int(around.frames[0]) - KNOTS)
    hidden = own[begins : int(around.frames[-1]) + 1 + KNOTS].copy()
    for number, start in enumerate(stretches):
        frames = around.frames[usable]
        away = (frames < start - apart) | (frames >= start + length + apart)
        inside, truth = slice(start - begins, start - begins + length), own[start : start + length]
        hidden[inside] = np.nan
        learn = thinned(usable[away], around, start, start + length)
        gap = Gap(around, hidden, start, start + length, learn, begins)
        for method in tried:
            filled = METHODS[method](gap)
            errors[method].append(np.full_like(truth, np.nan) if filled is None else filled - truth)
        hidden[inside] = truth
        if number + 1 == HOPELESS_AFTER:
            tried = _worth_it(errors)
    kept = [m for m in tried if errors[m] and np.isfinite(errors[m]).all()]
    if not kept:
        return None
    every = np.array([errors[m] for m in kept])  # (methods, stretches, frames, 3)
    # Stretches in which the neighbours moved as they do in the gap say most about it.
    moved = np.array([_moved_mm(around, start, length) for start in stretches])
    here = _moved_mm(around, first, length)
    alike = np.exp(-0.5 * (np.log(moved / here) / ALIKE) ** 2) + 0.05
    alike *= len(alike) / alike.sum()
    weighted = every * np.sqrt(alike)[:, None, None]
    weights = mixed(weighted.reshape(len(kept), -1), len(stretches), expected(kept, length / rate_hz))
    off = np.einsum("m,mslk->slk", weights, weighted)
    over = np.interp(np.arange(length), [0, max(1, length - 1)], [0.0, 1.0])
    per_frame = np.sqrt((off**2).sum(axis=2).mean(axis=0))
    width = max(0.08, 1.5 / length)
    near = np.exp(-0.5 * ((SHAPE[:, None] - over) / width) ** 2)
    shape = np.sqrt(near @ per_frame**2 / near.sum(axis=1))
    # The weights were chosen on these very stretches: what they explain by chance is given back.
    count = len(stretches)
    given_back = np.sqrt((count + 1.0) / max(count - 1.0, 0.5))
    used = {m: float(w) for m, w in zip(kept, weights, strict=True) if w > 0}
    return Choice(used, float(np.sqrt((off**2).sum(axis=2).mean()) * given_back), shape * given_back, count)


def _worth_it(errors: dict[str, list[Array]]) -> list[str]:
    """Methods that have not been hopeless so far."""
    square = {m: float(np.mean(np.square(e))) for m, e in errors.items() if e and np.isfinite(e).all()}
    least = min(square.values(), default=0.0)
    return [m for m, s in square.items() if s <= HOPELESS**2 * max(least, 1e-12)]


def _moved_mm(around: Surroundings, first: int, length: int) -> float:
    """How much the neighbours moved otherwise than straight on (mm), over a quarter of the stretch at a time."""
    places = around.neighbours_mm[around.rows(first - 1, first + length + 1)]
    if places.shape[1] == 0 or len(places) < 3:
        return 1.0
    step = max(1, len(places) // 4)
    bent = places[2 * step :] - 2.0 * places[step:-step] + places[: -2 * step]
    return float(np.sqrt((bent**2).sum(axis=2).mean())) + STILL_MM if len(bent) else STILL_MM


def expected(methods: list[str], length_s: float) -> Array:
    """Errors to be expected of methods before any was tried, relative to the regression's: splines go astray with the
    length of a gap, neighbours hardly do. Rough numbers, by eye from the takes of benches/filling.py."""
    astray = {
        "linear": 8.0 * (length_s / 0.2) ** 1.5,
        "cubic": 1.5 * (length_s / 0.1) ** 1.7,
        "quintic": 1.5 * (length_s / 0.1) ** 2.2,
    }
    near = {"pattern": 4.0, "rigid": 1.8, "links": 2.0, "regression": 1.0, "cyclic": 1.6, "constant": 50.0}
    return np.array([astray[m] if m in astray else near[m] for m in methods])


def mixed(errors: Array, stretches: int, before: Array) -> Array:
    """Weights (non-negative, sum 1) of the mix with the least square error.

    ``errors``: (methods, values) over so many ``stretches``; ``before``: relative errors expected without any.
    """
    covariance = errors @ errors.T / errors.shape[1]
    own = np.diag(covariance)
    scale = np.median(own / before**2)
    # Methods err alike, since they see the same neighbours: a mix of many is no better than the best of them.
    belief = scale * (ALIKE_ERRORS * np.outer(before, before) + (1.0 - ALIKE_ERRORS) * np.diag(before**2))
    belief += 1e-6 * np.eye(len(belief))
    covariance = (stretches * covariance + BELIEVED * belief) / (stretches + BELIEVED)
    covariance += SHRINK * np.diag(np.diag(covariance)) + 1e-9 * np.eye(len(covariance))
    root = np.linalg.cholesky(covariance).T
    heavy = 1e3 * np.sqrt(np.trace(covariance))
    weights, _ = nnls(np.vstack([root, np.full(len(root), heavy)]), np.append(np.zeros(len(root)), heavy))
    weights = np.where(weights < LEAST_WEIGHT, 0.0, weights)
    return weights / weights.sum()


def learnable(around: Surroundings) -> Ints:
    """Rows of the surroundings in which the marker is seen too."""
    return np.flatnonzero(np.isfinite(around.local).all(axis=1))


def thinned(rows: Ints, around: Surroundings, first: int, last: int) -> Ints:
    """At most so many rows as are worth learning from, all of those nearest to the gap among them."""
    if len(rows) <= LEARNED:
        return rows
    distance = np.maximum(first - around.frames[rows], around.frames[rows] - last)
    near = np.argpartition(distance, LEARNED // 3)[: LEARNED // 3]
    kept = np.zeros(len(rows), bool)
    kept[near] = True
    rest = np.flatnonzero(~kept)
    kept[rest[np.linspace(0, len(rest) - 1, LEARNED - len(near)).astype(int)]] = True
    return rows[kept]


def _stretches(around: Surroundings, own: Array, first: int, last: int) -> list[int]:
    """First frames of stretches as long as the gap in which everything is seen, spread around it, the nearest first."""
    length = last - first
    low, high = int(around.frames[0]), int(around.frames[-1]) + 1
    seen = np.zeros(high - low, bool)
    seen[around.frames - low] = True
    seen &= np.isfinite(own[low:high]).all(axis=1)
    whole = length + 2 * BESIDE
    if len(seen) < whole:
        return []
    run = np.convolve(seen, np.ones(whole), "valid") >= whole
    starts = low + BESIDE + np.flatnonzero(run)
    if len(starts) == 0:
        return []
    chosen: list[int] = []
    step = max(1, length // 2, len(starts) // 64)
    distance = np.abs(starts + length / 2.0 - (first + last) / 2.0)
    left = starts[np.argsort(distance, kind="stable")]
    nearest = np.full(len(left), high)
    while len(chosen) < STRETCHES:
        free = np.flatnonzero(nearest >= step)
        if len(free) == 0:
            break
        chosen.append(int(left[free[0]]))
        left, nearest = left[free[0] + 1 :], nearest[free[0] + 1 :]
        nearest = np.minimum(nearest, np.abs(left - chosen[-1]))
        step = max(step, length, len(starts) // (4 * STRETCHES))
    return chosen


BESIDE = 4
"""Frames on both sides of a stretch that must be seen."""
