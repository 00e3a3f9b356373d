"""What the rig of a take is worth, and where its cameras would stand if they were adjusted to the take."""

from __future__ import annotations

import numpy as np

from markerloom.calibrate.refine import refine_rig
from markerloom.coverage import coverage
from markerloom.errors import InputError
from markerloom.studio import messages
from markerloom.studio.looking import camera_view
from markerloom.studio.opened import OpenTake
from markerloom.studio.seeing import dots_of

DEFAULT_NOISE_PX = 0.1


def accuracy_view(take: OpenTake) -> messages.AccuracyView:
    """The planner's map for this rig: the expected error in each cell of its volume, with the noise of this take."""
    if take.rig is None:
        raise InputError("the take has no calibration: what its rig is worth cannot be told")
    noise = float(np.median(dots_of(take).seen.noise_px)) if take.has_dots else DEFAULT_NOISE_PX
    found = take.remembered("accuracy", lambda: coverage(take.rig, sigma_px=noise))  # pyright: ignore[reportArgumentType]
    sigma = np.where(np.isfinite(found.sigma_mm), found.sigma_mm, -1.0)
    x, y, z = (axis.tolist() for axis in found.axes_m)
    return messages.AccuracyView(
        x_m=x,
        y_m=y,
        z_m=z,
        cameras=found.cameras.ravel().tolist(),
        sigma_mm=np.round(sigma, 4).ravel().tolist(),
        noise_px=noise,
        median_mm=float(found.report["sigma_mm_by_three"]["median"]),
    )


def refined_view(take: OpenTake) -> messages.RefinedView:
    """The rig before and after adjusting its cameras to the take (`calibrate refine`); nothing is written."""
    if take.rig is None:
        raise InputError("the take has no calibration to adjust")
    dots = dots_of(take).used
    refined, report = take.remembered("refined", lambda: refine_rig(take.rig, dots))  # pyright: ignore[reportArgumentType]
    return messages.RefinedView(
        verdict=report["verdict"],
        reasons=list(report.get("reasons", [])),
        before_px=report["residual_px_before"]["rms"],
        after_px=report["residual_px_after"]["rms"],
        cameras=[camera_view(c) for c in refined.cameras],
        moved_mm={str(k): float(v) for k, v in report["moved_mm"].items()},
        turned_deg={str(k): float(v) for k, v in report["turned_deg"].items()},
    )
