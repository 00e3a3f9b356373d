"""Motion as material: bands, warping, retargeting, feet, joins, graphs; beside fairmotion and bvhsdk where they are.

    python benches/motion.py [bands warp retarget speed footlock joins graph peers] [--peers PYTHON]

Real clips from ../shared/data (bvh, asf-amc), and a simulated walk. ``--peers``: a Python that has fairmotion and
bvhsdk.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

import markerloom as ml
from markerloom import _core
from markerloom.motion.body import body_of
from markerloom.motion.mapping import followed, indices
from markerloom.skeleton import Motion, Skeleton

DATA = Path(__file__).resolve().parents[2] / "shared/data"
CLIPS = (
    "asf-amc/02_01.amc",
    "asf-amc/02_03.amc",
    "asf-amc/02_04.amc",
    "bvh/dataset-1_kick_normal_001.bvh",
    "bvh/dataset-1_run_active_001.bvh",
    "bvh/dataset-2_walk_normal_001.bvh",
    "bvh/test_freebvh.bvh",
    "bvh/test_mocapbank.bvh",
    "bvh/mobu-rom.bvh",
)
UNSEEN = ("asf-amc/01_01.amc", "asf-amc/171025_Guy_ROM_body_01_blade.bvh")
"""Clips that no constant of retargeting was chosen on."""
PATIENCE_S = 240
"""Other programs are waited for so long."""
BODIES = ("bvh/test_freebvh.bvh", "bvh/test_mocapbank.bvh", "asf-amc/01.asf", "hanim-loa1", "hanim-loa2")


@cache
def clip(name: str) -> Motion:
    """A clip by its file, or the tests' walk, whose feet stand exactly until it drifts to and fro by 6 mm."""
    if name == "simulated walk":
        sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
        return import_module("motion_clips").walk(10.0, slip_m=0.006)
    return ml.motion.with_constant_bones(ml.read_motion(DATA / name))[0]


def short(name: str) -> str:
    """A file's name."""
    return Path(name).stem


def with_limbs(skeleton: Skeleton, factor: float) -> Skeleton:
    """The same skeleton with longer or shorter arms and legs."""
    body = body_of(skeleton)
    limbs = {*body.group("legs"), *body.group("arms")}
    offsets = skeleton.offsets_m.copy()
    inner = [j for j in limbs if skeleton.parents[j] in limbs]
    offsets[inner] *= factor
    sites = [
        replace(s, place_m=tuple((np.array(s.place_m) * factor).tolist())) if s.joint in limbs else s
        for s in skeleton.sites
    ]
    return replace(skeleton, name=f"limbs x {factor}", offsets_m=offsets, sites=tuple(sites))


def seconds(run: Callable[[], Any], times: int = 3) -> float:
    """The shortest of several runs."""
    took = []
    for _ in range(times):
        start = time.perf_counter()
        run()
        took.append(time.perf_counter() - start)
    return min(took)


def bands() -> None:
    """Unit gains, and time as frames grow."""
    worst = 0.0
    for name in CLIPS:
        motion = clip(name)
        out = ml.motion.bands(motion, root=True).motion
        off = np.concatenate([(out.turns - motion.turns).ravel(), (out.root_m - motion.root_m).ravel()])
        worst = max(worst, float(np.sqrt((off**2).mean())))
    print(f"bands, unit gains, {len(CLIPS)} clips: {worst:.1e} rms")
    rng = np.random.default_rng(0)
    for frames in (10_000, 20_000, 40_000):
        values = rng.normal(size=(frames, 60)).cumsum(axis=0)
        gains = np.ones((_core.band_count(frames) + 1, 60))
        took = seconds(lambda v=values, g=gains: _core.equalise_bands(v, g))
        print(f"  {frames} frames x 60 channels, {len(gains) - 1} bands: {1000 * took:.1f} ms")


def warp() -> None:
    """Key errors, and a clip without keys."""
    worst, same = 0.0, True
    rng = np.random.default_rng(0)
    for name in CLIPS:
        motion = clip(name)
        for by in ("shift", "scale"):
            at = sorted(rng.choice(len(motion), 4, replace=False).tolist())
            joints = rng.choice(motion.skeleton.joints[1:], 3, replace=False).tolist()
            keys = [ml.motion.by_angles(motion, f, {j: rng.uniform(-60, 60, 3).tolist() for j in joints}) for f in at]
            keys.append(ml.motion.Key(at[1], {}, rng.normal(size=3)))
            missed = ml.motion.warp(motion, keys, by=by).report["key_error"]
            worst = max(worst, missed["rad"], missed["m"])
            none = ml.motion.warp(motion, [], by=by).motion
            same &= np.array_equal(none.turns, motion.turns) and np.array_equal(none.root_m, motion.root_m)
    print(
        f"warp, {2 * len(CLIPS)} runs with 4 keys: error at most {worst:.1e} (rad, m); without keys same bits: {same}"
    )


def sharp(out: Motion, source: Motion) -> np.ndarray:
    """How sharp the joints that follow one are beside it."""
    pairs = indices(ml.motion.guess(source.skeleton, out.skeleton), source.skeleton, out.skeleton)
    own = ml.motion.sharpness(out, [(source, np.arange(len(out), dtype=float))], followed(out.skeleton, pairs))
    return own[:, sorted(pairs)]


def on_another_body(name: str, label: str, body: Callable[[Motion], Skeleton]) -> tuple[Motion, ml.motion.Edited]:
    """A clip, and what it becomes on another body."""
    motion = clip(name)
    shown = replace(motion, skeleton=body(motion)) if label.startswith("limbs") else None
    return motion, ml.motion.retarget(motion, body(motion), target_motion=shown)


def retarget() -> None:
    """Every clip on limbs of other lengths and on other bodies."""
    names = [*CLIPS, "simulated walk"]
    targets: list[tuple[str, Callable[[Motion], Skeleton]]] = [
        ("limbs x 0.7", lambda m: with_limbs(m.skeleton, 0.7)),
        ("limbs x 1.3", lambda m: with_limbs(m.skeleton, 1.3)),
        *((short(b), lambda _, b=b: ml.read_skeleton(b if b.startswith("hanim") else DATA / b)) for b in BODIES),
    ]
    for label, body in targets:
        slide, floor, missed, sharpest, over, samples, most, calmed = 0.0, 0.0, 0.0, [], 0, 0, 0.0, {}
        for name in names:
            motion, out = on_another_body(name, label, body)
            if "plants" not in out.report:
                continue
            own = sharp(out.motion, motion)
            sharpest.append(float(own.max()))
            over, samples = over + int((own > 1.5).sum()), samples + own.size
            slide, floor = max(slide, out.report["slide_mm"]), max(floor, out.report["in_floor_mm"])
            missed = max(missed, *out.report["missed_mm"].values())
            most = max(most, out.report["leg_stretch"])
            calmed[short(name)] = out.report["calmed_mm"]["max"]
        within = sum(s <= 1.5 for s in sharpest)
        print(
            f"retarget to {label}, {len(sharpest)} clips: slide {slide:.3f} mm, floor {floor:.3f} mm, constraints "
            f"{missed:.3f} mm, leg stretch {most:.0f} %; acceleration {np.median(sharpest):.2f} x the source's in the "
            f"median clip, {max(sharpest):.2f} x in the worst, within 1.5 x in {within} of {len(sharpest)} clips and "
            f"{100 * (1 - over / samples):.2f} % of samples; smoothed by up to "
            + ", ".join(f"{mm:.0f} mm ({name})" for name, mm in sorted(calmed.items(), key=lambda c: -c[1])[:2])
        )
        unseen = [on_another_body(name, label, body) for name in UNSEEN]
        others = [float(sharp(out.motion, motion).max()) for motion, out in unseen if "plants" in out.report]
        print("  clips that no constant was chosen on: " + ", ".join(f"{w:.2f} x" for w in others))
    worst = max(
        float(np.abs(ml.motion.retarget(clip(n), clip(n).skeleton).motion.turns - clip(n).turns).max()) for n in names
    )
    print(f"retarget to the same skeleton: changed by {worst:.1e}")


def speed() -> None:
    """A thousand frames with twenty stances."""
    motion = clip("asf-amc/01_01.amc")
    feet = ml.motion.feet_of(body_of(motion.skeleton))
    plants = ml.motion.find_plants(motion, feet)
    counts = [(abs(sum(s <= p.start < s + 1000 for p in plants) - 20), s) for s in range(0, len(motion) - 1000, 50)]
    start = min(counts)[1]
    part = ml.motion.crop(motion, start=start, stop=start + 1000).motion
    target = with_limbs(part.skeleton, 1.3)
    out = ml.motion.retarget(part, target)
    took = seconds(lambda: ml.motion.retarget(part, target))
    lock = seconds(lambda: ml.motion.footlock(part))
    size = f"1000 frames x {len(part.skeleton)} joints x {out.report['plants']} stances"
    print(f"speed, {size}: retarget {took:.2f} s, footlock {lock:.2f} s")


def footlock() -> None:
    """Feet held on every clip."""
    for name in (*CLIPS, "simulated walk"):
        report = ml.motion.footlock(clip(name)).report
        before = report["before"]
        held = f"slide {before['slide_mm']:.1f} -> {report['slide_mm']:.3f} mm"
        floor = f"floor {before['in_floor_mm']:.1f} -> {report['in_floor_mm']:.3f} mm"
        moved = (
            f"elsewhere {report['moved_elsewhere_mm']:.1f} mm, 99 % of all joints {report['moved_mm']['p99']:.1f} mm"
        )
        print(f"footlock {short(name)}: {report['plants']} stances, {held}, {floor}, {moved}")


def joins() -> None:
    """Blends and chains of clips."""
    a, b, c = (clip(f"asf-amc/{n}.amc") for n in ("02_01", "02_03", "02_04"))
    kick, run, walk = (clip(n) for n in CLIPS[3:6])
    made = {
        "blend 02_01, 02_03": ml.motion.blend(a, b),
        "blend 02_01, 02_04": ml.motion.blend(a, c),
        "blend walk, kick": ml.motion.blend(walk, kick),
        "blend walk, run": ml.motion.blend(walk, run),
        "concat 02_01, 02_03, 02_04": ml.motion.concatenate([a, b, c]),
        "concat walk, kick, run": ml.motion.concatenate([walk, kick, run]),
        "neutral 02_01, 02_04": ml.motion.through_neutral([a, c]),
        "loop 02_01 x 4": ml.motion.loop(a, times=4),
        "loop walk x 4": ml.motion.loop(walk, times=4),
        "loop run x 4": ml.motion.loop(run, times=4),
    }
    for label, out in made.items():
        worst = max(j["sharpness"] for j in out.report["joins"])
        print(f"{label}: joins {worst:.2f} x as sharp as the clips, slide {out.report['slide_mm']:.3f} mm")


@cache
def library_clips() -> tuple[Motion, ...]:
    """Clips of one skeleton and their mirror images, about 10,000 frames."""
    first = clip("asf-amc/02_01.amc")
    own = [first, clip("asf-amc/02_03.amc"), clip("asf-amc/02_04.amc")]
    climb = ml.motion.retarget(clip("asf-amc/01_01.amc"), first.skeleton).motion
    own += [replace(climb, source="01_01.amc")]
    walk = ml.motion.retarget(
        ml.motion.resample(clip("bvh/dataset-2_walk_normal_001.bvh"), 120.0).motion, first.skeleton
    )
    own += [replace(walk.motion, source="dataset-2_walk.bvh", rate_hz=first.rate_hz)]
    return tuple(own + [replace(ml.motion.mirror(m).motion, source=f"mirrored {m.source}") for m in own])


def graph() -> None:
    """A library of about 10,000 frames: indexed, walked, followed, searched."""
    clips = list(library_clips())
    start = time.perf_counter()
    library = ml.motion.build(clips)
    built = time.perf_counter() - start
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "library.sqlite"
        start = time.perf_counter()
        ml.motion.write_library(library, path)
        stored = time.perf_counter() - start
        found = seconds(lambda: ml.motion.find(path, clips[0], 100))
    frames = sum(len(c) for c in clips)
    print(
        f"graph, {frames} frames: {len(library.transitions)} transitions in {built:.1f} s, stored in {stored:.1f} s, "
        f"a moment found in {found:.2f} s"
    )
    for seed in range(3):
        start = time.perf_counter()
        out = ml.motion.walk(library, 60.0, seed=seed)
        took = time.perf_counter() - start
        worst = max(j["sharpness"] for j in out.report["joins"])
        said = f"{out.report['transitions']} transitions, joins {worst:.2f} x as sharp as the clips"
        print(f"  walk of 60 s, seed {seed}: {said}, slide {out.report['slide_mm']:.3f} mm, {took:.1f} s")
    out = ml.motion.follow(library, np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0]]))
    off = out.report["off_line_m"]
    said = f"{off['rms']:.2f} m rms from it, {off['max']:.2f} m at most"
    print(f"  7 m along a line with a corner: {said}, slide {out.report['slide_mm']:.3f} mm")


def stances(motion: Motion) -> tuple[float, int]:
    """How far feet slide while they stand (mm), by our own finding."""
    feet = ml.motion.feet_of(body_of(motion.skeleton))
    plants = ml.motion.find_plants(motion, feet)
    return ml.motion.slides(motion, feet, plants, ml.motion.floor_m(motion, feet, plants))["slide_mm"], len(plants)


def peers(python: str | None) -> None:
    """fairmotion and bvhsdk on the same clips."""
    if python is None:
        print("peers: give --peers PYTHON, one that has fairmotion and bvhsdk")
        return
    script = Path(__file__).with_name("peer_motion.py")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)

        def run(*arguments: object) -> float:
            # A session of its own: what has workers is ended with them.
            command = [python, str(script), *map(str, arguments)]
            pipe = subprocess.PIPE
            with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, start_new_session=True) as program:
                try:
                    said, wrong = program.communicate(timeout=PATIENCE_S)
                except subprocess.TimeoutExpired:
                    os.killpg(program.pid, signal.SIGKILL)
                    print(f"  {arguments[0]}: not done after {PATIENCE_S} s")
                    return float("nan")
            if program.returncode:
                print("  ", wrong.strip().splitlines()[-1])
                return float("nan")
            return float(said.split()[-1])

        _peer_blend(folder, run)
        _peer_walk(folder, run)
        _peer_retarget(folder, run)


def _peer_blend(folder: Path, run: Callable[..., float]) -> None:
    a, b = clip("asf-amc/02_01.amc"), clip("asf-amc/02_03.amc")
    for motion, name in ((a, "a"), (b, "b")):
        ml.write_motion(motion, folder / f"{name}.bvh")
    theirs_s = run("blend", folder / "a.bvh", folder / "b.bvh", folder / "blend.bvh")
    ours_s = seconds(lambda: ml.motion.concatenate([a, b], length_s=0.4))
    ours = ml.motion.concatenate([a, b], length_s=0.4)
    if (folder / "blend.bvh").exists():
        theirs = ml.read_motion(folder / "blend.bvh")
        leave = len(a) - 48
        frames = [np.where(np.arange(len(theirs)) < len(a), np.arange(len(theirs), dtype=float), np.nan)]
        frames.append(np.where(np.arange(len(theirs)) >= leave, np.arange(len(theirs)) - float(leave), np.nan))
        sharpest = ml.motion.sharpness(theirs, [(a, frames[0]), (b, frames[1])])[leave - 3 : len(a) + 3].max()
        said = f"{sharpest:.2f} x as sharp, feet slide {_slid(theirs, ours):.1f} mm"
        print(f"append 02_03 to 02_01: fairmotion {said}, {theirs_s:.2f} s")
    worst = max(j["sharpness"] for j in ours.report["joins"])
    print(f"  ours {worst:.2f} x as sharp, feet slide {ours.report['slide_mm']:.3f} mm, {ours_s:.2f} s")


def _slid(motion: Motion, like: ml.motion.Edited) -> float:
    """How far feet slide in another motion of the same frames during the stances of ours (mm)."""
    body = body_of(like.motion.skeleton)
    feet = ml.motion.feet_of(body)
    plants = [p for p in ml.motion.find_plants(like.motion, feet) if p.stop <= len(motion)]
    return ml.motion.slides(motion, ml.motion.feet_of(body_of(motion.skeleton)), plants, 0.0)["slide_mm"]


def _peer_walk(folder: Path, run: Callable[..., float]) -> None:
    clips = [clip(f"asf-amc/{n}.amc") for n in ("02_01", "02_03", "02_04")]
    for k, motion in enumerate(clips):
        ml.write_motion(motion, folder / f"{k}.bvh")
    took = run("walk", folder / "walk.bvh", 20, *(folder / f"{k}.bvh" for k in range(3)))
    if (folder / "walk.bvh").exists():
        made = ml.read_motion(folder / "walk.bvh")
        slide, count = stances(made)
        p99 = float(np.percentile(ml.motion.accelerations(made).max(axis=1), 99))
        said = f"{len(made)} frames at {made.rate_hz:g} Hz, {count} stances slide {slide:.1f} mm"
        print(f"graph of 999 frames, 20 s: fairmotion {said}, 99 % of accelerations below {p99:.0f} m/s2, {took:.1f} s")
    start = time.perf_counter()
    ours = ml.motion.walk(ml.motion.build(clips), 20.0)
    took = time.perf_counter() - start
    p99 = float(np.percentile(ml.motion.accelerations(ml.motion.resample(ours.motion, 30.0).motion).max(axis=1), 99))
    said = (
        f"{len(ours.motion)} frames at 120 Hz, {ours.report['plants']} stances slide {ours.report['slide_mm']:.3f} mm"
    )
    print(f"  ours {said}, 99 % of accelerations at 30 Hz below {p99:.0f} m/s2, {took:.1f} s")


def _peer_retarget(folder: Path, run: Callable[..., float]) -> None:
    """bvhsdk wants its own names of joints, and a target that stands in a T-pose."""
    body = clip("bvh/mobu-rom.bvh")
    source = ml.motion.retarget(clip("asf-amc/02_01.amc"), body.skeleton, target_motion=body).motion
    target = with_limbs(body.skeleton, 1.3)
    still = replace(body, skeleton=target).select(0, 1)
    ml.write_motion(source, folder / "source.bvh")
    ml.write_motion(replace(still, first_frame=0), folder / "target.bvh")
    for name in ("source", "target"):
        text = (folder / f"{name}.bvh").read_text()
        for side in ("Left", "Right"):
            text = text.replace(f"JOINT {side}Foot\n", f"JOINT {side}ForeFoot\n")
        (folder / f"{name}.bvh").write_text(text)
    took = run("retarget", folder / "source.bvh", folder / "target.bvh", folder / "retargeted.bvh")
    ours = ml.motion.retarget(source, target, target_motion=replace(body, skeleton=target))
    ours_s = seconds(lambda: ml.motion.retarget(source, target, target_motion=replace(body, skeleton=target)))
    if (folder / "retargeted.bvh").exists():
        made = ml.read_motion(folder / "retargeted.bvh")
        made = replace(
            made,
            skeleton=replace(made.skeleton, joints=tuple(n.replace("ForeFoot", "Foot") for n in made.skeleton.joints)),
        )
        feet = ml.motion.feet_of(body_of(source.skeleton))
        plants = ml.motion.find_plants(source, feet)
        report = ml.motion.slides(made, ml.motion.feet_of(body_of(made.skeleton)), plants, ours.report["floor_m"])
        print(f"retarget 02_01 to limbs x 1.3: bvhsdk {_of_feet(report)}, {took:.2f} s")
    print(f"  ours {_of_feet(ours.report)}, {ours_s:.2f} s")


def _of_feet(report: dict[str, Any]) -> str:
    return f"feet slide {report['slide_mm']:.3f} mm, {report['in_floor_mm']:.3f} mm into the floor"


if __name__ == "__main__":
    words = sys.argv[1:]
    python = words[words.index("--peers") + 1] if "--peers" in words else None
    words = [w for w in words if w not in ("--peers", python)]
    rows = {
        "bands": bands,
        "warp": warp,
        "retarget": retarget,
        "speed": speed,
        "footlock": footlock,
        "joins": joins,
        "graph": graph,
    }
    for row in words or [*rows, "peers"]:
        if row == "peers":
            peers(python)
        else:
            rows[row]()
