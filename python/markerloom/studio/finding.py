"""What is worth a look in a take: gaps, high residuals, jumps, names that may be wrong."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import MarkerloomError
from markerloom.labelling import check_labels
from markerloom.labelling.check import JUMP_MM
from markerloom.mending.sheet import ABSENT, Sheet
from markerloom.studio import messages
from markerloom.studio.opened import OpenTake

Array = NDArray[Any]
HIGH = 6.0
"""A residual is high from so many times the typical one of its trajectory."""
JUMP_SIGMAS = 12.0
CHECKED_SAMPLES = 2_000_000
"""Takes with more samples are not checked for wrong names while somebody waits."""
MOST = 2000


def findings(take: OpenTake) -> messages.Findings:
    """All findings in order of time."""
    sheet = take.sheet
    found: list[messages.Finding] = []
    for slot, one in enumerate(sheet.trajectories):
        seen = np.flatnonzero(one.kind != ABSENT)
        if len(seen) == 0:
            continue
        found += _gaps(sheet, slot, seen) if one.label else _unlabelled(sheet, slot, seen)
        found += _residuals(take, slot)
        found += _jumps(sheet, slot)
    notes = []
    names, note = _names(take)
    found += names
    notes += [note] if note else []
    found.sort(key=lambda f: (f.first, f.slot, f.kind))
    if len(found) > MOST:
        notes.append(f"the first {MOST} of {len(found)} findings are listed")
    return messages.Findings(revision=take.revision, findings=found[:MOST], notes=notes)


def _gaps(sheet: Sheet, slot: int, seen: Array) -> list[messages.Finding]:
    jumps = np.flatnonzero(np.diff(seen) > 1)
    out = []
    for j in jumps.tolist():
        first, last = int(seen[j]) + 1, int(seen[j + 1]) - 1
        text = f"{sheet.name(slot)} is missing for {last - first + 1} frames"
        out.append(_finding(sheet, "gap", slot, first, last, text))
    return out


def _unlabelled(sheet: Sheet, slot: int, seen: Array) -> list[messages.Finding]:
    if not any(t.label for t in sheet.trajectories):
        return []
    text = f"{sheet.name(slot)} has no name ({len(seen)} samples)"
    return [_finding(sheet, "unlabelled", slot, int(seen[0]), int(seen[-1]), text)]


def _residuals(take: OpenTake, slot: int) -> list[messages.Finding]:
    """Where rays do not meet as well as they do elsewhere."""
    residual = np.asarray(take.sheet.trajectories[slot].samples["residual"], float)
    known = np.isfinite(residual)
    if not known.any():
        return []
    typical = float(np.median(residual[known]))
    high = known & (residual > HIGH * max(typical, 1e-9))
    out = []
    for first, last in _runs(high, join=10):
        peak = float(np.nanmax(residual[first : last + 1]))
        text = f"{take.sheet.name(slot)}: residual up to {peak:.2f} {take.residual_unit} (typical {typical:.2f})"
        out.append(_finding(take.sheet, "residual", slot, first, last, text))
    return out


def _jumps(sheet: Sheet, slot: int) -> list[messages.Finding]:
    """Where a trajectory leaves its path for one that it does not come back from within a frame."""
    xyz = np.asarray(sheet.trajectories[slot].xyz_mm)
    if len(xyz) < 4:
        return []
    bent = np.linalg.norm(xyz[3:] - 3.0 * xyz[2:-1] + 3.0 * xyz[1:-2] - xyz[:-3], axis=1)
    known = np.isfinite(bent)
    if known.sum() < 8:
        return []
    typical = 1.48 * float(np.median(bent[known]))
    out = []
    for first, last in _runs(known & (bent > max(JUMP_SIGMAS * typical, 3.0 * JUMP_MM)), join=4):
        text = f"{sheet.name(slot)} jumps"
        out.append(_finding(sheet, "jump", slot, first + 1, last + 2, text))
    return out


def _names(take: OpenTake) -> tuple[list[messages.Finding], str]:
    """Names that may be wrong, by the distances between markers."""
    sheet = take.sheet
    samples = sum(int(np.sum(t.kind != ABSENT)) for t in sheet.trajectories)
    labelled = {t.label: i for i, t in enumerate(sheet.trajectories) if t.label}
    if len(labelled) < 4 or not sheet.rate_hz:
        return [], ""
    if samples > CHECKED_SAMPLES:
        return [], "names are not checked in a take of this length: `markerloom label --check` does that"
    try:
        checked = check_labels(sheet.window(0, sheet.count))
    except MarkerloomError as error:
        return [], f"names could not be checked: {error}"
    out = []
    for wrong in checked.wrong:
        if wrong.label in labelled:
            should = f"is rather {wrong.should}" if wrong.should else "fits no marker"
            text = f"{wrong.label} {should} (probability {wrong.probability:.2f})"
            slot = labelled[wrong.label]
            out.append(_finding(sheet, "name", slot, wrong.first - sheet.first, wrong.last - sheet.first, text))
    return out, ""


def _finding(sheet: Sheet, kind: Any, slot: int, first: int, last: int, text: str) -> messages.Finding:
    return messages.Finding(kind=kind, slot=slot, first=first + sheet.first, last=last + sheet.first, text=text)


def _runs(flags: Array, join: int) -> list[tuple[int, int]]:
    """First and last row of runs, those less than ``join`` apart taken together."""
    rows = np.flatnonzero(flags)
    if len(rows) == 0:
        return []
    ends = np.flatnonzero(np.diff(rows) > join)
    return list(zip(rows[np.append(0, ends + 1)].tolist(), rows[np.append(ends, len(rows) - 1)].tolist(), strict=True))
