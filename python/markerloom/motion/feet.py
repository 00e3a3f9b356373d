"""Feet of any skeleton: which places of them touch the floor, when these stand, and how high the floor is.

A skeleton that names its heels and balls is taken at its word; of another, the heel is its ankle and the ball where
its toes begin (or where the bone of the foot ends). A place stands while it is low and slow and stays within a small
ball (after Kovar, Schreiner & Gleicher 2002, "Footskate cleanup for motion capture editing").
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import InputError
from markerloom.motion.body import SIDES, Body
from markerloom.skeleton.contacts import FEET, LOW_M, SLOW_M_PER_S, STANDS_S, runs
from markerloom.skeleton.motion import Motion
from markerloom.skeleton.skeleton import Site, Skeleton

Array = NDArray[np.floating[Any]]
USUAL_LEG_M = 0.84
"""Distances and speeds of standing feet are those of somebody with legs of this length."""
STANDS_M_PER_S = 0.12
"""At the beginning and at the end of a stance a place is slower than this."""
STAYS_M = 0.015
"""While it stands, all its places are within this."""
STEADIER = np.array([1.0, 1.0, 3.0])
"""A place that stands moves less upwards than sideways: a heel that rises has begun to leave the floor."""
SLOWER = 2.0
"""In single frames a place that stands may be so many times as fast: over a stance it stays in its box."""
APART_S = 0.2
"""Between two stances of one place in different spots there is at least so much time."""
BELOW_M = 0.06
"""The floor is at most so far below the lowest place of a standing foot: joints are inside of feet."""
MOVE = 5.77
"""A move from rest to rest without jerks has so many times the acceleration of way over time squared (Flash and Hogan
1985)."""
TURNS_S, ALIKE_M, SHORTEST = 0.25, 1e-3, 3
"""A foot needs so long (s) to turn from a stance of one end to one of the other that is further from it than the foot
is long (m). A stance shorter than so many frames is none."""
NEAR_FLOOR_M = 0.12
"""Places higher than this above the floor cannot get into it by a small change."""


@dataclass(frozen=True)
class Plant:
    """A place of a foot that stands from frame ``start`` to before ``stop`` (frames of the clip, from 0); ``where_m``:
    where it must stand (world), if that is said.
    """

    site: str
    start: int
    stop: int
    where_m: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Feet:
    """Places of both feet, by name (``l_heel``, ``l_ball``, ``l_toe``, …), with the joint and the place on it (m).

    ``stand``: those that can stand; the others must only not enter the floor. ``scale``: size of the legs beside usual
    ones. ``span_m``: of a foot whose heel and ball keep their distance, that distance.
    """

    places: dict[str, tuple[int, Array]]
    stand: tuple[str, ...]
    scale: float
    span_m: dict[str, float]

    def world_m(self, motion: Motion) -> dict[str, Array]:
        """Where each place is (frames, 3; m, world)."""
        turn, place = motion.segments()
        return {
            name: place[:, joint] + turn[:, joint] @ np.asarray(local) for name, (joint, local) in self.places.items()
        }


def feet_of(body: Body) -> Feet:
    """The feet of a skeleton. Raises ``InputError`` where legs cannot be found."""
    skeleton = body.skeleton
    if body.missing():
        raise InputError(
            f"skeleton '{skeleton.name}': no joint was found for {', '.join(body.missing())}; its joints are "
            + ", ".join(skeleton.joints)
        )
    places: dict[str, tuple[int, Array]] = {}
    stand: list[str] = []
    for side in SIDES:
        ankle = body.parts[f"{side}_foot"]
        toes = body.parts.get(f"{side}_toes")
        own = _named(skeleton, side)
        if not own:
            own = {"heel": (ankle, np.zeros(3))}
            ends = [s for s in skeleton.sites if s.joint == (ankle if toes is None else toes) and _ends(skeleton, s)]
            if toes is not None:
                own["ball"] = (toes, np.zeros(3))
            if ends:
                own["ball" if toes is None else "toe"] = (ends[0].joint, np.array(ends[0].place_m))
        places |= {f"{side[0]}_{part}": place for part, place in own.items()}
        stand += [f"{side[0]}_{part}" for part in own if part in FEET]
    spans = {side: span for side in "lr" if (span := _span(skeleton, places, side)) is not None}
    return Feet(places, tuple(stand), body.leg_m() / USUAL_LEG_M, spans)


def _span(skeleton: Skeleton, places: dict[str, tuple[int, Array]], side: str) -> float | None:
    """Distance (m) of heel and ball, if they are on one segment, or the ball is the joint below the heel's."""
    if f"{side}_ball" not in places:
        return None
    (heel, at_heel), (ball, at_ball) = places[f"{side}_heel"], places[f"{side}_ball"]
    if heel == ball:
        return float(np.linalg.norm(at_ball - at_heel))
    if skeleton.parents[ball] == heel and not np.any(at_ball):
        return float(np.linalg.norm(skeleton.offsets_m[ball] - at_heel))
    return None


def _ends(skeleton: Skeleton, site: Site) -> bool:
    return not skeleton.children(site.joint) or bool(np.linalg.norm(site.place_m) > 1e-6)


def _named(skeleton: Skeleton, side: str) -> dict[str, tuple[int, Array]]:
    """Heel, ball and tip of the toes where the skeleton has them by name."""
    wanted = {f"{side[0]}_heel": "heel", f"{side[0]}_ball": "ball", f"{side[0]}_toe_tip": "toe"}
    found = {wanted[s.name]: (s.joint, np.array(s.place_m)) for s in skeleton.sites if s.name in wanted}
    return found if "heel" in found else {}


def find_plants(motion: Motion, feet: Feet) -> list[Plant]:
    """Where places of feet stand."""
    if len(motion) < 3:
        return []
    world = feet.world_m(motion)
    out: list[Plant] = []
    for name in feet.stand:
        places = world[name]
        smooth = _smoothed(places, motion.rate_hz)
        speed = np.linalg.norm(np.gradient(smooth, axis=0), axis=1) * motion.rate_hz
        low = smooth[:, 2] < np.percentile(smooth[:, 2], 3) + LOW_M * feet.scale
        shortest = max(3, round(STANDS_S * motion.rate_hz))
        apart = max(2, round(APART_S * motion.rate_hz))
        for first, last in runs(low & (speed < SLOWER * SLOW_M_PER_S * feet.scale)):
            spans = _still(places, first, last, STAYS_M * feet.scale, shortest, apart)
            trimmed = [_trimmed(speed, a, b, STANDS_M_PER_S * feet.scale, shortest) for a, b in spans]
            out += [Plant(name, a, b) for a, b in trimmed]
    return sorted(out, key=lambda p: (p.start, p.site))


def _smoothed(places: Array, rate_hz: float) -> Array:
    """A short average, so that noise is no speed."""
    half = max(1, round(0.02 * rate_hz))
    padded = np.pad(places, ((half, half), (0, 0)), mode="edge")
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0).mean(axis=2)


def _trimmed(speed: Array, first: int, last: int, slow: float, shortest: int) -> tuple[int, int]:
    """A stance without the frames in which the place has not quite come to rest, or begins to leave."""
    while last - first > shortest and speed[first] > slow:
        first += 1
    while last - first > shortest and speed[last - 1] > slow:
        last -= 1
    return first, last


def _still(places: Array, first: int, last: int, stays: float, shortest: int, apart: int) -> list[tuple[int, int]]:
    """Parts of a slow stretch in which the place stays within a box, the longest first, with time between them."""
    if last - first < shortest:
        return []
    best, start = (first, first), first
    for stop in range(first + 1, last + 1):
        while np.linalg.norm(np.ptp(places[start:stop], axis=0) * STEADIER) > stays:
            start += 1
        if stop - start > best[1] - best[0]:
            best = (start, stop)
    if best[1] - best[0] < shortest:
        return []
    before = _still(places, first, best[0] - apart, stays, shortest, apart)
    return [*before, best, *_still(places, best[1] + apart, last, stays, shortest, apart)]


def floor_m(motion: Motion, feet: Feet, plants: list[Plant]) -> float:
    """Height of the floor (m): as low as feet get, but hardly lower than where they stand (a foot that falls through
    the floor in a bad moment does not show where it is).
    """
    world = feet.world_m(motion)
    if not len(motion):
        return 0.0
    lowest = np.min(np.stack([places[:, 2] for places in world.values()]), axis=0)
    standing = sorted({f for p in plants for f in range(p.start, p.stop)})
    least = float(lowest.min())
    return max(least, float(np.median(lowest[standing])) - BELOW_M * feet.scale) if standing else least


def standing_heights(motion: Motion, feet: Feet, plants: list[Plant], floor: float) -> dict[str, float]:
    """How high above the floor each place usually is while it stands (m); places that never stand are left out."""
    world = feet.world_m(motion)
    heights: dict[str, list[float]] = {}
    for p in plants:
        heights.setdefault(p.site, []).extend(world[p.site][p.start : p.stop, 2] - floor)
    return {name: float(np.median(own)) for name, own in heights.items()}


def rest_heights(skeleton: Skeleton, feet: Feet) -> dict[str, float]:
    """How high above the lowest of them each place is in the rest pose (m), foot by foot."""
    at = skeleton.places_m()
    height = {name: float(at[joint][2] + local[2]) for name, (joint, local) in feet.places.items()}
    lowest = {side: min(h for name, h in height.items() if name[0] == side) for side in "lr"}
    return {name: h - lowest[name[0]] for name, h in height.items()}


def placed(
    motion: Motion, feet: Feet, plants: list[Plant], floor: float, height: Callable[[Plant], float] | None = None
) -> list[Plant]:
    """Plants with where they stand: at the middle of where they are, or at a given height (m, world), never below the
    floor. Two places of one foot that stand at the same time are as far from each other as the foot is long.
    """
    world = feet.world_m(motion)
    margin = max(2, round(TURNS_S * motion.rate_hz))
    done: list[Plant] = []
    for plant in sorted(plants, key=lambda p: (p.start - p.stop, p.start, p.site)):
        span = feet.span_m.get(plant.site[0])
        near = sorted((d for d in done if _same_foot(d, plant)), key=lambda d: -_overlap(d, plant))
        fellow = near[0] if near and _overlap(near[0], plant) > 0 else None
        where = world[plant.site][plant.start : plant.stop].mean(axis=0)
        where[2] = max(where[2] if height is None else height(plant), floor)
        if fellow is not None:
            where = _beside(np.array(fellow.where_m), where, span)
        if plant.where_m is not None:
            where = np.array(plant.where_m)
        others = [d for d in near if d is not fellow and _off_span(d, where, span) > ALIKE_M]
        kept = _without(plant, others, margin)
        if kept.stop - kept.start >= SHORTEST:
            done.append(replace(kept, where_m=(float(where[0]), float(where[1]), float(where[2]))))
    return sorted(done, key=lambda p: (p.start, p.site))


def with_time(plants: list[Plant], feet: Feet, allowed: Array, rate_hz: float) -> list[Plant]:
    """Placed plants that end earlier and begin later where a place has too little time to go from one to the next as
    calmly as it may (``allowed``: of every joint in every frame, m/s²). None loses more than half of its frames.
    """
    out = list(plants)
    for site in {p.site for p in plants}:
        own = [k for k, p in enumerate(plants) if p.site == site]
        for a, b in pairwise(own):
            way = float(np.linalg.norm(np.subtract(plants[b].where_m or (), plants[a].where_m or ())))
            between = slice(plants[a].stop, max(plants[b].start, plants[a].stop + 1))
            calm = float(allowed[between, feet.places[site][0]].max())
            wanted = np.sqrt(MOVE * way / calm) * rate_hz
            more = max(0, int(np.ceil(0.5 * (wanted - (plants[b].start - plants[a].stop)))))
            shorter = [min(more, (plants[k].stop - plants[k].start) // 4) for k in (a, b)]
            out[a] = replace(out[a], stop=out[a].stop - shorter[0])
            out[b] = replace(out[b], start=out[b].start + shorter[1])
    return [p for p in out if p.stop - p.start >= SHORTEST]


def _same_foot(a: Plant, b: Plant) -> bool:
    return a.site[0] == b.site[0] and a.site != b.site


def _overlap(a: Plant, b: Plant) -> int:
    return min(a.stop, b.stop) - max(a.start, b.start)


def _off_span(other: Plant, where: Array, span: float | None) -> float:
    return 0.0 if span is None else abs(float(np.linalg.norm(np.array(other.where_m) - where)) - span)


def _without(plant: Plant, others: list[Plant], margin: int) -> Plant:
    """A plant that leaves the frames of others alone, and those around them: a foot cannot keep its length to two
    stances of its other end, and needs time to turn from one to the next.
    """
    start, stop = plant.start, plant.stop
    for other in others:
        if other.start <= start:
            start = max(start, other.stop + margin)
        elif other.stop >= stop or other.start - start >= stop - other.stop:
            stop = min(stop, other.start - margin)
        else:
            start = max(start, other.stop + margin)
    start = min(start, plant.stop)
    return replace(plant, start=start, stop=max(stop, start))


def _beside(fixed: Array, wanted: Array, span: float | None) -> Array:
    """The point nearest to the wanted one at a distance from a fixed one, at the wanted height where it can be."""
    if span is None:
        return wanted
    flat = wanted[:2] - fixed[:2]
    length = float(np.linalg.norm(flat))
    rise = float(np.clip(wanted[2] - fixed[2], -0.95 * span, 0.95 * span))
    out = wanted.copy()
    out[:2] = fixed[:2] + flat / max(length, 1e-9) * np.sqrt(span**2 - rise**2)
    out[2] = fixed[2] + rise
    return out


def slides(motion: Motion, feet: Feet, plants: list[Plant], floor: float) -> dict[str, Any]:
    """How far standing places slide and sink from where they stand in the mean, and how deep any place of the feet gets
    into the floor (mm, the largest).
    """
    world = feet.world_m(motion)
    slide = [
        1000.0 * float(np.linalg.norm(own[:, :2] - own[:, :2].mean(axis=0), axis=1).max())
        for p in plants
        if len(own := world[p.site][p.start : p.stop])
    ]
    lowest = min((float(places[:, 2].min()) for places in world.values() if len(places)), default=floor)
    return {
        "plants": len(plants),
        "slide_mm": max(slide, default=0.0),
        "slide_median_mm": float(np.median(slide)) if slide else 0.0,
        "in_floor_mm": 1000.0 * max(0.0, floor - lowest),
    }
