"""Real recordings: figures that must hold, on data that are beside the checkout but not in it."""

from pathlib import Path

import numpy as np
import pytest

from real_data import REFLECTIONS, UpperBody, reflections, static_trial


@pytest.fixture(scope="module")
def upper_body(data: Path) -> UpperBody:
    return UpperBody(data)


def test_upper_body_with_a_drifted_calibration(upper_body: UpperBody) -> None:
    result = upper_body.score("optimal")
    assert result["ghosts_per_frame"] <= 0.03
    assert result["missing_per_frame"] == 0
    assert result["error_mm"]["median"] <= 0.35


def test_upper_body_by_relaxation(upper_body: UpperBody) -> None:
    result = upper_body.score("relaxation")
    assert result["ghosts_per_frame"] <= 0.04
    assert result["missing_per_frame"] <= 0.01


def test_static_trial_straight_from_the_raw_file(data: Path) -> None:
    result = static_trial(data, "optimal")
    assert (result["accuracy_3d"], result["ghosts_per_frame"]) == (1.0, 0.0)
    assert result["error_mm"]["median"] < 0.5


@pytest.mark.parametrize(("folder", "calibration"), REFLECTIONS)
def test_true_markers_among_reflections_and_nothing_else(data: Path, folder: str, calibration: str) -> None:
    found, markers, worst_mm = reflections(data, folder, calibration, "optimal")
    assert found == markers
    assert worst_mm <= 5.0


@pytest.mark.slow
@pytest.mark.parametrize("cameras", [6, 5, 4])
def test_with_fewer_cameras_no_worse_than_relaxation(upper_body: UpperBody, cameras: int) -> None:
    from itertools import combinations

    chosen = [list(c) for c in combinations(upper_body.active, cameras)][::14]
    means = {}
    for method in ("optimal", "relaxation"):
        results = [upper_body.score(method, c) for c in chosen]
        means[method] = [np.mean([r[f] for r in results]) for f in ("ghosts_per_frame", "missing_per_frame")]
    assert means["optimal"][0] <= means["relaxation"][0]
    assert means["optimal"][1] <= means["relaxation"][1]
