"""Edits: each does what it says, every one can be taken back, and lists of them are replayed to the same take."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import markerloom as ml
from markerloom.errors import FormatError, InputError
from markerloom.mending import edits as e
from markerloom.mending.feet import marked
from markerloom.mending.operations import apply
from markerloom.mending.sheet import Sheet
from markerloom.skeleton import Contact

FRAMES, RATE_HZ = 400, 100.0


def take(gap: tuple[int, int] | None = None) -> ml.Points:
    """Five markers that swing in front of each other, named A to E, 300 mm apart."""
    time = np.arange(FRAMES) / RATE_HZ
    swing = 80.0 * np.column_stack([np.sin(3.0 * time), np.cos(2.0 * time), 0.3 * np.sin(5.0 * time)])
    rng = np.random.default_rng(1)
    offsets = np.array([[0, 0, 0], [300, 0, 0], [0, 300, 0], [0, 0, 300], [300, 300, 100.0]])
    xyz = swing[:, None] + offsets + rng.normal(0, 0.1, (FRAMES, 5, 3))
    frame, slot = np.meshgrid(np.arange(FRAMES) + 10, np.arange(5), indexing="ij")
    keep = np.ones((FRAMES, 5), bool)
    if gap:
        keep[gap[0] - 10 : gap[1] - 9, 0] = False
    return ml.Points.of(
        frame[keep],
        slot[keep],
        xyz[keep],
        label=np.array(list("ABCDE"))[slot[keep]],
        sigma_mm=np.full(int(keep.sum()), 0.1),
        rays=np.full(int(keep.sum()), 4),
        confidence=np.linspace(0.5, 1.0, int(keep.sum())),
        rate_hz=RATE_HZ,
        source="swing",
    )


def at(points: ml.Points, label: str, frame: int) -> e.At:
    row = np.flatnonzero((points.label == label) & (points.frame == frame))[0]
    x, y, z = points.xyz_mm[row].tolist()
    return e.At(frame=frame, xyz_mm=(x, y, z))


def of(points: ml.Points, label: str) -> dict[int, list[float]]:
    own = points.label == label
    return dict(zip(points.frame[own].tolist(), points.xyz_mm[own].tolist(), strict=True))


def mended(points: ml.Points, *edits: e.PointEdit) -> ml.Mended:
    made = ml.mend(points, ml.EditList(edits=edits))
    assert made.report["unfit"] == []
    assert made.report["applied"] == len(edits)
    return made


def test_no_edit_changes_nothing() -> None:
    points = take(gap=(100, 120))
    same = mended(points)
    for name in ("frame", "track", "label", "xyz_mm", "sigma_mm", "rays", "confidence", "kind", "frames"):
        np.testing.assert_array_equal(getattr(same, name), getattr(points, name), err_msg=name)


def test_two_markers_swapped_over_a_range() -> None:
    points = take()
    within = e.Range(first=50, last=59)
    made = mended(points, e.Swap(at=at(points, "A", 30), other=at(points, "B", 30), within=within))
    for frame in (49, 50, 59, 60):
        mine, theirs = ("B", "A") if 50 <= frame <= 59 else ("A", "B")
        assert of(made, "A")[frame] == of(points, mine)[frame]
        assert of(made, "B")[frame] == of(points, theirs)[frame]
    # Renaming keeps what a sample is and what is known of it.
    assert set(made.kind.tolist()) == {0}
    assert sorted(made.confidence.tolist()) == sorted(points.confidence.tolist())


def test_names_given_and_taken() -> None:
    points = take()
    a = at(points, "A", 30)
    assert set(mended(points, e.Label(at=a, name="HEAD")).label) == {"HEAD", *"BCDE"}
    assert set(mended(points, e.Unlabel(at=a)).label) == {"", *"BCDE"}
    part = mended(points, e.Unlabel(at=a, within=e.Range(first=100, last=199)))
    assert sorted(part.frame[part.label == ""].tolist()) == list(range(100, 200))
    again = mended(
        points,
        e.Unlabel(at=a, within=e.Range(first=100, last=199)),
        e.Label(at=at(points, "A", 150), name="A"),
    )
    assert of(again, "A") == of(points, "A")


def test_split_and_join_are_each_others_way_back() -> None:
    points = take()
    a = at(points, "A", 30)
    parts = mended(points, e.Split(at=a, frame=200))
    assert max(of(parts, "A")) == 199
    assert min(parts.frame[parts.label == ""]) == 200
    whole = mended(points, e.Split(at=a, frame=200), e.Join(at=a, other=at(points, "A", 300)))
    assert of(whole, "A") == of(points, "A")
    assert "" not in whole.label


def test_deleted_and_filled() -> None:
    points = take()
    a = at(points, "A", 30)
    gone = mended(points, e.Delete(at=a, within=e.Range(first=100, last=119)))
    assert not set(range(100, 120)) & set(of(gone, "A"))
    filled = mended(
        points,
        e.Delete(at=a, within=e.Range(first=100, last=119)),
        e.Fill(at=a, within=e.Range(first=100, last=119)),
    )
    own = filled.label == "A"
    new = own & (filled.frame >= 100) & (filled.frame <= 119)
    assert set(filled.kind[new].tolist()) == {2}
    assert np.all(filled.sigma_mm[new] > 0)
    truth = np.array([of(points, "A")[f] for f in range(100, 120)])
    assert np.abs(filled.xyz_mm[new] - truth).max() < 1.0


@pytest.mark.parametrize("method", ["auto", "rigid", "cubic", "pattern"])
def test_a_gap_is_filled_as_the_verb_fills_it(method: str) -> None:
    points = take(gap=(200, 229))
    edit = e.Fill(at=at(points, "A", 199), within=e.Range(first=200, last=229), method=method)
    by_hand, by_verb = mended(points, edit), ml.fill(points, method=method)
    np.testing.assert_array_equal(by_hand.xyz_mm, by_verb.xyz_mm)
    np.testing.assert_array_equal(by_hand.sigma_mm, by_verb.sigma_mm)


def test_only_gaps_that_meet_some_frames_are_filled() -> None:
    points = take(gap=(200, 229))
    points = points.keep((points.label != "A") | (points.frame < 300) | (points.frame > 304))
    assert [g["first"] for g in ml.fill(points, frames=(220, 290)).report["filled"]] == [200]


def test_smoothing_a_range_leaves_the_rest() -> None:
    points = take()
    made = mended(points, e.Smooth(at=at(points, "A", 30), within=e.Range(first=100, last=199)))
    by_verb = ml.smooth(points)
    inside = (made.label == "A") & (made.frame >= 100) & (made.frame < 200)
    assert np.abs(made.xyz_mm[inside] - by_verb.xyz_mm[inside]).max() < 0.01
    np.testing.assert_array_equal(made.xyz_mm[~inside], points.xyz_mm[~inside])
    assert set(made.kind.tolist()) == {0}


def test_a_moved_sample_is_edited() -> None:
    points = take()
    made = mended(points, e.Move(at=at(points, "A", 30), xyz_mm=(1.0, 2.0, 3.0)))
    row = np.flatnonzero((made.label == "A") & (made.frame == 30))[0]
    assert made.xyz_mm[row].tolist() == [1.0, 2.0, 3.0]
    assert made.kind[row] == 3
    assert np.isnan(made.sigma_mm[row])


@pytest.mark.parametrize(
    ("edit", "why"),
    [
        (lambda _: e.Delete(at=e.At(frame=30, xyz_mm=(0, 0, 9000)), within=e.Range(first=1, last=2)), "no marker at"),
        (lambda _: e.Unlabel(at=e.At(frame=9000, xyz_mm=(0, 0, 0))), "not in the take"),
        (lambda p: e.Label(at=at(p, "A", 30), name="B"), "both there in 400 frames"),
        (lambda p: e.Label(at=at(p, "A", 30), name="A"), "already"),
        (lambda p: e.Join(at=at(p, "A", 30), other=at(p, "B", 30)), "both there"),
        (lambda p: e.Swap(at=at(p, "A", 30), other=at(p, "A", 31), within=e.Range(first=1, last=99)), "with itself"),
        (lambda p: e.Split(at=at(p, "A", 30), frame=10), "both sides"),
        (lambda p: e.Delete(at=at(p, "A", 30), within=e.Range(first=5000, last=5001)), "not in the take"),
        (lambda p: e.Fill(at=at(p, "A", 30), within=e.Range(first=50, last=60)), "no gap"),
        (lambda p: e.Fill(at=at(p, "A", 30), within=e.Range(first=50, last=60), method="magic"), "method 'magic'"),
        (lambda p: e.Smooth(at=at(p, "A", 30), within=e.Range(first=50, last=60), cutoff_hz=90), "half the frame rate"),
    ],
)
def test_what_does_not_fit_is_reported_and_changes_nothing(edit, why: str) -> None:
    points = take()
    made = ml.mend(points, ml.EditList(edits=(edit(points),)))
    assert why in made.report["unfit"][0]["reason"]
    assert why in made.report["warnings"][0]
    np.testing.assert_array_equal(made.xyz_mm, points.xyz_mm)
    np.testing.assert_array_equal(made.label, points.label)


def test_two_markers_at_one_place_are_not_guessed() -> None:
    points = take()
    xyz = points.xyz_mm.copy()
    xyz[1] = xyz[0] + 4.0
    twins = ml.Points.of(points.frame, points.track, xyz, rate_hz=RATE_HZ)
    middle = tuple((xyz[0] + 2.0).tolist())
    edit = e.Unlabel(at=e.At(frame=10, xyz_mm=middle))  # pyright: ignore[reportArgumentType]
    assert "two markers" in ml.mend(twins, ml.EditList(edits=(edit,))).report["unfit"][0]["reason"]


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 6), st.integers(0, 4), st.integers(0, 4), st.integers(10, 409)), max_size=6))
def test_everything_can_be_taken_back(steps: list[tuple[int, int, int, int]]) -> None:
    points = take(gap=(100, 110))
    sheet = Sheet.of(points)
    undos = []
    for what, i, j, frame in steps:
        within = e.Range(first=frame, last=min(frame + 40, 409))
        try:
            a, b = sheet.at(i % len(sheet.trajectories), frame), sheet.at(j % len(sheet.trajectories), frame)
            edits = [
                e.Label(at=a, name=f"N{i}", within=within),
                e.Unlabel(at=a, within=within),
                e.Swap(at=a, other=b, within=within),
                e.Split(at=a, frame=frame),
                e.Join(at=a, other=b),
                e.Delete(at=a, within=within),
                e.Move(at=a, xyz_mm=(0.0, 0.0, 5000.0 + i)),
            ]
            undos.append(apply(sheet, edits[what]))
        except InputError:
            continue
    for undo in reversed(undos):
        undo.take_back()
    back = sheet.as_points(points)
    for name in ("frame", "track", "label", "xyz_mm", "kind", "sigma_mm"):
        np.testing.assert_array_equal(getattr(back, name), getattr(points, name), err_msg=name)


def test_lists_survive_the_disk(tmp_path: Path) -> None:
    points = take()
    listed = ml.EditList(
        edits=(
            e.Swap(at=at(points, "A", 30), other=at(points, "B", 30), within=e.Range(first=50, last=59)),
            e.ExcludeRegion(camera="cam1", low=(0, 0), high=(10.5, 20), within=e.Range(first=0, last=9)),
            e.MarkContact(site="l_heel", within=e.Range(first=3, last=9), stands=False),
        )
    )
    ml.write_edits(listed, tmp_path / "a.edits.json")
    assert ml.read_edits(tmp_path / "a.edits.json") == listed
    assert len((tmp_path / "a.edits.json").read_text().splitlines()) == 5


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("{", "not JSON"),
        ('{"version": 2, "edits": []}', "version"),
        ('{"edits": [{"op": "explode"}]}', "edit 1"),
        ('{"edits": [{"op": "split", "at": {"frame": 1, "xyz_mm": [0, 0]}, "frame": 3}]}', "edit 1"),
        ('{"edits": [{"op": "split", "at": {"frame": 1, "xyz_mm": [0, 0, NaN]}, "frame": 3}]}', "edit 1"),
        ('{"edits": [{"op": "label", "at": {"frame": 1, "xyz_mm": [0, 0, 1]}, "name": "*3"}]}', "edit 1"),
        (
            '{"edits": [{"op": "delete", "at": {"frame": 1, "xyz_mm": [0, 0, 1]}, "within": {"first": 9, "last": 3}}]}',
            "9",
        ),
    ],
)
def test_broken_lists_are_refused(tmp_path: Path, text: str, why: str) -> None:
    (tmp_path / "a.edits.json").write_text(text)
    with pytest.raises(FormatError, match=why):
        ml.read_edits(tmp_path / "a.edits.json")


def test_marks_of_contacts_decide_over_what_was_found() -> None:
    found = [Contact("l_heel", 0, 50), Contact("r_heel", 20, 60)]
    marks = [
        e.MarkContact(site="l_heel", within=e.Range(first=10, last=19), stands=False),
        e.MarkContact(site="r_heel", within=e.Range(first=55, last=79)),
    ]
    assert marked(found, marks) == [
        Contact("l_heel", 0, 10),
        Contact("l_heel", 20, 50),
        Contact("r_heel", 20, 55),
        Contact("r_heel", 55, 80),
    ]


def test_excluded_centroids_are_left_out() -> None:
    scene = ml.simulate(ml.make_scene("walk", frames=30, seed=3))
    dots, camera = scene.observations, scene.observations.camera_ids[2]
    one = np.flatnonzero((dots.camera == 2) & (dots.frame == 4))[0]
    pixel = (float(dots.pixel[one, 0]), float(dots.pixel[one, 1]))
    kept, unfit = ml.without_excluded(
        dots,
        [
            e.ExcludeDot(camera=camera, frame=4, pixel=pixel),
            e.ExcludeCamera(camera=camera, within=e.Range(first=10, last=19)),
            e.ExcludeRegion(camera=camera, low=(0, 0), high=(5000, 5000), within=e.Range(first=25, last=25)),
            e.ExcludeDot(camera=camera, frame=4, pixel=(-50.0, -50.0)),
            e.ExcludeCamera(camera="nobody", within=e.Range(first=0, last=1)),
        ],
    )
    own = dots.camera == 2
    gone = own & ((dots.frame >= 10) & (dots.frame <= 19) | (dots.frame == 25))
    assert len(kept) == len(dots) - gone.sum() - 1
    np.testing.assert_array_equal(kept.frames, dots.frames)
    assert [u.split(":")[0] for u in unfit] == [
        "exclusion 4 (exclude_dot) fits nothing",
        "exclusion 5 (exclude_camera) fits nothing",
    ]


def test_a_project_replays_edits(tmp_path: Path) -> None:
    (tmp_path / "takes").mkdir()
    points = take()
    points.save(tmp_path / "takes/swing.parquet")
    (tmp_path / "markerloom.toml").write_text('[settings]\nfill = "none"\n')
    assert ml.process(tmp_path)["takes"][0]["edits"] == 0
    swap = e.Swap(at=at(points, "A", 30), other=at(points, "B", 30), within=e.Range(first=50, last=59))
    ml.write_edits(ml.EditList(edits=(swap,)), tmp_path / "takes/swing.parquet.edits.json")
    row = ml.process(tmp_path)["takes"][0]
    assert (row["edits"], row["ran"]) == (1, ["mend"])
    made = ml.read_points(tmp_path / "results/swing/swing.c3d")
    a = made.xyz_mm[(made.label == "A") & (made.frame == 45)][0]
    np.testing.assert_allclose(a, of(points, "B")[55], atol=1e-3)
    kept = tmp_path / "results/swing/made-with/swing.parquet.edits.json"
    assert json.loads(kept.read_text())["edits"][0]["op"] == "swap"
    (tmp_path / "takes/swing.parquet.edits.json").unlink()
    assert ml.process(tmp_path)["takes"][0]["ran"] == []
    made = ml.read_points(tmp_path / "results/swing/swing.c3d")
    a = made.xyz_mm[(made.label == "A") & (made.frame == 45)][0]
    np.testing.assert_allclose(a, of(points, "A")[55], atol=1e-3)


def test_excluded_centroids_of_a_project_change_what_is_tracked(tmp_path: Path) -> None:
    ml.save(ml.simulate(ml.make_scene("walk", frames=40, seed=3)), tmp_path / "sim")
    (tmp_path / "markerloom.toml").write_text(
        'calibration = "sim/calibration.toml"\n[settings]\nfill = "none"\n'
        '[takes.walk]\nfile = "sim/observations.parquet"\n'
    )
    ml.process(tmp_path)
    before = ml.read_points(tmp_path / "results/walk/track.parquet")
    camera = ml.read_observations(tmp_path / "sim/observations.parquet").camera_ids[0]
    edit = e.ExcludeCamera(camera=camera, within=e.Range(first=0, last=39))
    ml.write_edits(ml.EditList(edits=(edit,)), tmp_path / "sim/observations.parquet.edits.json")
    assert ml.process(tmp_path)["takes"][0]["ran"] == ["track"]
    after = ml.read_points(tmp_path / "results/walk/track.parquet")
    assert after.rays[after.kind == 0].mean() < before.rays[before.kind == 0].mean() - 0.3
