"""The studio's server: who may speak to it, what it shows, what edits do, and that nothing is lost or overwritten."""

import struct
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

import markerloom as ml
from markerloom.errors import InputError
from markerloom.mending import edits as e
from markerloom.mending.sheet import Sheet
from markerloom.studio import chunks, stored
from markerloom.studio.opened import open_take
from markerloom.studio.page import page_is_built
from markerloom.studio.wire import typescript
from motion_clips import walk
from studio_client import HOST, TOKEN, Studio
from test_mending import take as swing

pytestmark = pytest.mark.usefixtures("cache")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    swing(gap=(200, 229)).save(tmp_path / "swing.parquet")
    return tmp_path / "swing.parquet"


@pytest.fixture
def studio(file: Path) -> Studio:
    made = Studio(ml.view(file))
    assert made.open()["state"] == "ready"
    return made


SWAP = {"op": "swap", "within": {"first": 50, "last": 59}}


def test_who_has_no_token_or_comes_from_elsewhere_is_refused(studio: Studio) -> None:
    client = TestClient(studio.client.app, base_url=HOST)
    for path in ("/api/project", f"/api/takes/{studio.name}", f"/api/takes/{studio.name}/chunk?first=0&count=1", "/"):
        assert client.get(path).status_code == 403
        assert client.get(path, headers={"X-Markerloom-Token": "another"}).status_code == 403
    good = {"X-Markerloom-Token": TOKEN}
    assert client.get("/api/project", headers=good).status_code == 200
    assert client.get(f"/api/project?token={TOKEN}").status_code == 200
    for origin in ("http://evil.example", "http://127.0.0.1:9999", "null", "https://127.0.0.1:8123"):
        answer = client.get("/api/project", headers={**good, "Origin": origin})
        assert (answer.status_code, answer.json()["error"]) == (403, "refused"), origin
    assert client.get("/api/project", headers={**good, "Origin": HOST}).status_code == 200
    # A name that somebody else made to lead here (DNS rebinding).
    answer = client.get("/api/project", headers={**good, "Host": "studio.evil.example:8123"})
    assert answer.status_code == 403
    assert "access-control-allow-origin" not in answer.headers


@pytest.mark.parametrize(
    "path",
    [
        "../secret.txt",
        "..%2Fsecret.txt",
        "%2e%2e/secret.txt",
        "/etc/passwd",
        "%2Fetc%2Fpasswd",
        "results/../../secret.txt",
        "link.txt",
    ],
)
def test_nothing_outside_the_project_is_served(tmp_path: Path, path: str) -> None:
    project = tmp_path / "project"
    (project / "takes").mkdir(parents=True)
    swing().save(project / "takes/a.parquet")
    (project / "markerloom.toml").write_text('name = "x"\n')
    (project / "notes.txt").write_text("mine")
    (tmp_path / "secret.txt").write_text("theirs")
    (project / "link.txt").symlink_to(tmp_path / "secret.txt")
    client = Studio(ml.view(project)).client
    assert client.get("/api/files/notes.txt").text == "mine"
    answer = client.get(f"/api/files/{path}")
    assert answer.status_code in (403, 404)
    assert "theirs" not in answer.text
    assert "root:" not in answer.text
    assert client.get("/api/takes/..%2F..%2Fsecret").status_code == 404


def test_what_is_shown_is_what_the_file_holds(studio: Studio, file: Path) -> None:
    points = ml.read_points(file)
    view = studio.get("")
    assert (view["first_frame"], view["frames"], view["rate_hz"]) == (10, 400, 100.0)
    assert [t["name"] for t in view["trajectories"]] == list("ABCDE")
    assert [t["samples"] for t in view["trajectories"]] == [370, 400, 400, 400, 400]
    data = studio.get("/chunk", first=100, count=64)
    magic, version, flags, first, frames, slots, revision = struct.unpack_from("<4sHHIIII", data)
    assert (magic, version, flags, first, frames, slots, revision) == (b"MLCK", 1, 7, 100, 64, 5, view["revision"])
    samples = frames * slots
    xyz = np.frombuffer(data, "<f4", 3 * samples, 24).reshape(frames, slots, 3)
    kind = np.frombuffer(data, "i1", samples, 24 + 20 * samples).reshape(frames, slots)
    assert len(data) == 24 + 21 * samples
    for row in (0, 63):
        for slot, label in enumerate("ABCDE"):
            truth = points.xyz_mm[(points.label == label) & (points.frame == 110 + row)]
            np.testing.assert_allclose(xyz[row, slot], truth[0], atol=1e-3)
    assert set(kind.ravel().tolist()) == {0}
    assert studio.get("/timeline")["runs"][0] == [0, 190, 0, 220, 180, 0]
    assert len(studio.get("/chunk", first=390, count=64)) == 24 + 21 * 10 * 5
    assert len(studio.get("/chunk", first=9999, count=64)) == 24


def test_graphs_keep_every_peak(tmp_path: Path) -> None:
    points = swing()
    points.xyz_mm[(points.frame == 333) & (points.label == "C"), 2] = 9000.0
    points.save(tmp_path / "peak.parquet")
    studio = Studio(ml.view(tmp_path / "peak.parquet"))
    studio.open()
    series = studio.get("/series", slot=2, first=0, last=400, bins=10)
    assert max(series["highs"]["z"]) == 9000.0
    assert series["frames"][0] == 10
    assert len(series["frames"]) == 10
    whole = studio.get("/series", slot=2, first=0, last=400, bins=4000)
    np.testing.assert_allclose(whole["lows"]["x"], points.xyz_mm[points.label == "C", 0], atol=1e-3)


def test_edits_are_saved_as_they_are_made_and_found_in_the_exported_file(studio: Studio, file: Path) -> None:
    before = file.read_bytes()
    studio.edit({**SWAP, "at": studio.at("A", 30), "other": studio.at("B", 30)})
    listed = ml.read_edits(ml.edits_path(file))
    assert [x.op for x in listed.edits] == ["swap"]
    said = studio.post("/export", {"file": "swing-mended.c3d"})
    points, made = ml.read_points(file), ml.read_points(said["path"])
    theirs = points.xyz_mm[(points.label == "B") & (points.frame == 55)]
    np.testing.assert_allclose(made.xyz_mm[(made.label == "A") & (made.frame == 45)], theirs, atol=1e-3)
    assert file.read_bytes() == before
    # Whoever opens the take next finds the edit, and can take it back.
    again = Studio(ml.view(file))
    again.open()
    assert [x["words"] for x in again.get("")["edits"]] == ["A and B exchanged, frames 50 to 59"]
    assert "exchanged" in again.post("/undo", {"revision": again.get("")["revision"]})["message"]
    assert ml.read_edits(ml.edits_path(file)).edits == ()


def test_undo_and_redo_bring_back_the_same_bytes(studio: Studio) -> None:
    def samples() -> bytes:
        return studio.get("/chunk", first=0, count=400)[24:]

    states = [samples()]
    for edit in (
        {**SWAP, "at": studio.at("A", 30), "other": studio.at("B", 30)},
        {"op": "fill", "at": studio.at("A", 30), "within": {"first": 200, "last": 229}},
        {"op": "smooth", "at": studio.at("C", 30), "within": {"first": 100, "last": 199}},
        {"op": "move", "at": studio.at("D", 30), "xyz_mm": [1, 2, 3]},
    ):
        studio.edit(edit)
        states.append(samples())
    assert len(set(states)) == 5
    for wanted in reversed(states[:-1]):
        studio.post("/undo", {"revision": studio.get("")["revision"]})
        assert samples() == wanted
    for wanted in states[1:]:
        studio.post("/redo", {"revision": studio.get("")["revision"]})
        assert samples() == wanted
    assert "nothing to redo" in studio.post("/redo", {"revision": studio.get("")["revision"]}, 422)["message"]


def test_two_windows_never_overwrite_each_other(studio: Studio, file: Path) -> None:
    seen = studio.get("")["revision"]
    a, b = studio.at("A", 30), studio.at("B", 30)
    studio.post("/edits", {"revision": seen, "edit": {**SWAP, "at": a, "other": b}})
    late = studio.post("/edits", {"revision": seen, "edit": {"op": "unlabel", "at": a}}, 409)
    assert (late["error"], "another window" in late["message"]) == ("conflict", True)
    assert len(ml.read_edits(ml.edits_path(file))) == 1
    # Another program, or a second server, changed the list.
    ml.write_edits(ml.EditList(), ml.edits_path(file))
    now = studio.get("")["revision"]
    other = studio.post("/edits", {"revision": now, "edit": {"op": "unlabel", "at": a}}, 409)
    assert "another program" in other["message"]
    assert len(ml.read_edits(ml.edits_path(file))) == 0
    assert studio.open("/reopen")["state"] == "ready"
    assert studio.get("")["edits"] == []
    assert studio.get("")["revision"] > now


@pytest.mark.parametrize(
    ("edit", "why"),
    [
        ({"op": "unlabel", "at": {"frame": 30, "xyz_mm": [0, 0, 9000]}}, "no marker at"),
        ({"op": "explode"}, "edit"),
        ({"op": "unlabel", "at": {"frame": 30, "xyz_mm": [0, 0]}}, "edit"),
        ({"op": "fill", "at": None, "within": {"first": 9, "last": 3}}, "edit"),
    ],
)
def test_what_does_not_fit_is_refused_and_changes_nothing(studio: Studio, file: Path, edit: Any, why: str) -> None:
    before = studio.get("")["revision"]
    answer = studio.edit(edit, 422)
    assert (answer["error"], why in answer["message"]) == ("invalid", True)
    assert studio.get("")["revision"] == before
    assert not ml.edits_path(file).exists()


def test_a_broken_file_shows_its_error_and_the_server_lives_on(tmp_path: Path) -> None:
    (tmp_path / "takes").mkdir()
    swing().save(tmp_path / "takes/good.parquet")
    (tmp_path / "takes/broken.c3d").write_bytes(b"nonsense")
    (tmp_path / "markerloom.toml").write_text('name = "x"\n')
    studio = Studio(ml.view(tmp_path))
    studio.name = "broken"
    info = studio.open()
    assert (info["state"], "broken.c3d" in info["message"]) == ("failed", True)
    assert "broken.c3d" in studio.get("", 422)["message"]
    studio.name = "good"
    assert studio.open()["state"] == "ready"
    (tmp_path / "takes/broken.c3d").unlink()
    swing().save(tmp_path / "takes/broken.c3d")
    studio.name = "broken"
    assert studio.open("/reopen")["state"] == "ready"


def test_edits_that_are_no_list_are_reported_and_kept(file: Path) -> None:
    ml.edits_path(file).write_text("{not json")
    studio = Studio(ml.view(file))
    info = studio.open()
    assert (info["state"], "not JSON" in info["message"]) == ("failed", True)
    assert ml.edits_path(file).read_text() == "{not json"


def test_edits_that_fit_no_more_are_told(file: Path) -> None:
    gone = e.Unlabel(at=e.At(frame=30, xyz_mm=(0.0, 0.0, 9000.0)))
    ml.write_edits(ml.EditList(edits=(gone,)), ml.edits_path(file))
    studio = Studio(ml.view(file))
    studio.open()
    assert "no marker at" in studio.get("")["edits"][0]["unfit"]


def test_a_file_that_changes_or_goes_is_noticed(studio: Studio, file: Path) -> None:
    taken = studio.workspace.entries[studio.name].take
    assert taken is not None
    assert taken.source_state() == "ok"
    points = swing()
    points.keep(points.frame < 100).save(file)
    assert taken.source_state() == "changed"
    assert studio.open("/reopen")["state"] == "ready"
    assert studio.get("")["frames"] == 90
    file.unlink()
    assert studio.workspace.entries[studio.name].take.source_state() == "gone"  # pyright: ignore[reportOptionalMemberAccess]
    # What is shown stays, with the reason why it is not read again.
    assert "there is no file" in studio.open("/reopen")["message"]
    assert studio.get("")["frames"] == 90


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("../out.c3d", "plain name"),
        ("out.fbx", "written as"),
        ("swing.parquet", "never changed"),
        (".hidden.c3d", "plain name"),
    ],
)
def test_exports_go_nowhere_else(studio: Studio, name: str, why: str) -> None:
    assert why in studio.post("/export", {"file": name}, 422)["message"]


def test_an_export_writes_over_nothing_silently(studio: Studio) -> None:
    studio.post("/export", {"file": "out.c3d"})
    assert "is there already" in studio.post("/export", {"file": "out.c3d"}, 422)["message"]
    studio.post("/export", {"file": "out.c3d", "overwrite": True})


def test_gaps_are_found_previewed_and_explained(studio: Studio) -> None:
    found = studio.get("/findings")["findings"]
    assert [(f["kind"], f["first"], f["last"]) for f in found if f["kind"] == "gap"] == [("gap", 200, 229)]
    previews = studio.get("/previews", slot=0, first=190, last=219)
    assert [p["method"] for p in previews] == ["auto", *ml_methods()]
    assert all(len(p["xyz_mm"]) == 30 for p in previews if not p["reason"])
    assert "missing from frame 200 to 229" in studio.get("/why", slot=0, frame=210)["text"]
    assert "is measured" in studio.get("/why", slot=0, frame=100)["text"]


def ml_methods() -> list[str]:
    from markerloom.filling.methods import METHODS

    return list(METHODS)


def test_a_name_is_suggested_by_its_distances(tmp_path: Path) -> None:
    points = swing()
    late = (points.label == "C") & (points.frame >= 250)
    points.label[late] = ""
    points.track[late] = 9
    points.save(tmp_path / "cut.parquet")
    studio = Studio(ml.view(tmp_path / "cut.parquet"))
    studio.open()
    slot = next(t["slot"] for t in studio.get("")["trajectories"] if not t["label"])
    first = studio.get("/suggestions", slot=slot)[0]
    assert first["name"] == "C"
    assert first["off_mm"] < 1.0


def test_video_lies_behind_its_dots(tmp_path: Path) -> None:
    pytest.importorskip("av", reason="PyAV is not installed")
    import cv2

    scene = ml.make_scene("walk", frames=8, seed=1, cameras=3, image_width=320, image_height=256, focal_px=320.0)
    made = ml.simulate(scene)
    ml.save(made, tmp_path)
    ml.save_videos(made, tmp_path)
    studio = Studio(ml.view(tmp_path / "observations.parquet", calibration=tmp_path / "calibration.toml"))
    studio.open()
    camera = studio.get("")["cameras"][1]
    assert camera["video"]
    image = cv2.imdecode(np.frombuffer(studio.get("/video", camera=camera["id"], frame=5), np.uint8), 0)
    assert image is not None
    assert image.shape == (256, 320)
    seen = next(c["dots"] for c in studio.get("/dots", frame=5)["cameras"] if c["camera"] == camera["id"])
    bright = [int(image[round(d["y"]), round(d["x"])]) for d in seen]
    assert np.median(bright) > 5 * (np.median(image) + 5)
    assert "no video" in studio.get("/video", 422, camera="nobody", frame=5)["message"]
    assert "no image" in studio.get("/video", 422, camera=camera["id"], frame=500)["message"]


def test_a_subject_is_learned_from_the_take_as_it_was_mended(studio: Studio) -> None:
    studio.edit({"op": "label", "at": studio.at("A", 30), "name": "HEAD", "within": None})
    done = studio.post("/subject", {"name": "anna"})
    assert set(ml.read_subject(done["path"]).markers) == {"HEAD", *"BCDE"}
    assert "is there already" in studio.post("/subject", {"name": "anna"}, 422)["message"]
    studio.post("/subject", {"name": "anna", "overwrite": True})
    for name in ("", "../anna", ".anna", "markerloom"):
        assert "no name for a subject" in studio.post("/subject", {"name": name}, 422)["message"]


def test_a_subject_is_edited(studio: Studio) -> None:
    done = studio.post("/subject", {"name": "anna"})
    before = ml.read_subject(done["path"])
    names = {"A": "TOP", "B": "B", "C": "C", "D": "D"}
    wanted = {"name": "Anna", "markers": names}
    put = partial(studio.client.put, "/api/subjects/anna.toml")
    assert put(json=wanted).status_code == 200
    after = ml.read_subject(done["path"])
    assert (after.name, set(after.markers)) == ("Anna", {"TOP", "B", "C", "D"})
    for a, b in (("A", "B"), ("C", "D")):
        i, j = before.markers.index(a), before.markers.index(b)
        k, n = after.markers.index(names[a]), after.markers.index(names[b])
        assert after.distances[k * len(after) + n] == before.distances[i * len(before) + j]
    assert [s["name"] for s in studio.client.get("/api/subjects").json()] == ["Anna"]
    for markers, why in (
        ({"TOP": "X"}, "at least 3"),
        ({**dict.fromkeys(names.values(), "x"), "E": "E"}, "no marker"),
        ({"B": "B", "C": "B", "D": "D"}, "of their own"),
    ):
        answer = put(json={"name": "Anna", "markers": markers})
        assert (answer.status_code, why in answer.json()["message"]) == (422, True)
    assert studio.client.put("/api/subjects/nobody.toml", json=wanted).status_code == 422


def test_a_take_whose_calibration_is_missing_says_so(tmp_path: Path) -> None:
    ml.save(ml.simulate(ml.make_scene("walk", frames=5)), tmp_path)
    text = 'calibration = "gone.toml"\n[takes.walk]\nfile = "observations.parquet"\n'
    (tmp_path / "markerloom.toml").write_text(text)
    studio = Studio(ml.view(tmp_path))
    info = studio.open()
    assert (info["state"], "gone.toml" in info["message"]) == ("failed", True)
    assert "gone.toml" in studio.get("", 422)["message"]
    (tmp_path / "gone.toml").write_bytes((tmp_path / "calibration.toml").read_bytes())
    assert studio.open("/reopen")["state"] == "ready"


@pytest.mark.parametrize("kind", [".c3d", ".parquet"])
def test_stored_takes_are_the_same_whatever_they_came_from(tmp_path: Path, kind: str) -> None:
    points = ml.fill(swing(gap=(200, 229)))
    file = tmp_path / f"swing{kind}"
    points.save(file)
    if kind == ".c3d":
        stored.store_c3d(tmp_path / "sheet", "key", file, None)
    else:
        stored.store(tmp_path / "sheet", "key", ml.read_points(file))
    found = stored.load(tmp_path / "sheet", "key")
    assert found is not None
    expected = Sheet.of(ml.read_points(file))
    assert (
        chunks.of_sheet(found.sheet, 0, 400, 1)[24 : 24 + 12 * 2000]
        == chunks.of_sheet(expected, 0, 400, 1)[24 : 24 + 12 * 2000]
    )
    for mine, theirs in zip(found.sheet.trajectories, expected.trajectories, strict=True):
        np.testing.assert_array_equal(mine.kind, theirs.kind)
        np.testing.assert_array_equal(mine.xyz_mm, theirs.xyz_mm)
        assert mine.label == theirs.label
    assert stored.load(tmp_path / "sheet", "another") is None
    # What is mended in memory never reaches the disk.
    found.sheet.trajectories[0].xyz_mm[:] = 0.0
    again = stored.load(tmp_path / "sheet", "key")
    assert again is not None
    assert not np.array_equal(again.sheet.trajectories[0].xyz_mm, found.sheet.trajectories[0].xyz_mm)


def test_a_damaged_store_is_made_anew(studio: Studio, file: Path) -> None:
    folder = studio.workspace.entries[studio.name].take.folder / "sheet"  # pyright: ignore[reportOptionalMemberAccess]
    (folder / "xyz_mm.f64").write_bytes(b"short")
    again = Studio(ml.view(file))
    assert again.open()["state"] == "ready"
    assert again.get("")["frames"] == 400


@pytest.mark.skipif(not page_is_built(), reason="the page is not built")
def test_long_takes_become_a_page_of_every_nth_frame(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chunks, "OVERVIEW_BYTES", 21 * 5 * 64)
    studio = Studio(ml.view(file))
    studio.open()
    assert studio.get("")["overview_stride"] == 7
    data = studio.get("/overview")
    assert struct.unpack_from("<4sHHIII", data)[3:] == (0, 58, 5)
    whole = np.frombuffer(studio.get("/chunk", first=0, count=400), "<f4", 3 * 5 * 400, 24).reshape(400, 15)
    np.testing.assert_array_equal(np.frombuffer(data, "<f4", 3 * 5 * 58, 24).reshape(58, 15), whole[::7])
    said = studio.post("/export", {"file": "swing.html"})
    assert said["message"] == "swing.html: 58 frames in one page"
    assert "one frame in 7" in Path(said["path"]).read_text("utf-8")


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (("nothing.c3d", None), "there is no file"),
        (("readme.md", None), "are not shown"),
        (("dots.csv", None), "--calibration"),
        (("swing.parquet", "nothing.toml"), "there is no file"),
        ((".", None), "there is no markerloom.toml"),
    ],
)
def test_what_cannot_be_viewed_is_told(
    file: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, str | None], why: str
) -> None:
    monkeypatch.chdir(file.parent)
    Path("readme.md").write_text("# x")
    Path("dots.csv").write_text("frame,camera,x,y\n0,a,1,2\n")
    with pytest.raises(ml.MarkerloomError, match=why):
        ml.view(arguments[0], calibration=arguments[1])


def test_the_page_speaks_the_language_of_the_server() -> None:
    wire = Path(__file__).parents[1] / "web/src/wire.ts"
    assert wire.read_text("utf-8") == typescript(), "run: python -m markerloom.studio.wire > web/src/wire.ts"


def test_the_layout_of_chunks_is_documented() -> None:
    text = (Path(__file__).parents[1] / "docs/reference/studio.md").read_text("utf-8")
    assert f"version {chunks.VERSION}" in text
    assert f"{chunks.HEADER.size} bytes" in text


def test_a_motion_is_shown_over_another(tmp_path: Path) -> None:
    """The joints of one motion as dots, the bones of the other: before and after an edit."""
    clip = walk(1.0)
    ml.write_motion(clip, tmp_path / "before.bvh")
    ml.write_motion(ml.motion.bands(clip, preset="livelier").motion, tmp_path / "after.bvh")
    workspace = ml.view(tmp_path / "before.bvh", motion=tmp_path / "after.bvh")
    (entry,) = workspace.entries.values()
    take = open_take(workspace.project, entry.settings)
    assert [t.label for t in take.sheet.trajectories] == list(clip.skeleton.joints)
    assert take.motion is not None
    assert np.abs(take.motion.joints_m() - ml.read_motion(tmp_path / "after.bvh").joints_m()).max() < 1e-9
    with pytest.raises(InputError, match="there is no motion"):
        ml.view(tmp_path / "before.bvh", motion=tmp_path / "gone.bvh")
