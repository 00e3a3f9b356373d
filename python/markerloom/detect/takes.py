"""Centroids of whole recordings: one source a camera."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from markerloom.detect.images import Grey, grey_images, rate_hz, start_s
from markerloom.detect.markers import Blobs, detect_markers
from markerloom.errors import FormatError, InputError
from markerloom.observations import Observations

Flags = NDArray[np.bool_]

AHEAD = 4
"""Images read ahead for each thread."""
FEWEST_FOR_BLUR = 3
"""Markers of an image from which a camera's blur is taken."""
LEARNED_FROM = 50
"""Images of an empty scene that are looked at."""
AROUND_PX = 3
"""A mask reaches so far around what was bright in the empty scene."""


def detect(
    sources: Mapping[str, str | Path],
    *,
    threshold: float | None = None,
    white: float | None = None,
    radius_px: float | None = None,
    masks: Mapping[str, Flags] | None = None,
    backgrounds: Mapping[str, Grey] | None = None,
    adaptive: bool = False,
    threads: int = 0,
) -> tuple[Observations, dict[str, Any]]:
    """Find the markers in recordings: for each camera id a video, an image, or a folder of images (frame by frame).

    Options as in ``detect_markers``; ``masks`` and ``backgrounds`` by camera. ``threads``: 0 = all cores; the result is
    the same for any number.
    The observations have ``radius``, ``sigma`` (px), ``brightness`` and ``quality`` (see ``Blobs``), and ``timecode_s``
    where every video states a time code. The report has, by camera, ``frames``, ``dots``, ``dots_per_frame``, and
    counts of what was hidden, merged, clipped, saturated; ``warnings`` name images without markers, of another size, or
    that cannot be read: what came before them is kept.
    """
    if not sources:
        raise InputError("no image or video was given")
    rows, report, warnings, rates, starts = [], {}, [], [], []
    workers = threads or os.cpu_count() or 1
    with ThreadPoolExecutor(workers) as pool:
        for index, (camera, source) in enumerate(sources.items()):
            mask = None if masks is None else masks.get(camera)
            background = None if backgrounds is None else backgrounds.get(camera)

            one = partial(
                detect_markers,
                threshold=threshold,
                white=white,
                radius_px=radius_px,
                mask=mask,
                background=background,
                adaptive=adaptive,
            )
            counts = _Counts()
            images = _of_one_size(camera, source, warnings)
            for frame, blobs in enumerate(_in_order(pool, workers, one, images)):
                counts.add(blobs)
                n = len(blobs)
                columns = (blobs.pixel, blobs.radius_px, blobs.brightness, blobs.sigma_px, blobs.quality)
                rows.append((np.full(n, frame), np.full(n, index), *columns))
            report[camera] = counts.report()
            warnings += counts.warnings(camera)
            rates.append(rate_hz(source) if counts.frames else None)
            starts.append(start_s(source) if counts.frames else None)
    frames = max((own["frames"] for own in report.values()), default=0)
    if frames == 0:
        raise InputError("; ".join(warnings) or "there is no image in the sources")
    if len({own["frames"] for own in report.values()}) > 1:
        lengths = ", ".join(f"{c} {own['frames']}" for c, own in report.items())
        warnings.append(f"the cameras have different numbers of images: {lengths}")
    frame, camera, pixel, radius, brightness, sigma, quality = (
        np.concatenate(column) for column in zip(*rows, strict=True)
    )
    known = {r for r in rates if r is not None}
    columns = {"radius": radius, "brightness": brightness, "sigma": sigma, "quality": quality}
    found = Observations(
        frame.astype(np.int64),
        camera.astype(np.int64),
        tuple(sources),
        pixel,
        optional=_timecodes_s(frame, camera.astype(np.int64), starts, rates) | columns,
        rate_hz=known.pop() if len(known) == 1 else None,
        frames=np.arange(frames),
        source=", ".join(str(s) for s in sources.values()),
        warnings=tuple(warnings),
    )
    return found, {"frames": frames, "dots": len(found), "cameras": report, "warnings": warnings}


def _timecodes_s(
    frame: np.ndarray, camera: np.ndarray, starts: list[float | None], rates: list[float | None]
) -> dict[str, np.ndarray]:
    """The time of every dot as a column, where every video states when it begins."""
    if any(s is None for s in starts) or any(r is None for r in rates):
        return {}
    return {"timecode_s": np.array(starts, float)[camera] + frame / np.array(rates, float)[camera]}


def learn_mask(source: str | Path, *, threshold: float | None = None) -> Flags:
    """Pixels (height, width) that are bright in a recording of the empty scene, and what is near them."""
    bright: Flags | None = None
    for count, image in enumerate(grey_images(source)):
        if count == LEARNED_FROM:
            break
        level = detect_markers(image, threshold=threshold).threshold
        now = image > level
        bright = now if bright is None else bright | now
    if bright is None:
        raise InputError(f"there is no image in {source}")
    return np.asarray(binary_dilation(bright, iterations=AROUND_PX), bool)


def read_mask(path: str | Path) -> Flags:
    """A painted mask: every pixel of an image file that is not black is ignored."""
    return next(grey_images(path)) > 0


def _of_one_size(camera: str, source: str | Path, warnings: list[str]) -> Iterator[Grey]:
    """The images until one cannot be read or has another size."""
    size = None
    try:
        for number, image in enumerate(grey_images(source)):
            if size is not None and image.shape != size:
                warnings.append(
                    f"camera {camera}: image {number} has {image.shape[1]}x{image.shape[0]} pixels, those before it "
                    f"{size[1]}x{size[0]}: it and what follows is left out"
                )
                return
            size = image.shape
            yield image
    except FormatError as error:
        warnings.append(f"camera {camera}: {error}; what came before it is kept")


def _in_order(pool: ThreadPoolExecutor, workers: int, find: Any, images: Iterator[Grey]) -> Iterator[Blobs]:
    """Results in the order of the images, with a bounded number of them in memory.

    The blur of a camera's edges is that of its first image with markers enough; later ones take it as known.
    """
    waiting: deque[Future[Blobs]] = deque()
    for image in images:
        if "blur_px" not in find.keywords:
            blobs = find(image)
            if len(blobs) >= FEWEST_FOR_BLUR:
                find = partial(find, blur_px=blobs.blur_px)
            yield blobs
            continue
        waiting.append(pool.submit(find, image))
        if len(waiting) > AHEAD * workers:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()


class _Counts:
    """What a camera's images held."""

    def __init__(self) -> None:
        self.frames = self.dots = self.empty = self.overfull = 0
        self.flags = dict.fromkeys(("hidden", "merged", "clipped", "saturated"), 0)

    def add(self, blobs: Blobs) -> None:
        self.frames += 1
        self.dots += len(blobs)
        self.empty += len(blobs) == 0
        self.overfull += blobs.left_out > 0
        for name in self.flags:
            self.flags[name] += int(getattr(blobs, name).sum())

    def report(self) -> dict[str, Any]:
        per_frame = self.dots / self.frames if self.frames else 0.0
        return {"frames": self.frames, "dots": self.dots, "dots_per_frame": per_frame, **self.flags}

    def warnings(self, camera: str) -> list[str]:
        notes = []
        if self.frames and self.empty == self.frames:
            notes.append(f"camera {camera} shows no marker in any of its {self.frames} images: lower the threshold?")
        if self.overfull:
            notes.append(
                f"camera {camera}: {self.overfull} images hold more blobs than are given out: raise the threshold, or "
                "mask stray light"
            )
        if self.dots and self.flags["saturated"] > 0.5 * self.dots:
            notes.append(f"camera {camera}: most markers are saturated: expose shorter, or state --white")
        return notes
