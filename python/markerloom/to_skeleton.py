"""The other half of the demo: from a person in a T-pose to a BVH, as a project that the studio shows."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from markerloom.errors import InputError
from markerloom.formats import read_points
from markerloom.formats.files import write_text
from markerloom.points import Points
from markerloom.project import process
from markerloom.simulate import make_scene, save, simulate
from markerloom.skeleton import Motion, read_motion
from markerloom.skeleton.page import figure_strip

MARKER_SET = "front-waist-53"
PROJECT = f"""# Made by `markerloom demo`; look at it with `markerloom view`.
name = "markerloom demo"

[settings]
export = [".c3d"]

[takes.walk]
file = "walk/observations.parquet"
calibration = "walk/calibration.toml"
marker_set = "{MARKER_SET}"
skeleton = "hanim-loa1"

[takes.dance]
file = "observations.parquet"
calibration = "calibration.toml"
fill = "none"
"""


@dataclass(frozen=True)
class ToSkeleton:
    """What came out: the named take, the solved motion with its report, and the files."""

    take: Points
    motion: Motion
    report: dict[str, Any]
    files: dict[str, Path]

    def rows(self) -> list[list[str]]:
        """What happened, in words."""
        off, contacts = self.report["residual_mm"], self.report["contacts"]
        slides = max((c["slides_mm"] for c in contacts), default=0.0)
        return [
            ["from the T-pose", f"{len(set(self.take.label.tolist()) - {''})} markers named"],
            ["skeleton", f"{self.report['joints']} joints, markers {off['rms']:.1f} mm rms from it"],
            ["feet that stand", f"{len(contacts)} times, sliding by at most {slides:.2f} mm"],
        ]

    def picture(self) -> str:
        """The figure over time."""
        return figure_strip(self.motion)


def to_skeleton(folder: str | Path, *, frames: int, seed: int) -> ToSkeleton:
    """Simulate a person who walks out of a T-pose, and take it the whole way as a project: track, name, fill, solve.

    Writes ``markerloom.toml``, the simulated take into ``walk``, and what came out into ``results/walk``.
    """
    folder = Path(folder)
    (folder / "walk").mkdir(parents=True, exist_ok=True)
    scene = make_scene("walk", frames=frames, seed=seed, marker_set=MARKER_SET, t_pose_s=1.0)
    save(simulate(scene), folder / "walk")
    write_text(folder / "markerloom.toml", PROJECT)
    result = process(folder, takes=["walk"])
    if result["failed"]:
        raise InputError(result["failed"][0]["reason"])
    made = folder / "results" / "walk"
    files = {"named": made / "walk.c3d", "motion": made / "walk.bvh", "skeleton": made / "skeleton.html"}
    report = json.loads((made / "solve.json").read_text("utf-8"))["report"]
    return ToSkeleton(read_points(files["named"]), read_motion(files["motion"]), report, files)
