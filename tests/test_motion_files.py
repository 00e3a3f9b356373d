"""Motions in files: round trips, other people's files against each other, presets, and damaged input."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import markerloom as ml
from markerloom.errors import MarkerloomError
from markerloom.skeleton.files import PRESETS
from markerloom.skeleton.motion import Motion

DATA = Path(__file__).resolve().parents[2] / "shared/data"
needs_data = pytest.mark.skipif(not DATA.exists(), reason="needs ../shared/data")
FRAMES = 12


def motion(level: int = 1, seed: int = 0, reach: float = 0.8) -> Motion:
    """A skeleton turned at random, everywhere."""
    skeleton = ml.hanim(level)
    rng = np.random.default_rng(seed)
    turns = Rotation.from_rotvec(rng.uniform(-reach, reach, (FRAMES * len(skeleton), 3))).as_matrix()
    return Motion(skeleton, rng.uniform(-2, 2, (FRAMES, 3)), turns.reshape(FRAMES, len(skeleton), 3, 3), 100.0)


def far_m(again: Motion, made: Motion) -> float:
    """The largest distance of a joint from where it was (m)."""
    names = ["root" if "root" in again.skeleton.joints and i == 0 else n for i, n in enumerate(made.skeleton.joints)]
    order = [again.skeleton.joints.index(n) for n in names]
    return float(np.abs(again.joints_m()[:, order] - made.joints_m()).max())


@pytest.mark.parametrize("level", [1, 2, 3, 4])
@pytest.mark.parametrize("kind", ["bvh", "amc"])
def test_write_read_moves_no_joint(level: int, kind: str, tmp_path: Path) -> None:
    made = motion(level)
    ml.write_motion(made, tmp_path / f"motion.{kind}")
    assert far_m(ml.read_motion(tmp_path / f"motion.{kind}"), made) < 1e-4 * made.skeleton.bone_lengths_m()[1:].min()


@settings(max_examples=30, deadline=None)
@given(
    order=st.permutations("XYZ").map("".join),
    units=st.sampled_from(["mm", "cm", "m", "in", "0.0564"]),
    up=st.sampled_from(["y", "z"]),
    rest=st.sampled_from(["t-pose", "a-pose", "i-pose"]),
)
def test_bvh_in_every_order_unit_axis_and_rest_pose(
    order: str, units: str, up: str, rest: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    made, path = motion(seed=3), tmp_path_factory.mktemp("bvh") / "m.bvh"
    ml.write_motion(made, path, order=order, units=units, up=up, rest=rest)
    assert f"{order[0]}rotation {order[1]}rotation {order[2]}rotation" in path.read_text()
    assert far_m(ml.read_motion(path, units=units, up=up), made) < 2e-6


@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_presets_write_what_their_programs_expect(preset: str, tmp_path: Path) -> None:
    made, style = motion(seed=4), PRESETS[preset]
    ml.write_motion(made, tmp_path / "m.bvh", preset=preset)
    assert far_m(ml.read_motion(tmp_path / "m.bvh", units=style.units, up=style.up), made) < 2e-6


def test_amc_in_radians_is_the_same(tmp_path: Path) -> None:
    made = motion(seed=5)
    ml.write_motion(made, tmp_path / "m.amc", radians=True)
    assert ":RADIANS" in (tmp_path / "m.amc").read_text()
    assert far_m(ml.read_motion(tmp_path / "m.amc"), made) < 2e-6
    assert re.search(r"limits \(-?\d", (tmp_path / "m.asf").read_text())


def test_glb_has_the_joints_where_they_are(tmp_path: Path) -> None:
    pygltflib = pytest.importorskip("pygltflib")
    made = motion(seed=6)
    ml.write_motion(made, tmp_path / "m.glb")
    file = pygltflib.GLTF2().load(str(tmp_path / "m.glb"))
    blob = file.binary_blob()

    def numbers(accessor: int) -> np.ndarray:
        one = file.accessors[accessor]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[one.type]
        view = file.bufferViews[one.bufferView]
        assert one.componentType == 5126
        return np.frombuffer(blob, np.float32, one.count * width, view.byteOffset).reshape(one.count, width)

    animation, frame = file.animations[0], 7
    local = {i: np.eye(4) for i in range(len(made.skeleton))}
    for i in local:
        local[i][:3, 3] = file.nodes[i].translation
    for channel in animation.channels:
        values = numbers(animation.samplers[channel.sampler].output)[frame]
        if channel.target.path == "rotation":
            local[channel.target.node][:3, :3] = Rotation.from_quat(values).as_matrix()
        else:
            local[channel.target.node][:3, 3] = values
    world = {0: local[0]}
    for j, p in enumerate(made.skeleton.parents):
        if p >= 0:
            world[j] = world[p] @ local[j]
        assert j in world
        for child in [c for c in file.nodes[j].children or [] if c < len(made.skeleton)]:
            assert made.skeleton.parents[child] == j
    x, y, z = made.joints_m()[frame].T
    found = np.array([world[j][:3, 3] for j in range(len(made.skeleton))])
    assert np.abs(found - np.column_stack([x, z, -y])).max() < 1e-5
    assert file.skins[0].joints == list(range(len(made.skeleton)))


def test_usd_has_the_joints_where_they_are(tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    from importlib import import_module
    from typing import Any

    usd: Any = import_module("pxr.Usd")
    skel: Any = import_module("pxr.UsdSkel")
    geom: Any = import_module("pxr.UsdGeom")
    made = motion(seed=7)
    ml.write_motion(made, tmp_path / "m.usda")
    stage = usd.Stage.Open(str(tmp_path / "m.usda"))
    assert geom.GetStageUpAxis(stage) == "Z"
    assert geom.GetStageMetersPerUnit(stage) == 1.0
    cache = skel.Cache()
    root = skel.Root(stage.GetDefaultPrim())
    cache.Populate(root, usd.PrimDefaultPredicate)
    query = cache.GetSkelQuery(skel.Skeleton(stage.GetPrimAtPath("/Figure/Skeleton")))
    for frame in (0, 5, FRAMES - 1):
        matrices = query.ComputeJointSkelTransforms(usd.TimeCode(frame))
        found = np.array([m.ExtractTranslation() for m in matrices])
        assert np.abs(found - made.joints_m()[frame]).max() < 1e-5


def test_joints_as_points_and_as_a_table(tmp_path: Path) -> None:
    made = motion(seed=8)
    for kind in ("trc", "c3d"):
        ml.write_motion(made, tmp_path / f"m.{kind}")
        points = ml.read_points(tmp_path / f"m.{kind}")
        names, _ = points.slots()
        assert tuple(names) == made.skeleton.joints
        assert np.abs(points.xyz_mm.reshape(FRAMES, -1, 3) - 1000 * made.joints_m()).max() < 0.01
    ml.write_motion(made, tmp_path / "m.csv")
    header = (tmp_path / "m.csv").read_text().splitlines()[0]
    assert (
        header.replace('"', "")
        == "frame,joint,x_mm,y_mm,z_mm,qx,qy,qz,qw,sigma_mm,kind,angle_1_deg,angle_2_deg,angle_3_deg"
    )


def test_opensim_has_the_markers_where_they_are(tmp_path: Path) -> None:
    opensim = pytest.importorskip("opensim", reason="OpenSim is large: pip install opensim to run this")
    made = motion(seed=9, reach=0.5)
    glued = [("A", 3, np.array([0.05, 0.02, -0.1])), ("B", 12, np.array([0.1, 0.0, 0.03]))]
    ml.write_motion(made, tmp_path / "m.osim", markers=glued, preset="opensim")
    model = opensim.Model(str(tmp_path / "m.osim"))
    state = model.initSystem()
    table = opensim.TimeSeriesTable(str(tmp_path / "m.mot"))
    names = list(table.getColumnLabels())
    row = table.getRowAtIndex(4)
    for i, name in enumerate(names):
        turn = "_t" not in name[-3:]
        model.getCoordinateSet().get(name).setValue(state, np.deg2rad(row[i]) if turn else row[i], False)
    model.realizePosition(state)
    segments, places = made.segments()
    for name, joint, place in glued:
        at = model.getMarkerSet().get(name).getLocationInGround(state)
        x, y, z = places[4, joint] + segments[4, joint] @ place
        assert np.abs(np.array([at.get(k) for k in range(3)]) - [x, z, -y]).max() < 1e-6


@needs_data
def test_the_same_motion_from_two_formats() -> None:
    folder = DATA / "asf-amc"
    amc = ml.read_motion(folder / "171025_Guy_ROM_body_01_blade.amc")
    bvh = ml.read_motion(folder / "171025_Guy_ROM_body_01_blade.bvh", units="in")
    both = [n for n in bvh.skeleton.joints if n in amc.skeleton.joints]
    assert len(both) > 25
    a, b = (m.joints_m()[:, [m.skeleton.joints.index(n) for n in both]] for m in (amc, bvh))
    assert np.abs(a - b).max() < 1e-5
    mobu = ml.read_motion(DATA / "bvh/mobu-rom.bvh")
    shared = [n for n in both if n in mobu.skeleton.joints]
    c, b = (m.joints_m()[:, [m.skeleton.joints.index(n) for n in shared]] for m in (mobu, bvh))
    # MotionBuilder resampled 120 Hz to 24 Hz, a frame late; at these frames both hold the same moment.
    assert np.abs(c[[12, 24]] - b[[59, 119]]).max() < 2e-5


@needs_data
def test_a_cmu_motion_from_two_formats() -> None:
    amc = ml.read_motion(DATA / "asf-amc/01_01.amc")
    bvh = ml.read_motion(DATA / "asf-amc/01_01.bvh", units=str(0.0254 / 0.45))
    # The BVH has a rest pose before the first frame, and leaves out the bones of thorax and wrists.
    a, b = amc.joints_m(), bvh.joints_m()[1:]
    legs_and_spine = slice(0, 14)
    assert np.abs(a[: len(b), legs_and_spine] - b[: len(a), legs_and_spine]).max() < 1e-5
    turn, _ = amc.segments()
    off = a[: len(b), amc.skeleton.joints.index("lhumerus")] - b[: len(a), bvh.skeleton.joints.index("LeftArm")]
    thorax = np.einsum("fba,fb->fa", turn[: len(b), amc.skeleton.joints.index("thorax")], off)
    assert np.ptp(thorax, axis=0).max() < 1e-5


@needs_data
def test_every_file_reads_or_says_why_not() -> None:
    for path in sorted([*(DATA / "bvh").iterdir(), *(DATA / "asf-amc").glob("*.amc"), *(DATA / "mvnx").glob("*.bvh")]):
        if path.name == "default.bvh":
            with pytest.raises(MarkerloomError, match="skeleton without a motion"):
                ml.read_motion(path)
            assert len(ml.read_skeleton(path)) == 18
        else:
            assert np.isfinite(ml.read_motion(path).joints_m()).all()
    with pytest.raises(MarkerloomError, match=r"'\.htr' is none of them"):
        ml.read_motion(next((DATA / "asf-amc").glob("*.htr")))


@needs_data
def test_an_inertial_capture_is_solved_as_its_maker_does() -> None:
    ours = ml.solve_segments(ml.read_segment_poses(DATA / "mvnx/test_mocap.mvnx"))
    theirs = ml.read_motion(DATA / "mvnx/test_mocap.bvh")
    same = {
        "Pelvis": "Hips",
        "L5": "Chest",
        "L3": "Chest2",
        "T12": "Chest3",
        "T8": "Chest4",
        "Neck": "Neck",
        "Head": "Head",
    }
    for side in ("Left", "Right"):
        same |= {
            f"{side}Shoulder": f"{side}Collar",
            f"{side}UpperArm": f"{side}Shoulder",
            f"{side}ForeArm": f"{side}Elbow",
        }
        same |= {f"{side}Hand": f"{side}Wrist", f"{side}UpperLeg": f"{side}Hip", f"{side}LowerLeg": f"{side}Knee"}
        same |= {f"{side}Foot": f"{side}Ankle", f"{side}Toe": f"{side}Toe"}
    (turn, place), (their_turn, their_place) = ours.segments(), theirs.segments()
    # The BVH's first frame is a T-pose.
    for a, b in same.items():
        i, j = ours.skeleton.joints.index(a), theirs.skeleton.joints.index(b)
        assert np.abs(place[1:, i] - their_place[1:, j]).max() < 0.02
        between = Rotation.from_matrix(np.swapaxes(turn[1:, i], 1, 2) @ their_turn[1:, j]).magnitude()
        assert np.rad2deg(between.max()) < 5.0


BVH = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Knee
  {
    OFFSET 0 -40 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 -40 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.01
0 90 0 0 0 0 0 10 0
0 90 0 0 0 0 0 20 0
"""


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("0 90 0 0 0 0 0 20 0\n", "0 90 0 0 0 0 0 20\n"), "frame 1: has 8 numbers, not 9"),
        (("0 90 0 0 0 0 0 20 0\n", ""), "says 2 frames, but has 1"),
        (("0 90 0 0 0 0 0 20 0\n", "0 90 0 0 0 x 0 20 0\n"), "not numbers only"),
        (("  }\n}\nMOTION", "  }\nMOTION"), "brackets are not closed"),
        (("CHANNELS 3 Z", "CHANNELS 2 Z"), "not a number and that many channels"),
        (("Xrotation Yrotation\n    End", "Xrotation Wrotation\n    End"), "not a number and that many channels"),
        (("Frame Time: 0.01", "Frame Time: 0"), "cannot be"),
        (("JOINT Knee", "ROOT Knee"), "a second ROOT"),
        (("JOINT Knee", "JOINT Hips"), "there twice"),
        (("HIERARCHY", "HELLO"), "does not begin with HIERARCHY"),
    ],
)
def test_a_damaged_bvh_is_refused(change: tuple[str, str], says: str, tmp_path: Path) -> None:
    path = tmp_path / "m.bvh"
    path.write_text(BVH)
    assert ml.read_motion(path).joints_m()[1, 1, 2] == pytest.approx(0.5)
    assert change[0] in BVH
    path.write_text(BVH.replace(*change))
    with pytest.raises(MarkerloomError, match=re.escape(says)):
        ml.read_motion(path)


@settings(max_examples=60, deadline=None)
@given(at=st.integers(0, len(BVH) - 1), byte=st.sampled_from(list("}{x9 -\n\t")))
def test_no_byte_breaks_the_reader(at: int, byte: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("mutated") / "m.bvh"
    path.write_text(BVH[:at] + byte + BVH[at + 1 :])
    try:
        found = ml.read_motion(path)
    except MarkerloomError as error:
        found, said = None, str(error)
        assert "m.bvh" in said
    assert found is None or np.isfinite(found.joints_m()).all()


@pytest.mark.parametrize(
    ("file", "change", "says"),
    [
        ("amc", ("l_knee ", "l_knie "), "no moving bone 'l_knie'"),
        ("amc", (r"(?m)^l_knee .*\n", ""), "bone 'l_knee' has no numbers"),
        ("amc", (r"(?m)^(l_knee \S+).*$", r"\1"), "bone 'l_knee' needs 3 numbers"),
        ("asf", (r"(?m)^    l_knee l_talocrural$", "    l_knee l_knee"), "hangs from"),
        ("asf", (r"length \d\S+\n    axis", "length x\n    axis"), "is not 1 numbers"),
        ("asf", (r":bonedata", ":bones"), "no :bonedata"),
    ],
)
def test_a_damaged_acclaim_is_refused(file: str, change: tuple[str, str], says: str, tmp_path: Path) -> None:
    ml.write_motion(motion(), tmp_path / "m.amc")
    path = tmp_path / f"m.{file}"
    text = re.sub(change[0], change[1], path.read_text())
    assert text != path.read_text()
    path.write_text(text)
    with pytest.raises(MarkerloomError, match=re.escape(says)):
        ml.read_motion(tmp_path / "m.amc")


def test_a_table_of_poses_is_solved(tmp_path: Path) -> None:
    made = motion(seed=10, reach=0.3)
    made.turns[:, ~made.skeleton.free.all(axis=1)] = np.eye(3)
    made = replace(
        made, turns=np.repeat(made.turns[:1], FRAMES, axis=0), root_m=np.repeat(made.root_m[:1], FRAMES, axis=0)
    )
    ml.write_motion(made, tmp_path / "poses.parquet")
    import pyarrow.parquet as pq

    table = pq.read_table(tmp_path / "poses.parquet")
    pq.write_table(
        table.rename_columns(["segment" if c == "joint" else c for c in table.column_names]), tmp_path / "p.parquet"
    )
    poses = ml.read_segment_poses(tmp_path / "p.parquet", made.skeleton, rate_hz=100.0)
    again = ml.solve_segments(poses)
    assert np.abs(again.joints_m() - made.joints_m()).max() < 0.02


def test_motions_on_the_command_line(tmp_path: Path) -> None:
    from test_cli import run

    (tmp_path / "m.bvh").write_text(BVH)
    assert "motion" in run("inspect", tmp_path / "m.bvh")
    run("convert", tmp_path / "m.bvh", tmp_path / "n.bvh", "--units", "m", "--up", "z")
    again = ml.read_motion(tmp_path / "n.bvh", units="m", up="z")
    assert again.joints_m()[1, 1, 2] == pytest.approx(0.5)
    assert json.dumps(list(again.skeleton.joints)) == '["Hips", "Knee"]'


def test_c3d_holds_joints_angles_and_segments(tmp_path: Path) -> None:
    ezc3d = pytest.importorskip("ezc3d")
    made = motion(seed=11)
    ml.write_motion(made, tmp_path / "m.c3d")
    theirs = ezc3d.c3d(str(tmp_path / "m.c3d"))
    parameters, data = theirs["parameters"], theirs["data"]
    labels = parameters["POINT"]["LABELS"]["value"]
    assert parameters["POINT"]["ANGLE_UNITS"]["value"] == ["deg"]
    for joint, columns in ml.joint_angles(made).items():
        assert f"{joint}_angles" in parameters["POINT"]["ANGLES"]["value"]
        at = labels.index(f"{joint}_angles")
        assert parameters["POINT"]["DESCRIPTIONS"]["value"][at] == ", ".join(name for name, _ in columns)
        np.testing.assert_allclose(data["points"][:3, at], [v for _, v in columns], atol=1e-4)
    place = np.moveaxis(data["rotations"][:3, 3], 2, 0).transpose(0, 2, 1)
    np.testing.assert_allclose(place, 1000.0 * made.joints_m(), atol=1e-3)
    again = ml.read_points(tmp_path / "m.c3d")
    assert set(again.label) == set(made.skeleton.joints), "angles are no points"
    np.testing.assert_allclose(again.xyz_mm.reshape(FRAMES, -1, 3), 1000.0 * made.joints_m(), atol=1e-3)


@pytest.mark.parametrize("up", ["y", "z"])
def test_segments_of_a_c3d_are_solved(up: str, tmp_path: Path) -> None:
    made = _slow(motion(seed=12, reach=0.4))
    ml.write_motion(made, tmp_path / "m.c3d", up=up)
    poses = ml.read_segment_poses(tmp_path / "m.c3d")
    again = ml.solve_segments(poses)
    part_of = {j: part for part, j in reversed(made.skeleton.segments.items())}
    order = [poses.skeleton.joints.index(part_of.get(j, name)) for j, name in enumerate(made.skeleton.joints)]
    assert np.abs(again.joints_m()[:, order] - made.joints_m()).max() < 1e-3
    known = ml.joint_angles(made)
    assert len(known) == len(ml.joint_angles(again))
    for part, columns in ml.joint_angles(again).items():
        name = made.skeleton.joints[made.skeleton.segments[part]]
        for (_, own), (_, angle) in zip(columns, known[name], strict=True):
            assert np.abs((own - angle + 180.0) % 360.0 - 180.0).max() < 0.5, name


@needs_data
def test_segments_of_a_markerless_system_are_solved(tmp_path: Path) -> None:
    from test_cli import run

    path = DATA / "c3d/ezc3d/C3DRotationExample.c3d"
    poses = ml.read_segment_poses(path)
    skeleton = poses.skeleton
    above = {n: skeleton.joints[p] for n, p in zip(skeleton.joints, skeleton.parents, strict=True) if p >= 0}
    assert "worldbody" not in skeleton.joints
    assert (above["l_hand"], above["l_uarm"], above["r_toes"]) == ("l_larm", "l_clavicle", "r_foot")
    off_mm = 1000.0 * np.linalg.norm(ml.solve_segments(poses).joints_m() - poses.place_m, axis=2)
    legs = [skeleton.joints.index(n) for n in ("l_thigh", "l_shank", "l_foot", "l_toes")]
    assert np.nanmedian(off_mm[:, legs]) < 3.0
    assert "l_uarm" in run("inspect", path)
    run("solve", path, "-o", tmp_path / "m.bvh")
    assert len(ml.read_motion(tmp_path / "m.bvh")) == 340


def test_segments_without_known_names_hang_where_their_origins_stay(tmp_path: Path) -> None:
    from markerloom.formats import c3d_file

    made = motion(seed=13, reach=0.4)
    keep = [made.skeleton.joints.index(n) for n in ("humanoid_root", "l_hip", "l_knee", "l_talocrural")]
    turn, place = made.segments()
    names = ["box", "one", "two", "three"]
    points = ml.read_points(_joints(made, tmp_path))
    segments = c3d_file.Segments(names, 1000.0 * place[:, keep], turn[:, keep])
    c3d_file.write(points, tmp_path / "s.c3d", segments=segments)
    skeleton = ml.read_segment_poses(tmp_path / "s.c3d").skeleton
    assert dict(zip(skeleton.joints, skeleton.parents, strict=True))["three"] == skeleton.joints.index("two")
    segments.place_mm[:6, 0], segments.place_mm[6:, 1:] = np.nan, np.nan
    c3d_file.write(points, tmp_path / "s.c3d", segments=segments)
    with pytest.raises(MarkerloomError, match="never seen together"):
        ml.read_segment_poses(tmp_path / "s.c3d")
    with pytest.raises(MarkerloomError, match="holds no poses of segments"):
        ml.read_segment_poses(_joints(made, tmp_path))


def _slow(made: Motion) -> Motion:
    """From the pose of its first frame to that of its second, in a second."""
    part = np.linspace(0.0, 1.0, 100)
    first, second = (Rotation.from_matrix(made.turns[f]) for f in (0, 1))
    step = (first.inv() * second).as_rotvec()
    turns = np.stack([(first * Rotation.from_rotvec(p * step)).as_matrix() for p in part])
    return Motion(made.skeleton, np.outer(part, [1.0, 0.5, 0.2]), turns, 100.0)


def _joints(made: Motion, folder: Path) -> Path:
    from markerloom.skeleton.tables import as_points

    as_points(made).save(folder / "joints.c3d")
    return folder / "joints.c3d"


def test_poses_alone_have_no_markers_to_speak_of(tmp_path: Path) -> None:
    from test_cli import run

    made = _slow(motion(seed=14, reach=0.3))
    ml.write_motion(made, tmp_path / "poses.csv")
    page = tmp_path / "p.html"
    solve = ("solve", tmp_path / "poses.csv", "-o", tmp_path / "m.bvh", "--rate-hz", "100")
    assert "--page belong to a take with markers" in run(*solve, "--page", page, code=1)
    assert not (tmp_path / "m.bvh").exists()
    run(*solve)
    assert len(ml.read_motion(tmp_path / "m.bvh")) == 100


def test_a_solved_take_holds_its_markers_and_can_be_solved_again(tmp_path: Path) -> None:
    from skeleton_truth import rom
    from test_cli import run
    from test_label import points_of

    names, xyz_mm, _, _ = rom(seed=3, frames=300, rate_hz=50.0)
    points_of(xyz_mm, [f"Anna:{n}" for n in names]).save(tmp_path / "take.c3d")
    run("solve", tmp_path / "take.c3d", "-o", tmp_path / "solved.c3d")
    labels = set(ml.read_points(tmp_path / "solved.c3d").label)
    assert {f"Anna:{names[0]}", "Anna:l_knee"} <= labels
    assert "markers on no segment" in run("solve", tmp_path / "solved.c3d", "-o", tmp_path / "again.bvh")
