"""Active markers: LEDs whose blinking tells who they are. See ``crates/core/src/active`` for the code book."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom import _core
from markerloom.errors import InputError
from markerloom.observations import Observations

MARGIN = 1.02
"""The image is taken to be a little larger than where dots were seen in it."""


def led_codes() -> NDArray[np.bool_]:
    """The code book (identities, frames): whether an LED is bright in each frame of its period, which it repeats."""
    return np.array(_core.led_codes(), bool)


def leds(observations: Observations, *, frames_per_bit: int = 1) -> tuple[Observations, dict[str, Any]]:
    """Give each dot the identity that its brightness tells over time: the column ``id``, −1 where none is sure.

    Every camera is decoded for itself, from the column ``brightness`` (any unit). LEDs change at most once a frame, in
    time with the cameras; ``frames_per_bit`` for slower ones. When each started does not matter. The report has, by
    camera, ``dots`` and ``told``, and ``identities`` with the number of dots that told each.

    Raises ``InputError`` where there is no brightness.
    """
    brightness = observations.optional.get("brightness")
    if brightness is None or not np.isfinite(brightness).any():
        raise InputError(
            "there is no brightness of the dots (a column 'brightness'), by which LEDs could be told: detect writes it "
            f"({observations.source})"
        )
    if not 1 <= frames_per_bit <= 100:
        raise InputError(f"a bit that lasts {frames_per_bit} frames: state a number from 1 on")
    identity = np.full(len(observations), -1, np.int64)
    cameras: dict[str, dict[str, int]] = {}
    for index in np.unique(observations.camera):
        rows = np.flatnonzero(observations.camera == index)
        rows = rows[np.argsort(observations.frame[rows], kind="stable")]
        frames = np.arange(observations.frames[0], observations.frames[-1] + 2)
        starts = np.searchsorted(observations.frame[rows], frames)
        pixel = np.ascontiguousarray(observations.pixel[rows])
        width = MARGIN * float(np.nanmax(pixel[:, 0], initial=1.0))
        identity[rows] = _core.decode_leds(starts.tolist(), pixel, brightness[rows], width, frames_per_bit)
        told = int((identity[rows] >= 0).sum())
        cameras[observations.camera_ids[index]] = {"dots": len(rows), "told": told}
    identities, counts = np.unique(identity[identity >= 0], return_counts=True)
    report: dict[str, Any] = {
        "frames": len(observations.frames),
        "cameras": cameras,
        "identities": {str(i): int(n) for i, n in zip(identities, counts, strict=True)},
        "warnings": [] if len(identities) else ["no dot tells an identity: are the LEDs in time with the cameras?"],
    }
    return replace(observations, optional={**observations.optional, "id": identity.astype(float)}), report
