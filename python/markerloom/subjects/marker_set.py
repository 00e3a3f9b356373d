"""Marker sets: TOML with names, sides, segments, places on the body, colours, rigid pairs and virtual markers.

Places are parts of the stature in the T-pose: forward, left, up, from the floor between the feet. A set may leave them
out; it then names takes only through a subject. Read also: the markers of a Vicon subject or template (.vsk, .vst), the
MarkerSet of OpenSim (.xml), and the names of any labelled take.
"""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import FormatError, InputError
from markerloom.formats import POINTS_READ, ending, read_points
from markerloom.formats.files import read_text, write_text
from markerloom.formats.xml_file import parse
from markerloom.subjects.names import other_side, prefixes, side_of, split_prefix

SIDES = ("left", "right", "middle")


@dataclass(frozen=True)
class MarkerSet:
    """Markers by name; ``segments`` are empty and ``places`` NaN where they are not known.

    ``virtual`` are points that follow from markers: name to the markers whose mean it is.
    """

    name: str
    markers: tuple[str, ...]
    segments: tuple[str, ...]
    sides: tuple[str, ...]
    places: NDArray[np.floating[Any]]
    colors: tuple[str, ...]
    rigid_pairs: tuple[tuple[str, str], ...] = ()
    virtual: dict[str, tuple[str, ...]] = field(default_factory=dict)
    title: str = ""

    def __len__(self) -> int:
        """Return the number of markers."""
        return len(self.markers)

    def same_segment(self) -> list[bool | None]:
        """For every pair of markers, row by row, whether they are rigidly joined; ``None`` where it is not known."""
        rigid = {frozenset(pair) for pair in self.rigid_pairs}
        return [
            True if frozenset((a, b)) in rigid else (p == q if p and q else None)
            for a, p in zip(self.markers, self.segments, strict=True)
            for b, q in zip(self.markers, self.segments, strict=True)
        ]

    def pairs_of_sides(self) -> list[tuple[str, str]]:
        """Markers of the left with their fellows of the right."""
        found = [(name, other_side(name, self.markers)) for name in self.markers]
        return [(a, b) for (a, b), side in zip(found, self.sides, strict=True) if b is not None and side == "left"]


def marker_sets() -> list[str]:
    """Names of the marker sets that come with markerloom."""
    folder = resources.files("markerloom.subjects") / "sets"
    return sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml"))


def read_marker_set(source: str | Path) -> MarkerSet:
    """A marker set by its name, from TOML, .vsk, .vst, an OpenSim MarkerSet .xml, or from a labelled take.

    Raises ``InputError`` for an unknown name, ``FormatError`` for a file that holds none.
    """
    if str(source) in marker_sets():
        text = (resources.files("markerloom.subjects") / "sets" / f"{source}.toml").read_text("utf-8")
        return _of_toml(text, source)
    kind = ending(source)
    if kind == ".toml":
        return _of_toml(read_text(source), source)
    if kind in (".vsk", ".vst"):
        return _of_vicon(source)
    if kind == ".xml":
        return _of_opensim(source)
    if kind in POINTS_READ:
        return _of_take(source)
    raise InputError(
        f"marker set '{source}': {', '.join(marker_sets())}, or a .toml, .vsk, .vst, .xml or labelled take"
    )


def make_set(
    name: str,
    markers: list[str],
    path: str | Path,
    *,
    segments: list[str] | None = None,
    sides: list[str] | None = None,
    places: list[list[float]] | None = None,
    colors: list[str] | None = None,
    **more: Any,
) -> MarkerSet:
    """A set from lists; what is not known is left empty. Refuses markers that are named twice."""
    if not markers:
        raise FormatError(path, "there is no marker in it")
    twice = sorted({m for m in markers if markers.count(m) > 1})
    if twice:
        raise FormatError(path, f"marker '{twice[0]}' is there twice")
    n = len(markers)
    return MarkerSet(
        name=name,
        markers=tuple(markers),
        segments=tuple(segments or [""] * n),
        sides=tuple(sides or [side_of(m, markers) for m in markers]),
        places=np.array(places, float).reshape(n, 3) if places else np.full((n, 3), np.nan),
        colors=tuple(colors or [""] * n),
        **more,
    )


def _of_toml(text: str, path: str | Path) -> MarkerSet:
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise FormatError(path, f"not a TOML file: {error}") from None
    rows = content.get("markers")
    if not isinstance(rows, list) or not all(isinstance(r, dict) and isinstance(r.get("name"), str) for r in rows):
        raise FormatError(path, "a marker set has one [[markers]] table with a name for each marker")
    names = [r["name"] for r in rows]
    for row in rows:
        place, side = row.get("place"), row.get("side", "middle")
        if place is not None and not (isinstance(place, list) and len(place) == 3):
            raise FormatError(path, "place is not [forward, left, up]", where=f"marker '{row['name']}'")
        if side not in SIDES:
            raise FormatError(path, f"side is '{side}': {', '.join(SIDES)}", where=f"marker '{row['name']}'")
    pairs = content.get("rigid_pairs", [])
    virtual = {v["name"]: tuple(v["mean_of"]) for v in content.get("virtual", [])}
    for name in [n for pair in pairs for n in pair] + [n for of in virtual.values() for n in of]:
        if name not in names:
            raise FormatError(path, f"'{name}' in rigid_pairs or virtual is none of its markers")
    return make_set(
        str(content.get("name", Path(path).stem)),
        names,
        path,
        segments=[str(r.get("segment", "")) for r in rows],
        sides=[str(r["side"]) for r in rows] if all("side" in r for r in rows) else None,
        places=[r.get("place", [np.nan] * 3) for r in rows],
        colors=[str(r.get("color", "")) for r in rows],
        rigid_pairs=tuple((str(a), str(b)) for a, b in pairs),
        virtual=virtual,
        title=str(content.get("title", "")),
    )


def _of_vicon(path: str | Path) -> MarkerSet:
    """Names, colours and segments of a Vicon subject; its markers for calibration only count too."""
    root = parse(path, "KinematicModel", "Vicon subject")
    markers = [m for m in root.iter("Marker") if m.get("NAME")]
    names = [str(m.get("NAME")) for m in markers]
    segment = {t.get("MARKER"): t.get("SEGMENT", "") for t in root.iter("TargetLocalPointToWorldPoint")}
    colors = ["#" + "".join(f"{int(v):02x}" for v in str(m.get("RGB", "200 200 200")).split()) for m in markers]
    return make_set(Path(path).stem, names, path, segments=[segment.get(n) or "" for n in names], colors=colors)


def _of_opensim(path: str | Path) -> MarkerSet:
    root = parse(path, "OpenSimDocument", "OpenSim")
    markers = list(root.iter("Marker"))
    names = [str(m.get("name")) for m in markers]
    frames = [(m.findtext("socket_parent_frame") or m.findtext("body") or "").strip() for m in markers]
    return make_set(Path(path).stem, names, path, segments=[frame.rsplit("/", 1)[-1] for frame in frames])


def _of_take(path: str | Path) -> MarkerSet:
    names, _ = read_points(path).slots()
    named = [name for name in names if not name.startswith("*")]
    if len(prefixes(named)) == 1:
        named = [split_prefix(name)[1] for name in named]
    return make_set(Path(path).stem, named, path)


def write_marker_set(made: MarkerSet, path: str | Path) -> None:
    """Write a set as TOML."""
    if Path(path).suffix != ".toml":
        raise InputError(f"marker sets are written as .toml ({path})")
    lines = [f"name = {json.dumps(made.name)}"]
    if made.title:
        lines.append(f"title = {json.dumps(made.title)}")
    if made.rigid_pairs:
        lines.append(f"rigid_pairs = {json.dumps([list(p) for p in made.rigid_pairs])}")
    for i, name in enumerate(made.markers):
        lines += ["", "[[markers]]", f"name = {json.dumps(name)}", f'side = "{made.sides[i]}"']
        if made.segments[i]:
            lines.append(f"segment = {json.dumps(made.segments[i])}")
        if np.isfinite(made.places[i]).all():
            lines.append(f"place = [{', '.join(f'{v:.4f}' for v in made.places[i])}]")
        if made.colors[i]:
            lines.append(f"color = {json.dumps(made.colors[i])}")
    for name, of in made.virtual.items():
        lines += ["", "[[virtual]]", f"name = {json.dumps(name)}", f"mean_of = {json.dumps(list(of))}"]
    write_text(path, "\n".join(lines) + "\n")
