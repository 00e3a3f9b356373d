"""USD with UsdSkel (.usda, .usdc): skeleton and animation; for film tools, Omniverse and Houdini."""

from __future__ import annotations

import tempfile
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from markerloom.errors import InputError
from markerloom.formats.files import write_bytes
from markerloom.skeleton.motion import Motion, quaternions
from markerloom.skeleton.skeleton import Skeleton


def write(motion: Motion, path: str | Path, up: str) -> None:
    """Write a motion in its own axes, whose up axis is ``up``, in metres. Needs the extra `export`."""
    try:
        gf, usd, geom, skel, vt = (import_module(f"pxr.{m}") for m in ("Gf", "Usd", "UsdGeom", "UsdSkel", "Vt"))
    except ImportError:
        raise InputError("for .usda, usd-core is needed: pip install 'markerloom[export]'") from None
    skeleton = motion.skeleton
    stage = usd.Stage.CreateInMemory()
    geom.SetStageUpAxis(stage, geom.Tokens.y if up == "y" else geom.Tokens.z)
    geom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(motion.rate_hz)
    stage.SetFramesPerSecond(motion.rate_hz)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(max(len(motion) - 1, 0))
    root = skel.Root.Define(stage, "/Figure")
    stage.SetDefaultPrim(root.GetPrim())
    made = skel.Skeleton.Define(stage, "/Figure/Skeleton")
    paths = joint_paths(skeleton)
    made.CreateJointsAttr(paths)
    made.CreateJointNamesAttr(list(skeleton.joints))

    def matrices(places: Any) -> Any:
        return vt.Matrix4dArray([gf.Matrix4d().SetTranslate(gf.Vec3d(*map(float, p))) for p in places])

    made.CreateBindTransformsAttr(matrices(skeleton.places_m()))
    made.CreateRestTransformsAttr(matrices(skeleton.offsets_m))
    animation = skel.Animation.Define(stage, "/Figure/Skeleton/Motion")
    animation.CreateJointsAttr(paths)
    places, turns, scales = (
        animation.CreateTranslationsAttr(),
        animation.CreateRotationsAttr(),
        animation.CreateScalesAttr(),
    )
    scales.Set(vt.Vec3hArray([gf.Vec3h(1, 1, 1)] * len(skeleton)))
    q = np.stack([quaternions(motion.turns[:, j]) for j in range(len(skeleton))], axis=1) if len(motion) else []
    for f in range(len(motion)):
        offsets = (skeleton.offsets_m if motion.shifts_m is None else motion.shifts_m[f]).copy()
        offsets[0] = motion.root_m[f]
        places.Set(vt.Vec3fArray([gf.Vec3f(*map(float, o)) for o in offsets]), f)
        turns.Set(vt.QuatfArray([gf.Quatf(float(w), float(x), float(y), float(z)) for x, y, z, w in q[f]]), f)
    binding = skel.BindingAPI.Apply(made.GetPrim())
    binding.CreateAnimationSourceRel().SetTargets([animation.GetPrim().GetPath()])
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"motion{Path(path).suffix.lower()}"
        stage.GetRootLayer().Export(str(file))
        write_bytes(path, file.read_bytes())


def joint_paths(skeleton: Skeleton) -> list[str]:
    """Every joint with those above it, as UsdSkel names joints."""
    names = ["".join(c if c.isascii() and c.isalnum() else "_" for c in n) for n in skeleton.joints]
    names = [f"_{n}" if n[:1].isdigit() else n for n in names]
    paths: list[str] = []
    for name, p in zip(names, skeleton.parents, strict=True):
        paths.append(name if p < 0 else f"{paths[p]}/{name}")
    return paths
