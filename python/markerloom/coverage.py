"""What a rig will be worth before it is bought: cameras per point and the accuracy to expect, over the whole volume."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from markerloom import html_report, pictures
from markerloom.errors import InputError
from markerloom.formats import table_file
from markerloom.rig import Rig

Array = NDArray[np.floating[Any]]
Box = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]

CELLS = 40
"""Along the longest side of the volume."""
LEAST_DOT_PX = 2.0
"""A camera does not see a marker whose image is smaller across."""
HALF_STEP_M = 1e-4
SHADES = ("#2c105c", "#711f81", "#b63679", "#ee605e", "#fdae78", "#fcfdbf")
NONE = "#e4e8ec"


@dataclass(frozen=True)
class Coverage:
    """A map over a grid: ``axes_m`` (x, y, z of the cells' middles), ``cameras`` and ``sigma_mm`` (nx, ny, nz).

    ``sigma_mm`` = √trace of the covariance of a point that all cameras which can see it do see; infinite where fewer
    than two do.
    """

    rig: Rig
    axes_m: tuple[Array, Array, Array]
    cameras: NDArray[np.int64]
    sigma_mm: Array
    report: dict[str, Any]


def coverage(rig: Rig, *, sigma_px: float = 0.1, marker_mm: float = 14.0, volume_m: Box | None = None) -> Coverage:
    """Predict how well a rig will measure.

    ``sigma_px``: noise of a dot (px per axis). ``marker_mm``: diameter; a camera sees a marker in its image whose dot
    is 2 px across or more. ``volume_m``: ((x, x), (y, y), (z, z)); by default what the cameras look at, from the floor
    (z = 0) to their height. Nothing hides a marker from a camera: bodies will. The accuracy is that of least squares
    from all views (Hartley & Zisserman 2003, §5.2); the calibration counts as perfect.
    """
    if not sigma_px > 0 or not marker_mm > 0:
        raise InputError(f"sigma_px {sigma_px} and marker_mm {marker_mm} must be above 0")
    box = volume_m or _looked_at(rig)
    if any(low >= high for low, high in box):
        raise InputError(f"the volume {box} is empty: every range goes from small to large")
    step = max(high - low for low, high in box) / CELLS
    axes = [low + step * (np.arange(max(1, round((high - low) / step))) + 0.5) for low, high in box]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    seen, information = np.zeros((len(rig), len(points)), bool), np.zeros((len(points), 3, 3))
    for i in range(len(rig)):
        seen[i] = _sees(rig, i, points, marker_mm / 1000.0)
        jacobian = _by_point(rig, i, points[seen[i]]) / sigma_px
        information[seen[i]] += np.einsum("nri,nrj->nij", jacobian, jacobian)
    shape = tuple(len(a) for a in axes)
    sigma = np.full(len(points), np.inf)
    enough = seen.sum(axis=0) >= 2
    sigma[enough] = 1000.0 * np.sqrt(np.trace(np.linalg.pinv(information[enough]), axis1=1, axis2=2))
    report = _report(rig, box, seen, sigma, sigma_px, marker_mm)
    return Coverage(rig, (axes[0], axes[1], axes[2]), seen.sum(axis=0).reshape(shape), sigma.reshape(shape), report)


def save_coverage(found: Coverage, folder: str | Path) -> None:
    """Write ``coverage.html`` with pictures, and every cell as ``coverage.parquet``."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    x, y, z = np.meshgrid(*found.axes_m, indexing="ij")
    columns = {"x_m": x, "y_m": y, "z_m": z, "cameras": found.cameras, "sigma_mm": found.sigma_mm}
    table_file.write(pa.table({k: v.ravel() for k, v in columns.items()}), folder / "coverage.parquet")
    html_report.write(folder / "coverage.html", "What this rig will be worth", *_sections(found))


def _looked_at(rig: Rig) -> Box:
    """Around the place nearest to all optical axes, as far as the cameras are from it on average."""
    axes = np.array([c.rotation[2] for c in rig.cameras])
    places = np.array([c.position_m for c in rig.cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    middle = np.linalg.lstsq(across.sum(axis=0), (across @ places[:, :, None]).sum(axis=0)[:, 0], rcond=None)[0]
    reach = float(np.median(np.linalg.norm((places - middle)[:, :2], axis=1)))
    low, high = min(0.0, float(places[:, 2].min())), float(places[:, 2].max())
    if high - low < reach / 2:
        low, high = float(middle[2]) - reach / 2, float(middle[2]) + reach / 2
    x, y = float(middle[0]), float(middle[1])
    return (x - reach, x + reach), (y - reach, y + reach), (low, high)


def _sees(rig: Rig, camera: int, points: Array, marker_m: float) -> NDArray[np.bool_]:
    one = rig.cameras[camera]
    depth = (points - one.position_m) @ one.rotation[2]
    big = marker_m * one.focal_px[0] >= LEAST_DOT_PX * np.maximum(depth, 1e-9)
    return rig.core.sees(camera, np.ascontiguousarray(points)) & big


def _by_point(rig: Rig, camera: int, points: Array) -> Array:
    steps = HALF_STEP_M * np.eye(3)
    sides = [(rig.project(camera, points + s) - rig.project(camera, points - s)) / (2 * HALF_STEP_M) for s in steps]
    return np.nan_to_num(np.stack(sides, axis=2))


def _report(rig: Rig, box: Box, seen: Array, sigma: Array, sigma_px: float, marker_mm: float) -> dict[str, Any]:
    count = seen.sum(axis=0)
    whole = float(np.prod([high - low for low, high in box]))
    well = count >= 3
    return {
        "cameras": len(rig),
        "sigma_px": sigma_px,
        "marker_mm": marker_mm,
        "volume_m": [list(side) for side in box],
        "volume_m3": whole,
        "share_by_cameras": {str(k): float(np.mean(count >= k)) for k in range(2, min(len(rig), 6) + 1)},
        "sigma_mm_by_two": _quantiles(sigma[count >= 2]),
        "sigma_mm_by_three": _quantiles(sigma[well]),
        "volume_by_three_m3": whole * float(np.mean(well)),
        "share_by_camera": {c.id: float(np.mean(seen[i])) for i, c in enumerate(rig.cameras)},
        "warnings": [
            f"camera {c.id} sees nothing of the volume" for i, c in enumerate(rig.cameras) if not seen[i].any()
        ],
    }


def _quantiles(values: Array) -> dict[str, float]:
    if len(values) == 0:
        return {"best": float("nan"), "median": float("nan"), "p95": float("nan")}
    return {"best": float(values.min()), "median": float(np.median(values)), "p95": float(np.percentile(values, 95))}


def _sections(found: Coverage) -> list[str]:
    report = found.report
    three = report["sigma_mm_by_three"]
    rows = [
        ["volume looked at", " × ".join(f"{high - low:.2f}" for low, high in report["volume_m"]) + " m"],
        *[[f"seen by {k} cameras or more", f"{share:.1%}"] for k, share in report["share_by_cameras"].items()],
        ["expected error there (3 or more), median", f"{three['median']:.3f} mm"],
        ["95 % of it below", f"{three['p95']:.3f} mm"],
    ]
    note = (
        f"Markers of {report['marker_mm']:g} mm, dots with {report['sigma_px']:g} px of noise, a perfect calibration, "
        "nothing that hides a marker."
    )
    parts = [html_report.note(note), html_report.table(["what", "value"], rows)]
    parts += [html_report.note(f"Note: {text}.") for text in report["warnings"]]
    heights = np.unique(np.linspace(0, len(found.axes_m[2]) - 1, 5).round().astype(int)[1:4])
    accuracy = [_slice(found, k, "sigma") for k in heights]
    cameras = [_slice(found, k, "cameras") for k in heights]
    parts.append(html_report.section("Expected error", *accuracy))
    parts.append(html_report.section("Cameras that see a marker", *cameras))
    share = {name: 100.0 * value for name, value in report["share_by_camera"].items()}
    bars = pictures.bars(share, "%", "share of the volume that each camera sees")
    parts.append(html_report.section("What each camera sees", html_report.figure(bars, "Share of the volume.")))
    return parts


def _slice(found: Coverage, height: int, what: str, width: float = 620.0) -> str:
    """A horizontal slice as a picture: cells in shades, cameras as dots, a legend of the shades' limits."""
    values = found.sigma_mm[:, :, height] if what == "sigma" else found.cameras[:, :, height].astype(float)
    limits = _limits(found, what)
    x, y, z = found.axes_m
    step = float(x[1] - x[0]) if len(x) > 1 else float(y[1] - y[0])
    low = np.array([min(x[0], *_places(found, 0)), min(y[0], *_places(found, 1))]) - step
    high = np.array([max(x[-1], *_places(found, 0)), max(y[-1], *_places(found, 1))]) + step
    scale = (width - 140) / float(high[0] - low[0])
    tall = scale * float(high[1] - low[1])
    body = []
    for i, j in np.ndindex(values.shape):
        left, top = scale * (x[i] - step / 2 - low[0]), tall - scale * (y[j] + step / 2 - low[1])
        side = scale * step + 0.4
        shade = _shade(float(values[i, j]), limits, what)
        body.append(f"<rect x='{left:.1f}' y='{top:.1f}' width='{side:.1f}' height='{side:.1f}' fill='{shade}'/>")
    for camera in found.rig.cameras:
        at = scale * (camera.position_m[:2] - low)
        body.append(pictures.dot(at[0], tall - at[1], 5, pictures.BLUE))
    body += _legend(limits, what, width - 125)
    unit = "expected error (mm)" if what == "sigma" else "number of cameras"
    title = f"{unit} at a height of {z[height]:.2f} m"
    return html_report.figure(pictures.svg(width, tall, body, title), f"{title}, from above; blue: cameras.")


def _places(found: Coverage, axis: int) -> list[float]:
    return [float(c.position_m[axis]) for c in found.rig.cameras]


def _limits(found: Coverage, what: str) -> Array:
    """Upper limits of the shades but the last."""
    if what == "cameras":
        return np.array([2, 3, 4, 6, 8], float)
    finite = found.sigma_mm[np.isfinite(found.sigma_mm)]
    return np.quantile(finite, [0.1, 0.3, 0.6, 0.85, 0.97]) if len(finite) else np.arange(1.0, 6.0)


def _shade(value: float, limits: Array, what: str) -> str:
    if not np.isfinite(value) or (what == "cameras" and value < 2):
        return NONE
    index = int(np.searchsorted(limits, value, side="right"))
    return SHADES[len(SHADES) - 1 - index] if what == "sigma" else SHADES[index]


def _legend(limits: Array, what: str, left: float) -> list[str]:
    body = []
    if what == "sigma":
        names = [f"under {limits[0]:.2f}", *(f"{a:.2f}-{b:.2f}" for a, b in pairwise(limits))]
        rows = [*zip([*names, f"over {limits[-1]:.2f}"], SHADES[::-1], strict=True), ("fewer than 2", NONE)]
    else:
        rows = [("2", SHADES[1]), ("3", SHADES[2]), ("4-5", SHADES[3]), ("6-7", SHADES[4]), ("8 or more", SHADES[5])]
        rows = [*rows, ("fewer than 2", NONE)]
    for k, (name, shade) in enumerate(rows):
        y = 10 + 20 * k
        body.append(f"<rect x='{left:.0f}' y='{y}' width='14' height='14' fill='{shade}' stroke='{pictures.GRID}'/>")
        body.append(pictures.text(left + 20, y + 12, name))
    return body
