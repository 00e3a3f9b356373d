"""The verb ``calibrate wand`` on the command line."""

from __future__ import annotations

import csv
from io import StringIO
from pathlib import Path
from typing import Annotated, Any

import typer

from markerloom import formats
from markerloom import report as reports
from markerloom.calibrate import recordings
from markerloom.calibrate.page import save_calibration_page
from markerloom.calibrate.wand import Calibration, calibrate_wand
from markerloom.calibrate.wands import read_wand
from markerloom.errors import InputError
from markerloom.formats.files import read_text

ImageSize = Annotated[str | None, typer.Option("--image-size", help="Of all cameras.", metavar="WIDTHxHEIGHT")]
ImageSizes = Annotated[
    Path | None, typer.Option("--image-sizes", help="Table camera,width,height.", metavar="FILE.csv")
]


def wand(
    observations: Annotated[
        list[Path], typer.Argument(help="Dots of a wand wave, in one recording or several: .x2d, .parquet, .csv, …")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Calib.toml to write")],
    wand: Annotated[
        str, typer.Option("--wand", help="vicon-t, line-500, pair-500, marker, or a .toml file")
    ] = "vicon-t",
    intrinsics: Annotated[Path | None, typer.Option(help="A calibration whose lenses are kept.")] = None,
    start: Annotated[Path | None, typer.Option(help="An old calibration to start from; its world is kept.")] = None,
    continued: Annotated[
        Path | None, typer.Option("--continue", help="A calibration whose recordings are used too.", metavar="CAL")
    ] = None,
    image_size: ImageSize = None,
    image_sizes: ImageSizes = None,
    cameras: Annotated[str | None, typer.Option(help="Only these, with commas between.")] = None,
    camera_distance: Annotated[
        str | None, typer.Option(help="Distance of two cameras, for a single marker.", metavar="A,B=MM")
    ] = None,
    page: Annotated[Path | None, typer.Option("--page", help="Write a page with pictures.")] = None,
    report: Annotated[Path | None, typer.Option("--report", help="Write a report as JSON.")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")] = False,
) -> None:
    """Calibrate cameras from the raw dots of a waved wand; nothing of the cameras needs to be known.

    A calibration that is not right is refused with its reasons, and the output file stays as it was. It is kept as
    OUTPUT.refused.toml; wave more where the reasons say, and go on with --continue OUTPUT.refused.toml.

    Example: markerloom calibrate wand wave.csv.gz --wand vicon-t --image-size 1024x1024 -o rig.toml
    """
    options = {k: v for k, v in locals().items() if k not in ("quiet", "report")}
    if formats.ending(output) != ".toml":
        raise typer.BadParameter(f"{output}: a wand calibration is written as .toml")
    sources = [*([] if continued is None else recordings.recordings_of(continued)), *observations]
    take = recordings.read_all(sources)
    made = calibrate_wand(
        take,
        read_wand(wand),
        image_sizes=sizes(image_size, image_sizes, list(take.camera_ids)),
        intrinsics=None if intrinsics is None else formats.read_calibration(intrinsics),
        start=None if start is None else formats.read_calibration(start),
        cameras=None if cameras is None else [c.strip() for c in cameras.split(",")],
        camera_distance_m=None if camera_distance is None else _distance(camera_distance),
    )
    if page is not None:
        save_calibration_page(made, page)
    if report is not None:
        inputs: list[str | Path] = [p for p in (*sources, intrinsics, start, image_sizes) if p is not None]
        reports.save(reports.of_run(inputs, options, made.report), report)
    if made.report["verdict"] != "ok":
        _refuse(made, sources, wand, output)
    recordings.write(made, sources, wand, output)
    if not quiet:
        for text in made.report["warnings"]:
            typer.echo(f"warning: {text}", err=True)
        typer.echo(_summary(made, output))


def _refuse(made: Calibration, sources: list[Path], wand: str, output: Path) -> None:
    kept = recordings.refused_path(output)
    recordings.write(made, sources, wand, kept)
    reasons = "\n  ".join(made.report["reasons"])
    raise InputError(
        f"the calibration is refused, {output} stays as it was:\n  {reasons}\n"
        f"To add another wave to this one: --continue {kept}"
    )


def _summary(made: Calibration, output: Path) -> str:
    result: dict[str, Any] = made.report
    lengths = result["wand_length_mm"]
    measured = f"wand lengths ± {lengths['std']:.2f} mm " if lengths["count"] else ""
    return (
        f"{len(made.rig)} cameras from {result['poses']} wand poses, reprojection {result['reprojection_px']:.3f} px, "
        f"on poses left out {result['left_out_residual_px']['median']:.3f} px, {measured}→ {output}"
    )


def _distance(text: str) -> tuple[str, str, float]:
    names, _, distance = text.partition("=")
    first, _, second = names.partition(",")
    try:
        return first.strip(), second.strip(), float(distance) / 1000.0
    except ValueError:
        raise typer.BadParameter(f"'{text}' is not A,B=MM", param_hint="--camera-distance") from None


def sizes(one: str | None, table: Path | None, ids: list[str]) -> dict[str, tuple[float, float]] | None:
    """Image sizes by camera, as the options state them."""
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
