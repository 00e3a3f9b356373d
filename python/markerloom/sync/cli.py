"""The verb ``sync`` on the command line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from markerloom import formats
from markerloom import report as reports
from markerloom.errors import InputError
from markerloom.sync.clocks import WAYS, Synced
from markerloom.sync.clocks import sync as run_sync


def sync(
    recordings: Annotated[list[Path], typer.Argument(help="Dots of each recorder: .parquet, .csv, .csv.gz, .x2d")],
    output: Annotated[
        list[Path],
        typer.Option("-o", "--output", help="One file for all recordings together, or as many as there are."),
    ],
    calibration: Annotated[
        Path | None, typer.Option("--calibration", help=".xcp, Calib.toml, .qca.txt or .mcal")
    ] = None,
    by: Annotated[str, typer.Option("--by", help=f"What tells the offset: {', '.join(WAYS)}.")] = "motion",
    offset: Annotated[
        list[str] | None,
        typer.Option(help="A camera's or recording's first frame, in reference frames.", metavar="CAM=FRAMES"),
    ] = None,
    each_camera: Annotated[
        bool | None, typer.Option("--each-camera/--each-recording", help="Which of them has its own clock.")
    ] = None,
    rate_hz: Annotated[float | None, typer.Option("--rate-hz", help="Of recordings that do not state it.")] = None,
    calibration_units: Annotated[
        str, typer.Option("--calibration-units", help="Unit of lengths in a Calib.toml: m, cm or mm.")
    ] = "m",
    report: Annotated[Path | None, typer.Option("--report", help="Write a report as JSON.")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")] = False,
) -> None:
    """Put cameras or recordings without a common clock on one: writes the time of every row (time_s).

    Each recording has its own clock; in a single one every camera has. Offset and drift come from the markers' own
    motion, which needs the calibration; or from a flash, a clap, time codes, or by hand.

    Example: markerloom sync left.parquet right.parquet --calibration rig.toml -o both.parquet
    """
    options = {k: v for k, v in locals().items() if k not in ("quiet", "report")}
    if len(output) not in (1, len(recordings)):
        raise typer.BadParameter(f"{len(output)} outputs for {len(recordings)} recordings: one, or one for each")
    for path in output:
        if formats.ending(path) not in formats.TABLE_ENDINGS:
            raise typer.BadParameter(f"{path}: observations are written as {', '.join(formats.TABLE_ENDINGS)}")
    takes = [formats.read_observations(path) for path in recordings]
    if rate_hz is not None:
        takes = [replace(t, rate_hz=t.rate_hz or rate_hz) for t in takes]
    rig = None if calibration is None else formats.read_calibration(calibration, units=calibration_units)
    synced = run_sync(takes, rig, by=by, offsets=_offsets(offset or []), each_camera=each_camera)
    written = [synced.merged] if len(output) == 1 else synced.recordings
    for take, path in zip(written, output, strict=True):
        formats.write_observations(take, path)
    if report is not None:
        inputs: list[str | Path] = [*recordings, *([] if calibration is None else [calibration])]
        reports.save(reports.of_run(inputs, options, synced.report), report)
    if not quiet:
        for text in synced.report["warnings"]:
            typer.echo(f"warning: {text}", err=True)
        typer.echo(_summary(synced, output))


def _offsets(texts: list[str]) -> dict[str, float]:
    offsets = {}
    for text in texts:
        name, equals, frames = text.partition("=")
        try:
            offsets[name.strip()] = float(frames)
        except ValueError:
            equals = ""
        if not equals or not name.strip():
            raise InputError(f"--offset {text}: CAM=FRAMES is expected, such as --offset left=3.5") from None
    return offsets


def _summary(synced: Synced, output: list[Path]) -> str:
    lines = []
    for clock in synced.report["clocks"]:
        if clock["way"] == "reference":
            lines.append(f"{clock['name']}: the reference, {clock['rate_hz']:g} Hz")
            continue
        drift = f", drift {clock['drift_ppm']:+.1f} ± {clock['drift_sigma_ppm']:.1f} ppm" if clock["drift_ppm"] else ""
        at = f"{clock['offset_frames']:+.3f} ± {clock['sigma_frames']:.3f}"
        lines.append(f"{clock['name']}: its frame 0 is reference frame {at}{drift}")
    return "\n".join([*lines, f"→ {', '.join(str(p) for p in output)}"])
