"""The seed paper's system as written, and points of other systems."""

import numpy as np
import pytest

import markerloom as ml
from markerloom.errors import InputError


@pytest.fixture(scope="module")
def dance() -> ml.SimulatedTake:
    return ml.simulate(ml.make_scene("dance", frames=300, markers=33, sigma_px=0.3, seed=0))


def test_the_paper_finds_most_markers_and_is_clearly_beaten(dance: ml.SimulatedTake) -> None:
    truth = ml.truth_from_assignments(dance.truth, dance.truth_assignments, dance.rig)
    found = {
        m: ml.evaluate(ml.track(dance.observations, dance.rig, method=m), truth, tolerance_mm=25)
        for m in ("default", "paper")
    }
    assert found["paper"]["accuracy_3d"] > 0.99  # it does work
    assert found["paper"]["trajectories"] > 1.2 * found["default"]["trajectories"]
    assert found["paper"]["ghosts_per_frame"] > 2 * found["default"]["ghosts_per_frame"]
    assert found["paper"]["idf1"] < found["default"]["idf1"]


def test_the_paper_reuses_what_it_knows(dance: ml.SimulatedTake) -> None:
    points = ml.track(dance.observations, dance.rig, method="paper")
    assert points.report["method"] == "paper"
    assert points.report["searched_dots"] < 0.5
    assert set(np.unique(points.kind)) == {0, 1}


def test_an_unknown_method_is_refused(dance: ml.SimulatedTake) -> None:
    with pytest.raises(InputError, match="known are default, paper"):
        ml.track(dance.observations, dance.rig, method="magic")


def swinging(frames: int, rate_hz: float) -> ml.Points:
    """Three rigid clusters that swing past each other."""
    time_s = np.arange(frames) / rate_hz
    layout = np.array([[0, 0, 0], [80, 10, 0], [20, 70, 30], [60, 50, -40]], float)
    clusters = []
    for k in range(3):
        center = np.stack(
            [400 * np.sin(2.0 * time_s + k), 300 * np.cos(1.7 * time_s + 2 * k), 300.0 * k + 0 * time_s], axis=1
        )
        clusters.append(center[:, None] + layout)
    places = np.concatenate(clusters, axis=1)
    n = places.shape[1]
    noise = np.random.default_rng(0).normal(0.0, 0.3, places.shape)
    return ml.Points.of(
        np.repeat(np.arange(frames), n), np.tile(np.arange(n), frames), (places + noise).reshape(-1, 3), rate_hz=rate_hz
    )


@pytest.mark.parametrize("method", ["default", "paper"])
def test_points_become_one_trajectory_per_marker(method: str) -> None:
    points = swinging(200, 100.0)
    found = ml.track(points, method=method)
    assert len(np.unique(found.track)) == 12
    for track in np.unique(found.track):
        rows = found.track == track
        step_mm = np.linalg.norm(np.diff(found.xyz_mm[rows], axis=0), axis=1)
        assert step_mm.max() < 15.0


def test_a_marker_that_jumps_to_and_fro_keeps_its_trajectory() -> None:
    points = swinging(200, 100.0)
    xyz_mm = points.xyz_mm.copy()
    glitch = (points.track == 5) & (points.frame >= 100) & (points.frame < 108) & (points.frame % 2 == 0)
    xyz_mm[glitch] += [0.0, 0.0, 45.0]
    found = ml.track(ml.Points.of(points.frame, points.track, xyz_mm, rate_hz=100.0))
    assert len(np.unique(found.track)) == 12
    assert np.sum(found.kind == 0) >= len(points) - 8


def test_a_hidden_marker_is_carried_by_its_rigid_neighbours() -> None:
    points = swinging(300, 100.0)
    hidden = (points.track == 2) & (points.frame >= 240) & (points.frame < 280)
    found = ml.track(points.keep(~hidden), causal=True)
    truth = points.xyz_mm[hidden]
    carried = (found.kind == 1) & (found.frame >= 240) & (found.frame < 280)
    assert carried.sum() == 40
    error_mm = np.linalg.norm(found.xyz_mm[carried] - truth, axis=1)
    assert np.sqrt(np.mean(error_mm**2)) < 5.0
    assert np.mean((error_mm / found.sigma_mm[carried]) ** 2) < 1.5
