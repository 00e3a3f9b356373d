"""Grey blobs: half-hidden and merged dots that a camera could not fit."""

from pathlib import Path

import numpy as np
import pytest
from scipy.special import ndtr
from typer.testing import CliRunner

import markerloom as ml
from markerloom.cli import app
from markerloom.errors import FormatError

RADIUS, BLUR, THRESHOLD = 2.5, 0.75, 51


def blob(centers: list[tuple[float, float]], cut: tuple[float, float] | None, seed: int) -> ml.GreyBlob:
    """Disks (radius to the threshold: 2.5 px), hidden beyond a cut (direction, offset), as a camera sends them."""
    x, y = np.meshgrid(np.arange(60.0), np.arange(60.0))
    radius = RADIUS - 0.67 * BLUR
    share = np.zeros_like(x)
    for cx, cy in centers:
        own = ndtr((radius - np.hypot(x - cx, y - cy)) / BLUR)
        if cut is not None:
            along = (x - cx) * np.cos(cut[0]) + (y - cy) * np.sin(cut[0])
            own *= ndtr((along - cut[1]) / BLUR)
        share = np.maximum(share, own)
    values = 210.0 * share + np.random.default_rng(seed).normal(0.0, 3.0, share.shape)
    rows, columns = np.nonzero(values > THRESHOLD)
    pixels = zip(columns.tolist(), rows.tolist(), values[rows, columns].astype(int).tolist(), strict=True)
    return ml.GreyBlob(seed, "7", tuple(pixels))


def test_half_hidden_dots_have_their_whole_disks_centre() -> None:
    random = np.random.default_rng(1)
    places = random.uniform(29, 31, (40, 2))
    blobs = [blob([tuple(p)], (random.uniform(0, 6.28), -0.4), k) for k, p in enumerate(places)]
    found = ml.fit_grey_blobs(blobs, {"7": RADIUS})
    assert len(found) == 40
    off = np.linalg.norm(found.pixel - places[found.frame], axis=1)
    plain = [np.average([p[:2] for p in b.pixels], axis=0, weights=[p[2] - 45 for p in b.pixels]) for b in blobs]
    naive = np.linalg.norm(np.array(plain) - places, axis=1)
    assert np.median(off) < 0.5 * np.median(naive)
    assert np.mean(off < 1.0) > 0.95
    assert np.mean(np.square(off) / (2 * np.square(found.optional["sigma"]))) < 2.5


def test_two_that_have_run_together_are_two() -> None:
    found = ml.fit_grey_blobs([blob([(28.2, 30.0), (32.1, 30.8)], None, 3)], {"7": RADIUS}, threshold=THRESHOLD)
    assert len(found) == 2
    order = np.argsort(found.pixel[:, 0])
    assert np.abs(found.pixel[order] - [(28.2, 30.0), (32.1, 30.8)]).max() < 0.5


def test_nothing_comes_of_nothing() -> None:
    few = ml.GreyBlob(0, "7", ((3, 4, 60), (4, 4, 60)))
    assert len(ml.fit_grey_blobs([few], {})) == 0
    assert len(ml.fit_grey_blobs([], {})) == 0


def test_a_real_x2d_gains_dots(data: Path, tmp_path: Path) -> None:
    source = data / "vicon-upper-body" / "cal.x2d"
    blobs = ml.read_grey_blobs(source)
    assert len(blobs) > 1000
    assert all(51 <= value <= 255 for b in blobs for _, _, value in b.pixels)
    out = tmp_path / "dots.parquet"
    done = CliRunner().invoke(app, ["detect", str(source), "-o", str(out)])
    assert done.exit_code == 0, done.output
    dots = ml.read_observations(out)
    assert len(dots) > len(ml.read_observations(source)) + 1000
    rig = ml.read_calibration(source.with_suffix(".xcp"))
    before = ml.reconstruct(ml.read_observations(source).select(0, 20), rig)
    after = ml.reconstruct(dots.select(0, 20), rig)
    assert after.report["rays_mean"] >= before.report["rays_mean"]


@pytest.mark.parametrize("content", [b"", b"not an x2d"])
def test_what_is_no_x2d_is_told(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.x2d"
    path.write_bytes(content)
    with pytest.raises(FormatError):
        ml.read_grey_blobs(path)
