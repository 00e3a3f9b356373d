"""The exact solver against HiGHS: same candidate groups, same objective, gap 0.

Run: python benches/certificate.py [FRAMES]
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import highspy
import numpy as np

from markerloom import _core
from markerloom.observations import DotArrays, match
from markerloom.simulate import make_scene, simulate

MODELS: dict[str, tuple[str, dict[str, Any]]] = {
    "exp61 one": ("exp61", {"hide": "one"}),
    "exp61 quarter": ("exp61", {"hide": "quarter"}),
    "exp61 one, elevation 0": ("exp61", {"hide": "one", "elevation_deg": 0.0}),
    "exp61 one, arc of 120°": ("exp61", {"hide": "one", "shape": "arc", "elevation_deg": 0.0, "angle_deg": 120.0}),
    "exp61 one, 0.1 px": ("exp61", {"hide": "one", "sigma_px": 0.1}),
    "8 cameras, 33 markers": ("cloud", {"markers": 33}),
    "8 cameras, 100 markers": ("cloud", {"markers": 100}),
    "8 cameras, 200 markers": ("cloud", {"markers": 200}),
}


@dataclass(frozen=True)
class Comparison:
    """What came of it."""

    frames: int
    certified: int
    worst_difference: float


def compare(model: str, *, frames: int) -> Comparison:
    """Solve every frame both ways."""
    name, changes = MODELS[model]
    take = simulate(make_scene(name, frames=frames, **changes))
    dots = match(take.observations, take.rig)
    prior = _core.estimate_model(take.rig.core, DotArrays(*dots.of_frames(0, frames)))
    worst, certified = 0.0, 0
    for frame in range(frames):
        found = _core.candidates(take.rig.core, DotArrays(*dots.of_frames(frame, frame + 1)), prior)
        certified += int(found["complete"] and found["optimal"])
        worst = max(worst, abs(found["objective"] - milp(found["groups"], found["weights"])))
    return Comparison(frames, certified, worst)


def milp(groups: list[list[int]], weights: np.ndarray) -> float:
    """Largest total weight of disjoint groups, by HiGHS."""
    solver = highspy.Highs()
    solver.setOptionValue("output_flag", False)
    solver.setOptionValue("mip_rel_gap", 0.0)
    solver.setOptionValue("mip_abs_gap", 0.0)
    n = len(groups)
    solver.addVars(n, np.zeros(n), np.ones(n))
    index = np.arange(n, dtype=np.int32)
    solver.changeColsCost(n, index, -np.asarray(weights, float))
    solver.changeColsIntegrality(n, index, np.array([highspy.HighsVarType.kInteger] * n))
    holders: dict[int, list[int]] = {}
    for group, members in enumerate(groups):
        for member in members:
            holders.setdefault(member, []).append(group)
    for members in holders.values():
        solver.addRow(-highspy.kHighsInf, 1.0, len(members), np.array(members, np.int32), np.ones(len(members)))
    solver.run()
    return -solver.getInfo().objective_function_value


def main() -> None:
    """Print one line per model."""
    frames = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    for model in MODELS:
        result = compare(model, frames=frames)
        print(
            f"{model:26} {result.frames} frames, {result.certified} certified, "
            f"largest difference from HiGHS {result.worst_difference:.1e}"
        )


if __name__ == "__main__":
    main()
