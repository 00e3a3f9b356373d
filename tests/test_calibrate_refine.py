"""A rig refined from a take's own markers."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import markerloom as ml


@pytest.fixture(scope="module")
def take() -> ml.SimulatedTake:
    scene = ml.make_scene("cloud", cameras=6, frames=60, markers=12, sigma_px=0.2, hide="0.05", seed=1)
    return ml.simulate(scene)


def crept(rig: ml.Rig, turn_rad: float) -> ml.Rig:
    """Every camera turned and moved a little."""
    random = np.random.default_rng(4)
    cameras = [
        replace(
            c,
            rotation=Rotation.from_rotvec(random.normal(0.0, turn_rad, 3)).as_matrix() @ c.rotation,
            position_m=c.position_m + random.normal(0.0, turn_rad, 3),
        )
        for c in rig.cameras
    ]
    return replace(rig, cameras=tuple(cameras))


def test_a_rig_that_crept_is_mended(take: ml.SimulatedTake):
    start = crept(take.rig, 0.001)
    refined, report = ml.refine_rig(start, take.observations)
    assert report["verdict"] == "ok"
    assert report["residual_px_after"]["rms"] < 0.6 * report["residual_px_before"]["rms"]
    assert report["residual_px_after"]["median"] < 0.3

    def apart(rig: ml.Rig) -> np.ndarray:
        places = np.array([c.position_m for c in rig.cameras])
        return np.linalg.norm(places[:, None] - places[None], axis=2)

    scale = apart(refined).sum() / apart(take.rig).sum()
    before = np.abs(apart(start) - apart(take.rig)).max()
    assert np.abs(apart(refined) / scale - apart(take.rig)).max() < 0.5 * before


def test_a_silent_camera_stays_as_it_was(take: ml.SimulatedTake):
    silent = replace(take.rig.cameras[0], id="cam_99")
    rig = replace(crept(take.rig, 0.001), cameras=(*crept(take.rig, 0.001).cameras, silent))
    refined, report = ml.refine_rig(rig, take.observations)
    assert refined.cameras[-1] is silent
    assert "cam_99" in report["warnings"][0]


def test_too_few_cameras_or_points_are_told(take: ml.SimulatedTake):
    with pytest.raises(ml.InputError, match="three or more"):
        ml.refine_rig(take.rig, take.observations.of_cameras(["cam_00", "cam_01"]))
    with pytest.raises(ml.InputError, match="50 needed"):
        ml.refine_rig(take.rig, take.observations.select(0, 3))


def test_a_real_rig_that_warmed_up(data: Path):
    folder = data / "vicon-upper-body"
    rig = ml.read_calibration(folder / "move.xcp")
    _, report = ml.refine_rig(rig, ml.read_observations(folder / "move_centroids.csv.gz"))
    assert report["verdict"] == "ok"
    assert report["residual_px_before"]["rms"] > 0.7
    assert report["residual_px_after"]["rms"] < 0.40


def test_a_stream_refines_as_a_take_does(take: ml.SimulatedTake):
    start = crept(take.rig, 0.001)
    stream = ml.RigStream(start)
    with pytest.raises(ml.InputError, match="nothing was pushed"):
        stream.refined()
    dots = take.observations
    for frame in range(take.scene.frames):
        own = dots.frame == frame
        stream.push({c: dots.pixel[own & (dots.camera == i)] for i, c in enumerate(dots.camera_ids)})
    live, report = stream.refined()
    offline, _ = ml.refine_rig(start, dots)
    assert report["verdict"] == "ok"
    for a, b in zip(live.cameras, offline.cameras, strict=True):
        assert np.array_equal(a.position_m, b.position_m)
        assert np.array_equal(a.rotation, b.rotation)
    with pytest.raises(ml.InputError, match="camera 'x' is not in the calibration"):
        stream.push({"x": np.zeros((1, 2))})


def test_a_long_stream_keeps_frames_spread_over_all_of_it(take: ml.SimulatedTake):
    stream = ml.RigStream(take.rig)
    for _ in range(1700):
        stream.push({"cam_00": [[1.0, 2.0]]})
    numbers = [number for number, _ in stream._kept]
    assert len(numbers) <= 400
    assert len(set(np.diff(numbers))) == 1
    assert numbers[-1] > 1680
