"""Frequency bands of a motion, louder or softer (Bruderlin & Williams 1995, "Motion signal processing").

Every joint's turns are told as vectors about its mean pose, and these, like the root's place, are split into bands:
Gaussian and Laplacian pyramid with the kernel (1/16, 1/4, 3/8, 1/4, 1/16), its taps spread by doubling. A motion with
its bands weighted is put together again. Waveshaping maps each vector's components through a curve.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from markerloom import _core
from markerloom.errors import InputError
from markerloom.motion.body import Body, body_of
from markerloom.motion.edited import Edited, moved_mm
from markerloom.motion.rotations import about, exp, reference
from markerloom.skeleton.motion import Motion

Array = NDArray[np.floating[Any]]
EDGE = 0.182
"""Half of a signal of this frequency (cycles per frame) is left in the first smoothed level."""
BODY_HZ = 2.0
"""A body's path is in the bands that begin below this; what is faster is its trembling, and that of the capture."""
PRESETS: dict[str, list[tuple[float, float]]] = {
    "calmer": [(0.3, 1.0), (1.0, 0.8), (3.0, 0.5), (8.0, 0.4)],
    "livelier": [(0.3, 1.0), (1.0, 1.2), (3.0, 1.5), (8.0, 1.2), (15.0, 1.0)],
    "heavier": [(0.3, 1.1), (1.0, 1.2), (2.0, 0.9), (4.0, 0.4), (10.0, 0.2)],
}
"""Gains by frequency (Hz), between them by its logarithm."""
Curve = list[tuple[float, float]]


def band_hz(frames: int, rate_hz: float) -> list[tuple[float, float]]:
    """From which to which frequency (Hz) each band of a clip reaches, the finest first."""
    edges = [rate_hz / 2.0, *(EDGE * rate_hz / 2.0**k for k in range(_core.band_count(frames)))]
    return [(low, high) for high, low in pairwise(edges)]


def bands(
    motion: Motion,
    *,
    gains: dict[int, float] | None = None,
    hz: list[tuple[float, float, float]] | None = None,
    preset: str | None = None,
    joints: list[str] | None = None,
    root: bool = False,
    shape: dict[str, Curve] | None = None,
) -> Edited:
    """A motion with its frequency bands weighted.

    ``gains``: by number of the band, 0 the fastest, or by the number of bands for what is below all; ``hz``: ranges
    (from, to, gain) in Hz; ``preset``: calmer, livelier, heavier. ``joints``: names, or groups (legs, arms, spine,
    head, left, right); else all. ``root``: the root's place, too. ``shape``: for joints or groups, a curve of pairs
    (degrees from the mean pose, degrees instead). Raises ``InputError`` for bands and joints that are not there.
    """
    if len(motion) < 3:
        raise InputError(f"bands need a clip of at least 3 frames; {motion.source} has {len(motion)}")
    own = _gains(len(motion), motion.rate_hz, gains or {}, hz or [], preset)
    body = body_of(motion.skeleton)
    chosen = _chosen(body, joints)
    curves = {j: curve for name, curve in (shape or {}).items() for j in _chosen(body, [name])}
    turns = motion.turns.copy()
    for j in sorted({*chosen, *curves}):
        where = reference(motion.turns[:, j])
        vectors = about(where, motion.turns[:, j])
        if j in chosen:
            vectors = _weighted(vectors, own)
        if j in curves:
            vectors = _shaped(vectors, curves[j])
        turns[:, j] = where @ exp(vectors)
    root_m = _weighted(motion.root_m, own) if root else motion.root_m
    out = replace(motion, turns=turns, root_m=root_m)
    rows = [{"from": low, "to": high, "gain": float(g)} for (low, high), g in zip(_spans(motion), own, strict=True)]
    return Edited(out, {"bands_hz": rows, "joints": len(chosen), "moved_mm": moved_mm(motion, out), "warnings": []})


def split(motion: Motion, joint: str) -> Array:
    """The bands of a joint's turns about its mean pose: (bands + 1, frames, 3; rad), finest first; their sum is the
    turns themselves.
    """
    j = motion.skeleton.index(joint)
    if j < 0:
        raise InputError(f"there is no joint '{joint}' in {motion.source or motion.skeleton.name}")
    vectors = about(reference(motion.turns[:, j]), motion.turns[:, j])
    return _core.split_bands(np.ascontiguousarray(vectors), _core.band_count(len(motion)))


def low_passed(values: Array, rate_hz: float, hz: float = BODY_HZ) -> Array:
    """The bands of signals (frames, columns) below a frequency."""
    spans = band_hz(len(values), rate_hz)
    gains = np.array([0.0 if low > hz else 1.0 for low, _ in spans] + [1.0])
    return _weighted(values, gains)


def _spans(motion: Motion) -> list[tuple[float, float]]:
    spans = band_hz(len(motion), motion.rate_hz)
    return [*spans, (0.0, spans[-1][0] if spans else motion.rate_hz / 2.0)]


def _gains(
    frames: int, rate_hz: float, gains: dict[int, float], hz: list[tuple[float, float, float]], preset: str | None
) -> Array:
    spans = band_hz(frames, rate_hz)
    out = np.ones(len(spans) + 1)
    middles = np.array([np.sqrt(low * high) for low, high in spans])
    if preset is not None:
        if preset not in PRESETS:
            raise InputError(f"there is no preset '{preset}': {', '.join(PRESETS)}")
        knots, values = np.array(PRESETS[preset]).T
        out[:-1] = np.interp(np.log(middles), np.log(knots), values)
    for low, high, gain in hz:
        inside = (middles >= low) & (middles < high)
        if not 0.0 <= low < high or not inside.any():
            raise InputError(
                f"no band lies in {low:g}-{high:g} Hz; the bands' middles are at "
                + ", ".join(f"{m:.2g}" for m in middles)
                + " Hz"
            )
        out[:-1][inside] = gain
    for band, gain in gains.items():
        if not 0 <= band <= len(spans):
            raise InputError(f"there is no band {band}: a clip of {frames} frames has bands 0 to {len(spans)}")
        out[band] = gain
    if not np.isfinite(out).all() or np.abs(out).max() > 100.0:
        raise InputError("gains are numbers up to 100")
    return out


def _chosen(body: Body, names: list[str] | None) -> list[int]:
    if names is None:
        return list(range(len(body.skeleton)))
    chosen: set[int] = set()
    for name in names:
        found = body.group(name)
        if not found:
            raise InputError(
                f"there is no joint or group '{name}': legs, arms, spine, head, left, right, or one of "
                + ", ".join(body.skeleton.joints)
            )
        chosen |= set(found)
    return sorted(chosen)


def _weighted(values: Array, gains: Array) -> Array:
    columns = np.ascontiguousarray(np.broadcast_to(gains[:, None], (len(gains), values.shape[1])))
    return _core.equalise_bands(np.ascontiguousarray(values), columns)


def _shaped(vectors: Array, curve: Curve) -> Array:
    """Waveshaping (section 5 of the paper): every component through a curve, straight on beyond its ends."""
    pairs = np.deg2rad(np.array(sorted(curve), float))
    if pairs.ndim != 2 or len(pairs) < 2 or (np.diff(pairs[:, 0]) <= 0).any():
        raise InputError("a shape is two or more pairs in:out (degrees), each with another in")
    inside = PchipInterpolator(pairs[:, 0], pairs[:, 1])(np.clip(vectors, pairs[0, 0], pairs[-1, 0]))
    return inside + np.where(vectors < pairs[0, 0], vectors - pairs[0, 0], np.maximum(vectors - pairs[-1, 0], 0.0))
