"""What the cameras had: centroids and whose they are, reprojections, coverage, and why a marker is missing."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.bumped import Moves
from markerloom.errors import InputError, MarkerloomError
from markerloom.explain import CAUSES, CameraView, Seen, TrackedTake, explain
from markerloom.formats import table_file
from markerloom.mending.dots import excluded, left_out
from markerloom.mending.edits import DotEdit
from markerloom.mending.sheet import ABSENT
from markerloom.observations import MatchedDots, Observations, match
from markerloom.points import KINDS, Points
from markerloom.project.process import ASSIGNMENTS, read_dots
from markerloom.rig import Rig
from markerloom.studio import messages
from markerloom.studio.opened import OpenTake

Array = NDArray[Any]
CELLS = 16
"""Cells across an image in a coverage map."""
AROUND_S = 30.0
"""A gap is explained by the samples within this time (s)."""


@dataclass(frozen=True)
class CameraDots:
    """The take's centroids: those that were reconstructed from, those that edits had left out, and ``seen``: the former
    with their owners' tracks (−1: nobody's).
    """

    used: Observations
    out: Observations
    seen: Seen


def dots_of(take: OpenTake) -> CameraDots:
    """The centroids of a take, read when they are first looked at."""
    with take.lock:
        known = take.kept.get("dots")
        if known is None:
            if not take.has_dots or take.rig is None:
                raise InputError("the take has no centroids: only its 3D points are known")
            known = take.kept["dots"] = _read(take, take.rig)  # pyright: ignore[reportArgumentType]
        return known  # pyright: ignore[reportReturnType]


def _read(take: OpenTake, rig: Rig) -> CameraDots:
    every = read_dots(take.settings)
    gone = _union(every, take.processed.of_dots)
    used = left_out(every, gone)
    dots = match(used, rig)
    owner = np.full((2, len(dots.camera)), -1, np.int64)
    file = take.folder / ASSIGNMENTS
    if file.is_file():
        table = table_file.read(file)
        cameras = {camera: i for i, camera in enumerate(rig.ids)}
        told = np.array([cameras.get(str(c), -1) for c in table.column("camera").to_pylist()], np.int64)
        keys = [table.column(n).to_numpy() for n in ("frame", "observation", "track")]
        owner = _owners(dots, keys[0], told, keys[1], keys[2])
    noise = json.loads((take.folder / "track.json").read_text("utf-8"))["report"].get("noise_px", {})
    noise_px = tuple(float(noise.get(c) or 0.1) for c in rig.ids)
    return CameraDots(used, left_out(every, ~gone), Seen(Moves(rig), dots, owner[0], owner[1], noise_px))


def _owners(dots: MatchedDots, frame: Array, camera: Array, observation: Array, track: Array) -> Array:
    """The track of each dot, and the other one of a dot of two markers (2, n), from rows of an assignments table."""
    of_dot = np.repeat(dots.frames, np.diff(dots.starts))
    mine = np.rec.fromarrays([of_dot, dots.camera, dots.observation])
    if len(track) == 0:
        return np.full((2, len(mine)), -1, np.int64)
    theirs = np.rec.fromarrays([frame.astype(np.int64), camera, observation.astype(np.int64)])
    order = np.argsort(theirs, order=("f0", "f1", "f2"), kind="stable")
    first = np.searchsorted(theirs[order], mine)
    at = np.minimum([first, first + 1], len(order) - 1)
    found = theirs[order][at] == mine
    found[1] &= at[1] > first
    return np.where(found, track[order][at], -1)


def dots_view(take: OpenTake, frame: int) -> messages.DotsView:
    """All centroids of a frame, and where every marker must be seen."""
    rig, cameras = take.rig, []
    if rig is None:
        raise InputError("the take has no calibration: there is no camera to look through (view it with --calibration)")
    row = frame - take.sheet.first
    slots, places = _places(take, row)
    known = dots_of(take) if take.has_dots else None
    slot_of = _slots_by_origin(take, row)
    gone = _excluded_rows(take, known) if known and take.dots_pending else None
    for i, camera in enumerate(rig.cameras):
        dots = [*_dots(known, i, frame, slot_of, gone), *_left_out(take, known, i, frame)] if known else []
        pixels = rig.project(i, places / 1000.0) if len(slots) else np.zeros((0, 2))
        reprojections = [
            messages.ReprojectionView(slot=s, x=float(x), y=float(y))
            for s, (x, y) in zip(slots, pixels, strict=True)
            if np.isfinite(x + y) and 0 <= x < camera.size_px[0] and 0 <= y < camera.size_px[1]
        ]
        cameras.append(messages.CameraFrame(camera=camera.id, dots=dots, reprojections=reprojections))
    return messages.DotsView(frame=frame, cameras=cameras)


def _places(take: OpenTake, row: int) -> tuple[list[int], Array]:
    if not 0 <= row < take.sheet.count:
        return [], np.zeros((0, 3))
    slots = [i for i, t in enumerate(take.sheet.trajectories) if t.kind[row] != ABSENT]
    return slots, np.array([take.sheet.trajectories[i].xyz_mm[row] for i in slots]).reshape(-1, 3)


def _slots_by_origin(take: OpenTake, row: int) -> dict[int, int]:
    """Of each track, as tracked, the trajectory that has its sample now."""
    found = {}
    for i, one in enumerate(take.sheet.trajectories):
        if "origin" in one.samples and 0 <= row < take.sheet.count and one.kind[row] != ABSENT:
            origin = int(one.samples["origin"][row])
            if origin >= 0:
                found[origin] = i
    return found


def _dots(
    known: CameraDots, camera: int, frame: int, slot_of: dict[int, int], gone: Array | None
) -> list[messages.DotView]:
    """The centroids of a camera in a frame; ``gone``: those that are excluded since the take was reconstructed."""
    dots = known.seen.dots
    index = int(np.searchsorted(dots.frames, frame))
    if index == len(dots.frames) or dots.frames[index] != frame:
        return []
    rows = np.arange(int(dots.starts[index]), int(dots.starts[index + 1]))
    return [
        messages.DotView(
            x=float(dots.pixel[r, 0]),
            y=float(dots.pixel[r, 1]),
            observation=int(dots.observation[r]),
            slot=slot_of.get(int(known.seen.track[r]), -1),
            excluded=gone is not None and bool(gone[dots.row[r]]),
        )
        for r in rows[dots.camera[rows] == camera].tolist()
    ]


def _excluded_rows(take: OpenTake, known: CameraDots) -> Array:
    """Of the centroids that were reconstructed from, which are excluded since."""
    return take.remembered("excluded now", lambda: _union(known.used, take.edits.of_dots))


def _union(dots: Observations, edits: list[DotEdit]) -> Array:
    """Which centroids any of some edits leaves out."""
    gone = np.zeros(len(dots), bool)
    for edit in edits:
        with suppress(InputError):
            gone |= excluded(dots, edit)
    return gone


def _left_out(take: OpenTake, known: CameraDots, camera: int, frame: int) -> list[messages.DotView]:
    """Centroids that were left out when the take was reconstructed."""
    out, name = known.out, take.rig.cameras[camera].id if take.rig else ""
    if len(out) == 0 or name not in out.camera_ids:
        return []
    rows = np.flatnonzero((out.frame == frame) & (out.camera == out.camera_ids.index(name)))
    return [
        messages.DotView(x=float(x), y=float(y), observation=-1, slot=-1, excluded=True)
        for x, y in out.pixel[rows].tolist()
    ]


def coverage_views(take: OpenTake) -> list[messages.CoverageView]:
    """Where in its image each camera saw something, over the whole take."""
    known = dots_of(take)
    dots, rig = known.seen.dots, known.seen.cameras.rig
    report = json.loads((take.folder / "track.json").read_text("utf-8"))["report"]
    by_camera = report.get("residual_px_by_camera", {})
    found = []
    for i, camera in enumerate(rig.cameras):
        own = dots.camera == i
        width, height = camera.size_px
        rows = max(1, round(CELLS * height / width))
        counts, _, _ = np.histogram2d(
            dots.pixel[own, 1], dots.pixel[own, 0], bins=(rows, CELLS), range=((0, height), (0, width))
        )
        found.append(
            messages.CoverageView(
                camera=camera.id,
                columns=CELLS,
                rows=rows,
                counts=counts.astype(int).ravel().tolist(),
                dots=int(own.sum()),
                used=int((known.seen.track[own] >= 0).sum()),
                residual_px=float(by_camera.get(camera.id) or 0.0),
            )
        )
    return found


def why(take: OpenTake, slot: int, frame: int) -> messages.Why:
    """Why a marker is missing in a frame, or what it is made of there."""
    sheet = take.sheet
    one, row = sheet.trajectories[slot], frame - sheet.first
    if not 0 <= row < sheet.count:
        raise InputError(f"frame {frame} is not in the take")
    text = _state(take, slot, row)
    if not take.has_dots:
        return messages.Why(text=f"{text} What the cameras saw is not in this file.", lines=[], rays=[])
    known = dots_of(take)
    origin = int(one.samples["origin"][row]) if one.kind[row] != ABSENT else -1
    track = origin if origin >= 0 else _nearest_origin(one.samples["origin"], one.kind, row)
    try:
        found = explain(_around(take, known, slot, track, row), track, frame)
    except MarkerloomError as error:
        return messages.Why(text=f"{text} {error}", lines=[], rays=[])
    slot_of = _slots_by_origin(take, row)
    lines = [_line(take, view, slot_of) for view in found.cameras]
    return messages.Why(text=text, lines=lines, rays=_rays(known, frame, track))


def _state(take: OpenTake, slot: int, row: int) -> str:
    """What a trajectory is in a frame, in a sentence."""
    sheet = take.sheet
    one = sheet.trajectories[slot]
    seen = np.flatnonzero(one.kind != ABSENT)
    name, frame = sheet.name(slot), row + sheet.first
    if one.kind[row] != ABSENT:
        sigma = float(one.samples["sigma_mm"][row])
        sure = f", within {sigma:.2f} mm" if np.isfinite(sigma) else ""
        return f"{name} is {KINDS[int(one.kind[row])]} in frame {frame}{sure}."
    before, after = seen[seen < row], seen[seen > row]
    if len(before) == 0 or len(after) == 0:
        edge = "begins only in frame" if len(before) == 0 else "ends in frame"
        at = int(after[0] if len(before) == 0 else before[-1]) + sheet.first if len(seen) else frame
        return f"{name} is not there: it {edge} {at}." if len(seen) else f"{name} has no samples."
    first, last = int(before[-1]) + 1, int(after[0]) - 1
    seconds = (last - first + 1) / sheet.rate_hz if sheet.rate_hz else 0.0
    return (
        f"{name} is missing from frame {first + sheet.first} to {last + sheet.first} "
        f"({last - first + 1} frames{f', {seconds:.2f} s' if seconds else ''})."
    )


def _nearest_origin(origin: Array, kind: Array, row: int) -> int:
    seen = np.flatnonzero((kind != ABSENT) & (origin >= 0))
    return int(origin[seen[np.argmin(np.abs(seen - row))]]) if len(seen) else -1


def _around(take: OpenTake, known: CameraDots, slot: int, track: int, row: int) -> TrackedTake:
    """The samples of one trajectory around a frame, as the tracker's own take."""
    sheet = take.sheet
    margin = round(AROUND_S * (sheet.rate_hz or 100.0))
    points = sheet.window(row - margin, row + margin + 1, [slot])
    columns = {n: getattr(points, n) for n in Points.__dataclass_fields__}
    return TrackedTake(**{**columns, "track": np.full(len(points), track)}, seen=known.seen)


def _line(take: OpenTake, view: CameraView, slot_of: dict[int, int]) -> str:
    text = f"camera {view.camera}: {CAUSES[view.cause]}"
    if view.cause == "taken" and view.track in slot_of:
        text += f" ({take.sheet.name(slot_of[view.track])})"
    if np.isfinite(view.distance_px):
        text += f"; {view.distance_px:.2f} px away, {view.allowed_px:.2f} px allowed"
    return text


def _rays(known: CameraDots, frame: int, track: int) -> list[messages.RayView]:
    """Rays of the centroids that a track has in a frame."""
    dots, rig = known.seen.dots, known.seen.cameras.rig_at(frame)
    index = int(np.searchsorted(dots.frames, frame))
    if index == len(dots.frames) or dots.frames[index] != frame:
        return []
    rows = np.arange(int(dots.starts[index]), int(dots.starts[index + 1]))
    found = []
    used = (known.seen.track[rows] == track) | (known.seen.other[rows] == track)
    for r in rows[used].tolist():
        camera = int(dots.camera[r])
        x, y, z = rig.rays(camera, dots.pixel[r][None])[0].tolist()
        found.append(messages.RayView(camera=rig.cameras[camera].id, direction=(x, y, z)))
    return found
