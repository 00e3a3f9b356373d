"""Single points from pixels or rays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from markerloom import _core
from markerloom.errors import InputError
from markerloom.rig import Rig


@dataclass(frozen=True)
class Triangulated:
    """A point (m, world) with its covariance (m²), squared whitened error and the camera left out, if any."""

    point_m: np.ndarray
    covariance_m2: np.ndarray
    rss: float
    left_out: str | None

    @property
    def sigma_mm(self) -> float:
        """√trace of the covariance in millimetres."""
        return float(1000.0 * np.sqrt(np.trace(self.covariance_m2)))


def triangulate(rig: Rig, pixels: Mapping[str, Sequence[float]], *, sigma_px: float = 1.0) -> Triangulated:
    """The point that best explains one pixel per camera (by id).

    Raises ``NoPointError(reason, text)`` with the reason ``too_few_rays``, ``parallel``, ``behind_camera`` or
    ``outlier``. With four views or more, one that disagrees with all others is left out.
    """
    unknown = [i for i in pixels if i not in rig.ids]
    if unknown:
        raise InputError(f"the rig has no camera {unknown[0]}; it has {', '.join(rig.ids)}")
    cameras = [rig.ids.index(i) for i in pixels]
    found = _core.triangulate(rig.core, cameras, [tuple(map(float, p)) for p in pixels.values()], sigma_px)
    left_out = found["left_out"]
    return Triangulated(
        point_m=np.array(found["point_m"]),
        covariance_m2=np.array(found["covariance_m2"]),
        rss=found["rss"],
        left_out=None if left_out is None else list(pixels)[left_out],
    )


def two_rays(origins_m: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, float]:
    """Halfway point (m) and gap (m) of two rays (2, 3): the lecture notes' §6.4 and their test of correspondence."""
    point, gap_m = _core.two_rays(np.asarray(origins_m, float).tolist(), np.asarray(directions, float).tolist())
    return np.array(point), gap_m
