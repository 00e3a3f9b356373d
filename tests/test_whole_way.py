"""The whole way: filmed wave and dance, dots, a rig from nothing, trajectories, compared with the truth."""

from dataclasses import replace
from pathlib import Path

import pytest

import markerloom as ml
from markerloom.calibrate.world import moved, old_world

CAMERA = {
    "cameras": 5,
    "distance_m": 4.5,
    "elevation_deg": 20.0,
    "angle_deg": 0.0,
    "image_width": 640,
    "image_height": 512,
    "focal_px": 640.0,
    "reflections": 0,
}
MARKER_MM = 28.0


@pytest.mark.slow
def test_from_video_to_trajectories_without_knowing_the_cameras(tmp_path: Path) -> None:
    wave = ml.simulate(ml.make_scene("wand", frames=260, rate_hz=20.0, clutter_per_frame=0.0, **CAMERA))
    dance = ml.simulate(ml.make_scene("walk", frames=50, markers=20, **CAMERA))
    dots, report = ml.detect(ml.save_videos(wave, tmp_path / "wave", marker_mm=MARKER_MM))
    assert report["frames"] == 260
    made = ml.calibrate_wand(dots, ml.read_wand("vicon-t"), image_sizes=dict.fromkeys(wave.rig.ids, (640.0, 512.0)))
    assert made.report["verdict"] == "ok", made.report["reasons"]
    assert made.report["reprojection_px"] < 0.08
    filmed, _ = ml.detect(ml.save_videos(dance, tmp_path / "dance", marker_mm=MARKER_MM))
    in_true_world = moved(list(made.rig.cameras), *old_world(list(made.rig.cameras), wave.rig))
    take = ml.track(filmed, replace(made.rig, cameras=tuple(in_true_world)), rate_hz=100.0)
    truth = ml.truth_from_assignments(dance.truth, dance.truth_assignments, dance.rig)
    result = ml.evaluate(take, truth, tolerance_mm=25.0, align="rigid")
    assert result["ghosts_per_frame"] <= 0.02
    assert result["missing_per_frame"] <= 0.02
    assert result["error_mm"]["median"] < 0.1
    assert result["id_switches"] == 0
    assert 0.6 < result["sigma_ratio"] < 1.6
