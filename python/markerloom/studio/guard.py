"""Who may speak to the server: whoever has its token, on this machine, from its own page."""

from __future__ import annotations

import hmac
from typing import Any
from urllib.parse import parse_qs

from fastapi.responses import JSONResponse
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from markerloom.studio.messages import Problem

POLICY = "default-src 'self'; img-src 'self' blob: data:; style-src 'self' 'unsafe-inline'; frame-ancestors 'none'"
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}
HERE = ("127.0.0.1", "localhost")


def problem(status: int, kind: Any, message: str) -> JSONResponse:
    """An error in words, for the page to show."""
    return JSONResponse(Problem(error=kind, message=message).model_dump(), status)


class Guard:
    """Refuses who has no token, who comes from another page, and who was led here under another name."""

    def __init__(self, app: ASGIApp, token: str) -> None:
        """Stand before ``app``."""
        self.app, self.token = app, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request through, or answer it."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        reason = self._refusal(scope)
        if reason:
            await problem(403, "refused", reason)(scope, receive, send)
            return

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers[name] = value
            await send(message)

        await self.app(scope, receive, with_headers)

    def _refusal(self, scope: Scope) -> str:
        """Why a request is refused; empty where it is not."""
        headers = Headers(scope=scope)
        host = headers.get("host", "")
        if host.rpartition(":")[0] not in HERE:
            return f"the studio is at 127.0.0.1, not at {host or 'nowhere'}"
        origin = headers.get("origin")
        if origin is not None and origin != f"http://{host}":
            return f"the page {origin} is not the studio"
        if scope["path"].startswith("/assets/"):
            return ""  # the page's own code: the same for everybody
        asked = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        given = headers.get("x-markerloom-token") or asked
        if not hmac.compare_digest(given.encode(), self.token.encode()):
            return "the token is missing or of another run: open the address that `markerloom view` printed"
        return ""
