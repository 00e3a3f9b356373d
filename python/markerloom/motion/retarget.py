"""A motion on another body (Gleicher 1998, "Retargetting motion to new characters").

First every segment of the target takes the direction that its fellow of the source has, and the hips the source's path
in the size of the target's legs. Then feet that stood stand, hands that touched touch, and nothing enters the floor:
one problem over the whole clip, in which as little as possible changes (`spacetime`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from markerloom.errors import InputError
from markerloom.motion.bands import low_passed
from markerloom.motion.body import Body, body_of
from markerloom.motion.calm import calmed
from markerloom.motion.constraints import Constraints, find_constraints
from markerloom.motion.edited import Edited, accelerations, bounds, moved_mm
from markerloom.motion.feet import Plant, feet_of, floor_m, placed, rest_heights, slides, standing_heights, with_time
from markerloom.motion.footlock import check_length, check_plants
from markerloom.motion.looks import lines, meeting
from markerloom.motion.mapping import Mapping, followed, guess, indices, with_parts
from markerloom.motion.rotations import about_vertical
from markerloom.motion.spacetime import (
    CALM,
    NOWHERE,
    Freedom,
    Goal,
    arm_freedoms,
    calmly_changed,
    floor_goals,
    head_freedoms,
    knee_goals,
    leg_freedoms,
    plant_goals,
    straightness,
    together,
)
from markerloom.motion.upright import standing
from markerloom.skeleton.motion import Motion, with_rest
from markerloom.skeleton.skeleton import Skeleton

Array = NDArray[np.floating[Any]]
SAME_M = 1e-9
FLAT_PARTS = ("pelvis", "head", "left_foot", "right_foot", "left_toes", "right_toes")
"""Parts that only follow the heading of the source's rest pose: a foot of another shape stands flat, too."""
NEXT = {
    "upper_leg": "lower_leg",
    "lower_leg": "foot",
    "clavicle": "upper_arm",
    "upper_arm": "forearm",
    "forearm": "hand",
}


def retarget(
    motion: Motion,
    target: Skeleton,
    *,
    mapping: Mapping | None = None,
    constraints: Constraints | None = None,
    target_motion: Motion | None = None,
) -> Edited:
    """A motion on the bones of another skeleton.

    ``mapping``: which joint follows which, guessed unless given; ``constraints``: what must hold, found unless given;
    ``target_motion``: a motion of the target, needed where its rest pose is no pose of a body. Onto the same skeleton
    nothing changes. Raises ``InputError`` where skeletons cannot be matched, with the joints.
    """
    known = mapping or guess(motion.skeleton, target)
    pairs = indices(known, motion.skeleton, target)
    if _same(motion.skeleton, target, pairs):
        return Edited(replace(motion, skeleton=target), {"same_skeleton": True, "warnings": []})
    check_length(motion)
    body, fellow = with_parts(body_of(target), body_of(motion.skeleton), pairs)
    source, fellow, _ = standing(motion, fellow, motion)
    still = Motion(target, np.zeros((1, 3)), np.tile(np.eye(3), (1, len(target), 1, 1)), motion.rate_hz)
    bones, body, rest = standing(still, body, target_motion if target_motion is not None else still)
    held = find_constraints(source, fellow) if constraints is None else constraints
    problem = _Problem(source, fellow, bones.skeleton, body, pairs, held)
    out, report = problem.solve()
    if rest is not None:
        out = with_rest(out, np.swapaxes(rest, 1, 2))
    return Edited(replace(out, skeleton=target), report)


def _same(source: Skeleton, target: Skeleton, pairs: dict[int, int]) -> bool:
    if source.parents != target.parents or any(j != k for j, k in pairs.items()):
        return False
    return bool(np.abs(source.offsets_m[1:] - target.offsets_m[1:]).max(initial=0.0) < SAME_M)


class _Problem:
    """Source, target, and how they belong together; rest poses of both stand."""

    def __init__(
        self,
        source: Motion,
        fellow: Body,
        target: Skeleton,
        body: Body,
        pairs: dict[int, int],
        constraints: Constraints,
    ) -> None:
        self.source, self.fellow, self.target, self.body, self.pairs = source, fellow, target, body, pairs
        self.feet, self.their_feet = feet_of(body), feet_of(fellow)
        self.scale = body.leg_m() / fellow.leg_m()
        self.constraints = constraints
        self.plants = check_plants(list(constraints.plants), source, self.their_feet)
        said = constraints.floor_m
        self.floor = floor_m(source, self.their_feet, self.plants) if said is None else said
        self.their_heights = standing_heights(source, self.their_feet, self.plants, self.floor)
        self.their_world = self.their_feet.world_m(source)
        self.heights = self._heights()
        self.allowed = self._allowed()
        transferred = self._transferred()
        self.naive = calmed(transferred, CALM * self.allowed)
        self.calmed_mm = moved_mm(transferred, self.naive)

    def _allowed(self) -> Array:
        """How sharp joints may be (frames, joints; m/s²): as their fellows; those that follow none as they like."""
        frames = np.arange(len(self.source), dtype=float)
        out = bounds([(self.source, frames)], len(frames), followed(self.target, self.pairs))
        out[:, [j for j in range(len(self.target)) if j not in self.pairs]] = np.inf
        return out

    def _heights(self) -> dict[str, float]:
        """How high above the floor each place of the target's feet is while it stands (m)."""
        theirs = self.their_heights
        rest, own = rest_heights(self.fellow.skeleton, self.their_feet), rest_heights(self.target, self.feet)
        above = [theirs[name] - rest[name] for name in theirs]
        usual = float(np.median(above)) if above else 0.0
        return {
            name: own[name] + self.scale * max(theirs.get(name, rest.get(name, 0.0) + usual) - rest.get(name, 0.0), 0.0)
            for name in own
        }

    def _transferred(self) -> Motion:
        """Directions of the source's segments, and its path in the size of the target's legs."""
        turn, place = self.source.segments()
        frames, joints = len(self.source), len(self.target)
        alike = _alignments(self.fellow, self.body, self.pairs)
        world = np.empty((frames, joints, 3, 3))
        chains = _chains(self.fellow, self.body, self.pairs, turn)
        above = self.target.above(self.body.parts["pelvis"])
        for j in _pelvis_first(self.target, self.body):
            p = self.target.parents[j]
            if j in self.pairs:
                world[:, j] = turn[:, self.pairs[j]] @ alike[j]
            elif j in chains:
                world[:, j] = chains[j] @ alike[j]
            elif j in above:
                world[:, j] = world[:, self.body.parts["pelvis"]]
            else:
                world[:, j] = world[:, p]
        turns = world.copy()
        for j, p in enumerate(self.target.parents):
            if p >= 0:
                turns[:, j] = np.swapaxes(world[:, p], 1, 2) @ world[:, j]
        out = Motion(self.target, np.zeros((frames, 3)), turns, self.source.rate_hz, self.source.first_frame)
        own = out.joints_m()
        pelvis = own[:, self.body.parts["pelvis"]]
        wanted = self._path(_hips(place, self.fellow)) - _hips(own, self.body)
        theirs = place[:, self.fellow.parts["pelvis"]] - pelvis
        # Sizes differ slowly; what is fast comes from the source's pelvis as it is, its trembling, too.
        root_m = theirs + low_passed(wanted - theirs, self.source.rate_hz)
        return replace(out, root_m=root_m, source=self.source.source)

    def _path(self, hips: Array) -> Array:
        """Where the target's hips go: from where the source's begin, steps and heights in the size of its legs."""
        out = hips[0] + self.scale * (hips - hips[0])
        theirs = self.their_heights
        ankles = [self.heights[n] - self.scale * theirs[n] for n in ("l_heel", "r_heel") if n in theirs]
        lift = float(np.mean(ankles)) if ankles else 0.0
        out[:, 2] = self.floor + self.scale * (hips[:, 2] - self.floor) + lift
        return out

    def solve(self) -> tuple[Motion, dict[str, Any]]:
        """Hold what must hold."""
        plants = placed(self.naive, self.feet, self._own_plants(), self.floor, self._height)
        plants = with_time(plants, self.feet, self.allowed, self.naive.rate_hz)
        free = leg_freedoms(self.naive, self.body, self.feet)
        groups: dict[str, list[Goal]] = {
            "plants": plant_goals(self.feet, plants),
            "floor": floor_goals(self.naive, self.feet, plants, self.floor),
            "knees": knee_goals(self.naive, self.body),
        }
        groups["touches"], arms = self._touches()
        groups["holds"], more = self._holds()
        groups["looks"], necks = self._looks()
        goals = [g for own in groups.values() for g in own]
        solved = calmly_changed(self.naive, together(free, arms, more, necks), goals, self.allowed)
        edges = np.cumsum([len(own) for own in groups.values()])[:-1]
        missed = {
            k: 1000.0 * float(part.max(initial=0.0))
            for k, part in zip(groups, np.split(solved.missed_m, edges), strict=True)
        }
        return solved.motion, self._report(solved.motion, plants, missed)

    def _own_plants(self) -> list[Plant]:
        return [p for p in self.plants if p.site in self.feet.stand]

    def _height(self, plant: Plant) -> float:
        """How high a place of the target stands (m, world): its own height, and what the source's stands higher."""
        at = self.their_world[plant.site][plant.start : plant.stop, 2].mean()
        higher = float(at) - self.floor - self.their_heights[plant.site]
        return self.floor + self.heights[plant.site] + self.scale * higher

    def _touches(self) -> tuple[list[Goal], list[Freedom]]:
        goals: list[Goal] = []
        free: list[Freedom] = []
        place = self.source.joints_m()
        arm = _reach(self.body) / max(_reach(self.fellow), 1e-9)
        for touch in self.constraints.touches:
            a, b = self._part(touch.a), self._part(touch.b)
            way = arm * (place[:, self.fellow.parts[touch.a]] - place[:, self.fellow.parts[touch.b]])
            goals += [
                ("apart", f, a, NOWHERE, b, NOWHERE, way[f].tolist(), 0.0) for f in range(touch.start, touch.stop)
            ]
            free += [f for part in (touch.a, touch.b) for f in self._arm(part)]
        return goals, free

    def _holds(self) -> tuple[list[Goal], list[Freedom]]:
        goals: list[Goal] = []
        free: list[Freedom] = []
        place = self.naive.joints_m()
        for hold in self.constraints.holds:
            j = self._part(hold.part)
            where = hold.where_m or tuple(place[hold.start : hold.stop, j].mean(axis=0).tolist())
            goals += [("at", f, j, NOWHERE, 0, NOWHERE, list(where), 0.0) for f in range(hold.start, hold.stop)]
            free += self._arm(hold.part)
        return goals, free

    def _looks(self) -> tuple[list[Goal], list[Freedom]]:
        goals: list[Goal] = []
        if not self.constraints.looks:
            return [], []
        head = self._part("head")
        forward = np.cross(self.body.lateral(), [0.0, 0.0, 1.0]).tolist()
        eyes, ahead = lines(self.naive, self.body)
        for look in self.constraints.looks:
            where = look.where_m or meeting(eyes[look.start : look.stop], ahead[look.start : look.stop]).tolist()
            goals += [("look", f, head, NOWHERE, 0, forward, list(where), 0.0) for f in range(look.start, look.stop)]
        return goals, head_freedoms(self.body)

    def _part(self, name: str) -> int:
        for body, what in ((self.body, "target"), (self.fellow, "source")):
            if name not in body.parts:
                raise InputError(
                    f"the {what} '{body.skeleton.name}' has no part '{name}': {', '.join(sorted(body.parts))}"
                )
        return self.body.parts[name]

    def _arm(self, part: str) -> list[Freedom]:
        side = part.partition("_")[0]
        return arm_freedoms(self.naive, self.body, side) if part.endswith("_hand") else []

    def _report(self, out: Motion, plants: list[Plant], missed_mm: dict[str, float]) -> dict[str, Any]:
        sharp = accelerations(out) / self.allowed
        straightest = {s: float(straightness(out, self.body, s).max()) for s in ("left", "right")}
        warnings = [f"{kind}: missed by up to {mm:.1f} mm" for kind, mm in missed_mm.items() if mm > 1.0]
        unmapped = [name for j, name in enumerate(self.target.joints) if j not in self.pairs]
        return {
            **slides(out, self.feet, plants, self.floor),
            "scale": self.scale,
            "floor_m": self.floor,
            "missed_mm": missed_mm,
            "constraints": {k: len(getattr(self.constraints, k)) for k in ("plants", "touches", "holds", "looks")},
            "joints": {"followed": len(self.pairs), "at_rest": unmapped},
            "calmed_mm": self.calmed_mm,
            "sharpness": float(sharp.max(initial=0.0)),
            "straightest_leg": straightest,
            "leg_stretch": 0.0,
            "warnings": warnings,
        }


def _hips(place: Array, body: Body) -> Array:
    return 0.5 * (place[:, body.parts["left_upper_leg"]] + place[:, body.parts["right_upper_leg"]])


def _reach(body: Body) -> float:
    lengths = body.skeleton.bone_lengths_m()
    parts = [
        body.parts[f"{side}_{p}"]
        for side in ("left", "right")
        for p in ("forearm", "hand")
        if f"{side}_{p}" in body.parts
    ]
    return float(lengths[parts].sum()) if parts else 1.0


def _pelvis_first(target: Skeleton, body: Body) -> list[int]:
    """Joints in an order in which those above the pelvis come after it."""
    return [body.parts["pelvis"], *(j for j in range(len(target)) if j != body.parts["pelvis"])]


def _bone(body: Body, joint: int) -> Array | None:
    """Direction of a part's bone in the rest pose (world), to the next part of its limb or of the trunk."""
    at = body.skeleton.places_m()
    part = next((p for p, j in body.parts.items() if j == joint and p not in FLAT_PARTS), None)
    end: int | None = None
    if part is not None:
        side, _, name = part.partition("_")
        end = body.parts.get(f"{side}_{NEXT[name]}") if name in NEXT else None
        if part == "chest":
            end = body.neck[0] if body.neck else body.parts.get("head")
    for chain, last in ((body.spine, body.parts.get("chest")), (body.neck, body.parts.get("head"))):
        if joint in chain:
            k = chain.index(joint)
            end = chain[k + 1] if k + 1 < len(chain) else last
    if end is None or np.linalg.norm(at[end] - at[joint]) < 1e-4:
        return None
    return (at[end] - at[joint]) / np.linalg.norm(at[end] - at[joint])


def _alignments(fellow: Body, body: Body, pairs: dict[int, int]) -> list[Array]:
    """Of every joint of the target the turn from its segment's axes to those of the source's segment it follows: both
    rest poses face the same way, and bones that differ in them point the same way.
    """
    ours, theirs = body.lateral(), fellow.lateral()
    facing = about_vertical(np.arctan2(theirs[1], theirs[0]) - np.arctan2(ours[1], ours[0]))
    out: list[Array] = []
    for j in range(len(body.skeleton)):
        turn = facing
        own, other = _bone(body, j), _bone(fellow, pairs[j]) if j in pairs else None
        if own is not None and other is not None:
            turn = _onto(facing @ own, other) @ facing
        feet = [p for p in FLAT_PARTS[2:4] if body.parts.get(p) == j or body.parts.get(p.replace("foot", "toes")) == j]
        if feet:
            turn = about_vertical(_toes_out(fellow, feet[0]) - _toes_out(body, feet[0], facing)) @ facing
        out.append(turn)
    return out


def _toes_out(body: Body, foot: str, facing: Array | None = None) -> float:
    """Where a foot points in the rest pose (rad about the vertical); that of one without toes is unknown: 0."""
    ankle = body.parts[foot]
    toes = body.parts.get(foot.replace("foot", "toes"))
    at = body.skeleton.places_m()
    ends = [np.array(s.place_m) for s in body.skeleton.sites if s.joint == ankle]
    way = at[toes] - at[ankle] if toes is not None else ends[0] if ends else np.zeros(3)
    way = way if facing is None else facing @ way
    return float(np.arctan2(way[1], way[0])) if np.linalg.norm(way[:2]) > 1e-4 else 0.0


def _onto(a: Array, b: Array) -> Array:
    """The least turn that takes one direction to another."""
    axis = np.cross(a, b)
    sine, cosine = float(np.linalg.norm(axis)), float(a @ b)
    if sine < 1e-12:
        return np.eye(3)
    return Rotation.from_rotvec(axis / sine * np.arctan2(sine, cosine)).as_matrix()


def _chains(fellow: Body, body: Body, pairs: dict[int, int], turn: Array) -> dict[int, Array]:
    """World turns (frames, 3, 3) for joints of spine and neck that follow no single joint: between those of the source,
    by how far up they are.
    """
    out: dict[int, Array] = {}
    ends = (("spine", "pelvis", "chest"), ("neck", "chest", "head"))
    for name, low, high in ends:
        own, other = getattr(body, name), getattr(fellow, name)
        if (
            not own
            or any(j in pairs for j in own)
            or not all(p in b.parts for b in (body, fellow) for p in (low, high))
        ):
            continue
        knots = [fellow.parts[low], *other, fellow.parts[high]]
        up = np.linspace(0.0, len(knots) - 1.0, len(own) + 2)[1:-1]
        for j, level in zip(own, up, strict=True):
            k = min(int(level), len(knots) - 2)
            a, b = turn[:, knots[k]], turn[:, knots[k + 1]]
            between = Rotation.from_matrix(np.swapaxes(a, 1, 2) @ b).as_rotvec() * (level - k)
            out[j] = a @ Rotation.from_rotvec(between).as_matrix()
    return out
