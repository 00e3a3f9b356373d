"""Video frames behind the 2D view: recordings that lie beside a take, one for each camera, named after it."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import InputError
from markerloom.rig import Camera
from markerloom.studio.opened import OpenTake

ENDINGS = (".mkv", ".mp4", ".avi", ".mov")


def video_of(take: OpenTake, camera: Camera) -> Path | None:
    """The recording of a camera: ``CAMERA.mkv`` (or .mp4, .avi, .mov) in the folder of the take's file."""
    folder = Path(take.settings.file).parent
    files = (folder / f"{name}{ending}" for name in (camera.id, camera.name) if name for ending in ENDINGS)
    return next((f for f in files if f.is_file()), None)


def frame_of(take: OpenTake, camera: str, frame: int) -> bytes:
    """The image of a camera in a frame of the take, as PNG."""
    one = take.rig.find(camera) if take.rig else None
    file = video_of(take, one) if one else None
    if file is None:
        raise InputError(f"there is no video of camera {camera}")
    return frame_png(file, frame - take.sheet.first)


def frame_png(path: Path, row: int) -> bytes:
    """One image of a recording as PNG. Raises ``InputError`` where the recording has no such image."""
    try:
        import av
    except ImportError:
        raise InputError("showing video needs PyAV: pip install markerloom[video]") from None
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        rate, base = stream.average_rate, stream.time_base
        if rate is None or base is None:
            raise InputError(f"{path.name} does not tell its frame rate")
        container.seek(int(row / rate / base), stream=stream, backward=True)
        for image in container.decode(stream):
            if image.pts is None or round(float(image.pts * base * rate)) >= row:
                return png(np.asarray(image.to_ndarray(format="gray"), np.uint8))
    raise InputError(f"{path.name} has no image {row}")


def png(grey: NDArray[np.uint8]) -> bytes:
    """A grey image (height, width) as PNG."""
    height, width = grey.shape

    def part(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    lines = np.hstack([np.zeros((height, 1), np.uint8), grey]).tobytes()
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    body = part(b"IHDR", head) + part(b"IDAT", zlib.compress(lines, 1)) + part(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body
