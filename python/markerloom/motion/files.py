"""Clips in and out of the operations: read with bones of constant length, written in the same conventions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from markerloom.errors import InputError
from markerloom.motion.edited import with_constant_bones
from markerloom.skeleton.files import read_motion, write_motion
from markerloom.skeleton.motion import Motion

BONES_MM = 5.0
"""Bones that change by more than this in a file are told."""


@dataclass(frozen=True)
class Conventions:
    """Units and up axis of the files read and written; what is only said of those written."""

    units: str | None = None
    up: str = "y"
    rate_hz: float | None = None
    order: str | None = None
    preset: str | None = None


def read_clip(path: str | Path, how: Conventions) -> tuple[Motion, list[str]]:
    """A clip, and what had to be changed so that it can be edited."""
    motion = read_motion(path, units=how.units, up=how.up, rate_hz=how.rate_hz)
    if not len(motion):
        raise InputError(f"{path} has no frames")
    out, off = with_constant_bones(motion)
    changed = (
        [f"{Path(path).name}: bones change by up to {off:.0f} mm; they are constant now"] if off > BONES_MM else []
    )
    return replace(out, first_frame=0), changed


def write_clip(motion: Motion, path: str | Path, how: Conventions) -> list[Path]:
    """Write a clip in the conventions it was read in, unless a preset says others."""
    units, up = (how.units, how.up) if how.preset is None else (None, None)
    if units is None and how.preset is None and Path(path).suffix.lower() == ".bvh":
        units = "cm"
    return write_motion(motion, path, units=units, up=up, order=how.order, preset=how.preset)
