"""A library of clips on disk, in one SQLite file: motions, moments to search, transitions of a motion graph."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from markerloom.errors import FormatError, InputError
from markerloom.motion.alike import clouds
from markerloom.motion.blend import begun
from markerloom.motion.body import body_of
from markerloom.motion.edited import same_skeleton
from markerloom.motion.feet import Plant
from markerloom.motion.rotations import about_vertical, heading
from markerloom.skeleton.motion import Motion, quaternions
from markerloom.skeleton.skeleton import Site, Skeleton

Array = NDArray[np.floating[Any]]
VERSION = 1
SCHEMA = """
CREATE TABLE about (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE clips (
    id INTEGER PRIMARY KEY, name TEXT NOT NULL, frames INTEGER NOT NULL,
    root_m BLOB NOT NULL, turns BLOB NOT NULL, plants TEXT NOT NULL
);
CREATE TABLE moments (clip INTEGER NOT NULL, frame INTEGER NOT NULL, place BLOB NOT NULL, PRIMARY KEY (clip, frame));
CREATE TABLE transitions (
    from_clip INTEGER NOT NULL, from_frame INTEGER NOT NULL, to_clip INTEGER NOT NULL, to_frame INTEGER NOT NULL,
    distance_m REAL NOT NULL, turn_rad REAL NOT NULL, shift_x_m REAL NOT NULL, shift_y_m REAL NOT NULL
);
"""
MOMENTS_HZ = 30.0
"""So many moments of a second can be searched."""
NEAREST = 400
"""So many moments are compared as clouds after a first search."""


@dataclass(frozen=True)
class Transition:
    """From a frame of one clip a fade leads into a frame of another (or the same), laid onto it by a turn about the
    vertical (rad) and a shift (m); ``distance_m``: how unlike the two are in the middle of the fade.
    """

    from_clip: int
    from_frame: int
    to_clip: int
    to_frame: int
    distance_m: float
    turn_rad: float
    shift_m: tuple[float, float]


@dataclass(frozen=True)
class Library:
    """Clips of one skeleton and rate, their stances, and the transitions between them; a fade takes ``fade`` frames."""

    clips: tuple[Motion, ...]
    plants: tuple[tuple[Plant, ...], ...]
    transitions: tuple[Transition, ...]
    fade: int

    def name(self, clip: int) -> str:
        """What a clip is called: the name of its file."""
        return Path(self.clips[clip].source).stem


@contextmanager
def _opened(path: Path) -> Iterator[sqlite3.Connection]:
    connection = sqlite3.connect(path)
    try:
        yield connection
        connection.commit()
    finally:
        connection.close()


def write_library(library: Library, path: str | Path) -> None:
    """Write a library; the file appears whole or not at all."""
    path = Path(path)
    if path.suffix != ".sqlite":
        raise InputError(f"libraries are written as .sqlite ({path})")
    part = path.with_name(path.name + ".part")
    part.unlink(missing_ok=True)
    try:
        with _opened(part) as db:
            db.executescript(SCHEMA)
            about = {
                "markerloom_library": VERSION,
                "skeleton": _skeleton_json(library.clips[0].skeleton),
                "rate_hz": library.clips[0].rate_hz,
                "fade": library.fade,
            }
            db.executemany("INSERT INTO about VALUES (?, ?)", [(k, json.dumps(v)) for k, v in about.items()])
            for i, (clip, plants) in enumerate(zip(library.clips, library.plants, strict=True)):
                q = np.stack([quaternions(clip.turns[:, j]) for j in range(len(clip.skeleton))], axis=1)
                own = json.dumps([[p.site, p.start, p.stop] for p in plants])
                db.execute(
                    "INSERT INTO clips VALUES (?, ?, ?, ?, ?, ?)",
                    (i, clip.source, len(clip), clip.root_m.astype("<f8").tobytes(), q.astype("<f8").tobytes(), own),
                )
                rows = zip(*_moments(clip), strict=True)
                db.executemany("INSERT INTO moments VALUES (?, ?, ?)", [(i, f, p.tobytes()) for f, p in rows])
            db.executemany(
                "INSERT INTO transitions VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
                [
                    (t.from_clip, t.from_frame, t.to_clip, t.to_frame, t.distance_m, t.turn_rad, *t.shift_m)
                    for t in library.transitions
                ],
            )
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def read_library(path: str | Path) -> Library:
    """Read a library. Raises ``FormatError`` for files that are none."""
    if not Path(path).is_file():
        raise InputError(f"{path} is not there")
    try:
        with _opened(Path(path)) as db:
            about = {k: json.loads(v) for k, v in db.execute("SELECT key, value FROM about")}
            if about.get("markerloom_library") != VERSION:
                raise FormatError(path, f"is a library of version {about.get('markerloom_library')}, not {VERSION}")
            skeleton = _skeleton_of(about["skeleton"])
            clips, plants = [], []
            for name, frames, root, turns, own in db.execute(
                "SELECT name, frames, root_m, turns, plants FROM clips ORDER BY id"
            ):
                q = np.frombuffer(turns, "<f8").reshape(frames * len(skeleton), 4)
                turned = Rotation.from_quat(q).as_matrix().reshape(frames, len(skeleton), 3, 3)
                root_m = np.frombuffer(root, "<f8").reshape(frames, 3).copy()
                clips.append(Motion(skeleton, root_m, turned, float(about["rate_hz"]), source=name))
                plants.append(tuple(Plant(*p) for p in json.loads(own)))
            rows = db.execute("SELECT * FROM transitions ORDER BY rowid").fetchall()
            moves = tuple(Transition(a, i, b, j, d, turn, (x, y)) for a, i, b, j, d, turn, x, y in rows)
            return Library(tuple(clips), tuple(plants), moves, int(about["fade"]))
    except (sqlite3.Error, ValueError, KeyError, TypeError) as error:
        raise FormatError(path, f"is no library of clips: {error}") from None


def of_clips(clips: list[Motion]) -> list[Motion]:
    """Clips that can be in one library; refused where one of them differs in skeleton, size or rate."""
    if len(clips) < 2:
        raise InputError(f"a library needs two clips or more, not {len(clips)}: nothing could follow on anything")
    for clip in clips[1:]:
        same_skeleton(clips[0], clip, f"'{clips[0].source}' and '{clip.source}' cannot be in one library")
    names = [c.source for c in clips]
    twice = next((n for n in names if names.count(n) > 1), None)
    if twice is not None:
        raise InputError(f"the clip '{twice}' is there twice")
    return [replace(c, skeleton=clips[0].skeleton, first_frame=0) for c in clips]


def stances(clips: list[Motion]) -> tuple[tuple[Plant, ...], ...]:
    """The stances of every clip."""
    return tuple(begun(c).plants for c in clips)


def _moments(clip: Motion) -> tuple[list[int], NDArray[np.float32]]:
    """Moments that can be searched: numbers that are near where clouds are, wherever and facing wherever they are."""
    step = max(1, round(clip.rate_hz / MOMENTS_HZ))
    frames = list(range(0, len(clip), step))
    return frames, _places(clip)[frames]


def _places(clip: Motion) -> NDArray[np.float32]:
    """Joints from the root, turned so that it faces one way, and where they are a little later."""
    facing = heading(clip.turns[:, 0], body_of(clip.skeleton).lateral())
    back = about_vertical(-facing)
    places = clip.joints_m()
    ahead = np.minimum(np.arange(len(clip)) + max(1, round(0.1 * clip.rate_hz)), len(clip) - 1)
    origin = clip.root_m * np.array([1.0, 1.0, 0.0])
    now = np.einsum("fab,fjb->fja", back, places - origin[:, None])
    then = np.einsum("fab,fjb->fja", back, places[ahead] - origin[:, None])
    both = np.concatenate([now, then], axis=1).reshape(len(clip), -1)
    return both.astype(np.float32)


@dataclass(frozen=True)
class Found:
    """A moment like another one: clip, frame, and the distance of their clouds (m)."""

    clip: int
    frame: int
    distance_m: float


def find(path: str | Path, motion: Motion, frame: int, count: int = 5) -> list[Found]:
    """The moments of a library most like a frame (from 0) of a clip, at most one for each half second."""
    if not 0 <= frame < len(motion):
        raise InputError(f"frame {frame} is not in the clip, which has {len(motion)} frames ({motion.source})")
    library = read_library(path)
    same_skeleton(library.clips[0], motion, f"'{motion.source}' cannot be searched in {path}")
    with _opened(Path(path)) as db:
        rows = db.execute("SELECT clip, frame, place FROM moments ORDER BY clip, frame").fetchall()
    table = np.stack([np.frombuffer(place, np.float32) for _, _, place in rows])
    away = np.linalg.norm(table - _places(motion)[frame], axis=1)
    near = np.argsort(away, kind="stable")[:NEAREST]
    query = clouds(motion)
    known = {c: clouds(library.clips[c]) for c in sorted({rows[n][0] for n in near})}
    found = [Found(rows[n][0], rows[n][1], query.alignment(frame, known[rows[n][0]], rows[n][1])[2]) for n in near]
    out: list[Found] = []
    apart = 0.5 * motion.rate_hz
    for f in sorted(found, key=lambda f: (f.distance_m, f.clip, f.frame)):
        if all(f.clip != o.clip or abs(f.frame - o.frame) >= apart for o in out):
            out.append(f)
    return out[:count]


def _skeleton_json(skeleton: Skeleton) -> dict[str, Any]:
    return {
        "name": skeleton.name,
        "joints": list(skeleton.joints),
        "parents": list(skeleton.parents),
        "offsets_m": skeleton.offsets_m.tolist(),
        "orders": list(skeleton.orders),
        "turns_about": list(skeleton.turns_about),
        "free": skeleton.free.tolist(),
        "limits_rad": skeleton.limits_rad.tolist(),
        "sites": [[s.name, s.joint, list(s.place_m)] for s in skeleton.sites],
        "segments": skeleton.segments,
        "aliases": skeleton.aliases,
    }


def _skeleton_of(content: dict[str, Any]) -> Skeleton:
    return Skeleton(
        name=content["name"],
        joints=tuple(content["joints"]),
        parents=tuple(content["parents"]),
        offsets_m=np.array(content["offsets_m"]),
        sites=tuple(Site(n, j, (p[0], p[1], p[2])) for n, j, p in content["sites"]),
        orders=tuple(content["orders"]),
        turns_about=tuple(content["turns_about"]),
        free=np.array(content["free"], bool),
        limits_rad=np.array(content["limits_rad"]),
        segments=content["segments"],
        aliases=content["aliases"],
    )
