"""Origin, floor and axes from an object on the floor."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import markerloom as ml
from markerloom.calibrate.world import moved

PLACES_M = np.array([[0.0, 0.0, 0.02], [0.4, 0.0, 0.02], [0.0, 0.6, 0.02], [0.0, 0.25, 0.02]])
L_FRAME = ml.Wand("l-frame", ("O", "X", "Y", "y"), PLACES_M)


def seen(rig: ml.Rig, places_m: np.ndarray, frames: int = 12) -> ml.Observations:
    """Dots of still points with a little noise."""
    random = np.random.default_rng(2)
    rows = []
    for frame in range(frames):
        for index in range(len(rig)):
            pixel = rig.project(index, places_m) + random.normal(0.0, 0.05, (len(places_m), 2))
            rows += [(frame, index, *p) for p in pixel if np.isfinite(p).all()]
    table = np.array(rows)
    return ml.Observations(
        table[:, 0].astype(np.int64), table[:, 1].astype(np.int64), tuple(rig.ids), table[:, 2:].copy()
    )


@pytest.fixture(scope="module")
def rig() -> ml.Rig:
    return ml.simulate(ml.make_scene("wand", cameras=6, frames=1)).rig


def elsewhere(rig: ml.Rig) -> ml.Rig:
    """The same rig in another world."""
    turn = Rotation.from_rotvec([0.9, -0.4, 2.0]).as_matrix()
    return replace(rig, cameras=tuple(moved(list(rig.cameras), turn, np.array([1.0, -2.0, 0.7]))))


def test_the_world_of_the_object_comes_back(rig: ml.Rig):
    extra = np.vstack([PLACES_M, [[0.7, -0.5, 0.9], [-0.4, 0.2, 0.5]]])
    placed, report = ml.calibrate_origin(elsewhere(rig), seen(rig, extra), L_FRAME)
    assert report["misfit_mm"] < 0.5
    assert abs(report["scale_error"]) < 1e-3
    for found, true in zip(placed.cameras, rig.cameras, strict=True):
        assert np.linalg.norm(found.position_m - true.position_m) < 0.003
        assert np.abs(found.rotation - true.rotation).max() < 1e-3


def test_the_height_of_the_markers_is_counted(rig: ml.Rig):
    flat = replace(L_FRAME, places_m=PLACES_M * [1.0, 1.0, 0.0])
    placed, _ = ml.calibrate_origin(rig, seen(rig, PLACES_M), flat, height_m=0.02)
    assert placed.cameras[0].position_m[2] == pytest.approx(rig.cameras[0].position_m[2], abs=0.003)


def test_an_object_that_is_not_there_is_told(rig: ml.Rig):
    with pytest.raises(ml.InputError, match="no frame shows 'l-frame'"):
        ml.calibrate_origin(rig, seen(rig, PLACES_M * 1.1), L_FRAME)


def test_a_mirrored_object_is_not_taken(rig: ml.Rig):
    solid = replace(L_FRAME, places_m=np.vstack([PLACES_M[:3], [[0.1, 0.1, 0.35]]]))
    with pytest.raises(ml.InputError, match="no frame shows"):
        ml.calibrate_origin(rig, seen(rig, solid.places_m * [-1.0, 1.0, 1.0]), solid)


def test_an_object_upside_down_would_put_the_cameras_below_the_floor(rig: ml.Rig):
    flipped = replace(L_FRAME, places_m=PLACES_M * [1.0, -1.0, -1.0])
    with pytest.raises(ml.InputError, match="below the floor"):
        ml.calibrate_origin(rig, seen(rig, PLACES_M), flipped)


def test_markers_on_a_line_fix_no_world(rig: ml.Rig):
    with pytest.raises(ml.InputError, match="off one line"):
        ml.calibrate_origin(rig, seen(rig, PLACES_M), ml.read_wand("line-500"))


def test_three_named_points_give_the_world(rig: ml.Rig):
    other = elsewhere(rig)
    turn = Rotation.from_rotvec([0.9, -0.4, 2.0]).as_matrix()
    there = (PLACES_M[:3] - [1.0, -2.0, 0.7]) @ turn.T
    frame, label = np.repeat(np.arange(4), 3), np.tile(["O", "X", "Y"], 4)
    points = ml.Points.of(frame, np.tile([0, 1, 2], 4), np.tile(1000.0 * there, (4, 1)), label=label)
    placed, report = ml.origin_from_points(other, points, ("O", "X", "Y"), height_m=0.02)
    assert report["points_mm"]["X"] == pytest.approx([400.0, 0.0, 20.0], abs=1e-6)
    for found, true in zip(placed.cameras, rig.cameras, strict=True):
        assert np.linalg.norm(found.position_m - true.position_m) < 1e-9
    with pytest.raises(ml.InputError, match="exchange the last two"):
        ml.origin_from_points(other, points, ("O", "Y", "X"))
    with pytest.raises(ml.InputError, match="no point is labelled 'Z'; labels are O, X, Y"):
        ml.origin_from_points(other, points, ("O", "X", "Z"))


def test_markers_on_the_floor_level_the_world_and_leave_its_heading(rig: ml.Rig):
    tilted = Rotation.from_rotvec([0.05, -0.03, 0.0]).as_matrix()
    crooked = replace(rig, cameras=tuple(moved(list(rig.cameras), tilted, np.array([0.0, 0.0, -0.2]))))
    flat = np.array([[0.6, 0.1, 0.007], [-0.7, 0.3, 0.007], [0.1, -0.8, 0.007], [0.2, 0.5, 0.007], [0.0, 0.0, 0.007]])
    placed, report = ml.origin_from_floor(crooked, seen(rig, flat), height_m=0.007)
    assert report["markers"] == 5
    assert report["misfit_mm"] < 0.5
    assert report["tilt_deg"] == pytest.approx(np.degrees(np.hypot(0.05, 0.03)), abs=0.05)
    for found, true in zip(placed.cameras, rig.cameras, strict=True):
        assert found.position_m[2] == pytest.approx(true.position_m[2], abs=0.003)
        assert np.linalg.norm(found.position_m - true.position_m) < 0.03
    with pytest.raises(ml.InputError, match="in no plane"):
        ml.origin_from_floor(crooked, seen(rig, flat + np.outer([0.0, 0.3, 0.0, 0.0, 0.2], [0.0, 0.0, 1.0])))
    with pytest.raises(ml.InputError, match="on a line"):
        ml.origin_from_floor(crooked, seen(rig, flat * [1.0, 0.0, 1.0]))
