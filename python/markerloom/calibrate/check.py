"""Whether a rig still fits a take: what is systematic in each camera's residuals, beside the noise of its dots."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import InputError, MarkerloomError
from markerloom.moments import refuse_several_clocks
from markerloom.observations import Observations, match
from markerloom.reconstruct import Reconstruction, reconstruct
from markerloom.rig import Camera, Rig
from markerloom.triangulate import triangulate

Array = NDArray[np.floating[Any]]

LOOKED_AT = 60
"""Pairs of frames looked at, evenly spread."""
STEP_M = 0.03
"""A marker is the same in the next frame if it moved by less."""
FEWEST = 30
"""Fewer residuals say nothing about a camera."""
STRANGE = 0.5
"""A camera stands elsewhere when its dots are used so much less than those of the others."""
OUTLYING = 6.0
"""Residuals so many times the median one belong to wrong dots."""
LARGEST_SHARE = 0.5
"""A camera should be calibrated again when its systematic error is this part of all other errors of its dots."""


@dataclass(frozen=True)
class Seen:
    """A dot, and how far (px) it lies from the projection of its marker's place by the other cameras."""

    pixel: Array
    off: Array


def check_rig(rig: Rig, observations: Observations) -> dict[str, Any]:
    """Compare a rig with any take of it.

    Every dot is compared with its marker placed by the other cameras alone. The report has, by camera, ``bias_px``
    (mean, x, y) with ``bias_sigma_px``; ``systematic_px``: rms of what a shift, turn or scale of the image explains;
    ``rest_px``: rms of what is left; ``noise_px``: of the dots alone, from frames that follow each other (half-hidden
    markers are in the rest, but not in it); ``dots``; ``age_hours`` and ``warming_celsius`` where the calibration file
    tells; and ``verdict``: ``ok``, or ``recalibrate`` with ``reasons``.

    Raises ``InputError`` where the take shows too few markers in three cameras or more.
    """
    refuse_several_clocks(observations)
    frames = observations.frames
    step = max(2, len(frames) // LOOKED_AT)
    first = frames[:-1:step]
    rows = np.isin(observations.frame, np.concatenate([first, first + 1]))
    observations = observations._keep(rows)
    points = reconstruct(observations, rig)
    residuals = _without_own_ray(rig, points, _pixels(observations, rig))
    cameras = {c.id: _of_camera(points, residuals[c.id], c) for c in rig.cameras if len(residuals[c.id]) >= FEWEST}
    strangers = _strangers(rig, points, observations)
    if not cameras and not strangers:
        raise InputError(
            f"the take shows too few markers in three cameras or more to check a rig by ({observations.source})"
        )
    reasons = [
        f"camera {c}: its dots fit the markers of the other cameras in {share:.0%} only: it stands elsewhere; refine "
        "the rig from the take in which it was moved, or calibrate it again"
        for c, share in strangers.items()
    ]
    reasons += [reason for name, own in cameras.items() if name not in strangers for reason in _reasons(name, own)]
    return {
        "frames": len(np.unique(points.frame)),
        "cameras": cameras,
        "warnings": [
            f"camera {c} shows too little to be checked" for c in rig.ids if c not in cameras and c not in strangers
        ],
        "verdict": "recalibrate" if reasons else "ok",
        "reasons": reasons,
    }


def _strangers(rig: Rig, points: Reconstruction, observations: Observations) -> dict[str, float]:
    """Cameras whose dots hardly ever belong to a marker that others see, and the share that does."""
    dots = match(observations, rig)
    seen = np.bincount(dots.camera, minlength=len(rig))
    used = np.bincount([rig.ids.index(c) for c in points.assignments["camera"].to_pylist()], minlength=len(rig))
    share = used / np.maximum(seen, 1)
    usual = float(np.median(share[seen >= FEWEST])) if (seen >= FEWEST).any() else 0.0
    few = (seen >= FEWEST) & (share < STRANGE * usual)
    return {c: float(share[i]) for i, c in enumerate(rig.ids) if few[i]}


def _pixels(observations: Observations, rig: Rig) -> dict[tuple[int, str, int], Array]:
    """Pixel by frame, camera of the rig, and number of the dot within them."""
    dots = match(observations, rig)
    frame = np.repeat(dots.frames, np.diff(dots.starts))
    keys = zip(frame.tolist(), dots.camera.tolist(), dots.observation.tolist(), strict=True)
    return {(f, rig.ids[c], o): pixel for (f, c, o), pixel in zip(keys, dots.pixel, strict=True)}


def _without_own_ray(
    rig: Rig, points: Reconstruction, pixels: dict[tuple[int, str, int], Array]
) -> dict[str, dict[tuple[int, int], Seen]]:
    """By camera, then (frame, point): the dot beside the projection of the place that the other cameras give."""
    rays: dict[tuple[int, int], dict[str, Array]] = defaultdict(dict)
    table = points.assignments.to_pydict()
    for frame, camera, dot, track in zip(*(table[k] for k in ("frame", "camera", "observation", "track")), strict=True):
        rays[frame, track][camera] = pixels[frame, camera, dot]
    found: dict[str, dict[tuple[int, int], Seen]] = {c: {} for c in rig.ids}
    for point, own in rays.items():
        for camera in own if len(own) >= 3 else ():
            others = {c: (p[0], p[1]) for c, p in own.items() if c != camera}
            try:
                place = triangulate(rig, others).point_m
            except MarkerloomError:
                continue
            expected = rig.project(rig.ids.index(camera), place[None])[0]
            found[camera][point] = Seen(own[camera], own[camera] - expected)
    return found


def _of_camera(points: Reconstruction, residuals: dict[tuple[int, int], Seen], camera: Camera) -> dict[str, Any]:
    frame = np.array([key[0] for key in residuals])
    pixel, off = (np.array([getattr(s, k) for s in residuals.values()]) for k in ("pixel", "off"))
    distance = np.linalg.norm(off - np.median(off, axis=0), axis=1)
    near = distance < OUTLYING * np.median(distance) + 1e-9
    frame, pixel, off = frame[near], pixel[near], off[near]
    means = np.array([off[frame == f].mean(axis=0) for f in np.unique(frame)])
    size = np.array(camera.size_px)
    pattern = np.column_stack([np.ones(len(pixel)), pixel / size - 0.5])
    explained = pattern @ np.linalg.lstsq(pattern, off, rcond=None)[0]
    noise = _differences(points, residuals)
    conditions = camera.conditions
    result: dict[str, Any] = {
        "dots": len(off),
        "bias_px": off.mean(axis=0).tolist(),
        "bias_sigma_px": float(np.sqrt(np.mean(means.var(axis=0)) / max(len(means) - 1, 1))),
        "systematic_px": _rms(explained),
        "rest_px": _rms(off - explained),
        "noise_px": float(1.4826 * np.median(np.abs(noise)) / np.sqrt(2)) if noise.size else float("nan"),
    }
    if conditions.calibrated is not None and conditions.captured is not None:
        result["age_hours"] = (conditions.captured - conditions.calibrated).total_seconds() / 3600.0
    if conditions.calibrated_celsius is not None and conditions.captured_celsius is not None:
        result["warming_celsius"] = conditions.captured_celsius - conditions.calibrated_celsius
    return result


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _differences(points: Reconstruction, residuals: dict[tuple[int, int], Seen]) -> Array:
    """Residuals of the same marker in two frames that follow each other, one minus the other."""
    place = {(f, t): p for f, t, p in zip(points.frame.tolist(), points.track.tolist(), points.xyz_mm, strict=True)}
    by_frame: dict[int, list[tuple[int, int]]] = defaultdict(list)
    for key in residuals:
        by_frame[key[0]].append(key)
    found = []
    for key, value in residuals.items():
        following = by_frame.get(key[0] + 1, [])
        if following:
            apart = [np.linalg.norm(place[other] - place[key]) for other in following]
            if min(apart) < 1000.0 * STEP_M:
                found.append(residuals[following[int(np.argmin(apart))]].off - value.off)
    return np.array(found)


def _reasons(camera: str, own: dict[str, Any]) -> list[str]:
    if own["systematic_px"] <= LARGEST_SHARE * own["rest_px"]:
        return []
    x, y = own["bias_px"]
    text = (
        f"camera {camera}: {own['systematic_px']:.2f} px systematic beside {own['rest_px']:.2f} px of other errors "
        f"(bias {x:+.2f}, {y:+.2f} ± {own['bias_sigma_px']:.2f} px)"
    )
    if "age_hours" in own:
        text += f"; calibrated {own['age_hours']:.1f} h before"
    if own.get("warming_celsius"):
        text += f", {own['warming_celsius']:+.0f} °C since"
    return [text + ": refine the rig from a take, or calibrate it again"]
