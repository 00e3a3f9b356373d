"""How sensors sit on segments: what markers and poses of the same motion say together.

A sensor turns as ``R_s = W R M`` and is at ``x_s = W (x + R p) + t``: ``R``, ``x`` of its segment, ``M``, ``p`` how it
sits there, ``W``, ``t`` how its system stands to that of the cameras. ``W`` follows from how segments turn between two
frames, whatever ``M`` is (``a = W b`` for the rotation vectors on both sides; Tsai & Lenz 1989, for the hand and the
eye), ``M`` is then a mean, and ``p`` and ``t`` are linear.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from markerloom.errors import InputError
from markerloom.skeleton.contacts import Pin
from markerloom.skeleton.isb import arms_hanging
from markerloom.skeleton.motion import Motion
from markerloom.skeleton.mvnx import SegmentPoses
from markerloom.skeleton.placing import split_side
from markerloom.skeleton.skeleton import Skeleton

Array = NDArray[np.floating[Any]]
Turn = tuple[int, int, list[float], float]
PLACE_SIGMA_M, TURN_SIGMA_RAD = 0.005, np.deg2rad(1.0)
"""How far sensors' places and turns are trusted where nothing else is said."""
FINEST_M, FINEST_RAD = 0.0005, np.deg2rad(0.2)
"""Spreads smaller than these are luck."""
APART_S = 0.5
"""Frames this far apart have turned enough to compare how."""
SAMPLES = 400
"""Frames that are enough to learn how a sensor sits."""


@dataclass(frozen=True)
class Mount:
    """A sensor on a segment: ``joint``, the sensor's number in the poses, ``turn`` (3, 3) and ``place_m`` (3) in the
    segment's axes, ``sigma_rad`` and ``sigma_m``: how far its poses are from those of the markers (a place that was
    never seen has an infinite one).
    """

    joint: int
    sensor: int
    turn: Array
    place_m: Array
    sigma_rad: float
    sigma_m: float


@dataclass(frozen=True)
class Mounts:
    """All sensors, and how their system stands to that of the cameras: ``turn`` (3, 3), ``shift_m`` (3)."""

    each: list[Mount]
    turn: Array
    shift_m: Array


def learn_mounts(poses: SegmentPoses, motion: Motion) -> Mounts:
    """How the sensors sit, from the frames in which markers tell the segments' turns.

    ``poses`` have the motion's frames (see `at_frames_of`). Sensors of segments without markers are taken to sit as
    their skeleton says. Raises ``InputError`` where no segment is in both.
    """
    pairs = [
        (j, i) for i, name in enumerate(poses.skeleton.joints) if (j := _joint(motion.skeleton, poses, i, name)) >= 0
    ]
    if not pairs:
        raise InputError(
            f"no segment of the poses ({', '.join(poses.skeleton.joints[:4])}, …) is one of skeleton "
            f"'{motion.skeleton.name}' ({poses.source})"
        )
    turn, place = motion.segments()
    told = motion.kind == 0
    world = _between(poses, turn, told, pairs, motion.rate_hz)
    rests = arms_hanging(motion.skeleton), arms_hanging(poses.skeleton)
    mounts = []
    for j, i in pairs:
        both = told[:, j] & np.isfinite(poses.turn[:, i]).all(axis=(1, 2))
        sits, sigma = rests[0][j].T @ rests[1][i], TURN_SIGMA_RAD
        if both.any():
            own = np.swapaxes(world @ turn[both, j], 1, 2) @ poses.turn[both, i]
            sits = Rotation.from_matrix(own).mean().as_matrix()
            off = Rotation.from_matrix(own @ sits.T).as_rotvec()
            sigma = max(_spread(off), FINEST_RAD)
        mounts.append(Mount(j, i, sits, np.zeros(3), sigma, np.inf))
    return _placed(mounts, world, poses, turn, place, told)


def _joint(skeleton: Skeleton, poses: SegmentPoses, sensor: int, name: str) -> int:
    """The joint that moves a sensor's segment: by the name of the body's part, or by the same name."""
    part = next(
        (p for p, i in poses.skeleton.segments.items() if i == sensor), "_".join(filter(None, split_side(name)))
    )
    return skeleton.segments.get(part, skeleton.index(name))


def _between(
    poses: SegmentPoses, turn: Array, told: NDArray[np.bool_], pairs: list[tuple[int, int]], rate_hz: float
) -> Array:
    """The turn ``W`` of the sensors' system against the cameras', as far as the motion shows it."""
    apart = max(1, round(APART_S * rate_hz))
    cross, count = np.zeros((3, 3)), 0
    for j, i in pairs:
        good = told[:, j] & np.isfinite(poses.turn[:, i]).all(axis=(1, 2))
        first = np.flatnonzero(good[:-apart] & good[apart:])[:: max(1, len(good) // SAMPLES)]
        if not len(first):
            continue
        ours, theirs = (
            Rotation.from_matrix(t[first + apart, k] @ np.swapaxes(t[first, k], 1, 2)).as_rotvec()
            for t, k in ((turn, j), (poses.turn, i))
        )
        cross += theirs.T @ ours
        count += len(first)
    # What the motion does not show stays as it is.
    left, _, right = np.linalg.svd(cross + (count + 1) * TURN_SIGMA_RAD**2 * np.eye(3))
    return left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right


def _placed(
    mounts: list[Mount], world: Array, poses: SegmentPoses, turn: Array, place: Array, told: NDArray[np.bool_]
) -> Mounts:
    """The mounts with their places: least squares over all of them, since they share the shift."""
    count = len(mounts)
    normal, right = 1e-6 * np.eye(3 * count + 3), np.zeros(3 * count + 3)
    seen = [told[:, m.joint] & np.isfinite(poses.place_m[:, m.sensor]).all(axis=1) for m in mounts]
    back = poses.place_m @ world
    for n, (mount, good) in enumerate(zip(mounts, seen, strict=True)):
        some = np.flatnonzero(good)[:: max(1, int(good.sum()) // SAMPLES)]
        rows = np.concatenate([turn[some, mount.joint], np.broadcast_to(np.eye(3), (len(some), 3, 3))], axis=2)
        values = back[some, mount.sensor] - place[some, mount.joint]
        index = np.r_[3 * n : 3 * n + 3, 3 * count : 3 * count + 3]
        normal[np.ix_(index, index)] += np.einsum("fab,fac->bc", rows, rows)
        right[index] += np.einsum("fab,fa->b", rows, values)
    found = np.linalg.solve(normal, right).reshape(-1, 3)
    out = []
    for mount, good, own in zip(mounts, seen, found[:-1], strict=True):
        sigma = np.inf
        if good.any():
            at = place[good, mount.joint] + turn[good, mount.joint] @ own + found[-1]
            sigma = max(_spread(back[good, mount.sensor] - at), FINEST_M)
        out.append(Mount(mount.joint, mount.sensor, mount.turn, own, mount.sigma_rad, sigma))
    return Mounts(out, world, world @ found[-1])


def _spread(off: Array) -> float:
    """The standard deviation of one component, not led by a few that are far out."""
    return float(1.4826 * np.median(np.abs(off)))


def held_by(mounts: Mounts, poses: SegmentPoses) -> tuple[list[Pin], list[Turn]]:
    """What the poses hold, for the engine: places and turns of segments in the cameras' system."""
    pins: list[Pin] = []
    turns: list[Turn] = []
    for mount in mounts.each:
        turn, place = poses.turn[:, mount.sensor], poses.place_m[:, mount.sensor]
        told = np.flatnonzero(np.isfinite(turn).all(axis=(1, 2)))
        if len(told):
            own = Rotation.from_matrix(mounts.turn.T @ turn[told] @ mount.turn.T).as_rotvec()
            turns += [(int(f), mount.joint, v.tolist(), mount.sigma_rad) for f, v in zip(told, own, strict=True)]
        if np.isfinite(mount.sigma_m):
            told = np.flatnonzero(np.isfinite(place).all(axis=1))
            at = (place[told] - mounts.shift_m) @ mounts.turn
            local = mount.place_m.tolist()
            pins += [(int(f), mount.joint, local, v.tolist(), mount.sigma_m) for f, v in zip(told, at, strict=True)]
    return pins, turns


def at_frames_of(poses: SegmentPoses, frames: NDArray[np.int64], rate_hz: float) -> SegmentPoses:
    """The poses at a take's frames: by number where both have one rate, else between two by time (both begin with
    their frame 0 at the same moment). Nothing is told beyond the ends, or where one of the two is missing.
    """
    when = frames / rate_hz * poses.rate_hz - poses.first_frame
    if abs(poses.rate_hz / rate_hz - 1.0) < 1e-6:
        when = np.round(when)
    inside = (when >= 0) & (when <= len(poses.place_m) - 1)
    if not inside.any():
        raise InputError(f"the poses and the take have no moment in common ({poses.source})")
    joints = len(poses.skeleton)
    place, turn = np.full((len(frames), joints, 3), np.nan), np.full((len(frames), joints, 3, 3), np.nan)
    low = np.floor(when[inside]).astype(int)
    part = when[inside] - low
    high = np.where(part > 0, low + 1, low)
    place[inside] = (1.0 - part)[:, None, None] * poses.place_m[low] + part[:, None, None] * poses.place_m[high]
    for i in range(joints):
        good = np.isfinite(poses.turn[low, i]).all(axis=(1, 2)) & np.isfinite(poses.turn[high, i]).all(axis=(1, 2))
        rows = np.flatnonzero(inside)[good]
        if not len(rows):
            continue
        first = Rotation.from_matrix(poses.turn[low[good], i])
        step = first.inv() * Rotation.from_matrix(poses.turn[high[good], i])
        turn[rows, i] = (first * Rotation.from_rotvec(part[good, None] * step.as_rotvec())).as_matrix()
    return SegmentPoses(poses.skeleton, place, turn, rate_hz, first_frame=int(frames[0]), source=poses.source)
