"""What the cameras of a simulated take would film: markers as blurred disks with noise, saturation and merging."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from scipy.special import ndtr

from markerloom.detect.images import Grey, write_video
from markerloom.detect.markers import detect_markers
from markerloom.detect.takes import FEWEST_FOR_BLUR
from markerloom.errors import InputError
from markerloom.observations import Observations
from markerloom.simulate import SimulatedTake

BLUR_PX = 0.6
DARK, BRIGHT, NOISE = 16.0, 200.0, 2.0
"""Grey values of the background, of a marker above it, and the standard deviation of a pixel."""
FINE = 3
"""Samples of a pixel along each side."""


def rendered(take: SimulatedTake, camera: str, *, marker_mm: float = 14.0, bright: float = BRIGHT) -> Iterator[Grey]:
    """The images of one camera, frame by frame, 8 bits.

    Every marker that the take says this camera sees is a disk at its true place, as large as a ball of ``marker_mm``;
    disks that overlap become one. ``bright``: grey values above the background; beyond 239 it saturates. LEDs are as
    bright as the take says. The noise comes from the take's seed.
    """
    if camera not in take.rig.ids:
        raise InputError(f"the take has no camera {camera}; it has {', '.join(take.rig.ids)}")
    index = take.rig.ids.index(camera)
    one = take.rig.cameras[index]
    width, height = (int(side) for side in one.size_px)
    place = {(f, m): p for f, m, p in zip(take.truth.frame, take.truth.label, take.truth.xyz_mm / 1000.0, strict=True)}
    seen: dict[int, list[tuple[np.ndarray, float]]] = defaultdict(list)
    table = take.truth_assignments.to_pydict()
    level = _levels(take, index)
    columns = (table[name] for name in ("frame", "camera", "observation", "label"))
    for frame, name, observation, label in zip(*columns, strict=True):
        if name == camera:
            seen[frame].append((place[frame, label], level.get((frame, observation), bright) / bright))
    for frame in range(take.scene.frames):
        share = np.zeros((height, width))
        for at, level in seen[frame]:
            pixel = take.rig.project(index, at[None])[0]
            depth = float((at - one.position_m) @ one.rotation[2])
            _draw(share, pixel, 0.5 * marker_mm / 1000.0 * one.focal_px[0] / depth, level)
        noise = np.random.default_rng([take.scene.seed, index, frame]).normal(0.0, NOISE, share.shape)
        yield np.clip(np.round(DARK + bright * share + noise), 0, 255).astype(np.uint8)


def detected(
    take: SimulatedTake, *, marker_mm: float = 14.0, progress: Callable[[int, int], None] | None = None
) -> Observations:
    """The dots that detection finds in the images of a simulated take, without a file in between."""
    rows: list[np.ndarray] = []
    films = [rendered(take, camera, marker_mm=marker_mm) for camera in take.rig.ids]
    blur_px: list[float | None] = [None] * len(films)
    for frame, images in enumerate(zip(*films, strict=True)):
        for camera, image in enumerate(images):
            blobs = detect_markers(image, blur_px=blur_px[camera])
            if blur_px[camera] is None and len(blobs) >= FEWEST_FOR_BLUR:
                blur_px[camera] = blobs.blur_px
            where = np.tile([frame, camera], (len(blobs), 1))
            own = (blobs.radius_px, blobs.brightness, blobs.sigma_px, blobs.quality)
            rows.append(np.column_stack([where, blobs.pixel, *own]))
        if progress:
            progress(frame + 1, take.scene.frames)
    table = np.concatenate(rows)
    return Observations(
        frame=table[:, 0].astype(np.int64),
        camera=table[:, 1].astype(np.int64),
        camera_ids=tuple(take.rig.ids),
        pixel=table[:, 2:4].copy(),
        optional=dict(zip(("radius", "brightness", "sigma", "quality"), table[:, 4:].T.copy(), strict=True)),
        rate_hz=take.scene.rate_hz,
        frames=np.arange(take.scene.frames),
        source=f"filmed {take.scene.scene}",
    )


def save_videos(take: SimulatedTake, folder: str | Path, *, marker_mm: float = 14.0) -> dict[str, Path]:
    """Write a lossless video of every camera into a folder: ``CAMERA.mkv``. Returns the files by camera."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    files = {camera: folder / f"{camera}.mkv" for camera in take.rig.ids}
    for camera, file in files.items():
        write_video(rendered(take, camera, marker_mm=marker_mm), file, rate_hz=take.scene.rate_hz)
    return files


def _levels(take: SimulatedTake, camera: int) -> dict[tuple[int, int], float]:
    """Grey value of each of a camera's observations (frame, index in it), where they have one: LEDs."""
    observations = take.observations
    brightness = observations.optional.get("brightness")
    if brightness is None:
        return {}
    own = np.flatnonzero(observations.camera == camera)
    frame = observations.frame[own]
    first = np.searchsorted(frame, frame)
    within = np.arange(len(own)) - first
    return {(int(f), int(i)): float(b) for f, i, b in zip(frame, within, brightness[own], strict=True)}


def _draw(share: np.ndarray, pixel: np.ndarray, radius: float, level: float) -> None:
    """A blurred disk, averaged over each pixel; where another one is brighter, that one stays."""
    height, width = share.shape
    reach = radius + 4.0 * BLUR_PX + 1.0
    left, top = (max(int(np.floor(c - reach)), 0) for c in pixel)
    right, bottom = min(int(pixel[0] + reach) + 2, width), min(int(pixel[1] + reach) + 2, height)
    if left >= right or top >= bottom:
        return
    fine = (np.arange(FINE) + 0.5) / FINE - 0.5
    x = (np.arange(left, right)[:, None] + fine).ravel() - pixel[0]
    y = (np.arange(top, bottom)[:, None] + fine).ravel() - pixel[1]
    disk = ndtr((radius - np.hypot(x[None, :], y[:, None])) / BLUR_PX)
    disk = level * disk.reshape(bottom - top, FINE, right - left, FINE).mean(axis=(1, 3))
    share[top:bottom, left:right] = np.maximum(share[top:bottom, left:right], disk)
