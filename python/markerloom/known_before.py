"""A start pose: what is known before the first frame of how the markers lie to each other."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom import _core
from markerloom.errors import InputError
from markerloom.formats import ending, read_points
from markerloom.points import Points
from markerloom.subjects import create_subject, marker_sets, read_marker_set, read_subject
from markerloom.subjects.names import prefixes, split_prefix
from markerloom.subjects.subject import Subject, model_of
from markerloom.trajectories import Trajectories

MOVES = 2.0
"""Independent poses from which a take tells by itself what is rigid."""
KNOWN_SET = 0.6
"""Markers are of a known set if it has at least this share of their names."""
POSES = 100
"""Poses that are kept of a longer take: more say little more."""


@dataclass(frozen=True)
class StartPose:
    """The subjects' markers, one after the other, and their places in poses that were seen before (poses, markers, 3;
    m; NaN where missing); none if only their distances are known. Made by `start_pose`.
    """

    subjects: tuple[Subject, ...]
    poses_m: NDArray[np.floating[Any]]

    @property
    def core(self) -> _core.StartPose:
        """For the engine."""
        independent = min(s.poses for s in self.subjects)
        return _core.StartPose(model_of(list(self.subjects)), independent, np.ascontiguousarray(self.poses_m))


def start_pose(known: Points | Subject) -> StartPose:
    """What `track` may know before the first frame: from named points of the same person with the same markers (a
    static pose, better a range of motion, or any other take), or from a subject, which knows distances alone.

    Raises ``InputError`` where no three markers of somebody have names.
    """
    if isinstance(known, Subject):
        return StartPose((known,), np.zeros((0, len(known), 3)))
    take = Trajectories.of(known)
    named = [n for n in take.names if not n.startswith("*")]
    if not named:
        raise InputError(f"no marker of the start pose has a name: label it first ({known.source})")
    whose = prefixes(named)
    subjects = tuple(_subject(known, prefix, named) for prefix in whose)
    names = [f"{p}:{m}" if p else m for p, s in zip(whose, subjects, strict=True) for m in s.markers]
    xyz_m = take.xyz_mm[:, [take.names.index(n) for n in names]] / 1000.0
    some = np.unique(np.linspace(0, len(xyz_m) - 1, min(POSES, len(xyz_m))).round().astype(int))
    return StartPose(subjects, xyz_m[some])


def _subject(points: Points, prefix: str, names: list[str]) -> Subject:
    """The subject of a prefix. Which of its markers are rigid to each other, a take in which the person moves tells; of
    a single pose, the known marker set that most of the names are of.
    """
    subject = create_subject(points, prefix=prefix)
    if subject.poses >= MOVES:
        return subject
    own = {split_prefix(n)[1] for n in names if split_prefix(n)[0] == prefix}
    sets = [read_marker_set(name) for name in marker_sets()]
    worn = max(sets, key=lambda s: len(own & set(s.markers)))
    if len(own & set(worn.markers)) < KNOWN_SET * len(own):
        raise InputError(
            "a single pose does not tell which markers are rigid to each other, and these are of no known marker set: "
            f"give a take in which the person moves, or a subject ({points.source})"
        )
    return create_subject(points, prefix=prefix, marker_set=worn)


def read_start_pose(path: str | Path) -> StartPose:
    """A start pose from SUBJECT.toml, or from named points (.c3d, .trc, .parquet, .csv)."""
    return start_pose(read_subject(path) if ending(path) == ".toml" else read_points(path))
