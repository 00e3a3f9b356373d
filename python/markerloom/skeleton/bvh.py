"""BVH (Biovision): hierarchy of offsets and channels, and one line of numbers per frame.

Rotations are about moved axes in the order of the channels: of "Zrotation Xrotation Yrotation" R = Rz·Rx·Ry. Channels
of place replace the joint's OFFSET, as Blender and MotionBuilder take them. Lengths have no unit of their own.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from markerloom.errors import FormatError, InputError
from markerloom.formats.files import read_text, write_text
from markerloom.skeleton.motion import Motion, euler
from markerloom.skeleton.skeleton import Site, Skeleton

Array = NDArray[np.floating[Any]]
PLACES = ("Xposition", "Yposition", "Zposition")
TURNS = ("Xrotation", "Yrotation", "Zrotation")
STUB = 0.5
"""A bone without an end is written this part as long as the one above it."""


@dataclass
class _Tree:
    names: list[str] = field(default_factory=list)
    parents: list[int] = field(default_factory=list)
    offsets: list[list[float]] = field(default_factory=list)
    channels: list[list[str]] = field(default_factory=list)
    sites: list[tuple[int, list[float]]] = field(default_factory=list)


def read_skeleton(path: str | Path, unit_m: float) -> Skeleton:
    """The hierarchy alone, in the file's axes; ``unit_m``: the file's unit of length."""
    tree, _ = _hierarchy(_lines(path), path)
    return _skeleton(tree, path, unit_m)


def read(path: str | Path, unit_m: float) -> Motion:
    """A motion in the file's axes.

    Raises ``FormatError`` for a broken hierarchy, and for frames with too few, too many or unreadable numbers.
    """
    lines = _lines(path)
    tree, at = _hierarchy(lines, path)
    skeleton = _skeleton(tree, path, unit_m)
    if at >= len(lines) or lines[at][1].upper() != "MOTION":
        raise FormatError(path, "has no MOTION part: it is a skeleton without a motion")
    frames, step_s, at = _head(lines, at + 1, path)
    width = sum(len(c) for c in tree.channels)
    values = _numbers(lines[at:], frames, width, path)
    root_m = np.zeros((frames, 3))
    turns = np.tile(np.eye(3), (frames, len(skeleton), 1, 1))
    shifts = np.tile(skeleton.offsets_m, (frames, 1, 1)) if skeleton.moving else None
    column = 0
    for j, channels in enumerate(tree.channels):
        own = values[:, column : column + len(channels)]
        column += len(channels)
        rotations = [i for i, c in enumerate(channels) if c in TURNS]
        order = "".join(channels[i][0] for i in rotations)
        if order:
            turns[:, j] = Rotation.from_euler(order, np.deg2rad(own[:, rotations])).as_matrix()
        for i, channel in enumerate(channels):
            if channel in PLACES:
                target = root_m if j == 0 else shifts[:, j]  # pyright: ignore[reportOptionalSubscript]
                target[:, PLACES.index(channel)] = own[:, i] * unit_m
    return Motion(skeleton, root_m, turns, 1.0 / step_s, shifts_m=shifts, source=str(path))


def _lines(path: str | Path) -> list[tuple[int, str]]:
    """Lines that are not empty, with their numbers."""
    return [(i, text) for i, line in enumerate(read_text(path).splitlines(), start=1) if (text := line.strip())]


def _hierarchy(lines: list[tuple[int, str]], path: str | Path) -> tuple[_Tree, int]:
    """The tree, and the line after it."""
    if not lines or lines[0][1].upper() != "HIERARCHY":
        raise FormatError(path, "does not begin with HIERARCHY: it is no BVH")
    tree = _Tree()
    open_joints: list[int] = []
    new: int | None = None
    at = 1
    while at < len(lines) and lines[at][1].upper() != "MOTION":
        number, text = lines[at]
        where = f"line {number}"
        word, rest = (*text.split(None, 1), "")[:2]
        key = word.upper()
        if key in ("ROOT", "JOINT"):
            if (key == "ROOT") != (not tree.names):
                raise FormatError(path, "a second ROOT" if tree.names else "a JOINT before the ROOT", where=where)
            tree.names.append(rest.strip())
            parent = next((j for j in reversed(open_joints) if j >= 0), -1)
            tree.parents.append(parent)
            tree.offsets.append([0.0] * 3)
            tree.channels.append([])
            new = len(tree.names) - 1
        elif key == "END":
            new = -1
        elif text == "{":
            if new is None:
                raise FormatError(path, "a bracket opens nothing", where=where)
            open_joints.append(new)
            new = None
        elif text == "}":
            if not open_joints:
                raise FormatError(path, "a bracket closes nothing", where=where)
            open_joints.pop()
        elif key == "OFFSET":
            offset = _floats(rest, 3, path, where)
            owner = open_joints[-1] if open_joints else None
            if owner is None:
                raise FormatError(path, "OFFSET outside of a joint", where=where)
            if owner >= 0:
                tree.offsets[owner] = offset
            else:
                tree.sites.append((next(j for j in reversed(open_joints) if j >= 0), offset))
        elif key == "CHANNELS":
            if not open_joints or open_joints[-1] < 0:
                raise FormatError(path, "CHANNELS outside of a joint", where=where)
            tree.channels[open_joints[-1]] = _channels(rest, path, where)
        else:
            raise FormatError(path, f"'{word}' is not part of a hierarchy", where=where)
        at += 1
    if open_joints or not tree.names:
        raise FormatError(path, "the hierarchy is cut off: brackets are not closed" if tree.names else "has no ROOT")
    return tree, at


def _channels(rest: str, path: str | Path, where: str) -> list[str]:
    words = rest.split()
    known = {c.lower(): c for c in (*PLACES, *TURNS)}
    found = [known.get(w.lower(), "") for w in words[1:]]
    if not words or not words[0].isdigit() or int(words[0]) != len(found) or "" in found or len({*found}) < len(found):
        raise FormatError(path, f"CHANNELS {rest} is not a number and that many channels", where=where)
    return found


def _floats(text: str, count: int, path: str | Path, where: str) -> list[float]:
    try:
        values = [float(v) for v in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not np.isfinite(values).all():
        raise FormatError(path, f"'{text.strip()}' is not {count} numbers", where=where)
    return values


def _skeleton(tree: _Tree, path: str | Path, unit_m: float) -> Skeleton:
    offsets = np.array(tree.offsets) * unit_m
    sites, count = [], {}
    for joint, offset in tree.sites:
        count[joint] = count.get(joint, 0) + 1
        name = f"{tree.names[joint]}_end" + (f"_{count[joint]}" if count[joint] > 1 else "")
        sites.append(Site(name, joint, (offset[0] * unit_m, offset[1] * unit_m, offset[2] * unit_m)))
    orders = ["".join(c[0] for c in own if c in TURNS) for own in tree.channels]
    try:
        return Skeleton(
            name=Path(path).stem,
            joints=tuple(tree.names),
            parents=tuple(tree.parents),
            offsets_m=offsets,
            sites=tuple(sites),
            orders=tuple(order if len(order) == 3 else "ZXY" for order in orders),
            moving=tuple(j for j, own in enumerate(tree.channels) if j and any(c in PLACES for c in own)),
        )
    except InputError as error:
        raise FormatError(path, str(error)) from None


def _head(lines: list[tuple[int, str]], at: int, path: str | Path) -> tuple[int, float, int]:
    """Number of frames, time from one to the next (s), and the line after."""
    found: dict[str, float] = {}
    for key in ("frames", "frame time"):
        number, text = lines[at] if at < len(lines) else (0, "")
        name, colon, value = text.partition(":")
        if not colon or name.strip().lower() != key:
            raise FormatError(path, f"after MOTION there is no '{key.capitalize()}:'", where=f"line {number}")
        found[key] = _floats(value, 1, path, f"line {number}")[0]
        at += 1
    if found["frames"] < 0 or found["frames"] != int(found["frames"]) or found["frame time"] <= 0:
        raise FormatError(path, f"{found['frames']:g} frames of {found['frame time']:g} s cannot be")
    return int(found["frames"]), found["frame time"], at


def _numbers(lines: list[tuple[int, str]], frames: int, width: int, path: str | Path) -> Array:
    if len(lines) < frames:
        raise FormatError(path, f"says {frames} frames, but has {len(lines)}")
    out = np.empty((frames, width))
    for f in range(frames):
        number, text = lines[f]
        try:
            row = np.array(text.split(), dtype=float)
        except ValueError:
            raise FormatError(path, "is not numbers only", where=f"line {number}, frame {f}") from None
        if len(row) != width:
            raise FormatError(path, f"has {len(row)} numbers, not {width}", where=f"line {number}, frame {f}")
        out[f] = row
    if not np.isfinite(out).all():
        raise FormatError(path, "holds numbers that are not finite")
    return out


def write(motion: Motion, path: str | Path, unit_m: float) -> None:
    """Write a motion in its own axes; ``unit_m``: the unit of length that the file shall have."""
    skeleton = motion.skeleton
    digits = 6 if unit_m < 0.1 else 9
    lines = ["HIERARCHY"]
    columns: list[Array] = []

    def offset(values: Any) -> str:
        return "OFFSET " + " ".join(f"{float(v) / unit_m:.{digits}f}" for v in values)

    def put(j: int, depth: int) -> None:
        pad = "\t" * depth
        lines.append(f"{pad}{'JOINT' if depth else 'ROOT'} {skeleton.joints[j]}")
        lines.append(pad + "{")
        lines.append(f"{pad}\t{offset(skeleton.offsets_m[j] if j else np.zeros(3))}")
        order = skeleton.orders[j]
        channels = [f"{axis}rotation" for axis in order]
        if j == 0 or j in skeleton.moving:
            channels = [*PLACES, *channels]
            place = motion.root_m if j == 0 else _shifts(motion)[:, j]
            columns.append(place / unit_m)
        columns.append(_unwrapped(order, motion.turns[:, j]))
        lines.append(f"{pad}\tCHANNELS {len(channels)} {' '.join(channels)}")
        below = skeleton.children(j)
        for child in below:
            put(child, depth + 1)
        if not below:
            ends = [s.place_m for s in skeleton.sites if s.joint == j] or [skeleton.offsets_m[j] * STUB]
            lines.extend([f"{pad}\tEnd Site", pad + "\t{", f"{pad}\t\t{offset(ends[0])}", pad + "\t}"])
        lines.append(pad + "}")

    put(0, 0)
    values = np.concatenate(columns, axis=1) if len(motion) else np.zeros((0, 1))
    lines += ["MOTION", f"Frames: {len(motion)}", f"Frame Time: {1.0 / motion.rate_hz:.9f}"]
    lines += [" ".join(f"{v:.{digits}f}" for v in row) for row in values]
    write_text(path, "\n".join(lines) + "\n")


def _shifts(motion: Motion) -> Array:
    if motion.shifts_m is not None:
        return motion.shifts_m
    return np.broadcast_to(motion.skeleton.offsets_m, (len(motion), *motion.skeleton.offsets_m.shape))


def _unwrapped(order: str, rotations: Array) -> Array:
    """Angles (deg) in the order of the channels, without jumps by whole turns."""
    if not len(rotations):
        return np.zeros((0, 3))
    return np.rad2deg(np.unwrap(euler(order, rotations), axis=0))
