"""The plot of docs/results.md: time per frame over cameras and over markers, from the results of `make bench`.

Run after `make bench`: python benches/growth.py
"""

from __future__ import annotations

import json
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np

from markerloom.pictures import BLUE, GREY, GRID, PAPER, dot, line, svg, text

ROOT = Path(__file__).resolve().parents[1]
GROUPS = {
    "growth with cameras, 50 markers": "cameras (50 markers)",
    "growth with markers, 8 cameras": "markers (8 cameras)",
}


def measured(group: str) -> list[tuple[int, float]]:
    """Number and mean milliseconds per frame, as Criterion stored them."""
    folder = ROOT / "target" / "criterion" / group
    found = []
    for path in folder.glob("*/new/estimates.json"):
        mean_ns = json.loads(path.read_text())["mean"]["point_estimate"]
        found.append((int(path.parents[1].name), mean_ns / 1e6))
    return sorted(found)


def panel(points: list[tuple[int, float]], title: str, left: float) -> list[str]:
    """One plot with both axes logarithmic."""
    x = np.log10([p[0] for p in points])
    y = np.log10([p[1] for p in points])
    low, high = np.floor(y.min()), np.ceil(y.max())
    width, height = 280.0, 220.0

    def place(a: float, b: float) -> tuple[float, float]:
        across = (a - x.min()) / max(x.max() - x.min(), 1e-9)
        return left + 50 + across * (width - 20), 30 + height * (1 - (b - low) / max(high - low, 1e-9))

    parts = [text(left + 50, 18, f"ms per frame over {title}", size=12)]
    for decade in np.arange(low, high + 1):
        parts.append(line(place(x.min(), decade), place(x.max(), decade), GRID))
        parts.append(
            text(left + 44, place(x.min(), decade)[1] + 4, f"{10.0**decade:g}", size=10, color=GREY, anchor="end")
        )
    places = [place(a, b) for a, b in zip(x, y, strict=True)]
    parts += [line(a, b, BLUE, 1.5) for a, b in pairwise(places)]
    for (n, ms), at in zip(points, places, strict=True):
        parts += [dot(*at, 3, BLUE), text(at[0], at[1] - 7, f"{ms:.2g}", size=9, anchor="middle")]
        parts.append(text(at[0], 30 + height + 16, str(n), size=10, color=GREY, anchor="middle"))
    return parts


def main() -> None:
    """Write docs/growth.svg and print the numbers."""
    body = [f"<rect width='720' height='285' fill='{PAPER}'/>"]
    for i, (group, title) in enumerate(GROUPS.items()):
        points = measured(group)
        if not points:
            sys.exit(f"no results for '{group}': run make bench first")
        print(title, ", ".join(f"{n}: {ms:.2f} ms" for n, ms in points))
        body += panel(points, title, 360.0 * i)
    (ROOT / "docs" / "growth.svg").write_text(
        svg(720, 285, body, "time per frame over cameras and over markers") + "\n"
    )


if __name__ == "__main__":
    main()
