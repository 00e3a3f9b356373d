"""MVNX (Xsens): place and orientation of every segment of an inertial capture, and the skeleton they are of.

MVNX's axes are forward, left, up; here they become left, back, up, as in the BVH that Xsens writes of the same capture.
Quaternions have their scalar part first.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from markerloom.errors import FormatError, InputError
from markerloom.formats.xml_file import parse
from markerloom.skeleton.skeleton import Site, Skeleton, in_order

Array = NDArray[np.floating[Any]]
AXES = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""From forward, left, up to left, back, up."""
PARTS = {
    "Pelvis": "pelvis",
    "T8": "thorax",
    "Head": "head",
    **{
        f"{side}{part}": f"{side.lower()}_{ours}"
        for side in ("Left", "Right")
        for part, ours in {
            "Shoulder": "clavicle",
            "UpperArm": "upper_arm",
            "ForeArm": "forearm",
            "Hand": "hand",
            "UpperLeg": "thigh",
            "LowerLeg": "shank",
            "Foot": "foot",
            "Toe": "toes",
        }.items()
    },
}


@dataclass(frozen=True)
class SegmentPoses:
    """Place (frames, joints, 3; m) and turn (frames, joints, 3, 3) of segments in the world, in the skeleton's order;
    NaN where a sensor told nothing.
    """

    skeleton: Skeleton
    place_m: Array
    turn: Array
    rate_hz: float
    first_frame: int = 0
    source: str = ""


def read(path: str | Path) -> SegmentPoses:
    """All normal frames of a capture.

    Raises ``FormatError`` where segments, joints or frames do not fit together.
    """
    root = parse(path, "mvnx", "MVNX")
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    subject = root.find("subject")
    rate = float(subject.get("frameRate", "0") or 0) if subject is not None else 0.0
    if subject is None or rate <= 0:
        raise FormatError(path, "has no subject with a frame rate")
    skeleton, order = _skeleton(subject, path)
    places, turns = [], []
    for number, frame in enumerate(f for f in subject.iter("frame") if f.get("type") == "normal"):
        places.append(_numbers(frame, "position", 3, len(order), path, number))
        turns.append(_numbers(frame, "orientation", 4, len(order), path, number))
    if not places:
        raise FormatError(path, "holds no normal frame")
    place = np.array(places)[:, order] @ AXES.T
    matrix = Rotation.from_quat(np.array(turns)[:, order].reshape(-1, 4)[:, [1, 2, 3, 0]]).as_matrix()
    turn = AXES @ matrix.reshape(len(places), -1, 3, 3) @ AXES.T
    return SegmentPoses(skeleton, place, turn, rate, source=str(path))


def _numbers(frame: Xml.Element, tag: str, width: int, count: int, path: str | Path, number: int) -> Array:
    text = frame.findtext(tag) or ""
    try:
        values = np.array(text.split(), float)
    except ValueError:
        values = np.zeros(0)
    if len(values) != width * count or not np.isfinite(values).all():
        raise FormatError(path, f"<{tag}> has {len(values)} numbers, not {width * count}", where=f"frame {number}")
    return values.reshape(count, width)


def _skeleton(subject: Xml.Element, path: str | Path) -> tuple[Skeleton, list[int]]:
    """The skeleton, and for its joints the number of the segment in the file."""
    points: dict[str, dict[str, Array]] = {}
    for segment in subject.iter("segment"):
        own = {str(p.get("label")): np.array((p.findtext("pos_b") or "").split(), float) for p in segment.iter("point")}
        points[str(segment.get("label"))] = own
    labels = list(points)
    parent_of: dict[str, str | None] = dict.fromkeys(labels)
    at: dict[str, Array] = {name: np.zeros(3) for name in labels}
    for joint in subject.iter("joint"):
        ends = [(joint.findtext(f"connector{k}") or "").split("/") for k in (1, 2)]
        if any(len(e) != 2 or e[0] not in points or e[1] not in points[e[0]] for e in ends):
            raise FormatError(path, f"joint '{joint.get('label')}' joins what is not there")
        (above, point), (below, _) = ends
        parent_of[below] = above
        at[below] = points[above][point]
    try:
        names = in_order(labels, parent_of, Path(path).name)
        skeleton = Skeleton(
            name=Path(path).stem,
            joints=tuple(names),
            parents=tuple(-1 if parent_of[n] is None else names.index(str(parent_of[n])) for n in names),
            offsets_m=np.array([at[n] for n in names]) @ AXES.T,
            sites=_sites(names, points),
            segments={PARTS[n]: i for i, n in enumerate(names) if n in PARTS},
        )
    except InputError as error:
        raise FormatError(path, str(error)) from None
    return skeleton, [labels.index(n) for n in names]


def _sites(names: list[str], points: dict[str, dict[str, Array]]) -> tuple[Site, ...]:
    """Where bones end, and where feet touch the floor."""
    ends = {
        "Head": ("pTopOfHead", "skull_top"),
        "LeftHand": ("pLeftTopOfHand", "l_hand_tip"),
        "RightHand": ("pRightTopOfHand", "r_hand_tip"),
        "LeftToe": ("pLeftToe", "l_toe_tip"),
        "RightToe": ("pRightToe", "r_toe_tip"),
        "LeftFoot": ("pLeftHeelFoot", "l_heel"),
        "RightFoot": ("pRightHeelFoot", "r_heel"),
    }
    return tuple(
        Site(name, names.index(segment), tuple((AXES @ points[segment][point]).tolist()))
        for segment, (point, name) in ends.items()
        if segment in points and point in points[segment]
    )
