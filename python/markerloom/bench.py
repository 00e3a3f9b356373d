"""The accuracy figures of docs/results.md: simulated takes, reconstructed and judged, over many seeds."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from markerloom.errors import InputError
from markerloom.evaluate import evaluate, truth_from_assignments
from markerloom.reconstruct import Progress, reconstruct
from markerloom.simulate import make_scene, simulate

FIGURES = (
    "accuracy_3d",
    "accuracy_set",
    "ghosts_per_frame",
    "missing_per_frame",
    "certified",
    "ece",
    "sigma_ratio",
)


@dataclass(frozen=True)
class Row:
    """One row of the table: a scene, a method, a tolerance."""

    name: str
    scene: str = "exp61"
    method: str = "optimal"
    tolerance_mm: float = 30.0
    changes: dict[str, Any] = field(default_factory=dict)


def _rows() -> list[Row]:
    rows = [
        Row("one", changes={"hide": "one"}),
        Row("one-relaxation", method="relaxation", changes={"hide": "one"}),
        Row("quarter", changes={"hide": "quarter"}),
        Row("quarter-relaxation", method="relaxation", changes={"hide": "quarter"}),
        Row("one-elevation-0", changes={"hide": "one", "elevation_deg": 0.0}),
        Row("one-arc-120", changes={"hide": "one", "shape": "arc", "elevation_deg": 0.0, "angle_deg": 120.0}),
    ]
    rows += [
        Row(f"one-sigma-{sigma}", tolerance_mm=5.0, changes={"hide": "one", "sigma_px": sigma})
        for sigma in (0.1, 0.2, 0.3)
    ]
    rows += [
        Row(f"8-cameras-{markers}", scene="cloud", tolerance_mm=5.0, changes={"markers": markers})
        for markers in (33, 100, 200)
    ]
    return rows


ROWS = {row.name: row for row in _rows()}


def choose(names: Sequence[str]) -> list[Row]:
    """Rows by name; all without names."""
    unknown = [n for n in names if n not in ROWS]
    if unknown:
        raise InputError(f"bench has no row '{unknown[0]}'; it has {', '.join(ROWS)}")
    return [ROWS[n] for n in names] or list(ROWS.values())


def measure(row: Row, *, seeds: int, frames: int, progress: Progress | None = None) -> dict[str, Any]:
    """Mean and standard error of each figure over the seeds 0 to ``seeds`` − 1."""
    jobs = [(row, seed, frames) for seed in range(seeds)]
    workers = min(len(jobs), os.cpu_count() or 1)
    results = []
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        for i, result in enumerate(pool.map(_one, jobs)):
            results.append(result)
            if progress:
                progress(i + 1, len(jobs))
    values = {figure: np.array([r[figure] for r in results]) for figure in FIGURES}
    error = 1.0 / np.sqrt(max(seeds, 1))
    return {
        "name": row.name,
        "method": row.method,
        "tolerance_mm": row.tolerance_mm,
        **{f: float(np.mean(v)) for f, v in values.items()},
        **{f"{f}_se": float(np.std(v, ddof=1) * error) if seeds > 1 else float("nan") for f, v in values.items()},
    }


def _one(job: tuple[Row, int, int]) -> dict[str, float]:
    row, seed, frames = job
    take = simulate(make_scene(row.scene, seed=seed, frames=frames, **row.changes))
    points = reconstruct(take.observations, take.rig, method=row.method, threads=1)
    truth = truth_from_assignments(take.truth, take.truth_assignments, take.rig)
    score = evaluate(points, truth, tolerance_mm=row.tolerance_mm, assignments=points.assignments)
    return {
        **{
            f: score[f] for f in ("accuracy_3d", "accuracy_set", "ghosts_per_frame", "missing_per_frame", "sigma_ratio")
        },
        "certified": points.report["certified_frames"],
        "ece": score["confidence_ece"],
    }


def bench(names: Sequence[str] = (), *, seeds: int = 20, frames: int = 200) -> list[dict[str, Any]]:
    """Measure rows of docs/results.md by name; all without names."""
    return [measure(row, seeds=seeds, frames=frames) for row in choose(names)]


HEADER = (
    f"{'row':20}{'3D accuracy %':>18}{'exact sets %':>18}{'ghosts/frame':>18}"
    f"{'certified %':>13}{'ECE':>8}{'(e/sigma)²':>12}"
)


def line(result: dict[str, Any]) -> str:
    """One printed row."""

    def pair(figure: str, factor: float, digits: int) -> str:
        return f"{factor * result[figure]:.{digits}f} ± {factor * result[f'{figure}_se']:.{digits}f}"

    return (
        f"{result['name']:20}{pair('accuracy_3d', 100, 3):>18}{pair('accuracy_set', 100, 3):>18}"
        f"{pair('ghosts_per_frame', 1, 4):>18}{100 * result['certified']:>13.2f}{result['ece']:>8.4f}"
        f"{result['sigma_ratio']:>12.3f}"
    )
