"""One pose whose hands, feet or other places are where they are wanted: limbs turned as little as that needs."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import InputError
from markerloom.motion.body import ARM, LEG, SIDES, Body
from markerloom.motion.rotations import exp
from markerloom.skeleton.motion import Motion

Array = NDArray[np.floating[Any]]
ROUNDS, REACHED_M = 60, 1e-12
LARGEST_RAD = 0.4
"""A joint turns at most so far in one round."""
OUT_OF_REACH_M = 1e-4


def place_of(motion: Motion, name: str) -> tuple[int, Array]:
    """A joint, or the end of a bone, by its name: its joint and where it is on the joint's segment (m)."""
    skeleton = motion.skeleton
    j = skeleton.index(name)
    if j >= 0:
        return j, np.zeros(3)
    site = next((s for s in skeleton.sites if s.name == name), None)
    if site is None:
        raise InputError(
            f"there is no joint or end of a bone '{name}': "
            + ", ".join([*skeleton.joints, *(s.name for s in skeleton.sites)])
        )
    return site.joint, np.array(site.place_m)


def limb_above(body: Body, joint: int) -> list[int]:
    """The joints that move a place: from the joint above it to where its limb begins, or, on the trunk, to the root.
    The end of a bone moves with its own joint, too.
    """
    tops = {body.chain(side, limb)[0] for side in SIDES for limb in (LEG, ARM) if body.chain(side, limb)}
    way = [joint]
    while way[-1] not in tops and body.skeleton.parents[way[-1]] >= 0:
        way.append(body.skeleton.parents[way[-1]])
    return way


def reached(motion: Motion, at: int, targets_m: dict[str, Array], body: Body) -> dict[int, Array]:
    """New turns (3, 3) of the joints that had to turn so that named places are at targets (m, world) in a frame.

    Newton's method with the shortest step of all joints together (Wampler 1986). Raises ``InputError`` where a target
    is out of reach.
    """
    skeleton = motion.skeleton
    places = {name: place_of(motion, name) for name in targets_m}
    moving = sorted({j for joint, _ in places.values() for j in limb_above(body, joint)})
    turns = motion.turns[at].copy()
    above = {j: _way(skeleton.parents, j) for j in {joint for joint, _ in places.values()}}
    for _ in range(ROUNDS):
        turn, joint_m = _posed(motion, at, turns)
        off, rows = [], []
        for name, (joint, local) in places.items():
            here = joint_m[joint] + turn[joint] @ local
            off.append(targets_m[name] - here)
            row = np.zeros((3, 3 * len(moving)))
            for m, j in enumerate(moving):
                # The turn of the joint itself moves places on its segment, and all below it.
                if j in above[joint] and (j != joint or np.any(local)):
                    row[:, 3 * m : 3 * m + 3] = -_cross(here - joint_m[j]) @ turn[j]
            rows.append(row)
        missing = np.concatenate(off)
        if np.abs(missing).max() < REACHED_M:
            break
        step = np.linalg.lstsq(np.concatenate(rows), missing, rcond=1e-9)[0].reshape(-1, 3)
        step *= min(1.0, LARGEST_RAD / max(float(np.linalg.norm(step, axis=1).max()), 1e-12))
        turns[moving] = turns[moving] @ exp(step)
    _check(motion, at, turns, places, targets_m)
    return {j: turns[j] for j in moving}


def _check(
    motion: Motion, at: int, turns: Array, places: dict[str, tuple[int, Array]], targets_m: dict[str, Array]
) -> None:
    turn, joint_m = _posed(motion, at, turns)
    for name, (joint, local) in places.items():
        missed = float(np.linalg.norm(targets_m[name] - joint_m[joint] - turn[joint] @ local))
        if missed > OUT_OF_REACH_M:
            raise InputError(f"'{name}' cannot reach its place in frame {at}: {1000 * missed:.0f} mm are missing")


def _posed(motion: Motion, at: int, turns: Array) -> tuple[Array, Array]:
    skeleton = motion.skeleton
    turn, place = np.empty((len(skeleton), 3, 3)), np.empty((len(skeleton), 3))
    turn[0], place[0] = turns[0], motion.root_m[at]
    for j, p in enumerate(skeleton.parents):
        if p >= 0:
            turn[j], place[j] = turn[p] @ turns[j], place[p] + turn[p] @ skeleton.offsets_m[j]
    return turn, place


def _way(parents: tuple[int, ...], joint: int) -> set[int]:
    way = set()
    while joint >= 0:
        way.add(joint)
        joint = parents[joint]
    return way


def _cross(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
