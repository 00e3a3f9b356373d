"""Grey images from image files, folders of them, and video; one at a time, so that memory does not grow."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import FormatError, InputError
from markerloom.formats import timecode
from markerloom.rig import natural_key

Grey = NDArray[np.unsignedinteger[Any]]

IMAGES = (".png", ".tif", ".tiff", ".bmp", ".jpg", ".jpeg", ".pgm")


def grey_images(source: str | Path) -> Iterator[Grey]:
    """The images of a video, an image file, or a folder of image files in natural order of their names.

    Each is (height, width), uint8, or uint16 where the source has more than 8 bits. Colours become grey.

    Raises ``InputError`` where there is nothing to read or PyAV is not installed, ``FormatError`` for a file that is no
    image or video, or that ends amid an image: what came before it was given.
    """
    path = Path(source)
    if not path.exists():
        raise InputError(f"there is no file or folder {path}")
    if not path.is_dir():
        yield from _of_file(path)
        return
    files = sorted((p for p in path.iterdir() if p.suffix.lower() in IMAGES), key=lambda p: natural_key(p.name))
    if not files:
        raise InputError(f"no image in the folder {path} ({', '.join(IMAGES)})")
    for file in files:
        yield from _of_file(file)


def sources_by_camera(sources: Sequence[Path], names: str | None) -> dict[str, Path]:
    """Camera ids with their sources: names with commas between, or the files' and folders' own names."""
    ids = [p.stem for p in sources] if names is None else [n.strip() for n in names.split(",")]
    if len(ids) != len(sources):
        raise InputError(f"--names: {len(ids)} names for {len(sources)} cameras")
    if len(set(ids)) < len(ids):
        raise InputError(f"two cameras have the same name ({', '.join(ids)}): tell them apart with --names")
    return dict(zip(ids, sources, strict=True))


def rate_hz(source: str | Path) -> float | None:
    """Frame rate that a video states; ``None`` for images."""
    path = Path(source)
    if path.is_dir() or path.suffix.lower() in IMAGES:
        return None
    with _av().open(str(path)) as container:
        rate = container.streams.video[0].average_rate
        return float(rate) if rate else None


def start_s(source: str | Path) -> float | None:
    """Time (s since midnight) at which a video begins by its SMPTE time code; ``None`` where it states none."""
    path = Path(source)
    if path.is_dir() or path.suffix.lower() in IMAGES:
        return None
    with _av().open(str(path)) as container:
        stated = [container.metadata, *(s.metadata for s in container.streams)]
        rate = container.streams.video[0].average_rate
    for metadata in stated:
        for key, code in metadata.items():
            if key.lower() == "timecode":
                try:
                    return float(timecode.seconds([code], rate=float(rate) if rate else None)[0])
                except InputError:
                    return None
    return None


def write_png(image: Grey, path: str | Path) -> None:
    """Write an 8-bit grey image."""
    av = _av()
    height, width = image.shape
    codec = av.CodecContext.create("png", "w")
    codec.width, codec.height, codec.pix_fmt = width, height, "gray"
    codec.time_base = 1
    packets = codec.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="gray"))
    Path(path).write_bytes(b"".join(bytes(p) for p in [*packets, *codec.encode(None)]))


def write_video(images: Iterable[Grey], path: str | Path, *, rate_hz: float, timecode: str | None = None) -> None:
    """Write 8-bit grey images as a lossless video (FFV1), with the time code of its first image where one is given."""
    av = _av()
    with av.open(str(path), "w") as container:
        if timecode is not None:
            container.metadata["timecode"] = timecode
        stream = None
        for image in images:
            if stream is None:
                stream = container.add_stream("ffv1", rate=Fraction(rate_hz).limit_denominator(1000))
                stream.height, stream.width = image.shape
                stream.pix_fmt = "gray"
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="gray")))
        if stream is None:
            raise InputError(f"there is no image to write as {path}")
        container.mux(stream.encode())


def _av() -> Any:
    try:
        import av
    except ImportError:
        raise InputError(
            "images and video are read by PyAV, which is not installed: pip install 'markerloom[video]'"
        ) from None
    return av


def _of_file(path: Path) -> Iterator[Grey]:
    av = _av()
    if path.stat().st_size == 0:
        raise FormatError(path, "the file is empty")
    count = 0
    try:
        with av.open(str(path)) as container:
            if not container.streams.video:
                raise FormatError(path, "there is no picture in it")
            for frame in container.decode(container.streams.video[0]):
                yield _grey(frame)
                count += 1
    except av.FFmpegError as error:
        what = "not an image or video that can be read" if count == 0 else f"it ends amid image {count}"
        raise FormatError(path, f"{what}: {error}") from None
    if count == 0:
        raise FormatError(path, "there is no picture in it")


def _grey(frame: Any) -> Grey:
    deep = any(c.bits > 8 for c in frame.format.components)
    return frame.to_ndarray(format="gray16le" if deep else "gray")
