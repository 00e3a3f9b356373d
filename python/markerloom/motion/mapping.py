"""Which joint of one skeleton follows which of another: guessed by parts of the body and by names, kept as TOML."""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import FormatError, InputError
from markerloom.formats.files import read_text, write_text
from markerloom.motion.body import Body, body_of
from markerloom.skeleton.skeleton import Skeleton

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Mapping:
    """``joints``: of joints of the target (by name) the joint of the source that they follow. Others stay as they rest
    on the joint above; joints of the spine and the neck between two that follow share the turn between these.
    """

    joints: dict[str, str]


def guess(source: Skeleton, target: Skeleton) -> Mapping:
    """The mapping that parts of the body and names suggest.

    Raises ``InputError`` with the joints that could not be matched, where legs or the pelvis are among them.
    """
    ours, theirs = body_of(source), body_of(target)
    for body, what in ((ours, "source"), (theirs, "target")):
        if body.missing() or "pelvis" not in body.parts:
            lost = ", ".join(body.missing() or ["pelvis"])
            raise InputError(
                f"the {what} '{body.skeleton.name}' cannot be matched: no joint was found for {lost}; "
                f"its joints are {', '.join(body.skeleton.joints)}. Say which they are with a mapping"
            )
    pairs: dict[int, int] = {}
    for part, joint in theirs.parts.items():
        # A body without a spine has its chest in its hips: these come first.
        if part in ours.parts:
            pairs.setdefault(joint, ours.parts[part])
    for chain, own in ((theirs.spine, ours.spine), (theirs.neck, ours.neck)):
        if len(chain) == len(own):
            pairs |= dict(zip(chain, own, strict=True))
    by_name = {_plain(name): j for j, name in enumerate(source.joints)}
    used = set(pairs.values())
    trunk = {*theirs.spine, *theirs.neck, *target.above(theirs.parts["pelvis"])}
    for j, name in enumerate(target.joints):
        k = by_name.get(_plain(name))
        if j not in pairs and j not in trunk and k is not None and k not in used:
            pairs[j] = k
    return Mapping({target.joints[j]: source.joints[k] for j, k in sorted(pairs.items())})


def _plain(name: str) -> str:
    return name.rpartition(":")[2].lower().replace("_", "").replace(" ", "")


def indices(mapping: Mapping, source: Skeleton, target: Skeleton) -> dict[int, int]:
    """The mapping by indices: target's joint → source's. Raises ``InputError`` for joints that are not there."""
    out = {}
    for name, other in mapping.joints.items():
        for skeleton, joint, what in ((target, name, "target"), (source, other, "source")):
            if skeleton.index(joint) < 0:
                raise InputError(
                    f"mapping: the {what} '{skeleton.name}' has no joint '{joint}': {', '.join(skeleton.joints)}"
                )
        out[target.index(name)] = source.index(other)
    return out


def read_mapping(path: str | Path, source: Skeleton, target: Skeleton) -> Mapping:
    """A mapping from TOML: a table ``[joints]`` of target = source; "" lets a joint rest. What it does not name is
    guessed, where it can be.
    """
    try:
        content = tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        raise FormatError(path, f"not a TOML file: {error}") from None
    rows = content.get("joints")
    if not isinstance(rows, dict) or not all(isinstance(v, str) for v in rows.values()):
        raise FormatError(path, "has no table [joints] of target = source")
    try:
        joints = guess(source, target).joints
    except InputError:
        joints = {}
    joints = {k: v for k, v in (joints | rows).items() if v}
    mapping = Mapping(joints)
    indices(mapping, source, target)
    return mapping


def write_mapping(mapping: Mapping, target: Skeleton, path: str | Path) -> None:
    """Write a mapping, with the joints that follow nothing as comments."""
    lines = ["# Which joint of the source each joint of the target follows.", "[joints]"]
    for name in target.joints:
        key = json.dumps(name)
        lines.append(f"{key} = {json.dumps(mapping.joints[name])}" if name in mapping.joints else f'# {key} = ""')
    write_text(path, "\n".join(lines) + "\n")


def followed(target: Skeleton, pairs: dict[int, int]) -> list[int]:
    """Of every joint of the target the source's joint that it follows, or that the nearest joint above it follows."""
    out: list[int] = []
    for j, p in enumerate(target.parents):
        out.append(pairs.get(j, out[p] if p >= 0 else 0))
    return out


def with_parts(body: Body, other: Body, pairs: dict[int, int]) -> tuple[Body, Body]:
    """Bodies whose parts are known on one side only learn them from the mapping."""
    mine, theirs = dict(body.parts), dict(other.parts)
    for j, k in pairs.items():
        for part in [p for p, joint in body.parts.items() if joint == j and p not in theirs]:
            theirs[part] = k
        for part in [p for p, joint in other.parts.items() if joint == k and p not in mine]:
            mine[part] = j
    return Body(body.skeleton, mine, body.spine, body.neck), Body(other.skeleton, theirs, other.spine, other.neck)
