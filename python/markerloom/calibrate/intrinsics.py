"""Focal lengths, principal point and lens of single cameras from images of a board (OpenCV's solver, Zhang 2000)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.calibrate.boards import Board, Corners, find_corners, opencv
from markerloom.detect.images import grey_images
from markerloom.errors import InputError
from markerloom.reconstruct import Progress
from markerloom.rig import Camera, Lens, Rig

Array = NDArray[np.floating[Any]]

FEWEST_VIEWS = 4
MOST_VIEWS = 80
"""More views of a video tell hardly more; those are taken in which the board is elsewhere."""
MOST_IMAGES = 400
"""Images of a video that are looked at."""
OUTLYING = 5.0
"""A corner so many robust standard deviations off is left out; a view with more such corners than not, too."""
FOCAL_UNSURE = 0.02
"""A focal length known no better than this (relative) is refused."""
LARGEST_RMS_PX = 1.5
LEAST_TILT_DEG = 10.0
"""Views must differ in direction by this: a plane seen from one direction tells no focal length."""
USEFUL_COVERAGE = 0.3
GRID = 12
K3_GAIN, ENOUGH_FOR_K3 = 0.97, 10
"""A sixth-order term is kept where it makes the residual smaller than this, of so many views."""
ALIKE = 1.2
"""Solutions from two starts whose residuals are within this factor explain the corners alike."""


@dataclass(frozen=True)
class BoardViews:
    """A camera's views of a board: corners by image number, and the size of its images."""

    camera: str
    size_px: tuple[int, int]
    views: dict[int, Corners]
    images: int


def look_for_board(
    sources: Mapping[str, str | Path], board: Board, *, progress: Progress | None = None
) -> list[BoardViews]:
    """Find the board in each camera's images: a video, an image, or a folder of images.

    Of long videos every k-th image is looked at. Raises ``InputError`` for images of one camera that differ in size.
    """
    found = []
    for done, (camera, source) in enumerate(sources.items()):
        step = _step(source)
        size, views, images = None, {}, 0
        for number, image in enumerate(grey_images(source)):
            shape = (image.shape[1], image.shape[0])
            if size is not None and shape != size:
                raise InputError(
                    f"camera {camera}: image {number} has {shape[0]}x{shape[1]} pixels, those before it "
                    f"{size[0]}x{size[1]}: a camera is calibrated with images of one size ({source})"
                )
            size = shape
            images += 1
            if number % step == 0 and (corners := find_corners(board, image)) is not None:
                views[number] = corners
        if size is None:
            raise InputError(f"camera {camera}: there is no image in {source}")
        found.append(BoardViews(camera, size, views, images))
        if progress:
            progress(done + 1, len(sources))
    return found


def calibrate_intrinsics(
    sources: Mapping[str, str | Path], board: Board, *, progress: Progress | None = None
) -> tuple[Rig, dict[str, Any]]:
    """Calibrate each camera for itself from images of a board held at many angles, over the whole image.

    ``sources`` by camera id: a video, an image, or a folder of images. The cameras of the rig all stand at the origin:
    where they stand is for ``calibrate wand`` or ``board`` to find (``intrinsics=``). The report has, by camera,
    ``images``, ``views`` (images with the board), ``corners``, ``reprojection_px`` {median, rms}, ``focal_px``,
    ``principal_px``, ``distortions`` with their standard deviations (``…_sigma``), ``coverage`` of the image,
    ``tilt_deg`` (the largest angle between two views); ``verdict`` (``ok``, or ``refused`` with ``reasons``).
    """
    looked = look_for_board(sources, board, progress=progress)
    cameras, rows, reasons, warnings = [], {}, [], []
    for own in looked:
        refused = _too_few(own, sources[own.camera], board)
        if refused is not None:
            reasons.append(refused)
            continue
        camera, row = solve_intrinsics(own, board)
        cameras.append(camera)
        rows[own.camera] = row
        reasons += _reasons(own.camera, row)
        if row["coverage"] < USEFUL_COVERAGE:
            warnings.append(
                f"camera {own.camera}: the board covers {row['coverage']:.0%} of the image; hold it into the corners, "
                "or the lens is a guess there"
            )
    rms = [row["reprojection_px"]["rms"] for row in rows.values()]
    report = {
        "frames": sum(own.images for own in looked),
        "warnings": warnings,
        "cameras": rows,
        "reprojection_px": float(np.sqrt(np.mean(np.square(rms)))) if rms else float("nan"),
        "verdict": "refused" if reasons else "ok",
        "reasons": reasons,
    }
    return Rig(tuple(cameras), "intrinsics from a board"), report


def _step(source: str | Path) -> int:
    path = Path(source)
    if path.is_dir():
        return 1
    return max(1, sum(1 for _ in grey_images(path)) // MOST_IMAGES)


def _too_few(own: BoardViews, source: str | Path, board: Board) -> str | None:
    if len(own.views) >= FEWEST_VIEWS:
        return None
    if board.kind != "checkerboard":
        for number, image in enumerate(grey_images(source)):
            if find_corners(board, np.ascontiguousarray(image[:, ::-1])) is not None:
                return f"camera {own.camera}: its images are mirrored (image {number} shows the board flipped)"
            if number >= FEWEST_VIEWS:
                break
    return (
        f"camera {own.camera}: the board is found in {len(own.views)} of {own.images} images; {FEWEST_VIEWS} or more "
        "are needed, sharp, with the whole board in view; are its columns and rows as stated?"
    )


def solve_intrinsics(own: BoardViews, board: Board) -> tuple[Camera, dict[str, Any]]:
    """A camera (at the origin) from its views of the board, and what it is worth."""
    cv2 = opencv()
    numbers = _apart(own)
    places = [board.places_m[own.views[n].corner] for n in numbers]
    pixels = [own.views[n].pixel for n in numbers]
    keep = [np.ones(len(p), bool) for p in pixels]
    solved: tuple[Any, ...] = ()
    for _ in range(3):
        solved = _solve(places, pixels, keep, own.size_px)
        off = _residuals(places, pixels, solved)
        sizes = np.concatenate([np.linalg.norm(o[k], axis=1) for o, k in zip(off, keep, strict=True)])
        limit = OUTLYING * float(np.median(sizes)) / 1.1774
        good = [np.linalg.norm(o, axis=1) < limit for o in off]
        good = [g if g.mean() > 0.5 else np.zeros_like(g) for g in good]
        if all(np.array_equal(g, k) for g, k in zip(good, keep, strict=True)):
            break
        if sum(g.any() for g in good) < FEWEST_VIEWS:
            break
        keep = good
    _, matrix, lens, turns, _, spread = solved
    used = np.concatenate([p[k] for p, k in zip(pixels, keep, strict=True)])
    lengths = np.concatenate(
        [np.linalg.norm(o[k], axis=1) for o, k in zip(_residuals(places, pixels, solved), keep, strict=True)]
    )
    normals = np.array([cv2.Rodrigues(t)[0][:, 2] for t, k in zip(turns, keep, strict=True) if k.any()])
    tilt = np.degrees(np.arccos(np.clip((normals @ normals.T).min(), -1.0, 1.0)))
    cells = np.unique(np.clip((used / np.array(own.size_px) * GRID).astype(int), 0, GRID - 1), axis=0)
    coefficients = (*(float(v) for v in np.ravel(lens)[:5]), 0.0, 0.0, 0.0)
    camera = Camera(
        id=own.camera,
        size_px=(float(own.size_px[0]), float(own.size_px[1])),
        focal_px=(float(matrix[0, 0]), float(matrix[1, 1])),
        principal_px=(float(matrix[0, 2]), float(matrix[1, 2])),
        rotation=np.eye(3),
        position_m=np.zeros(3),
        lens=Lens("brown_conrady", coefficients),
    )
    spread = np.ravel(spread)
    return camera, {
        "images": own.images,
        "views": int(sum(k.any() for k in keep)),
        "corners": len(used),
        "corners_left_out": int(sum((~k).sum() for k in keep)),
        "reprojection_px": {"median": float(np.median(lengths)), "rms": float(np.sqrt(np.mean(lengths**2)))},
        "focal_px": camera.focal_px,
        "focal_px_sigma": spread[:2].tolist(),
        "aspect": camera.focal_px[1] / camera.focal_px[0],
        "principal_px": camera.principal_px,
        "principal_px_sigma": spread[2:4].tolist(),
        "distortions": list(coefficients[:5]),
        "distortions_sigma": spread[4:9].tolist(),
        "coverage": len(cells) / GRID**2,
        "tilt_deg": float(tilt),
    }


def _apart(own: BoardViews) -> list[int]:
    """Views in which the board is elsewhere than in those chosen before, up to ``MOST_VIEWS``."""
    numbers = sorted(own.views)
    if len(numbers) <= MOST_VIEWS:
        return numbers
    middles = np.array([[*v.mean(axis=0), np.ptp(v[:, 0])] for v in (own.views[n].pixel for n in numbers)])
    chosen, nearest = [0], np.linalg.norm(middles - middles[0], axis=1)
    while len(chosen) < MOST_VIEWS:
        chosen.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, np.linalg.norm(middles - middles[chosen[-1]], axis=1))
    return sorted(numbers[i] for i in chosen)


def _solve(
    places: list[Array], pixels: list[Array], keep: list[NDArray[np.bool_]], size: tuple[int, int]
) -> tuple[Any, ...]:
    """OpenCV's solution with, if it fits so much better, or without a term of sixth order.

    Poses are given for all views, also for those left out (of the nearest in use).
    """
    cv2 = opencv()
    rows = [i for i, k in enumerate(keep) if k.sum() >= FEWEST_VIEWS]
    objects = [places[i][keep[i]].astype(np.float32) for i in rows]
    images = [pixels[i][keep[i]].astype(np.float32).reshape(-1, 1, 2) for i in rows]

    def solve(flags: int, start: Array | None = None) -> tuple[Any, ...]:
        flags |= 0 if start is None else cv2.CALIB_USE_INTRINSIC_GUESS
        return cv2.calibrateCameraExtended(objects, images, size, start, None, flags=flags)

    usual = np.array([[max(size), 0, (size[0] - 1) / 2], [0, max(size), (size[1] - 1) / 2], [0, 0, 1]], float)
    own, other = solve(cv2.CALIB_FIX_K3), solve(cv2.CALIB_FIX_K3, usual)
    plain = min(own, other, key=lambda s: s[0])
    full = solve(0, plain[1].copy()) if len(rows) >= ENOUGH_FOR_K3 else None
    rms, matrix, lens, turns, shifts, spread, *_ = full if full and full[0] < K3_GAIN * plain[0] else plain
    if max(own[0], other[0]) < ALIKE * plain[0]:
        # Two answers that explain the corners alike: neither is known better than they differ.
        spread = np.ravel(spread).copy()
        spread[:2] = np.maximum(spread[:2], np.abs(np.diag(own[1] - other[1])[:2]))
    all_turns, all_shifts = [], []
    for i in range(len(places)):
        if i in rows:
            all_turns.append(turns[rows.index(i)])
            all_shifts.append(shifts[rows.index(i)])
        else:
            _, turn, shift = cv2.solvePnP(places[i], pixels[i], matrix, lens)
            all_turns.append(turn)
            all_shifts.append(shift)
    return rms, matrix, lens, all_turns, all_shifts, spread


def _residuals(places: list[Array], pixels: list[Array], solved: tuple[Any, ...]) -> list[Array]:
    cv2 = opencv()
    _, matrix, lens, turns, shifts, _ = solved
    projected = [
        cv2.projectPoints(p, t, s, matrix, lens)[0][:, 0] for p, t, s in zip(places, turns, shifts, strict=True)
    ]
    return [pixel - own for pixel, own in zip(pixels, projected, strict=True)]


def _reasons(camera: str, row: dict[str, Any]) -> list[str]:
    reasons = []
    if row["tilt_deg"] < LEAST_TILT_DEG:
        reasons.append(
            f"camera {camera}: all views show the board from one direction (within {row['tilt_deg']:.0f}°), which "
            "tells no focal length: tilt it by 30° or more, in all directions"
        )
    unsure = max(s / f for s, f in zip(row["focal_px_sigma"], row["focal_px"], strict=True))
    if not unsure < FOCAL_UNSURE:
        reasons.append(
            f"camera {camera}: the focal length is known to ± {unsure:.1%} only: more views, nearer and more tilted"
        )
    rms = row["reprojection_px"]["rms"]
    if not rms < LARGEST_RMS_PX:
        reasons.append(
            f"camera {camera}: corners lie {rms:.2f} px (rms) from where they should: is the board flat, and as "
            "stated? Does the camera expose all rows at once?"
        )
    return reasons
