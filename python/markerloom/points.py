"""Points: one row per 3D point of a take, with its uncertainty and where it came from."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from markerloom.observations import all_frames

if TYPE_CHECKING:
    from pathlib import Path

    import pyarrow as pa

Array = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]
KINDS = ("measured", "predicted", "filled", "edited")
MEASURED = 0
COLUMNS = (
    *("frame", "track", "label", "xyz_mm", "sigma_mm", "rays", "residual_px", "confidence", "kind"),
    *("residual_mm", "camera_mask", "label_probability"),
)


@dataclass(frozen=True)
class Points:
    """Points as columns, ordered by frame and track.

    ``kind`` holds indices into ``KINDS``. Values that a source does not know are NaN (``sigma_mm``, ``residual_px``,
    ``confidence``, ``label_probability``) or −1 (``rays``). ``residual_mm`` is the mean distance between point and
    rays; ``label_probability`` that of the label being right.
    """

    frame: Ints
    track: Ints
    label: NDArray[np.str_]
    xyz_mm: Array
    sigma_mm: Array
    rays: Ints
    residual_px: Array
    confidence: Array
    kind: Ints
    residual_mm: Array
    camera_mask: Ints
    rate_hz: float | None = None
    frames: Ints = field(default_factory=lambda: np.zeros(0, np.int64))
    up_axis: str = "z"
    tracked: bool = True
    source: str = ""
    label_probability: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        """Fill in the frame numbers and probabilities where the source did not know them."""
        if len(self.label_probability) != len(self.frame):
            object.__setattr__(self, "label_probability", np.full(len(self.frame), np.nan))
        if len(self.frames) == 0 and len(self.frame) > 0:
            object.__setattr__(self, "frames", all_frames(self.frame, self.source))

    @staticmethod
    def of(frame: Ints, track: Ints, xyz_mm: Array, **known: object) -> Points:
        """Points with defaults for everything that is not known."""
        n = len(frame)
        defaults: dict[str, object] = {
            "label": np.full(n, "", dtype="<U1"),
            "sigma_mm": np.full(n, np.nan),
            "rays": np.full(n, -1, np.int64),
            "residual_px": np.full(n, np.nan),
            "confidence": np.full(n, np.nan),
            "kind": np.zeros(n, np.int64),
            "residual_mm": np.full(n, np.nan),
            "camera_mask": np.zeros(n, np.int64),
        }
        return Points(frame=frame, track=track, xyz_mm=xyz_mm, **{**defaults, **known})  # pyright: ignore[reportArgumentType]

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.frame)

    def keep(self, rows: NDArray[np.bool_] | Ints) -> Points:
        """The rows for which ``rows`` is true; or these rows, in this order."""
        return replace(self, **{name: getattr(self, name)[rows] for name in COLUMNS}, frames=self.frames)

    def select(self, start: int | None, stop: int | None) -> Points:
        """The frames from ``start`` to before ``stop``."""
        low = -(2**62) if start is None else start
        high = 2**62 if stop is None else stop
        frames = self.frames[(self.frames >= low) & (self.frames < high)]
        return replace(self.keep((self.frame >= low) & (self.frame < high)), frames=frames)

    def with_up_axis(self, up: str) -> Points:
        """The same points with another axis up, ``y`` or ``z``: (x, y, z) → (x, z, −y), or back."""
        if up == self.up_axis:
            return self
        x, y, z = self.xyz_mm.T
        turned = [x, z, -y] if up == "y" else [x, -z, y]
        return replace(self, xyz_mm=np.column_stack(turned), up_axis=up)

    def joined(self, other: Points) -> Points:
        """These trajectories, and after them those of another take of the same frames, under numbers of their own."""
        both = {name: np.concatenate([getattr(self, name), getattr(other, name)]) for name in COLUMNS}
        both["track"][len(self) :] += 1 + self.track.max(initial=-1)
        together = replace(self, **both)
        return together.keep(np.lexsort([together.track, together.frame]))

    def slots(self) -> tuple[list[str], Ints]:
        """Trajectories for formats with one column per marker: their names, and the column of each row.

        Labelled tracks keep their label; the others are called ``*1``, ``*2``, … in order of track.
        """
        _, first_row, column = np.unique(self.track, return_index=True, return_inverse=True)
        names, unnamed = [], 0
        for row in first_row.tolist():
            label = str(self.label[row])
            if not label:
                unnamed += 1
                label = f"*{unnamed}"
            names.append(label)
        return names, column.astype(np.int64)

    def save(self, path: str | Path) -> None:
        """Write to .c3d, .trc, .parquet or .csv."""
        from markerloom.formats import write_points

        write_points(self, path)

    def to_arrow(self) -> pa.Table:
        """The points table."""
        from markerloom.formats.points_table import to_arrow

        return to_arrow(self)

    def to_pandas(self) -> object:
        """The points table as a data frame; needs pandas."""
        return self.to_arrow().to_pandas()
