"""Which joint of any skeleton is which part of a body: by its name, and by where it hangs.

Names of different programs mean different joints ("LeftShoulder" is a collar bone where there is a "LeftArm", and the
upper arm where there is a "LeftCollar"), so that words are read together with the other joints of the same side.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.skeleton.skeleton import Skeleton

Array = NDArray[np.floating[Any]]
SIDES = ("left", "right")
WORDS = {
    "upper_leg": {"upleg", "upperleg", "thigh", "upperthigh", "femur", "hip"},
    "lower_leg": {"leg", "lowerleg", "shin", "shank", "calf", "tibia", "knee"},
    "foot": {"foot", "ankle", "talocrural"},
    "toes": {"toebase", "toe", "toes", "ball", "tarsometatarsal", "metatarsophalangeal", "toebasis"},
    "clavicle": {"clavicle", "collar", "collarbone", "sternoclavicular", "acromioclavicular", "scapula"},
    "upper_arm": {"arm", "upperarm", "uparm", "humerus"},
    "forearm": {"forearm", "lowerarm", "loarm", "radius", "ulna", "elbow"},
    "hand": {"hand", "wrist", "radiocarpal"},
}
"""Words for parts of limbs; "shoulder" is an upper arm, or a collar bone where one of the words for arms is there."""
VAGUE = {"hip"}
"""A hip may be the thigh's joint or one above it: it counts where no plainer word is there."""
LEG, ARM = ("upper_leg", "lower_leg", "foot", "toes"), ("clavicle", "upper_arm", "forearm", "hand")
HEAD, NECK = {"head", "skullbase", "skull"}, re.compile(r"^(lower|upper)?neck$|^vc$")
NEEDED = tuple(f"{side}_{part}" for side in SIDES for part in ("upper_leg", "lower_leg", "foot"))


@dataclass(frozen=True)
class Body:
    """``parts``: the joint of each part, such as ``left_upper_leg``, ``pelvis``, ``chest``, ``head``; ``spine`` and
    ``neck``: the joints from pelvis to chest, and from chest to head, without these.
    """

    skeleton: Skeleton
    parts: dict[str, int]
    spine: tuple[int, ...]
    neck: tuple[int, ...]

    def chain(self, side: str, limb: tuple[str, ...]) -> list[int]:
        """The joints of a limb that are there, from the body outwards."""
        return [self.parts[f"{side}_{part}"] for part in limb if f"{side}_{part}" in self.parts]

    def missing(self) -> list[str]:
        """Parts without which feet cannot be held."""
        return [part for part in NEEDED if part not in self.parts]

    def leg_m(self) -> float:
        """Length of a leg from hip to ankle (m), the mean of both."""
        lengths = [self.skeleton.bone_lengths_m()[_between(self.skeleton, *ends)].sum() for ends in self._legs()]
        return float(np.mean(lengths)) if lengths else 0.0

    def _legs(self) -> list[tuple[int, int]]:
        pairs = [(f"{side}_upper_leg", f"{side}_foot") for side in SIDES]
        return [(self.parts[a], self.parts[b]) for a, b in pairs if a in self.parts and b in self.parts]

    def lateral(self) -> Array:
        """To the person's left in the rest pose (unit vector): from the right hip, or shoulder, to the left one."""
        places = self.skeleton.places_m()
        for part in ("upper_leg", "upper_arm", "clavicle", "lower_leg"):
            if f"left_{part}" in self.parts and f"right_{part}" in self.parts:
                way = places[self.parts[f"left_{part}"]] - places[self.parts[f"right_{part}"]]
                length = float(np.linalg.norm(way))
                if length > 1e-6:
                    return way / length
        return np.array([1.0, 0.0, 0.0])

    def group(self, name: str) -> list[int]:
        """Joints of a group: legs, arms, spine, head, left, right, or one joint by its name; [] where there is none."""
        below = _descendants(self.skeleton)
        tops = {
            "legs": [f"{side}_upper_leg" for side in SIDES],
            "arms": [f"{side}_{part}" for side in SIDES for part in ("clavicle", "upper_arm")],
            "left": [f"left_{part}" for part in ("upper_leg", "clavicle", "upper_arm")],
            "right": [f"right_{part}" for part in ("upper_leg", "clavicle", "upper_arm")],
        }
        if name in tops:
            return sorted({j for part in tops[name] if part in self.parts for j in below[self.parts[part]]})
        if name == "spine":
            return sorted({*self.spine, *([self.parts["chest"]] if "chest" in self.parts else [])})
        if name == "head":
            return sorted({*self.neck, *(below[self.parts["head"]] if "head" in self.parts else [])})
        joint = self.skeleton.index(name)
        return [] if joint < 0 else [joint]


def _descendants(skeleton: Skeleton) -> list[list[int]]:
    below: list[list[int]] = [[j] for j in range(len(skeleton))]
    for j in range(len(skeleton) - 1, 0, -1):
        below[skeleton.parents[j]] += below[j]
    return below


def _between(skeleton: Skeleton, top: int, end: int) -> list[int]:
    """The joints below one down to another, from the end upwards."""
    way = [end, *skeleton.above(end)]
    return way[: way.index(top)] if top in way else way


def split_name(name: str) -> tuple[str, str]:
    """Side ("left", "right" or "") and word of a joint's name, without namespace, numbers and separators."""
    plain = name.rpartition(":")[2]
    lower = re.sub(r"[\s._\-0-9]+", "_", re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", plain)).lower().strip("_")
    pieces = [p for p in lower.split("_") if p]
    while len(pieces) > 1 and pieces[0] in ("j", "jnt", "joint", "bip", "bone", "def", "mixamorig"):
        pieces = pieces[1:]
    for at in (0, -1):
        side = {"left": "left", "l": "left", "lft": "left", "right": "right", "r": "right", "rgt": "right"}
        if len(pieces) > 1 and pieces[at] in side:
            rest = pieces[1:] if at == 0 else pieces[:-1]
            return side[pieces[at]], "".join(rest)
    word = "".join(pieces)
    for full, side in (("left", "left"), ("right", "right")):
        if word.startswith(full) and len(word) > len(full):
            return side, word[len(full) :]
    known = set().union(*WORDS.values()) | {"shoulder", "hipjoint", "fingers", "thumb"}
    if word[:1] in ("l", "r") and word[1:] in known:
        return ("left" if word[0] == "l" else "right"), word[1:]
    return "", word


def body_of(skeleton: Skeleton) -> Body:
    """The parts of a skeleton; parts that cannot be told are left out."""
    words = [split_name(name) for name in skeleton.joints]
    parts: dict[str, int] = {}
    for side in SIDES:
        parts |= _limbs(skeleton, [(j, word) for j, (s, word) in enumerate(words) if s == side], side)
    tops = [parts[f"{side}_upper_leg"] for side in SIDES if f"{side}_upper_leg" in parts]
    if len(tops) == 2:
        parts["pelvis"] = _common(skeleton, tops)
    arms = [next((parts[p] for p in (f"{side}_clavicle", f"{side}_upper_arm") if p in parts), None) for side in SIDES]
    if None not in arms:
        parts["chest"] = _common(skeleton, [a for a in arms if a is not None])
    head = next((j for j, (side, word) in enumerate(words) if not side and word in HEAD), None)
    if head is not None:
        parts["head"] = head
    spine: list[int] = []
    if "pelvis" in parts and "chest" in parts:
        above = {parts["pelvis"], *skeleton.above(parts["pelvis"])}
        spine = [j for j in reversed(skeleton.above(parts["chest"])) if j not in above]
    neck: list[int] = []
    if head is not None and "chest" in parts:
        neck = [j for j in reversed(_between(skeleton, parts["chest"], head)) if j != head]
    return Body(skeleton, parts, tuple(spine), tuple(neck))


def _limbs(skeleton: Skeleton, own: list[tuple[int, str]], side: str) -> dict[str, int]:
    """Leg and arm of one side: of several joints with a part's word the one nearest to the body."""
    found: dict[str, int] = {}
    for part, known in WORDS.items():
        fitting = [j for j, word in own if word in known]
        plain = [j for j, word in own if word in known - VAGUE]
        if fitting:
            found[part] = min(plain or fitting)
    shoulder = next((j for j, word in own if word == "shoulder"), None)
    if shoulder is not None:
        found.setdefault("clavicle" if "upper_arm" in found else "upper_arm", shoulder)
    if "upper_leg" in found and "lower_leg" not in found and "foot" in found:
        between = _between(skeleton, found["upper_leg"], found["foot"])[1:]
        if between:
            found["lower_leg"] = between[-1]
    for limb in (LEG, ARM):
        _keep_in_line(skeleton, found, limb)
    return {f"{side}_{part}": joint for part, joint in found.items()}


def _keep_in_line(skeleton: Skeleton, found: dict[str, int], limb: tuple[str, ...]) -> None:
    """Parts of a limb hang below each other; one that does not is another thing of the same name."""
    top: int | None = None
    for part in limb:
        if part not in found:
            continue
        if top is not None and found[part] != top and top not in skeleton.above(found[part]):
            del found[part]
            continue
        top = found[part]


def _common(skeleton: Skeleton, joints: list[int]) -> int:
    """The lowest joint above all of these."""
    ways = [skeleton.above(joint) for joint in joints]
    return next((j for j in ways[0] if all(j in way for way in ways)), 0)
