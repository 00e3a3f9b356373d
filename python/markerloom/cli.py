"""The command line: verbs, progress bars, exit codes. 0 done, 1 failed, 2 wrong usage."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import Progress as Bar
from rich.table import Table

from markerloom import formats
from markerloom import report as reports
from markerloom.active import leds as run_leds
from markerloom.bench import HEADER as BENCH_HEADER
from markerloom.bench import choose, measure
from markerloom.bench import line as bench_line
from markerloom.calibrate.cli import app as calibrate_app
from markerloom.convert import convert as run_convert
from markerloom.coverage import Box, save_coverage
from markerloom.coverage import coverage as run_coverage
from markerloom.demo import HEADER as DEMO_HEADER
from markerloom.demo import demo as run_demo
from markerloom.demo import summary
from markerloom.detect.cli import detect
from markerloom.detect.render import save_videos
from markerloom.errors import InputError, MarkerloomError
from markerloom.evaluate import Truth, truth_from_assignments, truth_from_observations, truth_without_views
from markerloom.evaluate import evaluate as run_evaluate
from markerloom.explain import TrackedTake
from markerloom.filling.cli import fill, smooth
from markerloom.formats import table_file
from markerloom.from_pixels import rows as whole_way_rows
from markerloom.inspect import inspect as run_inspect
from markerloom.known_before import read_start_pose
from markerloom.labelling.cli import frame_range, label, subject_app
from markerloom.mending.cli import mend
from markerloom.motion.cli import edit_app
from markerloom.observations import Observations
from markerloom.project.cli import process
from markerloom.reconstruct import Progress
from markerloom.reconstruct import reconstruct as run_reconstruct
from markerloom.rig import Rig
from markerloom.rigid_cli import rigid_app
from markerloom.simulate import PRESETS, make_rig, make_scene, save
from markerloom.simulate import simulate as run_simulate
from markerloom.skeleton.cli import solve
from markerloom.skeleton.files import PRESETS as STYLES
from markerloom.studio.cli import view
from markerloom.sync.cli import sync
from markerloom.track import track as run_track
from markerloom.track_page import save_track_page

app = typer.Typer(no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
app.add_typer(calibrate_app, name="calibrate")
app.command()(detect)
app.add_typer(subject_app, name="subject")
app.add_typer(rigid_app, name="rigid")
app.add_typer(edit_app, name="edit")
for verb in (sync, label, fill, smooth, mend, solve, process, view):
    app.command()(verb)
out = Console(highlight=False)
err = Console(stderr=True, highlight=False)

Quiet = Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")]
ReportFile = Annotated[Path | None, typer.Option("--report", help="Write a report as JSON.", metavar="FILE.json")]
Frames = Annotated[str | None, typer.Option("--frames", help="Only frames A to before B.", metavar="A:B")]
Calibration = Annotated[Path, typer.Option("--calibration", help=".xcp, Calib.toml, .qca.txt or .mcal")]
Units = Annotated[str, typer.Option("--calibration-units", help="Unit of lengths in a Calib.toml: m, cm or mm.")]


def main() -> None:
    """Run the command line; errors become one line and an exit code."""
    try:
        app()
    except MarkerloomError as error:
        err.print(f"markerloom: {error}", markup=False, soft_wrap=True)
        sys.exit(1)
    except KeyboardInterrupt:
        err.print("markerloom: stopped")
        sys.exit(130)


@contextmanager
def progress_bar(title: str, quiet: bool) -> Iterator[Progress | None]:
    """A bar on a terminal; nothing elsewhere."""
    if quiet or not err.is_terminal:
        yield None
        return
    with Bar(console=err, transient=True) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def say(quiet: bool, text: str) -> None:
    """A line for the user."""
    if not quiet:
        out.print(text, markup=False, soft_wrap=True)


def warn(quiet: bool, warnings: list[str]) -> None:
    """Warnings, one a line, on standard error."""
    for text in [] if quiet else warnings:
        err.print(f"warning: {text}", markup=False, soft_wrap=True)


def finish(report: Path | None, inputs: list[Path], options: dict[str, Any], result: dict[str, Any]) -> None:
    """Write the report where one is wanted."""
    if report is not None:
        reports.save(reports.of_run(list(inputs), options, result), report)


@app.command()
def demo(
    folder: Annotated[Path, typer.Option("-o", "--output", help="Where everything goes.")] = Path("out/demo"),
    frames: Annotated[int, typer.Option(help="Frames to simulate.", min=1)] = 200,
    seed: Annotated[int, typer.Option(help="Seed of the simulation.", min=0)] = 0,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Simulate a capture, reconstruct it with three methods, go on from images to a skeleton, and write a page of it.

    Example: markerloom demo -o out/demo
    """
    with progress_bar("demo", quiet) as progress:
        made = run_demo(folder, frames=frames, seed=seed, progress=progress)
    table = Table(*DEMO_HEADER, "time / frame")
    for row, answer in zip(summary(made.scores), made.answers.values(), strict=True):
        table.add_row(*row, f"{answer.report['timing']['ms_per_frame']['mean']:.2f} ms")
    if not quiet:
        out.print(table)
        say(quiet, "The whole way, from filmed images:")
    for name, text in whole_way_rows(made.whole_way):
        say(quiet, f"  {name}: {text}")
    say(quiet, "To a skeleton:")
    for name, text in made.figure.rows():
        say(quiet, f"  {name}: {text}")
    for name, path in made.files.items():
        say(quiet, f"{name:8} {path}")
    say(quiet, f"Open {made.files['page']} in a browser; look at the takes and mend them: markerloom view {folder}")
    finish(report, [], {"frames": frames, "seed": seed}, {"frames": frames, "methods": made.scores})


@app.command()
def simulate(
    scene: Annotated[str, typer.Argument(help=f"One of {', '.join(PRESETS)}; or coverage.")],
    rig: Annotated[
        Path | None, typer.Argument(help="Of coverage: a calibration; without one, --cameras and so on.")
    ] = None,
    folder: Annotated[Path, typer.Option("-o", "--output", help="Folder for what is written.")] = ...,  # pyright: ignore[reportArgumentType]
    seed: Annotated[int | None, typer.Option(min=0)] = None,
    frames: Annotated[int | None, typer.Option()] = None,
    markers: Annotated[int | None, typer.Option()] = None,
    cameras: Annotated[int | None, typer.Option()] = None,
    sigma_px: Annotated[float | None, typer.Option(help="Noise of the dots (px per axis).")] = None,
    hide: Annotated[str | None, typer.Option(help="Views withheld: none, one, quarter or a probability.")] = None,
    shape: Annotated[str | None, typer.Option(help="Rig: ring, arc or wall.")] = None,
    elevation_deg: Annotated[float | None, typer.Option()] = None,
    angle_deg: Annotated[float | None, typer.Option(help="Ring: first azimuth; arc: span; wall: spacing.")] = None,
    distance_m: Annotated[float | None, typer.Option()] = None,
    focal_px: Annotated[float | None, typer.Option()] = None,
    image_width: Annotated[int | None, typer.Option()] = None,
    image_height: Annotated[int | None, typer.Option()] = None,
    rate_hz: Annotated[float | None, typer.Option()] = None,
    merge_px: Annotated[float | None, typer.Option(help="Dots nearer than this become one.")] = None,
    clutter_per_frame: Annotated[float | None, typer.Option(help="False dots per camera and frame.")] = None,
    reflections: Annotated[int | None, typer.Option(help="Fixed reflections per camera.")] = None,
    wand: Annotated[str | None, typer.Option(help="Of scene 'wand': a name, or a .toml file.")] = None,
    offset_frames: Annotated[
        float | None, typer.Option(help="Every second camera has a clock of its own, so much later.")
    ] = None,
    drift_ppm: Annotated[float | None, typer.Option(help="How much slower that clock runs.")] = None,
    leds: Annotated[bool | None, typer.Option("--leds", help="Markers are LEDs that blink their identity.")] = None,
    bit_errors: Annotated[float | None, typer.Option(help="Share of the LEDs' bits that are read wrongly.")] = None,
    marker_set: Annotated[str | None, typer.Option(help="Of figures: the marker set they wear.")] = None,
    t_pose_s: Annotated[float | None, typer.Option("--t-pose-s", help="They stand in a T-pose first, so long.")] = None,
    video: Annotated[bool, typer.Option("--video", help="Film the take too: CAMERA.mkv for each camera.")] = False,
    marker_mm: Annotated[float, typer.Option(help="Of coverage and video: diameter of a marker.")] = 14.0,
    volume: Annotated[
        str | None, typer.Option(help="Of coverage: the volume in metres.", metavar="X:X,Y:Y,Z:Z")
    ] = None,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Simulate a take with its truth; or predict with ``coverage`` how well a rig will measure, and where.

    Example: markerloom simulate exp61 -o out/exp61 --hide one --seed 3 --frames 200
    · markerloom simulate coverage rig.toml -o out/coverage
    """
    elsewhere = ("scene", "rig", "folder", "video", "marker_mm", "volume", "report", "quiet")
    given = {k: v for k, v in locals().items() if k not in (*elsewhere, "elsewhere")}
    if scene == "coverage":
        planned = make_rig(make_scene("walk", **given)) if rig is None else formats.read_calibration(rig)
        noise_px, box = 0.1 if sigma_px is None else sigma_px, None if volume is None else _volume(volume)
        found = run_coverage(planned, sigma_px=noise_px, marker_mm=marker_mm, volume_m=box)
        save_coverage(found, folder)
        warn(quiet, found.report["warnings"])
        say(quiet, _of_coverage(found.report, folder))
        finish(report, [] if rig is None else [rig], {"scene": scene, **given}, found.report)
        return
    if rig is not None:
        raise typer.BadParameter("a rig is for coverage; scenes have their own (--cameras, --shape, …)")
    made = make_scene(scene, **given)
    with progress_bar("simulate", quiet) as progress:
        take = run_simulate(made, progress=progress)
    save(take, folder)
    if video:
        save_videos(take, folder, marker_mm=marker_mm)
    say(
        quiet,
        f"{made.frames} frames, {len(take.observations)} observations of {len(take.rig)} cameras in {folder}",
    )
    finish(report, [], {"scene": scene, **given}, {"frames": made.frames})


def _of_coverage(result: dict[str, Any], folder: Path) -> str:
    three = result["sigma_mm_by_three"]
    return (
        f"{result['share_by_cameras'].get('3', 0.0):.0%} of the volume in view of 3 cameras or more, expected error "
        f"there {three['median']:.3f} mm (95 % below {three['p95']:.3f}) → {folder / 'coverage.html'}"
    )


def _volume(text: str) -> Box:
    try:
        x, y, z = (tuple(float(v) for v in side.split(":")) for side in text.split(","))
        (x0, x1), (y0, y1), (z0, z1) = x, y, z
    except ValueError:
        raise typer.BadParameter(f"'{text}' is not X:X,Y:Y,Z:Z", param_hint="--volume") from None
    return (x0, x1), (y0, y1), (z0, z1)


@app.command()
def reconstruct(
    observations: Annotated[Path, typer.Argument(help=".x2d, .parquet, .csv, .csv.gz or a Tracker dump")],
    calibration: Calibration,
    output: Annotated[Path, typer.Option("-o", "--output", help=".c3d, .trc, .parquet or .csv")],
    method: Annotated[str, typer.Option(help="optimal, relaxation or epipolar")] = "optimal",
    frames: Frames = None,
    assignments: Annotated[Path | None, typer.Option(help="Write which dots made which point.")] = None,
    rate_hz: Annotated[float | None, typer.Option("--rate-hz", help="Frame rate, where the input has none.")] = None,
    noise_px: Annotated[float | None, typer.Option(help="Noise of the dots, where it is known.")] = None,
    threads: Annotated[int, typer.Option(help="0 = all cores; the result is the same.", min=0)] = 0,
    calibration_units: Units = "m",
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Join the dots of each frame into 3D points: ghost-free, with uncertainty, without knowledge of time.

    Example: markerloom reconstruct take.x2d --calibration take.xcp -o points.c3d --rate-hz 100
    """
    options = {k: v for k, v in locals().items() if k not in ("quiet", "report")}
    wanted = frame_range(frames)
    take, rig = _take_and_rig(observations, calibration, calibration_units, rate_hz, output)
    with progress_bar("reconstruct", quiet) as progress:
        points = run_reconstruct(
            take, rig, method=method, frames=wanted, threads=threads, noise_px=noise_px, progress=progress
        )
    formats.write_points(points, output)
    if assignments is not None:
        table_file.write(points.assignments, assignments)
    warn(quiet, points.report["warnings"])
    result = points.report
    say(
        quiet,
        f"{result['frames']} frames, {result['points_per_frame']:.2f} points per frame, "
        f"{result['rays_mean']:.2f} rays per point, residual {result['residual_px']['median']:.3f} px, "
        f"{100 * result['certified_frames']:.1f} % of frames certified → {output}",
    )
    finish(report, [observations, calibration], options, result)


@app.command()
def track(
    take: Annotated[Path, typer.Argument(help="Dots: .x2d, .parquet, .csv or a dump. Points: .c3d, .trc, .csv, …")],
    calibration: Annotated[
        Path | None, typer.Option("--calibration", help="The cameras, where the take holds dots.")
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", help=".c3d, .trc, .parquet or .csv")] = ...,  # pyright: ignore[reportArgumentType]
    method: Annotated[str, typer.Option(help="default, or paper: Lee et al. 2000 as written")] = "default",
    causal: Annotated[bool, typer.Option("--causal", help="Only what a live user would have seen.")] = False,
    frames: Frames = None,
    assignments: Annotated[Path | None, typer.Option(help="Write which dots made which point.")] = None,
    rate_hz: Annotated[float | None, typer.Option("--rate-hz", help="Frame rate, where the input has none.")] = None,
    noise_px: Annotated[float | None, typer.Option(help="Noise of the dots, where it is known.")] = None,
    calibration_units: Units = "m",
    refine_calibration: Annotated[
        bool, typer.Option("--refine-calibration", help="Adjust the cameras to the take; solve knocked ones anew.")
    ] = False,
    calibration_out: Annotated[
        Path | None, typer.Option("--calibration-out", help="Write the refined cameras, as they stand at the end.")
    ] = None,
    start_pose: Annotated[
        Path | None, typer.Option("--start-pose", help="The same markers before: named points, or SUBJECT.toml.")
    ] = None,
    page: Annotated[
        Path | None, typer.Option("--page", help="Write a page with pictures.", metavar="FILE.html")
    ] = None,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Follow every marker through time: one trajectory per marker, through occlusions and sharp turns.

    Without a calibration, the take holds points of any system, anonymous or broken.

    Example: markerloom track take.x2d --calibration take.xcp -o trajectories.c3d --rate-hz 100
    · markerloom track broken.c3d -o trajectories.c3d
    """
    options = {k: v for k, v in locals().items() if k not in ("quiet", "report")}
    wanted = frame_range(frames)
    if calibration_out is not None:
        if not refine_calibration:
            raise typer.BadParameter("--calibration-out belongs to --refine-calibration")
        formats.check_calibration_output(calibration_out)
    if calibration is None:
        refine = refine_calibration or None
        _refuse_for_points({"--assignments": assignments, "--noise-px": noise_px, "--refine-calibration": refine})
        _check_points_ending(output)
        source, rig = formats.read_points(take), None
        source = source if rate_hz is None else _with_rate(source, rate_hz)
    else:
        source, rig = _take_and_rig(take, calibration, calibration_units, rate_hz, output)
    with progress_bar("track", quiet) as progress:
        points = run_track(
            source,
            rig,
            method=method,
            causal=causal,
            frames=wanted,
            noise_px=noise_px,
            refine_calibration=refine_calibration,
            start_pose=None if start_pose is None else read_start_pose(start_pose),
            progress=progress,
        )
    formats.write_points(points, output)
    if calibration_out is not None and isinstance(points, TrackedTake) and points.seen is not None:
        formats.write_calibration(points.seen.cameras.rig_at(int(points.seen.dots.frames[-1])), calibration_out)
    if assignments is not None:
        table_file.write(points.assignments, assignments)
    if page is not None:
        save_track_page(points, page)
    warn(quiet, points.report["warnings"])
    say(quiet, f"{_in_a_line(points.report)} → {output}")
    finish(report, [p for p in (take, calibration, start_pose) if p is not None], options, points.report)


def _in_a_line(tracked: dict[str, Any]) -> str:
    """What tracking gave: of dots their residual, of points their noise."""
    residual = tracked.get("residual_px")
    off = f"residual {residual['median']:.3f} px" if residual else f"noise {tracked['noise_mm']:.2f} mm"
    return (
        f"{tracked['frames']} frames, {tracked['trajectories']} trajectories, {tracked['points_per_frame']:.2f} "
        f"measured and {tracked['predicted_per_frame']:.2f} predicted points per frame, {off}"
    )


def _refuse_for_points(dots_only: dict[str, object]) -> None:
    """Refuse options that were given although they are for dots."""
    for option in (o for o, value in dots_only.items() if value is not None):
        raise typer.BadParameter(f"{option} is for dots, which need --calibration")


def _check_points_ending(output: Path) -> str:
    ending = formats.ending(output)
    if ending not in formats.POINTS_WRITTEN:
        raise typer.BadParameter(f"{output}: points are written as {', '.join(formats.POINTS_WRITTEN)}")
    return ending


def _take_and_rig(
    observations: Path, calibration: Path, units: str, rate_hz: float | None, output: Path
) -> tuple[Observations, Rig]:
    """Read the inputs of a verb that writes points; refuses at once what could not be written."""
    ending = _check_points_ending(output)
    take = formats.read_observations(observations)
    rig = formats.read_calibration(calibration, units=units)
    if rate_hz is not None:
        take = _with_rate(take, rate_hz)
    if ending in (".c3d", ".trc") and take.rate_hz is None:
        raise InputError(f"a {ending} file needs the frame rate: state it with --rate-hz ({observations})")
    return take, rig


def _with_rate(take: Any, rate_hz: float) -> Any:
    from dataclasses import replace

    if not 0 < rate_hz < 1e6:
        raise typer.BadParameter(f"{rate_hz} Hz is no frame rate", param_hint="--rate-hz")
    return replace(take, rate_hz=rate_hz)


@app.command()
def leds(
    observations: Annotated[Path, typer.Argument(help="Dots with their brightness: .parquet, .csv or .csv.gz")],
    output: Annotated[Path, typer.Option("-o", "--output", help="The same with identities: .parquet, .csv or .csv.gz")],
    frames_per_bit: Annotated[int, typer.Option(help="Frames that a bit of an LED's code lasts.", min=1)] = 1,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Decode who active markers are from their blinking: writes the column id, which track trusts.

    Example: markerloom leds dots.parquet -o told.parquet
    """
    if formats.ending(output) not in formats.TABLE_ENDINGS:
        raise typer.BadParameter(f"{output}: observations are written as {', '.join(formats.TABLE_ENDINGS)}")
    told, result = run_leds(formats.read_observations(observations), frames_per_bit=frames_per_bit)
    formats.write_observations(told, output)
    warn(quiet, result["warnings"])
    dots = sum(own["told"] for own in result["cameras"].values())
    say(quiet, f"{dots} of {len(told)} dots tell who they are: {len(result['identities'])} identities → {output}")
    finish(report, [observations], {"frames_per_bit": frames_per_bit}, result)


@app.command()
def evaluate(
    points: Annotated[Path, typer.Argument(help="Points to judge: .c3d, .trc, .parquet or .csv")],
    truth: Annotated[Path, typer.Option("--truth", help="Points with labels: .parquet, .csv(.gz) or .c3d")],
    tolerance_mm: Annotated[float, typer.Option(help="Largest distance of a hit.")] = 30.0,
    frames: Frames = None,
    align: Annotated[str | None, typer.Option(help="'rigid' removes a rigid difference of the worlds.")] = None,
    assignments: Annotated[Path | None, typer.Option(help="Which dots made which point.")] = None,
    truth_assignments: Annotated[Path | None, typer.Option(help="Whose each dot is.")] = None,
    observations: Annotated[Path | None, typer.Option(help="For real data: the dots.")] = None,
    calibration: Annotated[Path | None, typer.Option(help="For real data: the rig.")] = None,
    calibration_units: Units = "m",
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Compare points with truth: found, missing, ghosts, error, honesty of the uncertainty.

    Example: markerloom evaluate points.parquet --truth truth.parquet --truth-assignments truth_assignments.parquet
    """
    options = {k: v for k, v in locals().items() if k not in ("quiet", "report")}
    if observations is not None and (calibration is None or truth_assignments is not None):
        raise typer.BadParameter("--observations goes with --calibration and without --truth-assignments")
    judged = formats.read_points(points)
    reference = _truth(truth, truth_assignments, observations, calibration, calibration_units)
    result = run_evaluate(
        judged,
        reference,
        tolerance_mm=tolerance_mm,
        frames=frame_range(frames),
        align=align,
        assignments=None if assignments is None else table_file.read(assignments),
    )
    say(quiet, _scores(result))
    inputs = [p for p in (points, truth, assignments, truth_assignments, observations, calibration) if p is not None]
    finish(report, inputs, options, result)


def _truth(
    truth: Path, assignments: Path | None, observations: Path | None, calibration: Path | None, units: str
) -> Truth:
    samples = formats.read_points(truth)
    if assignments is not None:
        beside = assignments.parent / "calibration.toml"
        place = calibration or (beside if beside.is_file() else None)
        rig = None if place is None else formats.read_calibration(place, units=units)
        return truth_from_assignments(samples, table_file.read(assignments), rig)
    if observations is not None and calibration is not None:
        rig = formats.read_calibration(calibration, units=units)
        return truth_from_observations(samples, formats.read_observations(observations), rig)
    return truth_without_views(samples)


def _scores(result: dict[str, Any]) -> str:
    lines = [f"frames            {result['frames']} ({result['required_samples']} required samples)"]
    lines.append(f"found (3D)        {100 * result['accuracy_3d']:.3f} % within {result['tolerance_mm']:g} mm")
    if "accuracy_set" in result:
        lines.append(f"exact sets        {100 * result['accuracy_set']:.3f} %")
    lines.append(f"ghosts / frame    {result['ghosts_per_frame']:.4f}")
    lines.append(f"missing / frame   {result['missing_per_frame']:.4f}")
    error = result["error_mm"]
    lines.append(f"error             median {error['median']:.3f}, rms {error['rms']:.3f}, 95 % {error['p95']:.3f} mm")
    lines.append(f"(error/sigma)²    {result['sigma_ratio']:.3f} on average")
    if "trajectories" in result:
        happened, touching = result["id_switches"], result["id_switches_in_contact"]
        of_those = f", {touching} of them in a contact" if happened else ""
        lines.append(f"trajectories      {result['trajectories']}, {happened} identity switches{of_those}")
        lines.append(f"MOTA, IDF1        {result['mota']:.4f}, {result['idf1']:.4f}")
        lines.append(f"coverage          {100 * result['coverage']:.2f} % of all samples, measured or predicted")
    return "\n".join(lines)


@app.command()
def inspect(
    file: Annotated[Path, typer.Argument(help="Any file that markerloom reads.")],
    calibration_units: Units = "m",
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Say what is in a file.

    Example: markerloom inspect take.c3d
    """
    found = run_inspect(file, calibration_units=calibration_units)
    for key, value in found.items():
        if isinstance(value, list) and value and isinstance(value[0], dict):
            say(quiet, f"{key}:")
            for row in value:
                say(quiet, "  " + ", ".join(f"{k} {v}" for k, v in row.items()))
        else:
            say(quiet, f"{key}: {value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)}")
    finish(report, [file], {}, found)


@app.command()
def convert(
    source: Annotated[Path, typer.Argument(help="File to read.")],
    target: Annotated[Path, typer.Argument(help="File to write.")],
    rate_hz: Annotated[float | None, typer.Option("--rate-hz", help="State or replace the frame rate.")] = None,
    up: Annotated[str | None, typer.Option(help="Up axis of the target: y or z.")] = None,
    units: Annotated[str | None, typer.Option(help="Of a motion's lengths: mm, cm, m, in, or metres per unit.")] = None,
    preset: Annotated[str | None, typer.Option(help=f"Of motions: {', '.join(STYLES)}")] = None,
    order: Annotated[str | None, typer.Option(help="Of a BVH's angles, such as ZXY.")] = None,
    rest: Annotated[str | None, typer.Option(help="Rest pose of a motion: t-pose, a-pose or i-pose.")] = None,
    source_units: Annotated[str | None, typer.Option("--source-units", help="Of a motion that is read.")] = None,
    source_up: Annotated[str, typer.Option("--source-up", help="Up axis of a motion that is read.")] = "y",
    calibration_units: Units = "m",
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Convert points, motions, observations or a calibration. C3D to C3D keeps everything.

    Example: markerloom convert take.c3d take.trc
    """
    options = {"rate_hz": rate_hz, "up": up, "units": units, "preset": preset, "order": order, "rest": rest}
    options |= {"source_units": source_units, "source_up": source_up}
    run_convert(source, target, **options, calibration_units=calibration_units)  # pyright: ignore[reportArgumentType]
    say(quiet, f"{source} → {target}")
    finish(report, [source], {"target": str(target), **options}, {})


@app.command()
def bench(
    scenes: Annotated[list[str] | None, typer.Argument(help="Rows to run; all without any.")] = None,
    seeds: Annotated[int, typer.Option(help="Takes per row: seeds 0 to N − 1.", min=1)] = 20,
    frames: Annotated[int, typer.Option(help="Frames per take.", min=1)] = 200,
    report: ReportFile = None,
    quiet: Quiet = False,
) -> None:
    """Measure the accuracy figures of docs/results.md.

    Example: markerloom bench one quarter --seeds 20 --frames 200
    """
    rows = choose(scenes or [])
    printed: list[dict[str, Any]] = []
    say(quiet, BENCH_HEADER)
    for row in rows:
        with progress_bar(row.name, quiet) as progress:
            result = measure(row, seeds=seeds, frames=frames, progress=progress)
        printed.append(result)
        say(quiet, bench_line(result))
    finish(
        report,
        [],
        {"scenes": scenes, "seeds": seeds, "frames": frames},
        {"rows": printed, "frames": seeds * frames},
    )


if __name__ == "__main__":
    main()
