"""C3D as points; the lossless file itself is `markerloom._core.C3d`.

Kinds and sigmas have no place in a C3D sample, so they stand in a group MARKERLOOM: KINDS, KINDS2, … (bytes) and
SIGMAS, SIGMAS2, … (floats, mm), frame by frame, all points of a frame in order, absent samples included.

Angles, forces, moments and powers that a model wrote stand among a file's points, too; those that POINT:ANGLES and its
like name are no places and are left out. Segments' poses stand in a section of their own (group ROTATION, C-Motion).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from markerloom import _core
from markerloom.errors import BytesError, FormatError, InputError
from markerloom.formats.files import read_bytes, write_bytes
from markerloom.points import MEASURED, Points

SCALE = 0.02
TO_MM = {"mm": 1.0, "millimeters": 1.0, "cm": 10.0, "m": 1000.0, "meters": 1000.0, "in": 25.4, "": 1.0}
GROUP = "MARKERLOOM"
OUTPUTS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS")
"""Parameters of POINT that name what a model wrote."""
Y_TO_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
NEARLY_SQUARE = 1e-3
"""A matrix is no rotation where its product with its transpose is farther from one than this."""
CHUNK_BYTES = 255 * 250
CHUNK_FLOATS = 255 * 62


def read_file(path: str | Path) -> _core.C3d:
    """The whole file, as it is; a file whose data are cut off is refused."""
    try:
        file = _core.C3d.read(read_bytes(path))
    except BytesError as error:
        raise FormatError(path, str(error)) from None
    cut = [w for w in file.warnings if w.startswith("the file announces")]
    if cut:
        raise FormatError(path, f"{cut[0]}: it is cut off; copy it again from its source")
    return file


def write_file(file: _core.C3d, path: str | Path) -> None:
    """Write a whole file."""
    try:
        data = file.write()
    except BytesError as error:
        raise InputError(f"{path} cannot be written as C3D: {error}") from None
    write_bytes(path, data)


@dataclass(frozen=True)
class Angles:
    """What a model says of joints: ``labels``, ``descriptions``, ``values_deg`` (frames, labels, 3; NaN: none) and
    ``kind`` (frames, labels).
    """

    labels: list[str]
    descriptions: list[str]
    values_deg: np.ndarray
    kind: np.ndarray


@dataclass(frozen=True)
class Segments:
    """Poses of segments: ``labels``, ``place_mm`` (frames, labels, 3) and ``turn`` (frames, labels, 3, 3), NaN where
    there is none. Z up, in the segments' own axes.
    """

    labels: list[str]
    place_mm: np.ndarray
    turn: np.ndarray


@dataclass(frozen=True)
class Columns:
    """A file as columns: ``xyz_mm`` (frames, slots, 3; Z up), ``present``, ``kind``, ``sigma_mm`` (NaN: not known),
    ``residual_mm`` (NaN: not known), ``camera_mask`` (frames, slots); labels of the slots, ``*1`` and so on without.
    """

    labels: list[str]
    xyz_mm: np.ndarray
    present: np.ndarray
    kind: np.ndarray
    sigma_mm: np.ndarray
    residual_mm: np.ndarray
    camera_mask: np.ndarray
    rate_hz: float | None
    tracked: bool


def read_columns(path: str | Path) -> Columns:
    """The points of a file as columns, in millimetres, Z up: less memory than one row for each point."""
    file = read_file(path)
    unit_mm = _unit_mm(file, path)
    xyz = file.coordinates()
    xyz *= unit_mm
    residual, mask = file.residuals()
    present = (residual >= 0) & np.isfinite(xyz).all(axis=2)
    frames, slots, _ = xyz.shape
    if _y_up(file):
        xyz = np.stack([xyz[..., 0], -xyz[..., 2], xyz[..., 1]], axis=2)
    labels = _labels(file, slots)
    kind, sigma = _own(file, frames, slots)
    outputs = {name for group in OUTPUTS for name in file.strings("POINT", group)}
    places = slice(None) if outputs.isdisjoint(labels) else [i for i, n in enumerate(labels) if n not in outputs]
    labels = [n for n in labels if n not in outputs]
    return Columns(
        labels=labels,
        xyz_mm=xyz[:, places],
        present=present[:, places],
        kind=kind[:, places],
        sigma_mm=sigma[:, places],
        residual_mm=np.where(residual > 0, residual * unit_mm, np.nan)[:, places],
        camera_mask=mask[:, places],
        rate_hz=float(file.rate_hz) if file.rate_hz > 0 else None,
        tracked=(file.number(GROUP, "TRACKED") or 0) > 0 or not any(n.startswith("*") for n in labels),
    )


def _unit_mm(file: _core.C3d, path: str | Path) -> float:
    unit = (file.strings("POINT", "UNITS") or ["mm"])[0].strip().lower()
    if unit not in TO_MM:
        raise FormatError(path, f"unknown unit {unit!r}", where="POINT:UNITS")
    return TO_MM[unit]


def _y_up(file: _core.C3d) -> bool:
    return (file.strings("POINT", "Y_SCREEN") or [""])[0].strip().upper() == "+Y"


def read_segments(path: str | Path) -> tuple[Segments, float | None]:
    """The segments' poses of a file, without the ending _4X4 of their labels, and the file's rate (Hz).

    Raises ``FormatError`` where there is none, or more than one for each frame.
    """
    file = read_file(path)
    values = file.rotations().astype(float)
    labels = segment_names(file)
    if not values.shape[1]:
        raise FormatError(path, "holds no poses of segments (a group ROTATION)")
    if len(labels) != values.shape[1] or len(set(labels)) != len(labels):
        where = "ROTATION:LABELS"
        raise FormatError(path, f"there are {values.shape[1]} poses a frame for {len(set(labels))} names", where=where)
    matrix = values[..., :16].reshape(*values.shape[:2], 4, 4).swapaxes(2, 3)
    turn, place = matrix[..., :3, :3], matrix[..., :3, 3] * _unit_mm(file, path)
    if _y_up(file):
        turn, place = Y_TO_Z_UP @ turn, place @ Y_TO_Z_UP.T
    square = np.abs(turn @ turn.swapaxes(2, 3) - np.eye(3)).max(axis=(2, 3)) < NEARLY_SQUARE
    good = square & (values[..., 16] >= 0) & np.isfinite(place).all(axis=2)
    turn, place = np.where(good[..., None, None], turn, np.nan), np.where(good[..., None], place, np.nan)
    return Segments(labels, place, turn), float(file.rate_hz) if file.rate_hz > 0 else None


def segment_names(file: _core.C3d) -> list[str]:
    """The segments whose poses a file holds."""
    return [n.removesuffix("_4X4") for n in file.strings("ROTATION", "LABELS")]


def read(path: str | Path) -> Points:
    """The points of a file, in millimetres, Z up."""
    columns = read_columns(path)
    present = columns.present
    frame, slot = np.nonzero(present)
    names = np.array(["" if name.startswith("*") else name for name in columns.labels] or [""], dtype=str)
    return Points.of(
        frame.astype(np.int64),
        slot.astype(np.int64),
        columns.xyz_mm[present],
        label=names[slot],
        kind=columns.kind[present].astype(np.int64),
        sigma_mm=columns.sigma_mm[present],
        residual_mm=columns.residual_mm[present],
        camera_mask=columns.camera_mask[present].astype(np.int64),
        rate_hz=columns.rate_hz,
        frames=np.arange(len(present)),
        source=str(path),
        tracked=columns.tracked,
    )


def _labels(file: _core.C3d, slots: int) -> list[str]:
    labels = file.strings("POINT", "LABELS")[:slots]
    return labels + [f"*{i + 1}" for i in range(len(labels), slots)]


def _own(file: _core.C3d, frames: int, slots: int) -> tuple[np.ndarray, np.ndarray]:
    kinds = np.full((frames, slots), MEASURED, np.int8)
    sigmas = np.full((frames, slots), np.nan)
    for name, target in (("KINDS", kinds), ("SIGMAS", sigmas)):
        parts: list[np.ndarray] = []
        for i in range(1, 100_000):
            part = file.numbers(GROUP, name if i == 1 else f"{name}{i}")
            if not part:
                break
            parts.append(np.array(part, target.dtype))
        values = np.concatenate([*parts, np.zeros(0, target.dtype)])
        if len(values) >= frames * slots > 0:
            target[:] = values[: frames * slots].reshape(frames, slots)
    np.copyto(sigmas, np.nan, where=sigmas < 0)
    return kinds, sigmas


def write(points: Points, path: str | Path, angles: Angles | None = None, segments: Segments | None = None) -> None:
    """Write points as a new file: float, mm, first frame 1; with the angles of joints and segments' poses (Z up) of the
    same frames.
    """
    rate = points.rate_hz
    if rate is None:
        raise InputError(f"a C3D needs a frame rate: state it with --rate-hz ({path})")
    names, slot = points.slots()
    frames, slots = len(points.frames), len(names)
    row = np.searchsorted(points.frames, points.frame)
    xyz = np.zeros((frames, slots, 3))
    words = np.full((frames, slots), -1.0)
    sigmas = np.full((frames, slots), -1.0)
    kinds = np.zeros((frames, slots), np.uint8)
    xyz[row, slot] = points.xyz_mm
    words[row, slot] = _words(points)
    sigmas[row, slot] = np.where(np.isfinite(points.sigma_mm), points.sigma_mm, -1.0)
    kinds[row, slot] = points.kind
    if angles is not None:
        told = np.isfinite(angles.values_deg).all(axis=2)
        xyz = np.concatenate([xyz, np.nan_to_num(angles.values_deg)], axis=1)
        words = np.concatenate([words, np.where(told, 0.0, -1.0)], axis=1)
        sigmas = np.concatenate([sigmas, np.full(told.shape, -1.0)], axis=1)
        kinds = np.concatenate([kinds, angles.kind.astype(np.uint8)], axis=1)
    file = _core.C3d.empty(rate, 1)
    file.set_points(xyz, words)
    _set_standard_groups(file, names, frames, rate, angles)
    file.set_text("POINT", "X_SCREEN", "+X")
    file.set_text("POINT", "Y_SCREEN", "+Y" if points.up_axis == "y" else "+Z")
    _set_own_group(file, kinds, sigmas, points)
    if segments is not None:
        _set_segments(file, segments, rate, points.up_axis)
    write_file(file, path)


def _set_segments(file: _core.C3d, segments: Segments, rate: float, up: str) -> None:
    axes = Y_TO_Z_UP.T if up == "y" else np.eye(3)
    names = [f"{n}_4X4" for n in segments.labels]
    for name, value in (("USED", len(names)), ("RATIO", 1), ("DATA_START", 0)):
        file.set_ints("ROTATION", name, [value])
    file.set_floats("ROTATION", "RATE", [rate])
    file.set_strings("ROTATION", "LABELS", names)
    file.set_strings("ROTATION", "DESCRIPTIONS", names)
    frames = len(segments.turn)
    matrix = np.tile(np.eye(4), (frames, len(names), 1, 1))
    matrix[..., :3, :3], matrix[..., :3, 3] = axes @ segments.turn, segments.place_mm @ axes.T
    values = np.zeros((frames, len(names), 17))
    values[..., :16] = matrix.swapaxes(2, 3).reshape(frames, len(names), 16)
    values[..., 16] = np.where(np.isfinite(matrix).all(axis=(2, 3)), 0.0, -1.0)
    file.set_rotations(values)


def _words(points: Points) -> np.ndarray:
    """Residual words: at least one step for what was measured, 0 for what was not, cameras 1–7 in the high byte."""
    steps = np.clip(np.round(np.nan_to_num(points.residual_mm) / SCALE), 1, 255)
    measured = points.kind == MEASURED
    return np.where(measured, steps + 256 * (points.camera_mask & 0x7F), 0.0)


def _set_standard_groups(
    file: _core.C3d, names: list[str], frames: int, rate: float, angles: Angles | None = None
) -> None:
    said = names
    if angles is not None:
        names, said = names + angles.labels, names + angles.descriptions
        file.set_strings("POINT", "ANGLES", angles.labels)
        file.set_text("POINT", "ANGLE_UNITS", "deg")
    file.set_ints("POINT", "USED", [len(names)])
    file.set_floats("POINT", "SCALE", [-SCALE])
    file.set_floats("POINT", "RATE", [rate])
    file.set_ints("POINT", "DATA_START", [0])
    file.set_ints("POINT", "FRAMES", [min(frames, 65_535)])
    file.set_strings("POINT", "LABELS", names)
    file.set_strings("POINT", "DESCRIPTIONS", said)
    file.set_text("POINT", "UNITS", "mm")
    file.set_ints("ANALOG", "USED", [0])
    file.set_ints("ANALOG", "OFFSET", [], [0])
    file.set_floats("ANALOG", "SCALE", [], [0])
    file.set_floats("ANALOG", "GEN_SCALE", [1.0])
    file.set_floats("ANALOG", "RATE", [rate])
    file.set_ints("FORCE_PLATFORM", "USED", [0])
    file.set_ints("TRIAL", "ACTUAL_START_FIELD", [1, 0], [2])
    file.set_ints("TRIAL", "ACTUAL_END_FIELD", [frames & 0xFFFF, frames >> 16], [2])
    file.set_floats("TRIAL", "CAMERA_RATE", [rate])
    file.set_text("MANUFACTURER", "SOFTWARE", "markerloom")


def _set_own_group(file: _core.C3d, kinds: np.ndarray, sigmas: np.ndarray, points: Points) -> None:
    file.set_ints(GROUP, "VERSION", [1])
    file.set_ints(GROUP, "TRACKED", [int(points.tracked)])
    if np.any(kinds):
        flat = kinds.ravel().tobytes()
        for i, start in enumerate(range(0, len(flat), CHUNK_BYTES)):
            part = flat[start : start + CHUNK_BYTES]
            rows = -(-len(part) // 255)
            padded = part + bytes(255 * rows - len(part))
            file.set_bytes(GROUP, "KINDS" if i == 0 else f"KINDS{i + 1}", padded, [255, rows])
    if np.any(sigmas >= 0):
        values = sigmas.ravel().astype(np.float32)
        for i, start in enumerate(range(0, len(values), CHUNK_FLOATS)):
            part = values[start : start + CHUNK_FLOATS]
            rows = -(-len(part) // 255)
            padded = np.append(part, np.full(255 * rows - len(part), -1, np.float32))
            file.set_floats(GROUP, "SIGMAS" if i == 0 else f"SIGMAS{i + 1}", padded.tolist(), [255, rows])
