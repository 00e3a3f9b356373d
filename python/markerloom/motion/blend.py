"""Clips joined: one fades into the next where they are most alike, or both go through a neutral pose.

Lecture notes, section 6.7.3. The next clip is laid onto the one before (turned about the vertical, moved on the floor);
over the interval turns go the shortest way from one to the other, weighted by a curve that is level at both ends.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import InputError
from markerloom.motion.alike import MEASURES, distances, laid, laid_onto
from markerloom.motion.body import body_of
from markerloom.motion.edited import (
    STILL,
    Edited,
    accelerations,
    at_frames,
    bounds,
    glued,
    near_or_usual,
    same_skeleton,
    sharpness,
)
from markerloom.motion.feet import Plant, feet_of, find_plants, floor_m, placed, slides, with_time
from markerloom.motion.footlock import held_feet
from markerloom.motion.rotations import exp, heading, log, unwrapped
from markerloom.motion.upright import stands
from markerloom.skeleton.motion import Motion

Array = NDArray[np.floating[Any]]
BLEND_S, LONGEST_S = 0.4, 1.5
"""How long one clip usually, and at most, fades into the next (s)."""
PEAK, STEEP = 5.78, 1.88
"""The largest acceleration and speed of the fading curve, for a fade over 1 from 0 to 1."""
CALM = 1.3
"""A fade is as long as it takes to be no more than so much sharper than its clips."""
ADDS = 0.4
"""A fade adds at most this part of the accelerations that the clips have at their joints."""
LATEST = 0.5
"""Without other wish a clip is left in the last half of it, and the next entered in its first half."""


@dataclass(frozen=True)
class Joined:
    """A motion in the making: where each of its frames comes from, and the stances that its clips bring."""

    motion: Motion
    clips: tuple[Motion, ...]
    frames: tuple[Array, ...]
    joins: tuple[tuple[int, int], ...]
    plants: tuple[Plant, ...]


def eased(steps: int) -> Array:
    """Weights from 0 to 1 (steps), level with no curvature at both ends, and without the ends themselves."""
    t = np.arange(1, steps + 1) / (steps + 1)
    return t * t * t * (t * (6.0 * t - 15.0) + 10.0)


def mixed(a: Motion, b: Motion, weights: Array) -> Motion:
    """Two motions of as many frames, frame by frame: places in a straight line, turns the shortest way."""
    way = unwrapped(log(np.swapaxes(a.turns, -1, -2) @ b.turns))
    turns = a.turns @ exp(way * weights[:, None, None])
    root_m = a.root_m + weights[:, None] * (b.root_m - a.root_m)
    return replace(a, root_m=root_m, turns=turns, kind=np.ones_like(a.kind), sigma_mm=np.full(a.kind.shape, np.nan))


def begun(motion: Motion) -> Joined:
    """The first clip of several."""
    clip = replace(motion, first_frame=0)
    return Joined(clip, (clip,), (np.arange(len(clip), dtype=float),), (), tuple(_stances(clip)))


def _stances(motion: Motion) -> list[Plant]:
    body = body_of(motion.skeleton)
    if body.missing():
        return []
    return find_plants(motion, feet_of(body))


def joined(
    before: Joined,
    clip: Motion,
    leave: int,
    enter: int,
    length: int,
    *,
    plants: list[Plant] | None = None,
    free_feet: bool = False,
) -> Joined:
    """Another clip at the end: frame ``leave`` of what is there begins to fade into frame ``enter`` of the clip, over
    ``length`` frames. ``plants``: stances of the clip, found unless given; ``free_feet``: none holds within the fade.
    """
    own = _stances(clip) if plants is None else plants
    head, tail = before.motion, clip
    mid = length // 2
    placed_tail = laid_onto(head, min(leave + mid, len(head) - 1), tail, min(enter + mid, len(tail) - 1))
    fade = mixed(_span(head, leave, leave + length), _span(placed_tail, enter, enter + length), eased(length))
    parts = (_span(head, 0, leave), fade, _span(placed_tail, enter + length, len(tail)))
    motion = glued(list(parts))
    rest = len(motion) - leave
    come = tuple(np.concatenate([f[: leave + length], np.full(rest - length, np.nan)]) for f in before.frames)
    new = np.concatenate([np.full(leave, np.nan), enter + np.arange(rest, dtype=float)])
    met = set() if free_feet else _met_sites(before.plants, own, (head, placed_tail), (leave + mid, enter + mid))
    out, into = (0, length) if free_feet else (round(MOSTLY * length), length - round(MOSTLY * length))
    kept = [_cut(p, 0, leave + (mid if p.site in met else out), 0) for p in before.plants]
    added = [_cut(p, enter + (mid if p.site in met else into), len(tail), leave - enter) for p in own]
    stances = [p for p in (*kept, *added) if p.stop - p.start >= 3]
    joins = (*before.joins, (leave, leave + length))
    return Joined(motion, (*before.clips, replace(clip, first_frame=0)), (*come, new), joins, tuple(_met(stances)))


MOSTLY = 0.3
"""A stance of one clip holds within the part of a fade in which that clip still counts for most."""
MEETS_M = 0.04
"""A place that stands on both sides of a join stays where it is if both are nearer than this, in the size of usual
legs. One that stands on one side only, or elsewhere, is free to go while the clips fade."""


def _met_sites(
    before: tuple[Plant, ...], after: list[Plant], clips: tuple[Motion, Motion], at: tuple[int, int]
) -> set[str]:
    """Places that stand on both sides of a join in the same spot."""
    sites = {p.site for p in before if p.start <= at[0] < p.stop} & {p.site for p in after if p.start <= at[1] < p.stop}
    if not sites:
        return set()
    feet = feet_of(body_of(clips[0].skeleton))
    spots = [feet.world_m(_span(clip, frame, frame + 1)) for clip, frame in zip(clips, at, strict=True)]
    return {s for s in sites if np.linalg.norm(spots[0][s][0] - spots[1][s][0]) < MEETS_M * feet.scale}


def _span(motion: Motion, start: int, stop: int) -> Motion:
    """Frames of a motion; beyond its end it goes on as it ends."""
    return at_frames(motion, np.minimum(np.arange(start, stop), len(motion) - 1))


def _cut(plant: Plant, start: int, stop: int, shift: int) -> Plant:
    """A stance within some frames, in the frames of the joined motion."""
    return replace(plant, start=max(plant.start, start) + shift, stop=max(min(plant.stop, stop), start) + shift)


def _met(plants: list[Plant]) -> list[Plant]:
    """Stances of one place that meet at a join are one."""
    out: list[Plant] = []
    for plant in sorted(plants, key=lambda p: (p.site, p.start)):
        if out and out[-1].site == plant.site and plant.start <= out[-1].stop:
            out[-1] = replace(out[-1], stop=max(out[-1].stop, plant.stop))
        else:
            out.append(plant)
    return sorted(out, key=lambda p: (p.start, p.site))


def finished(done: Joined, *, hold_feet: bool = True) -> Edited:
    """The joined motion with its feet held, and the report of its joins."""
    motion, missed = done.motion, {}
    body = body_of(motion.skeleton)
    feet_report: dict[str, Any] = {}
    allowed = bounds(list(zip(done.clips, done.frames, strict=True)), len(motion))
    if hold_feet and not body.missing() and len(motion) > 3:
        feet = feet_of(body)
        floor = min(floor_m(clip, feet, find_plants(clip, feet)) for clip in done.clips)
        plants = with_time(placed(motion, feet, list(done.plants), floor), feet, allowed, motion.rate_hz)
        motion, missed = held_feet(motion, body, feet, plants, floor, easily=1.0, allowed=allowed)
        feet_report = slides(motion, feet, plants, floor)
    sharp = accelerations(motion) / allowed
    rows = [
        {"from": a, "to": b, "sharpness": float(sharp[max(a - 2, 0) : b + 2].max(initial=0.0))} for a, b in done.joins
    ]
    worst = float(sharp.max(initial=0.0))
    return Edited(motion, {"joins": rows, **feet_report, "missed_mm": missed, "sharpness": worst, "warnings": []})


def fade_length(a: Motion, leave: int, b: Motion, enter: int) -> int:
    """How many frames a fade takes so that it is no sharper than its clips: the further joints have to go and the
    calmer the clips are, the longer.
    """
    at = min(enter, len(b) - 1)
    other = laid_onto(a, leave, b, at)
    ours, theirs = a.joints_m(), other.joints_m()
    away = np.linalg.norm(ours[leave] - theirs[at], axis=1)
    i, j = min(leave, len(a) - 2), min(at, len(b) - 2)
    faster = np.linalg.norm((ours[i + 1] - ours[i]) - (theirs[j + 1] - theirs[j]), axis=1) * a.rate_hz
    calm = np.maximum(near_or_usual(accelerations(a)), STILL)[leave]
    calm = np.maximum(calm, near_or_usual(accelerations(b))[at])
    needed = max(np.sqrt(PEAK * away / (ADDS * calm)).max(), (STEEP * faster / (ADDS * calm)).max())
    return max(2, round(float(np.clip(needed, BLEND_S, LONGEST_S)) * a.rate_hz))


def calmly_joined(
    before: Joined,
    clip: Motion,
    length: int,
    where: Callable[[int], tuple[int, int]],
    longest: int,
    *,
    free_feet: bool = False,
) -> Joined:
    """Another clip at the end, its fade made longer until it is calm; ``where`` says, for a length, the frame to leave
    and the one to enter.
    """
    best: tuple[float, Joined] | None = None
    while True:
        leave, enter = where(length)
        out = joined(before, clip, leave, enter, length, free_feet=free_feet)
        sources = [(before.motion, out_of(leave + length, len(out.motion))), (clip, out.frames[-1])]
        sharp = float(sharpness(out.motion, sources)[max(leave - 2, 0) : leave + length + 2].max(initial=0.0))
        if best is None or sharp < best[0]:
            best = sharp, out
        if sharp <= CALM or length >= longest:
            return best[1]
        length = min(int(1.3 * length) + 1, longest)


def out_of(until: int, frames: int) -> Array:
    """Frames that come from as many of a clip, those from ``until`` on from none."""
    return np.where(np.arange(frames) < until, np.arange(frames, dtype=float), np.nan)


class Likeness:
    """How alike two clips are over intervals of any length (m, the mean distance of their frames)."""

    def __init__(self, a: Motion, b: Motion, measure: str = "cloud") -> None:
        """Compare all frames of one with all of the other."""
        if measure not in MEASURES:
            raise InputError(f"likeness is measured by {' or '.join(MEASURES)}, not '{measure}'")
        table = distances(a, b, measure)
        # Sums along diagonals, so that those of any interval are differences of two.
        self.sums = np.zeros((len(a) + 1, len(b) + 1))
        for i, row in enumerate(table):
            self.sums[i + 1, 1:] = self.sums[i, :-1] + row

    def over(self, leave: int, enter: int, length: int) -> float:
        """From these frames on."""
        return float((self.sums[leave + length, enter + length] - self.sums[leave, enter]) / length)

    def best(self, length: int) -> tuple[int, int]:
        """The first frames of the interval in which they are most alike: the first clip is left in its last half, the
        next entered in its first half.
        """
        ours, theirs = len(self.sums) - 1, len(self.sums[0]) - 1
        if min(ours, theirs) < length + 1:
            raise InputError(f"clips of {ours} and {theirs} frames are too short to fade over {length} frames")
        low = min(int(ours * LATEST), ours - length)
        high = min(max(int(theirs * (1.0 - LATEST)), 1), theirs - length)
        sums = self.sums[low + length :, length : high + length + 1] - self.sums[low : ours - length + 1, : high + 1]
        i, j = np.unravel_index(int(np.argmin(sums)), sums.shape)
        return low + int(i), int(j)


def blend(
    a: Motion,
    b: Motion,
    *,
    length_s: float | None = None,
    leave: int | None = None,
    enter: int | None = None,
    measure: str = "cloud",
    hold_feet: bool = True,
) -> Edited:
    """Two clips as one: the first fades into the second where they are most alike, or at given frames (from 0), over
    ``length_s`` or as long as it takes to be no sharper than the clips.

    Raises ``InputError`` for clips of other skeletons, sizes or rates, and for clips that are too short.
    """
    same_skeleton(a, b, "these clips cannot be blended")
    length = _length(BLEND_S if length_s is None else length_s, a.rate_hz)
    alike = Likeness(a, b, measure)

    def where(frames: int) -> tuple[int, int]:
        best = alike.best(frames) if leave is None or enter is None else (0, 0)
        return best[0] if leave is None else leave, best[1] if enter is None else enter

    at, into = where(length)
    if not 0 <= at <= len(a) - length or not 0 <= into <= len(b) - length:
        raise InputError(
            f"a fade of {length} frames from frame {at} to {into} is not in clips of {len(a)} and {len(b)} frames"
        )
    # A longer fade may be another interval, where there is room for it.
    room = min(len(a) - (leave or 0), len(b) - (enter or 0)) - 1
    longest = length if length_s is not None else max(length, min(room, round(LONGEST_S * a.rate_hz)))
    done = calmly_joined(begun(a), b, length, where, longest)
    start, stop = done.joins[-1]
    into = where(stop - start)[1]
    out = finished(done, hold_feet=hold_feet)
    told = {"leave": start, "enter": into, "distance": alike.over(start, into, stop - start)}
    return Edited(out.motion, {**told, **out.report})


def _length(length_s: float, rate_hz: float) -> int:
    length = round(length_s * rate_hz)
    if length < 2:
        raise InputError(f"a fade takes at least 2 frames; {length_s:g} s at {rate_hz:g} Hz is {length}")
    return length


def concatenate(clips: list[Motion], *, length_s: float | None = None, hold_feet: bool = True) -> Edited:
    """Clips one after the other, whole: each begins where the one before ends, and facing as it does; the end of one
    fades into the beginning of the next, over ``length_s`` or as long as it takes to be no sharper than the clips.
    """
    if len(clips) < 2:
        raise InputError("two clips or more are put after each other")
    done = begun(clips[0])
    for clip in clips[1:]:
        same_skeleton(clips[0], clip, f"'{clips[0].source}' and '{clip.source}' cannot be put after each other")
        done = _appended(done, clip, length_s)
    return finished(done, hold_feet=hold_feet)


def _appended(
    before: Joined, clip: Motion, length_s: float | None, *, end: int | None = None, free_feet: bool = False
) -> Joined:
    """A clip whose beginning fades in over the last frames before ``end``."""
    last = len(before.motion) if end is None else end
    longest = min(last - 1, len(clip) - 1)
    wanted = fade_length(before.motion, last - 1, clip, 0) if length_s is None else _length(length_s, clip.rate_hz)
    length = min(wanted, longest)
    if length < 2:
        raise InputError(f"'{clip.source}' is too short to be put after another clip")
    most = length if length_s is not None else min(longest, round(LONGEST_S * clip.rate_hz))
    return calmly_joined(before, clip, length, lambda n: (last - n, 0), max(most, length), free_feet=free_feet)


def through_neutral(
    clips: list[Motion],
    neutral: Motion | None = None,
    *,
    at: int = 0,
    length_s: float | None = None,
    hold_s: float = 0.3,
    hold_feet: bool = True,
) -> Edited:
    """Clips one after the other, each begun and ended in a neutral pose: frame ``at`` of ``neutral``, or the rest pose
    of the skeleton, where the clip before has ended.
    """
    if len(clips) < 2:
        raise InputError("two clips or more are joined through a neutral pose")
    if neutral is not None and not 0 <= at < len(neutral):
        raise InputError(f"the neutral pose is frame {at} of a clip of {len(neutral)} frames")
    hold = max(1, round(hold_s * clips[0].rate_hz))
    longest = round(LONGEST_S * clips[0].rate_hz)
    done = begun(clips[0])
    for clip in clips[1:]:
        same_skeleton(clips[0], clip, f"'{clips[0].source}' and '{clip.source}' cannot be joined")
        stay = _standing(done.motion, neutral, at, 2 * longest + hold)
        done = _appended(done, stay, length_s, free_feet=True)
        settled = done.joins[-1][1]
        done = _appended(done, clip, length_s, end=min(settled + hold + longest, len(done.motion)), free_feet=True)
    return finished(done, hold_feet=hold_feet)


def _standing(before: Motion, neutral: Motion | None, at: int, frames: int) -> Motion:
    """A clip that stays in the neutral pose, where another ends and facing as it does."""
    pose = replace(before, turns=before.turns[-1:].copy(), root_m=before.root_m[-1:].copy())
    body = body_of(before.skeleton)
    if neutral is not None:
        same_skeleton(before, neutral, "the neutral pose is of another skeleton")
        turns, height = neutral.turns[at].copy(), float(neutral.root_m[at, 2])
    else:
        if not body.missing() and not stands(body):
            raise InputError(
                f"the rest pose of '{before.skeleton.name}' is no pose to stand in: give the neutral pose as a clip"
            )
        turns = np.tile(np.eye(3), (len(before.skeleton), 1, 1))
        places = before.skeleton.places_m()
        sites = [places[s.joint][2] + s.place_m[2] for s in before.skeleton.sites]
        height = -min([*places[:, 2].tolist(), *sites]) + _floor(before)
    facing = heading(before.turns[-1:, 0], body.lateral())[0] - heading(turns[None, 0], body.lateral())[0]
    still = replace(
        pose,
        turns=np.tile(turns, (frames, 1, 1, 1)),
        root_m=np.tile([0.0, 0.0, height], (frames, 1)),
        kind=np.ones((frames, len(before.skeleton)), np.int64),
        sigma_mm=np.full((frames, len(before.skeleton)), np.nan),
        source="neutral pose",
    )
    return laid(still, facing, before.root_m[-1, :2])


def _floor(motion: Motion) -> float:
    body = body_of(motion.skeleton)
    if body.missing():
        return float(motion.joints_m()[..., 2].min())
    feet = feet_of(body)
    return floor_m(motion, feet, find_plants(motion, feet))
