"""Motions as tables and as points: joints' places with their uncertainty, turns of segments, angles of joints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
from scipy.spatial.transform import Rotation

from markerloom.formats import table_file
from markerloom.points import KINDS, Points
from markerloom.skeleton.isb import joint_angles
from markerloom.skeleton.motion import Motion
from markerloom.subjects.names import prefixes

TOLD, INFERRED = "measured", "filled"


def as_points(motion: Motion) -> Points:
    """The joints as points, for .trc and .c3d; those whose turns no marker told are `filled`."""
    frames, joints = motion.turns.shape[:2]
    frame, joint = np.divmod(np.arange(frames * joints), joints)
    parents = np.array(motion.skeleton.parents)
    above = np.where(parents < 0, 0, parents)
    # A joint's place comes from the turns of those above it.
    kind = np.where(motion.kind[:, above] > 0, KINDS.index(INFERRED), KINDS.index(TOLD))
    return Points.of(
        frame + motion.first_frame,
        joint.astype(np.int64),
        1000.0 * motion.joints_m().reshape(-1, 3),
        label=np.array(motion.skeleton.joints, dtype=str)[joint],
        sigma_mm=motion.sigma_mm.reshape(-1),
        kind=kind.reshape(-1).astype(np.int64),
        rate_hz=motion.rate_hz,
        frames=np.arange(motion.first_frame, motion.first_frame + frames),
        source=motion.source,
    )


def with_markers(joints: Points, take: Points) -> Points:
    """The joints of a motion and the named markers of the take that it was solved from, frame by frame; joints bear the
    take's prefix where its markers have one.
    """
    named = take.keep((take.label != "") & np.isin(take.frame, joints.frames))
    whose = prefixes(np.unique(named.label).tolist())
    if len(whose) == 1 and whose[0]:
        joints = replace(joints, label=np.char.add(f"{whose[0]}:", joints.label))
    return joints.joined(named)


def write(motion: Motion, path: str | Path) -> None:
    """Write .parquet or .csv: frame, joint, place (mm), turn of the segment in the world (quaternion), sigma_mm, kind,
    and the joint's angles in ISB's convention where it has one (deg).
    """
    points = as_points(motion)
    turn, _ = motion.segments()
    q = Rotation.from_matrix(turn.reshape(-1, 3, 3)).as_quat()
    named = joint_angles(motion)
    angle = np.full((len(motion), len(motion.skeleton), 3), np.nan)
    for joint, columns in named.items():
        angle[:, motion.skeleton.joints.index(joint)] = np.stack([v for _, v in columns], axis=1)
    flat = angle.reshape(-1, 3)
    table = pa.table(
        {
            "frame": points.frame,
            "joint": points.label.astype(str),
            **{f"{axis}_mm": points.xyz_mm[:, k] for k, axis in enumerate("xyz")},
            **{f"q{axis}": q[:, k] for k, axis in enumerate("xyzw")},
            "sigma_mm": points.sigma_mm,
            "kind": np.array(KINDS)[points.kind],
            **{f"angle_{k + 1}_deg": flat[:, k] for k in range(3)},
        }
    )
    metadata = {"rate_hz": repr(motion.rate_hz), "units": "mm", "up_axis": "z"}
    table_file.write(table.replace_schema_metadata(metadata), path)
