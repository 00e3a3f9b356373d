"""Simple operations on clips: mirrored, cropped, looped, on the spot."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from markerloom.errors import InputError
from markerloom.motion.alike import clouds, distances, laid
from markerloom.motion.bands import low_passed
from markerloom.motion.blend import BLEND_S, Joined, begun, eased, finished, mixed
from markerloom.motion.body import SIDES, body_of, split_name
from markerloom.motion.edited import Edited, at_frames, glued
from markerloom.motion.feet import Plant
from markerloom.motion.rotations import about_vertical
from markerloom.motion.upright import standing_rest, stands
from markerloom.skeleton.motion import Motion, with_rest
from markerloom.skeleton.skeleton import Skeleton

Array = NDArray[np.floating[Any]]
PATH_HZ = 0.5
"""The way somebody walks is slower than this; what is faster is how they sway on it."""
SHORTEST_LOOP_S = 0.5
SAME_M = 1e-9


def crop(
    motion: Motion,
    *,
    start: int | None = None,
    stop: int | None = None,
    from_s: float | None = None,
    to_s: float | None = None,
) -> Edited:
    """Frames from ``start`` to before ``stop`` (by number), or from one time to another (s from the beginning)."""
    low = motion.first_frame if start is None else start
    high = motion.first_frame + len(motion) if stop is None else stop
    if from_s is not None:
        low = motion.first_frame + round(from_s * motion.rate_hz)
    if to_s is not None:
        high = motion.first_frame + round(to_s * motion.rate_hz)
    if not motion.first_frame <= low < high <= motion.first_frame + len(motion):
        raise InputError(
            f"there is nothing from frame {low} to before frame {high} in '{motion.source}', which begins with frame "
            f"{motion.first_frame} and ends before frame {motion.first_frame + len(motion)}"
        )
    out = motion.select(low, high)
    return Edited(out, {"frames_in_out": [len(motion), len(out)], "warnings": []})


def in_place(motion: Motion) -> Edited:
    """The motion on the spot: its way over the floor is taken out, how it sways on it stays."""
    way = low_passed(motion.root_m[:, :2], motion.rate_hz, PATH_HZ)
    root_m = motion.root_m.copy()
    root_m[:, :2] += way[0] - way
    travel = float(np.linalg.norm(way[-1] - way[0])) if len(way) else 0.0
    return Edited(replace(motion, root_m=root_m), {"travel_m": travel, "warnings": []})


def mirror(motion: Motion) -> Edited:
    """Left and right exchanged, as in a mirror across the body that stands where the motion begins.

    The bones stay those of the skeleton; where its sides differ, joints land off the exact mirror image, by as much as
    the report says. Raises ``InputError`` where no joint has a fellow on the other side.
    """
    fellow = mirrored_joints(motion.skeleton)
    if all(j == k for j, k in enumerate(fellow)):
        names = ", ".join(motion.skeleton.joints)
        raise InputError(f"no joint of '{motion.skeleton.name}' has a fellow on the other side: {names}")
    body = body_of(motion.skeleton)
    rest = None if body.missing() or stands(body) else standing_rest(motion, body)
    plain = motion if rest is None else with_rest(motion, rest)
    flip = _flip(body_of(plain.skeleton).lateral())
    turn = plain.segments()[0]
    world = flip @ turn[:, fellow] @ flip @ _alike(plain.skeleton, fellow, flip)
    turns = world.copy()
    for j, p in enumerate(plain.skeleton.parents):
        if p >= 0:
            turns[:, j] = np.swapaxes(world[:, p], 1, 2) @ world[:, j]
    start = motion.root_m[0] * np.array([1.0, 1.0, 0.0])
    root_m = (plain.root_m - start) @ flip + start
    sigma, kind = motion.sigma_mm[:, fellow], motion.kind[:, fellow]
    out = replace(plain, turns=turns, root_m=root_m, sigma_mm=sigma, kind=kind)
    exact = (plain.joints_m()[:, fellow] - start) @ flip + start
    worst = 1000.0 * float(np.linalg.norm(out.joints_m() - exact, axis=2).max(initial=0.0))
    if rest is not None:
        out = replace(with_rest(out, np.swapaxes(rest, 1, 2)), skeleton=motion.skeleton)
    pairs = sum(j != k for j, k in enumerate(fellow)) // 2
    warnings = (
        [f"the skeleton's sides differ: joints are up to {worst:.0f} mm off the mirror image"] if worst > 20.0 else []
    )
    return Edited(out, {"pairs": pairs, "off_mirror_mm": worst, "warnings": warnings})


def _flip(side: Array) -> Array:
    """The mirror across the plane that a body's left side is normal to; upright bodies are mirrored across an upright
    plane.
    """
    flat = side * np.array([1.0, 1.0, 0.0]) if np.linalg.norm(side[:2]) > 0.5 else side
    flat = flat / np.linalg.norm(flat)
    return np.eye(3) - 2.0 * np.outer(flat, flat)


def _alike(skeleton: Skeleton, fellow: list[int], flip: Array) -> Array:
    """Turns (joints, 3, 3) that lay each segment's own bones onto the mirrored bones of its fellow."""
    out = np.tile(np.eye(3), (len(skeleton), 1, 1))
    for j in range(len(skeleton)):
        own = np.array([skeleton.offsets_m[c] for c in skeleton.children(j)]).reshape(-1, 3)
        other = np.array([skeleton.offsets_m[fellow[c]] for c in skeleton.children(j)]).reshape(-1, 3) @ flip
        if len(own) and np.abs(own - other).max() > SAME_M and np.linalg.norm(own, axis=1).max() > SAME_M:
            if np.linalg.matrix_rank(own, tol=1e-3 * np.abs(own).max()) < 2:
                longest = int(np.argmax(np.linalg.norm(own, axis=1)))
                own, other = own[longest], other[longest]
            out[j] = Rotation.align_vectors(other, own)[0].as_matrix()
    return out


def mirrored_joints(skeleton: Skeleton) -> list[int]:
    """Of every joint its fellow of the other side; of others themselves. Fellows have the same name but for the side,
    or are the same part of the body, and hang from fellows.
    """
    words = [split_name(name) for name in skeleton.joints]
    plain = [_without_side(name, side) for name, (side, _) in zip(skeleton.joints, words, strict=True)]
    parts = {j: part for part, j in body_of(skeleton).parts.items()}
    out = list(range(len(skeleton)))
    for j, (side, _) in enumerate(words):
        if side not in SIDES:
            continue
        other = SIDES[1 - SIDES.index(side)]
        for k, (their_side, _) in enumerate(words):
            same_part = j in parts and parts.get(k) == parts[j].replace(side, other)
            if (
                their_side == other
                and (plain[j] == plain[k] or same_part)
                and out[skeleton.parents[j]] == skeleton.parents[k]
            ):
                out[j] = k
                break
    return out


def _without_side(name: str, side: str) -> str:
    lower = name.rpartition(":")[2].lower()
    if side and side in lower:
        return lower.replace(side, "", 1)
    pieces = lower.replace(".", "_").replace("-", "_").split("_")
    return "_".join(p for p in pieces if p != side[:1]) if len(pieces) > 1 else lower[1:] if side else lower


def loop(
    motion: Motion,
    *,
    times: int = 1,
    length_s: float = BLEND_S,
    start: int | None = None,
    stop: int | None = None,
    on_the_spot: bool = False,
    hold_feet: bool = True,
) -> Edited:
    """A part of a clip that can be repeated without end, ``times`` times: the end fades into what comes before the
    beginning, laid onto it. ``start`` and ``stop`` (frames of the clip, from 0) are found where they are most alike
    unless given.
    """
    length = min(round(length_s * motion.rate_hz), (len(motion) - 1) // 3)
    if length < 2 or times < 1:
        raise InputError(f"a clip of {len(motion)} frames is too short to loop over a fade of {length_s:g} s")
    i, j = _ends(motion, length, start, stop)
    turn, shift, away = clouds(motion).alignment(j, clouds(motion), i)
    before = laid(motion, turn, np.array(shift))
    fade = mixed(at_frames(motion, slice(j - length, j)), at_frames(before, slice(i - length, i)), eased(length))
    cycle = glued([at_frames(motion, slice(i, j - length)), fade])
    done = _repeated(motion, cycle, (turn, np.array(shift)), times, i, length)
    out = finished(done, hold_feet=hold_feet)
    final = in_place(out.motion).motion if on_the_spot else out.motion
    report = {"start": i, "stop": j, "seconds": (j - i) / motion.rate_hz, "distance": away, "times": times}
    return Edited(final, {**report, **out.report})


def _ends(motion: Motion, length: int, start: int | None, stop: int | None) -> tuple[int, int]:
    """First frame of the loop and the one that it comes round to."""
    shortest = max(length + 1, round(SHORTEST_LOOP_S * motion.rate_hz))
    if start is not None and stop is not None:
        if not length <= start < stop - length or stop >= len(motion):
            raise InputError(
                f"a loop of frames {start}:{stop}, {length} frames of fade, is not in a clip of {len(motion)} frames"
            )
        return start, stop
    table = distances(motion, motion)
    i, j = np.indices(table.shape)
    table = np.where((j - i < shortest) | (i < length), np.inf, table)
    # A still stretch is like itself: of ways that are as alike, the one that moves counts.
    table = table + STILL_M * np.exp(-_moved(motion)[None] + _moved(motion)[:, None])
    if start is not None:
        table[np.arange(len(table)) != start] = np.inf
    if stop is not None:
        table[:, np.arange(len(table)) != stop] = np.inf
    if not np.isfinite(table).any():
        raise InputError(f"no loop of at least {shortest} frames fits into the clip of {len(motion)} frames")
    best = np.unravel_index(int(np.argmin(table)), table.shape)
    return int(best[0]), int(best[1])


STILL_M = 0.05
"""A loop in which nothing moves counts as this far from a good one (m)."""


def _moved(motion: Motion) -> Array:
    """How far all joints have moved since the beginning, in lengths of the body (frames)."""
    places = motion.joints_m() - motion.root_m[:, None]
    steps = np.linalg.norm(np.diff(places, axis=0), axis=2).mean(axis=1)
    size = max(float(np.ptp(places[0], axis=0).max()), 1e-9)
    return np.concatenate([[0.0], np.cumsum(steps)]) / (0.2 * size)


def _repeated(motion: Motion, cycle: Motion, step: tuple[float, Array], times: int, start: int, length: int) -> Joined:
    """The cycle over and over, each time laid onto the end of the one before; and the source's stances in it."""
    period = len(cycle)
    rounds, turn, shift = [], 0.0, np.zeros(2)
    for _ in range(times):
        rounds.append(laid(cycle, turn, shift))
        shift = about_vertical(turn)[:2, :2] @ step[1] + shift
        turn += step[0]
    stances = [p for p in begun(motion).plants if p.stop > start and p.start < start + period]
    plants = []
    for n in range(times):
        for p in stances:
            a, b = max(p.start - start, 0), min(p.stop - start, period - length // 2)
            if b - a >= 3:
                plants.append(Plant(p.site, a + n * period, b + n * period))
    one = start + np.arange(period, dtype=float)
    back = np.where(np.arange(period) >= period - length, one - period, np.nan)
    joins = tuple((n * period + period - length, (n + 1) * period) for n in range(times))
    frames = (np.tile(one, times), np.tile(back, times))
    return Joined(glued(rounds), (motion, motion), frames, joins, tuple(plants))
