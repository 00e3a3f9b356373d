"""Joint centres from markers by rule: lecture notes §6.5, and regressions for hips.

`midpoint`: half way between two markers on both sides of a joint. `beside`: from the middle marker of three (wrist,
elbow, shoulder) along the normal of their plane by a measured distance. `hips`: from the four markers of the pelvis
(Harrington et al. 2007, "Prediction of the hip joint centre in adults, children, and patients with cerebral palsy
based on magnetic resonance imaging", eqs of table 4: depth and width of the pelvis).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import InputError
from markerloom.skeleton.placing import Hints
from markerloom.skeleton.skeleton import Skeleton
from markerloom.subjects.marker_set import MarkerSet

Array = NDArray[np.floating[Any]]
MIDPOINT_SD_M, BESIDE_SD_M, HIP_SD_M = 0.012, 0.015, 0.015
"""How well the rules hit the joint (m, per axis)."""
ON_BOTH_SIDES = {
    "l_elbow": (("LELB", "LIEL"), ("LElbow", "LElbowIn")),
    "l_radiocarpal": (("LWRA", "LWRB"), ("LOWR", "LIWR"), ("LWristOut", "LWristIn")),
    "l_knee": (("LKNE", "LKNI"), ("LKnee", "LKneeIn")),
    "l_talocrural": (("LANK", "LANI"), ("LAnkle", "LAnkleIn")),
}
PELVIS: tuple[tuple[str, str, str, str], ...] = (("LASI", "RASI", "LPSI", "RPSI"), ("LFWT", "RFWT", "LBWT", "RBWT"))


def midpoint(a_m: Array, b_m: Array) -> Array:
    """Half way between two markers (…, 3)."""
    return 0.5 * (a_m + b_m)


def beside(before_m: Array, at_m: Array, after_m: Array, distance_m: float) -> Array:
    """From the marker ``at_m`` along the normal of the plane of three markers (…, 3): (after − at) × (before − at).

    The normal is undefined where the three are in a line: NaN there.
    """
    normal = np.cross(after_m - at_m, before_m - at_m)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(length > 1e-6, at_m + distance_m * normal / length, np.nan)


def hips(lasi_m: Array, rasi_m: Array, lpsi_m: Array, rpsi_m: Array) -> tuple[Array, Array]:
    """Left and right hip centres from the markers of the pelvis (…, 3): Harrington et al. 2007."""
    front, back = 0.5 * (lasi_m + rasi_m), 0.5 * (lpsi_m + rpsi_m)
    across = lasi_m - rasi_m
    width = np.linalg.norm(across, axis=-1, keepdims=True)
    left = across / width
    ahead = front - back
    ahead = ahead - left * (ahead * left).sum(axis=-1, keepdims=True)
    depth = np.linalg.norm(front - back, axis=-1, keepdims=True)
    ahead = ahead / np.linalg.norm(ahead, axis=-1, keepdims=True)
    up = np.cross(ahead, left)
    x = -0.24 * depth - 0.0099
    y = -0.30 * width - 0.0109
    z = 0.33 * width + 0.0073
    return front + x * ahead + y * up + z * left, front + x * ahead + y * up - z * left


Centers = dict[int, tuple[Array, float]]
"""For joints: centres in every frame (frames, 3; m, world), and how well they are known (m)."""


def rule_centers(skeleton: Skeleton, markers: list[str], known: Hints | MarkerSet | None, seen_m: Array) -> Centers:
    """Centres of the joints that a rule gives: what the hints say, or what the names of the markers allow."""
    out: Centers = {}

    def put(joint: int, center_m: Array, within_m: float) -> None:
        if np.isfinite(center_m).all(axis=1).any():
            out[joint] = (center_m, within_m)

    def marker(name: str) -> Array:
        return seen_m[:, markers.index(name)]

    if isinstance(known, Hints):
        for joint, rule in known.joints.items():
            put(*_said(skeleton, joint, rule, markers, seen_m, known.source))
        return out
    for left, choices in ON_BOTH_SIDES.items():
        for joint, swap in ((left, ""), ("r" + left[1:], "R")):
            pair = next(
                (p for p in (tuple(swap + n[1:] if swap else n for n in c) for c in choices) if set(p) <= set(markers)),
                None,
            )
            if pair is not None and skeleton.index(joint) > 0:
                put(skeleton.index(joint), midpoint(marker(pair[0]), marker(pair[1])), MIDPOINT_SD_M)
    four = next((names for names in PELVIS if set(names) <= set(markers)), None)
    if four is not None:
        for joint, center in zip(
            ("l_hip", "r_hip"), hips(marker(four[0]), marker(four[1]), marker(four[2]), marker(four[3])), strict=True
        ):
            if skeleton.index(joint) > 0:
                put(skeleton.index(joint), center, HIP_SD_M)
    return out


def _said(
    skeleton: Skeleton, joint: str, rule: dict[str, Any], markers: list[str], seen_m: Array, source: str
) -> tuple[int, Array, float]:
    """A rule that a person gave: ``{midpoint = [a, b]}`` or ``{beside = [before, at, after], distance_mm = d}``."""
    index = skeleton.index(joint)
    if index <= 0:
        raise InputError(f"{source}: skeleton '{skeleton.name}' has no joint '{joint}' with a bone")
    names = rule.get("midpoint") or rule.get("beside") or []
    absent = [n for n in names if n not in markers]
    if absent:
        raise InputError(f"{source}, joint '{joint}': there is no marker '{absent[0]}' on a segment")
    at = [seen_m[:, markers.index(n)] for n in names]
    if "midpoint" in rule and len(at) == 2:
        return index, midpoint(at[0], at[1]), MIDPOINT_SD_M
    if "beside" in rule and len(at) == 3 and isinstance(rule.get("distance_mm"), int | float):
        return index, beside(at[0], at[1], at[2], rule["distance_mm"] / 1000.0), BESIDE_SD_M
    raise InputError(
        f"{source}, joint '{joint}': a rule is {{ midpoint = [a, b] }} or "
        "{ beside = [before, at, after], distance_mm = d }"
    )
