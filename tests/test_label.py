"""Naming: exact without noise, gaps and phantoms, mirror images, T-poses, two people, swaps, wrong input."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import markerloom as ml
from markerloom import _core
from markerloom.subjects.names import other_side, split_prefix
from markerloom.trajectories import Trajectories

RATE = 100.0
DATA = Path(__file__).resolve().parents[2] / "shared/data/labelling"


def figure(motion: str, seed: int, frames: int, *, markers: int = 41, first: int = 0) -> np.ndarray:
    """(frames, markers, 3), mm."""
    poses = [_core.body_pose(motion, markers, seed, (0.0, 0.0, 0.0), (first + i) / RATE)[0] for i in range(frames)]
    return 1000.0 * np.array(poses)


def points_of(xyz_mm: np.ndarray, names: list[str] | None = None, tracks: np.ndarray | None = None) -> ml.Points:
    frames = len(xyz_mm)
    seen = np.isfinite(xyz_mm).all(axis=2)
    frame, slot = np.nonzero(seen)
    label = np.array(names, dtype=str)[slot] if names else np.full(len(frame), "", dtype="<U1")
    track = slot if tracks is None else tracks[frame, slot]
    order = np.lexsort((track, frame))
    return ml.Points.of(
        *(frame[order], track[order].astype(np.int64), xyz_mm[seen][order]),
        label=label[order],
        rate_hz=RATE,
        frames=np.arange(frames),
        source="test",
    )


def names_of(count: int) -> list[str]:
    return [f"M{i:02d}" for i in range(count)]


def shares(named: ml.Points, xyz_mm: np.ndarray, names: list[str]) -> tuple[float, float]:
    """Shares of the true marker-frames with the right name, and with a wrong one."""
    by_name = {(int(f), str(n)): p for f, n, p in zip(named.frame, named.label, named.xyz_mm, strict=True) if n}
    seen = [(f, m) for f in range(len(xyz_mm)) for m in range(len(names)) if np.isfinite(xyz_mm[f, m]).all()]
    right = sum(np.allclose(by_name.get((f, names[m]), np.inf), xyz_mm[f, m]) for f, m in seen)
    taken = {tuple(np.round(xyz_mm[f, m], 6)): names[m] for f, m in seen}
    wrong = sum(
        bool(n) and taken.get(tuple(np.round(p, 6)), n) != n for n, p in zip(named.label, named.xyz_mm, strict=True)
    )
    return right / len(seen), wrong / len(seen)


def broken(xyz_mm: np.ndarray, seed: int) -> np.ndarray:
    """A trajectory number for every sample: cut at random, the pieces numbered at random."""
    rng = np.random.default_rng(seed)
    frames, markers = xyz_mm.shape[:2]
    cuts = rng.random((frames, markers)) < 0.01
    piece = np.cumsum(cuts, axis=0) + 1000 * np.arange(markers)
    _, number = np.unique(piece, return_inverse=True)
    return rng.permutation(number.max() + 1)[number.reshape(frames, markers)]


def test_a_dance_in_pieces_with_phantoms_is_named_whole() -> None:
    xyz_mm, names = figure("dance", 3, 1200), names_of(41)
    subject = ml.create_subject(points_of(xyz_mm[:600], names))
    rng = np.random.default_rng(1)
    later = xyz_mm[600:].copy()
    later[rng.random(later.shape[:2]) < 0.05] = np.nan
    ghosts = np.concatenate([later, np.full((600, 2, 3), np.nan)], axis=1)
    for start in range(0, 600, 40):
        ghosts[start : start + 25, 41:] = xyz_mm[600 + start].mean(axis=0) + rng.normal(0, 300, (2, 3))
    named = ml.label(points_of(ghosts, tracks=broken(ghosts, 2)), subjects=[subject])
    right, wrong = shares(named, later, names)
    assert right > 0.9995
    assert wrong == 0.0
    assert np.nanmean(named.label_probability) > 0.98


def test_a_tracker_that_takes_another_marker_after_a_hole_does_not_mislead() -> None:
    """Carried samples show nobody, and over a hole a trajectory may have gone over to the neighbour."""
    xyz_mm, names = figure("dance", 3, 1200), names_of(41)
    subject = ml.create_subject(points_of(xyz_mm[:600], names))
    later = xyz_mm[600:]
    apart = np.linalg.norm(later[:, :, None] - later[:, None], axis=3).mean(axis=0) + 1e6 * np.eye(41)
    a, b = (int(i) for i in np.unravel_index(apart.argmin(), apart.shape))
    other = next(m for m in range(41) if m not in (a, b))
    shown, kind = later.copy(), np.zeros(later.shape[:2], np.int64)
    shown[213:240, [a, b]] = later[213:240, [b, a]]
    for marker, first, last in ((a, 200, 213), (b, 200, 213), (a, 240, 252), (b, 240, 252), (other, 300, 320)):
        part = np.linspace(0, 1, last - first + 2)[1:-1, None]
        shown[first:last, marker] = (1 - part) * shown[first - 1, marker] + part * shown[last, marker]
        kind[first:last, marker] = 1
    named = ml.label(replace(points_of(shown), kind=kind.ravel()), subjects=[subject])
    measured = named.kind == 0
    off = [np.linalg.norm(later[f, names.index(n)] - p) if n else np.inf for f, n, p in _rows(named, measured)]
    assert max(off) < 1e-9
    carried = {(int(f), n) for f, n, _ in _rows(named, ~measured)}
    assert {n for f, n in carried if f < 300} == {""}
    assert {n for f, n in carried if f >= 300} == {names[other]}


def _rows(points: ml.Points, chosen: np.ndarray) -> list[tuple[int, str, np.ndarray]]:
    return list(zip(points.frame[chosen], points.label[chosen].tolist(), points.xyz_mm[chosen], strict=True))


def test_single_frames_are_named_without_tracking() -> None:
    xyz_mm, names = figure("dance", 0, 1600, markers=53), names_of(53)
    subject = ml.create_subject(points_of(xyz_mm[:1200], names))
    model = _core.LabelModel([0] * 53, subject.distances, subject.heights)
    rng = np.random.default_rng(0)
    right = total = 0
    for frame in range(1200, 1600, 8):
        seen = np.flatnonzero(rng.random(53) > 0.1)
        phantoms = rng.uniform(xyz_mm[frame].min(axis=0), xyz_mm[frame].max(axis=0), (3, 3))
        points = np.vstack([xyz_mm[frame, seen], phantoms]) / 1000.0
        found, _, sides = model.search(np.ascontiguousarray(points))
        right += sum(found[m] == i for i, m in enumerate(seen))
        total += len(seen)
        assert sides[0] > sides[1]
    assert right / total > 0.99


def test_a_mirror_image_is_refused() -> None:
    xyz_mm, names = figure("walk", 1, 900), names_of(41)
    subject = ml.create_subject(points_of(xyz_mm[:600], names))
    with pytest.raises(ml.InputError, match="mirror image"):
        ml.label(points_of(xyz_mm[600:] * [-1.0, 1.0, 1.0]), subjects=[subject])


def test_two_people_keep_their_own_markers() -> None:
    one, two = figure("dance", 4, 700), figure("dance", 9, 700) + np.array([450.0, 0.0, 0.0])
    subjects = [
        replace(ml.create_subject(points_of(x[:400], names_of(41))), name=name) for x, name in ((one, "A"), (two, "B"))
    ]
    both = np.concatenate([one, two], axis=1)[400:]
    names = [f"{who}:{m}" for who in "AB" for m in names_of(41)]
    named = ml.label(points_of(both, tracks=broken(both, 5)), subjects=subjects)
    whose = {tuple(np.round(both[f, m], 6)): names[m][0] for f in range(300) for m in range(82)}
    given = [(whose[tuple(np.round(p, 6))], str(n)) for p, n in zip(named.xyz_mm, named.label, strict=True) if n]
    assert all(who == name[0] for who, name in given)
    # Each figure has two feet with two markers only: which is which is told by the shank alone.
    assert shares(named, both, names)[0] > 0.97


@pytest.mark.parametrize("name", ml.marker_sets())
def test_every_marker_set_is_named_from_a_t_pose(name: str) -> None:
    worn = ml.read_marker_set(name)
    scene = ml.make_scene("walk", marker_set=name, t_pose_s=1.5, frames=500, seed=3)
    truth = ml.simulate(replace(scene, cameras=2, sigma_px=0.0)).truth
    rng = np.random.default_rng(2)
    number = rng.permutation(len(worn))
    anonymous = replace(truth, track=number[truth.track], label=np.full(len(truth), "", dtype="<U1"))
    named = ml.label(anonymous.keep(np.lexsort((anonymous.track, anonymous.frame))), marker_set=worn)
    right, _ = shares(named, Trajectories.of(truth).xyz_mm, list(worn.markers))
    assert right > 0.999


def test_the_live_labeller_finds_names_in_the_middle_of_a_motion_and_keeps_them() -> None:
    xyz_mm, names = figure("dance", 2, 900), names_of(41)
    labeller = ml.Labeller([ml.create_subject(points_of(xyz_mm[:600], names))])
    order = np.random.default_rng(0).permutation(41)
    right = 0
    for i, frame in enumerate(xyz_mm[600:]):
        found, probability = labeller.push(order, frame, time_s=i / RATE)
        assert ((probability >= 0) & (probability <= 1)).all()
        right += sum(a == b for a, b in zip(found, names, strict=True))
    assert right / (300 * 41) > 0.99


def test_swapped_pairs_are_found_and_mended() -> None:
    scene = ml.make_scene("walk", marker_set="plug-in-gait-39", frames=1000, seed=1, cameras=2)
    take = Trajectories.of(ml.simulate(scene).truth)
    xyz_mm = take.xyz_mm.copy()
    for (left, right), first, last in (
        (("LANK", "RANK"), 200, 500),
        (("LFIN", "RFIN"), 100, 400),
        (("LASI", "RASI"), 600, 700),
    ):
        a, b = take.names.index(left), take.names.index(right)
        xyz_mm[first:last, [a, b]] = xyz_mm[first:last, [b, a]]
    points = take.changed(xyz_mm, take.sigma_mm, take.kind).as_points()
    checked = ml.check_labels(points)
    mended = Trajectories.of(ml.repair_labels(points, checked))
    assert {(w.label, w.should, w.first, w.last) for w in checked.wrong if w.label == "LANK"} == {
        ("LANK", "RANK", 200, 499)
    }
    at = [mended.names.index(n) for n in take.names]
    assert np.array_equal(mended.xyz_mm[:, at], take.xyz_mm)


def test_a_clean_take_is_left_alone() -> None:
    xyz_mm, names = figure("dance", 6, 800), names_of(41)
    assert ml.check_labels(points_of(xyz_mm, names)).wrong == []


def test_a_subject_survives_its_file(tmp_path: Path) -> None:
    subject = ml.create_subject(points_of(figure("walk", 1, 300, markers=15), names_of(15)), name='Ånna "x"')
    ml.write_subject(subject, tmp_path / "s.toml")
    again = ml.read_subject(tmp_path / "s.toml")
    assert (again.name, again.markers) == (subject.name, subject.markers)
    for a, b in zip(again.distances, subject.distances, strict=True):
        assert (a is None) == (b is None)
        assert a is None or b is None or np.allclose(a, b, atol=1e-6)
    assert [[h[0] for h in own] for own in again.heights] == [[h[0] for h in own] for own in subject.heights]


def test_wrong_input_is_said_clearly(tmp_path: Path) -> None:
    xyz_mm, names = figure("walk", 1, 400), names_of(41)
    subject = ml.create_subject(points_of(xyz_mm, names))
    with pytest.raises(ml.InputError, match="--units m"):
        ml.label(points_of(xyz_mm / 1000.0), subjects=[subject])
    assert ml.label(points_of(xyz_mm / 1000.0), subjects=[subject], units="m").report["completeness"] > 0.99
    with pytest.raises(ml.InputError, match="does not fit the take"):
        ml.label(points_of(figure("walk", 8, 400)), subjects=[subject])
    with pytest.raises(ml.InputError, match="stands still"):
        ml.label(points_of(xyz_mm), marker_set=ml.read_marker_set("front-waist-53"))
    with pytest.raises(ml.InputError, match="no marker of the take has a name"):
        ml.create_subject(points_of(xyz_mm))
    (tmp_path / "s.toml").write_text("markers = 3\ndistances = []\nheights = []\n")
    with pytest.raises(ml.FormatError, match="damaged"):
        ml.read_subject(tmp_path / "s.toml")
    with pytest.raises(ml.InputError, match="plug-in-gait-39"):
        ml.read_marker_set("nonsense")


def test_markers_gone_for_a_second_are_named_again() -> None:
    xyz_mm, names = figure("walk", 5, 900), names_of(41)
    subject = ml.create_subject(points_of(xyz_mm[:500], names))
    later = xyz_mm[500:].copy()
    later[150:250] = np.nan
    named = ml.label(points_of(later, tracks=broken(later, 1)), subjects=[subject])
    right, _ = shares(named, later, names)
    assert right > 0.999
    assert any("frames have no named marker" in w for w in named.report["warnings"])


def test_names_tell_prefixes_and_sides() -> None:
    assert split_prefix("Anna:LFHD") == ("Anna", "LFHD")
    assert split_prefix("Anna_LFHD", {"LFHD"}) == ("Anna", "LFHD")
    assert split_prefix("foot_l_1") == ("", "foot_l_1")
    names = ["LFHD", "RFHD", "WaistLFront", "WaistRFront", "hand_L", "hand_R", "C7"]
    assert [other_side(n, names) for n in names] == [
        "RFHD",
        "LFHD",
        "WaistRFront",
        "WaistLFront",
        "hand_R",
        "hand_L",
        None,
    ]


@pytest.mark.parametrize("name", ml.marker_sets())
def test_marker_sets_have_sides_that_mirror_each_other(name: str, tmp_path: Path) -> None:
    worn = ml.read_marker_set(name)
    pairs = worn.pairs_of_sides()
    assert len(pairs) >= 6
    assert len(worn) == int(name.rsplit("-", 1)[1])
    ml.write_marker_set(worn, tmp_path / "set.toml")
    again = ml.read_marker_set(tmp_path / "set.toml")
    assert again.markers == worn.markers
    assert np.allclose(again.places, worn.places, atol=1e-4)


@pytest.mark.skipif(not DATA.is_dir(), reason="needs the shared recordings of other systems")
def test_real_takes_are_named_from_other_frames() -> None:
    for file in ("cmu-85_02.c3d", "fullbody-44.c3d"):
        take = Trajectories.of(ml.read_points(DATA / file))
        half = len(take.frames) // 2
        names = [n.split(":")[-1] for n in take.names]
        rate = take.points.rate_hz
        subject = ml.create_subject(replace(points_of(take.xyz_mm[:half], names), rate_hz=rate))
        later = take.xyz_mm[half:]
        named = ml.label(replace(points_of(later, tracks=broken(later, 3)), rate_hz=rate), subjects=[subject])
        right, _ = shares(named, later, names)
        assert right > 0.995, file


@pytest.mark.skipif(not DATA.is_dir(), reason="needs the shared recordings of other systems")
def test_marker_sets_of_other_programs_are_read() -> None:
    drill = ml.read_marker_set(DATA / "drill-markerset.xml")
    assert drill.segments[drill.markers.index("FHD")] == "head"
    vicon = ml.read_marker_set(DATA.parent / "vicon-upper-body/subject.vsk")
    assert vicon.segments[vicon.markers.index("C7")] == "LowerBack"
    assert len(ml.read_marker_set(DATA / "cmu-85_02.c3d")) == 41
