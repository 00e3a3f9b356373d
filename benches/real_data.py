"""The figures on real recordings: needs ../shared/data (not part of the repository).

Run: python benches/real_data.py [all]      ("all" adds every subset of 6, 5 and 4 cameras: about 12 minutes)
"""

from __future__ import annotations

import sys
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

import markerloom as ml

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
REFLECTIONS = (
    ("experiment-2", "experiment-2.xcp"),
    ("experiment-2/retry", "experiment-2.xcp"),
    ("experiment-3/all-cams", "experiment-3.xcp"),
)


class UpperBody:
    """The moving take: 8 cameras that drifted after their calibration, 23 markers, 400 frames."""

    def __init__(self, data: Path) -> None:
        """Read the take."""
        folder = data / "vicon-upper-body"
        self.rig = ml.read_calibration(folder / "move.xcp")
        self.observations = ml.read_observations(folder / "move_centroids.csv.gz")
        self.vicon = ml.read_points(folder / "move_vicon3d.csv.gz")

    @property
    def active(self) -> list[str]:
        """Ids of the cameras that saw anything."""
        return [i for i in self.rig.ids if i in self.observations.camera_ids]

    def score(self, method: str, cameras: list[str] | None = None) -> dict[str, Any]:
        """Reconstruct with some of the cameras and compare with Vicon's own 3D at 10 mm, rigidly aligned."""
        ids = cameras or self.active
        rig = self.rig.subset(ids)
        observations = self.observations.of_cameras(ids)
        truth = ml.truth_from_observations(self.vicon, observations, rig)
        points = ml.reconstruct(observations, rig, method=method)
        return ml.evaluate(points, truth, tolerance_mm=10.0, align="rigid")


def static_trial(data: Path, method: str) -> dict[str, Any]:
    """The static trial, straight from the raw .x2d, against Vicon's C3D of its first frames."""
    folder = data / "vicon-upper-body"
    rig, observations = ml.read_calibration(folder / "cal.xcp"), ml.read_observations(folder / "cal.x2d")
    vicon = ml.read_points(folder / "cal.c3d")
    truth = ml.truth_from_observations(vicon, observations, rig)
    points = ml.reconstruct(observations, rig, method=method)
    return ml.evaluate(points, truth, tolerance_mm=10.0, frames=(0, len(vicon.frames)), align="rigid")


def reflections(data: Path, folder: str, calibration: str, method: str) -> tuple[int, int, float]:
    """Points found, markers there, and the largest distance of a marker to its nearest point (mm)."""
    place = data / "vicon-reflections"
    observations = ml.read_observations(next((place / folder).glob("centroid-dump*.csv")))
    vicon = ml.read_points(next((place / folder).glob("marker-dump*.csv")))
    points = ml.reconstruct(observations, ml.read_calibration(place / calibration), method=method)
    distance = np.linalg.norm(points.xyz_mm[:, None] - vicon.xyz_mm[None], axis=2)
    return len(points), len(vicon), float(distance.min(axis=0).max())


def line(name: str, result: dict[str, Any]) -> str:
    """One printed row."""
    return (
        f"{name:34} ghosts {result['ghosts_per_frame']:.4f}  missing {result['missing_per_frame']:.4f}  "
        f"median {result['error_mm']['median']:.3f} mm"
    )


def subsets(take: UpperBody, step: int = 1) -> None:
    """Mean figures over all subsets of 6, 5 and 4 of the cameras."""
    for n in (6, 5, 4):
        chosen = [list(c) for c in combinations(take.active, n)][::step]
        for method in ("optimal", "relaxation"):
            results = [take.score(method, cameras) for cameras in chosen]
            figures = ("ghosts_per_frame", "missing_per_frame")
            means = {f: float(np.mean([r[f] for r in results])) for f in figures}
            median = float(np.mean([r["error_mm"]["median"] for r in results]))
            name = f"{n} of 8 cameras ({len(chosen)}), {method}"
            print(line(name, {**means, "error_mm": {"median": median}}), flush=True)


def main() -> None:
    """Print every figure."""
    if not DATA.is_dir():
        sys.exit("the real recordings (../shared/data) are not on this machine")
    take = UpperBody(DATA)
    for method in ("optimal", "relaxation"):
        print(line(f"upper body, {method}", take.score(method)))
        print(line(f"static trial from x2d, {method}", static_trial(DATA, method)))
        for folder, calibration in REFLECTIONS:
            found, markers, worst = reflections(DATA, folder, calibration, method)
            print(f"{folder + ', ' + method:34} {found} points for {markers} markers, worst {worst:.2f} mm")
    if sys.argv[1:] == ["all"]:
        subsets(take)


if __name__ == "__main__":
    main()
