"""Files: one module per format, and the lists of what reads and writes which ending."""

from __future__ import annotations

from pathlib import Path

from markerloom.errors import FormatError, InputError
from markerloom.formats import (
    c3d_file,
    calib_toml,
    mcal,
    motive_csv,
    observation_table,
    points_table,
    qca,
    qtm_tsv,
    table_file,
    trc,
    x2d,
    xcp,
    xcp_write,
)
from markerloom.formats.files import read_text
from markerloom.observations import Observations
from markerloom.points import Points
from markerloom.rig import Rig

TABLE_ENDINGS = (".parquet", ".csv", ".csv.gz")
CALIBRATIONS = (".xcp", ".toml", ".qca.txt", ".mcal")
CALIBRATIONS_WRITTEN = (".toml", ".xcp")
OBSERVATIONS = (".x2d", *TABLE_ENDINGS)
POINTS_READ = (".c3d", ".trc", ".tsv", *TABLE_ENDINGS)
POINTS_WRITTEN = (".c3d", ".trc", ".parquet", ".csv")


def ending(path: str | Path) -> str:
    """The ending that decides about the format, in small letters."""
    name = Path(path).name.lower()
    for double in (".csv.gz", ".qca.txt"):
        if name.endswith(double):
            return double
    return Path(name).suffix


def read_calibration(path: str | Path, *, units: str = "m") -> Rig:
    """Read a rig from .xcp, Calib.toml, .qca.txt or .mcal."""
    kind = ending(path)
    if kind == ".xcp":
        return xcp.read(path)
    if kind == ".toml":
        return calib_toml.read(path, units=units)
    if kind == ".qca.txt":
        return qca.read(path)
    if kind == ".mcal":
        return mcal.read(path)
    raise InputError(f"calibrations are {', '.join(CALIBRATIONS)}; '{kind}' is none of them ({path})")


def check_calibration_output(path: str | Path) -> None:
    """Refuse at once a file as which no calibration can be written."""
    if ending(path) not in CALIBRATIONS_WRITTEN:
        raise InputError(f"calibrations are written as {', '.join(CALIBRATIONS_WRITTEN)} ({path})")


def write_calibration(rig: Rig, path: str | Path) -> None:
    """Write a rig as Calib.toml or .xcp."""
    check_calibration_output(path)
    if ending(path) == ".xcp":
        xcp_write.write(rig, path)
    else:
        calib_toml.write(rig, path)


def read_observations(path: str | Path) -> Observations:
    """Read centroids from .x2d, Parquet, CSV, CSV.gz or a Tracker dump."""
    kind = ending(path)
    if kind == ".x2d":
        return x2d.read(path)
    if kind in TABLE_ENDINGS:
        return observation_table.of_table(table_file.read(path), path)
    raise InputError(f"observations are {', '.join(OBSERVATIONS)}; '{kind}' is none of them ({path})")


def write_observations(observations: Observations, path: str | Path) -> None:
    """Write centroids as Parquet or CSV."""
    table_file.write(observation_table.to_arrow(observations), path)


def read_points(path: str | Path) -> Points:
    """Read points from .c3d, .trc, .parquet, .csv(.gz), a Motive take CSV or a QTM .tsv."""
    kind = ending(path)
    if kind == ".c3d":
        return c3d_file.read(path)
    if kind == ".trc":
        return trc.read(path)
    if kind == ".tsv":
        return qtm_tsv.read(path)
    if kind == ".csv" and motive_csv.is_motive(read_text(path)[:100]):
        return motive_csv.read(path)
    if kind in TABLE_ENDINGS:
        table = table_file.read(path)
        if not points_table.is_points(table):
            raise FormatError(path, f"no table of points: its columns are {', '.join(table.column_names)}")
        return points_table.of_table(table, path)
    raise InputError(f"points are {', '.join(POINTS_READ)}; '{kind}' is none of them ({path})")


def write_points(points: Points, path: str | Path) -> None:
    """Write points to .c3d, .trc, .parquet or .csv."""
    kind = ending(path)
    if kind == ".c3d":
        c3d_file.write(points, path)
    elif kind == ".trc":
        trc.write(points, path)
    elif kind in (".parquet", ".csv"):
        table_file.write(points_table.to_arrow(points), path)
    else:
        raise InputError(f"points are written as {', '.join(POINTS_WRITTEN)}, not '{kind}' ({path})")
