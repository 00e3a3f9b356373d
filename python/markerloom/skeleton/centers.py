"""Joint centres before the fit: by rule, and by motion where two segments' markers show it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from markerloom.skeleton.by_motion import Rigid, rigid, score, sphere
from markerloom.skeleton.motion import Motion
from markerloom.skeleton.placing import Placed
from markerloom.skeleton.rules import Centers
from markerloom.skeleton.skeleton import Skeleton

Array = NDArray[np.floating[Any]]
LEAST_TURN, LEAST_MOVED_M = 0.15, 0.02
"""Segments that turn less against each other (rad), or markers that move less (m), show noise, not a centre."""
NOISE_M = 0.004
"""How far markers are from rigid motion (m): noise and soft tissue."""


def motion_centers(placed: Placed, seen_m: Array, motion: Motion, guesses: Centers, guess_sd_m: float) -> Centers:
    """Centres of joints between segments with markers; ``motion``: the body before the fit, ``guesses``: rules."""
    skeleton = motion.skeleton
    of: dict[int, list[int]] = {}
    for m, joint in enumerate(placed.joints):
        of.setdefault(joint, []).append(m)
    rigids = {joint: rigid(seen_m[:, own]) for joint, own in of.items() if len(own) >= 3}
    posed = motion.joints_m()
    out: Centers = {}
    for joint in of:
        above = _carrier(skeleton, joint, of)
        if above < 0:
            continue
        guess, sd = guesses.get(joint, (posed[:, joint], guess_sd_m))
        guess = np.where(np.isfinite(guess), guess, posed[:, joint])
        found = _center(rigids, of, above, joint, seen_m, guess, max(sd, 0.5 * guess_sd_m))
        if found is not None:
            out[joint] = (found, 0.25 * guess_sd_m)
    return out


def _center(
    rigids: dict[int, Rigid], of: dict[int, list[int]], above: int, joint: int, seen_m: Array, guess: Array, sd: float
) -> Array | None:
    if above in rigids and joint in rigids:
        one, two = rigids[above], rigids[joint]
        if _turning_rad(one, two) < LEAST_TURN:
            return None
        local = score(one, two, noise_m=NOISE_M, guess_m=guess, guess_sd_m=sd)
        first, second = _world(one, local[0]), _world(two, local[1])
        return np.where(np.isfinite(first), first, second)
    if above in rigids:
        if _moving_m(rigids[above], seen_m[:, of[joint]]) < LEAST_MOVED_M:
            return None
        local = sphere(rigids[above], seen_m[:, of[joint]], noise_m=NOISE_M, guess_m=guess, guess_sd_m=sd)
        return _world(rigids[above], local)
    if joint in rigids:
        if _moving_m(rigids[joint], seen_m[:, of[above]]) < LEAST_MOVED_M:
            return None
        local = sphere(rigids[joint], seen_m[:, of[above]], noise_m=NOISE_M, guess_m=guess, guess_sd_m=sd)
        return _world(rigids[joint], local)
    return None


def _turning_rad(one: Rigid, two: Rigid) -> float:
    """How much two segments turn against each other: rms angle from their mean turn."""
    relative = np.swapaxes(one.turn, 1, 2) @ two.turn
    relative = relative[np.isfinite(relative).all(axis=(1, 2))]
    if len(relative) < 2:
        return 0.0
    turns = Rotation.from_matrix(relative)
    return float(np.sqrt(((turns.mean().inv() * turns).magnitude() ** 2).mean()))


def _moving_m(of: Rigid, seen_m: Array) -> float:
    """How far markers move as a segment sees them: rms distance from where they are on average (m)."""
    local = np.einsum("fba,fmb->fma", of.turn, seen_m - of.place_m[:, None])
    with np.errstate(invalid="ignore"):
        off = local - np.nanmean(local, axis=0)
    return float(np.sqrt(np.nanmean((off**2).sum(axis=2)))) if np.isfinite(off).any() else 0.0


def _world(of: Rigid, local: Array) -> Array:
    return of.place_m + np.einsum("fab,b->fa", of.turn, local)


def _carrier(skeleton: Skeleton, joint: int, of: dict[int, list[int]]) -> int:
    """The segment with markers that a joint hangs from directly, or over joints that are locked; −1 without one."""

    def group(j: int) -> int:
        while j > 0 and not skeleton.free[j].any():
            j = skeleton.parents[j]
        return j

    if joint == 0 or not skeleton.free[joint].any():
        return -1
    top = group(skeleton.parents[joint])
    return next((j for j in of if group(j) == top), -1)


def with_centers(motion: Motion, centers: Centers) -> Skeleton:
    """The skeleton whose joints are where the centres say, in the axes of the poses at hand."""
    skeleton = motion.skeleton
    turn, place = motion.segments()
    offsets = skeleton.offsets_m.copy()
    for joint, p in enumerate(skeleton.parents):
        if joint in centers:
            at = place[:, p] if p not in centers else np.where(np.isfinite(centers[p][0]), centers[p][0], place[:, p])
            local = np.einsum("fba,fb->fa", turn[:, p], centers[joint][0] - at)
            local = local[np.isfinite(local).all(axis=1)]
            if len(local):
                offsets[joint] = np.median(local, axis=0)
    return replace(skeleton, offsets_m=offsets)
