"""The verb ``view`` on the command line."""

from __future__ import annotations

import json
import os
import secrets
import socket
import threading
import webbrowser
from pathlib import Path
from typing import Annotated, Any

import typer
import uvicorn

from markerloom.errors import InputError
from markerloom.formats.files import write_text
from markerloom.studio.messages import Done
from markerloom.studio.opened import open_take
from markerloom.studio.opening import Workspace, cache_folder
from markerloom.studio.opening import view as open_workspace
from markerloom.studio.page import built_page
from markerloom.studio.server import make_server
from markerloom.studio.standalone import save_page


def view(
    what: Annotated[
        Path, typer.Argument(help="A project, or a file of points, dots or motion.", metavar="FILE|PROJECT")
    ],
    calibration: Annotated[Path | None, typer.Option(help="The cameras, for a file.")] = None,
    rate_hz: Annotated[float | None, typer.Option("--rate-hz", help="Frame rate, where the file has none.")] = None,
    motion: Annotated[Path | None, typer.Option(help="Bones of this motion over the file's markers or joints.")] = None,
    port: Annotated[int, typer.Option(help="0: the one of last time, or any.", min=0, max=65535)] = 0,
    page: Annotated[
        Path | None, typer.Option("--page", help="Write a file into one page instead.", metavar="FILE.html")
    ] = None,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page.")] = True,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")] = False,
) -> None:
    """Look at a take in the browser, and mend it: a server on this machine only, until Ctrl-C.

    Example: markerloom view walk.c3d · markerloom view walk.c3d --page walk.html
    """
    workspace = open_workspace(what, calibration=calibration, rate_hz=rate_hz, motion=motion)
    if page is not None:
        done = page_of(workspace, page)
        if not quiet:
            typer.echo(f"{done.message} → {done.path}")
        return
    built = built_page()
    listening, token = _address(workspace, port)
    url = f"http://127.0.0.1:{listening.getsockname()[1]}/?token={token}"
    if not quiet:
        typer.echo(f"{workspace.project.name}: {url}\nCtrl-C ends it.")
    config = uvicorn.Config(
        make_server(workspace, token, built), log_level="critical", timeout_graceful_shutdown=1, access_log=False
    )
    if browser:
        threading.Timer(0.5, webbrowser.open, [url]).start()
    uvicorn.Server(config).run(sockets=[listening])


def page_of(workspace: Workspace, path: Path) -> Done:
    """A file as a page that needs no server."""
    if path.suffix != ".html":
        raise InputError(f"pages are written as .html ({path})")
    if workspace.is_project:
        raise InputError("the takes of a project have their pages from `markerloom process`: results/TAKE/view.html")
    entry = next(iter(workspace.entries.values()))
    return save_page(open_take(workspace.project, entry.settings), path)


def _address(workspace: Workspace, port: int) -> tuple[socket.socket, str]:
    """Port and token: those of last time where they are free, so that a page that is still open finds its way back."""
    note = cache_folder() / "addresses" / f"{workspace.key}.json"
    try:
        known: dict[str, Any] = json.loads(note.read_text("utf-8"))
        token, last = str(known["token"]), int(known["port"])
    except (OSError, ValueError, KeyError):
        token, last = secrets.token_urlsafe(24), 0
    listening = _listening(port) if port else _listening(last, 0)
    note.parent.mkdir(parents=True, exist_ok=True)
    note.parent.chmod(0o700)
    write_text(note, json.dumps({"port": listening.getsockname()[1], "token": token}))
    note.chmod(0o600)
    return listening, token


def _listening(*ports: int) -> socket.socket:
    """A socket on the first port that is free; who comes before the server is ready waits."""
    for port in ports:
        one = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        if os.name == "posix":
            one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            one.bind(("127.0.0.1", port))
            one.listen(128)
        except OSError:
            one.close()
            continue
        return one
    raise InputError(f"port {ports[0]} is taken: say another with --port, or 0 for any")
