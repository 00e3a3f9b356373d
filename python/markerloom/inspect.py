"""What is in a file: any file markerloom reads, in a dictionary and in words."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from markerloom import formats
from markerloom.errors import FormatError, InputError
from markerloom.formats import c3d_file, motive_csv, observation_table, points_table, table_file
from markerloom.formats.files import read_text
from markerloom.observations import Observations
from markerloom.points import KINDS, Points
from markerloom.rig import Rig
from markerloom.skeleton import read_motion, read_skeleton
from markerloom.skeleton.files import MOTIONS_READ


def inspect(path: str | Path, *, calibration_units: str = "m") -> dict[str, Any]:
    """Describe a file by what is in it; the first key, ``content``, says what it is."""
    if Path(path).is_dir():
        raise InputError(f"{path} is a folder: name a file in it")
    kind = formats.ending(path)
    if kind in formats.CALIBRATIONS:
        return _rig(formats.read_calibration(path, units=calibration_units))
    if kind in (*MOTIONS_READ, ".asf"):
        return _motion(path)
    if kind == ".x2d":
        return _observations(formats.read_observations(path))
    if kind == ".c3d":
        return _c3d(path)
    if kind in formats.TABLE_ENDINGS:
        return _table(path)
    if kind in formats.POINTS_READ:
        return _points(formats.read_points(path))
    readable = sorted({*MOTIONS_READ, ".asf", *formats.CALIBRATIONS, *formats.OBSERVATIONS, *formats.POINTS_READ})
    raise InputError(f"'{kind}' files are not read; these are: {', '.join(readable)} ({path})")


def _motion(path: str | Path) -> dict[str, Any]:
    """A motion, or a skeleton without one."""
    try:
        motion = None if formats.ending(path) == ".asf" else read_motion(path)
    except FormatError:
        # A BVH may be a skeleton alone; if that is broken, too, its own error says so.
        read_skeleton(path)
        motion = None
    skeleton = read_skeleton(path) if motion is None else motion.skeleton
    found: dict[str, Any] = {"content": "skeleton" if motion is None else "motion", "joints": list(skeleton.joints)}
    if motion is not None:
        found |= {"frames": len(motion), "rate_hz": motion.rate_hz, "bones_move": motion.shifts_m is not None}
    return found


def _table(path: str | Path) -> dict[str, Any]:
    if formats.ending(path) == ".csv" and motive_csv.is_motive(read_text(path)[:100]):
        return _points(motive_csv.read(path))
    table = table_file.read(path)
    if observation_table.is_observations(table) or observation_table.is_tracker_dump(table):
        return _observations(observation_table.of_table(table, path))
    if points_table.is_points(table):
        return _points(points_table.of_table(table, path))
    return {"content": "table", "columns": table.column_names, "rows": table.num_rows}


def _rig(rig: Rig) -> dict[str, Any]:
    cameras = [
        {
            "id": c.id,
            "size_px": [int(v) for v in c.size_px],
            "focal_px": round(float(np.mean(c.focal_px)), 1),
            "position_m": [round(float(v), 3) for v in c.position_m],
            "lens": c.lens.model,
            "masked_tiles": sum(c.mask.tiles) if c.mask else 0,
        }
        for c in rig.cameras
    ]
    return {"content": "calibration", "cameras": cameras, "warnings": list(rig.warnings)}


def _observations(observations: Observations) -> dict[str, Any]:
    frames = observations.frames
    per_camera = np.bincount(observations.camera, minlength=len(observations.camera_ids)) if len(observations) else []
    return {
        "content": "observations",
        "frames": len(frames),
        "first_frame": int(frames[0]) if len(frames) else None,
        "rate_hz": observations.rate_hz,
        "centroids": len(observations),
        "centroids_by_camera": dict(zip(observations.camera_ids, map(int, per_camera), strict=False)),
        "columns": ["frame", "camera", "x", "y", *observations.optional],
        "warnings": list(observations.warnings),
    }


def _points(points: Points) -> dict[str, Any]:
    labels = sorted({str(v) for v in points.label} - {""})
    result: dict[str, Any] = {
        "content": "points",
        "frames": len(points.frames),
        "first_frame": int(points.frames[0]) if len(points.frames) else None,
        "rate_hz": points.rate_hz,
        "samples": len(points),
        "trajectories": len(np.unique(points.track)),
        "labels": labels,
        "kinds": {name: int((points.kind == i).sum()) for i, name in enumerate(KINDS) if (points.kind == i).any()},
    }
    if len(points):
        low, high = points.xyz_mm.min(axis=0), points.xyz_mm.max(axis=0)
        result["extent_mm"] = [[round(float(v), 1) for v in corner] for corner in (low, high)]
    return result


def _c3d(path: str | Path) -> dict[str, Any]:
    file = c3d_file.read_file(path)
    result = _points(c3d_file.read(path))
    groups: dict[str, list[str]] = {}
    names = {r["group"]: r["name"] for r in file.records() if "dimensions" not in r}
    for record in file.records():
        if "dimensions" in record:
            groups.setdefault(names.get(record["group"], "?"), []).append(record["name"])
    result |= {
        "first_frame": file.first_frame,
        "storage": "float" if file.is_float else "integer",
        "analog_channels": int(file.number("ANALOG", "USED") or 0),
        "parameters": groups,
        "warnings": file.warnings,
    }
    if segments := c3d_file.segment_names(file):
        result["segments"] = segments
    return result
