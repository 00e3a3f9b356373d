"""A subject from labelled frames: a static pose, a range-of-motion take, or any take with names."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom import _core
from markerloom.errors import InputError
from markerloom.points import Points
from markerloom.subjects.marker_set import MarkerSet
from markerloom.subjects.names import prefixes, split_prefix
from markerloom.subjects.subject import Height, Length, Subject
from markerloom.trajectories import Trajectories

POSE_S = 0.5
"""Frames within this time show the same pose (s)."""
NOISE_M = 0.001
"""Least spread of a distance (m): noise of the points of any system, and of skin."""


def create_subject(
    points: Points,
    *,
    marker_set: MarkerSet | None = None,
    name: str | None = None,
    prefix: str | None = None,
    frames: tuple[int | None, int | None] | None = None,
    units: str | None = None,
) -> Subject:
    """Learn a subject from the labelled frames of a take.

    The more the take moves, the better joints are told from rigid parts; from a static pose, segments of the
    ``marker_set`` tell, or nearness. ``prefix`` chooses among several subjects of one take. Raises ``InputError`` where
    there are no labels, where markers of the set are missing altogether, and where several subjects are there.
    """
    from markerloom.labelling.scale import scaled

    if frames is not None:
        points = points.select(*frames)
    take = Trajectories.of(scaled(points, units, None))
    known = () if marker_set is None else marker_set.markers
    named = [n for n in take.names if not n.startswith("*")]
    if not named:
        raise InputError(f"no marker of the take has a name: a subject is made from labelled frames ({points.source})")
    found = prefixes(named, known)
    if prefix is None:
        if len(found) > 1:
            whose = ", ".join(repr(p) for p in found)
            raise InputError(f"the take has the markers of {whose}: choose one with --prefix ({points.source})")
        prefix = found[0]
    own = {split_prefix(n, known)[1]: i for i, n in enumerate(take.names) if split_prefix(n, known)[0] == prefix}
    own.pop("", None)
    markers = [m for m in (known or own) if m in own and np.isfinite(take.xyz_mm[:, own[m]]).any()]
    if len(markers) < 3:
        extra = f" of '{marker_set.name}'" if marker_set is not None else ""
        raise InputError(f"only {len(markers)} markers{extra} are in the take, 3 are needed ({points.source})")
    xyz_m = take.xyz_mm[:, [own[m] for m in markers]] / 1000.0
    distances, heights, poses = learned(xyz_m, _said(marker_set, markers), points.rate_hz)
    return Subject(
        name=name or prefix or "subject",
        markers=tuple(markers),
        segments=_segments(marker_set, markers),
        distances=distances,
        heights=heights,
        poses=poses,
        marker_set="" if marker_set is None else marker_set.name,
    )


def learned(
    xyz_m: NDArray[np.floating[Any]], said: list[bool | None], rate_hz: float | None
) -> tuple[list[Length | None], list[list[Height]], float]:
    """Distances, heights, and the number of poses, from (frames, markers, 3)."""
    poses = poses_of(len(xyz_m), rate_hz)
    distances, heights = _core.learn_subject(np.ascontiguousarray(xyz_m), said, poses, NOISE_M)
    return distances, heights, poses


def poses_of(frames: int, rate_hz: float | None) -> float:
    """How many independent poses frames are worth."""
    return max(1.0, frames / (rate_hz or 100.0) / POSE_S)


def _said(marker_set: MarkerSet | None, markers: list[str]) -> list[bool | None]:
    if marker_set is None:
        return [None] * len(markers) ** 2
    every = np.array(marker_set.same_segment(), dtype=object).reshape(len(marker_set), len(marker_set))
    rows = [marker_set.markers.index(m) for m in markers]
    return every[np.ix_(rows, rows)].ravel().tolist()


def _segments(marker_set: MarkerSet | None, markers: list[str]) -> tuple[str, ...]:
    if marker_set is None:
        return ("",) * len(markers)
    return tuple(marker_set.segments[marker_set.markers.index(m)] for m in markers)
