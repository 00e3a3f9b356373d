"""Observations: the 2D centroids of one take, and how they meet a rig's cameras."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import InputError
from markerloom.rig import Rig, natural_key

Array = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]
OPTIONAL_COLUMNS = ("time_s", "timecode_s", "radius", "brightness", "sigma", "quality", "id")


@dataclass(frozen=True)
class Observations:
    """Centroids as columns, in the order of the input.

    ``frame`` (n,), ``camera`` (n,) index into ``camera_ids``, ``pixel`` (n, 2); optional columns by name, each (n,).
    ``frames`` are all frame numbers of the take, empty ones included.
    """

    frame: Ints
    camera: Ints
    camera_ids: tuple[str, ...]
    pixel: Array
    optional: dict[str, Array] = field(default_factory=dict)
    rate_hz: float | None = None
    frames: Ints = field(default_factory=lambda: np.zeros(0, np.int64))
    source: str = ""
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Fill in the frame numbers where the reader did not know them."""
        if len(self.frames) == 0 and len(self.frame) > 0:
            object.__setattr__(self, "frames", all_frames(self.frame, self.source))

    def __len__(self) -> int:
        """Return the number of centroids."""
        return len(self.frame)

    def select(self, start: int | None, stop: int | None) -> Observations:
        """The frames from ``start`` to before ``stop``."""
        low = -(2**62) if start is None else start
        high = 2**62 if stop is None else stop
        keep = (self.frame >= low) & (self.frame < high)
        frames = self.frames[(self.frames >= low) & (self.frames < high)]
        if len(frames) == 0 and len(self.frames) > 0:
            first, last = self.frames.min(), self.frames.max()
            raise InputError(f"no frame in {start}:{stop}: the take has frames {first} to {last} ({self.source})")
        return replace(self._keep(keep), frames=frames)

    def of_cameras(self, ids: Sequence[str]) -> Observations:
        """The observations of some cameras only."""
        wanted = np.array([i in set(ids) for i in self.camera_ids], bool)
        return self._keep(wanted[self.camera]) if len(self) else self

    def every(self, step: int) -> Observations:
        """Every ``step``-th frame, with its number."""
        if step < 1:
            raise InputError(f"every {step}th frame: the step must be 1 or more")
        return replace(self._keep(self.frame % step == 0), frames=self.frames[self.frames % step == 0])

    def _keep(self, keep: NDArray[np.bool_]) -> Observations:
        optional = {name: column[keep] for name, column in self.optional.items()}
        kept = replace(
            self, frame=self.frame[keep], camera=self.camera[keep], pixel=self.pixel[keep], optional=optional
        )
        return replace(kept, frames=self.frames)


def all_frames(frame: Ints, source: str) -> Ints:
    """Every frame number from the first to the last; refuses numbers that cannot be those of one take."""
    first, last, filled = int(frame.min()), int(frame.max()), len(np.unique(frame))
    if last - first > 1_000_000 + 100 * filled:
        raise InputError(
            f"frames run from {first} to {last}, but only {filled} of them hold anything: "
            f"the frame numbers are damaged or belong to several takes ({source})"
        )
    return np.arange(first, last + 1)


def framed_by_time(observations: Observations) -> Observations:
    """The rows in frames of one clock: each goes to the frame nearest to its ``time_s``.

    Frame numbers stay where those of some camera fit the time already; else the camera with most dots decides what
    number a time has. Where a camera has two frames nearest to one, the nearer counts; a warning tells of the other.
    """
    time_s, rate = observations.optional["time_s"], observations.rate_hz
    if rate is None:
        raise InputError(f"its frame rate is not known: state it with --rate-hz ({observations.source})")
    known = np.isfinite(time_s)
    exact = np.where(known, time_s * rate, observations.frame)
    frame = np.floor(exact + 0.5).astype(np.int64)
    counts = np.bincount(observations.camera[known], minlength=1)
    apart = [
        int(np.median((observations.frame - frame)[known & (observations.camera == c)])) for c in np.flatnonzero(counts)
    ]
    if apart and 0 not in apart:
        frame = frame + apart[int(counts[counts > 0].argmax())]
    # Of several frames of a camera that fall into one, only the nearest stays.
    offset = np.abs(exact - np.floor(exact + 0.5))
    order = np.lexsort((observations.frame, offset, observations.camera, frame))
    first = np.ones(len(order), bool)
    same = (np.diff(frame[order]) == 0) & (np.diff(observations.camera[order]) == 0)
    first[1:] = ~same
    chosen = observations.frame[order][np.maximum.accumulate(np.where(first, np.arange(len(order)), 0))]
    keep = np.zeros(len(order), bool)
    keep[order] = observations.frame[order] == chosen
    notes = list(observations.warnings)
    _count(~keep, notes, "observations are left out: their camera had a frame nearer to the same moment")
    renamed = replace(observations, frame=frame, frames=np.zeros(0, np.int64), warnings=tuple(notes))
    kept = renamed._keep(keep)
    order = np.lexsort((np.arange(len(kept)), kept.camera, kept.frame))
    optional = {name: column[order] for name, column in kept.optional.items()}
    frames = all_frames(kept.frame, observations.source)
    return replace(
        kept,
        frame=kept.frame[order],
        camera=kept.camera[order],
        pixel=kept.pixel[order],
        optional=optional,
        frames=frames,
    )


@dataclass(frozen=True)
class MatchedDots:
    """Observations that belong to a rig's cameras, ordered by frame, as the engine takes them.

    ``row`` (m,): the observation's row in the input. ``observation`` (m,): its index within its frame and camera.
    ``hardware`` (m,): identity that an active marker told, −1 for none.
    """

    frames: Ints
    starts: Ints
    camera: Ints
    pixel: Array
    sigma: Array
    row: Ints
    observation: Ints
    hardware: Ints
    warnings: tuple[str, ...]

    def of_frames(self, first: int, last: int) -> tuple[Ints, Ints, Array, Array, Ints]:
        """Starts, camera, pixel, sigma and identity of the frames with index ``first`` to before ``last``."""
        low, high = self.starts[first], self.starts[last]
        return (
            self.starts[first : last + 1] - low,
            self.camera[low:high],
            self.pixel[low:high],
            self.sigma[low:high],
            self.hardware[low:high],
        )


class DotArrays:
    """The shape in which the engine takes dots."""

    def __init__(self, starts: Ints, camera: Ints, pixel: Array, sigma: Array, hardware: Ints | None = None) -> None:
        """Make the arrays contiguous and of the engine's types."""
        self.starts = np.ascontiguousarray(starts, np.int64)
        self.camera = np.ascontiguousarray(camera, np.int64)
        self.pixel = np.ascontiguousarray(pixel, np.float64).reshape(-1, 2)
        self.sigma = np.ascontiguousarray(sigma, np.float64)
        none = np.full(len(self.sigma), -1)
        self.hardware = np.ascontiguousarray(none if hardware is None else hardware, np.int64)


def match(observations: Observations, rig: Rig) -> MatchedDots:
    """Give each observation its camera of the rig; drop, count and name what cannot be used."""
    warnings = [*rig.warnings, *observations.warnings]
    camera_of, notes = _cameras_by_id(observations, rig)
    warnings += notes
    camera = camera_of[observations.camera] if len(observations) else np.zeros(0, np.int64)
    keep = camera >= 0
    keep &= _finite(observations, warnings)
    keep &= _on_sensor(observations, rig, camera, warnings)
    keep &= _not_masked(observations, rig, camera, warnings)
    keep &= _not_duplicate(observations, camera, keep, warnings)
    within = _index_within_camera(observations)
    sigma = _sigma(observations, warnings)
    order = np.lexsort((np.arange(len(observations)), observations.frame))
    order = order[keep[order]]
    if np.any(np.diff(observations.frame) < 0):
        warnings.append("frames are out of order: rows were sorted by frame")
    frames = observations.frames
    starts = np.searchsorted(observations.frame[order], np.append(frames, frames[-1] + 1)) if len(frames) else [0]
    return MatchedDots(
        frames=frames,
        starts=np.asarray(starts, np.int64),
        camera=camera[order],
        pixel=observations.pixel[order],
        sigma=sigma[order],
        row=order.astype(np.int64),
        observation=within[order],
        hardware=_hardware(observations, warnings)[order],
        warnings=tuple(warnings),
    )


def _cameras_by_id(observations: Observations, rig: Rig) -> tuple[Ints, list[str]]:
    """Index into the rig of each of the observations' cameras (−1 = none), and what to tell the user."""
    ids = observations.camera_ids
    for keys in ([c.id for c in rig.cameras], [c.name for c in rig.cameras]):
        place = {key: i for i, key in enumerate(keys) if key}
        found = np.array([place.get(i, -1) for i in ids], np.int64)
        if len(found) and np.any(found >= 0):
            unknown = [i for i, at in zip(ids, found, strict=True) if at < 0]
            if not unknown:
                return found, []
            count = int(np.isin(observations.camera, [ids.index(i) for i in unknown]).sum())
            note = f"{count} observations of {len(unknown)} cameras that the calibration lacks are ignored: "
            return found, [note + ", ".join(sorted(unknown, key=natural_key))]
    numbers = [int(i) for i in ids if i.isdigit()]
    if len(ids) and len(numbers) == len(ids) and set(numbers) <= set(range(len(rig))):
        note = "no camera id fits the calibration: 0, 1, 2, … are taken as positions in ascending order of id"
        return np.array(numbers, np.int64), [note]
    if not ids:
        return np.zeros(0, np.int64), []
    few = ", ".join(sorted(ids, key=natural_key)[:4])
    raise InputError(
        f"no camera of the observations ({few}, …) is in the calibration ({', '.join(rig.ids[:4])}, …): "
        f"use the calibration of this rig, or make the ids equal ({observations.source})"
    )


def _count(bad: NDArray[np.bool_], warnings: list[str], text: str) -> NDArray[np.bool_]:
    if np.any(bad):
        warnings.append(f"{int(bad.sum())} {text}")
    return ~bad


def _finite(observations: Observations, warnings: list[str]) -> NDArray[np.bool_]:
    bad = ~np.asarray(np.isfinite(observations.pixel).all(axis=1))
    return _count(bad, warnings, "observations with NaN or infinite pixels are ignored")


def _on_sensor(observations: Observations, rig: Rig, camera: Ints, warnings: list[str]) -> NDArray[np.bool_]:
    if len(observations) == 0:
        return np.ones(0, bool)
    size = np.array([c.size_px for c in rig.cameras])[np.maximum(camera, 0)]
    # A centroid may lie half a blob outside; a sensor's width outside it is another image.
    margin = 0.05 * size
    pixel = np.nan_to_num(observations.pixel)
    outside = np.any((pixel < -0.5 - margin) | (pixel > size - 0.5 + margin), axis=1) & (camera >= 0)
    share = outside.mean()
    if share > 0.2:
        raise InputError(
            f"{share:.0%} of the pixels lie outside the calibrated images: the observations and the calibration "
            f"belong to different sensors or scalings ({observations.source})"
        )
    return _count(outside, warnings, "observations outside the image are ignored")


def _not_masked(observations: Observations, rig: Rig, camera: Ints, warnings: list[str]) -> NDArray[np.bool_]:
    masked = np.zeros(len(observations), bool)
    for i, one in enumerate(rig.cameras):
        if one.mask is not None:
            masked |= (camera == i) & one.mask.covers(observations.pixel)
    return _count(masked, warnings, "observations under a camera's mask are ignored")


def _not_duplicate(
    observations: Observations, camera: Ints, keep: NDArray[np.bool_], warnings: list[str]
) -> NDArray[np.bool_]:
    columns = (observations.pixel[:, 1], observations.pixel[:, 0], camera, observations.frame)
    order = np.lexsort(columns) if len(observations) else np.zeros(0, np.int64)
    same = np.ones(max(len(order) - 1, 0), bool)
    for column in columns:
        same &= np.diff(column[order]) == 0
    bad = np.zeros(len(observations), bool)
    bad[order[1:][same]] = True
    return _count(bad & keep, warnings, "repeated rows (same frame, camera and pixel) are ignored")


def _index_within_camera(observations: Observations) -> Ints:
    """0-based index of each row within its frame and camera, in the input's order."""
    n = len(observations)
    order = np.lexsort((np.arange(n), observations.camera, observations.frame))
    frame, camera = observations.frame[order], observations.camera[order]
    new = np.ones(n, bool)
    new[1:] = (np.diff(frame) != 0) | (np.diff(camera) != 0)
    start = np.maximum.accumulate(np.where(new, np.arange(n), 0))
    within = np.zeros(n, np.int64)
    within[order] = np.arange(n) - start
    return within


def _sigma(observations: Observations, warnings: list[str]) -> Array:
    """The dots' own sigma relative to its median; 1 where it is missing."""
    sigma = observations.optional.get("sigma")
    if sigma is None:
        return np.ones(len(observations))
    good = np.isfinite(sigma) & (sigma > 0)
    _count(~good, warnings, "observations without a usable sigma get the median sigma")
    typical = float(np.median(sigma[good])) if np.any(good) else 1.0
    return np.where(good, sigma / typical, 1.0)


def _hardware(observations: Observations, warnings: list[str]) -> Ints:
    """Identities of active markers; −1 where there is none."""
    column = observations.optional.get("id")
    if column is None:
        return np.full(len(observations), -1, np.int64)
    told = np.isfinite(column) & (column != -1)
    bad = told & ((column < 0) | (column != np.round(column)) | (column > 2**32 - 2))
    _count(bad, warnings, "identities that are no whole number from 0 on are ignored")
    return np.where(told & ~bad, np.nan_to_num(column), -1).astype(np.int64)


def concatenate_ids(camera: Iterable[object]) -> tuple[Ints, tuple[str, ...]]:
    """Camera ids as strings: an index per row, and the ids in natural order."""
    values, inverse = np.unique(np.asarray([str(c) for c in camera]), return_inverse=True)
    order = sorted(range(len(values)), key=lambda i: natural_key(str(values[i])))
    rank = np.empty(len(values), np.int64)
    rank[order] = np.arange(len(values))
    return rank[inverse].astype(np.int64), tuple(str(values[i]) for i in order)
