"""The world of a rig that nothing else defines: up as the cameras stand, the origin below the middle of the wave."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.rig import Camera, Rig

Array = NDArray[np.floating[Any]]


LEAST_SPREAD_M = 0.1
"""Camera centres this near to a line do not tell how a rig is turned."""


def moved(cameras: list[Camera], rotation: Array, origin_m: Array) -> list[Camera]:
    """The cameras in a new world: ``new = rotation @ (old − origin_m)``."""
    return [
        replace(c, rotation=c.rotation @ rotation.T, position_m=rotation @ (c.position_m - origin_m)) for c in cameras
    ]


def old_world(cameras: list[Camera], old: Rig) -> tuple[Array, Array]:
    """Rotation and origin (in the cameras' world) that lay camera centres on those of an old calibration."""
    pairs = [(c.position_m, o.position_m) for c in cameras if (o := old.find(c.id)) is not None]
    now, before = (np.array(side) for side in zip(*pairs, strict=True))
    if np.linalg.svd(before - before.mean(axis=0))[1][1] < LEAST_SPREAD_M:
        pairs = [(c.rotation, o.rotation) for c in cameras if (o := old.find(c.id)) is not None]
        rotation = mean_rotation(np.array([b.T @ a for a, b in pairs]))
    else:
        rotation = rigid(now, before)[0]
    return rotation, now.mean(axis=0) - rotation.T @ before.mean(axis=0)


def rigid(own: Array, world: Array) -> tuple[Array, Array]:
    """Rotation and shift that lay ``own`` on ``world`` by least squares (Kabsch 1976); never a mirror image."""
    a, b = own - own.mean(axis=0), world - world.mean(axis=0)
    u, _, vt = np.linalg.svd(b.T @ a)
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return turn, world.mean(axis=0) - turn @ own.mean(axis=0)


def mean_rotation(turns: Array) -> Array:
    """The rotation nearest to the mean of rotations (n, 3, 3)."""
    u, _, vt = np.linalg.svd(turns.sum(axis=0))
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt


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
