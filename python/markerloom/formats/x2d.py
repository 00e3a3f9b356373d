"""Vicon .x2d: raw centroids; parsed in Rust."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from markerloom import _core
from markerloom.errors import BytesError, FormatError
from markerloom.formats.files import read_bytes
from markerloom.observations import Observations, concatenate_ids


def read(path: str | Path) -> Observations:
    """Read centroids; grey blobs (dots the camera could not fit) are counted in a warning."""
    try:
        content = _core.read_x2d(read_bytes(path))
    except BytesError as error:
        raise FormatError(path, str(error)) from None
    camera, ids = concatenate_ids(content["camera"].tolist())
    blobs = content["grey_blobs"]
    note = f"{blobs} grey blobs without a fitted centroid are not used (markerloom detect fits them)"
    return Observations(
        frame=content["frame"],
        camera=camera,
        camera_ids=ids,
        pixel=np.column_stack([content["x"], content["y"]]),
        optional={"radius": content["radius"], "quality": content["quality"]},
        frames=np.arange(content["frames"]),
        source=str(path),
        warnings=(note,) if blobs else (),
    )
