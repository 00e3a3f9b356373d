"""What a request speaks of: the workspace, an open take, a trajectory in it."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Query, Request

from markerloom.errors import InputError
from markerloom.studio.opened import OpenTake
from markerloom.studio.opening import Entry, Workspace


class UnknownError(InputError):
    """Something that the project does not have."""


def workspace_of(request: Request) -> Workspace:
    """What the server shows."""
    workspace: Workspace = request.app.state.workspace
    return workspace


Here = Annotated[Workspace, Depends(workspace_of)]


def entry_of(workspace: Here, name: str) -> Entry:
    """The take that is named in the address."""
    if name not in workspace.entries:
        raise UnknownError(f"the project has no take '{name}'")
    return workspace.entries[name]


Named = Annotated[Entry, Depends(entry_of)]


def opened_take(entry: Named) -> OpenTake:
    """The same, where it is open."""
    if entry.take is None:
        raise InputError(entry.message or f"{entry.settings.name} is not open yet")
    return entry.take


def resting_take(entry: Named) -> OpenTake:
    """The same, where nothing is going on with it."""
    if entry.state == "working":
        raise InputError(f"{entry.message}: wait until that is done")
    return opened_take(entry)


Opened = Annotated[OpenTake, Depends(opened_take)]
Resting = Annotated[OpenTake, Depends(resting_take)]
Row = Annotated[int, Query(ge=0, lt=2**31)]
Count = Annotated[int, Query(ge=1, le=4096)]


def slot_of(take: Opened, slot: Row) -> int:
    """A trajectory of the take."""
    if slot >= len(take.sheet.trajectories):
        raise UnknownError(f"the take has no trajectory {slot}")
    return slot


Slot = Annotated[int, Depends(slot_of)]
