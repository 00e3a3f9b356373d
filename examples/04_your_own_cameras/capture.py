"""Your own cameras: a capture loop that finds markers as the images come, and records the dots with their times.

    python capture.py                      no camera at hand: films a simulated take first
    python capture.py 0 2                  V4L2 or UVC cameras number 0 and 2 (needs OpenCV)
    python capture.py left.mp4 right.mp4   recordings

Each camera has a thread of its own that waits for images; the loop below takes the newest and finds its markers. For
other hardware, write another generator of (time in seconds, grey image) and put it in `source`. Cameras that are not
triggered together have clocks of their own: `markerloom sync` puts the recording on one.
"""

import queue
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import markerloom as ml

OUT = Path("out/capture")
LONGEST_S = 60.0


def from_camera(number: int) -> Iterator[tuple[float, np.ndarray]]:
    """Images of a V4L2 or UVC camera, until the time is over."""
    import cv2

    camera = cv2.VideoCapture(number)
    if not camera.isOpened():
        sys.exit(f"camera {number} cannot be opened: is it plugged in, and not in use elsewhere?")
    camera.set(cv2.CAP_PROP_AUTO_EXPOSURE, 1)  # by hand: markers are bright, all else is to be dark
    camera.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # no old images
    start = time.monotonic()
    while (now := time.monotonic() - start) < LONGEST_S:
        there, image = camera.read()
        if not there:
            break
        yield now, cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    camera.release()


def from_file(path: Path, rate_hz: float) -> Iterator[tuple[float, np.ndarray]]:
    """Images of a recording, as fast as they are wanted."""
    for number, image in enumerate(ml.grey_images(path)):
        yield number / rate_hz, image


def source(name: str) -> Iterator[tuple[float, np.ndarray]]:
    """Where a camera's images come from: its number, or a file's name."""
    return from_camera(int(name)) if name.isdigit() else from_file(Path(name), rate_hz=50.0)


def wait_for_images(camera: str, images: Iterator[tuple[float, np.ndarray]], out: queue.Queue) -> None:
    """A camera's thread: hands over images, and says when there are no more."""
    for frame, (time_s, image) in enumerate(images):
        out.put((camera, frame, time_s, image))
    out.put((camera, None, 0.0, None))


names = sys.argv[1:]
if not names:
    small = {"image_width": 640, "image_height": 512, "focal_px": 640.0}
    take = ml.simulate(ml.make_scene("walk", frames=20, markers=12, cameras=2, **small))
    names = [str(path) for path in ml.save_videos(take, OUT, marker_mm=25.0).values()]
OUT.mkdir(parents=True, exist_ok=True)

waiting: queue.Queue = queue.Queue(maxsize=8 * len(names))
for name in names:
    threading.Thread(target=wait_for_images, args=(Path(name).stem, source(name), waiting), daemon=True).start()

rows, running, blur_px = [], len(names), {}
while running:
    camera, frame, time_s, image = waiting.get()
    if image is None:
        running -= 1
        continue
    blobs = ml.detect_markers(image, blur_px=blur_px.get(camera))
    if len(blobs) >= 3:
        blur_px.setdefault(camera, blobs.blur_px)  # the camera's; known from its first image on
    rows += [(frame, camera, *pixel, time_s, sigma) for pixel, sigma in zip(blobs.pixel, blobs.sigma_px, strict=True)]

rows.sort(key=lambda row: (row[0], row[1]))
columns = dict(zip(("frame", "camera", "x", "y", "time_s", "sigma"), zip(*rows, strict=True), strict=True))
lines = [",".join(columns), *(",".join(str(value) for value in row) for row in rows)]
(OUT / "dots.csv").write_text("\n".join(lines) + "\n")
cameras = sorted(set(columns["camera"]))
print(f"{len(rows)} dots of {len(cameras)} cameras → {OUT / 'dots.csv'}")
