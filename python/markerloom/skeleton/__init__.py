"""Skeletons: definitions, fit to a person, solving, files."""

from markerloom.skeleton.by_motion import rigid, sara, score, sphere
from markerloom.skeleton.contacts import Contact, find_contacts
from markerloom.skeleton.definition import hanim, read_skeleton, write_skeleton
from markerloom.skeleton.files import read_motion, write_motion
from markerloom.skeleton.fitting import Wearer, fit_skeleton
from markerloom.skeleton.isb import joint_angles
from markerloom.skeleton.live import SkeletonFollower
from markerloom.skeleton.motion import Motion
from markerloom.skeleton.mvnx import SegmentPoses
from markerloom.skeleton.placing import Hints, read_hints
from markerloom.skeleton.segment_poses import (
    Distortion,
    fit_distortion,
    read_segment_poses,
    solve_segments,
)
from markerloom.skeleton.skeleton import Site, Skeleton
from markerloom.skeleton.takes import Solved, solve
from markerloom.skeleton.wearer import read_wearer, write_wearer

__all__ = [
    "Contact",
    "Distortion",
    "Hints",
    "Motion",
    "SegmentPoses",
    "Site",
    "Skeleton",
    "SkeletonFollower",
    "Solved",
    "Wearer",
    "find_contacts",
    "fit_distortion",
    "fit_skeleton",
    "hanim",
    "joint_angles",
    "read_hints",
    "read_motion",
    "read_segment_poses",
    "read_skeleton",
    "read_wearer",
    "rigid",
    "sara",
    "score",
    "solve",
    "solve_segments",
    "sphere",
    "write_motion",
    "write_skeleton",
    "write_wearer",
]
