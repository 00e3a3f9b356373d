"""Motive .mcal: a rig calibrated by OptiTrack Motive.

The "standard camera model" of the file is OpenCV's lens. Positions are metres, Y up; the orientation's columns are the
camera's axes in world with Y up and Z backwards. The world is turned to Z up by (x, y, z) → (x, −z, y). Verified on
one rig only as far as its cameras stand above the floor, upright, and look at a common centre.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from markerloom.errors import FormatError
from markerloom.formats.xml_file import child, number, parse
from markerloom.rig import Camera, Lens, Rig

Z_UP_FROM_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def read(path: str | Path) -> Rig:
    """Read a rig."""
    root = parse(path, "calibrationProfile", "Motive calibration")
    cameras = [_camera(e, path) for e in root.iter("Camera")]
    if not cameras:
        raise FormatError(path, "no camera in it")
    return Rig.of(cameras, source=str(path))


def _camera(element: Element, path: str | Path) -> Camera:
    owner = f"camera {element.get('Serial')}"
    attributes = child(element, "Attributes", path, owner=owner)
    lens = child(element, "IntrinsicStandardCameraModel", path, owner=owner)
    pose = child(element, "Extrinsic", path, owner=owner)
    world_from_camera = np.array([number(pose, f"OrientMatrix{i}", path) for i in range(9)]).reshape(3, 3)
    position = np.array([number(pose, axis, path) for axis in "XYZ"])
    k = [number(lens, f"k{i}", path) for i in (1, 2, 3)]
    tangential = (number(lens, "TangentialX", path), number(lens, "TangentialY", path))
    return Camera(
        id=element.get("Serial") or "",
        name=child(element, "Properties", path, owner=owner).get("CameraID") or "",
        size_px=(number(attributes, "ImagerPixelWidth", path), number(attributes, "ImagerPixelHeight", path)),
        focal_px=(number(lens, "HorizontalFocalLength", path), number(lens, "VerticalFocalLength", path)),
        principal_px=(number(lens, "LensCenterX", path), number(lens, "LensCenterY", path)),
        rotation=np.diag([1.0, -1.0, -1.0]) @ world_from_camera.T @ Z_UP_FROM_Y_UP.T,
        position_m=Z_UP_FROM_Y_UP @ position,
        lens=Lens("brown_conrady", (k[0], k[1], *tangential, k[2], 0.0, 0.0, 0.0)),
    )
