"""The recordings behind a wand calibration: several waves as one, and a calibration continued by another wave."""

from __future__ import annotations

import hashlib
import os
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from markerloom.calibrate.wand import Calibration
from markerloom.errors import InputError
from markerloom.formats import calib_toml, read_observations
from markerloom.formats.files import read_text
from markerloom.observations import Observations

KEY = "wave"
PAUSE_FRAMES = 10
"""Empty frames between two recordings: nothing is carried from one to the next."""


def joined(waves: Sequence[Observations]) -> Observations:
    """Several recordings of the same cameras, one after the other."""
    if len(waves) == 1:
        return waves[0]
    ids = tuple(dict.fromkeys(c for wave in waves for c in wave.camera_ids))
    frame, camera, pixel, next_frame = [], [], [], 0
    for wave in waves:
        if len(wave) == 0:
            continue
        frame.append(wave.frame - int(wave.frames[0]) + next_frame)
        camera.append(np.array([ids.index(c) for c in wave.camera_ids], np.int64)[wave.camera])
        pixel.append(wave.pixel)
        next_frame = int(frame[-1].max()) + 1 + PAUSE_FRAMES
    if not frame:
        raise InputError(f"there is no observation in {', '.join(w.source for w in waves)}")
    return Observations(
        np.concatenate(frame),
        np.concatenate(camera),
        ids,
        np.concatenate(pixel),
        rate_hz=waves[0].rate_hz,
        source=", ".join(w.source for w in waves),
    )


def refused_path(output: Path) -> Path:
    """Where a refused calibration is kept, for ``--continue`` and for nothing else."""
    return output.with_name(output.stem + ".refused.toml")


def write(made: Calibration, recordings: Sequence[Path], wand: str, output: Path) -> None:
    """Write the rig with what it is worth, and with the recordings that it comes from."""
    folder = output.parent.resolve()
    rows = [{"path": os.path.relpath(p.resolve(), folder), "sha256": _digest(p)} for p in recordings]
    own: dict[str, Any] = {"wand": wand, "recordings": rows, "verdict": made.report["verdict"]}
    calib_toml.write(made.rig, output, quality=made.quality(), extra={KEY: own})


def recordings_of(calibration: Path) -> list[Path]:
    """The recordings that a wand calibration comes from, as they were. Raises ``InputError`` where they are not."""
    content = tomllib.loads(read_text(calibration))
    own = content.get("metadata", {}).get("markerloom", {}).get(KEY)
    if not isinstance(own, dict) or not own.get("recordings"):
        raise InputError(f"only a calibration that 'calibrate wand' wrote can be continued ({calibration})")
    paths = []
    for row in own["recordings"]:
        path = calibration.parent / row["path"]
        if not path.exists():
            raise InputError(f"the recording {row['path']} behind the calibration is gone ({calibration})")
        if _digest(path) != row["sha256"]:
            raise InputError(f"the recording {row['path']} behind the calibration was changed since ({calibration})")
        paths.append(path)
    return paths


def read_all(paths: Sequence[Path]) -> Observations:
    """All recordings as one."""
    return joined([read_observations(path) for path in paths])


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
