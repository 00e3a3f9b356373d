"""C3D: real files survive, other readers agree, kinds and sigmas are exact, damage never crashes."""

from pathlib import Path
from typing import Any

import c3d as py_c3d
import ezc3d
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import markerloom as ml
from markerloom import _core
from markerloom.formats import c3d_file
from markerloom.points import Points

CLEAN = ["nexus-static.c3d", "nexus-walking.c3d", "MH0222_BP06.c3d", "CB_Dynamic0003.c3d"]
RENEWED = ("DATA_START",)  # pointers


def content(file: _core.C3d) -> list[dict[str, Any]]:
    """All parameters but the pointer that writing must renew."""
    return [r for r in file.records() if r["name"] not in RENEWED]


def test_every_real_file_survives_unchanged(data: Path) -> None:
    paths = [p for p in sorted(data.rglob("*")) if p.suffix.lower() == ".c3d" and p.stat().st_size > 0]
    assert len(paths) > 25
    for path in paths:
        first = c3d_file.read_file(path)
        again = _core.C3d.read(first.write())
        assert content(again) == content(first), path
        assert (again.first_frame, again.n_frames, again.rate_hz) == (first.first_frame, first.n_frames, first.rate_hz)
        np.testing.assert_array_equal(again.coordinates(), first.coordinates(), err_msg=path.name)
        np.testing.assert_array_equal(again.residuals(), first.residuals(), err_msg=path.name)
        np.testing.assert_array_equal(again.analog(), first.analog(), err_msg=path.name)
        np.testing.assert_array_equal(again.rotations(), first.rotations(), err_msg=path.name)
        assert again.header[149:] == first.header[149:], path
        assert again.write() == first.write(), path


@pytest.mark.parametrize("name", CLEAN)
def test_ezc3d_reads_the_same_from_what_we_write(data: Path, tmp_path: Path, name: str) -> None:
    first = c3d_file.read_file(data / "c3d" / "gait-labs" / name)
    c3d_file.write_file(first, tmp_path / "a.c3d")
    theirs = ezc3d.c3d(str(tmp_path / "a.c3d"))
    points = theirs["data"]["points"][:3].transpose(2, 1, 0)
    present = first.residuals()[0] >= 0
    np.testing.assert_allclose(points[present], first.coordinates()[present], atol=1e-4)
    assert theirs["parameters"]["POINT"]["LABELS"]["value"] == first.strings("POINT", "LABELS")


@pytest.mark.parametrize("name", CLEAN)
def test_py_c3d_reads_the_same_from_what_we_write(data: Path, tmp_path: Path, name: str) -> None:
    first = c3d_file.read_file(data / "c3d" / "gait-labs" / name)
    c3d_file.write_file(first, tmp_path / "a.c3d")
    with (tmp_path / "a.c3d").open("rb") as handle:
        frames = [points[:, :3].copy() for _, points, _ in py_c3d.Reader(handle).read_frames()]
    present = first.residuals()[0] >= 0
    np.testing.assert_allclose(np.array(frames)[present], first.coordinates()[present], atol=1e-4)


def example(frames: int = 6, tracks: int = 4, **changes: Any) -> Points:
    rng = np.random.default_rng(3)
    frame = np.repeat(np.arange(frames), tracks)
    known: dict[str, Any] = {
        "label": np.tile([f"M{i}" for i in range(tracks)], frames),
        "sigma_mm": rng.uniform(0.1, 2.0, frames * tracks).astype(np.float32).astype(float),
        "kind": rng.integers(0, 4, frames * tracks),
        "residual_mm": rng.uniform(0.0, 1.0, frames * tracks),
        "camera_mask": rng.integers(0, 128, frames * tracks),
        "rate_hz": 120.0,
        "frames": np.arange(frames),
        **changes,
    }
    xyz = rng.normal(0, 1000, (frames * tracks, 3)).astype(np.float32).astype(float)
    return Points.of(frame, np.tile(np.arange(tracks), frames), xyz, **known)


def test_kinds_and_sigmas_are_exact(tmp_path: Path) -> None:
    points = example()
    points.save(tmp_path / "a.c3d")
    again = ml.read_points(tmp_path / "a.c3d")
    np.testing.assert_array_equal(again.kind, points.kind)
    np.testing.assert_array_equal(again.sigma_mm, points.sigma_mm)
    np.testing.assert_array_equal(again.xyz_mm, points.xyz_mm)
    np.testing.assert_array_equal(again.label, points.label)
    assert again.rate_hz == 120.0


def test_residual_words_say_what_was_measured(tmp_path: Path) -> None:
    points = example().keep(np.arange(24) != 5)
    points.save(tmp_path / "a.c3d")
    residual, mask = c3d_file.read_file(tmp_path / "a.c3d").residuals()
    assert residual[1, 1] == -1
    for i in range(len(points)):
        value = residual[points.frame[i], points.track[i]]
        measured = points.kind[i] == 0
        assert (value >= 0.0199) == measured
        assert mask[points.frame[i], points.track[i]] == (points.camera_mask[i] if measured else 0)


def test_more_than_255_labels_and_long_own_group_are_read_by_others(tmp_path: Path) -> None:
    points = example(frames=120, tracks=300)
    points.save(tmp_path / "a.c3d")
    again = ml.read_points(tmp_path / "a.c3d")
    assert sorted(set(again.label)) == sorted({f"M{i}" for i in range(300)})
    np.testing.assert_array_equal(again.sigma_mm, points.sigma_mm)
    theirs = ezc3d.c3d(str(tmp_path / "a.c3d"))["data"]["points"]
    np.testing.assert_allclose(theirs[:3].transpose(2, 1, 0).reshape(-1, 3), points.xyz_mm, rtol=1e-6)


def test_unlabelled_trajectories_are_numbered(tmp_path: Path) -> None:
    points = example(label=np.full(24, "", dtype="<U1"), tracked=False)
    points.save(tmp_path / "a.c3d")
    file = c3d_file.read_file(tmp_path / "a.c3d")
    assert file.strings("POINT", "LABELS") == ["*1", "*2", "*3", "*4"]
    assert not ml.read_points(tmp_path / "a.c3d").tracked


def test_a_c3d_without_a_rate_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ml.InputError, match="--rate-hz"):
        example(rate_hz=None).save(tmp_path / "a.c3d")
    assert not (tmp_path / "a.c3d").exists()


def test_a_file_that_is_cut_off_is_refused(tmp_path: Path) -> None:
    example(frames=200).save(tmp_path / "a.c3d")
    whole = (tmp_path / "a.c3d").read_bytes()
    (tmp_path / "a.c3d").write_bytes(whole[: len(whole) - 6000])
    with pytest.raises(ml.FormatError, match="announces 200 frames and holds"):
        ml.read_points(tmp_path / "a.c3d")


def test_rotations_survive_and_are_those_that_ezc3d_reads(data: Path, tmp_path: Path) -> None:
    first = c3d_file.read_file(data / "c3d" / "ezc3d" / "C3DRotationExample.c3d")
    c3d_file.write_file(first, tmp_path / "a.c3d")
    again = c3d_file.read_file(tmp_path / "a.c3d")
    np.testing.assert_array_equal(again.rotations(), first.rotations())
    theirs = ezc3d.c3d(str(tmp_path / "a.c3d"))["data"]["rotations"]
    ours = again.rotations()[:, :, :16].reshape(340, 21, 4, 4)
    np.testing.assert_allclose(theirs, ours.transpose(3, 2, 1, 0), rtol=1e-6)


@settings(max_examples=300, deadline=None)
@given(st.integers(0, 3000), st.binary(min_size=1, max_size=8), st.integers(1, 10_000))
def test_damaged_bytes_give_an_error_or_a_file(at: int, patch: bytes, length: int) -> None:
    file = _core.C3d.empty(100.0, 1)
    file.set_ints("POINT", "USED", [2])
    file.set_floats("POINT", "SCALE", [-0.1])
    file.set_strings("POINT", "LABELS", ["A", "B"])
    file.set_points(np.ones((5, 2, 3)), np.ones((5, 2)))
    whole = file.write()
    damaged = bytearray(whole)
    damaged[at % len(whole) : at % len(whole) + len(patch)] = patch
    try:
        again = _core.C3d.read(bytes(damaged[:length]))
    except ml.MarkerloomError:
        return
    assert again.coordinates().size <= len(damaged)
