"""Two recordings without a common clock: offset and drift from motion, and tracking with two clocks beside one.

    python benches/clocks.py [--seeds=5] [--only=tracking]

Every second camera of a simulated rig has its own clock: its frame 0 is 3.37 frames late, and it runs 20 ppm slow. 60 s
at 100 Hz. The bound is what the noise of the dots alone would leave, by the same derivatives.
"""

from __future__ import annotations

import sys
import time

import numpy as np

import markerloom as ml

OFFSET, DRIFT_PPM, FRAMES = 3.37, 20.0, 6000
TRACKED = 600


def synchronise(seeds: int) -> None:
    """Offset and drift against the truth."""
    print("scene  seed  offset error  stated ±  drift error ppm  stated ±   seconds")
    for scene in ("walk", "dance", "wand"):
        for seed in range(seeds):
            made = ml.make_scene(scene, frames=FRAMES, offset_frames=OFFSET, drift_ppm=DRIFT_PPM, seed=seed)
            take = ml.simulate(made)
            clock = time.perf_counter()
            found = ml.sync(take.recordings(), take.rig).report["clocks"][1]
            seconds = time.perf_counter() - clock
            print(
                f"{scene:6s} {seed:4d} {found['offset_frames'] - OFFSET:+12.5f} {found['sigma_frames']:9.5f} "
                f"{found['drift_ppm'] - DRIFT_PPM:+14.3f} {found['drift_sigma_ppm']:10.3f} {seconds:9.1f}"
            )


def tracking(seeds: int) -> None:
    """The same motion seen with one clock and with two."""
    print("scene   clocks             ghosts  missing  median mm  rms mm  (error/sigma)²  switches")
    for scene in ("walk", "dance"):
        for name, two, with_times in (("one", False, True), ("two", True, True), ("two, times ignored", True, False)):
            scores = []
            for seed in range(seeds):
                clocks = {"offset_frames": OFFSET, "drift_ppm": DRIFT_PPM} if two else {}
                take = ml.simulate(ml.make_scene(scene, frames=TRACKED, seed=seed, **clocks))
                dots = take.observations
                if two:
                    dots = ml.sync(take.recordings(), take.rig).merged
                if not with_times:
                    dots.optional.pop("time_s")
                truth = ml.truth_from_assignments(take.truth, take.truth_assignments, take.rig)
                scores.append(ml.evaluate(ml.track(dots, take.rig), truth, tolerance_mm=25))

            def mean(of, scores=scores) -> float:
                return float(np.mean([of(s) for s in scores]))

            print(
                f"{scene:7s} {name:18s} {mean(lambda s: s['ghosts_per_frame']):6.4f} "
                f"{mean(lambda s: s['missing_per_frame']):8.4f} {mean(lambda s: s['error_mm']['median']):10.3f} "
                f"{mean(lambda s: s['error_mm']['rms']):7.3f} {mean(lambda s: s['sigma_ratio']):15.2f} "
                f"{mean(lambda s: s['id_switches']):9.1f}   missing by seed "
                + " ".join(f"{s['missing_per_frame']:.3f}" for s in scores)
            )


if __name__ == "__main__":
    given = dict(a.lstrip("-").split("=") for a in sys.argv[1:])
    count = int(given.get("seeds", "5"))
    if given.get("only") != "tracking":
        synchronise(count)
    tracking(count)
