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
from markerloom.labelling.static_pose import name_static_pose
from markerloom.points import Points
from markerloom.subjects.create import NOISE_M, poses_of
from markerloom.subjects.marker_set import MarkerSet
from markerloom.subjects.subject import Subject, model_of
from markerloom.track_points import track_points

Ints = NDArray[np.int64]
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
    """Of each row its marker and the probability; and the subjects, after what the take taught of them."""
    starts = np.searchsorted(points.frame, np.append(points.frames, points.frames[-1] + 1)).tolist()
    tracks, track = np.unique(points.track, return_inverse=True)
    known = subjects
    marker, probability, mirrored = np.zeros(0, np.int64), np.zeros(0), 0.0
    for lesson in range(LESSONS + 1):
        found = model_of(known).label_take(
            starts,
            np.ascontiguousarray(points.xyz_mm / 1000.0),
            track.tolist(),
            len(tracks),
            float(points.rate_hz or 100.0),
            believed,
        )
        marker, probability = np.array(found[0]), np.array(found[1])
        # What a take teaches would make a mirror image right: the first word counts.
        mirrored = found[2] if lesson == 0 else mirrored
        if lesson == LESSONS or all(s.poses >= FEW_POSES for s in subjects):
            break
        known = _taught(points, subjects, marker, probability)
    return marker, probability, mirrored, known


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
    n = len(subject)
    rigid = [
        (i // n, i % n) for i, d in enumerate(subject.distances) if d is not None and d[2] >= 1.0 and i // n < i % n
    ]
    if not rigid:
        return 1.0
    a, b = np.array(rigid).T
    mean, sd = np.array([subject.distances[i * n + j][:2] for i, j in rigid]).T  # pyright: ignore[reportOptionalSubscript]
    fits = total = 0
    for frame in points.frames[:: max(1, len(points.frames) // LOOKED_AT)]:
        rows = np.arange(*np.searchsorted(points.frame, [frame, frame + 1]))
        rows = rows[(marker[rows] >= 0) & (marker[rows] < n)]
        place = np.full((n, 3), np.nan)
        place[marker[rows]] = points.xyz_mm[rows] / 1000.0
        off = np.abs(np.linalg.norm(place[a] - place[b], axis=1) - mean) / sd
        seen = np.isfinite(off)
        fits, total = fits + int(np.sum(off[seen] < NEAR_SD)), total + int(seen.sum())
    return fits / total if total else 1.0


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
