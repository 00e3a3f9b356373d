"""The command line as a user meets it: exit codes, one clear line, reports, no traceback."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

import markerloom as ml

VERBS = [
    "demo",
    "simulate",
    "reconstruct",
    "track",
    "evaluate",
    "inspect",
    "convert",
    "bench",
    "detect",
    "sync",
    "leds",
    "label",
    "fill",
    "mend",
    "smooth",
    "solve",
    "process",
    "view",
]


def run(*arguments: object, code: int = 0) -> str:
    """Run the command line; returns both outputs."""
    command = [sys.executable, "-m", "markerloom.cli", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    text = done.stdout + done.stderr
    assert done.returncode == code, text
    assert "Traceback" not in text
    return text


@pytest.mark.parametrize("verb", VERBS)
def test_help_has_an_example(verb: str) -> None:
    assert f"Example: markerloom {verb}" in run(verb, "--help")


def test_a_take_from_end_to_end(folder: Path, tmp_path: Path) -> None:
    points, dots, report = tmp_path / "points.c3d", tmp_path / "dots.parquet", tmp_path / "report.json"
    calibration = folder / "calibration.toml"
    text = run(
        *("reconstruct", folder / "observations.parquet", "--calibration", calibration, "-o", points),
        *("--assignments", dots, "--report", report),
    )
    assert "100.0 % of frames certified" in text
    content = json.loads(report.read_text())
    assert content["markerloom_version"] == ml.__version__
    assert [len(i["sha256"]) for i in content["inputs"]] == [64, 64]
    wanted = "options frames warnings points_per_frame rays_mean residual_px certified_frames noise_px trajectories"
    assert set(wanted.split()) <= set(content)
    assert set(content["timing"]) == {"seconds", "ms_per_frame", "stages"}
    assert set(content["timing"]["ms_per_frame"]) == {"mean", "p50", "p99", "p999"}
    scores = tmp_path / "scores.json"
    run(
        *("evaluate", points, "--truth", folder / "truth.parquet", "--assignments", dots),
        *("--truth-assignments", folder / "truth_assignments.parquet", "--report", scores, "--quiet"),
    )
    result = json.loads(scores.read_text())
    assert result["accuracy_3d"] >= 0.998
    wanted = "tolerance_mm ghosts_per_frame missing_per_frame accuracy_set error_mm sigma_ratio"
    assert set(wanted.split()) <= set(result)
    assert "content: points" in run("inspect", points)
    run("convert", points, tmp_path / "points.trc")
    assert ml.read_points(tmp_path / "points.trc").rate_hz == 100.0


def test_frames_can_be_chosen(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "p.csv"
    run(
        *("reconstruct", folder / "observations.parquet", "--calibration", folder / "calibration.toml"),
        *("-o", out, "--frames", "3:5", "--method", "relaxation", "--quiet"),
    )
    assert set(ml.read_points(out).frame) == {3, 4}


@pytest.mark.parametrize(
    ("arguments", "code", "reason"),
    [
        (["inspect", "nothing.c3d"], 1, "there is no file"),
        (["inspect", "nothing.xyz"], 1, "files are not read"),
        (["mend", "nothing.c3d", "-o", "a.c3d"], 1, "there is no file nothing.c3d"),
        (["view", "nothing.c3d"], 1, "there is no file"),
        (["reconstruct"], 2, "Missing argument"),
        (["simulate", "moon", "-o", "out"], 1, "choose one of"),
        (["bench", "nothing"], 1, "bench has no row"),
        (["fly"], 2, "No such command"),
    ],
)
def test_wrong_usage_and_failures_have_their_exit_codes(arguments: list[str], code: int, reason: str) -> None:
    assert reason in run(*arguments, code=code)


def test_wrong_values_are_told_apart(folder: Path, tmp_path: Path) -> None:
    take = ["reconstruct", folder / "observations.parquet", "--calibration", folder / "calibration.toml", "-o"]
    assert "not A:B" in run(*take, tmp_path / "a.csv", "--frames", "3", code=2)
    assert "choose one of" in run(*take, tmp_path / "a.csv", "--method", "magic", code=1)
    assert "points are written as" in run(*take, tmp_path / "a.fbx", code=2)
    assert "does not exist" in run(*take, tmp_path / "no" / "a.csv", code=1)
    assert list(tmp_path.iterdir()) == []


def test_a_csv_without_a_rate_is_refused_where_time_matters(folder: Path, tmp_path: Path) -> None:
    run("convert", folder / "observations.parquet", tmp_path / "obs.csv")
    take = ["reconstruct", tmp_path / "obs.csv", "--calibration", folder / "calibration.toml", "-o", tmp_path / "a.c3d"]
    assert "--rate-hz" in run(*take, code=1)
    run(*take, "--rate-hz", "100", "--quiet")
    assert ml.read_points(tmp_path / "a.c3d").rate_hz == 100.0


def test_the_demo_writes_its_files_the_same_every_time(tmp_path: Path) -> None:
    for name in ("a", "b"):
        text = run("demo", "-o", tmp_path / name, "--frames", "12")
        assert "report.html" in text
    files = ("points.c3d", "points.parquet", "report.html", "observations.parquet", "from_pixels/trajectories.c3d")
    for file in files:
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()
    page = (tmp_path / "a" / "report.html").read_text()
    assert page.count("<svg") == 6
    assert "http" not in page.replace("http://www.w3.org/2000/svg", "")


def test_every_verb_has_its_twin_in_python() -> None:
    for verb in VERBS:
        assert callable(getattr(ml, verb)), verb
