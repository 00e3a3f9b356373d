"""What each edit does to a take: one function for each, through the same functions as the command line's verbs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from markerloom.errors import InputError
from markerloom.filling import fill
from markerloom.mending.edits import (
    Delete,
    Fill,
    Join,
    Label,
    Move,
    PointEdit,
    Smooth,
    Split,
    Swap,
    Unlabel,
)
from markerloom.mending.sheet import ABSENT, BLANK, Changes, Sheet
from markerloom.points import KINDS, Points
from markerloom.smoothing import smooth

AROUND_S = 30.0
"""Gaps are filled by what is known within this time (s): three times as far as filling looks around a gap."""
PREDICTED, EDITED = KINDS.index("predicted"), KINDS.index("edited")
LEAD_S, LEAD_PERIODS = 1.0, 4.0
"""Smoothing of a range begins so long before it, or so many periods of the cut-off, whichever is more."""


def apply(sheet: Sheet, edit: PointEdit) -> Changes:
    """Apply an edit; returns the way back. Where it does not fit, ``InputError`` says why and nothing is changed."""
    changes = Changes(sheet)
    try:
        OPERATIONS[type(edit)](changes, edit)
    except InputError:
        changes.take_back()
        raise
    return changes


def _label(changes: Changes, edit: Label) -> None:
    sheet = changes.sheet
    slot, own = sheet.find(edit.at), sheet.labelled(edit.name)
    if own == slot:
        raise InputError(f"the marker is called '{edit.name}' already")
    low, high = (0, sheet.count) if edit.within is None else sheet.span(edit.within)
    if own is None and edit.within is None:
        changes.rename(slot, edit.name)
        return
    _give(changes, slot, changes.new(edit.name) if own is None else own, low, high)


def _unlabel(changes: Changes, edit: Unlabel) -> None:
    sheet = changes.sheet
    slot = sheet.find(edit.at)
    if not sheet.trajectories[slot].label:
        raise InputError("the marker has no name")
    if edit.within is None:
        changes.rename(slot, "")
        return
    _give(changes, slot, changes.new(), *sheet.span(edit.within))


def _swap(changes: Changes, edit: Swap) -> None:
    sheet = changes.sheet
    a, b = sheet.find(edit.at), sheet.find(edit.other)
    if a == b:
        raise InputError("a marker cannot be exchanged with itself")
    low, high = sheet.span(edit.within)
    mine, theirs = changes.copy(a, low, high), changes.copy(b, low, high)
    changes.write(a, low, theirs)
    changes.write(b, low, mine)


def _split(changes: Changes, edit: Split) -> None:
    sheet = changes.sheet
    slot, row = sheet.find(edit.at), edit.frame - sheet.first
    seen = sheet.trajectories[slot].kind != ABSENT
    if not 0 < row < sheet.count or not seen[:row].any() or not seen[row:].any():
        raise InputError(f"{sheet.name(slot)} has no samples on both sides of frame {edit.frame}")
    _give(changes, slot, changes.new(), row, sheet.count)


def _join(changes: Changes, edit: Join) -> None:
    sheet = changes.sheet
    a, b = sheet.find(edit.at), sheet.find(edit.other)
    if a == b:
        raise InputError("both are the same trajectory already")
    if not sheet.trajectories[a].label and sheet.trajectories[b].label:
        changes.rename(a, sheet.trajectories[b].label)
    _give(changes, b, a, 0, sheet.count)
    changes.rename(b, "")


def _give(changes: Changes, giver: int, taker: int, low: int, high: int) -> None:
    """The samples of some rows go from one trajectory to another, which must have none where they are."""
    sheet = changes.sheet
    given, there = sheet.trajectories[giver].kind[low:high], sheet.trajectories[taker].kind[low:high]
    both = np.flatnonzero((given != ABSENT) & (there != ABSENT))
    if len(both):
        first, last = (int(both[i]) + low + sheet.first for i in (0, -1))
        raise InputError(
            f"{sheet.name(giver)} and {sheet.name(taker)} are both there in {len(both)} frames from {first} to {last}: "
            "exchange them over a range, or delete or unlabel one of them there first"
        )
    seen = given != ABSENT
    mine, theirs = changes.copy(giver, low, high), changes.copy(taker, low, high)
    for name, values in theirs.items():
        values[seen] = mine[name][seen]
    changes.write(taker, low, theirs)
    changes.clear(giver, low, high)


def _delete(changes: Changes, edit: Delete) -> None:
    sheet = changes.sheet
    slot = sheet.find(edit.at)
    low, high = sheet.span(edit.within)
    if not (sheet.trajectories[slot].kind[low:high] != ABSENT).any():
        raise InputError(f"{sheet.name(slot)} has no samples there")
    changes.clear(slot, low, high)


def _fill(changes: Changes, edit: Fill) -> None:
    sheet = changes.sheet
    slot = sheet.find(edit.at)
    low, high = sheet.span(edit.within)
    if edit.predicted:
        carried = np.flatnonzero(sheet.trajectories[slot].kind[low:high] == PREDICTED) + low
        for row in carried.tolist():
            changes.clear(slot, row, row + 1)
    made = filled(sheet, slot, low, high, edit.method)
    if not made:
        raise InputError(f"{sheet.name(slot)} has no gap in frames {edit.within.first} to {edit.within.last} to fill")
    for first, samples in made:
        changes.write(slot, first, samples)


def filled(sheet: Sheet, slot: int, low: int, high: int, method: str) -> list[tuple[int, dict[str, Any]]]:
    """How the gaps of a trajectory that meet rows ``low`` to before ``high`` would be filled; nothing is changed."""
    margin = round(AROUND_S * (sheet.rate_hz or 100.0))
    start, stop = max(low - margin, 0), min(high + margin, sheet.count)
    points = sheet.window(start, stop)
    names, _ = points.slots()
    tracks = np.unique(points.track).tolist()
    if slot not in tracks:
        return []
    marker, frames = names[tracks.index(slot)], (low + sheet.first, high + sheet.first)
    result = fill(
        points, method=method, markers=[marker], longest_s=(stop - start) / (sheet.rate_hz or 1.0), frames=frames
    )
    found = []
    own = result.track == slot
    for gap in result.report["filled"]:
        first = gap["first"] - sheet.first
        rows = np.flatnonzero(own & (result.frame >= gap["first"]) & (result.frame <= gap["last"]))
        found.append((first, _new_samples(sheet, slot, result, rows)))
    return found


def _smooth(changes: Changes, edit: Smooth) -> None:
    sheet = changes.sheet
    slot = sheet.find(edit.at)
    low, high = sheet.span(edit.within)
    rate = sheet.rate_hz or 100.0
    lead = round(max(LEAD_S, LEAD_PERIODS / edit.cutoff_hz) * rate)
    points = sheet.window(low - lead, high + lead, [slot])
    result = smooth(points, method=edit.method, cutoff_hz=edit.cutoff_hz)
    rows = np.flatnonzero((result.frame >= low + sheet.first) & (result.frame < high + sheet.first))
    if len(rows) == 0:
        raise InputError(f"{sheet.name(slot)} has no samples there")
    after = changes.copy(slot, low, high)
    there = result.frame[rows] - sheet.first - low
    after["xyz_mm"][there] = result.xyz_mm[rows]
    thrown = np.ones(high - low, bool)
    thrown[there] = False
    for name, values in after.items():
        values[thrown] = BLANK[name]
    changes.write(slot, low, after)


def _move(changes: Changes, edit: Move) -> None:
    sheet = changes.sheet
    slot = sheet.find(edit.at)
    row = edit.at.frame - sheet.first
    after = changes.copy(slot, row, row + 1)
    after["xyz_mm"][0], after["kind"][0] = edit.xyz_mm, EDITED
    after["sigma_mm"][0] = after["residual"][0] = np.nan
    changes.write(slot, row, after)


def _new_samples(sheet: Sheet, slot: int, points: Points, rows: np.ndarray) -> dict[str, Any]:
    """Samples that came from a method; what it does not know of them is blank."""
    made = {"xyz_mm": points.xyz_mm[rows], "sigma_mm": points.sigma_mm[rows], "kind": points.kind[rows]}
    rest = {
        n: np.full(len(rows), -1 if n == "row" else np.nan) for n in sheet.trajectories[slot].samples if n not in made
    }
    return {**made, **rest}


OPERATIONS: dict[type, Callable[[Changes, Any], None]] = {
    Label: _label,
    Unlabel: _unlabel,
    Swap: _swap,
    Split: _split,
    Join: _join,
    Delete: _delete,
    Fill: _fill,
    Smooth: _smooth,
    Move: _move,
}
