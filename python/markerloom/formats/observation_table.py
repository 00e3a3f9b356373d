"""Observations as Parquet, CSV or CSV.gz: frame, camera, x, y and optional columns; also Tracker's centroid dumps."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pyarrow as pa

from markerloom.errors import FormatError, InputError
from markerloom.formats import table_file, timecode
from markerloom.observations import OPTIONAL_COLUMNS, Observations, concatenate_ids


def is_tracker_dump(table: pa.Table) -> bool:
    """Whether the columns are those of a dump of Vicon Tracker."""
    return {"cameraName", "positionX", "positionY"} <= set(table.column_names)


def is_observations(table: pa.Table) -> bool:
    """Whether the columns are those of observations."""
    return {"frame", "camera", "x", "y"} <= set(table.column_names)


def of_table(table: pa.Table, path: str | Path) -> Observations:
    """Observations from a table read before."""
    return _of_dump(table, path) if is_tracker_dump(table) else _of_observations(table, path)


def _of_observations(table: pa.Table, path: str | Path) -> Observations:
    for name in ("frame", "camera", "x", "y"):
        if name not in table.column_names:
            raise FormatError(path, f"column '{name}' is missing; it has {', '.join(table.column_names)}")
    if table.num_rows == 0:
        raise FormatError(path, "no observation in it")
    camera, ids = concatenate_ids(table_file.text(table, "camera"))
    names = [n for n in OPTIONAL_COLUMNS if n in table.column_names]
    optional = {n: table_file.number(table, n, path) for n in names}
    if "timecode" in table.column_names:
        optional["timecode_s"] = _timecodes(table, path)
    pixel = np.column_stack([table_file.number(table, "x", path), table_file.number(table, "y", path)])
    return Observations(
        frame=table_file.integer(table, "frame", path),
        camera=camera,
        camera_ids=ids,
        pixel=pixel,
        optional=optional,
        rate_hz=table_file.rate(table),
        source=str(path),
    )


def _timecodes(table: pa.Table, path: str | Path) -> np.ndarray:
    try:
        return timecode.seconds(table_file.text(table, "timecode"))
    except InputError as error:
        raise FormatError(path, str(error), where="column 'timecode'") from None


def _of_dump(table: pa.Table, path: str | Path) -> Observations:
    """Tracker's dump of one frame: the id is the number in brackets in cameraName; empty rows are empty cameras."""
    names = table_file.text(table, "cameraName")
    ids = []
    for row, name in enumerate(names):
        found = re.search(r"\((\d+)\)", name)
        if found is None:
            raise FormatError(path, f"no id in brackets in {name!r}", where=f"column 'cameraName', row {row + 1}")
        ids.append(found.group(1))
    pixel = np.column_stack([table_file.number(table, c, path) for c in ("positionX", "positionY")])
    present = np.isfinite(pixel).all(axis=1)
    camera, all_ids = concatenate_ids(ids)
    optional = {}
    if "radius" in table.column_names:
        optional["radius"] = table_file.number(table, "radius", path)[present]
    if "weight" in table.column_names:
        optional["quality"] = table_file.number(table, "weight", path)[present]
    return Observations(
        frame=np.zeros(int(present.sum()), np.int64),
        camera=camera[present],
        camera_ids=all_ids,
        pixel=pixel[present],
        optional=optional,
        frames=np.zeros(1, np.int64),
        source=str(path),
    )


def to_arrow(observations: Observations) -> pa.Table:
    """The observations table."""
    ids = np.array(observations.camera_ids)[observations.camera] if len(observations) else np.zeros(0, dtype=str)
    columns = {
        "frame": pa.array(observations.frame),
        "camera": pa.array(ids),
        "x": pa.array(observations.pixel[:, 0]),
        "y": pa.array(observations.pixel[:, 1]),
    }
    columns |= {name: pa.array(values) for name, values in observations.optional.items()}
    table = pa.table(columns)
    rate = observations.rate_hz
    return table.replace_schema_metadata({} if rate is None else {"rate_hz": repr(rate), "units": "px"})
