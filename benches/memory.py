"""Memory of a live tracker over a million pushed frames. Run: python benches/memory.py [frames]     (3 minutes)"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import markerloom as ml


def resident_mb() -> float:
    """Memory of this process (MB; Linux)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def main() -> None:
    """Push the frames of a short dance again and again, time going on, and print the memory."""
    frames = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    take = ml.simulate(ml.make_scene("dance", frames=100, markers=6, cameras=4, clutter_per_frame=0.3, seed=0))
    names = take.observations.camera_ids
    dots = []
    for frame in take.observations.frames:
        own = take.observations.frame == frame
        camera, pixel = take.observations.camera[own], take.observations.pixel[own]
        dots.append({name: pixel[camera == i] for i, name in enumerate(names)})
    forth_and_back = np.r_[np.arange(100), np.arange(98, 0, -1)]
    tracker = ml.Tracker(take.rig, rate_hz=100.0)
    for k in range(frames):
        tracker.push(dots[forth_and_back[k % len(forth_and_back)]])
        if k in (1_000, 10_000) or (k + 1) % 100_000 == 0:
            print(f"{k + 1:8} frames: {resident_mb():.1f} MB", flush=True)


if __name__ == "__main__":
    main()
