"""Trajectories of 3D points: hidden markers carried, and broken takes put together again. Needs ../shared/data.

Run: python benches/points.py [hidden] [started] [broken]      (all parts: about 10 minutes)
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

import markerloom as ml
from real_data import DATA

FILES = ("cmu-85_02", "fullbody-44")
HIDDEN_FRAMES = (24, 60, 240)
TRIALS = 60
RUN_UP = 150


def decimated(points: ml.Points, step: int) -> ml.Points:
    """Every ``step``-th frame, under new numbers."""
    kept = points.keep((points.frame % step == 0) & (points.kind == 0))
    frames = np.unique(kept.frame // step)
    return replace(kept, frame=kept.frame // step, frames=frames, rate_hz=(points.rate_hz or 0.0) / step)


def spheres_error_mm(take: ml.Points, track: int, first: int, n: int) -> list[float]:
    """Errors of the paper's two spheres: around the two markers whose distances changed least before the gap."""
    by_track = {int(t): take.track == t for t in np.unique(take.track)}
    path = {t: dict(zip(take.frame[m].tolist(), take.xyz_mm[m], strict=True)) for t, m in by_track.items()}
    own = path.pop(track)
    before = [f for f in own if f < first]
    spread = []
    for other, places in path.items():
        lengths = [float(np.linalg.norm(own[f] - places[f])) for f in before if f in places]
        if len(lengths) > 20 and all(f in places for f in range(first, first + n)):
            spread.append((float(np.std(lengths)), other, float(np.mean(lengths))))
    (_, a, da), (_, b, db) = sorted(spread)[:2]
    predicted, errors = own[before[-1]], []
    for f in range(first, first + n):
        predicted = ml.place_on_spheres([path[a][f], path[b][f]], [da, db], predicted)
        errors.append(float(np.linalg.norm(predicted - own[f])))
    return errors


def carried(
    piece: ml.Points, track: int, first: int, known: ml.StartPose | None = None
) -> tuple[list[float], list[float]]:
    """A marker of a piece of a take hidden from frame ``first`` on: how far off it is carried (mm), and its sigmas."""
    seen = piece.keep((piece.track != track) | (piece.frame < first))
    tracked = ml.track(seen, causal=True, start_pose=known)
    rows = np.flatnonzero((tracked.frame == first - 1) & (tracked.kind == 0))
    where = piece.xyz_mm[(piece.track == track) & (piece.frame == first - 1)][0]
    mine = tracked.track[rows[np.argmin(np.linalg.norm(tracked.xyz_mm[rows] - where, axis=1))]]
    given = (tracked.track == mine) & (tracked.frame >= first) & (tracked.kind == 1)
    truth = dict(zip(piece.frame[piece.track == track].tolist(), piece.xyz_mm[piece.track == track], strict=True))
    error = [
        float(np.linalg.norm(x - truth[f]))
        for f, x in zip(tracked.frame[given].tolist(), tracked.xyz_mm[given], strict=True)
    ]
    return error, tracked.sigma_mm[given].tolist()


def hidden(name: str, n: int) -> str:
    """One row: a marker hidden for ``n`` frames at 60 Hz, over many markers and times."""
    take = decimated(ml.read_points(DATA / "labelling" / f"{name}.c3d"), 2)
    rng = np.random.default_rng(0)
    rms, spheres, ratios, covered, asked = [], [], [], 0, 0
    for _ in range(TRIALS):
        track = int(rng.choice(np.unique(take.track)))
        own = set(take.frame[take.track == track].tolist())
        first = int(rng.integers(take.frames[0] + min(RUN_UP, len(take.frames) - n - 5), take.frames[-1] - n))
        if not all(f in own for f in range(first - 1, first + n)):
            continue
        piece = take.select(None, first + n)
        error, sigma = carried(piece, track, first)
        asked, covered = asked + n, covered + len(error)
        if error:
            rms.append(float(np.sqrt(np.mean(np.square(error)))))
            ratios += list(np.square(np.array(error) / sigma))
        spheres.append(float(np.sqrt(np.mean(np.square(spheres_error_mm(piece, track, first, n))))))
    return (
        f"{name:12} hidden {n:3} frames: mean rms {np.mean(rms):5.1f} mm (median {np.median(rms):5.1f})  "
        f"(error/sigma)² {np.mean(ratios):5.2f}  given {100 * covered / asked:5.1f} %  "
        f"two spheres {np.mean(spheres):5.1f} mm  gaps {len(rms)}"
    )


def started(name: str, before: int, n: int = 60) -> str:
    """One row: a marker that is hidden for ``n`` frames so many frames after the take has begun (at 60 Hz, somewhere in
    the first half of the file), without a start pose and with the last quarter of the file as one.
    """
    take = decimated(ml.read_points(DATA / "labelling" / f"{name}.c3d"), 2)
    take = take.keep(take.kind == 0)
    begin, frames = int(take.frames[0]), len(take.frames)
    known = ml.start_pose(take.select(begin + 3 * frames // 4, None))
    rng = np.random.default_rng(0)
    rms: dict[bool, list[float]] = {False: [], True: []}
    ratios: dict[bool, list[float]] = {False: [], True: []}
    for _ in range(TRIALS):
        track = int(rng.choice(np.unique(take.track)))
        start = begin + int(rng.integers(0, frames // 2))
        piece = take.select(start, start + before + n)
        if (piece.track == track).sum() < before + n:
            continue
        for with_pose in rms:
            error, sigma = carried(piece, track, start + before, known if with_pose else None)
            if error:
                rms[with_pose].append(float(np.sqrt(np.mean(np.square(error)))))
                ratios[with_pose] += list(np.square(np.array(error) / sigma))
    told = [f"{np.mean(rms[k]):.1f} mm (median {np.median(rms[k]):.1f}; {np.mean(ratios[k]):.2f})" for k in rms]
    return f"{name:12} {before} frames after the start, hidden {n}: mean rms {told[0]}, with a start pose {told[1]}"


def broken(points: ml.Points, seed: int, longest_hole: int) -> tuple[ml.Points, ml.Points]:
    """Names removed, trajectories cut at random (each cut with a hole of up to so many frames), 1 % ghosts added."""
    rng = np.random.default_rng(seed)
    truth = points.keep(points.kind == 0)
    keep = np.ones(len(truth), bool)
    if longest_hole:
        for track in np.unique(truth.track):
            rows = np.flatnonzero(truth.track == track)
            for cut in np.flatnonzero(rng.random(len(rows)) < 0.002):
                keep[rows[cut : cut + int(rng.integers(1, longest_hole + 1))]] = False
    left = truth.keep(keep)
    ghosts = int(0.01 * len(left))
    low, high = left.xyz_mm.min(0), left.xyz_mm.max(0)
    frame = np.concatenate([left.frame, rng.choice(left.frames, ghosts)])
    xyz_mm = np.vstack([left.xyz_mm, rng.uniform(low, high, (ghosts, 3))])
    order = np.lexsort((rng.random(len(frame)), frame))
    frame, xyz_mm = frame[order], xyz_mm[order]
    number = np.arange(len(frame)) - np.searchsorted(frame, frame)
    return ml.Points.of(frame, number, xyz_mm, rate_hz=points.rate_hz, frames=points.frames), left


def put_together(name: str, longest_hole: int) -> str:
    """One row: means over three seeds."""
    points = ml.read_points(DATA / "labelling" / f"{name}.c3d")
    rows = []
    for seed in range(3):
        take, truth = broken(points, seed, longest_hole)
        result = ml.evaluate(ml.track(take), ml.truth_without_views(truth), tolerance_mm=25)
        markers = len(set(truth.label.tolist()))
        rows.append([result["trajectories"] / markers, result["id_switches"], result["ghosts_per_frame"]])
    per_marker, switches, ghosts = np.mean(rows, axis=0)
    return (
        f"{name:14} holes up to {longest_hole:2} frames: trajectories/marker {per_marker:.3f}  "
        f"switches {switches:.1f}  ghosts {ghosts:.4f}"
    )


def main() -> None:
    """Print every row."""
    if not DATA.is_dir():
        sys.exit("the real recordings (../shared/data) are not on this machine")
    chosen = set(sys.argv[1:]) or {"hidden", "started", "broken"}
    if "hidden" in chosen:
        for name in FILES:
            for n in HIDDEN_FRAMES:
                print(hidden(name, n), flush=True)
    if "started" in chosen:
        for name in ("cmu-85_02", "fullbody-44"):
            for before in (12, 60):
                print(started(name, before), flush=True)
    if "broken" in chosen:
        for name in (*FILES, "KneeltoProne01", "PronetoRun01"):
            for longest_hole in (0, 12):
                print(put_together(name, longest_hole), flush=True)


if __name__ == "__main__":
    main()
