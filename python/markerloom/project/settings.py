"""What a project says of its takes: ``markerloom.toml``, settings cascading from the project to each take.

name = "Friday"
calibration = "rig.toml"            # for takes of dots
subjects = ["anna.toml"]            # or: marker_set = "plug-in-gait-39", with a T-pose at the start of each take

[settings]                          # any of them again under [takes.NAME]
rate_hz = 100.0
longest_s = 2.0
smooth = "none"
export = [".c3d"]
virtual = "plug-in-gait-39"         # export the virtual markers of this set, too: its name or file
skeleton = "hanim-loa1"             # solve a skeleton, too; solve_to = [".bvh"]; hints and fit_from as for `solve`

[takes.walk-1]                      # without any, every file in the folder takes/
file = "takes/walk-1.parquet"
frames = "0:1200"
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from markerloom.errors import FormatError, InputError
from markerloom.formats import OBSERVATIONS, POINTS_READ, POINTS_WRITTEN, ending
from markerloom.formats.files import read_text
from markerloom.skeleton.files import MOTIONS_WRITTEN

FILE = "markerloom.toml"


@dataclass(frozen=True)
class TakeSettings:
    """Everything that decides about one take; paths are absolute."""

    name: str = ""
    file: str = ""
    calibration: str = ""
    subjects: tuple[str, ...] = ()
    marker_set: str = ""
    frames: str = ""
    rate_hz: float = 0.0
    units: str = ""
    fill: str = "auto"
    longest_s: float = 2.0
    smooth: str = "none"
    cutoff_hz: float = 6.0
    virtual: str = ""
    export: tuple[str, ...] = (".c3d",)
    skeleton: str = ""
    hints: str = ""
    fit_from: str = ""
    solve_to: tuple[str, ...] = (".bvh",)
    motion: str = ""


@dataclass(frozen=True)
class Project:
    """A project: its folder, its name, and its takes in order of name."""

    folder: Path
    name: str
    takes: tuple[TakeSettings, ...]


def read_project(folder: str | Path) -> Project:
    """Read a project from its folder or ``markerloom.toml``; raises ``FormatError`` where that says something odd."""
    folder = Path(folder)
    path = folder if folder.name == FILE else folder / FILE
    folder = path.parent.resolve()
    if not path.is_file():
        raise InputError(f"there is no {FILE} in {folder}: it says what the project consists of")
    try:
        content = tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        raise FormatError(path, f"not a TOML file: {error}") from None
    top = {k: content[k] for k in ("calibration", "subjects", "marker_set") if k in content}
    unknown = sorted(set(content) - {"name", "calibration", "subjects", "marker_set", "settings", "takes"})
    if unknown:
        raise FormatError(path, f"'{unknown[0]}' is nothing a project has")
    common = _merged(TakeSettings(), {**top, **content.get("settings", {})}, path, "settings")
    listed: dict[str, dict[str, Any]] = content.get("takes") or {
        _name(p): {"file": str(p)} for p in sorted((folder / "takes").glob("*")) if ending(p) in READ
    }
    if not listed:
        raise InputError(f"the project has no takes: list them in {FILE}, or put them into {folder / 'takes'}")
    takes = [
        _placed(_merged(replace(common, name=name), own, path, f"takes.{name}"), folder)
        for name, own in sorted(listed.items())
    ]
    return Project(folder, str(content.get("name", folder.name)), tuple(takes))


READ = (*OBSERVATIONS, *POINTS_READ)


def _name(path: Path) -> str:
    return path.name[: -len(ending(path))]


def _merged(settings: TakeSettings, given: dict[str, Any], path: Path, where: str) -> TakeSettings:
    kinds = {f.name: type(getattr(settings, f.name)) for f in fields(settings)}
    changes: dict[str, Any] = {}
    for key, value in given.items():
        if key not in kinds or key == "name":
            raise FormatError(
                path, f"'{key}' is no setting; there are {', '.join(k for k in kinds if k != 'name')}", where=where
            )
        wanted = kinds[key]
        fits = (
            isinstance(value, list)
            if wanted is tuple
            else isinstance(value, (int, float) if wanted is float else wanted)
        )
        if not fits:
            raise FormatError(path, f"{key} = {value!r} is not a {wanted.__name__}", where=where)
        changes[key] = tuple(str(v) for v in value) if wanted is tuple else wanted(value)
    made = replace(settings, **changes)
    for kind in made.export:
        if kind not in POINTS_WRITTEN:
            raise FormatError(path, f"export '{kind}': {', '.join(POINTS_WRITTEN)}", where=where)
    for kind in made.solve_to:
        if kind not in MOTIONS_WRITTEN:
            raise FormatError(path, f"solve_to '{kind}': {', '.join(MOTIONS_WRITTEN)}", where=where)
    return made


def _placed(settings: TakeSettings, folder: Path) -> TakeSettings:
    """Paths relative to the project made absolute; marker sets may be names."""

    def at(path: str) -> str:
        return str((folder / path).resolve()) if path else ""

    own = settings.skeleton and (folder / settings.skeleton).exists()
    named = settings.marker_set and (folder / settings.marker_set).exists()
    return replace(
        settings,
        file=at(settings.file),
        calibration=at(settings.calibration),
        subjects=tuple(at(s) for s in settings.subjects),
        marker_set=at(settings.marker_set) if named else settings.marker_set,
        virtual=at(settings.virtual) if settings.virtual and (folder / settings.virtual).exists() else settings.virtual,
        skeleton=at(settings.skeleton) if own else settings.skeleton,
        hints=at(settings.hints),
        fit_from=at(settings.fit_from),
        motion=at(settings.motion),
    )
