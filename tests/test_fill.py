"""Filling and smoothing: exact where it must be, expected errors with noise, gaps respected, nothing silent."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import markerloom as ml
from markerloom.filling.methods import METHODS
from markerloom.trajectories import FILLED, Trajectories
from test_label import RATE, figure, names_of, points_of


def with_gaps(xyz_mm: np.ndarray, gaps: list[tuple[int, int, int]]) -> ml.Points:
    hidden = xyz_mm.copy()
    for marker, first, last in gaps:
        hidden[first:last, marker] = np.nan
    return points_of(hidden, names_of(xyz_mm.shape[1]))


def error_mm(filled: ml.Points, xyz_mm: np.ndarray, gaps: list[tuple[int, int, int]]) -> float:
    take = Trajectories.of(filled)
    return max(float(np.abs(take.xyz_mm[a:b, m] - xyz_mm[a:b, m]).max()) for m, a, b in gaps)


GAPS = [(0, 200, 230), (17, 300, 420), (33, 100, 108)]


@pytest.mark.parametrize("method", [m for m in METHODS if m != "constant"])
def test_a_body_that_moves_as_one_is_filled_exactly_from_its_neighbours(method: str) -> None:
    places = np.random.default_rng(0).normal(0, 150.0, (12, 3))
    times = np.arange(500) / RATE
    path = np.column_stack([100.0 * times, 50.0 * times, 0.0 * times])
    rigid = places[None] + path[:, None]
    gaps = [(3, 200, 260), (7, 300, 330)]
    filled = ml.fill(with_gaps(rigid, gaps), method=method)
    assert error_mm(filled, rigid, gaps) < (1e-6 if method != "links" else 1e-3)


def test_auto_fills_a_dance_and_says_how_well() -> None:
    xyz_mm = figure("dance", 3, 1200)
    filled = ml.fill(with_gaps(xyz_mm, GAPS))
    take = Trajectories.of(filled)
    for gap, (marker, first, last) in zip(filled.report["filled"], sorted(GAPS), strict=True):
        off = take.xyz_mm[first:last, marker] - xyz_mm[first:last, marker]
        assert np.sqrt((off**2).sum(axis=1).mean()) < 2.5 * gap["expected_mm"] + 0.1
        assert gap["expected_mm"] < 12.0
    assert np.sum(filled.kind == FILLED) == sum(b - a for _, a, b in GAPS)
    assert np.isfinite(filled.sigma_mm[filled.kind == FILLED]).all()
    assert [g["tried"] for g in filled.report["filled"]] == [True] * 3
    assert filled.report["complete_after"] == 1.0


def test_sigma_is_of_the_size_of_the_error() -> None:
    rng = np.random.default_rng(4)
    truth = figure("dance", 5, 2000)
    skin = np.cumsum(rng.normal(0, 0.6, truth.shape), axis=0)
    xyz_mm = truth + skin - skin.mean(axis=0)
    gaps = [(m, 60 + 200 * k + 4 * m, 60 + 200 * k + 4 * m + 25) for k in range(9) for m in range(0, 41, 5)]
    take = Trajectories.of(ml.fill(with_gaps(xyz_mm, gaps)))
    ratios = [
        (((take.xyz_mm[a:b, m] - xyz_mm[a:b, m]) ** 2).sum(axis=1) / take.sigma_mm[a:b, m] ** 2).mean()
        for m, a, b in gaps
    ]
    assert 0.5 < np.mean(ratios) < 1.6


def test_long_gaps_ends_and_beginnings_stay() -> None:
    xyz_mm = figure("walk", 1, 800)
    points = with_gaps(xyz_mm, [(2, 100, 500), (4, 0, 50), (5, 700, 800), (6, 300, 320)])
    filled = ml.fill(points)
    take = Trajectories.of(filled)
    assert [g["marker"] for g in filled.report["filled"]] == ["M06"]
    assert not np.isfinite(take.xyz_mm[:50, 4]).any()
    assert not np.isfinite(take.xyz_mm[700:, 5]).any()
    assert [g["marker"] for g in filled.report["left"]] == ["M02"]
    assert "1 gaps stay" in filled.report["warnings"][0]


def test_measured_samples_are_not_touched_and_the_same_input_gives_the_same_bytes(tmp_path: Path) -> None:
    xyz_mm = figure("dance", 2, 700)
    points = with_gaps(xyz_mm, GAPS)
    for name in ("a.c3d", "b.c3d"):
        ml.fill(points).save(tmp_path / name)
    assert (tmp_path / "a.c3d").read_bytes() == (tmp_path / "b.c3d").read_bytes()
    again = Trajectories.of(ml.read_points(tmp_path / "a.c3d"))
    measured = again.kind == 0
    assert np.abs(again.xyz_mm - xyz_mm)[measured].max() < 1e-3
    assert np.array_equal(~measured, ~np.isfinite(Trajectories.of(points).xyz_mm).all(axis=2))


def test_unknown_methods_and_markers_are_refused() -> None:
    points = with_gaps(figure("walk", 1, 100), [])
    with pytest.raises(ml.InputError, match="auto, constant"):
        ml.fill(points, method="magic")
    with pytest.raises(ml.InputError, match="no marker 'Q'"):
        ml.fill(points, markers=["Q"])


def test_butterworth_has_the_cut_off_that_was_asked_for() -> None:
    times = np.arange(4000) / RATE
    for hz, gain in ((6.0, 1 / np.sqrt(2)), (1.0, 1.0), (20.0, 0.01)):
        wave = np.column_stack([np.sin(2 * np.pi * hz * times)] * 3)[:, None] * 100.0
        smoothed = Trajectories.of(ml.smooth(points_of(wave, ["A"]), cutoff_hz=6.0, outliers=False)).xyz_mm
        middle = slice(1000, 3000)
        ratio = smoothed[middle].std() / wave[middle].std()
        assert ratio == pytest.approx(gain, abs=0.02)
        if gain > 0.5:  # no lag: nothing left a quarter period away
            assert abs(np.vdot(smoothed[middle, 0, 0], np.cos(2 * np.pi * hz * times[middle]))) < 1.0


@pytest.mark.parametrize("method", ["butterworth", "average", "gcv", "kalman"])
def test_smoothing_takes_noise_off_and_leaves_gaps(method: str) -> None:
    truth = figure("walk", 3, 600, markers=15)
    noisy = truth + np.random.default_rng(0).normal(0, 1.5, truth.shape)
    noisy[200:260, 4] = np.nan
    smoothed = Trajectories.of(ml.smooth(points_of(noisy, names_of(15)), method=method, cutoff_hz=10.0, outliers=False))
    assert np.array_equal(np.isfinite(smoothed.xyz_mm), np.isfinite(noisy))
    before, after = np.nanstd(noisy - truth), np.nanstd(smoothed.xyz_mm - truth)
    assert after < 0.8 * before


def test_outliers_are_thrown_away_and_fast_motion_is_not() -> None:
    truth = figure("dance", 1, 1500)
    wrong = truth + np.random.default_rng(3).normal(0, 0.3, truth.shape)
    hits = [(100, 3), (500, 20), (900, 7), (1200, 40)]
    for frame, marker in hits:
        wrong[frame, marker] += [40.0, -30.0, 20.0]
    cleaned = ml.smooth(points_of(wrong, names_of(41)), method="none")
    gone = ~np.isfinite(Trajectories.of(cleaned).xyz_mm).all(axis=2)
    assert set(map(tuple, np.argwhere(gone).tolist())) == set(hits)


def test_a_cut_off_above_half_the_rate_is_refused() -> None:
    with pytest.raises(ml.InputError, match="half the frame rate"):
        ml.smooth(points_of(figure("walk", 1, 50), names_of(41)), cutoff_hz=60.0)


def test_virtual_markers_follow_from_their_markers(tmp_path: Path) -> None:
    from markerloom.points import KINDS
    from test_cli import run

    rng = np.random.default_rng(0)
    xyz_mm = np.cumsum(rng.normal(0.0, 2.0, (80, 4, 3)), axis=0) + 500.0 * np.arange(4)[:, None]
    names = ["LPSI", "RPSI", "LASI", "C7"]
    take = points_of(xyz_mm, names)
    take = replace(take, sigma_mm=np.full(len(take), 0.6), kind=np.where(take.frame == 7, KINDS.index("filled"), 0))
    take = take.keep(~((take.label == "RPSI") & (take.frame == 9)))
    made = ml.with_virtual_markers(take, ml.read_marker_set("plug-in-gait-39"))
    own = made.keep(made.label == "SACR")
    assert sorted(set(made.label)) == ["C7", "LASI", "LPSI", "RPSI", "SACR"], "no MASI without RASI"
    assert own.frame.tolist() == [f for f in range(80) if f != 9]
    np.testing.assert_allclose(own.xyz_mm, xyz_mm[own.frame][:, :2].mean(axis=1), atol=1e-9)
    np.testing.assert_allclose(own.sigma_mm, 0.6 / np.sqrt(2.0))
    assert own.kind[7] == KINDS.index("filled")
    assert own.kind[8] == 0
    again = ml.with_virtual_markers(made, ml.read_marker_set("plug-in-gait-39"))
    assert len(again) == len(made)
    with pytest.raises(ml.InputError, match="has no virtual markers"):
        ml.with_virtual_markers(take, ml.read_marker_set("minimal-14"))
    with pytest.raises(ml.InputError, match="has not the markers of any virtual one"):
        ml.with_virtual_markers(take.keep(take.label == "C7"), ml.read_marker_set("plug-in-gait-39"))
    take.save(tmp_path / "take.c3d")
    run("fill", tmp_path / "take.c3d", "-o", tmp_path / "out.c3d", "--virtual", "plug-in-gait-39")
    assert (ml.read_points(tmp_path / "out.c3d").label == "SACR").sum() == 80
