"""A wand wave calibrated by markerloom and by the open caliscope (https://github.com/mprib/caliscope), side by side.

    python benches/peer_caliscope.py --peer=VENV/bin/python [--cameras=8] [--frames=1000] [--seed=0]

``--peer``: a Python in which ``pip install caliscope`` was run. markerloom gets raw, unlabelled dots among clutter and
knows nothing of the cameras; caliscope gets every dot's true name and the wand's shape, and is timed without reading
its input: once as blind as markerloom, once starting from the true focal lengths. Both then leave them free.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np


def theirs(folder: Path) -> None:
    """In caliscope's environment: calibrate from ``points.csv``, write centres and seconds."""
    import pandas as pd  # pyright: ignore[reportMissingImports]
    from caliscope.api import (  # pyright: ignore[reportMissingImports]
        CameraArray,
        CameraData,
        ConstraintSet,
        ImagePoints,
        calibrate_extrinsics,
    )
    from caliscope.core.constraints import DistanceConstraint  # pyright: ignore[reportMissingImports]

    task = json.loads((folder / "task.json").read_text())
    points = ImagePoints(pd.read_csv(folder / "points.csv"))
    cameras = {i: CameraData(i, tuple(task["size"])) for i in range(task["cameras"])}
    if task["focal_px"] is not None:
        middle = [(side - 1) / 2 for side in task["size"]]
        for camera in cameras.values():
            camera.matrix = np.array([[task["focal_px"], 0, middle[0]], [0, task["focal_px"], middle[1]], [0, 0, 1]])
            camera.distortions = np.zeros(5)
    wand = np.array(task["wand_m"])
    distances = tuple(
        DistanceConstraint(0, a, 0, b, float(np.linalg.norm(wand[a] - wand[b])), 1e-4)
        for a in range(len(wand))
        for b in range(a)
    )
    start = time.perf_counter()
    run = calibrate_extrinsics(points, CameraArray(cameras), ConstraintSet(distances, frozenset()))
    seconds = time.perf_counter() - start
    made = run.capture_volume.camera_array.cameras
    centers = [(-made[i].rotation.T @ made[i].translation).ravel().tolist() for i in sorted(made)]
    (folder / "result.json").write_text(json.dumps({"seconds": seconds, "centers_m": centers}))


def ours(options: dict[str, str]) -> None:
    """Simulate, calibrate with both, compare camera centres after a rigid alignment."""
    import markerloom as ml
    from calibration import aligned, best_mm, true_sightings

    n, frames, seed = (int(options.get(k, d)) for k, d in (("cameras", "8"), ("frames", "1000"), ("seed", "0")))
    take = ml.simulate(ml.make_scene("wand", cameras=n, frames=frames, seed=seed))
    true = np.array([c.position_m for c in take.rig.cameras])
    size = (take.scene.image_width, take.scene.image_height)
    wand = ml.read_wand(take.scene.wand)
    start = time.perf_counter()
    made = ml.calibrate_wand(
        take.observations, wand, image_sizes=dict.fromkeys(take.rig.ids, (float(size[0]), float(size[1])))
    )
    seconds = time.perf_counter() - start
    print(f"{n} cameras, {frames} frames, seed {seed}; bound {np.sqrt(np.mean(best_mm(take)[0] ** 2)):.3f} mm")
    error = aligned(np.array([c.position_m for c in made.rig.cameras]), true)[0]
    _line("markerloom, blind", seconds, error)
    start = time.perf_counter()
    known = ml.calibrate_wand(take.observations, wand, intrinsics=take.rig)
    error = aligned(np.array([c.position_m for c in known.rig.cameras]), true)[0]
    _line("markerloom, true intrinsics", time.perf_counter() - start, error)
    with tempfile.TemporaryDirectory() as folder:
        rows = []
        for i, camera in enumerate(take.rig.ids):
            for frame, marker, pixel in zip(*true_sightings(take, camera), strict=True):
                rows.append([frame, i, 0, marker, *pixel, *wand.places_m[marker]])
        header = "sync_index,cam_id,object_id,keypoint_id,img_loc_x,img_loc_y,obj_loc_x,obj_loc_y,obj_loc_z"
        rows.sort(key=lambda row: row[:4])
        text = "\n".join(",".join(repr(float(v)) if k > 3 else str(int(v)) for k, v in enumerate(r)) for r in rows)
        (Path(folder) / "points.csv").write_text(header + "\n" + text + "\n")
        for name, focal_px in (("caliscope, blind", None), ("caliscope, true focal lengths", take.scene.focal_px)):
            task = {"cameras": n, "size": size, "wand_m": wand.places_m.tolist(), "focal_px": focal_px}
            (Path(folder) / "task.json").write_text(json.dumps(task))
            done = subprocess.run([options["peer"], __file__, f"--folder={folder}"], check=False, capture_output=True)
            if done.returncode != 0:
                print(f"{name} failed: {done.stderr.decode()[-600:]}")
                continue
            result = json.loads((Path(folder) / "result.json").read_text())
            _line(name, result["seconds"], aligned(np.array(result["centers_m"]), true)[0])
            print(f"markerloom is {result['seconds'] / seconds:.1f} times as fast")


def _line(name: str, seconds: float, error_m: np.ndarray) -> None:
    rms = 1000.0 * np.sqrt(np.mean(np.sum(error_m**2, axis=1)))
    print(f"{name:30s} {seconds:8.2f} s   camera centres {rms:8.3f} mm rms", flush=True)


if __name__ == "__main__":
    given = dict(a.lstrip("-").split("=", 1) for a in sys.argv[1:])
    if "folder" in given:
        theirs(Path(given["folder"]))
    else:
        ours(given)
