"""Which marker is on which segment, and about where: from marker sets, subjects, or a few hints."""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import FormatError, InputError
from markerloom.formats.files import read_text
from markerloom.skeleton.skeleton import Skeleton
from markerloom.subjects.marker_set import MarkerSet, marker_sets, read_marker_set

Array = NDArray[np.floating[Any]]
PARTS = {
    "pelvis": "pelvis hips hip sacrum",
    "thorax": "thorax torso chest trunk spine",
    "head": "head skull",
    "clavicle": "clavicle clav scapula shoulder collar",
    "upper_arm": "upper_arm upperarm humerus arm uarm",
    "forearm": "forearm fore_arm lower_arm lowerarm radius ulna farm larm",
    "hand": "hand wrist",
    "thigh": "thigh femur up_leg upleg upper_leg upperleg",
    "shank": "shank tibia shin calf leg low_leg lower_leg lowerleg",
    "foot": "foot calcn talus ankle",
    "toes": "toes toe",
}
"""Words that files use for the body's parts."""
KNOWN_SET = 0.6
"""A take wears a known marker set where at least this share of the set's names is in it."""
SHOULDER = (0.07, 0.78)
"""Markers of the thorax farther out and higher up than this (parts of the stature) move with the collar bones."""


@dataclass(frozen=True)
class Hints:
    """What a person says of the markers: segment of each, and rules for joint centres (see `rules`)."""

    segments: dict[str, str]
    joints: dict[str, dict[str, Any]]
    source: str = ""


def read_hints(path: str | Path) -> Hints:
    """Hints as TOML: ``[segments]`` with lists of markers, ``[joints]`` with a rule for a joint centre each."""
    try:
        content = tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        raise FormatError(path, f"not a TOML file: {error}") from None
    segments: dict[str, str] = {}
    for segment, markers in content.get("segments", {}).items():
        if not (isinstance(markers, list) and all(isinstance(m, str) for m in markers)):
            raise FormatError(path, "is not a list of markers", where=f"segment '{segment}'")
        for marker in markers:
            if marker in segments:
                raise FormatError(path, f"marker '{marker}' is on '{segments[marker]}' and on '{segment}'")
            segments[marker] = segment
    if not segments:
        raise FormatError(path, "hints have a table [segments] with a list of markers for each segment")
    return Hints(segments, dict(content.get("joints", {})), str(path))


@dataclass(frozen=True)
class Placed:
    """Markers by name with the joint that carries each; ``place`` (n, 3): left, back, up in the T-pose as parts of the
    stature, NaN where only the segment is known.
    """

    markers: list[str]
    joints: list[int]
    place: Array
    unplaced: list[str]
    source: str

    def __len__(self) -> int:
        """Return the number of markers that are on a segment."""
        return len(self.markers)


def place_markers(names: list[str], skeleton: Skeleton, known: Hints | MarkerSet | None, source: str) -> Placed:
    """For the markers of a take: the joint and the place of each. Without anything said, from their names: the known
    marker set that has most of them.

    Raises ``InputError`` where the names tell nothing, and where hints name markers that are not in the take.
    """
    others: list[MarkerSet] = []
    if known is None:
        known, *others = _worn_sets(names, source)
    if isinstance(known, Hints):
        absent = [m for m in known.segments if m not in names]
        if absent:
            raise InputError(f"{known.source}: there is no marker '{absent[0]}' in {source}")
        segments, places, said = known.segments, {}, known.source
    else:
        segments, places = {}, {}
        for made in [known, *others]:
            for marker, segment, p in zip(made.markers, made.segments, made.places, strict=True):
                if segment:
                    segments.setdefault(marker, segment)
                    places.setdefault(marker, np.array([p[1], -p[0], p[2]]))
        said = f"marker set '{known.name}'"
    markers, joints, place, unplaced = [], [], [], []
    for name in names:
        where = places.get(name, np.full(3, np.nan))
        joint = -1 if name not in segments else segment_joint(skeleton, segments[name], where)
        if joint < 0 and name in segments and isinstance(known, Hints):
            raise InputError(
                f"{said}: skeleton '{skeleton.name}' has no segment or joint '{segments[name]}': "
                f"{', '.join(skeleton.segments or skeleton.joints[:12])}"
            )
        if joint < 0:
            unplaced.append(name)
            continue
        markers.append(name)
        joints.append(joint)
        place.append(where)
    if len(set(joints)) < 2 or len(markers) < 6:
        raise InputError(f"{said} puts only {len(markers)} of the take's {len(names)} markers on segments ({source})")
    return Placed(markers, joints, np.array(place), unplaced, said)


def _worn_sets(names: list[str], source: str) -> list[MarkerSet]:
    """The known marker set that the take's names are of, and the others: laboratories add markers from one another."""

    def share(made: MarkerSet) -> float:
        return sum(m in names for m in made.markers) / len(made)

    sets = sorted((read_marker_set(name) for name in marker_sets()), key=lambda made: (-share(made), -len(made)))
    if share(sets[0]) < KNOWN_SET:
        raise InputError(
            f"the names of the markers ({', '.join(names[:4])}, …) are of no known marker set: give --marker-set, or "
            f"--hints with a TOML that says which markers are on which segment ({source})"
        )
    return sets


def segment_joint(skeleton: Skeleton, segment: str, place: Array) -> int:
    """The joint that moves a segment, by any of the names in use; −1 where there is none."""
    found = skeleton.index(segment)
    if found >= 0 and not (segment == "thorax" and np.isfinite(place).all()):
        return found
    side, part = split_side(segment)
    if part == "thorax" and np.isfinite(place).all() and abs(place[0]) > SHOULDER[0] and place[2] > SHOULDER[1]:
        side, part = ("left" if place[0] > 0 else "right"), "clavicle"
    return skeleton.segments.get(f"{side}_{part}" if side else part, found)


def split_side(segment: str) -> tuple[str, str]:
    """Side (left, right or nothing) and part of the body of a segment's name in any of the usual spellings."""
    words = [w.lower() for w in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+", segment)]
    side = ""
    for short, long in (("l", "left"), ("r", "right")):
        if short in words or long in words:
            side = long
            words = [w for w in words if w not in (short, long)]
    text = "_".join(words)
    if not side and text[:1] in "lr" and _part(text[1:]):
        side, text = ("left" if text[0] == "l" else "right"), text[1:]
    return side, _part(text) or text


def _part(text: str) -> str:
    return next((part for part, words in PARTS.items() if text in words.split()), "")
