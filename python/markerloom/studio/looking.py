"""What the page is told of an open take: its views, its timeline, its graphs."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import InputError
from markerloom.mending.feet import marked
from markerloom.mending.sheet import ABSENT, Sheet
from markerloom.rig import Camera
from markerloom.skeleton.contacts import Contact
from markerloom.skeleton.motion import angles
from markerloom.studio import chunks, messages
from markerloom.studio.opened import OpenTake
from markerloom.studio.videos import video_of
from markerloom.subjects import read_marker_set, read_subject
from markerloom.subjects.names import split_prefix

Array = NDArray[Any]
RATE_HZ = 100.0
"""Of takes that do not say theirs: for playing only."""
SAMPLED, GLANCES = 240, 8
"""Frames looked at to see which markers go together, and of those to see which are near each other at all."""
NEIGHBOURS = 12
LINKS_EACH = 3
RIGID_MM = 6.0
"""Markers are shown as linked whose distance varies less than this (robust standard deviation)."""
LONGEST_LINK_M = 0.6


def take_view(take: OpenTake) -> messages.TakeView:
    """Everything but the samples."""
    sheet, settings = take.sheet, take.settings
    colors, names = _known_markers(take)
    samples = [len(_runs(take, i)) and int(np.sum(_runs(take, i)[:, 1])) for i in range(len(sheet.trajectories))]
    rate = sheet.rate_hz or RATE_HZ
    warnings = list(take.warnings)
    if not sheet.rate_hz:
        warnings.append(f"the file does not tell its frame rate: it is played at {RATE_HZ:g} Hz")
    return messages.TakeView(
        name=settings.name,
        file=settings.file.rpartition("/")[2],
        revision=take.revision,
        first_frame=sheet.first,
        frames=sheet.count,
        rate_hz=rate,
        trajectories=[
            messages.TrajectoryView(
                slot=i,
                label=one.label,
                name=sheet.name(i),
                color=colors.get(split_prefix(one.label)[1], ""),
                samples=samples[i],
            )
            for i, one in enumerate(sheet.trajectories)
        ],
        links=_known_links(take),
        cameras=[camera_view(c, video=video_of(take, c) is not None) for c in (take.rig.cameras if take.rig else ())],
        has_dots=take.has_dots,
        dots_pending=take.dots_pending,
        residual_unit=take.residual_unit,  # pyright: ignore[reportArgumentType]
        typical_residual=take.remembered("typical", lambda: _typical_residual(sheet)),
        skeleton=_skeleton(take),
        contacts=_contacts(take),
        can_solve=bool(settings.skeleton),
        edits=[messages.EditView(op=m.edit.op, words=m.words, unfit=m.unfit) for m in take.made],
        can_undo=bool(take.made),
        can_redo=bool(take.undone),
        suggested_names=names,
        warnings=warnings,
        chunk_frames=chunks.frames_of(len(sheet.trajectories)),
        overview_stride=chunks.overview_stride(len(sheet.trajectories), sheet.count),
        export_name=f"{settings.name}-mended.c3d",
    )


def _known_markers(take: OpenTake) -> tuple[dict[str, str], list[str]]:
    """Colours by name, and all names that a marker of the take may have."""
    settings = take.settings
    subjects = [read_subject(s) for s in settings.subjects]
    worn = settings.marker_set or next((s.marker_set for s in subjects if s.marker_set), "")
    colors: dict[str, str] = {}
    names = [t.label for t in take.sheet.trajectories if t.label]
    for one in subjects:
        names += list(one.markers)
    if worn:
        known = take.remembered(f"set {worn}", lambda: read_marker_set(worn))
        colors = dict(zip(known.markers, known.colors, strict=True))
        prefix = {split_prefix(n)[0] for n in names}
        names += list(known.markers) if len(prefix) < 2 else []
    return colors, sorted(set(names))


def camera_view(camera: Camera, *, video: bool = False) -> messages.CameraView:
    """A camera to be drawn."""
    turn = np.asarray(camera.rotation)
    masked: list[tuple[float, float, float, float]] = []
    if camera.mask is not None:
        (width, height), (columns, _) = camera.mask.tile_px, camera.mask.grid
        for i in np.flatnonzero(camera.mask.tiles).tolist():
            x, y = i % columns * width - 0.5, i // columns * height - 0.5
            masked.append((x, y, x + width, y + height))
    axes = tuple(tuple(float(v) for v in row) for row in turn)
    return messages.CameraView(
        id=camera.id,
        name=camera.name,
        position_m=tuple(np.asarray(camera.position_m).tolist()),
        axes=axes,  # pyright: ignore[reportArgumentType]
        size_px=camera.size_px,
        focal_px=camera.focal_px,
        masked=masked,
        video=video,
    )


def _typical_residual(sheet: Sheet) -> float:
    step = max(1, sheet.count // SAMPLED)
    some = [t.samples["residual"][::step] for t in sheet.trajectories]
    values = np.concatenate(some) if some else np.zeros(0)
    values = values[np.isfinite(values)]
    return float(np.median(values)) if len(values) else 0.0


def _links(sheet: Sheet) -> list[tuple[int, int]]:
    """Pairs of markers to join by lines: those that keep their distance best, a few for each."""
    named = [i for i, t in enumerate(sheet.trajectories) if t.label]
    if len(named) < 2:
        return []
    step = max(1, sheet.count // SAMPLED)
    xyz_m = np.array([sheet.trajectories[i].xyz_mm[::step] for i in named]) / 1000.0
    found: set[tuple[int, int]] = set()
    for a, slot in enumerate(named):
        others = _nearest(xyz_m, a)
        apart = np.linalg.norm(xyz_m[others] - xyz_m[a], axis=2)
        count = np.isfinite(apart).sum(axis=1)
        others, apart = others[count >= min(5, xyz_m.shape[1])], apart[count >= min(5, xyz_m.shape[1])]
        middle = np.nanmedian(apart, axis=1) if len(apart) else np.zeros(0)
        spread = 1.48 * np.nanmedian(np.abs(apart - middle[:, None]), axis=1) if len(apart) else np.zeros(0)
        usable = np.flatnonzero((middle < LONGEST_LINK_M) & (spread < RIGID_MM / 1000.0))
        # Firm and near before firm and far.
        worth = usable[np.argsort((spread[usable] + 0.002) * (middle[usable] + 0.05), kind="stable")]
        pairs = [named[others[b]] for b in worth[:LINKS_EACH].tolist()]
        found |= {(min(slot, b), max(slot, b)) for b in pairs}
    return sorted(found)


def _known_links(take: OpenTake) -> list[tuple[int, int]]:
    """Links, found anew only when names changed."""
    named = [t.label for t in take.sheet.trajectories]
    known = take.kept.get("links")
    if known is None or known[0] != named:
        known = take.kept["links"] = (named, _links(take.sheet))
    return known[1]


def _nearest(xyz_m: Array, a: int) -> Array:
    """The markers that are nearest to one over the take (xyz_m: markers, frames, 3)."""
    few = xyz_m[:, :: max(1, xyz_m.shape[1] // GLANCES)]
    apart = np.linalg.norm(few - few[a], axis=2)
    known = np.isfinite(apart)
    mean = np.where(known, apart, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    mean[~known.any(axis=1)] = np.inf
    mean[a] = np.inf
    return np.argsort(mean, kind="stable")[: min(NEIGHBOURS, len(mean) - 1)]


def _skeleton(take: OpenTake) -> messages.SkeletonView | None:
    if take.motion is None:
        return None
    skeleton = take.motion.skeleton
    return messages.SkeletonView(
        joints=list(skeleton.joints),
        parents=list(skeleton.parents),
        ends=[s.joint for s in skeleton.sites],
        feet=list(_solve_report(take).get("feet", [])),
        stale=take.skeleton_stale,
    )


def _contacts(take: OpenTake) -> list[messages.ContactView]:
    """Contacts as they were found, and as marked since."""
    found = [Contact(c["site"], c["start"], c["stop"]) for c in _solve_report(take).get("contacts", [])]
    return [
        messages.ContactView(site=c.site, first=c.start, last=c.stop - 1) for c in marked(found, take.edits.of_contacts)
    ]


def _solve_report(take: OpenTake) -> dict[str, Any]:
    """What was reported when the skeleton was solved; nothing where it was not."""

    def read() -> dict[str, Any]:
        note = take.folder / "solve.json"
        return json.loads(note.read_text("utf-8")).get("report", {}) if note.is_file() else {}

    return take.remembered("solve report", read)


def _runs(take: OpenTake, slot: int) -> Array:
    """Runs of a trajectory (n, 3: start, length, kind), computed once for each of its versions."""
    one = take.sheet.trajectories[slot]
    known = take.kept.get(f"runs {slot}")
    if known is None or known[0] != one.version:
        known = take.kept[f"runs {slot}"] = (one.version, runs_of_kinds(one.kind))
    return known[1]


def runs_of_kinds(kinds: Array) -> Array:
    """Runs of samples of one kind (n, 3: start, length, kind)."""
    kinds = np.asarray(kinds)
    if len(kinds) == 0:
        return np.zeros((0, 3), np.int64)
    edges = np.flatnonzero(np.diff(kinds)) + 1
    starts = np.concatenate([[0], edges])
    lengths = np.diff(np.append(starts, len(kinds)))
    there = kinds[starts] != ABSENT
    return np.column_stack([starts, lengths, kinds[starts]])[there].astype(np.int64)


def timeline(take: OpenTake) -> messages.Timeline:
    """Every trajectory over the whole take."""
    runs = [_runs(take, i).ravel().tolist() for i in range(len(take.sheet.trajectories))]
    return messages.Timeline(revision=take.revision, runs=runs)


def series(take: OpenTake, slot: int, first: int, last: int, bins: int) -> messages.Series:
    """Graphs of a trajectory from row ``first`` to before ``last``."""
    sheet = take.sheet
    one = sheet.trajectories[slot]
    low, high = max(first - 1, 0), min(last + 1, sheet.count)
    part = slice(low, high)
    xyz = np.asarray(one.xyz_mm[part])
    speed = np.full(len(xyz), np.nan)
    if len(xyz) > 2:
        speed[1:-1] = np.linalg.norm(xyz[2:] - xyz[:-2], axis=1) / 2000.0 * (sheet.rate_hz or RATE_HZ)
    values = {"x": xyz[:, 0], "y": xyz[:, 1], "z": xyz[:, 2], "speed": speed}
    values |= {n: np.asarray(one.samples[k][part], float) for n, k in (("residual", "residual"), ("sigma", "sigma_mm"))}
    inner = slice(max(first, 0) - low, max(first, 0) - low + max(min(last, sheet.count) - max(first, 0), 0))
    return _thinned({n: v[inner] for n, v in values.items()}, max(first, 0) + sheet.first, bins)


def joint_series(take: OpenTake, joint: int, first: int, last: int, bins: int) -> messages.Series:
    """Turns of a joint against its parent (deg), in the order of its axes."""
    motion = take.motion
    if motion is None or joint >= len(motion.skeleton):
        raise InputError("the take has no such joint")
    part = motion.turns[max(first, 0) : last, joint]
    order = motion.skeleton.turns_about[joint] if joint else "XYZ"
    turns = np.degrees(np.unwrap(angles(order or "XYZ", part), axis=0)) if len(part) else np.zeros((0, 3))
    return _thinned(dict(zip("xyz", turns.T, strict=True)), max(first, 0) + take.sheet.first, bins)


def joints_mm(take: OpenTake) -> Array:
    """Places of joints, and of sites after them (frames, n, 3; mm)."""
    if take.motion is None:
        raise InputError("the take has no skeleton: process it with one")
    motion = take.motion
    return take.remembered("joints", lambda: 1000.0 * np.concatenate([motion.joints_m(), motion.sites_m()], axis=1))


def _thinned(values: dict[str, Array], first_frame: int, bins: int) -> messages.Series:
    count = len(next(iter(values.values())))
    starts = np.unique(np.linspace(0, count, min(bins, count), endpoint=False).astype(np.int64)) if count else []
    lows: dict[str, list[float | None]] = {}
    highs: dict[str, list[float | None]] = {}
    for name, column in values.items():
        for target, function, otherwise in ((lows, np.minimum, np.inf), (highs, np.maximum, -np.inf)):
            filled = np.where(np.isfinite(column), column, otherwise)
            found = function.reduceat(filled, starts) if count else np.zeros(0)
            target[name] = [round(float(v), 4) if np.isfinite(v) else None for v in found]
    return messages.Series(frames=[int(s) + first_frame for s in starts], lows=lows, highs=highs)
