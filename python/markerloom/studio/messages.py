"""What the server and the page say to each other. ``web/src/wire.ts`` is generated from these models."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict

from markerloom.mending.edits import Edit

Place = tuple[float, float, float]
Pixel = tuple[float, float]


class Message(BaseModel):
    """Plain data, the same on both sides."""

    model_config = ConfigDict(frozen=True, ser_json_inf_nan="null")


class TakeInfo(Message):
    """A take of the project: its name, its file, and whether it can be shown, is being worked on, or failed."""

    name: str
    file: str
    state: Literal["closed", "working", "ready", "failed"]
    message: str


class ProjectView(Message):
    """What is open: a project, or a file as a project of one take. ``instance``: changes when the server restarts."""

    name: str
    is_project: bool
    takes: list[TakeInfo]
    instance: str
    version: str


class TrajectoryView(Message):
    """A trajectory: its place among the slots of a chunk, label (may be empty), name, colour, number of samples."""

    slot: int
    label: str
    name: str
    color: str
    samples: int


class CameraView(Message):
    """A camera for the eye: place (m), axes (rows: right, down, forward in world), image and focal length (px)."""

    id: str
    name: str
    position_m: Place
    axes: tuple[Place, Place, Place]
    size_px: Pixel
    focal_px: Pixel
    masked: list[tuple[float, float, float, float]]
    video: bool


class EditView(Message):
    """An edit of the list: what it does in words, and why it does not fit, where it does not."""

    op: str
    words: str
    unfit: str


class SkeletonView(Message):
    """A solved skeleton: joints, each with its parent (−1: root), ends of bones with the joint that each belongs to,
    and places of feet that can stand. ``stale``: edits came after it was solved.
    """

    joints: list[str]
    parents: list[int]
    ends: list[int]
    feet: list[str]
    stale: bool


class ContactView(Message):
    """A place of a foot that stands over these frames (both included)."""

    site: str
    first: int
    last: int


class TakeView(Message):
    """Everything of a take but its samples. ``revision`` goes up with every change; an edit names the one it saw."""

    name: str
    file: str
    revision: int
    first_frame: int
    frames: int
    rate_hz: float
    trajectories: list[TrajectoryView]
    links: list[tuple[int, int]]
    cameras: list[CameraView]
    has_dots: bool
    dots_pending: bool
    residual_unit: Literal["px", "mm", ""]
    typical_residual: float
    skeleton: SkeletonView | None
    contacts: list[ContactView]
    can_solve: bool
    edits: list[EditView]
    can_undo: bool
    can_redo: bool
    suggested_names: list[str]
    warnings: list[str]
    chunk_frames: int
    overview_stride: int
    export_name: str


class Timeline(Message):
    """Runs of samples of one kind, of every trajectory by slot: flat triples start (row of the take), length, kind (0
    measured, 1 predicted, 2 filled, 3 edited).
    """

    revision: int
    runs: list[list[int]]


class Series(Message):
    """A trajectory, or a joint, over a stretch of frames, thinned: for each bin its first frame, and the least and the
    largest of each value in it (none where absent). Of trajectories ``x``, ``y``, ``z`` (mm), ``speed`` (m/s),
    ``residual``, ``sigma`` (mm); of joints turns about ``x``, ``y``, ``z`` (deg).
    """

    frames: list[int]
    lows: dict[str, list[float | None]]
    highs: dict[str, list[float | None]]


class DotView(Message):
    """A centroid: its place (px), row within its frame and camera, whose it is (slot, −1: nobody's), if left out."""

    x: float
    y: float
    observation: int
    slot: int
    excluded: bool


class ReprojectionView(Message):
    """Where a camera must see a trajectory (px)."""

    slot: int
    x: float
    y: float


class CameraFrame(Message):
    """What one camera had in a frame."""

    camera: str
    dots: list[DotView]
    reprojections: list[ReprojectionView]


class DotsView(Message):
    """What all cameras had in a frame."""

    frame: int
    cameras: list[CameraFrame]


class CoverageView(Message):
    """How often each camera saw something in each cell of its image: counts row by row."""

    camera: str
    columns: int
    rows: int
    counts: list[int]
    dots: int
    used: int
    residual_px: float


class AccuracyView(Message):
    """What a rig is worth: cells (x slowest, z fastest) with the cameras that see them and the expected error (mm, −1
    where fewer than two cameras do), for dots with this noise (px).
    """

    x_m: list[float]
    y_m: list[float]
    z_m: list[float]
    cameras: list[int]
    sigma_mm: list[float]
    noise_px: float
    median_mm: float


class RefinedView(Message):
    """A rig adjusted to the take: residuals (px rms) on frames left out, before and after, and where the cameras go."""

    verdict: str
    reasons: list[str]
    before_px: float
    after_px: float
    cameras: list[CameraView]
    moved_mm: dict[str, float]
    turned_deg: dict[str, float]


class RayView(Message):
    """The ray of a centroid that made a marker: its camera, and its direction in world (unit length)."""

    camera: str
    direction: Place


class Why(Message):
    """Why a marker is missing, or what it is made of, in words; a line for each camera where there are dots."""

    text: str
    lines: list[str]
    rays: list[RayView]


class Finding(Message):
    """Something worth a look: a gap, a high residual, a name that may be wrong. Frames of the take, both included."""

    kind: Literal["gap", "residual", "name", "jump", "unlabelled"]
    slot: int
    first: int
    last: int
    text: str


class Findings(Message):
    """All findings in order of time, and what was not looked for."""

    revision: int
    findings: list[Finding]
    notes: list[str]


class Suggestion(Message):
    """A name that a trajectory may have: how far its distances to its neighbours are off (mm, rms)."""

    name: str
    off_mm: float


class Preview(Message):
    """How a method would fill a gap: places (mm) by frame, expected error (mm); ``reason`` where it cannot."""

    method: str
    first: int
    xyz_mm: list[Place]
    expected_mm: float
    reason: str


class EditRequest(Message):
    """Make an edit; ``revision`` is the one the page was looking at."""

    revision: int
    edit: Edit


class RevisionRequest(Message):
    """Undo, redo or process, as seen at ``revision``."""

    revision: int


class ExportRequest(Message):
    """Write the mended take; ``file``: a name with an ending, in the take's own folder of results."""

    file: str
    overwrite: bool = False


class Done(Message):
    """What was done, in words."""

    message: str
    path: str = ""


class Problem(Message):
    """What went wrong, and what to do."""

    error: Literal["refused", "invalid", "conflict", "missing", "failed"]
    message: str


class Notice(Message):
    """What the server tells without being asked: states of takes, and of the file of the one that is open."""

    instance: str
    takes: list[TakeInfo]
    revisions: dict[str, int]
    sources: dict[str, Literal["ok", "changed", "gone"]]


class MarkerView(Message):
    """A marker of a set: side (left, right, middle), segment, colour; place as parts of the stature, or none."""

    name: str
    side: Literal["left", "right", "middle"]
    segment: str
    color: str
    place: Place | None


class MarkerSetView(Message):
    """A marker set that can be edited; ``links``: pairs that are rigidly joined."""

    name: str
    title: str
    markers: list[MarkerView]
    links: list[tuple[str, str]]


class SubjectRequest(Message):
    """Learn a subject from the take as it is, and save it as NAME.toml in the project's folder."""

    name: str
    overwrite: bool = False


class SubjectEdit(Message):
    """A subject's name, and the markers that stay: each by its present name, with the one it gets."""

    name: str
    markers: dict[str, str]


class SubjectView(Message):
    """A subject of the project: its markers, and the distances that vary least (two markers, mean and sd in mm)."""

    file: str
    name: str
    marker_set: str
    markers: list[str]
    poses: float
    firmest: list[tuple[str, str, float, float]]


MESSAGES = (
    *(
        ProjectView,
        TakeView,
        Timeline,
        Series,
        DotsView,
        CoverageView,
        AccuracyView,
        RefinedView,
        Why,
        Findings,
        Suggestion,
        Preview,
    ),
    *(
        EditRequest,
        RevisionRequest,
        ExportRequest,
        Done,
        Problem,
        Notice,
        MarkerSetView,
        SubjectEdit,
        SubjectRequest,
        SubjectView,
    ),
)
