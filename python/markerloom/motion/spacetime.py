"""The engine's one least-squares problem over a whole clip, told in joints and places (`core/motion/spacetime.rs`)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom import _core
from markerloom.motion.body import ARM, SIDES, Body
from markerloom.motion.calm import above, near
from markerloom.motion.edited import accelerations, near_or_usual
from markerloom.motion.feet import NEAR_FLOOR_M, Feet, Plant
from markerloom.motion.rotations import about, reference
from markerloom.motion.upright import stands
from markerloom.skeleton.motion import Motion

Array = NDArray[np.floating[Any]]
Freedom = tuple[int, list[float], bool, float]
Goal = tuple[str, int, int, list[float], int, list[float], list[float], float]
TOLERANCE_M = 3e-5
LEVELS = [(4, 3e-3), (2, 1e-3), (1, 1e-4), (1, 1e-5)]
"""Levels of splines: frames from knot to knot, and what a goal may be missed by at the price of a usual change (m)."""
SHARP = 0.5
"""A change is sharp where it adds this part of the acceleration that a joint has there anyway."""
LEAST_SHARP_M_PER_S2 = 0.3
SHARPEST, CALM = 1.45, 1.4
"""Where joints are sharper than allowed by the first, all that are by more than the second get calmer; before anything
is held, none is by more than the second."""
STEADIER_ROUNDS, STEADIER, MET_M = 3, 0.6, 1e-4
"""So often a change has to ease in by so much more slowly, while goals are met so well (m)."""
WINDOW, OVERLAP_S = 1500, 1.0
"""Frames of a window, and how long two of them share (s)."""
ROOT_M, ROOT_RAD = 0.03, 0.02
"""Usual changes: of the root's place (for legs of usual length), and of its turn."""
BALL_RAD, HINGE_RAD, TRUNK_RAD, TOES_RAD = 0.15, 0.3, 0.05, 0.4
"""Usual changes of hips, ankles, shoulders and wrists; of knees and elbows; of joints of the trunk; of toes."""
BENDS_RAD = 0.1
"""A joint that bends less than this in a clip does not show its axis."""
STRAIGHT = 0.998
"""A knee that is straighter than this part of the leg's length pops; a leg may be as straight as its source was."""
NOWHERE = [0.0, 0.0, 0.0]


@dataclass(frozen=True)
class Solved:
    """The motion, and by how much each goal is missed (m)."""

    motion: Motion
    missed_m: Array


def changed(motion: Motion, freedoms: list[Freedom], goals: list[Goal], steadier: Array | None = None) -> Solved:
    """The motion that meets the goals and differs as little as that allows.

    ``steadier``: of every joint in every frame (frames, joints) how sharply it may change, as a part of usual.
    """
    skeleton = motion.skeleton
    overlap = max(8, round(OVERLAP_S * motion.rate_hz))
    root_m, turns, missed = _core.change_motion(
        [None if p < 0 else p for p in skeleton.parents],
        skeleton.offsets_m.tolist(),
        np.ascontiguousarray(motion.root_m, float),
        np.ascontiguousarray(motion.turns, float),
        freedoms,
        goals,
        LEVELS,
        _sharp(motion, freedoms, steadier),
        TOLERANCE_M,
        (max(WINDOW, 4 * overlap), overlap),
    )
    return Solved(replace(motion, root_m=root_m, turns=turns), np.array(missed))


def calmly_changed(motion: Motion, freedoms: list[Freedom], goals: list[Goal], allowed: Array) -> Solved:
    """The same with accelerations (frames, joints; m/s²) that are allowed, as far as may be: where joints get sharper,
    changes have to ease in more slowly, as long as goals are still met.
    """
    best, least, steadier = None, np.inf, np.ones(allowed.shape)
    for _ in range(STEADIER_ROUNDS + 1):
        solved = changed(motion, freedoms, goals, steadier)
        sharp = accelerations(solved.motion) / allowed
        worst = float(sharp.max(initial=0.0))
        if best is None or (worst < least and solved.missed_m.max(initial=0.0) < MET_M):
            best, least = solved, worst
        if worst <= SHARPEST:
            break
        steadier *= 1.0 - STEADIER * near(above((sharp > CALM).astype(float), motion.skeleton))
    assert best is not None
    return best


def _sharp(motion: Motion, freedoms: list[Freedom], steadier: Array | None) -> Array:
    """How sharply each freedom may change in each frame (frames, freedoms; rad or m per frame²): by how much the joints
    that it moves are accelerated anyway, there or usually.
    """
    skeleton = motion.skeleton
    usual = np.maximum(near_or_usual(accelerations(motion)), LEAST_SHARP_M_PER_S2) * SHARP / motion.rate_hz**2
    reach = skeleton.bone_lengths_m().copy()
    reach[0] = 0.0
    # The lever of a turn: the longest way down from the joint.
    longest = np.zeros(len(skeleton))
    for j in range(len(skeleton) - 1, 0, -1):
        p = skeleton.parents[j]
        longest[p] = max(longest[p], longest[j] + reach[j])
    columns = []
    for joint, _, shift, _ in freedoms:
        ends = [joint, *skeleton.children(joint)]
        lever = 1.0 if shift else max(longest[joint], 0.1 * longest[0])
        own = usual[:, ends].max(axis=1) / lever
        columns.append(own if steadier is None else own * steadier[:, joint])
    return np.ascontiguousarray(np.stack(columns, axis=1)) if columns else np.zeros((len(motion), 0))


def leg_freedoms(motion: Motion, body: Body, feet: Feet, *, easily: float = 1.0) -> list[Freedom]:
    """What may change so that feet stand: the root a little, hips, knees about their axes, ankles, and the joints
    between ankle and ball where these move the ball. ``easily``: usual changes are so many times as large: the smaller,
    the sooner a pose returns to what it was.
    """
    free = _root(feet.scale)
    for side in SIDES:
        free += _ball(body.parts[f"{side}_upper_leg"], BALL_RAD)
        free += hinge(motion, body, side, ("upper_leg", "lower_leg", "foot"))
        free += _ball(body.parts[f"{side}_foot"], BALL_RAD)
        # Toes bend so that they do not enter the floor, and where they move the ball.
        for part in ("ball", "toe"):
            joint, local = feet.places.get(f"{side[0]}_{part}", (0, np.zeros(3)))
            if joint != body.parts[f"{side}_foot"] and np.any(local):
                upright = stands(body)
                free += [(joint, body.lateral().tolist(), False, TOES_RAD)] if upright else _ball(joint, TOES_RAD)
    return _unique([(joint, axis, shift, easily * usual) for joint, axis, shift, usual in free])


def arm_freedoms(motion: Motion, body: Body, side: str) -> list[Freedom]:
    """What may change so that a hand is somewhere: shoulder, elbow, and the trunk a little."""
    free: list[Freedom] = []
    for j in (*body.spine, body.parts.get("chest", -1)):
        if j > 0:
            free += _ball(j, TRUNK_RAD)
    chain = body.chain(side, ARM)
    if f"{side}_upper_arm" in body.parts:
        free += _ball(body.parts[f"{side}_upper_arm"], BALL_RAD)
    if f"{side}_forearm" in body.parts:
        free += hinge(motion, body, side, ("upper_arm", "forearm", "hand"))
    if f"{side}_hand" in body.parts and len(chain) > 2:
        free += _ball(body.parts[f"{side}_hand"], BALL_RAD)
    return free


def head_freedoms(body: Body) -> list[Freedom]:
    """What may change so that somebody looks somewhere."""
    joints = [*body.neck, *([body.parts["head"]] if "head" in body.parts else [])]
    return [f for j in joints for f in _ball(j, BALL_RAD)]


def _root(scale: float) -> list[Freedom]:
    eye = np.eye(3).tolist()
    return [(0, axis, True, ROOT_M * scale) for axis in eye] + [(0, axis, False, ROOT_RAD) for axis in eye]


def _ball(joint: int, usual: float) -> list[Freedom]:
    return [(joint, axis, False, usual) for axis in np.eye(3).tolist()]


def _unique(free: list[Freedom]) -> list[Freedom]:
    """Sorted by joint, the root's shifts first; what is there twice once."""
    seen: dict[tuple[int, tuple[float, ...], bool], Freedom] = {}
    for f in free:
        seen.setdefault((f[0], tuple(f[1]), f[2]), f)
    return sorted(seen.values(), key=lambda f: (f[0], not f[2]))


def together(*parts: list[Freedom]) -> list[Freedom]:
    """Several sets of freedoms as one."""
    return _unique([f for part in parts for f in part])


def hinge(motion: Motion, body: Body, side: str, parts: tuple[str, str, str]) -> list[Freedom]:
    """A knee or elbow: it bends about one axis, the one it bends about in the clip, or across the plane of its limb."""
    top, joint, end = (body.parts.get(f"{side}_{part}", -1) for part in parts)
    vectors = about(reference(motion.turns[:, joint]), motion.turns[:, joint])
    _, size, axes = np.linalg.svd(vectors - vectors.mean(axis=0), full_matrices=False)
    if len(vectors) > 2 and size[0] / np.sqrt(len(vectors)) > BENDS_RAD / 2.0 and size[0] > 3.0 * size[1]:
        return [(joint, axes[0].tolist(), False, HINGE_RAD)]
    turn, place = motion.segments()
    if min(top, end) < 0 or not len(motion):
        return _ball(joint, BALL_RAD)
    normal = np.cross(place[:, joint] - place[:, top], place[:, end] - place[:, joint])
    most = int(np.argmax(np.linalg.norm(normal, axis=1)))
    length = float(np.linalg.norm(normal[most]))
    bones = float(np.prod(body.skeleton.bone_lengths_m()[[joint, end]]))
    if length < np.sin(BENDS_RAD) * max(bones, 1e-12):
        return _ball(joint, BALL_RAD)
    return [(joint, (turn[most, joint].T @ normal[most] / length).tolist(), False, HINGE_RAD)]


def plant_goals(feet: Feet, plants: list[Plant]) -> list[Goal]:
    """Places of feet that stand where they stand."""
    goals: list[Goal] = []
    for p in plants:
        joint, local = feet.places[p.site]
        where = list(p.where_m or NOWHERE)
        goals += [("at", f, joint, list(local), 0, NOWHERE, where, 0.0) for f in range(p.start, p.stop)]
    return goals


def floor_goals(motion: Motion, feet: Feet, plants: list[Plant], floor: float) -> list[Goal]:
    """All other places of the feet, where they come near the floor: not below it."""
    held = {(p.site, f) for p in plants for f in range(p.start, p.stop)}
    goals: list[Goal] = []
    for name, places in feet.world_m(motion).items():
        joint, local = feet.places[name]
        near = np.flatnonzero(places[:, 2] < floor + NEAR_FLOOR_M * feet.scale)
        goals += [
            ("above", int(f), joint, list(local), 0, NOWHERE, NOWHERE, floor)
            for f in near
            if (name, int(f)) not in held
        ]
    return goals


def straightness(motion: Motion, body: Body, side: str) -> Array:
    """How straight a leg is (frames): distance from hip to ankle as a part of the lengths of thigh and shank."""
    place = motion.joints_m()
    hip, knee, ankle = (body.parts[f"{side}_{part}"] for part in ("upper_leg", "lower_leg", "foot"))
    bones = np.linalg.norm(place[:, knee] - place[:, hip], axis=1) + np.linalg.norm(
        place[:, ankle] - place[:, knee], axis=1
    )
    return np.linalg.norm(place[:, ankle] - place[:, hip], axis=1) / bones


def knee_goals(motion: Motion, body: Body) -> list[Goal]:
    """No leg straighter than it may be, so that knees do not pop."""
    goals: list[Goal] = []
    place = motion.joints_m()
    for side in SIDES:
        hip, knee, ankle = (body.parts[f"{side}_{part}"] for part in ("upper_leg", "lower_leg", "foot"))
        straight = straightness(motion, body, side)
        bones = np.linalg.norm(place[0, knee] - place[0, hip]) + np.linalg.norm(place[0, ankle] - place[0, knee])
        allowed = np.maximum(straight, STRAIGHT) * bones
        near = np.flatnonzero(straight > STRAIGHT - 0.05)
        goals += [("within", int(f), hip, NOWHERE, ankle, NOWHERE, NOWHERE, float(allowed[f])) for f in near]
    return goals
