"""The verbs ``subject`` and ``label`` on the command line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from markerloom import formats
from markerloom import report as reports
from markerloom.labelling.check import check_labels, repair_labels
from markerloom.labelling.takes import label as run_label
from markerloom.points import Points
from markerloom.subjects import create_subject, read_marker_set, read_subject, write_subject
from markerloom.subjects.marker_set import marker_sets
from markerloom.subjects.subject import Subject

subject_app = typer.Typer(
    no_args_is_help=True, help="People and things that wear markers: what label looks for.", rich_markup_mode=None
)

Rate = Annotated[float | None, typer.Option("--rate-hz", help="Frame rate, where the input has none.")]
Units = Annotated[str | None, typer.Option("--units", help="Unit of the take's numbers: mm, cm, m or in.")]
Frames = Annotated[str | None, typer.Option("--frames", help="Only frames A to before B.", metavar="A:B")]
ReportFile = Annotated[Path | None, typer.Option("--report", help="Write a report as JSON.", metavar="FILE.json")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")]
SetName = Annotated[
    str | None, typer.Option("--marker-set", help=f"{', '.join(marker_sets())}; .toml, .vsk, .vst, .xml, a take")
]


@subject_app.command("create")
def create(
    take: Annotated[Path, typer.Argument(help="Labelled frames: .c3d, .trc, .parquet, .csv or .tsv")],
    output: Annotated[Path, typer.Option("-o", "--output", help="SUBJECT.toml")],
    marker_set: SetName = None,
    name: Annotated[str | None, typer.Option(help="The subject's name.")] = None,
    prefix: Annotated[str | None, typer.Option(help="Of several subjects in the take: whose markers.")] = None,
    frames: Frames = None,
    rate_hz: Rate = None,
    units: Units = None,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Learn a subject from labelled frames: a static pose, a range of motion, or any take with names.

    Example: markerloom subject create rom.c3d --marker-set plug-in-gait-39 -o anna.toml
    """
    points = _with_rate(formats.read_points(take), rate_hz)
    worn = None if marker_set is None else read_marker_set(marker_set)
    made = create_subject(points, marker_set=worn, name=name, prefix=prefix, frames=frame_range(frames), units=units)
    write_subject(made, output)
    missing = [] if worn is None else [m for m in worn.markers if m not in made.markers]
    warnings = [f"marker '{m}' of the set is not in the take" for m in missing]
    rigid = sum(d is not None and d[2] >= 1.0 for d in made.distances) // 2
    result = {"frames": len(points.frames), "warnings": warnings, "markers": len(made), "rigid_pairs": rigid}
    if report is not None:
        reports.save(reports.of_run([take], {"marker_set": marker_set, "frames": frames}, result), report)
    if not quiet:
        _warn(warnings)
        typer.echo(f"'{made.name}': {len(made)} markers, {rigid} rigid pairs, {made.poses:.0f} poses → {output}")


def label(
    take: Annotated[Path, typer.Argument(help="Points: .c3d, .trc, .parquet, .csv or .tsv")],
    output: Annotated[Path | None, typer.Option("-o", "--output", help=".c3d, .trc, .parquet or .csv")] = None,
    subject: Annotated[list[Path] | None, typer.Option("--subject", help="SUBJECT.toml; once for each.")] = None,
    marker_set: SetName = None,
    check: Annotated[
        bool, typer.Option("--check", help="Find wrong names of a labelled take; change nothing.")
    ] = False,
    repair: Annotated[
        bool, typer.Option("--repair", help="Find wrong names of a labelled take and mend them.")
    ] = False,
    subject_out: Annotated[
        Path | None, typer.Option("--subject-out", help="Write the subject as the take showed it.")
    ] = None,
    frames: Frames = None,
    rate_hz: Rate = None,
    units: Units = None,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Name the markers of a take: from subjects, in any motion; or from a marker set and a T-pose at the start.

    Example: markerloom label trajectories.c3d --subject anna.toml -o named.c3d
    """
    options = {k: v for k, v in locals().items() if k not in ("report", "quiet")}
    if output is None and not check:
        raise typer.BadParameter("-o is needed, unless --check")
    if output is not None and formats.ending(output) not in formats.POINTS_WRITTEN:
        raise typer.BadParameter(f"{output}: points are written as {', '.join(formats.POINTS_WRITTEN)}")
    known = [read_subject(p) for p in subject or []]
    points = _with_rate(formats.read_points(take), rate_hz)
    if check or repair:
        result = _checked(points, known, units, output if repair else None)
        text = f"{100 * result['wrong_share']:.2f} % of the names are wrong, over {len(result['wrong'])} stretches"
        lines = [
            f"  frames {w['first']} to {w['last']}: '{w['label']}' should be '{w['should'] or 'nobody'}'"
            for w in result["wrong"][:20]
        ]
        text = "\n".join([text, *lines])
    else:
        if bool(known) == (marker_set is not None):
            raise typer.BadParameter("either --subject or --marker-set is needed")
        worn = None if marker_set is None else read_marker_set(marker_set)
        named = run_label(points, subjects=known or None, marker_set=worn, units=units, frames=frame_range(frames))
        assert output is not None
        formats.write_points(named, output)
        if subject_out is not None:
            write_subject(named.subjects[0], subject_out)
        result = named.report
        text = (
            f"{100 * result['completeness']:.1f} % of the marker-frames named, "
            f"{result['unlabelled_per_frame']:.2f} points per frame without a name → {output}"
        )
    if report is not None:
        reports.save(reports.of_run([take, *(subject or [])], options, result), report)
    if not quiet:
        _warn(result["warnings"])
        typer.echo(text)


def _checked(points: Points, known: list[Subject], units: str | None, output: Path | None) -> dict[str, Any]:
    if len(known) > 1:
        raise typer.BadParameter("names are checked for one subject at a time")
    found = check_labels(points, subject=known[0] if known else None, units=units)
    if output is not None:
        formats.write_points(repair_labels(points, found), output)
    return found.report


def _warn(warnings: list[str]) -> None:
    for text in warnings:
        typer.echo(f"warning: {text}", err=True)


def _with_rate(points: Points, rate_hz: float | None) -> Points:
    if rate_hz is None:
        return points
    if not 0 < rate_hz < 1e6:
        raise typer.BadParameter(f"{rate_hz} Hz is no frame rate", param_hint="--rate-hz")
    return replace(points, rate_hz=rate_hz)


def frame_range(text: str | None) -> tuple[int | None, int | None] | None:
    """``A:B`` as two numbers, either of which may be missing."""
    if text is None:
        return None
    first, colon, last = text.partition(":")
    try:
        if not colon:
            raise ValueError
        return (int(first) if first else None, int(last) if last else None)
    except ValueError:
        raise typer.BadParameter(f"'{text}' is not A:B, such as 0:400 or 100:", param_hint="--frames") from None
