"""Cameras that were moved while a take ran: what the engine's watch found, and the rig of each frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from markerloom.rig import Camera, Rig


@dataclass(frozen=True)
class Move:
    """From ``frame`` on, camera ``camera`` (index) stands as ``now`` says; it was found out in frame ``found``.

    ``shift_px``: (x, y) by which its dots lay beside their places. ``dots``: how many tell where it stands now.
    """

    frame: int
    found: int
    camera: int
    now: Camera
    shift_px: tuple[float, float]
    dots: int


@dataclass(frozen=True)
class Moves:
    """A rig at the first frame of a take, and the moves of its cameras in order of time."""

    rig: Rig
    moves: tuple[Move, ...] = ()

    def rig_at(self, frame: int) -> Rig:
        """The rig as it stood in a frame."""
        cameras = list(self.rig.cameras)
        for move in self.moves:
            if move.frame <= frame:
                cameras[move.camera] = move.now
        return replace(self.rig, cameras=tuple(cameras))

    def parts(self) -> list[tuple[float, float, Rig]]:
        """First frame, one past the last, and the rig, for each part of a take in which no camera moves."""
        bounds = [-np.inf, *sorted({move.frame for move in self.moves}), np.inf]
        return [(a, b, self.rig if a == -np.inf else self.rig_at(int(a))) for a, b in pairwise(bounds)]

    def described(self) -> list[dict[str, Any]]:
        """For the report: ``camera``, ``frame``, ``found``, ``shift_px``, ``moved_mm``, ``turned_deg``, ``dots``."""
        rows = []
        for move in self.moves:
            before = self.rig_at(move.frame - 1).cameras[move.camera]
            shift_mm, turn_deg = between(before, move.now)
            rows.append(
                {
                    "camera": move.now.id,
                    "frame": move.frame,
                    "found": move.found,
                    "shift_px": list(move.shift_px),
                    "moved_mm": shift_mm,
                    "turned_deg": turn_deg,
                    "dots": move.dots,
                }
            )
        return rows

    def planned(self) -> list[tuple[int, int, dict[str, Any]]]:
        """For the engine: frame, index and description of each."""
        return [(move.frame, move.camera, move.now._described()) for move in self.moves]


def found_moves(rig: Rig, found: list[dict[str, Any]]) -> Moves:
    """Moves as the engine's watch tells of them: of one that it tells of again, the last and best word."""
    last: dict[tuple[int, int], Move] = {}
    for one in found:
        before = rig.cameras[one["camera"]]
        now = replace(before, rotation=np.array(one["rotation"]), position_m=np.array(one["position_m"]))
        move = Move(one["frame"], one["found"], one["camera"], now, tuple(one["shift_px"]), one["dots"])
        last[move.frame, move.camera] = move
    return Moves(rig, tuple(last[key] for key in sorted(last)))


def between(before: Camera, after: Camera) -> tuple[float, float]:
    """How far apart two poses of a camera are: mm, and degrees."""
    cosine = (np.trace(before.rotation.T @ after.rotation) - 1.0) / 2.0
    shift_mm = 1000.0 * float(np.linalg.norm(before.position_m - after.position_m))
    return shift_mm, float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def warning(move: dict[str, Any], *, healed: bool) -> str:
    """A line about a move in a report."""
    x, y = move["shift_px"]
    what = "its new pose is used from there on" if healed else "calibrate it anew, or track with --refine-calibration"
    return (
        f"camera {move['camera']} was moved at frame {move['frame']} by {move['moved_mm']:.1f} mm and "
        f"{move['turned_deg']:.2f}° (its dots by {x:+.2f}, {y:+.2f} px): {what}"
    )
