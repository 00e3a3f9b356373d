"""Gaps of a take, filled: each by the method that would have filled others like it best."""

from __future__ import annotations

import os
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import InputError
from markerloom.filling.auto import SHAPE, Choice, choose, expected, learnable, thinned
from markerloom.filling.methods import METHODS, TRIED, Gap
from markerloom.filling.surroundings import FEWEST, Surroundings, neighbours_of, spreads, surroundings
from markerloom.points import KINDS, Points
from markerloom.reconstruct import Progress
from markerloom.trajectories import ABSENT, FILLED, Trajectories

Array = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]

LONGEST_S = 2.0
MOST_THREADS = 4
"""Beyond this many, threads wait for each other: what is not in the engine runs one at a time."""
PREDICTED = KINDS.index("predicted")
ALIKE_S = 15.0
"""Gaps of one marker within this time share a choice, when their lengths are of one size (s)."""
POOLED = 3.0
"""What the errors that are usual for gaps of a size are worth, in stretches."""
UNTRIED_MM = 10.0
"""Uncertainty where there was nothing to try a method on, growing with the length of the gap."""


@dataclass(frozen=True)
class Filled(Points):
    """A take with its gaps filled. ``report``: every gap, how it was filled, and the expected error."""

    report: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class _Hole:
    slot: int
    first: int
    last: int


def fill(
    points: Points,
    *,
    method: str = "auto",
    longest_s: float = LONGEST_S,
    rate_hz: float | None = None,
    markers: list[str] | None = None,
    predicted: bool = False,
    frames: tuple[int | None, int | None] | None = None,
    progress: Progress | None = None,
) -> Filled:
    """Fill the gaps of a take.

    ``method``: ``auto`` mixes the others as would have been best on stretches like the gap, in that marker's own
    neighbourhood; or one of constant, linear, cubic, quintic, pattern, rigid, links, regression, cyclic. Gaps longer
    than ``longest_s`` stay, as do beginnings and ends; nothing is held or extrapolated unless ``constant`` is asked
    for. ``markers``: only these. ``predicted``: fill anew what a tracker carried.
    ``frames``: only gaps that meet these (first, one past the last). Filled samples are of kind ``filled``
    with their ``sigma_mm``. Raises ``InputError`` for an unknown method or marker, or without a frame rate.
    """
    clock = time.perf_counter()
    if method != "auto" and method not in METHODS:
        raise InputError(f"method '{method}': auto, {', '.join(METHODS)}")
    rate = points.rate_hz if rate_hz is None else rate_hz
    if rate is None or not 0 < rate < 1e6:
        raise InputError(f"filling needs the frame rate: state it with --rate-hz ({points.source})")
    points = replace(points, rate_hz=rate)
    if predicted:
        points = points.keep(points.kind != PREDICTED)
    take = Trajectories.of(points)
    slots = _slots(take, markers)
    holes = [hole for slot in slots for hole in _holes(take, slot) if _meets(take, hole, frames)]
    longest = round(longest_s * rate)
    todo = [hole for hole in holes if hole.last - hole.first <= longest]
    xyz_mm, sigma_mm, kind = take.xyz_mm.copy(), take.sigma_mm.copy(), take.kind.copy()
    methods = TRIED if method == "auto" else (method,)
    rows: list[dict[str, Any]] = []
    plans = _plans(take, todo, methods, rate, progress)
    usual = {size: _pooled_mm(plans, size) for size in {plan.size for plan in plans}}
    noise = {slot: _noise_mm(sigma_mm[:, slot]) for slot in {plan.hole.slot for plan in plans}}
    for plan in plans:
        result = _filled(plan, usual[plan.size], noise[plan.hole.slot])
        if result is not None:
            inside = (slice(plan.hole.first, plan.hole.last), plan.hole.slot)
            xyz_mm[inside], sigma_mm[inside], how = result
            kind[inside] = FILLED
            rows.append({**_described(take, plan.hole), **how})
    filled = take.changed(xyz_mm, sigma_mm, kind).as_points()
    done = {(r["marker"], r["first"]) for r in rows}
    left = [d for d in (_described(take, hole) for hole in holes) if (d["marker"], d["first"]) not in done]
    report = {
        "frames": len(take.frames),
        "warnings": _warnings(left, longest_s),
        "method": method,
        "longest_s": longest_s,
        "gaps": len(holes),
        "filled": rows,
        "left": left,
        "complete_before": float(np.mean(take.present[:, slots])) if slots else 1.0,
        "complete_after": float(np.mean(kind[:, slots] != ABSENT)) if slots else 1.0,
        "timing": {"seconds": time.perf_counter() - clock},
    }
    columns = {name: getattr(filled, name) for name in Points.__dataclass_fields__}
    return Filled(**columns, report=report)


def _slots(take: Trajectories, markers: list[str] | None) -> list[int]:
    """Trajectories to fill: those with a name; all, where none has one."""
    if markers is not None:
        unknown = sorted(set(markers) - set(take.names))
        if unknown:
            raise InputError(f"the take has no marker '{unknown[0]}'; it has {', '.join(take.names[:12])} …")
        return [take.names.index(m) for m in markers]
    named = [i for i, name in enumerate(take.names) if not name.startswith("*")]
    return named or list(range(len(take.names)))


def _holes(take: Trajectories, slot: int) -> list[_Hole]:
    """Gaps between the first and the last sample."""
    seen = np.flatnonzero(take.present[:, slot])
    jumps = np.flatnonzero(np.diff(seen) > 1)
    return [_Hole(slot, int(seen[j]) + 1, int(seen[j + 1])) for j in jumps]


def _meets(take: Trajectories, hole: _Hole, frames: tuple[int | None, int | None] | None) -> bool:
    """Whether a gap lies in frames that are wanted, or reaches into them."""
    start, stop = frames or (None, None)
    first, last = int(take.frames[hole.first]), int(take.frames[hole.last - 1])
    return (start is None or last >= start) and (stop is None or first < stop)


def _described(take: Trajectories, hole: _Hole) -> dict[str, Any]:
    first, last = int(take.frames[hole.first]), int(take.frames[hole.last - 1])
    return {"marker": take.names[hole.slot], "first": first, "last": last, "frames": hole.last - hole.first}


@dataclass(frozen=True)
class _Plan:
    """A gap with how it will be filled: the choice, and what each of its methods says (frames, 3)."""

    hole: _Hole
    size: int
    choice: Choice
    tried: bool
    parts: dict[str, Array]


def _plans(
    take: Trajectories, holes: list[_Hole], methods: tuple[str, ...], rate_hz: float, progress: Progress | None
) -> list[_Plan]:
    """How every gap will be filled; gaps of one marker that are alike and near each other share what was tried."""
    spread = spreads(take.xyz_mm) if holes else np.zeros((0, 0))
    alike: dict[tuple[int, int, int, bytes], list[tuple[_Hole, Ints]]] = {}
    for hole in holes:
        neighbours = neighbours_of(take.xyz_mm, hole.slot, hole.first, hole.last, spread)
        key = (hole.slot, _size(hole), int(hole.first / (ALIKE_S * rate_hz)), neighbours.tobytes())
        alike.setdefault(key, []).append((hole, neighbours))
    plans: dict[_Hole, _Plan] = {}
    with ThreadPoolExecutor(min(MOST_THREADS, os.cpu_count() or 1)) as pool:
        for found in pool.map(lambda some: _planned(take, some, methods, rate_hz), alike.values()):
            plans |= {plan.hole: plan for plan in found}
            if progress:
                progress(len(plans), len(holes))
    return [plans[hole] for hole in holes]


def _size(hole: _Hole) -> int:
    return round(2.0 * np.log2(hole.last - hole.first))


def _planned(
    take: Trajectories, alike: list[tuple[_Hole, Ints]], methods: tuple[str, ...], rate_hz: float
) -> list[_Plan]:
    """Gaps that are alike, by what was tried for the first of them."""
    plans: list[_Plan] = []
    known: Choice | None = None
    for hole, neighbours in alike:
        around = surroundings(take.xyz_mm, hole.slot, hole.first, hole.last, neighbours, rate_hz)
        own = take.xyz_mm[:, hole.slot]
        if not plans:
            known = choose(around, own, hole.first, hole.last, methods, rate_hz)
        choice = known or _untried(around, methods, (hole.last - hole.first) / rate_hz)
        gap = Gap(around, own, hole.first, hole.last, thinned(learnable(around), around, hole.first, hole.last))
        parts = {m: METHODS[m](gap) for m in choice.weights}
        found = {m: p for m, p in parts.items() if p is not None and np.isfinite(p).all()}
        plans.append(_Plan(hole, _size(hole), choice, known is not None, found))
    return plans


def _pooled_mm(plans: list[_Plan], size: int) -> float:
    """The usual expected error of gaps of about this size (rms, mm)."""
    errors = [p.choice.error_mm for p in plans if p.tried and abs(p.size - size) <= 1]
    return float(np.sqrt(np.mean(np.square(errors)))) if errors else 0.0


def _noise_mm(sigma_mm: Array) -> float:
    """What a marker's own samples are uncertain by; 0 where they do not say."""
    known = sigma_mm[np.isfinite(sigma_mm)]
    return float(np.median(known)) if len(known) else 0.0


def _filled(plan: _Plan, pooled_mm: float, noise_mm: float) -> tuple[Array, Array, dict[str, Any]] | None:
    """Places, sigmas, and how they were found; ``None`` where no method can."""
    hole, choice, found = plan.hole, plan.choice, plan.parts
    if not found:
        return None
    total = sum(choice.weights[m] for m in found)
    place = np.sum([choice.weights[m] / total * p for m, p in found.items()], axis=0)
    over = np.linspace(0.0, 1.0, hole.last - hole.first)
    # Few stretches may all have been easy: a part of what is usual for gaps of this size goes in.
    n = choice.stretches
    error = np.sqrt((n * choice.error_mm**2 + POOLED * pooled_mm**2) / (n + POOLED)) if plan.tried else choice.error_mm
    shape_mm = choice.shape_mm * error / max(choice.error_mm, 1e-9)
    sigma_mm = np.hypot(np.interp(over, SHAPE, shape_mm), noise_mm)
    how = {
        "method": choice.method,
        "weights": {m: round(choice.weights[m] / total, 3) for m in found},
        "expected_mm": round(float(error), 3),
        "tried": plan.tried,
    }
    return place, sigma_mm, how


def _untried(around: Surroundings, methods: tuple[str, ...], length_s: float) -> Choice:
    """A choice where nothing could be tried: what is usually best, with a large uncertainty."""
    usable = [m for m in methods if len(around.neighbours) >= FEWEST or m in ("constant", "linear", "cubic", "quintic")]
    error = expected(usable or list(methods), length_s)
    best = (usable or list(methods))[int(np.argmin(error))]
    guess = UNTRIED_MM * (1.0 + length_s) * float(min(error.min(), 10.0))
    return Choice({best: 1.0}, guess, np.full(len(SHAPE), guess))


def _warnings(left: list[dict[str, Any]], longest_s: float) -> list[str]:
    if not left:
        return []
    worst = max(left, key=lambda d: d["frames"])
    return [
        f"{len(left)} gaps stay: longer than {longest_s:g} s, or nothing to fill them from; the longest is "
        f"'{worst['marker']}', frames {worst['first']} to {worst['last']}"
    ]
