"""Names for the markers of a take, from subjects or from a marker set and a T-pose."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom import _core
from markerloom.errors import InputError
from markerloom.labelling.scale import scaled
from markerloom.labelling.static_pose import GUESSED_M, name_static_pose
from markerloom.points import KINDS, Points
from markerloom.subjects.create import NOISE_M, poses_of
from markerloom.subjects.marker_set import MarkerSet
from markerloom.subjects.subject import Subject, model_of
from markerloom.track_points import track_points

Ints = NDArray[np.int64]
CARRIED = (KINDS.index("predicted"), KINDS.index("filled"))
SURE = 0.9
"""Names of at least this probability teach what a subject can do."""
FIRM = 1000.0
"""Evidence of a name that a static pose gave, in every one of its frames: more than anything else says."""
LESSONS = 3
"""Rounds of learning at most, where a subject is known from a static pose only."""
FEW_POSES = 20.0
"""A subject of fewer poses learns from the take itself."""
FITS = 0.3
"""Share of the samples expected of a subject below which it does not fit the take."""
AGREES = 0.5
"""Share of the rigid pairs that must have their distance, within ``NEAR_SD`` spreads, in ``LOOKED_AT`` frames."""
NEAR_SD = 4.0
LOOKED_AT = 60
MIRRORED = 0.5
WIDER = 2.0
"""Some rigid pairs spread more than most: by this factor."""
NORMAL_MEDIAN = 0.6745
"""Median of the absolute values of a standard normal variable."""


@dataclass(frozen=True)
class Labelled(Points):
    """A take with names. ``report``: what was named, and how surely."""

    report: dict[str, Any] = field(default_factory=dict)
    subjects: tuple[Subject, ...] = ()


def label(
    points: Points,
    *,
    subjects: list[Subject] | None = None,
    marker_set: MarkerSet | None = None,
    rate_hz: float | None = None,
    units: str | None = None,
    frames: tuple[int | None, int | None] | None = None,
) -> Labelled:
    """Name the markers of a take.

    With ``subjects``, from any moment on; with a ``marker_set`` alone, from a T-pose or A-pose near the start, from
    which the subject is learned. Names the input has are not looked at. Points without trajectories (as of
    ``reconstruct``) are tracked first. Phantoms and foreign markers stay without a name. Raises ``InputError`` where no
    subject fits, where the take is a mirror image, or where its units are in doubt.
    """
    clock = time.perf_counter()
    if (subjects is None) == (marker_set is None):
        raise InputError("naming needs either subjects or a marker set")
    if frames is not None:
        points = points.select(*frames)
    rate = points.rate_hz if rate_hz is None else rate_hz
    if rate is None or not 0 < rate < 1e6:
        raise InputError(f"naming needs the frame rate: state it with --rate-hz ({points.source})")
    points = scaled(points, units, max(s.size_m for s in subjects) if subjects else None)
    points = replace(points, rate_hz=rate)
    if not points.tracked:
        points = replace(track_points(points), tracked=True)
    if len(points) == 0:
        raise InputError(f"there are no points to name ({points.source})")
    believed: list[tuple[int, float] | None] = []
    if marker_set is not None:
        subject, rows = name_static_pose(points, marker_set)
        subjects = [subject]
        believed = [None] * len(points)
        for row, marker in rows:
            believed[row] = (marker, FIRM)
    assert subjects is not None
    marker, probability, mirrored, known = _named(points, subjects, believed)
    _check(points, subjects, known, marker, mirrored)
    named = _with_names(points, known, marker, probability)
    report = _report(named, known, marker, probability)
    report["timing"] = {"seconds": time.perf_counter() - clock}
    return replace(named, report=report)


def _named(
    points: Points, subjects: list[Subject], believed: list[tuple[int, float] | None]
) -> tuple[Ints, NDArray[np.floating[Any]], float, list[Subject]]:
    """Of each row its marker and the probability; and the subjects, after what the take taught of them.

    Samples that were carried or filled say nothing of who was seen: they get the name of the measured ones around them.
    """
    seen = ~np.isin(points.kind, CARRIED)
    if seen.any() and not seen.all():
        rows = np.flatnonzero(seen)
        taught = [believed[row] for row in rows.tolist()] if believed else []
        marker, probability, mirrored, known = _named(points.keep(seen), subjects, taught)
        return *_carried_names(points, rows, marker, probability), mirrored, known
    starts = np.searchsorted(points.frame, np.append(points.frames, points.frames[-1] + 1)).tolist()
    _, track = np.unique(points.track, return_inverse=True)
    known = subjects
    marker, probability, mirrored = np.zeros(0, np.int64), np.zeros(0), 0.0
    for lesson in range(LESSONS + 1):
        found = model_of(known).label_take(
            starts,
            np.ascontiguousarray(points.xyz_mm / 1000.0),
            track.tolist(),
            float(points.rate_hz or 100.0),
            believed,
        )
        marker, probability = np.array(found[0]), np.array(found[1])
        # What a take teaches would make a mirror image right: the first word counts.
        mirrored = found[2] if lesson == 0 else mirrored
        if lesson == LESSONS or all(s.poses >= FEW_POSES for s in subjects):
            break
        if lesson == 0 and believed:
            known = subjects = [_as_rigid_as_seen(points, subjects[0], marker)]
        else:
            known = _taught(points, subjects, marker, probability)
    return marker, probability, mirrored, known


def _carried_names(
    points: Points, rows: Ints, marker: Ints, probability: NDArray[np.floating[Any]]
) -> tuple[Ints, NDArray[np.floating[Any]]]:
    """Names of all rows, from those of the measured ``rows``.

    A carried sample has one where the measured ones before and after it on its trajectory agree, and nobody else is
    that marker in its frame.
    """
    whole, sure = np.full(len(points), -1), np.zeros(len(points))
    whole[rows], sure[rows] = marker, probability
    order = np.lexsort((points.frame, points.track))
    measured = np.isin(order, rows)
    place = np.arange(len(order))
    before = np.maximum.accumulate(np.where(measured, place, -1))
    after = np.minimum.accumulate(np.where(measured, place, len(order))[::-1])[::-1]
    track = points.track[order]
    around = np.stack([np.maximum(before, 0), np.minimum(after, len(order) - 1)])
    is_own = (track[around] == track) & np.stack([before >= 0, after < len(order)])
    name, chance = whole[order[around]], sure[order[around]]
    # Where there is nothing on one side, the other alone counts.
    name, chance = np.where(is_own, name, name[::-1]), np.where(is_own, chance, chance[::-1])
    agreed = ~measured & is_own.any(axis=0) & (name[0] == name[1])
    carried = order[agreed]
    whole[carried], sure[carried] = name[0][agreed], chance.min(axis=0)[agreed]
    carried = carried[np.lexsort((carried, -sure[carried]))]
    key = points.frame * (whole.max(initial=0) + 1) + whole
    _, first = np.unique(key[carried], return_index=True)
    twice = np.isin(key[carried], key[rows][marker >= 0])
    twice[np.setdiff1d(np.arange(len(carried)), first)] = True
    whole[carried[twice]], sure[carried[twice]] = -1, 0.0
    return whole, sure


def _as_rigid_as_seen(points: Points, subject: Subject, marker: Ints) -> Subject:
    """A subject from a static pose whose rigid pairs spread as little as they do in the take, by most of them.

    A pose tells how long they are, but not how much skin moves; wrong names of a few change nothing in the median.
    """
    pairs, mean, sd = rigid_pairs(subject)
    exact = sd < GUESSED_M
    off = _off_their_length(points, subject, marker, pairs[exact], mean[exact]) / sd[exact]
    if not np.isfinite(off).any():
        return subject
    scale = min(1.0, WIDER * float(np.nanmedian(off)) / NORMAL_MEDIAN)
    n = len(subject)
    distances = list(subject.distances)
    for (i, j), m, s in zip(pairs[exact].tolist(), mean[exact].tolist(), sd[exact].tolist(), strict=True):
        distances[i * n + j] = distances[j * n + i] = (m, max(scale * s, NOISE_M), 1.0)
    return replace(subject, distances=distances)


def rigid_pairs(subject: Subject) -> tuple[Ints, NDArray[np.floating[Any]], NDArray[np.floating[Any]]]:
    """Pairs of markers that keep their distance (pairs, 2), its mean and its spread (m)."""
    n = len(subject)
    rigid = [
        (i // n, i % n, d[0], d[1])
        for i, d in enumerate(subject.distances)
        if d is not None and d[2] >= 1.0 and i // n < i % n
    ]
    table = np.array(rigid, float).reshape(-1, 4)
    return table[:, :2].astype(np.int64), table[:, 2], table[:, 3]


def _off_their_length(
    points: Points, subject: Subject, marker: Ints, pairs: Ints, mean_m: NDArray[np.floating[Any]]
) -> NDArray[np.floating[Any]]:
    """How far pairs are off their length (m) in some frames of the take (frames, pairs), NaN where one is missing."""
    n = len(subject)
    frames = points.frames[:: max(1, len(points.frames) // LOOKED_AT)]
    off = np.full((len(frames), len(pairs)), np.nan)
    for k, frame in enumerate(frames):
        rows = np.arange(*np.searchsorted(points.frame, [frame, frame + 1]))
        rows = rows[(marker[rows] >= 0) & (marker[rows] < n)]
        place = np.full((n, 3), np.nan)
        place[marker[rows]] = points.xyz_mm[rows] / 1000.0
        off[k] = np.abs(np.linalg.norm(place[pairs[:, 0]] - place[pairs[:, 1]], axis=1) - mean_m)
    return off


def _taught(
    points: Points, subjects: list[Subject], marker: Ints, probability: NDArray[np.floating[Any]]
) -> list[Subject]:
    """Subjects with what the take shows of them."""
    place = np.full((len(points.frames), sum(len(s) for s in subjects), 3), np.nan)
    sure = (marker >= 0) & (probability >= SURE)
    place[np.searchsorted(points.frames, points.frame[sure]), marker[sure]] = points.xyz_mm[sure] / 1000.0
    poses = poses_of(len(place), points.rate_hz)
    taught, first = [], 0
    for subject in subjects:
        own = np.ascontiguousarray(place[:, first : first + len(subject)])
        first += len(subject)
        distances, heights = _core.learn_more((subject.distances, subject.heights), subject.poses, own, poses, NOISE_M)
        taught.append(replace(subject, distances=distances, heights=heights, poses=subject.poses + poses))
    return taught


def _check(points: Points, given: list[Subject], subjects: list[Subject], marker: Ints, mirrored: float) -> None:
    """Refuse mirror images and subjects that do not fit; ``given`` as they were before the take taught of them."""
    first = 0
    for before, subject in zip(given, subjects, strict=True):
        agreement = _agreement(points, before, marker - first)
        own = (marker >= first) & (marker < first + len(subject))
        counts = np.bincount(marker[own] - first, minlength=len(subject))
        first += len(subject)
        share = own.sum() / (len(points.frames) * len(subject))
        expected = min(1.0, len(points) / (len(points.frames) * sum(len(s) for s in subjects)))
        if share < FITS * expected or agreement < AGREES:
            nowhere = [m for m, c in zip(subject.markers, counts, strict=True) if c < 0.1 * len(points.frames)]
            raise InputError(
                f"subject '{subject.name}' does not fit the take: {100 * share:.0f} % of its markers found; nowhere:"
                f" {', '.join(nowhere[:8])}{' …' if len(nowhere) > 8 else ''}. Another person, another marker set, or"
                f" another size? ({points.source})"
            )
    if mirrored > MIRRORED:
        raise InputError(
            f"the take is a mirror image of its subject: {100 * mirrored:.0f} % of the markers are on the wrong side of"
            f" their neighbours; check the axes of the export, or whether left and right are exchanged in the subject"
            f" ({points.source})"
        )


def _agreement(points: Points, subject: Subject, marker: Ints) -> float:
    """Share of the rigid pairs of a subject, among all named ones in some frames, that have their distance."""
    pairs, mean, sd = rigid_pairs(subject)
    off = _off_their_length(points, subject, marker, pairs, mean) / sd
    seen = np.isfinite(off)
    return float(np.mean(off[seen] < NEAR_SD)) if seen.any() else 1.0


def _with_names(
    points: Points, subjects: list[Subject], marker: Ints, probability: NDArray[np.floating[Any]]
) -> Labelled:
    """The take with one trajectory per name; the others keep their own numbers, after those."""
    several = len(subjects) > 1
    names = [f"{s.name}:{m}" if several else m for s in subjects for m in s.markers]
    _, own = np.unique(points.track, return_inverse=True)
    named = marker >= 0
    track = np.where(named, marker, len(names) + own)
    text = np.where(named, np.array(names, dtype=str)[np.maximum(marker, 0)], "")
    order = np.lexsort((track, points.frame))
    columns = {f: getattr(points, f)[order] for f in ("frame", "xyz_mm", "sigma_mm", "rays", "residual_px", "kind")}
    columns |= {f: getattr(points, f)[order] for f in ("confidence", "residual_mm", "camera_mask")}
    return Labelled(
        **columns,
        track=track[order].astype(np.int64),
        label=text[order],
        label_probability=np.asarray(probability)[order],
        rate_hz=points.rate_hz,
        frames=points.frames,
        up_axis=points.up_axis,
        source=points.source,
        subjects=tuple(subjects),
    )


def _report(
    named: Points, subjects: list[Subject], marker: Ints, probability: NDArray[np.floating[Any]]
) -> dict[str, Any]:
    frames = max(len(named.frames), 1)
    names = [m for s in subjects for m in s.markers]
    found = marker >= 0
    counts = np.bincount(marker[found], minlength=len(names))
    sure = np.bincount(marker[found], weights=probability[found], minlength=len(names))
    nowhere = [n for n, c in zip(names, counts, strict=True) if c == 0]
    warnings = [f"marker '{n}' was found nowhere" for n in nowhere]
    gone = [int(f) for f in np.setdiff1d(named.frames, named.frame[named.label != ""])]
    if gone:
        warnings.append(f"{len(gone)} frames have no named marker at all, the first is {gone[0]}")
    return {
        "frames": len(named.frames),
        "warnings": warnings,
        "named": float(found.mean()) if len(found) else 0.0,
        "completeness": float(found.sum() / (frames * len(names))),
        "labels": {
            name: {"frames": int(c), "probability": round(float(s / c), 4) if c else 0.0}
            for name, c, s in zip(names, counts, sure, strict=True)
        },
        "unlabelled_per_frame": float((~found).sum() / frames),
    }
