"""What an operation gives back: the new motion, and what it changed."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import InputError
from markerloom.skeleton.motion import Motion

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Edited:
    """A new motion; ``report``: what changed, in numbers, with ``warnings`` in words."""

    motion: Motion
    report: dict[str, Any] = field(default_factory=dict)


def at_frames(motion: Motion, at: Any) -> Motion:
    """The frames of a motion that an index or a slice names (from 0), as a motion of their own."""
    return replace(
        motion, root_m=motion.root_m[at], turns=motion.turns[at], kind=motion.kind[at], sigma_mm=motion.sigma_mm[at]
    )


def glued(parts: list[Motion]) -> Motion:
    """Motions of one skeleton, one after the other as they are."""
    return replace(
        parts[0],
        root_m=np.concatenate([p.root_m for p in parts]),
        turns=np.concatenate([p.turns for p in parts]),
        kind=np.concatenate([p.kind for p in parts]),
        sigma_mm=np.concatenate([p.sigma_mm for p in parts]),
        first_frame=0,
    )


def accelerations(motion: Motion) -> Array:
    """Size of every joint's acceleration (frames, joints; m/s², world), by second differences; 0 at both ends."""
    places = motion.joints_m()
    out = np.zeros(places.shape[:2])
    if len(places) > 2:
        out[1:-1] = np.linalg.norm(places[2:] - 2.0 * places[1:-1] + places[:-2], axis=2) * motion.rate_hz**2
    return out


STILL = 1e-3
"""Accelerations smaller than this are none (m/s²)."""
AROUND = 5
"""A joint may jump as it jumps within so many frames of the same moment in its source."""


def near_or_usual(acceleration: Array) -> Array:
    """The largest acceleration (frames, joints) within 5 frames, or its 99th percentile, if that is larger."""
    padded = np.pad(acceleration, ((AROUND, AROUND), (0, 0)), mode="edge")
    near = np.lib.stride_tricks.sliding_window_view(padded, 2 * AROUND + 1, axis=0).max(axis=2)
    return np.maximum(near, np.percentile(acceleration, 99, axis=0)) if len(acceleration) else acceleration


def bounds(sources: list[tuple[Motion, Array]], frames: int, joints: list[int] | None = None) -> Array:
    """How sharp joints may be (frames, joints; m/s²): the largest acceleration that a source has at a joint within 5
    frames of the moment that a frame comes from, or its 99th percentile, if that is larger.

    ``sources``: motions with, for every frame, the frame that it comes from (NaN: from none); ``joints``: of every
    joint the source's joint that it follows, where the skeletons differ.
    """
    sizes = [accelerations(source) if joints is None else accelerations(source)[:, joints] for source, _ in sources]
    # What comes from nowhere (a neutral pose) may be as sharp as the sources usually are.
    usual = [np.percentile(own, 99, axis=0) for own in sizes if own.size and own.max() > STILL]
    out = np.tile(np.maximum(np.min(usual, axis=0), STILL) if usual else STILL, (frames, 1))
    out = np.broadcast_to(out, (frames, sizes[0].shape[1])).copy()
    for (_, origin), own in zip(sources, sizes, strict=True):
        known = np.isfinite(origin)
        at = np.clip(np.round(origin[known]).astype(int), 0, len(own) - 1)
        out[known] = np.maximum(out[known], near_or_usual(own)[at])
    return out


def sharpness(motion: Motion, sources: list[tuple[Motion, Array]], joints: list[int] | None = None) -> Array:
    """How sharp every joint is beside its sources (frames, joints): its acceleration as a part of `bounds`."""
    return accelerations(motion) / bounds(sources, len(motion), joints)


def moved_mm(before: Motion, after: Motion) -> dict[str, float]:
    """How far joints are from where they were, over all frames (mm)."""
    off = 1000.0 * np.linalg.norm(after.joints_m() - before.joints_m(), axis=2)
    return {"rms": float(np.sqrt((off**2).mean())), "p99": float(np.percentile(off, 99)), "max": float(off.max())}


def same_skeleton(a: Motion, b: Motion, what: str) -> None:
    """Refuse clips that cannot be put together: other joints, other bones, other sizes."""
    one, two = a.skeleton, b.skeleton
    missing = [j for j in one.joints if j not in two.joints] + [j for j in two.joints if j not in one.joints]
    if missing or one.parents != two.parents:
        names = ", ".join(missing[:5]) or "the same joints hang from each other in another way"
        raise InputError(f"{what}: the skeletons differ ({names}); retarget one onto the other first")
    sizes = one.bone_lengths_m().sum(), two.bone_lengths_m().sum()
    if not 0.8 < sizes[0] / max(sizes[1], 1e-9) < 1.25:
        raise InputError(
            f"{what}: one figure is {sizes[0] / max(sizes[1], 1e-9):.3g} times as large as the other: "
            "say the units of the files, or retarget one onto the other first"
        )
    off = np.abs(one.offsets_m[1:] - two.offsets_m[1:]).max(initial=0.0)
    if off > 0.02 * sizes[0] / max(len(one), 1) + 1e-4:
        raise InputError(f"{what}: the bones differ by up to {1000 * off:.1f} mm; retarget one onto the other first")
    if not np.isclose(a.rate_hz, b.rate_hz, rtol=1e-4):
        raise InputError(
            f"{what}: {a.rate_hz:g} and {b.rate_hz:g} frames per second; resample one first (edit resample --rate-hz)"
        )


def with_constant_bones(motion: Motion) -> tuple[Motion, float]:
    """The same motion with bones of constant length, and by how much they changed in the file (mm, largest).

    Files with channels of place in every joint mostly repeat the skeleton's offsets. What moves above the hips, where a
    root of the scene stands still, becomes the root's own movement, so that the root is where the hips are; the other
    bones get the mean of their offsets.
    """
    if motion.shifts_m is None or not len(motion):
        return replace(motion, skeleton=replace(motion.skeleton, moving=()), shifts_m=None), 0.0
    skeleton = motion.skeleton
    mean = motion.shifts_m.mean(axis=0)
    mean[0] = skeleton.offsets_m[0]
    root_m, turn, top = motion.root_m.copy(), motion.turns[:, 0], 0
    while len(skeleton.children(top)) == 1:
        top = skeleton.children(top)[0]
        mean[top] = 0.0
        root_m += np.einsum("fab,fb->fa", turn, motion.shifts_m[:, top] - mean[top])
        turn = turn @ motion.turns[:, top]
    others = list(range(top + 1, len(skeleton)))
    off = np.abs(motion.shifts_m[:, others] - mean[others]).max(initial=0.0)
    still = replace(skeleton, offsets_m=mean, moving=())
    return replace(motion, skeleton=still, root_m=root_m, shifts_m=None), 1000.0 * float(off)
