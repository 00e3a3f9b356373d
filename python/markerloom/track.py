"""Observations and a rig to trajectories: a whole take at once, or one frame at a time."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from markerloom import _core
from markerloom.bumped import Moves, found_moves, warning
from markerloom.calibrate.refine import refine_rig
from markerloom.errors import InputError
from markerloom.explain import Seen, TrackedTake, gaps
from markerloom.known_before import StartPose
from markerloom.moments import Moments, dots_for_estimates, moment, moments_of
from markerloom.observations import DotArrays, MatchedDots, Observations, framed_by_time, match
from markerloom.points import KINDS, Points
from markerloom.reconstruct import (
    CHUNK_FRAMES,
    Progress,
    Reconstruction,
    as_points,
    dot_arrays,
    in_parts,
    residual_by_camera,
    statistics,
    timing,
    usable_dots,
)
from markerloom.rig import Rig
from markerloom.track_points import track_points

Array = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]

TRACK_METHODS = ("default", "paper")


@dataclass(frozen=True)
class TrackedFrame:
    """What one frame gave: one row per marker, in ascending order of ``tracks``.

    ``points_mm`` (n, 3); ``sigmas_mm`` (n,) = √trace of the position's covariance; ``kinds``: ``measured`` or
    ``predicted``; ``rays``, ``residuals_px``, ``confidences`` (n,); ``ids`` (n,): identities that active markers told,
    −1 for none.
    """

    points_mm: Array
    tracks: Ints
    kinds: NDArray[np.str_]
    sigmas_mm: Array
    rays: Ints
    residuals_px: Array
    confidences: Array
    ids: Ints


class Tracker:
    """Follows markers live, one frame after the other; memory does not grow.

    What ``push`` returns depends on the frames so far and on nothing else: ``track(..., causal=True)`` gives the same
    to the bit. Noise and volume are learned from the frames as they come; ``noise_px`` states the noise where it is
    known. ``refine_calibration``: a camera that is knocked is found, and its new pose used from the next frame on; what
    was found is in ``moves``. ``start_pose``: how the markers lie to each other, where that is known before. Raises
    ``InputError`` for a rate that is none and for a rig that cannot give a depth.
    """

    def __init__(
        self,
        rig: Rig,
        *,
        rate_hz: float,
        noise_px: float | None = None,
        refine_calibration: bool = False,
        start_pose: StartPose | None = None,
    ) -> None:
        """Prepare for the cameras of ``rig``."""
        self._rig = rig
        self._index = {camera.id: i for i, camera in enumerate(rig.cameras)}
        self._rate_hz, self._frame = rate_hz, -1
        start = None if start_pose is None else start_pose.core
        self._core = _core.Tracker(rig.core, None, rate_hz, noise_px, heal=refine_calibration, start=start)

    @property
    def moves(self) -> Moves:
        """Cameras that were moved so far; ``moves.rig_at(frame)`` is the rig as it stood in a frame."""
        return found_moves(self._rig, self._core.moved(False))

    def push(
        self,
        dots: Mapping[str, ArrayLike],
        frame: int | None = None,
        time_s: float | Mapping[str, float] | None = None,
    ) -> TrackedFrame:
        """Take in the dots of one frame: for each camera that has any, (n, 2) pixels, (n, 3) pixels and sigma (px), or
        (n, 4) with the identities of active markers (−1: none) too.

        ``frame``: its number, one more than the last if missing; a jump is frames that were lost. ``time_s``: its time,
        by number and rate if missing; by camera where they saw it at different moments. Raises ``InputError`` for a
        camera that the rig lacks and for time that does not move forwards.
        """
        self._frame = self._frame + 1 if frame is None else frame
        lag_s: list[float] = []
        if isinstance(time_s, Mapping):
            times = np.array([time_s.get(name, np.nan) for name in self._rig.ids], float)
            time_s, lag_s = moment(self._frame, times, self._rate_hz)
        solved = self._core.push(self._arrays(dots), self._frame, time_s, lag_s)
        variance = np.trace(solved["covariance_m2"], axis1=1, axis2=2)
        return TrackedFrame(
            points_mm=1000.0 * solved["point_m"],
            tracks=solved["track"],
            kinds=np.array(KINDS)[solved["kind"]],
            sigmas_mm=1000.0 * np.sqrt(variance),
            rays=np.diff(solved["dot_starts"]),
            residuals_px=solved["residual_px"],
            confidences=solved["confidence"],
            ids=solved["hardware"],
        )

    def _arrays(self, dots: Mapping[str, ArrayLike]) -> DotArrays:
        camera: list[NDArray[np.int64]] = []
        rows: list[Array] = []
        for name, values in dots.items():
            if name not in self._index:
                raise InputError(f"camera '{name}' is not in the calibration ({', '.join(self._rig.ids)})")
            table = np.asarray(values, float)
            if table.size == 0:
                continue
            if table.ndim != 2 or table.shape[1] not in (2, 3, 4):
                raise InputError(f"dots of camera '{name}' have the shape {table.shape}: (n, 2), 3 or 4 is needed")
            rows.append(np.column_stack([table, np.tile([1.0, -1.0], (len(table), 1))[:, table.shape[1] - 2 :]]))
            camera.append(np.full(len(table), self._index[name]))
        table = np.concatenate(rows) if rows else np.zeros((0, 4))
        index = np.concatenate(camera) if camera else np.zeros(0, np.int64)
        keep = self._usable(table, index)
        return DotArrays(
            np.array([0, keep.sum()]), index[keep], table[keep, :2], table[keep, 2], table[keep, 3].astype(np.int64)
        )

    def _usable(self, table: Array, camera: Ints) -> NDArray[np.bool_]:
        """Rows that a take would use too: finite, in the image or hardly outside, with a sigma, not repeated."""
        size = np.array([c.size_px for c in self._rig.cameras])[camera]
        margin = 0.05 * size
        keep = np.isfinite(table).all(axis=1) & (table[:, 2] > 0)
        with np.errstate(invalid="ignore"):
            keep &= np.all((table[:, :2] >= -0.5 - margin) & (table[:, :2] <= size - 0.5 + margin), axis=1)
        _, first = np.unique(np.column_stack([camera, table[:, :2]]), axis=0, return_index=True)
        once = np.zeros(len(table), bool)
        once[first] = True
        return keep & once


def track(
    take: Observations | Points,
    rig: Rig | None = None,
    *,
    rate_hz: float | None = None,
    method: str = "default",
    causal: bool = False,
    frames: tuple[int | None, int | None] | None = None,
    noise_px: float | None = None,
    refine_calibration: bool = False,
    start_pose: StartPose | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Follow every marker of a take through time: from dots and their ``rig``, or from anonymous or broken points.

    ``rate_hz``: frame rate where the observations do not state it. ``method``: ``default``, or ``paper`` for the whole
    system of Lee et al. 2000 as written (causal by nature), to compare with. ``causal``: exactly what a live user would
    have seen (see ``Tracker``); otherwise the whole take decides about identities, and gaps are carried from both ends.
    ``frames``: first and one past the last. ``noise_px``: noise of the dots where it is known.
    ``refine_calibration``: the rig is first adjusted to the take's own markers (see ``refine_rig``), and a camera that
    was moved while the take ran is solved anew from the others; with ``causal``, only the latter, as a live user would
    have had it. Without it, cameras that were moved are only told of. ``start_pose``: how the markers lie to each
    other, where that is known before the first frame (see ``start_pose``). ``progress(done, total)`` is called now and
    then.

    Raises ``InputError`` when observations and rig do not belong together or the frame rate is not known, ``RigError``
    when the cameras cannot give a depth.
    """
    if method not in TRACK_METHODS:
        raise InputError(f"method '{method}': known are {', '.join(TRACK_METHODS)}")
    if method == "paper" and start_pose is not None:
        raise InputError("the method of the paper learns its links from the take: leave the start pose out")
    if isinstance(take, Points):
        return track_points(
            take,
            rate_hz=rate_hz,
            causal=causal,
            frames=frames,
            method=method,
            start_pose=start_pose,
            progress=progress,
        )
    if rig is None:
        raise InputError(f"dots are tracked with the cameras that saw them: state the calibration ({take.source})")
    observations = take if frames is None else take.select(*frames)
    observations = _in_frames_of_one_clock(replace(observations, rate_hz=_rate(observations, rate_hz)))
    if method == "paper" and refine_calibration:
        raise InputError("the method of the paper takes the calibration as it is: leave refine_calibration out")
    if causal and method == "default":
        dots = _as_pushed(observations, rig)
        notes = list(dots.warnings)
    else:
        rig, dots, notes = usable_dots(observations, rig)
    run = _Run(observations, dots, len(rig), notes, method, causal, noise_px, start_pose, progress)
    if not refine_calibration or causal:
        return run.of(Moves(rig), heal=refine_calibration)
    if run.moments.has_several_clocks:
        final = run.of(run.moves(Moves(rig)))
        reasons = ["the cameras saw the frames at different moments: refine the rig with a take in which nothing moves"]
        final.report["refined"] = {"verdict": "refused", "reasons": reasons}
        return final
    rig, refined = _refined(observations, run.moves(Moves(rig)))
    final = run.of(run.moves(Moves(rig)))
    final.report["refined"] = refined
    return final


@dataclass(frozen=True)
class _Run:
    """Tracks the same dots, once or more often."""

    observations: Observations
    dots: MatchedDots
    cameras: int
    notes: list[str]
    method: str
    causal: bool
    noise_px: float | None
    start_pose: StartPose | None
    progress: Progress | None

    @cached_property
    def moments(self) -> Moments:
        """When the frames were seen."""
        return moments_of(self.observations, self.dots, self.cameras)

    def _recorded(self, known: Moves, heal: bool, stages: dict[str, float]) -> _core.Tracker:
        """A tracker that has seen the whole take."""
        clock = time.perf_counter()
        dots, rig, rate_hz = self.dots, known.rig, self.observations.rate_hz or 0.0
        moments = self.moments
        if self.method == "paper" and moments.has_several_clocks:
            raise InputError(
                "the method of the paper knows one clock only: the cameras saw the frames at different times"
            )
        start = None if self.start_pose is None else self.start_pose.core
        if self.causal and self.method == "default":
            tracker = _core.Tracker(rig.core, None, rate_hz, self.noise_px, heal=heal, start=start)
        else:
            model = _core.estimate_model(rig.core, dots_for_estimates(dots, moments, rig, rate_hz), self.noise_px)
            paper = self.method == "paper"
            tracker = _core.Tracker(rig.core, model, rate_hz, None, paper, planned=known.planned(), start=start)
        stages["estimate"] = time.perf_counter() - clock
        _record(tracker, dots, moments, self._part(0))
        stages["track"] = time.perf_counter() - clock - stages["estimate"]
        return tracker

    def _lights(self) -> tuple[list[int], list[float]] | None:
        """Frames and brightness of all dots, where active markers may be among them."""
        brightness = self.observations.optional.get("brightness")
        if brightness is None or not (self.dots.hardware >= 0).any():
            return None
        return self.dots.frames.tolist(), brightness[self.dots.row].tolist()

    def _part(self, part: int) -> Progress | None:
        """Progress of tracking (0) or of the repair (1), which take about as long; alone, tracking is all there is."""
        if self.progress is None:
            return None
        parts, tell = (1 if self.causal or self.method == "paper" else 2), self.progress
        return lambda done, total: tell(part * total + done, parts * total)

    def moves(self, known: Moves) -> Moves:
        """Cameras that are found to move."""
        return found_moves(known.rig, self._recorded(known, False, {}).moved(True))

    def of(self, known: Moves, *, heal: bool = False) -> TrackedTake:
        """The take with cameras whose moves are known, or are found and healed on the way."""
        clock, stages = time.perf_counter(), {}
        tracker = self._recorded(known, heal, stages)
        solved = tracker.recorded(self.causal, in_parts(self._part(1), len(self.dots.frames)), self._lights())
        stages["repair"] = time.perf_counter() - clock - sum(stages.values())
        solved["sizes"] = np.diff(solved.pop("dot_starts"))
        found = found_moves(known.rig, tracker.moved(not heal))
        in_use = found if heal else known
        lag_s = self.moments.of_dots(self.dots)
        report = _report(solved, self.dots, in_use, tracker, list(self.notes), self.causal, self.method, lag_s)
        dots, tracks = solved["dots"], np.repeat(solved["track"], solved["sizes"])
        owner = np.full((2, len(self.dots.camera)), -1, np.int64)
        first = np.unique(dots, return_index=True)[1]
        merged = np.setdiff1d(np.arange(len(dots)), first)
        owner[0, dots[first]], owner[1, dots[merged]] = tracks[first], tracks[merged]
        seen = Seen(in_use, self.dots, owner[0], owner[1], tuple(report["noise_px"].values()))
        points = as_points(solved, self.dots, known.rig, self.observations, report)
        tracked = TrackedTake.with_dots(points, seen)
        report["gaps"] = gaps(tracked)
        report["bumped_cameras"] = (in_use if in_use.moves else found).described()
        healed = bool(in_use.moves)
        report["warnings"] += [warning(move, healed=healed) for move in report["bumped_cameras"]]
        stages["explain"] = time.perf_counter() - clock - sum(stages.values())
        report["timing"] = timing(time.perf_counter() - clock, tracker.frame_ms(), stages)
        return tracked


def _refined(observations: Observations, found: Moves) -> tuple[Rig, dict[str, Any]]:
    """The rig at the take's first frame adjusted to the longest part in which no camera moves, and a report of that.

    Cameras that moved before that part stay as they were at first.
    """
    bounds = [int(observations.frames[0]), *(move.frame for move in found.moves), int(observations.frames[-1]) + 1]
    first, last = max(pairwise(bounds), key=lambda part: part[1] - part[0])
    try:
        refined, report = refine_rig(found.rig_at(first), observations.select(first, last))
    except InputError as error:
        return found.rig, {"verdict": "refused", "reasons": [str(error)]}
    if report["verdict"] != "ok":
        return found.rig, report
    moved = {move.camera for move in found.moves if move.frame <= first}
    cameras = [found.rig.cameras[i] if i in moved else c for i, c in enumerate(refined.cameras)]
    return replace(found.rig, cameras=tuple(cameras)), report


def _rate(observations: Observations, rate_hz: float | None) -> float:
    rate = observations.rate_hz if rate_hz is None else rate_hz
    if rate is None:
        raise InputError(f"tracking needs the frame rate: state it with --rate-hz ({observations.source})")
    if not 0 < rate < 1e6:
        raise InputError(f"{rate} Hz is no frame rate: state one above 0 with --rate-hz ({observations.source})")
    return rate


def _in_frames_of_one_clock(observations: Observations) -> Observations:
    """Cameras that number their frames apart, by their common time; other takes as they are."""
    time_s = observations.optional.get("time_s")
    if time_s is None or len(observations) == 0:
        return observations
    good = np.isfinite(time_s)
    start = time_s[good] - observations.frame[good] / (observations.rate_hz or 1.0)
    first = [start[observations.camera[good] == c] for c in np.unique(observations.camera[good])]
    middles = [float(np.median(own)) for own in first]
    if not middles or max(middles) - min(middles) <= 1.0 / (observations.rate_hz or 1.0):
        return observations
    framed = framed_by_time(observations)
    note = "the cameras number their frames apart: frames were numbered anew, by their time"
    return replace(framed, warnings=(*framed.warnings, note))


def _as_pushed(observations: Observations, rig: Rig) -> MatchedDots:
    """The dots as a live user pushes them: every camera of the rig takes part, and nothing is known of later frames."""
    if len(observations) == 0:
        raise InputError(f"there are no observations to track ({observations.source})")
    dots = match(observations, rig)
    sigma = observations.optional.get("sigma")
    if sigma is None:
        return dots
    own = np.where(np.isfinite(sigma) & (sigma > 0), sigma, 1.0)[dots.row]
    return replace(dots, sigma=own)


def _record(tracker: _core.Tracker, dots: MatchedDots, moments: Moments, progress: Progress | None) -> None:
    n = len(dots.frames)
    for first in range(0, n, CHUNK_FRAMES):
        last = min(first + CHUNK_FRAMES, n)
        tracker.record(
            dot_arrays(dots, first, last),
            dots.frames[first:last].tolist(),
            moments.times_s[first:last],
            moments.lags_s[first:last],
        )
        if progress:
            progress(last, n)


def _report(
    solved: dict[str, Any],
    dots: MatchedDots,
    cameras: Moves,
    tracker: _core.Tracker,
    notes: list[str],
    causal: bool,
    method: str,
    lag_s: Array | None,
) -> dict[str, Any]:
    frames = max(len(dots.frames), 1)
    measured = solved["kind"] == KINDS.index("measured")
    overfull = dots.frames[solved["overfull"]]
    if len(overfull):
        notes.append(
            f"{len(overfull)} frames, the first {overfull[0]}, hold so many unexplained dots that no new markers were "
            "looked for: check thresholds and stray light"
        )
    model = tracker.model().describe()
    return {
        "frames": len(dots.frames),
        "warnings": notes,
        "method": method,
        "causal": causal or method == "paper",
        "cameras": cameras.rig.ids,
        "points_per_frame": float(measured.sum() / frames),
        "predicted_per_frame": float((~measured).sum() / frames),
        "rays_mean": float(solved["sizes"][measured].mean()) if measured.any() else 0.0,
        "residual_px": statistics(solved["residual_px"][measured]),
        "residual_px_by_camera": residual_by_camera(solved, dots, cameras, lag_s),
        "certified_frames": float(solved["certified"].mean()) if len(solved["certified"]) else 0.0,
        "searched_dots": float(solved["searched_dots"].sum() / max(len(dots.camera), 1)),
        "noise_px": dict(zip(cameras.rig.ids, model["noise"], strict=True)),
        "model": model,
        "trajectories": len(np.unique(solved["track"][measured])),
    }
