"""Whether the names of a labelled take are right: swaps and wrong labels found, and mended.

Every trajectory is cut where it jumps to where another was, and at its gaps; the pieces are named anew (`takes.py`),
the names they have counting a little. Without a subject, one is learned from the take itself, after exchanges that show
as a jump of two markers to each other's places are undone in favour of the names that hold longer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import InputError
from markerloom.labelling.scale import scaled
from markerloom.points import Points
from markerloom.subjects.create import create_subject
from markerloom.subjects.names import split_prefix
from markerloom.subjects.subject import Subject, model_of
from markerloom.trajectories import Trajectories

Ints = NDArray[np.int64]

KEPT = 2.0
"""Evidence for the name that a sample has already."""
SURE = 0.95
"""Probability from which another name, or none, is believed."""
JUMP_MM = 15.0
"""Least jump that may be an exchange; jumps of that size within a frame are rare in motion that is not noise."""
NEARER = 0.5
"""A jump is an exchange when the other's former place is nearer than this part of the jump."""
LONGEST_S = 0.1
"""An exchange is told by continuity across gaps of at most this length (s)."""


@dataclass(frozen=True)
class Wrong:
    """A name that is wrong over frames ``first`` to ``last``; ``should`` is empty where no name is right."""

    first: int
    last: int
    label: str
    should: str
    probability: float


@dataclass(frozen=True)
class Checked:
    """What was found, and of each row of the take the name it should have."""

    wrong: list[Wrong]
    label: NDArray[np.str_]
    report: dict[str, Any]


def check_labels(points: Points, *, subject: Subject | None = None, units: str | None = None) -> Checked:
    """Find wrong names of a labelled take; ``subject`` is learned from the take where none is given.

    Raises ``InputError`` where nothing is labelled or the subject's markers are not those of the take.
    """
    points = scaled(points, units, None if subject is None else subject.size_m)
    if points.rate_hz is None:
        raise InputError(f"checking names needs the frame rate: state it with --rate-hz ({points.source})")
    take = Trajectories.of(points)
    if all(name.startswith("*") for name in take.names):
        raise InputError(f"no marker of the take has a name: there is nothing to check ({points.source})")
    if subject is not None:
        return _checked(points, take, subject)
    found = _checked(points, take, create_subject(_exchanges_undone(take, points.rate_hz).as_points()))
    if found.wrong:
        # What was learned from wrong names was not quite right itself.
        found = _checked(points, take, create_subject(repair_labels(points, found)))
    return found


def _checked(points: Points, take: Trajectories, subject: Subject) -> Checked:
    """The names a take has beside those that it should have by what is known of a subject."""
    rate_hz = points.rate_hz or 100.0
    own = {split_prefix(name, subject.markers)[1]: name for name in take.names}
    index = {name: subject.markers.index(m) for m, name in own.items() if m in subject.markers}
    if len(index) < 3:
        raise InputError(f"the take has {len(index)} of the markers of subject '{subject.name}' ({points.source})")
    marker = np.array([index.get(str(name), -1) for name in points.label])
    piece = _pieces(take, rate_hz)[points.frame - take.frames[0], np.searchsorted(take.tracks, points.track)]
    _, track = np.unique(piece, return_inverse=True)
    starts = np.searchsorted(points.frame, np.append(points.frames, points.frames[-1] + 1)).tolist()
    xyz_m = np.ascontiguousarray(points.xyz_mm / 1000.0)
    believed = [(int(m), KEPT) if m >= 0 else None for m in marker]
    found, probability, _ = model_of([subject]).label_take(starts, xyz_m, track.tolist(), rate_hz, believed)
    should, sure = np.array(found), np.array(probability) >= SURE
    should = np.where((marker >= 0) & ~sure, marker, should)
    names = np.array([own.get(m, m) for m in subject.markers] + [""], dtype=str)
    label = np.where((marker >= 0) | (should >= 0), names[should], points.label)
    wrong = _ranges(points, label, np.array(probability))
    share = float(np.mean(label != points.label)) if len(points) else 0.0
    report = {
        "frames": len(points.frames),
        "warnings": [],
        "wrong_share": share,
        "wrong": [vars(w) for w in wrong],
        "subject": subject.name,
    }
    return Checked(wrong, label, report)


def repair_labels(points: Points, checked: Checked) -> Points:
    """The take with the names it should have, one trajectory per name; positions, kinds and sigmas are not touched."""
    names = [n for n in dict.fromkeys([*points.slots()[0], *checked.label.tolist()]) if n and not n.startswith("*")]
    number = {name: i for i, name in enumerate(names)}
    _, own = np.unique(points.track, return_inverse=True)
    track = np.array([number.get(str(n), -1) for n in checked.label])
    track = np.where(track >= 0, track, len(names) + own)
    order = np.lexsort((track, points.frame))
    return replace(points, track=track.astype(np.int64), label=checked.label).keep(order)


def _steps(take: Trajectories, rate_hz: float) -> list[tuple[int, int, Ints]]:
    """Successive samples of every trajectory, over short gaps only: (before, after, trajectories)."""
    longest = max(1, round(LONGEST_S * rate_hz))
    found = []
    present = take.present
    last = np.full(len(take.names), -1)
    for frame in range(len(take.frames)):
        here = np.flatnonzero(present[frame])
        for before in np.unique(last[here][last[here] >= 0]):
            if frame - before <= longest:
                found.append((int(before), frame, here[last[here] == before]))
        last[here] = frame
    return found


def _exchanges(take: Trajectories, rate_hz: float) -> list[tuple[int, int, int]]:
    """Where a trajectory jumps to where another was: (frame, trajectory, other)."""
    found = []
    for before, after, slots in _steps(take, rate_hz):
        expected = take.xyz_mm[before]
        if before > 0:
            # Where everybody would be who goes on as before: fast neighbours cross each other's former places.
            going_on = expected + (after - before) * (expected - take.xyz_mm[before - 1])
            known = np.isfinite(going_on)
            known[[slot for frame, slot, _ in found[-len(take.names) :] if frame == before]] = False
            expected = np.where(known, going_on, expected)
        jump = np.linalg.norm(take.xyz_mm[after, slots] - expected[slots], axis=1)
        for slot, length in zip(slots[jump > JUMP_MM], jump[jump > JUMP_MM], strict=True):
            away = np.linalg.norm(expected - take.xyz_mm[after, slot], axis=1)
            away[slot] = np.inf
            away = np.where(np.isfinite(away), away, np.inf)
            other = int(np.argmin(away))
            if away[other] < NEARER * length:
                found.append((after, int(slot), other))
    return found


def _pieces(take: Trajectories, rate_hz: float) -> Ints:
    """A number for every sample: the piece of a trajectory to which it belongs."""
    new = take.present.copy()
    new[1:] &= ~take.present[:-1]
    for frame, slot, _ in _exchanges(take, rate_hz):
        new[frame, slot] = True
    return np.cumsum(new, axis=0) + (len(take.frames) + 1) * np.arange(len(take.names))


def _exchanges_undone(take: Trajectories, rate_hz: float) -> Trajectories:
    """The take in which pairs that jump to each other's places have the names that hold longer."""
    toggles: dict[tuple[int, int], list[int]] = {}
    events = {(frame, slot, other) for frame, slot, other in _exchanges(take, rate_hz)}
    for frame, slot, other in sorted(events):
        if slot < other and (frame, other, slot) in events:
            toggles.setdefault((slot, other), []).append(frame)
    xyz_mm = take.xyz_mm.copy()
    for (a, b), frames in sorted(toggles.items()):
        bounds = [0, *frames, len(take.frames)]
        exchanged = np.zeros(len(take.frames), bool)
        for i in range(1, len(bounds) - 1, 2):
            exchanged[bounds[i] : bounds[i + 1]] = True
        if exchanged.mean() > 0.5:
            exchanged = ~exchanged
        xyz_mm[exchanged, a], xyz_mm[exchanged, b] = take.xyz_mm[exchanged, b], take.xyz_mm[exchanged, a]
    kind = np.where(np.isfinite(xyz_mm).all(axis=2), 0, -1)
    return take.changed(xyz_mm, take.sigma_mm, kind)


def _ranges(points: Points, label: NDArray[np.str_], probability: NDArray[np.floating[Any]]) -> list[Wrong]:
    """Runs of frames over which a trajectory has the same wrong name."""
    rows = np.flatnonzero(label != points.label)
    rows = rows[np.lexsort((points.frame[rows], points.track[rows]))]
    found: list[Wrong] = []
    start = 0
    for end in range(1, len(rows) + 1):
        goes_on = (
            end < len(rows)
            and points.track[rows[end]] == points.track[rows[start]]
            and label[rows[end]] == label[rows[start]]
            and points.frame[rows[end]] <= points.frame[rows[end - 1]] + 1
        )
        if not goes_on:
            run = rows[start:end]
            first, last = int(points.frame[run[0]]), int(points.frame[run[-1]])
            certainty = round(float(np.mean(probability[run])), 4)
            found.append(Wrong(first, last, str(points.label[run[0]]), str(label[run[0]]), certainty))
            start = end
    return sorted(found, key=lambda w: (w.first, w.label))
