"""Wands: by name, or from a TOML file with ``name``, ``units`` and one ``[[markers]]`` table per marker."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import FormatError, InputError
from markerloom.formats.files import read_text

UNITS = {"m": 1.0, "mm": 1e-3}
NAMED_MM: dict[str, list[list[float]]] = {
    "vicon-t": [[-80, 0, 0], [0, 0, 0], [160, 0, 0], [0, 120, 0], [0, 240, 0]],
    "line-500": [[0, 0, 0], [150, 0, 0], [500, 0, 0]],
    "pair-500": [[0, 0, 0], [500, 0, 0]],
    "marker": [[0, 0, 0]],
}


@dataclass(frozen=True)
class Wand:
    """A rigid object of known shape: marker names and places (n, 3) in metres, in axes of its own."""

    name: str
    markers: tuple[str, ...]
    places_m: NDArray[np.floating[Any]]


def read_wand(name: str | Path) -> Wand:
    """A wand by its name, or from a TOML file.

    Names: ``vicon-t`` (five markers: −80, 0, 160 mm on a line, and 120, 240 mm at right angles), ``line-500`` (0, 150,
    500 mm), ``pair-500`` (500 mm apart), ``marker`` (a single one). Raises ``InputError`` for an unknown name,
    ``FormatError`` for a file that is none.
    """
    if str(name) in NAMED_MM:
        places = np.array(NAMED_MM[str(name)], float) / 1000.0
        return Wand(str(name), tuple(f"W{i + 1}" for i in range(len(places))), places)
    if Path(name).suffix != ".toml":
        raise InputError(f"wand '{name}': {', '.join(NAMED_MM)}, or a .toml file with its markers")
    try:
        content = tomllib.loads(read_text(name))
    except tomllib.TOMLDecodeError as error:
        raise FormatError(name, f"not a TOML file: {error}") from None
    return _of_table(content, name)


def _of_table(content: dict[str, Any], path: str | Path) -> Wand:
    units = content.get("units")
    if units not in UNITS:
        raise FormatError(path, f'units are {units!r}: "mm" or "m" is needed')
    rows = content.get("markers")
    if not isinstance(rows, list) or not rows:
        raise FormatError(path, "no [[markers]] in it")
    try:
        places = np.array([row["position"] for row in rows], float)
        names = tuple(str(row["name"]) for row in rows)
    except (KeyError, TypeError, ValueError):
        raise FormatError(path, "every marker needs a name and position = [x, y, z]", where="[[markers]]") from None
    if len(rows) < 2:
        raise FormatError(path, "one marker has no length: name the wand 'marker' instead", where="[[markers]]")
    if places.shape != (len(rows), 3) or not np.isfinite(places).all():
        raise FormatError(path, "every position is three finite numbers", where="[[markers]]")
    return Wand(str(content.get("name", Path(path).stem)), names, places * UNITS[units])
