"""A camera knocked by 5 mm and 0.3° in the middle of a take: when it is found, and how well it is solved anew.

    python benches/knocked.py [--scene=walk] [--seeds=0:5] [--frames=400]

The bound is that of the camera's pose from all frames after the knock, the other cameras known, computed here from the
true rig, places and views with numerical derivatives. Shown are the root mean square over all its markers' places of
how far the new pose projects them aside (px), and the same for the bound: rotation and position alone trade off.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

import markerloom as ml
from markerloom.knock import _dots_of

STEP = 1e-6
HEADER = "seed camera  found after  pose mm / °          bound mm / °         aside px  bound px  others moved  ratio"


def by_pose(rig: ml.Rig, index: int, places: np.ndarray) -> np.ndarray:
    """Derivatives (n, 2, 6) of pixels by the camera's turn (its own axes, rad) and position (m)."""

    def moved(step: np.ndarray) -> np.ndarray:
        one = rig.cameras[index]
        turned = Rotation.from_rotvec(step[:3]).as_matrix() @ one.rotation
        other = replace(one, rotation=turned, position_m=one.position_m + step[3:])
        return ml.Rig((other,)).project(0, places)

    steps = STEP * np.eye(6)
    return np.stack([(moved(s) - moved(-s)) / (2 * STEP) for s in steps], axis=2)


def by_place(rig: ml.Rig, index: int, places: np.ndarray) -> np.ndarray:
    """Derivatives (n, 2, 3) of pixels by the places."""
    steps = STEP * np.eye(3)
    return np.stack(
        [(rig.project(index, places + s) - rig.project(index, places - s)) / (2 * STEP) for s in steps], axis=2
    )


def bound(take: ml.SimulatedTake, rig: ml.Rig, index: int, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """Smallest covariance (6, 6) of the camera's pose, and the derivatives of its dots by it."""
    sigma = take.scene.sigma_px
    information: dict[bytes, np.ndarray] = {}
    for other, camera in enumerate(rig.cameras):
        if other != index:
            _, places = _dots_of(take, camera.id, frame)
            for place, jacobian in zip(places, by_place(rig, other, places), strict=True):
                key = place.tobytes()
                information[key] = information.get(key, 0.0) + jacobian.T @ jacobian / sigma**2
    _, places = _dots_of(take, rig.cameras[index].id, frame)
    pose, place = by_pose(rig, index, places), by_place(rig, index, places)
    total, used = np.zeros((6, 6)), []
    for k, at in enumerate(places):
        known = information.get(at.tobytes())
        if known is not None and np.linalg.matrix_rank(known) == 3:
            noise = sigma**2 * np.eye(2) + place[k] @ np.linalg.solve(known, place[k].T)
            total += pose[k].T @ np.linalg.solve(noise, pose[k])
            used.append(k)
    return np.linalg.inv(total), pose[used]


def aside_px(derivatives: np.ndarray, covariance: np.ndarray) -> float:
    """Root mean square displacement of the dots under a covariance of the pose."""
    return float(np.sqrt(np.mean(np.einsum("nri,ij,nrj->n", derivatives, covariance, derivatives))))


def main() -> None:
    """One row per seed."""
    options = dict(a.lstrip("-").split("=", 1) for a in sys.argv[1:])
    frames = int(options.get("frames", "400"))
    print(HEADER)
    for seed in range(*map(int, options.get("seeds", "0:5").split(":"))):
        take = ml.simulate(ml.make_scene(options.get("scene", "walk"), frames=frames, sigma_px=0.1, seed=seed))
        random = np.random.default_rng(seed)
        index = int(random.integers(len(take.rig)))
        turn, shift = (v / np.linalg.norm(v) for v in random.normal(size=(2, 3)))
        name, frame = take.rig.ids[index], frames // 2
        knocked, after = ml.knock(take, name, frame=frame, turn_rad=np.radians(0.3) * turn, shift_m=0.005 * shift)
        healed = ml.track(knocked.observations, take.rig, refine_calibration=True)
        moves = [m for m in healed.report["bumped_cameras"] if m["camera"] == name]
        assert isinstance(healed, ml.TrackedTake)
        assert healed.seen is not None
        last = healed.seen.cameras.rig_at(frames)
        true = replace(take.rig, cameras=tuple(after if i == index else c for i, c in enumerate(take.rig.cameras)))
        covariance, derivatives = bound(take, true, index, frame)
        found = last.cameras[index]
        turned = Rotation.from_matrix(found.rotation @ after.rotation.T).as_rotvec()
        error = np.concatenate([turned, found.position_m - after.position_m])
        best, got = aside_px(derivatives, covariance), aside_px(derivatives, np.outer(error, error))
        others = max(
            float(np.linalg.norm(a.position_m - b.position_m))
            for i, (a, b) in enumerate(zip(last.cameras, take.rig.cameras, strict=True))
            if i != index
        )
        after_frames = moves[0]["found"] - frame + 1 if moves else -1
        errors = f"{1000 * np.linalg.norm(error[3:]):.3f} / {np.degrees(np.linalg.norm(turned)):.4f}"
        limits = f"{1000 * np.sqrt(np.trace(covariance[3:, 3:])):.3f} / "
        limits += f"{np.degrees(np.sqrt(np.trace(covariance[:3, :3]))):.4f}"
        print(
            f"{seed:4d} {name:7s} {after_frames:4d} frames  {errors:18s}   {limits:18s}   {got:7.4f}   {best:7.4f}   "
            f"{1000 * others:8.3f} mm   {got / best:5.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
