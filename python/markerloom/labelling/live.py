"""Names for a stream of frames, in bounded time and memory."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom import _core
from markerloom.errors import InputError
from markerloom.subjects.subject import Subject, model_of


class Labeller:
    """Names points frame by frame.

    A trajectory keeps its name while the evidence of its last half second allows; frames with many nameless points are
    searched without history, at most a few times a second. What ``Tracker.push`` returns goes in as it is.
    """

    def __init__(self, subjects: list[Subject]) -> None:
        """Look for the markers of these subjects."""
        if not subjects:
            raise InputError("a labeller needs a subject")
        several = len(subjects) > 1
        self.names = [f"{s.name}:{m}" if several else m for s in subjects for m in s.markers]
        self._engine = _core.Labeller(model_of(subjects))

    def push(
        self, tracks: NDArray[np.int64], xyz_mm: NDArray[np.floating[Any]], *, time_s: float
    ) -> tuple[list[str], NDArray[np.floating[Any]]]:
        """The name of every point ("" for none) and its probability; ``tracks`` (n,), ``xyz_mm`` (n, 3).

        ``time_s`` must not run backwards.
        """
        xyz_m = np.ascontiguousarray(np.asarray(xyz_mm, float).reshape(-1, 3) / 1000.0)
        if len(tracks) != len(xyz_m):
            raise InputError(f"{len(tracks)} trajectories do not go with {len(xyz_m)} points")
        marker, probability = self._engine.push(time_s, [int(t) for t in tracks], xyz_m)
        return ["" if m < 0 else self.names[m] for m in marker], np.array(probability)
