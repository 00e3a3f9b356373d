"""Calib.toml, the dialect of Pose2Sim, anipose and caliscope; markerloom's own additions in [metadata.markerloom].

Every other table is one camera: ``name``, ``size``, ``matrix``, ``distortions`` (OpenCV), ``rotation`` (Rodrigues
vector) and ``translation`` (world to camera, metres unless stated otherwise), ``fisheye``. A lens that OpenCV's model
cannot express exactly is kept under [metadata.markerloom.lenses] beside its best OpenCV fit, and counts as long as
the camera's standard keys are those it was written with.
"""

from __future__ import annotations

import hashlib
import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from scipy.spatial.transform import Rotation

from markerloom.errors import FormatError, InputError
from markerloom.formats.files import read_text, write_text
from markerloom.rig import Camera, Lens, Mask, Rig

NOT_CAMERAS = ("metadata", "capture_volume", "charuco", "checkerboard", "constraints", "intrinsics")
UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2}


def read(path: str | Path, *, units: str = "m") -> Rig:
    """Read a rig."""
    if units not in UNITS:
        raise InputError(f"calibration units '{units}': m, cm or mm")
    try:
        content = tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        raise FormatError(path, f"not a TOML file: {error}") from None
    own = content.get("metadata", {})
    own = own.get("markerloom", {}) if isinstance(own, dict) else {}
    cameras = []
    for section, table in content.items():
        if section in NOT_CAMERAS or not isinstance(table, dict):
            continue
        if "matrix" not in table:
            raise FormatError(path, "no camera matrix", where=f"[{section}]")
        cameras.append(_camera(section, table, own, path, UNITS[units]))
    if not cameras:
        raise FormatError(path, "no camera in it")
    return Rig.of(cameras, source=str(path))


def _array(table: dict[str, Any], key: str, shape: tuple[int, ...], path: str | Path, section: str) -> np.ndarray:
    try:
        value = np.asarray(table[key], dtype=float)
    except KeyError:
        raise FormatError(path, f"{key} is missing", where=f"[{section}]") from None
    except (TypeError, ValueError):
        raise FormatError(path, f"{key} is not numbers", where=f"[{section}]") from None
    if value.shape != shape:
        raise FormatError(path, f"{key} has shape {value.shape}, {shape} expected", where=f"[{section}]")
    return value


def _camera(section: str, table: dict[str, Any], own: dict[str, Any], path: str | Path, unit: float) -> Camera:
    matrix = _array(table, "matrix", (3, 3), path, section)
    if abs(matrix[0, 1]) > 1e-6 * abs(matrix[0, 0]):
        raise FormatError(path, "a skewed sensor is not supported", where=f"[{section}] matrix")
    rotation = Rotation.from_rotvec(_array(table, "rotation", (3,), path, section)).as_matrix()
    translation = _array(table, "translation", (3,), path, section) * unit
    size = _array(table, "size", (2,), path, section)
    extra = own.get("lenses", {}).get(section, {})
    mask = own.get("masks", {}).get(section)
    return Camera(
        id=section,
        name=str(table.get("name", "")),
        size_px=(float(size[0]), float(size[1])),
        focal_px=(float(matrix[0, 0]), float(matrix[1, 1])),
        principal_px=(float(matrix[0, 2]), float(matrix[1, 2])),
        rotation=rotation,
        position_m=-rotation.T @ translation,
        lens=_own_lens(extra, table) or _opencv_lens(table, path, section),
        mask=_own_mask(mask),
    )


def _own_lens(extra: dict[str, Any], table: dict[str, Any]) -> Lens | None:
    if extra.get("standard_keys") != _fingerprint(table):
        return None
    return Lens(str(extra["model"]), tuple(float(v) for v in extra["coefficients"]))


def _own_mask(mask: dict[str, Any] | None) -> Mask | None:
    if mask is None:
        return None
    columns, rows = mask["grid"]
    tiles = np.zeros(columns * rows, bool)
    tiles[np.asarray(mask["covered"], int)] = True
    return Mask(tuple(mask["tile_px"]), (columns, rows), tuple(tiles.tolist()))


def _opencv_lens(table: dict[str, Any], path: str | Path, section: str) -> Lens:
    values = [float(v) for v in np.ravel(table.get("distortions", []))]
    if table.get("fisheye"):
        if len(values) < 4:
            raise FormatError(path, f"{len(values)} fisheye distortions, 4 expected", where=f"[{section}]")
        return Lens("fisheye", tuple(values[:4]))
    if len(values) > 8 and any(values[8:]):
        raise FormatError(path, "thin-prism or tilted distortions are not supported", where=f"[{section}]")
    values = (values + [0.0] * 8)[:8]
    return Lens("brown_conrady", tuple(values)) if any(values) else Lens()


def _fingerprint(table: dict[str, Any]) -> str:
    keys = ("size", "matrix", "distortions", "rotation", "translation", "fisheye")
    plain = {k: table[k].unwrap() if hasattr(table[k], "unwrap") else table[k] for k in keys if k in table}
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()[:16]


def write(
    rig: Rig, path: str | Path, *, quality: dict[str, Any] | None = None, extra: dict[str, Any] | None = None
) -> None:
    """Write a rig for Pose2Sim, anipose, caliscope and markerloom.

    ``quality``: what the calibration is worth, with a table ``cameras`` by id; ``extra``: tables of markerloom's own.
    """
    document = tomlkit.document()
    own: dict[str, Any] = {"version": 1, "up_axis": "z", **(extra or {})}
    if quality is not None:
        own["quality"] = quality | {"cameras": {_section(c): quality["cameras"][c.id] for c in rig.cameras}}
    for camera in rig.cameras:
        section = _section(camera)
        distortions, fisheye, error = _as_opencv(rig, camera)
        table: dict[str, Any] = {
            "name": camera.id,
            "size": [float(v) for v in camera.size_px],
            "matrix": [
                [camera.focal_px[0], 0.0, camera.principal_px[0]],
                [0.0, camera.focal_px[1], camera.principal_px[1]],
                [0.0, 0.0, 1.0],
            ],
            "distortions": distortions,
            "rotation": Rotation.from_matrix(camera.rotation).as_rotvec().tolist(),
            "translation": camera.translation_m.tolist(),
            "fisheye": fisheye,
        }
        document[section] = table
        if camera.lens.model == "vicon_radial":
            lenses = own.setdefault("lenses", {})
            lenses[section] = {
                "model": camera.lens.model,
                "coefficients": list(camera.lens.coefficients),
                "fit_error_px": error,
                "standard_keys": _fingerprint(table),
            }
        if camera.mask is not None:
            covered = np.flatnonzero(camera.mask.tiles).tolist()
            masks = own.setdefault("masks", {})
            masks[section] = {"tile_px": camera.mask.tile_px, "grid": camera.mask.grid, "covered": covered}
    error = 0.0 if quality is None else quality["reprojection_px"]
    document["metadata"] = {"adjusted": False, "error": error, "markerloom": own}
    write_text(path, tomlkit.dumps(document))


def _section(camera: Camera) -> str:
    return camera.id if camera.id.startswith("cam") else f"cam_{camera.id}"


def _as_opencv(rig: Rig, camera: Camera) -> tuple[list[float], bool, float]:
    """OpenCV distortions, whether they are fisheye ones, and the largest error of a fit (px)."""
    model, coefficients = camera.lens.model, list(camera.lens.coefficients)
    if model == "fisheye":
        return coefficients, True, 0.0
    if model == "ideal":
        return [0.0] * 5, False, 0.0
    if model == "brown_conrady":
        return (coefficients if any(coefficients[5:]) else coefficients[:5]), False, 0.0
    return _fit_brown_conrady(rig, camera)


def _fit_brown_conrady(rig: Rig, camera: Camera) -> tuple[list[float], bool, float]:
    """The k1, k2, p1, p2, k3 that reproduce another lens over the sensor, in pixels."""
    width, height = camera.size_px
    x, y = np.meshgrid(np.linspace(0, width - 1, 25), np.linspace(0, height - 1, 25))
    measured = np.column_stack([x.ravel(), y.ravel()])
    ideal = rig.normalise(rig.cameras.index(camera), measured)
    good = np.isfinite(ideal).all(axis=1)
    measured, ideal = measured[good], ideal[good]
    target = (measured - camera.principal_px) / camera.focal_px - ideal
    x, y = ideal.T
    r2 = x * x + y * y
    # The displacement is linear in OpenCV's coefficients.
    by_x = np.column_stack([x * r2, x * r2**2, 2 * x * y, r2 + 2 * x * x, x * r2**3])
    by_y = np.column_stack([y * r2, y * r2**2, r2 + 2 * y * y, 2 * x * y, y * r2**3])
    system = np.vstack([by_x * camera.focal_px[0], by_y * camera.focal_px[1]])
    wanted = np.concatenate([target[:, 0] * camera.focal_px[0], target[:, 1] * camera.focal_px[1]])
    fitted = np.linalg.lstsq(system, wanted, rcond=None)[0]
    return fitted.tolist(), False, float(np.abs(system @ fitted - wanted).max())
