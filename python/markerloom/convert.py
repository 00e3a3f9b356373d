"""Files from one format to another. C3D to C3D keeps everything that is not asked to change."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from markerloom import formats
from markerloom.errors import InputError
from markerloom.formats import c3d_file
from markerloom.points import Points
from markerloom.skeleton import read_motion, read_segment_poses, solve_segments, write_motion
from markerloom.skeleton.files import MOTIONS_READ
from markerloom.skeleton.segment_poses import is_segment_poses


def convert(
    source: str | Path,
    target: str | Path,
    *,
    rate_hz: float | None = None,
    up: str | None = None,
    units: str | None = None,
    preset: str | None = None,
    order: str | None = None,
    rest: str | None = None,
    source_units: str | None = None,
    source_up: str = "y",
    calibration_units: str = "m",
) -> None:
    """Convert points, motions, observations or a calibration, by the endings of the two files.

    ``up='y'`` turns points from Z up to Y up: (x, y, z) → (x, z, −y). ``rate_hz`` states or replaces the frame rate.
    ``units``, ``preset``, ``order`` and ``rest`` are of motions (see `write_motion`), ``source_units`` and
    ``source_up`` of motions that are read.
    """
    if up not in (None, "y", "z"):
        raise InputError(f"up '{up}': y or z")
    kind, wanted = formats.ending(source), formats.ending(target)
    poses = kind == ".mvnx" or (kind == ".c3d" and wanted not in formats.POINTS_WRITTEN and is_segment_poses(source))
    if kind in MOTIONS_READ or poses:
        write_motion(
            solve_segments(read_segment_poses(source))
            if poses
            else read_motion(source, units=source_units, up=source_up, rate_hz=rate_hz),
            target,
            units=units,
            up=up,
            order=order,
            rest=rest,
            preset=preset,
        )
    elif kind in formats.CALIBRATIONS:
        formats.write_calibration(formats.read_calibration(source, units=calibration_units), target)
    elif kind == wanted == ".c3d" and rate_hz is None and up is None:
        c3d_file.write_file(c3d_file.read_file(source), target)
    elif kind == ".x2d" or (kind in formats.TABLE_ENDINGS and _is_observations(source)):
        observations = formats.read_observations(source)
        rate = rate_hz if rate_hz is not None else observations.rate_hz
        formats.write_observations(replace(observations, rate_hz=rate), target)
    else:
        formats.write_points(_changed(formats.read_points(source), rate_hz, up), target)


def _is_observations(path: str | Path) -> bool:
    from markerloom.formats import motive_csv, observation_table, table_file
    from markerloom.formats.files import read_text

    if formats.ending(path) == ".csv" and motive_csv.is_motive(read_text(path)[:100]):
        return False
    table = table_file.read(path)
    return observation_table.is_observations(table) or observation_table.is_tracker_dump(table)


def _changed(points: Points, rate_hz: float | None, up: str | None) -> Points:
    if rate_hz is not None:
        points = replace(points, rate_hz=rate_hz)
    return points if up is None else points.with_up_axis(up)
