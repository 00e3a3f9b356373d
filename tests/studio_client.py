"""A studio to be spoken to in tests: its server, and somebody who has its token."""

import time
from typing import Any

from fastapi.testclient import TestClient

from markerloom.studio.opening import Workspace
from markerloom.studio.server import make_server

TOKEN = "a-token"
HOST = "http://127.0.0.1:8123"


class Studio:
    """A server and somebody who has its token."""

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = workspace
        app = make_server(workspace, TOKEN)
        self.client = TestClient(
            app, base_url=HOST, headers={"X-Markerloom-Token": TOKEN}, raise_server_exceptions=False
        )
        self.name = next(iter(workspace.entries))

    def get(self, path: str, code: int = 200, **parameters: Any) -> Any:
        answer = self.client.get(f"/api/takes/{self.name}{path}", params=parameters)
        assert answer.status_code == code, answer.text
        return answer.json() if "json" in answer.headers["content-type"] else answer.content

    def post(self, path: str, body: Any = None, code: int = 200) -> Any:
        answer = self.client.post(f"/api/takes/{self.name}{path}", json=body)
        assert answer.status_code == code, answer.text
        return answer.json()

    def open(self, how: str = "/open") -> dict[str, Any]:
        self.post(how)
        for _ in range(600):
            info = self.post("/open")
            if info["state"] != "working":
                return info
            time.sleep(0.05)
        raise AssertionError("the take does not open")

    def at(self, label: str, frame: int) -> dict[str, Any]:
        return self.get("/at", slot=self.slot(label), frame=frame)

    def slot(self, label: str) -> int:
        return next(t["slot"] for t in self.get("")["trajectories"] if t["label"] == label)

    def edit(self, edit: dict[str, Any], code: int = 200) -> Any:
        return self.post("/edits", {"revision": self.get("")["revision"], "edit": edit}, code)
