"""Trajectories against truth: simulated walks and dances, sharp turns, a real take with cameras and frames left out.

Run: python benches/tracking.py [simulated] [turns] [real] [--seeds=0,1,2,3,4] [--rows=0,1]     (all: about 20 minutes)
"""

from __future__ import annotations

import sys
from dataclasses import replace
from itertools import combinations

import numpy as np

import markerloom as ml
from real_data import DATA, UpperBody

EASY: dict[str, object] = {"frames": 2633, "markers": 33, "sigma_px": 0.3}
HARD: dict[str, object] = EASY | {"sigma_px": 1.0, "hide": "0.05", "clutter_per_frame": 0.2}
ROWS: list[tuple[str, str, dict[str, object]]] = [
    ("walk, 8 cameras, 0.3 px", "walk", EASY),
    ("dance, 8 cameras, 0.3 px", "dance", EASY),
    ("walk, 8 cameras, 1 px, 5 % out", "walk", HARD),
    ("dance, 8 cameras, 1 px, 5 % out", "dance", HARD),
    ("walk, 4 cameras, 0.3 px", "walk", EASY | {"cameras": 4}),
    ("dance, 4 cameras, 0.3 px", "dance", EASY | {"cameras": 4}),
    ("duet, 12 cameras, 0.3 px", "duet", {"frames": 1000, "sigma_px": 0.3}),
]
FIGURES = (
    "ghosts_per_frame",
    "missing_per_frame",
    "per_marker",
    "id_switches",
    "id_switches_in_contact",
    "sigma_ratio",
    "idf1",
    "us",
    "searched",
)
METHODS = ("default", "paper")
# Markers of a foot (mm), 45 to 66 mm apart.
FEET = (
    [[0, 0, 0], [60, 0, 10], [20, 40, 0]],
    [[0, 0, 0], [50, 20, 0], [10, 45, 15]],
    [[0, 0, 0], [65, 10, 5], [25, 45, 0]],
)


def simulated(name: str, scene: str, changes: dict[str, object], seeds: list[int]) -> str:
    """One row for each method: means over the seeds, switches per take."""
    results: dict[str, list[list[float]]] = {method: [] for method in METHODS}
    for seed in seeds:
        take = ml.simulate(ml.make_scene(scene, seed=seed, **changes))
        truth = ml.truth_from_assignments(take.truth, take.truth_assignments, take.rig)
        seen = len(set(truth.points.label[truth.required].tolist()))
        for method in METHODS:
            points = ml.track(take.observations, take.rig, method=method)
            result = ml.evaluate(points, truth, tolerance_mm=25)
            report = points.report
            result |= {"per_marker": result["trajectories"] / seen, "searched": report["searched_dots"]}
            result |= {"us": 1000 * report["timing"]["ms_per_frame"]["mean"]}
            results[method].append([result[figure] for figure in FIGURES])
    return "\n".join(line(f"{name}, {method}", rows) for method, rows in results.items())


def line(name: str, rows: list[list[float]]) -> str:
    """One printed row."""
    ghosts, missing, per_marker, switches, touching, ratio, idf1, us, searched = np.mean(rows, axis=0)
    by_seed = "/".join(f"{row[FIGURES.index('id_switches')]:.0f}" for row in rows)
    return (
        f"{name:40} ghosts {ghosts:.4f}  missing {missing:.4f}  trajectories/marker {per_marker:.3f}  "
        f"switches {switches:.1f} ({by_seed}), {touching:.1f} in contacts  IDF1 {idf1:.4f}  "
        f"(error/sigma)² {ratio:.2f}  {us:.0f} µs/frame  "
        f"searched {100 * searched:.1f} %"
    )


def turning_foot(markers: list[list[int]], rate_hz: float) -> ml.Points:
    """A foot that stands for a second, then goes forth and back at 2.5 m/s; each turn takes 0.08 s, at 60 m/s²."""
    fine_s = np.arange(0.0, 4.0, 1e-3)
    speed = np.clip(60.0 * (np.abs(((fine_s - 0.8) % 0.8) - 0.4) - 0.2), -2.5, 2.5) * (fine_s > 1.0)
    time_s = np.arange(0.0, 4.0, 1.0 / rate_hz)
    along_mm = 1000.0 * np.interp(time_s, fine_s, np.cumsum(speed) * 1e-3)
    foot = np.stack([along_mm, 0.0 * time_s, 100.0 + 0.0 * time_s], axis=1)
    body = [[0, 150, 500], [200, 150, 500], [0, -150, 500], [300, -250, 900], [-200, 100, 1000]]
    layout = np.array(markers, float)
    places = np.concatenate([foot[:, None] + layout, np.broadcast_to(body, (len(foot), 5, 3))], axis=1)
    rng = np.random.default_rng(0)
    frame = np.repeat(np.arange(len(foot)), 8)
    xyz_mm = (places + rng.normal(0.0, 0.3, places.shape)).reshape(-1, 3)
    track = np.tile(np.arange(8), len(foot))
    return replace(ml.Points.of(frame, track, xyz_mm, rate_hz=rate_hz), label=track.astype(str))


def turns() -> None:
    """A foot that reverses its direction sharply (figure 13), simulated, and the fastest turns of a real recording."""
    for rate_hz in (60.0, 30.0):
        for number, foot in enumerate(FEET):
            print(turn_line(f"foot {number} at 2.5 m/s, turns at 60 m/s², {rate_hz:g} Hz", turning_foot(foot, rate_hz)))
    points = ml.read_points(DATA / "labelling" / "cmu-85_02.c3d")
    for step in (1, 2, 4):
        kept = points.keep((points.frame % step == 0) & (points.kind == 0))
        frame = kept.frame // step
        take = replace(kept, frame=frame, frames=np.unique(frame), rate_hz=(points.rate_hz or 0.0) / step)
        print(turn_line(f"cmu-85_02, {take.rate_hz:g} Hz", take))


def turn_line(name: str, take: ml.Points) -> str:
    """Whether every marker keeps its trajectory, live and over the whole take."""
    kept = {}
    for causal in (True, False):
        found = ml.evaluate(ml.track(take, causal=causal), ml.truth_without_views(take), tolerance_mm=25)
        kept["live" if causal else "whole take"] = (found["trajectories"], found["id_switches"])
    markers = len(np.unique(take.track))
    speed = max(
        float(np.linalg.norm(np.diff(take.xyz_mm[take.track == t], axis=0), axis=1).max())
        for t in np.unique(take.track)
    )
    parts = "  ".join(f"{k}: {n} trajectories, {s} switches" for k, (n, s) in kept.items())
    return f"{name:40} {markers} markers, fastest {speed * (take.rate_hz or 0) / 1000:.1f} m/s  {parts}"


def real(take: UpperBody, cameras: list[str], step: int = 1) -> list[float]:
    """Ghosts, missing, trajectories and switches with some of the cameras, and every ``step``-th frame."""
    rig = take.rig.subset(cameras)
    observations = take.observations.of_cameras(cameras)
    truth = ml.truth_from_observations(take.vicon, observations, rig)
    if step > 1:
        observations = observations.every(step)
        kept = truth.points.frame % step == 0
        frames = truth.points.frames[truth.points.frames % step == 0]
        truth = ml.Truth(replace(truth.points.keep(kept), frames=frames), truth.required[kept])
    points = ml.track(observations, rig, rate_hz=100.0)
    result = ml.evaluate(points, truth, tolerance_mm=10.0, align="rigid")
    return [result[f] for f in ("ghosts_per_frame", "missing_per_frame", "trajectories", "id_switches")]


def real_line(name: str, rows: list[list[float]]) -> str:
    """One printed row: means."""
    ghosts, missing, trajectories, switches = np.mean(rows, axis=0)
    return (
        f"{name:34} ghosts {ghosts:.4f}  missing {missing:.4f}  "
        f"trajectories {trajectories:.2f}  switches {switches:.2f}"
    )


def main() -> None:
    """Print every row."""
    parts = {"simulated", "turns", "real"}
    chosen = {a for a in sys.argv[1:] if a in parts} or parts
    listed = [a.split("=", 1)[1] for a in sys.argv if a.startswith("--seeds=")]
    seeds = [int(s) for s in listed[0].split(",")] if listed else [0, 1, 2, 3, 4]
    rows = [a.split("=", 1)[1] for a in sys.argv if a.startswith("--rows=")]
    wanted = [int(r) for r in rows[0].split(",")] if rows else range(len(ROWS))
    if "simulated" in chosen:
        for row in wanted:
            print(simulated(*ROWS[row], seeds), flush=True)
    if chosen & {"turns", "real"} and not DATA.is_dir():
        sys.exit("the real recordings (../shared/data) are not on this machine")
    if "turns" in chosen:
        turns()
    if "real" in chosen:
        take = UpperBody(DATA)
        for step in (1, 2, 4, 8):
            print(real_line(f"upper body, every {step}. frame", [real(take, take.active, step)]), flush=True)
        for n in (6, 5, 4):
            sets = [list(c) for c in combinations(take.active, n)]
            print(real_line(f"{n} of 8 cameras ({len(sets)})", [real(take, c) for c in sets]), flush=True)


if __name__ == "__main__":
    main()
