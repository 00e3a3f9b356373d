"""How far hidden markers of simulated takes are from where they are carried, beside what their uncertainty says.

Run: python benches/carried.py [--seeds=0,1] [--rows=1,3,5]     (rows of tracking.py; 5 minutes)
"""

from __future__ import annotations

import sys
from collections import Counter

import numpy as np

import markerloom as ml
from tracking import ROWS

# Frames hidden, from and to.
GAPS = ((1, 1), (2, 4), (5, 16), (17, 64), (65, 10_000))
NEAR_MM = 25.0


def homes(points: ml.Points, truth: ml.Points) -> dict[int, str]:
    """The marker that each trajectory measures most often, by the nearest one in each frame."""
    count: dict[int, Counter[str]] = {}
    for frame in np.unique(truth.frame):
        own, there = points.keep((points.frame == frame) & (points.kind == 0)), truth.keep(truth.frame == frame)
        apart_mm = np.linalg.norm(own.xyz_mm[:, None] - there.xyz_mm[None], axis=2)
        distance, nearest = apart_mm.min(axis=1), apart_mm.argmin(axis=1)
        for track, label in zip(own.track[distance < NEAR_MM], there.label[nearest[distance < NEAR_MM]], strict=True):
            count.setdefault(int(track), Counter())[str(label)] += 1
    return {track: labels.most_common(1)[0][0] for track, labels in count.items()}


def carried(points: ml.Points, truth: ml.Points) -> np.ndarray:
    """Frames hidden, error (mm) and expected error (mm, root of the summed variances) of every predicted sample."""
    home = homes(points, truth)
    place = {(int(f), str(n)): x for f, n, x in zip(truth.frame, truth.label, truth.xyz_mm, strict=True)}
    found = []
    for track, label in home.items():
        own = points.keep(points.track == track)
        own = own.keep(np.argsort(own.frame, kind="stable"))
        seen = own.frame[own.kind == 0]
        for frame, xyz_mm, sigma_mm in zip(
            own.frame[own.kind != 0], own.xyz_mm[own.kind != 0], own.sigma_mm[own.kind != 0], strict=True
        ):
            after = int(np.searchsorted(seen, frame))
            if 0 < after < len(seen) and (int(frame), label) in place:
                error_mm = np.linalg.norm(xyz_mm - place[int(frame), label])
                found.append((seen[after] - seen[after - 1] - 1, error_mm, np.linalg.norm(sigma_mm)))
    return np.array(found)


def main() -> None:
    """Print every row."""
    listed = {key: value for key, _, value in (a.partition("=") for a in sys.argv[1:])}
    seeds = [int(s) for s in listed.get("--seeds", "0,1").split(",")]
    for row in (int(r) for r in listed.get("--rows", "1,3,5").split(",")):
        name, scene, changes = ROWS[row]
        of_seeds = []
        for seed in seeds:
            take = ml.simulate(ml.make_scene(scene, seed=seed, **changes))
            of_seeds.append(carried(ml.track(take.observations, take.rig), take.truth))
        hidden, error_mm, sigma_mm = np.concatenate(of_seeds).T
        for least, most in GAPS:
            own = (hidden >= least) & (hidden <= most)
            if own.sum() >= 20:
                ratio = (error_mm[own] / sigma_mm[own]) ** 2
                middle = [float(np.median(x)) for x in (error_mm[own], sigma_mm[own], ratio)]
                print(
                    f"{name:32} hidden {least:2}-{most:<5} n {own.sum():5}  medians: error {middle[0]:5.1f} mm"
                    f"  sigma {middle[1]:5.1f} mm  (error/sigma)² {middle[2]:6.2f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
