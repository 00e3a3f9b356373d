"""A clock from the markers' own motion: see ``crates/core/src/sync``."""

from __future__ import annotations

from typing import Any

import numpy as np

from markerloom import _core
from markerloom.errors import InputError
from markerloom.observations import DotArrays, Observations, match
from markerloom.rig import Rig

JUMP_FRAMES = 0.3
"""A part of a recording that alone would lie this far from the whole has lost or doubled a frame."""


def clock_from_motion(first: Observations, second: Observations, rig: Rig) -> dict[str, Any]:
    """Offset (s), drift (ppm) and standard deviations of the second recording's clock against the first's."""
    rates = float(first.rate_hz or 0.0), float(second.rate_hz or 0.0)
    arrays = _arrays(first, rig), _arrays(second, rig)
    starts = [int(take.frames[0]) for take in (first, second)]
    try:
        found = _core.synchronise(rig.core, *arrays, rates[1] / rates[0])
    except InputError as error:
        raise InputError(f"{error} ({first.source}; {second.source})") from None
    # Frame shift + k · stretch · rate of the second is frame k of the first, both counted from their first frames.
    rate = found["stretch"] * rates[1] / rates[0]
    offset_frames = starts[0] - (starts[1] + found["shift"]) / rate
    details: dict[str, Any] = {"noise_px": found["noise_px"], "matches": found["matches"]}
    jumps = [
        (int(frame) + starts[0], shift)
        for frame, shift, weight in found["parts"]
        if abs(shift) > JUMP_FRAMES and abs(shift) * np.sqrt(weight) > 10.0
    ]
    if jumps:
        frame, shift = jumps[0]
        details["warnings"] = [
            f"{second.source}: around frame {frame} of {first.source} its frames lie {shift:+.1f} frames from an even "
            "clock: frames were lost or doubled there"
        ]
    return {
        "offset_s": offset_frames / rates[0],
        "drift_ppm": 1e6 * (1.0 / found["stretch"] - 1.0),
        "sigma_s": found["middle_sigma"] / rates[1],
        "drift_sigma_ppm": 1e6 * found["stretch_sigma"],
        "details": details,
    }


def _arrays(take: Observations, rig: Rig) -> DotArrays:
    dots = match(take, rig)
    return DotArrays(dots.starts, dots.camera, dots.pixel, dots.sigma)
