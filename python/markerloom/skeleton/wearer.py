"""Fitted skeletons with their markers as TOML: made once from a range of motion, used for every take of the person."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np

from markerloom.errors import FormatError, InputError
from markerloom.formats.files import read_text, write_text
from markerloom.skeleton.definition import LEVELS, read_skeleton, skeleton_text
from markerloom.skeleton.fitting import Wearer


def has_markers(source: str | Path) -> bool:
    """Whether a skeleton's file says where markers are on it."""
    if str(source) in LEVELS or Path(source).suffix.lower() != ".toml":
        return False
    return "\n[[markers]]" in read_text(source)


def read_wearer(path: str | Path) -> Wearer:
    """A fitted skeleton with its markers."""
    skeleton = read_skeleton(path)
    rows = tomllib.loads(read_text(path)).get("markers", [])
    names, joints, places, sigmas = [], [], [], []
    for row in rows:
        where = f"marker '{row.get('name', '?')}'"
        joint = skeleton.index(str(row.get("joint", "")))
        place = row.get("place_mm")
        if joint < 0 or not isinstance(place, list) or len(place) != 3 or not row.get("sigma_mm", 0) > 0:
            raise FormatError(path, "needs a joint of the skeleton, place_mm and sigma_mm", where=where)
        names.append(str(row["name"]))
        joints.append(joint)
        places.append(np.array(place, float) / 1000.0)
        sigmas.append(float(row["sigma_mm"]) / 1000.0)
    if len(set(names)) < len(names):
        raise FormatError(path, "a marker is there twice")
    return Wearer(skeleton, tuple(names), tuple(joints), np.array(places), np.array(sigmas))


def write_wearer(wearer: Wearer, path: str | Path) -> None:
    """Write a fitted skeleton with its markers: place in the segment's axes (left, back, up of the rest pose) and
    standard deviation per axis, in mm.
    """
    if Path(path).suffix != ".toml":
        raise InputError(f"skeletons are written as .toml ({path})")
    lines = [skeleton_text(wearer.skeleton).rstrip("\n")]
    for name, joint, place, sigma in zip(wearer.markers, wearer.joints, wearer.places_m, wearer.sigmas_m, strict=True):
        numbers = ", ".join(f"{1000.0 * v:.4f}" for v in place)
        lines += ["", "[[markers]]", f"name = {json.dumps(name)}"]
        lines += [f"joint = {json.dumps(wearer.skeleton.joints[joint])}", f"place_mm = [{numbers}]"]
        lines.append(f"sigma_mm = {1000.0 * float(sigma):.4f}")
    write_text(path, "\n".join(lines) + "\n")
