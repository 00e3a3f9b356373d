"""Feet that stand are held where they stand, and none enters the floor (after Kovar, Schreiner & Gleicher 2002).

Unlike there, bones keep their lengths: the root gives way a little instead, so that knees do not pop; and the change is
found for all frames together, so that it eases in and out by itself.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import InputError
from markerloom.motion.body import SIDES, Body, body_of
from markerloom.motion.edited import Edited, moved_mm, sharpness
from markerloom.motion.feet import Feet, Plant, feet_of, find_plants, floor_m, placed, slides
from markerloom.motion.spacetime import (
    calmly_changed,
    changed,
    floor_goals,
    knee_goals,
    leg_freedoms,
    plant_goals,
    straightness,
)
from markerloom.skeleton.motion import Motion

Array = NDArray[np.floating[Any]]
LEAST_FRAMES = 4
EASILY = 0.2
"""A motion on its own body changes no further around its stances than it must."""


def footlock(motion: Motion, *, plants: list[Plant] | None = None, floor: float | None = None) -> Edited:
    """The motion with its standing feet held; ``plants``: found unless given; ``floor``: its height (m), found from the
    standing feet unless given. Raises ``InputError`` where the skeleton's legs cannot be told.
    """
    body = body_of(motion.skeleton)
    feet = feet_of(body)
    check_length(motion)
    own = find_plants(motion, feet) if plants is None else check_plants(plants, motion, feet)
    height = floor_m(motion, feet, own) if floor is None else floor
    held = placed(motion, feet, own, height)
    before = slides(motion, feet, held, height)
    out, missed = held_feet(motion, body, feet, held, height)
    return Edited(out, foot_report(motion, out, body, feet, held, height, missed) | {"before": before})


def check_length(motion: Motion) -> None:
    """Refuse clips that are too short for anything to stand in them."""
    if len(motion) < LEAST_FRAMES:
        raise InputError(f"a clip of {len(motion)} frames is too short to hold feet in ({motion.source})")


def check_plants(plants: list[Plant], motion: Motion, feet: Feet) -> list[Plant]:
    """Refuse plants of places that are not there, and frames outside of the clip."""
    for p in plants:
        if p.site not in feet.stand:
            raise InputError(f"no foot has a place '{p.site}': {', '.join(feet.stand)}")
        if not 0 <= p.start < p.stop <= len(motion):
            raise InputError(f"'{p.site}' stands in frames {p.start}:{p.stop}, which are not in the clip")
    return plants


def held_feet(
    motion: Motion,
    body: Body,
    feet: Feet,
    plants: list[Plant],
    floor: float,
    *,
    easily: float = EASILY,
    allowed: Array | None = None,
) -> tuple[Motion, dict[str, float]]:
    """The motion with feet held, and by how much plants, floor and knees are missed (mm, the largest).

    ``allowed``: how sharp joints may get by it (frames, joints; m/s²), if that matters.
    """
    goals = plant_goals(feet, plants), floor_goals(motion, feet, plants, floor), knee_goals(motion, body)
    free, every = leg_freedoms(motion, body, feet, easily=easily), [g for part in goals for g in part]
    solved = changed(motion, free, every) if allowed is None else calmly_changed(motion, free, every, allowed)
    edges = np.cumsum([len(part) for part in goals])[:-1]
    parts = np.split(1000.0 * solved.missed_m, edges)
    missed = {k: float(part.max(initial=0.0)) for k, part in zip(("plants", "floor", "knees"), parts, strict=True)}
    return solved.motion, missed


def foot_report(
    before: Motion,
    after: Motion,
    body: Body,
    feet: Feet,
    plants: list[Plant],
    floor: float,
    missed_mm: dict[str, float],
) -> dict[str, Any]:
    """What holding feet has changed."""
    stands = {f for p in plants for f in range(p.start, p.stop)}
    off = 1000.0 * np.linalg.norm(after.joints_m() - before.joints_m(), axis=2).max(axis=1)
    elsewhere = off[[f for f in range(len(before)) if f not in stands]]
    sharp = sharpness(after, [(before, np.arange(len(after), dtype=float))])
    longest = max(float(straightness(after, body, side).max()) for side in SIDES)
    return {
        **slides(after, feet, plants, floor),
        "floor_m": floor,
        "missed_mm": missed_mm,
        "moved_mm": moved_mm(before, after),
        "moved_elsewhere_mm": float(elsewhere.max(initial=0.0)),
        "sharpness": float(sharp.max(initial=0.0)),
        "straightest_leg": longest,
        "leg_stretch": 0.0,
        "warnings": [],
    }
