"""Addresses under which a take is looked at; none of them changes anything."""

from __future__ import annotations

from fastapi import APIRouter
from fastapi.responses import Response

from markerloom.mending.edits import At
from markerloom.studio import calibrating, chunks, finding, looking, seeing, suggesting, videos
from markerloom.studio import messages as m
from markerloom.studio.requests import Count, Opened, Row, Slot

routes = APIRouter(prefix="/api/takes/{name}")


@routes.get("")
def take_view(take: Opened) -> m.TakeView:
    """Everything of a take but its samples."""
    with take.lock:
        return looking.take_view(take)


@routes.get("/timeline")
def timeline(take: Opened) -> m.Timeline:
    """What kind of samples every trajectory has when."""
    with take.lock:
        return looking.timeline(take)


@routes.get("/chunk")
def chunk(take: Opened, first: Row, count: Count) -> Response:
    """Samples as bytes (see `chunks`)."""
    with take.lock:
        return _bytes(chunks.of_sheet(take.sheet, first, count, take.revision))


@routes.get("/overview")
def overview(take: Opened) -> Response:
    """Every n-th frame of the whole take, as bytes."""
    with take.lock:
        return _bytes(chunks.overview(take.sheet, take.revision))


@routes.get("/joints")
def joints(take: Opened, first: Row, count: Count) -> Response:
    """Places of joints and sites as bytes."""
    return _bytes(chunks.of_places(looking.joints_mm(take), first, count, take.revision))


@routes.get("/series")
def series(take: Opened, slot: Slot, first: Row, last: Row, bins: Count) -> m.Series:
    """Graphs of a trajectory."""
    with take.lock:
        return looking.series(take, slot, first, last, bins)


@routes.get("/joint-series")
def joint_series(take: Opened, joint: Row, first: Row, last: Row, bins: Count) -> m.Series:
    """Graphs of a joint."""
    return looking.joint_series(take, joint, first, last, bins)


@routes.get("/dots")
def dots(take: Opened, frame: int) -> m.DotsView:
    """What the cameras had in a frame."""
    with take.lock:
        return seeing.dots_view(take, frame)


@routes.get("/video")
def video(take: Opened, camera: str, frame: int) -> Response:
    """The image of a camera."""
    return Response(videos.frame_of(take, camera, frame), media_type="image/png")


@routes.get("/coverage")
def coverage(take: Opened) -> list[m.CoverageView]:
    """Where in its image each camera saw something."""
    return seeing.coverage_views(take)


@routes.get("/accuracy")
def accuracy(take: Opened) -> m.AccuracyView:
    """What the rig is worth, cell by cell."""
    return calibrating.accuracy_view(take)


@routes.get("/refined")
def refined(take: Opened) -> m.RefinedView:
    """Where the cameras would stand if they were adjusted to the take."""
    return calibrating.refined_view(take)


@routes.get("/why")
def why(take: Opened, slot: Slot, frame: int) -> m.Why:
    """Why a marker is missing, or what it is made of."""
    with take.lock:
        return seeing.why(take, slot, frame)


@routes.get("/findings")
def findings(take: Opened) -> m.Findings:
    """What is worth a look."""
    return take.remembered("findings", lambda: finding.findings(take))


@routes.get("/suggestions")
def suggestions(take: Opened, slot: Slot) -> list[m.Suggestion]:
    """Names that a trajectory may have."""
    with take.lock:
        return suggesting.suggestions(take, slot)


@routes.get("/previews")
def previews(take: Opened, slot: Slot, first: Row, last: Row) -> list[m.Preview]:
    """A gap as each method would fill it."""
    with take.lock:
        return suggesting.previews(take, slot, first, last)


@routes.get("/at")
def at(take: Opened, slot: Slot, frame: int) -> At:
    """How an edit points at a trajectory."""
    with take.lock:
        return take.sheet.at(slot, frame)


def _bytes(data: bytes) -> Response:
    return Response(data, media_type="application/octet-stream")
