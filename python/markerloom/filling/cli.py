"""The verbs ``fill`` and ``smooth`` on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from markerloom import formats
from markerloom import report as reports
from markerloom.filling.methods import METHODS
from markerloom.filling.takes import LONGEST_S
from markerloom.filling.takes import fill as run_fill
from markerloom.labelling.cli import frame_range
from markerloom.points import Points
from markerloom.smoothing import AVERAGE_S, CUTOFF_HZ
from markerloom.smoothing import METHODS as SMOOTHERS
from markerloom.smoothing import smooth as run_smooth
from markerloom.subjects import read_marker_set, with_virtual_markers

Take = Annotated[Path, typer.Argument(help="Points: .c3d, .trc, .parquet, .csv or .tsv")]
Output = Annotated[Path, typer.Option("-o", "--output", help=".c3d, .trc, .parquet or .csv")]
Rate = Annotated[float | None, typer.Option("--rate-hz", help="Frame rate, where the input has none.")]
ReportFile = Annotated[Path | None, typer.Option("--report", help="Write a report as JSON.", metavar="FILE.json")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")]


def fill(
    take: Take,
    output: Output,
    method: Annotated[str, typer.Option(help=f"auto, {', '.join(METHODS)}")] = "auto",
    longest_s: Annotated[float, typer.Option("--longest-s", help="Longer gaps stay.")] = LONGEST_S,
    markers: Annotated[str | None, typer.Option(help="Only these, with commas between.")] = None,
    predicted: Annotated[bool, typer.Option("--predicted", help="Fill anew what a tracker carried.")] = False,
    frames: Annotated[str | None, typer.Option("--frames", help="Only gaps that meet these.", metavar="A:B")] = None,
    virtual: Annotated[
        str | None, typer.Option("--virtual", help="Add the virtual markers of this set: its name, or SET.toml.")
    ] = None,
    rate_hz: Rate = None,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Fill gaps: each by the mix of methods that would have filled others like it best; with its expected error.

    Example: markerloom fill named.c3d -o filled.c3d
    """
    options = {k: v for k, v in locals().items() if k not in ("report", "quiet")}
    wanted = None if markers is None else markers.split(",")
    points = _read(take, output)
    more = None if virtual is None else read_marker_set(virtual)
    filled = run_fill(
        points,
        method=method,
        longest_s=longest_s,
        rate_hz=rate_hz,
        markers=wanted,
        predicted=predicted,
        frames=frame_range(frames),
    )
    result = filled.report
    done = filled if more is None else with_virtual_markers(filled, more)
    _finish(done, output, [take], options, result, report)
    if not quiet:
        for text in result["warnings"]:
            typer.echo(f"warning: {text}", err=True)
        typer.echo(
            f"{len(result['filled'])} of {result['gaps']} gaps filled, "
            f"{100 * result['complete_before']:.2f} → {100 * result['complete_after']:.2f} % complete → {output}"
        )


def smooth(
    take: Take,
    output: Output,
    method: Annotated[str, typer.Option(help=", ".join(SMOOTHERS))] = "butterworth",
    cutoff_hz: Annotated[float, typer.Option("--cutoff-hz", help="Of butterworth: −3 dB of the result.")] = CUTOFF_HZ,
    order: Annotated[int, typer.Option(help="Of butterworth, over both passes.")] = 4,
    window_s: Annotated[float, typer.Option("--window-s", help="Of average: standard deviation.")] = AVERAGE_S,
    outliers: Annotated[bool, typer.Option("--outliers/--no-outliers", help="Throw outliers away first.")] = True,
    rate_hz: Rate = None,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Smooth trajectories, run by run; gaps stay gaps.

    Example: markerloom smooth filled.c3d -o smooth.c3d --cutoff-hz 6
    """
    options = {k: v for k, v in locals().items() if k not in ("report", "quiet")}
    points = _read(take, output)
    smoothed = run_smooth(
        points,
        method=method,
        cutoff_hz=cutoff_hz,
        order=order,
        window_s=window_s,
        outliers=outliers,
        rate_hz=rate_hz,
    )
    result = smoothed.report
    _finish(smoothed, output, [take], options, result, report)
    if not quiet:
        typer.echo(
            f"{result['outliers']} outliers thrown away, changed by {result['change_mm']['rms']:.3f} mm rms → {output}"
        )


def _read(take: Path, output: Path) -> Points:
    if formats.ending(output) not in formats.POINTS_WRITTEN:
        raise typer.BadParameter(f"{output}: points are written as {', '.join(formats.POINTS_WRITTEN)}")
    return formats.read_points(take)


def _finish(
    points: Points,
    output: Path,
    inputs: list[str | Path],
    options: dict[str, Any],
    result: dict[str, Any],
    report: Path | None,
) -> None:
    formats.write_points(points, output)
    if report is not None:
        reports.save(reports.of_run(inputs, options, result), report)
