"""The verb ``edit`` on the command line: one operation each on clips of motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from markerloom import report as reports
from markerloom.errors import InputError, MarkerloomError
from markerloom.motion.bands import PRESETS, Curve, bands
from markerloom.motion.body import body_of
from markerloom.motion.constraints import find_constraints, read_constraints, write_constraints
from markerloom.motion.edited import Edited
from markerloom.motion.files import Conventions, read_clip, write_clip
from markerloom.motion.footlock import footlock
from markerloom.motion.keys import by_angles, by_clip, by_reach, frame_at, read_keys
from markerloom.motion.mapping import guess, read_mapping, write_mapping
from markerloom.motion.page import save_edit_page
from markerloom.motion.retarget import retarget
from markerloom.motion.timing import resample, timewarp
from markerloom.motion.upright import standing
from markerloom.motion.warp import BY, warp
from markerloom.skeleton.definition import read_skeleton
from markerloom.skeleton.files import MOTIONS_READ, MOTIONS_WRITTEN, read_skeleton_file
from markerloom.skeleton.files import PRESETS as STYLES
from markerloom.skeleton.motion import Motion

edit_app = typer.Typer(
    no_args_is_help=True,
    help="Motion as material: bands, warping, joining. Example: markerloom edit footlock walk.bvh -o out.bvh",
    rich_markup_mode=None,
)

Clip = Annotated[Path, typer.Argument(help=", ".join(MOTIONS_READ), metavar="CLIP")]
Output = Annotated[Path, typer.Option("-o", "--output", help=", ".join(MOTIONS_WRITTEN))]
Units = Annotated[str | None, typer.Option(help="Of lengths in files without: mm, cm, m, in, or metres per unit.")]
Up = Annotated[str, typer.Option(help="Up axis of the files: y or z.")]
Rate = Annotated[float | None, typer.Option("--source-rate-hz", help="Frame rate of files that say none (AMC).")]
Preset = Annotated[str | None, typer.Option(help=f"Write for {', '.join(STYLES)}")]
HoldFeet = Annotated[bool, typer.Option("--hold-feet/--no-hold-feet", help="Keep standing feet in place.")]
Page = Annotated[Path | None, typer.Option(help="Write a page that shows before and after: .html")]
ReportFile = Annotated[Path | None, typer.Option("--report", help="Write a report as JSON.", metavar="FILE.json")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")]


def pairs(texts: list[str], what: str, split: str = "=") -> list[tuple[str, str]]:
    """Options of the form A=B."""
    out = []
    for text in texts:
        left, sign, right = text.partition(split)
        if not sign or not left.strip() or not right.strip():
            raise typer.BadParameter(f"'{text}' is not {what}")
        out.append((left.strip(), right.strip()))
    return out


def numbers(text: str, count: int | None, what: str) -> list[float]:
    """Numbers with commas between."""
    try:
        values = [float(v) for v in text.split(",")]
    except ValueError:
        values = []
    if not values or (count is not None and len(values) != count):
        raise typer.BadParameter(f"'{text}' is not {what}")
    return values


def check_output(output: Path) -> None:
    """Refuse endings that cannot be written before anything is computed."""
    if output.suffix.lower() not in MOTIONS_WRITTEN:
        raise typer.BadParameter(f"{output}: motions are written as {', '.join(MOTIONS_WRITTEN)}")


def finish(
    result: Edited,
    before: list[Motion],
    inputs: list[Path],
    output: Path,
    how: Conventions,
    options: dict[str, Any],
    said: str,
    warnings: list[str],
    *,
    page: Path | None = None,
    report: Path | None = None,
    quiet: bool = False,
) -> None:
    """Write what came out, its page and its report, and say so in a line."""
    written = write_clip(result.motion, output, how)
    content = result.report | {"warnings": [*warnings, *result.report.get("warnings", [])]}
    if page is not None:
        save_edit_page(before, result.motion, content, output.name, page)
    if report is not None:
        plain = {k: str(v) if isinstance(v, Path) else v for k, v in options.items()}
        own = {"frames": len(result.motion), "rate_hz": result.motion.rate_hz, **content}
        reports.save(reports.of_run(list(inputs), plain, own), report)
    if not quiet:
        for text in content["warnings"]:
            typer.echo(f"warning: {text}", err=True)
        names = ", ".join(str(p) for p in written)
        typer.echo(f"{len(result.motion)} frames; {said} → {names}")


def feet_held(result: Edited, hold: bool) -> Edited:
    """The result with its feet held, where that is wished; otherwise how they slide, if they can be told."""
    if hold:
        held = footlock(result.motion)
        return Edited(held.motion, result.report | {"feet": held.report})
    return result


def said_of_feet(report: dict[str, Any]) -> str:
    """The feet in a few words."""
    if "slide_mm" not in report:
        return "feet as they came"
    return f"{report['plants']} stances slide at most {report['slide_mm']:.2f} mm"


@edit_app.command("bands")
def bands_command(
    clip: Clip,
    output: Output,
    preset_of_bands: Annotated[str | None, typer.Option("--style", help=f"{', '.join(PRESETS)}")] = None,
    gain: Annotated[list[str] | None, typer.Option(help="Of a range of frequencies (Hz): LOW-HIGH=GAIN")] = None,
    band: Annotated[list[str] | None, typer.Option(help="Of one band, 0 the fastest: BAND=GAIN")] = None,
    joints: Annotated[str | None, typer.Option(help="Joints or groups (legs, arms, spine, head, left, right).")] = None,
    root: Annotated[bool, typer.Option("--root", help="The root's place, too.")] = False,
    shape: Annotated[list[str] | None, typer.Option(help="Waveshaping: JOINT:IN=OUT,IN=OUT,… (degrees)")] = None,
    hold_feet: HoldFeet = False,
    units: Units = None,
    up: Up = "y",
    source_rate_hz: Rate = None,
    preset: Preset = None,
    page: Page = None,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Make frequency bands of a motion louder or softer.

    Example: markerloom edit bands walk.bvh --style livelier --hold-feet -o lively.bvh
    """
    options = dict(locals())
    check_output(output)
    hz = []
    for span, value in pairs(gain or [], "LOW-HIGH=GAIN"):
        low, _, high = span.partition("-")
        hz.append((*numbers(f"{low},{high}", 2, "LOW-HIGH=GAIN"), numbers(value, 1, "LOW-HIGH=GAIN")[0]))
    own = {}
    for number, value in pairs(band or [], "BAND=GAIN"):
        if not number.isdigit():
            raise typer.BadParameter(f"'{number}' is not the number of a band")
        own[int(number)] = numbers(value, 1, "BAND=GAIN")[0]
    how = Conventions(units, up, source_rate_hz, preset=preset)
    motion, told = read_clip(clip, how)
    chosen = joints.split(",") if joints else None
    result = bands(
        motion, gains=own, hz=hz, preset=preset_of_bands, joints=chosen, root=root, shape=_shapes(shape or [])
    )
    moved = result.report["moved_mm"]
    result = feet_held(result, hold_feet)
    said = f"{result.report['joints']} joints weighted, moved {moved['rms']:.0f} mm rms"
    finish(result, [motion], [clip], output, how, options, said, told, page=page, report=report, quiet=quiet)


def _shapes(texts: list[str]) -> dict[str, Curve]:
    out: dict[str, Curve] = {}
    for joint, curve in pairs(texts, "JOINT:IN=OUT,IN=OUT,…", ":"):
        points = pairs(curve.split(","), "IN=OUT")
        out[joint] = [(numbers(a, 1, "IN=OUT")[0], numbers(b, 1, "IN=OUT")[0]) for a, b in points]
    return out


@edit_app.command("warp")
def warp_command(
    clip: Clip,
    output: Output,
    keys: Annotated[Path | None, typer.Option(help="Key poses as TOML.")] = None,
    key: Annotated[list[str] | None, typer.Option(help="Angles (degrees) at a time (s): TIME:JOINT=A,B,C")] = None,
    reach: Annotated[list[str] | None, typer.Option(help="A place (mm, Z up) at a time: TIME:JOINT=X,Y,Z")] = None,
    pose: Annotated[list[str] | None, typer.Option(help="A pose of a clip at a time: TIME:CLIP=FRAME")] = None,
    by: Annotated[str, typer.Option(help=" or ".join(BY))] = "shift",
    within: Annotated[float | None, typer.Option(help="Keys reach so far in time (s); else to the next.")] = None,
    hold_feet: HoldFeet = False,
    units: Units = None,
    up: Up = "y",
    source_rate_hz: Rate = None,
    preset: Preset = None,
    page: Page = None,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Bend a motion so that it goes through key poses.

    Example: markerloom edit warp punch.bvh --reach "1.2:RightHand=300,-600,1500" -o higher.bvh
    """
    options = dict(locals())
    check_output(output)
    how = Conventions(units, up, source_rate_hz, preset=preset)
    motion, told = read_clip(clip, how)
    poses = [] if keys is None else read_keys(keys, motion)
    for make, texts, what in ((by_angles, key, "TIME:JOINT=A,B,C"), (by_reach, reach, "TIME:JOINT=X,Y,Z")):
        for moment, rest in pairs(texts or [], what, ":"):
            at = frame_at(motion, time_s=numbers(moment, 1, what)[0])
            (name, values), *_ = pairs([rest], what)
            poses.append(make(motion, at, {name: numbers(values, 3, what)}))
    for moment, rest in pairs(pose or [], "TIME:CLIP=FRAME", ":"):
        (file, number), *_ = pairs([rest], "TIME:CLIP=FRAME")
        other, _ = read_clip(file, how)
        other_at = frame_at(other, frame=int(numbers(number, 1, "TIME:CLIP=FRAME")[0]))
        at = frame_at(motion, time_s=numbers(moment, 1, "TIME:CLIP=FRAME")[0])
        poses.append(by_clip(motion, at, other, other_at))
    result = warp(motion, poses, by=by, reach_s=within)
    missed = result.report["key_error"]
    said = f"{result.report['keys']} keys, missed by {missed['rad']:.1e} rad, {missed['m']:.1e} m"
    result = feet_held(result, hold_feet)
    inputs = [p for p in (clip, keys) if p is not None]
    finish(result, [motion], inputs, output, how, options, said, told, page=page, report=report, quiet=quiet)


@edit_app.command("timewarp")
def timewarp_command(
    clip: Clip,
    output: Output,
    key: Annotated[list[str], typer.Option(help="A time of the clip and the time instead (s): OLD=NEW")],
    hold_feet: HoldFeet = False,
    units: Units = None,
    up: Up = "y",
    source_rate_hz: Rate = None,
    preset: Preset = None,
    page: Page = None,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Let moments of a motion happen earlier or later.

    Example: markerloom edit timewarp punch.bvh --key 1.0=1.4 --key 1.2=1.5 -o windup.bvh
    """
    options = dict(locals())
    check_output(output)
    how = Conventions(units, up, source_rate_hz, preset=preset)
    motion, told = read_clip(clip, how)
    what = "OLD=NEW"
    times = [(numbers(a, 1, what)[0], numbers(b, 1, what)[0]) for a, b in pairs(key, what)]
    result = feet_held(timewarp(motion, times), hold_feet)
    speed = result.report["speed"]
    said = f"{len(times)} keys, time runs {speed['least']:.2f} to {speed['largest']:.2f} times as fast"
    finish(result, [motion], [clip], output, how, options, said, told, page=page, report=report, quiet=quiet)


@edit_app.command("retarget")
def retarget_command(
    clip: Clip,
    output: Output,
    target: Annotated[str, typer.Option(help="The other body: .bvh, .asf, .toml, or hanim-loa1 … hanim-loa4")],
    target_units: Annotated[str | None, typer.Option("--target-units", help="Of the target's lengths.")] = None,
    mapping: Annotated[Path | None, typer.Option(help="Which joint follows which: .toml")] = None,
    mapping_out: Annotated[Path | None, typer.Option("--mapping-out", help="Write the mapping, to edit it.")] = None,
    constraints: Annotated[Path | None, typer.Option(help="What must hold: .toml")] = None,
    constraints_out: Annotated[Path | None, typer.Option("--constraints-out", help="Write what was found.")] = None,
    units: Units = None,
    up: Up = "y",
    source_rate_hz: Rate = None,
    preset: Preset = None,
    page: Page = None,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Put a motion onto another body; feet that stand stand there, too.

    Example: markerloom edit retarget walk.bvh --target hero.bvh -o hero-walk.bvh
    """
    options = dict(locals())
    check_output(output)
    how = Conventions(units, up, source_rate_hz, preset=preset)
    motion, told = read_clip(clip, how)
    body, shown = read_target(target, target_units or units, how)
    known = guess(motion.skeleton, body) if mapping is None else read_mapping(mapping, motion.skeleton, body)
    held = None if constraints is None else read_constraints(constraints, len(motion))
    result = retarget(motion, body, mapping=known, constraints=held, target_motion=shown)
    if mapping_out is not None:
        write_mapping(known, body, mapping_out)
    if constraints_out is not None:
        source, fellow, _ = standing(motion, body_of(motion.skeleton), motion)
        write_constraints(held or find_constraints(source, fellow), constraints_out)
    inputs = [p for p in (clip, Path(target), mapping, constraints) if p is not None and p.is_file()]
    said = f"on '{body.name}', {len(known.joints)} of {len(body)} joints follow; {said_of_feet(result.report)}"
    finish(result, [motion], inputs, output, how, options, said, told, page=page, report=report, quiet=quiet)


def read_target(target: str, units: str | None, how: Conventions) -> tuple[Any, Motion | None]:
    """A target's skeleton, and its own motion where the file has one (it shows how somebody stands in it)."""
    kind = Path(target).suffix.lower()
    if kind == ".bvh":
        if not Path(target).is_file():
            raise InputError(f"there is no file {target}")
        try:
            shown, _ = read_clip(target, replace(how, units=units, rate_hz=None))
        except MarkerloomError:
            return read_skeleton_file(target, units=units, up=how.up), None
        return shown.skeleton, shown
    if kind == ".asf":
        return read_skeleton_file(target, units=units, up=how.up), None
    return read_skeleton(target), None


@edit_app.command("footlock")
def footlock_command(
    clip: Clip,
    output: Output,
    constraints: Annotated[Path | None, typer.Option(help="Stances and floor from this .toml")] = None,
    constraints_out: Annotated[Path | None, typer.Option("--constraints-out", help="Write what was found.")] = None,
    units: Units = None,
    up: Up = "y",
    source_rate_hz: Rate = None,
    preset: Preset = None,
    page: Page = None,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Hold feet that stand where they stand, and keep them out of the floor.

    Example: markerloom edit footlock walk.bvh -o steady.bvh
    """
    options = dict(locals())
    check_output(output)
    how = Conventions(units, up, source_rate_hz, preset=preset)
    motion, told = read_clip(clip, how)
    held = None if constraints is None else read_constraints(constraints, len(motion))
    result = footlock(
        motion, plants=None if held is None else list(held.plants), floor=None if held is None else held.floor_m
    )
    if constraints_out is not None:
        write_constraints(held or find_constraints(motion, body_of(motion.skeleton)), constraints_out)
    before, elsewhere = result.report["before"]["slide_mm"], result.report["moved_elsewhere_mm"]
    said = f"{said_of_feet(result.report)} (before: {before:.1f}), elsewhere moved {elsewhere:.1f} mm at most"
    inputs = [p for p in (clip, constraints) if p is not None]
    finish(result, [motion], inputs, output, how, options, said, told, page=page, report=report, quiet=quiet)


@edit_app.command("resample")
def resample_command(
    clip: Clip,
    output: Output,
    rate_hz: Annotated[float, typer.Option("--rate-hz", help="The new frame rate.")],
    units: Units = None,
    up: Up = "y",
    source_rate_hz: Rate = None,
    preset: Preset = None,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Give a clip another frame rate.

    Example: markerloom edit resample walk.bvh --rate-hz 60 -o walk60.bvh
    """
    options = dict(locals())
    check_output(output)
    how = Conventions(units, up, source_rate_hz, preset=preset)
    motion, told = read_clip(clip, how)
    result = resample(motion, rate_hz)
    said = f"{motion.rate_hz:g} → {rate_hz:g} Hz"
    finish(result, [motion], [clip], output, how, options, said, told, report=report, quiet=quiet)


# The other operations add themselves.
from markerloom.motion import cli_graph, cli_join  # noqa: E402, F401
