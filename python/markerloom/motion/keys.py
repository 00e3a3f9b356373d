"""Key poses: what a motion must be at a time. Joints' angles, places of hands and feet, poses of other clips."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import FormatError, InputError
from markerloom.formats.files import read_text
from markerloom.motion.body import body_of
from markerloom.motion.reach import reached
from markerloom.skeleton.files import read_motion
from markerloom.skeleton.motion import Motion, matrices

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Key:
    """A pose at a frame of the clip (from 0): ``turns`` of joints (3, 3) against their parents, and the root's place
    (m; NaN in axes that stay as they are).
    """

    frame: int
    turns: dict[int, Array] = field(default_factory=dict)
    root_m: Array = field(default_factory=lambda: np.full(3, np.nan))


def frame_at(motion: Motion, *, time_s: float | None = None, frame: int | None = None) -> int:
    """The clip's frame (from 0) of a time from its beginning, or of a number of frame; refused outside of the clip."""
    if (time_s is None) == (frame is None):
        raise InputError("a key has a time_s or a frame, one of them")
    at = round(time_s * motion.rate_hz) if time_s is not None else int(frame or 0) - motion.first_frame
    if not 0 <= at < len(motion):
        end = (len(motion) - 1) / motion.rate_hz
        what = f"time {time_s:g} s" if time_s is not None else f"frame {frame}"
        raise InputError(
            f"a key at {what} is not in the clip, which has {len(motion)} frames, 0 to {end:g} s ({motion.source})"
        )
    return at


def by_angles(motion: Motion, at: int, angles_deg: dict[str, list[float]]) -> Key:
    """A key of joints' Euler angles (deg), in the order that the skeleton's files show them."""
    turns = {}
    for name, values in angles_deg.items():
        j = motion.skeleton.index(name)
        if j < 0:
            raise InputError(f"a key for joint '{name}', which is not there: {', '.join(motion.skeleton.joints)}")
        if len(values) != 3 or not np.isfinite(values).all():
            raise InputError(
                f"a key for '{name}' is three angles about {', '.join(motion.skeleton.orders[j])} in degrees"
            )
        order = motion.skeleton.orders[j]
        by_axis = [np.deg2rad(values[order.index(a)]) for a in "XYZ"]
        turns[j] = matrices(order, np.array([by_axis]))[0]
    return Key(at, turns)


def by_reach(motion: Motion, at: int, places_mm: dict[str, list[float]]) -> Key:
    """A key in which joints or ends of bones are at places (mm, world, Z up): their limbs are turned as little as that
    needs. Raises ``InputError`` for places out of reach.
    """
    targets = {}
    for name, values in places_mm.items():
        if len(values) != 3 or not np.isfinite(values).all():
            raise InputError(f"a key for '{name}' is a place, three numbers in mm")
        targets[name] = np.array(values, float) / 1000.0
    return Key(at, reached(motion, at, targets, body_of(motion.skeleton)))


def by_clip(motion: Motion, at: int, other: Motion, other_at: int, joints: list[str] | None = None) -> Key:
    """A key from a frame (from 0) of another clip: the joints of the same names; the root's place and heading stay."""
    if not 0 <= other_at < len(other):
        raise InputError(f"{other.source} has {len(other)} frames: a key from frame {other_at} is not in it")
    body = body_of(motion.skeleton)
    wanted = set(range(1, len(motion.skeleton))) if joints is None else {j for name in joints for j in body.group(name)}
    turns = {}
    for j in sorted(wanted):
        k = other.skeleton.index(motion.skeleton.joints[j])
        if k >= 0:
            turns[j] = other.turns[other_at, k]
    if not turns:
        raise InputError(f"{other.source} has none of the joints that a key would take from it")
    return Key(at, turns)


def merged(keys: list[Key], motion: Motion) -> list[Key]:
    """One key per frame. Raises ``InputError`` where two say different things of one joint in one frame."""
    out: dict[int, Key] = {}
    for key in keys:
        if not 0 <= key.frame < len(motion):
            raise InputError(f"a key in frame {key.frame}: the clip has {len(motion)} frames ({motion.source})")
        before = out.get(key.frame)
        if before is None:
            out[key.frame] = key
            continue
        for j in before.turns.keys() & key.turns.keys():
            if not np.allclose(before.turns[j], key.turns[j], atol=1e-9):
                name = motion.skeleton.joints[j]
                raise InputError(f"two keys contradict each other: joint '{name}' in frame {key.frame}")
        both = np.isfinite(before.root_m) & np.isfinite(key.root_m)
        if not np.allclose(before.root_m[both], key.root_m[both], atol=1e-9):
            raise InputError(f"two keys contradict each other: the root's place in frame {key.frame}")
        place = np.where(np.isfinite(key.root_m), key.root_m, before.root_m)
        out[key.frame] = Key(key.frame, before.turns | key.turns, place)
    return [out[frame] for frame in sorted(out)]


def read_keys(path: str | Path, motion: Motion) -> list[Key]:
    """Keys from a TOML: ``[[keys]]`` with time_s or frame, and angles_deg, reach_mm, root_mm, or from with from_frame
    (and only, a list of joints or groups).
    """
    try:
        content = tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        raise FormatError(path, f"not a TOML file: {error}") from None
    rows = content.get("keys")
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise FormatError(path, "has no [[keys]]")
    known = {"time_s", "frame", "angles_deg", "reach_mm", "root_mm", "from", "from_frame", "only"}
    keys: list[Key] = []
    for number, row in enumerate(rows, start=1):
        unknown = sorted(set(row) - known)
        if unknown:
            raise FormatError(path, f"does not know '{unknown[0]}': {', '.join(sorted(known))}", where=f"key {number}")
        try:
            keys += _of_row(row, motion, Path(path).parent)
        except (TypeError, ValueError, AttributeError):
            raise FormatError(path, "is not readable", where=f"key {number}") from None
    return keys


def _of_row(row: dict[str, Any], motion: Motion, folder: Path) -> list[Key]:
    at = frame_at(motion, time_s=row.get("time_s"), frame=row.get("frame"))
    keys = []
    if "angles_deg" in row:
        keys.append(by_angles(motion, at, row["angles_deg"]))
    if "reach_mm" in row:
        keys.append(by_reach(motion, at, row["reach_mm"]))
    if "root_mm" in row:
        keys.append(Key(at, {}, np.array(row["root_mm"], float).reshape(3) / 1000.0))
    if "from" in row:
        other = read_motion(folder / row["from"])
        other_at = frame_at(other, frame=row.get("from_frame", other.first_frame))
        keys.append(by_clip(motion, at, other, other_at, row.get("only")))
    if not keys:
        raise InputError("a key says nothing: angles_deg, reach_mm, root_mm or from")
    return keys
