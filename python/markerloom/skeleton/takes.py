"""`solve`: from named markers to a moving skeleton with constant bones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom import _core
from markerloom.errors import InputError
from markerloom.points import KINDS, Points
from markerloom.skeleton.contacts import FEET, Contact, Pin, find_contacts, pins_of, slides_mm
from markerloom.skeleton.definition import read_skeleton
from markerloom.skeleton.fitting import Wearer, fit_skeleton
from markerloom.skeleton.motion import Motion, angles, turns_of
from markerloom.skeleton.mounts import Mounts, Turn, at_frames_of, held_by, learn_mounts
from markerloom.skeleton.mvnx import SegmentPoses
from markerloom.skeleton.placing import Hints
from markerloom.skeleton.skeleton import Skeleton
from markerloom.subjects.marker_set import MarkerSet
from markerloom.subjects.names import split_prefix
from markerloom.trajectories import Trajectories

Array = NDArray[np.floating[Any]]
USED = [KINDS.index(kind) for kind in ("measured", "filled", "edited")]
NOT_THIS_PERSON = 3.0
"""Residuals this many times those of the fit say that the skeleton is somebody else's."""
BEYOND_DEG, OFTEN = 5.0, 0.05
"""A joint that is this far beyond its limits in more than this part of the frames is reported."""


@dataclass(frozen=True)
class Solved:
    """The motion, who made it, the contacts that were held, and the report."""

    motion: Motion
    wearer: Wearer
    contacts: list[Contact]
    residuals_mm: Array
    report: dict[str, Any]


TellsContacts = Callable[[Motion], list[Contact]]


def solve(
    points: Points,
    skeleton: str | Skeleton | Wearer = "hanim-loa1",
    *,
    known: Hints | MarkerSet | None = None,
    fit_from: Points | None = None,
    contacts: bool | list[Contact] | TellsContacts = True,
    person: str | None = None,
    rate_hz: float | None = None,
    poses: SegmentPoses | None = None,
) -> Solved:
    """The motion of a skeleton under the take's named markers, and under the poses of sensors on its segments.

    The skeleton is fitted to the take itself, or to ``fit_from`` (a range of motion or a static pose); a ``Wearer``
    that was fitted before is used as it is. ``known``: hints or a marker set where names do not say which;
    ``contacts``: feet that stand are held (found, as given, or as a function tells of the motion). ``poses``: how the
    sensors sit is learned from the take (see `mounts`). Raises ``InputError`` where nobody can be solved for.
    """
    rate = rate_hz or points.rate_hz
    if not rate:
        raise InputError(f"the take has no frame rate: say --rate-hz ({points.source})")
    names, xyz_m, frames = named_markers(points, person)
    if isinstance(skeleton, Wearer):
        wearer = skeleton
    else:
        body = skeleton if isinstance(skeleton, Skeleton) else read_skeleton(skeleton)
        own = (names, xyz_m) if fit_from is None else named_markers(fit_from, person)[:2]
        source = points.source if fit_from is None else fit_from.source
        wearer = fit_skeleton(*own, body, known=known, source=source)
    worn_m = _columns(wearer, names, xyz_m, points.source)
    figure = wearer.figure()
    first = Motion(
        wearer.skeleton, np.zeros((0, 3)), np.zeros((0, 0, 3, 3)), rate, int(frames[0]), source=points.source
    )
    found, certain = figure.solve(worn_m, 1.0 / rate, [], [])
    told = _told(wearer, worn_m)
    motion = _motion(wearer, first, told, found, certain)
    sensed: tuple[list[Pin], list[Turn]] = ([], [])
    mounts = None
    if poses is not None:
        poses = at_frames_of(poses, frames, rate)
        mounts = learn_mounts(poses, motion)
        sensed = held_by(mounts, poses)
        for frame, joint, *_ in sensed[1]:
            told[frame, joint] = True
        found, certain = figure.solve(worn_m, 1.0 / rate, *sensed)
        motion = _motion(wearer, first, told, found, certain)
    held = _held(motion, contacts)
    if held:
        found, closer = figure.hold(worn_m, 1.0 / rate, *sensed, found, pins_of(motion, held))
        place, turn = (np.where(np.isnan(new), old, new) for old, new in zip(certain, closer, strict=True))
        motion = _motion(wearer, first, told, found, (place, turn))
    off_mm = 1000.0 * residuals_m(wearer, motion, worn_m)
    report = _report(wearer, motion, held, off_mm, names) | _of_sensors(wearer, mounts)
    return Solved(motion, wearer, held, off_mm, report)


def _of_sensors(wearer: Wearer, mounts: Mounts | None) -> dict[str, Any]:
    """How firmly each sensor was believed."""
    if mounts is None:
        return {}
    return {
        "sensors": {
            wearer.skeleton.joints[m.joint]: {
                "sigma_deg": float(np.rad2deg(m.sigma_rad)),
                "sigma_mm": 1000.0 * m.sigma_m if np.isfinite(m.sigma_m) else None,
            }
            for m in mounts.each
        }
    }


def _held(motion: Motion, contacts: bool | list[Contact] | TellsContacts) -> list[Contact]:
    if callable(contacts):
        return contacts(motion)
    return find_contacts(motion) if contacts is True else list(contacts or [])


def named_markers(points: Points, person: str | None = None) -> tuple[list[str], Array, NDArray[np.int64]]:
    """Names without the subject's prefix, places (frames, markers, 3; m; NaN where absent) and numbers of frames."""
    take = Trajectories.of(points)
    slots = [i for i, name in enumerate(take.names) if not name.startswith("*")]
    who = sorted({split_prefix(take.names[i])[0] for i in slots})
    if person is not None:
        slots = [i for i in slots if split_prefix(take.names[i])[0] == person]
    elif len(who) > 1:
        raise InputError(f"there are several subjects in {points.source}: say which with --person ({', '.join(who)})")
    if not slots:
        raise InputError(f"no marker{f' of {person}' if person else ''} has a name: label the take ({points.source})")
    xyz_m = np.where(np.isin(take.kind, USED)[..., None], take.xyz_mm, np.nan)[:, slots] / 1000.0
    return [split_prefix(take.names[i])[1] for i in slots], xyz_m, take.frames


def _columns(wearer: Wearer, names: list[str], xyz_m: Array, source: str) -> Array:
    out = np.full((len(xyz_m), len(wearer.markers), 3), np.nan)
    for m, marker in enumerate(wearer.markers):
        if marker in names:
            out[:, m] = xyz_m[:, names.index(marker)]
    if not (np.isfinite(out).all(axis=2).sum(axis=1) >= 3).any():
        raise InputError(f"no frame has three markers of the skeleton '{wearer.skeleton.name}' ({source})")
    return out


def _motion(
    wearer: Wearer, like: Motion, told: NDArray[np.bool_], poses: _core.Poses, certain: tuple[Array, Array]
) -> Motion:
    return replace(
        like,
        root_m=poses[0],
        turns=turns_of(wearer.skeleton, poses),
        sigma_mm=1000.0 * certain[0],
        kind=(~told).astype(np.int64),
    )


def _told(wearer: Wearer, worn_m: Array) -> NDArray[np.bool_]:
    """Where markers at or below a joint tell its turn (frames, joints)."""
    told = np.zeros((len(worn_m), len(wearer.skeleton)), bool)
    there = np.asarray(np.isfinite(worn_m).all(axis=2))
    for m, joint in enumerate(wearer.joints):
        told[:, joint] |= there[:, m]
    for j in range(len(wearer.skeleton) - 1, 0, -1):
        told[:, wearer.skeleton.parents[j]] |= told[:, j]
    return told


def residuals_m(wearer: Wearer, motion: Motion, worn_m: Array) -> Array:
    """How far each marker is from where the motion has it (frames, markers; m), NaN where absent."""
    turn, place = motion.segments()
    joints = list(wearer.joints)
    at = place[:, joints] + np.einsum("fmab,mb->fma", turn[:, joints], wearer.places_m)
    return np.linalg.norm(worn_m - at, axis=2)


def _report(wearer: Wearer, motion: Motion, held: list[Contact], off_mm: Array, names: list[str]) -> dict[str, Any]:
    skeleton = wearer.skeleton
    rms = np.sqrt(np.nanmean(off_mm**2))
    lengths = skeleton.bone_lengths_m()
    seen = np.isfinite(off_mm)
    ever = np.asarray(seen.any(axis=0)).tolist()
    per_marker = np.sqrt(np.where(seen, off_mm**2, 0.0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1))
    slides = slides_mm(motion, held)
    return {
        "frames": len(motion),
        "rate_hz": motion.rate_hz,
        "skeleton": skeleton.name,
        "joints": len(skeleton),
        "stature_m": skeleton.stature_m,
        "residual_mm": {
            "rms": float(rms),
            "median": float(np.nanmedian(off_mm)),
            "p95": float(np.nanpercentile(off_mm, 95)),
        },
        "residual_mm_per_marker": {m: float(v) for m, v, s in zip(wearer.markers, per_marker, ever, strict=True) if s},
        "bone_lengths_mm": {j: 1000.0 * float(lengths[i]) for i, j in enumerate(skeleton.joints) if i},
        "contacts": slides,
        "feet": [s.name for s in skeleton.sites if s.name.rpartition("_")[2] in FEET],
        "inferred": float(np.mean(motion.kind)),
        "warnings": _warnings(wearer, motion, off_mm, names),
    }


def _warnings(wearer: Wearer, motion: Motion, off_mm: Array, names: list[str]) -> list[str]:
    out = []
    loose = [n for n in names if n not in wearer.markers]
    if loose:
        out.append(f"markers on no segment, not used: {', '.join(loose[:8])}{' …' if len(loose) > 8 else ''}")
    typical = 1000.0 * float(np.sqrt(3.0) * np.median(wearer.sigmas_m))
    middle = float(np.nanmedian(off_mm))
    if middle > NOT_THIS_PERSON * typical:
        worst = np.argsort(-np.nan_to_num(off_mm).mean(axis=0))[:3]
        out.append(
            f"the markers are {middle:.0f} mm from the skeleton, {typical:.0f} mm when it was fitted: this may be "
            f"another person, or markers were moved (worst: {', '.join(wearer.markers[i] for i in worst)})"
        )
    for j, name in enumerate(motion.skeleton.joints):
        order = motion.skeleton.turns_about[j]
        if j == 0 or not order:
            continue
        own = angles(order, motion.turns[:, j])
        low, high = motion.skeleton.limits_rad[j].T
        beyond = np.rad2deg(np.maximum(own - high, low - own)).max(axis=1)
        if (beyond > BEYOND_DEG).mean() > OFTEN:
            out.append(f"joint '{name}' is up to {beyond.max():.0f}° beyond its limits: do they suit this motion?")
    return out
