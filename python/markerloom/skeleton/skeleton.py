"""Skeletons: a tree of joints with constant bones.

In the rest pose all segments' axes are the world's: x to the person's left, y to the back, z up (H-Anim's own axes,
laid down so that z is up), a T-pose unless the skeleton came from a file with another. Rotations are given against
that pose.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import InputError

Array = NDArray[np.floating[Any]]
NO_LIMIT = np.pi
LOOSE = np.deg2rad(90.0)
"""Limits and habit of a component of which nothing is known (rad)."""


@dataclass(frozen=True)
class Site:
    """A place on a segment: the end of a bone, or where a foot touches the floor (m, segment's axes)."""

    name: str
    joint: int
    place_m: tuple[float, float, float]


@dataclass(frozen=True)
class Skeleton:
    """Joints, parents before children; joint 0 is the root and the only one whose parent is −1.

    ``offsets_m`` (joints, 3): place in the parent's axes; ``free``, ``limits_rad`` (joints, 3, 2) and ``habit_rad``
    (joints, 3): of the turns about X, Y and Z; ``turns_about``: in which order, or "" for a ball (then the three are a
    rotation vector); ``segments``: names that marker sets use, and their joint;
    ``orders``: the Euler order that files show ("ZXY": first about Z); ``moving``: joints with channels of place.
    """

    name: str
    joints: tuple[str, ...]
    parents: tuple[int, ...]
    offsets_m: Array
    sites: tuple[Site, ...] = ()
    turns_about: tuple[str, ...] = ()
    free: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, 3), bool))
    limits_rad: Array = field(default_factory=lambda: np.zeros((0, 3, 2)))
    habit_rad: Array = field(default_factory=lambda: np.zeros((0, 3)))
    segments: dict[str, int] = field(default_factory=dict)
    aliases: dict[str, str] = field(default_factory=dict)
    orders: tuple[str, ...] = ()
    moving: tuple[int, ...] = ()
    stature_m: float | None = None

    def __post_init__(self) -> None:
        """Complete what was left out, and refuse a tree that is none."""
        n = len(self.joints)
        fill = {
            "free": np.ones((n, 3), bool),
            "limits_rad": np.tile([-NO_LIMIT, NO_LIMIT], (n, 3, 1)),
            "habit_rad": np.full((n, 3), LOOSE),
        }
        for key, value in fill.items():
            if len(getattr(self, key)) == 0:
                object.__setattr__(self, key, value)
        if not self.orders:
            object.__setattr__(self, "orders", ("ZXY",) * n)
        if not self.turns_about:
            object.__setattr__(self, "turns_about", ("",) * n)
        check_tree(self.name, self.joints, self.parents)

    def __len__(self) -> int:
        """Return the number of joints."""
        return len(self.joints)

    def index(self, name: str) -> int:
        """A joint by its name, its other name, or the name of its segment; −1 where there is none."""
        if name in self.joints:
            return self.joints.index(name)
        if name in self.aliases:
            return self.joints.index(self.aliases[name])
        return self.segments.get(name, -1)

    def children(self, joint: int) -> list[int]:
        """The joints that hang from one."""
        return [j for j, p in enumerate(self.parents) if p == joint]

    def above(self, joint: int) -> list[int]:
        """The joints that one hangs from, the nearest first, the root last."""
        way: list[int] = []
        while (joint := self.parents[joint]) >= 0:
            way.append(joint)
        return way

    def bone_lengths_m(self) -> Array:
        """The distance of every joint from its parent (m)."""
        return np.linalg.norm(self.offsets_m, axis=1)

    def places_m(self) -> Array:
        """Every joint's place in the rest pose, from the root (m)."""
        places = np.zeros((len(self), 3))
        for j, p in enumerate(self.parents):
            if p >= 0:
                places[j] = places[p] + self.offsets_m[j]
        return places

    def scaled(self, factor: float) -> Skeleton:
        """The same skeleton in another size."""
        return replace(
            self,
            offsets_m=self.offsets_m * factor,
            sites=tuple(replace(s, place_m=tuple(v * factor for v in s.place_m)) for s in self.sites),
            stature_m=None if self.stature_m is None else self.stature_m * factor,
        )

    def mirrored(self) -> list[tuple[int, int]]:
        """Joints of the left with their fellows of the right."""
        pairs = []
        for j, name in enumerate(self.joints):
            for left, right in (("l_", "r_"), ("Left", "Right"), ("left", "right"), ("L_", "R_")):
                if name.startswith(left) and right + name[len(left) :] in self.joints:
                    pairs.append((j, self.joints.index(right + name[len(left) :])))
                    break
        return pairs


def check_tree(name: str, joints: tuple[str, ...], parents: tuple[int, ...]) -> None:
    """Refuse names that are there twice, several roots, and children before their parents."""
    if not joints:
        raise InputError(f"skeleton '{name}' has no joint")
    twice = sorted({j for j in joints if joints.count(j) > 1})
    if twice:
        raise InputError(f"skeleton '{name}': joint '{twice[0]}' is there twice")
    for j, p in enumerate(parents):
        if (p < 0) != (j == 0):
            raise InputError(f"skeleton '{name}': joint '{joints[j]}' is a second root")
        if p >= j:
            raise InputError(f"skeleton '{name}': joint '{joints[j]}' comes before its parent")


def in_order(names: list[str], parent_of: dict[str, str | None], what: str) -> list[str]:
    """Names sorted so that parents come before children, otherwise as they were. Refuses cycles and unknown parents."""
    done: list[str] = []
    for name in names:
        way: list[str] = []
        at: str | None = name
        while at is not None and at not in done:
            if at in way:
                raise InputError(f"{what}: the joints {' → '.join([*way[way.index(at) :], at])} hang from each other")
            if at not in parent_of:
                raise InputError(f"{what}: joint '{way[-1]}' hangs from '{at}', which is not there")
            way.append(at)
            at = parent_of[at]
        done += reversed(way)
    return done
