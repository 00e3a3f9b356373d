"""What must hold when a motion goes onto another body: feet that stand, hands that touch or hold, looks, the floor.

Found in the source, kept as TOML for editing. Frames are those of the clip, from 0; names are parts of the body.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import FormatError, InputError
from markerloom.formats.files import read_text, write_text
from markerloom.motion.body import SIDES, Body
from markerloom.motion.feet import USUAL_LEG_M, Plant, feet_of, find_plants, floor_m
from markerloom.motion.looks import find_looks
from markerloom.motion.upright import stands
from markerloom.skeleton.contacts import runs
from markerloom.skeleton.motion import Motion

Array = NDArray[np.floating[Any]]
TOUCH_M, TOUCH_S, TOUCH_SLOW = 0.18, 0.25, 0.25
"""Hands touch while their joints are nearer than this for so long (s) and move against each other more slowly (m/s)."""
HOLD_M, HOLD_S, HOLD_MOVES_M = 0.03, 0.4, 0.10
"""A hand holds on while it stays within this for so long (s), and the hips move by more than that meanwhile."""


@dataclass(frozen=True)
class Touch:
    """Two parts that keep how they lie to each other, as much as sizes allow: hands together."""

    a: str
    b: str
    start: int
    stop: int


@dataclass(frozen=True)
class Hold:
    """A part that stays where it is: a hand on a table; ``where_m``: where (m, world), if that is said."""

    part: str
    start: int
    stop: int
    where_m: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Look:
    """The head faces one place; ``where_m``: which (m, world), if that is said; otherwise what it faces anyway."""

    start: int
    stop: int
    where_m: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Constraints:
    """Everything that must hold; ``floor_m``: height of the floor (m), found from the feet where it is ``None``."""

    plants: tuple[Plant, ...] = ()
    touches: tuple[Touch, ...] = ()
    holds: tuple[Hold, ...] = ()
    looks: tuple[Look, ...] = ()
    floor_m: float | None = None


def find_constraints(motion: Motion, body: Body) -> Constraints:
    """What holds in a motion: feet that stand, the floor, hands together, hands that stay while the body moves, and
    what the head looks at, where the rest pose is one of somebody who stands and faces ahead.
    """
    feet = feet_of(body)
    plants = find_plants(motion, feet)
    scale = body.leg_m() / USUAL_LEG_M
    hands = {side: motion.joints_m()[:, body.parts[f"{side}_hand"]] for side in SIDES if f"{side}_hand" in body.parts}
    touches: list[Touch] = []
    if len(hands) == 2:
        apart = hands["left"] - hands["right"]
        speed = np.linalg.norm(np.gradient(apart, axis=0), axis=1) * motion.rate_hz if len(apart) > 2 else apart[:, 0]
        near = (np.linalg.norm(apart, axis=1) < TOUCH_M * scale) & (speed < TOUCH_SLOW * scale)
        least = TOUCH_S * motion.rate_hz
        touches = [Touch("left_hand", "right_hand", a, b) for a, b in runs(near) if b - a >= least]
    holds = [
        Hold(f"{side}_hand", a, b)
        for side, places in hands.items()
        for a, b in _stays(places, motion.root_m, HOLD_M * scale, HOLD_S * motion.rate_hz, HOLD_MOVES_M * scale)
    ]
    looks = tuple(Look(a, b) for a, b in find_looks(motion, body, scale)) if stands(body) else ()
    return Constraints(tuple(plants), tuple(touches), tuple(holds), looks, floor_m(motion, feet, plants))


def _stays(places: Array, body: Array, within: float, least: float, moves: float) -> list[tuple[int, int]]:
    """Stretches in which a place stays within a box while the body does not."""
    out, start = [], 0
    for f in range(1, len(places) + 1):
        if f == len(places) or np.linalg.norm(np.ptp(places[start : f + 1], axis=0)) > within:
            if f - start >= least and np.linalg.norm(np.ptp(body[start:f], axis=0)) > moves:
                out.append((start, f))
            start = f
    return out


KINDS: dict[str, type] = {"plants": Plant, "touches": Touch, "holds": Hold, "looks": Look}


def write_constraints(constraints: Constraints, path: str | Path) -> None:
    """Write constraints as TOML, places in mm."""
    lines = ["# What must hold when the motion goes onto another body. Frames are those of the clip, from 0."]
    if constraints.floor_m is not None:
        lines.append(f"floor_mm = {1000.0 * constraints.floor_m:.3f}")
    for kind in KINDS:
        for item in getattr(constraints, kind):
            lines += ["", f"[[{kind}]]"]
            for f in fields(item):
                value = getattr(item, f.name)
                if f.name == "where_m":
                    if value is not None:
                        lines.append("where_mm = [" + ", ".join(f"{1000.0 * v:.3f}" for v in value) + "]")
                else:
                    lines.append(f'{f.name} = "{value}"' if isinstance(value, str) else f"{f.name} = {value}")
    write_text(path, "\n".join(lines) + "\n")


def read_constraints(path: str | Path, frames: int) -> Constraints:
    """Constraints from TOML. Raises ``FormatError`` for what is not known, ``InputError`` for frames outside."""
    try:
        content = tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        raise FormatError(path, f"not a TOML file: {error}") from None
    unknown = sorted(set(content) - {*KINDS, "floor_mm"})
    if unknown:
        raise FormatError(path, f"does not know '{unknown[0]}': floor_mm, {', '.join(KINDS)}")
    parts: dict[str, tuple[Any, ...]] = {}
    for kind, made in KINDS.items():
        items = []
        for number, row in enumerate(content.get(kind, []), start=1):
            where = f"{kind} {number}"
            try:
                values = {k: v for k, v in row.items() if k != "where_mm"}
                if "where_mm" in row:
                    x, y, z = (float(v) / 1000.0 for v in row["where_mm"])
                    values["where_m"] = (x, y, z)
                item = made(**values)
                inside = 0 <= item.start < item.stop <= frames
            except (TypeError, ValueError, AttributeError):
                known = ", ".join(f.name.replace("_m", "_mm") for f in fields(made))
                raise FormatError(path, f"needs {known}", where=where) from None
            if not inside:
                raise InputError(
                    f"{path}: {where}: frames {item.start}:{item.stop} are not in a clip of {frames} frames"
                )
            items.append(item)
        parts[kind] = tuple(items)
    floor = content.get("floor_mm")
    return Constraints(**parts, floor_m=None if floor is None else float(floor) / 1000.0)
