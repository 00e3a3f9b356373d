"""A rig refined while dots stream in: frames spread over all of the stream are kept, and memory does not grow."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from markerloom.calibrate.refine import refine_rig
from markerloom.errors import InputError
from markerloom.observations import Observations
from markerloom.rig import Rig

MOST_FRAMES = 400
"""Frames kept; beyond, every second one goes and only every second is taken in from then on."""


class RigStream:
    """Refines a rig from a stream, as ``refine_rig`` does from a take: camera poses; lenses, scale and origin stay.

    ``push`` takes each frame's dots and costs nothing; ``refined`` may be called now and then, as often as wanted. What
    it gives depends on the frames so far and on nothing else.
    """

    def __init__(self, rig: Rig) -> None:
        """Refine this rig."""
        self._rig = rig
        self._step = 1
        self._count = 0
        self._kept: list[tuple[int, dict[str, np.ndarray]]] = []

    def push(self, dots: Mapping[str, ArrayLike]) -> None:
        """Take in a frame: for each camera that has dots, (n, 2) pixels. ``InputError`` for a camera the rig lacks."""
        number, self._count = self._count, self._count + 1
        if number % self._step:
            return
        own = {}
        for camera, values in dots.items():
            if camera not in self._rig.ids:
                raise InputError(f"camera '{camera}' is not in the calibration ({', '.join(self._rig.ids)})")
            table = np.asarray(values, float)
            if table.size and (table.ndim != 2 or table.shape[1] < 2):
                raise InputError(f"dots of camera '{camera}' have the shape {table.shape}: (n, 2) is needed")
            own[camera] = table.reshape(-1, table.shape[1] if table.size else 2)
        self._kept.append((number, own))
        if len(self._kept) > MOST_FRAMES:
            self._kept, self._step = self._kept[::2], 2 * self._step

    def refined(self) -> tuple[Rig, dict[str, Any]]:
        """The rig adjusted to the stream so far, and the report of ``refine_rig``, which raises what is wrong."""
        frame, camera, pixel = [], [], []
        for number, own in self._kept:
            for name, values in own.items():
                frame.append(np.full(len(values), number))
                camera.append(np.full(len(values), self._rig.ids.index(name)))
                pixel.append(values[:, :2])
        if not frame:
            raise InputError("nothing was pushed yet: there is nothing to refine the rig by")
        kept = Observations(
            np.concatenate(frame).astype(np.int64),
            np.concatenate(camera).astype(np.int64),
            tuple(self._rig.ids),
            np.concatenate(pixel),
            source="stream",
        )
        return refine_rig(self._rig, kept)
