"""Subjects: the distances between the markers of one person or thing, with their spreads, as TOML.

A subject is what `label` looks for: mean and spread of every distance, how far each is trusted (1 = rigid), and signed
heights of markers over triangles of others, which a mirror image has with the wrong sign.
"""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from markerloom import _core
from markerloom.errors import FormatError, InputError
from markerloom.formats.files import read_text, write_text

Length = tuple[float, float, float]
Height = tuple[list[int], Length]


@dataclass(frozen=True)
class Subject:
    """One person or thing. Lengths are (mean, standard deviation, trust) in metres.

    ``distances``: of every pair of markers, row by row, ``None`` where it is not known; ``heights``: of every marker,
    (three others, length); ``poses``: how many independent poses it was learned from.
    """

    name: str
    markers: tuple[str, ...]
    segments: tuple[str, ...]
    distances: list[Length | None]
    heights: list[list[Height]]
    poses: float
    marker_set: str = ""

    def __len__(self) -> int:
        """Return the number of markers."""
        return len(self.markers)

    @property
    def size_m(self) -> float:
        """The largest mean distance of two markers (m)."""
        return max((d[0] for d in self.distances if d is not None), default=0.0)


def model_of(subjects: list[Subject]) -> _core.LabelModel:
    """The engine's model of one or several subjects, their markers one after the other."""
    if len(subjects) == 1:
        one = subjects[0]
        return _core.LabelModel([0] * len(one), one.distances, one.heights)
    total = sum(len(s) for s in subjects)
    distances: list[Length | None] = [None] * (total * total)
    heights: list[list[Height]] = []
    whose: list[int] = []
    for number, subject in enumerate(subjects):
        first, n = len(whose), len(subject)
        for a in range(n):
            distances[(first + a) * total + first : (first + a) * total + first + n] = subject.distances[
                a * n : (a + 1) * n
            ]
        heights += [[([first + i for i in base], length) for base, length in own] for own in subject.heights]
        whose += [number] * n
    return _core.LabelModel(whose, distances, heights)


def with_markers(subject: Subject, names: dict[str, str]) -> Subject:
    """The subject with only some of its markers, in its own order: ``names`` has the present name of each that stays,
    and the one it gets. What is known of the others goes with them. Raises ``InputError`` for unknown or equal names.
    """
    strangers = sorted(set(names) - set(subject.markers))
    if strangers:
        raise InputError(f"subject '{subject.name}' has no marker '{strangers[0]}'")
    if len(set(names.values())) < len(names) or "" in names.values():
        raise InputError(f"markers of subject '{subject.name}' need names of their own")
    kept = [i for i, m in enumerate(subject.markers) if m in names]
    place, n = {old: new for new, old in enumerate(kept)}, len(subject)
    heights = [
        [([place[b] for b in base], length) for base, length in subject.heights[i] if set(base) <= set(place)]
        for i in kept
    ]
    return replace(
        subject,
        markers=tuple(names[subject.markers[i]] for i in kept),
        segments=tuple(subject.segments[i] for i in kept),
        distances=[subject.distances[i * n + j] for i in kept for j in kept],
        heights=heights,
    )


def write_subject(subject: Subject, path: str | Path) -> None:
    """Write a subject as TOML; lengths in millimetres."""
    if Path(path).suffix != ".toml":
        raise InputError(f"subjects are written as .toml ({path})")
    n = len(subject)
    lines = [
        "# A subject of markerloom: distances as [marker, marker, mean, standard deviation, trust], and",
        "# heights over triangles as [marker, [three others], mean, standard deviation, trust]; in mm.",
        f"name = {json.dumps(subject.name)}",
        f"marker_set = {json.dumps(subject.marker_set)}",
        f"poses = {subject.poses:.3f}",
        "",
        f"markers = {json.dumps(list(subject.markers))}",
        f"segments = {json.dumps(list(subject.segments))}",
        "",
        "distances = [",
    ]
    quoted = [json.dumps(name) for name in subject.markers]
    for a in range(n):
        for b in range(a + 1, n):
            length = subject.distances[a * n + b]
            if length is not None:
                lines.append(f"  [{quoted[a]}, {quoted[b]}, {_text(length)}],")
    lines += ["]", "", "heights = ["]
    for marker, own in enumerate(subject.heights):
        for base, length in own:
            lines.append(f"  [{quoted[marker]}, [{', '.join(quoted[i] for i in base)}], {_text(length)}],")
    write_text(path, "\n".join([*lines, "]", ""]))


def _text(length: Length) -> str:
    mean, sd, trust = length
    return f"{1000 * mean:.3f}, {1000 * sd:.3f}, {trust:.3f}"


def read_subject(path: str | Path) -> Subject:
    """Read a subject; raises ``FormatError`` where it is none or is damaged."""
    try:
        content = tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        raise FormatError(path, f"not a TOML file: {error}") from None
    if not {"markers", "distances", "heights"} <= set(content):
        raise FormatError(path, "no subject: make one with 'markerloom subject create'")
    try:
        return _of_content(content, path)
    except (KeyError, ValueError, TypeError) as error:
        raise FormatError(path, f"the subject is damaged: {error}") from None


def _of_content(content: dict[str, Any], path: str | Path) -> Subject:
    markers = [str(m) for m in content["markers"]]
    index = {name: i for i, name in enumerate(markers)}
    n = len(markers)
    distances: list[Length | None] = [None] * (n * n)
    for a, b, *numbers in content["distances"]:
        i, j = index[a], index[b]
        distances[i * n + j] = distances[j * n + i] = _length(numbers)
    heights: list[list[Height]] = [[] for _ in range(n)]
    for marker, base, *numbers in content["heights"]:
        heights[index[marker]].append(([index[b] for b in base], _length(numbers)))
    return Subject(
        name=str(content.get("name", Path(path).stem)),
        markers=tuple(markers),
        segments=tuple(content.get("segments", [""] * n)),
        distances=distances,
        heights=heights,
        poses=float(content.get("poses", 1.0)),
        marker_set=str(content.get("marker_set", "")),
    )


def _length(numbers: list[float]) -> Length:
    mean, sd, trust = (float(v) for v in numbers)
    if not (mean == mean and sd > 0 and 0 <= trust <= 1):
        raise ValueError(f"{numbers} is no length")
    return mean / 1000.0, sd / 1000.0, trust
