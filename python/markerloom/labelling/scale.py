"""Units of a take beside the size of a subject: asked, not guessed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from markerloom.errors import InputError
from markerloom.points import Points

TO_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}
SIZES_M = (0.03, 3.0)
"""Sizes that a marked body or thing may have where no subject is known (m)."""
ALIKE = 2.5
"""Largest factor between a take's extent and a subject's size, within one unit: poses change the extent."""


def scaled(points: Points, units: str | None, size_m: float | None) -> Points:
    """The take in millimetres; refuses one that looks as if it were in another unit, unless ``units`` say which.

    ``size_m``: largest distance between markers of the subjects, where it is known.
    """
    if units is not None:
        if units not in TO_MM:
            raise InputError(f"units '{units}': {', '.join(TO_MM)}")
        factor = TO_MM[units]
        return (
            points
            if factor == 1.0
            else replace(points, xyz_mm=points.xyz_mm * factor, sigma_mm=points.sigma_mm * factor)
        )
    extent_m = _extent_m(points)
    low, high = SIZES_M if size_m is None else (size_m / ALIKE, size_m * ALIKE)
    if extent_m is None or extent_m >= low:
        return points
    fits = [u for u, f in TO_MM.items() if low <= extent_m * f <= high]
    if fits:
        raise InputError(
            f"the take is {1000 * extent_m:.3g} mm large, markers should be some {1000 * high / ALIKE:.0f} mm apart:"
            f" if its numbers are in {fits[0]}, say --units {fits[0]}; if not, --units mm ({points.source})"
        )
    return points


def _extent_m(points: Points) -> float | None:
    """The usual extent of a frame (m): between the 5th and 95th percentiles, so that few phantoms do not count."""
    sizes = []
    for frame in points.frames[:: max(1, len(points.frames) // 30)]:
        xyz_mm = points.xyz_mm[points.frame == frame]
        if len(xyz_mm) >= 3:
            low, high = np.percentile(xyz_mm, [5, 95], axis=0)
            sizes.append(float(np.linalg.norm(high - low)))
    return float(np.median(sizes)) / 1000.0 if sizes else None
