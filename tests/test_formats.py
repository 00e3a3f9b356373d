"""Tables, TRC, Motive and QTM files: round trips, real files, and what bad input is told."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import markerloom as ml
from markerloom import _core
from markerloom.points import Points

READABLE = {".c3d", ".trc", ".tsv", ".csv", ".csv.gz", ".x2d", ".xcp", ".mcal", ".qca.txt"}


def example() -> Points:
    rng = np.random.default_rng(5)
    n = 30
    return Points.of(
        np.repeat(np.arange(10), 3),
        np.tile(np.arange(3), 10),
        np.round(rng.normal(0, 900, (n, 3)), 5),
        label=np.tile(["A", "B", "C"], 10),
        sigma_mm=rng.uniform(0, 2, n),
        rays=rng.integers(2, 9, n),
        residual_px=rng.uniform(0, 1, n),
        confidence=rng.uniform(0, 1, n),
        kind=rng.integers(0, 4, n),
        rate_hz=119.88,
        frames=np.arange(10),
    )


@pytest.mark.parametrize("ending", ["parquet", "csv"])
def test_points_tables_round_trip(tmp_path: Path, ending: str) -> None:
    points = example()
    points.save(tmp_path / f"a.{ending}")
    again = ml.read_points(tmp_path / f"a.{ending}")
    for name in ("frame", "track", "label", "xyz_mm", "sigma_mm", "rays", "residual_px", "confidence", "kind"):
        np.testing.assert_array_equal(getattr(again, name), getattr(points, name))
    if ending == "parquet":
        assert again.rate_hz == 119.88


def test_points_table_has_the_agreed_columns() -> None:
    names = example().to_arrow().column_names
    agreed = "frame track label x_mm y_mm z_mm sigma_mm rays residual_px confidence kind"
    assert names[:11] == agreed.split()


def test_trc_round_trip_keeps_gaps(tmp_path: Path) -> None:
    points = example().keep(np.arange(30) != 7)
    points.save(tmp_path / "a.trc")
    again = ml.read_points(tmp_path / "a.trc")
    np.testing.assert_array_equal(again.frame, points.frame)
    np.testing.assert_allclose(again.xyz_mm, points.xyz_mm, atol=1e-6)
    assert again.rate_hz == pytest.approx(119.88)


def test_observations_round_trip(tmp_path: Path, take: ml.SimulatedTake) -> None:
    from markerloom.formats import write_observations

    write_observations(take.observations, tmp_path / "a.parquet")
    again = ml.read_observations(tmp_path / "a.parquet")
    np.testing.assert_array_equal(again.pixel, take.observations.pixel)
    assert again.rate_hz == take.scene.rate_hz


def ending(path: Path) -> str:
    name = path.name.lower()
    return next((e for e in (".csv.gz", ".qca.txt") if name.endswith(e)), Path(name).suffix)


def test_every_real_file_is_read_or_refused_with_a_clear_line(data: Path) -> None:
    read, refused = 0, []
    for path in sorted(p for p in data.rglob("*") if ending(p) in READABLE):
        try:
            found = ml.inspect(path)
            assert found["content"] in ("calibration", "observations", "points", "table"), path
            read += 1
        except ml.MarkerloomError as error:
            refused.append(path.name if path.name in str(error) else f"{path.name} is not named in: {error}")
    assert sorted(refused) == ["Empty.c3d", "Empty.trc", "Truncated.trc"]
    assert read > 50


def test_a_real_trc_has_its_published_numbers(data: Path) -> None:
    points = ml.read_points(data / "trc" / "exampleFormat.trc")
    first = points.xyz_mm[points.label == "marker2"][0]
    np.testing.assert_allclose(first, [-152.0, 245.0, -1710.0])
    assert (points.label == "marker1").sum() == 4


def test_a_real_motive_csv_is_turned_to_z_up(data: Path) -> None:
    points = ml.read_points(data / "optitrack" / "hand-markers.csv")
    first = points.xyz_mm[(points.frame == 0) & (points.label == "Hand:00_ThumbCMC")][0]
    np.testing.assert_allclose(first, [92.607880, 33.401894, 102.412979])
    assert points.rate_hz == 120.0


def test_a_real_qtm_file_has_its_first_sample(data: Path) -> None:
    points = ml.read_points(data / "qualisys-tsv" / "Measurement1.tsv")
    np.testing.assert_allclose(points.xyz_mm[0], [819.834, 277.770, 22.421])
    assert (points.frame[0], points.rate_hz, len(points.frames)) == (0, 100.0, 2000)


BAD = {
    "empty.csv": (b"", "empty"),
    "nocolumn.csv": (b"frame,camera,x\n0,1,2\n", "no table of points"),
    "halfframe.csv": (b"frame,track,x_mm,y_mm,z_mm\n0.5,0,1,2,3\n", "not a whole number"),
    "text.csv": (b"frame,track,x_mm,y_mm,z_mm\n0,0,one,2,3\n", "not a number"),
    "kind.csv": (b"frame,track,x_mm,y_mm,z_mm,kind\n0,0,1,2,3,guessed\n", "guessed"),
    "no.parquet": (b"PAR1 but not really", "not a readable Parquet"),
    "damaged.csv.gz": (b"\x1f\x8b\x08damaged", "compression is damaged"),
    "cut.trc": (b"PathFileType\t4\n", "ends in the header"),
    "not.trc": (b"hello\n", "does not start with PathFileType"),
    "not.c3d": (b"\x02\x51" + bytes(600), "not a C3D"),
    "short.c3d": (b"\x02", "ends at byte"),
    "not.tsv": (b"a\tb\n1\t2\n", "not a QTM TSV"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_points_are_refused_with_the_file_and_the_reason(tmp_path: Path, name: str) -> None:
    content, reason = BAD[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ml.MarkerloomError, match=reason) as caught:
        ml.read_points(tmp_path / name)
    assert name in str(caught.value)


def test_an_unknown_ending_and_a_missing_file_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(ml.InputError, match="points are"):
        ml.read_points(tmp_path / "a.fbx")
    with pytest.raises(ml.InputError, match="there is no file"):
        ml.read_points(tmp_path / "a.trc")


def test_xml_bombs_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.xcp").write_text('<!DOCTYPE x [<!ENTITY a "b">]><Cameras>&a;</Cameras>')
    with pytest.raises(ml.FormatError, match="document type"):
        ml.read_calibration(tmp_path / "a.xcp")


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=400))
def test_random_bytes_are_never_an_x2d(content: bytes) -> None:
    try:
        found = _core.read_x2d(b"\x03\x00\x00\x00" + content)
    except ml.MarkerloomError:
        return
    assert len(found["x"]) * 11 <= len(content)


def test_a_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    target = tmp_path / "a.c3d"
    target.write_bytes(b"old")
    points = example()
    with pytest.raises(ml.InputError):
        Points(**{**vars(points), "rate_hz": None}).save(target)
    assert target.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.c3d"]


def test_c3d_to_c3d_keeps_analog_and_events(data: Path, tmp_path: Path) -> None:
    source = data / "c3d" / "gait-labs" / "nexus-walking.c3d"
    ml.convert(source, tmp_path / "a.c3d")
    before, after = ml.inspect(source), ml.inspect(tmp_path / "a.c3d")
    assert before["analog_channels"] == after["analog_channels"] > 0
    assert before["parameters"] == after["parameters"]
    assert "EVENT" in after["parameters"]
