"""The whole way: filmed wave and walk, dots, a rig from nothing, trajectories, compared with the truth."""

from pathlib import Path

import numpy as np
import pytest

import markerloom as ml
from markerloom.from_pixels import CAMERAS, MARKER_MM, from_pixels


@pytest.mark.slow
def test_from_pixels_to_trajectories_without_knowing_the_cameras(tmp_path: Path) -> None:
    made = from_pixels(tmp_path, seed=0)
    assert made.calibration.report["reprojection_px"] < 0.08
    score = made.score
    assert score["ghosts_per_frame"] <= 0.02
    assert score["missing_per_frame"] <= 0.02
    assert score["error_mm"]["median"] < 0.1
    assert score["id_switches"] == 0
    assert 0.6 < score["sigma_ratio"] < 1.6
    assert ml.read_points(tmp_path / "trajectories.c3d").rate_hz == 100.0


def test_video_gives_the_same_dots_as_the_images_themselves(tmp_path: Path) -> None:
    take = ml.simulate(ml.make_scene("walk", frames=6, markers=12, **CAMERAS))
    from_video, report = ml.detect(ml.save_videos(take, tmp_path, marker_mm=MARKER_MM))
    in_memory = ml.detected(take, marker_mm=MARKER_MM)
    assert report["frames"] == 6
    keys = [np.lexsort((o.pixel[:, 0], o.pixel[:, 1], o.camera, o.frame)) for o in (from_video, in_memory)]
    assert np.allclose(from_video.pixel[keys[0]], in_memory.pixel[keys[1]], atol=1e-9)
