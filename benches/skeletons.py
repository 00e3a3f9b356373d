"""Skeletons against truth: joint centres, residuals, speed, swaps, gaps, feet, files; beside OpenSim where it is there.

    python benches/skeletons.py [joints short real speed swap gap gaps feet files glb opensim]

Simulated: a range of motion of 41 s at 100 Hz, 53 markers, 1 mm of noise, three body sizes (seeds 0, 1, 2).
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import markerloom as ml
from markerloom import _core
from markerloom.points import Points
from markerloom.skeleton.contacts import Contact, slides_mm
from markerloom.skeleton.takes import named_markers
from skeleton_truth import joint_errors_mm, rom

DATA = Path(__file__).resolve().parents[2] / "shared/data"
HINTS = Path(__file__).resolve().parents[1] / "docs/guides/fullbody-44-hints.toml"
FRAMES, RATE = 4100, 100.0


def points_of(names: list[str], xyz_mm: np.ndarray) -> Points:
    """Markers by name as points."""
    frames, markers = xyz_mm.shape[:2]
    frame, slot = np.divmod(np.arange(frames * markers), markers)
    label = np.array(names, dtype=str)[slot]
    return Points.of(
        frame, slot, xyz_mm.reshape(-1, 3), label=label, rate_hz=RATE, frames=np.arange(frames), source="simulated"
    )


def taken(seed: int) -> tuple[Points, list[str], np.ndarray]:
    names, xyz_mm, joints, centers_mm = rom(seed=seed, frames=FRAMES)
    return points_of(names, xyz_mm), joints, centers_mm


def rms(errors: dict[str, float]) -> float:
    return float(np.sqrt(np.mean(np.square(list(errors.values())))))


def joints() -> None:
    print("seed  stature_m  joint centres, mm rms (worst joint)   residual / noise   bones constant to, m")
    for seed in range(3):
        points, names, centers_mm = taken(seed)
        solved = ml.solve(points, contacts=False)
        errors = joint_errors_mm(solved.motion, names, centers_mm)
        worst = max(errors, key=lambda j: errors[j])
        places, parents = solved.motion.joints_m(), np.array(solved.motion.skeleton.parents)
        lengths = np.linalg.norm(places[:, 1:] - places[:, parents[1:]], axis=2)
        ratio = solved.report["residual_mm"]["rms"] / np.sqrt(3.0)
        stature = solved.wearer.skeleton.stature_m
        print(f"{seed}     {stature:.3f}      {rms(errors):.2f} ({worst} {errors[worst]:.2f})   {ratio:.2f}", end="   ")
        print(f"{np.ptp(lengths, axis=0).max():.1e}")


def short() -> None:
    """Three seconds of walking show no joint over its range: what is known before counts."""
    for seed in range(3):
        names, xyz_mm, joints_, centers_mm = rom(seed=seed, frames=300, motion="walk")
        errors = joint_errors_mm(ml.solve(points_of(names, xyz_mm), contacts=False).motion, joints_, centers_mm)
        worst = max(errors, key=lambda j: errors[j])
        print(f"walk of 3 s, seed {seed}: joint centres {rms(errors):.1f} mm rms ({worst} {errors[worst]:.1f})")


def real() -> None:
    points = ml.read_points(DATA / "labelling/fullbody-44.c3d")
    for skeleton in ("hanim-loa1", "hanim-loa2"):
        started = time.perf_counter()
        solved = ml.solve(points, skeleton, known=ml.read_hints(HINTS))
        off = solved.report["residual_mm"]
        print(f"fullbody-44 {skeleton}: {off['rms']:.2f} mm rms, {off['median']:.2f} median, "
              f"{len(solved.contacts)} contacts, {time.perf_counter() - started:.1f} s with the fit")  # fmt: skip
    points = ml.read_points(DATA / "labelling/cmu-85_02.c3d")
    for skeleton in ("hanim-loa1", "hanim-loa2"):
        off = ml.solve(points, skeleton).report["residual_mm"]
        print(f"cmu-85_02 {skeleton}: {off['rms']:.2f} mm rms, {off['median']:.2f} median")


def speed() -> None:
    points, *_ = taken(0)
    names, xyz_m, _ = named_markers(points)
    for skeleton in ("hanim-loa1", "hanim-loa2"):
        started = time.perf_counter()
        wearer = ml.fit_skeleton(names, xyz_m, ml.read_skeleton(skeleton))
        print(f"{skeleton}: fitted in {time.perf_counter() - started:.1f} s, all cores")
        figure = wearer.figure()
        worn = np.ascontiguousarray(xyz_m[:, [names.index(m) for m in wearer.markers]])
        best_live, best_take = np.inf, np.inf
        for _ in range(3):
            follower = _core.Follower(figure, 1.0 / RATE)
            started = time.perf_counter()
            for frame in worn:
                follower.push(frame)
            best_live = min(best_live, time.perf_counter() - started)
            started = time.perf_counter()
            figure.solve(worn, 1.0 / RATE, [], [])
            best_take = min(best_take, time.perf_counter() - started)
        each = 1000.0 / len(worn)
        print(f"{skeleton}: live {best_live * each:.3f} ms per frame, whole take (both ways, uncertainty) "
              f"{best_take * each:.3f} ms; one thread")  # fmt: skip


def swap() -> None:
    points, names, centers_mm = taken(1)
    solved = ml.solve(points, contacts=False)
    print("pair swapped for 20 frames: joint error within them, mm rms, without and with")
    for left, right in (("LKNE", "RKNE"), ("LOWR", "ROWR"), ("LTOE", "RTOE"), ("LFHD", "RFHD")):
        label = points.label.copy()
        inside = (points.frame >= 1400) & (points.frame < 1420)
        label[inside & (points.label == left)] = right
        label[inside & (points.label == right)] = left
        track = np.unique(label, return_inverse=True)[1].astype(np.int64)
        again = ml.solve(replace(points, label=label, track=track), solved.wearer, contacts=False)
        window = slice(1400, 1420)
        before = joint_errors_mm(solved.motion, names, centers_mm, window)
        after = joint_errors_mm(again.motion, names, centers_mm, window)
        joint = max(after, key=lambda j: after[j] / before[j])
        print(f"  {left}/{right}: {rms(before):.2f} → {rms(after):.2f}; worst joint {joint} "
              f"{before[joint]:.2f} → {after[joint]:.2f}")  # fmt: skip


def gap() -> None:
    points, *_ = taken(1)
    solved = ml.solve(points, contacts=False)
    skeleton = solved.wearer.skeleton
    wrist, first = skeleton.index("l_radiocarpal"), skeleton.index("l_shoulder")
    arm = [m for m, j in zip(solved.wearer.markers, solved.wearer.joints, strict=True) if first <= j <= wrist]
    whole = solved.motion.joints_m()[:, wrist]
    sharpest = np.linalg.norm(np.diff(whole, 2, axis=0), axis=1).max() * RATE**2
    print(f"0.5 s without the left arm; the wrist's largest acceleration in the take: {sharpest:.0f} m/s²")
    for start in (1100, 1250, 1400):
        gone = (points.frame >= start) & (points.frame < start + 50) & np.isin(points.label, arm)
        ours = ml.solve(points.keep(~gone), solved.wearer, contacts=False).motion.joints_m()[:, wrist]
        bend = np.linalg.norm(np.diff(ours, 2, axis=0), axis=1)[start - 5 : start + 60].max() * RATE**2
        off = np.linalg.norm(ours - whole, axis=1)
        print(f"  from frame {start}: acceleration {bend:.0f} m/s², off by at most {1000 * off.max():.0f} mm within, "
              f"{1000 * off[start + 55 :].max():.2f} mm from the 5th frame after")  # fmt: skip


def gaps() -> None:
    """The same in many places: half a second in every four, three bodies."""
    sharp, off = [], []
    for seed in range(3):
        points, *_ = taken(seed)
        solved = ml.solve(points, contacts=False)
        skeleton = solved.wearer.skeleton
        wrist, first = skeleton.index("l_radiocarpal"), skeleton.index("l_shoulder")
        arm = [m for m, j in zip(solved.wearer.markers, solved.wearer.joints, strict=True) if first <= j <= wrist]
        whole = solved.motion.joints_m()[:, wrist]
        sharpest = np.linalg.norm(np.diff(whole, 2, axis=0), axis=1).max()
        for shift in range(0, 400, 100):
            starts = range(300 + shift, len(whole) - 200, 400)
            hidden = np.isin(points.frame, [f for start in starts for f in range(start, start + 50)])
            kept = points.keep(~(hidden & np.isin(points.label, arm)))
            ours = ml.solve(kept, solved.wearer, contacts=False).motion.joints_m()[:, wrist]
            bends = np.linalg.norm(np.diff(ours, 2, axis=0), axis=1)
            sharp += [bends[start - 5 : start + 60].max() / sharpest for start in starts]
            off += [1000 * np.linalg.norm(ours - whole, axis=1)[start : start + 50].max() for start in starts]
    print(f"{len(sharp)} gaps: acceleration over the take's largest {np.median(sharp):.2f} (median), "
          f"{np.quantile(sharp, 0.9):.2f} (90 %), above 1 in {np.mean(np.array(sharp) > 1):.0%}; off by at most "
          f"{np.median(off):.1f} mm (median), {np.quantile(off, 0.9):.1f} mm (90 %)")  # fmt: skip


def feet() -> None:
    """Real feet: how far standing places slide before and after, and what it changed elsewhere."""
    points = ml.read_points(DATA / "labelling/cmu-85_02.c3d")
    free = ml.solve(points, "hanim-loa2", contacts=False)
    held = ml.solve(points, free.wearer)
    contacts: list[Contact] = held.contacts
    before, after = slides_mm(free.motion, contacts), held.report["contacts"]
    changed = 1000.0 * np.linalg.norm(held.motion.joints_m() - free.motion.joints_m(), axis=2)
    skeleton = free.motion.skeleton
    feet_ = {skeleton.segments[s] for s in ("left_foot", "right_foot")}
    elsewhere = changed[:, [j for j in range(len(skeleton)) if feet_.isdisjoint([j, *skeleton.above(j)])]]
    often = np.mean(elsewhere.max(axis=1) > 10.0)
    worst = {k: (max(c[k] for c in before), max(c[k] for c in after)) for k in ("slides_mm", "sinks_mm")}
    print(f"cmu-85_02, {len(contacts)} contacts: slide {worst['slides_mm'][0]:.2f} → {worst['slides_mm'][1]:.2f} mm, "
          f"sink {worst['sinks_mm'][0]:.2f} → {worst['sinks_mm'][1]:.2f} mm; changed: any joint by at most "
          f"{changed.max():.1f} mm, all but of feet {np.percentile(elsewhere, 99):.1f} mm (99 %), more than 10 mm "
          f"in {often:.1%} of the frames")  # fmt: skip


def files() -> None:
    folder = DATA / "asf-amc"
    amc = ml.read_motion(folder / "171025_Guy_ROM_body_01_blade.amc")
    bvh = ml.read_motion(folder / "171025_Guy_ROM_body_01_blade.bvh", units="in")
    print(f"Blade AMC and BVH: joints at most {_apart_mm(amc, bvh):.4f} mm apart")
    mobu = ml.read_motion(DATA / "bvh/mobu-rom.bvh")
    picked = replace(bvh, root_m=bvh.root_m[[59, 119]], turns=bvh.turns[[59, 119]], sigma_mm=bvh.sigma_mm[:2])
    other = replace(mobu, root_m=mobu.root_m[[12, 24]], turns=mobu.turns[[12, 24]], sigma_mm=mobu.sigma_mm[:2])
    print(f"Blade and MotionBuilder BVH, at moments both hold: {_apart_mm(picked, other):.4f} mm")
    cmu = ml.read_motion(folder / "01_01.amc").joints_m()
    same = ml.read_motion(folder / "01_01.bvh", units=str(0.0254 / 0.45)).joints_m()[1:]
    frames = min(len(cmu), len(same))
    off = np.linalg.norm(cmu[:frames, :14] - same[:frames, :14], axis=2)
    print(f"CMU 01 AMC and BVH, legs and spine: {1000 * off.max():.4f} mm")
    _inertial()


def _inertial() -> None:
    solved = ml.solve_segments(ml.read_segment_poses(DATA / "mvnx/test_mocap.mvnx"))
    theirs = ml.read_motion(DATA / "mvnx/test_mocap.bvh")
    # Both list the same joints from the pelvis on, but for the order of the sides.
    same = {"UpperArm": "Shoulder", "ForeArm": "Elbow", "Hand": "Wrist", "Shoulder": "Collar", "UpperLeg": "Hip"}
    same |= {"LowerLeg": "Knee", "Foot": "Ankle", "Toe": "Toe"}
    pairs = [(f"{side}{a}", f"{side}{b}") for side in ("Left", "Right") for a, b in same.items()]
    pairs += [("Pelvis", "Hips"), ("L5", "Chest"), ("L3", "Chest2"), ("T12", "Chest3"), ("T8", "Chest4")]
    pairs += [("Neck", "Neck"), ("Head", "Head")]
    ours = [solved.skeleton.joints.index(a) for a, _ in pairs]
    other = [theirs.skeleton.joints.index(b) for _, b in pairs]
    (turn, place), (their_turn, their_place) = solved.segments(), theirs.segments()
    off = np.linalg.norm(place[1:, ours] - their_place[1:, other], axis=2)
    between = np.swapaxes(turn[1:, ours], 2, 3) @ their_turn[1:, other]
    angle = np.rad2deg(Rotation.from_matrix(between.reshape(-1, 3, 3)).magnitude())
    print(f"MVNX solved, beside Xsens' BVH: at most {1000 * off.max():.2f} mm and {angle.max():.2f} deg")


def glb() -> None:
    """A motion as GLB and its joints as JSON, for `node glb_in_three.mjs` (npm install three), and as USD here."""
    points, *_ = taken(0)
    motion = ml.solve(points, contacts=False).motion.select(0, 500)
    folder = Path("out/glb")
    folder.mkdir(parents=True, exist_ok=True)
    ml.write_motion(motion, folder / "motion.glb")
    ml.write_motion(motion, folder / "motion.usda")
    x, y, z = motion.joints_m()[250].T
    content = {"seconds": 250 / RATE, "joints": list(motion.skeleton.joints)}
    content["places_m"] = np.column_stack([x, z, -y]).tolist()
    (folder / "motion.json").write_text(json.dumps(content))
    usd, skel = import_module("pxr.Usd"), import_module("pxr.UsdSkel")
    stage: Any = usd.Stage.Open(str(folder / "motion.usda"))
    cache: Any = skel.Cache()
    cache.Populate(skel.Root(stage.GetDefaultPrim()), usd.PrimDefaultPredicate)
    query = cache.GetSkelQuery(skel.Skeleton(stage.GetPrimAtPath("/Figure/Skeleton")))
    found = np.array([m.ExtractTranslation() for m in query.ComputeJointSkelTransforms(usd.TimeCode(250))])
    off = 1000.0 * np.linalg.norm(found - motion.joints_m()[250], axis=1).max()
    print(f"USD in usd-core: joints at most {off:.5f} mm off")
    print(f"then: cd {folder}; cp ../../benches/glb_in_three.mjs .; npm install three; node glb_in_three.mjs")


def _apart_mm(one: ml.Motion, two: ml.Motion) -> float:
    both = [n for n in one.skeleton.joints if n in two.skeleton.joints]
    a, b = (m.joints_m()[:, [m.skeleton.joints.index(n) for n in both]] for m in (one, two))
    return 1000.0 * float(np.linalg.norm(a - b, axis=2).max())


def opensim() -> None:
    """The same model and markers solved by OpenSim's InverseKinematicsTool."""
    try:
        osim: Any = import_module("opensim")
    except ImportError:
        print("opensim: not installed (pip install opensim)")
        return
    points, *_ = taken(0)
    short = points.select(0, 500)
    solved = ml.solve(points, contacts=False)
    wearer = solved.wearer
    with tempfile.TemporaryDirectory() as folder:
        model, trc, mot = (Path(folder) / name for name in ("m.osim", "m.trc", "ik.mot"))
        glued = list(zip(wearer.markers, wearer.joints, wearer.places_m, strict=True))
        ml.write_motion(solved.motion.select(0, 500), model, markers=glued, preset="opensim")
        x, y, z = short.xyz_mm.T
        ml.write_points(replace(short, xyz_mm=np.column_stack([x, z, -y]), up_axis="y"), trc)
        tool = osim.InverseKinematicsTool()
        loaded = osim.Model(str(model))
        loaded.initSystem()
        tool.setModel(loaded)
        tool.setMarkerDataFileName(str(trc))
        tool.setStartTime(0.0)
        tool.setEndTime(4.99)
        tool.setOutputMotionFileName(str(mot))
        tool.set_report_errors(False)
        started = time.perf_counter()
        tool.run()
        theirs_s = time.perf_counter() - started
        names, xyz_m, _ = named_markers(short)
        worn = np.ascontiguousarray(xyz_m[:, [names.index(m) for m in wearer.markers]])
        figure = wearer.figure()
        started = time.perf_counter()
        poses, _ = figure.solve(worn, 1.0 / RATE, [], [])
        ours_s = time.perf_counter() - started
        ours = 1000.0 * np.sqrt(np.nanmean(figure.residuals_m(worn, *poses) ** 2))
        theirs = _opensim_residual_mm(osim, model, mot, wearer, worn)
    print(f"OpenSim IK: {2 * theirs_s:.2f} ms per frame, {theirs:.3f} mm rms")
    # Least squares, each frame for itself, as OpenSim does: no marker is an outlier, and the next frame is far away.
    for name, sigma_m, step_s in (("each frame for itself", 0.003, 1e3), ("live", 0.001, 1.0 / RATE)):
        live_s, live = _pushed(replace(wearer, sigmas_m=np.full(len(wearer.markers), sigma_m)), worn, step_s)
        print(f"ours, {name}: {2 * live_s:.3f} ms, {live:.3f} mm rms: {theirs_s / live_s:.0f} times faster")
    print(f"ours, whole take, smoothed: {2 * ours_s:.3f} ms, {ours:.3f} mm rms: {theirs_s / ours_s:.0f} times faster")


def _pushed(wearer: ml.Wearer, worn: np.ndarray, step_s: float) -> tuple[float, float]:
    """Seconds and residual (mm rms) of a follower."""
    figure = wearer.figure()
    follower = _core.Follower(figure, step_s)
    started = time.perf_counter()
    pushed = [follower.push(frame) for frame in worn]
    seconds = time.perf_counter() - started
    root, turns, place = (np.concatenate(part) for part in zip(*[p for p in pushed if p is not None], strict=True))
    return seconds, 1000.0 * float(np.sqrt(np.nanmean(figure.residuals_m(worn, root, turns, place) ** 2)))


def _opensim_residual_mm(osim: Any, model: Path, mot: Path, wearer: ml.Wearer, worn: np.ndarray) -> float:
    loaded = osim.Model(str(model))
    state = loaded.initSystem()
    table = osim.TimeSeriesTable(str(mot))
    labels = list(table.getColumnLabels())
    squares = []
    for f in range(table.getNumRows()):
        row = table.getRowAtIndex(f)
        for i, name in enumerate(labels):
            coordinate = loaded.getCoordinateSet().get(name)
            turns = coordinate.getMotionType() == 1
            coordinate.setValue(state, np.deg2rad(row[i]) if turns else row[i], False)
        loaded.realizePosition(state)
        for m, marker in enumerate(wearer.markers):
            at = loaded.getMarkerSet().get(marker).getLocationInGround(state)
            x, y, z = worn[f, m]
            squares.append(float(np.sum((np.array([at.get(k) for k in range(3)]) - [x, z, -y]) ** 2)))
    return 1000.0 * float(np.sqrt(np.mean(squares)))


ROWS = {r.__name__: r for r in (joints, short, real, speed, swap, gap, gaps, feet, files, glb, opensim)}

if __name__ == "__main__":
    for row in sys.argv[1:] or list(ROWS):
        ROWS[row]()
