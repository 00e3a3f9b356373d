"""TRC, the marker text format of Motion Analysis and OpenSim.

The file's own frame numbers start at 1 by convention; frame 1 is frame 0 of a table. Blank, "NaN" and non-finite
coordinates are missing samples. No uncertainty, kinds or confidence can be stored.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from markerloom.errors import FormatError, InputError
from markerloom.formats.files import read_text, write_text
from markerloom.points import Points

TO_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "meters": 1000.0}


def read(path: str | Path) -> Points:
    """Read trajectories."""
    lines = read_text(path).splitlines()
    header = _header(lines, path)
    unit = header.get("Units", "mm").strip().lower()
    if unit not in TO_MM:
        raise FormatError(path, f"unknown unit {unit!r}", where="header")
    if len(lines) < 4:
        raise FormatError(path, "it ends before the line of marker names")
    labels = [t.strip() for t in lines[3].split("\t")[2:] if t.strip()]
    if not labels:
        raise FormatError(path, "no marker names", where="line 4")
    frames, rows = [], []
    for number, line in enumerate(lines[5:], start=6):
        if line.strip():
            frame, values = _sample(line, len(labels), path, number)
            frames.append(frame)
            rows.append(values)
    if not rows:
        raise FormatError(path, "no frame in it")
    if len(set(frames)) != len(frames):
        raise FormatError(path, "frame numbers repeat")
    xyz = np.array(rows).reshape(len(rows), len(labels), 3) * TO_MM[unit]
    return _points(np.array(frames, np.int64) - 1, labels, xyz, _rate(header, path), path)


def _header(lines: list[str], path: str | Path) -> dict[str, str]:
    if not lines or not lines[0].startswith("PathFileType"):
        raise FormatError(path, "not a TRC file: it does not start with PathFileType")
    if len(lines) < 3:
        raise FormatError(path, "it ends in the header")
    return dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=False))


def _rate(header: dict[str, str], path: str | Path) -> float | None:
    try:
        rate = float(header.get("DataRate", "0"))
    except ValueError:
        raise FormatError(path, f"DataRate is {header['DataRate']!r}", where="line 3") from None
    return rate if rate > 0 else None


def _sample(line: str, markers: int, path: str | Path, number: int) -> tuple[int, list[float]]:
    cells = line.split("\t")
    try:
        frame = int(float(cells[0]))
    except ValueError:
        raise FormatError(path, f"{cells[0][:20]!r} is not a frame number", where=f"line {number}") from None
    cells = (cells[2:] + [""] * (3 * markers))[: 3 * markers]
    return frame, [_coordinate(cell, path, number) for cell in cells]


def _coordinate(cell: str, path: str | Path, number: int) -> float:
    cell = cell.strip()
    if not cell:
        return math.nan
    try:
        return float(cell)
    except ValueError:
        raise FormatError(path, f"{cell[:20]!r} is not a coordinate", where=f"line {number}") from None


def _points(frames: np.ndarray, labels: list[str], xyz: np.ndarray, rate: float | None, path: str | Path) -> Points:
    row, slot = np.nonzero(np.isfinite(xyz).all(axis=2))
    names = np.array(["" if n.startswith("*") else n for n in labels], dtype=str)
    return Points.of(
        frames[row],
        slot.astype(np.int64),
        xyz[row, slot],
        label=names[slot],
        rate_hz=rate,
        frames=np.sort(frames),
        source=str(path),
    )


def write(points: Points, path: str | Path) -> None:
    """Write trajectories in millimetres."""
    rate = points.rate_hz
    if rate is None:
        raise InputError(f"a TRC needs a frame rate: state it with --rate-hz ({path})")
    names, slot = points.slots()
    xyz = np.full((len(points.frames), len(names), 3), np.nan)
    xyz[np.searchsorted(points.frames, points.frame), slot] = points.xyz_mm
    first = int(points.frames[0]) + 1 if len(points.frames) else 1
    counts = f"{rate:g}\t{rate:g}\t{len(points.frames)}\t{len(names)}\tmm\t{rate:g}\t{first}\t{len(points.frames)}"
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{Path(path).name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        counts,
        "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{i + 1}" for i in range(len(names)) for axis in "XYZ"),
        "",
    ]
    for frame, sample in zip(points.frames.tolist(), xyz, strict=True):
        cells = ["" if math.isnan(v) else f"{v:.6f}" for v in sample.ravel()]
        lines.append("\t".join([str(frame + 1), f"{frame / rate:.6f}", *cells]))
    write_text(path, "\n".join(lines) + "\n")
