"""A page about a tracked take: a timeline of all trajectories, the sharpest turn, gaps and why they are there."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom import html_report, pictures
from markerloom.explain import CAUSES
from markerloom.points import MEASURED
from markerloom.reconstruct import Reconstruction

Array = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]

TURN_S = 0.25
"""How long a turn is looked at, on each side."""
GAPS_LISTED = 25


def save_track_page(take: Reconstruction, path: str | Path) -> None:
    """Write the page, with pictures inside, for what ``track`` gave."""
    report = take.report
    facts = [
        ["frames", str(report["frames"])],
        ["trajectories", str(report["trajectories"])],
        ["measured points per frame", f"{report['points_per_frame']:.2f}"],
        ["predicted points per frame", f"{report['predicted_per_frame']:.2f}"],
    ]
    sections = [
        html_report.table(["", ""], facts),
        *(html_report.note(f"Warning: {text}") for text in report["warnings"]),
        html_report.section("Timeline", html_report.figure(_timeline(take), "One row per trajectory.")),
    ]
    found = sharpest_turn(take)
    if found is not None:
        track, rows = found
        picture = pictures.turn(
            take.xyz_mm[rows], take.kind[rows] == MEASURED, take.frame[rows], f"trajectory {track} in its sharpest turn"
        )
        sections.append(html_report.section("A sharp turn", html_report.figure(picture, "A dot per frame.")))
    if report.get("gaps"):
        meaning = "; ".join(f"{name} = {text}" for name, text in CAUSES.items())
        causes = html_report.note(f"What the cameras had in the middle of the gap, by their number: {meaning}.")
        sections.append(html_report.section("The longest gaps", causes, _gaps(report["gaps"][:GAPS_LISTED])))
    html_report.write(path, f"Trajectories of {Path(take.source).name or 'a take'}", *sections)


def _timeline(take: Reconstruction) -> str:
    rows = []
    for track in np.unique(take.track).tolist():
        own = take.track == track
        rows.append((str(track), take.frame[own], take.kind[own] == MEASURED))
    return pictures.timeline(rows, (int(take.frames[0]), int(take.frames[-1])), f"{len(rows)} trajectories")


def _gaps(gaps: list[dict[str, Any]]) -> str:
    rows = []
    for gap in gaps:
        cameras = ", ".join(f"{name} {count}" for name, count in gap.get("cameras", {}).items())
        frames = gap["last"] + 1 - gap["first"]
        rows.append([str(gap["track"]), f"{gap['first']}–{gap['last']}", f"{gap['predicted']} of {frames}", cameras])
    return html_report.table(["trajectory", "frames", "predicted", "cameras"], rows)


def sharpest_turn(take: Reconstruction) -> tuple[int, Ints] | None:
    """The trajectory whose velocity turns against itself the most, and its rows around that, if anything moves."""
    half = max(3, round(TURN_S * (take.rate_hz or 100.0)))
    best: tuple[float, int, Ints] | None = None
    for track in np.unique(take.track).tolist():
        rows = np.flatnonzero(take.track == track)
        if len(rows) < 2 * half + 1:
            continue
        xyz_mm, frame = take.xyz_mm[rows], take.frame[rows]
        step = max(1, half // 3)
        before = xyz_mm[step:-step] - xyz_mm[: -2 * step]
        after = xyz_mm[2 * step :] - xyz_mm[step:-step]
        steady = frame[2 * step :] - frame[: -2 * step] == 2 * step
        steady &= take.kind[rows[step:-step]] == MEASURED
        reversal = np.where(steady, -np.einsum("ij,ij->i", before, after), -np.inf)
        at = int(reversal.argmax())
        if reversal[at] > 0 and (best is None or reversal[at] > best[0]):
            middle = at + step
            best = (float(reversal[at]), track, rows[max(middle - half, 0) : middle + half + 1])
    return None if best is None else best[1:]
