"""Recordings without a common clock: offset and drift from motion, events, time codes and by hand; tracking them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import markerloom as ml
from markerloom.cli import app
from markerloom.errors import InputError
from markerloom.formats import write_observations
from markerloom.formats.timecode import seconds

OFFSET, DRIFT = 3.37, 20.0


@pytest.fixture(scope="module")
def two_clocks() -> ml.SimulatedTake:
    return ml.simulate(ml.make_scene("walk", frames=900, offset_frames=OFFSET, drift_ppm=DRIFT, seed=1))


def test_offset_and_drift_come_from_the_motion_alone(two_clocks: ml.SimulatedTake) -> None:
    synced = ml.sync(two_clocks.recordings(), two_clocks.rig)
    reference, other = synced.report["clocks"]
    assert reference["way"] == "reference"
    assert abs(other["offset_frames"] - OFFSET) < 0.02
    # Nine seconds tell the drift to a few parts in a million; what is stated covers the error.
    assert abs(other["drift_ppm"] - DRIFT) < 5 * other["drift_sigma_ppm"] + 1.0
    assert other["sigma_frames"] < 0.01


def test_without_noise_the_offset_is_exact() -> None:
    take = ml.simulate(
        ml.make_scene("dance", frames=300, offset_frames=-5.25, drift_ppm=0.1, sigma_px=0.0, merge_px=0.0, hide="none")
    )
    other = ml.sync(take.recordings(), take.rig).report["clocks"][1]
    assert abs(other["offset_frames"] + 5.25) < 2e-3


def test_the_merged_take_has_the_truth_of_the_simulated_one(two_clocks: ml.SimulatedTake) -> None:
    merged = ml.sync(two_clocks.recordings(), two_clocks.rig).merged
    truth = two_clocks.observations
    assert len(merged) == len(truth)
    order = [np.lexsort((o.pixel[:, 0], o.camera, o.frame)) for o in (merged, truth)]
    assert np.array_equal(merged.frame[order[0]], truth.frame[order[1]])
    assert np.array_equal(merged.pixel[order[0]], truth.pixel[order[1]])  # no dot is moved in its image
    apart = merged.optional["time_s"][order[0]] - truth.optional["time_s"][order[1]]
    assert np.abs(apart).max() < 0.02 / 100.0


def test_tracking_with_two_clocks_is_as_good_as_with_one(two_clocks: ml.SimulatedTake) -> None:
    one = ml.simulate(ml.make_scene("walk", frames=900, seed=1))
    scores = []
    for take, dots in ((one, one.observations), (two_clocks, ml.sync(two_clocks.recordings(), two_clocks.rig).merged)):
        truth = ml.truth_from_assignments(take.truth, take.truth_assignments, take.rig)
        scores.append(ml.evaluate(ml.track(dots, take.rig), truth, tolerance_mm=25))
    for key in ("ghosts_per_frame", "missing_per_frame"):
        assert scores[1][key] <= scores[0][key] + 0.01
    assert scores[1]["error_mm"]["median"] < 1.1 * scores[0]["error_mm"]["median"]
    assert 0.8 < scores[1]["sigma_ratio"] < 1.25
    # Without their own times the same dots are far worse.
    ignorant = replace(two_clocks.observations, optional={})
    truth = ml.truth_from_assignments(two_clocks.truth, two_clocks.truth_assignments, two_clocks.rig)
    naive = ml.evaluate(ml.track(ignorant, two_clocks.rig), truth, tolerance_mm=25)
    assert naive["error_mm"]["rms"] > 1.5 * scores[1]["error_mm"]["rms"]


def test_live_equals_causal_with_two_clocks(two_clocks: ml.SimulatedTake) -> None:
    dots = two_clocks.observations.select(0, 40)
    taken = ml.track(dots, two_clocks.rig, causal=True)
    tracker = ml.Tracker(two_clocks.rig, rate_hz=100.0)
    for frame in range(40):
        rows = dots.frame == frame
        by_camera = {c: dots.pixel[rows & (dots.camera == i)] for i, c in enumerate(dots.camera_ids)}
        time_s = {
            c: float(dots.optional["time_s"][rows & (dots.camera == i)][0])
            for i, c in enumerate(dots.camera_ids)
            if (rows & (dots.camera == i)).any()
        }
        pushed = tracker.push(by_camera, frame=frame, time_s=time_s)
        own = taken.frame == frame
        assert np.array_equal(pushed.tracks, taken.track[own])
        assert np.array_equal(pushed.points_mm, taken.xyz_mm[own])


def test_recordings_numbered_apart_are_numbered_anew(two_clocks: ml.SimulatedTake) -> None:
    parts = ml.sync(two_clocks.recordings(), two_clocks.rig).recordings
    ids = two_clocks.rig.ids
    both = ml.Observations(
        np.concatenate([p.frame for p in parts]),
        np.concatenate([np.array([ids.index(c) for c in p.camera_ids])[p.camera] for p in parts]),
        tuple(ids),
        np.concatenate([p.pixel for p in parts]),
        optional={"time_s": np.concatenate([p.optional["time_s"] for p in parts])},
        rate_hz=100.0,
    ).select(0, 60)
    points = ml.track(both, two_clocks.rig)
    assert any("numbered anew" in w for w in points.report["warnings"])
    assert points.report["residual_px"]["rms"] < 0.5


def test_clocks_of_single_cameras_and_of_other_rates() -> None:
    take = ml.simulate(ml.make_scene("dance", frames=400, cameras=4, offset_frames=2.6, drift_ppm=-50.0, seed=3))
    synced = ml.sync(take.recordings(), take.rig)
    assert abs(synced.report["clocks"][1]["offset_frames"] - 2.6) < 0.02
    slow = take.recordings()
    slow[1] = replace(slow[1].every(2), frame=slow[1].every(2).frame // 2, frames=np.zeros(0, np.int64), rate_hz=50.0)
    synced = ml.sync(slow, take.rig)
    assert abs(synced.report["clocks"][1]["offset_frames"] - 2.6) < 0.05
    each = replace(take.recordings()[0], source="four")
    by_camera = ml.sync([each], take.rig)
    assert len(by_camera.report["clocks"]) == 2
    assert all(abs(c["offset_frames"]) < 0.02 for c in by_camera.report["clocks"])


def test_what_does_not_move_or_is_another_capture_is_refused(two_clocks: ml.SimulatedTake) -> None:
    first, second = two_clocks.recordings()
    other = ml.simulate(ml.make_scene("dance", frames=900, seed=9, offset_frames=1.0)).recordings()[1]
    with pytest.raises(InputError, match=r"no offset stands out|several offsets"):
        ml.sync([first, other], two_clocks.rig)
    still = [r.select(10, 11) for r in (first, second)]
    frozen = [
        replace(
            s,
            frame=np.repeat(np.arange(200), len(s)),
            camera=np.tile(s.camera, 200),
            pixel=np.tile(s.pixel, (200, 1)),
            frames=np.zeros(0, np.int64),
        )
        for s in still
    ]
    with pytest.raises(InputError, match=r"stands still|move too little|no offset"):
        ml.sync(frozen, two_clocks.rig)
    with pytest.raises(InputError, match="--calibration"):
        ml.sync([first, second])
    with pytest.raises(InputError, match="several recordings"):
        ml.sync([first, first], two_clocks.rig)


def test_offsets_by_hand_need_no_cameras(two_clocks: ml.SimulatedTake) -> None:
    first, second = two_clocks.recordings()
    second = replace(second, source="right.parquet")
    synced = ml.sync([first, second], offsets={"right": 3.5})
    clock = synced.report["clocks"][1]
    assert clock["way"] == "hand"
    assert np.isclose(clock["offset_frames"], 3.5)
    assert np.allclose(synced.recordings[1].optional["time_s"], (second.frame + 3.5) / 100.0)
    with pytest.raises(InputError, match="no such camera"):
        ml.sync([first, second], offsets={"middle": 3.5})


def _with_flashes(take: ml.Observations, frames: list[int]) -> ml.Observations:
    """A flash fills every camera with false dots for one frame."""
    random = np.random.default_rng(0)
    cameras = np.unique(take.camera)
    frame = np.repeat(frames, 40 * len(cameras))
    camera = np.tile(np.repeat(cameras, 40), len(frames))
    pixel = random.uniform(0, 1000, (len(frame), 2))
    order = np.argsort(np.concatenate([take.frame, frame]), kind="stable")
    return replace(
        take,
        frame=np.concatenate([take.frame, frame])[order],
        camera=np.concatenate([take.camera, camera])[order],
        pixel=np.concatenate([take.pixel, pixel])[order],
    )


def test_flashes_that_all_saw(two_clocks: ml.SimulatedTake) -> None:
    first, second = (replace(r, optional={}) for r in two_clocks.recordings())
    lit = [_with_flashes(first, [100, 700]), _with_flashes(second, [97, 697])]
    clock = ml.sync(lit, by="flash").report["clocks"][1]
    assert abs(clock["offset_frames"] - 3.0) < 0.01
    assert 0.1 < clock["sigma_frames"] < 0.5
    with pytest.raises(InputError, match="no flash"):
        ml.sync([first, second], by="flash")


def test_a_clap_is_found_where_a_fast_dot_stops() -> None:
    def recording(camera: str, stop: int) -> ml.Observations:
        frame = np.arange(200)
        x = 100.0 + 4.0 * np.minimum(frame, stop)
        return ml.Observations(
            frame, np.zeros(200, np.int64), (camera,), np.column_stack([x, 300.0 + 0 * x]), rate_hz=50.0
        )

    clock = ml.sync([recording("a", 120), recording("b", 80)], by="clap").report["clocks"][1]
    assert abs(clock["offset_frames"] - 40.0) < 1.01


def test_time_codes(tmp_path: Path) -> None:
    assert np.allclose(seconds(["01:00:00:12", ""], rate=25.0), [3600.48, np.nan], equal_nan=True)
    assert np.isclose(seconds(["00:10:00;00"], rate=30.0)[0], 600.0, atol=1e-3)  # dropped numbers keep time
    with pytest.raises(InputError, match="no time code"):
        seconds(["12:30"])
    rows = {"a": 10, "b": 4}
    paths = []
    for camera, start in rows.items():
        path = tmp_path / f"{camera}.csv"
        lines = [f"{n},{camera},{100 + n},50,10:00:{start + n // 25:02d}:{n % 25:02d}" for n in range(75)]
        path.write_text("frame,camera,x,y,timecode\n" + "\n".join(lines) + "\n")
        paths.append(replace(ml.read_observations(path), rate_hz=25.0))
    clock = ml.sync(paths, by="timecode").report["clocks"][1]
    assert abs(clock["offset_frames"] + 6 * 25) < 1e-6


def test_the_command_line_writes_one_file_or_each(two_clocks: ml.SimulatedTake, tmp_path: Path) -> None:
    ml.save(two_clocks, tmp_path)
    inputs = [str(tmp_path / f"recording_{n}.parquet") for n in (1, 2)]
    calibration = ["--calibration", str(tmp_path / "calibration.toml")]
    done = CliRunner().invoke(app, ["sync", *inputs, *calibration, "-o", str(tmp_path / "both.parquet")])
    assert done.exit_code == 0, done.output
    assert "+3.37" in done.output or "+3.36" in done.output
    each = [str(tmp_path / f"timed_{n}.csv") for n in (1, 2)]
    arguments = ["sync", *inputs, "--offset", "recording_2=3.37", "-o", each[0], "-o", each[1], "--quiet"]
    assert CliRunner().invoke(app, arguments).exit_code == 0
    timed = ml.read_observations(each[1])
    assert np.allclose(timed.optional["time_s"], (timed.frame + 3.37) / 100.0)
    bad = CliRunner().invoke(app, ["sync", *inputs, "--offset", "x", "-o", str(tmp_path / "b.parquet")])
    assert bad.exit_code == 1 or isinstance(bad.exception, InputError)


def test_what_knows_no_time_says_so(two_clocks: ml.SimulatedTake) -> None:
    dots = two_clocks.observations.select(0, 30)
    points = ml.reconstruct(dots, two_clocks.rig)
    assert any("different moments" in w for w in points.report["warnings"])
    with pytest.raises(InputError, match="different moments"):
        ml.refine_rig(two_clocks.rig, dots)
    with pytest.raises(InputError, match="different moments"):
        ml.check_rig(two_clocks.rig, dots)
    with pytest.raises(InputError, match="one clock only"):
        ml.track(dots, two_clocks.rig, method="paper")


def test_two_simulated_clocks_survive_a_file(two_clocks: ml.SimulatedTake, tmp_path: Path) -> None:
    write_observations(two_clocks.observations, tmp_path / "dots.parquet")
    assert np.array_equal(
        ml.read_observations(tmp_path / "dots.parquet").optional["time_s"], two_clocks.observations.optional["time_s"]
    )
