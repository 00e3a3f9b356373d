"""Grey blobs of a real Vicon take, fitted, beside Vicon's own points.

    python benches/grey_blobs.py

Counted are blobs that hold exactly one labelled marker: its projection lies within 1.5 px of one of the blob's pixels.
The cameras of this take had crept since their calibration, by up to 2 px: "corrected" takes that off, camera by camera,
by an affine fit to Vicon's own centroids, whose share within 1 px is printed beside it.
"""

from __future__ import annotations

import gzip
import json
from collections import defaultdict
from pathlib import Path

import numpy as np

import markerloom as ml

FOLDER = Path(__file__).resolve().parents[2] / "shared" / "data" / "vicon-upper-body"


THRESHOLD = 51.0
"""No pixel of these blobs is darker."""


def drift(pixel: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Affine map (3, 2) of a place in the image to how far the camera's dots lie beside it, robustly."""
    system, weight = np.column_stack([expected, np.ones(len(expected))]), np.ones(len(expected))
    fitted = np.zeros((3, 2))
    for _ in range(10):
        fitted = np.linalg.lstsq(system * weight[:, None], (pixel - expected) * weight[:, None], rcond=None)[0]
        off = np.linalg.norm(pixel - expected - system @ fitted, axis=1)
        weight = 1.0 / np.sqrt(1.0 + (off / 0.3) ** 2)
    return fitted


def main() -> None:
    """The table."""
    rig = ml.read_calibration(FOLDER / "move.xcp")
    dots = ml.read_observations(FOLDER / "move_centroids.csv.gz")
    vicon = ml.read_points(FOLDER / "move_vicon3d.csv.gz")
    rows = defaultdict(list)
    for row, frame in enumerate(vicon.frame):
        rows[int(frame)].append(row)
    blobs = []
    with gzip.open(FOLDER / "move_greyblobs.jsonl.gz", "rt") as file:
        for line in map(json.loads, file):
            pixels = [(x + k, y, value) for x, y, values in line["lines"] for k, value in enumerate(values)]
            blobs.append(ml.GreyBlob(line["frame"], str(line["camera"]), tuple(pixels)))
    radii = {c: float(np.median(dots.optional["radius"][dots.camera == i])) for i, c in enumerate(dots.camera_ids)}
    print("camera    blobs  fitted raw  fitted corrected  plain centroid corrected  Vicon's centroids raw, corrected")
    total = np.zeros(4)
    for index, camera in enumerate(dots.camera_ids):
        projected = rig.project(rig.ids.index(camera), vicon.xyz_mm / 1000.0)
        own = np.flatnonzero(dots.camera == index)

        def closest(row: int, places: np.ndarray = projected) -> int:
            return min(rows[int(dots.frame[row])], key=lambda v: float(np.hypot(*(places[v] - dots.pixel[row]))))

        nearest = np.array([closest(row) for row in own.tolist()])
        near = np.linalg.norm(projected[nearest] - dots.pixel[own], axis=1) < 4.0
        map_to = drift(dots.pixel[own][near], projected[nearest][near])
        corrected = projected + np.column_stack([projected, np.ones(len(projected))]) @ map_to
        good = [np.linalg.norm(p[nearest] - dots.pixel[own], axis=1)[near] < 1.0 for p in (projected, corrected)]
        hits = np.array([_judge(b, rows, projected, corrected, radii) for b in blobs if b.camera == camera])
        hits = hits[hits[:, 0] >= 0]
        total += [len(hits), *hits.sum(axis=0)]
        print(
            f"{camera:9s} {len(hits):5d} {hits[:, 0].mean():10.1%} {hits[:, 1].mean():16.1%} {hits[:, 2].mean():20.1%} "
            f"{good[0].mean():28.1%} {good[1].mean():9.1%}"
        )
    print(
        f"all       {total[0]:5.0f} {total[1] / total[0]:10.1%} {total[2] / total[0]:16.1%} {total[3] / total[0]:20.1%}"
    )


def _judge(
    blob: ml.GreyBlob, rows: dict[int, list[int]], projected: np.ndarray, corrected: np.ndarray, radii: dict[str, float]
) -> tuple[int, int, int]:
    """Whether the fit lies within 1 px of the raw and the corrected projection, and the plain centroid of that."""
    pixels = np.array([p[:2] for p in blob.pixels], float)
    here = rows[blob.frame]
    away = np.linalg.norm(corrected[here][:, None] - pixels[None], axis=2).min(axis=1)
    held = np.flatnonzero(away < 1.5)
    if len(held) != 1:
        return -1, -1, -1
    row = here[held[0]]
    found = ml.fit_grey_blobs([blob], radii, threshold=THRESHOLD).pixel
    weight = np.array([p[2] for p in blob.pixels], float) - 45.0
    plain = (pixels * weight[:, None]).sum(axis=0) / weight.sum()

    def near(places: np.ndarray, to: np.ndarray) -> int:
        return int(len(places) > 0 and np.linalg.norm(places - to, axis=1).min() < 1.0)

    return near(found, projected[row]), near(found, corrected[row]), near(plain[None], corrected[row])


if __name__ == "__main__":
    main()
