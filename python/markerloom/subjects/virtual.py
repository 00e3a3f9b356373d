"""Virtual markers: points that follow from markers of a set, such as the middle between two."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from markerloom.errors import InputError
from markerloom.points import KINDS, Points
from markerloom.subjects.marker_set import MarkerSet
from markerloom.subjects.names import prefixes, split_prefix
from markerloom.trajectories import Trajectories

ORDER = [KINDS.index(kind) for kind in ("measured", "edited", "filled", "predicted")]
"""A virtual marker is of the last of these kinds that its markers are of."""


def with_virtual_markers(points: Points, marker_set: MarkerSet) -> Points:
    """The take with the virtual markers of its set, of each subject, in the frames that have all their markers.

    Their ``sigma_mm`` is that of a mean of independent samples. Those that the take has already are computed anew.
    Raises ``InputError`` where the set has no virtual markers, or the take none of the markers that they need.
    """
    if not marker_set.virtual:
        raise InputError(f"marker set '{marker_set.name}' has no virtual markers")
    known = (*marker_set.markers, *marker_set.virtual)
    is_old = np.array([split_prefix(n, known)[1] in marker_set.virtual for n in points.label.tolist()], bool)
    points = points.keep(~is_old)
    take = Trajectories.of(points)
    found = [_one(take, f"{prefix}:{name}" if prefix else name, places)
             for prefix in prefixes([n for n in take.names if not n.startswith("*")], known)
             for name, of in marker_set.virtual.items()
             if (places := _columns(take, prefix, of, known))]  # fmt: skip
    if not found:
        needed = sorted({m for of in marker_set.virtual.values() for m in of})
        raise InputError(f"the take has not the markers of any virtual one ({', '.join(needed[:8])}; {points.source})")
    for one in found:
        points = points.joined(one)
    return points


def _columns(take: Trajectories, prefix: str, of: tuple[str, ...], known: tuple[str, ...]) -> list[int]:
    """The trajectories of a subject's markers; none where one of them is missing altogether."""
    own = {split_prefix(n, known)[1]: i for i, n in enumerate(take.names) if split_prefix(n, known)[0] == prefix}
    return [own[m] for m in of] if all(m in own for m in of) else []


def _one(take: Trajectories, name: str, columns: list[int]) -> Points:
    there = np.flatnonzero(take.present[:, columns].all(axis=1))
    worst = np.array([ORDER.index(kind) for kind in range(len(KINDS))])[take.kind[there][:, columns]].max(axis=1)
    made = Points.of(
        take.frames[there],
        np.zeros(len(there), np.int64),
        take.xyz_mm[there][:, columns].mean(axis=1),
        label=np.full(len(there), name),
        sigma_mm=np.sqrt((take.sigma_mm[there][:, columns] ** 2).sum(axis=1)) / len(columns),
        kind=np.array(ORDER)[worst] if len(there) else np.zeros(0, np.int64),
        frames=take.frames,
    )
    return replace(made, rate_hz=take.points.rate_hz)
