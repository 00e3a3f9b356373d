"""Tables as Parquet, CSV or CSV.gz: reading with clear errors, writing with metadata, the same bytes every time."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from markerloom.errors import FormatError, InputError
from markerloom.formats.files import read_bytes, read_text, write_bytes

NULLS = ["", "NA", "NaN", "nan", "null"]


def columns(path: str | Path) -> list[str]:
    """The names of a table's columns, without reading its rows."""
    if Path(path).suffix == ".parquet":
        return read(path).column_names
    return [name.strip().strip('"') for name in read_text(path).partition("\n")[0].split(",")]


def read(path: str | Path) -> pa.Table:
    """The table; metadata of Parquet files as a dictionary of bytes in ``schema.metadata``."""
    path = Path(path)
    data = read_bytes(path)
    try:
        if path.suffix == ".parquet":
            return pyarrow.parquet.read_table(io.BytesIO(data))
        options = pyarrow.csv.ConvertOptions(null_values=NULLS, strings_can_be_null=True)
        return pyarrow.csv.read_csv(io.BytesIO(data), convert_options=options)
    except (pa.ArrowException, OSError, ValueError) as error:
        kind = "Parquet" if path.suffix == ".parquet" else "CSV"
        raise FormatError(path, f"not a readable {kind} table: {str(error).splitlines()[0]}") from None


def write(table: pa.Table, path: str | Path) -> None:
    """Write Parquet or CSV by the path's ending."""
    path = Path(path)
    sink = io.BytesIO()
    if path.suffix == ".parquet":
        pyarrow.parquet.write_table(table, sink, compression="zstd", write_statistics=False)
    elif path.suffix == ".csv":
        pyarrow.csv.write_csv(table, sink, pyarrow.csv.WriteOptions(quoting_style="needed"))
    else:
        raise InputError(f"tables are written as .parquet or .csv, not '{path.suffix}' ({path})")
    write_bytes(path, sink.getvalue())


def number(table: pa.Table, name: str, path: str | Path) -> np.ndarray:
    """A column of numbers; missing values are NaN."""
    if name not in table.column_names:
        raise FormatError(path, f"column '{name}' is missing; it has {', '.join(table.column_names)}")
    try:
        column = table.column(name).cast(pa.float64())
    except pa.ArrowException:
        raise FormatError(path, "holds something that is not a number", where=f"column '{name}'") from None
    return column.to_numpy(zero_copy_only=False).astype(np.float64)


def integer(table: pa.Table, name: str, path: str | Path) -> np.ndarray:
    """A column of whole numbers without gaps."""
    values = number(table, name, path)
    bad = ~np.isfinite(values) | (values != np.round(values)) | (np.abs(values) > 2**53)
    if np.any(bad):
        row = int(np.flatnonzero(bad)[0])
        raise FormatError(path, f"{values[row]} is not a whole number", where=f"column '{name}', row {row + 1}")
    return values.astype(np.int64)


def text(table: pa.Table, name: str) -> list[str]:
    """A column as text; missing values are empty."""
    values = table.column(name).to_pylist()
    return ["" if v is None else _plain(v) for v in values]


def _plain(value: object) -> str:
    return str(int(value)) if isinstance(value, float) and value.is_integer() else str(value)


def rate(table: pa.Table) -> float | None:
    """``rate_hz`` from the metadata."""
    value = (table.schema.metadata or {}).get(b"rate_hz")
    try:
        return float(value) if value else None
    except ValueError:
        return None
