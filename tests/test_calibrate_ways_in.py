"""Other ways to a rig: known points, a single marker, an old calibration, several waves; and what its file says."""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import markerloom as ml
from markerloom.cli import app
from test_calibrate import SIZE, calibrate, center_errors_mm, wave
from test_calibrate_origin import elsewhere

NOISE_PX = 0.1


@pytest.fixture(scope="module")
def rig() -> ml.Rig:
    return ml.simulate(ml.make_scene("wand", cameras=4, frames=1)).rig


@pytest.fixture(scope="module")
def frame() -> ml.Wand:
    places = np.random.default_rng(3).uniform([-1.0, -1.0, 0.1], [1.0, 1.0, 1.9], (16, 3))
    return ml.Wand("frame", tuple(str(k) for k in range(16)), places)


def dots(rig: ml.Rig, rows: list[tuple[int, int, int]], places: np.ndarray, noise_px: float = NOISE_PX):
    """Observations of (frame, camera, marker) with ids."""
    random = np.random.default_rng(4)
    pixel = np.array([rig.project(c, places[m : m + 1])[0] for _, c, m in rows])
    table = np.array(rows)
    return ml.Observations(
        table[:, 0],
        table[:, 1],
        tuple(rig.ids),
        pixel + random.normal(0.0, noise_px, pixel.shape),
        optional={"id": table[:, 2].astype(float)},
    )


def everything(rig: ml.Rig, places: np.ndarray, noise_px: float = NOISE_PX) -> ml.Observations:
    return dots(rig, [(0, c, m) for c in range(len(rig)) for m in range(len(places))], places, noise_px)


def test_known_points_give_the_rig_exactly_without_noise(rig: ml.Rig, frame: ml.Wand) -> None:
    seen = everything(rig, frame.places_m, noise_px=0.0)
    found, report = ml.calibrate_points(seen, frame, image_sizes=dict.fromkeys(rig.ids, SIZE))
    assert report["verdict"] == "ok"
    for a, b in zip(found.cameras, rig.cameras, strict=True):
        assert np.linalg.norm(a.position_m - b.position_m) < 1e-5
        assert a.focal_px[0] == pytest.approx(1300.0, rel=1e-5)


def test_known_points_with_noise_are_as_good_as_stated(rig: ml.Rig, frame: ml.Wand) -> None:
    found, report = ml.calibrate_points(
        everything(rig, frame.places_m), frame, image_sizes=dict.fromkeys(rig.ids, SIZE)
    )
    ratios = [
        1000.0 * np.linalg.norm(a.position_m - b.position_m) / report["cameras"][a.id]["position_sigma_mm"]
        for a, b in zip(found.cameras, rig.cameras, strict=True)
    ]
    assert 0.2 < np.sqrt(np.mean(np.square(ratios))) < 2.5


def test_a_marker_laid_on_the_places_in_order_tells_which_is_which(rig: ml.Rig, frame: ml.Wand) -> None:
    rows, number = [], 0
    for marker in range(16):
        for _ in range(8):
            rows += [(number, c, marker) for c in range(4)]
            number += 1
        number += 3  # carried, out of view
    seen = replace(dots(rig, rows, frame.places_m, 0.05), optional={})
    _, report = ml.calibrate_points(seen, frame, image_sizes=dict.fromkeys(rig.ids, SIZE), in_order=True)
    assert report["verdict"] == "ok"
    with pytest.raises(ml.InputError, match="rests 16 times, but 'frame' has 15 places"):
        ml.calibrate_points(
            seen, ml.Wand("frame", frame.markers[:15], frame.places_m[:15]), in_order=True, intrinsics=rig
        )


def test_an_old_calibration_tells_which_is_which(rig: ml.Rig, frame: ml.Wand) -> None:
    seen = replace(everything(rig, frame.places_m), optional={})
    with pytest.raises(ml.InputError, match="nothing tells which dot is which marker"):
        ml.calibrate_points(seen, frame, image_sizes=dict.fromkeys(rig.ids, SIZE))
    old = replace(rig, cameras=tuple(replace(c, position_m=c.position_m + 0.01) for c in rig.cameras))
    found, report = ml.calibrate_points(seen, frame, start=old, intrinsics=rig)
    assert report["verdict"] == "ok"
    assert max(np.linalg.norm(a.position_m - b.position_m) for a, b in zip(found.cameras, rig.cameras, strict=True)) < (
        0.005
    )


def test_points_in_a_plane_too_few_or_misnamed_are_refused(rig: ml.Rig, frame: ml.Wand) -> None:
    seen = everything(rig, frame.places_m)
    flat = ml.Wand("flat", frame.markers, frame.places_m * [1.0, 1.0, 0.0])
    with pytest.raises(ml.InputError, match="not all in one plane"):
        ml.calibrate_points(seen, flat, intrinsics=rig)
    hidden = seen._keep((seen.camera != 1) | (seen.optional["id"] < 5))
    _, report = ml.calibrate_points(hidden, frame, intrinsics=rig)
    assert report["reasons"] == ["camera cam_01 sees 5 of the known markers: six or more are needed, not in one plane"]
    order = np.random.default_rng(0).permutation(16)
    mixed = ml.Wand("frame", tuple(frame.markers[k] for k in order), frame.places_m)
    _, report = ml.calibrate_points(seen, mixed, intrinsics=rig)
    assert report["verdict"] == "refused"


def test_a_single_marker_calibrates_cameras_whose_lenses_are_known() -> None:
    take = wave(wand="marker", cameras=5, frames=400)
    a, b = take.rig.cameras[0], take.rig.cameras[2]
    distance_m = float(np.linalg.norm(a.position_m - b.position_m))
    with pytest.raises(ml.InputError, match="a single marker has no length"):
        calibrate(take)
    made = calibrate(take, intrinsics=take.rig, camera_distance_m=(a.id, b.id, distance_m))
    assert made.report["verdict"] == "ok", made.report["reasons"]
    assert center_errors_mm(made, take.rig).max() < 1.5
    own = center_errors_mm(made, take.rig)
    sigma = np.array([c["position_sigma_mm"] for c in made.report["cameras"].values()])
    assert np.sqrt(np.mean((own / sigma) ** 2)) < 3.0


def test_a_single_marker_finds_equal_focal_lengths_too() -> None:
    take = wave(wand="marker", cameras=6, frames=500)
    made = calibrate(take, camera_distance_m=("cam_00", "cam_03", 1.0))
    assert [round(c.focal_px[0], -1) for c in made.rig.cameras] == [1300.0] * 6


def test_an_old_calibration_is_a_start_and_its_world_is_kept() -> None:
    take = wave(cameras=5, frames=250)
    old = elsewhere(take.rig)
    made = calibrate(take, start=old)
    assert made.report["verdict"] == "ok", made.report["reasons"]
    for found, before in zip(made.rig.cameras, old.cameras, strict=True):
        assert np.linalg.norm(found.position_m - before.position_m) < 0.005


def test_an_old_calibration_of_another_place_does_no_harm() -> None:
    take = wave(cameras=5, frames=250)
    turned = tuple(take.rig.cameras[(i + 2) % 5] for i in range(5))
    wrong = replace(take.rig, cameras=tuple(replace(c, id=i) for c, i in zip(turned, take.rig.ids, strict=True)))
    made = calibrate(take, start=wrong)
    assert made.report["verdict"] == "ok", made.report["reasons"]
    assert center_errors_mm(made, take.rig).max() < 3.0


def test_a_refused_wave_is_continued_by_another(tmp_path: Path) -> None:
    short, more = wave(frames=40, seed=1), wave(frames=300, seed=2)
    ml.save(short, tmp_path / "short")
    ml.save(more, tmp_path / "more")
    target, run = tmp_path / "rig.toml", CliRunner()
    common = ["--image-size", "1280x1024", "-o", str(target)]
    refused = run.invoke(app, ["calibrate", "wand", str(tmp_path / "short" / "observations.parquet"), *common])
    assert "--continue" in str(refused.exception)
    assert not target.exists()
    second = str(tmp_path / "more" / "observations.parquet")
    report = tmp_path / "report.json"
    kept = ["--continue", str(tmp_path / "rig.refused.toml"), "--report", str(report)]
    done = run.invoke(app, ["calibrate", "wand", second, *common, *kept])
    assert done.exit_code == 0, done.exception
    content = tomllib.loads(target.read_text())["metadata"]["markerloom"]
    assert [r["path"] for r in content["wave"]["recordings"]] == [
        "short/observations.parquet",
        "more/observations.parquet",
    ]
    (tmp_path / "short" / "observations.parquet").write_bytes(b"something else")
    changed = run.invoke(app, ["calibrate", "wand", second, *common, "--continue", str(target)])
    assert "was changed since" in str(changed.exception)


def test_the_file_says_what_the_calibration_is_worth(tmp_path: Path) -> None:
    take = wave()
    ml.save(take, tmp_path)
    arguments = ["calibrate", "wand", str(tmp_path / "observations.parquet"), "-o", str(tmp_path / "rig.toml")]
    done = CliRunner().invoke(app, [*arguments, "--image-size", "1280x1024"])
    assert done.exit_code == 0, done.exception
    metadata = tomllib.loads((tmp_path / "rig.toml").read_text())["metadata"]
    quality = metadata["markerloom"]["quality"]
    assert quality["verdict"] == "ok"
    assert quality["reprojection_px"] == pytest.approx(0.1, rel=0.1)
    assert metadata["error"] == quality["reprojection_px"]
    assert abs(quality["scale_error"]) < 1e-3
    own = quality["cameras"]["cam_02"]
    covariance = np.array(own["pose_covariance"]).reshape(6, 6)
    assert np.allclose(covariance, covariance.T)
    assert 1000.0 * np.sqrt(np.trace(covariance[3:, 3:])) == pytest.approx(own["position_sigma_mm"])


def test_a_camera_keeps_its_id_through_a_calibration_file(rig: ml.Rig, tmp_path: Path) -> None:
    named = replace(rig, cameras=tuple(replace(c, id=str(k), name="Vantage") for k, c in enumerate(rig.cameras)))
    ml.write_calibration(named, tmp_path / "rig.toml")
    again = ml.read_calibration(tmp_path / "rig.toml")
    assert [again.find(c) is not None for c in named.ids] == [True] * 4


def test_a_rig_written_as_xcp_projects_alike(rig: ml.Rig, tmp_path: Path) -> None:
    mild = ml.Lens("brown_conrady", (-0.05, 0.004, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    given = replace(rig, cameras=tuple(replace(c, lens=mild) for c in rig.cameras))
    ml.write_calibration(given, tmp_path / "rig.xcp")
    again = ml.read_calibration(tmp_path / "rig.xcp")
    places = np.random.default_rng(0).uniform([-1.0, -1.0, 0.0], [1.0, 1.0, 2.0], (300, 3))
    for i in range(len(rig)):
        assert np.nanmax(np.abs(again.project(i, places) - given.project(i, places))) < 0.06
    strong = ml.Lens("brown_conrady", (-0.4, 0.1, 0.01, -0.01, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(ml.InputError, match=r"0\.05 allowed"):
        ml.write_calibration(replace(rig, cameras=(replace(rig.cameras[0], lens=strong),)), tmp_path / "other.xcp")
    assert not (tmp_path / "other.xcp").exists()
