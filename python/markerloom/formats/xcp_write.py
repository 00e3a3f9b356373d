"""A rig as Vicon XCP. Vicon's lens runs from measured to ideal pixels, so that others are fitted by it, or refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from markerloom.errors import InputError
from markerloom.formats.files import write_text
from markerloom.rig import Camera, Rig

Array = NDArray[np.floating[Any]]

LARGEST_MISFIT_PX = 0.05
GRID = 25


def write(rig: Rig, path: str | Path) -> None:
    """Write the rig. Raises ``InputError`` where Vicon's lens cannot be a camera's within 0.05 px over its image."""
    root = ElementTree.Element("Cameras", SOURCE="markerloom", VERSION="2.0")
    for index, camera in enumerate(rig.cameras):
        focal, principal, lens = _vicon(rig, index, path)
        width, height = camera.size_px
        element = ElementTree.SubElement(
            root,
            "Camera",
            DEVICEID=camera.id,
            NAME=camera.name,
            PIXEL_ASPECT_RATIO=repr(camera.focal_px[1] / camera.focal_px[0]),
            SENSOR_SIZE=f"{width:g} {height:g}",
            USERID=str(index + 1),
        )
        frames = ElementTree.SubElement(element, "KeyFrames")
        ElementTree.SubElement(
            frames,
            "KeyFrame",
            FRAME="0",
            FOCAL_LENGTH=repr(float(focal)),
            PRINCIPAL_POINT=_text(principal),
            ORIENTATION=_text(Rotation.from_matrix(camera.rotation).as_quat()),
            POSITION=_text(1000.0 * camera.position_m),
            VICON_RADIAL2=f"Vicon3Parameter {_text(lens)}",
        )
    ElementTree.indent(root)
    write_text(path, '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n")


def _text(values: Array) -> str:
    return " ".join(repr(float(v)) for v in values)


def _vicon(rig: Rig, index: int, path: str | Path) -> tuple[float, Array, Array]:
    """Focal length, principal point, and cx, cy, k1, k2, k3."""
    camera = rig.cameras[index]
    principal = np.array(camera.principal_px)
    if camera.lens.model == "vicon_radial":
        return camera.focal_px[0], principal, np.array(camera.lens.coefficients)
    if camera.lens.model == "ideal":
        return camera.focal_px[0], principal, np.array([*principal, 0.0, 0.0, 0.0])
    measured, ideal = _samples(rig, index)
    reach = float(np.hypot(*camera.size_px)) / 2.0
    scale = np.array([1.0, 1.0, reach**-2, reach**-4, reach**-6])
    aspect = np.array([1.0, camera.focal_px[1] / camera.focal_px[0]])

    def misfit(p: Array) -> Array:
        offset = measured - p[3:5]
        r2 = np.sum(offset**2, axis=1)[:, None]
        k1, k2, k3 = p[5:8] * scale[2:]
        place = p[3:5] + offset * (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)))
        return ((place - p[1:3]) - p[0] * aspect * ideal).ravel()

    first = np.array([camera.focal_px[0], *principal, *principal, 0.0, 0.0, 0.0])
    fitted = least_squares(misfit, first, x_scale=[100.0, 10.0, 10.0, 10.0, 10.0, 0.1, 0.1, 0.1], method="trf")
    worst = float(np.abs(misfit(fitted.x)).max())
    if worst > LARGEST_MISFIT_PX:
        raise InputError(
            f"camera {camera.id}: Vicon's lens would be off by up to {worst:.2f} px ({LARGEST_MISFIT_PX} allowed); "
            f"write a .toml ({path})"
        )
    return fitted.x[0], fitted.x[1:3], np.concatenate([fitted.x[3:5], fitted.x[5:8] * scale[2:]])


def _samples(rig: Rig, index: int) -> tuple[Array, Array]:
    """Measured pixels over the image, and the ideal points they belong to."""
    camera: Camera = rig.cameras[index]
    width, height = camera.size_px
    x, y = np.meshgrid(np.linspace(0, width - 1, GRID), np.linspace(0, height - 1, GRID))
    measured = np.column_stack([x.ravel(), y.ravel()])
    ideal = rig.normalise(index, measured)
    good = np.isfinite(ideal).all(axis=1)
    return measured[good], ideal[good]
