"""Lengths of the real wand, each marker placed on its own, beside what the noise of the dots predicts for its views.

    python benches/wand_lengths.py

One row per number of cameras that saw the marker seen by fewer: spread of the lengths about their median, and the root
mean square of the standard deviations that least squares states for dots of the noise that the calibration found.
"""

from __future__ import annotations

from collections import defaultdict
from itertools import combinations
from pathlib import Path

import numpy as np

import markerloom as ml
from markerloom import _core
from markerloom.calibrate.wand import LEFT_OUT_EVERY, MOST_POSES, _camera, _sizes, _start, _usable

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "vicon-wand"


def main() -> None:
    """Calibrate, place every marker of every pose, compare."""
    take, wand = ml.read_observations(DATA / "wand_centroids.csv.gz"), ml.read_wand("vicon-t")
    vendor = ml.read_calibration(DATA / "reference.xcp")
    ids, dots, _ = _usable(take)
    sizes, _ = _sizes(ids, dots, {c.id: c.size_px for c in vendor.cameras}, None)
    start = [_start(i, sizes[i], None) for i in ids]
    described = [c._described() for c in start]
    solved = _core.calibrate_wand(described, "nothing", wand.places_m.tolist(), dots, LEFT_OUT_EVERY, MOST_POSES)
    rig = ml.Rig(tuple(_camera(s, d) for s, d in zip(start, solved["cameras"], strict=True)))
    sigma_px = float(np.median(np.linalg.norm(solved["residual_px"][solved["used"]], axis=1)) / 1.1774)
    seen: dict[tuple[int, int], dict[str, np.ndarray]] = defaultdict(dict)
    for k in np.flatnonzero(solved["used"]):
        seen[solved["pose"][k], solved["marker"][k]][ids[solved["camera"][k]]] = dots.pixel[solved["dot"][k]]
    placed = {}
    for key, pixels in seen.items():
        try:
            placed[key] = (
                ml.triangulate(rig, {c: (p[0], p[1]) for c, p in pixels.items()}, sigma_px=sigma_px),
                len(pixels),
            )
        except ml.MarkerloomError:
            continue
    rows = []
    for a, b in combinations(range(len(wand.markers)), 2):
        own = []
        for pose in range(len(solved["pose_frame"])):
            if (pose, a) in placed and (pose, b) in placed:
                (one, n), (two, m) = placed[pose, a], placed[pose, b]
                between = one.point_m - two.point_m
                length = np.linalg.norm(between)
                variance = between @ (one.covariance_m2 + two.covariance_m2) @ between / length**2
                own.append((1000 * length, 1000 * np.sqrt(variance), min(n, m)))
        values = np.array(own)
        values[:, 0] -= np.median(values[:, 0])
        rows.append(values)
    off, stated, rays = np.concatenate(rows).T
    print(f"noise of the dots {sigma_px:.3f} px\ncameras  lengths  std mm  robust  predicted")
    for name, chosen in [("all", rays > 0), *((str(k), rays == k) for k in range(2, 11))]:
        own = off[chosen]
        robust, predicted = 1.4826 * np.median(np.abs(own)), np.sqrt(np.mean(stated[chosen] ** 2))
        print(f"{name:7s}  {len(own):7d}  {own.std():6.3f}  {robust:6.3f}  {predicted:9.3f}")


if __name__ == "__main__":
    main()
