"""What is opened: a project, or a file as a project of one take; and its takes, opened one by one in the background."""

from __future__ import annotations

import hashlib
import os
import secrets
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from markerloom import formats
from markerloom.errors import InputError, MarkerloomError
from markerloom.project import Project, TakeSettings, process, read_project
from markerloom.project.process import holds_dots
from markerloom.project.settings import FILE
from markerloom.skeleton.files import MOTIONS_READ
from markerloom.studio.opened import OpenTake, open_take

State = Literal["closed", "working", "ready", "failed"]


@dataclass
class Entry:
    """A take of the project, open or not."""

    settings: TakeSettings
    state: State = "closed"
    message: str = ""
    take: OpenTake | None = None


@dataclass
class Workspace:
    """Everything that one server shows. ``instance`` tells one run of the server from the next."""

    project: Project
    is_project: bool
    entries: dict[str, Entry]
    key: str
    """The same for the same project or file: under it the server's address is kept."""
    instance: str = field(default_factory=lambda: secrets.token_hex(8))
    lock: threading.RLock = field(default_factory=threading.RLock)

    def entry(self, name: str) -> Entry:
        """A take by its name."""
        if name not in self.entries:
            raise InputError(f"the project has no take '{name}'; it has {', '.join(self.entries)}")
        return self.entries[name]

    def open(self, name: str) -> Entry:
        """A take, opened in the background where it is not open yet."""
        entry = self.entry(name)
        with self.lock:
            if entry.state == "closed":
                self._work(entry, "is being opened", lambda: None)
        return entry

    def reopen(self, name: str) -> Entry:
        """Read a take again, with whatever changed on disk since."""
        entry = self.entry(name)
        with self.lock:
            if entry.state != "working":
                self._work(entry, "is being opened again", lambda: None)
        return entry

    def process(self, name: str) -> Entry:
        """Take a take the whole way again, with its edits, and show what came out."""
        entry = self.entry(name)
        with self.lock:
            if entry.state == "working":
                raise InputError(f"{name} is being worked on already")
            self._work(entry, "is being processed", lambda: self._process(name))
        return entry

    def _process(self, name: str) -> None:
        result = process(self.project, takes=[name])
        if result["failed"]:
            raise InputError(result["failed"][0]["reason"])

    def _work(self, entry: Entry, doing: str, first: Callable[[], None]) -> None:
        """Do something with a take, and open it, in a thread of its own."""
        entry.state, entry.message = "working", f"{entry.settings.name} {doing}"

        def work() -> None:
            before = entry.take
            try:
                first()
                take = open_take(self.project, entry.settings)
                # A page that looked at the take before must not take its revisions for the new ones.
                take.revision = 1 if before is None else before.revision + 1
                entry.take, entry.message, entry.state = take, "", "ready"
            except MarkerloomError as error:
                entry.message, entry.state = str(error), "ready" if before else "failed"
            except Exception as error:  # noqa: BLE001 - whatever goes wrong with one file, the server lives on
                entry.message, entry.state = f"{type(error).__name__}: {error}", "ready" if before else "failed"

        threading.Thread(target=work, name=f"open {entry.settings.name}", daemon=True).start()


def view(
    path: str | Path,
    *,
    calibration: str | Path | None = None,
    rate_hz: float | None = None,
    motion: str | Path | None = None,
) -> Workspace:
    """What `view` shows: a project's folder, or a file of points, dots (with ``calibration``) or motion.

    ``motion``: a motion whose bones are shown over the file's markers, or over the joints of its own motion.
    Raises ``InputError`` for what it cannot show. Takes are opened when they are first looked at.
    """
    path = Path(path)
    if path.is_dir() or path.name == FILE:
        if calibration is not None or rate_hz is not None or motion is not None:
            raise InputError(f"calibration, rate and motion of a project's takes are in its {FILE}")
        project, is_project = read_project(path), True
    else:
        project, is_project = _of_file(path, calibration, rate_hz, motion), False
    key = hashlib.sha256(str(project.folder).encode()).hexdigest()[:16]
    return Workspace(project, is_project, {t.name: Entry(t) for t in project.takes}, key)


def _of_file(path: Path, calibration: str | Path | None, rate_hz: float | None, motion: str | Path | None) -> Project:
    if not path.is_file():
        raise InputError(f"there is no file or project {path}")
    kind = formats.ending(path)
    if kind not in (*formats.POINTS_READ, *formats.OBSERVATIONS, *MOTIONS_READ):
        readable = sorted({*formats.POINTS_READ, *formats.OBSERVATIONS, *MOTIONS_READ})
        raise InputError(f"'{kind}' files are not shown; these are: {', '.join(readable)} ({path})")
    if calibration is None and kind in formats.OBSERVATIONS and holds_dots(path):
        raise InputError(f"{path.name} holds dots: say with --calibration which cameras saw them")
    if calibration is not None and not Path(calibration).is_file():
        raise InputError(f"there is no file {calibration}")
    if motion is not None and (formats.ending(motion) not in MOTIONS_READ or not Path(motion).is_file()):
        raise InputError(f"there is no motion {motion}: {', '.join(MOTIONS_READ)}")
    path = path.resolve()
    settings = TakeSettings(
        name=path.name[: -len(kind)],
        file=str(path),
        calibration="" if calibration is None else str(Path(calibration).resolve()),
        rate_hz=rate_hz or 0.0,
        motion="" if motion is None else str(Path(motion).resolve()),
        fill="none",
        export=(),
    )
    known = hashlib.sha256(f"{settings.file}\n{settings.calibration}\n{settings.motion}".encode()).hexdigest()[:16]
    return Project(cache_folder() / known, settings.name, (settings,))


def cache_folder() -> Path:
    """Where what is computed of single files is kept: of no worth to anybody else, it can be deleted at any time."""
    root = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(root) / "markerloom" / "studio"
