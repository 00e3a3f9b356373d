"""Joint angles by ISB's recommendations, named (Wu et al. 2002, hip, ankle, spine; Wu et al. 2005, shoulder, elbow,
wrist; the knee after Grood & Suntay 1983).

All from the segments' axes: x forward, y up, z to the right, the arms hanging. Flexion, adduction and internal
rotation are positive on both sides.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.skeleton.motion import Motion, euler
from markerloom.skeleton.skeleton import Skeleton

Array = NDArray[np.floating[Any]]
TO_ISB = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
"""From left, back, up to forward, up, right."""
MIRROR = np.diag([1.0, 1.0, -1.0])
"""Takes the left side to the right one."""
NAMES = {
    "hip": ("flexion", "adduction", "internal rotation"),
    "knee": ("flexion", "adduction", "internal rotation"),
    "ankle": ("dorsiflexion", "inversion", "internal rotation"),
    "trunk": ("flexion", "lateral bend to the right", "rotation to the left"),
    "neck": ("flexion", "lateral bend to the right", "rotation to the left"),
    "shoulder": ("plane of elevation", "elevation", "axial rotation"),
    "elbow": ("flexion", "carrying angle", "pronation"),
    "wrist": ("flexion", "radial deviation", "pronation"),
}
SEGMENTS = {
    "thigh": "hip",
    "shank": "knee",
    "foot": "ankle",
    "upper_arm": "shoulder",
    "forearm": "elbow",
    "hand": "wrist",
}


def joint_angles(motion: Motion) -> dict[str, list[tuple[str, Array]]]:
    """For joints that move a segment of the body: three names and angles (frames; deg)."""
    skeleton = motion.skeleton
    turn, _ = motion.segments()
    hanging = arms_hanging(skeleton)
    out: dict[str, list[tuple[str, Array]]] = {}
    for segment, joint in skeleton.segments.items():
        side, _, part = segment.partition("_")
        kind = SEGMENTS.get(part) if side in ("left", "right") else {"thorax": "trunk", "head": "neck"}.get(segment)
        if kind is None or joint == 0:
            continue
        above = _above(skeleton, segment, joint)
        axes = [TO_ISB @ hanging[j] for j in (above, joint)]
        relative = axes[0] @ np.swapaxes(turn[:, above], 1, 2) @ turn[:, joint] @ axes[1].T
        if side == "left":
            relative = MIRROR @ relative @ MIRROR
        angles = np.rad2deg(_angles(kind, relative))
        out[skeleton.joints[joint]] = list(zip(NAMES[kind], angles.T, strict=True))
    return out


def _above(skeleton: Skeleton, segment: str, joint: int) -> int:
    """The segment an angle is told against: trunk for shoulders, pelvis for hips and trunk, else the joint above."""
    _, _, part = segment.partition("_")
    if part == "upper_arm":
        return skeleton.segments.get("thorax", skeleton.parents[joint])
    if part == "thigh" or segment == "thorax":
        return skeleton.segments.get("pelvis", 0)
    return skeleton.segments.get("thorax", skeleton.parents[joint]) if segment == "head" else skeleton.parents[joint]


def arms_hanging(skeleton: Skeleton) -> Array:
    """Turns of the segments' axes that make the arms hang in the rest pose (joints, 3, 3), for `with_rest`: the arms of
    a T-pose are turned down about the back axis.
    """
    out = np.tile(np.eye(3), (len(skeleton), 1, 1))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        shoulder = skeleton.segments.get(f"{side}_upper_arm", -1)
        below = skeleton.children(shoulder) if shoulder >= 0 else []
        if not below or abs(skeleton.offsets_m[below[0]][0]) < abs(skeleton.offsets_m[below[0]][2]):
            continue
        arm = {shoulder}
        for j in range(shoulder + 1, len(skeleton)):
            if skeleton.parents[j] in arm:
                arm.add(j)
        out[sorted(arm)] = np.array([[0.0, 0.0, sign], [0.0, 1.0, 0.0], [-sign, 0.0, 0.0]])
    return out


def _angles(kind: str, relative: Array) -> Array:
    """Three angles (frames, 3; rad) of a segment of the right side against another, both in ISB's axes."""
    if kind == "shoulder":
        found = euler("YXY", relative)
        # Elevation is about the axis that points forward, and negative; the same turn has another solution.
        other = np.stack([found[:, 0] + np.pi, -found[:, 1], found[:, 2] + np.pi], axis=1)
        found = np.where(found[:, 1:2] > 0, other, found)
        return np.stack([_wrapped(found[:, 0]), -found[:, 1], _wrapped(found[:, 2])], axis=1)
    found = euler("ZXY", relative)
    if kind in ("knee", "trunk", "neck"):
        found[:, 0] *= -1.0
    return found


def _wrapped(angle: Array) -> Array:
    return (angle + np.pi) % (2.0 * np.pi) - np.pi
