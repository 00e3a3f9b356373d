"""SMPTE time codes (ST 12-1): HH:MM:SS:FF, with ; or . before the frames where numbers are dropped (29.97 Hz)."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from markerloom.errors import InputError

PATTERN = re.compile(r"(\d{1,2}):(\d{2}):(\d{2})([:;.])(\d{2,3})")
RATES = (24, 25, 30, 48, 50, 60, 100, 120, 240)


def seconds(codes: Sequence[str], *, rate: float | None = None) -> np.ndarray:
    """Time (s) since midnight at which each code begins; NaN for an empty one.

    ``rate``: codes per second, by default the slowest usual one above the largest frame number that occurs. With
    dropped numbers a code lasts 1.001 of its share, and numbers 0 and 1 (0 to 3 at 60) are left out in every minute
    but the tenth. Raises ``InputError`` for what is no time code.
    """
    found = [PATTERN.fullmatch(code.strip()) for code in codes]
    for code, match in zip(codes, found, strict=True):
        if match is None and code.strip():
            raise InputError(f"'{code}' is no time code: HH:MM:SS:FF is expected")
    parts = np.array([[int(m[k]) for k in (1, 2, 3, 5)] if m else [0, 0, 0, 0] for m in found], float).reshape(-1, 4)
    if rate is None:
        largest = parts[:, 3].max(initial=0.0)
        rate = next((r for r in RATES if r > largest), None)
        if rate is None:
            raise InputError(f"a time code has the frame number {largest:.0f}: state its rate")
    nominal = round(rate)
    hours, minutes, whole, frames = parts.T
    number = (3600.0 * hours + 60.0 * minutes + whole) * nominal + frames
    dropped = np.array([m is not None and m[4] != ":" for m in found], bool)
    minute = 60.0 * hours + minutes
    skipped = (nominal // 30 * 2) * (minute - minute // 10)
    time_s = np.where(dropped, (number - skipped) * 1.001 / nominal, number / nominal)
    return np.where([m is not None for m in found], time_s, np.nan)
