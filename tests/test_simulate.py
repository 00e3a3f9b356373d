"""Simulation: the paper's experiment as described, and one take per seed, byte for byte."""

from pathlib import Path

import numpy as np
import pytest

import markerloom as ml


def test_exp61_is_the_papers_scene(take: ml.SimulatedTake) -> None:
    assert len(take.rig) == 4
    for camera in take.rig.cameras:
        assert camera.size_px == (640, 480)
        assert camera.focal_px == (757, 757)
        assert np.linalg.norm(camera.position_m) == pytest.approx(2.0)
        assert np.degrees(np.arcsin(camera.position_m[2] / 2.0)) == pytest.approx(30.0)
        np.testing.assert_allclose(camera.rotation[2], -camera.position_m / 2.0, atol=1e-12)
    half = np.array([497.843, 788.865, 748.485]) / 2
    assert np.all(np.abs(take.truth.xyz_mm) <= half)
    assert (np.abs(take.truth.xyz_mm).max(axis=0) > 0.98 * half).all()
    assert (np.bincount(take.truth.frame) == 33).all()


def test_one_hides_exactly_one_view_of_each_marker(take: ml.SimulatedTake) -> None:
    views = take.truth_assignments.group_by(["frame", "label"]).aggregate([("camera", "count")])
    assert set(views["camera_count"].to_pylist()) == {3}


def test_quarter_hides_a_quarter_of_the_views() -> None:
    take = ml.simulate(ml.make_scene("exp61", frames=50, hide="quarter"))
    assert len(take.observations) / (50 * 33 * 4) == pytest.approx(0.75, abs=0.02)


def test_the_noise_is_the_stated_one(take: ml.SimulatedTake) -> None:
    table = take.truth_assignments.to_pydict()
    place = {(f, str(m)): x for f, m, x in zip(take.truth.frame, take.truth.label, take.truth.xyz_mm, strict=True)}
    count: dict[tuple[int, int], int] = {}
    errors = []
    labels = {(f, c, o): m for f, c, o, m in zip(*table.values(), strict=True)}
    for frame, camera, pixel in zip(
        take.observations.frame.tolist(), take.observations.camera.tolist(), take.observations.pixel, strict=True
    ):
        index = count.get((frame, camera), 0)
        count[frame, camera] = index + 1
        label = labels[frame, take.rig.ids[camera], index]
        errors.append(pixel - take.rig.project(camera, place[frame, label][None] / 1000.0)[0])
    assert np.std(errors) == pytest.approx(2.0, rel=0.04)
    assert abs(np.mean(errors)) < 0.1


def test_a_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        ml.save(ml.simulate(ml.make_scene("dance", frames=5, seed=9)), tmp_path / name)
    for file in sorted((tmp_path / "a").iterdir()):
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes()


def test_seeds_differ() -> None:
    first, second = (ml.simulate(ml.make_scene("exp61", frames=2, seed=s)) for s in (0, 1))
    assert not np.array_equal(first.truth.xyz_mm, second.truth.xyz_mm)


@pytest.mark.parametrize(
    ("name", "changes", "reason"),
    [
        ("nothing", {}, "choose one of"),
        ("exp61", {"frames": 0}, "must be positive"),
        ("exp61", {"sigma_px": -1.0}, "must not be negative"),
        ("exp61", {"colour": "red"}, "a scene has no 'colour'"),
        ("exp61", {"hide": "most"}, "hide 'most'"),
        ("exp61", {"shape": "heap"}, "unknown rig shape"),
    ],
)
def test_impossible_scenes_are_refused(name: str, changes: dict[str, object], reason: str) -> None:
    with pytest.raises(ml.InputError, match=reason):
        ml.simulate(ml.make_scene(name, **changes))


@pytest.mark.parametrize("shape", ["ring", "arc", "wall"])
def test_every_shape_of_rig_sees_the_scene(shape: str) -> None:
    take = ml.simulate(ml.make_scene("cloud", frames=2, shape=shape, angle_deg=90.0 if shape == "arc" else 20.0))
    assert len(take.rig) == 8
    assert len(take.observations) > 2 * 33 * 4
