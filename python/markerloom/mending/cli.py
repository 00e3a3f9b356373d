"""The verb ``mend`` on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from markerloom import formats
from markerloom import report as reports
from markerloom.errors import InputError
from markerloom.mending.edits import edits_path
from markerloom.mending.takes import mend as run_mend


def mend(
    take: Annotated[Path, typer.Argument(help="Points: .c3d, .trc, .parquet, .csv or .tsv")],
    output: Annotated[Path, typer.Option("-o", "--output", help=".c3d, .trc, .parquet or .csv")],
    edits: Annotated[
        Path | None, typer.Option("--edits", help="The list of edits; otherwise TAKE.edits.json.", metavar="FILE.json")
    ] = None,
    report: Annotated[
        Path | None, typer.Option("--report", help="Write a report as JSON.", metavar="FILE.json")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")] = False,
) -> None:
    """Apply the edits that were made in the studio to a take; the take itself is never changed.

    Example: markerloom mend walk.c3d -o walk-mended.c3d
    """
    if formats.ending(output) not in formats.POINTS_WRITTEN:
        raise typer.BadParameter(f"{output}: points are written as {', '.join(formats.POINTS_WRITTEN)}")
    points = formats.read_points(take)
    listed = edits_path(take) if edits is None else edits
    if not listed.is_file():
        raise InputError(f"there are no edits {listed}: make some with `markerloom view {take}`, or name --edits")
    mended = run_mend(points, listed)
    formats.write_points(mended, output)
    if report is not None:
        reports.save(reports.of_run([take, listed], {"edits": listed.name}, mended.report), report)
    if not quiet:
        for text in mended.report["warnings"]:
            typer.echo(f"warning: {text}", err=True)
        typer.echo(f"{mended.report['applied']} edits applied → {output}")
