"""Clips joined, mixed, mirrored, looped, and walks through libraries of clips."""

import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import markerloom as ml
from markerloom.errors import FormatError, InputError
from markerloom.motion.alike import laid
from markerloom.motion.graph import pruned
from markerloom.motion.library import Transition
from markerloom.skeleton import Motion
from motion_clips import walk, with_limbs


@pytest.fixture(scope="module")
def clips() -> list[Motion]:
    """Walks of other steps, elsewhere and facing elsewhere."""
    other = laid(walk(4.0, step_m=0.38, period_s=1.2), 1.1, (2.0, -1.0))
    third = laid(walk(3.0, step_m=0.42, period_s=1.0), -2.0, (-1.0, 3.0))
    return [walk(4.0), replace(other, source="other"), replace(third, source="third")]


def sharpest(report: dict[str, list[dict[str, float]]]) -> float:
    return max(j["sharpness"] for j in report["joins"])


def test_a_fade_that_needs_room_is_where_there_is_room() -> None:
    # Over 0.4 s these walks are most alike at the end of the first, where no longer fade fits.
    out = ml.motion.blend(walk(), walk(4.0, step_m=0.35, period_s=1.4))
    (join,) = out.report["joins"]
    assert join["sharpness"] <= 1.3
    assert join["to"] - join["from"] > 24
    assert out.report["leave"] == join["from"]


def test_likeness_does_not_see_place_and_heading(clips: list[Motion]) -> None:
    a = clips[0]
    moved = laid(a, 2.0, (5.0, -3.0))
    table = ml.motion.distances(a, moved)
    assert np.abs(np.diag(table)).max() < 1e-6
    assert np.abs(np.diag(ml.motion.distances(a, moved, "dof"))).max() < 1e-6
    assert table[0, 15] > 0.05


def test_a_blend_is_as_smooth_as_its_clips(clips: list[Motion]) -> None:
    for measure in ("cloud", "dof"):
        out = ml.motion.blend(clips[0], clips[1], measure=measure)
        assert out.report["distance"] < 0.15
        assert sharpest(out.report) <= 1.5
        assert out.report["slide_mm"] <= 2.0
        leave = out.report["leave"]
        assert np.linalg.norm(np.diff(out.motion.root_m[:, :2], axis=0), axis=1).max() < 0.05
        assert np.allclose(out.motion.joints_m()[: leave - 30], clips[0].joints_m()[: leave - 30], atol=0.02)


def test_clips_one_after_the_other(clips: list[Motion]) -> None:
    out = ml.motion.concatenate(clips)
    total = sum(len(c) for c in clips)
    faded = sum(j["to"] - j["from"] for j in out.report["joins"])
    assert len(out.motion) == total - faded
    assert sharpest(out.report) <= 1.5
    assert out.report["slide_mm"] <= 2.0


def test_through_a_neutral_pose(clips: list[Motion]) -> None:
    out = ml.motion.through_neutral(clips[:2], hold_s=0.5)
    stands = np.abs(out.motion.turns[:, 5] - np.eye(3)).max(axis=(1, 2)) < 1e-9
    assert stands.sum() >= 0.5 * 60
    assert sharpest(out.report) <= 2.0
    with pytest.raises(InputError, match="frame 999 of a clip"):
        ml.motion.through_neutral(clips[:2], clips[0], at=999)


def test_a_walk_between_two_walks(clips: list[Motion]) -> None:
    a = ml.motion.crop(clips[0], to_s=3.3).motion
    b = ml.motion.crop(clips[1], to_s=3.6).motion
    only = ml.motion.mix([a, b], [1.0, 0.0], hold_feet=False).motion
    assert np.abs(only.turns - a.turns).max() < 1e-9
    assert np.abs(only.root_m - a.root_m).max() < 1e-9
    half = ml.motion.mix([a, b], [0.5, 0.5])
    way = [float(np.linalg.norm(np.ptp(m.root_m[:, :2], axis=0))) / len(m) for m in (a, b, half.motion)]
    assert min(way[:2]) < way[2] < max(way[:2])
    assert len(a) < len(half.motion) < len(b)
    assert half.report["slide_mm"] <= 1.0
    for weights, said in (([1.0], "a weight for each"), ([0.0, 0.0], "not all of them 0"), ([-1.0, 2.0], "from 0")):
        with pytest.raises(InputError, match=said):
            ml.motion.mix([a, b], weights)


def test_a_mirror(clips: list[Motion]) -> None:
    a = clips[0]
    out = ml.motion.mirror(a)
    assert out.report["pairs"] == 7
    assert out.report["off_mirror_mm"] < 1e-6
    names = a.skeleton.joints
    left, right = names.index("LeftHand"), names.index("RightHand")
    flipped = a.joints_m() * [-1.0, 1.0, 1.0]
    assert np.allclose(out.motion.joints_m()[:, left], flipped[:, right], atol=1e-9)
    assert np.abs(ml.motion.mirror(out.motion).motion.turns - a.turns).max() < 1e-9
    nameless = replace(a, skeleton=replace(a.skeleton, joints=tuple(f"p{j}" for j in range(len(names)))))
    with pytest.raises(InputError, match="no joint of 'figure' has a fellow"):
        ml.motion.mirror(nameless)


def test_a_loop_goes_round(clips: list[Motion]) -> None:
    out = ml.motion.loop(clips[0], times=3, length_s=0.3)
    period = out.report["stop"] - out.report["start"]
    assert len(out.motion) == 3 * period
    assert period / 66 == pytest.approx(round(period / 66), abs=0.05)
    assert sharpest(out.report) <= 1.5
    assert np.abs(out.motion.turns[period, 5:] - out.motion.turns[0, 5:]).max() < 0.05
    spot = ml.motion.loop(clips[0], times=3, length_s=0.3, on_the_spot=True).motion
    assert np.ptp(spot.root_m[:, 1]) < 0.2
    with pytest.raises(InputError, match="is not in a clip"):
        ml.motion.loop(clips[0], start=0, stop=999)


def test_a_crop_and_the_spot(clips: list[Motion]) -> None:
    part = ml.motion.crop(clips[0], from_s=1.0, to_s=2.0).motion
    assert len(part) == 60
    assert part.first_frame == 60
    assert np.array_equal(part.turns, clips[0].turns[60:120])
    with pytest.raises(InputError, match="nothing from frame 5 to before frame 999"):
        ml.motion.crop(clips[0], start=5, stop=999)
    still = ml.motion.in_place(clips[0])
    assert still.report["travel_m"] > 2.0
    assert np.ptp(still.motion.root_m[:, 1]) < 0.2


def test_clips_that_cannot_be_joined(clips: list[Motion]) -> None:
    a = clips[0]
    with pytest.raises(InputError, match="60 and 30 frames per second; resample one first"):
        ml.motion.blend(a, walk(4.0, 30.0))
    with pytest.raises(InputError, match="times as large as the other: say the units"):
        ml.motion.blend(a, replace(a, skeleton=a.skeleton.scaled(0.01), root_m=a.root_m * 0.01))
    with pytest.raises(InputError, match="retarget one onto the other first"):
        ml.motion.concatenate([a, replace(a, skeleton=with_limbs(a.skeleton, 0.9))])
    renamed = replace(a.skeleton, joints=("Pelvis", *a.skeleton.joints[1:]))
    with pytest.raises(InputError, match=r"the skeletons differ \(Hips, Pelvis\)"):
        ml.motion.mix([a, replace(a, skeleton=renamed)], [0.5, 0.5])
    with pytest.raises(InputError, match="too short"):
        ml.motion.blend(a.select(0, 10), a)
    with pytest.raises(InputError, match="two clips or more"):
        ml.motion.concatenate([a])


def test_a_graph_keeps_what_leads_back() -> None:
    def move(a: int, i: int, b: int, j: int) -> Transition:
        return Transition(a, i, b, j, 0.0, 0.0, (0.0, 0.0))

    moves = [move(0, 50, 1, 5), move(1, 60, 0, 10), move(1, 70, 2, 5)]
    assert pruned(moves, 4) == moves[:2]
    assert pruned(moves[:1], 4) == []


@pytest.fixture(scope="module")
def library(clips: list[Motion]) -> ml.motion.Library:
    return ml.motion.build(clips)


def test_a_library_on_disk(library: ml.motion.Library, tmp_path: Path) -> None:
    path = tmp_path / "library.sqlite"
    ml.motion.write_library(library, path)
    again = ml.motion.read_library(path)
    assert again.transitions == library.transitions
    assert again.plants == library.plants
    assert all(np.abs(a.turns - b.turns).max() < 1e-12 for a, b in zip(again.clips, library.clips, strict=True))
    shifted = laid(library.clips[1], 0.7, (3.0, 1.0))
    best = ml.motion.find(path, shifted, 100)[0]
    assert (best.clip, best.frame) == (1, 100)
    assert best.distance_m < 1e-6
    with pytest.raises(InputError, match="frame 999 is not in the clip"):
        ml.motion.find(path, shifted, 999)


def test_a_file_that_is_no_library(tmp_path: Path) -> None:
    path = tmp_path / "no.sqlite"
    path.write_bytes(b"not a database at all, but long enough to be looked at" * 20)
    with pytest.raises(FormatError, match="is no library of clips"):
        ml.motion.read_library(path)
    empty = tmp_path / "empty.sqlite"
    sqlite3.connect(empty).close()
    with pytest.raises(FormatError, match="is no library of clips"):
        ml.motion.read_library(empty)
    with pytest.raises(InputError, match="is not there"):
        ml.motion.read_library(tmp_path / "gone.sqlite")


def test_a_random_walk(library: ml.motion.Library) -> None:
    out = ml.motion.walk(library, 20.0, seed=3)
    assert len(out.motion) == 1200
    assert out.report["slide_mm"] <= 2.0
    assert sharpest(out.report) <= 1.5
    assert np.array_equal(ml.motion.walk(library, 20.0, seed=3).motion.turns, out.motion.turns)
    assert not np.array_equal(ml.motion.walk(library, 20.0, seed=4).motion.root_m, out.motion.root_m)


def test_along_a_line(library: ml.motion.Library) -> None:
    out = ml.motion.follow(library, np.array([[0.0, 0.0], [5.0, 0.0]]))
    assert out.report["off_line_m"]["rms"] < 0.3
    assert np.linalg.norm(out.motion.root_m[-1, :2] - [5.0, 0.0]) < 0.5
    assert out.report["slide_mm"] <= 2.0
    for line, said in (([[0.0, 0.0]], "two points or more"), ([[0.0, 0.0], [0.0, 0.0]], "no length")):
        with pytest.raises(InputError, match=said):
            ml.motion.follow(library, np.array(line))


def test_libraries_that_cannot_be(clips: list[Motion]) -> None:
    with pytest.raises(InputError, match="a library needs two clips or more"):
        ml.motion.build(clips[:1])
    with pytest.raises(InputError, match="is there twice"):
        ml.motion.build([clips[0], clips[0]])
    with pytest.raises(InputError, match="too short for a library"):
        ml.motion.build([clips[0], replace(clips[1].select(0, 20), source="short")])
    with pytest.raises(InputError, match="no moments of these clips are alike enough"):
        ml.motion.build(clips, threshold_m=1e-6)


def test_a_walk_through_real_clips(data: Path) -> None:
    clips = [ml.read_motion(data / f"asf-amc/{name}.amc") for name in ("02_01", "02_03", "02_04")]
    library = ml.motion.build(
        [*clips, *(replace(ml.motion.mirror(c).motion, source=f"{c.source}-mirror") for c in clips)]
    )
    out = ml.motion.walk(library, 15.0, seed=1)
    assert out.report["slide_mm"] <= 2.0
    assert sharpest(out.report) <= 1.5
