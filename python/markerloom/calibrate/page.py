"""A page about a calibration: its verdict, what every camera is worth, where the wand was seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from markerloom import html_report, pictures
from markerloom.calibrate.wand import GRID, Calibration
from markerloom.rig import Camera


def save_calibration_page(calibration: Calibration, path: str | Path) -> None:
    """Write the page."""
    report = calibration.report
    sections = [html_report.note(f"Verdict: {report['verdict']}.")]
    sections += [html_report.note(f"Refused: {reason}.") for reason in report["reasons"]]
    sections += [html_report.note(f"Note: {text}.") for text in report["warnings"]]
    lengths = report["wand_length_mm"]
    facts = [
        ["wand poses", str(report["poses"])],
        ["dots used", f"{report['observations']} ({report['observations_used']:.1%} of those near the wand)"],
        ["reprojection √(RSS/(n−p))", f"{report['reprojection_px']:.4f} px"],
        ["residual on poses left out, median", f"{report['left_out_residual_px']['median']:.4f} px"],
        ["error of wand lengths on poses left out, std", f"{lengths['std']:.3f} mm"],
    ]
    sections.append(html_report.table(["what", "value"], facts))
    sections.append(html_report.section("Cameras", _cameras(calibration)))
    picture = pictures.rig_and_points(calibration.rig, np.zeros((0, 3)), np.zeros((0, 3)), "the rig")
    sections.append(html_report.section("Rig", html_report.figure(picture, "The floor grid has cells of 1 m.")))
    parts = [html_report.figure(_coverage(calibration, c), _caption(c)) for c in calibration.rig.cameras]
    sections.append(html_report.section("Where the wand was seen", *parts))
    html_report.write(path, "Calibration", *sections)


def _cameras(calibration: Calibration) -> str:
    header = ["camera", "views", "coverage", "median px", "rms px", "position ± mm", "angle ± °", "focal ± px"]
    rows = []
    for name, own in calibration.report["cameras"].items():
        numbers = [own.get(k, float("nan")) for k in ("position_sigma_mm", "angle_sigma_deg", "focal_sigma_px")]
        error = own["reprojection_px"]
        row = [name, str(own["views"]), f"{own['coverage']:.0%}", f"{error['median']:.3f}", f"{error['rms']:.3f}"]
        rows.append([*row, *(f"{v:.2g}" for v in numbers)])
    return html_report.table(header, rows)


def _caption(camera: Camera) -> str:
    return f"Camera {camera.id}: every tenth dot of the wand; grid of {GRID} x {GRID} cells."


def _coverage(calibration: Calibration, camera: Camera, width: int = 360) -> str:
    scale = width / camera.size_px[0]
    height = scale * camera.size_px[1]
    body = [f"<rect width='{width}' height='{height:.0f}' fill='{pictures.PAPER}' stroke='{pictures.INK}'/>"]
    for k in range(1, GRID):
        x, y = width * k / GRID, height * k / GRID
        body.append(pictures.line((x, 0), (x, height), pictures.GRID, 0.5))
        body.append(pictures.line((0, y), (width, y), pictures.GRID, 0.5))
    body += [pictures.dot(x * scale, y * scale, 0.8, pictures.BLUE) for x, y in calibration.dots_px[camera.id][::10]]
    return pictures.svg(width, height, body, f"where camera {camera.id} saw the wand")
