"""The verb ``edit``: clips joined, mixed, mirrored, cropped, looped."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from markerloom.motion.alike import MEASURES
from markerloom.motion.blend import blend, concatenate, through_neutral
from markerloom.motion.cli import (
    Clip,
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
    pairs,
    said_of_feet,
)
from markerloom.motion.clips import crop, in_place, loop, mirror
from markerloom.motion.edited import Edited
from markerloom.motion.files import Conventions, read_clip
from markerloom.motion.registration import mix
from markerloom.skeleton.files import MOTIONS_READ
from markerloom.skeleton.motion import Motion

Clips = Annotated[list[Path], typer.Argument(help=f"Two or more: {', '.join(MOTIONS_READ)}", metavar="CLIP CLIP …")]
Fade = Annotated[float | None, typer.Option("--fade", help="Length of a fade (s); else as long as it needs.")]


def _read(files: list[Path], how: Conventions) -> tuple[list[Motion], list[str]]:
    read = [read_clip(file, how) for file in files]
    return [motion for motion, _ in read], [text for _, told in read for text in told]


def _joins(result: Edited) -> str:
    sharp = max((j["sharpness"] for j in result.report["joins"]), default=0.0)
    return f"joins {sharp:.2f} times as sharp as the clips; {said_of_feet(result.report)}"


@edit_app.command("blend")
def blend_command(
    clips: Clips,
    output: Output,
    weights: Annotated[str | None, typer.Option(help="Mix clips of one kind, with these weights: 0.5,0.5")] = None,
    fade: Fade = None,
    leave: Annotated[int | None, typer.Option(help="Frame of the first clip in which the fade begins.")] = None,
    enter: Annotated[int | None, typer.Option(help="Frame of the second clip that it leads into.")] = None,
    measure: Annotated[str, typer.Option(help=f"Of likeness: {', '.join(MEASURES)}")] = "cloud",
    hold_feet: HoldFeet = True,
    units: Units = None,
    up: Up = "y",
    source_rate_hz: Rate = None,
    preset: Preset = None,
    page: Page = None,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Let one clip fade into another where they are most alike; with weights, make one motion between several.

    Example: markerloom edit blend walk.bvh run.bvh -o walk-run.bvh
    """
    options = dict(locals())
    check_output(output)
    how = Conventions(units, up, source_rate_hz, preset=preset)
    motions, told = _read(clips, how)
    if weights is not None:
        result = mix(motions, numbers(weights, None, "weights with commas between"), hold_feet=hold_feet)
        said = f"{len(motions)} clips mixed; {said_of_feet(result.report)}"
    else:
        if len(motions) != 2:
            raise typer.BadParameter(f"a fade is of two clips, not {len(motions)}; --weights mixes more")
        result = blend(
            motions[0], motions[1], length_s=fade, leave=leave, enter=enter, measure=measure, hold_feet=hold_feet
        )
        said = f"frame {result.report['leave']} into {result.report['enter']}; {_joins(result)}"
    finish(result, motions, clips, output, how, options, said, told, page=page, report=report, quiet=quiet)


@edit_app.command("concat")
def concat_command(
    clips: Clips,
    output: Output,
    fade: Fade = None,
    neutral: Annotated[bool, typer.Option("--neutral", help="Through the rest pose of the skeleton.")] = False,
    neutral_pose: Annotated[str | None, typer.Option("--neutral-pose", help="Through this pose: CLIP=FRAME")] = None,
    hold: Annotated[float, typer.Option("--hold", help="How long the neutral pose is held (s).")] = 0.3,
    hold_feet: HoldFeet = True,
    units: Units = None,
    up: Up = "y",
    source_rate_hz: Rate = None,
    preset: Preset = None,
    page: Page = None,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Put clips one after the other, each where the one before ends and facing as it does.

    Example: markerloom edit concat walk.bvh turn.bvh sit.bvh -o scene.bvh
    """
    options = dict(locals())
    check_output(output)
    how = Conventions(units, up, source_rate_hz, preset=preset)
    motions, told = _read(clips, how)
    if neutral_pose is not None:
        (file, number), *_ = pairs([neutral_pose], "CLIP=FRAME")
        pose, _ = read_clip(file, how)
        at = int(numbers(number, 1, "CLIP=FRAME")[0])
        result = through_neutral(motions, pose, at=at, length_s=fade, hold_s=hold, hold_feet=hold_feet)
    elif neutral:
        result = through_neutral(motions, length_s=fade, hold_s=hold, hold_feet=hold_feet)
    else:
        result = concatenate(motions, length_s=fade, hold_feet=hold_feet)
    said = f"{len(motions)} clips; {_joins(result)}"
    finish(result, motions, clips, output, how, options, said, told, page=page, report=report, quiet=quiet)


@edit_app.command("mirror")
def mirror_command(
    clip: Clip,
    output: Output,
    units: Units = None,
    up: Up = "y",
    source_rate_hz: Rate = None,
    preset: Preset = None,
    page: Page = None,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Exchange left and right.

    Example: markerloom edit mirror kick.bvh -o left-kick.bvh
    """
    options = dict(locals())
    check_output(output)
    how = Conventions(units, up, source_rate_hz, preset=preset)
    motion, told = read_clip(clip, how)
    result = mirror(motion)
    said = f"{result.report['pairs']} pairs of joints, {result.report['off_mirror_mm']:.1f} mm off the mirror at most"
    finish(result, [motion], [clip], output, how, options, said, told, page=page, report=report, quiet=quiet)


@edit_app.command("crop")
def crop_command(
    clip: Clip,
    output: Output,
    start: Annotated[int | None, typer.Option(help="First frame.")] = None,
    stop: Annotated[int | None, typer.Option(help="Frame before which it ends.")] = None,
    from_s: Annotated[float | None, typer.Option("--from", help="From this time (s).")] = None,
    to_s: Annotated[float | None, typer.Option("--to", help="To this time (s).")] = None,
    units: Units = None,
    up: Up = "y",
    source_rate_hz: Rate = None,
    preset: Preset = None,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Keep a part of a clip.

    Example: markerloom edit crop take.bvh --from 2.5 --to 7 -o part.bvh
    """
    options = dict(locals())
    check_output(output)
    how = Conventions(units, up, source_rate_hz, preset=preset)
    motion, told = read_clip(clip, how)
    result = crop(motion, start=start, stop=stop, from_s=from_s, to_s=to_s)
    finish(result, [motion], [clip], output, how, options, f"of {len(motion)}", told, report=report, quiet=quiet)


@edit_app.command("loop")
def loop_command(
    clip: Clip,
    output: Output,
    times: Annotated[int, typer.Option(help="How often it is repeated.", min=1)] = 1,
    start: Annotated[int | None, typer.Option(help="First frame of the loop; else found.")] = None,
    stop: Annotated[int | None, typer.Option(help="Frame that it comes round to; else found.")] = None,
    fade: Annotated[float, typer.Option("--fade", help="Length of the fade (s).")] = 0.4,
    on_the_spot: Annotated[bool, typer.Option("--in-place", help="Take the way over the floor out.")] = False,
    hold_feet: HoldFeet = True,
    units: Units = None,
    up: Up = "y",
    source_rate_hz: Rate = None,
    preset: Preset = None,
    page: Page = None,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Make a part of a clip that can be repeated without end.

    Example: markerloom edit loop walk.bvh --times 4 -o walking.bvh
    """
    options = dict(locals())
    check_output(output)
    how = Conventions(units, up, source_rate_hz, preset=preset)
    motion, told = read_clip(clip, how)
    result = loop(
        motion, times=times, length_s=fade, start=start, stop=stop, on_the_spot=on_the_spot, hold_feet=hold_feet
    )
    said = (
        f"frames {result.report['start']}:{result.report['stop']} ({result.report['seconds']:.2f} s); {_joins(result)}"
    )
    finish(result, [motion], [clip], output, how, options, said, told, page=page, report=report, quiet=quiet)


@edit_app.command("inplace")
def inplace_command(
    clip: Clip,
    output: Output,
    units: Units = None,
    up: Up = "y",
    source_rate_hz: Rate = None,
    preset: Preset = None,
    page: Page = None,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Take the way over the floor out of a motion; how the body sways stays.

    Example: markerloom edit inplace walk.bvh -o treadmill.bvh
    """
    options = dict(locals())
    check_output(output)
    how = Conventions(units, up, source_rate_hz, preset=preset)
    motion, told = read_clip(clip, how)
    result = in_place(motion)
    said = f"{result.report['travel_m']:.2f} m of way taken out"
    finish(result, [motion], [clip], output, how, options, said, told, page=page, report=report, quiet=quiet)
