"""A simulated range of motion with its joint centres, for tests and benches."""

import numpy as np

from markerloom import _core
from markerloom.simulate import _worn
from markerloom.skeleton.motion import Motion

SAME = {
    "thorax": "vl5",
    "head": "skullbase",
    "upper_arm": "shoulder",
    "forearm": "elbow",
    "hand": "radiocarpal",
    "thigh": "hip",
    "shank": "knee",
    "foot": "talocrural",
}
"""Where the simulated figure's segments begin, and the joint of H-Anim that is there."""


def rom(
    *,
    seed: int,
    frames: int,
    rate_hz: float = 100.0,
    noise_mm: float = 1.0,
    motion: str = "rom",
    marker_set: str = "front-waist-53",
) -> tuple[list[str], np.ndarray, list[str], np.ndarray]:
    """Names, markers (frames, markers, 3; mm) with noise; joints and their true centres (frames, joints, 3; mm)."""
    worn = _worn(marker_set)
    times = [f / rate_hz for f in range(frames)]
    xyz = 1000.0 * np.array([_core.wearing_pose(motion, worn, seed, (0, 0, 0), 1.0, t)[0] for t in times])
    centers = [_core.wearing_joints(motion, worn, seed, (0, 0, 0), 1.0, t) for t in times]
    places = 1000.0 * np.array([[p for _, p in frame] for frame in centers])
    noise = np.random.default_rng(seed).standard_normal(xyz.shape)
    return [m for m, _, _ in worn], xyz + noise_mm * noise, [n for n, _ in centers[0]], places


def joint_errors_mm(
    motion: Motion, joints: list[str], centers_mm: np.ndarray, window: slice = slice(None)
) -> dict[str, float]:
    """Root mean square distance of each joint centre from the truth (mm)."""
    at = 1000.0 * motion.joints_m()
    out = {}
    for i, name in enumerate(joints):
        part, _, side = name.rpartition("_")
        ours = f"{side}_{SAME[part]}" if part in SAME else SAME.get(name, "")
        if ours in motion.skeleton.joints:
            off = at[window, motion.skeleton.index(ours)] - centers_mm[window, i]
            out[name] = float(np.sqrt((off**2).sum(axis=1).mean()))
    return out
