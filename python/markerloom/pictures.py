"""Pictures as SVG text: rig and points in 3D, residuals by camera, ghosts and missing markers over time."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from itertools import pairwise

import numpy as np

from markerloom.rig import Rig

INK, PAPER, GRID = "#1f2933", "#ffffff", "#d5dbe1"
BLUE, RED, GREEN, AMBER, GREY = "#2563eb", "#dc2626", "#16a34a", "#d97706", "#8794a1"
FONT = "font-family='system-ui, sans-serif'"


def svg(width: float, height: float, body: Sequence[str], title: str) -> str:
    """A whole picture."""
    head = f"<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {width:g} {height:g}' role='img'"
    return f"{head} aria-label='{escape(title)}'><title>{escape(title)}</title>{''.join(body)}</svg>"


def text(x: float, y: float, value: str, *, size: float = 12, color: str = INK, anchor: str = "start") -> str:
    """A line of text."""
    return f"<text x='{x:.1f}' y='{y:.1f}' font-size='{size:g}' {FONT} fill='{color}' text-anchor='{anchor}'>{escape(value)}</text>"


def line(start: Sequence[float] | np.ndarray, end: Sequence[float] | np.ndarray, color: str, width: float = 1) -> str:
    """A line between two pixels."""
    (x1, y1), (x2, y2) = start, end
    return f"<line x1='{x1:.1f}' y1='{y1:.1f}' x2='{x2:.1f}' y2='{y2:.1f}' stroke='{color}' stroke-width='{width:g}'/>"


def dot(x: float, y: float, r: float, color: str, *, hollow: bool = False) -> str:
    """A disc or a ring."""
    style = f"fill='none' stroke='{color}' stroke-width='1.5'" if hollow else f"fill='{color}'"
    return f"<circle cx='{x:.1f}' cy='{y:.1f}' r='{r:g}' {style}/>"


class View:
    """A parallel projection of the world (m) seen from above at an angle, fitted into a rectangle."""

    def __init__(self, points_m: np.ndarray, box: tuple[float, float, float, float], azimuth_deg: float = -60) -> None:
        """Fit ``points_m`` (n, 3) into ``box`` = x, y, width, height (px)."""
        azimuth, elevation = np.radians(azimuth_deg), np.radians(22.0)
        right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        toward = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
        self.axes = np.array([right, -np.cross(toward, right)])
        flat = points_m @ self.axes.T
        low, high = flat.min(axis=0), flat.max(axis=0)
        x, y, width, height = box
        self.scale = 0.92 * min(width / max(high[0] - low[0], 1e-9), height / max(high[1] - low[1], 1e-9))
        self.offset = np.array([x + width / 2, y + height / 2]) - self.scale * (low + high) / 2

    def __call__(self, points_m: np.ndarray) -> np.ndarray:
        """Pixels (n, 2) of points (n, 3)."""
        return np.atleast_2d(points_m) @ self.axes.T * self.scale + self.offset


def _floor(view: View, corners: np.ndarray) -> list[str]:
    low, high = np.floor(corners.min(axis=0)[:2]), np.ceil(corners.max(axis=0)[:2])
    parts = []
    for x in np.arange(low[0], high[0] + 1):
        a, b = view(np.array([[x, low[1], 0.0], [x, high[1], 0.0]]))
        parts.append(line(a, b, GRID, 0.7))
    for y in np.arange(low[1], high[1] + 1):
        a, b = view(np.array([[low[0], y, 0.0], [high[0], y, 0.0]]))
        parts.append(line(a, b, GRID, 0.7))
    return parts


def _frustum(view: View, rig: Rig, camera: int, depth_m: float) -> list[str]:
    one = rig.cameras[camera]
    width, height = one.size_px
    corners = np.array([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]], float)
    # Without the lens: in its corners a calibrated one need not have a ray.
    ahead = np.column_stack([(corners - one.principal_px) / one.focal_px, np.ones(4)])
    rays = ahead / np.linalg.norm(ahead, axis=1)[:, None] @ one.rotation
    tips = view(one.position_m + depth_m * rays)
    apex = view(one.position_m)[0]
    parts = [line(apex, tip, BLUE, 0.8) for tip in tips]
    parts += [line(tips[i], tips[(i + 1) % 4], BLUE, 0.8) for i in range(4)]
    return [*parts, text(apex[0] + 4, apex[1] - 4, one.id, size=9, color=BLUE)]


def rig_and_points(
    rig: Rig, points_m: np.ndarray, trails_m: np.ndarray, title: str, size: tuple[int, int] = (760, 420)
) -> str:
    """The rig's cameras, the points of one frame (n, 3) and all points of the frames before as a faint cloud (m, 3)."""
    width, height = size
    places = np.array([c.position_m for c in rig.cameras])
    everything = np.vstack([places, points_m, np.c_[places[:, :2], np.zeros(len(places))]])
    view = View(everything, (0, 24, width, height - 24))
    parts = [f"<rect width='{width}' height='{height}' fill='{PAPER}'/>", *_floor(view, everything)]
    for camera in range(len(rig)):
        parts += _frustum(view, rig, camera, 0.12 * float(np.linalg.norm(np.ptp(places, axis=0))))
    parts += [dot(x, y, 0.8, "#b7c0ca") for x, y in view(trails_m)] if len(trails_m) else []
    parts += [dot(x, y, 3, INK) for x, y in view(points_m)] if len(points_m) else []
    return svg(width, height, [*parts, text(8, 16, title, size=13)], title)


def points_and_truth(
    panels: Sequence[tuple[str, np.ndarray, np.ndarray]],
    truth_m: np.ndarray,
    title: str,
    size: tuple[int, int] = (250, 290),
) -> str:
    """Panels side by side, each a name, points (n, 3) and which of them are ghosts (n,), over the true places (m, 3)."""
    width, height = size
    body = [f"<rect width='{width * len(panels)}' height='{height}' fill='{PAPER}'/>"]
    for k, (name, points_m, ghost) in enumerate(panels):
        view = View(truth_m, (k * width + 12, 40, width - 24, height - 52))
        body.append(
            f"<rect x='{k * width + 4}' y='4' width='{width - 8}' height='{height - 8}' fill='none' stroke='{GRID}'/>"
        )
        body += [dot(x, y, 5, GREEN, hollow=True) for x, y in view(truth_m)]
        inside = (points_m > truth_m.min(axis=0) - 0.3).all(axis=1) & (points_m < truth_m.max(axis=0) + 0.3).all(axis=1)
        for (x, y), bad in zip(view(points_m[inside]), ghost[inside], strict=True):
            body.append(dot(x, y, 2.2, RED if bad else INK))
        body.append(text(k * width + 12, 22, name, size=13))
        body.append(text(k * width + 12, 37, f"{len(points_m)} points, {int(ghost.sum())} ghosts", size=11, color=GREY))
    return svg(width * len(panels), height, body, title)


def bars(values: dict[str, float], unit: str, title: str, width: int = 760) -> str:
    """Horizontal bars with their values."""
    height, top = 20 * len(values) + 34, max([*values.values(), 1e-9])
    body = [f"<rect width='{width}' height='{height}' fill='{PAPER}'/>", text(8, 16, title, size=13)]
    for i, (name, value) in enumerate(values.items()):
        y = 28 + 20 * i
        length = (width - 220) * value / top
        body.append(text(120, y + 12, name, size=11, anchor="end"))
        body.append(f"<rect x='128' y='{y + 2}' width='{length:.1f}' height='13' fill='{BLUE}'/>")
        body.append(text(134 + length, y + 12, f"{value:.3g} {unit}", size=11, color=GREY))
    return svg(width, height, body, title)


def over_time(
    frames: Sequence[int], series: dict[str, tuple[Sequence[float], str]], title: str, width: int = 760
) -> str:
    """Counts per frame as thin bars, one row per series."""
    row, left = 54, 120
    height = row * len(series) + 46
    body = [f"<rect width='{width}' height='{height}' fill='{PAPER}'/>", text(8, 16, title, size=13)]
    step = (width - left - 16) / max(len(frames), 1)
    for k, (name, (values, color)) in enumerate(series.items()):
        base = 28 + row * (k + 1) - 6
        top = max([*values, 1])
        body.append(text(left - 8, base - 14, name, size=11, anchor="end"))
        body.append(text(left - 8, base, f"0 to {top:g}", size=9, color=GREY, anchor="end"))
        body.append(line((left, base), (width - 16, base), GRID))
        for i, value in enumerate(values):
            if value > 0:
                tall = (row - 14) * value / top
                body.append(
                    f"<rect x='{left + i * step:.2f}' y='{base - tall:.1f}' width='{max(step, 1):.2f}' height='{tall:.1f}' fill='{color}'/>"
                )
    first, last = (frames[0], frames[-1]) if len(frames) else (0, 0)
    body += [text(left, height - 4, f"frame {first}", size=10, color=GREY)]
    body += [text(width - 16, height - 4, f"{last}", size=10, color=GREY, anchor="end")]
    return svg(width, height, body, title)


def timeline(
    rows: Sequence[tuple[str, np.ndarray, np.ndarray]], frames: tuple[int, int], title: str, width: int = 760
) -> str:
    """One row per trajectory: a name, frames (n,) and which of them are measured (n,); others are carried."""
    tall = 11 if len(rows) <= 80 else 4
    height, left = tall * len(rows) + 56, 60
    first, last = frames
    step = (width - left - 16) / max(last + 1 - first, 1)
    body = [f"<rect width='{width}' height='{height}' fill='{PAPER}'/>", text(8, 16, title, size=13)]
    for k, (color, name) in enumerate([(BLUE, "measured"), (AMBER, "predicted")]):
        body.append(f"<rect x='{width - 190 + 90 * k}' y='8' width='10' height='9' fill='{color}'/>")
        body.append(text(width - 176 + 90 * k, 16, name, size=10, color=GREY))
    for k, (name, own, measured) in enumerate(rows):
        y = 28 + tall * k
        if tall > 8:
            body.append(text(left - 6, y + 8, name, size=8, color=GREY, anchor="end"))
        for kind, color in [(True, BLUE), (False, AMBER)]:
            for start, stop in _runs(own[measured == kind]):
                x, length = left + (start - first) * step, (stop + 1 - start) * step
                body.append(
                    f"<rect x='{x:.2f}' y='{y}' width='{max(length, 0.6):.2f}' height='{tall - 2}' fill='{color}'/>"
                )
    body.append(text(left, height - 8, f"frame {first}", size=10, color=GREY))
    body.append(text(width - 16, height - 8, f"{last}", size=10, color=GREY, anchor="end"))
    return svg(width, height, body, title)


def _runs(frames: np.ndarray) -> list[tuple[int, int]]:
    """First and last of each stretch without a break."""
    if len(frames) == 0:
        return []
    breaks = np.flatnonzero(np.diff(frames) > 1)
    return list(
        zip(frames[np.r_[0, breaks + 1]].tolist(), frames[np.r_[breaks, len(frames) - 1]].tolist(), strict=True)
    )


def turn(xyz_mm: np.ndarray, measured: np.ndarray, frames: np.ndarray, title: str, width: int = 760) -> str:
    """A path (n, 3) seen in the plane in which it turns, a dot per frame; predicted places are hollow."""
    height = 320
    centred = xyz_mm - xyz_mm.mean(axis=0)
    flat = centred @ np.linalg.svd(centred, full_matrices=False)[2][:2].T
    low, high = flat.min(axis=0), flat.max(axis=0)
    scale = min((width - 80) / max(high[0] - low[0], 1e-9), (height - 100) / max(high[1] - low[1], 1e-9))
    middle = np.array([width / 2, 32 + (height - 60) / 2])
    at = (flat - (low + high) / 2) * scale + middle
    body = [f"<rect width='{width}' height='{height}' fill='{PAPER}'/>", text(8, 16, title, size=13)]
    body += [line(a, b, GRID, 1.5) for a, b in pairwise(at)]
    body += [dot(x, y, 3.2, BLUE if m else AMBER, hollow=not m) for (x, y), m in zip(at, measured, strict=True)]
    for k in (0, len(at) - 1):
        side = "end" if at[k][0] > width / 2 else "start"
        body.append(text(at[k][0], at[k][1] - 9, f"frame {frames[k]}", size=10, color=GREY, anchor=side))
    length = 10.0 ** np.floor(np.log10(max(150.0 / scale, 1e-6)))
    body.append(line((24, height - 16), (24 + length * scale, height - 16), INK, 2))
    body.append(text(30 + length * scale, height - 12, f"{length:g} mm", size=10, color=GREY))
    return svg(width, height, body, title)
