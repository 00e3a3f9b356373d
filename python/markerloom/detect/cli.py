"""The verb ``detect`` on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from markerloom import formats
from markerloom import report as reports
from markerloom.active import leds as decode_leds
from markerloom.detect.grey_blobs import detect_x2d
from markerloom.detect.images import grey_images, sources_by_camera, write_png
from markerloom.detect.takes import detect as run_detect
from markerloom.detect.takes import learn_mask as run_learn_mask
from markerloom.detect.takes import read_mask


def detect(
    sources: Annotated[
        list[Path], typer.Argument(help="One for each camera: a video, an image, or a folder of images; or a .x2d.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help=".parquet, .csv or .csv.gz")],
    names: Annotated[str | None, typer.Option(help="Camera ids, with commas between; else the files' names.")] = None,
    threshold: Annotated[float | None, typer.Option(help="Grey value above which a pixel is bright.")] = None,
    white: Annotated[float | None, typer.Option(help="Value at which the sensor saturates (12 bits: 4095).")] = None,
    radius_px: Annotated[float | None, typer.Option(help="Radius of a marker's image, where it is known.")] = None,
    mask: Annotated[
        Path | None, typer.Option(help="A painted image, or a folder with one for each camera: CAMERA.png.")
    ] = None,
    learn_mask: Annotated[
        Path | None,
        typer.Option("--learn-mask", help="The empty scene: a recording, or a folder with one for each camera."),
    ] = None,
    masks_out: Annotated[Path | None, typer.Option(help="Folder for the masks that were learned.")] = None,
    background: Annotated[
        Path | None, typer.Option(help="An image to subtract, or a folder with one for each camera.")
    ] = None,
    leds: Annotated[bool, typer.Option("--leds", help="Markers are LEDs: decode who they are (column id).")] = False,
    frames_per_bit: Annotated[int, typer.Option(help="Frames that a bit of an LED's code lasts.", min=1)] = 1,
    adaptive: Annotated[
        bool, typer.Option("--adaptive", help="Take the background from each image, tile by tile: uneven light.")
    ] = False,
    threads: Annotated[int, typer.Option(help="0 = all cores; the result is the same.", min=0)] = 0,
    report: Annotated[Path | None, typer.Option("--report", help="Write a report as JSON.")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")] = False,
) -> None:
    """Find markers in images and video, with sub-pixel centres and their uncertainty.

    Example: markerloom detect left.mp4 right.mp4 -o dots.parquet
    """
    options = {k: v for k, v in locals().items() if k not in ("quiet", "report")}
    if formats.ending(output) not in formats.TABLE_ENDINGS:
        raise typer.BadParameter(f"{output}: observations are written as {', '.join(formats.TABLE_ENDINGS)}")
    if any(formats.ending(s) == ".x2d" for s in sources):
        _of_x2d(sources, output, options, report, quiet)
        return
    cameras = sources_by_camera(sources, names)
    masks = {}
    for camera in cameras:
        ignored = [] if mask is None else [read_mask(_own(mask, camera))]
        if learn_mask is not None:
            ignored.append(run_learn_mask(_own(learn_mask, camera), threshold=threshold))
        if ignored:
            masks[camera] = np.logical_or.reduce(ignored)
            if masks_out is not None:
                masks_out.mkdir(parents=True, exist_ok=True)
                write_png(np.where(masks[camera], 255, 0).astype(np.uint8), masks_out / f"{camera}.png")
    backgrounds = None if background is None else {c: next(grey_images(_own(background, c))) for c in cameras}
    found, result = run_detect(
        cameras,
        threshold=threshold,
        white=white,
        radius_px=radius_px,
        masks=masks,
        backgrounds=backgrounds,
        adaptive=adaptive,
        threads=threads,
    )
    if leds:
        found, result["leds"] = decode_leds(found, frames_per_bit=frames_per_bit)
        result["warnings"] += result["leds"].pop("warnings")
    formats.write_observations(found, output)
    if report is not None:
        reports.save(reports.of_run([p for p in sources if p.is_file()], options, result), report)
    if not quiet:
        for text in result["warnings"]:
            typer.echo(f"warning: {text}", err=True)
        typer.echo(f"{result['dots']} dots in {result['frames']} images of {len(cameras)} cameras → {output}")


def _of_x2d(sources: list[Path], output: Path, options: dict[str, Any], report: Path | None, quiet: bool) -> None:
    if len(sources) > 1:
        raise typer.BadParameter("a .x2d holds all cameras: one at a time")
    found, result = detect_x2d(sources[0])
    formats.write_observations(found, output)
    if report is not None:
        reports.save(reports.of_run([sources[0]], options, result), report)
    if not quiet:
        typer.echo(
            f"{result['dots']} dots in {result['frames']} frames, from {result['grey_blobs_fitted']} of "
            f"{result['grey_blobs']} grey blobs too → {output}"
        )


def _own(path: Path, camera: str) -> Path:
    """A camera's own file of a folder (by its name without ending), or the file itself."""
    if not path.is_dir():
        return path
    own = [p for p in sorted(path.iterdir()) if p.stem == camera or p.name == camera]
    return own[0] if own else path
