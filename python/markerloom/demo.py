"""The README's first command: a simulated capture through the whole chain, with pictures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.distance import cdist

from markerloom import html_report, pictures, report
from markerloom.evaluate import Truth, evaluate, truth_from_assignments
from markerloom.formats import write_points
from markerloom.from_pixels import FromPixels, from_pixels, rows
from markerloom.reconstruct import METHODS, Progress, Reconstruction, reconstruct
from markerloom.simulate import SimulatedTake, make_scene, save, simulate
from markerloom.to_skeleton import ToSkeleton, to_skeleton

TOLERANCE_MM = 20.0
LEAST_WALKED = 300
"""The T-pose and some steps (frames)."""
MOST_FILMED = 50
"""Frames of the walk that are filmed at most."""
NAMES = {"optimal": "optimal", "relaxation": "relaxation (2000)", "epipolar": "epipolar matches"}


@dataclass(frozen=True)
class Demo:
    """What the demo made: the take, the three answers, their evaluations, and the files."""

    take: SimulatedTake
    answers: dict[str, Reconstruction]
    scores: dict[str, dict[str, Any]]
    files: dict[str, Path]
    whole_way: FromPixels
    figure: ToSkeleton


def demo(folder: str | Path, *, frames: int = 200, seed: int = 0, progress: Progress | None = None) -> Demo:
    """Simulate a dancer, reconstruct with all three methods, evaluate; then go the whole way from filmed images, and from
    a T-pose to a skeleton that walks.

    Everything is written into a folder.
    """
    folder = Path(folder)
    take = simulate(make_scene("dance", frames=frames, seed=seed), progress=progress)
    save(take, folder)
    truth = truth_from_assignments(take.truth, take.truth_assignments, take.rig)
    answers, scores = {}, {}
    for method in METHODS:
        answer = reconstruct(take.observations, take.rig, method=method, progress=progress)
        answers[method] = answer
        scores[method] = evaluate(answer, truth, tolerance_mm=TOLERANCE_MM, assignments=answer.assignments)
    files = {
        "points": folder / "points.c3d",
        "table": folder / "points.parquet",
        "report": folder / "report.json",
        "page": folder / "report.html",
    }
    best = answers["optimal"]
    write_points(best, files["points"])
    write_points(best, files["table"])
    inputs: list[str | Path] = [folder / "observations.parquet", folder / "calibration.toml"]
    report.save(report.of_run(inputs, {"method": "optimal"}, best.report), files["report"])
    filmed = min(max(frames // 4, 10), MOST_FILMED)
    whole_way = from_pixels(folder / "from_pixels", frames=filmed, seed=seed, progress=progress)
    files["trajectories"] = folder / "from_pixels" / "trajectories.c3d"
    figure = to_skeleton(folder, frames=max(frames, LEAST_WALKED), seed=seed)
    files["motion"] = figure.files["motion"]
    write_page(files["page"], take, truth, answers, scores, whole_way, figure)
    return Demo(take, answers, scores, files, whole_way, figure)


def summary(scores: dict[str, dict[str, Any]]) -> list[list[str]]:
    """One row per method: the figures people ask for first."""
    rows = []
    for method, score in scores.items():
        rows.append(
            [
                NAMES[method],
                f"{100 * score['accuracy_3d']:.2f} %",
                f"{score['ghosts_per_frame']:.3f}",
                f"{score['missing_per_frame']:.3f}",
                f"{score['error_mm']['median']:.2f} mm",
            ]
        )
    return rows


HEADER = ["method", "found", "ghosts / frame", "missing / frame", "median error"]


def write_page(
    path: Path,
    take: SimulatedTake,
    truth: Truth,
    answers: dict[str, Reconstruction],
    scores: dict[str, dict[str, Any]],
    whole_way: FromPixels,
    figure: ToSkeleton,
) -> None:
    """Write the page with pictures."""
    best = answers["optimal"]
    frame = int(best.frames[len(best.frames) // 2])
    now = best.xyz_mm[best.frame == frame] / 1000.0
    scene = take.scene
    html_report.write(
        path,
        "markerloom demo",
        html_report.note(
            f"A simulated dancer with {scene.markers} markers before {scene.cameras} cameras: noise {scene.sigma_px} px, "
            f"dots hidden by the body, merged dots, clutter and fixed reflections; {scene.frames} frames, seed {scene.seed}. "
            "The program sees only the dots and the calibration."
        ),
        html_report.section("Result", html_report.table(HEADER, summary(scores))),
        html_report.section("The whole way, from pixels", *_whole_way(whole_way)),
        html_report.section("To a skeleton", html_report.table(["", ""], figure.rows()), figure.picture()),
        html_report.section(
            "Rig and points",
            html_report.figure(
                pictures.rig_and_points(take.rig, now, best.xyz_mm[::7] / 1000.0, f"frame {frame}"),
                "Cameras with their view, the points of one frame, and the points of all frames as a cloud.",
            ),
        ),
        html_report.section(
            "Three methods on one frame",
            html_report.figure(
                three_methods(take, truth, answers, frame),
                "Rings: true markers. Black: points that are one. Red: ghosts. (Lee et al. 2000 show the same in figure 11.)",
            ),
        ),
        html_report.section("Ghosts and missing markers over time", html_report.figure(*_time(scores))),
        html_report.section(
            "Residual by camera",
            html_report.figure(
                pictures.bars(best.report["residual_px_by_camera"], "px", "rms distance of dot and reprojection"),
                f"The noise that was simulated is {scene.sigma_px} px per axis; merged and half-hidden dots come on top.",
            ),
        ),
    )


def _whole_way(made: FromPixels) -> list[str]:
    """Wave and walk were filmed, and nothing of the cameras was known."""
    frame = int(made.take.frames[len(made.take.frames) // 2])
    now = made.take.xyz_mm[made.take.frame == frame] / 1000.0
    return [
        html_report.table(["", ""], rows(made)),
        html_report.figure(
            pictures.rig_and_points(made.wave.rig, now, made.take.xyz_mm[::3] / 1000.0, f"frame {frame}"),
            "A wand wave and a walk were rendered as images with blur, noise and merging. Their markers were found, the "
            "cameras calibrated from the wave alone, and the walk tracked with them.",
        ),
    ]


def three_methods(take: SimulatedTake, truth: Truth, answers: dict[str, Reconstruction], frame: int) -> str:
    """The methods side by side, from the naive to the best."""
    true_m = truth.points.xyz_mm[truth.points.frame == frame] / 1000.0
    panels = []
    for method in reversed(METHODS):
        points_m = answers[method].xyz_mm[answers[method].frame == frame] / 1000.0
        panels.append((NAMES[method], points_m, ghosts(points_m, true_m)))
    return pictures.points_and_truth(panels, true_m, f"Three methods on frame {frame} of the {take.scene.scene}")


def ghosts(points_m: np.ndarray, true_m: np.ndarray) -> np.ndarray:
    """Points that are not the nearest one to a true marker within the tolerance."""
    distance = cdist(points_m, true_m).reshape(len(points_m), len(true_m))
    real = np.zeros(len(points_m), bool)
    for j in range(len(true_m)):
        if len(points_m) and distance[:, j].min() <= TOLERANCE_MM / 1000.0:
            real[distance[:, j].argmin()] = True
    return ~real


def _time(scores: dict[str, dict[str, Any]]) -> tuple[str, str]:
    colors = {"ghosts": pictures.RED, "missing": pictures.AMBER}
    series = {}
    for method in ("optimal", "relaxation"):
        for what, color in colors.items():
            series[f"{method}: {what}"] = ([f[what] for f in scores[method]["per_frame"]], color)
    frames = [f["frame"] for f in scores["optimal"]["per_frame"]]
    caption = (
        "A ghost is a point where no marker is; a missing marker is one that two cameras saw and no point stands for."
    )
    return pictures.over_time(frames, series, "per frame"), caption
