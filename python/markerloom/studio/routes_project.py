"""Addresses of the project: its takes, what is going on with them, its files, marker sets and subjects."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from pathlib import Path

from fastapi import APIRouter, Request
from fastapi.responses import FileResponse, Response, StreamingResponse

from markerloom.studio import messages as m
from markerloom.studio.marker_sets import (
    edit_subject,
    known_sets,
    marker_set_view,
    save_marker_set,
    subject_views,
)
from markerloom.studio.opening import Entry, Workspace
from markerloom.studio.requests import Here, Named, UnknownError

TOLD_EVERY_S = 0.2
CHECKED_EVERY = 10
"""Whether files changed on disk is looked at so many times less often."""
routes = APIRouter(prefix="/api")


@routes.get("/project")
def project(workspace: Here) -> m.ProjectView:
    """What is open."""
    return _project_view(workspace)


@routes.get("/notices")
async def notices(workspace: Here, request: Request) -> StreamingResponse:
    """What changes, as it happens (server-sent events of `Notice`)."""
    return StreamingResponse(_notices(workspace, request), media_type="text/event-stream")


@routes.post("/takes/{name}/open")
def open_(workspace: Here, entry: Named) -> m.TakeInfo:
    """Open a take, in the background."""
    return _info(workspace.open(entry.settings.name))


@routes.post("/takes/{name}/reopen")
def reopen(workspace: Here, entry: Named) -> m.TakeInfo:
    """Read a take again from disk."""
    return _info(workspace.reopen(entry.settings.name))


@routes.post("/takes/{name}/process")
def process(workspace: Here, entry: Named) -> m.TakeInfo:
    """Reconstruct, name, fill and solve again, with the edits."""
    return _info(workspace.process(entry.settings.name))


@routes.get("/files/{path:path}")
def file(workspace: Here, path: str) -> Response:
    """A file of the project: its pages and results."""
    return file_within(workspace.project.folder, path)


@routes.get("/marker-sets")
def sets(workspace: Here) -> list[str]:
    """Names of marker sets."""
    return known_sets(workspace.project)


@routes.get("/marker-sets/{name}")
def marker_set(workspace: Here, name: str) -> m.MarkerSetView:
    """A marker set."""
    return marker_set_view(workspace.project, name)


@routes.put("/marker-sets/{name}")
def put_marker_set(workspace: Here, name: str, view: m.MarkerSetView) -> m.Done:
    """Save a marker set into the project."""
    return save_marker_set(workspace.project, name, view)


@routes.get("/subjects")
def subjects(workspace: Here) -> list[m.SubjectView]:
    """The subjects of the project."""
    return subject_views(workspace.project)


@routes.put("/subjects/{file}")
def put_subject(workspace: Here, file: str, wanted: m.SubjectEdit) -> m.Done:
    """Change a subject's names, or let markers go."""
    return edit_subject(workspace.project, file, wanted)


def file_within(folder: Path, name: str) -> Response:
    """A file of a folder; nothing outside of it."""
    file = (folder / name).resolve()
    if not file.is_relative_to(folder.resolve()) or not file.is_file():
        raise UnknownError(f"there is no file {name}")
    return FileResponse(file)


def _project_view(workspace: Workspace) -> m.ProjectView:
    from markerloom import __version__

    return m.ProjectView(
        name=workspace.project.name,
        is_project=workspace.is_project,
        takes=[_info(e) for e in workspace.entries.values()],
        instance=workspace.instance,
        version=__version__,
    )


def _info(entry: Entry) -> m.TakeInfo:
    file = Path(entry.settings.file).name
    return m.TakeInfo(name=entry.settings.name, file=file, state=entry.state, message=entry.message)


async def _notices(workspace: Workspace, request: Request) -> AsyncIterator[str]:
    """A line whenever something changed, and a sign of life now and then."""
    told, turn = "", 0
    sources: dict[str, str] = {}
    while not await request.is_disconnected():
        takes = {n: e.take for n, e in workspace.entries.items() if e.take is not None}
        if turn % CHECKED_EVERY == 0:
            sources = {n: await asyncio.to_thread(t.source_state) for n, t in takes.items()}
            yield ": alive\n\n"
        notice = m.Notice(
            instance=workspace.instance,
            takes=[_info(e) for e in workspace.entries.values()],
            revisions={n: t.revision for n, t in takes.items()},
            sources=sources,  # pyright: ignore[reportArgumentType]
        )
        line = json.dumps(notice.model_dump())
        if line != told:
            told = line
            yield f"data: {line}\n\n"
        turn += 1
        await asyncio.sleep(TOLD_EVERY_S)
