"""Motions in C3D: segments' poses (group ROTATION) read as a source, and joints, angles and poses written.

The axes of a segment in the file are those of Visual3D and Theia: x to the person's right, y forward, z up along the
segment, the arms hanging. Here x is to the left and y to the back, so that the two differ by half a turn about z.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import FormatError
from markerloom.formats import c3d_file
from markerloom.points import Points
from markerloom.skeleton.isb import arms_hanging, joint_angles
from markerloom.skeleton.motion import Motion, with_rest
from markerloom.skeleton.mvnx import SegmentPoses
from markerloom.skeleton.placing import split_side
from markerloom.skeleton.skeleton import Skeleton, in_order

Array = NDArray[np.floating[Any]]
HALF_TURN = np.diag([-1.0, -1.0, 1.0])
ABOVE = {
    "thorax": ("pelvis",),
    "neck": ("thorax",),
    "head": ("neck", "thorax"),
    "clavicle": ("thorax",),
    "upper_arm": ("clavicle", "thorax"),
    "forearm": ("upper_arm",),
    "hand": ("forearm",),
    "thigh": ("pelvis",),
    "shank": ("thigh",),
    "foot": ("shank",),
    "toes": ("foot",),
}
"""What the body's parts hang from: the first of these that a file has."""
NAMED, NAMED_M = 0.5, 0.001
"""What names say counts where data say at most this much else: a part of how far origins stray, and noise (m)."""
STILL = 1e-6
"""A segment that never moves or turns by more than this (mm, or a part of one) is the laboratory, not a part of it."""


def read(path: str | Path) -> SegmentPoses:
    """The poses of a file's segments, and the skeleton that they make: joints at the segments' origins, bones as long
    as they are in the middle of all frames. A segment hangs from that in whose axes its origin strays least, parts of
    the body rather from what their names say.

    Raises ``FormatError`` where there is no segment that moves, or one is never seen together with another.
    """
    segments, rate = c3d_file.read_segments(path)
    if rate is None:
        raise FormatError(path, "has no frame rate")
    kept = [i for i in range(len(segments.labels)) if _moves(segments, i)]
    if not kept:
        raise FormatError(path, "no segment moves: there is nothing to solve")
    names = [segments.labels[i] for i in kept]
    place, turn = segments.place_mm[:, kept] / 1000.0, segments.turn[:, kept] @ HALF_TURN
    offsets, spread = _offsets(place, turn)
    parent_of = _parents(names, spread, path)
    order = in_order(names, parent_of, Path(path).name)
    parents = [-1 if parent_of[n] is None else order.index(str(parent_of[n])) for n in order]
    index = [names.index(n) for n in order]
    parts = {"_".join(filter(None, split_side(n))): j for j, n in enumerate(order)}
    skeleton = Skeleton(
        name=Path(path).stem,
        joints=tuple(order),
        parents=tuple(parents),
        offsets_m=np.array(
            [offsets[i, index[p]] if p >= 0 else np.zeros(3) for i, p in zip(index, parents, strict=True)]
        ),
        segments=parts,
    )
    return SegmentPoses(skeleton, place[:, index], turn[:, index], rate, source=str(path))


def _moves(segments: c3d_file.Segments, i: int) -> bool:
    seen = np.isfinite(segments.place_mm[:, i]).all(axis=1)
    if seen.sum() < 2:
        return bool(seen.any())
    ranges = np.ptp(segments.place_mm[seen, i], axis=0).max(), np.ptp(segments.turn[seen, i], axis=0).max()
    return max(ranges) > STILL


def _offsets(place: Array, turn: Array) -> tuple[Array, Array]:
    """Where each segment's origin is in the axes of each other one (segments, segments, 3; m; the middle of all
    frames), and how far from there it strays (rms, m; infinite where the two are never seen together).
    """
    count = place.shape[1]
    offsets, spread = np.zeros((count, count, 3)), np.full((count, count), np.inf)
    for p in range(count):
        local = np.einsum("fba,fnb->fna", turn[:, p], place - place[:, p : p + 1])
        both = np.isfinite(local).all(axis=2)
        for i in np.flatnonzero(both.any(axis=0)):
            own = local[both[:, i], i]
            offsets[i, p] = np.median(own, axis=0)
            spread[i, p] = np.sqrt(((own - offsets[i, p]) ** 2).sum(axis=1).mean())
    return offsets, spread


def _parents(names: list[str], spread: Array, path: str | Path) -> dict[str, str | None]:
    """What each segment hangs from: that in whose axes its origin strays least, the body's parts rather as their names
    say, and all from the pelvis rather than from another.
    """
    sides = [split_side(n) for n in names]
    cost = spread.copy()
    for i, (side, part) in enumerate(sides):
        above = (sides.index((s, p)) for p in ABOVE.get(part, ()) for s in (side, "") if (s, p) in sides)
        if (p := next(above, None)) is not None:
            cost[i, p] = NAMED * cost[i, p] - NAMED_M
    tried = [_hung(root, cost) for root in range(len(names))]
    total = np.array([strays for _, strays in tried])
    root = int(np.argmin(total))
    pelvis = sides.index(("", "pelvis")) if ("", "pelvis") in sides else root
    if NAMED * total[pelvis] - NAMED_M < total[root]:
        root = pelvis
    if not np.isfinite(total[root]):
        alone = names[int(np.argmin(np.isfinite(spread).sum(axis=1)))]
        raise FormatError(path, f"segment '{alone}' is never seen together with those that it could hang from")
    return {names[i]: None if p < 0 else names[p] for i, p in enumerate(tried[root][0])}


def _hung(root: int, cost: Array) -> tuple[list[int], float]:
    """All segments hung from one, always that which costs least next; their parents and the cost of all."""
    parents, total = [-1] * len(cost), 0.0
    there = np.arange(len(cost)) == root
    while not there.all():
        near = np.where(there[None, :] & ~there[:, None], cost, np.inf)
        i, p = (int(v) for v in np.unravel_index(int(np.argmin(near)), near.shape))
        if not np.isfinite(near[i, p]):
            return parents, np.inf
        parents[i], total = p, total + float(near[i, p])
        there[i] = True
    return parents, total


def write(motion: Motion, points: Points, path: str | Path) -> None:
    """Write points, Z up, with the joints' angles after ISB (POINT:ANGLES, deg) and the segments' poses (ROTATION)."""
    angles = c3d_file.Angles([], [], np.zeros((len(motion), 0, 3)), np.zeros((len(motion), 0), np.int64))
    named = joint_angles(motion)
    if named:
        joints = [motion.skeleton.joints.index(j) for j in named]
        angles = c3d_file.Angles(
            [f"{j}_angles" for j in named],
            [", ".join(name for name, _ in columns) for columns in named.values()],
            np.stack([np.stack([v for _, v in columns], axis=1) for columns in named.values()], axis=1),
            motion.kind[:, joints],
        )
    turn, place = with_rest(motion, arms_hanging(motion.skeleton)).segments()
    parts = {j: part for part, j in reversed(motion.skeleton.segments.items())}
    labels = [parts.get(i, joint) for i, joint in enumerate(motion.skeleton.joints)]
    segments = c3d_file.Segments(labels, 1000.0 * place, turn @ HALF_TURN)
    c3d_file.write(points, path, angles, segments)
