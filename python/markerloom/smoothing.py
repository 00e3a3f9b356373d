"""Trajectories smoothed: outliers thrown away, then one of the filters that biomechanists know by name.

Every run of samples without a gap is smoothed by itself; gaps stay gaps. Kinds stay what they were, since smoothing is
not editing; outliers that are thrown away leave a gap.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_smoothing_spline
from scipy.signal import butter, sosfiltfilt

from markerloom.errors import InputError
from markerloom.points import Points
from markerloom.trajectories import ABSENT, Trajectories

Array = NDArray[np.floating[Any]]

METHODS = ("butterworth", "average", "gcv", "kalman", "none")
CUTOFF_HZ = 6.0
HAMPEL_S = 0.1
HAMPEL_SIGMAS = 4.0
LEAST_NOISE_MM = 0.3
AVERAGE_S = 0.015
SHORTEST = 9
"""Runs of fewer samples are too short for a filter, and stay as they are."""
THIRD_DIFFERENCE = 20.0
"""White noise has so many times its variance in third differences."""
LONGEST_SPLINE = 2000
OVERLAP = 100


@dataclass(frozen=True)
class Smoothed(Points):
    """A take after smoothing. ``report``: outliers, the change made, and how."""

    report: dict[str, Any] = field(default_factory=dict)


def smooth(
    points: Points,
    *,
    method: str = "butterworth",
    cutoff_hz: float = CUTOFF_HZ,
    order: int = 4,
    window_s: float = AVERAGE_S,
    outliers: bool = True,
    rate_hz: float | None = None,
) -> Smoothed:
    """Smooth the trajectories of a take.

    ``outliers``: samples that stand out from the median of their neighbours (Hampel 1974) are thrown away first.
    ``method``: ``butterworth`` (zero lag, of ``order`` over both passes, −3 dB at ``cutoff_hz`` in the result; Winter
    2009), ``average`` (neighbours weighted by a Gaussian of ``window_s``), ``gcv`` (spline whose strength is found by
    generalised cross-validation; Woltring 1986), ``kalman`` (Rauch–Tung–Striebel over constant velocity, noise from the
    take), ``none`` (outliers only). Raises ``InputError`` for cut-offs at or above half the frame rate.
    """
    rate = points.rate_hz if rate_hz is None else rate_hz
    if rate is None or not 0 < rate < 1e6:
        raise InputError(f"smoothing needs the frame rate: state it with --rate-hz ({points.source})")
    if method not in METHODS:
        raise InputError(f"method '{method}': {', '.join(METHODS)}")
    if method == "butterworth" and not 0 < cutoff_hz < rate / 2:
        raise InputError(f"a cut-off of {cutoff_hz:g} Hz is not below half the frame rate ({rate / 2:g} Hz)")
    if method == "butterworth" and (order < 2 or order % 2):
        raise InputError(f"order {order}: an even number from 2, half of it in each direction")
    points = replace(points, rate_hz=rate)
    take = Trajectories.of(points)
    filters: dict[str, Callable[[Array], Array]] = {
        "butterworth": lambda run: _butterworth(run, cutoff_hz, order, rate),
        "average": lambda run: _average(run, window_s * rate),
        "gcv": _gcv,
        "kalman": lambda run: _kalman(run, rate),
        "none": lambda run: run,
    }
    xyz_mm, kind = take.xyz_mm.copy(), take.kind.copy()
    thrown = 0
    for slot in range(len(take.names)):
        if outliers:
            wrong = _outliers(xyz_mm[:, slot], rate)
            xyz_mm[wrong, slot], kind[wrong, slot] = np.nan, ABSENT
            thrown += int(wrong.sum())
        for first, last in _runs(kind[:, slot] != ABSENT):
            if last - first >= SHORTEST:
                xyz_mm[first:last, slot] = filters[method](xyz_mm[first:last, slot])
    change = np.linalg.norm(xyz_mm - take.xyz_mm, axis=2)
    report = {
        "frames": len(take.frames),
        "warnings": [],
        "method": method,
        "outliers": thrown,
        "change_mm": {
            "rms": float(np.sqrt(np.nanmean(change**2))) if np.isfinite(change).any() else 0.0,
            "largest": float(np.nanmax(change)) if np.isfinite(change).any() else 0.0,
        },
    }
    smoothed = take.changed(xyz_mm, take.sigma_mm, kind).as_points()
    return Smoothed(**{n: getattr(smoothed, n) for n in Points.__dataclass_fields__}, report=report)


def _runs(seen: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and one past the last frame of every run."""
    edges = np.flatnonzero(np.diff(np.r_[False, seen, False].astype(int)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _outliers(path: Array, rate_hz: float) -> NDArray[np.bool_]:
    """Samples farther from the median of their surroundings than those are from it (Hampel identifier).

    The motion is taken off first, as the mean of the two neighbours of each sample, so that fast motion is no outlier.
    """
    wrong = np.zeros(len(path), bool)
    half = max(2, round(HAMPEL_S * rate_hz))
    inner = path[1:-1] - 0.5 * (path[:-2] + path[2:])
    size = np.linalg.norm(inner, axis=1)
    seen = np.flatnonzero(np.isfinite(size))
    if len(seen) < 2 * half + 1:
        return wrong
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(size, half, constant_values=np.nan), 2 * half + 1)[seen]
    usual = np.nanmedian(windows, axis=1)
    jump = size[seen] > HAMPEL_SIGMAS * 1.4826 * np.maximum(usual, LEAST_NOISE_MM) * 2.0
    # A jump shows in three samples: the one in the middle is the largest.
    largest = size[seen] >= np.nanmax(windows[:, half - 1 : half + 2], axis=1)
    wrong[seen[jump & largest] + 1] = True
    return wrong


def _butterworth(run: Array, cutoff_hz: float, order: int, rate_hz: float) -> Array:
    # Run forward and backward: half the order each, with the cut-off moved so that the result has −3 dB there.
    passes = order // 2
    moved = np.tan(np.pi * cutoff_hz / rate_hz) / (np.sqrt(2.0) - 1.0) ** (1.0 / (2.0 * passes))
    corrected = min(np.arctan(moved) * rate_hz / np.pi, 0.499 * rate_hz)
    sections = butter(passes, corrected, fs=rate_hz, output="sos")
    pad = min(len(run) - 1, round(3.0 * rate_hz / corrected))
    return sosfiltfilt(sections, run, axis=0, padtype="odd", padlen=pad)


def _average(run: Array, window: float) -> Array:
    reach = max(1, int(np.ceil(2.0 * window)))
    weight = np.exp(-0.5 * (np.arange(-reach, reach + 1) / max(window, 1e-3)) ** 2)
    padded = np.pad(run, ((reach, reach), (0, 0)), mode="reflect", reflect_type="odd")
    smoothed = [np.convolve(padded[:, axis], weight / weight.sum(), "valid") for axis in range(3)]
    return np.column_stack(smoothed)


def _gcv(run: Array) -> Array:
    """Piece by piece where the run is long, the pieces overlapping and fading into each other."""
    found, weight = np.zeros_like(run), np.zeros((len(run), 1))
    for start in range(0, max(1, len(run) - OVERLAP), LONGEST_SPLINE - OVERLAP):
        part = run[start : start + LONGEST_SPLINE]
        times = np.arange(len(part), dtype=float)
        smoothed = np.column_stack([make_smoothing_spline(times, part[:, axis])(times) for axis in range(3)])
        fade = np.minimum(1.0, (np.minimum(times, times[::-1]) + 1.0) / OVERLAP)[:, None]
        found[start : start + len(part)] += fade * smoothed
        weight[start : start + len(part)] += fade
    return found / weight


def _kalman(run: Array, rate_hz: float) -> Array:
    """Constant velocity driven by white acceleration; noise from third differences, acceleration from second ones."""
    dt = 1.0 / rate_hz
    noise = max(float(np.median(np.diff(run, n=3, axis=0) ** 2)) / (0.4549 * THIRD_DIFFERENCE), 1e-6)
    bent = float(np.mean(np.diff(run, n=2, axis=0) ** 2)) - 6.0 * noise
    push = max(bent, 0.01 * noise) / dt**4
    step = np.array([[1.0, dt], [0.0, 1.0]])
    drive = push * np.array([[dt**4 / 4, dt**3 / 2], [dt**3 / 2, dt**2]])
    state, spread = np.zeros((len(run), 2, 3)), np.zeros((len(run), 2, 2))
    ahead, ahead_spread = np.zeros_like(state), np.zeros_like(spread)
    ahead[0], ahead_spread[0] = np.vstack([run[0], np.zeros(3)]), np.diag([noise, 1e8])
    for k in range(len(run)):
        if k:
            ahead[k], ahead_spread[k] = step @ state[k - 1], step @ spread[k - 1] @ step.T + drive
        gain = ahead_spread[k][:, 0] / (ahead_spread[k][0, 0] + noise)
        state[k] = ahead[k] + gain[:, None] * (run[k] - ahead[k][0])
        spread[k] = ahead_spread[k] - np.outer(gain, ahead_spread[k][0])
    for k in range(len(run) - 2, -1, -1):
        back = spread[k] @ step.T @ np.linalg.inv(ahead_spread[k + 1])
        state[k] += back @ (state[k + 1] - ahead[k + 1])
    return state[:, 0]
