"""Every reason for which a wand calibration is refused, provoked; what is said names the camera and the remedy."""

import copy
import re
from dataclasses import replace

import numpy as np
import pytest

import markerloom as ml
from markerloom.calibrate.verdict import refusals
from test_calibrate import SIZE, calibrate, wave


def kept(take: ml.SimulatedTake, keep: np.ndarray) -> ml.SimulatedTake:
    return replace(take, observations=take.observations._keep(keep))


def shifted(take: ml.SimulatedTake, pixel: np.ndarray) -> ml.SimulatedTake:
    return replace(take, observations=replace(take.observations, pixel=pixel))


def reasons(made: ml.Calibration) -> str:
    assert made.report["verdict"] == "refused"
    return "; ".join(made.report["reasons"])


def test_cameras_that_share_no_view_with_the_others_are_named():
    take = wave(cameras=6, frames=300)
    dots = take.observations
    first = dots.camera < 3
    alone = kept(take, np.where(dots.frame < 150, first, ~first))
    text = reasons(calibrate(alone))
    named = [c for c in take.rig.ids if re.search(f"camera {c} sees the wand in 1[45].? frames, but too seldom", text)]
    assert named in (take.rig.ids[:3], take.rig.ids[3:])
    assert "wave where it and two others see the wand" in text


def test_a_weakly_connected_camera_is_named():
    take = wave(cameras=4, frames=300)
    dots = take.observations
    few = dots.frame % 20 == 0
    near = few & (dots.frame < 300)
    weak = kept(take, (dots.camera != 3) | near)
    text = reasons(calibrate(weak))
    assert "camera cam_03" in text


def test_one_mirrored_camera_is_named():
    take = wave(cameras=5, frames=250)
    pixel = take.observations.pixel.copy()
    own = take.observations.camera == 2
    pixel[own, 0] = SIZE[0] - 1 - pixel[own, 0]
    text = reasons(calibrate(shifted(take, pixel)))
    assert "camera cam_02" in text


def test_a_rig_of_mirrored_images_does_not_pass_the_floor():
    """A flat wand looks the same in a mirror: the handedness shows when the floor is set."""
    take = wave(cameras=5, frames=250)
    pixel = take.observations.pixel.copy()
    pixel[:, 0] = SIZE[0] - 1 - pixel[:, 0]
    made = calibrate(shifted(take, pixel))
    frame = np.array([[0.0, 0.0, 0.0], [400.0, 0.0, 0.0], [0.0, 600.0, 0.0]]) / 1000.0
    mirrored = [
        np.column_stack([SIZE[0] - 1 - seen[:, 0], seen[:, 1]])
        for seen in (take.rig.project(i, frame) for i in range(len(take.rig)))
    ]
    rows = [(f, c, *p) for f in range(5) for c, seen in enumerate(mirrored) for p in seen]
    table = np.array(rows)
    floor = ml.Observations(
        table[:, 0].astype(int), table[:, 1].astype(int), take.observations.camera_ids, table[:, 2:]
    )
    with pytest.raises(ml.InputError, match="below the floor"):
        ml.calibrate_origin(made.rig, floor, ml.Wand("l-frame", ("o", "x", "y"), frame))


def test_wrong_intrinsics_of_one_camera_are_named():
    take = wave(cameras=5, frames=250)
    wrong = replace(take.rig.cameras[1], focal_px=(1500.0, 1500.0))
    intrinsics = replace(take.rig, cameras=tuple(wrong if i == 1 else c for i, c in enumerate(take.rig.cameras)))
    made = ml.calibrate_wand(take.observations, ml.read_wand("vicon-t"), intrinsics=intrinsics)
    text = reasons(made)
    assert "camera cam_01" in text
    assert "its intrinsics are not its own" in text or "of another shape" in text


def test_a_lens_that_folds_over_is_refused():
    made = calibrate(wave())
    lens = ml.Lens("brown_conrady", (-2.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    folded = replace(made.rig.cameras[0], lens=lens)
    rig = replace(made.rig, cameras=(folded, *made.rig.cameras[1:]))
    told = refusals(rig, made.report, {"determined": True, "converged": True}, made.dots_px)
    assert any("camera cam_00: the lens model folds over" in text and "corners" in text for text in told)


def test_two_wands_in_view_are_told():
    take = wave(seed=1)
    other = ml.simulate(replace(take.scene, seed=2)).observations
    dots = take.observations
    both = ml.Observations(
        np.concatenate([dots.frame, other.frame]),
        np.concatenate([dots.camera, other.camera]),
        dots.camera_ids,
        np.concatenate([dots.pixel, other.pixel]),
    )
    with pytest.raises(ml.InputError, match="two wands or more: wave one at a time"):
        ml.calibrate_wand(both, ml.read_wand("vicon-t"), image_sizes=dict.fromkeys(dots.camera_ids, SIZE))


def test_a_wave_that_is_too_fast_is_told():
    """Cameras out of step by up to a tenth of a frame: dots err along the motion."""
    take = wave(cameras=5, frames=300, rate_hz=12.0)
    dots = take.observations
    late = np.random.default_rng(0).uniform(-0.15, 0.15, (take.scene.frames, len(dots.camera_ids)))
    truth = take.truth.xyz_mm.reshape(take.scene.frames, -1, 3) / 1000.0
    speed = np.gradient(truth, axis=0).mean(axis=1)
    pixel = dots.pixel.copy()
    for camera in range(len(dots.camera_ids)):
        own = np.flatnonzero(dots.camera == camera)
        frame = dots.frame[own]
        middle = truth.mean(axis=1)[frame]
        ahead = take.rig.project(camera, middle + speed[frame] * late[frame, camera, None])
        pixel[own] += ahead - take.rig.project(camera, middle)
    text = reasons(calibrate(shifted(take, pixel)))
    assert "too fast" in text
    assert "wave slower" in text


def test_ten_frames_are_too_few():
    with pytest.raises(ml.InputError, match="20 needed"):
        calibrate(wave(frames=10))


def test_a_camera_with_nothing_but_false_dots_is_named():
    take = wave(cameras=5)
    dots = take.observations
    pixel = dots.pixel.copy()
    own = dots.camera == 4
    pixel[own] = np.random.default_rng(1).uniform(0, 1000, (int(own.sum()), 2))
    text = reasons(calibrate(shifted(take, pixel)))
    assert "camera cam_04 never sees the wand whole" in text or "camera cam_04 sees the wand in" in text


@pytest.fixture(scope="module")
def good() -> ml.Calibration:
    made = calibrate(wave())
    assert made.report["verdict"] == "ok"
    return made


@pytest.mark.parametrize(
    ("where", "value", "told"),
    [
        (("cameras", "cam_01", "views"), 31, "camera cam_01 sees the wand in 31 frames (50 needed): wave longer"),
        (("cameras", "cam_01", "coverage"), 0.07, "camera cam_01: the wand visited 7% of its image (10% needed)"),
        (("cameras", "cam_01", "used"), 0.5, "camera cam_01: only 50% of its views of the wand fit the others"),
        (("cameras", "cam_01", "reprojection_px", "median"), 1.2, "camera cam_01: residual 1.20 px, the others'"),
        (
            ("cameras", "cam_01", "position_sigma_mm"),
            90.0,
            "camera cam_01 is weakly connected: its place is known to ± 90",
        ),
        (("wand_length_mm", "relative_spread"), 0.05, "the wand's lengths spread by"),
        (("wand_length_mm", "worst_ratio"), 0.11, "distances on the wand differ from the stated ones by up to 11.0%"),
        (("speed", "along_px"), 2.0, "the wand was waved too fast"),
        (("determined",), False, "the views do not determine all cameras"),
        (("converged",), False, "the adjustment did not settle: wave longer"),
    ],
)
def test_every_reason_is_given_for_its_figure_alone(good: ml.Calibration, where: tuple, value: object, told: str):
    report = copy.deepcopy(good.report)
    solved = {"determined": True, "converged": True}
    assert refusals(good.rig, report, solved, good.dots_px) == []
    inside: dict = solved if where[0] in solved else report
    for key in where[:-1]:
        inside = inside[key]
    inside[where[-1]] = value
    reasons = refusals(good.rig, report, solved, good.dots_px)
    assert len(reasons) == 1
    assert reasons[0].startswith(told)
