"""Samples as bytes for the page: one documented layout, little-endian, with its version.

Offset 0: ``MLCK``; 4: version (u16); 6: flags (u16; 1: sigmas, 2: residuals, 4: kinds); 8: first frame, as a row of the
take (u32); 12: frames (u32); 16: slots (u32); 20: revision of the take (u32). From 24 on, each block frame by frame,
slot by slot: places (f32 × 3, mm, NaN where absent), then as the flags say sigmas (f32, mm), residuals (f32), kinds
(i8, −1 where absent).
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.mending.sheet import Sheet

MAGIC, VERSION = b"MLCK", 1
HEADER = struct.Struct("<4sHHIIII")
SIGMAS, RESIDUALS, KINDS = 1, 2, 4
BYTES = 1 << 19
"""A chunk is about so large."""
PER_SAMPLE = 21
OVERVIEW_BYTES = 1 << 22
"""Every n-th frame of a take, as far as they fit into this: for finding one's way at once."""


def frames_of(slots: int) -> int:
    """Frames in a chunk: a power of two, from 8 to 1024."""
    wanted = BYTES / (PER_SAMPLE * max(slots, 1))
    return int(min(1024, max(8, 1 << int(np.log2(max(wanted, 1))))))


def overview_stride(slots: int, frames: int) -> int:
    """Of how many frames the overview has one."""
    fitting = max(OVERVIEW_BYTES // (PER_SAMPLE * max(slots, 1)), 64)
    return max(1, -(-frames // fitting))


def overview(sheet: Sheet, revision: int) -> bytes:
    """Every n-th row of the whole take; ``first`` and the frames of its header count these."""
    return of_sheet(sheet, 0, sheet.count, revision, overview_stride(len(sheet.trajectories), sheet.count))


def of_sheet(sheet: Sheet, first: int, count: int, revision: int, stride: int = 1) -> bytes:
    """Rows ``first`` to before ``first + count`` of all trajectories, as far as the take has them; every n-th one."""
    low, high = max(first, 0), max(min(first + count, sheet.count), 0)
    trajectories = sheet.trajectories
    n, slots = len(range(low, high, stride)), len(trajectories)
    shape = (n, slots)
    xyz, kinds = np.empty((*shape, 3), "<f4"), np.empty(shape, np.int8)
    sigmas, residuals = np.empty(shape, "<f4"), np.empty(shape, "<f4")
    part = slice(low, max(low, high), stride)
    for i, one in enumerate(trajectories):
        samples = one.samples
        xyz[:, i], kinds[:, i] = samples["xyz_mm"][part], samples["kind"][part]
        sigmas[:, i], residuals[:, i] = samples["sigma_mm"][part], samples["residual"][part]
    header = HEADER.pack(MAGIC, VERSION, SIGMAS | RESIDUALS | KINDS, low, n, slots, revision)
    return b"".join([header, xyz.tobytes(), sigmas.tobytes(), residuals.tobytes(), kinds.tobytes()])


def of_places(places_mm: NDArray[Any], first: int, count: int, revision: int) -> bytes:
    """Some frames of places (frames, slots, 3; mm) that have nothing but a place: joints."""
    low, high = max(first, 0), max(min(first + count, len(places_mm)), 0)
    part = np.ascontiguousarray(places_mm[low:high], "<f4")
    return HEADER.pack(MAGIC, VERSION, 0, low, len(part), places_mm.shape[1], revision) + part.tobytes()
