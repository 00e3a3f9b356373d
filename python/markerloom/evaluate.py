"""Points against truth: what is found, what is missing, what is a ghost, and how honest the uncertainty is.

A truth sample is *required* if at least two cameras hold an observation of it alone and some pair of their rays meets
at 5° to 175°. Other samples are *optional*: matched within 40 mm (or the tolerance, if larger) they count neither as
hit nor as miss nor as ghost. Matching follows CLEAR-MOT (Bernardin & Stiefelhagen 2008): the last frame's match is
kept while within the tolerance, the rest is an optimal assignment. Points without identity over time are assigned
frame by frame. MOTA, MOTP and IDF1 are of required samples; coverage is the share of all truth samples for
which some row, measured or predicted, stands.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from markerloom.errors import InputError
from markerloom.observations import Observations, match
from markerloom.points import MEASURED, Points
from markerloom.reconstruct import statistics
from markerloom.rig import Rig
from markerloom.switches import Matches, switches, switches_in_contact

OPTIONAL_MM = 40.0
SAME_CENTROID_PX = 4.0
ANGLE_DEG = (5.0, 175.0)
CONFIDENCE_BINS = 10
Array = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Truth:
    """Positions of the markers, which of them a take must show, and the dots that are theirs."""

    points: Points
    required: NDArray[np.bool_]
    dots: dict[tuple[int, str], frozenset[tuple[str, int]]] | None = None


def truth_without_views(points: Points) -> Truth:
    """Every truth sample is required."""
    return Truth(points, np.ones(len(points), bool))


def truth_from_assignments(points: Points, table: pa.Table, rig: Rig | None) -> Truth:
    """Views from a table ``frame, camera, observation, label``; angles are checked where the rig is known."""
    holders: dict[tuple[int, str, int], list[str]] = {}
    columns = [table.column(n).to_pylist() for n in ("frame", "camera", "observation", "label")]
    for frame, camera, observation, label in zip(*columns, strict=True):
        holders.setdefault((frame, str(camera), observation), []).append(label)
    alone: dict[tuple[int, str], set[str]] = {}
    dots: dict[tuple[int, str], set[tuple[str, int]]] = {}
    for (frame, camera, observation), labels in holders.items():
        for label in labels:
            dots.setdefault((frame, label), set()).add((camera, observation))
            if len(labels) == 1:
                alone.setdefault((frame, label), set()).add(camera)
    required = np.zeros(len(points), bool)
    for row, (frame, label) in enumerate(zip(points.frame.tolist(), points.label.tolist(), strict=True)):
        required[row] = _enough_views(points.xyz_mm[row], alone.get((frame, label), set()), rig)
    return Truth(points, required, {key: frozenset(value) for key, value in dots.items()})


def truth_from_observations(points: Points, observations: Observations, rig: Rig) -> Truth:
    """Views by projection: a camera holds a marker if a centroid lies within 4 px of its projection only."""
    matched = match(observations, rig)
    seen: list[set[str]] = [set() for _ in range(len(points))]
    index_of = {int(f): i for i, f in enumerate(matched.frames)}
    starts = np.flatnonzero(np.r_[True, np.diff(points.frame) != 0]) if len(points) else np.zeros(0, np.int64)
    for start, stop in zip(starts, np.r_[starts[1:], len(points)], strict=True):
        frame = index_of.get(int(points.frame[start]))
        if frame is None:
            continue
        low, high = matched.starts[frame], matched.starts[frame + 1]
        camera, pixel = matched.camera[low:high], matched.pixel[low:high]
        for i, one in enumerate(rig.cameras):
            own = pixel[camera == i]
            if len(own) == 0:
                continue
            projected = rig.project(i, points.xyz_mm[start:stop] / 1000.0)
            near = cdist(np.nan_to_num(projected, nan=1e9), own) <= SAME_CENTROID_PX
            exclusive = near & (near.sum(axis=0) == 1)
            for row in np.flatnonzero(exclusive.any(axis=1)):
                seen[start + row].add(one.id)
    required = np.array([_enough_views(points.xyz_mm[r], seen[r], rig) for r in range(len(points))], bool)
    return Truth(points, required)


def _enough_views(xyz_mm: Array, cameras: set[str], rig: Rig | None) -> bool:
    if len(cameras) < 2:
        return False
    if rig is None:
        return True
    origins = np.array([c.position_m for c in rig.cameras if c.id in cameras or f"cam_{c.id}" in cameras])
    if len(origins) < 2:
        return False
    directions = xyz_mm / 1000.0 - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    angles = np.degrees(np.arccos(np.clip(directions @ directions.T, -1.0, 1.0)))
    return bool(np.any((angles >= ANGLE_DEG[0]) & (angles <= ANGLE_DEG[1])))


@dataclass
class _Tally:
    """What the frames add up to."""

    frames: int = 0
    required: int = 0
    hits: int = 0
    ghosts: int = 0
    exact_sets: int = 0
    errors: list[float] = field(default_factory=list)
    ratios: list[float] = field(default_factory=list)
    confidence: list[tuple[float, bool]] = field(default_factory=list)
    per_frame: list[tuple[int, int, int]] = field(default_factory=list)
    matches: Matches = field(default_factory=dict)
    overlap: dict[tuple[str, int], int] = field(default_factory=dict)
    scored_points: int = 0
    covered: int = 0
    samples: int = 0
    predicted_errors: list[float] = field(default_factory=list)
    predicted_unmatched: int = 0


def evaluate(
    points: Points,
    truth: Truth,
    *,
    tolerance_mm: float = 30.0,
    frames: tuple[int | None, int | None] | None = None,
    align: str | None = None,
    assignments: pa.Table | None = None,
) -> dict[str, Any]:
    """Compare points with truth; the keys are those of the report."""
    if not tolerance_mm > 0:
        raise InputError(f"the tolerance must be positive, not {tolerance_mm} mm")
    if frames is not None:
        low, high = frames
        in_range = _in_range(truth.points.frame, low, high)
        kept = replace(truth.points.keep(in_range), frames=truth.points.select(low, high).frames)
        truth, points = Truth(kept, truth.required[in_range], truth.dots), points.select(low, high)
    if len(truth.points) == 0:
        raise InputError(f"the truth has no sample in the evaluated frames ({truth.points.source})")
    if align not in (None, "rigid"):
        raise InputError(f"align '{align}': only 'rigid' is known")
    if align == "rigid":
        points = replace(points, xyz_mm=_aligned(points, truth.points, tolerance_mm))
    groups = _groups(assignments) if assignments is not None and truth.dots is not None else None
    tally = _Tally()
    last: dict[str, int] = {}
    for frame in np.union1d(truth.points.frames, np.unique(truth.points.frame)).tolist():
        last = _frame(tally, points, truth, frame, tolerance_mm, last, groups)
    return _result(tally, points, truth, tolerance_mm, groups is not None)


def _in_range(frame: NDArray[np.int64], low: int | None, high: int | None) -> NDArray[np.bool_]:
    return (frame >= (-(2**62) if low is None else low)) & (frame < (2**62 if high is None else high))


def _groups(table: pa.Table) -> dict[int, list[frozenset[tuple[str, int]]]]:
    """The chosen sets of dots of each frame."""
    found: dict[tuple[int, int], set[tuple[str, int]]] = {}
    columns = [table.column(n).to_pylist() for n in ("frame", "camera", "observation", "track")]
    for frame, camera, observation, track in zip(*columns, strict=True):
        found.setdefault((frame, track), set()).add((str(camera), observation))
    by_frame: dict[int, list[frozenset[tuple[str, int]]]] = {}
    for (frame, _), dots in found.items():
        by_frame.setdefault(frame, []).append(frozenset(dots))
    return by_frame


def _rows(frames: NDArray[np.int64], frame: int) -> slice:
    return slice(*np.searchsorted(frames, [frame, frame + 1]).tolist())


def _assign(distance: Array, tolerance: float) -> list[tuple[int, int]]:
    """The assignment with the most pairs within the tolerance, and among those the smallest total distance."""
    if distance.size == 0:
        return []
    far = 1e3 * tolerance
    cost = np.where(distance <= tolerance, distance, far)
    rows, columns = linear_sum_assignment(cost)
    return [(int(r), int(c)) for r, c in zip(rows, columns, strict=True) if distance[r, c] <= tolerance]


def _part(distance: Array, rows: list[int], columns: list[int]) -> Array:
    return distance[rows][:, columns]


def _frame(
    tally: _Tally,
    points: Points,
    truth: Truth,
    frame: int,
    tolerance: float,
    last: dict[str, int],
    groups: dict[int, list[frozenset[tuple[str, int]]]] | None,
) -> dict[str, int]:
    """Add one frame; returns which track each marker was matched to."""
    own, other = _rows(truth.points.frame, frame), _rows(points.frame, frame)
    kind = points.kind[other]
    measured: NDArray[np.int64] = np.flatnonzero(kind == MEASURED) + other.start
    labels = truth.points.label[own].tolist()
    required = truth.required[own]
    distance = cdist(truth.points.xyz_mm[own], points.xyz_mm[measured]).reshape(len(labels), len(measured))
    pairs = _kept_pairs(labels, points.track[measured], distance, tolerance, last) if points.tracked else []
    free_truth = [i for i in np.flatnonzero(required).tolist() if i not in {p[0] for p in pairs}]
    free_points = [j for j in range(len(measured)) if j not in {p[1] for p in pairs}]
    best = _assign(_part(distance, free_truth, free_points), tolerance)
    pairs += [(free_truth[i], free_points[j]) for i, j in best]
    used = {j for _, j in pairs}
    rest_truth = [i for i in range(len(labels)) if not required[i] and i not in {p[0] for p in pairs}]
    rest_points = [j for j in range(len(measured)) if j not in used]
    spare = _assign(_part(distance, rest_truth, rest_points), max(OPTIONAL_MM, tolerance))
    excused = {rest_points[j] for _, j in spare}
    hits = [(i, j) for i, j in pairs if required[i]]
    ghosts = [j for j in rest_points if j not in excused]
    tally.frames += 1
    tally.samples += len(labels)
    tally.required += int(required.sum())
    tally.hits += len(hits)
    tally.ghosts += len(ghosts)
    tally.per_frame.append((frame, len(ghosts), int(required.sum()) - len(hits)))
    for i, j in hits:
        row = measured[j]
        tally.errors.append(float(distance[i, j]))
        if points.sigma_mm[row] > 0:
            tally.ratios.append(float((distance[i, j] / points.sigma_mm[row]) ** 2))
        tally.confidence.append((float(points.confidence[row]), True))
    tally.confidence += [(float(points.confidence[measured[j]]), False) for j in ghosts]
    for i, j in pairs:
        tally.matches.setdefault(labels[i], []).append((frame, int(points.track[measured[j]])))
    tally.scored_points += len(measured) - len(excused) - sum(not required[i] for i, _ in pairs)
    if points.tracked:
        near = np.argwhere((distance <= tolerance) & required[:, None])
        for i, j in near.tolist():
            key = (labels[i], int(points.track[measured[j]]))
            tally.overlap[key] = tally.overlap.get(key, 0) + 1
    if groups is not None and truth.dots is not None:
        chosen = set(groups.get(frame, []))
        wanted = [truth.dots.get((frame, labels[i]), frozenset()) for i in np.flatnonzero(required)]
        tally.exact_sets += sum(dots in chosen for dots in wanted)
    carried = _predicted(tally, points, truth, own, other, {i for i, _ in pairs})
    tally.covered += len(pairs) + len(spare) + carried
    return {labels[i]: int(points.track[measured[j]]) for i, j in pairs}


def _kept_pairs(
    labels: list[str], tracks: NDArray[np.int64], distance: Array, tolerance: float, last: dict[str, int]
) -> list[tuple[int, int]]:
    place = {int(t): j for j, t in enumerate(tracks)}
    kept = []
    for i, label in enumerate(labels):
        j = place.get(last.get(label, -1))
        if j is not None and distance[i, j] <= tolerance:
            kept.append((i, j))
    return kept


def _predicted(tally: _Tally, points: Points, truth: Truth, own: slice, other: slice, matched: set[int]) -> int:
    """Rows that were not measured are judged on their own, against the markers no measured row stands for; how many are
    near one."""
    rows = np.flatnonzero(points.kind[other] != MEASURED) + other.start
    if len(rows) == 0:
        return 0
    rest = [i for i in range(own.stop - own.start) if i not in matched]
    distance = cdist(truth.points.xyz_mm[own][rest], points.xyz_mm[rows]).reshape(len(rest), len(rows))
    pairs = _assign(distance, 4 * OPTIONAL_MM)
    tally.predicted_errors += [float(distance[i, j]) for i, j in pairs]
    tally.predicted_unmatched += len(rows) - len(pairs)
    return len(pairs)


def _idf1(tally: _Tally) -> float:
    """Ristani et al. 2016, eq. 9–11: one identity per marker, chosen to explain the most; required samples only."""
    if not tally.overlap:
        return 0.0
    labels = sorted({label for label, _ in tally.overlap})
    tracks = sorted({track for _, track in tally.overlap})
    matrix = np.zeros((len(labels), len(tracks)))
    for (label, track), count in tally.overlap.items():
        matrix[labels.index(label), tracks.index(track)] = count
    rows, columns = linear_sum_assignment(-matrix)
    return float(2.0 * matrix[rows, columns].sum() / max(tally.required + tally.scored_points, 1))


def _aligned(points: Points, truth: Points, tolerance: float) -> Array:
    """Points moved rigidly onto the truth (Kabsch 1976 on matched pairs, three rounds, the worst tenth left out)."""
    xyz = points.xyz_mm
    for _ in range(3):
        mine, theirs = [], []
        for frame in np.unique(truth.frame).tolist():
            own, other = _rows(truth.frame, frame), _rows(points.frame, frame)
            pairs = _assign(cdist(truth.xyz_mm[own], xyz[other]), max(OPTIONAL_MM, tolerance))
            theirs += [truth.xyz_mm[own][i] for i, _ in pairs]
            mine += [xyz[other][j] for _, j in pairs]
        if len(mine) < 3:
            return xyz
        a, b = np.array(mine), np.array(theirs)
        distance = np.linalg.norm(a - b, axis=1)
        good = distance <= np.percentile(distance, 90)
        a, b = a[good], b[good]
        u, _, vt = np.linalg.svd((a - a.mean(0)).T @ (b - b.mean(0)))
        turn = vt.T @ np.diag([1, 1, np.linalg.det(vt.T @ u.T)]) @ u.T
        xyz = (xyz - a.mean(0)) @ turn.T + b.mean(0)
    return xyz


def expected_calibration_error(confidence: list[tuple[float, bool]]) -> float:
    """Mean over points of |mean confidence − share of real markers| in bins of equal width (Guo et al. 2017, eq. 3)."""
    known = np.array([(c, t) for c, t in confidence if np.isfinite(c)], float).reshape(-1, 2)
    if len(known) == 0:
        return float("nan")
    bins = np.minimum((known[:, 0] * CONFIDENCE_BINS).astype(int), CONFIDENCE_BINS - 1)
    total = 0.0
    for b in np.unique(bins):
        part = known[bins == b]
        total += len(part) * abs(part[:, 0].mean() - part[:, 1].mean())
    return float(total / len(known))


def _result(tally: _Tally, points: Points, truth: Truth, tolerance: float, has_sets: bool) -> dict[str, Any]:
    frames, required = max(tally.frames, 1), max(tally.required, 1)
    measured_tracks = np.unique(points.track[points.kind == MEASURED])
    result: dict[str, Any] = {
        "tolerance_mm": tolerance,
        "frames": tally.frames,
        "required_samples": tally.required,
        "ghosts_per_frame": tally.ghosts / frames,
        "missing_per_frame": (tally.required - tally.hits) / frames,
        "accuracy_3d": tally.hits / required,
        "error_mm": statistics(np.array(tally.errors)),
        "sigma_ratio": float(np.mean(tally.ratios)) if tally.ratios else float("nan"),
        "confidence_ece": expected_calibration_error(tally.confidence),
        "per_frame": [{"frame": f, "ghosts": g, "missing": m} for f, g, m in tally.per_frame],
    }
    if has_sets:
        result["accuracy_set"] = tally.exact_sets / required
    if points.tracked:
        fragments = [len({track for _, track in of}) for of in tally.matches.values()]
        result["trajectories"] = len(measured_tracks)
        result["fragments_per_marker"] = float(np.mean(fragments)) if fragments else 0.0
        result["id_switches"] = len(switches(tally.matches))
        result["id_switches_in_contact"] = switches_in_contact(tally.matches, truth, tolerance)
        errors = tally.required - tally.hits + tally.ghosts + result["id_switches"]
        result["mota"] = 1.0 - errors / required
        result["motp_mm"] = float(np.mean(tally.errors)) if tally.errors else float("nan")
        result["idf1"] = _idf1(tally)
        result["coverage"] = tally.covered / max(tally.samples, 1)
    if np.any(points.kind != MEASURED):
        result["predicted_error_mm"] = statistics(np.array(tally.predicted_errors))
        result["predicted_unmatched_per_frame"] = tally.predicted_unmatched / frames
    return result
