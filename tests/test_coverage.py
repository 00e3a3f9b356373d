"""The planner: what it predicts is what a simulated take then measures."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import markerloom as ml
from markerloom.cli import app


@pytest.fixture(scope="module")
def rig() -> ml.Rig:
    return ml.simulate(ml.make_scene("wand", cameras=8, frames=1)).rig


def test_the_predicted_error_is_that_of_triangulation(rig: ml.Rig) -> None:
    box = ((-0.5, 0.5), (-0.5, 0.5), (0.5, 1.5))
    found = ml.coverage(rig, sigma_px=0.2, volume_m=box)
    assert found.cameras.min() == 8
    place = np.array([axis[17] for axis in found.axes_m])
    random = np.random.default_rng(0)
    errors = []
    for _ in range(300):
        pixels = {c: rig.project(i, place[None])[0] + random.normal(0.0, 0.2, 2) for i, c in enumerate(rig.ids)}
        errors.append(1000.0 * (ml.triangulate(rig, pixels, sigma_px=0.2).point_m - place))
    measured = np.sqrt(np.mean(np.sum(np.square(errors), axis=1)))
    assert found.sigma_mm[17, 17, 17] == pytest.approx(measured, rel=0.12)


def test_what_fewer_than_two_cameras_see_is_said_to_be_unmeasurable(rig: ml.Rig) -> None:
    found = ml.coverage(rig)
    assert np.isinf(found.sigma_mm[found.cameras < 2]).all()
    assert np.isfinite(found.sigma_mm[found.cameras >= 3]).all()
    share = found.report["share_by_cameras"]
    assert share["2"] > share["3"] > share["6"] > 0
    assert found.report["share_by_cameras"]["3"] == pytest.approx(np.mean(found.cameras >= 3))


def test_smaller_markers_are_seen_by_fewer_cameras_and_noise_counts(rig: ml.Rig) -> None:
    usual, small = ml.coverage(rig), ml.coverage(rig, marker_mm=5.0)
    assert small.cameras.sum() < 0.8 * usual.cameras.sum()
    twice = ml.coverage(rig, sigma_px=0.2)
    both = np.isfinite(usual.sigma_mm)
    assert np.allclose(twice.sigma_mm[both], 2.0 * usual.sigma_mm[both])


def test_on_the_command_line_a_page_and_a_table_are_written(rig: ml.Rig, tmp_path: Path) -> None:
    ml.write_calibration(rig, tmp_path / "rig.toml")
    run = CliRunner()
    done = run.invoke(app, ["simulate", "coverage", str(tmp_path / "rig.toml"), "-o", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    page = (tmp_path / "out" / "coverage.html").read_text()
    assert page.count("<svg") == 7
    assert (tmp_path / "out" / "coverage.parquet").exists()
    planned = run.invoke(app, ["simulate", "coverage", "--cameras", "6", "-o", str(tmp_path / "planned")])
    assert planned.exit_code == 0, planned.output
    wrong = run.invoke(app, ["simulate", "coverage", "--volume", "0:1,0:1", "-o", str(tmp_path / "wrong")])
    assert wrong.exit_code == 2
    empty = run.invoke(app, ["simulate", "coverage", "--volume", "1:0,0:1,0:1", "-o", str(tmp_path / "wrong")])
    assert isinstance(empty.exception, ml.InputError)
