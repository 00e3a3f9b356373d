"""The functions that users script with: every verb of the command line has its twin here, under the same name."""

from __future__ import annotations

from pathlib import Path

from markerloom import formats, motion
from markerloom.active import led_codes, leds
from markerloom.bench import bench
from markerloom.calibrate import Calibration, Wand, calibrate_wand, read_wand
from markerloom.calibrate.board_rig import calibrate_board
from markerloom.calibrate.boards import Board, read_board
from markerloom.calibrate.check import check_rig
from markerloom.calibrate.floor import origin_from_floor, origin_from_points
from markerloom.calibrate.intrinsics import calibrate_intrinsics
from markerloom.calibrate.origin import calibrate_origin
from markerloom.calibrate.page import save_calibration_page
from markerloom.calibrate.points import calibrate_points
from markerloom.calibrate.refine import refine_rig
from markerloom.calibrate.stream import RigStream
from markerloom.convert import convert
from markerloom.coverage import Coverage, coverage, save_coverage
from markerloom.demo import Demo, demo
from markerloom.detect import Blobs, detect, detect_markers, grey_images, learn_mask, read_mask
from markerloom.detect.grey_blobs import GreyBlob, detect_x2d, fit_grey_blobs, read_grey_blobs
from markerloom.detect.render import detected, save_videos
from markerloom.evaluate import (
    Truth,
    evaluate,
    truth_from_assignments,
    truth_from_observations,
    truth_without_views,
)
from markerloom.explain import CameraView, Explanation, TrackedTake, explain
from markerloom.filling import Filled, fill
from markerloom.formats import read_observations, read_points, write_calibration, write_points
from markerloom.hidden import place_on_spheres
from markerloom.inspect import inspect
from markerloom.knock import knock
from markerloom.known_before import StartPose, read_start_pose, start_pose
from markerloom.labelling import Checked, Labelled, Labeller, check_labels, label, repair_labels
from markerloom.mending import EditList, Mended, edits_path, mend, read_edits, without_excluded, write_edits
from markerloom.observations import Observations
from markerloom.points import Points
from markerloom.project import Project, process, read_project
from markerloom.reconstruct import Reconstruction, reconstruct
from markerloom.rig import Camera, Lens, Mask, Rig
from markerloom.rigid_body import (
    Poses,
    RigidBody,
    ambiguities,
    create_rigid_body,
    read_rigid_body,
    track_rigid_body,
    write_rigid_body,
)
from markerloom.simulate import Scene, SimulatedTake, make_scene, save, simulate
from markerloom.skeleton import (
    Contact,
    Distortion,
    Hints,
    Motion,
    SegmentPoses,
    Site,
    Skeleton,
    SkeletonFollower,
    Solved,
    Wearer,
    find_contacts,
    fit_distortion,
    fit_skeleton,
    hanim,
    joint_angles,
    read_hints,
    read_motion,
    read_segment_poses,
    read_skeleton,
    read_wearer,
    sara,
    score,
    solve,
    solve_segments,
    write_motion,
    write_skeleton,
    write_wearer,
)
from markerloom.smoothing import Smoothed, smooth
from markerloom.studio import view
from markerloom.subjects import (
    MarkerSet,
    Subject,
    create_subject,
    marker_sets,
    read_marker_set,
    read_subject,
    with_virtual_markers,
    write_marker_set,
    write_subject,
)
from markerloom.sync import Clock, Synced, sync
from markerloom.track import TrackedFrame, Tracker, track
from markerloom.track_page import save_track_page
from markerloom.triangulate import Triangulated, triangulate, two_rays

__all__ = [
    "Blobs",
    "Board",
    "Calibration",
    "Camera",
    "CameraView",
    "Checked",
    "Clock",
    "Contact",
    "Coverage",
    "Demo",
    "Distortion",
    "EditList",
    "Explanation",
    "Filled",
    "GreyBlob",
    "Hints",
    "Labelled",
    "Labeller",
    "Lens",
    "MarkerSet",
    "Mask",
    "Mended",
    "Motion",
    "Observations",
    "Points",
    "Poses",
    "Project",
    "Reconstruction",
    "Rig",
    "RigStream",
    "RigidBody",
    "Scene",
    "SegmentPoses",
    "SimulatedTake",
    "Site",
    "Skeleton",
    "SkeletonFollower",
    "Smoothed",
    "Solved",
    "StartPose",
    "Subject",
    "Synced",
    "TrackedFrame",
    "TrackedTake",
    "Tracker",
    "Triangulated",
    "Truth",
    "Wand",
    "Wearer",
    "ambiguities",
    "bench",
    "calibrate_board",
    "calibrate_intrinsics",
    "calibrate_origin",
    "calibrate_points",
    "calibrate_wand",
    "check_labels",
    "check_rig",
    "convert",
    "coverage",
    "create_rigid_body",
    "create_subject",
    "demo",
    "detect",
    "detect_markers",
    "detect_x2d",
    "detected",
    "edits_path",
    "evaluate",
    "explain",
    "fill",
    "find_contacts",
    "fit_distortion",
    "fit_grey_blobs",
    "fit_skeleton",
    "grey_images",
    "hanim",
    "inspect",
    "joint_angles",
    "knock",
    "label",
    "learn_mask",
    "led_codes",
    "leds",
    "make_scene",
    "marker_sets",
    "mend",
    "motion",
    "origin_from_floor",
    "origin_from_points",
    "place_on_spheres",
    "process",
    "read_board",
    "read_calibration",
    "read_edits",
    "read_grey_blobs",
    "read_hints",
    "read_marker_set",
    "read_mask",
    "read_motion",
    "read_observations",
    "read_points",
    "read_project",
    "read_rigid_body",
    "read_segment_poses",
    "read_skeleton",
    "read_start_pose",
    "read_subject",
    "read_wand",
    "read_wearer",
    "reconstruct",
    "refine_rig",
    "repair_labels",
    "sara",
    "save",
    "save_calibration_page",
    "save_coverage",
    "save_track_page",
    "save_videos",
    "score",
    "simulate",
    "smooth",
    "solve",
    "solve_segments",
    "start_pose",
    "sync",
    "track",
    "track_rigid_body",
    "triangulate",
    "truth_from_assignments",
    "truth_from_observations",
    "truth_without_views",
    "two_rays",
    "view",
    "with_virtual_markers",
    "without_excluded",
    "write_calibration",
    "write_edits",
    "write_marker_set",
    "write_motion",
    "write_points",
    "write_rigid_body",
    "write_skeleton",
    "write_subject",
    "write_wearer",
]


def read_calibration(path: str | Path, *, units: str = "m") -> Rig:
    """Read a rig from .xcp, Calib.toml, .qca.txt or .mcal; ``units`` of lengths in a Calib.toml."""
    return formats.read_calibration(path, units=units)
