"""Feet that stand, and motions on other bodies: stances held, floors kept, bones constant, nothing else changed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import markerloom as ml
from markerloom.errors import FormatError, InputError
from markerloom.motion.body import body_of, split_name
from markerloom.motion.calm import calmed
from markerloom.motion.edited import accelerations
from markerloom.motion.feet import Plant, feet_of, placed, with_time
from markerloom.motion.looks import find_looks, lines, meeting
from markerloom.motion.upright import stands
from markerloom.skeleton import Skeleton
from markerloom.skeleton.motion import with_rest
from motion_clips import figure, walk, with_limbs


@pytest.mark.parametrize(
    ("name", "side", "word"),
    [
        ("mixamorig:LeftUpLeg", "left", "upleg"),
        ("UpperArm_R", "right", "upperarm"),
        ("l_shoulder", "left", "shoulder"),
        ("rhumerus", "right", "humerus"),
        ("LHipJoint", "left", "hipjoint"),
        ("Bip01 L Thigh", "left", "thigh"),
        ("joint_Root", "", "root"),
        ("root", "", "root"),
        ("lowerback", "", "lowerback"),
    ],
)
def test_names_of_joints(name: str, side: str, word: str) -> None:
    assert split_name(name.replace("Bip01 ", "")) == (side, word)


@pytest.mark.parametrize("level", [1, 2, 3, 4])
def test_parts_of_h_anim(level: int) -> None:
    body = body_of(ml.hanim(level))
    names = {part: body.skeleton.joints[j] for part, j in body.parts.items()}
    assert not body.missing()
    assert names["left_foot"] == "l_talocrural"
    assert names["right_forearm"] == "r_elbow"
    assert names["pelvis"] == "sacroiliac"
    assert names["head"] == "skullbase"


def test_parts_of_other_peoples_skeletons(data: Path) -> None:
    wanted = {
        "bvh/test_freebvh.bvh": ("mixamorig:LeftUpLeg", "mixamorig:LeftArm", "mixamorig:LeftShoulder"),
        "bvh/test_mocapbank.bvh": ("LeftHip", "LeftShoulder", "LeftCollar"),
        "bvh/example.bvh": ("LeftUpLeg", "LeftArm", "LeftShoulder"),
        "bvh/dataset-1_kick_normal_001.bvh": ("UpperLeg_L", "UpperArm_L", "Shoulder_L"),
        "asf-amc/01.asf": ("lfemur", "lhumerus", "lclavicle"),
    }
    for file, names in wanted.items():
        body = body_of(ml.read_skeleton(data / file))
        found = [body.parts[f"left_{part}"] for part in ("upper_leg", "upper_arm", "clavicle")]
        assert tuple(body.skeleton.joints[j] for j in found) == names


def test_feet_that_slip_are_held() -> None:
    clip = walk(slip_m=0.006)
    out = ml.motion.footlock(clip)
    report = out.report
    assert report["before"]["slide_mm"] > 5.0
    assert report["slide_mm"] <= 1.0
    assert report["in_floor_mm"] <= 1.0
    assert max(report["missed_mm"].values()) <= 0.1
    assert np.array_equal(out.motion.skeleton.offsets_m, clip.skeleton.offsets_m)
    arms = [j for j, n in enumerate(clip.skeleton.joints) if "Arm" in n]
    assert np.array_equal(out.motion.turns[:, arms], clip.turns[:, arms])
    again = ml.motion.footlock(clip)
    assert np.array_equal(again.motion.turns, out.motion.turns)


def test_feet_that_stand_exactly_hardly_move() -> None:
    clip = walk()
    out = ml.motion.footlock(clip)
    assert out.report["moved_mm"]["p99"] < 5.0
    assert out.report["sharpness"] < 1.5


def test_a_foot_that_enters_the_floor_is_lifted() -> None:
    clip = walk()
    sunk = replace(clip, root_m=clip.root_m - [0.0, 0.0, 0.015])
    out = ml.motion.footlock(sunk, floor=0.0)
    assert out.report["in_floor_mm"] <= 1.0


def test_stances_can_be_said() -> None:
    clip = walk()
    plants = [Plant("l_ball", 5, 30, (0.12, -0.3, 0.03))]
    out = ml.motion.footlock(clip, plants=plants, floor=0.0)
    feet = ml.motion.feet_of(body_of(clip.skeleton))
    assert np.abs(feet.world_m(out.motion)["l_ball"][5:30] - [0.12, -0.3, 0.03]).max() < 1e-4
    for bad, said in (
        (Plant("l_knee", 5, 30), "no foot has a place 'l_knee'"),
        (Plant("l_ball", 5, 999), "not in the clip"),
    ):
        with pytest.raises(InputError, match=said):
            ml.motion.footlock(clip, plants=[bad])


def test_stances_never_grow() -> None:
    """A foot cannot keep its length to two stances of its other end: one of them gives way, and stays inside itself."""
    clip = walk()
    feet = ml.motion.feet_of(body_of(clip.skeleton))
    plants = [Plant("l_ball", 0, 42), Plant("l_heel", 40, 46), Plant("l_ball", 60, 110), Plant("l_heel", 44, 64)]
    for plant in placed(clip, feet, plants, 0.0):
        assert any(p.site == plant.site and p.start <= plant.start < plant.stop <= p.stop for p in plants)


def test_feet_need_legs_and_frames() -> None:
    body = figure()
    legless = replace(body, joints=tuple(f"part{j}" for j in range(len(body))))
    with pytest.raises(InputError, match=r"no joint was found for left_upper_leg.*its joints are part0"):
        ml.motion.footlock(replace(walk(), skeleton=legless))
    with pytest.raises(InputError, match="too short"):
        ml.motion.footlock(walk().select(0, 3))


@pytest.mark.parametrize("factor", [0.7, 1.3])
def test_limbs_of_other_lengths(factor: float) -> None:
    clip = walk()
    target = with_limbs(clip.skeleton, factor)
    out = ml.motion.retarget(clip, target)
    assert out.report["scale"] == pytest.approx(factor)
    assert out.report["slide_mm"] <= 1.0
    assert out.report["in_floor_mm"] <= 1.0
    assert max(out.report["missed_mm"].values()) <= 0.1
    assert np.array_equal(out.motion.skeleton.offsets_m, target.offsets_m)
    assert out.report["sharpness"] <= 1.5 * max(factor, 1.0)
    steps = [np.ptp(m.root_m[:, 1]) for m in (clip, out.motion)]
    assert steps[1] / steps[0] == pytest.approx(factor, abs=0.05)


def test_the_same_skeleton_changes_nothing() -> None:
    clip = walk(slip_m=0.006)
    out = ml.motion.retarget(clip, figure())
    assert np.array_equal(out.motion.turns, clip.turns)
    assert np.array_equal(out.motion.root_m, clip.root_m)


def other_hierarchy() -> Skeleton:
    """The figure by other names, with a root of the scene, two more joints in the spine, and collar bones."""
    rows = [
        ("joint_Root", None, (0, 0, 0)),
        ("Pelvis", "joint_Root", (0, 0, 0.95)),
        ("Spine_1", "Pelvis", (0, 0, 0.08)),
        ("Spine_2", "Spine_1", (0, 0, 0.1)),
        ("Spine_3", "Spine_2", (0, 0, 0.1)),
        ("Thorax", "Spine_3", (0, 0, 0.1)),
        ("Head", "Thorax", (0, 0, 0.35)),
    ]
    for side, x in (("L", 1), ("R", -1)):
        rows += [
            (f"Clavicle_{side}", "Thorax", (0.03 * x, 0, 0.2)),
            (f"UpperArm_{side}", f"Clavicle_{side}", (0.14 * x, 0, 0)),
            (f"LowerArm_{side}", f"UpperArm_{side}", (0.3 * x, 0, 0)),
            (f"Hand_{side}", f"LowerArm_{side}", (0.27 * x, 0, 0)),
            (f"Thigh_{side}", "Pelvis", (0.09 * x, 0, -0.02)),
            (f"Shin_{side}", f"Thigh_{side}", (0, 0, -0.45)),
            (f"Ankle_{side}", f"Shin_{side}", (0, 0, -0.43)),
            (f"Toe_{side}", f"Ankle_{side}", (0, -0.16, -0.05)),
        ]
    names = [name for name, _, _ in rows]
    parents = tuple(-1 if parent is None else names.index(parent) for _, parent, _ in rows)
    return Skeleton("hero", tuple(names), parents, np.array([offset for _, _, offset in rows], float))


def test_another_hierarchy() -> None:
    clip = walk()
    target = other_hierarchy()
    out = ml.motion.retarget(clip, target)
    assert out.report["slide_mm"] <= 1.0
    assert out.report["in_floor_mm"] <= 1.0
    ours, theirs = out.motion.joints_m(), clip.joints_m()
    for part in ("left_forearm", "right_lower_leg", "left_foot"):
        one, two = body_of(target).parts, body_of(clip.skeleton).parts
        a = (
            ours[:, one[part]]
            - ours[
                :,
                one[
                    part.replace("forearm", "upper_arm").replace("lower_leg", "upper_leg").replace("foot", "lower_leg")
                ],
            ]
        )
        b = (
            theirs[:, two[part]]
            - theirs[
                :,
                two[
                    part.replace("forearm", "upper_arm").replace("lower_leg", "upper_leg").replace("foot", "lower_leg")
                ],
            ]
        )
        cosine = (a * b).sum(axis=1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
        assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 15.0


def test_a_rest_pose_that_is_none() -> None:
    """All bones along x, as some programs write them: the motion shows how somebody stands."""
    clip = walk()
    spins = np.random.default_rng(0).normal(size=(len(clip.skeleton), 4))
    rest = Rotation.from_quat(spins).as_matrix()
    strange = with_rest(clip, rest)
    assert not stands(body_of(strange.skeleton))
    target = with_limbs(clip.skeleton, 0.9)
    out = ml.motion.retarget(strange, target)
    plain = ml.motion.retarget(clip, target)
    assert out.report["slide_mm"] <= 1.0
    assert np.linalg.norm(out.motion.joints_m() - plain.motion.joints_m(), axis=2).mean() < 0.05
    back = ml.motion.retarget(clip, with_limbs(strange.skeleton, 1.0), target_motion=strange)
    assert np.linalg.norm(back.motion.joints_m() - clip.joints_m(), axis=2).mean() < 0.05
    still = replace(strange, turns=np.tile(np.eye(3), (240, len(rest), 1, 1)))
    with pytest.raises(InputError, match="in its motion nobody stands"):
        ml.motion.retarget(still, target)


def test_what_trembles_against_itself_stays_as_calm() -> None:
    """A root that trembles and a spine that takes it back: a body with no spine keeps as calm as its source."""
    clip = walk()
    shaken = replace(clip, turns=clip.turns.copy())
    tremble = 0.06 * np.sin(np.arange(len(clip)) * 2.0) * (np.arange(len(clip)) % 80 > 60)
    for joint, sign in ((0, 1.0), (clip.skeleton.index("Spine"), -1.0)):
        turn = Rotation.from_rotvec(np.outer(sign * tremble, [0.0, 1.0, 0.0])).as_matrix()
        shaken.turns[:, joint] = shaken.turns[:, joint] @ turn
    target = spineless()
    out = ml.motion.retarget(shaken, target)
    assert out.report["sharpness"] <= 1.5
    assert out.report["calmed_mm"]["max"] > 1.0
    assert out.report["slide_mm"] <= 1.0
    assert ml.motion.retarget(clip, target).report["calmed_mm"]["max"] == 0.0


def spineless() -> Skeleton:
    """The figure, with arms and neck on its hips, from where its chest is."""
    body = figure()
    kept = [j for j, name in enumerate(body.joints) if name not in ("Spine", "Chest")]
    lifted = np.where([body.parents[j] == body.index("Chest") for j in kept], 0.3, 0.0)
    return Skeleton(
        name="spineless",
        joints=tuple(body.joints[j] for j in kept),
        parents=tuple(-1 if j == 0 else kept.index(body.parents[j]) if body.parents[j] in kept else 0 for j in kept),
        offsets_m=body.offsets_m[kept] + lifted[:, None] * [0.0, 0.0, 1.0],
        sites=tuple(replace(site, joint=kept.index(site.joint)) for site in body.sites),
    )


def test_smoothing_leaves_alone_what_is_calm() -> None:
    clip = walk()
    allowed = accelerations(clip) + 1e-9
    assert np.array_equal(calmed(clip, allowed).turns, clip.turns)
    jerked = replace(clip, root_m=clip.root_m.copy())
    jerked.root_m[100] += [0.0, 0.0, 0.02]
    out = calmed(jerked, np.broadcast_to(2.0 * accelerations(clip).max(axis=0), allowed.shape))
    assert (accelerations(out) <= 2.0 * accelerations(clip).max(axis=0)).all()
    assert np.array_equal(
        np.delete(out.root_m, range(75, 126), axis=0), np.delete(jerked.root_m, range(75, 126), axis=0)
    )


def test_feet_get_the_time_they_need() -> None:
    clip = walk()
    feet = feet_of(body_of(clip.skeleton))
    one, two = Plant("l_heel", 0, 100, (0.0, 0.0, 0.1)), Plant("l_heel", 105, 200, (0.0, 0.05, 0.1))
    calm = np.full((len(clip), len(clip.skeleton)), 5.0)
    before, after = with_time([one, two], feet, calm, 60.0)
    assert (after.start - before.stop) / 60.0 >= np.sqrt(5.77 * 0.05 / 5.0)
    assert with_time([one, two], feet, 100.0 * calm, 60.0) == [one, two]


def test_hands_that_touch_still_do() -> None:
    clip = walk()
    body = clip.skeleton
    middle = 1000.0 * clip.joints_m()[:, body.index("Chest")] + [0.0, -250.0, 0.0]
    turns = clip.turns.copy()
    for f in range(60, 120):
        key = ml.motion.by_reach(
            clip, f, {"LeftHand": (middle[f] + [40, 0, 0]).tolist(), "RightHand": (middle[f] - [40, 0, 0]).tolist()}
        )
        for j, turn in key.turns.items():
            turns[f, j] = turn
    together = replace(clip, turns=turns)
    found = ml.motion.find_constraints(together, body_of(body))
    assert [(t.start, t.stop) for t in found.touches if t.stop - t.start > 30]
    out = ml.motion.retarget(together, with_limbs(body, 1.2))
    hands = out.motion.joints_m()[:, [body.index("LeftHand"), body.index("RightHand")]]
    assert out.report["missed_mm"]["touches"] <= 0.1
    assert np.abs(np.linalg.norm(hands[70:110, 0] - hands[70:110, 1], axis=1) - 0.08 * 1.2).max() < 1e-3


def test_a_head_looks_where_it_is_told() -> None:
    clip = walk()
    target = with_limbs(clip.skeleton, 1.1)
    wanted = ml.motion.Constraints(looks=(ml.motion.Look(80, 120, (1.5, -3.0, 1.2)),), floor_m=0.0)
    out = ml.motion.retarget(clip, target, constraints=wanted).motion
    turn, place = out.segments()
    head = target.index("Head")
    way = np.array([1.5, -3.0, 1.2]) - place[100, head]
    assert (turn[100, head] @ [0.0, -1.0, 0.0]) @ (way / np.linalg.norm(way)) > 0.99999


def watching(place_m: tuple[float, float, float], start: int, stop: int) -> ml.Motion:
    """A walk whose head faces one place for a while, to within a degree."""
    clip = walk()
    turn, place = clip.segments()
    head, neck = clip.skeleton.index("Head"), clip.skeleton.index("Neck")
    rng = np.random.default_rng(0)
    for f in range(start, stop):
        way = np.array(place_m) - place[f, head] + rng.normal(0.0, 0.01, 3)
        side = np.cross([0.0, 0.0, 1.0], -way)
        columns = [side / np.linalg.norm(side), -way / np.linalg.norm(way)]
        world = np.stack([*columns, np.cross(*columns)], axis=1)
        clip.turns[f, head] = turn[f, neck].T @ world
    return clip


def test_a_look_is_found_and_goes_along() -> None:
    where = (1.2, -2.0, 1.0)
    clip = watching(where, 60, 180)
    (look,) = ml.motion.find_constraints(clip, body_of(clip.skeleton)).looks
    assert (look.start, look.stop) == (pytest.approx(60, abs=12), pytest.approx(180, abs=12))
    out = ml.motion.retarget(clip, with_limbs(clip.skeleton, 1.2))
    assert out.report["missed_mm"]["looks"] <= 0.1
    eyes, ahead = lines(out.motion, body_of(out.motion.skeleton))
    place = meeting(eyes[look.start : look.stop], ahead[look.start : look.stop])
    way = place - eyes[look.start : look.stop]
    missed_rad = np.linalg.norm(np.cross(ahead[look.start : look.stop], way), axis=1) / np.linalg.norm(way, axis=1)
    assert missed_rad.max() < 1e-4


def test_heads_that_look_at_nothing() -> None:
    clip = walk()
    body = body_of(clip.skeleton)
    assert find_looks(clip, body, 1.0) == []
    head, swing = clip.skeleton.index("Head"), 0.5 * np.sin(2.0 * np.pi * np.arange(len(clip)) / len(clip))
    shaking = replace(clip, turns=clip.turns.copy())
    shaking.turns[:, head] = Rotation.from_rotvec(np.outer(swing, [0.0, 0.0, 1.0])).as_matrix()
    still = replace(shaking, root_m=0.0 * clip.root_m)
    assert find_looks(still, body, 1.0) == []


def test_a_mapping_and_constraints_can_be_edited(tmp_path: Path) -> None:
    clip, target = walk(), other_hierarchy()
    known = ml.motion.guess(clip.skeleton, target)
    ml.motion.write_mapping(known, target, tmp_path / "mapping.toml")
    assert ml.motion.read_mapping(tmp_path / "mapping.toml", clip.skeleton, target) == known
    (tmp_path / "mapping.toml").write_text('[joints]\nHand_L = ""\n')
    fewer = ml.motion.read_mapping(tmp_path / "mapping.toml", clip.skeleton, target)
    assert set(known.joints) - set(fewer.joints) == {"Hand_L"}
    found = ml.motion.find_constraints(clip, body_of(clip.skeleton))
    ml.motion.write_constraints(found, tmp_path / "constraints.toml")
    again = ml.motion.read_constraints(tmp_path / "constraints.toml", len(clip))
    assert again.plants == found.plants
    assert again.floor_m == pytest.approx(found.floor_m, abs=1e-6)


def test_a_floor_that_is_not_said_is_found() -> None:
    clip = walk()
    raised = replace(clip, root_m=clip.root_m + np.array([0.0, 0.0, 0.3]))
    found = ml.motion.find_constraints(raised, body_of(clip.skeleton))
    target = with_limbs(clip.skeleton, 0.9)
    said = ml.motion.retarget(raised, target, constraints=found)
    unsaid = ml.motion.retarget(raised, target, constraints=replace(found, floor_m=None))
    assert found.floor_m == pytest.approx(0.3, abs=1e-3)
    assert np.array_equal(said.motion.root_m, unsaid.motion.root_m)


def test_skeletons_that_cannot_be_matched(tmp_path: Path) -> None:
    clip = walk()
    dog = Skeleton("dog", ("body", "tail"), (-1, 0), np.array([[0, 0, 0], [0.3, 0, 0]], float))
    with pytest.raises(
        InputError, match=r"the target 'dog' cannot be matched: no joint was found for left_upper_leg.*body, tail"
    ):
        ml.motion.retarget(clip, dog)
    for text, said in (
        ('[joints]\nTail = "Head"\n', "has no joint 'Tail'"),
        ("joints = 3\n", r"no table \[joints\]"),
    ):
        (tmp_path / "mapping.toml").write_text(text)
        with pytest.raises((InputError, FormatError), match=said):
            ml.motion.read_mapping(tmp_path / "mapping.toml", clip.skeleton, figure())
    for text, said in (
        ("[[plants]]\nsite = 'l_heel'\nstart = 3\nstop = 999\n", "not in a clip of 240 frames"),
        ("[[plants]]\nplace = 3\n", "needs site, start, stop"),
        ("[[hops]]\n", "does not know 'hops'"),
    ):
        (tmp_path / "constraints.toml").write_text(text)
        with pytest.raises((InputError, FormatError), match=said):
            ml.motion.read_constraints(tmp_path / "constraints.toml", 240)


REAL = ["bvh/test_freebvh.bvh", "bvh/test_mocapbank.bvh", "asf-amc/01.asf", "hanim-loa2"]


@pytest.mark.parametrize("target", REAL)
@pytest.mark.parametrize("clip", ["asf-amc/02_04.amc", "bvh/dataset-2_walk_normal_001.bvh"])
def test_real_walks_on_real_bodies(data: Path, clip: str, target: str) -> None:
    motion, _ = ml.motion.with_constant_bones(ml.read_motion(data / clip))
    body = ml.read_skeleton(target if target.startswith("hanim") else data / target)
    out = ml.motion.retarget(motion, body)
    assert out.report["plants"] > 10
    assert out.report["slide_mm"] <= 1.0
    assert out.report["in_floor_mm"] <= 1.0
    assert max(out.report["missed_mm"].values()) <= 0.1
