"""Clips for tests: a figure of seventeen joints that walks by inverse kinematics, so that its feet stand exactly."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.skeleton import Motion, Site, Skeleton

Array = NDArray[np.floating[Any]]
THIGH, SHANK, ANKLE = 0.42, 0.42, 0.08
BONES = {
    "Hips": (None, (0.0, 0.0, 0.0)),
    "Spine": ("Hips", (0.0, 0.0, 0.12)),
    "Chest": ("Spine", (0.0, 0.0, 0.18)),
    "Neck": ("Chest", (0.0, 0.0, 0.2)),
    "Head": ("Neck", (0.0, 0.0, 0.1)),
    "LeftArm": ("Chest", (0.18, 0.0, 0.15)),
    "LeftForeArm": ("LeftArm", (0.28, 0.0, 0.0)),
    "LeftHand": ("LeftForeArm", (0.26, 0.0, 0.0)),
    "RightArm": ("Chest", (-0.18, 0.0, 0.15)),
    "RightForeArm": ("RightArm", (-0.28, 0.0, 0.0)),
    "RightHand": ("RightForeArm", (-0.26, 0.0, 0.0)),
    "LeftUpLeg": ("Hips", (0.1, 0.0, 0.0)),
    "LeftLeg": ("LeftUpLeg", (0.0, 0.0, -THIGH)),
    "LeftFoot": ("LeftLeg", (0.0, 0.0, -SHANK)),
    "LeftToeBase": ("LeftFoot", (0.0, -0.14, -0.06)),
    "RightUpLeg": ("Hips", (-0.1, 0.0, 0.0)),
    "RightLeg": ("RightUpLeg", (0.0, 0.0, -THIGH)),
    "RightFoot": ("RightLeg", (0.0, 0.0, -SHANK)),
    "RightToeBase": ("RightFoot", (0.0, -0.14, -0.06)),
}


def figure() -> Skeleton:
    """The figure: a T-pose that faces −y."""
    names = tuple(BONES)
    ends = {"Head": (0.0, 0.0, 0.2), "LeftToeBase": (0.0, -0.06, -0.02), "RightToeBase": (0.0, -0.06, -0.02)}
    ends |= {"LeftHand": (0.15, 0.0, 0.0), "RightHand": (-0.15, 0.0, 0.0)}
    return Skeleton(
        name="figure",
        joints=names,
        parents=tuple(-1 if parent is None else names.index(parent) for parent, _ in BONES.values()),
        offsets_m=np.array([offset for _, offset in BONES.values()]),
        sites=tuple(Site(f"{name}_end", names.index(name), place) for name, place in ends.items()),
    )


def about_x(angle: Array) -> Array:
    """Turns (frames, 3, 3) about x."""
    out = np.tile(np.eye(3), (len(angle), 1, 1))
    out[:, 1, 1] = out[:, 2, 2] = np.cos(angle)
    out[:, 2, 1] = np.sin(angle)
    out[:, 1, 2] = -out[:, 2, 1]
    return out


def walk(
    seconds: float = 4.0, rate_hz: float = 60.0, *, step_m: float = 0.45, period_s: float = 1.1, slip_m: float = 0.0
) -> Motion:
    """A walk along −y. ``slip_m``: the whole figure drifts to and fro by so much, so that its feet slide."""
    body = figure()
    at = np.arange(round(seconds * rate_hz)) / rate_hz
    turns = np.tile(np.eye(3), (len(at), len(body), 1, 1))
    root = np.stack([0 * at, -step_m * 2.0 * at / period_s, 0.84 + 0.01 * np.cos(4 * np.pi * at / period_s)], axis=1)
    swing = np.sin(2 * np.pi * at / period_s)
    for side, sign, ahead in (("Left", 1.0, 0.0), ("Right", -1.0, 0.5)):
        foot = _foot(at / period_s + ahead, 2.0 * step_m, ahead)
        d = np.stack([foot[:, 0] - root[:, 1], foot[:, 1] - root[:, 2]], axis=1)
        r = np.linalg.norm(d, axis=1)
        lean = np.arctan2(d[:, 0], -d[:, 1])
        thigh = lean - np.arccos((THIGH**2 + r**2 - SHANK**2) / (2 * THIGH * r))
        knee = np.pi - np.arccos((THIGH**2 + SHANK**2 - r**2) / (2 * THIGH * SHANK))
        turns[:, body.index(f"{side}UpLeg")] = about_x(thigh)
        turns[:, body.index(f"{side}Leg")] = about_x(knee)
        turns[:, body.index(f"{side}Foot")] = about_x(-thigh - knee)
        turns[:, body.index(f"{side}Arm")] = about_x(-sign * 0.4 * swing)
        turns[:, body.index(f"{side}ForeArm")] = about_x(-0.3 + 0.1 * sign * swing)
    turns[:, body.index("Spine")] = about_x(0.05 * np.sin(4 * np.pi * at / period_s) + 0.08 * np.sin(at))
    root[:, 0] += slip_m * np.sin(2 * np.pi * at / 0.9)
    return Motion(body, root, turns, rate_hz, source="walk")


def _foot(phase: Array, stride: float, ahead: float) -> Array:
    """Where an ankle is (frames, 2: along −y, up): still for six tenths of a cycle, then swung to the next stance."""
    cycle, part = np.floor(phase), np.clip((phase - np.floor(phase) - 0.6) / 0.4, 0.0, 1.0)
    gone = part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
    along = -stride * (cycle - ahead + gone) - stride * 0.3
    return np.stack([along, ANKLE + 0.12 * np.sin(np.pi * part) ** 2], axis=1)


def with_limbs(skeleton: Skeleton, factor: float) -> Skeleton:
    """The figure with longer or shorter arms and legs."""
    limbs = [j for j, name in enumerate(skeleton.joints) if name.startswith(("Left", "Right"))]
    inner = [j for j in limbs if skeleton.parents[j] in limbs]
    offsets = skeleton.offsets_m.copy()
    offsets[inner] *= factor
    sites = tuple(
        replace(s, place_m=(s.place_m[0] * factor, s.place_m[1] * factor, s.place_m[2] * factor))
        if s.joint in limbs
        else s
        for s in skeleton.sites
    )
    return replace(skeleton, name=f"figure x {factor}", offsets_m=offsets, sites=sites)
