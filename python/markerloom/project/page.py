"""A page for every take, and one table over all takes of a project."""

from __future__ import annotations

import csv
import io
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from markerloom import html_report as html
from markerloom import pictures
from markerloom.formats.files import write_text
from markerloom.points import KINDS, Points
from markerloom.project.settings import Project, TakeSettings
from markerloom.trajectories import Trajectories

WORST = 25


def save_take_page(
    path: Path, settings: TakeSettings, points: Points, reports: dict[str, dict[str, Any]], *, view: str = ""
) -> None:
    """Write ``report.html``: completeness of names, gaps and their fills, residuals, warnings; ``view``: a page beside
    it in which the take can be looked at.
    """
    take = Trajectories.of(points)
    sections = [html.frame(view, "The take: play, turn, select")] if view else []
    sections.append(html.section("At a glance", _glance(take, reports)))
    warnings = [w for r in reports.values() for w in r.get("warnings", [])]
    if warnings:
        sections.append(html.section("Warnings", *(html.note(w) for w in warnings)))
    sections.append(html.section("Every marker over time", _timeline(take)))
    labels = reports.get("label", {}).get("labels")
    if labels:
        frames = max(len(take.frames), 1)
        rows = [
            [name, f"{100 * v['frames'] / frames:.1f} %", f"{v['probability']:.3f}"]
            for name, v in sorted(labels.items(), key=lambda item: item[1]["frames"])
        ]
        sections.append(html.section("Names", html.table(["marker", "named", "mean probability"], rows)))
    sections += _gaps(reports.get("fill", {}))
    html.write(path, f"{settings.name}", *sections)


def _glance(take: Trajectories, reports: dict[str, dict[str, Any]]) -> str:
    rows = [["frames", str(len(take.frames))], ["trajectories", str(len(take.names))]]
    for kind in KINDS:
        share = float(np.mean(take.kind == KINDS.index(kind))) if take.kind.size else 0.0
        if share:
            rows.append([f"{kind} samples", f"{100 * share:.2f} %"])
    track = reports.get("track", {})
    if "residual_px" in track:
        rows.append(["residual, median", f"{track['residual_px']['median']:.3f} px"])
    named = reports.get("label", {})
    if "completeness" in named:
        rows.append(["named", f"{100 * named['completeness']:.2f} % of the marker-frames"])
        rows.append(["points without a name", f"{named['unlabelled_per_frame']:.2f} per frame"])
    solved = reports.get("solve", {})
    if solved:
        off = solved["residual_mm"]
        rows.append(["markers from the skeleton", f"{off['rms']:.2f} mm rms (see skeleton.html)"])
    fills = reports.get("fill", {})
    if fills:
        rows.append(["gaps", f"{fills['gaps']}, {len(fills['filled'])} of them filled"])
    return html.table(["", ""], rows)


def _timeline(take: Trajectories) -> str:
    named = [i for i, name in enumerate(take.names) if not name.startswith("*")] or list(range(len(take.names)))
    colors = {0: "#2f6f9f", 1: "#e0a030", 2: "#58a55c", 3: "#8a5fb0"}
    row_height, left, width = 12.0, 90.0, 760.0
    per_frame = (width - left) / max(len(take.frames), 1)
    body = []
    for row, slot in enumerate(named):
        y = 8.0 + row * row_height
        body.append(pictures.text(left - 6, y + 8, take.names[slot], size=9, anchor="end"))
        kinds = take.kind[:, slot]
        edges = np.flatnonzero(np.diff(np.r_[-9, kinds, -9]))
        for a, b in pairwise(edges.tolist()):
            if kinds[a] in colors:
                x0, x1 = left + a * per_frame, left + b * per_frame
                middle = y + row_height / 2
                body.append(pictures.line((x0, middle), (max(x1, x0 + 0.4), middle), colors[int(kinds[a])], 7))
    height = 16.0 + row_height * len(named)
    picture = pictures.svg(width, height, body, "Every marker over time")
    return html.figure(picture, "Blue: measured; yellow: predicted; green: filled; violet: edited; blank: missing.")


def _gaps(fills: dict[str, Any]) -> list[str]:
    if not fills:
        return []
    worst = sorted(fills["filled"], key=lambda g: -g["expected_mm"])[:WORST]
    rows = [[g["marker"], f"{g['first']} – {g['last']}", g["method"], f"{g['expected_mm']:.2f} mm"] for g in worst]
    found = [
        html.section(
            "Gaps filled, the least certain first", html.table(["marker", "frames", "by", "expected error"], rows)
        )
    ]
    left = sorted(fills["left"], key=lambda g: -g["frames"])[:WORST]
    if left:
        rows = [[g["marker"], f"{g['first']} – {g['last']}", str(g["frames"])] for g in left]
        found.append(html.section("Gaps that stay", html.table(["marker", "frames", "length"], rows)))
    return found


COLUMNS = ("take", "frames", "named", "gaps", "filled", "complete", "residual_px")


def save_quality(
    project: Project, rows: list[dict[str, Any]], failed: list[dict[str, str]], *, others: list[str]
) -> None:
    """Write ``results/quality.csv`` and ``results/report.html``: one line for each take; those of ``others`` stay."""
    folder = project.folder / "results"
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "quality.csv"
    lines = {r["take"]: [*(_cell(r[c]) for c in COLUMNS), str(len(r["warnings"])), ""] for r in rows}
    lines |= {f["take"]: [f["take"], *[""] * len(COLUMNS), f["reason"]] for f in failed}
    if others and file.is_file():
        known = list(csv.reader(io.StringIO(file.read_text("utf-8"))))[1:]
        lines |= {line[0]: line for line in known if len(line) == len(COLUMNS) + 2 and line[0] in others}
    ordered = [lines[name] for name in sorted(lines)]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerows([[*COLUMNS, "warnings", "failed"], *ordered])
    write_text(file, out.getvalue())
    done = [line[:-1] for line in ordered if not line[-1]]
    parts = [html.section("Takes", html.table([*COLUMNS, "warnings"], done))]
    broken = [[line[0], line[-1]] for line in ordered if line[-1]]
    if broken:
        parts.append(html.section("Failed", html.table(["take", "reason"], broken)))
    html.write(folder / "report.html", project.name, *parts)


def _cell(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.4f}" if isinstance(value, float) else str(value)
