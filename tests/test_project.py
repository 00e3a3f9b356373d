"""Projects: the whole chain, what is not computed again, takes that fail, settings that cascade."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import markerloom as ml
from test_label import figure, names_of, points_of


@pytest.fixture
def project(tmp_path: Path) -> Path:
    folder = tmp_path / "friday"
    (folder / "takes").mkdir(parents=True)
    xyz_mm = figure("walk", 2, 700)
    ml.write_subject(ml.create_subject(points_of(xyz_mm[:300], names_of(41)), name="anna"), folder / "anna.toml")
    later = xyz_mm[300:].copy()
    later[50:70, 5] = float("nan")
    points_of(later).save(folder / "takes/one.parquet")
    points_of(later[:200]).save(folder / "takes/two.c3d")
    (folder / "markerloom.toml").write_text(
        'name = "Friday"\nsubjects = ["anna.toml"]\n[settings]\nlongest_s = 1.0\nexport = [".c3d", ".trc"]\n'
    )
    return folder


def test_takes_go_the_whole_way_and_are_not_computed_again(project: Path) -> None:
    first = ml.process(project)
    assert [r["take"] for r in first["takes"]] == ["one", "two"]
    assert [r["ran"] for r in first["takes"]] == [["label", "fill"], ["label", "fill"]]
    assert first["takes"][0]["filled"] == 1
    assert first["takes"][0]["complete"] == 1.0
    results = project / "results"
    assert set(ml.read_points(results / "one/one.c3d").slots()[0]) == set(names_of(41))
    for file in ("report.html", "quality.csv", "one/report.html", "one/one.trc", "one/made-with/anna.toml"):
        assert (results / file).stat().st_size > 0, file
    before = (results / "one/one.c3d").read_bytes()
    assert [r["ran"] for r in ml.process(project)["takes"]] == [[], []]
    settings = (project / "markerloom.toml").read_text()
    (project / "markerloom.toml").write_text(settings.replace("longest_s = 1.0", "longest_s = 0.1"))
    again = ml.process(project, takes=["one"])["takes"][0]
    assert (again["ran"], again["filled"]) == (["fill"], 0)
    assert (results / "one/one.c3d").read_bytes() != before


def test_a_killed_run_goes_on(project: Path) -> None:
    ml.process(project)
    (project / "results/one/fill.json").unlink()
    assert [r["ran"] for r in ml.process(project)["takes"]] == [["fill"], []]


def test_a_broken_take_does_not_stop_the_others(project: Path) -> None:
    (project / "takes/broken.c3d").write_bytes(b"nonsense")
    result = ml.process(project)
    assert [f["take"] for f in result["failed"]] == ["broken"]
    assert [r["take"] for r in result["takes"]] == ["one", "two"]
    assert "broken" in (project / "results/quality.csv").read_text()


def test_settings_of_a_take_come_before_those_of_the_project(project: Path) -> None:
    text = (project / "markerloom.toml").read_text()
    (project / "markerloom.toml").write_text(
        text + '[takes.short]\nfile = "takes/one.parquet"\nframes = "0:100"\nfill = "rigid"\n'
    )
    take = ml.read_project(project).takes[0]
    assert (take.frames, take.fill, take.longest_s, take.export) == ("0:100", "rigid", 1.0, (".c3d", ".trc"))
    assert ml.process(project)["takes"][0]["frames"] == 100


def test_odd_settings_are_refused(project: Path) -> None:
    text = (project / "markerloom.toml").read_text()
    for wrong, said in (("longest = 3\n", "no setting"), ("cutoff_hz = 'x'\n", "not a float")):
        (project / "markerloom.toml").write_text(text + wrong)
        with pytest.raises(ml.FormatError, match=said):
            ml.read_project(project)
    with pytest.raises(ml.InputError, match=r"no markerloom\.toml"):
        ml.read_project(project / "takes")


def test_a_project_from_dots_to_names(tmp_path: Path) -> None:
    scene = ml.make_scene("walk", marker_set="plug-in-gait-39", t_pose_s=1.0, frames=260, seed=1)
    ml.save(ml.simulate(scene), tmp_path / "takes")
    folder = tmp_path
    (folder / "markerloom.toml").write_text(
        'calibration = "takes/calibration.toml"\nmarker_set = "plug-in-gait-39"\n'
        '[takes.walk]\nfile = "takes/observations.parquet"\n'
    )
    row = ml.process(folder)["takes"][0]
    assert row["ran"] == ["track", "label", "fill"]
    assert row["named"] > 0.9


def test_virtual_markers_are_exported(project: Path) -> None:
    first, second = names_of(41)[:2]
    points_of(figure("walk", 2, 20), names_of(41)).save(project / "takes/named.c3d")
    made = replace(ml.read_marker_set(project / "takes/named.c3d"), virtual={"MIDDLE": (first, second)})
    ml.write_marker_set(made, project / "ours.toml")
    (project / "takes/named.c3d").unlink()
    text = (project / "markerloom.toml").read_text()
    ml.process(project)
    (project / "markerloom.toml").write_text(text + 'virtual = "ours.toml"\n')
    assert [r["ran"] for r in ml.process(project)["takes"]] == [[], []]
    points = ml.read_points(project / "results/one/one.c3d")
    place = {n: points.xyz_mm[points.label == n] for n in (first, second, "MIDDLE")}
    np.testing.assert_allclose(place["MIDDLE"], (place[first] + place[second]) / 2.0, atol=1e-3)
