"""Pictures of motions as SVG: figures over time, before and after; curves; ways over the floor; bands."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom import pictures
from markerloom.skeleton.motion import Motion

Array = NDArray[np.floating[Any]]
WIDTH = 760.0
BEFORE, AFTER = pictures.GREY, pictures.BLUE
COLORS = (pictures.BLUE, pictures.RED, pictures.GREEN, pictures.AMBER)
SLANT = 0.35
"""How much of the depth is seen sideways."""


def _bones(motion: Motion, frame: int) -> list[tuple[Array, Array]]:
    one = Motion(motion.skeleton, motion.root_m[frame : frame + 1], motion.turns[frame : frame + 1], motion.rate_hz)
    places, sites = one.joints_m()[0], one.sites_m()[0]
    bones = [(places[p], places[j]) for j, p in enumerate(motion.skeleton.parents) if p >= 0]
    return bones + [(places[s.joint], sites[i]) for i, s in enumerate(motion.skeleton.sites)]


def strip(
    motions: Sequence[tuple[Motion, str]],
    moments: Sequence[float],
    title: str,
    *,
    height: float = 220.0,
    along: bool = False,
) -> str:
    """Figures of one or several motions (with their colours) at moments (parts of their length, 0 to 1).

    Side by side, each where it stands in its cell; or, ``along``, where they are on their way, seen from the side.
    """
    frames = [[min(round(t * (len(m) - 1)), len(m) - 1) for t in moments] for m, _ in motions]
    shown = [[_bones(m, f) for f in own] for (m, _), own in zip(motions, frames, strict=True)]
    heights = np.array([end[2] for own in shown for bones in own for bone in bones for end in bone])
    low, tall = float(heights.min()), max(float(np.ptp(heights)), 1e-6)
    scale = (height - 40.0) / tall
    across = _view(motions[0][0])
    places = np.array([end @ across for own in shown for bones in own for bone in bones for end in bone])
    if along:
        scale = min(scale, (WIDTH - 40.0) / max(float(np.ptp(places)), 1e-6))
    body = [pictures.line((0, height - 24), (WIDTH, height - 24), pictures.GRID)]
    for k, t in enumerate(moments):
        middle = (k + 0.5) * WIDTH / len(moments)
        for (motion, color), own, at in zip(motions, shown, frames, strict=True):
            hips = motion.root_m[at[k]] @ across
            for a, b in own[k]:
                ends = []
                for p in (a, b):
                    x = 20.0 + scale * (p @ across - places.min()) if along else middle + scale * (p @ across - hips)
                    ends.append((x, height - 24 - scale * (p[2] - low)))
                body.append(pictures.line(ends[0], ends[1], color, 2))
            if not along and motion is motions[0][0]:
                seconds = frames[0][k] / motion.rate_hz
                body.append(
                    pictures.text(
                        middle, height - 6, f"{t if len(motion) < 2 else seconds:.2f} s", size=10, anchor="middle"
                    )
                )
    return pictures.svg(WIDTH, height, body, title)


def _view(motion: Motion) -> Array:
    """The direction on the floor that is drawn to the right: where somebody goes, or their left side; a bit aslant."""
    way = motion.root_m[-1] - motion.root_m[0]
    way[2] = 0.0
    if np.linalg.norm(way) < 0.5:
        way = np.array([1.0, 0.0, 0.0])
    way = way / np.linalg.norm(way)
    side = np.array([-way[1], way[0], 0.0])
    return way * np.sqrt(1.0 - SLANT**2) + side * SLANT


def curves(
    rows: Sequence[tuple[str, Array, str]], rate_hz: float, unit: str, title: str, *, height: float = 200.0
) -> str:
    """Curves over time in one picture: label, values, colour."""
    longest = max(len(values) for _, values, _ in rows)
    low = min(float(np.nanmin(values)) for _, values, _ in rows)
    high = max(float(np.nanmax(values)) for _, values, _ in rows)
    span = max(high - low, 1e-9)
    left, top, bottom = 56.0, 24.0, height - 22.0

    def pixel(f: int, value: float) -> tuple[float, float]:
        return left + (WIDTH - left - 10.0) * f / max(longest - 1, 1), bottom - (bottom - top) * (value - low) / span

    body = [pictures.line((left, bottom), (WIDTH - 10, bottom), pictures.GRID)]
    for value in (low, high):
        body.append(pictures.text(left - 6, pixel(0, value)[1] + 4, f"{value:.3g}", size=10, anchor="end"))
    body.append(pictures.text(4, 14, unit, size=10))
    seconds = (longest - 1) / rate_hz
    body += [
        pictures.text(left, height - 6, "0 s", size=10),
        pictures.text(WIDTH - 10, height - 6, f"{seconds:.2f} s", size=10, anchor="end"),
    ]
    at = left
    for label, values, color in rows:
        step = max(1, len(values) // 1500)
        points = " ".join("{:.1f},{:.1f}".format(*pixel(f, float(values[f]))) for f in range(0, len(values), step))
        body.append(f"<polyline points='{points}' fill='none' stroke='{color}' stroke-width='1.5'/>")
        body.append(pictures.text(at, 14, label, size=11, color=color))
        at += 7.0 * len(label) + 20.0
    return pictures.svg(WIDTH, height, body, title)


def floor_plan(ways: Sequence[tuple[str, Array, str]], title: str, *, height: float = 260.0) -> str:
    """Ways over the floor seen from above (points, 2; m): label, way, colour."""
    points = np.concatenate([way for _, way, _ in ways])
    low, high = points.min(axis=0), points.max(axis=0)
    scale = min((WIDTH - 60.0) / max(high[0] - low[0], 0.1), (height - 60.0) / max(high[1] - low[1], 0.1))
    middle = (low + high) / 2

    def pixel(p: Array) -> tuple[float, float]:
        x, y = scale * (p - middle)
        return WIDTH / 2 + float(x), height / 2 + 10 - float(y)

    body, at = [], 10.0
    for label, way, color in ways:
        text = " ".join("{:.1f},{:.1f}".format(*pixel(p)) for p in way[:: max(1, len(way) // 1500)])
        body.append(f"<polyline points='{text}' fill='none' stroke='{color}' stroke-width='2'/>")
        body.append(pictures.text(at, 14, label, size=11, color=color))
        at += 7.0 * len(label) + 20.0
    metre = WIDTH - 20 - scale
    body += [pictures.line((metre, height - 8), (WIDTH - 20, height - 8), pictures.INK, 2)]
    body.append(pictures.text(WIDTH - 20, height - 12, "1 m", size=10, anchor="end"))
    return pictures.svg(WIDTH, height, body, title)
