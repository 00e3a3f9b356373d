"""Simulated takes with truth: a scene, a seed, and everything the cameras would see.

Scenes: ``exp61`` (the seed paper's experiment 6.1), ``cloud`` (random points in a larger volume), ``walk`` and
``dance`` (an articulated figure whose trunk and limbs hide markers), ``duet`` (two dancers who touch), ``wand`` (a
calibration wand waved through the volume).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import tomlkit
from scipy.spatial.transform import Rotation

from markerloom import _core
from markerloom.calibrate.wands import read_wand
from markerloom.errors import InputError, RigError
from markerloom.filmed import Capsule, Filmed, Pose, recordings_of
from markerloom.formats import calib_toml, table_file, write_observations
from markerloom.formats.files import write_text
from markerloom.observations import Observations
from markerloom.points import Points
from markerloom.reconstruct import Progress
from markerloom.rig import Camera, Rig
from markerloom.subjects.marker_set import read_marker_set

EXP61_BOX_M = (0.497843, 0.788865, 0.748485)


@dataclass(frozen=True)
class Scene:
    """Everything that decides about a simulated take. Units stand in the names."""

    scene: str = "exp61"
    seed: int = 0
    frames: int = 100
    markers: int = 33
    rate_hz: float = 100.0
    cameras: int = 4
    shape: str = "ring"
    distance_m: float = 2.0
    elevation_deg: float = 30.0
    angle_deg: float = 45.0
    image_width: int = 640
    image_height: int = 480
    focal_px: float = 757.0
    sigma_px: float = 2.0
    hide: str = "one"
    merge_px: float = 0.0
    clutter_per_frame: float = 0.0
    reflections: int = 0
    box_x_m: float = EXP61_BOX_M[0]
    box_y_m: float = EXP61_BOX_M[1]
    box_z_m: float = EXP61_BOX_M[2]
    wand: str = "vicon-t"
    offset_frames: float = 0.0
    drift_ppm: float = 0.0
    leds: bool = False
    bit_errors: float = 0.05
    marker_set: str = ""
    t_pose_s: float = 0.0

    @property
    def has_two_clocks(self) -> bool:
        """Whether every second camera has a clock of its own: its frame n shows n · (1 + drift) + offset."""
        return self.offset_frames != 0.0 or self.drift_ppm != 0.0

    @property
    def center_m(self) -> tuple[float, float, float]:
        """What the cameras look at: figures stand on the floor, clouds float at the origin."""
        return (0.0, 0.0, 1.0) if self.scene in (*FIGURES, "wand") else (0.0, 0.0, 0.0)


FIGURES = ("walk", "dance", "rom", "duet")
DUET_DISTANCE_M = 0.7
FIGURE: dict[str, object] = {
    "markers": 41,
    "cameras": 8,
    "distance_m": 4.5,
    "elevation_deg": 20.0,
    "image_width": 1280,
    "image_height": 1024,
    "focal_px": 1300.0,
    "sigma_px": 0.2,
    "hide": "0.02",
    "merge_px": 3.0,
    "clutter_per_frame": 0.3,
    "reflections": 1,
}
PRESETS: dict[str, dict[str, object]] = {
    "exp61": {},
    "cloud": {"cameras": 8, "sigma_px": 0.3, "hide": "quarter"},
    "walk": FIGURE,
    "dance": FIGURE,
    "rom": FIGURE | {"frames": 4000},
    "duet": FIGURE | {"markers": 82, "cameras": 12},
    "wand": FIGURE
    | {"frames": 1000, "markers": 5, "sigma_px": 0.1, "hide": "0.02", "reflections": 1, "clutter_per_frame": 0.2}
    | {"box_x_m": 2.4, "box_y_m": 2.4, "box_z_m": 1.6},
}


@dataclass(frozen=True)
class SimulatedTake:
    """A take with its truth: points with labels, and the labels of every observation."""

    scene: Scene
    rig: Rig
    observations: Observations
    truth: Points
    truth_assignments: pa.Table

    def recordings(self) -> list[Observations]:
        """What the recorders of the take would have written: one for each clock, with its own frame numbers."""
        return recordings_of(self.observations, self.scene, self.rig)


def make_scene(name: str, **changes: object) -> Scene:
    """A preset with changes; values of ``None`` are not changes."""
    if name not in PRESETS:
        raise InputError(f"scene '{name}': choose one of {', '.join(PRESETS)}")
    known = {f.name for f in fields(Scene)}
    given = {k: v for k, v in changes.items() if v is not None}
    unknown = sorted(set(given) - known)
    if unknown:
        raise InputError(f"a scene has no '{unknown[0]}'; it has {', '.join(sorted(known))}")
    scene = replace(Scene(scene=name), **{**PRESETS[name], **given})  # pyright: ignore[reportArgumentType]
    for field_name in (
        "frames",
        "markers",
        "cameras",
        "image_width",
        "image_height",
        "focal_px",
        "rate_hz",
        "distance_m",
    ):
        if not getattr(scene, field_name) > 0:
            raise InputError(f"{field_name} must be positive, not {getattr(scene, field_name)}")
    for field_name in ("sigma_px", "merge_px", "clutter_per_frame", "reflections", "seed"):
        if not 0 <= getattr(scene, field_name) < 1e9:
            raise InputError(f"{field_name} must not be negative or huge, but is {getattr(scene, field_name)}")
    if scene.has_two_clocks and scene.scene in ("exp61", "cloud"):
        raise InputError(f"the points of scene '{scene.scene}' do not move: two clocks need walk, dance, duet or wand")
    if scene.marker_set:
        if scene.scene not in FIGURES:
            raise InputError(f"scene '{scene.scene}' has nobody to wear a marker set: {', '.join(FIGURES)}")
        figures = 2 if scene.scene == "duet" else 1
        scene = replace(scene, markers=figures * len(_worn(scene.marker_set)))
    if not 0.0 <= scene.bit_errors < 0.5:
        raise InputError(f"bit_errors must be a probability below 0.5, not {scene.bit_errors}")
    return scene


def make_rig(scene: Scene) -> Rig:
    """The rig of a scene."""
    try:
        described = _core.rig(
            scene.shape,
            scene.cameras,
            scene.distance_m,
            scene.elevation_deg,
            scene.angle_deg,
            (scene.image_width, scene.image_height),
            scene.focal_px,
            scene.center_m,
        )
    except RigError as error:
        raise InputError(str(error)) from None
    cameras = [
        Camera(
            id=f"cam_{int(d['id']):02d}",
            size_px=tuple(d["size_px"]),
            focal_px=tuple(d["focal_px"]),
            principal_px=tuple(d["principal_px"]),
            rotation=np.array(d["rotation"]),
            position_m=np.array(d["position_m"]),
        )
        for d in described
    ]
    return Rig.of(cameras, source="simulated")


def simulate(scene: Scene, *, progress: Progress | None = None) -> SimulatedTake:
    """Simulate a take; the same scene gives the same take on every machine."""
    rig = make_rig(scene)
    labels = _labels(scene)
    filmed = Filmed(scene, rig, labels)
    positions = np.zeros((scene.frames, len(labels), 3))
    for frame in range(scene.frames):
        positions[frame], capsules = _markers(scene, frame)
        filmed.add(frame, positions[frame].tolist(), capsules)
        if progress:
            progress(frame + 1, scene.frames)
    if scene.has_two_clocks:
        filmed.add_second_clock(lambda moment: _markers(scene, moment))
    frame_of, marker_of = np.divmod(np.arange(scene.frames * len(labels)), len(labels))
    truth = Points.of(
        frame_of,
        marker_of,
        1000.0 * positions.reshape(-1, 3),
        label=np.array(labels, dtype=str)[marker_of],
        rate_hz=scene.rate_hz,
        frames=np.arange(scene.frames),
        source=f"simulated {scene.scene}",
    )
    return SimulatedTake(scene, rig, filmed.observations(), truth, filmed.assignments())


def _labels(scene: Scene) -> list[str]:
    if scene.scene == "wand":
        return list(read_wand(scene.wand).markers)
    if scene.scene not in FIGURES:
        return [f"M{i + 1:03d}" for i in range(scene.markers)]
    figures = _figures(scene)
    if scene.marker_set:
        names = [list(read_marker_set(scene.marker_set).markers) for _ in figures]
    else:
        names = [_core.body_labels(motion, markers, seed) for motion, markers, seed, _ in figures]
    if len(figures) == 1:
        return names[0]
    return [f"{person}:{name}" for person, own in zip("AB", names, strict=True) for name in own]


def _figures(scene: Scene) -> list[tuple[str, int, int, tuple[float, float, float]]]:
    """Motion, number of markers, seed and place of each figure."""
    if scene.scene != "duet":
        return [(scene.scene, scene.markers, scene.seed, (0.0, 0.0, 0.0))]
    half, apart = scene.markers // 2, DUET_DISTANCE_M / 2
    return [
        ("dance", scene.markers - half, 2 * scene.seed, (-apart, 0.0, 0.0)),
        ("dance", half, 2 * scene.seed + 1, (apart, 0.0, 0.0)),
    ]


def _markers(scene: Scene, frame: float) -> Pose:
    """Markers and what hides them at a frame, or between two where the scene moves."""
    if scene.scene == "wand":
        return wave(scene, frame), []
    if scene.scene not in FIGURES:
        box = (scene.box_x_m, scene.box_y_m, scene.box_z_m)
        return _core.cloud(scene.seed, int(frame), scene.markers, box, scene.center_m), []
    time_s = frame / scene.rate_hz
    markers: list[list[float]] = []
    capsules: list[Capsule] = []
    for motion, count, seed, center in _figures(scene):
        if scene.marker_set:
            own = _core.wearing_pose(motion, _worn(scene.marker_set), seed, center, scene.t_pose_s, time_s)
        else:
            own = _core.body_pose(motion, count, seed, center, time_s)
        markers += own[0]
        capsules += own[1]
    return markers, capsules


def joints_of(scene: Scene) -> Points | None:
    """Joint centres of a figure that wears a marker set, as points; ``None`` for other scenes."""
    if not scene.marker_set or scene.scene not in FIGURES:
        return None
    frames, labels = [], []
    for frame in range(scene.frames):
        found = []
        for person, (motion, _, seed, center) in zip("AB", _figures(scene), strict=False):
            own = _core.wearing_joints(
                motion, _worn(scene.marker_set), seed, center, scene.t_pose_s, frame / scene.rate_hz
            )
            found += [(f"{person}:{name}" if scene.scene == "duet" else name, place) for name, place in own]
        labels = [name for name, _ in found]
        frames.append([place for _, place in found])
    frame_of, joint_of = np.divmod(np.arange(scene.frames * len(labels)), len(labels))
    return Points.of(
        frame_of,
        joint_of,
        1000.0 * np.array(frames).reshape(-1, 3),
        label=np.array(labels, dtype=str)[joint_of],
        rate_hz=scene.rate_hz,
        frames=np.arange(scene.frames),
        source=f"simulated {scene.scene}",
    )


@cache
def _worn(marker_set: str) -> list[tuple[str, str, list[float]]]:
    """A marker set as the figure wears it: names, segments of the figure, places."""
    worn = read_marker_set(marker_set)
    if not np.isfinite(worn.places).all():
        raise InputError(f"marker set '{marker_set}' has no places on the body: nobody can wear it")
    rows = zip(worn.markers, worn.segments, worn.places.tolist(), strict=True)
    return [(name, _segment_of_figure(segment), place) for name, segment, place in rows]


def _segment_of_figure(segment: str) -> str:
    side, _, part = segment.partition("_")
    return f"{part}_{side[0]}" if side in ("left", "right") else segment


WAVES_HZ = (0.11, 0.17, 0.29, 0.41)
"""Frequencies of the sines of which a wave consists: none is a multiple of another, so that it never repeats."""


def wave(scene: Scene, frame: float) -> list[list[float]]:
    """Places (m) of the wand's markers: positions and turns are sums of slow sines with phases from the seed."""
    phase = np.random.default_rng([scene.seed, 0x3A4D]).uniform(0.0, 2.0 * np.pi, (6, len(WAVES_HZ)))
    time_s = frame / scene.rate_hz
    rate = np.array(WAVES_HZ)
    share = np.array([0.6, 0.5, 0.3, 0.2]) / 1.1
    sines = (share * np.sin(2.0 * np.pi * (rate * (1.0 + 0.13 * np.arange(6)[:, None]) * time_s) + phase)).sum(axis=1)
    box = np.array([scene.box_x_m, scene.box_y_m, scene.box_z_m])
    middle = np.array(scene.center_m) + 0.5 * box * np.clip(sines[:3], -1.0, 1.0)
    turn = Rotation.from_rotvec(np.pi * sines[3:]).as_matrix()
    places = read_wand(scene.wand).places_m
    return ((places - places.mean(axis=0)) @ turn.T + middle).tolist()


def save(take: SimulatedTake, folder: str | Path) -> None:
    """Write calibration.toml, observations.parquet, truth.parquet, truth_assignments.parquet and scene.toml; of figures
    that wear a marker set also truth_joints.parquet, the joint centres.

    With two clocks also recording_1.parquet and recording_2.parquet: what the recorders would have written.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"the folder {folder} cannot be made: {error.strerror}") from None
    calib_toml.write(take.rig, folder / "calibration.toml")
    write_observations(take.observations, folder / "observations.parquet")
    if take.scene.has_two_clocks:
        for number, recording in enumerate(take.recordings(), start=1):
            write_observations(recording, folder / f"recording_{number}.parquet")
    _save_truth(take.truth, folder / "truth.parquet")
    joints = joints_of(take.scene)
    if joints is not None:
        _save_truth(joints, folder / "truth_joints.parquet")
    table_file.write(take.truth_assignments, folder / "truth_assignments.parquet")
    write_text(folder / "scene.toml", tomlkit.dumps(asdict(take.scene)))


def _save_truth(truth: Points, path: Path) -> None:
    table = pa.table(
        {
            "frame": truth.frame,
            "label": truth.label.astype(str),
            **{f"{axis}_mm": truth.xyz_mm[:, i] for i, axis in enumerate("xyz")},
        }
    )
    metadata = {"rate_hz": repr(truth.rate_hz), "units": "mm", "up_axis": "z"}
    table_file.write(table.replace_schema_metadata(metadata), path)
