"""How well gaps are filled: markers of real takes hidden, filled by every method, compared with what they were.

python benches/filling.py [FOLDER of labelled takes] [--gaps=N] [--seed=N]

The ways of the package gapfill (pip install gapfill) stand beside ours where it is installed.
"""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

import markerloom as ml
from markerloom.filling import fill
from markerloom.filling.methods import METHODS
from markerloom.filling.surroundings import spreads
from markerloom.hidden import place_on_spheres
from markerloom.trajectories import Trajectories

FOLDER = Path(__file__).resolve().parents[2] / "shared/data/labelling"
TAKES = ("cmu-85_02.c3d", "fullbody-44.c3d", "KneeltoProne01.c3d", "PronetoRun01.c3d")
LENGTHS_S = (0.1, 0.5, 2.0)
AT_ONCE = 4
PEERS = {
    "gapfill interp": ("fill_marker_gap_interp", 0),
    "gapfill pattern": ("fill_marker_gap_pattern", 1),
    "gapfill pattern2": ("fill_marker_gap_pattern2", 1),
    "gapfill rbt": ("fill_marker_gap_rbt", 3),
}
"""Functions of the package gapfill, and how many other markers they need."""


def main() -> None:
    folder = Path(next((a for a in sys.argv[1:] if not a.startswith("--")), FOLDER))
    gaps = int(next((a.split("=")[1] for a in sys.argv if a.startswith("--gaps=")), 40))
    seed = int(next((a.split("=")[1] for a in sys.argv if a.startswith("--seed=")), 0))
    print(f"mean rms of {gaps} gaps per take (mm), seed {seed}; sigma: mean (error/sigma)^2")
    total: dict[tuple[str, float], dict[str, list[float]]] = {}
    honest: dict[tuple[str, float], list[float]] = {}
    for name in TAKES:
        take = Trajectories.of(ml.read_points(folder / name))
        spread = spreads(take.xyz_mm)
        for kind in ("one", "three"):
            for length_s in LENGTHS_S:
                errors, ratios = cell(take, spread, kind == "three", length_s, gaps, seed)
                for method, values in errors.items():
                    total.setdefault((kind, length_s), {}).setdefault(method, []).extend(values)
                honest.setdefault((kind, length_s), []).extend(ratios)
                line = ", ".join(f"{m} {np.mean(v):.2f}" for m, v in errors.items())
                print(f"{name} {kind} {length_s} s: {line}; sigma {np.mean(ratios):.2f}", flush=True)
    for (kind, length_s), errors in total.items():
        means = {m: float(np.mean(v)) for m, v in errors.items()}
        single = min(v for m, v in means.items() if m != "auto")
        line = ", ".join(f"{m} {v:.2f}" for m, v in means.items())
        ratios = np.array(honest[kind, length_s])
        sigma = f"mean {ratios.mean():.2f}, median {np.median(ratios):.2f}, {np.mean(ratios < 4.0):.0%} of the gaps < 4"
        print(f"all {kind} {length_s} s: {line}; auto / best {means['auto'] / single:.3f}; (error/sigma)² {sigma}")


def cell(
    take: Trajectories, spread: np.ndarray, three: bool, length_s: float, gaps: int, seed: int
) -> tuple[dict[str, list[float]], list[float]]:
    """Errors of every method, and the squared ratios of error and sigma of ``auto``, over gaps of one kind."""
    rate = take.points.rate_hz or 100.0
    length = round(length_s * rate)
    rng = np.random.default_rng(seed)
    peers = PEERS if find_spec("gapfill") else {}
    errors: dict[str, list[float]] = {m: [] for m in ("auto", *METHODS, "two spheres", *peers)}
    ratios: list[float] = []
    while len(errors["auto"]) < gaps:
        holes = hidden_stretches(take, spread, rng, three, length)
        xyz_mm = take.xyz_mm.copy()
        for first, slots in holes:
            xyz_mm[first : first + length, slots] = np.nan
        kind = np.where(np.isfinite(xyz_mm).all(axis=2), take.kind, -1)
        broken = take.changed(xyz_mm, take.sigma_mm, kind).as_points()
        for method in ("auto", *METHODS):
            filled = Trajectories.of(fill(broken, method=method, longest_s=10.0))
            for first, slots in holes:
                inside = (slice(first, first + length), slots)
                off = ((filled.xyz_mm[inside] - take.xyz_mm[inside]) ** 2).sum(axis=2)
                errors[method] += np.sqrt(off.mean(axis=0)).tolist()
                if method == "auto":
                    ratios += (off / filled.sigma_mm[inside] ** 2).mean(axis=0).tolist()
        for first, slots in holes:
            errors["two spheres"] += [two_spheres(xyz_mm, take.xyz_mm, spread, s, first, length) for s in slots]
            for peer in peers:
                errors[peer] += [by_peer(peer, xyz_mm, take.xyz_mm, spread, s, first, length) for s in slots]
    return {m: [v for v in values if np.isfinite(v)] for m, values in errors.items()}, ratios


def hidden_stretches(
    take: Trajectories, spread: np.ndarray, rng: np.random.Generator, three: bool, length: int
) -> list[tuple[int, list[int]]]:
    """Stretches far from each other, each with the markers that are hidden in it."""
    frames, markers = take.kind.shape
    found: list[tuple[int, list[int]]] = []
    for _ in range(1000):
        if len(found) == (1 if length > frames // 8 else AT_ONCE):
            break
        marker, first = int(rng.integers(markers)), int(rng.integers(10, frames - length - 10))
        slots = [marker, *(int(s) for s in np.argsort(spread[marker])[:2])] if three else [marker]
        clear = all(abs(first - other) > 3 * length for other, _ in found)
        if clear and np.isfinite(take.xyz_mm[first - 10 : first + length + 10][:, slots]).all():
            found.append((first, slots))
    return found


def two_spheres(
    seen_mm: np.ndarray, true_mm: np.ndarray, spread: np.ndarray, slot: int, first: int, length: int
) -> float:
    """The seed paper's way: on the spheres about the two best links, nearest to the motion's prediction."""
    visible = np.asarray(np.isfinite(seen_mm[first : first + length]).all(axis=(0, 2)))
    links = [int(s) for s in np.argsort(spread[slot]) if visible[s] and s != slot][:2]
    apart = [float(np.nanmean(np.linalg.norm(seen_mm[:, s] - seen_mm[:, slot], axis=1))) for s in links]
    place, before = seen_mm[first - 1, slot], seen_mm[first - 2, slot]
    off = []
    for frame in range(first, first + length):
        found = place_on_spheres(seen_mm[frame, links], apart, 2.0 * place - before)
        before, place = place, found
        off.append(((found - true_mm[frame, slot]) ** 2).sum())
    return float(np.sqrt(np.mean(off)))


def by_peer(
    peer: str, seen_mm: np.ndarray, true_mm: np.ndarray, spread: np.ndarray, slot: int, first: int, length: int
) -> float:
    """A way of the package gapfill, with the most rigid markers that are seen as its donor or cluster."""
    for name, own in (("int", int), ("float", float), ("bool", bool)):
        setattr(np, name, own)  # its last version (0.0.7) asks for names that NumPy has given up
    package: Any = import_module("gapfill")
    function, needed = PEERS[peer]
    around = slice(max(0, first - 10), first + length + 10)
    visible = np.asarray(np.isfinite(seen_mm[around]).all(axis=(0, 2)))
    near = [int(s) for s in np.argsort(spread[slot]) if visible[s] and s != slot][:needed]
    others = [] if not near else [seen_mm[:, near[0]].copy() if needed == 1 else seen_mm[:, near].swapaxes(0, 1).copy()]
    place = seen_mm[:, slot].copy()
    getattr(package, function)(place, *others)
    off = place[first : first + length] - true_mm[first : first + length, slot]
    return float(np.sqrt((off**2).sum(axis=1).mean()))


if __name__ == "__main__":
    main()
