"""glTF 2.0 binary (.glb): a skinned figure whose joints move; for three.js, Blender and the web.

Read are the joints of the file's first skin (without one, all nodes that its first animation moves), their bind pose as
the rest pose, and the first animation, at an even rate.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from markerloom.errors import FormatError, InputError
from markerloom.formats.files import write_bytes
from markerloom.skeleton.motion import Motion, quaternions, with_rest
from markerloom.skeleton.skeleton import Site, Skeleton

Array = NDArray[np.floating[Any]]
THICK = 0.12
"""Half width of a bone as a part of its length."""


def write(motion: Motion, path: str | Path) -> None:
    """Write a motion in its own axes (Y up by the format's rule), in metres. Needs the extra `export`."""
    try:
        gltf: Any = import_module("pygltflib")
    except ImportError:
        raise InputError("for .glb, pygltflib is needed: pip install 'markerloom[export]'") from None
    skeleton = motion.skeleton
    n = len(skeleton)
    made = gltf.GLTF2(asset=gltf.Asset(version="2.0", generator="markerloom"))
    blob = _Blob(gltf, made)
    for j, name in enumerate(skeleton.joints):
        offset = motion.root_m[0] if j == 0 and len(motion) else skeleton.offsets_m[j]
        made.nodes.append(
            gltf.Node(name=name, translation=offset.tolist(), children=skeleton.children(j), rotation=[0, 0, 0, 1])
        )
    places = skeleton.places_m() + (motion.root_m[0] if len(motion) else 0.0)
    vertices, faces, owners = _bones(skeleton, places)
    inverse = np.tile(np.eye(4, dtype=np.float32), (n, 1, 1))
    inverse[:, 3, :3] = -places
    made.skins.append(gltf.Skin(joints=list(range(n)), skeleton=0, inverseBindMatrices=blob.add(inverse, "MAT4")))
    weights = np.zeros((len(vertices), 4), np.float32)
    weights[:, 0] = 1.0
    joints = np.zeros((len(vertices), 4), np.uint16)
    joints[:, 0] = owners
    attributes = gltf.Attributes(
        POSITION=blob.add(vertices.astype(np.float32), "VEC3", bounds=True),
        JOINTS_0=blob.add(joints, "VEC4"),
        WEIGHTS_0=blob.add(weights, "VEC4"),
    )
    made.meshes.append(
        gltf.Mesh(
            primitives=[gltf.Primitive(attributes=attributes, indices=blob.add(faces.astype(np.uint32), "SCALAR"))]
        )
    )
    made.nodes.append(gltf.Node(name="figure", mesh=0, skin=0))
    for site in skeleton.sites:
        made.nodes[site.joint].children.append(len(made.nodes))
        made.nodes.append(gltf.Node(name=site.name, translation=list(site.place_m)))
    made.scenes.append(gltf.Scene(nodes=[0, n]))
    made.scene = 0
    if len(motion):
        made.animations.append(_animation(gltf, blob, motion))
    made.buffers.append(gltf.Buffer(byteLength=len(blob.data)))
    made.set_binary_blob(bytes(blob.data))
    write_bytes(path, b"".join(made.save_to_bytes()))


class _Blob:
    """The file's numbers, and who reads them."""

    def __init__(self, gltf: Any, made: Any) -> None:
        self.gltf, self.made, self.data = gltf, made, bytearray()

    def add(self, values: NDArray[Any], kind: str, *, bounds: bool = False) -> int:
        """Append an array; returns its accessor."""
        codes = {"float32": 5126, "uint16": 5123, "uint32": 5125}
        self.data += b"\0" * (-len(self.data) % 4)
        raw = np.ascontiguousarray(values).tobytes()
        self.made.bufferViews.append(self.gltf.BufferView(buffer=0, byteOffset=len(self.data), byteLength=len(raw)))
        self.data += raw
        flat = values.reshape(len(values), -1) if kind != "SCALAR" else values.reshape(-1, 1)
        self.made.accessors.append(
            self.gltf.Accessor(
                bufferView=len(self.made.bufferViews) - 1,
                componentType=codes[str(values.dtype)],
                count=len(flat),
                type=kind,
                min=flat.min(axis=0).tolist() if bounds else None,
                max=flat.max(axis=0).tolist() if bounds else None,
            )
        )
        return len(self.made.accessors) - 1


def _animation(gltf: Any, blob: _Blob, motion: Motion) -> Any:
    times = blob.add((np.arange(len(motion)) / motion.rate_hz).astype(np.float32), "SCALAR", bounds=True)
    animation = gltf.Animation(name="motion", samplers=[], channels=[])

    def channel(node: int, path: str, values: Array, kind: str) -> None:
        output = blob.add(values.astype(np.float32), kind)
        animation.samplers.append(gltf.AnimationSampler(input=times, output=output, interpolation="LINEAR"))
        target = gltf.AnimationChannelTarget(node=node, path=path)
        animation.channels.append(gltf.AnimationChannel(sampler=len(animation.samplers) - 1, target=target))

    channel(0, "translation", motion.root_m, "VEC3")
    for j in range(len(motion.skeleton)):
        if j == 0 or np.ptp(motion.turns[:, j], axis=0).max() > 0 or not np.allclose(motion.turns[0, j], np.eye(3)):
            channel(j, "rotation", quaternions(motion.turns[:, j]), "VEC4")
        if j > 0 and motion.shifts_m is not None:
            channel(j, "translation", motion.shifts_m[:, j], "VEC3")
    return animation


def _bones(skeleton: Skeleton, places: Array) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
    """An octahedron for every bone: corners, triangles, and the joint that moves each corner."""
    ends = [(p, places[p], places[j]) for j, p in enumerate(skeleton.parents) if p >= 0]
    ends += [(s.joint, places[s.joint], places[s.joint] + np.array(s.place_m)) for s in skeleton.sites]
    ring = [(1, 2), (2, 3), (3, 4), (4, 1)]
    vertices, faces, owners = [], [], []
    for joint, a, b in ends:
        length = float(np.linalg.norm(b - a))
        if length < 1e-6:
            continue
        along = (b - a) / length
        side = np.cross(along, np.eye(3)[int(np.argmin(np.abs(along)))])
        side /= np.linalg.norm(side)
        other = np.cross(along, side)
        waist = a + 0.2 * (b - a)
        first = len(vertices)
        vertices += [a, *(waist + THICK * length * s for s in (side, other, -side, -other)), b]
        faces += [(first, first + k, first + i) for i, k in ring] + [(first + 5, first + i, first + k) for i, k in ring]
        owners += [joint] * 6
    return np.array(vertices), np.array(faces).reshape(-1), np.array(owners)


def read(path: str | Path, rate_hz: float | None = None) -> Motion:
    """A motion in the file's axes (Y up), in metres; ``rate_hz``: unless given, that of the file's own key frames.

    Raises ``FormatError`` for files that are no glTF, have no joints, or move by scaling. Needs the extra `export`.
    """
    try:
        gltf: Any = import_module("pygltflib")
    except ImportError:
        raise InputError("for .glb, pygltflib is needed: pip install 'markerloom[export]'") from None
    if not Path(path).is_file():
        raise InputError(f"there is no file {path}")
    try:
        file = _File(gltf.GLTF2.load_binary(str(path)), path)
        return file.motion(rate_hz)
    except FormatError:
        raise
    except Exception as error:  # noqa: BLE001 - the library fails in many ways on broken bytes
        raise FormatError(path, f"is no glTF binary that can be read: {type(error).__name__}") from None


KINDS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
COUNTS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}


class _File:
    """A file's nodes, and what its first animation says of them."""

    def __init__(self, content: Any, path: str | Path) -> None:
        self.content, self.path = content, path
        self.blob = content.binary_blob() or b""
        self.nodes = content.nodes
        self.parent = {c: n for n, node in enumerate(self.nodes) for c in node.children or []}

    def numbers(self, accessor: int) -> Array:
        """An accessor's values (count, numbers)."""
        a = self.content.accessors[accessor]
        view = self.content.bufferViews[a.bufferView]
        width = COUNTS[a.type]
        kind = np.dtype(KINDS[a.componentType])
        start = (view.byteOffset or 0) + (a.byteOffset or 0)
        stride = view.byteStride or kind.itemsize * width
        rows = np.lib.stride_tricks.as_strided(
            np.frombuffer(self.blob[start : start + stride * (a.count - 1) + kind.itemsize * width], np.uint8),
            (a.count, kind.itemsize * width),
            (stride, 1),
        )
        values = np.ascontiguousarray(rows).view(kind).reshape(a.count, width).astype(float)
        return values / np.iinfo(kind).max if a.normalized else values

    def joints(self) -> list[int]:
        """Nodes of the skeleton, parents before children, with what lies between them."""
        if self.content.skins:
            own = set(self.content.skins[0].joints)
        else:
            moved = self.content.animations[0].channels if self.content.animations else []
            own = {c.target.node for c in moved if c.target.node is not None}
        if not own:
            raise FormatError(self.path, "has no joints: neither a skin nor an animation of nodes")
        depth = {n: len(self.above(n)) for n in own}
        top = min(own, key=lambda n: (depth[n], n))
        inside = {n for n in own if top in (n, *self.above(n))}
        for n in sorted(inside):
            inside |= {a for a in self.above(n) if top in self.above(a)}
        order: list[int] = []
        waiting = [top]
        while waiting:
            n = waiting.pop(0)
            order.append(n)
            waiting = [c for c in self.nodes[n].children or [] if c in inside] + waiting
        return order

    def above(self, node: int) -> list[int]:
        """The nodes above one, nearest first."""
        way = []
        while node in self.parent and len(way) <= len(self.nodes):
            node = self.parent[node]
            way.append(node)
        return way

    def motion(self, rate_hz: float | None) -> Motion:
        """The joints' motion."""
        order = self.joints()
        index = {n: j for j, n in enumerate(order)}
        turn, shift, size = self._outside(order[0])
        sites = [
            Site(self.nodes[c].name or f"end_{c}", index[n], tuple((size * self._place(c)).tolist()))
            for n in order
            for c in self.nodes[n].children or []
            if c not in index and self.nodes[c].mesh is None and not self.nodes[c].children
        ]
        names = [self.nodes[n].name or f"node_{n}" for n in order]
        skeleton = Skeleton(
            name=Path(self.path).stem,
            joints=tuple(n if names.count(n) == 1 else f"{n}_{k}" for k, n in enumerate(names)),
            parents=tuple(-1 if j == 0 else index[self.parent[n]] for j, n in enumerate(order)),
            offsets_m=np.array([np.zeros(3) if j == 0 else size * self._place(n) for j, n in enumerate(order)]),
            sites=tuple(sites),
        )
        times, tracks = self._tracks(order)
        rate = rate_hz or _rate(times)
        at = np.arange(int(np.floor((times[-1] - times[0]) * rate + 1e-6)) + 1) / rate + times[0]
        turns = np.empty((len(at), len(order), 3, 3))
        shifts = np.empty((len(at), len(order), 3))
        for j, n in enumerate(order):
            own = tracks.get(n, {})
            turns[:, j] = _turned(own["rotation"], at) if "rotation" in own else self._turn(n)
            shifts[:, j] = size * (_moved(own["translation"], at) if "translation" in own else self._place(n))
        root_m = shift + shifts[:, 0] @ turn.T
        turns[:, 0] = turn @ turns[:, 0]
        still = np.ptp(shifts[:, 1:], axis=0).max(initial=0.0) < 1e-6
        own = Motion(skeleton, root_m, turns, rate, shifts_m=None if still else shifts, source=str(self.path))
        rest = np.empty((len(order), 3, 3))
        for j, p in enumerate(skeleton.parents):
            local = self._turn(order[j])
            rest[j] = turn @ local if p < 0 else rest[p] @ local
        return with_rest(own, rest)

    def _place(self, node: int) -> Array:
        return np.array(self.nodes[node].translation or [0.0, 0.0, 0.0], float)

    def _turn(self, node: int) -> Array:
        return Rotation.from_quat(self.nodes[node].rotation or [0.0, 0.0, 0.0, 1.0]).as_matrix()

    def _outside(self, root: int) -> tuple[Array, Array, float]:
        """Turn, place and size of what the root hangs from."""
        turn, shift, size = np.eye(3), np.zeros(3), 1.0
        for n in reversed(self.above(root)):
            shift = shift + turn @ (size * self._place(n))
            turn = turn @ self._turn(n)
            size *= float((self.nodes[n].scale or [1.0])[0])
        return turn, shift, size

    def _tracks(self, order: list[int]) -> tuple[Array, dict[int, dict[str, tuple[Array, Array, str]]]]:
        """All key times, and of each node what the first animation says of it."""
        tracks: dict[int, dict[str, tuple[Array, Array, str]]] = {}
        if not self.content.animations:
            return np.zeros(1), tracks
        animation = self.content.animations[0]
        for channel in animation.channels:
            if channel.target.node not in order or channel.target.path == "weights":
                continue
            sampler = animation.samplers[channel.sampler]
            times, values = self.numbers(sampler.input)[:, 0], self.numbers(sampler.output)
            kind = sampler.interpolation or "LINEAR"
            if kind == "CUBICSPLINE":
                values = values.reshape(len(times), 3, -1)[:, 1]
            if channel.target.path == "scale":
                if np.ptp(values, axis=0).max(initial=0.0) > 0.01:
                    raise FormatError(self.path, f"node '{self.nodes[channel.target.node].name}' changes its size")
                continue
            tracks.setdefault(channel.target.node, {})[channel.target.path] = (times, values, kind)
        every = [own[0] for track in tracks.values() for own in track.values()]
        return np.unique(np.concatenate(every)) if every else np.zeros(1), tracks


def _rate(times: Array) -> float:
    """The rate of key times; times have few digits: rates that are nearly whole are."""
    if len(times) < 2:
        return 30.0
    rate = (len(times) - 1) / float(times[-1] - times[0])
    return float(round(rate)) if abs(rate - round(rate)) < 1e-4 * rate else rate


def _moved(track: tuple[Array, Array, str], at: Array) -> Array:
    times, values, kind = track
    if kind == "STEP":
        return values[np.clip(np.searchsorted(times, at + 1e-9, side="right") - 1, 0, len(times) - 1)]
    return np.stack([np.interp(at, times, values[:, k]) for k in range(3)], axis=1)


def _turned(track: tuple[Array, Array, str], at: Array) -> Array:
    times, values, kind = track
    turns = Rotation.from_quat(values)
    if kind == "STEP" or len(times) == 1:
        return turns.as_matrix()[np.clip(np.searchsorted(times, at + 1e-9, side="right") - 1, 0, len(times) - 1)]
    return Slerp(times, turns)(np.clip(at, times[0], times[-1])).as_matrix()
