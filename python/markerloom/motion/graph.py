"""Motion graphs (Kovar, Gleicher & Pighin 2002): new clips of any length from a library of clips.

Between all clips the moments that are most alike become transitions: local minima of the distance of clouds, below a
threshold. What does not lead back is pruned: only the largest part in which everything can be reached from everywhere
stays. A walk goes through it at random; a path is followed by a search that keeps the best beginnings.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from markerloom.errors import InputError
from markerloom.motion.alike import clouds, laid, minima
from markerloom.motion.blend import BLEND_S, Joined, eased, finished, joined, mixed
from markerloom.motion.edited import STILL, Edited, accelerations, at_frames, near_or_usual
from markerloom.motion.library import Library, Transition, of_clips, stances
from markerloom.motion.rotations import about_vertical
from markerloom.skeleton.motion import Motion

Array = NDArray[np.floating[Any]]
SEARCH_HZ = 30.0
"""Transitions are searched at about this rate, and then refined."""
CALM = 1.2
"""A fade adds to the accelerations of its clips, but they grow at most so many times."""
APART_S = 0.5
"""A transition to the same clip leads at least so far away in time; so long a clip is followed between two."""


def build(clips: list[Motion], *, threshold_m: float | None = None) -> Library:
    """A library of clips with the transitions between them.

    ``threshold_m``: largest distance of a transition's clouds; unless given, as far as clips move within half a fade.
    Raises ``InputError`` for clips that differ in skeleton or rate, and where nothing leads back to where it began.
    """
    own = of_clips(clips)
    fade = max(2, round(BLEND_S * own[0].rate_hz))
    short = next((c for c in own if len(c) < 2 * fade + 2), None)
    if short is not None:
        raise InputError(
            f"'{short.source}' is too short for a library: {len(short)} frames, of which a fade takes {fade}"
        )
    least = _usual_m(own, fade) if threshold_m is None else threshold_m
    moves = _transitions(own, fade, least)
    kept = pruned(moves, fade)
    if not kept:
        raise InputError(
            f"no moments of these clips are alike enough to go from one to another and back "
            f"(within {1000 * least:.0f} mm): add clips, or allow more"
        )
    return Library(tuple(own), stances(own), tuple(kept), fade)


def _usual_m(clips: list[Motion], fade: int) -> float:
    """How far clouds of moments half a fade apart are from each other (m), the median over all clips."""
    half = max(1, fade // 2)
    away = []
    for clip in clips:
        own = clouds(clip)
        away += [own.alignment(f, own, f + half)[2] for f in range(0, len(clip) - half, half)]
    return float(np.median(away))


def _transitions(clips: list[Motion], fade: int, least: float) -> list[Transition]:
    step = max(1, round(clips[0].rate_hz / SEARCH_HZ))
    coarse = [clouds(c, step) for c in clips]
    fine = [clouds(c) for c in clips]
    half = fade // 2
    apart = round(APART_S * clips[0].rate_hz)
    out: list[Transition] = []
    for a in range(len(clips)):
        for b in range(len(clips)):
            table = coarse[a].distances(coarse[b])
            for i, j in minima(table, 1.5 * least):
                middle, other, away = _refined(
                    fine[a], fine[b], (i * step, j * step), step, (len(clips[a]), len(clips[b]))
                )
                leave, enter = middle - half, other - half
                fits = leave >= 0 and enter >= 0 and leave + fade < len(clips[a]) and enter + fade < len(clips[b])
                if away > least or not fits or (a == b and abs(middle - other) < apart):
                    continue
                turn, shift, _ = fine[a].alignment(middle, fine[b], other)
                out.append(Transition(a, leave, b, enter, away, turn, (shift[0], shift[1])))
    calm = _Calm(clips, fade)
    kept = {t for t in out if calm.sharpness(t) <= CALM}
    return sorted(kept, key=lambda t: (t.from_clip, t.from_frame, t.to_clip, t.to_frame))


class _Calm:
    """How sharp fades would be, by joints that go straight from one clip to the other."""

    def __init__(self, clips: list[Motion], fade: int) -> None:
        self.places = [c.joints_m() for c in clips]
        self.bounds = [np.maximum(near_or_usual(accelerations(c)), STILL) for c in clips]
        self.weights = np.concatenate([[0.0, 0.0], eased(fade), [1.0, 1.0]])[:, None, None]
        self.fade, self.rate_hz = fade, clips[0].rate_hz

    def sharpness(self, move: Transition) -> float:
        """The largest acceleration over that of the clips around it."""
        spans = []
        for clip, frame in ((move.from_clip, move.from_frame), (move.to_clip, move.to_frame)):
            at = np.clip(np.arange(frame - 2, frame + self.fade + 2), 0, len(self.places[clip]) - 1)
            spans.append((self.places[clip][at], self.bounds[clip][at]))
        (one, calm), (two, other) = spans
        two = two @ about_vertical(move.turn_rad).T
        two[..., :2] += move.shift_m
        path = one + self.weights * (two - one)
        sharp = np.linalg.norm(path[2:] - 2.0 * path[1:-1] + path[:-2], axis=2) * self.rate_hz**2
        return float((sharp / np.maximum(calm, other)[1:-1]).max())


def _refined(a: Any, b: Any, at: tuple[int, int], step: int, frames: tuple[int, int]) -> tuple[int, int, float]:
    """The nearest minimum at the full rate."""
    i, j = at
    best = a.alignment(i, b, j)[2]
    for _ in range(2 * step):
        around = [(i + di, j + dj) for di in (-1, 0, 1) for dj in (-1, 0, 1) if di or dj]
        inside = [(p, q) for p, q in around if 0 <= p < frames[0] and 0 <= q < frames[1]]
        ways = [(a.alignment(p, b, q)[2], p, q) for p, q in inside]
        if min(ways)[0] >= best:
            break
        best, i, j = min(ways)
    return i, j, best


def pruned(moves: list[Transition], fade: int) -> list[Transition]:
    """The transitions of the largest strongly connected part: whatever is entered can be left again."""
    ends = sorted({(t.from_clip, t.from_frame) for t in moves} | {(t.to_clip, t.to_frame + fade) for t in moves})
    index = {end: k for k, end in enumerate(ends)}
    along = [(k, k + 1) for k in range(len(ends) - 1) if ends[k][0] == ends[k + 1][0]]
    across = [(index[t.from_clip, t.from_frame], index[t.to_clip, t.to_frame + fade]) for t in moves]
    edges = np.array([*along, *across], dtype=int).reshape(-1, 2)
    if not len(edges):
        return []
    net = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(len(ends), len(ends)))
    _, part = connected_components(net, directed=True, connection="strong")
    # The part in which clips are followed longest.
    length = np.zeros(part.max() + 1)
    for a, b in along:
        if part[a] == part[b]:
            length[part[a]] += ends[b][1] - ends[a][1]
    best = int(np.argmax(length))
    return [t for t, (a, b) in zip(moves, across, strict=True) if part[a] == best and part[b] == best]


@dataclass(frozen=True)
class Step:
    """A part of a way: a transition taken, and from where its clip was followed."""

    clip: int
    entered: int
    transition: Transition | None


def walk(library: Library, seconds: float, *, seed: int = 0, hold_feet: bool = True) -> Edited:
    """A random walk of so many seconds. The same seed gives the same walk."""
    frames = _frames(library, seconds)
    chance = np.random.default_rng(seed)
    exits = _exits(library)
    clip, at = _start(library, exits, chance)
    steps, length = [], 0
    while length < frames:
        nexts = [t for t in exits[clip] if t.from_frame >= at + _least(library)] or [
            t for t in exits[clip] if t.from_frame >= at
        ]
        some = [nexts[k] for k in chance.permutation(min(len(nexts), CHOICES))]
        move = next((t for t in some if _sharpness(library, t) <= SHARPEST), some[0])
        steps.append(Step(clip, at, move))
        length += move.from_frame - at + library.fade
        clip, at = move.to_clip, move.to_frame + library.fade
    steps.append(Step(clip, at, None))
    return _made(library, steps, frames, hold_feet)


CHOICES, SHARPEST = 12, 1.4
"""Of the next so many transitions one is taken whose fade is at most so many times as sharp as its clips."""


def _sharpness(library: Library, move: Transition) -> float:
    """How sharp a fade is beside its clips, as it will be made."""
    spans, bounds = [], []
    for number, frame in ((move.from_clip, move.from_frame), (move.to_clip, move.to_frame)):
        clip = library.clips[number]
        at = np.clip(np.arange(frame - 8, frame + library.fade + 8), 0, len(clip) - 1)
        around = at_frames(clip, at)
        inner = slice(6, len(at) - 6)
        spans.append(at_frames(around, inner))
        bounds.append(near_or_usual(accelerations(around))[inner])
    weights = np.concatenate([[0.0, 0.0], eased(library.fade), [1.0, 1.0]])
    made = mixed(spans[0], laid(spans[1], move.turn_rad, move.shift_m), weights)
    return float((accelerations(made) / np.maximum(np.maximum(*bounds), STILL)).max())


def _frames(library: Library, seconds: float) -> int:
    frames = round(seconds * library.clips[0].rate_hz)
    if not 2 * library.fade < frames <= 10_000_000:
        raise InputError(f"a walk of {seconds:g} s is too short or too long")
    return frames


def _least(library: Library) -> int:
    return round(APART_S * library.clips[0].rate_hz)


def _exits(library: Library) -> dict[int, list[Transition]]:
    out: dict[int, list[Transition]] = {c: [] for c in range(len(library.clips))}
    for t in library.transitions:
        out[t.from_clip].append(t)
    return out


def _start(library: Library, exits: dict[int, list[Transition]], chance: np.random.Generator) -> tuple[int, int]:
    """Where a walk begins: where a transition of the graph leads to."""
    entries = sorted({(t.to_clip, t.to_frame + library.fade) for t in library.transitions})
    usable = [(c, f) for c, f in entries if any(t.from_frame >= f for t in exits[c])]
    return usable[int(chance.integers(len(usable)))]


def _made(library: Library, steps: list[Step], frames: int, hold_feet: bool) -> Edited:
    """The clip that a way through the graph is."""
    first = steps[0]
    done = _begun_at(library, first)
    for step, after in pairwise(steps):
        move = step.transition
        if move is None:
            break
        own = list(library.plants[after.clip])
        # The clip before was followed from where it was entered: its frames end at the way's end.
        offset = len(done.motion) - len(library.clips[step.clip])
        done = joined(
            done, library.clips[move.to_clip], offset + move.from_frame, move.to_frame, library.fade, plants=own
        )
    out = finished(_cut(done, frames), hold_feet=hold_feet)
    names = [library.name(s.clip) for s in steps]
    worst = max((s.transition.distance_m for s in steps if s.transition is not None), default=0.0)
    report = {"clips": names, "transitions": len(steps) - 1, "largest_distance_mm": 1000.0 * worst}
    return Edited(replace(out.motion, source="motion graph"), {**report, **out.report})


def _begun_at(library: Library, step: Step) -> Joined:
    """The first clip from where the way enters it."""
    clip = library.clips[step.clip]
    start = step.entered
    part = at_frames(clip, slice(start, None))
    plants = [replace(p, start=max(p.start - start, 0), stop=p.stop - start) for p in library.plants[step.clip]]
    kept = tuple(p for p in plants if p.stop - p.start >= 3)
    return Joined(part, (clip,), (start + np.arange(len(part), dtype=float),), (), kept)


def _cut(done: Joined, frames: int) -> Joined:
    """The first so many frames."""
    part = at_frames(done.motion, slice(frames))
    plants = [replace(p, stop=min(p.stop, frames)) for p in done.plants if p.start < frames]
    return Joined(
        part,
        done.clips,
        tuple(f[:frames] for f in done.frames),
        tuple(j for j in done.joins if j[1] <= frames),
        tuple(p for p in plants if p.stop - p.start >= 3),
    )


@dataclass(frozen=True)
class _Way:
    """The beginning of a way along a line: its steps, where it stands, and what it has cost."""

    steps: tuple[Step, ...]
    clip: int
    at: int
    turn: float
    shift: Array
    gone_m: float
    cost: float
    frames: int


BEAM, BRANCHES = 40, 16
"""So many beginnings of ways are kept, and so many continuations of each are tried."""


def follow(library: Library, line_m: Array, *, hold_feet: bool = True) -> Edited:
    """A clip that goes along a line (points, 2; m on the floor), as near to it as the library can.

    Section 5 of the paper: of all ways through the graph that with the least squared distance between where the root is
    after so much way and the line there; the search keeps the best beginnings. Raises ``InputError`` for a line without
    length.
    """
    line = _Line(np.asarray(line_m, float))
    exits = _exits(library)
    paths = [_over_floor(clip) for clip in library.clips]
    ways = _beginnings(library, exits, paths, line)
    best: _Way | None = None
    for _ in range(MOST_STEPS):
        grown = [w for way in ways for w in _continued(library, exits, paths, line, way)]
        arrived = [w for w in grown if w.gone_m >= line.length]
        best = min([*arrived, *([best] if best else [])], key=_rating, default=None)
        ways = sorted((w for w in grown if w.gone_m < line.length), key=_rating)[:BEAM]
        if not ways or (best is not None and _rating(ways[0]) > _rating(best)):
            break
    if best is None:
        raise InputError("no way through the library gets to the end of the line: its clips hardly move over the floor")
    turn, shift = _placed_start(paths, best.steps[0], line)
    out = _made(library, [*best.steps, Step(best.clip, best.at, None)], best.frames, hold_feet)
    motion = laid(out.motion, turn, shift)
    off = line.distances(motion.root_m[:, :2])
    rms = float(np.sqrt((off**2).mean()))
    return Edited(motion, {"line_m": line.length, "off_line_m": {"rms": rms, "max": float(off.max())}, **out.report})


MOST_STEPS = 400


def _rating(way: _Way) -> float:
    """Mean squared distance from the line (m²) per way gone, and a little for time."""
    return way.cost / max(way.frames, 1) + 1e-6 * way.frames / max(way.gone_m, 1e-3)


def _over_floor(clip: Motion) -> tuple[Array, Array]:
    """Where the root is on the floor (frames, 2), and how far it has gone (frames; m)."""
    flat = clip.root_m[:, :2]
    return flat, np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(flat, axis=0), axis=1))])


class _Line:
    """A line on the floor, by the way along it."""

    def __init__(self, points_m: Array) -> None:
        if points_m.ndim != 2 or points_m.shape[1] != 2 or len(points_m) < 2 or not np.isfinite(points_m).all():
            raise InputError("a line is two points or more, each x,y in metres")
        steps = np.linalg.norm(np.diff(points_m, axis=0), axis=1)
        self.points = points_m
        self.ways = np.concatenate([[0.0], np.cumsum(steps)])
        self.length = float(self.ways[-1])
        if self.length < 0.1:
            raise InputError("the line has no length")

    def at(self, way: Array) -> Array:
        """Points of the line after so much way."""
        return np.stack([np.interp(way, self.ways, self.points[:, k]) for k in range(2)], axis=-1)

    def distances(self, places: Array) -> Array:
        """How far places are from the nearest point of the line."""
        dense = self.at(np.linspace(0.0, self.length, max(2, int(self.length / 0.02))))
        return np.array([np.linalg.norm(dense - p, axis=1).min() for p in places])


def _placed_start(paths: list[tuple[Array, Array]], step: Step, line: _Line) -> tuple[float, Array]:
    """The turn and shift that put the beginning of a way onto the line's beginning, going along it."""
    flat, gone = paths[step.clip]
    ahead = min(int(np.searchsorted(gone, gone[step.entered] + 0.5)), len(flat) - 1)
    way, wanted = flat[ahead] - flat[step.entered], line.at(np.array(0.5)) - line.points[0]
    if np.linalg.norm(way) < 1e-3:
        facing = 0.0
    else:
        facing = float(np.arctan2(wanted[1], wanted[0]) - np.arctan2(way[1], way[0]))
    return facing, line.points[0] - about_vertical(facing)[:2, :2] @ flat[step.entered]


def _beginnings(
    library: Library, exits: dict[int, list[Transition]], paths: list[tuple[Array, Array]], line: _Line
) -> list[_Way]:
    entries = sorted({(t.to_clip, t.to_frame + library.fade) for t in library.transitions})
    ways = []
    for clip, at in entries:
        if any(t.from_frame >= at for t in exits[clip]):
            turn, shift = _placed_start(paths, Step(clip, at, None), line)
            ways.append(_Way((), clip, at, turn, shift, 0.0, 0.0, 0))
    return ways


def _continued(
    library: Library, exits: dict[int, list[Transition]], paths: list[tuple[Array, Array]], line: _Line, way: _Way
) -> list[_Way]:
    """A way gone on along its clip to each of the next transitions, and through it."""
    flat, gone = paths[way.clip]
    about = about_vertical(way.turn)[:2, :2]
    out = []
    later = [t for t in exits[way.clip] if t.from_frame >= way.at + (_least(library) if way.steps else 0)]
    for move in later[:BRANCHES]:
        stop = min(move.from_frame + library.fade, len(flat) - 1)
        span = slice(way.at, stop + 1)
        along = way.gone_m + gone[span] - gone[way.at]
        off = flat[span] @ about.T + way.shift - line.at(np.minimum(along, line.length))
        inside = along <= line.length
        cost = way.cost + float((off[inside] ** 2).sum())
        frames = way.frames + int(inside.sum())
        shift = about @ np.array(move.shift_m) + way.shift
        out.append(
            _Way(
                (*way.steps, Step(way.clip, way.at, move)),
                move.to_clip,
                move.to_frame + library.fade,
                way.turn + move.turn_rad,
                shift,
                float(along[-1]),
                cost,
                frames,
            )
        )
    return out
