"""Motions of the same kind blended with weights, aligned in time and space: a walk between two walks.

Registration curves (Kovar & Gleicher 2003, "Flexible automatic motion blending with registration curves"): moments of
all clips that correspond are found by dynamic time warping over the distance of clouds; blended are turns, heights,
and the speeds over the floor and about the vertical in each clip's own heading, so that nothing skates.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from markerloom.errors import InputError
from markerloom.motion.alike import distances
from markerloom.motion.blend import Joined, begun, finished
from markerloom.motion.body import body_of
from markerloom.motion.edited import Edited, same_skeleton
from markerloom.motion.feet import Plant
from markerloom.motion.rotations import about_vertical, heading
from markerloom.motion.timing import sampled
from markerloom.skeleton.contacts import runs
from markerloom.skeleton.motion import Motion, quaternions

Array = NDArray[np.floating[Any]]
WARP_HZ = 30.0
"""Correspondence is searched at about this rate."""
KNOT_S = 0.25
"""Between knots so far apart time runs smoothly (s)."""
STEEPEST = 3.0
"""One clip runs at most so many times as fast as another."""


def mix(clips: list[Motion], weights: list[float], *, hold_feet: bool = True) -> Edited:
    """One motion between several of the same kind. Weights are parts of their sum; the first clip says where the
    motion begins.

    Raises ``InputError`` for clips of other skeletons or rates, and for weights that are none.
    """
    if len(clips) < 2 or len(weights) != len(clips):
        raise InputError(
            f"a mix needs two clips or more and a weight for each: {len(clips)} clips, {len(weights)} weights"
        )
    share = np.array(weights, float)
    if not np.isfinite(share).all() or share.min() < 0.0 or share.sum() <= 0.0:
        raise InputError("weights are numbers from 0, not all of them 0")
    share = share / share.sum()
    for clip in clips[1:]:
        same_skeleton(clips[0], clip, f"'{clips[0].source}' and '{clip.source}' cannot be mixed")
    times = [np.arange(len(clips[0]), dtype=float), *(corresponding(clips[0], clip) for clip in clips[1:])]
    # Time of the mix at every frame of the first clip, and from it the moments of all clips at its own frames.
    mixed_time = np.sum([w * t for w, t in zip(share, times, strict=True)], axis=0)
    frames = np.arange(int(np.floor(mixed_time[-1] + 1e-9)) + 1, dtype=float)
    at = [np.interp(frames, mixed_time, t) for t in times]
    moments = [sampled(clip, t) for clip, t in zip(clips, at, strict=True)]
    out = replace(_mixed(moments, share), first_frame=0)
    plants = _stances(clips, at, share)
    done = Joined(out, tuple(clips), tuple(at), (), tuple(plants))
    final = finished(done, hold_feet=hold_feet)
    report = {"weights": share.tolist(), "frames_in_out": [*(len(c) for c in clips), len(out)], **final.report}
    return Edited(final.motion, report)


def corresponding(a: Motion, b: Motion) -> Array:
    """The moment of ``b`` (between frames) that corresponds to each frame of ``a``; both begin and end together.

    Dynamic time warping (Sakoe & Chiba 1978) with steps that keep one from running much faster than the other, then a
    smooth curve through knots.
    """
    step = max(1, round(a.rate_hz / WARP_HZ))
    if len(a) < 3 or len(b) < 3:
        raise InputError("clips to be mixed have 3 frames or more")
    table = distances(a, b, step=step)
    n, m = table.shape
    if not 1.0 / STEEPEST < (n - 1) / max(m - 1, 1) < STEEPEST:
        raise InputError(f"'{a.source}' and '{b.source}' are of too different length: {len(a)} and {len(b)} frames")
    path = _warped(table)
    rows = np.unique(path[:, 0])
    mean = np.array([path[path[:, 0] == i, 1].mean() for i in rows])
    knots = np.unique(np.concatenate([np.arange(0, n - 1, max(2, round(KNOT_S * a.rate_hz / step))), [n - 1]]))
    values = np.interp(knots, rows, mean)
    values[0], values[-1] = 0.0, m - 1
    least = (m - 1) / (n - 1) / STEEPEST * np.diff(knots)
    for k in range(1, len(values) - 1):
        values[k] = np.clip(values[k], values[k - 1] + least[k - 1], m - 1 - least[k:].sum())
    ends = (len(a) - 1) / max(n - 1, 1), (len(b) - 1) / max(m - 1, 1)
    return PchipInterpolator(knots * ends[0], values * ends[1])(np.arange(len(a)))


def _warped(table: Array) -> NDArray[np.int64]:
    """The way through a table of distances with the least sum: steps (1, 1), (1, 2), (2, 1)."""
    n, m = table.shape
    best = np.full((n, m), np.inf)
    came = np.zeros((n, m), np.int8)
    best[0, 0] = table[0, 0]
    moves = ((1, 1), (1, 2), (2, 1))
    for i in range(1, n):
        for k, (di, dj) in enumerate(moves):
            if i < di:
                continue
            cost = np.full(m, np.inf)
            between = table[i, dj - 1 : m - 1] if dj == 2 else table[i - 1, dj:] if di == 2 else 0.0
            cost[dj:] = best[i - di, : m - dj] + table[i, dj:] + between
            better = cost < best[i]
            best[i], came[i] = np.where(better, cost, best[i]), np.where(better, k, came[i])
    if not np.isfinite(best[-1, -1]):
        return np.stack([np.arange(n), np.round(np.linspace(0, m - 1, n))], axis=1).astype(np.int64)
    i, j, way = n - 1, m - 1, [(n - 1, m - 1)]
    while (i, j) != (0, 0):
        di, dj = moves[came[i, j]]
        i, j = i - di, j - dj
        way.append((i, j))
    return np.array(way[::-1], np.int64)


def _mixed(moments: list[Motion], share: Array) -> Motion:
    """Weighted poses; the root goes on from frame to frame as its weighted speeds say."""
    first = moments[0]
    lateral = body_of(first.skeleton).lateral()
    frames, joints = first.turns.shape[:2]
    facing = [heading(m.turns[:, 0], lateral) for m in moments]
    tilt = [about_vertical(-f) @ m.turns[:, 0] for f, m in zip(facing, moments, strict=True)]
    turns = np.empty_like(first.turns)
    for j in range(joints):
        own = [quaternions(t if j == 0 else m.turns[:, j]) for t, m in zip(tilt, moments, strict=True)]
        signed = [q * np.where((q * own[0]).sum(axis=1) < 0.0, -1.0, 1.0)[:, None] for q in own]
        total = np.sum([w * q for w, q in zip(share, signed, strict=True)], axis=0)
        turns[:, j] = Rotation.from_quat(total).as_matrix()
    local = []
    for f, m in zip(facing, moments, strict=True):
        steps = np.diff(m.root_m[:, :2], axis=0)
        local.append(np.einsum("fab,fb->fa", about_vertical(-f[:-1])[:, :2, :2], steps))
    face = facing[0][0] + np.concatenate(
        [[0.0], np.cumsum(np.sum([w * np.diff(f) for w, f in zip(share, facing, strict=True)], axis=0))]
    )
    speed = np.sum([w * s for w, s in zip(share, local, strict=True)], axis=0)
    steps = np.einsum("fab,fb->fa", about_vertical(face[:-1])[:, :2, :2], speed)
    root_m = np.empty((frames, 3))
    root_m[:, :2] = first.root_m[0, :2] + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    root_m[:, 2] = np.sum([w * m.root_m[:, 2] for w, m in zip(share, moments, strict=True)], axis=0)
    turns[:, 0] = about_vertical(face) @ turns[:, 0]
    return replace(first, root_m=root_m, turns=turns, kind=np.ones((frames, joints), np.int64))


def _stances(clips: list[Motion], at: list[Array], share: Array) -> list[Plant]:
    """A place stands where it does in clips of at least half of the weight."""
    weight: dict[str, Array] = {}
    for clip, moments, w in zip(clips, at, share, strict=True):
        for p in begun(clip).plants:
            inside = (moments >= p.start) & (moments <= p.stop - 1)
            weight[p.site] = weight.get(p.site, np.zeros(len(moments))) + w * inside
    plants = [Plant(site, a, b) for site, own in weight.items() for a, b in runs(own >= 0.5) if b - a >= 3]
    return sorted(plants, key=lambda p: (p.start, p.site))
