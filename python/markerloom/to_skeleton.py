"""The other half of the demo: from a person in a T-pose to a BVH, nothing known but the marker set."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from markerloom.filling import fill
from markerloom.labelling import label
from markerloom.points import Points
from markerloom.simulate import make_scene, simulate
from markerloom.skeleton import Solved, solve, write_motion
from markerloom.skeleton.page import figure_strip, save_motion_page
from markerloom.subjects import read_marker_set
from markerloom.track import track

MARKER_SET = "front-waist-53"


@dataclass(frozen=True)
class ToSkeleton:
    """What came out: the named take, the solved skeleton, and the files."""

    take: Points
    solved: Solved
    files: dict[str, Path]

    def rows(self) -> list[list[str]]:
        """What happened, in words."""
        off = self.solved.report["residual_mm"]
        slides = max((c["slides_mm"] for c in self.solved.report["contacts"]), default=0.0)
        return [
            ["from the T-pose", f"{len(set(self.take.label.tolist()) - {''})} markers named"],
            ["skeleton", f"{len(self.solved.motion.skeleton)} joints, markers {off['rms']:.1f} mm rms from it"],
            ["feet that stand", f"{len(self.solved.contacts)} times, sliding by at most {slides:.2f} mm"],
        ]

    def picture(self) -> str:
        """The figure over time."""
        return figure_strip(self.solved.motion)


def to_skeleton(folder: str | Path, *, frames: int, seed: int) -> ToSkeleton:
    """Simulate a person who walks out of a T-pose; track, name, fill and solve; write ``take.c3d``, ``take.bvh`` and a
    page into a folder.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    scene = make_scene("walk", frames=frames, seed=seed, marker_set=MARKER_SET, t_pose_s=1.0)
    taken = simulate(scene)
    named = label(track(taken.observations, taken.rig), marker_set=read_marker_set(MARKER_SET))
    filled = fill(named)
    solved = solve(filled)
    files = {"named": folder / "take.c3d", "motion": folder / "take.bvh", "skeleton": folder / "skeleton.html"}
    filled.save(files["named"])
    write_motion(solved.motion, files["motion"])
    save_motion_page(solved, files["skeleton"])
    return ToSkeleton(filled, solved, files)
