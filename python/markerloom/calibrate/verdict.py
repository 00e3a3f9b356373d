"""Whether a calibration may be used: every reason why not, with the camera and what to do."""

from __future__ import annotations

from typing import Any

import numpy as np

from markerloom.rig import Rig

FEWEST_VIEWS = 50
"""Views of the wand that a camera needs: fewer leave its lens to chance."""
LEAST_COVERAGE = 0.10
"""Part of the image (of a 12 x 12 grid, over the part any wand can be seen in) that the wand must have visited."""
LEAST_FITTING = 0.8
"""Part of a camera's whole views of the wand that must fit what the other cameras saw."""
TOO_FAST = 2.0
"""Residuals along the motion of fast dots over those across."""
WEAK = 0.005
"""A camera's place should be known to this part of its distance from the middle of the rig."""
STANDS_OUT = 5.0
LEAST_RESIDUAL_PX = 0.3
"""A camera's median residual stands out when it is so many times that of the others, and worth speaking of."""
FOLDED = "the lens model folds over where the wand was seen"


def refusals(rig: Rig, report: dict[str, Any], solved: dict[str, Any], reached_px: dict[str, np.ndarray]) -> list[str]:
    """Why this calibration is refused; empty if it is good. ``reached_px``: where each camera's dots lay (n, 2)."""
    reasons = [_unjoined(camera, report) for camera in report["unjoined"]]
    too_fast = _of_speed(report["speed"])
    if too_fast:
        return [*reasons, *too_fast]  # whatever else is wrong follows from it
    reasons += _standing_out(report)
    for camera in rig.cameras:
        if camera.id in report["unjoined"]:
            continue
        own = report["cameras"][camera.id]
        reasons += _of_camera(camera.id, own, report["markers"])
        if _folded(rig, rig.cameras.index(camera), reached_px[camera.id]):
            reasons.append(
                f"camera {camera.id}: {FOLDED}: its views do not determine the lens; wave into its corners too"
            )
    reasons += _weak(rig, report, solved)
    if not solved["converged"]:
        reasons.append("the adjustment did not settle: wave longer, over the whole volume, in all directions")
    reasons += _of_lengths(report)
    return reasons


def _unjoined(camera: str, report: dict[str, Any]) -> str:
    views = report["whole_views"][camera]
    if views == 0:
        return f"camera {camera} never sees the wand whole: wave in its view, or leave it out with --cameras"
    return (
        f"camera {camera} sees the wand in {views} frames, but too seldom together with the others, or of another "
        "shape: wave where it and two others see the wand, or leave it out with --cameras"
    )


def _standing_out(report: dict[str, Any]) -> list[str]:
    """Cameras whose residual is not of the others' kind."""
    median = {name: own["reprojection_px"]["median"] for name, own in report["cameras"].items()}
    typical = float(np.nanmedian(list(median.values()))) if median else 0.0
    return [
        f"camera {name}: residual {value:.2f} px, the others' {typical:.2f} px: it moved during the wave, or its "
        "intrinsics are not its own; fasten it and wave again"
        for name, value in median.items()
        if value > STANDS_OUT * typical and value > LEAST_RESIDUAL_PX
    ]


def _of_camera(camera: str, own: dict[str, Any], markers: int) -> list[str]:
    reasons = []
    if own["views"] < FEWEST_VIEWS:
        reasons.append(
            f"camera {camera} sees the wand in {own['views']} frames ({FEWEST_VIEWS} needed): wave longer in its view"
        )
    if own["coverage"] < LEAST_COVERAGE:
        reasons.append(
            f"camera {camera}: the wand visited {own['coverage']:.0%} of its image ({LEAST_COVERAGE:.0%} needed): "
            "wave from edge to edge of its view"
        )
    if own["used"] < LEAST_FITTING and markers > 1:  # a single dot may always be another's
        reasons.append(
            f"camera {camera}: only {own['used']:.0%} of its views of the wand fit the others: it moved during the "
            "wave, or its intrinsics are not its own; fasten it and wave again"
        )
    return reasons


def _weak(rig: Rig, report: dict[str, Any], solved: dict[str, Any]) -> list[str]:
    """Cameras whose places the wave tells only roughly."""
    if not solved["determined"]:
        return ["the views do not determine all cameras: some are weakly connected; wave where several see the wand"]
    middle = np.median(np.array([c.position_m for c in rig.cameras]), axis=0)
    reasons = []
    for camera in rig.cameras:
        sigma_mm = report["cameras"][camera.id]["position_sigma_mm"]
        distance_mm = 1000.0 * float(np.linalg.norm(camera.position_m - middle))
        if sigma_mm > WEAK * distance_mm:
            reasons.append(
                f"camera {camera.id} is weakly connected: its place is known to ± {sigma_mm:.0f} mm only; wave where "
                "it and others see the wand, far and near"
            )
    return reasons


def _folded(rig: Rig, index: int, reached_px: np.ndarray) -> bool:
    """Whether dots lie where the lens model has no ray, or would 5 % farther from the image's centre."""
    camera = rig.cameras[index]
    farther = np.array(camera.principal_px) + 1.05 * (reached_px - np.array(camera.principal_px))
    return not bool(np.isfinite(rig.normalise(index, farther)).all())


def _of_speed(speed: dict[str, float]) -> list[str]:
    if speed["along_px"] > TOO_FAST * speed["across_px"] and speed["along_px"] > LEAST_RESIDUAL_PX:
        return [
            f"the wand was waved too fast: its dots move by {speed['px_per_frame']:.0f} px per frame and are off by "
            f"{speed['along_px']:.2f} px along their motion, {speed['across_px']:.2f} px across: wave slower, expose "
            "shorter, or bring the cameras in step"
        ]
    return []


def _of_lengths(report: dict[str, Any]) -> list[str]:
    lengths = report["wand_length_mm"]
    if lengths["count"] == 0:
        return []
    if lengths["relative_spread"] > 0.02:
        return [
            f"the wand's lengths spread by {lengths['std']:.1f} mm on poses left out of the fit: "
            "wrong wand, or cameras that moved; check --wand, fasten the cameras and wave again"
        ]
    if lengths["worst_ratio"] > 0.01:
        return [
            f"distances on the wand differ from the stated ones by up to {lengths['worst_ratio']:.1%}: "
            "wrong wand; check --wand"
        ]
    return []
