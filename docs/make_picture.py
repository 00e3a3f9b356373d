"""The README's picture: the demo's rig and the three methods on one frame, as one SVG. Run: make picture"""

from pathlib import Path

from markerloom import pictures
from markerloom.demo import three_methods
from markerloom.evaluate import truth_from_assignments
from markerloom.reconstruct import METHODS, reconstruct
from markerloom.simulate import make_scene, simulate

HERE = Path(__file__).parent


def main() -> None:
    """Write docs/picture.svg."""
    take = simulate(make_scene("dance", frames=120))
    truth = truth_from_assignments(take.truth, take.truth_assignments, take.rig)
    answers = {method: reconstruct(take.observations, take.rig, method=method) for method in METHODS}
    best = answers["optimal"]
    frame = 60
    now = best.xyz_mm[best.frame == frame] / 1000.0
    scene = pictures.rig_and_points(
        take.rig, now, best.xyz_mm[::5] / 1000.0, "8 cameras, one dancer, points of one frame"
    )
    methods = three_methods(take, truth, answers, frame)
    body = [_placed(scene, 0, 760, 420), _placed(methods, 428, 760, 293)]
    (HERE / "picture.svg").write_text(pictures.svg(760, 726, body, "markerloom: rig, and three methods") + "\n")


def _placed(picture: str, y: int, width: int, height: int) -> str:
    return picture.replace("<svg ", f"<svg y='{y}' width='{width}' height='{height}' ", 1)


if __name__ == "__main__":
    main()
