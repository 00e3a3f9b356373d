"""Centroids of rendered disks beside the Cramér-Rao bound, half-hidden and merged markers, and the time per image.

    python benches/detection.py [--draws=400]

Disks are rendered apart from the detector: a Gaussian-blurred disk integrated over each pixel on a fine grid, white
noise, rounded to 8 bits. The bound is that of a disk located by its edge, (1 / SNR) sqrt(2 s / (sqrt(pi) r)),
s = sqrt(blur² + 1/12).
"""

from __future__ import annotations

import sys
import time

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter

from markerloom.detect import detect_markers

BLUR_PX, FINE, SIDE = 0.6, 8, 40
HEIGHT, DARK = 180.0, 20.0


def rendered(disks: list[tuple[float, float, float]], side: int = SIDE, cut: tuple[float, float] | None = None):
    """Grey values without noise of disks (x, y, r); ``cut``: direction and offset of an edge that hides the rest."""
    grid = (np.arange(side * FINE) + 0.5) / FINE - 0.5
    x, y = np.meshgrid(grid, grid)
    share = np.zeros_like(x)
    for cx, cy, r in disks:
        inside = np.clip((r - np.hypot(x - cx, y - cy)) * FINE + 0.5, 0.0, 1.0)
        if cut is not None:
            inside *= (x - cx) * np.cos(cut[0]) + (y - cy) * np.sin(cut[0]) > cut[1]
        share = np.maximum(share, inside)
    blurred = gaussian_filter(share, BLUR_PX * FINE)
    return DARK + HEIGHT * blurred.reshape(side, FINE, side, FINE).mean(axis=(1, 3))


def noisy(image: np.ndarray, noise: float, random: np.random.Generator) -> np.ndarray:
    """The image with white noise, rounded to 8 bits."""
    return np.clip(np.round(image + random.normal(0.0, noise, image.shape)), 0, 255).astype(np.uint8)


def accuracy(draws: int) -> None:
    """Errors of single disks."""
    print("radius  SNR   error px  bound px  ratio  (error/sigma)²  OpenCV moments px")
    random = np.random.default_rng(0)
    s = np.sqrt(BLUR_PX**2 + 1 / 12)
    for r in (1.5, 3.0, 5.0):
        for snr in (20, 50, 100):
            errors, stated, plain = [], [], []
            for _ in range(draws // 20):
                at = random.uniform(SIDE / 2 - 1, SIDE / 2, 2)
                clean = rendered([(at[0], at[1], r)])
                for _ in range(20):
                    image = noisy(clean, HEIGHT / snr, random)
                    blobs = detect_markers(image)
                    best = int(np.argmax(blobs.area_px))
                    errors.append(blobs.pixel[best] - at)
                    stated.append(blobs.sigma_px[best])
                    moments = cv2.moments((image > DARK + HEIGHT / 2).astype(np.uint8), binaryImage=True)
                    plain.append(np.array([moments["m10"], moments["m01"]]) / moments["m00"] - at)
            error = np.sqrt(np.mean(np.square(errors)))
            bound = np.sqrt(2 * s / (np.sqrt(np.pi) * r)) / snr
            honest = np.mean(np.sum(np.square(errors), axis=1) / (2 * np.square(stated)))
            print(
                f"{r:6.1f} {snr:4d}   {error:8.4f}  {bound:8.4f}  {error / bound:5.2f}  {honest:14.2f}  "
                f"{np.sqrt(np.mean(np.square(plain))):16.3f}"
            )


def hard(draws: int) -> None:
    """Half-hidden and merged markers of radius 4."""
    random = np.random.default_rng(1)
    errors, both = [], 0
    for _ in range(draws):
        at = random.uniform(SIDE / 2 - 1, SIDE / 2, 2)
        image = noisy(rendered([(at[0], at[1], 4.0)], cut=(random.uniform(0, 2 * np.pi), 0.0)), 3.0, random)
        blobs = detect_markers(image, radius_px=4.0)
        errors.append(np.linalg.norm(blobs.pixel - at, axis=1).min())
        turn = random.uniform(0, 2 * np.pi)
        apart = 0.6 * 4.0 * np.array([np.cos(turn), np.sin(turn)])
        pair = [at - apart, at + apart]
        blobs = detect_markers(noisy(rendered([(*p, 4.0) for p in pair]), 3.0, random), radius_px=4.0)
        near = [np.linalg.norm(blobs.pixel - p, axis=1).min() < 0.3 for p in pair]
        both += all(near) and len(blobs) == 2
    print(f"half hidden, r = 4: {np.sqrt(np.mean(np.square(errors))):.3f} px rms of the distance")
    print(f"two merged, 1.2 radii apart: both within 0.3 px in {both / draws:.1%}")


def speed() -> None:
    """1280 x 1024, 80 markers, beside OpenCV's ways."""
    random = np.random.default_rng(2)
    image = np.full((1024, 1280), DARK)
    for k in range(80):
        x, y = 60 + 120 * (k % 10), 60 + 120 * (k // 10)
        tile = rendered([(20 + random.uniform(), 20 + random.uniform(), random.uniform(2, 4))])
        image[y - 20 : y + 20, x - 20 : x + 20] = tile
    grey = noisy(image, 1.5, random)

    def components() -> int:
        return cv2.connectedComponentsWithStats((grey > 40).astype(np.uint8))[0] - 1

    def contours() -> int:
        found, _ = cv2.findContours((grey > 40).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        return len([cv2.moments(c) for c in found])

    parameters = cv2.SimpleBlobDetector_Params()  # pyright: ignore[reportAttributeAccessIssue]
    parameters.filterByColor, parameters.blobColor = True, 255
    parameters.filterByArea, parameters.minArea = True, 4
    detector = cv2.SimpleBlobDetector_create(parameters)  # pyright: ignore[reportAttributeAccessIssue]
    cv2.setNumThreads(1)
    blur_px = detect_markers(grey).blur_px
    ways = {
        "markerloom": lambda: len(detect_markers(grey)),
        "markerloom, blur known from before": lambda: len(detect_markers(grey, blur_px=blur_px)),
        "OpenCV threshold, contours, moments": contours,
        "OpenCV threshold, connected components": components,
        "OpenCV SimpleBlobDetector": lambda: len(detector.detect(grey)),
    }
    for name, way in ways.items():
        count, times = way(), []
        for _ in range(40):
            start = time.perf_counter()
            way()
            times.append(time.perf_counter() - start)
        print(f"{name:40s} {1000 * np.median(times):7.3f} ms   {count} blobs")


if __name__ == "__main__":
    draws = int(dict(a.lstrip("-").split("=") for a in sys.argv[1:]).get("draws", "400"))
    accuracy(draws)
    hard(draws // 2)
    speed()
