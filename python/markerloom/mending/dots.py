"""Centroids that somebody excluded before reconstruction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import InputError
from markerloom.mending.edits import DotEdit, ExcludeCamera, ExcludeDot, Range
from markerloom.observations import Observations

NEAR_PX = 1.0
"""An excluded centroid is the nearest one within this of where it was."""


def without_excluded(observations: Observations, edits: list[DotEdit]) -> tuple[Observations, list[str]]:
    """The take without the centroids that are excluded, and edits that fit nothing, in words."""
    gone, unfit = np.zeros(len(observations), bool), []
    for number, edit in enumerate(edits, start=1):
        try:
            gone |= excluded(observations, edit)
        except InputError as error:
            unfit.append(f"exclusion {number} ({edit.op}) fits nothing: {error}")
    return left_out(observations, gone), unfit


def left_out(observations: Observations, gone: NDArray[np.bool_]) -> Observations:
    """The take without some rows; its frames stay."""
    kept = ~gone
    return replace(
        observations,
        frame=observations.frame[kept],
        camera=observations.camera[kept],
        pixel=observations.pixel[kept],
        optional={name: column[kept] for name, column in observations.optional.items()},
        frames=observations.frames,
    )


def excluded(observations: Observations, edit: DotEdit) -> NDArray[np.bool_]:
    """Rows that an edit leaves out; raises ``InputError`` where the take has no such camera or centroid."""
    if edit.camera not in observations.camera_ids:
        raise InputError(f"the take has no camera {edit.camera}; it has {', '.join(observations.camera_ids)}")
    own = observations.camera == observations.camera_ids.index(edit.camera)
    if isinstance(edit, ExcludeDot):
        rows = np.flatnonzero(own & (observations.frame == edit.frame))
        away = np.linalg.norm(observations.pixel[rows] - np.array(edit.pixel), axis=1)
        if len(rows) == 0 or not away.min() <= NEAR_PX:
            place = "({:.1f}, {:.1f})".format(*edit.pixel)
            raise InputError(f"camera {edit.camera} has no centroid at {place} px in frame {edit.frame}")
        found = np.zeros(len(observations), bool)
        found[rows[np.argmin(away)]] = True
        return found
    own &= _within(observations, edit.within)
    if isinstance(edit, ExcludeCamera):
        return own
    low, high = np.minimum(edit.low, edit.high), np.maximum(edit.low, edit.high)
    return own & np.asarray(((observations.pixel >= low) & (observations.pixel <= high)).all(axis=1))


def _within(observations: Observations, within: Range) -> NDArray[np.bool_]:
    return np.asarray((observations.frame >= within.first) & (observations.frame <= within.last))
