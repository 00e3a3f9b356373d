"""Printed calibration boards: what is on them, and where their corners lie in an image (found by OpenCV)."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from markerloom.errors import FormatError, InputError
from markerloom.formats.files import read_text

Array = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]

KINDS = ("checkerboard", "charuco", "aprilgrid")
FEWEST_CORNERS = 8
"""Corners of a board of tags from which a view counts."""
LARGEST_SIDE_PX = 1400
"""Larger images are also searched at this size: OpenCV misses large squares that are not sharp."""
SQUARE_REACH, TAG_REACH = 1.0 / 3.0, 0.08
"""Around a corner so much of a square's side is looked at; across a tag's edge, less than its border is wide."""
EDGE_POINTS = 25
"""Places along an edge of a tag where it is located."""
CROOKED = 0.1
"""Corners may lie this far (of a square's side) from where a plane has them; lenses bend less."""


@dataclass(frozen=True)
class Board:
    """A flat board. ``columns``, ``rows``: inner corners of a checkerboard; squares of a ChArUco board; tags of an
    AprilGrid. ``square_m``: side of a square, or of a tag; ``marker_m``: side of a ChArUco board's markers;
    ``spacing``: gap between tags over their side; ``dictionary``: OpenCV's name of the markers' set.
    """

    kind: str
    columns: int
    rows: int
    square_m: float
    marker_m: float = 0.0
    spacing: float = 0.3
    dictionary: str = ""

    def __post_init__(self) -> None:
        """Refuse what is no board."""
        if self.kind not in KINDS:
            raise InputError(f"a board of kind '{self.kind}': known are {', '.join(KINDS)}")
        least = 1 if self.kind == "aprilgrid" else 3
        if not (least <= self.columns <= 100 and least <= self.rows <= 100 and 0.0 < self.square_m < 10.0):
            raise InputError(f"a board of {self.columns} x {self.rows} with squares of {1000 * self.square_m:g} mm")
        if self.kind == "charuco" and not 0.0 < self.marker_m < self.square_m:
            raise InputError(
                f"markers of {1000 * self.marker_m:g} mm do not fit squares of {1000 * self.square_m:g} mm"
            )

    @property
    def places_m(self) -> Array:
        """Places (n, 3) of all corners on the board: x along a row, y down the rows, z into the board."""
        if self.kind == "aprilgrid":
            step = self.square_m * (1.0 + self.spacing)
            tag = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * self.square_m
            at = np.array([[c * step, r * step] for r in range(self.rows) for c in range(self.columns)])
            flat = (at[:, None] + tag[None]).reshape(-1, 2)
        else:
            off = 1 if self.kind == "charuco" else 0
            columns, rows = self.columns - off, self.rows - off
            flat = np.array([[c + off, r + off] for r in range(rows) for c in range(columns)]) * self.square_m
        return np.column_stack([flat, np.zeros(len(flat))])

    @property
    def looks_the_same_turned(self) -> bool:
        """Whether half a turn of the board cannot be seen: a checkerboard whose corners and colours then coincide."""
        return self.kind == "checkerboard" and (self.columns + self.rows) % 2 == 0


@dataclass(frozen=True)
class Corners:
    """Corners found in one image: ``corner`` (n,) index into the board's places, ``pixel`` (n, 2)."""

    corner: Ints
    pixel: Array


def read_board(spec: str) -> Board:
    """A board from a .toml file, or from KIND:COLUMNSxROWS:MM.

    ``checkerboard:4x7:60`` (inner corners, side of a square), ``charuco:7x5:40:30:DICT_4X4_50`` (squares, side of a
    square, of a marker, dictionary), ``aprilgrid:6x6:88:0.3`` (tags, side of a tag, gap over side). A file has
    ``kind``, ``columns``, ``rows``, ``square_mm`` and, where they belong, ``marker_mm``, ``spacing``, ``dictionary``.
    """
    if spec.endswith(".toml"):
        return _of_file(Path(spec))
    parts = spec.split(":")
    try:
        kind, (columns, rows), square_mm = parts[0], (int(n) for n in parts[1].split("x")), float(parts[2])
        if kind == "charuco":
            dictionary = parts[4] if len(parts) > 4 else "DICT_4X4_50"
            return Board(kind, columns, rows, square_mm / 1000, marker_m=float(parts[3]) / 1000, dictionary=dictionary)
        if kind == "aprilgrid":
            spacing = float(parts[3]) if len(parts) > 3 else 0.3
            return Board(kind, columns, rows, square_mm / 1000, spacing=spacing, dictionary="DICT_APRILTAG_36h11")
        return Board(kind, columns, rows, square_mm / 1000)
    except (IndexError, ValueError):
        raise InputError(
            f"'{spec}' is no board: KIND:COLUMNSxROWS:MM such as checkerboard:4x7:60, charuco:7x5:40:30:DICT_4X4_50, "
            "aprilgrid:6x6:88:0.3, or a .toml file"
        ) from None


def _of_file(path: Path) -> Board:
    try:
        table = tomllib.loads(read_text(path))
        return Board(
            kind=str(table["kind"]),
            columns=int(table["columns"]),
            rows=int(table["rows"]),
            square_m=float(table["square_mm"]) / 1000,
            marker_m=float(table.get("marker_mm", 0.0)) / 1000,
            spacing=float(table.get("spacing", 0.3)),
            dictionary=str(
                table.get("dictionary", "DICT_APRILTAG_36h11" if table["kind"] == "aprilgrid" else "DICT_4X4_50")
            ),
        )
    except tomllib.TOMLDecodeError as error:
        raise FormatError(path, f"not readable as TOML: {error}") from None
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(path, f"a board needs kind, columns, rows and square_mm ({error})") from None


def find_corners(board: Board, image: NDArray[np.unsignedinteger[Any]]) -> Corners | None:
    """The board's corners in a grey image (height, width), with sub-pixel places; ``None`` where it is not seen."""
    grey = image if image.dtype == np.uint8 else (image >> max(0, int(image.max()).bit_length() - 8)).astype(np.uint8)
    if board.kind == "checkerboard":
        return _checkerboard(board, grey)
    return _charuco(board, grey) if board.kind == "charuco" else _aprilgrid(board, grey)


def opencv() -> Any:
    """OpenCV, or an error that says how to get it."""
    try:
        import cv2
    except ImportError:
        raise InputError(
            "boards are found by OpenCV, which is not installed: pip install 'markerloom[boards]'"
        ) from None
    return cv2


def _checkerboard(board: Board, grey: NDArray[np.uint8]) -> Corners | None:
    cv2 = opencv()
    shape = (board.columns, board.rows)
    sector = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_NORMALIZE_IMAGE
    adaptive = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    ways = (
        lambda im: cv2.findChessboardCornersSB(im, shape, flags=sector),
        lambda im: cv2.findChessboardCorners(im, shape, flags=adaptive),
    )
    side = max(grey.shape)
    for scale in dict.fromkeys((1.0, min(1.0, LARGEST_SIDE_PX / side), min(1.0, 0.5 * LARGEST_SIDE_PX / side))):
        small = grey if scale == 1.0 else cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        for find in ways:
            found, pixel = find(small)
            if not found:
                continue
            pixel = (pixel.reshape(-1, 2).astype(float) + 0.5) / scale - 0.5
            pixel = _at_crossing(grey, pixel, SQUARE_REACH)
            if _is_flat(board, np.arange(len(pixel)), pixel):
                return Corners(np.arange(len(pixel)), pixel)
    return None


def _at_crossing(grey: NDArray[np.uint8], pixel: Array, part: float) -> Array:
    """Corners moved to where the grey values cross (Förstner's operator), within a part of their smallest distance."""
    cv2 = opencv()
    apart = np.linalg.norm(pixel[:, None] - pixel[None], axis=2)[~np.eye(len(pixel), dtype=bool)].min()
    reach = int(np.clip(part * apart, 2, 11))
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-3)
    start = np.ascontiguousarray(pixel, np.float32).reshape(-1, 1, 2)
    return cv2.cornerSubPix(grey, start, (reach, reach), (-1, -1), stop).reshape(-1, 2).astype(float)


def _where_edges_meet(grey: NDArray[np.uint8], quad: Array) -> Array:
    """Corners (4, 2) of a dark square from straight lines through its edges: blur rounds corners, but moves no edge.

    Across each edge, at places along it, the grey values pass half of their step.
    """
    middle, side = quad.mean(axis=0), float(np.linalg.norm(np.roll(quad, -1, axis=0) - quad, axis=1).min())
    reach = max(TAG_REACH * side, 1.5)
    across = np.linspace(-reach, reach, 4 * int(np.ceil(reach)) + 1)
    lines = []
    for a, b in zip(quad, np.roll(quad, -1, axis=0), strict=True):
        ahead = (b - a) / np.linalg.norm(b - a)
        out = np.array([ahead[1], -ahead[0]])
        out = out if (a + b) / 2 @ out > middle @ out else -out
        along = a + np.linspace(0.15, 0.85, EDGE_POINTS)[:, None] * (b - a)
        at = along[:, None] + across[None, :, None] * out
        value = map_coordinates(grey.astype(float), [at[..., 1], at[..., 0]], order=1, mode="nearest")
        low, high = value[:, 0].mean(), value[:, -1].mean()
        weight = np.clip((value - low) / max(high - low, 1.0), 0.0, 1.0)
        # The edge lies where as much is bright inside as is dark outside.
        off = reach - np.trapezoid(weight, across, axis=1)
        edge = along + off[:, None] * out
        near = np.abs(off - np.median(off)) < 1.0
        center = edge[near].mean(axis=0)
        normal = np.linalg.svd(edge[near] - center)[2][1]
        lines.append((*normal, normal @ center))
    corners = []
    for (a, b, c), (d, e, f) in zip([lines[-1], *lines[:-1]], lines, strict=True):
        corners.append(np.linalg.solve([[a, b], [d, e]], [c, f]))
    found = np.array(corners)
    return found if np.linalg.norm(found - quad, axis=1).max() < reach + 1.5 else quad


def _is_flat(board: Board, corner: Ints, pixel: Array) -> bool:
    """Whether the corners lie where a plane has them."""
    cv2 = opencv()
    places = board.places_m[corner, :2]
    plane, _ = cv2.findHomography(places, pixel, cv2.RANSAC, 5.0)
    if plane is None:
        return False
    expected = cv2.perspectiveTransform(places[None], plane)[0]
    side = np.linalg.norm(pixel[:, None] - pixel[None], axis=2)[~np.eye(len(pixel), dtype=bool)].min()
    return bool(np.median(np.linalg.norm(expected - pixel, axis=1)) < max(CROOKED * side, 1.0))


def _dictionary(board: Board) -> Any:
    cv2 = opencv()
    code = getattr(cv2.aruco, board.dictionary, None)
    if code is None:
        raise InputError(f"OpenCV knows no dictionary '{board.dictionary}': such as DICT_4X4_50, DICT_APRILTAG_36h11")
    return cv2.aruco.getPredefinedDictionary(code)


def _charuco(board: Board, grey: NDArray[np.uint8]) -> Corners | None:
    cv2 = opencv()
    shape = (board.columns, board.rows)
    made = cv2.aruco.CharucoBoard(shape, board.square_m, board.marker_m, _dictionary(board))
    pixel, corner, _, _ = cv2.aruco.CharucoDetector(made).detectBoard(grey)
    if corner is None or len(corner) < FEWEST_CORNERS:
        return None
    found = Corners(corner.ravel().astype(np.int64), pixel.reshape(-1, 2).astype(float))
    return found if _is_flat(board, found.corner, found.pixel) else None


def _aprilgrid(board: Board, grey: NDArray[np.uint8]) -> Corners | None:
    """Corners of tags; grids are numbered from the top or the bottom, and tags are printed in any of four turns."""
    cv2 = opencv()
    quads, tags, _ = cv2.aruco.ArucoDetector(_dictionary(board)).detectMarkers(grey)
    if tags is None:
        return None
    known = [
        (int(t), _where_edges_meet(grey, q.reshape(4, 2).astype(float)))
        for t, q in zip(tags.ravel(), quads, strict=True)
        if t < board.rows * board.columns
    ]
    if 4 * len(known) < FEWEST_CORNERS:
        return None
    best: tuple[float, Corners] | None = None
    for from_bottom in (False, True):
        for turn in range(4):
            corner, pixel = [], []
            for tag, quad in known:
                row, column = divmod(tag, board.columns)
                row = board.rows - 1 - row if from_bottom else row
                corner += [4 * (row * board.columns + column) + k for k in range(4)]
                pixel.append(np.roll(quad, turn, axis=0))
            found = Corners(np.array(corner), np.concatenate(pixel))
            places = board.places_m[found.corner, :2]
            plane, _ = cv2.findHomography(places, found.pixel, 0)
            if plane is not None:
                off = np.linalg.norm(cv2.perspectiveTransform(places[None], plane)[0] - found.pixel, axis=1)
                if best is None or np.median(off) < best[0]:
                    best = float(np.median(off)), found
    return best[1] if best is not None and _is_flat(board, best[1].corner, best[1].pixel) else None
