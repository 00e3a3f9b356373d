"""A take that is open: its sheet, its list of edits with the way back from each, and where that list is saved."""

from __future__ import annotations

import hashlib
import json
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from markerloom import formats
from markerloom.errors import InputError
from markerloom.formats.files import write_text
from markerloom.mending.edits import (
    DOT_EDITS,
    Edit,
    EditList,
    MarkContact,
    PointEdit,
    edits_path,
    read_edits,
    write_edits,
)
from markerloom.mending.operations import apply
from markerloom.mending.sheet import Changes, Sheet
from markerloom.project.process import RESULTS, automatic, holds_dots
from markerloom.project.settings import Project, TakeSettings
from markerloom.rig import Rig
from markerloom.skeleton.files import MOTIONS_READ, read_motion
from markerloom.skeleton.motion import Motion
from markerloom.skeleton.tables import as_points
from markerloom.studio import stored, words


class ConflictError(InputError):
    """The take is not as the page saw it."""


@dataclass
class Made:
    """An edit of the list: the way back where it changed trajectories, and the reason where it does not fit."""

    edit: Edit
    words: str
    way_back: Changes | None = None
    unfit: str = ""


@dataclass
class OpenTake:
    """A take that is shown and mended. Changes go through ``edit``, ``undo`` and ``redo``, which save the list."""

    project: Project
    settings: TakeSettings
    sheet: Sheet
    residual_unit: str
    warnings: list[str]
    folder: Path
    has_dots: bool
    rig: Rig | None
    motion: Motion | None
    stamp: list[list[Any]]
    revision: int = 1
    made: list[Made] = field(default_factory=list)
    undone: list[Edit] = field(default_factory=list)
    processed: EditList = field(default_factory=EditList)
    lock: threading.RLock = field(default_factory=threading.RLock)
    on_disk: bytes = b""
    kept: dict[str, Any] = field(default_factory=dict)
    """What views have computed, each with the revision for which it holds."""

    @property
    def edits(self) -> EditList:
        """The list as it is now."""
        return EditList(edits=tuple(m.edit for m in self.made))

    @property
    def path(self) -> Path:
        """Where the list is saved."""
        return edits_path(self.settings.file)

    def replay(self) -> None:
        """Read the list from disk, and apply it."""
        self.on_disk = _bytes(self.path)
        listed = read_edits(self.path).edits if self.on_disk else ()
        for edit in listed:
            self.made.append(self._applied(edit, keep=True))

    def edit(self, edit: Edit, revision: int) -> None:
        """Make an edit and save it; raises where it does not fit, or the page looked at another revision."""
        with self.lock:
            self._check(revision)
            made = self._applied(edit, keep=False)
            self.made.append(made)
            self.undone.clear()
            self._save_or(self._drop_last)

    def undo(self, revision: int) -> str:
        """Take the last edit back; returns what it was, in words."""
        with self.lock:
            self._check(revision)
            if not self.made:
                raise InputError("there is nothing to undo")
            last = self._drop_last()
            self.undone.append(last.edit)
            self._save_or(lambda: self.made.append(self._applied(self.undone.pop(), keep=True)))
            return last.words

    def redo(self, revision: int) -> str:
        """Make the edit again that was undone last."""
        with self.lock:
            self._check(revision)
            if not self.undone:
                raise InputError("there is nothing to redo")
            made = self._applied(self.undone[-1], keep=False)
            self.undone.pop()
            self.made.append(made)
            self._save_or(self._drop_last)
            return made.words

    def _applied(self, edit: Edit, *, keep: bool) -> Made:
        """Apply an edit. ``keep``: one that does not fit is kept as such, for whoever looks at the list."""
        said = words.of_edit(edit, self.sheet)
        if isinstance(edit, (*DOT_EDITS, MarkContact)):
            return Made(edit, said)
        point_edit: PointEdit = edit
        try:
            return Made(edit, said, apply(self.sheet, point_edit))
        except InputError as error:
            if not keep:
                raise
            return Made(edit, said, unfit=str(error))

    def _drop_last(self) -> Made:
        last = self.made.pop()
        if last.way_back is not None:
            last.way_back.take_back()
        return last

    def _check(self, revision: int) -> None:
        if revision != self.revision:
            raise ConflictError(
                "the take was changed in another window: it is shown as it is now; do it again if it still fits"
            )
        if _bytes(self.path) != self.on_disk:
            raise ConflictError(f"{self.path.name} was changed by another program: open the take again to see it")

    def _save_or(self, take_back: Any) -> None:
        """Save the list; where that fails nothing has happened."""
        try:
            write_edits(self.edits, self.path)
        except InputError:
            take_back()
            raise
        self.on_disk = _bytes(self.path)
        self.revision += 1

    def source_state(self) -> str:
        """Whether the files that the take came from are as they were: ``ok``, ``changed`` or ``gone``."""
        now = _stamp([Path(p) for p, *_ in self.stamp])
        return "gone" if any(len(s) == 1 for s in now) else "ok" if now == self.stamp else "changed"

    @property
    def dots_pending(self) -> bool:
        """Whether centroids were excluded, or included again, since the take was reconstructed."""
        return self.edits.of_dots != self.processed.of_dots

    @property
    def skeleton_stale(self) -> bool:
        """Whether edits came after the skeleton was solved."""
        return self.edits.plain() != _made_with(self.project, self.settings)

    def remembered(self, name: str, make: Any) -> Any:
        """Something that is computed once for each revision; while it is, the take can be looked at and changed."""
        revision, known = self.revision, self.kept.get(name)
        if known is not None and known[0] == revision:
            return known[1]
        made = make()
        if revision == self.revision:
            self.kept[name] = (revision, made)
        return made


def results_of(project: Project, settings: TakeSettings) -> Path:
    """The folder of a take's results."""
    return project.folder / RESULTS / settings.name


def open_take(project: Project, settings: TakeSettings) -> OpenTake:
    """Open a take: from what was stored when it was opened before, or by way of its automatic stages.

    Raises ``MarkerloomError`` where it cannot be read or tracked.
    """
    folder = results_of(project, settings)
    folder.mkdir(parents=True, exist_ok=True)
    stamp = _stamp([Path(p) for p in (settings.file, settings.calibration, settings.motion, *settings.subjects) if p])
    if len(stamp[0]) == 1:
        raise InputError(f"there is no file {settings.file}")
    listed = edits_path(settings.file)
    edits = read_edits(listed) if listed.is_file() else EditList()
    motion = read_motion(settings.file) if _is_motion(settings) else None
    known = json.dumps([stamp, repr(settings), [e.model_dump(mode="json") for e in edits.of_dots], stored.VERSION])
    key = hashlib.sha256(known.encode()).hexdigest()
    found = stored.load(folder / "sheet", key)
    if found is None and motion is None:
        _store(project, settings, folder, key)
        found = stored.load(folder / "sheet", key)
    sheet = found.sheet if found else _of_motion(motion, settings)
    note = folder / "sheet" / "warnings.json"
    take = OpenTake(
        project=project,
        settings=settings,
        sheet=sheet,
        residual_unit=found.residual_unit if found else "",
        warnings=json.loads(note.read_text("utf-8")) if note.is_file() else [],
        folder=folder,
        has_dots=bool(settings.calibration) and motion is None and holds_dots(Path(settings.file)),
        rig=formats.read_calibration(settings.calibration) if settings.calibration else None,
        motion=read_motion(settings.motion) if settings.motion else motion or _solved(project, settings),
        stamp=stamp,
        processed=edits,
    )
    take.replay()
    return take


def _store(project: Project, settings: TakeSettings, folder: Path, key: str) -> None:
    """The take as its automatic stages make it, stored for the studio."""
    file = Path(settings.file)
    plain = not (settings.subjects or settings.marker_set or settings.frames)
    warnings: list[str] = []
    if formats.ending(file) == ".c3d" and plain and settings.fill == settings.smooth == "none":
        stored.store_c3d(folder / "sheet", key, file, settings.rate_hz or None)
    else:
        made = automatic(project, settings)
        warnings = [w for r in made.reports.values() for w in r.get("warnings", [])]
        tracked = made.stages.folder / "track.parquet"
        dots = formats.read_points(tracked) if tracked.is_file() and holds_dots(file) else None
        stored.store(folder / "sheet", key, made.points, dots)
    write_text(folder / "sheet" / "warnings.json", json.dumps(warnings))


def _is_motion(settings: TakeSettings) -> bool:
    return Path(settings.file).suffix.lower() in MOTIONS_READ


def _of_motion(motion: Motion | None, settings: TakeSettings) -> Sheet:
    """A motion has no markers; under another motion its joints are shown as if they were."""
    if motion is not None and settings.motion:
        return Sheet.of(as_points(motion))
    return Sheet(0, len(motion or ()), motion.rate_hz if motion else None, [], settings.file)


def _solved(project: Project, settings: TakeSettings) -> Motion | None:
    """The motion that `process` solved, where there is one."""
    kind = next((k for k in settings.solve_to if k in MOTIONS_READ), None)
    file = results_of(project, settings) / f"{settings.name}{kind}"
    return read_motion(file) if settings.skeleton and kind and file.is_file() else None


def _made_with(project: Project, settings: TakeSettings) -> list[dict[str, object]]:
    """The edits with which `process` ran last."""
    kept = results_of(project, settings) / "made-with" / edits_path(settings.file).name
    return read_edits(kept).plain() if kept.is_file() else []


def _stamp(files: list[Path]) -> list[list[Any]]:
    """Files by size and time of change, which tell at once what a hash of gigabytes would; those gone by name only."""
    found: list[list[Any]] = []
    for file in files:
        try:
            state = file.stat()
            found.append([str(file), state.st_size, state.st_mtime_ns])
        except OSError:
            found.append([str(file)])
    return found


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:
        return b""
