"""A person's skeleton from their markers: stature, bones and marker places, adjusted together over many poses.

The skeleton is scaled to the markers' distances, posed in frames that differ as much as possible, and fitted by
adjusting bones, marker places and poses together (`crates/core/src/skeleton/fit.rs`). Joint centres are where motion
shows them; where it does not, they stay where rules and proportions have them.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom import _core
from markerloom.errors import InputError
from markerloom.skeleton.by_motion import rigid
from markerloom.skeleton.centers import motion_centers, with_centers
from markerloom.skeleton.definition import hanim
from markerloom.skeleton.motion import Motion, turns_of
from markerloom.skeleton.placing import Hints, Placed, place_markers
from markerloom.skeleton.rules import Centers, rule_centers
from markerloom.skeleton.skeleton import Skeleton
from markerloom.subjects.marker_set import MarkerSet

Array = NDArray[np.floating[Any]]
KEY_FRAMES = 200
"""Poses that are adjusted together."""
SPREAD_M = 0.005
"""Distances that change by less than this are noise."""
PRESENT = 0.7
"""Key frames have at least this part of the most markers of any frame."""
OFFSET_SD = 0.020
"""How well proportions give a joint's place, as a part of the stature; and of the small bones of spine and foot."""
SMALL_BONE = 0.05
SMALL_SD = 0.25
PLACE_SD, UNKNOWN_SD = 0.02, 0.06
"""How well a set gives a marker's place, and a segment alone does; parts of the stature."""
STATURES_M = (0.4, 2.7)
"""Nobody is smaller or taller (m)."""
MIRROR_SD_M = 0.01
"""How alike left and right are (m)."""


@dataclass(frozen=True)
class Wearer:
    """A skeleton fitted to a person, and where its markers are: ``joints`` and ``places_m`` (segment's axes),
    ``sigmas_m`` per axis: noise and soft tissue.
    """

    skeleton: Skeleton
    markers: tuple[str, ...]
    joints: tuple[int, ...]
    places_m: Array
    sigmas_m: Array
    residual_mm: float = float("nan")
    unplaced: tuple[str, ...] = ()

    def figure(self) -> _core.Figure:
        """The engine's figure."""
        return figure_of(self.skeleton, self.joints, self.places_m, self.sigmas_m)


def figure_of(skeleton: Skeleton, joints: Sequence[int], places_m: Array, sigmas_m: Array) -> _core.Figure:
    """The engine's figure of a skeleton with markers on it."""
    return _core.Figure(
        [None if p < 0 else p for p in skeleton.parents],
        skeleton.offsets_m.tolist(),
        [["XYZ".index(a) for a in order] if order else None for order in skeleton.turns_about],
        skeleton.free.tolist(),
        skeleton.limits_rad.tolist(),
        skeleton.habit_rad.tolist(),
        list(joints),
        places_m.tolist(),
        list(sigmas_m),
    )


def fit_skeleton(
    names: list[str],
    xyz_m: Array,
    skeleton: Skeleton,
    *,
    known: Hints | MarkerSet | None = None,
    source: str = "",
) -> Wearer:
    """The skeleton of the person who wears the markers ``names`` in a take ``xyz_m`` (frames, markers, 3; NaN where
    absent).

    Raises ``InputError`` where too few markers are on segments, or too few frames show them.
    """
    placed = place_markers(names, skeleton, known, source)
    column = [names.index(m) for m in placed.markers]
    seen_m = xyz_m[:, column]
    if not np.isfinite(seen_m).all(axis=2).any():
        raise InputError(f"none of the markers on segments is ever there ({source})")
    stature = _stature_m(names, seen_m, placed, skeleton, known, source)
    if skeleton.stature_m and not STATURES_M[0] < stature < STATURES_M[1]:
        raise InputError(
            f"the markers are those of somebody {stature:.3g} m tall: are the take's lengths really millimetres, and "
            f"the markers named right? ({source})"
        )
    body = skeleton.scaled(stature / (skeleton.stature_m or _height(skeleton)))
    places = _first_places(body, placed, stature)
    exact = np.asarray(np.isfinite(placed.place).all(axis=1))
    place_sd = stature * np.where(exact, PLACE_SD, UNKNOWN_SD)
    keys_m = seen_m[key_frames(seen_m, placed, body)]
    first = figure_of(body, placed.joints, places, place_sd)
    if not exact.all():
        first, places = _without_places(body, placed, keys_m, stature)
    motion = _posed(first, body, keys_m)
    rules = rule_centers(body, placed.markers, known, keys_m)
    centers = rules | motion_centers(placed, keys_m, motion, rules, OFFSET_SD * stature)
    body = with_centers(motion, centers)
    offset_sd = _offset_sd(body, placed, stature)
    mirrored = [(a, b, MIRROR_SD_M) for a, b in body.mirrored()]
    first = figure_of(body, placed.joints, places, place_sd)
    figure, poses, _ = first.fit(
        keys_m, first.pose(keys_m), offset_sd.tolist(), place_sd.tolist(), mirrored, _held(rules), []
    )
    off = figure.residuals_m(keys_m, *poses)
    return Wearer(
        skeleton=replace(body, offsets_m=figure.offsets_m(), stature_m=stature),
        markers=tuple(placed.markers),
        joints=tuple(placed.joints),
        places_m=figure.places_m(),
        sigmas_m=np.array(figure.sigmas_m()),
        residual_mm=1000.0 * float(np.sqrt(np.nanmean(off**2))),
        unplaced=tuple(placed.unplaced),
    )


def _held(rules: Centers) -> list[tuple[int, int, list[float], list[float], float]]:
    """Joints held near where rules say they are: where motion does not show a joint, nothing else does. A rule is off
    by the same in all frames, so that all of them together count once.
    """
    pins = []
    for joint, (center_m, within_m) in rules.items():
        frames = np.flatnonzero(np.isfinite(center_m).all(axis=1))
        sd = within_m * float(np.sqrt(len(frames)))
        pins += [(int(f), joint, [0.0, 0.0, 0.0], center_m[f].tolist(), sd) for f in frames]
    return pins


def _posed(figure: _core.Figure, body: Skeleton, keys_m: Array) -> Motion:
    """The body posed in frames, nothing of it changed."""
    poses = figure.pose(keys_m)
    return Motion(body, poses[0], turns_of(body, poses), 1.0)


def _height(skeleton: Skeleton) -> float:
    places = skeleton.places_m()
    return float(np.ptp(places[:, 2])) or 1.0


def _stature_m(
    names: list[str], seen_m: Array, placed: Placed, skeleton: Skeleton, known: Hints | MarkerSet | None, source: str
) -> float:
    """The stature; of H-Anim's levels by the first, whose segments are those that markers tell apart."""
    if skeleton.name.startswith("hanim-") and len(skeleton) > len(hanim(1)):
        simple = hanim(1)
        with suppress(InputError):
            return stature_m(seen_m, place_markers(names, simple, known, source), simple)
    return stature_m(seen_m, placed, skeleton)


def stature_m(seen_m: Array, placed: Placed, skeleton: Skeleton) -> float:
    """The person's stature: how much larger distances of neighbouring segments are than those of the body of size 1.

    Stretched limbs are as long as in the T-pose, so the longer distances of a take count.
    """
    size = skeleton.stature_m or _height(skeleton)
    rest = (skeleton.places_m() + _ground(skeleton)) / size
    exact = np.asarray(np.isfinite(placed.place).all(axis=1))
    place = np.where(exact[:, None], placed.place, 0.0)
    joints = np.array(placed.joints)
    groups: list[tuple[int, Array, Array]] = []
    for joint in sorted(set(placed.joints)):
        own = np.flatnonzero(joints == joint)
        middle = place[own].mean(axis=0) if exact[own].all() else rest[joint] + _middle(skeleton, joint) / size
        with np.errstate(invalid="ignore"):
            track = seen_m[:, own].mean(axis=1)
        groups.append((joint, middle, track))
    ratios, weights = [], []
    for i, (joint, middle, track) in enumerate(groups):
        for other, beside, away in groups[:i]:
            if not _near(skeleton, joint, other):
                continue
            apart = np.linalg.norm(track - away, axis=1)
            apart = apart[np.isfinite(apart)]
            expected = float(np.linalg.norm(middle - beside))
            if len(apart) and expected > 0.05:
                ratios.append(float(np.percentile(apart, 95)) / expected)
                weights.append(expected)
    if not ratios:
        raise InputError("the markers' segments do not touch each other: their size cannot be told")
    order = np.argsort(ratios)
    cumulated = np.cumsum(np.array(weights)[order])
    return float(np.array(ratios)[order][np.searchsorted(cumulated, 0.5 * cumulated[-1])])


def _near(skeleton: Skeleton, joint: int, other: int) -> bool:
    """Whether one segment hangs from the other, over joints that are locked or few."""

    one, two = _unlocked(skeleton, joint), _unlocked(skeleton, other)
    return two in _way(skeleton, one)[:4] or one in _way(skeleton, two)[:4]


def _unlocked(skeleton: Skeleton, joint: int) -> int:
    """The joint that turns a segment: locked ones do not."""
    while joint > 0 and not skeleton.free[joint].any():
        joint = skeleton.parents[joint]
    return joint


def _way(skeleton: Skeleton, joint: int) -> list[int]:
    """A joint and those above it, up to the root."""
    return [] if joint < 0 else [joint, *_way(skeleton, skeleton.parents[joint])]


def _middle(skeleton: Skeleton, joint: int) -> Array:
    """The middle of a segment, from its joint (m): half way to what hangs from it."""
    below = [skeleton.offsets_m[c] for c in skeleton.children(joint)]
    below += [np.array(s.place_m) for s in skeleton.sites if s.joint == joint]
    if not below:
        return np.zeros(3)
    return 0.5 * np.mean(below, axis=0)


def _first_places(body: Skeleton, placed: Placed, stature: float) -> Array:
    """Where markers are on their segments before the fit (m)."""
    ground = _ground(body)
    rest = body.places_m() + ground
    return np.array(
        [
            stature * place - rest[joint] if np.isfinite(place).all() else _middle(body, joint)
            for place, joint in zip(placed.place, placed.joints, strict=True)
        ]
    )


def _ground(body: Skeleton) -> Array:
    """Where the root is in the rest pose when the soles are on the floor (m)."""
    rest = body.places_m()
    lowest = min([rest[s.joint][2] + s.place_m[2] for s in body.sites] + [float(rest[:, 2].min())])
    return np.array([0.0, 0.0, -lowest])


def _offset_sd(body: Skeleton, placed: Placed, stature: float) -> Array:
    """How well each joint's offset is known before the fit (joints, 3; m); 0 for bones that no marker moves."""
    moved = np.zeros(len(body), bool)
    for joint in placed.joints:
        while joint >= 0:
            moved[joint] = True
            joint = body.parents[joint]
    length = body.bone_lengths_m()
    sd = np.where(length < SMALL_BONE * stature, np.maximum(SMALL_SD * length, 0.003), OFFSET_SD * stature)
    sd[~moved] = 0.0
    return np.repeat(sd[:, None], 3, axis=1)


def key_frames(seen_m: Array, placed: Placed, skeleton: Skeleton) -> NDArray[np.int64]:
    """Frames with most markers whose poses differ as much as possible: for one segment after the other, the frame in
    which it is turned most unlike all those that were chosen before.
    """
    there = np.asarray(np.isfinite(seen_m).all(axis=2))
    count = there.sum(axis=1)
    frames = np.flatnonzero(count >= PRESENT * count.max())
    if len(frames) <= KEY_FRAMES:
        return frames
    frames = frames[:: max(1, len(frames) // 6000)]
    groups = []
    for joint in sorted(set(placed.joints)):
        own = [i for i, j in enumerate(placed.joints) if j == joint]
        near = [k for k, j in enumerate(placed.joints) if j < joint and _near(skeleton, joint, j)]
        if near:
            groups.append(_unlike(seen_m[frames], own, near))
    chosen = [int(np.argmax(count[frames]))]
    nearest = [np.linalg.norm(g - g[chosen[0]], axis=1) for g in groups]
    for step in range(KEY_FRAMES - 1):
        chosen.append(int(np.argmax(nearest[step % len(groups)])))
        for i, group in enumerate(groups):
            nearest[i] = np.minimum(nearest[i], np.linalg.norm(group - group[chosen[-1]], axis=1))
    return np.sort(frames[np.unique(chosen)])


def _unlike(seen_m: Array, own: list[int], near: list[int]) -> Array:
    """How a segment's markers are turned in each frame (frames, pairs): distances to those of the segments above, each
    in units of its own spread.
    """
    with np.errstate(invalid="ignore"):
        apart = np.linalg.norm(seen_m[:, own][:, :, None] - seen_m[:, near][:, None], axis=3).reshape(len(seen_m), -1)
        apart = (apart - np.nanmedian(apart, axis=0)) / (np.nanstd(apart, axis=0) + SPREAD_M)
    return np.nan_to_num(apart)


def _without_places(body: Skeleton, placed: Placed, keys_m: Array, stature: float) -> tuple[_core.Figure, Array]:
    """Where only segments are known: the middles of the segments' markers pose the body, and the markers are where
    they are on it, on average.
    """
    joints = sorted(set(placed.joints))
    own = [[i for i, j in enumerate(placed.joints) if j == joint] for joint in joints]
    middles = np.stack([keys_m[:, rows].mean(axis=1) for rows in own], axis=1)
    places = np.array([_middle(body, joint) for joint in joints])
    rough = figure_of(body, joints, places, np.full(len(joints), 0.03 * stature))
    turn, at = _posed(rough, body, middles).segments()
    found = np.zeros((len(placed), 3))
    for joint, rows in zip(joints, own, strict=True):
        local = np.einsum("fba,fmb->fma", turn[:, joint], keys_m[:, rows] - at[:, joint, None])
        found[rows] = _steady(local) if len(rows) >= 3 else np.nanmedian(local, axis=0)
    return figure_of(body, placed.joints, found, np.full(len(placed), 0.02 * stature)), found


def _steady(local_m: Array) -> Array:
    """Where a segment's markers (frames, markers ≥ 3, 3) are in its axes on average, their own shape kept."""
    shape = rigid(local_m)
    there = np.isfinite(shape.turn).all(axis=(1, 2))
    u, _, vt = np.linalg.svd(shape.turn[there].mean(axis=0))
    turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    middle = np.nanmedian(local_m.mean(axis=1), axis=0)
    return middle + (shape.shape_m - shape.shape_m.mean(axis=0)) @ turn.T
