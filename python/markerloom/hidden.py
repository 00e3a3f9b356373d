"""The seed paper's places of a hidden marker (Lee et al. 2000, §5.2, figures 8 and 9), for comparison.

The tracker itself does better: it also uses how the marker lies in the frame of its neighbours, and its motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from markerloom import _core
from markerloom.errors import InputError

Array = NDArray[np.floating[Any]]


def place_on_spheres(neighbours_mm: ArrayLike, distances_mm: Sequence[float], predicted_mm: ArrayLike) -> Array:
    """Place (3,) in mm of a hidden marker by its distances to one visible marker or two.

    ``neighbours_mm``: (1, 3) or (2, 3). Of the points at these distances, the one nearest to ``predicted_mm``; where
    two spheres do not meet (distances change a little all the time), the point between them on their axis. Raises
    ``InputError`` for another number of neighbours or for what is not finite.
    """
    centers = np.asarray(neighbours_mm, float).reshape(-1, 3)
    predicted = np.asarray(predicted_mm, float).reshape(3)
    radii = np.asarray(distances_mm, float).ravel()
    if len(centers) not in (1, 2) or len(radii) != len(centers):
        raise InputError(f"one neighbour or two are needed, each with a distance; got {len(centers)} and {len(radii)}")
    if not all(np.isfinite(v).all() for v in (centers, predicted, radii)):
        raise InputError("neighbours, distances and prediction must be finite")
    spheres = [(c.tolist(), float(r)) for c, r in zip(centers, radii, strict=True)]
    second = spheres[1] if len(spheres) == 2 else None
    return np.array(_core.on_spheres(spheres[0], predicted.tolist(), second))
