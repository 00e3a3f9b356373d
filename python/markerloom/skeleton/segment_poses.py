"""Solving from places and orientations of segments: inertial or electromagnetic sensors, and rigid bodies.

A table of poses has a row per frame and segment: `frame, segment, x_mm, y_mm, z_mm, qx, qy, qz, qw`; places may be
missing, turns too. Tables of motions and of rigid bodies are such tables. `Distortion` is the smooth field by which an
electromagnetic tracker is wrong, fitted against an optical reference.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator
from scipy.spatial.transform import Rotation

from markerloom.errors import FormatError, InputError
from markerloom.formats import TABLE_ENDINGS, c3d_file, ending, table_file
from markerloom.skeleton import c3d_motion, mvnx
from markerloom.skeleton.fitting import Wearer, figure_of
from markerloom.skeleton.motion import Motion, turns_of
from markerloom.skeleton.mounts import PLACE_SIGMA_M, TURN_SIGMA_RAD
from markerloom.skeleton.mvnx import SegmentPoses
from markerloom.skeleton.skeleton import Skeleton

Array = NDArray[np.floating[Any]]
NAMES = ("segment", "joint", "body")
"""Columns that name the segments: of sensors, of a table of a motion, of rigid bodies."""
TELL_SKELETON = (".mvnx", ".c3d")
COLUMNS = ("frame", "qx", "qy", "qz", "qw")


def read_segment_poses(
    path: str | Path, skeleton: Skeleton | None = None, rate_hz: float | None = None
) -> SegmentPoses:
    """Poses from .mvnx or a .c3d, which tell their skeleton, or from a table for the segments of ``skeleton``."""
    if ending(path) in TELL_SKELETON:
        return mvnx.read(path) if ending(path) == ".mvnx" else c3d_motion.read(path)
    if ending(path) not in TABLE_ENDINGS:
        raise InputError(f"poses of segments are .mvnx, .c3d, .parquet or .csv ({path})")
    if skeleton is None:
        raise InputError(f"a table of poses needs a skeleton: --skeleton ({path})")
    table = table_file.read(path)
    names = next((c for c in NAMES if c in table.column_names), "")
    if not names or not set(COLUMNS) <= set(table.column_names):
        raise FormatError(path, f"a table of poses has the columns segment, {', '.join(COLUMNS)} and x_mm, y_mm, z_mm")
    rate = float((table.schema.metadata or {}).get(b"rate_hz", b"0") or 0) or rate_hz
    if not rate:
        raise InputError(f"the table has no frame rate: say --rate-hz ({path})")
    frame = table["frame"].to_numpy().astype(np.int64)
    joint = np.array([skeleton.index(str(s)) for s in table[names].to_pylist()])
    if (joint < 0).any():
        unknown = table[names].to_pylist()[int(np.argmax(joint < 0))]
        raise InputError(f"{path}: skeleton '{skeleton.name}' has no segment '{unknown}'")
    first, last = int(frame.min()), int(frame.max())
    place = np.full((last - first + 1, len(skeleton), 3), np.nan)
    turn = np.full((last - first + 1, len(skeleton), 3, 3), np.nan)
    q = np.column_stack([table[c].to_numpy() for c in ("qx", "qy", "qz", "qw")]).astype(float)
    told = np.isfinite(q).all(axis=1) & (np.abs(np.linalg.norm(np.nan_to_num(q), axis=1) - 1.0) < 0.1)
    turn[frame[told] - first, joint[told]] = Rotation.from_quat(q[told]).as_matrix()
    if {"x_mm", "y_mm", "z_mm"} <= set(table.column_names):
        xyz = np.column_stack([table[c].to_numpy() for c in ("x_mm", "y_mm", "z_mm")]).astype(float)
        place[frame - first, joint] = xyz / 1000.0
    return SegmentPoses(skeleton, place, turn, rate, first_frame=first, source=str(path))


def is_segment_poses(path: str | Path) -> bool:
    """Whether a file holds poses of segments and no points: .mvnx, a table of poses, a .c3d with a group ROTATION."""
    kind = ending(path)
    if kind == ".c3d":
        file = c3d_file.read_file(path)
        return bool(c3d_file.segment_names(file)) and not (file.residuals()[0] >= 0).any()
    if kind in TABLE_ENDINGS:
        columns = table_file.columns(path)
        return set(COLUMNS) <= set(columns) and any(c in columns for c in NAMES)
    return kind == ".mvnx"


def solve_segments(
    poses: SegmentPoses,
    wearer: Wearer | None = None,
    worn_m: Array | None = None,
    *,
    place_sigma_m: float = PLACE_SIGMA_M,
    turn_sigma_rad: float = TURN_SIGMA_RAD,
) -> Motion:
    """The motion of the skeleton under its segments' poses; with a ``wearer`` and ``worn_m`` (frames, markers, 3; m)
    under its markers, too. Bones stay as long as the skeleton has them.
    """
    skeleton = poses.skeleton if wearer is None else wearer.skeleton
    frames, joints = poses.place_m.shape[:2]
    if wearer is None:
        figure = figure_of(skeleton, [], np.zeros((0, 3)), np.zeros(0))
        worn_m = np.zeros((frames, 0, 3))
    else:
        figure = wearer.figure()
        if worn_m is None or len(worn_m) != frames:
            raise InputError("markers and poses must have the same frames")
    at = np.argwhere(np.isfinite(poses.place_m).all(axis=2))
    pins = [(int(f), int(j), [0.0] * 3, poses.place_m[f, j].tolist(), place_sigma_m) for f, j in at]
    at = np.argwhere(np.isfinite(poses.turn).all(axis=(2, 3)))
    vectors = Rotation.from_matrix(poses.turn[at[:, 0], at[:, 1]]).as_rotvec() if len(at) else np.zeros((0, 3))
    turns = [(int(f), int(j), v.tolist(), turn_sigma_rad) for (f, j), v in zip(at, vectors, strict=True)]
    if not pins and not turns:
        raise InputError(f"no segment has a pose ({poses.source})")
    solved, (sigma_m, _) = figure.solve(worn_m, 1.0 / poses.rate_hz, pins, turns)
    told = np.asarray(np.isfinite(poses.turn).all(axis=(2, 3)))
    return Motion(
        skeleton,
        solved[0],
        turns_of(skeleton, solved),
        poses.rate_hz,
        first_frame=poses.first_frame,
        sigma_mm=1000.0 * sigma_m,
        kind=np.asarray(~told, np.int64) if wearer is None else np.zeros((frames, joints), np.int64),
        source=poses.source,
    )


@dataclass(frozen=True)
class Distortion:
    """A smooth field of corrections (m) over the volume of an electromagnetic tracker; `fit_distortion` makes one."""

    field: RBFInterpolator
    low_m: Array
    high_m: Array

    def corrected(self, place_m: Array) -> Array:
        """Places (…, 3) with the field's correction; outside of the fitted volume that of its nearest place."""
        flat = place_m.reshape(-1, 3)
        good = np.isfinite(flat).all(axis=1)
        out = flat.copy()
        if good.any():
            out[good] += self.field(np.clip(flat[good], self.low_m, self.high_m))
        return out.reshape(place_m.shape)


def fit_distortion(measured_m: Array, reference_m: Array, *, smoothing: float = 1e-4) -> Distortion:
    """The field that takes an electromagnetic tracker's places (n, 3; m) to those of an optical reference: thin-plate
    splines with a linear part (Bookstein 1989). Needs at least ten places that span a volume.
    """
    good = np.isfinite(measured_m).all(axis=1) & np.isfinite(reference_m).all(axis=1)
    here, there = measured_m[good], reference_m[good]
    if len(here) < 10 or np.linalg.matrix_rank(here - here.mean(axis=0), tol=1e-3) < 3:
        raise InputError("the field needs at least ten places that span a volume, seen by both systems")
    neighbours = min(len(here), 200)
    field = RBFInterpolator(here, there - here, neighbors=neighbours, smoothing=smoothing, kernel="thin_plate_spline")
    return Distortion(field, here.min(axis=0), here.max(axis=0))
