"""Vicon's grey blobs: dots that the camera could not fit, half hidden or run together, fitted after all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from markerloom import _core
from markerloom.detect.markers import detect_markers
from markerloom.errors import BytesError, FormatError
from markerloom.formats import x2d
from markerloom.formats.files import read_bytes
from markerloom.observations import Observations

BLUR_PX = 0.75
"""Blur of a camera's edges, from one make of camera: 0.6 to 0.9 px place its blobs almost alike."""
THRESHOLD_AT = 0.67
"""A camera's radius reaches to where values pass its threshold, a quarter of white: so many blurs outside the edge."""
USUAL_RADIUS_PX = 2.5
SEVERAL, MARGIN_PX = 1.3, 6
"""A blob of so many whole dots' area is several dots; pixels around it that are known to be dark."""
HALF_HIDDEN = 0.5
"""Quality of a dot that was fitted from what was left of it."""


@dataclass(frozen=True)
class GreyBlob:
    """Bright pixels (column, row, value) of one dot."""

    frame: int
    camera: str
    pixels: tuple[tuple[int, int, int], ...]


def read_grey_blobs(path: str | Path) -> list[GreyBlob]:
    """The grey blobs of a Vicon .x2d."""
    try:
        content = _core.read_x2d(read_bytes(path))
    except BytesError as error:
        raise FormatError(path, str(error)) from None
    return [GreyBlob(frame, str(camera), tuple(pixels)) for frame, camera, pixels in content["patches"]]


def fit_grey_blobs(
    blobs: Sequence[GreyBlob], radius_px: Mapping[str, float], *, threshold: float | None = None
) -> Observations:
    """Centres of grey blobs, each as a disk of which something may hide a part.

    ``radius_px``: what each camera calls the radius of its usual dots. Blobs larger than a whole dot are several that
    have run together; those of fewer than three pixels are left out. ``threshold``: pixels that are not given are
    darker; by default the darkest that a camera gives. The observations have ``sigma`` (px), ``quality``, ``radius``.
    """
    ids = tuple(dict.fromkeys(b.camera for b in blobs))
    rows: list[tuple[float, ...]] = []
    for index, camera in enumerate(ids):
        own = [b for b in blobs if b.camera == camera]
        dark = threshold or float(min(value for b in own for _, _, value in b.pixels))
        radius = max(radius_px.get(camera, USUAL_RADIUS_PX) - THRESHOLD_AT * BLUR_PX, 2.0 * BLUR_PX)
        largest = SEVERAL * np.pi * (radius + THRESHOLD_AT * BLUR_PX) ** 2
        single = [b for b in own if len(b.pixels) <= largest]
        fitted = _core.fit_patches([list(b.pixels) for b in single], dark, radius, BLUR_PX)
        rows += [(b.frame, index, *f[:3], radius) for b, f in zip(single, fitted, strict=True) if np.isfinite(f[0])]
        for blob in (b for b in own if len(b.pixels) > largest):
            rows += [(blob.frame, index, *row, radius) for row in _several(blob, dark, radius)]
    table = np.array(rows, float).reshape(-1, 6)
    table = table[np.argsort(table[:, 0], kind="stable")]
    return Observations(
        frame=table[:, 0].astype(np.int64),
        camera=table[:, 1].astype(np.int64),
        camera_ids=ids,
        pixel=table[:, 2:4].copy(),
        optional={"radius": table[:, 5], "sigma": table[:, 4], "quality": np.full(len(table), HALF_HIDDEN)},
        source="grey blobs",
    )


def _several(blob: GreyBlob, threshold: float, radius_px: float) -> list[tuple[float, float, float]]:
    """Centres and sigma of the dots in a blob that is too large for one."""
    column, row, value = np.array(blob.pixels).T
    left, top = column.min() - MARGIN_PX, row.min() - MARGIN_PX
    image = np.zeros((int(row.max() - top) + MARGIN_PX + 1, int(column.max() - left) + MARGIN_PX + 1), np.uint8)
    image[row - top, column - left] = value
    found = detect_markers(image, threshold=threshold - 1.0, radius_px=radius_px, blur_px=BLUR_PX)
    return [(x + left, y + top, s) for (x, y), s in zip(found.pixel, found.sigma_px, strict=True)]


def detect_x2d(path: str | Path) -> tuple[Observations, dict[str, Any]]:
    """The centroids of a Vicon .x2d, and its grey blobs fitted: more rays for markers that are half hidden."""
    seen, blobs = x2d.read(path), read_grey_blobs(path)
    radii = {c: float(np.median(seen.optional["radius"][seen.camera == i])) for i, c in enumerate(seen.camera_ids)}
    fitted = fit_grey_blobs(blobs, radii)
    ids = list(dict.fromkeys((*seen.camera_ids, *fitted.camera_ids)))
    place = np.array([ids.index(c) for c in fitted.camera_ids], np.int64)
    sigma = float(np.median(fitted.optional["sigma"])) if len(fitted) else 1.0
    # The camera's own centroids are whole dots: as sure as the surest of the others.
    own = np.full(len(seen), min(sigma, float(np.min(fitted.optional["sigma"], initial=sigma))))
    columns = {"radius": seen.optional["radius"], "sigma": own, "quality": seen.optional["quality"]}
    frame = np.concatenate([seen.frame, fitted.frame])
    order = np.argsort(frame, kind="stable")
    found = replace(
        seen,
        frame=frame[order],
        camera=np.concatenate([seen.camera, place[fitted.camera] if len(fitted) else seen.camera[:0]])[order],
        camera_ids=tuple(ids),
        pixel=np.concatenate([seen.pixel, fitted.pixel])[order],
        optional={n: np.concatenate([columns[n], fitted.optional[n]])[order] for n in columns},
        warnings=(),
    )
    report = {
        "frames": len(seen.frames),
        "dots": len(found),
        "grey_blobs": len(blobs),
        "grey_blobs_fitted": len(fitted),
        "cameras": {},
        "warnings": [],
    }
    return found, report
