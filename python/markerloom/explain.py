"""Why a marker is missing: what each camera had, or had not, where the marker must have been."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.bumped import Moves
from markerloom.errors import InputError
from markerloom.observations import MatchedDots
from markerloom.points import KINDS, MEASURED
from markerloom.reconstruct import Reconstruction
from markerloom.rig import Rig

Array = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]

GATE = 4.0
"""A dot within so many standard deviations of the expected place could have been the marker's."""
NEAREST_PX = 100.0
"""Dots farther away are not worth telling of."""
EXPLAINED_GAPS = 200
CAUSES = {
    "used": "its dot was used",
    "taken": "a dot was there, but belongs to another trajectory",
    "gated": "a dot was near, but too far off",
    "single": "a dot was there, but no second camera confirmed it",
    "hidden": "no dot: hidden, or missed",
    "outside": "outside the image",
    "masked": "under the camera's mask",
}


@dataclass(frozen=True)
class Seen:
    """The dots of a take; which trajectory has each of them, and which other if two markers are one dot (−1: none)."""

    cameras: Moves
    dots: MatchedDots
    track: Ints
    other: Ints
    noise_px: tuple[float, ...]


@dataclass(frozen=True)
class TrackedTake(Reconstruction):
    """Trajectories of a take, with what the cameras saw: see ``explain``."""

    seen: Seen | None = field(default=None, repr=False)

    @staticmethod
    def with_dots(points: Reconstruction, seen: Seen) -> TrackedTake:
        """Add what the cameras saw."""
        return TrackedTake(**{f.name: getattr(points, f.name) for f in fields(Reconstruction)}, seen=seen)


@dataclass(frozen=True)
class CameraView:
    """What one camera had where the marker must have been.

    ``cause``: one of ``CAUSES``. ``distance_px`` from the expected place to the dot used or else to the nearest one
    (NaN beyond 100 px); ``allowed_px``: how far a dot may be; ``observation``: that dot's row within its frame and
    camera; ``track``: whose it is (−1: nobody's).
    """

    camera: str
    cause: str
    distance_px: float
    allowed_px: float
    observation: int
    track: int

    def __str__(self) -> str:
        """One line."""
        line = f"camera {self.camera}: {CAUSES[self.cause]}"
        if self.cause == "taken":
            line += f" (trajectory {self.track})"
        if np.isfinite(self.distance_px):
            line += f"; {self.distance_px:.2f} px from where it is expected, {self.allowed_px:.2f} px allowed"
        return line


@dataclass(frozen=True)
class Explanation:
    """What happened to one marker in one frame.

    ``kind``: ``measured``, ``predicted``, or ``absent`` where the take has no sample; then the place is taken from the
    trajectory's samples before and after.
    """

    track: int
    frame: int
    kind: str
    place_mm: Array
    sigma_mm: float
    cameras: tuple[CameraView, ...]

    def __str__(self) -> str:
        """A paragraph."""
        x, y, z = self.place_mm
        place = f"({x:.1f}, {y:.1f}, {z:.1f}) mm ± {self.sigma_mm:.1f}"
        head = f"trajectory {self.track}, frame {self.frame}: {self.kind}, at {place}"
        return "\n".join([head, *(f"  {view}" for view in self.cameras)])


def explain(take: Reconstruction, track: int, frame: int) -> Explanation:
    """Say for each camera what became of a trajectory's marker in a frame.

    ``take``: what ``track`` gave for dots. Raises ``InputError`` for a take without dots (points of another system),
    for an unknown trajectory, and for a frame outside the take.
    """
    seen = take.seen if isinstance(take, TrackedTake) else None
    if seen is None:
        raise InputError("only trajectories that were tracked from dots can be explained")
    rows = np.flatnonzero(take.track == track)
    if len(rows) == 0:
        raise InputError(f"there is no trajectory {track} in the take")
    index = int(np.searchsorted(seen.dots.frames, frame))
    if index == len(seen.dots.frames) or seen.dots.frames[index] != frame:
        raise InputError(f"frame {frame} is not in the take ({seen.dots.frames[0]} to {seen.dots.frames[-1]})")
    kind, place_mm, sigma_mm = _place(take, rows, frame)
    low, high = int(seen.dots.starts[index]), int(seen.dots.starts[index + 1])
    rig = seen.cameras.rig_at(frame)
    views = [_view(seen, rig, i, track, (low, high), place_mm, sigma_mm) for i in range(len(rig))]
    return Explanation(track, frame, kind, place_mm, sigma_mm, tuple(views))


def _place(take: Reconstruction, rows: Ints, frame: int) -> tuple[str, Array, float]:
    """Kind, place and sigma (mm); without a sample, between the samples before and after, or at the nearest."""
    at = int(np.searchsorted(take.frame[rows], frame))
    if at < len(rows) and take.frame[rows[at]] == frame:
        row = rows[at]
        return KINDS[take.kind[row]], take.xyz_mm[row], float(take.sigma_mm[row])
    ends = rows[[max(at - 1, 0), min(at, len(rows) - 1)]]
    first, last = take.xyz_mm[ends]
    span = max(int(take.frame[ends[1]] - take.frame[ends[0]]), 1)
    share = np.clip((frame - take.frame[ends[0]]) / span, 0.0, 1.0)
    sigma_mm = float(take.sigma_mm[ends].max() + 0.25 * np.linalg.norm(last - first))
    return "absent", first + share * (last - first), sigma_mm


def _view(
    seen: Seen, rig: Rig, camera: int, track: int, rows: tuple[int, int], place_mm: Array, sigma_mm: float
) -> CameraView:
    one = rig.cameras[camera]
    steps_m = np.vstack([np.zeros(3), 1e-3 * np.eye(3)])
    pixels = rig.project(camera, place_mm / 1000.0 + steps_m)
    expected = pixels[0]
    spread_px = np.linalg.norm(pixels[1:] - expected) * sigma_mm / np.sqrt(6.0)
    allowed_px = float(GATE * np.hypot(seen.noise_px[camera], spread_px))
    own = np.arange(*rows)[seen.dots.camera[rows[0] : rows[1]] == camera]
    distances = np.linalg.norm(seen.dots.pixel[own] - expected, axis=1)
    used = np.flatnonzero((seen.track[own] == track) | (seen.other[own] == track))
    if len(used):
        dot = int(own[used[0]])
        return CameraView(one.id, "used", float(distances[used[0]]), allowed_px, int(seen.dots.observation[dot]), track)
    inside = np.all(np.isfinite(expected)) and np.all((expected > -0.5) & (expected < np.array(one.size_px) - 0.5))
    if not inside:
        return CameraView(one.id, "outside", float("nan"), allowed_px, -1, -1)
    if one.mask is not None and one.mask.covers(expected[None])[0]:
        return CameraView(one.id, "masked", float("nan"), allowed_px, -1, -1)
    if len(own) == 0 or distances.min() > NEAREST_PX:
        return CameraView(one.id, "hidden", float("nan"), allowed_px, -1, -1)
    nearest = int(distances.argmin())
    distance_px, owner = float(distances[nearest]), int(seen.track[own[nearest]])
    if distance_px <= allowed_px:
        cause = "taken" if owner >= 0 else "single"
    else:
        cause = "gated" if owner < 0 and distance_px <= 3.0 * allowed_px else "hidden"
    return _with_dot(seen, one.id, cause, int(own[nearest]), distance_px, allowed_px)


def _with_dot(seen: Seen, name: str, cause: str, dot: int, distance_px: float, allowed_px: float) -> CameraView:
    return CameraView(name, cause, distance_px, allowed_px, int(seen.dots.observation[dot]), int(seen.track[dot]))


def gaps(take: TrackedTake) -> list[dict[str, Any]]:
    """Every gap of every trajectory, the longest first: its frames, how many were predicted, and for the longest what
    the cameras had in its middle (number of cameras by cause)."""
    found = []
    for track in np.unique(take.track):
        rows = take.track == track
        measured = take.frame[rows & (take.kind == MEASURED)]
        predicted = take.frame[rows & (take.kind != MEASURED)]
        for before, after in zip(measured[:-1].tolist(), measured[1:].tolist(), strict=True):
            if after - before > 1:
                inside = int(np.searchsorted(predicted, after) - np.searchsorted(predicted, before))
                gap = {"track": int(track), "first": before + 1, "last": after - 1, "predicted": inside}
                found.append(gap)
    found.sort(key=lambda g: (g["first"] - g["last"], g["track"], g["first"]))
    known = set(take.frames.tolist())
    for gap in found[:EXPLAINED_GAPS]:
        middle = (gap["first"] + gap["last"]) // 2
        if middle in known:
            causes = Counter(view.cause for view in explain(take, gap["track"], middle).cameras)
            gap["cameras"] = dict(sorted(causes.items()))
    return found
