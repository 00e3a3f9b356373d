"""Trajectories against truth: simulated walks and dances, and a real take with cameras and frames left out.

Run: python benches/tracking.py [simulated] [real] [--seeds=0,1,2,3,4]     (both parts: about 20 minutes)
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
FIGURES = ("ghosts_per_frame", "missing_per_frame", "per_marker", "id_switches", "sigma_ratio", "us", "searched")


def simulated(name: str, scene: str, changes: dict[str, object], seeds: list[int]) -> str:
    """One row: means over the seeds, switches per take."""
    results = []
    for seed in seeds:
        take = ml.simulate(ml.make_scene(scene, seed=seed, **changes))
        truth = ml.truth_from_assignments(take.truth, take.truth_assignments, take.rig)
        points = ml.track(take.observations, take.rig)
        result = ml.evaluate(points, truth, tolerance_mm=25)
        seen = len(set(truth.points.label[truth.required].tolist()))
        report = points.report
        result |= {"per_marker": result["trajectories"] / seen, "searched": report["searched_dots"]}
        result |= {"us": 1000 * report["timing"]["ms_per_frame"]["mean"]}
        results.append([result[figure] for figure in FIGURES])
    ghosts, missing, per_marker, switches, ratio, us, searched = np.mean(results, axis=0)
    return (
        f"{name:34} ghosts {ghosts:.4f}  missing {missing:.4f}  trajectories/marker {per_marker:.3f}  "
        f"switches {switches:.1f}  (error/sigma)² {ratio:.2f}  {us:.0f} µs/frame  searched {100 * searched:.1f} %"
    )


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
    chosen = {a for a in sys.argv[1:] if a in ("simulated", "real")} or {"simulated", "real"}
    listed = [a.split("=", 1)[1] for a in sys.argv if a.startswith("--seeds=")]
    seeds = [int(s) for s in listed[0].split(",")] if listed else [0, 1, 2, 3, 4]
    if "simulated" in chosen:
        for row in ROWS:
            print(simulated(*row, seeds), flush=True)
    if "real" in chosen:
        if not DATA.is_dir():
            sys.exit("the real recordings (../shared/data) are not on this machine")
        take = UpperBody(DATA)
        for step in (1, 2, 4, 8):
            print(real_line(f"upper body, every {step}. frame", [real(take, take.active, step)]), flush=True)
        for n in (6, 5, 4):
            sets = [list(c) for c in combinations(take.active, n)]
            print(real_line(f"{n} of 8 cameras ({len(sets)})", [real(take, c) for c in sets]), flush=True)


if __name__ == "__main__":
    main()
