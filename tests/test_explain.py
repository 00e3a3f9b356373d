"""Why a marker is missing, cameras that were moved, and the page about a take."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import markerloom as ml
from markerloom.errors import InputError
from markerloom.explain import CAUSES
from markerloom.track_page import sharpest_turn


@pytest.fixture(scope="module")
def dance() -> ml.SimulatedTake:
    return ml.simulate(ml.make_scene("dance", frames=240, markers=33, sigma_px=0.3, seed=0))


@pytest.fixture(scope="module")
def tracked(dance: ml.SimulatedTake) -> ml.TrackedTake:
    points = ml.track(dance.observations, dance.rig)
    assert isinstance(points, ml.TrackedTake)
    return points


def test_a_measured_sample_is_explained_by_the_dots_that_made_it(tracked: ml.TrackedTake) -> None:
    row = int(np.flatnonzero((tracked.kind == 0) & (tracked.rays >= 3))[500])
    track, frame = int(tracked.track[row]), int(tracked.frame[row])
    told = ml.explain(tracked, track, frame)
    used = {(v.camera, v.observation) for v in told.cameras if v.cause == "used"}
    table = tracked.assignments.to_pydict()
    columns = (table["frame"], table["track"], table["camera"], table["observation"])
    made = {(c, o) for f, t, c, o in zip(*columns, strict=True) if (f, t) == (frame, track)}
    assert told.kind == "measured"
    assert used == made
    assert "its dot was used" in str(told)


def test_a_marker_hidden_from_all_cameras_is_told_to_be_hidden(dance: ml.SimulatedTake) -> None:
    take = dance.observations
    alone = ml.track(take, dance.rig)
    track = int(np.bincount(alone.track[alone.kind == 0]).argmax())
    table = alone.assignments.to_pydict()
    columns = (table["frame"], table["track"], table["camera"], table["observation"])
    gone = {(f, c, o) for f, t, c, o in zip(*columns, strict=True) if t == track and 100 <= f < 110}
    number = np.zeros(len(take.frame), np.int64)
    for frame in range(100, 110):
        for camera in range(len(take.camera_ids)):
            rows = np.flatnonzero((take.frame == frame) & (take.camera == camera))
            number[rows] = np.arange(len(rows))
    names = [take.camera_ids[c] for c in take.camera]
    keep = [key not in gone for key in zip(take.frame.tolist(), names, number.tolist(), strict=True)]
    points = ml.track(take._keep(np.array(keep)), dance.rig)
    place = alone.xyz_mm[(alone.track == track) & (alone.frame == 99)][0]
    rows = np.flatnonzero((points.frame == 99) & (points.kind == 0))
    same = int(points.track[rows[np.linalg.norm(points.xyz_mm[rows] - place, axis=1).argmin()]])
    told = ml.explain(points, same, 104)
    assert told.kind in ("predicted", "absent")
    assert not [v for v in told.cameras if v.cause in ("used", "single", "gated")]
    gap = next(g for g in points.report["gaps"] if g["track"] == same and g["first"] <= 104 <= g["last"])
    assert sum(gap["cameras"].values()) == len(dance.rig)
    assert set(gap["cameras"]) <= set(CAUSES)


def test_what_cannot_be_explained_is_refused(tracked: ml.TrackedTake) -> None:
    with pytest.raises(InputError, match="no trajectory 9999"):
        ml.explain(tracked, 9999, 5)
    with pytest.raises(InputError, match="frame 240 is not in the take"):
        ml.explain(tracked, int(tracked.track[0]), 240)
    rebuilt = ml.track(ml.Points.of(tracked.frame, tracked.track, tracked.xyz_mm, rate_hz=100.0))
    with pytest.raises(InputError, match="tracked from dots"):
        ml.explain(rebuilt, int(rebuilt.track[0]), 5)


@pytest.mark.parametrize("shift_px", [1.5, 12.0])
def test_a_camera_that_was_moved_is_named_with_its_frame(dance: ml.SimulatedTake, shift_px: float) -> None:
    take = dance.observations
    pixel = take.pixel.copy()
    pixel[(take.camera == 2) & (take.frame >= 133)] += [shift_px, -shift_px / 2]
    report = ml.track(replace(take, pixel=pixel), dance.rig).report
    (bump,) = report["bumped_cameras"]
    assert bump["camera"] == dance.rig.ids[2]
    assert abs(bump["frame"] - 133) <= 1
    assert np.allclose(bump["shift_px"], [shift_px, -shift_px / 2], atol=0.35 * shift_px)
    assert any(f"camera {dance.rig.ids[2]} was moved at frame" in w for w in report["warnings"])


def test_cameras_that_stand_still_are_not_accused(tracked: ml.TrackedTake) -> None:
    assert tracked.report["bumped_cameras"] == []


def test_the_page_shows_every_trajectory_and_a_turn(tracked: ml.TrackedTake, tmp_path: Path) -> None:
    ml.save_track_page(tracked, tmp_path / "take.html")
    page = (tmp_path / "take.html").read_text()
    assert f"{len(np.unique(tracked.track))} trajectories" in page
    assert "in its sharpest turn" in page
    assert page.count("<svg") == 2


def test_the_sharpest_turn_is_the_one_that_reverses() -> None:
    time_s = np.arange(0.0, 2.0, 0.01)
    straight = np.stack([2000.0 * time_s, 0.0 * time_s, 0.0 * time_s], axis=1)
    turning = np.stack([1000.0 * np.abs(time_s - 1.0), 500.0 + 0.0 * time_s, 0.0 * time_s], axis=1)
    xyz_mm = np.stack([straight, turning], axis=1).reshape(-1, 3)
    frame, track = np.repeat(np.arange(200), 2), np.tile([0, 1], 200)
    points = ml.track(ml.Points.of(frame, track, xyz_mm, rate_hz=100.0))
    found = sharpest_turn(points)
    assert found is not None
    rows = found[1]
    assert np.allclose(points.xyz_mm[rows][:, 1], 500.0, atol=1.0)
    assert abs(np.median(points.frame[rows]) - 100) <= 3
