"""Calibration from boards: intrinsics and rigs from rendered images of three kinds of board, and every refusal."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import markerloom as ml
from markerloom.calibrate.boards import find_corners
from markerloom.detect.images import write_png
from markerloom.errors import InputError
from markerloom.rig import Camera, Rig

SIZE = (640, 480)
FOCAL = 700.0
FINE = 3
"""Samples of a pixel along each side."""
BOARDS = ("checkerboard:5x8:30", "charuco:9x6:30:22:DICT_4X4_100", "aprilgrid:6x5:24:0.25")


def printed(board: ml.Board, px_per_m: float) -> tuple[np.ndarray, np.ndarray]:
    """The printed board with a margin, and the place (m) of its top-left pixel."""
    margin = 0.03
    if board.kind == "checkerboard":
        shape = (board.rows + 1, board.columns + 1)
        squares = np.indices(shape).sum(axis=0) % 2 == 0
        side = round(board.square_m * px_per_m)
        inner = np.where(np.kron(squares, np.ones((side, side))), 0, 255).astype(np.uint8)
        corner = np.array([-board.square_m, -board.square_m])
    elif board.kind == "charuco":
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
        made = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square_m, board.marker_m, dictionary)
        size = (round(board.columns * board.square_m * px_per_m), round(board.rows * board.square_m * px_per_m))
        inner, corner = made.generateImage(size), np.zeros(2)
    else:
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
        side, step = round(board.square_m * px_per_m), round(board.square_m * (1 + board.spacing) * px_per_m)
        inner = np.full((board.rows * step, board.columns * step), 255, np.uint8)
        for tag in range(board.rows * board.columns):
            row, column = divmod(tag, board.columns)
            top = (board.rows - 1 - row) * step  # as Kalibr prints them: numbered from the bottom
            inner[top : top + side, column * step : column * step + side] = cv2.aruco.generateImageMarker(
                dictionary, tag, side
            )
        corner = np.zeros(2)
    edge = round(margin * px_per_m)
    return np.pad(inner, edge, constant_values=255), corner - edge / px_per_m


def filmed(board: ml.Board, camera: Camera, rotation: np.ndarray, shift: np.ndarray, seed: int = 0) -> np.ndarray:
    """What a camera without distortion sees of the board at a pose in the world."""
    px_per_m = 5000.0
    image, corner = printed(board, px_per_m)
    turn = camera.rotation @ rotation
    at = camera.rotation @ (shift - camera.position_m)
    focal, middle = camera.focal_px[0] * FINE, (np.array(camera.principal_px) + 0.5) * FINE - 0.5
    project = np.array([[focal, 0, middle[0]], [0, focal, middle[1]], [0, 0, 1]])
    # A printed pixel's middle lies half a pixel inside its corner.
    place = (
        np.array([[1, 0, corner[0] * px_per_m + 0.5], [0, 1, corner[1] * px_per_m + 0.5], [0, 0, px_per_m]]) / px_per_m
    )
    plane = project @ np.column_stack([turn[:, 0], turn[:, 1], at]) @ place
    big = (SIZE[0] * FINE, SIZE[1] * FINE)
    fine = cv2.warpPerspective(image, plane, big, flags=cv2.INTER_LINEAR, borderValue=90)
    grey = fine.reshape(SIZE[1], FINE, SIZE[0], FINE).mean(axis=(1, 3)) * 0.7 + 30
    noise = np.random.default_rng(seed).normal(0.0, 1.5, grey.shape)
    return np.clip(np.round(grey + noise), 0, 255).astype(np.uint8)


def camera(name: str = "a", rotation: np.ndarray | None = None, position: tuple[float, ...] = (0, 0, 0)) -> Camera:
    turn = np.eye(3) if rotation is None else rotation
    return Camera(name, SIZE, (FOCAL, FOCAL), (322.0, 236.0), turn, np.array(position, float))


def poses(count: int, seed: int = 1, tilt: float = 0.6, at: tuple[float, ...] = (0, 0, 0.62)):
    """Board poses around a place, facing along +z, tilted up to ``tilt`` rad."""
    random = np.random.default_rng(seed)
    for _ in range(count):
        turn = Rotation.from_rotvec([*random.uniform(-tilt, tilt, 2), random.uniform(-0.3, 0.3)]).as_matrix()
        yield turn, np.array(at) + random.uniform(-1, 1, 3) * [0.08, 0.06, 0.1] - turn @ [0.09, 0.11, 0.0]


def save(folder: Path, images: list[np.ndarray]) -> Path:
    folder.mkdir(parents=True)
    for number, image in enumerate(images):
        write_png(image, folder / f"{number:03d}.png")
    return folder


@pytest.mark.parametrize("spec", BOARDS)
def test_corners_lie_where_they_are_projected(spec: str) -> None:
    board = ml.read_board(spec)
    one = camera()
    (rotation, shift), *_ = poses(1)
    found = find_corners(board, filmed(board, one, rotation, shift))
    assert found is not None
    places = board.places_m @ rotation.T + shift
    expected = Rig((one,)).project(0, places)
    if board.kind == "checkerboard":  # the first corner may be either end
        ends = [expected[found.corner], expected[::-1][found.corner]]
        off = min((np.linalg.norm(found.pixel - e, axis=1) for e in ends), key=np.median)
    else:
        off = np.linalg.norm(found.pixel - expected[found.corner], axis=1)
    assert len(found.corner) > 0.9 * len(board.places_m)
    assert np.median(off) < 0.1
    assert find_corners(board, np.full((480, 640), 120, np.uint8)) is None


@pytest.mark.parametrize("spec", BOARDS)
def test_intrinsics_are_recovered_within_their_uncertainty(spec: str, tmp_path: Path) -> None:
    board, one = ml.read_board(spec), camera()
    folder = save(tmp_path / "a", [filmed(board, one, *pose, seed=k) for k, pose in enumerate(poses(12))])
    rig, report = ml.calibrate_intrinsics({"a": folder}, board)
    own = report["cameras"]["a"]
    assert report["verdict"] == "ok", report["reasons"]
    assert own["reprojection_px"]["rms"] < 0.15
    assert abs(rig.cameras[0].focal_px[0] / FOCAL - 1) < 0.005
    for got, true, sigma in zip(rig.cameras[0].principal_px, (322.0, 236.0), own["principal_px_sigma"], strict=True):
        assert abs(got - true) < max(6 * sigma, 1.0)


def three_cameras() -> list[Camera]:
    """Cameras half a metre apart that look at the same place."""
    found = []
    for name, x in (("a", -0.35), ("b", 0.0), ("c", 0.4)):
        ahead = np.array([0.0, 0.0, 0.62]) - [x, 0.0, 0.0]
        ahead /= np.linalg.norm(ahead)
        right = np.cross([0.0, 1.0, 0.0], ahead)
        found.append(camera(name, np.array([right / np.linalg.norm(right), np.cross(ahead, right), ahead]), (x, 0, 0)))
    return found


@pytest.fixture(scope="module")
def filmed_rig(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Path], Rig, ml.Board]:
    board, cameras = ml.read_board(BOARDS[1]), three_cameras()
    folder = tmp_path_factory.mktemp("rig")
    views = list(poses(8, tilt=0.35))
    sources = {
        c.id: save(folder / c.id, [filmed(board, c, *pose, seed=10 * k + i) for k, pose in enumerate(views)])
        for i, c in enumerate(cameras)
    }
    return sources, Rig(tuple(cameras)), board


def test_a_rig_is_recovered_from_a_board(filmed_rig: tuple[dict[str, Path], Rig, ml.Board]) -> None:
    sources, true, board = filmed_rig
    rig, report = ml.calibrate_board(sources, board, intrinsics=true)
    assert report["verdict"] == "ok", report["reasons"]
    assert report["reprojection_px"] < 0.15
    for i, a in enumerate(true.cameras):
        for j, b in enumerate(true.cameras[:i]):
            apart = np.linalg.norm(rig.cameras[i].position_m - rig.cameras[j].position_m)
            assert abs(apart - np.linalg.norm(a.position_m - b.position_m)) < 0.002
            turned = Rotation.from_matrix(rig.cameras[i].rotation @ rig.cameras[j].rotation.T)
            wanted = Rotation.from_matrix(a.rotation @ b.rotation.T)
            assert np.degrees((turned * wanted.inv()).magnitude()) < 0.2
    assert all(c.position_m[2] > 0.3 for c in rig.cameras)  # Z out of the board, towards the cameras


def test_lenses_come_from_the_same_images_where_none_are_given(
    filmed_rig: tuple[dict[str, Path], Rig, ml.Board],
) -> None:
    sources, true, board = filmed_rig
    rig, report = ml.calibrate_board(sources, board)
    apart = np.linalg.norm(rig.cameras[0].position_m - rig.cameras[2].position_m)
    assert abs(apart - np.linalg.norm(true.cameras[0].position_m - true.cameras[2].position_m)) < 0.02
    assert report["reprojection_px"] < 0.2


def test_a_camera_that_sees_the_board_at_other_moments_is_refused(
    filmed_rig: tuple[dict[str, Path], Rig, ml.Board], tmp_path: Path
) -> None:
    sources, true, board = filmed_rig
    wrong = save(tmp_path / "c", [filmed(board, true.cameras[2], *pose) for pose in poses(8, seed=9, tilt=0.35)])
    _, report = ml.calibrate_board(sources | {"c": wrong}, board, intrinsics=true)
    assert report["verdict"] == "refused"
    assert any("camera c" in r for r in report["reasons"])


def test_views_from_one_direction_are_refused(tmp_path: Path) -> None:
    board = ml.read_board(BOARDS[0])
    flat = [filmed(board, camera(), *pose, seed=k) for k, pose in enumerate(poses(6, tilt=0.01))]
    _, report = ml.calibrate_intrinsics({"a": save(tmp_path / "a", flat)}, board)
    assert report["verdict"] == "refused"
    assert any("one direction" in r or "focal length" in r for r in report["reasons"])


def test_mirrored_images_and_too_few_views_are_told(tmp_path: Path) -> None:
    board = ml.read_board(BOARDS[1])
    images = [filmed(board, camera(), *pose) for pose in poses(5)]
    mirrored = save(tmp_path / "a", [np.ascontiguousarray(i[:, ::-1]) for i in images])
    _, report = ml.calibrate_intrinsics({"a": mirrored}, board)
    assert "mirrored" in report["reasons"][0]
    _, report = ml.calibrate_intrinsics({"a": save(tmp_path / "b", images[:2])}, board)
    assert "2 of 2 images" in report["reasons"][0]


def test_images_of_mixed_or_other_size_are_refused(
    filmed_rig: tuple[dict[str, Path], Rig, ml.Board], tmp_path: Path
) -> None:
    sources, true, board = filmed_rig
    image = filmed(board, camera(), *next(poses(1)))
    with pytest.raises(InputError, match="one size"):
        ml.calibrate_intrinsics({"a": save(tmp_path / "a", [image, image[:400]])}, board)
    other = Rig(
        tuple(Camera(c.id, (800, 600), c.focal_px, c.principal_px, c.rotation, c.position_m) for c in true.cameras)
    )
    with pytest.raises(InputError, match="800x600"):
        ml.calibrate_board(sources, board, intrinsics=other)


@pytest.mark.parametrize(
    "spec", ["chess:4x7:60", "checkerboard:4:60", "checkerboard:0x7:60", "charuco:5x7:30:40", "x.toml"]
)
def test_what_is_no_board_is_refused(spec: str) -> None:
    with pytest.raises(InputError):
        ml.read_board(spec)


def test_a_board_file_says_the_same_as_its_short_form(tmp_path: Path) -> None:
    file = tmp_path / "board.toml"
    file.write_text(
        'kind = "charuco"\ncolumns = 9\nrows = 6\nsquare_mm = 30\nmarker_mm = 22\ndictionary = "DICT_4X4_100"\n'
    )
    assert ml.read_board(str(file)) == ml.read_board(BOARDS[1])


def test_real_boards(data: Path) -> None:
    folder = data / "boards"
    sources = {f"cam0{c}": folder / "intrinsics" / f"int_cam0{c}_img" for c in range(1, 5)}
    rig, report = ml.calibrate_intrinsics(sources, ml.read_board("checkerboard:4x7:60"))
    reference = ml.read_calibration(folder / "Calib.qca.txt")
    assert sum(own["views"] for own in report["cameras"].values()) >= 25
    for one in rig.cameras:
        assert report["cameras"][one.id]["reprojection_px"]["rms"] < 0.5
        wanted = reference.find(one.id)
        assert wanted is not None
        for got, true in zip(one.focal_px, wanted.focal_px, strict=True):
            assert abs(got / true - 1) < 0.02
