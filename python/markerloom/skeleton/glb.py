"""glTF 2.0 binary (.glb): a skinned figure whose joints move; for three.js, Blender and the web."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import InputError
from markerloom.formats.files import write_bytes
from markerloom.skeleton.motion import Motion, quaternions
from markerloom.skeleton.skeleton import Skeleton

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
