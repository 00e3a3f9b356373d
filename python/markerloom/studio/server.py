"""The studio's server: on this machine only, for whoever has its token, from the opened project only."""

from __future__ import annotations

from pathlib import Path

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import FileResponse, Response

from markerloom.errors import MarkerloomError
from markerloom.studio import routes_edits, routes_project, routes_views
from markerloom.studio.guard import Guard, problem
from markerloom.studio.opened import ConflictError
from markerloom.studio.opening import Workspace
from markerloom.studio.requests import UnknownError
from markerloom.studio.routes_project import file_within


def make_server(workspace: Workspace, token: str, page: Path | None = None) -> FastAPI:
    """The server of a workspace. ``page``: folder of the built page, or none for the data alone."""
    app = FastAPI(title="markerloom studio", docs_url=None, redoc_url=None, openapi_url=None)
    app.state.workspace = workspace
    app.add_middleware(Guard, token=token)
    for routes in (routes_project.routes, routes_views.routes, routes_edits.routes):
        app.include_router(routes)
    if page is not None:
        _serve_page(app, page)
    _answer_errors(app)
    return app


def _serve_page(app: FastAPI, page: Path) -> None:
    @app.get("/")
    def index() -> Response:
        return FileResponse(page / "index.html")

    @app.get("/assets/{name}")
    def asset(name: str) -> Response:
        return file_within(page / "assets", name)


def _answer_errors(app: FastAPI) -> None:
    """Whatever goes wrong becomes a sentence, and the server lives on."""

    @app.exception_handler(MarkerloomError)
    async def failed(_: Request, error: MarkerloomError) -> Response:
        if isinstance(error, ConflictError):
            return problem(409, "conflict", str(error))
        if isinstance(error, UnknownError):
            return problem(404, "missing", str(error))
        return problem(422, "invalid", str(error))

    @app.exception_handler(RequestValidationError)
    async def invalid(_: Request, error: RequestValidationError) -> Response:
        first = error.errors()[0]
        where = ".".join(str(p) for p in first["loc"])
        return problem(422, "invalid", f"{where}: {first['msg']}")

    @app.exception_handler(404)
    async def missing(_: Request, __: Exception) -> Response:
        return problem(404, "missing", "there is no such thing here")

    @app.exception_handler(Exception)
    async def broken(_: Request, error: Exception) -> Response:
        return problem(500, "failed", f"{type(error).__name__}: {error}; nothing was changed")
