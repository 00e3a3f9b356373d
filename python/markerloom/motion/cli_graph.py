"""The verb ``edit graph``: libraries of clips, walks through them, lines followed, moments found."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from markerloom import report as reports
from markerloom.motion.cli import (
    HoldFeet,
    Output,
    Page,
    Preset,
    Quiet,
    Rate,
    ReportFile,
    Units,
    Up,
    check_output,
    edit_app,
    finish,
    numbers,
    said_of_feet,
)
from markerloom.motion.edited import Edited
from markerloom.motion.files import Conventions, read_clip
from markerloom.motion.graph import build, follow, walk
from markerloom.motion.library import find, read_library, write_library
from markerloom.skeleton.files import MOTIONS_READ

graph_app = typer.Typer(
    no_args_is_help=True,
    help="Motion graphs: new clips from a library. Example: markerloom edit graph build library.sqlite *.bvh",
    rich_markup_mode=None,
)
edit_app.add_typer(graph_app, name="graph")
Library = Annotated[Path, typer.Argument(help="A library: .sqlite", metavar="LIBRARY")]


@graph_app.command("build")
def build_command(
    library: Library,
    clips: Annotated[list[Path], typer.Argument(help=f"Two or more: {', '.join(MOTIONS_READ)}", metavar="CLIP CLIP …")],
    threshold_mm: Annotated[
        float | None, typer.Option("--threshold-mm", help="How unlike joined moments may be; else found.")
    ] = None,
    units: Units = None,
    up: Up = "y",
    source_rate_hz: Rate = None,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Make a library of clips, with the transitions between them.

    Example: markerloom edit graph build library.sqlite walk.bvh turn.bvh run.bvh
    """
    how = Conventions(units, up, source_rate_hz)
    motions = [read_clip(clip, how)[0] for clip in clips]
    made = build(motions, threshold_m=None if threshold_mm is None else threshold_mm / 1000.0)
    write_library(made, library)
    frames = sum(len(c) for c in made.clips)
    if report is not None:
        result = {"clips": len(clips), "frames": frames, "transitions": len(made.transitions)}
        reports.save(reports.of_run(list(clips), {"threshold_mm": threshold_mm}, result), report)
    if not quiet:
        typer.echo(f"{len(clips)} clips, {frames} frames, {len(made.transitions)} transitions → {library}")


def _said(result: Edited) -> str:
    sharp = max((j["sharpness"] for j in result.report["joins"]), default=0.0)
    moves = result.report["transitions"]
    return f"{moves} transitions, {sharp:.2f} times as sharp as the clips; {said_of_feet(result.report)}"


@graph_app.command("walk")
def walk_command(
    library: Library,
    output: Output,
    seconds: Annotated[float, typer.Option(help="How long.")] = 30.0,
    seed: Annotated[int, typer.Option(help="The same seed gives the same walk.")] = 0,
    hold_feet: HoldFeet = True,
    units: Units = None,
    up: Up = "y",
    preset: Preset = None,
    page: Page = None,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Go through a library at random.

    Example: markerloom edit graph walk library.sqlite --seconds 60 -o minute.bvh
    """
    options = dict(locals())
    check_output(output)
    result = walk(read_library(library), seconds, seed=seed, hold_feet=hold_feet)
    how = Conventions(units, up, preset=preset)
    finish(result, [], [library], output, how, options, _said(result), [], page=page, report=report, quiet=quiet)


@graph_app.command("path")
def path_command(
    library: Library,
    output: Output,
    line: Annotated[str, typer.Option(help="Points on the floor in metres: 'X,Y X,Y …'")],
    hold_feet: HoldFeet = True,
    units: Units = None,
    up: Up = "y",
    preset: Preset = None,
    page: Page = None,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Go along a line on the floor, as near to it as the library's clips can.

    Example: markerloom edit graph path library.sqlite --line "0,0 3,0 3,2" -o along.bvh
    """
    options = dict(locals())
    check_output(output)
    points = np.array([numbers(point, 2, "X,Y X,Y …") for point in line.split()])
    result = follow(read_library(library), points, hold_feet=hold_feet)
    off = result.report["off_line_m"]
    how = Conventions(units, up, preset=preset)
    said = f"{off['rms']:.2f} m rms from the line; {_said(result)}"
    finish(result, [], [library], output, how, options, said, [], page=page, report=report, quiet=quiet)


@graph_app.command("find")
def find_command(
    library: Library,
    clip: Annotated[Path, typer.Argument(help=", ".join(MOTIONS_READ), metavar="CLIP")],
    frame: Annotated[int, typer.Option(help="The moment of the clip, by number of frame.")],
    count: Annotated[int, typer.Option(help="How many moments to find.", min=1)] = 5,
    units: Units = None,
    up: Up = "y",
    source_rate_hz: Rate = None,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Find the moments of a library that are most like one of a clip.

    Example: markerloom edit graph find library.sqlite jump.bvh --frame 120
    """
    motion, _ = read_clip(clip, Conventions(units, up, source_rate_hz))
    found = find(library, motion, frame, count)
    made = read_library(library)
    rows = [{"clip": made.name(f.clip), "frame": f.frame, "distance_mm": 1000.0 * f.distance_m} for f in found]
    if report is not None:
        reports.save(reports.of_run([library, clip], {"frame": frame, "count": count}, {"found": rows}), report)
    if not quiet:
        for row in rows:
            typer.echo(f"{row['clip']}  frame {row['frame']}  {row['distance_mm']:.0f} mm")
