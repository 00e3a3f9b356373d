"""A take with its edits applied: the verb ``mend``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from markerloom.errors import InputError
from markerloom.mending.edits import EditList, read_edits
from markerloom.mending.operations import apply
from markerloom.mending.sheet import Sheet
from markerloom.points import Points


@dataclass(frozen=True)
class Mended(Points):
    """A take after edits. ``report``: how many were applied, and those that did not fit, with the reason."""

    report: dict[str, Any] = field(default_factory=dict)


def mend(points: Points, edits: EditList | str | Path) -> Mended:
    """Apply the edits of trajectories, in order; ``edits``: a list, or the file that holds it.

    An edit that does not fit the take is left out and reported, never guessed; exclusions of centroids and contacts
    are for reconstruction and `solve`, and have no effect here.
    """
    wanted = edits if isinstance(edits, EditList) else read_edits(edits)
    sheet = Sheet.of(points)
    unfit: list[dict[str, Any]] = []
    for number, edit in enumerate(wanted.of_points, start=1):
        try:
            apply(sheet, edit)
        except InputError as error:
            unfit.append({"edit": number, "op": edit.op, "reason": str(error)})
    mended = sheet.as_points(points)
    report = {
        "frames": len(points.frames),
        "warnings": [f"edit {u['edit']} ({u['op']}) does not fit the take: {u['reason']}" for u in unfit],
        "applied": len(wanted.of_points) - len(unfit),
        "unfit": unfit,
    }
    return Mended(**{n: getattr(mended, n) for n in Points.__dataclass_fields__}, report=report)
