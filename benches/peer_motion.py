"""Other programs that join and retarget motions, beside ours: run by `motion.py` in a Python that has them.

    PYTHON benches/peer_motion.py blend A.bvh B.bvh OUT.bvh
    PYTHON benches/peer_motion.py walk OUT.bvh SECONDS CLIP.bvh CLIP.bvh …
    PYTHON benches/peer_motion.py retarget SOURCE.bvh TARGET.bvh OUT.bvh

fairmotion 0.0.4 (its frame rate is mended after reading: it keeps the inverse of 60 Hz), bvhsdk 0.2.1. Prints seconds.
"""

from __future__ import annotations

import contextlib
import io
import random
import shutil
import sys
import tempfile
import time
from importlib import import_module
from pathlib import Path
from typing import Any


def loaded(path: str) -> Any:
    """A clip of fairmotion."""
    motion = import_module("fairmotion.data.bvh").load(path)
    motion.fps_inv = 1.0 / motion.fps
    return motion


def blend(a: str, b: str, out: str) -> float:
    """fairmotion's append_and_blend over 0.4 s."""
    one, two = loaded(a), loaded(b)
    start = time.perf_counter()
    made = import_module("fairmotion.ops.motion").append_and_blend(one, two, blend_length=0.4)
    seconds = time.perf_counter() - start
    import_module("fairmotion.data.bvh").save(made, out)
    return seconds


def walk(out: str, seconds: str, *clips: str) -> float:
    """fairmotion's motion graph at 30 Hz, and a random walk."""
    graphs = import_module("fairmotion.tasks.motion_graph.motion_graph")
    velocity = import_module("fairmotion.core.velocity")
    ops = import_module("fairmotion.ops.motion")
    random.seed(0)
    motions = []
    for clip in clips:
        motion = ops.resample(loaded(clip), 30)
        motion.fps_inv = 1.0 / motion.fps
        motions.append(velocity.MotionWithVelocity.from_motion(motion))
        motions[-1].fps_inv = 1.0 / motions[-1].fps
    start = time.perf_counter()
    graph = graphs.MotionGraph(
        motions,
        list(clips),
        motions[0].skel,
        fps=30,
        base_length=0.6,
        stride_length=0.3,
        blend_length=0.4,
        compare_length=0.4,
    )
    graph.construct(diff_threshold=5.0)
    graph.reduce()
    made = graph.create_random_motion(float(seconds))
    motion = made[0] if isinstance(made, tuple) else made
    took = time.perf_counter() - start
    import_module("fairmotion.data.bvh").save(motion, out)
    return took


def retarget(source: str, target: str, out: str) -> float:
    """bvhsdk's SimpleMotionRetargeting."""
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        import_module("bvhsdk.retarget").SimpleMotionRetargeting(source, target, folder + "/")
        seconds = time.perf_counter() - start
        shutil.copy(next(Path(folder).glob("*.bvh")), out)
    return seconds


if __name__ == "__main__":
    what = {"blend": blend, "walk": walk, "retarget": retarget}[sys.argv[1]]
    with contextlib.redirect_stdout(io.StringIO()):
        took = what(*sys.argv[2:])
    print(f"{took:.3f}")
