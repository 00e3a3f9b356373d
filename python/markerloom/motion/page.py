"""A page that shows what an operation did: figures before and after, joints that changed most, feet, joins, numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom import html_report as html
from markerloom import pictures
from markerloom.motion.body import body_of
from markerloom.motion.drawing import AFTER, BEFORE, COLORS, curves, floor_plan, strip
from markerloom.motion.edited import accelerations
from markerloom.motion.feet import feet_of
from markerloom.motion.rotations import about, reference
from markerloom.skeleton.motion import Motion

Array = NDArray[np.floating[Any]]
MOMENTS = (0.02, 0.2, 0.4, 0.6, 0.8, 0.98)
MOST = 3


def save_edit_page(before: list[Motion], after: Motion, report: dict[str, Any], name: str, path: str | Path) -> None:
    """Write the page. ``before``: the clips that came in; one of the same skeleton and length is laid beside."""
    same = next((m for m in before if m.skeleton.joints == after.skeleton.joints and len(m) == len(after)), None)
    parts = [html.section("At a glance", html.table(["", ""], _rows(after, report)))]
    if report.get("warnings"):
        parts.append(html.section("Warnings", *(html.note(w) for w in report["warnings"])))
    if same is not None:
        picture = strip([(same, BEFORE), (after, AFTER)], MOMENTS, "Before and after")
        parts.append(html.section("Figures", html.figure(picture, "Grey: before; blue: after.")))
        parts.append(html.section("Joints that changed most", *_changed(same, after)))
    else:
        shown = [html.figure(strip([(m, BEFORE)], MOMENTS, Path(m.source).name), Path(m.source).name) for m in before]
        shown.append(html.figure(strip([(after, AFTER)], MOMENTS, name), name))
        parts.append(html.section("Figures", *shown))
    parts.append(html.section("Feet", *_feet(after, same)))
    ways = [("after", after.root_m[:, :2], AFTER)] + ([("before", same.root_m[:, :2], BEFORE)] if same else [])
    parts.append(
        html.section("Way over the floor", html.figure(floor_plan(ways[::-1], "Way over the floor"), "From above."))
    )
    parts.append(
        html.section("Accelerations", html.figure(_sharpest(after, same), "The largest of all joints in each frame."))
    )
    if report.get("joins"):
        rows = [[str(j["from"]), str(j["to"]), f"{j['sharpness']:.2f}"] for j in report["joins"]]
        parts.append(html.section("Joins", html.table(["from frame", "to frame", "times as sharp as its clips"], rows)))
    html.write(path, f"Edited motion: {name}", *parts)


def _rows(motion: Motion, report: dict[str, Any]) -> list[list[str]]:
    rows = [["frames", f"{len(motion)} at {motion.rate_hz:g} Hz"]]
    for key, value in report.items():
        if isinstance(value, bool | int | str):
            rows.append([key.replace("_", " "), str(value)])
        elif isinstance(value, float):
            rows.append([key.replace("_", " "), f"{value:.4g}"])
        elif isinstance(value, dict) and all(isinstance(v, int | float) for v in value.values()):
            rows.append([key.replace("_", " "), ", ".join(f"{k} {v:.3g}" for k, v in value.items())])
    return rows


def _changed(before: Motion, after: Motion) -> list[str]:
    """Curves of the joints whose turns differ most."""
    size = []
    for j in range(len(after.skeleton)):
        off = np.swapaxes(before.turns[:, j], 1, 2) @ after.turns[:, j]
        size.append(float(np.degrees(np.arccos(np.clip((np.trace(off, axis1=1, axis2=2) - 1) / 2, -1, 1))).max()))
    out = []
    for j in np.argsort(size)[::-1][:MOST]:
        if size[j] < 0.01:
            break
        where = reference(before.turns[:, j])
        one, two = np.degrees(about(where, before.turns[:, j])), np.degrees(about(where, after.turns[:, j]))
        axis = int(np.argmax(np.abs(two - one).max(axis=0)))
        rows = [("before", one[:, axis], BEFORE), ("after", two[:, axis], AFTER)]
        name = after.skeleton.joints[j]
        out.append(
            html.figure(curves(rows, after.rate_hz, "°", name), f"{name}, about {'XYZ'[axis]} from its mean pose")
        )
    return out or [html.note("No joint turns in another way.")]


def _feet(after: Motion, before: Motion | None) -> list[str]:
    body = body_of(after.skeleton)
    if body.missing():
        return [html.note(f"Feet cannot be told: no joint for {', '.join(body.missing())}.")]
    feet = feet_of(body)
    world = feet.world_m(after)
    rows = [(name, 1000.0 * world[name][:, 2], COLORS[k % len(COLORS)]) for k, name in enumerate(feet.stand)]
    out = [html.figure(curves(rows, after.rate_hz, "mm", "Heights"), "Heights of heels and balls of the feet")]
    speeds = [
        (
            name,
            1000.0 * np.linalg.norm(np.gradient(world[name][:, :2], axis=0), axis=1) * after.rate_hz,
            COLORS[k % len(COLORS)],
        )
        for k, name in enumerate(feet.stand)
        if len(after) > 1
    ]
    if speeds:
        out.append(html.figure(curves(speeds, after.rate_hz, "mm/s", "Speeds"), "Their speeds over the floor"))
    if before is not None and len(before) > 1:
        old = feet.world_m(before)
        rows = [
            (n, 1000.0 * np.linalg.norm(world[n] - old[n], axis=1), COLORS[k % len(COLORS)])
            for k, n in enumerate(feet.stand)
        ]
        out.append(html.figure(curves(rows, after.rate_hz, "mm", "Moved"), "How far they moved from where they were"))
    return out


def _sharpest(after: Motion, before: Motion | None) -> str:
    rows = [("after", accelerations(after).max(axis=1), AFTER)]
    if before is not None:
        rows.insert(0, ("before", accelerations(before).max(axis=1), pictures.GREY))
    return curves(rows, after.rate_hz, "m/s²", "Accelerations")
