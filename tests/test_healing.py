"""A rig that is knocked or has crept: found, named, told of, and mended."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import markerloom as ml
from markerloom import formats
from markerloom.bumped import Moves, between
from markerloom.cli import app

FRAME = 150
TURN_RAD = np.radians(0.3) * np.array([0.6, -0.64, 0.48])
SHIFT_M = 0.005 * np.array([0.48, 0.6, -0.64])


def cameras_of(take: ml.Reconstruction) -> Moves:
    assert isinstance(take, ml.TrackedTake)
    assert take.seen is not None
    return take.seen.cameras


@pytest.fixture(scope="module")
def walk() -> ml.SimulatedTake:
    return ml.simulate(ml.make_scene("walk", frames=300, sigma_px=0.1, seed=5))


@pytest.fixture(scope="module")
def knocked(walk: ml.SimulatedTake) -> tuple[ml.SimulatedTake, ml.Camera]:
    return ml.knock(walk, "cam_03", frame=FRAME, turn_rad=TURN_RAD, shift_m=SHIFT_M)


def test_without_asking_a_knocked_camera_is_only_named(knocked: tuple[ml.SimulatedTake, ml.Camera]) -> None:
    take, _ = knocked
    points = ml.track(take.observations, take.rig)
    (bump,) = points.report["bumped_cameras"]
    assert (bump["camera"], bump["frame"]) == ("cam_03", FRAME)
    assert bump["moved_mm"] == pytest.approx(5.0, abs=0.7)
    assert bump["turned_deg"] == pytest.approx(0.3, abs=0.02)
    assert cameras_of(points).moves == ()
    assert any("--refine-calibration" in text for text in points.report["warnings"])


def test_a_knocked_camera_is_solved_anew_and_no_other_moves(knocked: tuple[ml.SimulatedTake, ml.Camera]) -> None:
    take, after = knocked
    before = ml.track(take.observations, take.rig)
    healed = ml.track(take.observations, take.rig, refine_calibration=True)
    (bump,) = healed.report["bumped_cameras"]
    assert (bump["camera"], bump["frame"]) == ("cam_03", FRAME)
    assert bump["found"] < FRAME + 20
    last = cameras_of(healed).rig_at(take.scene.frames)
    shift_mm, turn_deg = between(last.cameras[3], after)
    assert shift_mm < 0.5
    assert turn_deg < 0.01
    others = [i for i in range(len(last)) if i != 3]
    assert all(last.cameras[i] == take.rig.cameras[i] for i in others)
    assert cameras_of(healed).rig_at(FRAME - 1).cameras == take.rig.cameras
    assert healed.report["rays_mean"] > before.report["rays_mean"] + 0.1
    assert healed.report["refined"]["verdict"] == "refused"


def test_live_a_knocked_camera_is_healed_as_in_a_causal_run(knocked: tuple[ml.SimulatedTake, ml.Camera]) -> None:
    take, _ = knocked
    dots, rig = take.observations, take.rig
    tracker = ml.Tracker(rig, rate_hz=take.scene.rate_hz, refine_calibration=True)
    live = []
    for frame in range(take.scene.frames):
        own = dots.frame == frame
        pushed = {c: dots.pixel[own & (dots.camera == i)] for i, c in enumerate(dots.camera_ids)}
        live.append(tracker.push(pushed, frame=frame).points_mm)
    (move,) = tracker.moves.moves
    assert (move.now.id, move.frame) == ("cam_03", FRAME)
    causal = ml.track(dots, rig, causal=True, refine_calibration=True)
    assert np.array_equal(np.concatenate(live), causal.xyz_mm)
    assert causal.report["bumped_cameras"][0]["frame"] == FRAME


def test_two_cameras_knocked_one_after_the_other_are_both_found(walk: ml.SimulatedTake) -> None:
    once, first = ml.knock(walk, "cam_01", frame=90, turn_rad=-TURN_RAD, shift_m=SHIFT_M)
    twice, second = ml.knock(once, "cam_06", frame=200, turn_rad=TURN_RAD, shift_m=-SHIFT_M)
    healed = ml.track(twice.observations, walk.rig, refine_calibration=True)
    assert [(b["camera"], b["frame"]) for b in healed.report["bumped_cameras"]] == [("cam_01", 90), ("cam_06", 200)]
    last = cameras_of(healed).rig_at(300)
    assert between(last.cameras[1], first)[0] < 0.8
    assert between(last.cameras[6], second)[0] < 0.8


def test_the_paper_takes_the_calibration_as_it_is(walk: ml.SimulatedTake) -> None:
    with pytest.raises(ml.InputError, match="paper"):
        ml.track(walk.observations, walk.rig, method="paper", refine_calibration=True)


def test_a_rig_that_fits_is_left_in_peace(walk: ml.SimulatedTake) -> None:
    report = ml.check_rig(walk.rig, walk.observations)
    assert report["verdict"] == "ok"
    for own in report["cameras"].values():
        assert np.abs(own["bias_px"]).max() < 6 * own["bias_sigma_px"] + 0.01
        assert own["noise_px"] == pytest.approx(0.12, abs=0.04)


def test_a_camera_that_has_crept_is_named_by_the_check(walk: ml.SimulatedTake) -> None:
    crept = walk.rig.cameras[2]
    turned = replace(crept, rotation=Rotation.from_rotvec([0.0, 0.0003, 0.0]).as_matrix() @ crept.rotation)
    rig = replace(walk.rig, cameras=tuple(turned if c is crept else c for c in walk.rig.cameras))
    report = ml.check_rig(rig, walk.observations)
    assert report["verdict"] == "recalibrate"
    worst = max(report["cameras"], key=lambda c: report["cameras"][c]["systematic_px"])
    assert worst == crept.id
    assert any(reason.startswith(f"camera {crept.id}:") for reason in report["reasons"])


def test_on_the_command_line_the_healed_rig_is_written_and_passes_the_check(
    knocked: tuple[ml.SimulatedTake, ml.Camera], tmp_path: Path
) -> None:
    take, after = knocked
    formats.write_observations(take.observations, tmp_path / "take.parquet")
    ml.write_calibration(take.rig, tmp_path / "rig.toml")
    common = [str(tmp_path / "take.parquet"), "--calibration", str(tmp_path / "rig.toml")]
    run = CliRunner()
    out = [str(tmp_path / "points.parquet"), "--rate-hz", "100", "--calibration-out", str(tmp_path / "healed.toml")]
    refused = run.invoke(app, ["track", *common, "-o", *out])
    assert refused.exit_code == 2
    made = run.invoke(app, ["track", *common, "--refine-calibration", "-o", *out])
    assert made.exit_code == 0, made.output
    healed = ml.read_calibration(tmp_path / "healed.toml")
    assert between(healed.cameras[3], after)[0] < 0.5
    later = take.observations.select(FRAME, None)
    formats.write_observations(later, tmp_path / "later.parquet")
    before, good = (
        run.invoke(app, ["calibrate", "check", str(tmp_path / "later.parquet"), "--calibration", str(tmp_path / name)])
        for name in ("rig.toml", "healed.toml")
    )
    assert before.exit_code == 1
    assert good.exit_code == 0, good.output
    assert "the rig fits this take" in good.output


def test_age_and_warmth_are_read_from_xcp(tmp_path: Path) -> None:
    text = """<Cameras><Camera DEVICEID="7" SENSOR_SIZE="100 100" PIXEL_ASPECT_RATIO="1">
    <Calibration END_TEMP="41" END_TIME="2026-02-27 15:25:34.156 ST"/>
    <Capture END_TEMP="49" END_TIME="2026-02-27 17:55:34.156 ST"/>
    <KeyFrames><KeyFrame FOCAL_LENGTH="100" PRINCIPAL_POINT="50 50" ORIENTATION="0 0 0 1" POSITION="0 0 0"/></KeyFrames>
    </Camera></Cameras>"""
    (tmp_path / "rig.xcp").write_text(text)
    (camera,) = ml.read_calibration(tmp_path / "rig.xcp").cameras
    known = camera.conditions
    assert known.captured is not None
    assert known.calibrated is not None
    assert (known.captured - known.calibrated).total_seconds() == 9000.0
    assert (known.calibrated_celsius, known.captured_celsius) == (41.0, 49.0)
