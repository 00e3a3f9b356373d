"""Rigid bodies: exact without noise, honest with it, ambiguous layouts named before they are used."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import markerloom as ml
from test_label import points_of

LAYOUT_MM = np.array([[0.0, 0.0, 0.0], [120.0, 0.0, 0.0], [0.0, 70.0, 20.0], [40.0, 20.0, 95.0]])
NAMES = ["A", "B", "C", "D"]


def moved(layout_mm: np.ndarray, frames: int, sigma_mm: float = 0.0) -> tuple[np.ndarray, Rotation, np.ndarray]:
    """(frames, n, 3), the rotations, and where the layout's origin is."""
    times = np.linspace(0.0, 6.0, frames)
    turns = Rotation.from_rotvec(np.column_stack([np.sin(times), 0.7 * np.cos(1.3 * times), 0.5 * times]))
    origins = 300.0 * np.column_stack([np.cos(times), np.sin(1.7 * times), 3.0 + 0.2 * times])
    points = np.array([t.apply(layout_mm) + o for t, o in zip(turns, origins, strict=True)])
    return points + np.random.default_rng(0).normal(0.0, sigma_mm, points.shape), turns, origins


def test_poses_are_exact_without_noise() -> None:
    points_mm, turns, origins = moved(LAYOUT_MM, 200)
    points_mm[50:80, 3] = np.nan
    points_mm[120:130, 1:] = np.nan
    points = points_of(points_mm, NAMES)
    body = ml.RigidBody("tool", tuple(NAMES), LAYOUT_MM)
    poses = ml.track_rigid_body(points, body)
    assert len(poses.frame) == 190
    assert np.abs(poses.position_mm - origins[poses.frame]).max() < 1e-6
    off = (Rotation.from_quat(poses.quaternion) * Rotation.from_quat(turns.as_quat()[poses.frame]).inv()).magnitude()
    assert off.max() < 1e-7
    assert set(poses.markers.tolist()) == {3, 4}


def test_uncertainty_is_honest() -> None:
    points_mm, turns, origins = moved(LAYOUT_MM, 3000, sigma_mm=0.5)
    poses = ml.track_rigid_body(points_of(points_mm, NAMES), ml.RigidBody("tool", tuple(NAMES), LAYOUT_MM))
    off_mm = ((poses.position_mm - origins) ** 2).sum(axis=1)
    off_deg = np.degrees((Rotation.from_quat(poses.quaternion) * turns.inv()).magnitude()) ** 2
    assert np.mean(off_mm / poses.sigma_mm**2) == pytest.approx(1.0, abs=0.1)
    assert np.mean(off_deg / poses.sigma_deg**2) == pytest.approx(1.0, abs=0.1)


def test_a_layout_is_learned_from_frames_with_its_pivot_and_axis() -> None:
    points_mm, _, _ = moved(LAYOUT_MM, 400, sigma_mm=0.3)
    body = ml.create_rigid_body(points_of(points_mm, NAMES), NAMES, pivot="A", axis=("A", "B"))
    assert np.allclose(body.places_mm[0], 0.0, atol=1e-9)
    assert np.allclose(body.places_mm[1], [120.0, 0.0, 0.0], atol=0.1)
    apart = np.linalg.norm(body.places_mm[:, None] - body.places_mm, axis=2)
    true = np.linalg.norm(LAYOUT_MM[:, None] - LAYOUT_MM, axis=2)
    assert np.abs(apart - true).max() < 0.1
    assert body.residual_mm == pytest.approx(0.3 * np.sqrt(3) * np.sqrt(3 / 4 * 5 / 6), rel=0.25)


def test_bad_layouts_are_named_before_they_are_used() -> None:
    square = np.array([[0.0, 0, 0], [100, 0, 0], [100, 100, 0], [0, 100, 0]])
    with pytest.raises(ml.InputError, match="fits itself"):
        ml.create_rigid_body(points_of(moved(square, 20)[0], NAMES), NAMES)
    line = np.array([[0.0, 0, 0], [50, 0, 0], [120, 0, 0]])
    with pytest.raises(ml.InputError, match="on a line"):
        ml.create_rigid_body(points_of(moved(line, 20)[0], NAMES[:3]), NAMES[:3])
    loose = moved(LAYOUT_MM, 50)[0]
    loose[:, 3] += np.linspace(0, 150, 50)[:, None]
    with pytest.raises(ml.InputError, match="do they all belong"):
        ml.create_rigid_body(points_of(loose, NAMES), NAMES)
    with pytest.raises(ml.InputError, match="no marker 'Q'"):
        ml.create_rigid_body(points_of(loose, NAMES), ["A", "B", "Q"])
    mirrored = LAYOUT_MM * [1.0, 1.0, -1.0]
    assert ml.ambiguities(ml.RigidBody("m", tuple(NAMES), mirrored)) == []


def test_a_body_and_its_poses_survive_their_files(tmp_path: Path) -> None:
    points_mm, _, _ = moved(LAYOUT_MM, 30)
    body = ml.create_rigid_body(points_of(points_mm, NAMES), NAMES, name='to"ol')
    ml.write_rigid_body(body, tmp_path / "b.toml")
    again = ml.read_rigid_body(tmp_path / "b.toml")
    assert (again.name, again.markers) == (body.name, body.markers)
    assert np.allclose(again.places_mm, body.places_mm, atol=1e-3)
    ml.track_rigid_body(points_of(points_mm, NAMES), again).save(tmp_path / "poses.csv")
    assert (tmp_path / "poses.csv").read_text().splitlines()[0].startswith('"frame","body","x_mm"')
    (tmp_path / "b.toml").write_text("units = 'miles'\nmarkers = []\n")
    with pytest.raises(ml.FormatError, match="no rigid body"):
        ml.read_rigid_body(tmp_path / "b.toml")


def test_poses_stand_beside_the_markers_in_a_c3d(tmp_path: Path) -> None:
    from markerloom.formats import c3d_file
    from test_cli import run

    points_mm, rotation, _ = moved(LAYOUT_MM, 30)
    points_mm[4:6, 1:] = np.nan
    take = points_of(points_mm, NAMES)
    take.save(tmp_path / "take.c3d")
    ml.write_rigid_body(ml.create_rigid_body(take, NAMES, name="tool"), tmp_path / "tool.toml")
    run("rigid", "track", tmp_path / "take.c3d", "--body", tmp_path / "tool.toml", "-o", tmp_path / "posed.c3d")
    segments, _ = c3d_file.read_segments(tmp_path / "posed.c3d")
    assert segments.labels == ["tool"]
    assert np.isnan(segments.turn[4:6]).all()
    seen = np.r_[0:4, 6:30]
    relative = np.swapaxes(rotation.as_matrix()[seen], 1, 2) @ segments.turn[seen, 0]
    np.testing.assert_allclose(relative, relative[:1].repeat(len(seen), axis=0), atol=1e-4)
    assert len(ml.read_points(tmp_path / "posed.c3d")) == len(take)
