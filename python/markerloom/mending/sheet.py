"""A take that can be changed: one trajectory beside the other, and every change with its way back."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import InputError
from markerloom.mending.edits import At, Range
from markerloom.points import Points

Samples = dict[str, NDArray[Any]]
ABSENT = -1
SAME_MM = 10.0
"""Two markers are never nearer to each other than a marker is wide: within this it is the same trajectory."""
BLANK: dict[str, float] = {
    "xyz_mm": np.nan,
    "sigma_mm": np.nan,
    "kind": ABSENT,
    "residual": np.nan,
    "row": -1,
    "origin": -1,
}
HELD = ("xyz_mm", "sigma_mm", "kind", "residual", "row")
VERSIONS = count()


@dataclass
class Trajectory:
    """One trajectory: ``samples`` hold ``xyz_mm`` (frames, 3), ``sigma_mm``, ``kind`` (−1: absent), ``residual`` (px,
    or mm where only that is known), and where the take's points are kept, ``row``: the row of each sample in them.
    ``origin``: the track in which a sample came, where that is of interest. ``version`` is another after every change.
    """

    track: int
    label: str
    samples: Samples
    version: int = field(default_factory=lambda: next(VERSIONS))

    @property
    def kind(self) -> NDArray[np.int8]:
        """Kind of each sample; −1 where there is none."""
        return self.samples["kind"]

    @property
    def xyz_mm(self) -> NDArray[np.float64]:
        """Places (frames, 3)."""
        return self.samples["xyz_mm"]


@dataclass
class Sheet:
    """All trajectories of a take over ``count`` frames from number ``first``."""

    first: int
    count: int
    rate_hz: float | None
    trajectories: list[Trajectory]
    source: str = ""

    @staticmethod
    def of(points: Points) -> Sheet:
        """The trajectories of a take; frames that it skips are there too, without samples."""
        first = int(points.frames[0]) if len(points.frames) else 0
        frames = int(points.frames[-1]) - first + 1 if len(points.frames) else 0
        order = np.argsort(points.track, kind="stable")
        tracks, starts = np.unique(points.track[order], return_index=True)
        made = []
        for track, rows in zip(tracks.tolist(), np.split(order, starts[1:]), strict=True) if len(order) else ():
            at = points.frame[rows] - first
            samples = blank(frames, HELD)
            for name in ("xyz_mm", "sigma_mm", "kind"):
                samples[name][at] = getattr(points, name)[rows]
            samples["residual"][at], samples["row"][at] = points.residual_px[rows], rows
            made.append(Trajectory(int(track), str(points.label[rows[0]]), samples))
        return Sheet(first, frames, points.rate_hz, made, points.source)

    def span(self, within: Range) -> tuple[int, int]:
        """Rows of the frames of a range: the first, and one past the last."""
        low, high = max(within.first - self.first, 0), min(within.last - self.first + 1, self.count)
        if low >= high:
            raise InputError(f"frames {within.first} to {within.last} are not in the take ({self._frames()})")
        return low, high

    def _frames(self) -> str:
        return f"frames {self.first} to {self.first + self.count - 1}"

    def find(self, at: At) -> int:
        """The trajectory at a place in a frame; raises ``InputError`` where there is none, or two could be meant."""
        row = at.frame - self.first
        if not 0 <= row < self.count:
            raise InputError(f"frame {at.frame} is not in the take ({self._frames()})")
        places = np.array([t.xyz_mm[row] for t in self.trajectories]).reshape(-1, 3)
        away = np.linalg.norm(places - np.array(at.xyz_mm), axis=1)
        near = np.flatnonzero(away <= SAME_MM)
        place = "({:.1f}, {:.1f}, {:.1f}) mm".format(*at.xyz_mm)
        if len(near) == 0:
            raise InputError(f"there is no marker at {place} in frame {at.frame}")
        best = int(near[np.argmin(away[near])])
        if np.sum(away <= 2.0 * max(away[best], 1e-6)) > 1:
            raise InputError(f"two markers are near {place} in frame {at.frame}: which one is meant cannot be told")
        return best

    def at(self, slot: int, frame: int) -> At:
        """How an edit points at a trajectory: by its sample in this frame, or in the nearest that has one."""
        seen = np.flatnonzero(self.trajectories[slot].kind != ABSENT)
        if len(seen) == 0:
            raise InputError(f"{self.name(slot)} has no samples")
        row = int(seen[np.argmin(np.abs(seen - (frame - self.first)))])
        x, y, z = self.trajectories[slot].xyz_mm[row].tolist()
        return At(frame=row + self.first, xyz_mm=(x, y, z))

    def name(self, slot: int) -> str:
        """What a trajectory is called: its label, or its number after a star."""
        one = self.trajectories[slot]
        return one.label or f"*{one.track}"

    def labelled(self, label: str) -> int | None:
        """The trajectory with a label."""
        return next((i for i, t in enumerate(self.trajectories) if t.label == label), None)

    def window(self, low: int, high: int, slots: list[int] | None = None) -> Points:
        """The points of some frames (rows ``low`` to before ``high``), for what works on points."""
        low, high = max(low, 0), min(high, self.count)
        some = range(len(self.trajectories)) if slots is None else slots
        parts = [(s, np.flatnonzero(self.trajectories[s].kind[low:high] != ABSENT) + low) for s in some]
        frame = np.concatenate([rows for _, rows in parts] or [np.zeros(0, np.int64)])
        slot = np.concatenate([np.full(len(rows), s) for s, rows in parts] or [np.zeros(0, np.int64)])

        def column(name: str) -> NDArray[Any]:
            one = [self.trajectories[s].samples[name][rows] for s, rows in parts]
            return np.concatenate(one) if one else np.zeros((0, 3) if name == "xyz_mm" else 0)

        order = np.lexsort((slot, frame))
        labels = np.array([t.label for t in self.trajectories] or [""], dtype=str)
        return Points.of(
            (frame[order] + self.first).astype(np.int64),
            slot[order].astype(np.int64),
            column("xyz_mm")[order].astype(float),
            label=labels[slot[order].astype(np.int64)],
            sigma_mm=column("sigma_mm")[order].astype(float),
            kind=column("kind")[order].astype(np.int64),
            rate_hz=self.rate_hz,
            frames=np.arange(low, high) + self.first,
            source=self.source,
        )

    def as_points(self, points: Points) -> Points:
        """The take as points again; samples that are as they were keep everything that ``points`` knows of them."""
        rows = [np.flatnonzero(t.kind != ABSENT) for t in self.trajectories]
        frame = np.concatenate([*rows, np.zeros(0, np.int64)]).astype(np.int64)
        slot = np.repeat(np.arange(len(rows)), [len(r) for r in rows])
        track = np.array([t.track for t in self.trajectories], np.int64)[slot]
        order = np.lexsort((track, frame))

        def column(name: str, empty: NDArray[Any]) -> NDArray[Any]:
            parts = [t.samples[name][r] for t, r in zip(self.trajectories, rows, strict=True)]
            return np.concatenate([empty, *parts])[order]

        source = column("row", np.zeros(0, np.int64))
        new = source < 0
        kept = points.keep(np.where(new, 0, source)) if len(points) else points
        labels = np.array([t.label for t in self.trajectories] or [""], dtype=str)

        def known(values: NDArray[Any], otherwise: float) -> NDArray[Any]:
            return np.where(new, otherwise, values).astype(values.dtype) if len(points) else values

        return replace(
            kept,
            frame=frame[order] + self.first,
            track=track[order],
            label=labels[slot[order]],
            xyz_mm=column("xyz_mm", np.zeros((0, 3))),
            sigma_mm=column("sigma_mm", np.zeros(0)),
            kind=column("kind", np.zeros(0, np.int64)).astype(np.int64),
            rays=known(kept.rays, 0),
            residual_px=column("residual", np.zeros(0)),
            confidence=known(kept.confidence, np.nan),
            residual_mm=known(kept.residual_mm, np.nan),
            camera_mask=known(kept.camera_mask, 0),
            label_probability=known(kept.label_probability, np.nan),
            frames=points.frames,
        )


def blank(frames: int, names: tuple[str, ...]) -> Samples:
    """Samples of a trajectory that has none."""
    kinds = {"kind": np.int8, "row": np.int64, "origin": np.int64}
    shape = {"xyz_mm": (frames, 3)}
    return {n: np.full(shape.get(n, (frames,)), BLANK[n], kinds.get(n, np.float64)) for n in names}


@dataclass
class Changes:
    """Writes into a sheet, and keeps what was there: ``take_back`` makes everything as it was."""

    sheet: Sheet
    before: list[tuple[int, int, Samples]] = field(default_factory=list)
    labels: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Remember who is called what."""
        self.labels = [t.label for t in self.sheet.trajectories]

    def write(self, slot: int, low: int, samples: Samples) -> None:
        """Samples of a trajectory from row ``low`` on."""
        one = self.sheet.trajectories[slot]
        part = slice(low, low + len(next(iter(samples.values()))))
        self.before.append((slot, low, {n: v[part].copy() for n, v in one.samples.items()}))
        for name, values in samples.items():
            one.samples[name][part] = values
        one.version = next(VERSIONS)

    def clear(self, slot: int, low: int, high: int) -> None:
        """No samples from row ``low`` to before ``high``."""
        self.write(slot, low, blank(high - low, tuple(self.sheet.trajectories[slot].samples)))

    def copy(self, slot: int, low: int, high: int) -> Samples:
        """The samples of some rows."""
        return {n: v[low:high].copy() for n, v in self.sheet.trajectories[slot].samples.items()}

    def rename(self, slot: int, label: str) -> None:
        """Give a trajectory a label, or none."""
        self.sheet.trajectories[slot].label = label
        self.sheet.trajectories[slot].version = next(VERSIONS)

    def new(self, label: str = "") -> int:
        """A trajectory without samples; returns its place."""
        sheet = self.sheet
        names = tuple(sheet.trajectories[0].samples)
        track = 1 + max(t.track for t in sheet.trajectories)
        sheet.trajectories.append(Trajectory(track, label, blank(sheet.count, names)))
        return len(sheet.trajectories) - 1

    def take_back(self) -> None:
        """Undo everything that was written."""
        sheet = self.sheet
        for slot, low, samples in reversed(self.before):
            if slot < len(self.labels):
                for name, values in samples.items():
                    sheet.trajectories[slot].samples[name][low : low + len(values)] = values
        del sheet.trajectories[len(self.labels) :]
        for one, label in zip(sheet.trajectories, self.labels, strict=True):
            one.label = label
            one.version = next(VERSIONS)
