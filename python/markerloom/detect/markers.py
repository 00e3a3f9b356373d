"""Markers in one image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from markerloom import _core
from markerloom.errors import InputError

Array = NDArray[np.floating[Any]]
Flags = NDArray[np.bool_]

LEAST_PIXELS = 2
MOST_BLOBS = 10_000


TILE_PX = 32
"""Side of the tiles in which an image's own background is looked for: several markers wide."""
SAMPLES = 8
"""Pixels of a tile that are looked at, along each side."""


def local_background(image: NDArray[np.unsignedinteger[Any]]) -> NDArray[np.unsignedinteger[Any]]:
    """The background of an image that is lit unevenly: medians of tiles, interpolated between their middles.

    Markers must cover less than half of a tile.
    """
    lines, middles = [], []
    for length in image.shape:
        tiles = max(length // TILE_PX, 1)
        side = length / tiles
        lines.append(((np.arange(tiles)[:, None] + (np.arange(SAMPLES) + 0.5) / SAMPLES) * side).astype(int))
        middles.append(np.interp(np.arange(length), (np.arange(tiles) + 0.5) * side - 0.5, np.arange(tiles)))
    sampled = image[np.ix_(lines[0].ravel(), lines[1].ravel())]
    tiles = sampled.reshape(len(lines[0]), SAMPLES, len(lines[1]), SAMPLES)
    medians = np.median(tiles, axis=(1, 3))
    smooth = map_coordinates(medians, np.meshgrid(*middles, indexing="ij"), order=1, mode="nearest")
    return np.round(smooth).astype(image.dtype)


@dataclass(frozen=True)
class Blobs:
    """Markers' images of one image, from top to bottom; one row each.

    ``pixel`` (n, 2): centre, (0, 0) being the middle of the top-left pixel. ``sigma_px`` (n,): standard deviation of
    the centre per axis. ``radius_px``, ``area_px`` (bright pixels), ``peak`` (grey values above the background) (n,);
    ``ellipse`` (n, 3): half axes (px), the longer first, and its angle from x to y (rad). Flags (n,): ``clipped`` by
    the image's edge, ``saturated``, ``hidden`` (half hidden: fitted by an arc), ``merged`` (one of several that have
    run together). ``background``, ``noise``, ``threshold`` (grey values) and ``blur_px`` of the image; ``left_out``:
    blobs beyond the most that are given.
    """

    pixel: Array
    sigma_px: Array
    radius_px: Array
    area_px: NDArray[np.int64]
    peak: Array
    ellipse: Array
    clipped: Flags
    saturated: Flags
    hidden: Flags
    merged: Flags
    background: float
    noise: float
    threshold: float
    blur_px: float
    left_out: int

    def __len__(self) -> int:
        """Return the number of blobs."""
        return len(self.pixel)

    @property
    def brightness(self) -> Array:
        """All the light of each marker's image, in grey values times pixels: what an LED's blinking changes."""
        return self.peak * np.pi * np.square(self.radius_px)

    @property
    def quality(self) -> Array:
        """1 for a whole marker, 0.5 for a half hidden or merged one, 0.25 for a clipped or saturated one."""
        quality = np.where(self.hidden | self.merged, 0.5, 1.0)
        return np.where(self.clipped | self.saturated, 0.25, quality)


def detect_markers(
    image: NDArray[np.unsignedinteger[Any]],
    *,
    threshold: float | None = None,
    white: float | None = None,
    radius_px: float | None = None,
    blur_px: float | None = None,
    mask: Flags | None = None,
    background: NDArray[np.unsignedinteger[Any]] | None = None,
    adaptive: bool = False,
    least_pixels: int = LEAST_PIXELS,
    most_blobs: int = MOST_BLOBS,
) -> Blobs:
    """Find the bright markers of a grey image (height, width), 8 or 16 bit, with sub-pixel centres.

    A component of bright pixels gets a blurred disk fitted to all its grey values (the centre then reaches the bound of
    a disk's edge); what is no disk is fitted by circles of the markers' radius. ``threshold``: grey value above which a
    pixel is bright; by default 7 standard deviations of the image's noise above its background. ``white``: value at
    which the sensor saturates (4095 for 12 bits in 16). ``radius_px``: of a marker's image where it is known, otherwise
    the median of the image's. ``blur_px``: standard deviation of the edges' blur, the same for all images of a camera;
    otherwise it is fitted to some markers of the image. ``mask`` (height, width): pixels that are ignored.
    ``background``: an image without markers, of the same size, that is subtracted. ``adaptive``: the background is
    taken from the image itself, tile by tile, for walls that are lit unevenly.

    Raises ``InputError`` for an image that is none of this.
    """
    grey = np.asarray(image)
    if grey.ndim != 2 or grey.dtype not in (np.uint8, np.uint16) or grey.size == 0:
        raise InputError(
            f"an image of shape {grey.shape} and type {grey.dtype}: (height, width) of uint8 or uint16 is needed"
        )
    for name, other in (("mask", mask), ("background", background)):
        if other is not None and other.shape != grey.shape:
            raise InputError(f"the {name} has the size {other.shape[::-1]}, the image {grey.shape[::-1]}")
    if adaptive:
        background = local_background(grey)
    if background is not None:
        # Its median stays, so that the noise below it stays too.
        flat = grey.astype(np.int64) - background + int(np.median(background))
        grey = np.clip(flat, 0, np.iinfo(grey.dtype).max).astype(grey.dtype)
    if mask is not None:
        grey = np.where(mask, np.median(grey).astype(grey.dtype), grey)
    found = _core.detect_markers(
        np.ascontiguousarray(grey), threshold, white, radius_px, blur_px, (least_pixels, most_blobs)
    )
    return Blobs(**found)
