"""The studio on a project with dots: whose they are, reconstruction anew, skeletons, the rig, marker sets, reports."""

import struct
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import markerloom as ml
from markerloom.studio.page import page_is_built
from markerloom.studio.seeing import _owners
from markerloom.studio.standalone import save_view
from studio_client import Studio

pytestmark = pytest.mark.usefixtures("cache")
SWAP = {"op": "swap", "within": {"first": 50, "last": 59}}


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("project")
    scene = ml.make_scene("walk", frames=80, seed=3, marker_set="plug-in-gait-39", t_pose_s=0.3)
    ml.save(ml.simulate(scene), folder / "sim")
    (folder / "markerloom.toml").write_text(
        'calibration = "sim/calibration.toml"\nmarker_set = "plug-in-gait-39"\n[settings]\nskeleton = "hanim-loa1"\n'
        '[takes.walk]\nfile = "sim/observations.parquet"\n'
    )
    return folder


def test_a_dot_of_two_markers_has_two_owners() -> None:
    columns = {"frames": [5, 6], "starts": [0, 2, 3], "camera": [0, 1, 0], "observation": [0, 0, 0]}
    dots: Any = SimpleNamespace(**{name: np.array(values) for name, values in columns.items()})
    rows = [np.array(values) for values in ([6, 5, 5], [0, 0, 0], [0, 0, 0], [4, 3, 9])]
    assert _owners(dots, *rows).tolist() == [[3, -1, 4], [9, -1, -1]]
    assert _owners(dots, *(r[:0] for r in rows)).tolist() == [[-1, -1, -1]] * 2


def test_dots_have_their_owners_even_after_edits(simulated: Path) -> None:
    studio = Studio(ml.view(simulated))
    assert studio.open()["state"] == "ready"
    frame = 40
    view, dots = studio.get(""), studio.get("/dots", frame=frame)
    assert len(dots["cameras"]) == len(view["cameras"]) == 8

    def apart(dots: dict[str, Any]) -> list[float]:
        found = []
        for camera in dots["cameras"]:
            places = {r["slot"]: (r["x"], r["y"]) for r in camera["reprojections"]}
            for dot in camera["dots"]:
                if dot["slot"] in places:
                    x, y = places[dot["slot"]]
                    found.append(float(np.hypot(dot["x"] - x, dot["y"] - y)))
        return found

    before = apart(dots)
    assert len(before) > 100
    assert np.median(before) < 0.5
    a, b = (t["label"] for t in view["trajectories"][:2])
    studio.edit({**SWAP, "at": studio.at(a, 20), "other": studio.at(b, 20), "within": {"first": 30, "last": 50}})
    after = apart(studio.get("/dots", frame=frame))
    assert len(after) == len(before)
    np.testing.assert_allclose(sorted(after), sorted(before), atol=1e-6)
    why = studio.get("/why", slot=studio.slot(a), frame=frame)
    used = [line for line in why["lines"] if "was used" in line]
    assert len(used) == len(why["rays"]) >= 2
    studio.post("/undo", {"revision": studio.get("")["revision"]})


def test_a_camera_is_left_out_and_the_take_reconstructed_again(simulated: Path) -> None:
    studio = Studio(ml.view(simulated))
    studio.open()
    camera = studio.get("")["cameras"][0]["id"]

    def dots() -> list[dict[str, Any]]:
        return next(c["dots"] for c in studio.get("/dots", frame=40)["cameras"] if c["camera"] == camera)

    had = len(dots())
    assert had > 5
    studio.edit({"op": "exclude_camera", "camera": camera, "within": {"first": 0, "last": 79}})
    view = studio.get("")
    assert view["dots_pending"]
    assert all(d["excluded"] for d in dots())
    assert "reconstruct it first" in studio.post("/export", {"file": "x.c3d"}, 422)["message"]
    assert studio.open("/process")["state"] == "ready"
    view = studio.get("")
    assert not view["dots_pending"]
    assert len(dots()) == had
    assert all(d["excluded"] and d["slot"] < 0 for d in dots())
    assert {c["camera"]: c["dots"] for c in studio.get("/coverage")}[camera] == 0
    # The skeleton came with it, and its joints are served.
    assert view["skeleton"]["joints"]
    assert not view["skeleton"]["stale"]
    joints = studio.get("/joints", first=0, count=10)
    count = len(view["skeleton"]["joints"]) + len(view["skeleton"]["ends"])
    assert struct.unpack_from("<4sHHIII", joints)[3:] == (0, 10, count)
    assert np.isfinite(np.frombuffer(joints, "<f4", offset=24)).all()
    angles = studio.get("/joint-series", joint=3, first=0, last=80, bins=80)
    assert len(angles["lows"]["x"]) == 80
    studio.post("/undo", {"revision": view["revision"]})
    assert studio.get("")["dots_pending"]
    assert studio.open("/process")["state"] == "ready"
    assert not any(d["excluded"] for d in dots())


def test_the_rig_is_judged_and_compared(simulated: Path) -> None:
    studio = Studio(ml.view(simulated))
    studio.open()
    found = studio.get("/accuracy")
    cells = len(found["x_m"]) * len(found["y_m"]) * len(found["z_m"])
    assert len(found["sigma_mm"]) == len(found["cameras"]) == cells
    assert all((s < 0) == (c < 2) for s, c in zip(found["sigma_mm"], found["cameras"], strict=True))
    assert 0.05 < found["median_mm"] < 2.0
    refined = studio.get("/refined")
    assert len(refined["cameras"]) == len(refined["moved_mm"]) == 8
    # The simulated cameras stand where the calibration says: there is nothing to gain.
    assert refined["after_px"] > 0.8 * refined["before_px"]
    assert max(refined["moved_mm"].values()) < 20.0


def test_marks_of_contacts_change_what_is_shown(simulated: Path) -> None:
    studio = Studio(ml.view(simulated))
    studio.open("/process")
    site = next(s for s in studio.get("")["skeleton"]["feet"] if s.endswith("heel"))
    studio.edit({"op": "contact", "site": site, "within": {"first": 0, "last": 79}, "stands": False})
    assert site not in [c["site"] for c in studio.get("")["contacts"]]
    studio.edit({"op": "contact", "site": site, "within": {"first": 10, "last": 19}})
    assert {"site": site, "first": 10, "last": 19} in studio.get("")["contacts"]
    assert studio.get("")["skeleton"]["stale"]
    for _ in range(2):
        studio.post("/undo", {"revision": studio.get("")["revision"]})


def test_marker_sets_are_edited_and_saved_into_the_project(simulated: Path) -> None:
    studio = Studio(ml.view(simulated))
    view = studio.client.get("/api/marker-sets/plug-in-gait-39").json()
    view["markers"][0] = {**view["markers"][0], "name": "TOP", "color": "#123456"}
    view["links"] = [["TOP", view["markers"][1]["name"]]]
    saved = studio.client.put("/api/marker-sets/own.toml", json=view)
    assert saved.status_code == 200
    made = ml.read_marker_set(simulated / "own.toml")
    assert (made.markers[0], made.colors[0], made.rigid_pairs) == ("TOP", "#123456", (("TOP", made.markers[1]),))
    assert "own.toml" in studio.client.get("/api/marker-sets").json()
    for name, change, why in (
        ("markerloom.toml", {}, "saved as NAME.toml"),
        ("../own.toml", {}, "no such thing"),
        ("own.toml", {"markers": []}, "at least one"),
        ("own.toml", {"markers": [view["markers"][1]] * 2, "links": []}, "two markers"),
        ("own.toml", {"links": [["TOP", "nobody"]]}, "is no marker of the set"),
    ):
        answer = studio.client.put(f"/api/marker-sets/{name}", json={**view, **change})
        assert answer.status_code in (404, 422), name
        assert why in answer.json()["message"]
    (simulated / "own.toml").unlink()


def test_a_motion_alone_is_shown(simulated: Path) -> None:
    ml.process(simulated)
    studio = Studio(ml.view(simulated / "results/walk/walk.bvh"))
    assert studio.open()["state"] == "ready"
    view = studio.get("")
    assert view["frames"] == 80
    assert view["trajectories"] == []
    assert len(view["skeleton"]["joints"]) == len(view["skeleton"]["parents"])
    assert len(studio.get("/joints", first=0, count=5)) > 24
    assert studio.get("/timeline")["runs"] == []


@pytest.mark.skipif(not page_is_built(), reason="the page is not built")
def test_reports_of_a_project_show_the_take(simulated: Path) -> None:
    ml.process(simulated, viewer=save_view)
    made = simulated / "results/walk"
    assert 'src="view.html"' in (made / "report.html").read_text("utf-8")
    text = (made / "view.html").read_text("utf-8")
    assert "markerloomTake=" in text
    assert "./assets/" not in text
    before = text
    ml.process(simulated, viewer=save_view)
    assert (made / "view.html").read_text("utf-8") == before
