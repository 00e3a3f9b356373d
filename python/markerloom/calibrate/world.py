"""The world of a rig that nothing else defines: up as the cameras stand, the origin below the middle of the wave."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.rig import Camera

Array = NDArray[np.floating[Any]]


def moved(cameras: list[Camera], rotation: Array, origin_m: Array) -> list[Camera]:
    """The cameras in a new world: ``new = rotation @ (old − origin_m)``."""
    return [
        replace(c, rotation=c.rotation @ rotation.T, position_m=rotation @ (c.position_m - origin_m)) for c in cameras
    ]


def natural_world(cameras: list[Camera], wave_m: Array) -> tuple[Array, Array]:
    """Rotation and origin (in the old world) of a natural world: +Z up, origin at the lowest tenth of the wave.

    Up is the mean of the cameras' upward image directions, or its opposite where the cameras would hang below the wave
    (cameras mounted upside down): right to some degrees where cameras are not rolled. An object on the floor sets it
    exactly. +X points from the origin to the first camera.
    """
    up = np.mean([-c.rotation[1] for c in cameras], axis=0)
    up /= np.linalg.norm(up)
    middle = np.median(wave_m, axis=0)
    if np.mean([(c.position_m - middle) @ up for c in cameras]) < 0:
        up = -up
    height = (wave_m - middle) @ up
    origin = middle + up * np.percentile(height, 10)
    first = cameras[0].position_m - origin
    x = first - up * (first @ up)
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(up, x), up]), origin
