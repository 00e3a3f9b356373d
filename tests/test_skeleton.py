"""Skeletons: H-Anim, fit and solving against simulated truth, contacts, gaps, swaps, poses of segments, wrong input."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import markerloom as ml
from markerloom.errors import MarkerloomError
from markerloom.skeleton import by_motion
from markerloom.skeleton.contacts import Contact, find_contacts, read_contacts, slides_mm, write_contacts
from markerloom.skeleton.motion import Motion, rest_of, with_rest
from markerloom.skeleton.mvnx import SegmentPoses
from markerloom.skeleton.placing import split_side
from markerloom.skeleton.rules import beside, hips, midpoint
from skeleton_truth import joint_errors_mm, rom
from test_label import points_of

DATA = Path(__file__).resolve().parents[2] / "shared/data"


@cache
def solved_rom() -> tuple[ml.Solved, ml.Points, np.ndarray, list[str], np.ndarray]:
    """A range of motion of 40 s at 50 Hz with 1 mm of noise, solved; the truth beside it."""
    names, xyz_mm, joints, centers_mm = rom(seed=1, frames=2050, rate_hz=50.0)
    points = replace(points_of(xyz_mm, names), rate_hz=50.0)
    return ml.solve(points, contacts=False), points, xyz_mm, joints, centers_mm


@pytest.mark.parametrize(("level", "joints"), [(1, 18), (2, 71), (3, 94), (4, 144)])
def test_hanim_has_the_standards_joints(level: int, joints: int) -> None:
    skeleton = ml.hanim(level)
    assert len(skeleton) == joints
    assert {"humanoid_root", "sacroiliac", "l_hip", "r_knee", "vl5", "skullbase", "l_radiocarpal"} <= set(
        skeleton.joints
    )
    assert skeleton.bone_lengths_m()[1:].min() > 0.005
    places = skeleton.places_m()
    for left, right in skeleton.mirrored():
        assert np.allclose(places[left], places[right] * [-1, 1, 1])
    assert skeleton.index("l_ankle") == skeleton.joints.index("l_talocrural")


def test_joint_centres_are_found_from_a_range_of_motion() -> None:
    solved, _, _, joints, centers_mm = solved_rom()
    errors = joint_errors_mm(solved.motion, joints, centers_mm)
    assert np.sqrt(np.mean(np.square(list(errors.values())))) < 3.0, errors
    assert solved.report["residual_mm"]["rms"] < 1.2 * np.sqrt(3.0)
    places = solved.motion.joints_m()
    parents = np.array(solved.motion.skeleton.parents)
    lengths = np.linalg.norm(places[:, 1:] - places[:, parents[1:]], axis=2)
    assert np.ptp(lengths, axis=0).max() < 1e-9


def test_a_short_walk_leaves_no_joint_astray() -> None:
    names, xyz_mm, joints, centers_mm = rom(seed=1, frames=300, motion="walk")
    errors = joint_errors_mm(ml.solve(points_of(xyz_mm, names), contacts=False).motion, joints, centers_mm)
    assert max(errors.values()) < 60.0
    assert np.median(list(errors.values())) < 20.0


def test_an_arm_without_markers_is_carried_and_taken_up_again() -> None:
    solved, points, *_ = solved_rom()
    arm = [
        m
        for m, j in zip(solved.wearer.markers, solved.wearer.joints, strict=True)
        if "l_" in solved.wearer.skeleton.joints[j] and j >= solved.wearer.skeleton.index("l_shoulder")
    ]
    gone = (points.frame >= 600) & (points.frame < 625) & np.isin(points.label, arm)
    again = ml.solve(points.keep(~gone), solved.wearer, contacts=False)
    wrist = solved.motion.skeleton.index("l_radiocarpal")
    ours, whole = (m.motion.joints_m()[:, wrist] for m in (again, solved))
    sharpest = np.linalg.norm(np.diff(whole, 2, axis=0), axis=1).max()
    assert np.linalg.norm(np.diff(ours, 2, axis=0), axis=1)[595:632].max() <= sharpest
    assert np.linalg.norm(ours - whole, axis=1)[630:].max() < 0.002
    assert again.motion.kind[610, wrist] == 1
    assert again.motion.sigma_mm[612, wrist] > 5.0 * again.motion.sigma_mm[590, wrist]


def test_a_swapped_pair_hardly_moves_the_joints() -> None:
    solved, points, _, joints, centers_mm = solved_rom()
    label = points.label.copy()
    inside = (points.frame >= 700) & (points.frame < 720)
    for here, there in (("LKNE", "RKNE"), ("RKNE", "LKNE")):
        label[inside & (points.label == here)] = there
    again = ml.solve(replace(points, label=label, track=_tracks(label)), solved.wearer, contacts=False)
    window = slice(695, 725)
    before = joint_errors_mm(solved.motion, joints, centers_mm, window)
    after = joint_errors_mm(again.motion, joints, centers_mm, window)
    knee = np.sqrt(np.mean([after[j] ** 2 for j in ("shank_l", "shank_r", "foot_l", "foot_r")]))
    was = np.sqrt(np.mean([before[j] ** 2 for j in ("shank_l", "shank_r", "foot_l", "foot_r")]))
    assert knee <= 2.0 * was


def _tracks(label: np.ndarray) -> np.ndarray:
    return np.unique(label, return_inverse=True)[1].astype(np.int64)


def test_live_following_gives_nearly_what_the_whole_take_gives() -> None:
    solved, points, xyz_mm, _, _ = solved_rom()
    follower = ml.SkeletonFollower(solved.wearer, 50.0)
    assert follower.push({"C7": (0.0, 0.0, 1000.0)}) is None
    for f in range(40):
        live = follower.push({m: xyz_mm[f, i] for i, m in enumerate(_names(points))}, frame=f)
        assert live is not None
        assert np.linalg.norm(live.joints_m()[0] - solved.motion.joints_m()[f], axis=1).max() < 0.01


def _names(points: ml.Points) -> list[str]:
    return points.slots()[0]


def test_a_skeleton_keeps_its_markers_in_a_file(tmp_path: Path) -> None:
    solved, points, *_ = solved_rom()
    ml.write_wearer(solved.wearer, tmp_path / "anna.toml")
    again = ml.read_wearer(tmp_path / "anna.toml")
    assert again.markers == solved.wearer.markers
    assert np.abs(again.places_m - solved.wearer.places_m).max() < 1e-6
    assert np.abs(again.skeleton.offsets_m - solved.wearer.skeleton.offsets_m).max() < 1e-6
    short = points.select(0, 50)
    assert (
        np.abs(
            ml.solve(short, again, contacts=False).motion.joints_m()
            - ml.solve(short, solved.wearer, contacts=False).motion.joints_m()
        ).max()
        < 1e-4
    )


def test_somebody_elses_skeleton_is_noticed() -> None:
    solved, points, *_ = solved_rom()
    other = replace(solved.wearer, skeleton=solved.wearer.skeleton.scaled(1.1), places_m=solved.wearer.places_m * 1.1)
    report = ml.solve(points.select(0, 60), other, contacts=False).report
    assert any("another person" in w for w in report["warnings"])


def standing() -> tuple[Motion, list[Contact]]:
    """A figure that sways while its feet should stand."""
    skeleton = ml.hanim(1)
    frames = 200
    turns = np.tile(np.eye(3), (frames, len(skeleton), 1, 1))
    root = np.tile([0.0, 0.0, 0.9], (frames, 1))
    t = np.arange(frames) / 100.0
    root[:, 0] = 0.004 * np.sin(2.0 * t)
    return Motion(skeleton, root, turns, 100.0), [Contact("l_heel", 20, 180), Contact("l_ball", 20, 180)]


def test_feet_that_stand_neither_slide_nor_sink(tmp_path: Path) -> None:
    motion, contacts = standing()
    assert {c.site for c in find_contacts(motion)} == {"l_heel", "l_ball", "r_heel", "r_ball"}
    names, xyz_mm = _worn(motion)
    points = replace(points_of(xyz_mm, names), rate_hz=100.0)
    free = ml.solve(points, "hanim-loa1", contacts=False)
    held = ml.solve(points, free.wearer, contacts=contacts)
    assert max(c["slides_mm"] for c in slides_mm(free.motion, contacts)) > 2.0
    assert max(c["slides_mm"] for c in held.report["contacts"]) < 1.0
    assert max(c["sinks_mm"] for c in held.report["contacts"]) < 1.0
    changed = np.linalg.norm(held.motion.joints_m() - free.motion.joints_m(), axis=2)
    assert changed.max() < 0.01
    write_contacts(contacts, tmp_path / "contacts.csv")
    assert read_contacts(tmp_path / "contacts.csv", free.wearer.skeleton) == contacts


def _worn(motion: Motion) -> tuple[list[str], np.ndarray]:
    """Markers of a set on the rest skeleton, moved with it (mm)."""
    made = ml.read_marker_set("front-waist-53")
    from markerloom.skeleton.fitting import _first_places
    from markerloom.skeleton.placing import place_markers

    placed = place_markers(list(made.markers), motion.skeleton, made, "test")
    places = _first_places(motion.skeleton, placed, motion.skeleton.stature_m or 1.75)
    turn, at = motion.segments()
    joints = placed.joints
    xyz = at[:, joints] + np.einsum("fmab,mb->fma", turn[:, joints], places)
    return placed.markers, 1000.0 * (xyz + 0.0005 * np.random.default_rng(0).standard_normal(xyz.shape))


def test_a_new_rest_pose_moves_no_joint() -> None:
    solved, *_ = solved_rom()
    motion = solved.motion.select(0, 20)
    turns = {"l_shoulder": np.array([0.2, 1.2, -0.4]), "r_knee": np.array([0.5, 0.0, 0.1])}
    again = with_rest(motion, rest_of(motion.skeleton, turns))
    assert np.abs(again.joints_m() - motion.joints_m()).max() < 1e-12
    assert np.abs(again.sites_m() - motion.sites_m()).max() < 1e-12


def test_angles_have_the_signs_of_the_recommendation() -> None:
    skeleton = ml.hanim(1)
    turns = np.tile(np.eye(3), (1, len(skeleton), 1, 1))
    bend = {
        "l_hip": [-30, 0, 0],
        "r_hip": [0, 10, 0],
        "l_knee": [40, 0, 0],
        "r_talocrural": [-15, 0, 0],
        "l_elbow": [0, 0, -50],
        "r_elbow": [0, 0, 50],
        "vl5": [20, 0, 0],
    }
    for joint, degrees in bend.items():
        turns[:, skeleton.index(joint)] = Rotation.from_rotvec(np.deg2rad(degrees)).as_matrix()
    angles = ml.joint_angles(Motion(skeleton, np.zeros((1, 3)), turns, 100.0))

    def first(joint: str, number: int = 0) -> float:
        return float(angles[joint][number][1][0])

    assert first("l_hip") == pytest.approx(30)
    assert first("r_hip", 1) == pytest.approx(-10)
    assert first("l_knee") == pytest.approx(40)
    assert first("r_talocrural") == pytest.approx(15)
    assert first("l_elbow") == pytest.approx(50)
    assert first("r_elbow") == pytest.approx(50)
    assert first("vl5") == pytest.approx(20)
    assert first("l_shoulder", 1) == pytest.approx(90)


def test_rules_for_joint_centres() -> None:
    a, b = np.array([[0.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 2.0]])
    assert np.allclose(midpoint(a, b), [[0, 0, 1]])
    assert np.allclose(beside(np.array([[1.0, 0, 0]]), a, np.array([[0.0, 1.0, 0]]), 0.05), [[0, 0, -0.05]])
    assert np.isnan(beside(b, a, 2 * b, 0.05)).all()
    left, right = hips(*(np.array([p]) for p in ([0.0, 0.12, 1], [0.0, -0.12, 1], [-0.2, 0.05, 1], [-0.2, -0.05, 1])))
    assert left[0, 1] == pytest.approx(0.33 * 0.24 + 0.0073)
    assert np.allclose(left * [1, -1, 1], right)
    assert left[0, 0] == pytest.approx(-0.24 * 0.2 - 0.0099)
    assert left[0, 2] == pytest.approx(1 - 0.30 * 0.24 - 0.0109)


def moving_pair(hinge: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Two segments about a centre: markers of both, the centre in every frame, the hinge's axis in the first."""
    rng = np.random.default_rng(3)
    shape = rng.uniform(-0.2, 0.2, (2, 4, 3))
    center, axis = np.array([0.05, -0.1, 0.2]), np.array([0.0, 0.6, 0.8])
    frames = 80
    world = Rotation.from_rotvec(rng.uniform(-0.6, 0.6, (frames, 3)))
    bend = axis * rng.uniform(-0.8, 0.8, (frames, 1)) if hinge else rng.uniform(-0.5, 0.5, (frames, 3))
    one = world.as_matrix() @ shape[0].T
    two = world.as_matrix() @ (Rotation.from_rotvec(bend).as_matrix() @ shape[1].T + center[:, None])
    return np.swapaxes(one, 1, 2), np.swapaxes(two, 1, 2), world.apply(center), axis


def _first_axis(one_m: np.ndarray, one: by_motion.Rigid, axis: np.ndarray) -> np.ndarray:
    """The simulated axis, given in the first segment's own frame, in the axes that `rigid` found for it."""
    rng = np.random.default_rng(3)
    shape = rng.uniform(-0.2, 0.2, (2, 4, 3))[0]
    to_world = (one_m[0] - one_m[0].mean(axis=0)).T @ np.linalg.pinv((shape - shape.mean(axis=0)).T)
    return one.turn[0].T @ to_world @ axis


def test_score_and_sphere_find_a_centre_and_sara_an_axis() -> None:
    one_m, two_m, center_m, _ = moving_pair(hinge=False)
    one, two = by_motion.rigid(one_m), by_motion.rigid(two_m)
    found = by_motion.score(one, two)
    world = one.place_m + np.einsum("fab,b->fa", one.turn, found[0])
    assert np.abs(world - center_m).max() < 1e-9
    alone = by_motion.sphere(one, two_m[:, :1])
    assert np.abs(one.place_m + np.einsum("fab,b->fa", one.turn, alone) - center_m).max() < 1e-6
    one_m, two_m, _, axis = moving_pair(hinge=True)
    one, two = by_motion.rigid(one_m), by_motion.rigid(two_m)
    direction, ratio = by_motion.sara(one, two)
    # The same axis from both segments, in every frame; and the one that was simulated.
    first, second = (np.einsum("fab,b->fa", r.turn, d) for r, d in zip((one, two), direction, strict=True))
    assert np.abs(np.abs((first * second).sum(axis=1)) - 1.0).max() < 1e-9
    angle = np.arccos(np.clip(np.abs(direction[0] @ _first_axis(one_m, one, axis)), 0.0, 1.0))
    assert angle < 1e-6
    assert ratio < 1e-6
    assert np.linalg.norm(direction, axis=1) == pytest.approx([1.0, 1.0])


def test_segments_poses_drive_the_skeleton() -> None:
    solved, *_ = solved_rom()
    motion = solved.motion.select(1000, 1060)
    turn, place = motion.segments()
    rng = np.random.default_rng(0)
    noisy = (
        Rotation.from_rotvec(0.01 * rng.standard_normal((turn[..., 0, 0].size, 3))).as_matrix().reshape(turn.shape)
        @ turn
    )
    poses = SegmentPoses(motion.skeleton, place + 0.002 * rng.standard_normal(place.shape), noisy, motion.rate_hz)
    again = ml.solve_segments(poses)
    off = np.linalg.norm(again.joints_m() - place, axis=2)
    assert np.sqrt((off**2).mean()) < 0.005
    poses.place_m[:, 1:] = np.nan
    assert np.sqrt((np.linalg.norm(ml.solve_segments(poses).joints_m() - place, axis=2) ** 2).mean()) < 0.02


def test_a_distorted_field_is_straightened() -> None:
    rng = np.random.default_rng(1)
    reference = rng.uniform(-1, 1, (150, 3))
    bent = reference + 0.03 * np.sin(1.5 * reference[:, [1, 2, 0]])
    fitted = ml.fit_distortion(bent[:120], reference[:120])
    inside = np.abs(reference[120:]).max(axis=1) < 0.8
    before = np.linalg.norm(bent[120:] - reference[120:], axis=1)[inside].mean()
    assert np.linalg.norm(fitted.corrected(bent[120:]) - reference[120:], axis=1)[inside].mean() < 0.2 * before
    with pytest.raises(MarkerloomError, match="ten places"):
        ml.fit_distortion(bent[:5], reference[:5])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("left_upper_arm", ("left", "upper_arm")),
        ("femur_r", ("right", "thigh")),
        ("LFemur", ("left", "thigh")),
        ("RightForeArm", ("right", "forearm")),
        ("Thorax", ("", "thorax")),
        ("torso", ("", "thorax")),
    ],
)
def test_segments_are_known_under_many_names(text: str, expected: tuple[str, str]) -> None:
    assert split_side(text) == expected


def test_wrong_input_is_refused_with_reasons(tmp_path: Path) -> None:
    solved, points, *_ = solved_rom()
    unnamed = replace(points, label=np.full(len(points), "", dtype="<U8"))
    with pytest.raises(MarkerloomError, match="no marker has a name"):
        ml.solve(unnamed)
    odd = replace(points, label=np.array([f"Q{n}" for n in points.track]))
    with pytest.raises(MarkerloomError, match="--hints"):
        ml.solve(odd)
    cyclic = tmp_path / "cyclic.toml"
    rows = [("a", None), ("b", "c"), ("c", "b")]
    cyclic.write_text(
        "\n".join(
            f'[[joints]]\nname = "{n}"\nplace_mm = [0, 0, {i}]\n' + (f'parent = "{p}"\n' if p else "")
            for i, (n, p) in enumerate(rows)
        )
    )
    with pytest.raises(MarkerloomError, match="hang from each other"):
        ml.read_skeleton(cyclic)
    flat = tmp_path / "flat.toml"
    flat.write_text(
        '[[joints]]\nname = "a"\nplace_mm = [0, 0, 0]\n[[joints]]\nname = "b"\nparent = "a"\nplace_mm = [0, 0, 0]\n'
    )
    with pytest.raises(MarkerloomError, match="no length"):
        ml.read_skeleton(flat)
    hints = tmp_path / "hints.toml"
    hints.write_text('[segments]\nhead = ["NOBODY"]\n')
    with pytest.raises(MarkerloomError, match="no marker 'NOBODY'"):
        ml.solve(points, known=ml.read_hints(hints))
    with pytest.raises(MarkerloomError, match="motions are written as"):
        ml.write_motion(solved.motion, tmp_path / "motion.fbx")
    assert not (tmp_path / "motion.fbx").exists()


def test_a_project_solves_its_takes_once(tmp_path: Path) -> None:
    names, xyz_mm, _, _ = rom(seed=2, frames=120, rate_hz=50.0)
    (tmp_path / "takes").mkdir()
    replace(points_of(xyz_mm, names), rate_hz=50.0).save(tmp_path / "takes/short.parquet")
    (tmp_path / "markerloom.toml").write_text(
        '[settings]\nfill = "none"\nskeleton = "hanim-loa1"\nsolve_to = [".bvh", ".trc"]\n'
    )
    row = ml.process(tmp_path)["takes"][0]
    assert row["ran"] == ["solve"]
    assert row["skeleton_mm"] < 5.0
    folder = tmp_path / "results/short"
    assert {"short.bvh", "short.trc", "skeleton.html"} <= {p.name for p in folder.iterdir()}
    assert len(ml.read_motion(folder / "short.bvh")) == 120
    assert ml.process(tmp_path)["takes"][0]["ran"] == []


@pytest.mark.slow
@pytest.mark.skipif(not DATA.exists(), reason="needs ../shared/data")
def test_a_real_cloud_becomes_a_skeleton_with_hints(tmp_path: Path) -> None:
    hints = Path(__file__).resolve().parents[1] / "docs/guides/fullbody-44-hints.toml"
    points = ml.read_points(DATA / "labelling/fullbody-44.c3d")
    solved = ml.solve(points, "hanim-loa2", known=ml.read_hints(hints))
    assert solved.report["residual_mm"]["rms"] < 8.0
    ml.write_motion(solved.motion, tmp_path / "take.bvh")
    again = ml.read_motion(tmp_path / "take.bvh")
    order = [again.skeleton.joints.index(n) for n in solved.motion.skeleton.joints]
    assert np.abs(again.joints_m()[:, order] - solved.motion.joints_m()).max() < 1e-6


def test_sensors_carry_an_arm_whose_markers_are_gone() -> None:
    solved, points, _, _, _ = solved_rom()
    part = points.select(600, 1000)
    without = ml.solve(part, solved.wearer, contacts=False).motion
    turn, place = without.segments()
    rng = np.random.default_rng(3)
    arm = [without.skeleton.index(n) for n in ("left_upper_arm", "left_forearm", "left_hand")]
    world, shift = Rotation.from_rotvec([0.1, -0.2, 1.4]).as_matrix(), np.array([1.0, 2.0, -0.5])
    sits = Rotation.random(len(arm), rng=rng).as_matrix()
    noise = Rotation.from_rotvec(0.005 * rng.standard_normal((len(turn) * len(arm), 3))).as_matrix()
    sensed = noise.reshape(len(turn), len(arm), 3, 3) @ world @ turn[:, arm] @ sits
    at = (place[:, arm] + turn[:, arm] @ np.array([0.02, 0.0, -0.1])) @ world.T + shift
    sensors = ml.Skeleton("sensors", ("left_upper_arm", "left_forearm", "left_hand"), (-1, 0, 1), np.zeros((3, 3)))
    poses = SegmentPoses(sensors, at, sensed, without.rate_hz, first_frame=600)
    names = {m for m, j in zip(solved.wearer.markers, solved.wearer.joints, strict=True) if j in arm}
    hidden = part.keep(~(np.isin(part.label, list(names)) & (part.frame >= 750) & (part.frame < 850)))
    bare = ml.solve(hidden, solved.wearer, contacts=False)
    both = ml.solve(hidden, solved.wearer, contacts=False, poses=poses)
    gone = slice(750 - 600, 850 - 600)
    off = [1000.0 * np.linalg.norm(s.motion.joints_m() - place, axis=2)[gone][:, arm].max() for s in (bare, both)]
    assert off[0] > 50.0, "the arm moves while it is hidden"
    assert off[1] < 15.0
    assert (bare.motion.kind[gone][:, arm[0]] == 1).all()
    assert (both.motion.kind[gone][:, arm] == 0).all()
    assert both.report["sensors"]["l_elbow"]["sigma_deg"] < 2.0
    # Turns alone, as inertial sensors tell them, and at their own rate.
    poses.place_m[:] = np.nan
    slow = SegmentPoses(sensors, poses.place_m[::2], poses.turn[::2], without.rate_hz / 2, first_frame=300)
    turned = ml.solve(hidden, solved.wearer, contacts=False, poses=slow).motion
    assert 1000.0 * np.linalg.norm(turned.joints_m() - place, axis=2)[gone][:, arm].max() < 30.0


def test_poses_of_nobody_here_are_refused() -> None:
    solved, points, _, _, _ = solved_rom()
    part = points.select(0, 50)
    box = ml.Skeleton("box", ("box",), (-1,), np.zeros((1, 3)))
    still = SegmentPoses(box, np.zeros((50, 1, 3)), np.tile(np.eye(3), (50, 1, 1, 1)), 50.0)
    with pytest.raises(MarkerloomError, match="no segment of the poses"):
        ml.solve(part, solved.wearer, poses=still)
    with pytest.raises(MarkerloomError, match="no moment in common"):
        ml.solve(part, solved.wearer, poses=replace(still, first_frame=5000))
