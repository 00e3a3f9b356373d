"""Motions: a skeleton and, for every frame, where its root is and how every joint is turned."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from markerloom.skeleton.skeleton import Skeleton

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Motion:
    """``root_m`` (frames, 3; m, world, Z up), ``turns`` (frames, joints, 3, 3): every joint against its parent, the
    root against the world.

    ``shifts_m`` (frames, joints, 3): offsets of the joints in each frame, for files whose bones move; ``None`` where
    bones are constant. ``sigma_mm`` (frames, joints): uncertainty of the joints' places, NaN where not known.
    ``kind`` (frames, joints): 0 where markers told the turn, 1 where it was inferred from frames around it.
    """

    skeleton: Skeleton
    root_m: Array
    turns: Array
    rate_hz: float
    first_frame: int = 0
    shifts_m: Array | None = None
    sigma_mm: Array = field(default_factory=lambda: np.zeros((0, 0)))
    kind: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 0), np.int64))
    source: str = ""

    def __post_init__(self) -> None:
        """Fill in what is not known."""
        shape = self.turns.shape[:2]
        if self.sigma_mm.shape != shape:
            object.__setattr__(self, "sigma_mm", np.full(shape, np.nan))
        if self.kind.shape != shape:
            object.__setattr__(self, "kind", np.zeros(shape, np.int64))

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.root_m)

    def segments(self) -> tuple[Array, Array]:
        """Every segment in the world: turns (frames, joints, 3, 3) and joints' places (frames, joints, 3; m)."""
        frames, joints = self.turns.shape[:2]
        turn, place = np.empty((frames, joints, 3, 3)), np.empty((frames, joints, 3))
        turn[:, 0], place[:, 0] = self.turns[:, 0], self.root_m
        for j in range(1, joints):
            p = self.skeleton.parents[j]
            offset = self.skeleton.offsets_m[j] if self.shifts_m is None else self.shifts_m[:, j]
            turn[:, j] = turn[:, p] @ self.turns[:, j]
            place[:, j] = place[:, p] + (turn[:, p] @ np.broadcast_to(offset, (frames, 3))[..., None])[..., 0]
        return turn, place

    def joints_m(self) -> Array:
        """Places of the joints (frames, joints, 3; m, world)."""
        return self.segments()[1]

    def sites_m(self) -> Array:
        """Places of the skeleton's sites (frames, sites, 3; m, world)."""
        turn, place = self.segments()
        sites = self.skeleton.sites
        joint = [s.joint for s in sites]
        local = np.array([s.place_m for s in sites]).reshape(-1, 3)
        return place[:, joint] + np.einsum("fsab,sb->fsa", turn[:, joint], local)

    def select(self, start: int | None, stop: int | None) -> Motion:
        """The frames from ``start`` to before ``stop``, by number."""
        low = 0 if start is None else max(start - self.first_frame, 0)
        high = len(self) if stop is None else max(min(stop - self.first_frame, len(self)), low)
        part = slice(low, high)
        return replace(
            self,
            root_m=self.root_m[part],
            turns=self.turns[part],
            first_frame=self.first_frame + low,
            shifts_m=None if self.shifts_m is None else self.shifts_m[part],
            sigma_mm=self.sigma_mm[part],
            kind=self.kind[part],
        )


def turned(motion: Motion, axes: Array) -> Motion:
    """The same motion in other axes of the world: ``axes`` (3, 3) takes old coordinates to new ones."""
    skeleton = motion.skeleton
    return replace(
        motion,
        skeleton=replace(
            skeleton,
            offsets_m=skeleton.offsets_m @ axes.T,
            sites=tuple(replace(s, place_m=tuple((axes @ np.array(s.place_m)).tolist())) for s in skeleton.sites),
        ),
        root_m=motion.root_m @ axes.T,
        turns=axes @ motion.turns @ axes.T,
        shifts_m=None if motion.shifts_m is None else motion.shifts_m @ axes.T,
    )


def with_rest(motion: Motion, rest: Array) -> Motion:
    """The same motion told against another rest pose: ``rest`` (joints, 3, 3) turns every segment of the present one
    into the new one, in the world. No joint of the motion moves.
    """
    skeleton = motion.skeleton
    parents = np.array(skeleton.parents)
    above = np.where(parents < 0, 0, parents)
    old_parent = np.where((parents < 0)[:, None, None], np.eye(3), rest[above])
    offsets = np.einsum("jab,jb->ja", old_parent, skeleton.offsets_m)
    turns = np.einsum("jab,fjbc,jdc->fjad", old_parent, motion.turns, rest)
    sites = tuple(replace(s, place_m=tuple((rest[s.joint] @ np.array(s.place_m)).tolist())) for s in skeleton.sites)
    shifts = None if motion.shifts_m is None else np.einsum("jab,fjb->fja", old_parent, motion.shifts_m)
    return replace(motion, skeleton=replace(skeleton, offsets_m=offsets, sites=sites), turns=turns, shifts_m=shifts)


def rest_of(skeleton: Skeleton, turns: dict[str, Array]) -> Array:
    """Turns of all segments in the world (joints, 3, 3) of a pose in which some joints are turned (rotation vectors,
    rad) and the others are at rest; for `with_rest`.
    """
    rest = np.empty((len(skeleton), 3, 3))
    for j, p in enumerate(skeleton.parents):
        own = turns.get(skeleton.joints[j])
        local = np.eye(3) if own is None else Rotation.from_rotvec(own).as_matrix()
        rest[j] = local if p < 0 else rest[p] @ local
    return rest


Z_UP_TO_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""(x, y, z) → (x, z, −y)."""


def turns_of(skeleton: Skeleton, poses: tuple[Array, Array, Array]) -> Array:
    """Turns as matrices (frames, joints, 3, 3) from the engine's poses: root, its rotation vector, turns of joints."""
    _, root, turns = poses
    out = np.empty((*turns.shape, 3))
    out[:, 0] = Rotation.from_rotvec(root).as_matrix()
    for j in range(1, len(skeleton)):
        out[:, j] = matrices(skeleton.turns_about[j], turns[:, j])
    return out


def matrices(order: str, turns: Array) -> Array:
    """Rotations (frames, 3, 3) of turns about X, Y and Z (frames, 3; rad) in an order, or of rotation vectors."""
    if not order:
        return Rotation.from_rotvec(turns).as_matrix()
    return Rotation.from_euler(order, turns[:, ["XYZ".index(a) for a in order]]).as_matrix()


def angles(order: str, rotations: Array) -> Array:
    """Turns about X, Y and Z (frames, 3; rad) of rotations, in an order; or rotation vectors."""
    if not order:
        return Rotation.from_matrix(rotations).as_rotvec()
    return euler(order, rotations)[:, [order.index(a) for a in "XYZ"]]


def euler(order: str, rotations: Array) -> Array:
    """Angles (frames, 3; rad) about moved axes in an order; where two axes coincide, the third angle is 0."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return Rotation.from_matrix(rotations).as_euler(order)


def quaternions(rotations: Array) -> Array:
    """Rotations as quaternions x y z w that do not change their sign from one frame to the next."""
    q = Rotation.from_matrix(rotations).as_quat()
    flips = np.cumprod(np.where((q[1:] * q[:-1]).sum(axis=1) < 0, -1.0, 1.0))
    q[1:] *= flips[:, None]
    return q
