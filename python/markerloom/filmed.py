"""What the cameras of a simulated scene see of it: their clocks, and the codes of blinking LEDs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from markerloom import _core
from markerloom.errors import InputError, RigError
from markerloom.observations import Observations
from markerloom.rig import Rig

if TYPE_CHECKING:
    from markerloom.simulate import Scene

Array = NDArray[np.floating[Any]]
Capsule = tuple[list[float], list[float], float]
Pose = tuple[list[list[float]], list[Capsule]]

BRIGHT, DIM, BRIGHTNESS_NOISE = 200.0, 90.0, 0.05
"""Grey values of an LED at the cameras' usual distance, and their relative noise."""


class Filmed:
    """Collects dots, and whose they are."""

    def __init__(self, scene: Scene, rig: Rig, labels: list[str]) -> None:
        """Nothing yet."""
        self._scene, self._rig, self._labels = scene, rig, labels
        self._rows: list[tuple[float, ...]] = []
        self._holders: list[tuple[int, str, int, str]] = []
        self._codes = np.array(_core.led_codes(), bool) if scene.leds else np.zeros((0, 0), bool)
        if scene.leds and len(labels) > len(self._codes):
            raise InputError(f"{len(labels)} LEDs: there are codes for {len(self._codes)}")

    def add(self, frame: int, markers: list[list[float]], capsules: list[Capsule]) -> None:
        """What the cameras of the first clock see in a frame."""
        cameras = range(0, len(self._rig), 2 if self._scene.has_two_clocks else 1)
        self._see(frame, frame, float(frame), cameras, markers, capsules)

    def add_second_clock(self, pose: Callable[[float], Pose]) -> None:
        """What every second camera sees, whose clock is its own."""
        scene, last = self._scene, None
        for own in range(int(-scene.offset_frames) - 2, scene.frames + int(abs(scene.offset_frames)) + 2):
            moment = second_clock(scene, own)
            frame = round(moment)
            if own < 0 or not 0 <= moment <= scene.frames - 1 or frame == last:
                continue
            self._see(frame, own, moment, range(1, len(self._rig), 2), *pose(moment))
            last = frame

    def _see(
        self,
        frame: int,
        own: int,
        moment: float,
        cameras: range,
        markers: list[list[float]],
        capsules: list[Capsule],
    ) -> None:
        scene, rig = self._scene, self._rig
        imperfect = (scene.sigma_px, scene.hide, scene.merge_px, scene.clutter_per_frame, scene.reflections)
        try:
            dots = _core.observe(rig.core, markers, capsules, *imperfect, scene.seed, own)
        except RigError as error:
            raise InputError(str(error)) from None
        random = np.random.default_rng([scene.seed, own, 0x1ED])
        count = [0] * len(rig)
        for camera, x, y, whose in dots:
            if camera not in cameras:
                continue
            brightness = self._brightness(frame, camera, whose, markers, random) if scene.leds else np.nan
            self._rows.append((frame, camera, x, y, moment / scene.rate_hz, brightness))
            name = rig.cameras[camera].id
            self._holders += [(frame, name, count[camera], self._labels[m]) for m in whose]
            count[camera] += 1

    def _brightness(
        self, frame: int, camera: int, whose: list[int], markers: list[list[float]], random: np.random.Generator
    ) -> float:
        """Grey value of a dot: its LEDs' bits of this frame, some of them wrong; of a reflection, any."""
        if not whose:
            return float(random.uniform(DIM, BRIGHT))
        level = 0.0
        for marker in whose:
            code = self._codes[marker]
            bit = code[(frame + 7 * marker) % len(code)] ^ (random.uniform() < self._scene.bit_errors)
            away = np.linalg.norm(np.array(markers[marker]) - self._rig.cameras[camera].position_m)
            level += (BRIGHT if bit else DIM) * (self._scene.distance_m / away) ** 2
        return float(level * (1.0 + BRIGHTNESS_NOISE * random.normal()))

    def observations(self) -> Observations:
        """The dots, by frame of the first clock; ``time_s`` where there are two, ``brightness`` of LEDs."""
        scene, rig = self._scene, self._rig
        table = np.array(self._rows, float).reshape(-1, 6)
        table = table[np.argsort(table[:, 0], kind="stable")]
        columns = {"time_s": table[:, 4]} if scene.has_two_clocks else {}
        columns |= {"brightness": table[:, 5]} if scene.leds else {}
        return Observations(
            frame=table[:, 0].astype(np.int64),
            camera=table[:, 1].astype(np.int64),
            camera_ids=tuple(rig.ids),
            pixel=table[:, 2:4].copy(),
            optional=columns,
            rate_hz=scene.rate_hz,
            frames=np.arange(scene.frames),
            source=f"simulated {scene.scene}",
        )

    def assignments(self) -> pa.Table:
        """Labels of every dot."""
        columns = list(zip(*self._holders, strict=True)) or [[], [], [], []]
        names = ("frame", "camera", "observation", "label")
        return pa.table(dict(zip(names, map(list, columns), strict=True)))


def second_clock(scene: Scene, frame: float) -> float:
    """The reference frame, with a fraction, that a frame of the second clock shows."""
    return frame * (1.0 + 1e-6 * scene.drift_ppm) + scene.offset_frames


def recordings_of(observations: Observations, scene: Scene, rig: Rig) -> list[Observations]:
    """One for each clock, with the frame numbers of its own recorder and no common time."""
    if not scene.has_two_clocks:
        return [observations]
    optional = {name: column for name, column in observations.optional.items() if name != "time_s"}
    parts = [replace(observations, optional=optional).of_cameras(rig.ids[clock::2]) for clock in (0, 1)]
    moment = observations.of_cameras(rig.ids[1::2]).optional["time_s"] * scene.rate_hz
    own = np.round((moment - scene.offset_frames) / (1.0 + 1e-6 * scene.drift_ppm)).astype(np.int64)
    none = np.zeros(0, np.int64)
    return [replace(parts[0], frames=none), replace(parts[1], frame=own, frames=none)]
