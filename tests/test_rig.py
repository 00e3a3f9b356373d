"""Rigs: lenses against OpenCV, calibration files against the loaders of other programs, refusals."""

import tomllib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import markerloom as ml
from markerloom.formats import calib_toml

POINTS = np.random.default_rng(1).uniform([-1.2, -0.9, 2.0], [1.2, 0.9, 4.0], (200, 3))
TURN = np.asarray(cv2.Rodrigues(np.array([0.2, -0.3, 0.1]))[0], float)


def camera(lens: ml.Lens, name: str = "cam_1") -> ml.Camera:
    return ml.Camera(
        id=name,
        size_px=(1280, 1024),
        focal_px=(900.0, 910.0),
        principal_px=(650.0, 500.0),
        rotation=TURN,
        position_m=np.array([0.1, 0.2, -0.3]),
        lens=lens,
    )


def matrix(one: ml.Camera) -> np.ndarray:
    return np.array([[one.focal_px[0], 0, one.principal_px[0]], [0, one.focal_px[1], one.principal_px[1]], [0, 0, 1.0]])


def test_brown_conrady_projects_as_opencv() -> None:
    k = (-0.2, 0.08, 5e-4, -8e-4, -0.01, 0.02, 0.003, 0.001)
    rig = ml.Rig.of([camera(ml.Lens("brown_conrady", k))])
    one = rig.cameras[0]
    theirs, _ = cv2.projectPoints(POINTS, cv2.Rodrigues(TURN)[0], one.translation_m, matrix(one), np.array(k))
    np.testing.assert_allclose(rig.project(0, POINTS), theirs[:, 0], atol=1e-8)


def test_fisheye_projects_as_opencv() -> None:
    k = (-0.02, 0.004, -0.001, 0.0002)
    rig = ml.Rig.of([camera(ml.Lens("fisheye", k))])
    one = rig.cameras[0]
    theirs, _ = cv2.fisheye.projectPoints(
        POINTS[:, None], cv2.Rodrigues(TURN)[0], one.translation_m, matrix(one), np.array(k)
    )
    np.testing.assert_allclose(rig.project(0, POINTS), theirs[:, 0], atol=1e-8)


def test_normalise_inverts_the_lens_of_a_real_rig(data: Path) -> None:
    rig = ml.read_calibration(data / "vicon-upper-body" / "move.xcp")
    for i, one in enumerate(rig.cameras):
        pixels = np.random.default_rng(i).uniform([0, 0], one.size_px, (50, 2))
        points = one.position_m + 4.0 * rig.rays(i, pixels)
        np.testing.assert_allclose(rig.project(i, points), pixels, atol=1e-6)


def pose2sim_loader(path: Path) -> list[dict[str, np.ndarray]]:
    """What Pose2Sim does with a calibration file: every table but its known exceptions is a camera."""
    content = tomllib.loads(path.read_text())
    cameras = []
    for name in content:
        if name in ("metadata", "capture_volume", "charuco", "checkerboard"):
            continue
        one = content[name]
        rotation = cv2.Rodrigues(np.array(one["rotation"]))[0]
        projection = np.array(one["matrix"]) @ np.c_[rotation, np.array(one["translation"])]
        cameras.append({"P": projection, "dist": np.array(one["distortions"]), "size": np.array(one["size"])})
    return cameras


def anipose_loader(path: Path) -> list[dict[str, np.ndarray]]:
    """What anipose does: the sorted tables that are not metadata, through OpenCV with their distortions."""
    content = tomllib.loads(path.read_text())
    return [content[key] for key in sorted(content) if key != "metadata"]


@pytest.mark.parametrize("lens", [ml.Lens(), ml.Lens("brown_conrady", (-0.2, 0.08, 5e-4, -8e-4, -0.01, 0, 0, 0))])
def test_written_calibrations_are_read_by_other_programs(tmp_path: Path, lens: ml.Lens) -> None:
    rig = ml.Rig.of([camera(lens, "cam_1"), replace(camera(lens, "cam_2"), position_m=np.array([1.0, 0, 0]))])
    ml.write_calibration(rig, tmp_path / "Calib.toml")
    for i, one in enumerate(pose2sim_loader(tmp_path / "Calib.toml")):
        pixels = np.c_[POINTS, np.ones(len(POINTS))] @ one["P"].T
        ideal = ml.Rig.of([replace(rig.cameras[i], lens=ml.Lens())]).project(0, POINTS)
        np.testing.assert_allclose(pixels[:, :2] / pixels[:, 2:], ideal, atol=1e-6)
        assert one["size"].tolist() == [1280, 1024]
    for i, one in enumerate(anipose_loader(tmp_path / "Calib.toml")):
        turn, shift, inner, lens_k = (
            np.array(one[k], float) for k in ("rotation", "translation", "matrix", "distortions")
        )
        theirs, _ = cv2.projectPoints(POINTS, turn, shift, inner, lens_k)
        ours = rig.project(i, POINTS)
        inside = np.isfinite(ours).all(axis=1)  # beyond the lens's fold-over OpenCV gives pixels, we give none
        assert inside.mean() > 0.8
        np.testing.assert_allclose(theirs[inside, 0], ours[inside], atol=1e-6)


def test_calibration_round_trip_is_exact(tmp_path: Path) -> None:
    rig = ml.Rig.of([camera(ml.Lens("fisheye", (-0.02, 0.004, -0.001, 0.0002)))])
    ml.write_calibration(rig, tmp_path / "a.toml")
    again = ml.read_calibration(tmp_path / "a.toml")
    np.testing.assert_allclose(again.project(0, POINTS), rig.project(0, POINTS), atol=1e-9)
    ml.write_calibration(again, tmp_path / "b.toml")
    first, second = ml.read_calibration(tmp_path / "b.toml").cameras[0], again.cameras[0]
    np.testing.assert_allclose(first.position_m, second.position_m, atol=1e-12)


def test_a_vicon_lens_survives_beside_its_opencv_fit(data: Path, tmp_path: Path) -> None:
    rig = ml.read_calibration(data / "vicon-upper-body" / "move.xcp")
    path = tmp_path / "rig.toml"
    ml.write_calibration(rig, path)
    again = ml.read_calibration(path)
    assert all(c.lens.model == "vicon_radial" for c in again.cameras)
    assert [c.mask is not None for c in again.cameras] == [c.mask is not None for c in rig.cameras]
    point = np.array([[0.1, 0.2, 1.2]])
    for i in range(len(rig)):
        np.testing.assert_allclose(again.project(i, point), rig.project(i, point), atol=1e-7)
    lenses = tomllib.loads(path.read_text())["metadata"]["markerloom"]["lenses"]
    # Vicon's polynomials bend away in the corners of some sensors; OpenCV's cannot follow, and the file says so.
    errors = sorted(v["fit_error_px"] for v in lenses.values())
    assert errors[0] < 0.1
    assert len(errors) == len(rig)


def test_an_edited_camera_loses_markerlooms_own_lens(data: Path, tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    ml.write_calibration(ml.read_calibration(data / "vicon-upper-body" / "move.xcp"), path)
    text = path.read_text()
    width = "size = [4096.0, 4096.0]"
    assert width in text
    path.write_text(text.replace(width, "size = [4095.0, 4096.0]", 1))
    models = [c.lens.model for c in ml.read_calibration(path).cameras]
    assert models.count("brown_conrady") == 1


def test_units_that_cannot_be_right_are_refused(tmp_path: Path) -> None:
    rig = ml.Rig.of([replace(camera(ml.Lens()), position_m=np.array([2.0, 1.0, 3.0]))])
    ml.write_calibration(rig, tmp_path / "m.toml")
    in_mm = (tmp_path / "m.toml").read_text()
    content = tomllib.loads(in_mm)["cam_1"]["translation"]
    (tmp_path / "mm.toml").write_text(in_mm.replace(str(content), str([1000 * v for v in content])))
    with pytest.raises(ml.InputError, match="--calibration-units"):
        ml.read_calibration(tmp_path / "mm.toml")
    np.testing.assert_allclose(
        ml.read_calibration(tmp_path / "mm.toml", units="mm").cameras[0].position_m, [2.0, 1.0, 3.0]
    )


def test_a_mirrored_camera_is_refused() -> None:
    with pytest.raises(ml.InputError, match="mirrored"):
        ml.Rig.of([replace(camera(ml.Lens()), rotation=np.diag([1.0, 1.0, -1.0]))])


def test_duplicate_ids_are_refused() -> None:
    with pytest.raises(ml.InputError, match="two cameras have the id"):
        ml.Rig.of([camera(ml.Lens()), camera(ml.Lens())])


def test_cameras_are_in_natural_order() -> None:
    names = [c.id for c in ml.Rig.of([camera(ml.Lens(), n) for n in ("cam10", "cam9", "cam1")]).cameras]
    assert names == ["cam1", "cam9", "cam10"]


@pytest.mark.parametrize("file", ["boards/Calib.qca.txt", "optitrack/calibration.mcal"])
def test_foreign_rigs_look_at_a_common_centre_from_above_the_floor(data: Path, file: str) -> None:
    rig = ml.read_calibration(data / file)
    across = [np.eye(3) - np.outer(c.rotation[2], c.rotation[2]) for c in rig.cameras]
    right = sum((a @ c.position_m for a, c in zip(across, rig.cameras, strict=True)), np.zeros(3))
    centre = np.linalg.solve(sum(across, np.zeros((3, 3))), right)
    for c in rig.cameras:
        assert c.rotation[2] @ (centre - c.position_m) > 1.0
        assert c.position_m[2] > 0.5
        assert np.linalg.norm(np.cross(c.rotation[2], centre - c.position_m)) < 0.6


def test_mask_of_a_real_camera_covers_its_tiles(data: Path) -> None:
    rig = ml.read_calibration(data / "vicon-upper-body" / "move.xcp")
    mask = rig.cameras[0].mask
    assert mask is not None
    assert sum(mask.tiles) == 39
    assert mask.grid == (256, 256)


def test_toml_that_is_none_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text("[cam_1\nname=")
    with pytest.raises(ml.FormatError, match="not a TOML file"):
        calib_toml.read(tmp_path / "a.toml")
