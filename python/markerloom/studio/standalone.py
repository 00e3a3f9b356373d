"""A take as one page that needs neither server nor network: to be sent to somebody who only looks."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path

from markerloom.errors import InputError
from markerloom.formats.files import write_text
from markerloom.project import Project, TakeSettings
from markerloom.studio import chunks, finding, looking, messages
from markerloom.studio.opened import OpenTake, open_take
from markerloom.studio.page import built_page, page_is_built


def save_page(take: OpenTake, path: Path) -> messages.Done:
    """Write a take into a page with everything that shows it; of long takes every n-th frame, which the page says."""
    sheet = take.sheet
    stride = chunks.overview_stride(len(sheet.trajectories), sheet.count)
    view = looking.take_view(take)
    frames = len(range(0, sheet.count, stride))
    notes = [f"this page holds one frame in {stride} of the take; its numbers count these"] if stride > 1 else []
    view = view.model_copy(
        update={
            "frames": frames,
            "rate_hz": view.rate_hz / stride,
            "first_frame": view.first_frame if stride == 1 else 0,
            "chunk_frames": max(frames, 1),
            "overview_stride": 1,
            "has_dots": False,
            "edits": [],
            "warnings": [*view.warnings, *notes],
        }
    )
    found = (
        finding.findings(take) if stride == 1 else messages.Findings(revision=take.revision, findings=[], notes=notes)
    )
    project = messages.ProjectView(
        name=take.project.name,
        is_project=False,
        takes=[messages.TakeInfo(name=view.name, file=view.file, state="ready", message="")],
        instance="page",
        version="",
    )
    data = {
        "project": project.model_dump(mode="json"),
        "take": view.model_dump(mode="json"),
        "timeline": _timeline(take, stride).model_dump(mode="json"),
        "findings": found.model_dump(mode="json"),
        "chunk": base64.b64encode(chunks.overview(sheet, take.revision)).decode(),
        "joints": base64.b64encode(_joints(take, stride)).decode() if take.motion else "",
    }
    write_text(path, _page(json.dumps(data).replace("<", "\\u003c")))
    return messages.Done(message=f"{path.name}: {frames} frames in one page", path=str(path))


def save_view(project: Project, settings: TakeSettings, path: Path) -> None:
    """The same for a take that `process` has just made; nothing where the page is not built."""
    if page_is_built():
        save_page(open_take(project, settings), path)


def _timeline(take: OpenTake, stride: int) -> messages.Timeline:
    """Runs over the frames that the page holds."""
    if stride == 1:
        return looking.timeline(take)
    thinned = [looking.runs_of_kinds(one.kind[::stride]).ravel().tolist() for one in take.sheet.trajectories]
    return messages.Timeline(revision=take.revision, runs=thinned)


def _joints(take: OpenTake, stride: int) -> bytes:
    places = looking.joints_mm(take)[::stride]
    return chunks.of_places(places, 0, len(places), take.revision)


def _page(data: str) -> str:
    """The built page with its code, its style and a take inside."""
    folder = built_page()
    text = (folder / "index.html").read_text("utf-8")
    script = re.search(r'<script type="module"[^>]*src="\./assets/([^"]+)"[^>]*></script>', text)
    style = re.search(r'<link rel="stylesheet"[^>]*href="\./assets/([^"]+)"[^>]*>', text)
    if script is None or style is None:
        raise InputError("the built page is not as expected: build it anew with `make web`")
    code = (folder / "assets" / script[1]).read_text("utf-8").replace("</script", "<\\/script")
    look = (folder / "assets" / style[1]).read_text("utf-8")
    text = text.replace(style[0], f"<style>{look}</style>").replace(script[0], "")
    # Modules run when the body is there, wherever they stand.
    inside = f'<script>window.markerloomTake={data}</script>\n<script type="module">{code}</script>\n'
    return text.replace("</body>", f"{inside}</body>")
