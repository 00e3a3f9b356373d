"""Intrinsics from the real checkerboard images of four cameras, beside Qualisys' calibration of the same cameras.

python benches/boards.py
"""

from __future__ import annotations

import time
from pathlib import Path

import markerloom as ml

FOLDER = Path(__file__).resolve().parents[2] / "shared" / "data" / "boards"


def main() -> None:
    """One line for each camera."""
    sources = {f"cam0{c}": FOLDER / "intrinsics" / f"int_cam0{c}_img" for c in range(1, 5)}
    reference = ml.read_calibration(FOLDER / "Calib.qca.txt")
    clock = time.perf_counter()
    rig, report = ml.calibrate_intrinsics(sources, ml.read_board("checkerboard:4x7:60"))
    seconds = time.perf_counter() - clock
    print("camera  found  rms px  focal px (±)           Qualisys  difference")
    found = images = 0
    for camera in rig.cameras:
        own, other = report["cameras"][camera.id], reference.find(camera.id)
        assert other is not None
        found, images = found + own["views"], images + own["images"]
        print(
            f"{camera.id}  {own['views']} of {own['images']}  {own['reprojection_px']['rms']:.3f}   "
            f"{camera.focal_px[0]:.1f} ± {own['focal_px_sigma'][0]:.1f}   {other.focal_px[0]:8.1f}  "
            f"{camera.focal_px[0] / other.focal_px[0] - 1:+.2%}"
        )
    print(f"{found} of {images} images in use, verdict {report['verdict']}, {seconds:.1f} s")


if __name__ == "__main__":
    main()
