"""Calibration from simulated wand waves beside the Cramér–Rao bound, and from the real wave.

    python benches/calibration.py [simulated|real] [--cameras=8,16,32] [--seeds=5] [--frames=1000]

The bound is computed here from the true rig and the true poses with numerical derivatives of a projection of its own,
for the parameters that the calibration leaves free; the world is laid onto the camera centres.
"""

from __future__ import annotations

import sys
import time
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


def bound_mm(take: ml.SimulatedTake) -> np.ndarray:
    """Smallest standard deviation (mm, three axes together) of each camera centre."""
    rig, sigma = take.rig, take.scene.sigma_px
    markers = len(ml.read_wand(take.scene.wand).markers)
    places = take.truth.xyz_mm.reshape(-1, markers, 3) / 1000.0
    labels = sorted(set(take.truth.label.tolist()))
    table = take.truth_assignments.to_pydict()
    n, frames = len(rig), len(places)
    full = np.zeros((n * CAMERA, n * CAMERA))
    blocks, crosses = np.zeros((frames, POSE, POSE)), np.zeros((frames, n * CAMERA, POSE))
    for index, camera in enumerate(rig.cameras):
        rows = [i for i, c in enumerate(table["camera"]) if c == camera.id]
        frame = np.array([table["frame"][i] for i in rows])
        marker = np.array([labels.index(table["label"][i]) for i in rows])
        both = derivatives(camera, places[frame, marker], places[frame].mean(axis=1))
        own, pose = both[:, :, :CAMERA] / sigma, both[:, :, CAMERA:] / sigma
        at = slice(index * CAMERA, (index + 1) * CAMERA)
        full[at, at] = np.einsum("nri,nrj->ij", own, own)
        np.add.at(blocks, frame, np.einsum("nri,nrj->nij", pose, pose))
        np.add.at(crosses[:, at], frame, np.einsum("nri,nrj->nij", own, pose))
    seen = np.linalg.matrix_rank(blocks) == POSE
    for block, cross in zip(blocks[seen], crosses[seen], strict=True):
        full -= cross @ np.linalg.solve(block, cross.T)
    scale = 1 / np.sqrt(np.diag(full))
    values, vectors = np.linalg.eigh(full * np.outer(scale, scale))
    kept = vectors[:, 6:]  # the six motions of the world are free
    covariance = (kept / values[6:]) @ kept.T * np.outer(scale, scale)
    motions, hold = world(rig)
    lay = np.eye(n * CAMERA) - motions @ np.linalg.solve(hold @ motions, hold)
    covariance = lay @ covariance @ lay.T
    return 1000 * np.sqrt([np.trace(covariance[i + 3 : i + 6, i + 3 : i + 6]) for i in range(0, n * CAMERA, CAMERA)])


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


def simulated(cameras: list[int], seeds: int, frames: int) -> None:
    """One row per rig: 0.1 px, unknown focal lengths, clutter and reflections as the scene has them."""
    print("cameras  verdicts  px/σ    centres mm  bound mm  ratio  (e/σ)²  scale     seconds")
    for n in cameras:
        rows = []
        for seed in range(seeds):
            take = ml.simulate(ml.make_scene("wand", cameras=n, frames=frames, seed=seed))
            size = (float(take.scene.image_width), float(take.scene.image_height))
            start = time.perf_counter()
            made = ml.calibrate_wand(
                take.observations, ml.read_wand(take.scene.wand), image_sizes=dict.fromkeys(take.rig.ids, size)
            )
            seconds = time.perf_counter() - start
            error, scale = aligned(
                np.array([c.position_m for c in made.rig.cameras]), np.array([c.position_m for c in take.rig.cameras])
            )
            error_mm = 1000 * np.linalg.norm(error, axis=1)
            sigma = np.array([c["position_sigma_mm"] for c in made.report["cameras"].values()])
            fit = made.report["reprojection_px"] / take.scene.sigma_px
            ok = made.report["verdict"] == "ok"
            squares = [np.mean(error_mm**2), np.mean(bound_mm(take) ** 2), np.mean((error_mm / sigma) ** 2)]
            rows.append([ok, fit, *squares, abs(scale), seconds])
        ok, fit, error, bound, honest, scale, seconds = np.mean(rows, axis=0)
        print(
            f"{n:7d}  {ok * seeds:.0f} of {seeds}    {fit:.4f}  {np.sqrt(error):10.4f}  {np.sqrt(bound):8.4f}  "
            f"{np.sqrt(error / bound):5.3f}  {honest:6.3f}  {scale:.2e}  {seconds:7.1f}",
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
    print(f"wand dots used {report['observations_used']:.4f}")
    print(
        f"wand lengths: std {report['wand_length_mm']['std']:.3f}, robust {report['wand_length_mm']['spread']:.3f} mm"
    )
    print(f"focal lengths: largest difference from the vendor's {np.abs(ratio).max():.4%}")


def main() -> None:
    """Run what is asked for."""
    options = dict(a.lstrip("-").split("=", 1) for a in sys.argv[1:] if a.startswith("--"))
    wanted = [a for a in sys.argv[1:] if not a.startswith("--")] or ["simulated", "real"]
    if "simulated" in wanted:
        cameras = [int(n) for n in options.get("cameras", "8,16,32").split(",")]
        simulated(cameras, int(options.get("seeds", "5")), int(options.get("frames", "1000")))
    if "real" in wanted:
        real()


if __name__ == "__main__":
    main()
