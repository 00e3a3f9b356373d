"""Active markers: how many dots tell who they are, how many of those are right, and what the tracker makes of it.

    python benches/leds.py [--seeds=5] [--bit_errors=0.05]

40 LEDs on a simulated figure before 8 cameras; the body hides them, 2 % of the views drop out, near dots merge.
"""

from __future__ import annotations

import sys
import time

import numpy as np

import markerloom as ml
from markerloom.observations import _index_within_camera

FRAMES = 600


def owners(take: ml.SimulatedTake) -> list[list[int]]:
    """For each row of the observations, the LEDs it comes from."""
    labels = list(dict.fromkeys(take.truth.label.tolist()))
    holders: dict[tuple[int, str, int], list[int]] = {}
    table = take.truth_assignments.to_pydict()
    for *key, label in zip(*(table[n] for n in ("frame", "camera", "observation", "label")), strict=True):
        holders.setdefault(tuple(key), []).append(labels.index(label))
    dots = take.observations
    rows = zip(dots.frame, dots.camera, _index_within_camera(dots), strict=True)
    return [holders.get((int(f), dots.camera_ids[c], int(i)), []) for f, c, i in rows]


def main(seeds: int, bit_errors: float) -> None:
    """One line for each take."""
    print(
        "scene  seed  told of LEDs' dots  right      wrong   decode s | switches: no ids, ids, ids causal | named right"
    )
    for scene in ("walk", "dance"):
        for seed in range(seeds):
            made = ml.make_scene(scene, frames=FRAMES, markers=40, leds=True, bit_errors=bit_errors, seed=seed)
            take = ml.simulate(made)
            clock = time.perf_counter()
            told, _ = ml.leds(take.observations)
            seconds = time.perf_counter() - clock
            identity, owner = told.optional["id"], owners(take)
            right = sum(int(i) in o for i, o in zip(identity, owner, strict=True) if i >= 0)
            sure, owned = int((identity >= 0).sum()), np.array([bool(o) for o in owner])
            truth = ml.truth_from_assignments(take.truth, take.truth_assignments, take.rig)
            ways = ((take.observations, False), (told, False), (told, True))
            answers = [ml.track(dots, take.rig, causal=causal) for dots, causal in ways]
            switches = [ml.evaluate(a, truth, tolerance_mm=25)["id_switches"] for a in answers]
            print(
                f"{scene:6s} {seed:4d} {(identity[owned] >= 0).mean():18.1%} {right / sure:9.3%} {sure - right:8d} "
                f"{seconds:10.1f} | {switches[0]:15d} {switches[1]:5d} {switches[2]:11d} | "
                f"{named_right(answers[1], take):.3%}"
            )


def named_right(points: ml.Points, take: ml.SimulatedTake) -> float:
    """Share of the measured samples with a name whose marker is the nearest, or within 5 mm of being it."""
    labels = list(dict.fromkeys(take.truth.label.tolist()))
    place = take.truth.xyz_mm.reshape(FRAMES, len(labels), 3)
    own = np.flatnonzero((points.label != "") & (points.kind == 0))
    hits = 0
    for row in own:
        off = np.linalg.norm(place[points.frame[row]] - points.xyz_mm[row], axis=1)
        hits += off[int(points.label[row][2:])] < off.min() + 5.0
    return hits / len(own)


if __name__ == "__main__":
    given = dict(a.lstrip("-").split("=") for a in sys.argv[1:])
    main(int(given.get("seeds", "5")), float(given.get("bit_errors", "0.05")))
