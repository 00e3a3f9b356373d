"""A skeleton solved live: one frame of markers in, one pose out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from markerloom import _core
from markerloom.skeleton.fitting import Wearer
from markerloom.skeleton.motion import Motion, turns_of


class SkeletonFollower:
    """Follows a fitted skeleton frame by frame: each pose from its own markers and the frames before. Where markers
    are gone, motion goes on and dies away; where they come back, the pose follows them at once.
    """

    def __init__(self, wearer: Wearer, rate_hz: float) -> None:
        """A follower that has seen nothing yet."""
        self.wearer, self.rate_hz = wearer, rate_hz
        self._follower = _core.Follower(wearer.figure(), 1.0 / rate_hz)
        self._column = {name: i for i, name in enumerate(wearer.markers)}
        self._frame = 0

    def push(self, markers_mm: Mapping[str, Sequence[float]], frame: int | None = None) -> Motion | None:
        """The pose of the next frame from markers by name (mm, world), as a motion of one frame; ``None`` before three
        markers were seen. Markers that the skeleton does not wear are not used.
        """
        number = self._frame if frame is None else frame
        self._frame = number + 1
        xyz_m = np.full((len(self._column), 3), np.nan)
        for name, place in markers_mm.items():
            if name in self._column:
                xyz_m[self._column[name]] = np.asarray(place, float) / 1000.0
        poses = self._follower.push(xyz_m)
        if poses is None:
            return None
        return Motion(
            self.wearer.skeleton, poses[0], turns_of(self.wearer.skeleton, poses), self.rate_hz, first_frame=number
        )
