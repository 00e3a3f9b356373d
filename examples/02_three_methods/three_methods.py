"""The seed paper's experiment with three methods side by side, judged against the truth."""

import markerloom as ml

take = ml.simulate(ml.make_scene("exp61", frames=50, hide="one"))
truth = ml.truth_from_assignments(take.truth, take.truth_assignments, take.rig)

for method in ("epipolar", "relaxation", "optimal"):
    points = ml.reconstruct(take.observations, take.rig, method=method)
    score = ml.evaluate(points, truth, tolerance_mm=30)
    print(f"{method:10} found {100 * score['accuracy_3d']:.2f} %, ghosts per frame {score['ghosts_per_frame']:.2f}")
