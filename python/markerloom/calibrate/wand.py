"""A rig from the raw dots of a wand wave."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom import _core
from markerloom.calibrate.verdict import refusals
from markerloom.calibrate.wands import Wand
from markerloom.calibrate.world import moved, natural_world, old_world
from markerloom.errors import InputError
from markerloom.observations import DotArrays, Observations
from markerloom.reconstruct import statistics
from markerloom.rig import Camera, Lens, Rig

Array = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]

LEFT_OUT_EVERY = 10
"""One pose in this many is left out of the fit by which lengths and residuals are judged."""
MOST_POSES = 6000
PARAMETERS = 15
"""Adjusted parameters of a camera."""
FEWEST_SPEEDS = 40
"""Fewer dots that are seen in the next frame too do not tell how residuals grow with speed."""
GRID = 12
"""Cells along each side of an image in which coverage is counted."""


@dataclass(frozen=True)
class Calibration:
    """A calibrated rig and what it is worth: ``report["verdict"]`` is ``ok``, or ``refused`` with ``reasons``.

    ``dots_px``: for each camera id the pixels (n, 2) of the wand's dots in use; ``residuals_px``: their residuals
    (n, 2). ``covariance``: of all camera parameters (15 each, in the order of ``rig``: rotation in camera axes (rad),
    position (m), focal length, centre of the image (px), c1, c2, p1, p2, c3, aspect), the rig laid onto its own camera
    centres; ``None`` where it is not determined.
    """

    rig: Rig
    report: dict[str, Any]
    dots_px: dict[str, Array]
    residuals_px: dict[str, Array]
    covariance: Array | None

    def quality(self) -> dict[str, Any]:
        """What goes into a calibration file: the report's main figures, and for each camera the covariance of its pose.

        ``pose_covariance``: rotation in camera axes (rad), then position (m); 6 x 6, row by row.
        """
        report, cameras = self.report, {}
        for i, camera in enumerate(self.rig.ids):
            own = report["cameras"][camera]
            row = {"reprojection_px": own["reprojection_px"]["rms"], "views": own["views"]}
            keys = ("position_sigma_mm", "angle_sigma_deg", "focal_sigma_px")
            row |= {key: own[key] for key in keys if key in own}
            if self.covariance is not None:
                at = PARAMETERS * i
                row["pose_covariance"] = self.covariance[at : at + 6, at : at + 6].ravel().tolist()
            cameras[camera] = row
        main = ("verdict", "wand", "poses", "reprojection_px", "scale_error")
        lengths = {"wand_length_std_mm": report["wand_length_mm"]["std"]}
        return {key: report[key] for key in main} | lengths | {"cameras": cameras}


def calibrate_wand(
    observations: Observations,
    wand: Wand,
    *,
    image_sizes: dict[str, tuple[float, float]] | None = None,
    intrinsics: Rig | None = None,
    start: Rig | None = None,
    cameras: list[str] | None = None,
    camera_distance_m: tuple[str, str, float] | None = None,
) -> Calibration:
    """Calibrate every camera from unlabelled dots of a waved wand; nothing of the cameras needs to be known.

    ``image_sizes``: width and height (px) by camera id; without them and without ``intrinsics`` they are taken from
    where dots were seen. ``intrinsics``: a rig whose focal lengths and lenses are kept. ``start``: an old calibration
    to start from, whose world is kept. ``cameras``: only these. ``camera_distance_m``: two cameras and the distance of
    their centres, which sets the scale where the wand is a single marker; its lenses then have their centres in the
    middle of the image unless ``intrinsics`` say where. Without ``start``, the world has +Z up as the cameras stand. A
    result that is not right comes back with the verdict ``refused`` and its reasons.

    Raises ``InputError`` where there is nothing to calibrate from: fewer than two cameras, no wand in any two of them.
    """
    if cameras is not None:
        unknown = [c for c in cameras if c not in observations.camera_ids]
        if unknown:
            raise InputError(f"camera {unknown[0]} has no observations ({observations.source})")
        observations = observations.of_cameras(cameras)
    ids, dots, notes = _usable(observations)
    if len(wand.places_m) == 1 and camera_distance_m is None:
        raise InputError("a single marker has no length: state the distance of two cameras (--camera-distance A,B=MM)")
    known = intrinsics if intrinsics is not None else start
    sizes, size_notes = _sizes(ids, dots, image_sizes, known)
    first = [_start(camera, sizes[camera], known) for camera in ids]
    solved = _core.calibrate_wand(
        [c._described() for c in first],
        "intrinsics" if intrinsics is not None else "nothing" if start is None else "rig",
        wand.places_m.tolist(),
        dots,
        LEFT_OUT_EVERY,
        MOST_POSES,
    )
    if len(wand.places_m) == 1 and camera_distance_m is not None:
        _rescale(solved, ids, *camera_distance_m)
    return _as_calibration(solved, first, dots, wand, [*notes, *size_notes], observations, start)


def _rescale(solved: dict[str, Any], ids: list[str], a: str, b: str, distance_m: float) -> None:
    """Give the solved rig the scale at which two cameras are so far apart."""
    joined = [c for i, c in enumerate(ids) if i not in solved["missing"]]
    for camera in (a, b):
        if camera not in joined:
            raise InputError(f"the distance to camera {camera} is stated, but it is not among {', '.join(joined)}")
    place = [np.array(c["position_m"]) for c in solved["cameras"]]
    scale = distance_m / float(np.linalg.norm(place[ids.index(a)] - place[ids.index(b)]))
    for camera, at in zip(solved["cameras"], place, strict=True):
        camera["position_m"] = scale * at
    solved["pose_position_m"] = scale * solved["pose_position_m"]
    if "covariance" in solved:
        factor = np.ones(len(solved["covariance"])).reshape(-1, PARAMETERS)
        factor[:, 3:6] = scale
        solved["covariance"] = solved["covariance"] * np.outer(factor, factor)


def _usable(observations: Observations) -> tuple[list[str], DotArrays, list[str]]:
    """Cameras that saw anything, their dots by frame, and what was left out."""
    good = np.asarray(np.isfinite(observations.pixel).all(axis=1))
    notes = [] if good.all() else [f"{int((~good).sum())} observations with NaN or infinite pixels are ignored"]
    kept = observations._keep(good)
    seen = np.unique(kept.camera)
    if len(seen) < 2:
        raise InputError(f"a rig needs two cameras or more; {len(seen)} saw anything ({observations.source})")
    silent = [c for i, c in enumerate(observations.camera_ids) if i not in set(seen.tolist())]
    if silent and len(kept) == len(observations):
        notes.append(f"cameras without any observation are left out: {', '.join(silent)}")
    order = np.argsort(kept.frame, kind="stable")
    frame = kept.frame[order]
    starts = np.searchsorted(frame, np.append(kept.frames, kept.frames[-1] + 1))
    camera = np.searchsorted(seen, kept.camera[order])
    ids = [observations.camera_ids[i] for i in seen]
    return ids, DotArrays(starts, camera, kept.pixel[order], np.ones(len(frame))), notes


def _sizes(
    ids: list[str], dots: DotArrays, given: dict[str, tuple[float, float]] | None, intrinsics: Rig | None
) -> tuple[dict[str, tuple[float, float]], list[str]]:
    known = dict(given or {})
    if intrinsics is not None:
        known |= {i: found.size_px for i in ids if (found := intrinsics.find(i)) is not None}
    sizes, guessed = {}, []
    for i, camera in enumerate(ids):
        own = dots.pixel[dots.camera == i]
        far = own.max(axis=0)
        if camera not in known:
            low = np.minimum(own.min(axis=0), 0.0)
            sizes[camera] = (float(np.ceil(far[0] - low[0])) + 1.0, float(np.ceil(far[1] - low[1])) + 1.0)
            guessed.append(f"{camera} {sizes[camera][0]:.0f}x{sizes[camera][1]:.0f}")
            continue
        sizes[camera] = known[camera]
        if np.any(far > np.array(known[camera]) * 1.05) or np.any(own.min(axis=0) < -0.05 * np.array(known[camera])):
            raise InputError(
                f"camera {camera}: dots reach pixel {far[0]:.0f}, {far[1]:.0f}, but its image is stated as "
                f"{known[camera][0]:.0f}x{known[camera][1]:.0f}: state its true size"
            )
    note = "image sizes are taken from where dots were seen; state them with --image-size: "
    return sizes, [note + ", ".join(guessed)] if guessed else []


def _start(camera: str, size: tuple[float, float], known: Rig | None) -> Camera:
    if known is not None:
        found = known.find(camera)
        if found is None:
            raise InputError(f"the calibration lacks camera {camera}; leave it out with --cameras ({known.source})")
        return replace(found, id=camera)
    principal = ((size[0] - 1.0) / 2.0, (size[1] - 1.0) / 2.0)
    return Camera(camera, size, (size[0], size[0]), principal, np.eye(3), np.zeros(3))


def _as_calibration(
    solved: dict[str, Any],
    start: list[Camera],
    dots: DotArrays,
    wand: Wand,
    notes: list[str],
    observations: Observations,
    old: Rig | None,
) -> Calibration:
    adjusted = [_camera(s, d) for s, d in zip(start, solved["cameras"], strict=True)]
    joined = [i for i in range(len(start)) if i not in solved["missing"]]
    wave_m = solved["pose_position_m"]
    kept = [adjusted[i] for i in joined]
    rotation, origin = natural_world(kept, wave_m) if old is None else old_world(kept, old)
    rig = Rig(tuple(moved([adjusted[i] for i in joined], rotation, origin)), f"calibrated from {observations.source}")
    used = solved["used"]
    ids = [c.id for c in start]
    pixels = dots.pixel[solved["dot"]]
    of = {ids[i]: used & (solved["camera"] == i) for i in joined}
    reached: dict[str, Array] = {i: pixels[rows] for i, rows in of.items()}
    report = _report(solved, rig, dots, wand, ids, notes)
    reasons = refusals(rig, report, solved, reached)
    report["verdict"] = "refused" if reasons else "ok"
    report["reasons"] = reasons
    return Calibration(
        rig=rig,
        report=report,
        dots_px=reached,
        residuals_px={i: solved["residual_px"][rows] for i, rows in of.items()},
        covariance=_in_world(solved, joined, rotation),
    )


def _in_world(solved: dict[str, Any], joined: list[int], rotation: Array) -> Array | None:
    """The covariance of the joined cameras' parameters with positions in the world's axes."""
    if "covariance" not in solved:
        return None
    rows = np.concatenate([np.arange(PARAMETERS) + PARAMETERS * i for i in joined])
    turn = np.eye(len(rows))
    for k in range(len(joined)):
        at = PARAMETERS * k + 3
        turn[at : at + 3, at : at + 3] = rotation
    return turn @ solved["covariance"][np.ix_(rows, rows)] @ turn.T


def _camera(start: Camera, described: dict[str, Any]) -> Camera:
    coefficients = described.get("coefficients")
    lens = Lens("brown_conrady", tuple(coefficients)) if coefficients is not None else start.lens
    return Camera(
        id=start.id,
        name=start.name,
        size_px=start.size_px,
        focal_px=tuple(described["focal_px"]),
        principal_px=tuple(described["principal_px"]),
        rotation=np.array(described["rotation"]),
        position_m=np.array(described["position_m"]),
        lens=lens,
        mask=start.mask,
    )


def _report(
    solved: dict[str, Any], rig: Rig, dots: DotArrays, wand: Wand, ids: list[str], notes: list[str]
) -> dict[str, Any]:
    used = solved["used"]
    squared = np.nan_to_num(solved["residual_px"][used] ** 2)
    free = int(np.sum(solved["parameters_free"])) + solved["pose_freedom"] * len(solved["pose_frame"]) - 6
    redundancy = max(2 * int(used.sum()) - free, 1)
    per_camera = {}
    for i, camera in enumerate(ids):
        if camera in rig.ids:
            per_camera[camera] = _of_camera(solved, rig, dots, i, camera, redundancy)
    left_out = solved["left_out_px"][:, 1]
    return {
        "frames": len(dots.starts) - 1,
        "warnings": notes,
        "wand": wand.name,
        "markers": len(wand.places_m),
        "poses": len(solved["pose_frame"]),
        "observations": int(used.sum()),
        "observations_used": float(used.mean()) if len(used) else 0.0,
        "reprojection_px": float(np.sqrt(squared.sum() / redundancy)),
        "residual_px": statistics(np.sqrt(squared.sum(axis=1))),
        "left_out_residual_px": statistics(left_out[np.isfinite(left_out)]),
        "wand_length_mm": _lengths(solved["left_out_lengths_m"], wand),
        "scale_error": _scale_error(solved["left_out_lengths_m"]),
        "cameras": per_camera,
        "speed": _speed(solved, dots.pixel[solved["dot"]]),
        "unjoined": [ids[i] for i in solved["missing"]],
        "whole_views": dict(zip(ids, solved["whole_views"], strict=True)),
        "still_dots": dict(zip(ids, solved["still_dots"], strict=True)),
    }


def _speed(solved: dict[str, Any], pixels: Array) -> dict[str, float]:
    """How fast dots move (px per frame, median), and the residuals of the faster half along and across the motion (px).

    Dots of a fast wand are smeared, and cameras that do not expose at the same time see them elsewhere: both along the
    motion only. Dots that lie too far off to be used count too.
    """
    frame = solved["pose_frame"][solved["pose"]]
    order = np.lexsort([frame, solved["marker"], solved["camera"]])
    same = (np.diff(solved["camera"][order]) == 0) & (np.diff(solved["marker"][order]) == 0)
    same &= np.diff(frame[order]) == 1
    motion = np.diff(pixels[order], axis=0)[same]
    off = solved["residual_px"][order][:-1][same]
    speed = np.linalg.norm(motion, axis=1)
    good = np.isfinite(off).all(axis=1) & (speed > 0)
    if good.sum() < FEWEST_SPEEDS:
        return {"px_per_frame": float("nan"), "along_px": float("nan"), "across_px": float("nan")}
    motion, off, speed = motion[good], off[good], speed[good]
    fast = speed >= np.median(speed)
    ahead = (motion / speed[:, None])[fast]
    along = np.abs(np.sum(off[fast] * ahead, axis=1))
    across = np.abs(off[fast, 0] * ahead[:, 1] - off[fast, 1] * ahead[:, 0])
    sides = [1.4826 * float(np.median(side)) for side in (along, across)]
    return {"px_per_frame": float(np.median(speed)), "along_px": sides[0], "across_px": sides[1]}


def _of_camera(
    solved: dict[str, Any], rig: Rig, dots: DotArrays, index: int, camera: str, redundancy: int
) -> dict[str, Any]:
    own = solved["camera"] == index
    rows = own & solved["used"]
    length = np.linalg.norm(solved["residual_px"][rows], axis=1)
    pixels = dots.pixel[solved["dot"][rows]]
    size = np.array(rig.cameras[rig.ids.index(camera)].size_px)
    cells = np.unique(np.clip((pixels / size * GRID).astype(int), 0, GRID - 1), axis=0)
    share = redundancy / max(2 * int(solved["used"].sum()), 1)
    result = {
        "reprojection_px": {
            "median": float(np.median(length)) if len(length) else float("nan"),
            "rms": float(np.sqrt((length**2).sum() / max(2 * len(length) * share, 1e-9))),
        },
        "observations": int(rows.sum()),
        "views": len(np.unique(solved["pose"][rows])),
        "used": min(float(len(np.unique(solved["pose"][rows])) / max(solved["whole_views_placed"][index], 1)), 1.0),
        "coverage": len(cells) / GRID**2,
    }
    if "covariance" in solved:
        at = slice(index * PARAMETERS, (index + 1) * PARAMETERS)
        block = solved["covariance"][at, at]
        result["position_sigma_mm"] = float(1000.0 * np.sqrt(max(np.trace(block[3:6, 3:6]), 0.0)))
        result["angle_sigma_deg"] = float(np.degrees(np.sqrt(max(np.trace(block[:3, :3]), 0.0))))
        result["focal_sigma_px"] = float(np.sqrt(max(block[6, 6], 0.0)))
    return result


def _scale_error(lengths_m: Array) -> float:
    """How much longer the wand measures on poses left out than it is (relative); NaN without lengths."""
    return float(lengths_m[:, 0].sum() / lengths_m[:, 1].sum() - 1.0) if len(lengths_m) else float("nan")


def _lengths(lengths_m: Array, wand: Wand) -> dict[str, Any]:
    """Errors of the distances between markers on poses left out of the fit; the longest one's mean and spread."""
    if len(lengths_m) == 0:
        return {"count": 0, "mean": float("nan"), "std": float("nan"), "relative_spread": 0.0, "worst_ratio": 0.0}
    measured, true = 1000.0 * lengths_m.T
    longest = true > true.max() - 1e-6
    error = measured - true
    spread = 1.4826 * np.median(np.abs(error - np.median(error)))
    stated = np.sort([1000.0 * np.linalg.norm(a - b) for k, a in enumerate(wand.places_m) for b in wand.places_m[:k]])
    found = np.sort([np.median(measured[true == t]) for t in np.unique(true)])
    worst = float(np.max(np.abs(found / stated - 1.0))) if len(found) == len(stated) else 0.0
    return {
        "count": len(error),
        "mean": float(measured[longest].mean()),
        "std": float(error.std()),
        "spread": float(spread),
        "longest_stated": float(stated[-1]),
        "relative_spread": float(spread / true.mean()),
        "worst_ratio": worst,
    }
