"""Motions and skeletons in files: which ending is which format, units, axes and rest poses at the door."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import InputError
from markerloom.formats import write_points
from markerloom.points import Points
from markerloom.skeleton import asf_amc, bvh, c3d_motion, glb, osim, tables, usd
from markerloom.skeleton.motion import Z_UP_TO_Y_UP, Motion, rest_of, turned, with_rest
from markerloom.skeleton.skeleton import Skeleton

Array = NDArray[np.floating[Any]]
UNITS_M = {"mm": 0.001, "cm": 0.01, "m": 1.0, "in": 0.0254}
MOTIONS_READ = (".bvh", ".amc", ".glb")
USD = (".usda", ".usdc")
POINTS_OF_JOINTS = (".trc", ".c3d")
TABLES = (".parquet", ".csv")
MOTIONS_WRITTEN = (".bvh", ".asf", ".amc", ".glb", *USD, ".osim", ".mot", *POINTS_OF_JOINTS, *TABLES)
RESTS = {"t-pose": 0.0, "a-pose": 45.0, "i-pose": 90.0}
"""How far the arms hang from the T-pose (deg)."""


def axes_from(up: str) -> Array:
    """Takes coordinates of a file with this axis up to ours."""
    if up not in ("y", "z"):
        raise InputError(f"the up axis is y or z, not '{up}'")
    return Z_UP_TO_Y_UP.T if up == "y" else np.eye(3)


def unit_m(units: str) -> float:
    """The length of a unit (m): its name, or a number of metres for files in units of their own."""
    if units in UNITS_M:
        return UNITS_M[units]
    try:
        length = float(units)
    except ValueError:
        length = 0.0
    if not 0.0 < length < 1e3:
        raise InputError(f"units are {', '.join(UNITS_M)}, or how many metres one is, not '{units}'")
    return length


def read_motion(path: str | Path, *, units: str | None = None, up: str = "y", rate_hz: float | None = None) -> Motion:
    """A motion from .bvh (units: cm unless said), .amc with its .asf beside it (units: as the file says), or .glb.

    AMC files have no frame rate: 120 Hz unless said. A .glb is sampled at ``rate_hz``, or at its own rate.
    """
    kind = Path(path).suffix.lower()
    if kind == ".glb":
        return _to_ours(glb.read(path, rate_hz), "y")
    if kind == ".bvh":
        motion = bvh.read(path, unit_m(units or "cm"))
    elif kind == ".amc":
        own = unit_m(units) if units else None
        motion = asf_amc.read(path, asf_amc.find_asf(path), rate_hz=rate_hz or 120.0, unit_m=own)
    else:
        raise InputError(f"motions are {', '.join(MOTIONS_READ)}; '{kind}' is none of them ({path})")
    if rate_hz:
        motion = replace(motion, rate_hz=rate_hz)
    return _to_ours(motion, up)


def read_skeleton_file(path: str | Path, *, units: str | None = None, up: str = "y") -> Skeleton:
    """The skeleton of a .bvh or .asf."""
    if Path(path).suffix.lower() == ".bvh":
        skeleton = bvh.read_skeleton(path, unit_m(units or "cm"))
    else:
        skeleton = asf_amc.skeleton_of(asf_amc.read_asf(path), path, unit_m(units) if units else None)
    still = Motion(skeleton, np.zeros((1, 3)), np.tile(np.eye(3), (1, len(skeleton), 1, 1)), 1.0)
    return _to_ours(still, up).skeleton


def _to_ours(motion: Motion, up: str) -> Motion:
    moved = turned(motion, axes_from(up))
    if up == "z":
        return moved
    return replace(moved, skeleton=asf_amc.renamed_axes(moved.skeleton, "+X+Z-Y"))


def in_axes(motion: Motion, up: str) -> Motion:
    """A motion of ours in a file's axes; turns and limits of its skeleton told in these, too."""
    moved = turned(motion, axes_from(up).T)
    if up == "z":
        return moved
    return replace(moved, skeleton=asf_amc.renamed_axes(moved.skeleton, "+X-Z+Y"))


def with_arms(motion: Motion, rest: str) -> Motion:
    """The same motion against a rest pose with the arms hanging: t-pose, a-pose, or i-pose."""
    if rest not in RESTS:
        raise InputError(f"the rest pose is {', '.join(RESTS)}, not '{rest}'")
    skeleton = motion.skeleton
    arms = {s: skeleton.segments.get(f"{s}_upper_arm", -1) for s in ("left", "right")}
    if RESTS[rest] == 0.0:
        return motion
    if min(arms.values()) < 0:
        raise InputError(f"skeleton '{skeleton.name}' does not say which joints are its shoulders: its rest pose stays")
    angle = np.deg2rad(RESTS[rest])
    hang = {"left": np.array([0.0, angle, 0.0]), "right": np.array([0.0, -angle, 0.0])}
    return with_rest(motion, rest_of(skeleton, {skeleton.joints[j]: hang[s] for s, j in arms.items()}))


@dataclass(frozen=True)
class Style:
    """What a program expects of a file: units, up axis, order of Euler angles, rest pose."""

    units: str = "cm"
    up: str = "y"
    order: str | None = None
    rest: str = "t-pose"


PRESETS = {
    "vicon": Style(units="mm", up="z"),
    "opensim": Style(units="m", up="y"),
    "blender": Style(units="m", up="z"),
    "unity": Style(units="m", up="y", order="ZXY"),
    "unreal": Style(units="cm", up="z"),
    "maya": Style(units="cm", up="y", order="XYZ"),
}


def write_motion(
    motion: Motion,
    path: str | Path,
    *,
    units: str | None = None,
    up: str | None = None,
    order: str | None = None,
    rest: str | None = None,
    radians: bool = False,
    preset: str | None = None,
    markers: osim.Glued = (),
    take: Points | None = None,
) -> list[Path]:
    """Write a motion by its ending; returns the files written.

    ``units``: of lengths (cm), ``up``: the axis (y), ``order``: of the Euler angles of a BVH, such as ZXY, ``rest``:
    t-pose, a-pose or i-pose; what is not said comes from the ``preset``. ``markers``: for .osim; ``take``: whose
    markers .trc and .c3d show beside the joints.
    """
    kind = Path(path).suffix.lower()
    if kind not in MOTIONS_WRITTEN:
        raise InputError(f"motions are written as {', '.join(MOTIONS_WRITTEN)}, not '{kind}' ({path})")
    if preset is not None and preset not in PRESETS:
        raise InputError(f"there is no preset '{preset}': {', '.join(PRESETS)}")
    style = PRESETS.get(preset or "", Style())
    units, order, rest = units or style.units, order or style.order, rest or style.rest
    motion = with_arms(motion, rest)
    if order is not None:
        if sorted(order.upper()) != ["X", "Y", "Z"]:
            raise InputError(f"an order of angles is X, Y and Z in some order, not '{order}'")
        motion = replace(motion, skeleton=replace(motion.skeleton, orders=(order.upper(),) * len(motion.skeleton)))
    if kind in POINTS_OF_JOINTS:
        joints = tables.as_points(motion)
        points = joints if take is None else tables.with_markers(joints, take)
        points = points.with_up_axis(up or (style.up if preset else "z"))
        if kind == ".c3d":
            c3d_motion.write(motion, points, path)
        else:
            write_points(points, path)
        return [Path(path)]
    if kind in TABLES:
        tables.write(motion, path)
        return [Path(path)]
    # USD says its up axis; the others are Y up unless told otherwise, glTF always.
    axis = "y" if kind == ".glb" else up or (style.up if preset else "z" if kind in USD else "y")
    out = in_axes(motion, axis)
    if kind == ".bvh":
        bvh.write(out, path, unit_m(units))
    elif kind == ".glb":
        glb.write(out, path)
    elif kind in USD:
        usd.write(out, path, axis)
    elif kind in (".osim", ".mot"):
        turned_markers = [(name, joint, axes_from(axis).T @ place) for name, joint, place in markers]
        return list(osim.write(out, path, turned_markers))
    else:
        return list(asf_amc.write(out, path, unit_m(units), radians=radians))
    return [Path(path)]
