"""Vicon XCP: a rig as calibrated by Nexus, Tracker, Shogun or Blade.

Verified on real rigs: ORIENTATION is a quaternion x y z w that turns world into camera axes, POSITION the camera in
world millimetres, FOCAL_LENGTH and PRINCIPAL_POINT in pixels. The lens maps measured to ideal pixels:
VICON_RADIAL2 = "Vicon3Parameter cx cy k1 k2 k3", in XCP 1.0 VICON_RADIAL = "k1 k2" about the principal point.
Masks are run-length coded: "r n value n value …" repeats, "v value value …" lists.
"""

from __future__ import annotations

import re
from datetime import datetime
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from markerloom.errors import FormatError
from markerloom.formats.xml_file import number, numbers, parse
from markerloom.rig import Camera, Conditions, Lens, Mask, Rig


def read(path: str | Path) -> Rig:
    """Read a rig; cameras without a calibrated key frame are left out with a warning."""
    root = parse(path, "Cameras", "Vicon XCP")
    cameras, warnings = [], []
    for element in root.iter("Camera"):
        frame = element.find("KeyFrames/KeyFrame")
        if frame is None or frame.get("FOCAL_LENGTH") is None or number(frame, "FOCAL_LENGTH", path) <= 0:
            warnings.append(f"camera {element.get('DEVICEID')} is not calibrated and left out")
            continue
        cameras.append(_camera(element, frame, path))
    if not cameras:
        raise FormatError(path, "no calibrated camera in it")
    return Rig.of(cameras, source=str(path), warnings=warnings)


def _camera(element: Element, frame: Element, path: str | Path) -> Camera:
    identity = element.get("DEVICEID")
    if not identity:
        raise FormatError(path, "a camera has no DEVICEID")
    width, height = numbers(element, "SENSOR_SIZE", path, 2)
    focal = number(frame, "FOCAL_LENGTH", path)
    aspect = number(element, "PIXEL_ASPECT_RATIO", path) if element.get("PIXEL_ASPECT_RATIO") else 1.0
    cx, cy = numbers(frame, "PRINCIPAL_POINT", path, 2)
    return Camera(
        id=identity,
        name=element.get("NAME") or "",
        size_px=(width, height),
        focal_px=(focal, focal * aspect),
        principal_px=(cx, cy),
        rotation=_rotation(numbers(frame, "ORIENTATION", path, 4)),
        position_m=np.array(numbers(frame, "POSITION", path, 3)) / 1000.0,
        lens=_lens(frame, (cx, cy), path),
        mask=_mask(element, (width, height), path),
        conditions=Conditions(*_when(element, "Calibration"), *_when(element, "Capture")),
    )


def _when(element: Element, name: str) -> tuple[datetime | None, float | None]:
    """Time (of the place where it was recorded) and temperature (°C) at the end of a calibration or capture."""
    event = element.find(name)
    if event is None:
        return None, None
    found = re.match(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d", event.get("END_TIME", ""))
    warmth = re.fullmatch(r"-?\d+(\.\d+)?", event.get("END_TEMP", ""))
    try:
        time = datetime.fromisoformat(found.group()) if found else None
    except ValueError:
        time = None
    return time, float(warmth.group()) if warmth else None


def _rotation(quaternion: list[float]) -> np.ndarray:
    x, y, z, w = np.array(quaternion) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _lens(frame: Element, principal: tuple[float, float], path: str | Path) -> Lens:
    text = frame.get("VICON_RADIAL2")
    if text:
        name, *values = text.split()
        if name != "Vicon3Parameter" or len(values) != 5:
            raise FormatError(path, f"unknown lens {text[:40]!r}", where="VICON_RADIAL2")
        return Lens("vicon_radial", tuple(float(v) for v in values))
    if frame.get("VICON_RADIAL"):
        k1, k2 = numbers(frame, "VICON_RADIAL", path, 2)
        return Lens("vicon_radial", (*principal, k1, k2, 0.0))
    return Lens()


def _mask(element: Element, size: tuple[float, float], path: str | Path) -> Mask | None:
    grid = element.find("ThresholdGrid")
    if grid is None or not grid.get("DATA"):
        return None
    columns, rows = (int(v) for v in numbers(grid, "GRID_SIZE", path, 2))
    tile = numbers(grid, "TILE_SIZE", path, 2)
    values = _run_lengths(grid.get("DATA", ""), columns * rows, path)
    if not any(values):
        return None
    if tile[0] * columns < size[0] * 0.5:
        raise FormatError(path, "the mask does not cover the sensor", where=f"camera {element.get('DEVICEID')}")
    return Mask((tile[0], tile[1]), (columns, rows), tuple(v > 0 for v in values))


def _run_lengths(text: str, expected: int, path: str | Path) -> list[int]:
    values: list[int] = []
    mode, count = "", -1
    for token in text.split():
        if token in ("r", "v"):
            mode, count = token, -1
        elif not token.isdigit():
            raise FormatError(path, f"unknown token {token[:20]!r}", where="ThresholdGrid")
        elif mode == "v":
            values.append(int(token))
        elif count < 0:
            count = int(token)
            if len(values) + count > expected:
                raise FormatError(path, "the mask is longer than its grid", where="ThresholdGrid")
        else:
            values.extend([int(token)] * count)
            count = -1
    if len(values) != expected:
        raise FormatError(path, f"the mask has {len(values)} tiles, its grid {expected}", where="ThresholdGrid")
    return values
