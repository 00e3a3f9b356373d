"""Calibration from a wand wave: exact without noise, honest with noise, refused where it is not right."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import markerloom as ml
from markerloom.cli import app

SIZE = (1280.0, 1024.0)


def wave(**changes: object) -> ml.SimulatedTake:
    given = {
        "cameras": 5,
        "frames": 250,
        "rate_hz": 20.0,
        "clutter_per_frame": 0.0,
        "reflections": 0,
        "hide": "none",
    } | changes
    return ml.simulate(ml.make_scene("wand", **given))


def calibrate(take: ml.SimulatedTake, **options: object) -> ml.Calibration:
    sizes = dict.fromkeys(take.rig.ids, SIZE)
    return ml.calibrate_wand(take.observations, ml.read_wand(take.scene.wand), image_sizes=sizes, **options)  # pyright: ignore[reportArgumentType]


def center_errors_mm(made: ml.Calibration, true: ml.Rig) -> np.ndarray:
    """Distances of camera centres from the true ones after a rigid alignment."""
    found = np.array([c.position_m for c in made.rig.cameras])
    truth = np.array([true.cameras[true.ids.index(c.id)].position_m for c in made.rig.cameras])
    a, b = found - found.mean(axis=0), truth - truth.mean(axis=0)
    u, _, vt = np.linalg.svd(a.T @ b)
    turn = (u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt).T
    return 1000.0 * np.linalg.norm(a @ turn.T - b, axis=1)


def test_without_noise_the_rig_comes_back_from_nothing():
    take = wave(sigma_px=0.0)
    made = calibrate(take)
    assert made.report["verdict"] == "ok", made.report["reasons"]
    assert center_errors_mm(made, take.rig).max() < 0.01
    assert max(abs(c.focal_px[0] / 1300.0 - 1.0) for c in made.rig.cameras) < 1e-6


@pytest.mark.parametrize("wand", ["vicon-t", "line-500", "pair-500"])
def test_every_wand_calibrates_to_the_noise(wand: str):
    take = wave(wand=wand, sigma_px=0.1, frames=400)
    made = calibrate(take)
    assert made.report["verdict"] == "ok", made.report["reasons"]
    assert made.report["reprojection_px"] == pytest.approx(0.1, rel=0.05)
    sigma = np.array([c["position_sigma_mm"] for c in made.report["cameras"].values()])
    assert np.mean((center_errors_mm(made, take.rig) / sigma) ** 2) < 4.0
    assert made.report["wand_length_mm"]["spread"] < 1.0


def test_false_dots_reflections_and_gross_errors_do_no_harm():
    take = wave(clutter_per_frame=0.5, reflections=2, hide="0.05", frames=400)
    random = np.random.default_rng(3)
    pixel = take.observations.pixel.copy()
    wrong = random.random(len(pixel)) < 0.05
    pixel[wrong] += random.normal(0.0, 15.0, (int(wrong.sum()), 2))
    made = calibrate(replace(take, observations=replace(take.observations, pixel=pixel)))
    assert made.report["verdict"] == "ok", made.report["reasons"]
    assert made.report["reprojection_px"] == pytest.approx(0.1, rel=0.1)
    assert center_errors_mm(made, take.rig).max() < 5.0


def test_the_world_stands_upright():
    take = wave(sigma_px=0.05)
    cameras = calibrate(take).rig.cameras
    assert all(c.position_m[2] > 0.3 for c in cameras)
    assert np.mean([-c.rotation[1, 2] for c in cameras]) > 0.8


def test_the_same_wave_gives_the_same_bytes(tmp_path: Path):
    take = wave(frames=120)
    for name in ("a.toml", "b.toml"):
        ml.write_calibration(calibrate(take).rig, tmp_path / name)
    assert (tmp_path / "a.toml").read_bytes() == (tmp_path / "b.toml").read_bytes()


def test_given_intrinsics_stay_as_they_are():
    take = wave()
    made = calibrate(take, intrinsics=take.rig)
    assert made.report["verdict"] == "ok", made.report["reasons"]
    assert all(c.focal_px == (1300.0, 1300.0) for c in made.rig.cameras)
    assert center_errors_mm(made, take.rig).max() < 1.0


def test_a_camera_that_never_sees_the_wand_whole_is_named():
    take = wave()
    rows = ~((take.observations.camera == 2) & (np.arange(len(take.observations)) % 5 == 0))
    made = calibrate(replace(take, observations=take.observations._keep(rows)))
    assert made.report["verdict"] == "refused"
    assert any("cam_02 never sees the wand whole" in r and "--cameras" in r for r in made.report["reasons"])


def test_a_short_wave_is_refused_with_what_to_do():
    made = calibrate(wave(frames=35))
    assert made.report["verdict"] == "refused"
    assert any("50 needed" in r and "wave longer" in r for r in made.report["reasons"])


def test_a_camera_moved_during_the_wave_is_refused():
    take = wave(frames=400)
    late = (take.observations.camera == 1) & (take.observations.frame >= 160)
    pixel = take.observations.pixel + np.where(late[:, None], [12.0, 5.0], 0.0)
    made = calibrate(replace(take, observations=replace(take.observations, pixel=pixel)))
    assert made.report["verdict"] == "refused"
    assert any("cam_01" in r and "moved" in r for r in made.report["reasons"]), made.report["reasons"]


def test_a_wrong_image_size_is_an_error():
    take = wave(frames=60)
    with pytest.raises(ml.InputError, match="state its true size"):
        ml.calibrate_wand(
            take.observations, ml.read_wand("vicon-t"), image_sizes=dict.fromkeys(take.rig.ids, (640.0, 480.0))
        )


def test_another_wand_than_the_stated_one_is_refused():
    take = wave()
    made = ml.calibrate_wand(take.observations, ml.read_wand("line-500"), image_sizes=dict.fromkeys(take.rig.ids, SIZE))
    assert made.report["verdict"] == "refused"
    assert any("wrong wand" in r for r in made.report["reasons"]), made.report["reasons"]


def test_one_camera_and_nan_are_told():
    take = wave(frames=60)
    with pytest.raises(ml.InputError, match="two cameras or more"):
        calibrate(take, cameras=["cam_00"])
    pixel = take.observations.pixel.copy()
    pixel[::50] = np.nan
    made = calibrate(replace(take, observations=replace(take.observations, pixel=pixel)))
    assert any("NaN" in w for w in made.report["warnings"])


def test_a_refused_result_leaves_the_file_as_it_was(tmp_path: Path):
    from typer.testing import CliRunner

    take = wave(frames=35)
    ml.save(take, tmp_path / "take")
    target = tmp_path / "rig.toml"
    target.write_text("as it was")
    arguments = ["calibrate", "wand", str(tmp_path / "take" / "observations.parquet"), "-o", str(target)]
    result = CliRunner().invoke(app, [*arguments, "--image-size", "1280x1024", "--page", str(tmp_path / "page.html")])
    assert isinstance(result.exception, ml.InputError)
    assert "refused" in str(result.exception)
    assert target.read_text() == "as it was"
    assert "Refused:" in (tmp_path / "page.html").read_text()


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ('units = "furlong"\n[[markers]]\nname = "a"\nposition = [0, 0, 0]\n', "units"),
        ('units = "mm"\n', "no \\[\\[markers\\]\\]"),
        ('units = "mm"\n[[markers]]\nname = "a"\n', "position"),
        ('units = "mm"\n[[markers]]\nname = "a"\nposition = [0, 0, 0]\n', "one marker"),
        ("units = ", "TOML"),
    ],
)
def test_a_wand_file_that_is_none_says_why(tmp_path: Path, text: str, why: str):
    path = tmp_path / "wand.toml"
    path.write_text(text)
    with pytest.raises(ml.FormatError, match=why):
        ml.read_wand(path)


@pytest.mark.slow
def test_a_real_wave_from_nothing_but_its_dots(data: Path):
    take = ml.read_observations(data / "vicon-wand" / "wand_centroids.csv.gz")
    vendor = ml.read_calibration(data / "vicon-wand" / "reference.xcp")
    made = ml.calibrate_wand(take, ml.read_wand("vicon-t"), image_sizes={c.id: c.size_px for c in vendor.cameras})
    assert made.report["verdict"] == "ok", made.report["reasons"]
    assert made.report["left_out_residual_px"]["median"] < 0.12
    assert made.report["observations_used"] > 0.98
    for camera in made.rig.cameras:
        vendors = vendor.cameras[vendor.ids.index(camera.id)]
        assert camera.focal_px[0] == pytest.approx(vendors.focal_px[0], rel=0.01)
