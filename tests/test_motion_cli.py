"""The verb edit on the command line, and motions as glTF."""

import json
from pathlib import Path

import numpy as np
import pytest

import markerloom as ml
from markerloom.errors import FormatError
from motion_clips import walk
from test_cli import run

VERBS = ("bands", "warp", "timewarp", "retarget", "footlock", "blend", "concat", "mirror", "crop", "resample", "loop")
GRAPH = ("build", "walk", "path", "find")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("clips")
    ml.write_motion(walk(3.0, slip_m=0.005), path / "walk.bvh")
    ml.write_motion(walk(3.0, step_m=0.4, period_s=1.2), path / "slow.bvh")
    return path


@pytest.mark.parametrize("verb", [*VERBS, "inplace"])
def test_help_has_an_example(verb: str) -> None:
    assert f"Example: markerloom edit {verb}" in run("edit", verb, "--help")


@pytest.mark.parametrize("verb", GRAPH)
def test_help_of_graphs_has_an_example(verb: str) -> None:
    assert f"Example: markerloom edit graph {verb}" in run("edit", "graph", verb, "--help")


@pytest.mark.parametrize(
    "arguments",
    [
        ("bands", "walk.bvh", "--style", "calmer", "--gain", "5-20=0.5", "--band", "0=0", "--joints", "arms,Spine"),
        ("bands", "walk.bvh", "--shape", "Head:-40=-20,0=0,40=20", "--root", "--hold-feet"),
        ("warp", "walk.bvh", "--key", "1.0:Head=10,0,20", "--reach", "2.0:LeftHand=300,-1800,1300", "--within", "0.5"),
        ("warp", "walk.bvh", "--pose", "1.0:slow.bvh=20", "--by", "scale"),
        ("timewarp", "walk.bvh", "--key", "1.0=1.5"),
        ("footlock", "walk.bvh"),
        ("retarget", "walk.bvh", "--target", "hanim-loa1"),
        ("retarget", "walk.bvh", "--target", "slow.bvh"),
        ("blend", "walk.bvh", "slow.bvh", "--fade", "0.3"),
        ("blend", "walk.bvh", "slow.bvh", "--weights", "0.3,0.7"),
        ("concat", "walk.bvh", "slow.bvh", "walk.bvh"),
        ("concat", "walk.bvh", "slow.bvh", "--neutral"),
        ("concat", "walk.bvh", "slow.bvh", "--neutral-pose", "slow.bvh=3"),
        ("mirror", "walk.bvh"),
        ("crop", "walk.bvh", "--from", "0.5", "--to", "2"),
        ("resample", "walk.bvh", "--rate-hz", "30"),
        ("loop", "walk.bvh", "--times", "2", "--fade", "0.2", "--in-place"),
        ("inplace", "walk.bvh"),
    ],
)
def test_every_operation(folder: Path, tmp_path: Path, arguments: tuple[str, ...]) -> None:
    files = [str(folder / a) if a.endswith(".bvh") and "=" not in a and ":" not in a else a for a in arguments]
    files = [a.replace("slow.bvh=", f"{folder / 'slow.bvh'}=") for a in files]
    out, report = tmp_path / "out.bvh", tmp_path / "report.json"
    text = run("edit", *files, "-o", out, "--report", report)
    assert "frames; " in text
    assert str(out) in text
    content = json.loads(report.read_text())
    assert content["frames"] == len(ml.read_motion(out)) > 0
    assert {"inputs", "options", "warnings", "markerloom_version"} <= set(content)


def test_a_page_shows_before_and_after(folder: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    run("edit", "footlock", folder / "walk.bvh", "-o", tmp_path / "out.bvh", "--page", page)
    text = page.read_text()
    for part in ("At a glance", "Joints that changed most", "Feet", "Way over the floor", "Accelerations"):
        assert f"{part}</h2>" in text


def test_what_was_found_can_be_edited(folder: Path, tmp_path: Path) -> None:
    found, mapping = tmp_path / "found.toml", tmp_path / "mapping.toml"
    out = ("-o", tmp_path / "out.bvh")
    run(
        *("edit", "retarget", folder / "walk.bvh", "--target", "hanim-loa1", *out),
        *("--constraints-out", found, "--mapping-out", mapping),
    )
    assert "[[plants]]" in found.read_text()
    again = run(
        *("edit", "retarget", folder / "walk.bvh", "--target", "hanim-loa1", *out),
        *("--constraints", found, "--mapping", mapping),
    )
    assert "stances slide at most 0.0" in again


def test_a_library_from_the_shell(folder: Path, tmp_path: Path) -> None:
    library, out = tmp_path / "library.sqlite", tmp_path / "out.bvh"
    assert "2 clips, 360 frames" in run("edit", "graph", "build", library, folder / "walk.bvh", folder / "slow.bvh")
    run("edit", "graph", "walk", library, "--seconds", "6", "--seed", "2", "-o", out)
    assert len(ml.read_motion(out)) == 360
    assert "m rms from the line" in run("edit", "graph", "path", library, "--line", "0,0 2,0", "-o", out)
    assert "slow  frame 30" in run("edit", "graph", "find", library, folder / "slow.bvh", "--frame", "30")


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (("bands", "walk.bvh", "-o", "x.txt"), 2, "motions are written as"),
        (("bands", "walk.bvh", "--gain", "five", "-o", "x.bvh"), 2, "LOW-HIGH=GAIN"),
        (("warp", "walk.bvh", "--key", "9:Head=0,0,0", "-o", "x.bvh"), 1, "is not in the clip"),
        (("timewarp", "walk.bvh", "--key", "1=2", "--key", "1.5=1", "-o", "x.bvh"), 1, "time would run backwards"),
        (("retarget", "walk.bvh", "--target", "gone.bvh", "-o", "x.bvh"), 1, "there is no file"),
        (("blend", "walk.bvh", "-o", "x.bvh"), 2, "a fade is of two clips"),
        (("concat", "walk.bvh", "-o", "x.bvh"), 1, "two clips or more"),
        (("graph", "build", "x.sqlite", "walk.bvh"), 1, "a library needs two clips or more"),
        (("graph", "walk", "walk.bvh", "-o", "x.bvh"), 1, "is no library of clips"),
    ],
)
def test_bad_wishes(folder: Path, tmp_path: Path, arguments: tuple[str, ...], code: int, said: str) -> None:
    placed = [str(folder / a) if a == "walk.bvh" else str(tmp_path / a) if a.startswith("x.") else a for a in arguments]
    text = run("edit", *placed, code=code)
    assert said in " ".join(text.replace("│", " ").split())
    assert not list(tmp_path.iterdir())


def test_gltf_comes_back(tmp_path: Path) -> None:
    pytest.importorskip("pygltflib")
    clip = walk(2.0)
    ml.write_motion(clip, tmp_path / "walk.glb")
    again = ml.read_motion(tmp_path / "walk.glb")
    assert again.rate_hz == clip.rate_hz
    assert again.skeleton.joints == clip.skeleton.joints
    assert np.abs(again.joints_m() - clip.joints_m()).max() < 1e-5
    order = [[s.name for s in again.skeleton.sites].index(s.name) for s in clip.skeleton.sites]
    assert np.abs(again.sites_m()[:, order] - clip.sites_m()).max() < 1e-5
    assert len(ml.read_motion(tmp_path / "walk.glb", rate_hz=30.0)) == 60


def test_broken_gltf_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("pygltflib")
    ml.write_motion(walk(0.5), tmp_path / "walk.glb")
    whole = (tmp_path / "walk.glb").read_bytes()
    rng, said, read = np.random.default_rng(0), [], 0
    for k in range(60):
        broken = bytearray(whole[: int(rng.integers(0, len(whole)))] if k % 2 else whole)
        for at in rng.integers(0, max(len(broken), 1), 8):
            if at < len(broken):
                broken[at] = int(rng.integers(0, 256))
        (tmp_path / "broken.glb").write_bytes(bytes(broken))
        try:
            read += len(ml.read_motion(tmp_path / "broken.glb")) > 0
        except FormatError as error:
            said.append(str(error))
    assert len(said) + read == 60
    assert all("broken.glb" in text for text in said)
