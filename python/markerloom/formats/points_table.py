"""The points table as Parquet or CSV, and plain tables of named positions (truth, marker dumps)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa

from markerloom.errors import FormatError
from markerloom.formats import table_file
from markerloom.points import KINDS, Points

POSITION = ("x_mm", "y_mm", "z_mm")
DUMP = ("markerPosX", "markerPosY", "markerPosZ")


def is_points(table: pa.Table) -> bool:
    """Whether the columns are those of points."""
    return {"frame", *POSITION} <= set(table.column_names) or set(DUMP) <= set(table.column_names)


def of_table(table: pa.Table, path: str | Path) -> Points:
    """Points from a table read before."""
    if set(DUMP) <= set(table.column_names):
        return _of_dump(table, path)
    frame = table_file.integer(table, "frame", path)
    xyz = np.column_stack([table_file.number(table, name, path) for name in POSITION])
    columns = set(table.column_names)
    known: dict[str, object] = {}
    if "label" in columns:
        known["label"] = np.array(table_file.text(table, "label"), dtype=str)
    for name in ("sigma_mm", "residual_px", "confidence", "residual_mm", "label_probability"):
        if name in columns:
            known[name] = table_file.number(table, name, path)
    for name in ("rays", "camera_mask"):
        if name in columns:
            known[name] = np.nan_to_num(table_file.number(table, name, path), nan=-1).astype(np.int64)
    if "kind" in columns:
        known["kind"] = _kinds(table_file.text(table, "kind"), path)
    present = np.asarray(np.isfinite(xyz).all(axis=1))
    tracked = (table.schema.metadata or {}).get(b"tracked", b"true") != b"false"
    track = table_file.integer(table, "track", path) if "track" in columns else _tracks(frame, known.get("label"))
    points = Points.of(frame, track, xyz, rate_hz=table_file.rate(table), source=str(path), tracked=tracked, **known)
    return _ordered(points.keep(present))


def _ordered(points: Points) -> Points:
    order = np.lexsort((points.track, points.frame))
    return points if np.array_equal(order, np.arange(len(order))) else points.keep(order)


def _kinds(names: list[str], path: str | Path) -> np.ndarray:
    unknown = sorted(set(names) - set(KINDS))
    if unknown:
        raise FormatError(path, f"'{unknown[0]}' is none of {', '.join(KINDS)}", where="column 'kind'")
    return np.array([KINDS.index(n) for n in names], np.int64)


def _tracks(frame: np.ndarray, label: object) -> np.ndarray:
    """One track per label; rows without a label are numbered within their frame."""
    labels = label if isinstance(label, np.ndarray) else np.full(len(frame), "", dtype=str)
    names = sorted({str(x) for x in labels} - {""})
    number = {name: i for i, name in enumerate(names)}
    taken: dict[int, int] = {}
    tracks = np.zeros(len(frame), np.int64)
    for row, (f, name) in enumerate(zip(frame.tolist(), labels.tolist(), strict=True)):
        if name:
            tracks[row] = number[name]
        else:
            taken[f] = taken.get(f, len(names) - 1) + 1
            tracks[row] = taken[f]
    return tracks


def _of_dump(table: pa.Table, path: str | Path) -> Points:
    """Vicon Tracker's dump of the markers of one frame."""
    xyz = np.column_stack([table_file.number(table, name, path) for name in DUMP])
    n = len(xyz)
    return Points.of(np.zeros(n, np.int64), np.arange(n), xyz, source=str(path), tracked=False)


def to_arrow(points: Points) -> pa.Table:
    """The points table with its metadata."""
    table = pa.table(
        {
            "frame": pa.array(points.frame),
            "track": pa.array(points.track),
            "label": pa.array(points.label.astype(str)),
            **{name: pa.array(points.xyz_mm[:, i]) for i, name in enumerate(POSITION)},
            "sigma_mm": pa.array(points.sigma_mm),
            "rays": pa.array(points.rays),
            "residual_px": pa.array(points.residual_px),
            "confidence": pa.array(points.confidence),
            "kind": pa.array([KINDS[k] for k in points.kind]),
            "residual_mm": pa.array(points.residual_mm),
            "camera_mask": pa.array(points.camera_mask),
        }
    )
    if np.isfinite(points.label_probability).any():
        table = table.append_column("label_probability", pa.array(points.label_probability))
    metadata = {"units": "mm", "up_axis": points.up_axis, "tracked": str(points.tracked).lower()}
    if points.rate_hz is not None:
        metadata["rate_hz"] = repr(points.rate_hz)
    return table.replace_schema_metadata(metadata)
