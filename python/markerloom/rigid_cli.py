"""The verb ``rigid`` on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from markerloom import formats
from markerloom import report as reports
from markerloom.formats import c3d_file
from markerloom.rigid_body import create_rigid_body, read_rigid_body, track_rigid_body, write_rigid_body

rigid_app = typer.Typer(no_args_is_help=True, help="Rigid bodies: props, tools, plates.", rich_markup_mode=None)

Take = Annotated[Path, typer.Argument(help="Named points: .c3d, .trc, .parquet, .csv or .tsv")]
ReportFile = Annotated[Path | None, typer.Option("--report", help="Write a report as JSON.", metavar="FILE.json")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")]


@rigid_app.command("create")
def create(
    take: Take,
    markers: Annotated[str, typer.Option(help="Its markers, with commas between.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="BODY.toml")],
    name: Annotated[str | None, typer.Option(help="The body's name; else the file's.")] = None,
    pivot: Annotated[str | None, typer.Option(help="The marker at its origin; else their middle.")] = None,
    axis: Annotated[str | None, typer.Option(help="Two markers: its x axis.", metavar="FROM,TO")] = None,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Make a rigid body from markers of a take; layouts that fit themselves in another way are refused.

    Example: markerloom rigid create named.c3d --markers T1,T2,T3,T4 -o tool.toml
    """
    ends = None if axis is None else axis.split(",")
    if ends is not None and len(ends) != 2:
        raise typer.BadParameter(f"'{axis}' is not FROM,TO", param_hint="--axis")
    body = create_rigid_body(
        formats.read_points(take),
        markers.split(","),
        name=name or output.stem,
        pivot=pivot,
        axis=None if ends is None else (ends[0], ends[1]),
    )
    write_rigid_body(body, output)
    if report is not None:
        result = {"markers": len(body.markers), "residual_mm": body.residual_mm}
        reports.save(reports.of_run([take], {"markers": markers, "pivot": pivot, "axis": axis}, result), report)
    if not quiet:
        typer.echo(f"'{body.name}': {len(body.markers)} markers, rigid within {body.residual_mm:.3f} mm → {output}")


@rigid_app.command("track")
def track(
    take: Take,
    body: Annotated[Path, typer.Option("--body", help="BODY.toml, or a wand of at least three markers.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Poses: .parquet or .csv; .c3d: the take with them")],
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Where a rigid body is in every frame: position, orientation, and their uncertainty.

    Example: markerloom rigid track named.c3d --body tool.toml -o poses.csv
    """
    points = formats.read_points(take)
    poses = track_rigid_body(points, read_rigid_body(body))
    if formats.ending(output) == ".c3d":
        c3d_file.write(points, output, segments=poses.segments(points.frames))
    else:
        poses.save(output)
    share = len(poses.frame) / max(len(points.frames), 1)
    if report is not None:
        reports.save(reports.of_run([take, body], {}, {"frames": len(points.frames), "posed": share}), report)
    if not quiet:
        sigma = (
            f", ± {np.median(poses.sigma_mm):.3f} mm, ± {np.median(poses.sigma_deg):.3f}°" if len(poses.frame) else ""
        )
        typer.echo(f"'{poses.body}': in {100 * share:.1f} % of {len(points.frames)} frames{sigma} → {output}")
