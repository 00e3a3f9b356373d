"""The whole chain over a project's takes: dots → trajectories → names → fills → skeleton → files, a page for each."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import tomlkit

from markerloom import formats
from markerloom.errors import InputError, MarkerloomError
from markerloom.filling import fill
from markerloom.formats import table_file
from markerloom.formats.files import write_text
from markerloom.labelling import label
from markerloom.mending import EditList, edits_path, mend, read_edits, without_excluded, write_edits
from markerloom.mending.edits import ENDING
from markerloom.mending.feet import marked
from markerloom.observations import Observations
from markerloom.points import Points
from markerloom.project.page import save_quality, save_take_page
from markerloom.project.settings import Project, TakeSettings, read_project
from markerloom.project.stages import Stages, key_of
from markerloom.skeleton import read_hints, read_wearer, solve, write_motion
from markerloom.skeleton.contacts import find_contacts
from markerloom.skeleton.page import save_motion_page
from markerloom.skeleton.wearer import has_markers
from markerloom.smoothing import smooth
from markerloom.subjects import read_marker_set, read_subject, with_virtual_markers
from markerloom.track import track

RESULTS = "results"
ASSIGNMENTS = "assignments.parquet"
"""Which centroid is whose: beside the tracked take, for the studio."""
VERSIONS = {"track": 2, "label": 1, "fill": 1, "smooth": 1, "mend": 1, "solve": 2}
"""Raised when a stage gives other results for the same input: what was computed before is then computed again."""
Say = Callable[[str], None]
VIEW = "view.html"
Viewer = Callable[["Project", "TakeSettings", Path], None]
"""Writes a take, as it is after `process`, into one page in which it can be looked at."""


def process(
    folder: str | Path | Project,
    *,
    takes: list[str] | None = None,
    say: Say | None = None,
    viewer: Viewer | None = None,
) -> dict[str, Any]:
    """Process a project, by its folder or as it was read; returns a row for each take, and the reason of each failure.

    Results are in ``results/TAKE``: every stage as Parquet, the exported files, a page, and a snapshot of calibration,
    subjects and settings. What did not change is not computed again; a take that fails does not stop the others.
    ``takes``: only these. ``viewer``: writes ``view.html`` beside each page.
    """
    project = folder if isinstance(folder, Project) else read_project(folder)
    chosen = _chosen(project, takes)
    rows: list[dict[str, Any]] = []
    failed: list[dict[str, str]] = []
    for settings in chosen:
        try:
            rows.append(_one(project, settings, viewer))
            if say:
                ran = ", ".join(rows[-1]["ran"]) or "nothing to do"
                say(f"{settings.name}: {ran}; {100 * rows[-1]['complete']:.2f} % complete")
        except MarkerloomError as error:
            failed.append({"take": settings.name, "reason": str(error)})
            if say:
                say(f"{settings.name}: failed: {error}")
    save_quality(project, rows, failed, others=[t.name for t in project.takes if t not in chosen])
    return {
        "frames": sum(r["frames"] for r in rows),
        "warnings": [f"take '{f['take']}' failed: {f['reason']}" for f in failed],
        "takes": rows,
        "failed": failed,
    }


def _chosen(project: Project, takes: list[str] | None) -> list[TakeSettings]:
    names = [t.name for t in project.takes]
    unknown = sorted(set(takes or []) - set(names))
    if unknown:
        raise InputError(f"the project has no take '{unknown[0]}'; it has {', '.join(names)}")
    return [t for t in project.takes if takes is None or t.name in takes]


def _one(project: Project, settings: TakeSettings, viewer: Viewer | None) -> dict[str, Any]:
    """One take through all stages."""
    made = automatic(project, settings)
    stages, reports, edits = made.stages, made.reports, made.edits
    points, key = made.points, made.key
    if edits.of_points:
        key = key_of(key, edits.plain(), VERSIONS["mend"])
        points, reports["mend"] = stages.points("mend", key, lambda: _mended(made.points, edits))
    exported = _exported(stages, settings, points, key)
    if settings.skeleton:
        reports["solve"] = _solve(stages, settings, points, key, edits)
        exported += [f"{settings.name}{kind}" for kind in settings.solve_to]
    _snapshot(stages.folder, settings, edits)
    view = stages.folder / VIEW
    if viewer is not None and (stages.ran or not view.is_file()):
        viewer(project, settings, view)
    save_take_page(stages.folder / "report.html", settings, points, reports, view=VIEW if view.is_file() else "")
    fills = reports.get("fill", {})
    named = reports.get("label", {})
    warnings = [w for r in reports.values() for w in r.get("warnings", [])]
    return {
        "take": settings.name,
        "frames": len(points.frames),
        "ran": stages.ran,
        "edits": len(edits),
        "named": named.get("completeness"),
        "gaps": fills.get("gaps", 0),
        "filled": len(fills.get("filled", [])),
        "complete": fills.get("complete_after", 1.0),
        "skeleton_mm": reports.get("solve", {}).get("residual_mm", {}).get("rms"),
        "residual_px": reports["track"].get("residual_px", {}).get("median"),
        "warnings": warnings,
        "exported": exported,
    }


@dataclass(frozen=True)
class Automatic:
    """A take as it comes out of the stages that need nobody, before its edits; ``edits``: those it has."""

    points: Points
    key: str
    reports: dict[str, dict[str, Any]]
    stages: Stages
    edits: EditList


def automatic(project: Project, settings: TakeSettings) -> Automatic:
    """Track, name, fill and smooth a take as its settings say; what did not change is read from disk.

    Centroids that its edits exclude are left out; its other edits come after, in ``process``.
    """
    given = (settings.file, settings.calibration, settings.hints, settings.fit_from, *settings.subjects)
    missing = [p for p in given if p and not Path(p).is_file()]
    if missing:
        raise InputError(f"there is no file {missing[0]} (take '{settings.name}')")
    stages = Stages(project.folder / RESULTS / settings.name)
    listed = edits_path(settings.file)
    edits = read_edits(listed) if listed.is_file() else EditList()
    reports: dict[str, dict[str, Any]] = {}
    points, key, reports["track"] = _tracked(stages, settings, edits)
    for stage, options, run in _stages(settings):
        key = key_of(key, options, VERSIONS[stage])
        points, reports[stage] = stages.points(stage, key, lambda run=run, points=points: run(points))
    return Automatic(points, key, reports, stages, edits)


def _mended(points: Points, edits: EditList) -> tuple[Points, dict[str, Any]]:
    made = mend(points, edits)
    return made, made.report


def _exported(stages: Stages, settings: TakeSettings, points: Points, key: str) -> list[str]:
    """The take in the files that are asked for, with its virtual markers if they are asked for."""
    more = read_marker_set(settings.virtual) if settings.virtual else None
    if more is not None:
        key = key_of(key, sorted(more.virtual.items()))
        points = with_virtual_markers(points, more)
    exported = []
    for kind in settings.export:
        target, note = stages.folder / f"{settings.name}{kind}", stages.folder / f".{settings.name}{kind}.key"
        if not target.is_file() or not note.is_file() or note.read_text("utf-8") != key:
            formats.write_points(points, target)
            write_text(note, key)
        exported.append(target.name)
    return exported


def _solve(stages: Stages, settings: TakeSettings, points: Points, key: str, edits: EditList) -> dict[str, Any]:
    """A skeleton under the take's markers: its files, and a page of its own."""
    names = (settings.skeleton, settings.hints, settings.fit_from)
    made_of = [key_of(Path(n)) if n and Path(n).is_file() else n for n in names]
    page = stages.folder / "skeleton.html"
    marks = [e.model_dump() for e in edits.of_contacts]
    targets = [stages.folder / f"{settings.name}{kind}" for kind in settings.solve_to]

    def run() -> dict[str, Any]:
        worn = settings.marker_set or next((read_subject(s).marker_set for s in settings.subjects), "")
        known = read_hints(settings.hints) if settings.hints else read_marker_set(worn) if worn else None
        body = settings.skeleton
        solved = solve(
            points,
            read_wearer(body) if has_markers(body) else body,
            known=known,
            fit_from=formats.read_points(settings.fit_from) if settings.fit_from else None,
            contacts=lambda motion: marked(find_contacts(motion), edits.of_contacts),
        )
        glued = list(zip(solved.wearer.markers, solved.wearer.joints, solved.wearer.places_m, strict=True))
        for target in targets:
            write_motion(solved.motion, target, markers=glued)
        save_motion_page(solved, page)
        return solved.report

    key = key_of(key, made_of, settings.marker_set, list(settings.solve_to), marks, VERSIONS["solve"])
    return stages.files("solve", key, [*targets, page], run)


def _tracked(stages: Stages, settings: TakeSettings, edits: EditList) -> tuple[Points, str, dict[str, Any]]:
    """Trajectories: from dots by tracking, or as another system made them."""
    file = Path(settings.file)
    options = {"frames": settings.frames, "rate_hz": settings.rate_hz}
    frames = _frames(settings.frames)
    if holds_dots(file):
        if not settings.calibration:
            raise InputError(f"{file.name} holds dots: the project needs a calibration for take '{settings.name}'")
        excluded = [e.model_dump(mode="json") for e in edits.of_dots]
        key = key_of(file, Path(settings.calibration), options, excluded, VERSIONS["track"])

        def run() -> tuple[Points, dict[str, Any]]:
            dots, unfit = without_excluded(read_dots(settings), edits.of_dots)
            found = track(dots, formats.read_calibration(settings.calibration), frames=frames)
            found.report["warnings"] += unfit
            table_file.write(found.assignments, stages.folder / ASSIGNMENTS)
            return found, found.report

        return (*_swap(stages.points("track", key, run), key),)
    points = formats.read_points(file)
    points = points if not settings.rate_hz else replace(points, rate_hz=settings.rate_hz)
    points = points if frames is None else points.select(*frames)
    return points, key_of(file, options), {}


def read_dots(settings: TakeSettings) -> Observations:
    """The centroids of a take, with the rate that its settings state."""
    dots = formats.read_observations(settings.file)
    return dots if not settings.rate_hz else replace(dots, rate_hz=settings.rate_hz)


def _swap(made: tuple[Points, dict[str, Any]], key: str) -> tuple[Points, str, dict[str, Any]]:
    return made[0], key, made[1]


def holds_dots(file: Path) -> bool:
    """Whether a file holds centroids of cameras."""
    kind = formats.ending(file)
    if kind == ".x2d":
        return True
    if kind not in formats.TABLE_ENDINGS:
        return False
    try:
        formats.read_observations(file)
    except MarkerloomError:
        return False
    return True


def _stages(
    settings: TakeSettings,
) -> list[tuple[str, list[Any], Callable[[Points], tuple[Points, dict[str, Any]]]]]:
    """Stages after tracking: name, what decides about its result, and how it runs."""
    found: list[tuple[str, list[Any], Callable[[Points], tuple[Points, dict[str, Any]]]]] = []
    if settings.subjects or settings.marker_set:

        def name(points: Points) -> tuple[Points, dict[str, Any]]:
            known = [read_subject(s) for s in settings.subjects]
            worn = None if known else read_marker_set(settings.marker_set)
            made = label(points, subjects=known or None, marker_set=worn, units=settings.units or None)
            return made, made.report

        worn = settings.marker_set if settings.marker_set and not settings.subjects else ""
        worn_key = key_of(Path(worn)) if worn and Path(worn).is_file() else worn
        found.append(("label", [[key_of(Path(s)) for s in settings.subjects], worn_key, settings.units], name))

    def mend(points: Points) -> tuple[Points, dict[str, Any]]:
        made = fill(points, method=settings.fill, longest_s=settings.longest_s)
        return made, made.report

    def even(points: Points) -> tuple[Points, dict[str, Any]]:
        made = smooth(points, method=settings.smooth, cutoff_hz=settings.cutoff_hz)
        return made, made.report

    if settings.fill != "none":
        found.append(("fill", [settings.fill, settings.longest_s], mend))
    if settings.smooth != "none":
        found.append(("smooth", [settings.smooth, settings.cutoff_hz], even))
    return found


def _frames(text: str) -> tuple[int | None, int | None] | None:
    if not text:
        return None
    first, colon, last = text.partition(":")
    try:
        if not colon:
            raise ValueError
        return (int(first) if first else None, int(last) if last else None)
    except ValueError:
        raise InputError(f"frames = '{text}' is not A:B, such as 0:400 or 100:") from None


def _snapshot(folder: Path, settings: TakeSettings, edits: EditList) -> None:
    """What the result was made with: settings, edits, and copies of calibration and subjects."""
    kept = folder / "made-with"
    kept.mkdir(exist_ok=True)
    plain = {
        k: Path(v).name if k in ("file", "calibration", "hints", "fit_from") else v for k, v in asdict(settings).items()
    }
    plain["subjects"] = [Path(s).name for s in settings.subjects]
    plain["export"], plain["solve_to"] = list(settings.export), list(settings.solve_to)
    plain["skeleton"] = Path(settings.skeleton).name if Path(settings.skeleton).is_file() else settings.skeleton
    write_text(kept / "settings.toml", tomlkit.dumps(plain))
    own = settings.skeleton if Path(settings.skeleton).is_file() else ""
    for source in (settings.calibration, own, settings.hints, *settings.subjects):
        if source:
            shutil.copyfile(source, kept / Path(source).name)
    if edits:
        write_edits(edits, kept / f"{Path(settings.file).name}{ENDING}")
