"""The definitions of evaluation, each on a case small enough to check by hand."""

import numpy as np
import pyarrow as pa
import pytest

import markerloom as ml
from markerloom.evaluate import expected_calibration_error
from markerloom.points import Points


def points(rows: list[tuple[int, float]], *, tracks: list[int] | None = None, **known: object) -> Points:
    """Points on the x axis: (frame, x in mm)."""
    frame = np.array([r[0] for r in rows], np.int64)
    xyz = np.array([[r[1], 0.0, 0.0] for r in rows], float)
    track = np.array(tracks if tracks is not None else range(len(rows)), np.int64)
    return Points.of(frame, track, xyz, **known)


def truth(rows: list[tuple[int, float]], labels: list[str]) -> Points:
    return points(rows, label=np.array(labels))


def test_hits_misses_and_ghosts() -> None:
    found = points([(0, 1.0), (0, 500.0)], tracked=False)
    result = ml.evaluate(found, ml.truth_without_views(truth([(0, 0.0), (0, 200.0)], ["A", "B"])), tolerance_mm=10)
    assert (result["accuracy_3d"], result["ghosts_per_frame"], result["missing_per_frame"]) == (0.5, 1.0, 1.0)
    assert result["error_mm"]["median"] == 1.0


def test_a_duplicate_of_a_marker_is_a_ghost() -> None:
    result = ml.evaluate(points([(0, 1.0), (0, 2.0)], tracked=False), ml.truth_without_views(truth([(0, 0.0)], ["A"])))
    assert result["ghosts_per_frame"] == 1.0


def test_optional_samples_are_neither_hit_nor_miss_nor_ghost() -> None:
    samples = truth([(0, 0.0), (0, 200.0)], ["A", "B"])
    views = pa.table(
        {"frame": [0, 0, 0], "camera": ["1", "2", "1"], "observation": [0, 0, 1], "label": ["A", "A", "B"]}
    )
    reference = ml.truth_from_assignments(samples, views, None)
    near = ml.evaluate(points([(0, 0.0), (0, 235.0)], tracked=False), reference, tolerance_mm=10)
    assert (near["required_samples"], near["ghosts_per_frame"], near["missing_per_frame"]) == (1, 0.0, 0.0)
    far = ml.evaluate(points([(0, 0.0), (0, 245.0)], tracked=False), reference, tolerance_mm=10)
    assert far["ghosts_per_frame"] == 1.0


def test_a_merged_blob_is_no_view_of_either_marker() -> None:
    samples = truth([(0, 0.0), (0, 2.0)], ["A", "B"])
    rows = [("1", 0, "A"), ("1", 0, "B"), ("2", 0, "A"), ("2", 1, "B"), ("3", 0, "A")]
    views = pa.table(
        {
            "frame": [0] * 5,
            "camera": [r[0] for r in rows],
            "observation": [r[1] for r in rows],
            "label": [r[2] for r in rows],
        }
    )
    assert ml.truth_from_assignments(samples, views, None).required.tolist() == [True, False]


def test_rays_that_are_nearly_parallel_make_a_sample_optional(take: ml.SimulatedTake) -> None:
    close = ml.Rig.of(
        [
            ml.Camera(**{**vars(take.rig.cameras[0]), "id": "a"}),
            ml.Camera(**{**vars(take.rig.cameras[0]), "id": "b", "position_m": take.rig.cameras[0].position_m + 0.01}),
        ]
    )
    views = pa.table({"frame": [0, 0], "camera": ["a", "b"], "observation": [0, 0], "label": ["A", "A"]})
    assert not ml.truth_from_assignments(truth([(0, 0.0)], ["A"]), views, close).required[0]


def test_exact_sets_need_every_dot_and_no_other() -> None:
    samples = truth([(0, 0.0)], ["A"])
    views = pa.table({"frame": [0, 0], "camera": ["1", "2"], "observation": [0, 3], "label": ["A", "A"]})
    reference = ml.truth_from_assignments(samples, views, None)
    columns = {"frame": [0, 0, 0], "camera": ["1", "2", "3"], "observation": [0, 3, 1], "track": [0, 0, 0]}
    more = pa.table(columns)
    assert ml.evaluate(points([(0, 0.0)]), reference, assignments=more)["accuracy_set"] == 0.0
    assert ml.evaluate(points([(0, 0.0)]), reference, assignments=more.slice(0, 2))["accuracy_set"] == 1.0


def test_the_last_match_is_kept_while_it_is_within_the_tolerance() -> None:
    samples = truth([(0, 0.0), (0, 20.0), (1, 8.0), (1, 12.0)], ["A", "B", "A", "B"])
    found = points([(0, 0.0), (0, 20.0), (1, 12.5), (1, 7.5)], tracks=[0, 1, 0, 1])
    result = ml.evaluate(found, ml.truth_without_views(samples), tolerance_mm=10)
    assert (result["id_switches"], result["trajectories"]) == (0, 2)


def test_a_switch_and_fragments_are_counted() -> None:
    samples = truth([(f, 0.0) for f in range(4)], ["A"] * 4)
    found = points([(f, 0.0) for f in range(4)], tracks=[0, 0, 5, 5])
    result = ml.evaluate(found, ml.truth_without_views(samples), tolerance_mm=10)
    assert (result["id_switches"], result["fragments_per_marker"], result["trajectories"]) == (1, 2.0, 2)


def test_predicted_rows_have_their_own_figures() -> None:
    samples = truth([(0, 0.0), (0, 300.0)], ["A", "B"])
    found = points([(0, 1.0), (0, 310.0), (0, 900.0)], kind=np.array([0, 1, 1]))
    result = ml.evaluate(found, ml.truth_without_views(samples), tolerance_mm=10)
    assert (result["ghosts_per_frame"], result["missing_per_frame"]) == (0.0, 1.0)
    assert result["predicted_error_mm"]["median"] == pytest.approx(10.0)
    assert result["predicted_unmatched_per_frame"] == 1.0


def test_rigid_alignment_removes_a_gauge_difference(take: ml.SimulatedTake) -> None:
    turn, shift = np.array([[0.9999, -0.0141, 0], [0.0141, 0.9999, 0], [0, 0, 1.0]]), np.array([5.0, -3.0, 2.0])
    u, _, vt = np.linalg.svd(turn)
    moved = Points.of(take.truth.frame, take.truth.track, take.truth.xyz_mm @ (u @ vt).T + shift, tracked=False)
    reference = ml.truth_without_views(take.truth)
    assert ml.evaluate(moved, reference, tolerance_mm=1)["accuracy_3d"] < 0.1
    assert ml.evaluate(moved, reference, tolerance_mm=1, align="rigid")["accuracy_3d"] == 1.0


def test_sigma_ratio_is_the_mean_square_of_error_over_sigma() -> None:
    found = points([(0, 2.0), (0, 103.0)], tracked=False, sigma_mm=np.array([1.0, 3.0]))
    result = ml.evaluate(found, ml.truth_without_views(truth([(0, 0.0), (0, 100.0)], ["A", "B"])))
    assert result["sigma_ratio"] == pytest.approx((4.0 + 1.0) / 2)


def test_calibration_error_of_confidences() -> None:
    assert expected_calibration_error([(0.95, True)] * 19 + [(0.95, False)]) == pytest.approx(0.0)
    assert expected_calibration_error([(0.95, False)] * 10) == pytest.approx(0.95)


def test_a_truth_without_samples_in_range_is_refused() -> None:
    with pytest.raises(ml.InputError, match="no sample"):
        ml.evaluate(points([(0, 0.0)]), ml.truth_without_views(truth([(0, 0.0)], ["A"])), frames=(5, 9))
