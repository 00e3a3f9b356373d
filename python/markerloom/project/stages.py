"""Stages whose results stay on disk: a stage runs again only when its inputs, its options or the stage itself changed.

A result's key is the hash of those and of nothing else. Results appear whole or not at all, and the key after them, so
that a run that was killed goes on where it was.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from markerloom.formats import read_points, write_points
from markerloom.formats.files import write_text
from markerloom.points import Points


def key_of(*parts: object) -> str:
    """A hash of anything that prints the same when it is the same; files by their content."""
    digest = hashlib.sha256()
    for part in parts:
        data = part.read_bytes() if isinstance(part, Path) else json.dumps(part, sort_keys=True, default=str).encode()
        digest.update(len(data).to_bytes(8, "little") + data)
    return digest.hexdigest()


class Stages:
    """The stages of one take in their folder; ``ran`` are those that were not there already."""

    def __init__(self, folder: Path) -> None:
        """Results in ``folder``, which is made."""
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self.ran: list[str] = []

    def points(
        self, stage: str, key: str, make: Callable[[], tuple[Points, dict[str, Any]]]
    ) -> tuple[Points, dict[str, Any]]:
        """The points of a stage and its report: from disk where the key is the same, or made anew."""
        file, note = self.folder / f"{stage}.parquet", self.folder / f"{stage}.json"
        known = self._known(note, key)
        if file.is_file() and known is not None:
            return read_points(file), known
        points, report = make()
        note.unlink(missing_ok=True)
        write_points(points, file)
        plain = json.loads(json.dumps({k: v for k, v in report.items() if k != "timing"}, default=float))
        write_text(note, json.dumps({"key": key, "report": plain}, indent=1) + "\n")
        self.ran.append(stage)
        return points, plain

    def files(self, stage: str, key: str, targets: list[Path], make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """The report of a stage that writes files of its own: from disk where the key is the same and all are there."""
        note = self.folder / f"{stage}.json"
        known = self._known(note, key)
        if known is not None and all(t.is_file() for t in targets):
            return known
        note.unlink(missing_ok=True)
        report = json.loads(json.dumps(make(), default=float))
        write_text(note, json.dumps({"key": key, "report": report}, indent=1) + "\n")
        self.ran.append(stage)
        return report

    @staticmethod
    def _known(note: Path, key: str) -> dict[str, Any] | None:
        """The report beside a result, where it was made under this key."""
        try:
            known = json.loads(note.read_text("utf-8")) if note.is_file() else {}
            return known["report"] if known.get("key") == key else None
        except (json.JSONDecodeError, KeyError, UnicodeDecodeError):
            return None
