"""Start poses: markers that are recognised are carried from the first frames on as after a whole take."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import markerloom as ml
from markerloom.errors import InputError
from markerloom.points import Points
from skeleton_truth import rom
from test_label import points_of

RATE_HZ = 50.0


def moving(seed: int = 2) -> Points:
    """A dance of 24 s with 53 named markers."""
    names, xyz_mm, _, _ = rom(seed=seed, frames=1200, rate_hz=RATE_HZ, noise_mm=0.3, motion="dance")
    return replace(points_of(xyz_mm, names), rate_hz=RATE_HZ)


def anonymous(points: Points) -> Points:
    return replace(points, label=np.full(len(points), "", dtype="<U1"))


def carried_mm(take: Points, name: str, first: int, known: ml.StartPose | None) -> float:
    """How far off (rms) a marker is carried that is hidden from frame ``first`` on."""
    own = take.label == name
    seen = anonymous(take.keep(~own | (take.frame < first)))
    tracked = ml.track(seen, causal=True, start_pose=known)
    where = take.xyz_mm[own & (take.frame == first - 1)][0]
    rows = np.flatnonzero(tracked.frame == first - 1)
    mine = tracked.track[rows[np.argmin(np.linalg.norm(tracked.xyz_mm[rows] - where, axis=1))]]
    rows = np.flatnonzero((tracked.track == mine) & (tracked.frame >= first))
    assert len(rows) > 10
    off = tracked.xyz_mm[rows] - take.xyz_mm[own][tracked.frame[rows] - int(take.frames[0])]
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def test_a_marker_hidden_at_the_start_is_carried_by_what_was_known_before() -> None:
    take = moving()
    known = ml.start_pose(take.select(600, 1200))
    piece = take.select(100, 150)
    better = [
        (carried_mm(piece, name, 112, None), carried_mm(piece, name, 112, known))
        for name in ("LWRA", "RKNE", "LFHD", "RANK", "LELB")
        if name in set(take.label)
    ]
    assert len(better) >= 3
    alone, started = np.array(better).mean(axis=0)
    assert started < 0.7 * alone


def test_live_equals_causal_with_a_start_pose() -> None:
    walk = ml.simulate(ml.make_scene("walk", frames=360, markers=33, sigma_px=0.3, seed=0))
    known = ml.start_pose(walk.truth)
    take = walk.observations.select(0, 60)
    tracked = ml.track(take, walk.rig, causal=True, start_pose=known)
    tracker = ml.Tracker(walk.rig, rate_hz=take.rate_hz or 0.0, start_pose=known)
    for frame in take.frames:
        rows = take.frame == frame
        dots = {n: take.pixel[rows & (take.camera == i)] for i, n in enumerate(take.camera_ids)}
        found = tracker.push(dots, frame=int(frame))
        assert np.array_equal(tracked.xyz_mm[tracked.frame == frame], found.points_mm)


def test_a_strangers_start_pose_changes_nothing() -> None:
    piece = anonymous(moving().select(0, 60))
    rng = np.random.default_rng(0)
    strange = points_of(np.cumsum(rng.normal(0.0, 40.0, (300, 12, 3)), axis=0), [f"S{i}" for i in range(12)])
    known = ml.start_pose(replace(strange, rate_hz=RATE_HZ))
    alone, started = (ml.track(piece, causal=True, start_pose=k) for k in (None, known))
    assert np.array_equal(alone.xyz_mm, started.xyz_mm)


def test_start_poses_that_tell_nothing_are_refused() -> None:
    take = moving()
    with pytest.raises(InputError, match="no marker of the start pose has a name"):
        ml.start_pose(anonymous(take))
    pose = take.select(0, 1)
    assert len(ml.start_pose(pose).subjects[0]) >= 30, "a known marker set tells what is rigid"
    renamed = replace(pose, label=np.array([f"M{i}" for i in range(len(pose))]))
    with pytest.raises(InputError, match="a single pose does not tell"):
        ml.start_pose(renamed)
    with pytest.raises(InputError, match="leave the start pose out"):
        ml.track(take, method="paper", start_pose=ml.start_pose(take))


def test_start_poses_on_the_command_line(tmp_path: Path) -> None:
    from test_cli import run

    take = moving()
    take.save(tmp_path / "rom.c3d")
    anonymous(take.select(0, 60)).save(tmp_path / "take.c3d")
    ml.write_subject(ml.create_subject(take), tmp_path / "anna.toml")
    for known in ("rom.c3d", "anna.toml"):
        run("track", tmp_path / "take.c3d", "--start-pose", tmp_path / known, "-o", tmp_path / "out.c3d", "--causal")
        assert len(np.unique(ml.read_points(tmp_path / "out.c3d").track)) == 53
