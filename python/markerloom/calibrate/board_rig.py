"""A rig from a board that several cameras see at the same time."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom import _core
from markerloom.calibrate.boards import Board, Corners, opencv
from markerloom.calibrate.intrinsics import BoardViews, look_for_board, solve_intrinsics
from markerloom.calibrate.wand import GRID, PARAMETERS
from markerloom.calibrate.world import moved
from markerloom.errors import InputError
from markerloom.reconstruct import Progress
from markerloom.rig import Camera, Rig

Array = NDArray[np.floating[Any]]

FEWEST_VIEWS = 3
"""Images in which a camera must see the board together with another one."""
ALIKE_M, ALIKE_DEG = 0.15, 8.0
"""Poses of one camera against another that agree so well are the same (the shift relative to their distance)."""
AMBIGUOUS = 1.5
"""A plane has two poses that explain it nearly alike where their residuals are within this factor."""
LARGEST_RMS_PX = 1.5
WEAK = 0.005
"""A camera's place should be known to this part of its distance from the middle of the rig."""

Transform = tuple[Array, Array]
"""Rotation and shift: ``new = rotation @ old + shift``."""


def calibrate_board(
    sources: Mapping[str, str | Path],
    board: Board,
    *,
    intrinsics: Rig | None = None,
    progress: Progress | None = None,
) -> tuple[Rig, dict[str, Any]]:
    """Calibrate a rig from images of a board, image by image taken at the same time.

    ``sources`` by camera id: a video, an image, or a folder of images; the k-th images belong together.
    ``intrinsics``: a calibration whose lenses are kept; without one they come from the same images. The world is the
    board's in the first image that most cameras saw: origin in its first corner, X along its rows, Z out of it towards
    the cameras.

    The report has, by camera, ``views``, ``reprojection_px``, ``observations``, ``coverage``, ``position_sigma_mm``,
    ``angle_sigma_deg``; ``poses``, ``reprojection_px``, ``verdict`` (``ok``, or ``refused`` with ``reasons``).
    """
    if len(sources) < 2:
        raise InputError(f"a rig needs two cameras or more; {len(sources)} was given")
    looked = look_for_board(sources, board, progress=progress)
    cameras, reasons = _lenses(looked, board, intrinsics)
    warnings = _lengths(looked)
    if board.looks_the_same_turned:
        warnings.append(
            f"a checkerboard of {board.columns} x {board.rows} corners looks the same upside down: cameras that see it "
            "from opposite sides may disagree; use one with an odd and an even number"
        )
    views = {c.id: own.views for c, own in zip(cameras, looked, strict=True)}
    seen = {c.id: {n: _poses(c, board, v) for n, v in views[c.id].items()} for c in cameras}
    placed, unjoined = _first_rig(cameras, seen)
    for camera in unjoined:
        together = sum(1 for n in views[camera] if any(n in views[o] for o in views if o != camera))
        reasons.append(
            f"camera {camera} sees the board in {len(views[camera])} images, in {together} of them together with "
            f"another camera; these do not agree, or are fewer than {FEWEST_VIEWS}: show it the board with others"
        )
    if len(placed) < 2:
        report = {"frames": 0, "warnings": warnings, "cameras": {}, "verdict": "refused", "reasons": reasons}
        return Rig(tuple(cameras), "calibrated from a board"), report
    rig, report = _adjusted(placed, board, views, seen)
    reasons += _reasons(report)
    report |= {
        "frames": max(own.images for own in looked),
        "warnings": [*warnings, *report["warnings"]],
        "unjoined": unjoined,
        "verdict": "refused" if reasons else "ok",
        "reasons": reasons,
    }
    return rig, report


def _lenses(looked: list[BoardViews], board: Board, intrinsics: Rig | None) -> tuple[list[Camera], list[str]]:
    cameras, reasons = [], []
    for own in looked:
        if intrinsics is not None:
            known = intrinsics.find(own.camera)
            if known is None:
                raise InputError(f"the calibration lacks camera {own.camera} ({intrinsics.source})")
            if tuple(int(s) for s in known.size_px) != own.size_px:
                raise InputError(
                    f"camera {own.camera}: its images have {own.size_px[0]}x{own.size_px[1]} pixels, its calibration "
                    f"is for {known.size_px[0]:.0f}x{known.size_px[1]:.0f} ({intrinsics.source})"
                )
            cameras.append(replace(known, id=own.camera, rotation=np.eye(3), position_m=np.zeros(3)))
            continue
        if len(own.views) < 2 * FEWEST_VIEWS:
            raise InputError(
                f"camera {own.camera}: {len(own.views)} of {own.images} images show the board, too few to tell its "
                "lens: calibrate the lenses first (calibrate intrinsics), and state them with --intrinsics"
            )
        camera, row = solve_intrinsics(own, board)
        unsure = max(s / f for s, f in zip(row["focal_px_sigma"], row["focal_px"], strict=True))
        if not unsure < WEAK * 4:
            reasons.append(
                f"camera {own.camera}: these images tell its focal length to ± {unsure:.1%} only: calibrate the lenses "
                "first (calibrate intrinsics), and state them with --intrinsics"
            )
        cameras.append(camera)
    return cameras, reasons


def _lengths(looked: list[BoardViews]) -> list[str]:
    if len({own.images for own in looked}) < 2:
        return []
    lengths = ", ".join(f"{own.camera} {own.images}" for own in looked)
    return [f"the cameras have different numbers of images ({lengths}): the k-th ones are taken to belong together"]


def _poses(camera: Camera, board: Board, corners: Corners) -> list[tuple[float, Transform]]:
    """The board's poses in camera axes that explain its corners, with their residual (px): one, or two alike."""
    cv2 = opencv()
    rig = Rig((replace(camera, rotation=np.eye(3), position_m=np.zeros(3)),))
    ideal = rig.normalise(0, corners.pixel)
    good = np.isfinite(ideal).all(axis=1)
    places = board.places_m[corners.corner[good]]
    count, turns, shifts, _ = cv2.solvePnPGeneric(places, ideal[good], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    found = []
    for k in range(count):
        turn, shift = cv2.solvePnPRefineLM(places, ideal[good], np.eye(3), None, turns[k], shifts[k])
        rotation = cv2.Rodrigues(turn)[0]
        at = places @ rotation.T + shift.ravel()
        off = at[:, :2] / at[:, 2:] - ideal[good]
        found.append((camera.focal_px[0] * float(np.sqrt(np.mean(off**2))), (rotation, shift.ravel())))
    found.sort(key=lambda f: f[0])
    return [f for f in found if f[0] < AMBIGUOUS * found[0][0] + 0.05]


def _after(first: Transform, second: Transform) -> Transform:
    """The first transform, then the second."""
    return second[0] @ first[0], second[0] @ first[1] + second[1]


def _inverse(of: Transform) -> Transform:
    return of[0].T, -of[0].T @ of[1]


def _differ(a: Transform, b: Transform) -> float:
    """How far two transforms are apart: below 1 is the same."""
    turn = np.degrees(np.arccos(np.clip((np.trace(a[0] @ b[0].T) - 1.0) / 2.0, -1.0, 1.0)))
    reach = ALIKE_M * max(float(np.linalg.norm(a[1])), float(np.linalg.norm(b[1])), 0.1)
    return max(turn / ALIKE_DEG, float(np.linalg.norm(a[1] - b[1])) / reach)


def _first_rig(
    cameras: list[Camera], seen: dict[str, dict[int, list[tuple[float, Transform]]]]
) -> tuple[list[Camera], list[str]]:
    """Cameras placed against the first by poses on which several images agree; and those that cannot be."""
    ids = [c.id for c in cameras]
    links: dict[tuple[str, str], tuple[int, Transform]] = {}
    for i, a in enumerate(ids):
        for b in ids[i + 1 :]:
            link = _link(seen[a], seen[b])
            if link is not None:
                links[a, b] = link
                links[b, a] = link[0], _inverse(link[1])
    if not links:
        return [], ids
    start = max(ids, key=lambda c: sum(n for (a, _), (n, _) in links.items() if a == c))
    pose: dict[str, Transform] = {start: (np.eye(3), np.zeros(3))}
    while True:
        ready = [(n, a, b, t) for (a, b), (n, t) in links.items() if a in pose and b not in pose]
        if not ready:
            break
        _, a, b, transform = max(ready, key=lambda r: (r[0], r[1], r[2]))
        pose[b] = _after(pose[a], transform)
    placed = [
        replace(c, rotation=pose[c.id][0], position_m=-pose[c.id][0].T @ pose[c.id][1]) for c in cameras if c.id in pose
    ]
    return placed, [i for i in ids if i not in pose]


def _link(
    a: dict[int, list[tuple[float, Transform]]], b: dict[int, list[tuple[float, Transform]]]
) -> tuple[int, Transform] | None:
    """The transform between two cameras' axes on which most images agree. A mirrored pose agrees with none."""
    proposed = [(n, _after(_inverse(p), q)) for n in sorted(set(a) & set(b)) for _, p in a[n] for _, q in b[n]]
    best: tuple[int, Transform] | None = None
    for _, transform in proposed:
        agreeing = {n for n, other in proposed if _differ(transform, other) < 1.0}
        if best is None or len(agreeing) > best[0]:
            best = len(agreeing), transform
    return best if best is not None and best[0] >= FEWEST_VIEWS else None


def _adjusted(
    placed: list[Camera],
    board: Board,
    views: dict[str, dict[int, Corners]],
    seen: dict[str, dict[int, list[tuple[float, Transform]]]],
) -> tuple[Rig, dict[str, Any]]:
    by_image: dict[int, list[int]] = defaultdict(list)
    for index, camera in enumerate(placed):
        for number in views[camera.id]:
            by_image[number].append(index)
    images = sorted(n for n, own in by_image.items() if len(own) >= 2)
    poses, rows, pixels = [], [], []
    for pose, number in enumerate(images):
        poses.append(_board_pose(placed, by_image[number], number, seen))
        for index in by_image[number]:
            own = views[placed[index].id][number]
            rows += [[pose, index, int(corner)] for corner in own.corner]
            pixels.append(own.pixel)
    start = Rig(tuple(placed), "from a board")
    flat = [(r.tolist(), t.tolist()) for r, t in poses]
    solved = _core.adjust_board(start.core, board.places_m.tolist(), flat, rows, np.concatenate(pixels).tolist())
    adjusted = [
        replace(c, rotation=np.array(d["rotation"]), position_m=np.array(d["position_m"]))
        for c, d in zip(placed, solved["cameras"], strict=True)
    ]
    first = max(images, key=lambda n: (len(by_image[n]), -n))
    rotation, shift = _board_pose(adjusted, by_image[first], first, seen)
    axes = np.column_stack([rotation[:, 0], -rotation[:, 1], -rotation[:, 2]])
    rig = Rig.of(moved(adjusted, axes.T, shift), source="calibrated from a board")
    return rig, _report(rig, placed, solved, np.array(rows), np.concatenate(pixels), len(images))


def _board_pose(
    placed: list[Camera], cameras: list[int], number: int, seen: dict[str, dict[int, list[tuple[float, Transform]]]]
) -> Transform:
    """The board's pose in the rig's axes: of all that single cameras propose, the one nearest to the others."""
    proposed = []
    for index in cameras:
        camera = placed[index]
        from_camera = _inverse((camera.rotation, camera.translation_m))
        proposed += [_after(pose, from_camera) for _, pose in seen[camera.id][number]]
    return min(proposed, key=lambda p: np.median([_differ(p, q) for q in proposed]))


def _report(
    rig: Rig, placed: list[Camera], solved: dict[str, Any], rows: NDArray[np.int64], pixels: Array, poses: int
) -> dict[str, Any]:
    order, used = solved["row"], solved["used"]
    rows, pixels = rows[order], pixels[order]
    length = np.linalg.norm(solved["residual_px"], axis=1)
    middle = np.mean([c.position_m for c in rig.cameras], axis=0)
    factor = np.sqrt(solved["redundancy_factor"])
    cameras = {}
    for index, camera in enumerate(placed):
        own = (rows[:, 1] == index) & used
        size = np.array(camera.size_px)
        cells = np.unique(np.clip((pixels[own] / size * GRID).astype(int), 0, GRID - 1), axis=0)
        row: dict[str, Any] = {
            "reprojection_px": {
                "median": float(np.median(length[own])) if own.any() else float("nan"),
                "rms": float(factor * np.sqrt(np.mean(length[own] ** 2))) if own.any() else float("nan"),
            },
            "observations": int(own.sum()),
            "observations_left_out": int(((rows[:, 1] == index) & ~used).sum()),
            "views": len(np.unique(rows[own, 0])),
            "coverage": len(cells) / GRID**2,
        }
        at = next(c for c in rig.cameras if c.id == camera.id).position_m
        row["distance_mm"] = float(1000.0 * np.linalg.norm(at - middle))
        if "covariance" in solved:
            block = solved["covariance"][index * PARAMETERS :, index * PARAMETERS :]
            row["position_sigma_mm"] = float(1000.0 * np.sqrt(max(np.trace(block[3:6, 3:6]), 0.0)))
            row["angle_sigma_deg"] = float(np.degrees(np.sqrt(max(np.trace(block[:3, :3]), 0.0))))
        cameras[camera.id] = row
    rms = [own["reprojection_px"]["rms"] for own in cameras.values()]
    return {
        "cameras": cameras,
        "poses": poses,
        "observations": int(used.sum()),
        "reprojection_px": float(np.sqrt(np.mean(np.square(rms)))),
        "warnings": [],
    }


def _reasons(report: dict[str, Any]) -> list[str]:
    reasons = []
    for camera, own in report["cameras"].items():
        rms = own["reprojection_px"]["rms"]
        if not rms < LARGEST_RMS_PX:
            reasons.append(
                f"camera {camera}: corners lie {rms:.2f} px (rms) from where they should: do its images belong to the "
                "same moments as the others', and is the lens right?"
            )
        if not own.get("position_sigma_mm", np.inf) < max(WEAK * own["distance_mm"], 1.0):
            reasons.append(
                f"camera {camera}: its place is known to ± {own.get('position_sigma_mm', np.inf):.1f} mm only: show it "
                "the board together with others at more places"
            )
    return reasons
