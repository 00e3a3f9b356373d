"""Active markers: codes decoded over time, and identities that the tracker trusts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

import markerloom as ml
from markerloom.cli import app
from markerloom.errors import InputError
from markerloom.observations import _index_within_camera


def true_labels(take: ml.SimulatedTake) -> list[list[int]]:
    """For each row of the observations, the LEDs it comes from."""
    labels = list(dict.fromkeys(take.truth.label.tolist()))
    holders: dict[tuple[int, str, int], list[int]] = {}
    table = take.truth_assignments.to_pydict()
    for key in zip(table["frame"], table["camera"], table["observation"], table["label"], strict=True):
        holders.setdefault(key[:3], []).append(labels.index(key[3]))
    dots = take.observations
    within = _index_within_camera(dots)
    return [
        holders.get((int(f), dots.camera_ids[c], int(i)), [])
        for f, c, i in zip(dots.frame, dots.camera, within, strict=True)
    ]


@pytest.fixture(scope="module")
def blinking() -> ml.SimulatedTake:
    return ml.simulate(ml.make_scene("walk", frames=400, markers=40, leds=True, seed=0))


def test_what_is_told_is_right(blinking: ml.SimulatedTake) -> None:
    told, report = ml.leds(blinking.observations)
    truth = true_labels(blinking)
    identity = told.optional["id"]
    right = sum(int(i) in t for i, t in zip(identity, truth, strict=True) if i >= 0)
    assert right >= 0.999 * (identity >= 0).sum()
    owned = np.array([bool(t) for t in truth])
    assert (identity[owned] >= 0).mean() > 0.8
    assert set(report["identities"]) <= {str(n) for n in range(40)}


def test_more_wrong_bits_leave_more_undecided_and_nothing_wrong() -> None:
    shares = []
    for bit_errors in (0.0, 0.15):
        take = ml.simulate(ml.make_scene("walk", frames=200, leds=True, markers=40, bit_errors=bit_errors, cameras=4))
        told = ml.leds(take.observations)[0].optional["id"]
        truth = true_labels(take)
        right = sum(int(i) in t for i, t in zip(told, truth, strict=True) if i >= 0)
        assert right >= 0.998 * max((told >= 0).sum(), 1)
        shares.append((told >= 0).mean())
    assert shares[1] < shares[0]


def test_the_tracker_never_swaps_what_tells_who_it_is(blinking: ml.SimulatedTake) -> None:
    told, _ = ml.leds(blinking.observations)
    points = ml.track(told, blinking.rig)
    truth = ml.truth_from_assignments(blinking.truth, blinking.truth_assignments, blinking.rig)
    score = ml.evaluate(points, truth, tolerance_mm=25)
    assert score["id_switches"] == 0
    # Names are the identities: the trajectory of LED 17 follows marker 17.
    labels = list(dict.fromkeys(blinking.truth.label.tolist()))
    place = blinking.truth.xyz_mm.reshape(400, len(labels), 3)
    for name in np.unique(points.label[points.label != ""]):
        own = (points.label == name) & (points.kind == 0)
        off = np.linalg.norm(points.xyz_mm[own] - place[points.frame[own], int(name[2:])], axis=1)
        assert np.median(off) < 5.0
        assert (off < 50.0).mean() > 0.99


def test_identities_bring_back_markers_that_motion_cannot(blinking: ml.SimulatedTake) -> None:
    """All dots vanish for a second; every marker comes back as itself, because it says so."""
    told, _ = ml.leds(blinking.observations)
    gap = (told.frame >= 150) & (told.frame < 250)
    points = ml.track(told._keep(~gap), blinking.rig)
    before = {
        str(n): set(points.track[(points.label == n) & (points.frame < 150)]) for n in np.unique(points.label) if n
    }
    after = {n: set(points.track[(points.label == n) & (points.frame >= 250)]) for n in before}
    assert sum(bool(before[n] & after[n]) for n in before) >= len(before) - 2


def test_all_cameras_together_name_what_no_camera_could(blinking: ml.SimulatedTake) -> None:
    """Dots of some markers never tell anything of themselves: their brightness along the trajectory does."""
    told, _ = ml.leds(blinking.observations)
    silent = {3, 17, 29}
    identity = np.where(np.isin(told.optional["id"], list(silent)), -1, told.optional["id"])
    quiet = replace(told, optional={**told.optional, "id": identity})
    points = ml.track(quiet, blinking.rig)
    labels = list(dict.fromkeys(blinking.truth.label.tolist()))
    place = blinking.truth.xyz_mm.reshape(400, len(labels), 3)
    for one in silent:
        own = (points.label == f"id{one}") & (points.kind == 0)
        assert own.sum() > 200
        assert (np.linalg.norm(points.xyz_mm[own] - place[points.frame[own], one], axis=1) < 10.0).mean() > 0.99
    # Without brightness nobody knows.
    dark = {name: column for name, column in quiet.optional.items() if name != "brightness"}
    assert not {f"id{one}" for one in silent} & set(ml.track(replace(quiet, optional=dark), blinking.rig).label)


def test_a_wrong_identity_on_one_dot_swaps_nothing(blinking: ml.SimulatedTake) -> None:
    told, _ = ml.leds(blinking.observations)
    identity = told.optional["id"].copy()
    random = np.random.default_rng(5)
    hit = random.uniform(size=len(identity)) < 0.01
    identity[hit] = random.integers(0, 40, hit.sum())
    points = ml.track(replace(told, optional={**told.optional, "id": identity}), blinking.rig)
    truth = ml.truth_from_assignments(blinking.truth, blinking.truth_assignments, blinking.rig)
    assert ml.evaluate(points, truth, tolerance_mm=25)["id_switches"] == 0


def test_identities_can_be_pushed_live(blinking: ml.SimulatedTake) -> None:
    told, _ = ml.leds(blinking.observations)
    tracker = ml.Tracker(blinking.rig, rate_hz=100.0)
    last = None
    for frame in range(30):
        rows = told.frame == frame
        dots = {}
        for i, camera in enumerate(told.camera_ids):
            own = rows & (told.camera == i)
            dots[camera] = np.column_stack([told.pixel[own], np.ones(own.sum()), told.optional["id"][own]])
        last = tracker.push(dots, frame=frame)
    assert last is not None
    assert (last.ids >= 0).sum() > 20
    assert len(np.unique(last.ids[last.ids >= 0])) == (last.ids >= 0).sum()


def test_leds_are_read_from_filmed_images() -> None:
    small = {"cameras": 2, "image_width": 640, "image_height": 512, "focal_px": 640.0, "clutter_per_frame": 0.0}
    take = ml.simulate(ml.make_scene("walk", frames=120, markers=8, leds=True, bit_errors=0.02, reflections=0, **small))
    told, _ = ml.leds(ml.detected(take, marker_mm=28.0))
    identity = told.optional["id"]
    assert (identity >= 0).mean() > 0.5
    labels = list(dict.fromkeys(take.truth.label.tolist()))
    place = take.truth.xyz_mm.reshape(120, len(labels), 3) / 1000.0
    off = []
    for row in np.flatnonzero(identity >= 0):
        own = place[told.frame[row], int(identity[row])]
        off.append(np.linalg.norm(take.rig.project(int(told.camera[row]), own[None])[0] - told.pixel[row]))
    assert np.median(off) < 0.2
    assert np.mean(np.array(off) < 4.0) > 0.99  # the rest are two LEDs in one dot


def test_what_cannot_be_decoded_is_told(take: ml.SimulatedTake) -> None:
    with pytest.raises(InputError, match="no brightness"):
        ml.leds(take.observations)
    steady = replace(take.observations, optional={"brightness": np.full(len(take.observations), 100.0)})
    told, report = ml.leds(steady)
    assert (told.optional["id"] == -1).all()
    assert report["warnings"]
    with pytest.raises(InputError, match="lasts 0 frames"):
        ml.leds(steady, frames_per_bit=0)


def test_the_command_line(blinking: ml.SimulatedTake, tmp_path) -> None:
    ml.save(blinking, tmp_path)
    out = tmp_path / "told.parquet"
    done = CliRunner().invoke(app, ["leds", str(tmp_path / "observations.parquet"), "-o", str(out)])
    assert done.exit_code == 0, done.output
    assert "identities" in done.output
    assert np.array_equal(ml.read_observations(out).optional["id"], ml.leds(blinking.observations)[0].optional["id"])
