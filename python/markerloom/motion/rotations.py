"""Rotations as vectors that can be added and weighted: the exponential map about a pose (Grassia 1998).

About the mean pose of a clip the map is smooth as long as a joint turns by less than half a turn from it. A joint that
turns further (somebody who spins, or rolls) is told against its own path, smoothed as much as keeps it in reach.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from markerloom import _core
from markerloom.skeleton.motion import quaternions

Array = NDArray[np.floating[Any]]
REACH_RAD = 0.9 * np.pi
"""The vector of a larger turn may jump from one frame to the next."""
STEADY = 0.3
"""An average of quaternions shorter than this has no direction."""


def reference(turns: Array) -> Array:
    """The pose (1, 3, 3), or the path (frames, 3, 3), about which a joint's turns (frames, 3, 3) are told."""
    if not len(turns):
        return np.eye(3)[None]
    mean = Rotation.from_matrix(turns).mean().as_matrix()[None]
    if _angles(mean, turns).max() < REACH_RAD:
        return mean
    q = quaternions(turns)
    levels = np.cumsum(_core.split_bands(q, _core.band_count(len(q)))[::-1], axis=0)
    for smooth in levels:
        length = np.linalg.norm(smooth, axis=1)
        if length.min() > STEADY:
            path = Rotation.from_quat(smooth).as_matrix()
            if _angles(path, turns).max() < REACH_RAD:
                return path
    return turns


def _angles(about: Array, turns: Array) -> Array:
    trace = np.einsum("fab,fab->f", np.broadcast_to(about, turns.shape), turns)
    return np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))


def log(turns: Array) -> Array:
    """Rotation vectors (..., 3; rad) of rotations (..., 3, 3)."""
    return Rotation.from_matrix(turns.reshape(-1, 3, 3)).as_rotvec().reshape(turns.shape[:-1])


def unwrapped(vectors: Array) -> Array:
    """Rotation vectors (frames, ..., 3) of the same rotations that do not jump by whole turns from frame to frame."""
    out = vectors.copy()
    for f in range(1, len(out)):
        angle = np.linalg.norm(out[f], axis=-1, keepdims=True)
        axis = out[f] / np.maximum(angle, 1e-12)
        turns = np.round(((axis * out[f - 1]).sum(axis=-1, keepdims=True) - angle) / (2.0 * np.pi))
        out[f] = np.where(angle > 1e-9, axis * (angle + 2.0 * np.pi * turns), out[f])
    return out


def exp(vectors: Array) -> Array:
    """Rotations (..., 3, 3) of rotation vectors (..., 3; rad)."""
    return Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix().reshape(*vectors.shape, 3)


def about(where: Array, turns: Array) -> Array:
    """Vectors (frames, 3; rad) of turns against a pose or a path."""
    return log(np.swapaxes(where, -1, -2) @ turns)


def heading(turns: Array, lateral: Array) -> Array:
    """Where somebody faces (frames; rad about the vertical), by the direction of the left side of a segment's axes."""
    left = turns @ lateral
    return np.unwrap(np.arctan2(left[:, 1], left[:, 0]) - np.arctan2(lateral[1], lateral[0]))


def about_vertical(angles: Array | float) -> Array:
    """Turns (..., 3, 3) about the vertical (rad)."""
    out = np.zeros((*np.shape(angles), 3, 3))
    out[..., 0, 0] = out[..., 1, 1] = np.cos(angles)
    out[..., 1, 0] = np.sin(angles)
    out[..., 0, 1] = -out[..., 1, 0]
    out[..., 2, 2] = 1.0
    return out
