"""A take as one column per trajectory: frames × trajectories, for what works along time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.points import KINDS, Points

Array = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]
ABSENT = -1
FILLED = KINDS.index("filled")


@dataclass(frozen=True)
class Trajectories:
    """A take, dense: ``xyz_mm`` (frames, trajectories, 3) NaN where absent, ``sigma_mm`` and ``kind`` (frames,
    trajectories), −1 where absent, ``row``: the row of ``points`` a sample came from, −1 where it is new.

    Frames that the take skips are there too, empty, so that the columns have one step of time.
    """

    points: Points
    names: list[str]
    tracks: Ints
    frames: Ints
    xyz_mm: Array
    sigma_mm: Array
    kind: Ints
    row: Ints

    @staticmethod
    def of(points: Points) -> Trajectories:
        """The trajectories of a take."""
        names, slot = points.slots()
        first = int(points.frames[0]) if len(points.frames) else 0
        last = int(points.frames[-1]) if len(points.frames) else -1
        frames = np.arange(first, last + 1)
        shape = (len(frames), len(names))
        at = (points.frame - first, slot)
        xyz_mm = np.full((*shape, 3), np.nan)
        sigma_mm, kind, row = np.full(shape, np.nan), np.full(shape, ABSENT), np.full(shape, -1)
        xyz_mm[at], sigma_mm[at], kind[at] = points.xyz_mm, points.sigma_mm, points.kind
        row[at] = np.arange(len(points))
        return Trajectories(points, names, np.unique(points.track), frames, xyz_mm, sigma_mm, kind, row)

    @property
    def present(self) -> NDArray[np.bool_]:
        """Where there is a sample."""
        return self.kind != ABSENT

    def changed(self, xyz_mm: Array, sigma_mm: Array, kind: Ints) -> Trajectories:
        """The same take with other samples."""
        return replace(self, xyz_mm=xyz_mm, sigma_mm=sigma_mm, kind=kind)

    def as_points(self) -> Points:
        """The take as points: new samples know no rays; those that were there keep theirs."""
        frame, slot = np.nonzero(self.kind != ABSENT)
        row = self.row[frame, slot]
        old = row >= 0
        source = np.where(old, row, 0)
        label = np.array([_label(name) for name in self.names] or [""], dtype=str)
        nothing = len(self.points) == 0

        def known(column: NDArray[Any], otherwise: float) -> NDArray[Any]:
            return column if nothing else np.where(old, column[source], otherwise)

        points = self.points
        return replace(
            points,
            frame=self.frames[frame],
            track=self.tracks[slot],
            label=label[slot],
            xyz_mm=self.xyz_mm[frame, slot],
            sigma_mm=self.sigma_mm[frame, slot],
            kind=self.kind[frame, slot],
            rays=known(points.rays, 0).astype(np.int64),
            residual_px=known(points.residual_px, np.nan),
            confidence=known(points.confidence, np.nan),
            residual_mm=known(points.residual_mm, np.nan),
            camera_mask=known(points.camera_mask, 0).astype(np.int64),
            label_probability=known(points.label_probability, np.nan),
            frames=self.frames,
        )


def _label(name: str) -> str:
    return "" if name.startswith("*") else name
