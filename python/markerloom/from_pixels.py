"""The whole way in one go: filmed wave and walk, dots, a rig from nothing, trajectories; compared with the truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from markerloom.calibrate import Calibration, calibrate_wand, read_wand
from markerloom.calibrate.recordings import write as write_calibration
from markerloom.calibrate.world import moved, old_world
from markerloom.detect.render import detected
from markerloom.errors import InputError
from markerloom.evaluate import evaluate, truth_from_assignments
from markerloom.formats import write_observations, write_points
from markerloom.reconstruct import Progress, Reconstruction
from markerloom.simulate import SimulatedTake, make_scene, simulate
from markerloom.track import track

CAMERAS: dict[str, Any] = {
    "cameras": 5,
    "distance_m": 4.5,
    "elevation_deg": 20.0,
    "angle_deg": 0.0,
    "image_width": 640,
    "image_height": 512,
    "focal_px": 640.0,
    "reflections": 0,
}
WAVE = {"frames": 260, "rate_hz": 20.0, "clutter_per_frame": 0.0}
MARKER_MM = 28.0
TOLERANCE_MM = 25.0


@dataclass(frozen=True)
class FromPixels:
    """What came of the pixels: the rig (in the true world), the trajectories, and how far both are from the truth."""

    wave: SimulatedTake
    walk: SimulatedTake
    calibration: Calibration
    take: Reconstruction
    score: dict[str, Any]


def from_pixels(folder: str | Path, *, frames: int = 50, seed: int = 0, progress: Progress | None = None) -> FromPixels:
    """Film a simulated wand wave and a walk, find the markers, calibrate, track, and compare with the truth.

    Nothing of the cameras is known but the size of their images. Writes ``wave.parquet``, ``walk.parquet`` (dots),
    ``rig.toml`` and ``trajectories.c3d`` into the folder. Raises ``InputError`` where the calibration is refused.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    wave = simulate(make_scene("wand", seed=seed, **WAVE, **CAMERAS))
    walk = simulate(make_scene("walk", seed=seed, frames=frames, markers=20, **CAMERAS))
    total = wave.scene.frames + frames
    wave_dots = detected(wave, marker_mm=MARKER_MM, progress=_part(progress, 0, total))
    walk_dots = detected(walk, marker_mm=MARKER_MM, progress=_part(progress, wave.scene.frames, total))
    write_observations(wave_dots, folder / "wave.parquet")
    write_observations(walk_dots, folder / "walk.parquet")
    size = (float(wave.scene.image_width), float(wave.scene.image_height))
    made = calibrate_wand(wave_dots, read_wand("vicon-t"), image_sizes=dict.fromkeys(wave.rig.ids, size))
    if made.report["verdict"] != "ok":
        raise InputError("the wave does not calibrate the cameras: " + "; ".join(made.report["reasons"]))
    write_calibration(made, [folder / "wave.parquet"], "vicon-t", folder / "rig.toml")
    cameras = list(made.rig.cameras)
    rig = replace(made.rig, cameras=tuple(moved(cameras, *old_world(cameras, wave.rig))))
    take = track(walk_dots, rig)
    write_points(take, folder / "trajectories.c3d")
    truth = truth_from_assignments(walk.truth, walk.truth_assignments, walk.rig)
    score = evaluate(take, truth, tolerance_mm=TOLERANCE_MM, align="rigid")
    apart = [np.linalg.norm(a.position_m - b.position_m) for a, b in zip(rig.cameras, wave.rig.cameras, strict=True)]
    score["camera_error_mm"] = float(1000.0 * np.sqrt(np.mean(np.square(apart))))
    return FromPixels(wave, walk, made, take, score)


def rows(made: FromPixels) -> list[list[str]]:
    """What to say of it: a name and a figure each."""
    report, score = made.calibration.report, made.score
    return [
        ["images", str((made.wave.scene.frames + made.walk.scene.frames) * len(made.wave.rig))],
        [
            "cameras from a wave of the wand",
            f"{report['reprojection_px']:.3f} px, places within {score['camera_error_mm']:.2f} mm (rms)",
        ],
        ["trajectories", f"{score['trajectories']}, {score['fragments_per_marker']:.2f} for each marker that was seen"],
        ["identity switches", str(score["id_switches"])],
        ["ghosts, missing per frame", f"{score['ghosts_per_frame']:.3f}, {score['missing_per_frame']:.3f}"],
        ["error of a marker", f"{score['error_mm']['median']:.3f} mm (median)"],
    ]


def _part(progress: Progress | None, before: int, total: int) -> Callable[[int, int], None] | None:
    return None if progress is None else lambda done, _: progress(before + done, total)
