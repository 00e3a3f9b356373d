"""The verb ``calibrate`` on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from markerloom import formats
from markerloom import report as reports
from markerloom.calibrate.check import check_rig
from markerloom.calibrate.cli_wand import wand
from markerloom.calibrate.origin import calibrate_origin
from markerloom.calibrate.refine import refine_rig
from markerloom.calibrate.wands import read_wand
from markerloom.errors import InputError

app = typer.Typer(no_args_is_help=True, help="Calibrate a rig, and say what it is worth.", rich_markup_mode=None)


@app.callback()
def calibrate() -> None:
    """Calibrate a rig, and say what it is worth.

    Example: markerloom calibrate wand wave.csv --wand vicon-t -o rig.toml
    """


app.command()(wand)


@app.command()
def origin(
    observations: Annotated[Path, typer.Argument(help="Dots of a take with the object lying on the floor.")],
    calibration: Annotated[Path, typer.Option("--calibration", help=".xcp, Calib.toml, .qca.txt or .mcal")],
    floor_object: Annotated[
        str, typer.Option("--object", help="A .toml file with marker places in the wanted world, or vicon-t.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Calib.toml to write")],
    height_mm: Annotated[
        float, typer.Option("--height-mm", help="Height of the stated places' z = 0 above the floor.")
    ] = 0.0,
    report: Annotated[Path | None, typer.Option("--report", help="Write a report as JSON.")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")] = False,
) -> None:
    """Set origin, floor and axes from an object on the floor; scale and the cameras' places to each other stay.

    Example: markerloom calibrate origin floor.csv --calibration rig.toml --object l-frame.toml -o rig.toml
    """
    options = {k: v for k, v in locals().items() if k not in ("quiet", "report")}
    if formats.ending(output) != ".toml":
        raise typer.BadParameter(f"{output}: calibrations are written as .toml")
    rig = formats.read_calibration(calibration)
    placed, result = calibrate_origin(
        rig, formats.read_observations(observations), read_wand(floor_object), height_m=height_mm / 1000.0
    )
    if report is not None:
        reports.save(reports.of_run([observations, calibration], options, result), report)
    formats.write_calibration(placed, output)
    if not quiet:
        for text in result["warnings"]:
            typer.echo(f"warning: {text}", err=True)
        typer.echo(f"{result['frames']} frames, misfit {result['misfit_mm']:.2f} mm → {output}")


@app.command()
def refine(
    observations: Annotated[Path, typer.Argument(help="Dots of any take of this rig.")],
    calibration: Annotated[Path, typer.Option("--calibration", help=".xcp, Calib.toml, .qca.txt or .mcal")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Calib.toml to write")],
    report: Annotated[Path | None, typer.Option("--report", help="Write a report as JSON.")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")] = False,
) -> None:
    """Adjust the cameras' places and directions to a take's own markers; lenses, scale and origin stay.

    Example: markerloom calibrate refine take.x2d --calibration take.xcp -o refined.toml
    """
    options = {k: v for k, v in locals().items() if k not in ("quiet", "report")}
    if formats.ending(output) != ".toml":
        raise typer.BadParameter(f"{output}: calibrations are written as .toml")
    rig = formats.read_calibration(calibration)
    refined, result = refine_rig(rig, formats.read_observations(observations))
    if report is not None:
        reports.save(reports.of_run([observations, calibration], options, result), report)
    if result["verdict"] != "ok":
        raise InputError(f"the refined rig is refused, {output} stays as it was: {result['reasons'][0]}")
    formats.write_calibration(refined, output)
    if not quiet:
        for text in result["warnings"]:
            typer.echo(f"warning: {text}", err=True)
        before, after = result["residual_px_before"]["rms"], result["residual_px_after"]["rms"]
        typer.echo(f"residual on frames left out {before:.3f} → {after:.3f} px → {output}")


@app.command()
def check(
    observations: Annotated[Path, typer.Argument(help="Dots of any take of this rig.")],
    calibration: Annotated[Path, typer.Option("--calibration", help=".xcp, Calib.toml, .qca.txt or .mcal")],
    report: Annotated[Path | None, typer.Option("--report", help="Write a report as JSON.")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")] = False,
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
