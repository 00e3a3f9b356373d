"""A page for a solved take: the figure, its joint angles, the feet that stand, residuals of markers, bones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from markerloom import html_report as html
from markerloom import pictures
from markerloom.skeleton.isb import joint_angles
from markerloom.skeleton.motion import Motion
from markerloom.skeleton.takes import Solved

FIGURES = 6
WIDTH, LEFT = 760.0, 90.0
SHOWN = ("hip", "knee", "talocrural", "shoulder", "elbow", "radiocarpal")
LEFT_COLOR, RIGHT_COLOR = pictures.BLUE, pictures.RED


def save_motion_page(solved: Solved, path: str | Path) -> None:
    """Write the page."""
    html.write(path, f"Skeleton of {Path(solved.motion.source).name}", *motion_sections(solved))


def motion_sections(solved: Solved) -> list[str]:
    """The parts of the page, for those that hold more than a skeleton."""
    report = solved.report
    off = report["residual_mm"]
    rows = [
        ["skeleton", f"{report['skeleton']}, {report['joints']} joints"],
        ["frames", f"{report['frames']} at {report['rate_hz']:g} Hz"],
        ["markers from the skeleton", f"{off['rms']:.2f} mm rms, {off['median']:.2f} mm median"],
        ["contacts held", str(len(report["contacts"]))],
    ]
    parts = [html.section("At a glance", html.table(["", ""], rows))]
    if report["warnings"]:
        parts.append(html.section("Warnings", *(html.note(w) for w in report["warnings"])))
    parts.append(html.section("The figure", figure_strip(solved.motion)))
    parts.append(html.section("Joint angles", *_angles(solved.motion)))
    if solved.contacts:
        parts.append(html.section("Feet that stand", _contacts(solved)))
    worst = sorted(report["residual_mm_per_marker"].items(), key=lambda item: -item[1])
    parts.append(
        html.section("Residual of each marker", html.table(["marker", "rms, mm"], [[m, f"{v:.2f}"] for m, v in worst]))
    )
    bones = [[joint, f"{length:.1f}"] for joint, length in report["bone_lengths_mm"].items()]
    parts.append(html.section("Bones", html.table(["from the joint above to", "mm"], bones)))
    return parts


def figure_strip(motion: Motion) -> str:
    """The figure at several moments, side by side, seen from the front and the side."""
    places = motion.joints_m()
    sites = motion.sites_m()
    skeleton = motion.skeleton
    step = WIDTH / FIGURES
    height = 240.0
    heights = np.concatenate([places[..., 2].ravel(), sites[..., 2].ravel()])
    low = float(heights.min())
    scale = (height - 30.0) / max(float(heights.max()) - low, 1e-6)
    body = []
    for k, frame in enumerate(np.linspace(0, len(motion) - 1, FIGURES).astype(int)):
        middle = places[frame].mean(axis=0)

        def pixel(p: NDArray[np.floating], k: int = k, middle: NDArray[np.floating] = middle) -> tuple[float, float]:
            across = 0.87 * (p[0] - middle[0]) + 0.5 * (p[1] - middle[1])
            return (k + 0.5) * step + scale * across, height - 14.0 - scale * (p[2] - low)

        bones = [(places[frame, p], places[frame, j], j) for j, p in enumerate(skeleton.parents) if p >= 0]
        bones += [(places[frame, s.joint], sites[frame, i], s.joint) for i, s in enumerate(skeleton.sites)]
        for a, b, j in bones:
            name = skeleton.joints[j].lower()
            color = LEFT_COLOR if name.startswith("l") else RIGHT_COLOR if name.startswith("r") else pictures.INK
            body.append(pictures.line(pixel(a), pixel(b), color, 2))
        seconds = frame / motion.rate_hz
        body.append(pictures.text((k + 0.5) * step, height - 1, f"{seconds:.1f} s", size=10, anchor="middle"))
    picture = pictures.svg(WIDTH, height, body, "The figure over time")
    return html.figure(picture, "Blue: left; red: right.")


def _angles(motion: Motion) -> list[str]:
    found = joint_angles(motion)
    out = []
    for part in SHOWN:
        own = {j: columns for j, columns in found.items() if j.endswith(part)}
        if own:
            out.append(_curves(part, own, motion))
    return out


def _curves(part: str, own: dict[str, list[tuple[str, NDArray[np.floating]]]], motion: Motion) -> str:
    """Three curves per side over time."""
    rows = len(next(iter(own.values())))
    each, body = 74.0, []
    for row in range(rows):
        top = row * each + 6.0
        name = next(iter(own.values()))[row][0]
        values = np.concatenate([columns[row][1] for columns in own.values()])
        low, high = float(values.min()), float(values.max())
        span = max(high - low, 1.0)
        body.append(pictures.text(LEFT - 8, top + 12, f"{high:.0f}°", size=9, anchor="end"))
        body.append(pictures.text(LEFT - 8, top + each - 16, f"{low:.0f}°", size=9, anchor="end"))
        body.append(pictures.text(LEFT + 4, top + 10, name, size=10))
        for joint, columns in own.items():
            angle = columns[row][1]
            picked = np.unique(np.linspace(0, len(angle) - 1, min(len(angle), 600)).astype(int))
            x = LEFT + (WIDTH - LEFT) * picked / max(len(angle) - 1, 1)
            y = top + (each - 14.0) * (1.0 - (angle[picked] - low) / span)
            points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
            color = LEFT_COLOR if joint.startswith("l") else RIGHT_COLOR
            body.append(f"<polyline points='{points}' fill='none' stroke='{color}' stroke-width='1.2'/>")
    height = rows * each + 8.0
    picture = pictures.svg(WIDTH, height, body, part)
    seconds = len(motion) / motion.rate_hz
    return html.figure(picture, f"{part}, ISB, over {seconds:.1f} s. Blue: left; red: right.")


def _contacts(solved: Solved) -> str:
    motion = solved.motion
    sites = sorted({c.site for c in solved.contacts})
    body = []
    for row, site in enumerate(sites):
        y = 14.0 + 16.0 * row
        body.append(pictures.text(LEFT - 6, y + 4, site, size=10, anchor="end"))
        color = LEFT_COLOR if site.startswith("l") else RIGHT_COLOR
        for contact in solved.contacts:
            if contact.site == site:
                ends = [(e - motion.first_frame) / max(len(motion), 1) for e in (contact.start, contact.stop)]
                x0, x1 = (LEFT + (WIDTH - LEFT) * e for e in ends)
                body.append(pictures.line((x0, y), (max(x1, x0 + 0.5), y), color, 8))
    picture = pictures.svg(WIDTH, 20.0 + 16.0 * len(sites), body, "Feet that stand")
    worst = max(c["slides_mm"] for c in solved.report["contacts"])
    sinks = max(c["sinks_mm"] for c in solved.report["contacts"])
    return html.figure(picture, f"While they stand they slide by at most {worst:.2f} mm and sink by {sinks:.2f} mm.")
