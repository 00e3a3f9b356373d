"""Identity switches, in contacts and outside them."""

from __future__ import annotations

import numpy as np
import pytest

import markerloom as ml

FAR_MM, APART_MM = 200.0, 40.0


def meeting(touching: int, tracks_after: tuple[int, int, int], apart_mm: float = 8.0) -> tuple[ml.Points, ml.Truth]:
    """A and B meet for some frames, C is elsewhere; from when they part, their tracks are those given."""
    frames = 10 + touching + 10
    frame = np.repeat(np.arange(frames), 3)
    together = (np.arange(frames) >= 10) & (np.arange(frames) < 10 + touching)
    x_mm = np.stack([np.zeros(frames), np.where(together, apart_mm, APART_MM), np.full(frames, FAR_MM)], axis=1)
    xyz_mm = np.stack([x_mm.ravel(), 0.0 * frame, 0.0 * frame], axis=1)
    label = np.tile(np.array(["A", "B", "C"], object), frames)
    truth = ml.Points.of(frame, np.tile(np.arange(3), frames), xyz_mm, label=label)
    parted = np.arange(frames) >= 10 + touching
    track = np.where(parted[:, None], np.array(tracks_after), np.arange(3)).ravel()
    return ml.Points.of(frame, track, xyz_mm), ml.truth_without_views(truth)


@pytest.mark.parametrize(("touching", "in_contact"), [(4, 0), (5, 2), (30, 2)])
def test_an_exchange_belongs_to_a_contact_of_five_frames(touching: int, in_contact: int) -> None:
    result = ml.evaluate(*meeting(touching, (1, 0, 2)), tolerance_mm=25)
    assert (result["id_switches"], result["id_switches_in_contact"]) == (2, in_contact)


def test_near_but_not_touching_is_no_contact() -> None:
    result = ml.evaluate(*meeting(20, (1, 0, 2), apart_mm=16.0), tolerance_mm=25)
    assert (result["id_switches"], result["id_switches_in_contact"]) == (2, 0)


def test_an_exchange_with_a_third_marker_is_of_no_contact() -> None:
    result = ml.evaluate(*meeting(20, (2, 1, 0)), tolerance_mm=25)
    assert (result["id_switches"], result["id_switches_in_contact"]) == (2, 0)


def test_without_a_switch_there_is_none_in_a_contact() -> None:
    result = ml.evaluate(*meeting(20, (0, 1, 2)), tolerance_mm=25)
    assert (result["id_switches"], result["id_switches_in_contact"]) == (0, 0)


def test_merged_blobs_are_a_contact_if_one_marker_has_not_enough_of_its_own() -> None:
    points, truth = meeting(20, (1, 0, 2), apart_mm=20.0)
    blob = frozenset({("cam", 0)})
    dots = {(frame, label): blob for frame in range(10, 30) for label in "AB"}
    shared = np.isin(truth.points.frame, np.arange(10, 30))
    for alone, in_contact in ((True, 0), (False, 2)):
        required = truth.required & (alone | ~(shared & (truth.points.label == "A")))
        result = ml.evaluate(points, ml.Truth(truth.points, required, dots), tolerance_mm=25)
        assert (result["id_switches"], result["id_switches_in_contact"]) == (2, in_contact)
