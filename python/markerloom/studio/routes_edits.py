"""Addresses under which a take is changed."""

from __future__ import annotations

from fastapi import APIRouter

from markerloom.studio import messages as m
from markerloom.studio import saving
from markerloom.studio.marker_sets import learn_subject
from markerloom.studio.requests import Here, Resting

routes = APIRouter(prefix="/api/takes/{name}")


@routes.post("/edits")
def edit(take: Resting, wanted: m.EditRequest) -> m.Done:
    """Make an edit."""
    take.edit(wanted.edit, wanted.revision)
    return m.Done(message=take.made[-1].words)


@routes.post("/undo")
def undo(take: Resting, wanted: m.RevisionRequest) -> m.Done:
    """Take the last edit back."""
    return m.Done(message=f"undone: {take.undo(wanted.revision)}")


@routes.post("/redo")
def redo(take: Resting, wanted: m.RevisionRequest) -> m.Done:
    """Make the edit again that was undone last."""
    return m.Done(message=f"done again: {take.redo(wanted.revision)}")


@routes.post("/export")
def export(take: Resting, workspace: Here, wanted: m.ExportRequest) -> m.Done:
    """Write the mended take."""
    return saving.export(take, wanted, workspace.is_project)


@routes.post("/subject")
def subject(take: Resting, wanted: m.SubjectRequest) -> m.Done:
    """Learn a subject from the take as it is."""
    return learn_subject(take, wanted)
