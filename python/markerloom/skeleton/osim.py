"""OpenSim: a model (.osim) with bodies, joints and markers, and its coordinates over time (.mot)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from markerloom.formats.files import write_text
from markerloom.skeleton.motion import Motion, angles
from markerloom.skeleton.skeleton import Skeleton

Array = NDArray[np.floating[Any]]
Glued = Sequence[tuple[str, int, Array]]
"""Markers: name, joint, place in the segment's axes (m)."""
MASS_KG = 1.0
AXES = {"X": "1 0 0", "Y": "0 1 0", "Z": "0 0 1"}


def write(motion: Motion, path: str | Path, markers: Glued = ()) -> tuple[Path, Path]:
    """Write PATH.osim and PATH.mot in the motion's axes; returns both paths.

    Every segment is a body of its own; a joint turns about its axes in its own order, balls as X, Y, Z; the root moves
    freely. Masses are placeholders: the model is for kinematics.
    """
    osim, mot = Path(path).with_suffix(".osim"), Path(path).with_suffix(".mot")
    text = Xml.tostring(_model(motion.skeleton, motion, markers), encoding="unicode")
    write_text(osim, f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n')
    columns = coordinates(motion)
    names = list(columns)
    lines = [f"{Path(path).stem}", "version=1", f"nRows={len(motion)}", f"nColumns={len(names) + 1}", "inDegrees=yes"]
    lines += ["endheader", "\t".join(["time", *names])]
    values = np.column_stack([np.arange(len(motion)) / motion.rate_hz, *columns.values()])
    lines += ["\t".join(f"{v:.9f}" for v in row) for row in values]
    write_text(mot, "\n".join(lines) + "\n")
    return osim, mot


def _order(skeleton: Skeleton, joint: int) -> str:
    return skeleton.turns_about[joint] or "XYZ"


def _turning(skeleton: Skeleton, motion: Motion, joint: int) -> list[str]:
    """The axes about which a joint turns in this motion, in its order."""
    order = _order(skeleton, joint)
    used = skeleton.free[joint].copy()
    used |= np.abs(angles(order, motion.turns[:, joint])).max(axis=0, initial=0.0) > 1e-9
    return [a for a in order if used["XYZ".index(a)]]


def coordinates(motion: Motion) -> dict[str, Array]:
    """Columns of the .mot: angles in degrees, the root's place in metres."""
    skeleton = motion.skeleton
    out: dict[str, Array] = {}
    root = np.unwrap(Rotation.from_matrix(motion.turns[:, 0]).as_euler("XYZ"), axis=0)
    for k, axis in enumerate("xyz"):
        out[f"{skeleton.joints[0]}_{axis}"] = np.rad2deg(root[:, k])
    for k, axis in enumerate("xyz"):
        out[f"{skeleton.joints[0]}_t{axis}"] = motion.root_m[:, k]
    for j in range(1, len(skeleton)):
        own = np.unwrap(angles(_order(skeleton, j), motion.turns[:, j]), axis=0)
        for axis in _turning(skeleton, motion, j):
            out[f"{skeleton.joints[j]}_{axis.lower()}"] = np.rad2deg(own[:, "XYZ".index(axis)])
    return out


def _model(skeleton: Skeleton, motion: Motion, markers: Glued) -> Xml.Element:
    document = Xml.Element("OpenSimDocument", Version="40000")
    model = Xml.SubElement(document, "Model", name=skeleton.name)
    _text(model, "gravity", "0 -9.80665 0")
    _text(model, "length_units", "meters")
    bodies = Xml.SubElement(Xml.SubElement(model, "BodySet"), "objects")
    joints = Xml.SubElement(Xml.SubElement(model, "JointSet"), "objects")
    for j, name in enumerate(skeleton.joints):
        body = Xml.SubElement(bodies, "Body", name=name)
        _text(body, "mass", str(MASS_KG))
        _text(body, "mass_center", "0 0 0")
        _text(body, "inertia", "0.01 0.01 0.01 0 0 0")
        _joint(joints, skeleton, motion, j)
    if markers:
        objects = Xml.SubElement(Xml.SubElement(model, "MarkerSet"), "objects")
        for name, joint, place in markers:
            marker = Xml.SubElement(objects, "Marker", name=name)
            _text(marker, "socket_parent_frame", f"/bodyset/{skeleton.joints[joint]}")
            _text(marker, "location", _numbers(place))
    return document


def _joint(joints: Xml.Element, skeleton: Skeleton, motion: Motion, j: int) -> None:
    name = skeleton.joints[j]
    turning = ["X", "Y", "Z"] if j == 0 else _turning(skeleton, motion, j)
    if not turning:
        joint = Xml.SubElement(joints, "WeldJoint", name=f"{name}_joint")
    else:
        joint = Xml.SubElement(joints, "CustomJoint", name=f"{name}_joint")
    _text(joint, "socket_parent_frame", f"{name}_parent")
    _text(joint, "socket_child_frame", f"{name}_child")
    if turning:
        _coordinates(joint, skeleton, j, turning)
    frames = Xml.SubElement(joint, "frames")
    above = "/ground" if j == 0 else f"/bodyset/{skeleton.joints[skeleton.parents[j]]}"
    for frame, body, place in (
        (f"{name}_parent", above, skeleton.offsets_m[j] if j else np.zeros(3)),
        (f"{name}_child", f"/bodyset/{name}", np.zeros(3)),
    ):
        offset = Xml.SubElement(frames, "PhysicalOffsetFrame", name=frame)
        _text(offset, "socket_parent", body)
        _text(offset, "translation", _numbers(place))
        _text(offset, "orientation", "0 0 0")
    if turning:
        _transform(joint, name, j, turning)


def _coordinates(joint: Xml.Element, skeleton: Skeleton, j: int, turning: list[str]) -> None:
    objects = Xml.SubElement(joint, "coordinates")
    name = skeleton.joints[j]
    for axis in turning:
        coordinate = Xml.SubElement(objects, "Coordinate", name=f"{name}_{axis.lower()}")
        low, high = (-4 * np.pi, 4 * np.pi) if j == 0 else skeleton.limits_rad[j]["XYZ".index(axis)]
        if skeleton.turns_about[j] == "" or high <= low:
            low, high = -2 * np.pi, 2 * np.pi
        _text(coordinate, "range", f"{low:.9f} {high:.9f}")
    for axis in "xyz" if j == 0 else "":
        coordinate = Xml.SubElement(objects, "Coordinate", name=f"{name}_t{axis}")
        _text(coordinate, "range", "-100 100")


def _transform(joint: Xml.Element, name: str, j: int, turning: list[str]) -> None:
    spatial = Xml.SubElement(joint, "SpatialTransform")
    axes = [*turning, *(a for a in "XYZ" if a not in turning)]
    for number, axis in enumerate(axes, start=1):
        row = Xml.SubElement(spatial, "TransformAxis", name=f"rotation{number}")
        _function(row, f"{name}_{axis.lower()}" if axis in turning else None, AXES[axis])
    for number, axis in enumerate("xyz", start=1):
        row = Xml.SubElement(spatial, "TransformAxis", name=f"translation{number}")
        _function(row, f"{name}_t{axis}" if j == 0 else None, AXES[axis.upper()])


def _function(row: Xml.Element, coordinate: str | None, axis: str) -> None:
    _text(row, "coordinates", coordinate or "")
    _text(row, "axis", axis)
    if coordinate:
        _text(Xml.SubElement(row, "LinearFunction", name="function"), "coefficients", "1 0")
    else:
        _text(Xml.SubElement(row, "Constant", name="function"), "value", "0")


def _text(parent: Xml.Element, tag: str, text: str) -> None:
    Xml.SubElement(parent, tag).text = text


def _numbers(values: Array) -> str:
    return " ".join(f"{float(v):.9f}" for v in values)
