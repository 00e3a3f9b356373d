"""Motion as material: frequency bands, warping, retargeting, feet held, joining, motion graphs.

Every operation takes motions (`markerloom.read_motion`) and gives back an `Edited`: the new motion, and a report of
what it changed.
"""

from markerloom.motion import rotations
from markerloom.motion.alike import distances
from markerloom.motion.bands import band_hz, bands, split
from markerloom.motion.blend import blend, concatenate, through_neutral
from markerloom.motion.body import Body, body_of
from markerloom.motion.clips import crop, in_place, loop, mirror
from markerloom.motion.constraints import (
    Constraints,
    Hold,
    Look,
    Touch,
    find_constraints,
    read_constraints,
    write_constraints,
)
from markerloom.motion.edited import Edited, accelerations, sharpness, with_constant_bones
from markerloom.motion.feet import Feet, Plant, feet_of, find_plants, floor_m, slides
from markerloom.motion.footlock import footlock
from markerloom.motion.graph import build, follow, walk
from markerloom.motion.keys import Key, by_angles, by_clip, by_reach, read_keys
from markerloom.motion.library import Library, Transition, find, read_library, write_library
from markerloom.motion.mapping import Mapping, guess, read_mapping, write_mapping
from markerloom.motion.page import save_edit_page
from markerloom.motion.registration import corresponding, mix
from markerloom.motion.retarget import retarget
from markerloom.motion.timing import resample, sampled, timewarp
from markerloom.motion.warp import key_error, warp

__all__ = [
    "Body",
    "Constraints",
    "Edited",
    "Feet",
    "Hold",
    "Key",
    "Library",
    "Look",
    "Mapping",
    "Plant",
    "Touch",
    "Transition",
    "accelerations",
    "band_hz",
    "bands",
    "blend",
    "body_of",
    "build",
    "by_angles",
    "by_clip",
    "by_reach",
    "concatenate",
    "corresponding",
    "crop",
    "distances",
    "feet_of",
    "find",
    "find_constraints",
    "find_plants",
    "floor_m",
    "follow",
    "footlock",
    "guess",
    "in_place",
    "key_error",
    "loop",
    "mirror",
    "mix",
    "read_constraints",
    "read_keys",
    "read_library",
    "read_mapping",
    "resample",
    "retarget",
    "rotations",
    "sampled",
    "save_edit_page",
    "sharpness",
    "slides",
    "split",
    "through_neutral",
    "timewarp",
    "walk",
    "warp",
    "with_constant_bones",
    "write_constraints",
    "write_library",
    "write_mapping",
]
