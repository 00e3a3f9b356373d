"""Identity switches, and which of them happened in a contact.

Two markers touch in a frame if they are nearer than 15 mm, or if they share a blob and one of them is held alone by
fewer than two cameras. A contact is five frames in a row and more in which they touch; it lasts, before and after, as
long as the two are within the tolerance, since nothing shows until then which trajectory follows which marker. A switch
is of a contact if it happened in it and its two trajectories were those of the two markers.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

if TYPE_CHECKING:
    from markerloom.evaluate import Truth

TOUCH_MM = 15.0
LEAST_FRAMES = 5
# The frames in which a marker was matched, in order, and to which track.
Matches = dict[str, list[tuple[int, int]]]
# Two markers' names in order, and the frames in which they are near; those in which they touch are marked.
_Near = dict[tuple[str, str], list[tuple[int, bool]]]


def switches(matches: Matches) -> list[tuple[str, tuple[int, int], tuple[int, int]]]:
    """Every switch: the marker, and its last match (frame, track) before and first one after."""
    return [(label, a, b) for label, of in matches.items() for a, b in pairwise(of) if a[1] != b[1]]


def switches_in_contact(matches: Matches, truth: Truth, tolerance_mm: float) -> int:
    """How many of the switches happened in a contact."""
    happened = switches(matches)
    partners: dict[str, list[tuple[str, int, int]]] = {}
    for (a, b), near in _near(truth, tolerance_mm, {label for label, _, _ in happened}).items():
        for start, stop in _contacts(near):
            partners.setdefault(a, []).append((b, start, stop))
            partners.setdefault(b, []).append((a, start, stop))
    tracks = {label: {track for _, track in of} for label, of in matches.items()}
    return sum(
        any(
            start <= after[0] and before[0] <= stop and tracks.get(other, set()) & {before[1], after[1]}
            for other, start, stop in partners.get(label, [])
        )
        for label, before, after in happened
    )


def _near(truth: Truth, tolerance_mm: float, wanted: set[str]) -> _Near:
    """Where the wanted markers are near others."""
    found: _Near = {}
    if not wanted:
        return found
    frame = truth.points.frame
    for start, stop in pairwise([*np.flatnonzero(np.r_[True, np.diff(frame) != 0]).tolist(), len(frame)]):
        labels = truth.points.label[start:stop].tolist()
        xyz_mm: NDArray[np.floating[Any]] = truth.points.xyz_mm[start:stop]
        own = [i for i, label in enumerate(labels) if label in wanted]
        apart_mm = cdist(xyz_mm[own], xyz_mm).reshape(len(own), len(labels))
        for row, j in np.argwhere(apart_mm <= max(tolerance_mm, TOUCH_MM)).tolist():
            i, at = own[row], int(frame[start])
            if i == j or (labels[j] in wanted and j < i):
                continue
            touch = bool(apart_mm[row, j] < TOUCH_MM) or _merged(truth, at, (start + i, start + j))
            found.setdefault((labels[i], labels[j]), []).append((at, touch))
    return found


def _merged(truth: Truth, frame: int, rows: tuple[int, int]) -> bool:
    """Whether two truth samples share a blob and one of them has not enough of its own."""
    if truth.dots is None or all(truth.required[row] for row in rows):
        return False
    mine, theirs = (truth.dots.get((frame, str(truth.points.label[row])), frozenset()) for row in rows)
    return bool(mine & theirs)


def _contacts(near: list[tuple[int, bool]]) -> list[tuple[int, int]]:
    """First frame and the one after the last, of each contact."""
    found, start, run, most = [], 0, 0, 0
    for i, (frame, touch) in enumerate(near):
        if i == 0 or near[i - 1][0] != frame - 1:
            start, run, most = frame, 0, 0
        run = run + 1 if touch else 0
        most = max(most, run)
        if (i + 1 == len(near) or near[i + 1][0] != frame + 1) and most >= LEAST_FRAMES:
            found.append((start, frame + 1))
    return found
