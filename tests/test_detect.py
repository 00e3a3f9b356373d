"""Markers in images, folders and video: found where they are, with an honest sigma, whatever the file."""

from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from scipy.special import ndtr
from typer.testing import CliRunner

import markerloom as ml
from markerloom.cli import app
from markerloom.detect.images import write_png, write_video

WIDTH, HEIGHT = 160, 120


def picture(centers: np.ndarray, radius: float = 3.0, noise: float = 1.0, seed: int = 0, bits: int = 8) -> np.ndarray:
    """Disks blurred by about 0.6 px over a dark background."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    share = np.zeros((HEIGHT, WIDTH))
    for cx, cy in centers:
        share = np.maximum(share, 1.0 / (1.0 + np.exp((np.hypot(x - cx, y - cy) - radius) / 0.35)))
    top = 2**bits - 1
    grey = 0.08 * top + 0.7 * top * share
    grey = grey + np.random.default_rng(seed).normal(0.0, noise * top / 255.0, grey.shape)
    return np.clip(np.round(grey), 0, top).astype(np.uint8 if bits == 8 else np.uint16)


def truth(frame: int) -> np.ndarray:
    return np.array([[30.3 + 1.5 * frame, 40.7], [100.2, 60.1 + 0.8 * frame], [70.6, 90.4]])


def video(path: Path, images: list[np.ndarray]) -> Path:
    """A lossless grey video."""
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("ffv1", rate=50)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "gray"
        for image in images:
            for packet in stream.encode(av.VideoFrame.from_ndarray(image, format="gray")):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    return path


def matches(found: ml.Observations, frame: int, camera: int, true: np.ndarray, within_px: float) -> bool:
    own = found.pixel[(found.frame == frame) & (found.camera == camera)]
    if len(own) != len(true):
        return False
    return bool(np.linalg.norm(own[:, None] - true[None], axis=2).min(axis=0).max() < within_px)


def test_video_and_a_folder_of_images_give_the_same_dots(tmp_path: Path) -> None:
    images = [picture(truth(f), seed=f) for f in range(12)]
    folder = tmp_path / "cam_b"
    folder.mkdir()
    for number, image in enumerate(images):
        write_png(image, folder / f"frame{number}.png")  # frame10 follows frame9, not frame1
    found, report = ml.detect({"a": video(tmp_path / "cam_a.mkv", images), "b": folder})
    assert report["frames"] == 12
    assert found.rate_hz == 50.0
    for frame in range(12):
        assert matches(found, frame, 0, truth(frame), 0.05)
    both = [found.pixel[found.camera == c] for c in (0, 1)]
    assert np.array_equal(both[0], both[1])
    assert np.all(found.optional["quality"] == 1.0)
    assert np.abs(found.optional["radius"] - 3.0).max() < 0.15


def test_the_result_is_the_same_for_any_number_of_threads(tmp_path: Path) -> None:
    path = video(tmp_path / "a.mkv", [picture(truth(f), seed=f) for f in range(30)])
    one, many = (ml.detect({"a": path}, threads=n)[0] for n in (1, 5))
    assert np.array_equal(one.pixel, many.pixel)
    assert np.array_equal(one.frame, many.frame)


def test_the_stated_sigma_is_the_error() -> None:
    random = np.random.default_rng(1)
    errors = []
    for seed in range(60):
        centers = np.column_stack([[30, 80, 130], [30, 60, 90]]) + random.uniform(0, 1, (3, 2))
        blobs = ml.detect_markers(picture(centers, noise=4.0, seed=seed))
        order = np.argsort(blobs.pixel[:, 0])
        errors.append(np.sum((blobs.pixel[order] - centers) ** 2, axis=1) / (2 * blobs.sigma_px[order] ** 2))
    assert 0.7 < np.mean(errors) < 1.4


def test_sixteen_bits_are_read_as_such() -> None:
    image = picture(truth(0), noise=0.2, bits=16)
    blobs = ml.detect_markers(image)
    assert len(blobs) == 3
    assert blobs.peak.min() > 30_000
    twelve = (image >> 4).astype(np.uint16)
    assert not ml.detect_markers(twelve, white=4095).saturated.any()
    assert ml.detect_markers(np.minimum(twelve, 2000), white=2000).saturated.all()


def test_masks_hide_what_is_painted_or_was_bright_in_the_empty_scene(tmp_path: Path) -> None:
    lamp = np.array([[120.0, 20.0]])
    write_png(picture(lamp), tmp_path / "empty.png")
    image = picture(np.vstack([truth(0), lamp]))
    mask = ml.learn_mask(tmp_path / "empty.png")
    assert mask[20, 120]
    assert mask.mean() < 0.01
    assert len(ml.detect_markers(image)) == 4
    assert len(ml.detect_markers(image, mask=mask)) == 3
    write_png(np.where(mask, 255, 0).astype(np.uint8), tmp_path / "mask.png")
    assert np.array_equal(ml.read_mask(tmp_path / "mask.png"), mask)
    assert len(ml.detect_markers(image, background=picture(lamp, noise=0.0))) == 3
    with pytest.raises(ml.InputError, match="the mask has the size"):
        ml.detect_markers(image, mask=mask[:50])


def test_what_cannot_be_read_is_told_and_what_came_before_is_kept(tmp_path: Path) -> None:
    whole = video(tmp_path / "a.mkv", [picture(truth(f), seed=f, noise=6.0) for f in range(20)])
    content = whole.read_bytes()
    (tmp_path / "short.mkv").write_bytes(content[: len(content) // 2])
    (tmp_path / "noise.png").write_bytes(b"this is no picture")
    (tmp_path / "empty.mp4").write_bytes(b"")
    folder = tmp_path / "mixed"
    folder.mkdir()
    write_png(picture(truth(0)), folder / "0.png")
    write_png(picture(truth(1))[:100], folder / "1.png")
    (tmp_path / "nothing").mkdir()
    found, report = ml.detect({"short": tmp_path / "short.mkv", "mixed": folder})
    assert 3 < report["cameras"]["short"]["frames"] < 20
    assert report["cameras"]["mixed"]["frames"] == 1
    text = "; ".join(report["warnings"])
    assert "camera mixed: image 1 has 160x100 pixels, those before it 160x120" in text
    assert matches(found, 0, 0, truth(0), 0.2)
    for name, why in (
        ("noise.png", "not an image or video"),
        ("empty.mp4", "the file is empty"),
        ("nothing", "no image in the folder"),
        ("gone.mp4", "there is no file"),
    ):
        with pytest.raises(ml.InputError if "no " in why[:9] else ml.MarkerloomError, match=why):
            ml.detect({"a": tmp_path / name})


def test_frames_without_markers_and_overexposed_ones_are_told(tmp_path: Path) -> None:
    dark = [picture(np.zeros((0, 2)), seed=s) for s in range(3)]
    found, report = ml.detect({"a": video(tmp_path / "a.mkv", dark)})
    assert len(found) == 0
    assert report["warnings"] == ["camera a shows no marker in any of its 3 images: lower the threshold?"]
    white = np.full((HEIGHT, WIDTH), 255, np.uint8)
    blobs = ml.detect_markers(white, threshold=100)
    assert blobs.saturated.all()
    assert blobs.clipped.all()
    random = np.random.default_rng(0)
    snow = np.where(random.random((1000, 1000)) < 0.05, 255, 0).astype(np.uint8)
    crowded = ml.detect_markers(snow, threshold=100, least_pixels=1)
    assert len(crowded) == 10_000
    assert crowded.left_out > 10_000


@pytest.mark.parametrize("image", [np.zeros((5, 5)), np.zeros((5, 5, 3), np.uint8), np.zeros((0, 4), np.uint8)])
def test_what_is_no_grey_image_is_refused(image: np.ndarray) -> None:
    with pytest.raises(ml.InputError, match="uint8 or uint16 is needed"):
        ml.detect_markers(image)


def test_on_the_command_line(tmp_path: Path) -> None:
    for name in ("left", "right"):
        video(tmp_path / f"{name}.mkv", [picture(truth(f), seed=f) for f in range(5)])
    (tmp_path / "empty").mkdir()
    for name in ("left", "right"):
        write_png(picture(truth(0)[2:]), tmp_path / "empty" / f"{name}.png")
    sources = [str(tmp_path / f"{name}.mkv") for name in ("left", "right")]
    learned = ["--learn-mask", str(tmp_path / "empty"), "--masks-out", str(tmp_path / "masks")]
    out = tmp_path / "dots.csv"
    done = CliRunner().invoke(app, ["detect", *sources, "-o", str(out), *learned, "--report", str(tmp_path / "r.json")])
    assert done.exit_code == 0, done.output
    found = ml.read_observations(out)
    assert found.camera_ids == ("left", "right")
    assert all(matches(found, f, c, truth(f)[:2], 0.05) for f in range(5) for c in (0, 1))
    assert (tmp_path / "masks" / "left.png").exists()
    twice = CliRunner().invoke(app, ["detect", sources[0], sources[0], "-o", str(out)])
    assert isinstance(twice.exception, ml.InputError)
    assert CliRunner().invoke(app, ["detect", sources[0], "-o", "dots.xyz"]).exit_code == 2


def test_uneven_light_is_taken_off_tile_by_tile() -> None:
    random = np.random.default_rng(3)
    y, x = np.mgrid[0:256, 0:320]
    light = 20.0 + 0.35 * x + 0.1 * y  # up to 157: brighter than a marker is elsewhere
    places = [(40.3, 50.2), (160.7, 128.4), (290.1, 210.6)]
    for cx, cy in places:
        light = light + 70.0 * ndtr((3.0 - np.hypot(x - cx, y - cy)) / 0.7)
    image = np.clip(np.round(light + random.normal(0.0, 1.5, light.shape)), 0, 255).astype(np.uint8)
    assert len(ml.detect_markers(image)) != 3
    found = ml.detect_markers(image, adaptive=True)
    assert len(found) == 3
    for place in places:
        assert np.linalg.norm(found.pixel - place, axis=1).min() < 0.1


def test_a_videos_time_code_goes_into_the_dots(tmp_path: Path) -> None:
    image = np.full((64, 64), 16, np.uint8)
    image[30:34, 30:34] = 200
    for camera, code in (("a", "10:00:00:12"), ("b", "10:00:01:00")):
        write_video([image] * 4, tmp_path / f"{camera}.mkv", rate_hz=25.0, timecode=code)
    dots, _ = ml.detect({c: tmp_path / f"{c}.mkv" for c in "ab"})
    starts = [dots.optional["timecode_s"][(dots.camera == i) & (dots.frame == 0)][0] for i in (0, 1)]
    assert np.allclose(starts, [36000.48, 36001.0])
    clocks = ml.sync([dots], by="timecode").report["clocks"]
    assert np.isclose(clocks[1]["offset_frames"], 13.0)
