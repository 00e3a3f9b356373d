"""Joint centres and hinge axes from the motion of two segments' markers against each other.

`score`: the symmetrical centre of rotation of two segments with at least three markers each (Ehrig et al. 2006, "A
survey of formal methods for determining the centre of rotation of ball joints", eq 14). `sara`: their axis (Ehrig et
al. 2007, "A survey of formal methods for determining functional joint axes"). `sphere`: the centre about which single
markers move as seen from a segment (Gamage & Lasenby 2002, linear form).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Rigid:
    """A segment's motion by its markers: ``turn`` (frames, 3, 3), ``place_m`` (frames, 3), NaN where fewer than three
    markers were there; ``shape_m`` (markers, 3): the markers in its own axes.
    """

    turn: Array
    place_m: Array
    shape_m: Array


def rigid(seen_m: Array) -> Rigid:
    """A segment from its markers (frames, markers ≥ 3, 3; NaN where absent): their mean shape in every frame."""
    there = np.asarray(np.isfinite(seen_m).all(axis=2))
    shape = seen_m[int(np.argmax(there.sum(axis=1)))]
    shape = np.where(np.isfinite(shape), shape, 0.0) - np.nanmean(shape, axis=0)
    for _ in range(4):
        turn, place = _laid(shape, seen_m, there)
        local = np.einsum("fba,fmb->fma", turn, seen_m - place[:, None])
        shape = np.nanmean(local, axis=0)
    turn, place = _laid(shape, seen_m, there)
    return Rigid(turn, place, shape)


def _laid(shape: Array, seen_m: Array, there: NDArray[np.bool_]) -> tuple[Array, Array]:
    """The shape's best turn and place in every frame (Kabsch 1976)."""
    weight = there[..., None].astype(float)
    count = weight.sum(axis=1)
    filled = np.where(there[..., None], seen_m, 0.0)
    enough = count[:, 0] >= 3
    count = np.maximum(count, 1.0)
    here = (weight * shape).sum(axis=1) / count
    at = filled.sum(axis=1) / count
    spread = np.einsum("fma,fmb->fab", weight * (filled - at[:, None]), shape - here[:, None])
    u, _, vt = np.linalg.svd(spread)
    sign = np.ones((len(u), 3))
    sign[:, 2] = np.sign(np.linalg.det(u @ vt))
    turn = (u * sign[:, None, :]) @ vt
    turn[~enough] = np.nan
    return turn, at - np.einsum("fab,fb->fa", turn, here)


def score(
    one: Rigid, two: Rigid, *, noise_m: float = 0.0, guess_m: Array | None = None, guess_sd_m: float = 1.0
) -> Array:
    """The centre in both segments' axes (2, 3): where it moves least, from one to the other.

    ``guess_m`` (frames, 3), where it is expected in the world, holds it where the motion does not show it: along the
    axis of a hinge, or where nothing turned. Without a guess the least-squares solution of smallest norm is given.
    """
    whole = np.isfinite(one.turn).all(axis=(1, 2)) & np.isfinite(two.turn).all(axis=(1, 2))
    rows = np.concatenate([one.turn[whole], -two.turn[whole]], axis=2).reshape(-1, 6)
    right = (two.place_m[whole] - one.place_m[whole]).reshape(-1)
    if guess_m is not None:
        weight = noise_m / guess_sd_m
        rows = np.concatenate([rows, weight * np.eye(6)])
        right = np.concatenate([right, weight * np.concatenate([_local(one, guess_m), _local(two, guess_m)])])
    return np.linalg.lstsq(rows, right, rcond=None)[0].reshape(2, 3)


def sara(one: Rigid, two: Rigid) -> tuple[Array, float]:
    """Axis of a hinge: direction in both segments' axes (2, 3), and how much less the centre is known along it than
    across (ratio of the two smallest singular values; near 0 for a hinge, near 1 for a ball joint).
    """
    whole = np.isfinite(one.turn).all(axis=(1, 2)) & np.isfinite(two.turn).all(axis=(1, 2))
    rows = np.concatenate([one.turn[whole], -two.turn[whole]], axis=2).reshape(-1, 6)
    _, values, vt = np.linalg.svd(rows, full_matrices=False)
    axis = vt[-1].reshape(2, 3)
    return axis / np.linalg.norm(axis, axis=1, keepdims=True), float(values[-1] / values[-2])


def sphere(
    of: Rigid, seen_m: Array, *, noise_m: float = 0.0, guess_m: Array | None = None, guess_sd_m: float = 1.0
) -> Array:
    """The centre, in a segment's axes (3), from which markers (frames, markers, 3) keep their distances."""
    local = np.einsum("fba,fmb->fma", of.turn, seen_m - of.place_m[:, None])
    middle = np.nanmean(local, axis=(0, 1))
    rows, right = [], []
    for m in range(local.shape[1]):
        x = local[:, m] - middle
        x = x[np.isfinite(x).all(axis=1)]
        if len(x) < 4:
            continue
        # |x − c| = r: the difference of two squares is linear in c once the marker's mean is taken off.
        square = (x**2).sum(axis=1)
        radius = 2.0 * np.sqrt(square.mean()) + 1e-9
        rows.append(2.0 * (x - x.mean(axis=0)) / radius)
        right.append((square - square.mean()) / radius)
    if guess_m is not None:
        weight = noise_m / guess_sd_m
        rows.append(weight * np.eye(3))
        right.append(weight * (_local(of, guess_m) - middle))
    return middle + np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0]


def _local(of: Rigid, world_m: Array) -> Array:
    local = np.einsum("fba,fb->fa", of.turn, world_m - of.place_m)
    return np.median(local[np.isfinite(local).all(axis=1)], axis=0)
