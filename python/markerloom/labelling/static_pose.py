"""Names for somebody who stands still in a T-pose or A-pose, from a marker set's places on the body.

The set's body is turned to face either way, its arms lowered by several angles, scaled to the height of the points,
and bent onto them: the best assignment of markers to points pulls the body, first as a whole, then smoothly and more
and more locally (after the idea of coherent point drift, Myronenko & Song 2010). Which way it faced is decided by the
distances between markers, which bending does not change, and by how far markers were from the body before it bent.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from markerloom.errors import InputError
from markerloom.points import Points
from markerloom.subjects.create import learned
from markerloom.subjects.marker_set import MarkerSet
from markerloom.subjects.subject import Subject

Array = NDArray[np.floating[Any]]

WITHIN_S = 10.0
WINDOW_S = 0.3
"""The pose is looked for at the beginning of the take, in pieces of this length (s)."""
STILL_MM = 8.0
ARMS_DEG = (0.0, 20.0, 45.0, 70.0)
"""How far the arms may be lowered from the T-pose."""
BENDS = 24
FIRST_REACH, LAST_REACH = 0.25, 0.05
"""How far from its place a marker may be, and how far a pull reaches, as parts of the stature; first and last."""
GUESSED_M = 0.025
"""How well the set's body says where a marker is that was not seen (m)."""
FOUND = 0.7
"""Share of the markers that must be found for the set to fit."""
CLEARLY = 0.9
"""The other way of facing must fit worse than this part says."""


def name_static_pose(points: Points, marker_set: MarkerSet) -> tuple[Subject, list[tuple[int, int]]]:
    """The subject as it stands, and for rows of the take which marker they are.

    Raises ``InputError`` where nobody stands still, where the set has no places, where it does not fit, and where front
    and back cannot be told.
    """
    if not np.isfinite(marker_set.places).all():
        raise InputError(
            f"marker set '{marker_set.name}' has no places on the body: name a few frames by hand and make a subject"
            " from them (markerloom subject create)"
        )
    rows = _still(points, len(marker_set))
    tracks, own = np.unique(points.track[rows], return_inverse=True)
    standing_mm = np.array([np.median(points.xyz_mm[rows][own == i], axis=0) for i in range(len(tracks))])
    found, place_mm = _fit(standing_mm, marker_set, points.source)
    marker_of = {int(tracks[p]): m for m, p in found.items()}
    named = [(int(r), marker_of[int(points.track[r])]) for r in rows if int(points.track[r]) in marker_of]
    frames = np.unique(points.frame[rows])
    xyz_m = np.full((len(frames), len(marker_set), 3), np.nan)
    for row, marker in named:
        xyz_m[np.searchsorted(frames, points.frame[row]), marker] = points.xyz_mm[row] / 1000.0
    # A marker that is hidden here may be seen later: it is expected where the set's body has it.
    hidden = np.asarray(~np.isfinite(xyz_m).all(axis=2).any(axis=0))
    xyz_m[:, hidden] = place_mm[hidden] / 1000.0
    distances, heights, poses = learned(xyz_m, marker_set.same_segment(), points.rate_hz)
    n = len(marker_set)
    distances = [
        (d[0], max(d[1], GUESSED_M), d[2]) if d is not None and (hidden[i // n] or hidden[i % n]) else d
        for i, d in enumerate(distances)
    ]
    heights = [[] if hidden[m] else [h for h in own if not hidden[h[0]].any()] for m, own in enumerate(heights)]
    subject = Subject(
        "subject", marker_set.markers, marker_set.segments, distances, heights, poses, marker_set=marker_set.name
    )
    return subject, named


def _still(points: Points, markers: int) -> NDArray[np.int64]:
    """Rows of the piece near the beginning in which most points are there all the time and hardly move."""
    rate = points.rate_hz or 100.0
    length = max(2, round(WINDOW_S * rate))
    best: tuple[int, NDArray[np.int64]] = (0, np.zeros(0, np.int64))
    for first in range(0, min(len(points.frames), round(WITHIN_S * rate)) - length + 1, length):
        low, high = points.frames[first], points.frames[first + length - 1]
        rows = np.arange(*np.searchsorted(points.frame, [low, high + 1]))
        _, own, count = np.unique(points.track[rows], return_inverse=True, return_counts=True)
        steady = np.flatnonzero(count >= 0.8 * length)
        spread = np.array([np.ptp(points.xyz_mm[rows][own == i], axis=0).max() for i in steady])
        kept = steady[spread < STILL_MM] if len(steady) else steady
        # A little more is not worth looking later: the person is about to move.
        if len(kept) > best[0] + (2 if best[0] >= FOUND * markers else 0):
            best = (len(kept), rows[np.isin(own, kept)])
    if best[0] < FOUND * markers:
        raise InputError(
            f"nobody stands still in a T-pose in the first {WITHIN_S:g} s: at most {best[0]} of the set's {markers}"
            f" markers are there and at rest; give a subject instead, or --frames where the pose is ({points.source})"
        )
    return best[1]


def _fit(standing_mm: Array, marker_set: MarkerSet, source: str) -> tuple[dict[int, int], Array]:
    """Of each marker of the set its point, where it has one; and where the bent body has every marker (mm)."""
    tries = [
        (*_bent(standing_mm, marker_set, heading, arms), heading)
        for heading in _headings(standing_mm)
        for arms in ARMS_DEG
    ]
    tries.sort(key=lambda t: t[0])
    score, found, place, heading = tries[0]
    if len(found) < FOUND * len(marker_set):
        missing = [m for i, m in enumerate(marker_set.markers) if i not in found]
        raise InputError(
            f"marker set '{marker_set.name}' does not fit the pose: {len(found)} of {len(marker_set)} markers found;"
            f" nowhere: {', '.join(missing[:8])}{' …' if len(missing) > 8 else ''} ({source})"
        )
    other = next((t[0] for t in tries if t[3] != heading), np.inf)
    if score > CLEARLY * other:
        raise InputError(
            f"the pose does not tell front from back with marker set '{marker_set.name}': name a few frames by hand and"
            f" make a subject from them ({source})"
        )
    return found, place


def _headings(standing_mm: Array) -> tuple[float, float]:
    """The two ways a body may face whose sides are farthest apart (rad)."""
    flat = standing_mm[:, :2] - np.median(standing_mm[:, :2], axis=0)
    _, _, axes = np.linalg.svd(flat, full_matrices=False)
    across = float(np.arctan2(axes[0, 1], axes[0, 0]))
    return across - np.pi / 2, across + np.pi / 2


def _bent(
    standing_mm: Array, marker_set: MarkerSet, heading: float, arms_deg: float
) -> tuple[float, dict[int, int], Array]:
    """How badly the distances fit after bending the body onto the points, the markers that were found, and the body."""
    body = _posed(marker_set, arms_deg)
    low, high = np.percentile(standing_mm[:, 2], [2, 98])
    bottom, top = np.percentile(body[:, 2], [2, 98])
    stature = (high - low) / (top - bottom)
    turn = np.array([[np.cos(heading), -np.sin(heading), 0], [np.sin(heading), np.cos(heading), 0], [0, 0, 1]])
    place = stature * body @ turn.T
    place[:, :2] += np.median(standing_mm[:, :2], axis=0) - np.median(place[:, :2], axis=0)
    place[:, 2] += low - stature * bottom
    first = whole = place
    for step in range(BENDS):
        reach = stature * FIRST_REACH * (LAST_REACH / FIRST_REACH) ** (step / (BENDS - 1))
        markers, found = _assigned(place, standing_mm, reach)
        if len(markers) < 4:
            return np.inf, {}, place
        if step < BENDS // 3:
            whole = place = _as_a_whole(first, markers, standing_mm[found])
        else:
            near = np.exp(-0.5 * (cdist(place, place[markers]) / (1.5 * reach)) ** 2)
            pull = standing_mm[found] - place[markers]
            place = place + near @ pull / (near.sum(axis=1, keepdims=True) + 0.3)
    markers, found = _assigned(place, standing_mm, stature * LAST_REACH)
    if len(markers) < 4:
        return np.inf, {}, place
    expected = cdist(body[markers], body[markers]) * stature
    off = np.abs(cdist(standing_mm[found], standing_mm[found]) - expected) / (0.02 * stature + 0.1 * expected)
    # A flat body keeps its distances when it is turned about; what stands out of it, such as the face, does not.
    beside = np.linalg.norm(whole[markers] - standing_mm[found], axis=1) / (LAST_REACH * stature)
    missing = (len(marker_set) - len(markers)) / len(marker_set)
    score = float(np.minimum(off, 3.0)[~np.eye(len(markers), dtype=bool)].mean()) + 3.0 * missing
    score += float(np.minimum(beside, 3.0).mean())
    return score, dict(zip(markers.tolist(), found.tolist(), strict=True)), place


def _posed(marker_set: MarkerSet, arms_deg: float) -> Array:
    """The set's body with its arms lowered; forward, left, up."""
    body = marker_set.places.copy()
    for i, segment in enumerate(marker_set.segments):
        if any(part in segment for part in ("arm", "hand")):
            side = np.sign(body[i, 1])
            shoulder = np.array([0.0, side * 0.11, 0.815])
            angle = -side * np.deg2rad(arms_deg)
            c, s = np.cos(angle), np.sin(angle)
            body[i] = shoulder + np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ (body[i] - shoulder)
    return body


def _assigned(place: Array, points: Array, reach: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Markers and their points, one to one, none farther than ``reach``."""
    cost = np.minimum(cdist(place, points, "sqeuclidean"), reach**2)
    markers, found = linear_sum_assignment(cost)
    near = cost[markers, found] < reach**2
    return markers[near], found[near]


def _as_a_whole(body: Array, markers: NDArray[np.int64], points: Array) -> Array:
    """The body moved, turned about the vertical, and scaled (upwards by a factor of its own), as fits best."""
    middle, target = body[markers].mean(axis=0), points.mean(axis=0)
    here, there = body[markers] - middle, points - target
    flat, onto = here[:, 0] + 1j * here[:, 1], there[:, 0] + 1j * there[:, 1]
    turn = np.vdot(flat, onto) / max(np.vdot(flat, flat).real, 1e-12)
    moved = ((body[:, 0] - middle[0]) + 1j * (body[:, 1] - middle[1])) * turn
    scale = float(here[:, 2] @ there[:, 2] / max(here[:, 2] @ here[:, 2], 1e-12))
    return np.column_stack([moved.real, moved.imag, (body[:, 2] - middle[2]) * scale]) + target
