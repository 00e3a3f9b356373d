"""The world of a rig from named points, or from markers that lie on the floor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.calibrate.world import moved
from markerloom.errors import InputError
from markerloom.observations import Observations
from markerloom.points import Points
from markerloom.reconstruct import reconstruct
from markerloom.rig import Rig

Array = NDArray[np.floating[Any]]

LOOKED_AT = 50
"""Frames looked at, evenly spread."""
SAME_M = 0.01
"""Points of several frames within this distance are the same marker at rest."""
FLAT_M = 0.005
"""Markers on a floor lie this near to a plane (rms)."""
LEAST_EXTENT_M = 0.1
"""Points that span less in some direction do not tell how the floor is tilted."""


def origin_from_points(
    rig: Rig, points: Points, names: Sequence[str], *, height_m: float = 0.0
) -> tuple[Rig, dict[str, Any]]:
    """The rig in the world of three named points: the origin, one on +X, one on the side of +Y; all on the floor.

    ``points``: labelled points measured with this rig; a label's place is its median. ``height_m``: of the points above
    the floor. Returns the rig and a report (``points_mm``: their places in the new world).

    Raises ``InputError`` for a label that is not there, for points on a line, and where the cameras would stand below
    the floor: the last two points are then to be exchanged.
    """
    if len(names) != 3:
        raise InputError(f"three points are needed: origin, one on X, one beside; {len(names)} are named")
    origin, on_x, beside = (_median_of(points, name) for name in names)
    x = on_x - origin
    up = np.cross(x, beside - origin)
    if np.linalg.norm(x) < 1e-3 or np.linalg.norm(up) < 1e-3 * np.linalg.norm(x):
        raise InputError(f"{', '.join(names)} lie on a line: they fix no floor ({points.source})")
    rotation = _axes(x, up)
    placed, warnings = _placed(rig, rotation, origin - rotation[2] * height_m)
    places = 1000.0 * (np.array([origin, on_x, beside]) - origin + rotation[2] * height_m) @ rotation.T
    return placed, {"points_mm": dict(zip(names, places.tolist(), strict=True)), "warnings": warnings}


def origin_from_floor(rig: Rig, observations: Observations, *, height_m: float = 0.0) -> tuple[Rig, dict[str, Any]]:
    """The rig with z = 0 on the floor, from three or more markers that lie on it, anyhow; heading and origin are kept.

    ``height_m``: of the markers' centres above the floor. Returns the rig and a report: ``markers`` used, ``misfit_mm``
    (rms distance from the plane), ``tilt_deg`` by which the floor was turned, ``raised_mm``.

    Raises ``InputError`` for fewer than three markers at rest, for markers on a line, and for markers in no plane.
    """
    places = _at_rest(rig, observations)
    if len(places) < 3:
        raise InputError(
            f"{len(places)} markers lie still: three or more are needed, far apart on the floor ({observations.source})"
        )
    middle = places.mean(axis=0)
    _, extent, axes = np.linalg.svd(places - middle)
    extent = extent / np.sqrt(len(places))
    if extent[1] < LEAST_EXTENT_M:
        raise InputError(f"the markers lie on a line or too near to each other: spread them ({observations.source})")
    if extent[2] > FLAT_M:
        raise InputError(
            f"the markers lie in no plane ({1000 * extent[2]:.1f} mm rms): take away those that are not on the floor "
            f"({observations.source})"
        )
    up = axes[2] if np.mean([(c.position_m - middle) @ axes[2] for c in rig.cameras]) > 0 else -axes[2]
    rotation = _axes(np.array([1.0, 0.0, 0.0]), up)
    below = float(middle @ up) - height_m
    placed, warnings = _placed(rig, rotation, up * below)
    report = {
        "markers": len(places),
        "misfit_mm": float(1000.0 * extent[2]),
        "tilt_deg": float(np.degrees(np.arccos(np.clip(up[2], -1.0, 1.0)))),
        "raised_mm": -1000.0 * below,
        "warnings": warnings,
    }
    return placed, report


def _median_of(points: Points, name: str) -> Array:
    rows = points.label == name
    if not rows.any():
        known = ", ".join(sorted(set(points.label.tolist()) - {""})[:12]) or "none"
        raise InputError(f"no point is labelled '{name}'; labels are {known} ({points.source})")
    return np.median(points.xyz_mm[rows], axis=0) / 1000.0


def _axes(x: Array, up: Array) -> Array:
    """Rows: X as near to ``x`` as it may be at right angles to up, Y, and Z = up."""
    z = up / np.linalg.norm(up)
    x = x - z * (x @ z)
    if np.linalg.norm(x) < 1e-6:
        x = np.cross([0.0, 1.0, 0.0], z)
    x = x / np.linalg.norm(x)
    return np.array([x, np.cross(z, x), z])


def _placed(rig: Rig, rotation: Array, origin_m: Array) -> tuple[Rig, list[str]]:
    cameras = moved(list(rig.cameras), rotation, origin_m)
    below = [c.id for c in cameras if c.position_m[2] < 0]
    if 2 * len(below) > len(cameras):
        raise InputError(f"cameras {', '.join(below)} would stand below the floor: exchange the last two points")
    warnings = [f"cameras below the floor: {', '.join(below)}"] if below else []
    return Rig(tuple(cameras), rig.source, rig.warnings), warnings


def _at_rest(rig: Rig, observations: Observations) -> Array:
    """Markers (n, 3) that are at the same place in half of the frames looked at or more."""
    frames = observations.frames[:: max(1, len(observations.frames) // LOOKED_AT)]
    points = reconstruct(observations._keep(np.isin(observations.frame, frames)), rig)
    found: list[list[Array]] = []
    for place in points.xyz_mm / 1000.0:
        near = [own for own in found if np.linalg.norm(np.mean(own, axis=0) - place) < SAME_M]
        if near:
            near[0].append(place)
        else:
            found.append([place])
    return np.array([np.median(own, axis=0) for own in found if 2 * len(own) >= len(frames)]).reshape(-1, 3)
