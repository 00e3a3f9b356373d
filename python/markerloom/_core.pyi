"""Types of the extension module; see `crates/py`."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]

class MarkerloomError(Exception): ...
class BytesError(MarkerloomError): ...
class InputError(MarkerloomError): ...
class RigError(MarkerloomError): ...
class NoPointError(MarkerloomError): ...

class Rig:
    def __init__(self, cameras: Sequence[dict[str, Any]]) -> None: ...
    def project(self, camera: int, points: Floats) -> Floats: ...
    def normalise(self, camera: int, pixels: Floats) -> Floats: ...
    def rays(self, camera: int, pixels: Floats) -> Floats: ...
    def sees(self, camera: int, points: Floats) -> NDArray[np.bool_]: ...

class SceneModel:
    def describe(self) -> dict[str, Any]: ...

class Tracker:
    def __init__(
        self,
        rig: Rig,
        model: SceneModel | None,
        rate_hz: float,
        noise_px: float | None = None,
        paper: bool = False,
        heal: bool = False,
        planned: Sequence[tuple[int, int, dict[str, Any]]] = (),
        start: StartPose | None = None,
    ) -> None: ...
    def moved(self, best: bool) -> list[dict[str, Any]]: ...
    def push(self, dots: object, frame: int | None, time_s: float | None, lag_s: Sequence[float]) -> dict[str, Any]: ...
    def record(
        self,
        dots: object,
        frames: Sequence[int],
        times_s: Sequence[float | None],
        lags_s: Sequence[Sequence[float]],
    ) -> None: ...
    def recorded(
        self,
        confirmed_only: bool,
        progress: Callable[[float], object] | None = None,
        lights: tuple[Sequence[int], Sequence[float]] | None = None,
    ) -> dict[str, Any]: ...
    def model(self) -> SceneModel: ...
    def frame_ms(self) -> list[float]: ...

def on_spheres(
    first: tuple[Sequence[float], float],
    predicted: Sequence[float],
    second: tuple[Sequence[float], float] | None = None,
) -> list[float]: ...
def track_points(
    starts: Sequence[int],
    point_m: Floats,
    sigma_m: Floats,
    frames: Sequence[int],
    rate_hz: float,
    confirmed_only: bool,
    paper: bool,
    progress: Callable[[float], object] | None = None,
    start: StartPose | None = None,
) -> dict[str, Any]: ...

class C3d:
    rate_hz: float
    first_frame: int
    n_frames: int
    is_float: bool
    scale: float
    warnings: list[str]
    header: list[int]
    @staticmethod
    def read(bytes: bytes) -> C3d: ...
    @staticmethod
    def empty(rate_hz: float, first_frame: int) -> C3d: ...
    def write(self) -> bytes: ...
    def coordinates(self) -> Floats: ...
    def residuals(self) -> tuple[Floats, NDArray[np.int32]]: ...
    def analog(self) -> NDArray[np.float32]: ...
    def rotations(self) -> NDArray[np.float32]: ...
    def set_points(self, coordinates: Floats, words: Floats) -> None: ...
    def set_rotations(self, values: Floats) -> None: ...
    def strings(self, group: str, name: str) -> list[str]: ...
    def number(self, group: str, name: str) -> float | None: ...
    def numbers(self, group: str, name: str) -> list[float]: ...
    def records(self) -> list[dict[str, Any]]: ...
    def set_strings(self, group: str, name: str, strings: Sequence[str]) -> None: ...
    def set_text(self, group: str, name: str, text: str) -> None: ...
    def set_ints(
        self, group: str, name: str, values: Sequence[int], dimensions: Sequence[int] | None = None
    ) -> None: ...
    def set_floats(
        self, group: str, name: str, values: Sequence[float], dimensions: Sequence[int] | None = None
    ) -> None: ...
    def set_bytes(self, group: str, name: str, values: bytes, dimensions: Sequence[int]) -> None: ...

def estimate_model(rig: Rig, dots: object, noise: float | None = None) -> SceneModel: ...
def reconstruct(
    rig: Rig, dots: object, model: SceneModel, method: str = "optimal", threads: int = 0
) -> dict[str, Any]: ...
def candidates(rig: Rig, dots: object, model: SceneModel) -> dict[str, Any]: ...
def triangulate(
    rig: Rig,
    cameras: Sequence[int],
    pixels: Sequence[Sequence[float]],
    sigma_px: float,
    min_angle_deg: float = 0.5,
    refuse_probability: float = 1e-6,
) -> dict[str, Any]: ...
def two_rays(
    origins: Sequence[Sequence[float]], directions: Sequence[Sequence[float]]
) -> tuple[list[float], float]: ...
def rig(
    shape: str,
    cameras: int,
    distance_m: float,
    elevation_deg: float,
    angle_deg: float,
    size_px: tuple[float, float],
    focal_px: float,
    target_m: tuple[float, float, float],
) -> list[dict[str, Any]]: ...
def cloud(
    seed: int, frame: int, markers: int, size_m: tuple[float, float, float], center_m: tuple[float, float, float]
) -> list[list[float]]: ...
def body_labels(motion: str, markers: int, seed: int) -> list[str]: ...
def body_pose(
    motion: str, markers: int, seed: int, center_m: tuple[float, float, float], time_s: float
) -> tuple[list[list[float]], list[tuple[list[float], list[float], float]]]: ...
def wearing_joints(
    motion: str,
    set: Sequence[tuple[str, str, Sequence[float]]],
    seed: int,
    center_m: Sequence[float],
    t_pose_s: float,
    time_s: float,
) -> list[tuple[str, list[float]]]: ...
def wearing_pose(
    motion: str,
    set: Sequence[tuple[str, str, Sequence[float]]],
    seed: int,
    center_m: tuple[float, float, float],
    t_pose_s: float,
    time_s: float,
) -> tuple[list[list[float]], list[tuple[list[float], list[float], float]]]: ...

Length = tuple[float, float, float]
Heights = list[list[tuple[list[int], Length]]]

def learn_subject(
    xyz_m: Floats, same_segment: Sequence[bool | None], poses: float, noise_m: float
) -> tuple[list[Length | None], Heights]: ...
def learn_more(
    known: tuple[Sequence[Length | None], Heights], known_poses: float, xyz_m: Floats, poses: float, noise_m: float
) -> tuple[list[Length | None], Heights]: ...

Surroundings = tuple[NDArray[np.int64], Floats, Floats, Floats, Floats, Floats, Floats]

def fill_gap(
    way: str, around: Surroundings, first: int, last: int, learn: NDArray[np.int64]
) -> NDArray[np.float64] | None: ...
def in_frames_of(
    neighbours: Floats, marker: Floats, reference: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]: ...

class StartPose:
    def __init__(self, model: LabelModel, independent: float, poses_m: Floats) -> None: ...

class LabelModel:
    def __init__(self, subject: Sequence[int], distances: Sequence[Length | None], heights: Heights) -> None: ...
    def settle(self, xyz_m: Floats, names: Sequence[int]) -> tuple[list[int], float]: ...
    def search(self, xyz_m: Floats) -> tuple[list[int], float, tuple[int, int]]: ...
    def label_take(
        self,
        starts: Sequence[int],
        xyz_m: Floats,
        track: Sequence[int],
        rate_hz: float,
        believed: Sequence[tuple[int, float] | None],
    ) -> tuple[list[int], list[float], float]: ...

class Labeller:
    def __init__(self, model: LabelModel) -> None: ...
    def push(self, time_s: float, tracks: Sequence[int], xyz_m: Floats) -> tuple[list[int], list[float]]: ...

Poses = tuple[Floats, Floats, Floats]

class Figure:
    def __init__(
        self,
        parents: Sequence[int | None],
        offsets_m: Sequence[Sequence[float]],
        orders: Sequence[Sequence[int] | None],
        free: Sequence[Sequence[bool]],
        limits_rad: Sequence[Sequence[Sequence[float]]],
        rest_sd_rad: Sequence[Sequence[float]],
        marker_joint: Sequence[int],
        marker_place_m: Sequence[Sequence[float]],
        marker_sigma_m: Sequence[float],
    ) -> None: ...
    def offsets_m(self) -> Floats: ...
    def places_m(self) -> Floats: ...
    def sigmas_m(self) -> list[float]: ...
    def pose(self, xyz_m: Floats) -> Poses: ...
    def solve(
        self,
        xyz_m: Floats,
        step_s: float,
        pins: Sequence[tuple[int, int, Sequence[float], Sequence[float], float]],
        orientations: Sequence[tuple[int, int, Sequence[float], float]],
    ) -> tuple[Poses, tuple[Floats, Floats]]: ...
    def hold(
        self,
        xyz_m: Floats,
        step_s: float,
        pins: Sequence[tuple[int, int, Sequence[float], Sequence[float], float]],
        orientations: Sequence[tuple[int, int, Sequence[float], float]],
        poses: Poses,
        holds: Sequence[tuple[int, int, Sequence[float], Sequence[float], float]],
    ) -> tuple[Poses, tuple[Floats, Floats]]: ...
    def fit(
        self,
        xyz_m: Floats,
        poses: Poses | None,
        offset_sd_m: Sequence[Sequence[float]],
        place_sd_m: Sequence[float],
        mirrored: Sequence[tuple[int, int, float]],
        pins: Sequence[tuple[int, int, Sequence[float], Sequence[float], float]],
        orientations: Sequence[tuple[int, int, Sequence[float], float]],
    ) -> tuple[Figure, Poses, float]: ...
    def residuals_m(self, xyz_m: Floats, root_m: Floats, root_turn: Floats, turns: Floats) -> Floats: ...

class Follower:
    def __init__(self, figure: Figure, step_s: float) -> None: ...
    def push(self, xyz_m: Floats) -> Poses | None: ...

def observe(
    rig: Rig,
    markers: Sequence[Sequence[float]],
    capsules: Sequence[tuple[Sequence[float], Sequence[float], float]],
    sigma_px: float,
    hide: str,
    merge_px: float,
    clutter_per_frame: float,
    reflections: int,
    seed: int,
    frame: int,
) -> list[tuple[int, float, float, list[int]]]: ...
def read_x2d(bytes: bytes) -> dict[str, Any]: ...
def detect_markers(
    image: object,
    threshold: float | None,
    white: float | None,
    radius_px: float | None,
    blur_px: float | None,
    limits: tuple[int, int],
) -> dict[str, Any]: ...
def calibrate_wand(
    cameras: Sequence[dict[str, Any]],
    known: str,
    markers_m: Sequence[Sequence[float]],
    dots: object,
    left_out_every: int,
    most_poses: int,
) -> dict[str, Any]: ...
def calibrate_points(
    camera: dict[str, Any],
    places_m: Sequence[Sequence[float]],
    pixel: Sequence[Sequence[float]],
    focal_known: bool,
) -> dict[str, Any] | None: ...
def refine_rig(
    rig: Rig,
    points_m: Sequence[Sequence[float]],
    point: Sequence[int],
    camera: Sequence[int],
    pixel: Sequence[Sequence[float]],
) -> tuple[list[dict[str, Any]], list[float]]: ...
def dots_at_moments(
    rig: Rig, dots: object, times_s: Sequence[float], lags_s: Sequence[Sequence[float]], rate_hz: float
) -> dict[str, Any]: ...
def fit_patches(
    patches: Sequence[Sequence[tuple[int, int, int]]], threshold: float, radius_px: float, blur_px: float
) -> list[list[float]]: ...
def synchronise(rig: Rig, first: object, second: object, rate: float) -> dict[str, Any]: ...
def led_codes() -> list[list[bool]]: ...
def decode_leds(
    starts: Sequence[int], pixel: Floats, brightness: Floats, width_px: float, frames_per_bit: int
) -> Ints: ...
def adjust_board(
    rig: Rig,
    corners_m: Sequence[Sequence[float]],
    poses: Sequence[tuple[Sequence[Sequence[float]], Sequence[float]]],
    view: Sequence[Sequence[int]],
    pixel: Sequence[Sequence[float]],
) -> dict[str, Any]: ...
def band_count(frames: int) -> int: ...
def split_bands(values: Floats, count: int) -> Floats: ...
def equalise_bands(values: Floats, gains: Floats) -> Floats: ...

class Clouds:
    def __init__(self, points_m: Floats, weights: Sequence[float], half: int) -> None: ...
    def distances(self, other: Clouds) -> Floats: ...
    def alignment(self, at: int, other: Clouds, other_at: int) -> tuple[float, list[float], float]: ...

def change_motion(
    parents: Sequence[int | None],
    offsets_m: Sequence[Sequence[float]],
    root_m: Floats,
    turns: Floats,
    freedoms: Sequence[tuple[int, Sequence[float], bool, float]],
    goals: Sequence[tuple[str, int, int, Sequence[float], int, Sequence[float], Sequence[float], float]],
    levels: Sequence[tuple[int, float]],
    sharp: Floats,
    tolerance_m: float,
    window: tuple[int, int],
) -> tuple[Floats, Floats, list[float]]: ...
