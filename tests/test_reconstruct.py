"""Reconstruction through the public functions: determinism, reports, and what bad input is told."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import markerloom as ml
from markerloom.observations import Observations


def score(take: ml.SimulatedTake, points: ml.Reconstruction, tolerance_mm: float = 30.0) -> dict[str, Any]:
    truth = ml.truth_from_assignments(take.truth, take.truth_assignments, take.rig)
    return ml.evaluate(points, truth, tolerance_mm=tolerance_mm, assignments=points.assignments)


def test_the_papers_scene_is_solved(take: ml.SimulatedTake) -> None:
    points = ml.reconstruct(take.observations, take.rig)
    result = score(take, points)
    assert result["accuracy_3d"] >= 0.998
    assert result["accuracy_set"] >= 0.94
    assert result["confidence_ece"] < 0.02
    assert 0.8 < result["sigma_ratio"] < 1.25
    assert points.report["certified_frames"] == 1.0


def test_the_same_bytes_for_any_number_of_threads(take: ml.SimulatedTake, tmp_path: Any) -> None:
    for threads in (1, 2, 5):
        ml.reconstruct(take.observations, take.rig, threads=threads).save(tmp_path / f"{threads}.parquet")
    contents = {(tmp_path / f"{threads}.parquet").read_bytes() for threads in (1, 2, 5)}
    assert len(contents) == 1


@pytest.mark.parametrize("scene", ["walk", "dance"])
def test_figures_with_occlusion_merging_and_clutter(scene: str) -> None:
    take = ml.simulate(ml.make_scene(scene, frames=40, seed=2))
    ours = score(take, ml.reconstruct(take.observations, take.rig), 20.0)
    theirs = score(take, ml.reconstruct(take.observations, take.rig, method="relaxation"), 20.0)
    assert ours["accuracy_3d"] > 0.998
    assert ours["ghosts_per_frame"] <= theirs["ghosts_per_frame"] < 0.6


def test_unequal_noise_per_blob_is_used() -> None:
    take = ml.simulate(ml.make_scene("cloud", frames=10, markers=20, cameras=6, sigma_px=0.0, hide="none"))
    rng = np.random.default_rng(0)
    sigma = np.where(rng.random(len(take.observations)) < 0.3, 2.0, 0.2)
    pixel = take.observations.pixel + sigma[:, None] * rng.normal(size=(len(sigma), 2))
    noisy = replace(take.observations, pixel=pixel)
    told = replace(noisy, optional={"sigma": sigma})
    knowing = score(take, ml.reconstruct(told, take.rig), 10.0)
    blind = score(take, ml.reconstruct(noisy, take.rig), 10.0)
    assert knowing["error_mm"]["rms"] < 0.7 * blind["error_mm"]["rms"]
    assert 0.8 < knowing["sigma_ratio"] < 1.25


def changed(take: ml.SimulatedTake, **columns: Any) -> Observations:
    return replace(take.observations, **columns)


def test_nan_pixels_and_duplicates_are_counted(take: ml.SimulatedTake) -> None:
    pixel = take.observations.pixel.copy()
    pixel[3] = np.nan
    pixel[7, 0] = np.inf
    doubled = changed(
        take,
        pixel=np.vstack([pixel, pixel[:2]]),
        frame=np.append(take.observations.frame, take.observations.frame[:2]),
        camera=np.append(take.observations.camera, take.observations.camera[:2]),
    )
    warnings = " | ".join(ml.reconstruct(doubled, take.rig).report["warnings"])
    assert "2 observations with NaN or infinite pixels" in warnings
    assert "2 repeated rows" in warnings
    assert "out of order" in warnings


def test_masked_dots_are_counted_and_not_used(take: ml.SimulatedTake) -> None:
    left_half = ml.Mask((320.0, 480.0), (2, 1), (True, False))
    first = replace(take.rig.cameras[0], mask=left_half)
    points = ml.reconstruct(take.observations, ml.Rig.of([first, *take.rig.cameras[1:]]))
    own = take.observations.camera == 0
    masked = int((own & (take.observations.pixel[:, 0] < 319.5)).sum())
    assert 0 < masked < own.sum()
    assert f"{masked} observations under a camera's mask" in " | ".join(points.report["warnings"])
    used = [c == first.id for c in points.assignments["camera"].to_pylist()]
    assert sum(used) <= own.sum() - masked


def test_cameras_without_calibration_are_named(take: ml.SimulatedTake) -> None:
    rig = take.rig.subset(take.rig.ids[:3])
    warnings = " | ".join(ml.reconstruct(take.observations, rig).report["warnings"])
    assert "cameras that the calibration lacks" in warnings
    assert take.rig.ids[3] in warnings


def test_positions_stand_in_for_ids_with_a_warning(take: ml.SimulatedTake) -> None:
    numbered = changed(take, camera_ids=("0", "1", "2", "3"))
    points = ml.reconstruct(numbered, take.rig)
    assert any("ascending order of id" in w for w in points.report["warnings"])
    np.testing.assert_array_equal(points.xyz_mm, ml.reconstruct(take.observations, take.rig).xyz_mm)


def test_a_foreign_calibration_is_refused(take: ml.SimulatedTake) -> None:
    with pytest.raises(ml.InputError, match="no camera of the observations"):
        ml.reconstruct(changed(take, camera_ids=("a", "b", "c", "d")), take.rig)


def test_one_camera_only_is_refused(take: ml.SimulatedTake) -> None:
    keep = take.observations.camera == 0
    lonely = changed(
        take,
        frame=take.observations.frame[keep],
        camera=take.observations.camera[keep],
        pixel=take.observations.pixel[keep],
    )
    with pytest.raises(ml.InputError, match="one camera only"):
        ml.reconstruct(lonely, take.rig)


def test_cameras_at_one_place_are_refused(take: ml.SimulatedTake) -> None:
    same = ml.Rig.of([replace(c, position_m=np.zeros(3)) for c in take.rig.cameras])
    with pytest.raises(ml.InputError, match="same place"):
        ml.reconstruct(take.observations, same)


def test_pixels_of_another_sensor_are_refused(take: ml.SimulatedTake) -> None:
    with pytest.raises(ml.InputError, match="different sensors"):
        ml.reconstruct(changed(take, pixel=3.0 * take.observations.pixel), take.rig)


def test_no_observations_are_refused(take: ml.SimulatedTake) -> None:
    none = Observations(np.zeros(0, np.int64), np.zeros(0, np.int64), (), np.zeros((0, 2)))
    with pytest.raises(ml.InputError, match="no observations"):
        ml.reconstruct(none, take.rig)


def test_frames_outside_the_take_are_refused(take: ml.SimulatedTake) -> None:
    with pytest.raises(ml.InputError, match="frames 0 to 19"):
        ml.reconstruct(take.observations, take.rig, frames=(100, 200))


def test_impossible_frame_numbers_are_refused(take: ml.SimulatedTake) -> None:
    frame = take.observations.frame.copy()
    frame[-1] = 10**12
    with pytest.raises(ml.InputError, match="several takes"):
        changed(take, frame=frame, frames=np.zeros(0, np.int64))


def test_a_hopelessly_crowded_frame_still_gives_points() -> None:
    take = ml.simulate(ml.make_scene("cloud", frames=1, markers=200, sigma_px=2.0))
    points = ml.reconstruct(take.observations, take.rig)
    assert score(take, points)["accuracy_3d"] > 0.8


def test_frame_numbers_are_kept(take: ml.SimulatedTake) -> None:
    points = ml.reconstruct(take.observations, take.rig, frames=(5, 8))
    assert np.unique(points.frame).tolist() == [5, 6, 7]


def test_triangulation_gives_a_point_or_a_reason(take: ml.SimulatedTake) -> None:
    point = np.array([[0.1, 0.0, 0.05]])
    pixels = {c.id: take.rig.project(i, point)[0].tolist() for i, c in enumerate(take.rig.cameras)}
    found = ml.triangulate(take.rig, pixels, sigma_px=0.5)
    np.testing.assert_allclose(found.point_m, point[0], atol=1e-9)
    assert found.left_out is None
    bad = {**pixels, take.rig.ids[2]: [5.0, 5.0]}
    assert ml.triangulate(take.rig, bad, sigma_px=0.5).left_out == take.rig.ids[2]
    with pytest.raises(ml.NoPointError) as caught:
        ml.triangulate(take.rig, dict([next(iter(pixels.items()))]))
    assert caught.value.args[0] == "too_few_rays"


def test_the_lecture_notes_two_rays() -> None:
    point, gap_m = ml.two_rays(np.array([[0, 0, 0], [2, -3, 0.5]]), np.array([[1, 0, 0], [0, 1, 0]]))
    np.testing.assert_allclose(point, [2, 0, 0.25])
    assert gap_m == pytest.approx(0.5)
