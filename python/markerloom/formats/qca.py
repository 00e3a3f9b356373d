"""Qualisys .qca.txt: a rig calibrated by QTM.

Intrinsics are in 1/64 pixel; positions in millimetres. The rotation's rows are the camera's axes in world with Y up
and Z backwards, so Y and Z change sign. Verified on one rig: its cameras stand above the floor, upright, and look
at a common centre.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from markerloom.errors import FormatError
from markerloom.formats.xml_file import child, number, parse
from markerloom.rig import Camera, Lens, Rig

SUBPIXELS = 64.0


def read(path: str | Path) -> Rig:
    """Read a rig."""
    root = parse(path, "calibration", "Qualisys calibration")
    cameras = [_camera(e, path) for e in root.iter("camera") if e.get("active", "1") != "0"]
    if not cameras:
        raise FormatError(path, "no active camera in it")
    return Rig.of(cameras, source=str(path))


def _camera(element: Element, path: str | Path) -> Camera:
    owner = f"camera {element.get('serial')}"
    transform, intrinsic = (
        child(element, "transform", path, owner=owner),
        child(element, "intrinsic", path, owner=owner),
    )

    def pixels(name: str) -> float:
        return number(intrinsic, name, path) / SUBPIXELS

    rotation = np.array([[number(transform, f"r{i}{j}", path) for j in (1, 2, 3)] for i in (1, 2, 3)])
    k = [number(intrinsic, f"radialDistortion{i}", path) for i in (1, 2, 3)]
    p = [number(intrinsic, f"tangentalDistortion{i}", path) for i in (1, 2)]
    return Camera(
        id=element.get("serial") or "",
        size_px=(
            pixels("sensorMaxU") - pixels("sensorMinU") + 1,
            pixels("sensorMaxV") - pixels("sensorMinV") + 1,
        ),
        focal_px=(pixels("focalLengthU"), pixels("focalLengthV")),
        principal_px=(pixels("centerPointU"), pixels("centerPointV")),
        rotation=np.diag([1.0, -1.0, -1.0]) @ rotation,
        position_m=np.array([number(transform, axis, path) for axis in "xyz"]) / 1000.0,
        lens=Lens("brown_conrady", (k[0], k[1], p[0], p[1], k[2], 0.0, 0.0, 0.0)),
    )
