"""Cameras that were moved while a take ran: from one frame on, all their dots lie beside where the others say."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from markerloom.explain import TrackedTake
from markerloom.points import MEASURED

Array = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]

LOOKED_AT = 120
"""Frames looked at, evenly spread; where something changed, every frame is."""
REACH = 0.03
"""A bumped camera's dots are looked for within this part of the image's diagonal."""
FEWEST = 4
"""Fewer markers in a frame say nothing about a camera."""
BESIDE = 6
"""Looks on each side of a step that must agree on it."""
STEP_NOISES = 2.0
STEP_SPREADS = 5.0
"""A step is told of when it is this many times the dots' noise, and the spread of the looks around it."""


def bumped_cameras(take: TrackedTake) -> list[dict[str, Any]]:
    """Cameras that were moved: ``camera``, ``frame`` of the first look after, ``shift_px`` (x, y) of the dots there."""
    if take.seen is None:
        return []
    frames = take.seen.dots.frames
    looks = frames[:: max(1, len(frames) // LOOKED_AT)]
    found = []
    for camera in range(len(take.seen.rig)):
        series = _offsets(take, camera, looks)
        step = _largest_step(series[1], STEP_NOISES * float(np.median(take.seen.noise_px)))
        if step is not None:
            first, last = series[0][max(step - 3, 0)], series[0][min(step + 2, len(series[0]) - 1)]
            between = frames[(frames >= first) & (frames <= last)]
            frame = _where(take, camera, between, series[1][:step], series[1][step:])
            before, after = series[1][step - BESIDE : step], series[1][step : step + BESIDE]
            shift = np.median(after, axis=0) - np.median(before, axis=0)
            name = take.seen.rig.cameras[camera].id
            found.append({"camera": name, "frame": frame, "shift_px": [float(v) for v in shift]})
    return found


def _offsets(take: TrackedTake, camera: int, frames: Ints) -> tuple[Ints, Array]:
    """Frames in which enough markers tell, and the common offset (px) of the camera's dots from their places there."""
    if take.seen is None:
        return np.zeros(0, np.int64), np.zeros((0, 2))
    rig, dots = take.seen.rig, take.seen.dots
    reach_px = REACH * float(np.hypot(*rig.cameras[camera].size_px))
    told, offsets = [], []
    for frame in frames.tolist():
        index = int(np.searchsorted(dots.frames, frame))
        low, high = int(dots.starts[index]), int(dots.starts[index + 1])
        own = np.arange(low, high)[dots.camera[low:high] == camera]
        rows = np.arange(*np.searchsorted(take.frame, [frame, frame + 1]))
        rows = rows[(take.kind[rows] == MEASURED) & (take.rays[rows] >= 3)]
        if len(own) < FEWEST or len(rows) < FEWEST:
            continue
        expected = np.nan_to_num(rig.project(camera, take.xyz_mm[rows] / 1000.0), nan=-1e9)
        shift = _common_shift(dots.pixel[own], expected, reach_px)
        if shift is not None:
            told.append(frame)
            offsets.append(shift)
    return np.array(told, np.int64), np.array(offsets, float).reshape(-1, 2)


def _common_shift(pixels: Array, expected: Array, reach_px: float) -> Array | None:
    """The offset on which most pairs of dot and expected place agree: every pair proposes its own."""
    all_offsets = pixels[None, :, :] - expected[:, None, :]
    near = np.linalg.norm(all_offsets, axis=2) < reach_px
    proposals = all_offsets[near]
    if len(proposals) < FEWEST:
        return None
    width = max(reach_px / 40.0, 1.0)
    votes = KDTree(proposals).query_ball_point(proposals, width, return_length=True)
    best = int(votes.argmax())
    if votes[best] < FEWEST:
        return None
    agree = np.linalg.norm(proposals - proposals[best], axis=1) < width
    return np.median(proposals[agree], axis=0)


def _largest_step(offsets: Array, least_px: float) -> int | None:
    """Index of the look from which on the offset is another one; ``None`` if it never changes at once."""
    best, at = 0.0, None
    for k in range(BESIDE, len(offsets) - BESIDE + 1):
        before, after = offsets[k - BESIDE : k], offsets[k : k + BESIDE]
        step = float(np.linalg.norm(np.median(after, axis=0) - np.median(before, axis=0)))
        spread = float(np.median(np.abs(before - np.median(before, axis=0))))
        spread = max(spread, float(np.median(np.abs(after - np.median(after, axis=0)))))
        if step > max(least_px, STEP_SPREADS * spread, best):
            best, at = step, k
    return at


def _where(take: TrackedTake, camera: int, frames: Ints, before: Array, after: Array) -> int:
    """The first frame whose offset is nearer to what follows than to what went before."""
    told, offsets = _offsets(take, camera, frames)
    old, new = np.median(before[-BESIDE:], axis=0), np.median(after[:BESIDE], axis=0)
    later = np.linalg.norm(offsets - new, axis=1) < np.linalg.norm(offsets - old, axis=1)
    return int(told[int(later.argmax())]) if later.any() else int(frames[-1])
