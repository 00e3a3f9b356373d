"""Acclaim ASF (skeleton) and AMC (motion).

A bone turns about its start by L = C·M·C⁻¹: C from its `axis`, M from the frame's values, the first degree of freedom
applied first; it ends at `direction`·`length` in the world's axes of the rest pose, and its children begin there.
Lengths are inches when divided by the file's `length` unit (as in the CMU database).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from markerloom.errors import FormatError, InputError
from markerloom.formats.files import read_text, write_text
from markerloom.skeleton.motion import Motion, angles
from markerloom.skeleton.skeleton import NO_LIMIT, Site, Skeleton, in_order

Array = NDArray[np.floating[Any]]
INCH_M = 0.0254
DEGREES = ("rx", "ry", "rz", "tx", "ty", "tz")


@dataclass
class Bone:
    """One bone as the file has it; ``axis``: rotation C."""

    name: str
    direction: Array = field(default_factory=lambda: np.zeros(3))
    length: float = 0.0
    axis: Rotation = field(default_factory=Rotation.identity)
    dof: list[str] = field(default_factory=list)
    limits: list[tuple[float, float]] = field(default_factory=list)


@dataclass
class Acclaim:
    """A skeleton file: bones by name, the root first; ``unit_m``; whether angles are degrees."""

    bones: dict[str, Bone]
    parent_of: dict[str, str | None]
    position: Array
    length: float
    degrees: bool


def read_asf(path: str | Path) -> Acclaim:
    """A skeleton file. Raises ``FormatError`` for unknown bones, cycles, and directions without a length."""
    sections = _sections(path)
    units = dict(line.split(None, 1) for _, line in sections.get("units", []) if " " in line)
    degrees = not units.get("angle", "deg").strip().lower().startswith("rad")
    try:
        length = float(units.get("length", "1"))
    except ValueError:
        length = 0.0
    if length <= 0:
        raise FormatError(path, f"the unit of length is '{units.get('length')}'")
    bones = {"root": _root(sections.get("root", []), path, degrees)}
    position = bones["root"].direction.copy()
    bones["root"].direction = np.zeros(3)
    for bone in _bones(sections.get("bonedata", []), path, degrees):
        if bone.name in bones:
            raise FormatError(path, f"bone '{bone.name}' is there twice")
        bones[bone.name] = bone
    parent_of = _parents(sections.get("hierarchy", []), bones, path)
    return Acclaim(bones, parent_of, position, length, degrees)


def _sections(path: str | Path) -> dict[str, list[tuple[int, str]]]:
    sections: dict[str, list[tuple[int, str]]] = {}
    now: list[tuple[int, str]] = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        text = line.split("#", 1)[0].strip()
        if text.startswith(":"):
            key, _, rest = text[1:].partition(" ")
            now = sections.setdefault(key.strip().lower(), [])
            if rest.strip():
                now.append((number, rest.strip()))
        elif text:
            now.append((number, text))
    if "bonedata" not in sections or "hierarchy" not in sections:
        raise FormatError(path, "has no :bonedata and :hierarchy: it is no ASF")
    return sections


def _turn(order: str, values: list[float], degrees: bool) -> Rotation:
    """C of an `axis` line: the first letter is applied first."""
    return Rotation.from_euler(order.lower(), np.deg2rad(values) if degrees else np.array(values))


def _floats(words: list[str], count: int, path: str | Path, where: str) -> list[float]:
    try:
        values = [float(w) for w in words[:count]]
    except ValueError:
        values = []
    if len(values) < count or not np.isfinite(values).all():
        raise FormatError(path, f"'{' '.join(words)}' is not {count} numbers", where=where)
    return values


def _root(lines: list[tuple[int, str]], path: str | Path, degrees: bool) -> Bone:
    """The root; its `position` is put into ``direction``."""
    bone, order, orientation = Bone("root"), "xyz", [0.0] * 3
    for number, line in lines:
        words = line.split()
        where = f"line {number}"
        if words[0].lower() == "order":
            bone.dof = [w.lower() for w in words[1:]]
        elif words[0].lower() == "axis":
            order = words[1].lower() if len(words) > 1 else order
        elif words[0].lower() == "position":
            bone.direction = np.array(_floats(words[1:], 3, path, where))
        elif words[0].lower() == "orientation":
            orientation = _floats(words[1:], 3, path, where)
    if sorted(bone.dof) != sorted(DEGREES):
        raise FormatError(path, f"the root's order is '{' '.join(bone.dof)}', not TX TY TZ RX RY RZ in some order")
    if sorted(order) != ["x", "y", "z"]:
        raise FormatError(path, f"the root's axis is '{order}'")
    bone.axis = _turn(order, orientation, degrees)
    return bone


def _bones(lines: list[tuple[int, str]], path: str | Path, degrees: bool) -> list[Bone]:
    bones: list[Bone] = []
    bone: Bone | None = None
    limits: list[float] = []
    in_limits = False
    for number, line in lines:
        words = line.split()
        key, where = words[0].lower(), f"line {number}"
        if key == "begin":
            bone, limits, in_limits = Bone(""), [], False
        elif key == "end":
            if bone is None or not bone.name:
                raise FormatError(path, "a bone without a name", where=where)
            bone.limits = list(zip(limits[::2], limits[1::2], strict=False))
            bones.append(bone)
            bone = None
        elif bone is None:
            raise FormatError(path, f"'{line}' outside of begin and end", where=where)
        elif key == "name":
            bone.name = words[1] if len(words) > 1 else ""
            in_limits = False
        elif key == "direction":
            bone.direction = np.array(_floats(words[1:], 3, path, where))
        elif key == "length":
            bone.length = _floats(words[1:], 1, path, where)[0]
        elif key == "axis":
            order = words[4].lower() if len(words) > 4 else "xyz"
            if sorted(order) != ["x", "y", "z"]:
                raise FormatError(path, f"axis order '{order}'", where=where)
            bone.axis = _turn(order, _floats(words[1:], 3, path, where), degrees)
        elif key == "dof":
            bone.dof = [w.lower() for w in words[1:]]
            unknown = [d for d in bone.dof if d not in ("rx", "ry", "rz")]
            if unknown:
                raise FormatError(
                    path, f"bone '{bone.name}' moves by '{unknown[0]}': only rx ry rz are read", where=where
                )
        elif key == "limits" or (in_limits and key.startswith("(")):
            in_limits = True
            text = line.replace("limits", " ").replace("(", " ").replace(")", " ").replace(",", " ")
            limits += [_limit(word, path, where) for word in text.split()]
        elif key not in ("id", "bodymass", "cofmass"):
            in_limits = False
    return bones


def _limit(word: str, path: str | Path, where: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise FormatError(path, f"'{word}' is no limit", where=where) from None


def _parents(lines: list[tuple[int, str]], bones: dict[str, Bone], path: str | Path) -> dict[str, str | None]:
    parent_of: dict[str, str | None] = {"root": None}
    for number, line in lines:
        words = line.split()
        if words[0].lower() in ("begin", "end"):
            continue
        for name in words:
            if name not in bones:
                raise FormatError(path, f"there is no bone '{name}'", where=f"line {number}")
        for child in words[1:]:
            if child in parent_of:
                raise FormatError(path, f"bone '{child}' hangs from two others", where=f"line {number}")
            parent_of[child] = words[0]
    for name in bones:
        if name not in parent_of:
            raise FormatError(path, f"bone '{name}' hangs from nothing")
    return parent_of


def skeleton_of(acclaim: Acclaim, path: str | Path, unit_m: float | None = None) -> Skeleton:
    """The skeleton in the file's axes: joint of each bone at its start, an end site where a bone has no child."""
    unit = unit_m or INCH_M / acclaim.length
    try:
        names = in_order(list(acclaim.bones), acclaim.parent_of, Path(path).name)
    except InputError as error:
        raise FormatError(path, str(error)) from None
    index = {name: i for i, name in enumerate(names)}
    vectors = {}
    for name, bone in acclaim.bones.items():
        norm = float(np.linalg.norm(bone.direction))
        if bone.length > 0 and norm < 1e-9:
            raise FormatError(path, f"bone '{name}' has a length but no direction")
        vectors[name] = bone.direction * (bone.length / norm if norm > 0 else 0.0) * unit
    parents = [-1 if acclaim.parent_of[n] is None else index[str(acclaim.parent_of[n])] for n in names]
    offsets = np.array([np.zeros(3) if p < 0 else vectors[names[p]] for p in parents])
    leaves = [n for i, n in enumerate(names) if i not in parents and np.linalg.norm(vectors[n]) > 0]
    free = np.array([[f"r{a}" in acclaim.bones[n].dof for a in "xyz"] for n in names])
    return Skeleton(
        name=Path(path).stem,
        joints=tuple(names),
        parents=tuple(parents),
        offsets_m=offsets,
        sites=tuple(Site(f"{n}_end", index[n], tuple(vectors[n].tolist())) for n in leaves),
        free=free,
        limits_rad=np.array([_limits(acclaim.bones[n], acclaim.degrees) for n in names]),
        orders=tuple(_order(acclaim.bones[n].dof) for n in names),
    )


def _limits(bone: Bone, degrees: bool) -> list[list[float]]:
    out = [[-NO_LIMIT, NO_LIMIT] if f"r{a}" in bone.dof else [0.0, 0.0] for a in "xyz"]
    for dof, (low, high) in zip(bone.dof, bone.limits, strict=False):
        unit = np.pi / 180.0 if degrees else 1.0
        out["xyz".index(dof[1])] = [low * unit, high * unit]
    return out


def _order(dof: list[str]) -> str:
    """The order that a BVH of the same motion would have: the last degree of freedom stands first."""
    found = "".join(d[1].upper() for d in reversed(dof) if d.startswith("r"))
    return found if len(found) == 3 else "ZYX"


def read(path: str | Path, asf_path: str | Path, *, rate_hz: float, unit_m: float | None = None) -> Motion:
    """An AMC on its ASF, in the file's axes.

    Raises ``FormatError`` for bones that the skeleton has not, and frames with too few or too many numbers.
    """
    acclaim = read_asf(asf_path)
    skeleton = skeleton_of(acclaim, asf_path, unit_m)
    unit = unit_m or INCH_M / acclaim.length
    moving = {n: b for n, b in acclaim.bones.items() if b.dof}
    values, degrees = _values(path, moving, acclaim.degrees)
    frames = len(values["root"]) if values else 0
    turns = np.tile(np.eye(3), (frames, len(skeleton), 1, 1))
    root_m = np.tile(acclaim.position * unit, (frames, 1))
    for name, bone in moving.items():
        own = values[name]
        rotations = [i for i, d in enumerate(bone.dof) if d[0] == "r"]
        order = "".join(bone.dof[i][1] for i in rotations)
        angle = np.deg2rad(own[:, rotations]) if degrees else own[:, rotations]
        turn = Rotation.from_euler(order, angle)
        turns[:, skeleton.joints.index(name)] = (bone.axis * turn * bone.axis.inv()).as_matrix()
        for i, d in enumerate(bone.dof):
            if d[0] == "t":
                root_m[:, "xyz".index(d[1])] += own[:, i] * unit
    # The root's own orientation in the skeleton file turns the whole figure.
    turns[:, 0] = turns[:, 0] @ acclaim.bones["root"].axis.as_matrix()
    return Motion(skeleton, root_m, turns, rate_hz, first_frame=1, source=str(path))


def _values(path: str | Path, moving: dict[str, Bone], degrees: bool) -> tuple[dict[str, Array], bool]:
    """Numbers of every bone (frames, degrees of freedom), and whether they are degrees."""
    rows: dict[str, list[list[float]]] = {name: [] for name in moving}
    frame, frames = "", 0
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        text = line.split("#", 1)[0].strip()
        if text.startswith(":"):
            degrees = True if text.upper() == ":DEGREES" else False if text.upper() == ":RADIANS" else degrees
            continue
        if not text:
            continue
        words = text.split()
        where = f"line {number}, frame {frame}"
        if len(words) == 1 and words[0].isdigit():
            _complete(rows, frames, path, f"line {number}, frame {frame}")
            frame, frames = words[0], frames + 1
            continue
        if frames == 0:
            raise FormatError(path, f"'{text}' before the first frame", where=f"line {number}")
        if words[0] not in moving:
            raise FormatError(path, f"the skeleton has no moving bone '{words[0]}'", where=where)
        if len(words) - 1 != len(moving[words[0]].dof) or len(rows[words[0]]) >= frames:
            raise FormatError(
                path, f"bone '{words[0]}' needs {len(moving[words[0]].dof)} numbers, once per frame", where=where
            )
        rows[words[0]].append(_floats(words[1:], len(words) - 1, path, where))
    _complete(rows, frames, path, f"frame {frame}")
    if frames == 0:
        raise FormatError(path, "holds no frame")
    return {name: np.array(own, float).reshape(frames, -1) for name, own in rows.items()}, degrees


def _complete(rows: dict[str, list[list[float]]], frames: int, path: str | Path, where: str) -> None:
    missing = [name for name, own in rows.items() if len(own) < frames]
    if missing:
        raise FormatError(path, f"bone '{missing[0]}' has no numbers", where=where)


def write(motion: Motion, path: str | Path, unit_m: float, *, radians: bool = False) -> tuple[Path, Path]:
    """Write PATH.asf and PATH.amc in the motion's axes; returns both paths.

    A joint with several children becomes a bone of no length with one bone without freedom to each of them.
    """
    if motion.shifts_m is not None:
        raise InputError(f"{motion.source}: its bones change their lengths, which ASF/AMC cannot say")
    asf, amc = Path(path).with_suffix(".asf"), Path(path).with_suffix(".amc")
    skeleton = motion.skeleton
    free = skeleton.free.copy()
    for j in range(1, len(skeleton)):
        order = _file_order(skeleton, j)
        own = angles(order, motion.turns[:, j])
        free[j] |= np.abs(own).max(axis=0, initial=0.0) > 1e-7
    bones, hierarchy = _as_bones(skeleton)
    scale = 1.0 / unit_m
    unit = 1.0 if radians else 180.0 / np.pi
    lines = [":version 1.10", f":name {skeleton.name.replace(' ', '_')}", ":units", "  mass 1.0"]
    lines += [f"  length {INCH_M / unit_m:.9f}", f"  angle {'rad' if radians else 'deg'}", ":root"]
    lines += ["  order TX TY TZ RX RY RZ", "  axis XYZ", "  position 0 0 0", "  orientation 0 0 0", ":bonedata"]
    for number, (name, joint, vector) in enumerate(bones, start=1):
        length = float(np.linalg.norm(vector))
        direction = vector / length if length > 0 else np.array([0.0, 0.0, 1.0])
        lines += ["  begin", f"    id {number}", f"    name {name}"]
        lines += ["    direction " + " ".join(f"{v:.12f}" for v in direction), f"    length {length * scale:.9f}"]
        lines.append("    axis 0 0 0 XYZ")
        dof = [] if joint is None else _dof(skeleton, joint, free)
        if dof:
            lines.append("    dof " + " ".join(f"r{a.lower()}" for a in dof))
            limits = [skeleton.limits_rad[joint]["XYZ".index(a)] * unit for a in dof]
            pairs = [f"({low:.6f} {high:.6f})" for low, high in limits]
            lines += [("    limits " if i == 0 else "           ") + pair for i, pair in enumerate(pairs)]
        lines.append("  end")
    lines += [":hierarchy", "  begin", *(f"    {parent} {' '.join(own)}" for parent, own in hierarchy.items()), "  end"]
    numbers = _columns(motion, free, unit)
    text = [":FULLY-SPECIFIED", ":RADIANS" if radians else ":DEGREES"]
    root = np.concatenate([motion.root_m * scale, numbers.pop(0)], axis=1)
    for f in range(len(motion)):
        text.append(str(f + 1))
        text.append("root " + " ".join(f"{v:.9f}" for v in root[f]))
        text += [f"{skeleton.joints[j]} " + " ".join(f"{v:.9f}" for v in own[f]) for j, own in numbers.items()]
    write_text(asf, "\n".join(lines) + "\n")
    write_text(amc, "\n".join(text) + "\n")
    return asf, amc


def _file_order(skeleton: Skeleton, joint: int) -> str:
    """In which order a joint turns about the axes: its own where it has one."""
    return skeleton.turns_about[joint] or "XYZ"


def _dof(skeleton: Skeleton, joint: int, free: NDArray[np.bool_]) -> list[str]:
    """Axes of a joint's degrees of freedom as the file lists them: the one applied first stands first."""
    return [a for a in reversed(_file_order(skeleton, joint)) if free[joint]["XYZ".index(a)]]


def _as_bones(skeleton: Skeleton) -> tuple[list[tuple[str, int | None, Array]], dict[str, list[str]]]:
    """Bones (name, joint that turns it, vector) and who hangs from whom."""
    bones: list[tuple[str, int | None, Array]] = []
    hierarchy: dict[str, list[str]] = {}

    def own_name(j: int) -> str:
        return "root" if j == 0 else skeleton.joints[j]

    for j in range(len(skeleton)):
        below = skeleton.children(j)
        vector = np.zeros(3)
        if not below:
            ends = [np.array(s.place_m) for s in skeleton.sites if s.joint == j]
            vector = ends[0] if ends else vector
        elif len(below) == 1 and j > 0:
            vector = skeleton.offsets_m[below[0]]
        if j > 0:
            bones.append((own_name(j), j, vector))
        for child in below:
            if len(below) == 1 and j > 0:
                hierarchy.setdefault(own_name(j), []).append(own_name(child))
            elif np.linalg.norm(skeleton.offsets_m[child]) > 0:
                between = f"{skeleton.joints[child]}_dum"
                bones.append((between, None, skeleton.offsets_m[child]))
                hierarchy.setdefault(own_name(j), []).append(between)
                hierarchy.setdefault(between, []).append(own_name(child))
            else:
                hierarchy.setdefault(own_name(j), []).append(own_name(child))
    return bones, hierarchy


def _columns(motion: Motion, free: NDArray[np.bool_], unit: float) -> dict[int, Array]:
    """Numbers of the root's turn (0) and of every joint that turns (frames, degrees of freedom)."""
    skeleton = motion.skeleton
    out = {0: np.unwrap(Rotation.from_matrix(motion.turns[:, 0]).as_euler("xyz"), axis=0) * unit}
    for j in range(1, len(skeleton)):
        dof = _dof(skeleton, j, free)
        if dof:
            own = np.unwrap(angles(_file_order(skeleton, j), motion.turns[:, j]), axis=0)
            out[j] = own[:, ["XYZ".index(a) for a in dof]] * unit
    return out


def find_asf(path: str | Path) -> Path:
    """The skeleton of an AMC: of the same name, or with its beginning (01_01.amc: 01.asf)."""
    path = Path(path)
    same = path.with_suffix(".asf")
    if same.exists():
        return same
    near = [p for p in sorted(path.parent.glob("*.asf")) if path.stem.startswith(p.stem)]
    if near:
        return max(near, key=lambda p: len(p.stem))
    raise InputError(f"{path}: its skeleton is not beside it: put {same.name} into the same folder")


def renamed_axes(skeleton: Skeleton, names: str) -> Skeleton:
    """A skeleton whose turns and limits are told in other axes: ``names`` = for X, Y, Z the new axis with its sign, as
    "+X+Z-Y" read in pairs.
    """
    signs = [1.0 if names[2 * k] == "+" else -1.0 for k in range(3)]
    target = ["XYZ".index(names[2 * k + 1]) for k in range(3)]
    free, limits, habit = skeleton.free.copy(), skeleton.limits_rad.copy(), skeleton.habit_rad.copy()
    for k in range(3):
        free[:, target[k]] = skeleton.free[:, k]
        habit[:, target[k]] = skeleton.habit_rad[:, k]
        own = skeleton.limits_rad[:, k]
        limits[:, target[k]] = own if signs[k] > 0 else -own[:, ::-1]
    letters = {"XYZ"[k]: "XYZ"[target[k]] for k in range(3)}
    about = tuple("".join(letters[a] for a in order) for order in skeleton.turns_about)
    return replace(skeleton, free=free, limits_rad=limits, habit_rad=habit, turns_about=about)
