"""A take as the studio keeps it on disk: one trajectory after the other, read only where it is looked at.

A folder holds ``xyz_mm.f64`` (trajectories, frames, 3), ``sigma_mm.f32``, ``residual.f32`` and ``kind.i8``
(trajectories, frames), of takes with dots ``origin.i32`` (the track in which a sample was tracked), and ``sheet.json``,
written last. They are mapped copy-on-write: what is mended stays in
memory, the files never change.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.formats.c3d_file import read_columns
from markerloom.formats.files import write_text
from markerloom.mending.sheet import ABSENT, Sheet, Trajectory
from markerloom.points import Points

VERSION = 1
FILES = {
    "xyz_mm": ("f64", "<f8"),
    "sigma_mm": ("f32", "<f4"),
    "residual": ("f32", "<f4"),
    "kind": ("i8", "i1"),
    "origin": ("i32", "<i4"),
}
NOTHING: dict[str, float] = {"xyz_mm": np.nan, "sigma_mm": np.nan, "residual": np.nan, "kind": ABSENT, "origin": -1}


@dataclass(frozen=True)
class Stored:
    """A take from disk; ``residual_unit`` is ``px``, ``mm`` or empty."""

    sheet: Sheet
    residual_unit: str


def load(folder: Path, key: str) -> Stored | None:
    """What is stored under a key; ``None`` where there is nothing, or something else."""
    try:
        meta = json.loads((folder / "sheet.json").read_text("utf-8"))
        if meta["key"] != key or meta["version"] != VERSION:
            return None
        slots, count = len(meta["tracks"]), meta["count"]
        columns = {n: _mapped(folder / f"{n}.{FILES[n][0]}", FILES[n][1], slots, count, n) for n in meta["columns"]}
    except (OSError, ValueError, KeyError):
        return None
    trajectories = [
        Trajectory(track, label, {n: c[i] for n, c in columns.items()})
        for i, (track, label) in enumerate(zip(meta["tracks"], meta["labels"], strict=True))
    ]
    sheet = Sheet(meta["first"], count, meta["rate_hz"], trajectories, meta["source"])
    return Stored(sheet, meta["residual_unit"])


def _mapped(path: Path, kind: str, slots: int, count: int, name: str) -> NDArray[Any]:
    shape = (slots, count, 3) if name == "xyz_mm" else (slots, count)
    if slots * count == 0:
        return np.zeros(shape, kind)
    return np.memmap(path, kind, mode="c", shape=shape)


def store(folder: Path, key: str, points: Points, tracked: Points | None = None) -> None:
    """Store a take that is at hand. ``tracked``: the same as it was tracked from dots, before it was named."""
    unit = "px" if np.isfinite(points.residual_px).any() else "mm" if np.isfinite(points.residual_mm).any() else ""
    first = int(points.frames[0]) if len(points.frames) else 0
    count = int(points.frames[-1]) - first + 1 if len(points.frames) else 0
    order = np.argsort(points.track, kind="stable")
    tracks, starts = np.unique(points.track[order], return_index=True)
    groups = np.split(order, starts[1:]) if len(order) else []
    values = {
        "xyz_mm": points.xyz_mm,
        "sigma_mm": points.sigma_mm,
        "residual": points.residual_px if unit == "px" else points.residual_mm,
        "kind": points.kind,
    }
    if tracked is not None:
        values["origin"] = origins(points, tracked)

    def each() -> Iterator[dict[str, NDArray[Any]]]:
        for rows in groups:
            at = points.frame[rows] - first
            made = {n: np.full((count, 3) if n == "xyz_mm" else count, NOTHING[n]) for n in values}
            for name, column in values.items():
                made[name][at] = column[rows]
            yield made

    labels = [str(points.label[rows[0]]) for rows in groups]
    meta: dict[str, Any] = {"first": first, "count": count, "rate_hz": points.rate_hz, "source": points.source}
    meta |= {"key": key, "columns": list(values), "tracks": tracks.tolist(), "labels": labels, "residual_unit": unit}
    _write(folder, meta, each())


def origins(points: Points, tracked: Points) -> NDArray[np.int64]:
    """The track of each point when it was tracked (−1: none): naming and smoothing keep frame, sigma and residual."""

    def keys(of: Points) -> NDArray[Any]:
        known = (np.nan_to_num(c, nan=-1.0) for c in (of.sigma_mm, of.residual_px))
        return np.rec.fromarrays([of.frame, *known])

    mine, theirs = keys(points), keys(tracked)
    order = np.argsort(theirs, order=("f0", "f1", "f2"))
    if len(order) == 0:
        return np.full(len(mine), -1, np.int64)
    at = np.minimum(np.searchsorted(theirs[order], mine), len(order) - 1)
    return np.where(theirs[order][at] == mine, tracked.track[order][at], -1)


def store_c3d(folder: Path, key: str, path: Path, rate_hz: float | None) -> None:
    """Store a C3D column by column: hours fit into memory, which as one row for each point they would not."""
    file = read_columns(path)
    slots = [i for i in range(len(file.labels)) if file.present[:, i].any()]

    def each() -> Iterator[dict[str, NDArray[Any]]]:
        for i in slots:
            there = file.present[:, i]
            yield {
                "xyz_mm": np.where(there[:, None], file.xyz_mm[:, i], np.nan),
                "sigma_mm": np.where(there, file.sigma_mm[:, i], np.nan),
                "residual": np.where(there, file.residual_mm[:, i], np.nan),
                "kind": np.where(there, file.kind[:, i], ABSENT),
            }

    unit = "mm" if np.isfinite(file.residual_mm).any() else ""
    labels = ["" if file.labels[i].startswith("*") else file.labels[i] for i in slots]
    meta: dict[str, Any] = {
        "first": 0,
        "count": len(file.present),
        "rate_hz": rate_hz or file.rate_hz,
        "source": str(path),
    }
    columns = ["xyz_mm", "sigma_mm", "residual", "kind"]
    meta |= {"key": key, "columns": columns, "tracks": slots, "labels": labels, "residual_unit": unit}
    _write(folder, meta, each())


def _write(folder: Path, meta: dict[str, Any], trajectories: Iterator[dict[str, NDArray[Any]]]) -> None:
    """Columns next to those that are there, then in their place: a page that has those open keeps them."""
    fresh = folder.with_name(f"{folder.name}.new")
    shutil.rmtree(fresh, ignore_errors=True)
    fresh.mkdir(parents=True)
    out = {n: (fresh / f"{n}.{FILES[n][0]}").open("wb") for n in meta["columns"]}
    try:
        for one in trajectories:
            for name, values in one.items():
                out[name].write(np.ascontiguousarray(values, FILES[name][1]).data)
    finally:
        for file in out.values():
            file.close()
    write_text(fresh / "sheet.json", json.dumps({"version": VERSION, **meta}))
    shutil.rmtree(folder, ignore_errors=True)
    fresh.rename(folder)
