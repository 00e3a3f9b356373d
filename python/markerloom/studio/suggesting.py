"""Names that a trajectory may have, by how far it is from its neighbours; and what each way to fill would give."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import InputError
from markerloom.filling.methods import METHODS
from markerloom.mending.operations import filled
from markerloom.mending.sheet import ABSENT, Sheet
from markerloom.studio import messages
from markerloom.studio.opened import OpenTake

Array = NDArray[Any]
SAMPLED = 200
FEWEST = 3
"""Neighbours with a known distance from which a name is judged, at least."""
MOST = 8
SPREAD_MM = 2.0
"""Spread that a distance is taken to have at least."""


def suggestions(take: OpenTake, slot: int) -> list[messages.Suggestion]:
    """Names that are free where the trajectory is, the likeliest first.

    Distances to named markers, while the trajectory is there, are compared with what they are elsewhere in the take.
    """
    sheet = take.sheet
    own_rows = _some(sheet.trajectories[slot].kind != ABSENT)
    mine = sheet.trajectories[slot].xyz_mm[own_rows]
    named = [i for i, t in enumerate(sheet.trajectories) if t.label and i != slot]
    # Distances from the trajectory to every named marker: median over the frames that both have.
    here = np.array([_distance(mine, sheet.trajectories[i].xyz_mm[own_rows])[0] for i in named])
    found = []
    for candidate in named:
        kind = sheet.trajectories[candidate].kind
        if np.mean(kind[own_rows] != ABSENT) > 0.1:
            continue
        rows = _some(kind != ABSENT)
        theirs = sheet.trajectories[candidate].xyz_mm[rows]
        off = []
        for i, distance in zip(named, here, strict=True):
            if i == candidate or not np.isfinite(distance):
                continue
            elsewhere, spread = _distance(theirs, sheet.trajectories[i].xyz_mm[rows])
            if np.isfinite(elsewhere):
                off.append((distance - elsewhere, max(spread, SPREAD_MM)))
        if len(off) >= FEWEST:
            difference, sd = np.array(off).T
            weight = 1.0 / sd**2
            rms = float(np.sqrt(np.sum(weight * difference**2) / np.sum(weight)))
            found.append(messages.Suggestion(name=sheet.trajectories[candidate].label, off_mm=round(rms, 2)))
    return sorted(found, key=lambda s: s.off_mm)[:MOST]


def _some(flags: Array) -> Array:
    rows = np.flatnonzero(flags)
    return rows if len(rows) <= SAMPLED else rows[np.linspace(0, len(rows) - 1, SAMPLED).astype(int)]


def _distance(a: Array, b: Array) -> tuple[float, float]:
    """Median distance of two markers (mm) and its robust spread; NaN where they are never seen together."""
    apart = np.linalg.norm(a - b, axis=1)
    apart = apart[np.isfinite(apart)]
    if len(apart) < 3:
        return float("nan"), float("nan")
    middle = float(np.median(apart))
    return middle, 1.48 * float(np.median(np.abs(apart - middle)))


def previews(take: OpenTake, slot: int, first: int, last: int) -> list[messages.Preview]:
    """The gap of a trajectory that meets rows ``first`` to ``last``, filled by each method; nothing is changed."""
    found = []
    for method in ("auto", *METHODS):
        try:
            made = filled(take.sheet, slot, first, last + 1, method)
        except InputError as error:
            found.append(_failed(method, str(error)))
            continue
        found.append(_preview(take.sheet, method, made) if made else _failed(method, "does not work here"))
    return found


def _preview(sheet: Sheet, method: str, made: list[tuple[int, dict[str, Any]]]) -> messages.Preview:
    low, samples = made[0]
    sigma = samples["sigma_mm"][np.isfinite(samples["sigma_mm"])]
    return messages.Preview(
        method=method,
        first=low + sheet.first,
        xyz_mm=[(float(x), float(y), float(z)) for x, y, z in samples["xyz_mm"]],
        expected_mm=round(float(np.sqrt(np.mean(sigma**2))), 3) if len(sigma) else 0.0,
        reason="",
    )


def _failed(method: str, reason: str) -> messages.Preview:
    return messages.Preview(method=method, first=0, xyz_mm=[], expected_mm=0.0, reason=reason)
