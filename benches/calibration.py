"""Calibration from simulated wand waves beside the Cramér–Rao bound, and from the real wave.

    python benches/calibration.py [simulated|errors|real] [--cameras=8,16,32] [--seeds=0:5] [--frames=1000]

The bound is computed here from the true rig and the true poses with numerical derivatives of a projection of its own,
for the parameters that the calibration leaves free; the world is laid onto the camera centres.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import markerloom as ml

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
STEP = 1e-5
CAMERA, POSE = 14, 6


def project(camera: np.ndarray, points: np.ndarray, about: ml.Camera) -> np.ndarray:
    """Pixels of points (n, 3): OpenCV's lens about the true pose, with the offsets ``camera`` (14,) added."""
    turned = Rotation.from_rotvec(camera[:3]).as_matrix() @ about.rotation
    x, y, z = turned @ (points - about.position_m - camera[3:6]).T
    x, y = x / z, y / z
    k1, k2, p1, p2, k3 = camera[9:14]
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    focal, center = about.focal_px[0] + camera[6], np.array(about.principal_px) + camera[7:9]
    return np.column_stack([focal * u, focal * v]) + center


def derivatives(camera: ml.Camera, places: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Rows (n, 2, 20): by the camera's parameters and by the pose (turn about ``middle`` (n, 3), shift)."""
    columns = []
    for k in range(CAMERA):
        step = np.zeros(CAMERA)
        step[k] = STEP
        columns.append((project(step, places, camera) - project(-step, places, camera)) / (2 * STEP))
    none = np.zeros(CAMERA)
    for k in range(POSE):
        axis = np.zeros(3)
        axis[k % 3] = STEP
        moved = [places + s * (np.cross(axis, places - middle) if k < 3 else axis) for s in (1, -1)]
        columns.append((project(none, moved[0], camera) - project(none, moved[1], camera)) / (2 * STEP))
    return np.stack(columns, axis=2)


def best_mm(take: ml.SimulatedTake) -> tuple[np.ndarray, np.ndarray]:
    """Smallest standard deviation (mm, three axes together) of each camera centre, and the errors of an ideal estimate.

    The ideal estimate is one Gauss-Newton step from the truth with every dot's true owner: no estimator that knows
    less does better but by chance, and this shows how much of that the drawn noise holds.
    """
    rig, sigma = take.rig, take.scene.sigma_px
    markers = len(ml.read_wand(take.scene.wand).markers)
    places = take.truth.xyz_mm.reshape(-1, markers, 3) / 1000.0
    n, frames = len(rig), len(places)
    full, right = np.zeros((n * CAMERA, n * CAMERA)), np.zeros(n * CAMERA)
    blocks, crosses = np.zeros((frames, POSE, POSE)), np.zeros((frames, n * CAMERA, POSE))
    pose_right = np.zeros((frames, POSE))
    for index, camera in enumerate(rig.cameras):
        frame, marker, pixel = true_sightings(take, camera.id)
        both = derivatives(camera, places[frame, marker], places[frame].mean(axis=1))
        off = (pixel - project(np.zeros(CAMERA), places[frame, marker], camera)) / sigma
        own, pose = both[:, :, :CAMERA] / sigma, both[:, :, CAMERA:] / sigma
        at = slice(index * CAMERA, (index + 1) * CAMERA)
        full[at, at] = np.einsum("nri,nrj->ij", own, own)
        right[at] = np.einsum("nri,nr->i", own, off)
        np.add.at(blocks, frame, np.einsum("nri,nrj->nij", pose, pose))
        np.add.at(pose_right, frame, np.einsum("nri,nr->ni", pose, off))
        np.add.at(crosses[:, at], frame, np.einsum("nri,nrj->nij", own, pose))
    seen = np.linalg.matrix_rank(blocks) == POSE
    for block, cross, own_right in zip(blocks[seen], crosses[seen], pose_right[seen], strict=True):
        gain = np.linalg.solve(block, cross.T).T
        full -= gain @ cross.T
        right -= gain @ own_right
    scale = 1 / np.sqrt(np.diag(full))
    values, vectors = np.linalg.eigh(full * np.outer(scale, scale))
    kept = vectors[:, 6:]  # the six motions of the world are free
    covariance = (kept / values[6:]) @ kept.T * np.outer(scale, scale)
    motions, hold = world(rig)
    lay = np.eye(n * CAMERA) - motions @ np.linalg.solve(hold @ motions, hold)
    step, covariance = lay @ covariance @ right, lay @ covariance @ lay.T
    centers = [slice(i + 3, i + 6) for i in range(0, n * CAMERA, CAMERA)]
    return (
        1000 * np.sqrt([np.trace(covariance[c, c]) for c in centers]),
        1000 * np.array([np.linalg.norm(step[c]) for c in centers]),
    )


def true_sightings(take: ml.SimulatedTake, camera: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frame, marker and pixel of every dot of a camera that is one marker alone."""
    labels = {label: i for i, label in enumerate(sorted(set(take.truth.label.tolist())))}
    dots = take.observations
    own = dots.camera == dots.camera_ids.index(camera)
    rows = np.flatnonzero(own)[np.argsort(dots.frame[own], kind="stable")]
    first = dict(zip(*np.unique(dots.frame[rows], return_index=True), strict=True))
    table = take.truth_assignments.to_pydict()
    owners: dict[int, list[tuple[int, int]]] = {}
    for f, c, o, label in zip(*(table[k] for k in ("frame", "camera", "observation", "label")), strict=True):
        if c == camera:
            owners.setdefault(int(rows[first[f] + o]), []).append((f, labels[label]))
    alone = [(row, *of[0]) for row, of in owners.items() if len(of) == 1]
    row, frame, marker = np.array(alone).T
    return frame, marker, dots.pixel[row]


def world(rig: ml.Rig) -> tuple[np.ndarray, np.ndarray]:
    """The world's six motions as parameter steps (columns), and what holds the camera centres against them (rows)."""
    centers = np.array([c.position_m for c in rig.cameras])
    motions, hold = np.zeros((len(rig) * CAMERA, 6)), np.zeros((6, len(rig) * CAMERA))
    for i, camera in enumerate(rig.cameras):
        arm = centers[i] - centers.mean(axis=0)
        turn = -np.array([[0, -arm[2], arm[1]], [arm[2], 0, -arm[0]], [-arm[1], arm[0], 0]])
        at = i * CAMERA
        motions[at + 3 : at + 6, :3], motions[at + 3 : at + 6, 3:] = np.eye(3), turn
        motions[at : at + 3, 3:] = -camera.rotation
        hold[:3, at + 3 : at + 6], hold[3:, at + 3 : at + 6] = np.eye(3), turn.T
    return motions, hold


def aligned(found: np.ndarray, true: np.ndarray) -> tuple[np.ndarray, float]:
    """Errors (n, 3) after a rigid alignment, and the relative error of the scale."""
    a, b = found - found.mean(axis=0), true - true.mean(axis=0)
    u, s, vt = np.linalg.svd(a.T @ b)
    signs = np.array([1.0, 1.0, np.linalg.det(u @ vt)])
    turn = (u * signs @ vt).T
    return a @ turn.T - b, float((s * signs).sum() / (a**2).sum() - 1)


def with_errors(take: ml.SimulatedTake) -> ml.Observations:
    """The take's dots with one in twenty anywhere, and one view in ten turned end for end: its markers change names."""
    random = np.random.default_rng(take.scene.seed)
    dots = take.observations
    pixel = dots.pixel.copy()
    _, view = np.unique(np.column_stack([dots.frame, dots.camera]), axis=0, return_inverse=True)
    view = view.reshape(-1)
    middle = np.column_stack([np.bincount(view, pixel[:, k]) / np.bincount(view) for k in (0, 1)])
    size = np.array([take.scene.image_width, take.scene.image_height])
    ends = 2 * middle[view] - pixel
    outside = np.bincount(view, np.any((ends < 0) | (ends > size - 1), axis=1)) > 0
    turned = ((random.random(len(middle)) < 0.10 / (1 - outside.mean())) & ~outside)[view]
    pixel[turned] = ends[turned]
    wrong = random.random(len(pixel)) < 0.05
    pixel[wrong] = random.random((int(wrong.sum()), 2)) * size
    return replace(dots, pixel=pixel)


def simulated(cameras: list[int], seeds: range, frames: int, errors: bool) -> None:
    """One row per rig: 0.1 px, unknown focal lengths, clutter and reflections as the scene has them."""
    print(f"{'with wrong dots and names' if errors else 'as simulated'}; seeds {seeds.start}-{seeds.stop - 1}")
    print("cameras  verdicts  px/σ    centres mm  ideal mm  bound mm  ratio  (e/σ)²  ideal   scale     seconds")
    for n in cameras:
        rows = []
        for seed in seeds:
            take = ml.simulate(ml.make_scene("wand", cameras=n, frames=frames, seed=seed))
            size = (float(take.scene.image_width), float(take.scene.image_height))
            observations = with_errors(take) if errors else take.observations
            start = time.perf_counter()
            made = ml.calibrate_wand(
                observations, ml.read_wand(take.scene.wand), image_sizes=dict.fromkeys(take.rig.ids, size)
            )
            seconds = time.perf_counter() - start
            error, scale = aligned(
                np.array([c.position_m for c in made.rig.cameras]), np.array([c.position_m for c in take.rig.cameras])
            )
            error_mm = 1000 * np.linalg.norm(error, axis=1)
            sigma = np.array([c["position_sigma_mm"] for c in made.report["cameras"].values()])
            fit = made.report["reprojection_px"] / take.scene.sigma_px
            ok = made.report["verdict"] == "ok"
            bound, ideal = best_mm(take)
            squares = [np.mean(v**2) for v in (error_mm, ideal, bound, error_mm / sigma, ideal / bound)]
            rows.append([ok, fit, *squares, abs(scale), seconds])
        ok, fit, error, ideal, bound, honest, least, scale, seconds = np.mean(rows, axis=0)
        roots = " ".join(f"{np.sqrt(v):9.4f}" for v in (error, ideal, bound))
        print(
            f"{n:7d}  {ok * len(seeds):.0f} of {len(seeds)}    {fit:.4f}  {roots}  {np.sqrt(error / bound):5.3f}  "
            f"{honest:6.3f}  {least:6.3f}  {scale:.2e}  {seconds:7.1f}",
            flush=True,
        )


def real() -> None:
    """The real wave, from nothing but its dots and the wand's shape."""
    take = ml.read_observations(DATA / "vicon-wand" / "wand_centroids.csv.gz")
    vendor = ml.read_calibration(DATA / "vicon-wand" / "reference.xcp")
    start = time.perf_counter()
    made = ml.calibrate_wand(take, ml.read_wand("vicon-t"), image_sizes={c.id: c.size_px for c in vendor.cameras})
    seconds = time.perf_counter() - start
    report = made.report
    ratio = [c.focal_px[0] / vendor.cameras[vendor.ids.index(c.id)].focal_px[0] - 1 for c in made.rig.cameras]
    print(f"verdict {report['verdict']}, {report['poses']} poses, {seconds:.1f} s")
    print(f"median residual on poses left out {report['left_out_residual_px']['median']:.4f} px")
    print(
        f"dots used {report['observations_used']:.4f} of those near the wand, "
        f"{report['observations'] / len(take):.4f} of all"
    )
    print(
        f"wand lengths: std {report['wand_length_mm']['std']:.3f}, robust {report['wand_length_mm']['spread']:.3f} mm"
    )
    print(f"focal lengths: largest difference from the vendor's {np.abs(ratio).max():.4%}")


def main() -> None:
    """Run what is asked for."""
    options = dict(a.lstrip("-").split("=", 1) for a in sys.argv[1:] if a.startswith("--"))
    wanted = [a for a in sys.argv[1:] if not a.startswith("--")] or ["simulated", "errors", "real"]
    cameras = [int(n) for n in options.get("cameras", "8,16,32").split(",")]
    seeds = range(*map(int, options.get("seeds", "0:5").split(":")))
    for kind in [k for k in ("simulated", "errors") if k in wanted]:
        simulated(cameras, seeds, int(options.get("frames", "1000")), kind == "errors")
    if "real" in wanted:
        real()


if __name__ == "__main__":
    main()
