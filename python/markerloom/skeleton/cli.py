"""The verb ``solve`` on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from markerloom import formats
from markerloom import report as reports
from markerloom.errors import InputError
from markerloom.points import Points
from markerloom.skeleton.contacts import read_contacts, write_contacts
from markerloom.skeleton.definition import LEVELS, read_skeleton
from markerloom.skeleton.files import MOTIONS_WRITTEN, PRESETS, RESTS, write_motion
from markerloom.skeleton.fitting import Wearer
from markerloom.skeleton.mvnx import SegmentPoses
from markerloom.skeleton.page import save_motion_page
from markerloom.skeleton.placing import read_hints
from markerloom.skeleton.segment_poses import is_segment_poses, read_segment_poses, solve_segments
from markerloom.skeleton.takes import Solved
from markerloom.skeleton.takes import solve as run_solve
from markerloom.skeleton.wearer import has_markers, read_wearer, write_wearer
from markerloom.subjects import read_marker_set, read_subject

ReportFile = Annotated[Path | None, typer.Option("--report", help="Write a report as JSON.", metavar="FILE.json")]


def solve(
    take: Annotated[Path, typer.Argument(help="Named points (.c3d, .trc, .parquet, .csv), or segments' poses alone")],
    output: Annotated[Path, typer.Option("-o", "--output", help=", ".join(MOTIONS_WRITTEN))],
    skeleton: Annotated[str, typer.Option(help=f"{', '.join(LEVELS)}, or a .toml, .bvh or .asf")] = "hanim-loa1",
    subject: Annotated[Path | None, typer.Option(help="SUBJECT.toml: says which marker is on which segment.")] = None,
    marker_set: Annotated[str | None, typer.Option("--marker-set", help="The set that the names are of.")] = None,
    hints: Annotated[Path | None, typer.Option(help="TOML that says which markers are on which segment.")] = None,
    fit_from: Annotated[Path | None, typer.Option("--fit-from", help="Fit to this take: a ROM, a static pose.")] = None,
    skeleton_out: Annotated[Path | None, typer.Option("--skeleton-out", help="Keep the fitted skeleton: .toml")] = None,
    poses: Annotated[Path | None, typer.Option(help="Sensors on segments: .mvnx, .c3d, or a table of poses.")] = None,
    contacts: Annotated[Path | None, typer.Option(help="Feet that stand, from this table.")] = None,
    contacts_out: Annotated[Path | None, typer.Option("--contacts-out", help="Write that table, to edit it.")] = None,
    hold_feet: Annotated[bool, typer.Option("--hold-feet/--no-hold-feet", help="Keep standing feet in place.")] = True,
    person: Annotated[str | None, typer.Option(help="Which subject, where the take has several.")] = None,
    units: Annotated[str | None, typer.Option(help="Of lengths: mm, cm, m, in, or how many metres one is.")] = None,
    up: Annotated[str | None, typer.Option(help="Up axis of the output: y or z.")] = None,
    order: Annotated[str | None, typer.Option(help="Order of a BVH's angles, such as ZXY.")] = None,
    rest: Annotated[str | None, typer.Option(help=f"Rest pose: {', '.join(RESTS)}")] = None,
    radians: Annotated[bool, typer.Option("--radians", help="Angles of ASF/AMC in radians.")] = False,
    preset: Annotated[str | None, typer.Option(help=f"Units, axes and order of {', '.join(PRESETS)}")] = None,
    rate_hz: Annotated[float | None, typer.Option("--rate-hz", help="Frame rate, where the input has none.")] = None,
    page: Annotated[Path | None, typer.Option(help="Write a page with angles, contacts and residuals: .html")] = None,
    report: ReportFile = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")] = False,
) -> None:
    """Make a moving skeleton with constant bones from named markers, sensors on segments, or both.

    Example: markerloom solve filled.c3d -o take.bvh
    """
    options = {k: str(v) if isinstance(v, Path) else v for k, v in locals().items() if k not in ("report", "quiet")}
    if output.suffix.lower() not in MOTIONS_WRITTEN:
        raise typer.BadParameter(f"{output}: motions are written as {', '.join(MOTIONS_WRITTEN)}")
    style = {"units": units, "up": up, "order": order, "rest": rest, "radians": radians, "preset": preset}
    if is_segment_poses(take):
        _refuse_without_markers(take, options)
        motion = solve_segments(_poses(take, skeleton, rate_hz))
        written = write_motion(motion, output, **style)  # pyright: ignore[reportArgumentType]
        _finish([take], options, {"frames": len(motion), "joints": len(motion.skeleton)}, report)
        _say(quiet, f"{len(motion)} frames, {len(motion.skeleton)} joints → {_names(written)}")
        return
    points = formats.read_points(take)
    sensors = None if poses is None else _poses(poses, skeleton, rate_hz or points.rate_hz)
    solved = _solved(
        points, skeleton, subject, marker_set, hints, fit_from, contacts, hold_feet, person, rate_hz, sensors
    )
    glued = list(zip(solved.wearer.markers, solved.wearer.joints, solved.wearer.places_m, strict=True))
    written = write_motion(solved.motion, output, markers=glued, take=points, **style)  # pyright: ignore[reportArgumentType]
    if skeleton_out is not None:
        write_wearer(solved.wearer, skeleton_out)
    if contacts_out is not None:
        write_contacts(solved.contacts, contacts_out)
    if page is not None:
        save_motion_page(solved, page)
    _finish([p for p in (take, subject, hints, fit_from, poses, contacts) if p], options, solved.report, report)
    off = solved.report["residual_mm"]
    for text in solved.report["warnings"]:
        _say(quiet, f"warning: {text}", err=True)
    _say(
        quiet,
        f"{len(solved.motion)} frames, {len(solved.motion.skeleton)} joints; markers {off['rms']:.2f} mm rms "
        f"({off['median']:.2f} median) from the skeleton, {len(solved.contacts)} contacts → {_names(written)}",
    )


OF_MARKERS = ("subject", "marker_set", "hints", "fit_from", "skeleton_out", "poses", "contacts", "contacts_out", "page")


def _refuse_without_markers(take: Path, options: dict[str, Any]) -> None:
    given = [f"--{name.replace('_', '-')}" for name in OF_MARKERS if options[name] is not None]
    if given:
        raise InputError(f"{', '.join(given)} belong to a take with markers; {take} holds poses of segments")


def _poses(path: Path, skeleton: str, rate_hz: float | None) -> SegmentPoses:
    body = read_wearer(skeleton) if has_markers(skeleton) else read_skeleton(skeleton)
    return read_segment_poses(path, body.skeleton if isinstance(body, Wearer) else body, rate_hz)


def _solved(
    points: Points,
    skeleton: str,
    subject: Path | None,
    marker_set: str | None,
    hints: Path | None,
    fit_from: Path | None,
    contacts: Path | None,
    hold_feet: bool,
    person: str | None,
    rate_hz: float | None,
    poses: SegmentPoses | None,
) -> Solved:
    if sum(v is not None for v in (subject, marker_set, hints)) > 1:
        raise InputError("--subject, --marker-set and --hints say the same thing: give one of them")
    known = None if hints is None else read_hints(hints)
    if marker_set is not None:
        known = read_marker_set(marker_set)
    if subject is not None:
        known = _of_subject(subject)
    body = read_wearer(skeleton) if has_markers(skeleton) else read_skeleton(skeleton)
    bones = body.skeleton if isinstance(body, Wearer) else body
    held = hold_feet if contacts is None else read_contacts(contacts, bones)
    return run_solve(
        points,
        body,
        known=known,
        fit_from=None if fit_from is None else formats.read_points(fit_from),
        contacts=held,
        person=person,
        rate_hz=rate_hz,
        poses=poses,
    )


def _of_subject(path: Path) -> Any:
    """What a subject says of its markers: its marker set where that is known, else the segments alone."""
    from markerloom.skeleton.placing import Hints
    from markerloom.subjects import marker_sets

    subject = read_subject(path)
    if subject.marker_set in marker_sets():
        return read_marker_set(subject.marker_set)
    segments = {m: s for m, s in zip(subject.markers, subject.segments, strict=True) if s}
    if not segments:
        raise InputError(f"{path} does not say which segments its markers are on: give --hints")
    return Hints(segments, {}, str(path))


def _finish(inputs: list[Path], options: dict[str, Any], result: dict[str, Any], report: Path | None) -> None:
    if report is not None:
        reports.save(reports.of_run(list(inputs), options, result), report)


def _names(paths: list[Path]) -> str:
    return ", ".join(str(p) for p in paths)


def _say(quiet: bool, text: str, *, err: bool = False) -> None:
    if not quiet:
        typer.echo(text, err=err)
