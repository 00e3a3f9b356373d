"""Clocks of recordings against the first one's: from motion, from an event, from time codes, or by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import InputError
from markerloom.observations import Observations, framed_by_time
from markerloom.rig import Rig, natural_key
from markerloom.sync.event import EVENTS, clock_from_events
from markerloom.sync.motion import clock_from_motion

Array = NDArray[np.floating[Any]]
WAYS = ("motion", "timecode", *EVENTS)


@dataclass(frozen=True)
class Clock:
    """A recording's clock against the reference's.

    Its frame n was taken at ``offset_s + n (1 + drift_ppm / 10⁶) / rate_hz`` seconds of the reference, whose own frame
    0 is at 0 s. ``sigma_s``: standard deviation of that in the middle of the recording; ``drift_sigma_ppm`` of the
    drift.
    """

    name: str
    cameras: tuple[str, ...]
    rate_hz: float
    offset_s: float = 0.0
    drift_ppm: float = 0.0
    sigma_s: float = 0.0
    drift_sigma_ppm: float = 0.0
    way: str = "reference"
    details: dict[str, Any] = field(default_factory=dict)

    def time_s(self, frame: NDArray[np.int64]) -> Array:
        """Time of frames on the reference's clock."""
        return self.offset_s + frame * ((1.0 + 1e-6 * self.drift_ppm) / self.rate_hz)


@dataclass(frozen=True)
class Synced:
    """Recordings on one clock. ``recordings``: as given, with ``time_s``; ``merged``: all, by reference frame."""

    recordings: tuple[Observations, ...]
    merged: Observations
    clocks: tuple[Clock, ...]
    report: dict[str, Any]


@dataclass(frozen=True)
class _Part:
    """What one clock ticks for: a recording, or one camera of it."""

    name: str
    take: Observations


def sync(
    recordings: Sequence[Observations],
    rig: Rig | None = None,
    *,
    by: str = "motion",
    offsets: Mapping[str, float] | None = None,
    each_camera: bool | None = None,
) -> Synced:
    """Put recordings on one clock, that of the first of the fastest ones.

    Every recording has a clock of its own; with ``each_camera`` (the default for a single recording) every camera has.
    ``by``: ``motion`` (offset and drift from the markers themselves, by the epipolar lines of the calibrated ``rig``),
    ``flash`` or ``clap`` (an event that all saw), ``timecode`` (the column ``timecode_s``). ``offsets``: by name of a
    recording (its file's, without ending) or camera id, how many reference frames after the reference's frame 0 its
    frame 0 was taken; these are not looked for.

    Nothing is moved in the images: rows get the time at which they were taken. Raises ``InputError`` where a rate or
    the rig is missing, where cameras have the same id, and where no offset stands out.
    """
    if by not in WAYS:
        raise InputError(f"'{by}': known ways are {', '.join(WAYS)}")
    if not recordings:
        raise InputError("no recording was given")
    for recording in recordings:
        _check(recording)
    parts = _parts(recordings, len(recordings) == 1 if each_camera is None else each_camera, offsets or {})
    if len(parts) < 2:
        raise InputError(f"there is one clock only ({parts[0].name}): nothing is to be put on another")
    reference = max(range(len(parts)), key=lambda i: (parts[i].take.rate_hz or 0.0, -i))
    clocks = _clocks(parts, reference, rig, by, offsets or {})
    timed = [_timed(recording, clocks) for recording in recordings]
    merged = framed_by_time(_joined(timed, float(parts[reference].take.rate_hz or 0.0)))
    warnings = [*merged.warnings, *(w for c in clocks for w in c.details.get("warnings", ()))]
    report = {
        "reference": parts[reference].name,
        "frames": len(merged.frames),
        "clocks": [_described(c, float(parts[reference].take.rate_hz or 1.0)) for c in clocks],
        "warnings": warnings,
    }
    return Synced(tuple(timed), merged, tuple(clocks), report)


def _check(recording: Observations) -> None:
    if recording.rate_hz is None:
        raise InputError(f"its frame rate is not known: state it with --rate-hz ({recording.source})")
    if len(recording) == 0:
        raise InputError(f"there are no observations in it ({recording.source})")


def _parts(recordings: Sequence[Observations], each_camera: bool, offsets: Mapping[str, float]) -> list[_Part]:
    parts: list[_Part] = []
    for index, recording in enumerate(recordings):
        used = [recording.camera_ids[i] for i in np.unique(recording.camera)]
        apart = [c for c in used if each_camera or c in offsets]
        together = [c for c in used if c not in apart]
        if together:
            name = _name(recording, index)
            parts.append(_Part(name, recording if not apart else recording.of_cameras(together)))
        parts += [_Part(c, recording.of_cameras([c])) for c in sorted(apart, key=natural_key)]
    cameras = [c for r in recordings for c in np.array(r.camera_ids)[np.unique(r.camera)].tolist()]
    twice = sorted({c for c in cameras if cameras.count(c) > 1}, key=natural_key)
    if twice:
        raise InputError(f"camera {twice[0]} is in several recordings: every camera of the rig needs its own id")
    names = [p.name for p in parts]
    unknown = [name for name in offsets if name not in names]
    if unknown:
        raise InputError(f"--offset {unknown[0]}: there is no such camera or recording ({', '.join(names)})")
    return parts


def _name(recording: Observations, index: int) -> str:
    name = Path(recording.source).name.split(".")[0] if recording.source else ""
    return name or f"recording {index + 1}"


def _clocks(parts: list[_Part], reference: int, rig: Rig | None, by: str, offsets: Mapping[str, float]) -> list[Clock]:
    """The clock of each part; those that share no view with the reference are put on it by way of others."""
    found: dict[int, Clock] = {reference: _clock(parts[reference])}
    reference_hz = found[reference].rate_hz
    if parts[reference].name in offsets:
        raise InputError(f"--offset {parts[reference].name}: this is the reference; state the others' offsets")
    for index, part in enumerate(parts):
        if part.name in offsets:
            found[index] = replace(_clock(part), offset_s=offsets[part.name] / reference_hz, way="hand")
    failed: dict[int, str] = {}
    while missing := [i for i in range(len(parts)) if i not in found]:
        before = len(found)
        for index in missing:
            for known in [reference, *(k for k in sorted(found) if k != reference)]:
                try:
                    against = _against(parts[known].take, parts[index].take, rig, by)
                except InputError as error:
                    failed.setdefault(index, str(error))
                    continue
                found[index] = _chained(_clock(parts[index]), found[known], against, by)
                break
        if len(found) == before:
            raise InputError(
                f"{parts[missing[0]].name} cannot be put on the clock of {parts[reference].name}: {failed[missing[0]]}"
            )
    return [found[i] for i in range(len(parts))]


def _clock(part: _Part) -> Clock:
    cameras = tuple(part.take.camera_ids[i] for i in np.unique(part.take.camera))
    return Clock(part.name, cameras, float(part.take.rate_hz or 0.0))


def _against(first: Observations, second: Observations, rig: Rig | None, by: str) -> dict[str, Any]:
    """Offset (s), drift (ppm) and their standard deviations of the second recording's clock against the first's."""
    if by == "motion":
        if rig is None:
            raise InputError(
                "the motion tells the offset with calibrated cameras: state --calibration, or another way (--by)"
            )
        return clock_from_motion(first, second, rig)
    return clock_from_events(first, second, by)


def _chained(own: Clock, known: Clock, against: dict[str, Any], by: str) -> Clock:
    """A clock known against another, against the reference."""
    stretch = 1.0 + 1e-6 * known.drift_ppm
    drift = (stretch * (1.0 + 1e-6 * against["drift_ppm"]) - 1.0) * 1e6
    return replace(
        own,
        offset_s=known.offset_s + stretch * against["offset_s"],
        drift_ppm=drift,
        sigma_s=float(np.hypot(known.sigma_s, against["sigma_s"])),
        drift_sigma_ppm=float(np.hypot(known.drift_sigma_ppm, against["drift_sigma_ppm"])),
        way=by,
        details={"against": known.name, **against["details"]},
    )


def _timed(recording: Observations, clocks: list[Clock]) -> Observations:
    """The recording with the time of every row."""
    time_s = np.full(len(recording), np.nan)
    for clock in clocks:
        own = np.isin(np.array(recording.camera_ids)[recording.camera], clock.cameras)
        time_s[own] = clock.time_s(recording.frame[own])
    optional = {"time_s": time_s, **{k: v for k, v in recording.optional.items() if k not in ("time_s", "timecode_s")}}
    return replace(recording, optional=optional)


def _joined(recordings: Sequence[Observations], rate_hz: float) -> Observations:
    """All rows in one table; columns that only some have are NaN for the others."""
    used = [[r.camera_ids[i] for i in np.unique(r.camera)] for r in recordings]
    ids = tuple(sorted((c for own in used for c in own), key=natural_key))
    place = [np.array([ids.index(c) if c in ids else -1 for c in r.camera_ids]) for r in recordings]
    names = list(dict.fromkeys(name for r in recordings for name in r.optional))
    nothing = [np.full(len(r), np.nan) for r in recordings]
    return Observations(
        frame=np.concatenate([r.frame for r in recordings]),
        camera=np.concatenate([p[r.camera] for p, r in zip(place, recordings, strict=True)]),
        camera_ids=ids,
        pixel=np.concatenate([r.pixel for r in recordings]),
        optional={
            n: np.concatenate([r.optional.get(n, none) for r, none in zip(recordings, nothing, strict=True)])
            for n in names
        },
        rate_hz=rate_hz,
        source=", ".join(r.source for r in recordings if r.source),
        warnings=tuple(w for r in recordings for w in r.warnings),
    )


def _described(clock: Clock, reference_hz: float) -> dict[str, Any]:
    return {
        "name": clock.name,
        "cameras": list(clock.cameras),
        "rate_hz": clock.rate_hz,
        "way": clock.way,
        "offset_s": clock.offset_s,
        "offset_frames": clock.offset_s * reference_hz,
        "drift_ppm": clock.drift_ppm,
        "sigma_frames": clock.sigma_s * reference_hz,
        "drift_sigma_ppm": clock.drift_sigma_ppm,
        **{k: v for k, v in clock.details.items() if k != "warnings"},
    }
