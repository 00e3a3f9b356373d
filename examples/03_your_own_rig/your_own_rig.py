"""A rig built by hand, one point triangulated with its uncertainty, and the rig as a Calib.toml."""

from pathlib import Path

import numpy as np

import markerloom as ml


def camera(name: str, position_m: tuple[float, float, float]) -> ml.Camera:
    """A camera at a place, looking at a point one metre above the floor."""
    position = np.array(position_m)
    forward = np.array([0.0, 0.0, 1.0]) - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return ml.Camera(
        id=name,
        size_px=(1280, 1024),
        focal_px=(1200.0, 1200.0),
        principal_px=(639.5, 511.5),
        rotation=np.array([right, np.cross(forward, right), forward]),
        position_m=position,
    )


rig = ml.Rig.of([camera("left", (3, -2, 2)), camera("middle", (3.5, 0, 2.5)), camera("right", (3, 2, 2))])
marker_m = np.array([[0.2, 0.1, 1.3]])
pixels = {c.id: rig.project(i, marker_m)[0].tolist() for i, c in enumerate(rig.cameras)}
found = ml.triangulate(rig, pixels, sigma_px=0.2)

Path("out").mkdir(exist_ok=True)
ml.write_calibration(rig, "out/Calib.toml")
print(f"point {np.round(found.point_m, 6).tolist()} m, uncertain by {found.sigma_mm:.2f} mm")
