"""The verb ``calibrate`` on the command line."""

from __future__ import annotations

import csv
from io import StringIO
from pathlib import Path
from typing import Annotated, Any

import typer

from markerloom import formats
from markerloom import report as reports
from markerloom.calibrate.check import check_rig
from markerloom.calibrate.origin import calibrate_origin
from markerloom.calibrate.page import save_calibration_page
from markerloom.calibrate.refine import refine_rig
from markerloom.calibrate.wand import Calibration, calibrate_wand
from markerloom.calibrate.wands import read_wand
from markerloom.errors import InputError
from markerloom.formats.files import read_text

app = typer.Typer(no_args_is_help=True, help="Calibrate a rig, and say what it is worth.", rich_markup_mode=None)


@app.callback()
def calibrate() -> None:
    """Calibrate a rig, and say what it is worth.

    Example: markerloom calibrate wand wave.csv --wand vicon-t -o rig.toml
    """


@app.command()
def wand(
    observations: Annotated[Path, typer.Argument(help="Dots of a wand wave: .x2d, .parquet, .csv, .csv.gz or a dump")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Calib.toml to write")],
    wand: Annotated[str, typer.Option("--wand", help="vicon-t, line-500, pair-500, or a .toml file")] = "vicon-t",
    intrinsics: Annotated[Path | None, typer.Option(help="A calibration whose lenses are kept.")] = None,
    image_size: Annotated[
        str | None, typer.Option("--image-size", help="Of all cameras.", metavar="WIDTHxHEIGHT")
    ] = None,
    image_sizes: Annotated[
        Path | None, typer.Option("--image-sizes", help="Table camera,width,height.", metavar="FILE.csv")
    ] = None,
    cameras: Annotated[str | None, typer.Option(help="Only these, with commas between.")] = None,
    page: Annotated[Path | None, typer.Option("--page", help="Write a page with pictures.")] = None,
    report: Annotated[Path | None, typer.Option("--report", help="Write a report as JSON.")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")] = False,
) -> None:
    """Calibrate cameras from the raw dots of a waved wand; nothing of the cameras needs to be known.

    A calibration that is not right is refused with its reasons, and the output file stays as it was.

    Example: markerloom calibrate wand wave.csv.gz --wand vicon-t --image-size 1024x1024 -o rig.toml
    """
    options = {k: v for k, v in locals().items() if k not in ("quiet", "report")}
    if formats.ending(output) != ".toml":
        raise typer.BadParameter(f"{output}: calibrations are written as .toml")
    take = formats.read_observations(observations)
    sizes = _sizes(image_size, image_sizes, list(take.camera_ids))
    made = calibrate_wand(
        take,
        read_wand(wand),
        image_sizes=sizes,
        intrinsics=None if intrinsics is None else formats.read_calibration(intrinsics),
        cameras=None if cameras is None else [c.strip() for c in cameras.split(",")],
    )
    if page is not None:
        save_calibration_page(made, page)
    if report is not None:
        inputs: list[str | Path] = [p for p in (observations, intrinsics, image_sizes) if p is not None]
        reports.save(reports.of_run(inputs, options, made.report), report)
    if made.report["verdict"] != "ok":
        reasons = "\n  ".join(made.report["reasons"])
        raise InputError(f"the calibration is refused, {output} stays as it was:\n  {reasons}")
    formats.write_calibration(made.rig, output)
    if not quiet:
        for text in made.report["warnings"]:
            typer.echo(f"warning: {text}", err=True)
        typer.echo(_summary(made, output))


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


def _summary(made: Calibration, output: Path) -> str:
    result: dict[str, Any] = made.report
    return (
        f"{len(made.rig)} cameras from {result['poses']} wand poses, reprojection {result['reprojection_px']:.3f} px, "
        f"on poses left out {result['left_out_residual_px']['median']:.3f} px, "
        f"wand lengths ± {result['wand_length_mm']['std']:.2f} mm → {output}"
    )


def _sizes(one: str | None, table: Path | None, ids: list[str]) -> dict[str, tuple[float, float]] | None:
    if table is not None:
        try:
            rows = list(csv.DictReader(StringIO(read_text(table))))
            return {r["camera"]: (float(r["width"]), float(r["height"])) for r in rows}
        except (KeyError, TypeError, ValueError):
            raise InputError(f"a table with the columns camera, width, height is needed ({table})") from None
    if one is None:
        return None
    width, _, height = one.lower().partition("x")
    try:
        size = (float(width), float(height))
    except ValueError:
        raise typer.BadParameter(f"'{one}' is not WIDTHxHEIGHT", param_hint="--image-size") from None
    return dict.fromkeys(ids, size)
