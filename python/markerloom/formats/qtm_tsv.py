"""Qualisys QTM TSV export of 3D trajectories.

Frames count from 1 in the file; frame 1 is frame 0 of a table. A coordinate triple of zeros is a missing sample.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from markerloom.errors import FormatError
from markerloom.formats.files import read_text
from markerloom.points import Points


def read(path: str | Path) -> Points:
    """Read all trajectories."""
    lines = read_text(path).splitlines()
    header: dict[str, list[str]] = {}
    start = 0
    for i, line in enumerate(lines):
        cells = line.split("\t")
        if cells[0] in ("Frame", "") or cells[0].lstrip("-").replace(".", "", 1).isdigit():
            start = i
            break
        header[cells[0]] = cells[1:]
    if "NO_OF_FRAMES" not in header or "MARKER_NAMES" not in header:
        raise FormatError(path, "not a QTM TSV file: NO_OF_FRAMES or MARKER_NAMES is missing")
    names = [n for n in header["MARKER_NAMES"] if n]
    has_frames = bool(lines[start:]) and lines[start].startswith("Frame")
    body = [line for line in lines[start + has_frames :] if line.strip()]
    skip = 2 if has_frames else 0
    xyz = np.full((len(body), len(names), 3), np.nan)
    for i, line in enumerate(body):
        cells = line.split("\t")[skip : skip + 3 * len(names)]
        if len(cells) != 3 * len(names):
            raise FormatError(path, f"{len(cells)} values, {3 * len(names)} expected", where=f"frame {i + 1}")
        try:
            xyz[i] = np.array([float(c) if c.strip() else np.nan for c in cells]).reshape(-1, 3)
        except ValueError:
            raise FormatError(path, "a value is not a number", where=f"frame {i + 1}") from None
    present = np.isfinite(xyz).all(axis=2) & np.any(xyz != 0, axis=2)
    frame, slot = np.nonzero(present)
    try:
        rate = float(header.get("FREQUENCY", ["0"])[0]) or None
    except ValueError:
        rate = None
    return Points.of(
        frame.astype(np.int64),
        slot.astype(np.int64),
        xyz[present],
        label=np.array(names, dtype=str)[slot],
        rate_hz=rate,
        frames=np.arange(len(body)),
        source=str(path),
    )
