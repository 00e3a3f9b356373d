"""Bands, warping and timing: what is not asked to change does not, what is asked is met exactly."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import markerloom as ml
from markerloom import _core
from markerloom.errors import FormatError, InputError
from markerloom.motion.keys import frame_at
from markerloom.motion.rotations import about, exp, reference
from markerloom.skeleton import Motion
from motion_clips import about_x, walk


@pytest.fixture(scope="module")
def clip() -> Motion:
    return walk()


@given(st.integers(1, 200), st.integers(1, 5), st.integers(0, 10**6))
@settings(max_examples=30, deadline=None)
def test_bands_add_up_and_unit_gains_give_the_signal(frames: int, channels: int, seed: int) -> None:
    values = np.random.default_rng(seed).normal(size=(frames, channels)).cumsum(axis=0)
    bands = _core.band_count(frames)
    assert np.abs(_core.split_bands(values, bands).sum(axis=0) - values).max() < 1e-11
    again = _core.equalise_bands(values, np.ones((bands + 1, channels)))
    assert np.sqrt(((again - values) ** 2).mean()) <= 1e-12


def test_a_band_is_the_kernels_of_the_paper() -> None:
    values = np.zeros((33, 1))
    values[16] = 1.0
    bands = _core.split_bands(values, 2)
    kernel = np.zeros(33)
    kernel[14:19] = [1 / 16, 1 / 4, 3 / 8, 1 / 4, 1 / 16]
    spread = np.zeros(33)
    spread[[12, 14, 16, 18, 20]] = [1 / 16, 1 / 4, 3 / 8, 1 / 4, 1 / 16]
    assert np.allclose(bands[0, :, 0], values[:, 0] - kernel, atol=1e-15)
    assert np.allclose(bands[2, :, 0], np.convolve(kernel, spread, mode="same"), atol=1e-15)


def test_unit_gains_leave_a_motion(clip: Motion) -> None:
    out = ml.motion.bands(clip, root=True).motion
    assert np.sqrt(((out.turns - clip.turns) ** 2).mean()) <= 1e-12
    assert np.sqrt(((out.root_m - clip.root_m) ** 2).mean()) <= 1e-12


def test_only_chosen_joints_change_and_the_ends_stay(clip: Motion) -> None:
    out = ml.motion.bands(clip, hz=[(0.0, 30.0, 2.0)], joints=["arms"]).motion
    names = clip.skeleton.joints
    arms = [j for j, n in enumerate(names) if "Arm" in n or "Hand" in n]
    others = [j for j in range(len(names)) if j not in arms]
    assert np.array_equal(out.turns[:, others], clip.turns[:, others])
    assert np.abs(out.turns[:, arms] - clip.turns[:, arms]).max() > 0.1
    assert np.allclose(out.turns[[0, -1]], clip.turns[[0, -1]], atol=1e-12)


def test_a_gain_of_two_doubles_a_fast_turn() -> None:
    clip = walk(2.0)
    at = np.arange(len(clip)) / clip.rate_hz
    shake = 0.05 * np.sin(2 * np.pi * 12.0 * at)
    j = clip.skeleton.index("Head")
    turns = clip.turns.copy()
    turns[:, j] = about_x(shake)
    out = ml.motion.bands(replace(clip, turns=turns), hz=[(5.0, 30.0, 2.0)], joints=["Head"]).motion
    angle = Rotation.from_matrix(out.turns[20:-20, j]).as_rotvec()[:, 0]
    assert np.abs(angle - 2.0 * shake[20:-20]).max() < 0.25 * 0.05


def test_somebody_who_spins_has_no_jumps() -> None:
    """Three whole turns: no pose is near all of them, their own smoothed path is."""
    frames = 240
    turns = Rotation.from_euler(
        "zx", np.stack([np.linspace(0, 6 * np.pi, frames), 0.2 * np.sin(np.arange(frames))], axis=1)
    )
    spin = turns.as_matrix()
    where = reference(spin)
    vectors = about(where, spin)
    assert where.shape == spin.shape
    assert np.linalg.norm(np.diff(vectors, axis=0), axis=1).max() < 1.0
    assert np.abs(where @ exp(vectors) - spin).max() < 1e-12


def test_styles_do_what_they_say(clip: Motion) -> None:
    def liveliness(motion: Motion) -> float:
        return float(ml.motion.accelerations(motion).mean())

    calm = ml.motion.bands(clip, preset="calmer").motion
    lively = ml.motion.bands(clip, preset="livelier").motion
    assert liveliness(calm) < 0.8 * liveliness(clip) < liveliness(clip) * 1.1 < liveliness(lively)


def test_waveshaping_limits_a_joint(clip: Motion) -> None:
    curve = [(-60.0, -12.0), (-10.0, -9.0), (0.0, 0.0), (10.0, 9.0), (60.0, 12.0)]
    j = clip.skeleton.index("LeftArm")
    out = ml.motion.bands(clip, shape={"LeftArm": curve}).motion
    where = reference(clip.turns[:, j])
    assert np.abs(np.rad2deg(about(where, clip.turns[:, j]))).max() > 20.0
    assert np.abs(np.rad2deg(about(where, out.turns[:, j]))).max() < 12.0


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"hz": [(200.0, 300.0, 1.0)]}, "no band lies in"),
        ({"gains": {99: 1.0}}, "there is no band 99"),
        ({"preset": "angrier"}, "there is no preset 'angrier'"),
        ({"joints": ["Tail"]}, "no joint or group 'Tail'"),
        ({"gains": {0: float("nan")}}, "gains are numbers"),
        ({"shape": {"Head": [(0.0, 1.0)]}}, "two or more pairs"),
    ],
)
def test_bad_wishes_for_bands(clip: Motion, asked: dict[str, object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        ml.motion.bands(clip, **asked)  # pyright: ignore[reportArgumentType]


def test_without_keys_nothing_changes(clip: Motion) -> None:
    for by in ("shift", "scale"):
        out = ml.motion.warp(clip, [], by=by).motion
        assert np.array_equal(out.turns, clip.turns)
        assert np.array_equal(out.root_m, clip.root_m)


@given(st.integers(0, 10**6), st.sampled_from(["shift", "scale"]))
@settings(max_examples=20, deadline=None)
def test_keys_are_hit_and_far_frames_stay(seed: int, by: str) -> None:
    clip = walk(3.0)
    rng = np.random.default_rng(seed)
    frames = sorted(rng.choice(np.arange(60, 120), 3, replace=False).tolist())
    names = ["LeftArm", "Spine"]
    keys = [ml.motion.by_angles(clip, f, {n: rng.uniform(-70, 70, 3).tolist() for n in names}) for f in frames]
    keys.append(ml.motion.Key(frames[1], {}, np.array([0.3, np.nan, 1.0])))
    out = ml.motion.warp(clip, keys, by=by, reach_s=0.5)
    missed = ml.motion.key_error(out.motion, keys)
    assert missed["rad"] <= 1e-9
    assert missed["m"] <= 1e-9
    assert np.array_equal(out.motion.turns[:25], clip.turns[:25])
    assert np.array_equal(out.motion.turns[155:], clip.turns[155:])


def test_warping_keeps_the_detail(clip: Motion) -> None:
    """Between keys the change is slow: what is fast in the motion stays as it is."""
    j = clip.skeleton.index("LeftArm")
    key = ml.motion.by_angles(clip, 120, {"LeftArm": [0.0, 40.0, 0.0]})
    out = ml.motion.warp(clip, [key]).motion
    off = Rotation.from_matrix(np.swapaxes(clip.turns[:, j], 1, 2) @ out.turns[:, j]).as_rotvec()
    assert np.linalg.norm(np.diff(off, n=2, axis=0), axis=1).max() < 1e-3


def test_a_hand_reaches_its_place(clip: Motion) -> None:
    place = clip.joints_m()[100, clip.skeleton.index("LeftHand")] + np.array([-0.05, -0.1, 0.1])
    key = ml.motion.by_reach(clip, 100, {"LeftHand": (1000.0 * place).tolist()})
    out = ml.motion.warp(clip, [key], reach_s=0.4).motion
    assert np.linalg.norm(out.joints_m()[100, clip.skeleton.index("LeftHand")] - place) < 1e-9
    moved = {clip.skeleton.joints[j] for j in key.turns}
    assert moved <= {"LeftArm", "LeftForeArm", "LeftHand"}
    with pytest.raises(InputError, match="cannot reach its place in frame 100"):
        ml.motion.by_reach(clip, 100, {"LeftHand": [0.0, 0.0, 9000.0]})


def test_keys_from_a_file_and_from_another_clip(clip: Motion, tmp_path: Path) -> None:
    other = ml.motion.bands(clip, preset="livelier").motion
    ml.write_motion(other, tmp_path / "other.bvh")
    (tmp_path / "keys.toml").write_text(
        "[[keys]]\ntime_s = 1.0\nangles_deg = { Head = [10, 0, 20] }\nroot_mm = [0, -500, 900]\n"
        '[[keys]]\nframe = 150\nfrom = "other.bvh"\nfrom_frame = 20\nonly = ["arms"]\n'
    )
    keys = ml.motion.read_keys(tmp_path / "keys.toml", clip)
    out = ml.motion.warp(clip, keys).motion
    arm = clip.skeleton.index("RightForeArm")
    assert np.allclose(out.turns[150, arm], other.turns[20, arm], atol=1e-6)
    assert np.allclose(out.root_m[60], [0.0, -0.5, 0.9])


def test_bad_keys(clip: Motion, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is not in the clip, which has 240 frames"):
        ml.motion.warp(clip, [ml.motion.by_angles(clip, frame_at(clip, time_s=99.0), {"Head": [0, 0, 0]})])
    with pytest.raises(InputError, match="the clip has 240 frames"):
        ml.motion.warp(clip, [ml.motion.Key(999)])
    keys = [ml.motion.by_angles(clip, 10, {"Head": [0, 0, angle]}) for angle in (0.0, 5.0)]
    with pytest.raises(InputError, match="contradict each other: joint 'Head' in frame 10"):
        ml.motion.warp(clip, keys)
    with pytest.raises(InputError, match="joint 'Tail', which is not there"):
        ml.motion.by_angles(clip, 3, {"Tail": [0, 0, 0]})
    for text, said in (("keys = 3", r"no \[\[keys\]\]"), ("[[keys]]\nframe = 1\nangle = 3", "does not know 'angle'")):
        (tmp_path / "keys.toml").write_text(text)
        with pytest.raises(FormatError, match=said):
            ml.motion.read_keys(tmp_path / "keys.toml", clip)


def test_time_goes_through_its_keys(clip: Motion) -> None:
    out = ml.motion.timewarp(clip, [(1.0, 1.5), (2.0, 2.25)]).motion
    for old, new in ((1.0, 1.5), (2.0, 2.25)):
        assert np.allclose(out.turns[round(new * 60)], clip.turns[round(old * 60)], atol=1e-9)
    assert len(out) == len(clip) + 15
    same = ml.motion.timewarp(clip, [(1.0, 1.0)]).motion
    assert np.array_equal(same.turns, clip.turns)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ([(1.0, 2.0), (1.5, 1.0)], "time would run backwards"),
        ([(1.0, 2.0), (1.0, 2.5)], "time would stop or jump"),
        ([(99.0, 1.0)], "is not in the clip"),
        ([(1.0, -1.0)], "backwards"),
    ],
)
def test_time_that_cannot_run(clip: Motion, keys: list[tuple[float, float]], said: str) -> None:
    with pytest.raises(InputError, match=said):
        ml.motion.timewarp(clip, keys)


def test_between_frames_a_motion_is_smooth(clip: Motion) -> None:
    fine = ml.motion.resample(clip, 240.0).motion
    assert np.array_equal(fine.turns[::4], clip.turns)
    truth = walk(4.0, 240.0)
    inner = slice(8, len(fine) - 8)
    assert np.abs(fine.joints_m()[inner] - truth.joints_m()[: len(fine)][inner]).max() < 2e-3
    with pytest.raises(InputError, match="a frame rate is above 0"):
        ml.motion.resample(clip, 0.0)
