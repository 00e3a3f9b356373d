"""Skeletons as TOML: H-Anim in its four levels of articulation, and one's own."""

from __future__ import annotations

import json
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from markerloom.errors import FormatError, InputError
from markerloom.formats.files import read_text, write_text
from markerloom.skeleton.skeleton import LOOSE, NO_LIMIT, Site, Skeleton, in_order

LEVELS = {f"hanim-loa{level}": level for level in (1, 2, 3, 4)}
STATURE_M = 1.75
"""Of H-Anim's skeleton before it is fitted to anybody."""
SHORTEST_M = 1e-4
"""A bone shorter than this has no direction."""


def hanim(level: int) -> Skeleton:
    """H-Anim (ISO/IEC 19774-1) with 18, 71, 94 or 144 joints, at a stature of 1.75 m."""
    text = (resources.files("markerloom.skeleton") / "definitions" / "hanim.toml").read_text("utf-8")
    content = tomllib.loads(text)
    rows = {row["name"]: row for row in content["joints"]}

    def kept(name: str | None) -> str | None:
        while name is not None and rows[name]["loa"] > level:
            name = rows[name].get("parent")
        return name

    def joint(row: dict[str, Any]) -> dict[str, Any]:
        # In level 1 a joint may stand for all that level 2 adds.
        alone = {k.removesuffix("_alone"): v for k, v in row.items() if k.endswith("_alone") and level == 1}
        return {**row, **alone, "parent": kept(row.get("parent"))}

    joints = [joint(row) for row in rows.values() if row["loa"] <= level]
    sites = [{**site, "joint": kept(site["joint"])} for site in content["sites"]]
    names = {row["name"] for row in joints}
    segments = {segment: next((j for j in of if j in names), None) for segment, of in content["segments"].items()}
    made = {
        "name": f"hanim-loa{level}",
        "stature_m": STATURE_M,
        "joints": joints,
        "sites": sites,
        "segments": {segment: joint for segment, joint in segments.items() if joint is not None},
    }
    return _of_content(made, f"hanim-loa{level}")


def read_skeleton(source: str | Path) -> Skeleton:
    """A skeleton by its name (hanim-loa1 … hanim-loa4), or from a .toml, .bvh or .asf."""
    if str(source) in LEVELS:
        return hanim(LEVELS[str(source)])
    kind = Path(source).suffix.lower()
    if kind == ".toml":
        try:
            content = tomllib.loads(read_text(source))
        except tomllib.TOMLDecodeError as error:
            raise FormatError(source, f"not a TOML file: {error}") from None
        return _of_content(content, source)
    if kind in (".bvh", ".asf"):
        from markerloom.skeleton.files import read_skeleton_file

        return read_skeleton_file(source)
    raise InputError(f"skeleton '{source}': {', '.join(LEVELS)}, or a .toml, .bvh or .asf")


def _of_content(content: dict[str, Any], path: str | Path) -> Skeleton:
    rows = content.get("joints")
    if not isinstance(rows, list) or not all(isinstance(r, dict) and isinstance(r.get("name"), str) for r in rows):
        raise FormatError(path, "a skeleton has one [[joints]] table with a name for each joint")
    by_name = {r["name"]: r for r in rows}
    if len(by_name) < len(rows):
        twice = next(r["name"] for i, r in enumerate(rows) if r["name"] in [q["name"] for q in rows[:i]])
        raise FormatError(path, f"joint '{twice}' is there twice")
    names = in_order(list(by_name), {n: r.get("parent") for n, r in by_name.items()}, Path(path).name)
    index = {name: i for i, name in enumerate(names)}
    parents = tuple(index[by_name[n]["parent"]] if by_name[n].get("parent") else -1 for n in names)
    stature = content.get("stature_m")
    places = np.array([_place(by_name[n], stature, path) for n in names])
    offsets = np.array([places[i] - places[p] if p >= 0 else np.zeros(3) for i, p in enumerate(parents)])
    for name, p, offset in zip(names, parents, offsets, strict=True):
        if p >= 0 and np.linalg.norm(offset) < SHORTEST_M:
            raise FormatError(path, f"the bone to joint '{name}' has no length")
    free, limits, habit = (np.array(part) for part in zip(*(_turning(by_name[n], path) for n in names), strict=True))
    sites = [
        Site(s["name"], _known(index, s["joint"], path), tuple(_place(s, stature, path) - places[index[s["joint"]]]))
        for s in content.get("sites", [])
    ]
    return Skeleton(
        name=str(content.get("name", Path(path).stem)),
        joints=tuple(names),
        parents=parents,
        offsets_m=offsets,
        sites=tuple(sites),
        turns_about=tuple(_order(by_name[n], path) for n in names),
        free=free,
        limits_rad=limits,
        habit_rad=habit,
        segments={s: _known(index, j, path) for s, j in content.get("segments", {}).items()},
        aliases={by_name[n]["alias"]: n for n in names if "alias" in by_name[n]},
        orders=tuple(str(by_name[n].get("order", "ZXY")) for n in names),
        stature_m=stature,
    )


def _known(index: dict[str, int], joint: str, path: str | Path) -> int:
    if joint not in index:
        raise FormatError(path, f"there is no joint '{joint}'")
    return index[joint]


def _place(row: dict[str, Any], stature_m: float | None, path: str | Path) -> Any:
    """Place in the rest pose (m)."""
    if isinstance(row.get("place_mm"), list) and len(row["place_mm"]) == 3:
        return np.array(row["place_mm"], float) / 1000.0
    if stature_m and isinstance(row.get("place"), list) and len(row["place"]) == 3:
        return np.array(row["place"], float) * stature_m
    raise FormatError(
        path, "needs place_mm = [left, back, up] (or place, in parts of stature_m)", where=f"'{row['name']}'"
    )


def _order(row: dict[str, Any], path: str | Path) -> str:
    order = str(row.get("turns", ""))
    if order and sorted(order) != ["X", "Y", "Z"]:
        raise FormatError(path, f"turns is '{order}', not an order of X, Y and Z", where=f"joint '{row['name']}'")
    return order


def _turning(row: dict[str, Any], path: str | Path) -> tuple[Any, Any, Any]:
    """What a joint may do: free components, limits and habit (rad)."""
    if "limits_deg" not in row and "habit_deg" in row:
        raise FormatError(path, "habit_deg needs limits_deg", where=f"joint '{row['name']}'")
    if row.get("parent") is None:
        return [True] * 3, [[-NO_LIMIT, NO_LIMIT]] * 3, [LOOSE] * 3
    if "limits_deg" not in row:
        return [False] * 3, [[0.0, 0.0]] * 3, [LOOSE] * 3
    limits = np.deg2rad(np.array(row["limits_deg"], float))
    if limits.shape != (3, 2) or (limits[:, 0] > limits[:, 1]).any():
        raise FormatError(path, "limits_deg is not three times [least, largest]", where=f"joint '{row['name']}'")
    habit = np.deg2rad(np.array(row.get("habit_deg", [90.0] * 3), float))
    free = limits[:, 1] > limits[:, 0]
    return free.tolist(), limits.tolist(), np.where(habit > 0, habit, LOOSE).tolist()


def write_skeleton(skeleton: Skeleton, path: str | Path) -> None:
    """Write a skeleton as TOML, in millimetres."""
    if Path(path).suffix != ".toml":
        raise InputError(f"skeletons are written as .toml ({path})")
    write_text(path, skeleton_text(skeleton))


def skeleton_text(skeleton: Skeleton) -> str:
    """A skeleton as TOML."""
    places = skeleton.places_m() * 1000.0
    other = {name: alias for alias, name in skeleton.aliases.items()}
    lines = [
        "# A skeleton of markerloom: places in the rest pose as [left, back, up] in mm; limits and habits of the turns",
        "# about these axes in degrees.",
        f"name = {json.dumps(skeleton.name)}",
    ]
    for j, name in enumerate(skeleton.joints):
        lines += ["", "[[joints]]", f"name = {json.dumps(name)}"]
        if j > 0:
            lines.append(f"parent = {json.dumps(skeleton.joints[skeleton.parents[j]])}")
        if name in other:
            lines.append(f"alias = {json.dumps(other[name])}")
        lines.append(f"place_mm = [{_numbers(places[j], 4)}]")
        if skeleton.orders[j] != "ZXY":
            lines.append(f"order = {json.dumps(skeleton.orders[j])}")
        if skeleton.turns_about[j]:
            lines.append(f"turns = {json.dumps(skeleton.turns_about[j])}")
        if j > 0 and skeleton.free[j].any():
            limits = [f"[{_numbers(np.rad2deg(limit), 3)}]" for limit in skeleton.limits_rad[j]]
            lines.append(f"limits_deg = [{', '.join(limits)}]")
            lines.append(f"habit_deg = [{_numbers(np.rad2deg(skeleton.habit_rad[j]), 3)}]")
    for site in skeleton.sites:
        place = places[site.joint] + np.array(site.place_m) * 1000.0
        lines += ["", "[[sites]]", f"name = {json.dumps(site.name)}"]
        lines += [f"joint = {json.dumps(skeleton.joints[site.joint])}", f"place_mm = [{_numbers(place, 4)}]"]
    if skeleton.segments:
        lines += ["", "[segments]"]
        lines += [f"{json.dumps(s)} = {json.dumps(skeleton.joints[j])}" for s, j in skeleton.segments.items()]
    return "\n".join(lines) + "\n"


def _numbers(values: Any, digits: int) -> str:
    return ", ".join(f"{float(v):.{digits}f}" for v in values)
