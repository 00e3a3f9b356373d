"""The verb ``calibrate`` on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from markerloom import formats
from markerloom import report as reports
from markerloom.calibrate.check import check_rig
from markerloom.calibrate.cli_board import board, intrinsics
from markerloom.calibrate.cli_wand import ImageSize, ImageSizes, sizes, wand
from markerloom.calibrate.floor import origin_from_floor, origin_from_points
from markerloom.calibrate.origin import calibrate_origin
from markerloom.calibrate.points import calibrate_points
from markerloom.calibrate.refine import refine_rig
from markerloom.calibrate.wands import read_wand
from markerloom.errors import InputError

app = typer.Typer(no_args_is_help=True, help="Calibrate a rig, and say what it is worth.", rich_markup_mode=None)


CalibrationFile = Annotated[Path, typer.Option("--calibration", help=".xcp, Calib.toml, .qca.txt or .mcal")]
Output = Annotated[Path, typer.Option("-o", "--output", help="Calib.toml or .xcp to write")]
ReportFile = Annotated[Path | None, typer.Option("--report", help="Write a report as JSON.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")]


def tell(quiet: bool, warnings: list[str], text: str) -> None:
    """Warnings on standard error, then a line."""
    if not quiet:
        for warning in warnings:
            typer.echo(f"warning: {warning}", err=True)
        typer.echo(text)


@app.callback()
def calibrate() -> None:
    """Calibrate a rig, and say what it is worth.

    Example: markerloom calibrate wand wave.csv --wand vicon-t -o rig.toml
    """


app.command()(wand)
app.command()(intrinsics)
app.command()(board)


@app.command()
def origin(
    take: Annotated[
        Path, typer.Argument(help="Dots of a take with the object or markers on the floor; or named points.")
    ],
    calibration: CalibrationFile,
    output: Output,
    floor_object: Annotated[
        str | None, typer.Option("--object", help="A .toml file with marker places in the wanted world, or vicon-t.")
    ] = None,
    floor: Annotated[bool, typer.Option("--floor", help="Markers lie on the floor, anyhow.")] = False,
    points: Annotated[
        str | None,
        typer.Option("--points", help="Labels of the origin, a point on X, one on the side of Y.", metavar="O,X,Y"),
    ] = None,
    height_mm: Annotated[
        float,
        typer.Option("--height-mm", help="Height of the stated places' z = 0, or of the markers, above the floor."),
    ] = 0.0,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Set origin, floor and axes; scale and the cameras' places to each other stay.

    From an object on the floor (--object), from markers that lie on the floor (--floor: heading and origin stay), or
    from three named points of a .c3d, .trc, .parquet or .csv (--points).

    Example: markerloom calibrate origin floor.csv --calibration rig.toml --object l-frame.toml -o rig.toml
    """
    options = {k: v for k, v in locals().items() if k not in ("quiet", "report")}
    formats.check_calibration_output(output)
    rig, height_m = formats.read_calibration(calibration), height_mm / 1000.0
    if (floor_object is not None) + floor + (points is not None) != 1:
        raise typer.BadParameter("one of --object, --floor and --points says where the world is")
    if points is not None:
        names = [n.strip() for n in points.split(",")]
        placed, result = origin_from_points(rig, formats.read_points(take), names, height_m=height_m)
        said = f"the world of {', '.join(names)}"
    elif floor_object is not None:
        seen, wanted = formats.read_observations(take), read_wand(floor_object)
        placed, result = calibrate_origin(rig, seen, wanted, height_m=height_m)
        said = f"{result['frames']} frames, misfit {result['misfit_mm']:.2f} mm"
    else:
        placed, result = origin_from_floor(rig, formats.read_observations(take), height_m=height_m)
        said = f"{result['markers']} markers, misfit {result['misfit_mm']:.2f} mm, tilted by {result['tilt_deg']:.2f}°"
    if report is not None:
        reports.save(reports.of_run([take, calibration], options, result), report)
    formats.write_calibration(placed, output)
    tell(quiet, result["warnings"], f"{said} → {output}")


@app.command()
def points(
    observations: Annotated[Path, typer.Argument(help="Dots of markers at known places.")],
    places: Annotated[Path, typer.Option("--places", help="A .toml file with each marker's name and place.")],
    output: Output,
    intrinsics: Annotated[Path | None, typer.Option(help="A calibration whose lenses are kept.")] = None,
    start: Annotated[Path | None, typer.Option(help="An old calibration that tells which dot is which.")] = None,
    in_order: Annotated[
        bool, typer.Option("--in-order", help="One marker was laid on the places one after the other.")
    ] = False,
    image_size: ImageSize = None,
    image_sizes: ImageSizes = None,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Calibrate cameras from markers whose places in the world are known: six or more, not in one plane.

    Which dot is which is told by the column id, by an old calibration, or by the order.

    Example: markerloom calibrate points frame.csv --places frame.toml --image-size 1280x1024 -o rig.toml
    """
    options = {k: v for k, v in locals().items() if k not in ("quiet", "report")}
    formats.check_calibration_output(output)
    take = formats.read_observations(observations)
    rig, result = calibrate_points(
        take,
        read_wand(places),
        image_sizes=sizes(image_size, image_sizes, list(take.camera_ids)),
        intrinsics=None if intrinsics is None else formats.read_calibration(intrinsics),
        start=None if start is None else formats.read_calibration(start),
        in_order=in_order,
    )
    if report is not None:
        inputs: list[str | Path] = [p for p in (observations, places, intrinsics, start) if p is not None]
        reports.save(reports.of_run(inputs, options, result), report)
    if result["verdict"] != "ok":
        reasons = "\n  ".join(result["reasons"])
        raise InputError(f"the calibration is refused, {output} stays as it was:\n  {reasons}")
    formats.write_calibration(rig, output)
    tell(quiet, result["warnings"], f"{len(rig)} cameras, reprojection {result['reprojection_px']:.3f} px → {output}")


@app.command()
def refine(
    observations: Annotated[Path, typer.Argument(help="Dots of any take of this rig.")],
    calibration: CalibrationFile,
    output: Output,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Adjust the cameras' places and directions to a take's own markers; lenses, scale and origin stay.

    Example: markerloom calibrate refine take.x2d --calibration take.xcp -o refined.toml
    """
    options = {k: v for k, v in locals().items() if k not in ("quiet", "report")}
    formats.check_calibration_output(output)
    refined, result = refine_rig(formats.read_calibration(calibration), formats.read_observations(observations))
    if report is not None:
        reports.save(reports.of_run([observations, calibration], options, result), report)
    if result["verdict"] != "ok":
        raise InputError(f"the refined rig is refused, {output} stays as it was: {result['reasons'][0]}")
    formats.write_calibration(refined, output)
    before, after = result["residual_px_before"]["rms"], result["residual_px_after"]["rms"]
    tell(quiet, result["warnings"], f"residual on frames left out {before:.3f} → {after:.3f} px → {output}")


@app.command()
def check(
    observations: Annotated[Path, typer.Argument(help="Dots of any take of this rig.")],
    calibration: CalibrationFile,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Compare a rig with a take: is it still right, or should it be calibrated again? Exit code 1 if it should.

    Example: markerloom calibrate check take.x2d --calibration take.xcp
    """
    options = {k: v for k, v in locals().items() if k not in ("quiet", "report")}
    result = check_rig(formats.read_calibration(calibration), formats.read_observations(observations))
    if report is not None:
        reports.save(reports.of_run([observations, calibration], options, result), report)
    if not quiet:
        for text in result["warnings"]:
            typer.echo(f"warning: {text}", err=True)
        for name, own in result["cameras"].items():
            x, y = own["bias_px"]
            typer.echo(
                f"camera {name}: bias {x:+.3f}, {y:+.3f} ± {own['bias_sigma_px']:.3f} px, systematic "
                f"{own['systematic_px']:.3f}, rest {own['rest_px']:.3f}, noise {own['noise_px']:.3f} px"
            )
    if result["verdict"] != "ok":
        raise InputError("the rig does not fit this take:\n  " + "\n  ".join(result["reasons"]))
    if not quiet:
        typer.echo("the rig fits this take")
