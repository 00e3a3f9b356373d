"""How well a rigid body of four markers is followed before eight cameras: a row of docs/results.md.

python benches/rigid_body.py
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.spatial.transform import Rotation

import markerloom as ml

PLACES_MM = {"A": [0, 0, 0], "B": [160, 0, 0], "C": [0, 110, 20], "D": [50, 30, 140]}


def main() -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "tool.toml"
        body = ml.RigidBody("tool", tuple(PLACES_MM), np.array(list(PLACES_MM.values()), float))
        ml.write_rigid_body(body, path)
        for focal_px, distance_m in ((1300.0, 4.5), (2600.0, 3.0)):
            for seed in range(3):
                scene = ml.make_scene(
                    "wand",
                    wand=str(path),
                    seed=seed,
                    frames=1000,
                    focal_px=focal_px,
                    distance_m=distance_m,
                    sigma_px=0.3,
                    image_width=2600,
                    image_height=2200,
                    box_x_m=0.8,
                    box_y_m=0.8,
                    box_z_m=0.6,
                )
                row(scene, body)


def row(scene: ml.Scene, body: ml.RigidBody) -> None:
    take = ml.simulate(scene)
    tracked = ml.track(take.observations, take.rig, rate_hz=scene.rate_hz)
    named = ml.label(tracked, subjects=[ml.create_subject(take.truth.select(0, 400))])
    found = ml.track_rigid_body(named.keep(named.kind == 0), body)
    true = ml.track_rigid_body(take.truth, body)
    rows = np.searchsorted(true.frame, found.frame)
    off_mm = ((found.position_mm - true.position_mm[rows]) ** 2).sum(axis=1)
    turn = Rotation.from_quat(found.quaternion) * Rotation.from_quat(true.quaternion[rows]).inv()
    off_deg = np.degrees(turn.magnitude()) ** 2
    share = len(rows) / scene.frames
    print(
        f"focal {scene.focal_px:.0f} px, {scene.distance_m:g} m, seed {scene.seed}: {100 * share:.1f} % of the frames, "
        f"{np.sqrt(off_mm.mean()):.3f} mm, {np.sqrt(off_deg.mean()):.3f} deg rms; (error/sigma)^2 "
        f"{np.mean(off_mm / found.sigma_mm**2):.2f}, {np.mean(off_deg / found.sigma_deg**2):.2f}",
        flush=True,
    )


if __name__ == "__main__":
    main()
