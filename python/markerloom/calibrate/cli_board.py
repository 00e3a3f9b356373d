"""The verbs ``calibrate intrinsics`` and ``calibrate board`` on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from markerloom import formats
from markerloom import report as reports
from markerloom.calibrate.board_rig import calibrate_board
from markerloom.calibrate.boards import read_board
from markerloom.calibrate.intrinsics import calibrate_intrinsics
from markerloom.detect.images import sources_by_camera
from markerloom.errors import InputError
from markerloom.formats import calib_toml
from markerloom.rig import Rig

Sources = Annotated[list[Path], typer.Argument(help="One for each camera: a video, an image, or a folder of images.")]
BoardSpec = Annotated[
    str,
    typer.Option(
        "--board",
        help="checkerboard:4x7:60 (inner corners, mm), charuco:7x5:40:30:DICT_4X4_50, aprilgrid:6x6:88:0.3, or a .toml",
    ),
]
Output = Annotated[Path, typer.Option("-o", "--output", help="Calib.toml to write")]
Names = Annotated[str | None, typer.Option(help="Camera ids, with commas between; else the files' names.")]
ReportFile = Annotated[Path | None, typer.Option("--report", help="Write a report as JSON.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")]


def intrinsics(
    sources: Sources,
    board: BoardSpec,
    output: Output,
    names: Names = None,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Calibrate lenses from images of a board: focal length, middle, distortion, with their uncertainty.

    The cameras' places stay open (all at the origin): give the file to calibrate wand or board as --intrinsics.

    Example: markerloom calibrate intrinsics left/ right/ --board checkerboard:4x7:60 -o lenses.toml
    """
    options = {k: v for k, v in locals().items() if k not in ("quiet", "report")}
    rig, result = calibrate_intrinsics(sources_by_camera(sources, names), read_board(board))
    _finish(rig, result, sources, options, output, report, quiet)


def board(
    sources: Sources,
    board: BoardSpec,
    output: Output,
    intrinsics: Annotated[Path | None, typer.Option(help="A calibration whose lenses are kept.")] = None,
    names: Names = None,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Calibrate a rig from a board that its cameras see at the same time, image by image.

    Example: markerloom calibrate board left/ right/ --board charuco:7x5:40:30 --intrinsics lenses.toml -o rig.toml
    """
    options = {k: v for k, v in locals().items() if k not in ("quiet", "report")}
    known = None if intrinsics is None else formats.read_calibration(intrinsics)
    rig, result = calibrate_board(sources_by_camera(sources, names), read_board(board), intrinsics=known)
    _finish(rig, result, [*sources, *([] if intrinsics is None else [intrinsics])], options, output, report, quiet)


def _finish(
    rig: Rig,
    result: dict[str, Any],
    inputs: list[Path],
    options: dict[str, Any],
    output: Path,
    report: Path | None,
    quiet: bool,
) -> None:
    if formats.ending(output) != ".toml":
        raise typer.BadParameter(f"{output}: this calibration is written as .toml")
    if report is not None:
        reports.save(reports.of_run([p for p in inputs if p.is_file()], options, result), report)
    if result["verdict"] != "ok":
        reasons = "\n  ".join(result["reasons"])
        raise InputError(f"the calibration is refused, {output} stays as it was:\n  {reasons}")
    quality = {"reprojection_px": result["reprojection_px"], "cameras": result["cameras"]}
    calib_toml.write(rig, output, quality=quality)
    if quiet:
        return
    for text in result["warnings"]:
        typer.echo(f"warning: {text}", err=True)
    for camera, own in result["cameras"].items():
        typer.echo(f"camera {camera}: {own['views']} views, reprojection {own['reprojection_px']['rms']:.3f} px")
    typer.echo(f"{len(rig)} cameras, reprojection {result['reprojection_px']:.3f} px → {output}")
