"""Rest poses that are no pose of a body (all bones along one axis), told against one that somebody stands in."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import InputError
from markerloom.motion.body import SIDES, Body
from markerloom.motion.rotations import about_vertical
from markerloom.skeleton.motion import Motion, with_rest

Array = NDArray[np.floating[Any]]
UPRIGHT = 0.7
"""Cosine of how far legs and trunk may lean in a rest pose."""


def stands(body: Body) -> bool:
    """Whether the rest pose is one of somebody who stands: legs down, head up."""
    at = body.skeleton.places_m()
    return all(_down(at, body, side) > UPRIGHT for side in SIDES) and _up(at, body) > UPRIGHT


def _down(at: Array, body: Body, side: str) -> float:
    way = at[body.parts[f"{side}_foot"]] - at[body.parts[f"{side}_upper_leg"]]
    return float(-way[2] / max(float(np.linalg.norm(way)), 1e-9))


def _up(at: Array, body: Body) -> float:
    top = next((body.parts[p] for p in ("head", "chest") if p in body.parts), None)
    if top is None:
        return 1.0
    way = at[top] - at[body.parts["pelvis"]]
    length = float(np.linalg.norm(way))
    return float(way[2] / length) if length > 1e-6 else 1.0


def standing_rest(motion: Motion, body: Body) -> Array:
    """Turns of all segments (joints, 3, 3) of a pose to tell a motion against (`with_rest`): that of the frame in which
    somebody stands most upright, turned so that the left side is along x; feet from the frames where they are lowest.

    Raises ``InputError`` where nobody ever stands.
    """
    turn, place = motion.segments()
    if not len(motion):
        raise InputError(
            f"the rest pose of '{motion.skeleton.name}' is no pose of a body, and there is no motion to find one in"
        )
    upright = np.array([sum(_down(at, body, side) for side in SIDES) + _up(at, body) for at in place])
    legs = sum(_straight(place, body, side) for side in SIDES)
    best = int(np.argmax(upright + 2.0 * legs))
    if upright[best] < 3 * UPRIGHT:
        raise InputError(
            f"the rest pose of '{motion.skeleton.name}' is no pose of a body, and in its motion nobody stands"
        )
    rest = _faced(turn[best], place[best], body)
    for side in SIDES:
        foot = body.parts[f"{side}_foot"]
        toe = body.parts.get(f"{side}_toes", foot)
        height = place[:, foot, 2] + place[:, toe, 2]
        flat = int(np.argmin(height))
        below = [j for j in range(len(motion.skeleton)) if foot in (j, *motion.skeleton.above(j))]
        rest[below] = _faced(turn[flat], place[flat], body)[below]
    return rest


def _straight(place: Array, body: Body, side: str) -> Array:
    hip, knee, foot = (place[:, body.parts[f"{side}_{p}"]] for p in ("upper_leg", "lower_leg", "foot"))
    bones = np.linalg.norm(knee - hip, axis=1) + np.linalg.norm(foot - knee, axis=1)
    return np.linalg.norm(foot - hip, axis=1) / np.maximum(bones, 1e-9)


def _faced(turn: Array, place: Array, body: Body) -> Array:
    left = place[body.parts["left_upper_leg"]] - place[body.parts["right_upper_leg"]]
    return about_vertical(-np.arctan2(left[1], left[0])) @ turn


def standing(motion: Motion, body: Body, shown: Motion) -> tuple[Motion, Body, Array | None]:
    """A motion told against a rest pose that somebody stands in, found in ``shown`` where its own is none; and that
    pose, if it had to be found.
    """
    if stands(body):
        return motion, body, None
    rest = standing_rest(shown, body)
    other = with_rest(motion, rest)
    return other, Body(other.skeleton, body.parts, body.spine, body.neck), rest
