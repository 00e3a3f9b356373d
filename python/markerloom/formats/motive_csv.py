"""Take CSV of OptiTrack Motive: markers, rigid-body markers and unlabelled markers as points (Y up → Z up)."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from markerloom.errors import FormatError
from markerloom.formats.files import read_text
from markerloom.points import Points

TO_MM = {"millimeters": 1.0, "centimeters": 10.0, "meters": 1000.0}
MARKERS = ("Marker", "Bone Marker")


def is_motive(text: str) -> bool:
    """Whether a text starts like a Motive take CSV."""
    return text.lstrip("\ufeff").startswith("Format Version")


def read(path: str | Path) -> Points:
    """Read all marker trajectories."""
    rows = list(csv.reader(io.StringIO(read_text(path))))
    if not rows or rows[0][:1] != ["Format Version"]:
        raise FormatError(path, "not a Motive take CSV: it does not start with 'Format Version'")
    header = dict(zip(rows[0][::2], rows[0][1::2], strict=False))
    unit = header.get("Length Units", "Meters").strip().lower()
    if unit not in TO_MM:
        raise FormatError(path, f"unknown unit {unit!r}", where="line 1")
    names_at = next((i for i, row in enumerate(rows[:12]) if row[:1] == ["Frame"]), None)
    if names_at is None or names_at < 4:
        raise FormatError(path, "no line of column names that starts with 'Frame'")
    columns = _columns(rows, names_at)
    if not columns:
        raise FormatError(path, "no marker columns in it")
    body = [row for row in rows[names_at + 1 :] if row]
    frames = np.array([_frame(row[0], path, names_at + 2 + i) for i, row in enumerate(body)], np.int64)
    xyz = np.full((len(body), len(columns), 3), np.nan)
    for i, row in enumerate(body):
        for slot, (_, start) in enumerate(columns):
            cells = row[start : start + 3]
            if len(cells) == 3 and all(cells):
                xyz[i, slot] = [_value(c, path, names_at + 2 + i) for c in cells]
    xyz = np.stack([xyz[..., 0], -xyz[..., 2], xyz[..., 1]], axis=2) * TO_MM[unit]
    present = np.isfinite(xyz).all(axis=2)
    row_of, slot = np.nonzero(present)
    labels = np.array(["" if "nlabeled" in name else name for name, _ in columns], dtype=str)
    rate = float(header.get("Export Frame Rate") or header.get("Capture Frame Rate") or 0) or None
    return Points.of(
        frames[row_of],
        slot.astype(np.int64),
        xyz[present],
        label=labels[slot],
        rate_hz=rate,
        frames=np.unique(frames),
        source=str(path),
    )


def _columns(rows: list[list[str]], names_at: int) -> list[tuple[str, int]]:
    """Name and first column of each marker: three columns "X", "Y", "Z" under "Position" of a marker."""
    kinds = next(row for row in rows[1:names_at] if any(cell in MARKERS or "Rigid Body" in cell for cell in row))
    names = rows[rows.index(kinds) + 1]
    measures = rows[names_at - 1]
    found = []
    for i, kind in enumerate(kinds):
        if kind in MARKERS and measures[i : i + 3] == ["Position"] * 3 and rows[names_at][i : i + 3] == ["X", "Y", "Z"]:
            found.append((names[i], i))
    return found


def _frame(text: str, path: str | Path, line: int) -> int:
    if not text.isdigit():
        raise FormatError(path, f"{text[:20]!r} is not a frame number", where=f"line {line}")
    return int(text)


def _value(text: str, path: str | Path, line: int) -> float:
    try:
        return float(text)
    except ValueError:
        raise FormatError(path, f"{text[:20]!r} is not a coordinate", where=f"line {line}") from None
