"""How well markers are named: the rows of docs/results.md.

python benches/labelling.py [tpose] [frames] [real] [two] [swaps] [speed] [--seeds=N]
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

import markerloom as ml
from markerloom import _core
from markerloom.subjects.names import other_side
from markerloom.subjects.subject import model_of
from markerloom.trajectories import Trajectories

FOLDER = Path(__file__).resolve().parents[2] / "shared/data/labelling"
SET = "front-waist-53"
WITHIN_MM = 25.0


def main() -> None:
    asked = [a for a in sys.argv[1:] if not a.startswith("--")] or list(ROWS)
    seeds = int(next((a.split("=")[1] for a in sys.argv if a.startswith("--seeds=")), 5))
    for row in asked:
        ROWS[row](seeds)


def judged(named: ml.Points, truth: ml.Points) -> tuple[float, float, int]:
    """Shares of measured marker-frames with the right and with a wrong name; the longest run of wrong frames."""
    true, found = Trajectories.of(truth), Trajectories.of(named)
    right = wrong = total = longest = 0
    runs = np.zeros(len(true.names), int)
    for frame in range(len(true.frames)):
        seen = np.flatnonzero(found.kind[frame] == 0)
        apart = cdist(np.nan_to_num(true.xyz_mm[frame], nan=1e6), found.xyz_mm[frame, seen])
        for m, p in zip(*linear_sum_assignment(np.minimum(apart, WITHIN_MM)), strict=True):
            if apart[m, p] >= WITHIN_MM:
                continue
            name = found.names[seen[p]]
            total += 1
            right += name == true.names[m]
            is_wrong = name != true.names[m] and not name.startswith("*")
            wrong += is_wrong
            runs[m] = runs[m] + 1 if is_wrong else 0
            longest = max(longest, int(runs[m]))
    return right / total, wrong / total, longest


def tpose(seeds: int) -> None:
    worn = ml.read_marker_set(SET)
    for motion in ("walk", "dance"):
        for seed in range(seeds):
            scene = ml.make_scene(motion, frames=1500, seed=seed, marker_set=SET, t_pose_s=1.5, sigma_px=0.3)
            take = ml.simulate(scene)
            tracked = ml.track(take.observations, take.rig, rate_hz=100.0)
            right, wrong, longest = judged(ml.label(tracked, marker_set=worn), take.truth)
            known = ml.create_subject(take.truth, marker_set=worn)
            print(
                f"tpose {motion} seed {seed}: right {100 * right:.3f} %, wrong {100 * wrong:.3f} %, longest {longest}; "
                f"subject known: right {100 * judged(ml.label(tracked, subjects=[known]), take.truth)[0]:.3f} %",
                flush=True,
            )


def figure(motion: str, seed: int, frames: int, markers: int = 53) -> np.ndarray:
    return np.array([_core.body_pose(motion, markers, seed, (0.0, 0.0, 0.0), i / 100.0)[0] for i in range(frames)])


def points_of(xyz_mm: np.ndarray, track: np.ndarray, label: np.ndarray | None, rate_hz: float) -> ml.Points:
    """Points of (frames, columns, 3), NaN where there is none."""
    seen = np.isfinite(xyz_mm).all(axis=2)
    frame, slot = np.nonzero(seen)
    order = np.lexsort((track[seen], frame))
    names = np.full(len(frame), "", dtype="<U1") if label is None else label[slot]
    return ml.Points.of(
        *(frame[order], track[seen][order].astype(np.int64), xyz_mm[seen][order]),
        label=names[order],
        rate_hz=rate_hz,
        frames=np.arange(len(xyz_mm)),
    )


def subject_of(xyz_m: np.ndarray, rate_hz: float = 100.0) -> ml.Subject:
    names = np.array([f"M{i:02d}" for i in range(xyz_m.shape[1])])
    columns = np.broadcast_to(np.arange(xyz_m.shape[1]), xyz_m.shape[:2])
    return ml.create_subject(points_of(1000.0 * xyz_m, columns, names, rate_hz))


def frames(seeds: int) -> None:
    for motion in ("walk", "dance"):
        for seed in range(seeds):
            xyz_m = figure(motion, seed, 2600)
            model = model_of([subject_of(xyz_m[:1300])])
            rng = np.random.default_rng(seed)
            right = total = mirrored = looked = 0
            took = []
            for frame in range(1300, 2600, 5):
                seen = np.flatnonzero(rng.random(53) > 0.1)
                phantoms = rng.uniform(xyz_m[frame].min(axis=0), xyz_m[frame].max(axis=0), (3, 3))
                points = np.vstack([xyz_m[frame, seen] + 0.0005 * rng.standard_normal((len(seen), 3)), phantoms])
                clock = time.perf_counter()
                found, _, _ = model.search(np.ascontiguousarray(points))
                took.append(time.perf_counter() - clock)
                right += sum(found[m] == i for i, m in enumerate(seen))
                total += len(seen)
                _, _, sides = model.search(np.ascontiguousarray(points * [-1.0, 1.0, 1.0]))
                mirrored, looked = mirrored + (sides[1] > sides[0]), looked + 1
            print(
                f"frames {motion} seed {seed}: right {100 * right / total:.2f} %, mirror images told {mirrored} of "
                f"{looked}, {1e3 * np.mean(took):.2f} ms a frame (99 %: {1e3 * np.quantile(took, 0.99):.2f})",
                flush=True,
            )


def pieces(xyz_mm: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """The take with random gaps and 5 % phantoms, and a number for every piece of a trajectory."""
    count, markers = xyz_mm.shape[:2]
    hidden = xyz_mm.copy()
    piece = np.zeros((count, markers), int)
    for m in range(markers):
        for _ in range(rng.poisson(count / 250)):
            first = rng.integers(count)
            hidden[first : first + rng.integers(1, 60), m] = np.nan
            piece[first:, m] += 1
    piece += 1000 * np.arange(markers)
    ghosts = np.full((count, 40, 3), np.nan)
    numbers = np.tile(1000 * (markers + np.arange(40)), (count, 1))
    need, column = 0.05 * np.isfinite(hidden).all(axis=2).sum(), 0
    while need > 0:
        length, first = int(rng.integers(1, 60)), int(rng.integers(count))
        length = min(length, count - first)
        middle = np.nanmean(xyz_mm[first], axis=0) + rng.normal(0, 400.0, 3)
        ghosts[first : first + length, column % 40] = middle + np.cumsum(rng.normal(0, 2.0, (length, 3)), axis=0)
        numbers[first:, column % 40] += 1
        column, need = column + 1, need - length
    return np.concatenate([hidden, ghosts], axis=1), np.concatenate([piece, numbers], axis=1)


def by_row(named: ml.Points, xyz_mm: np.ndarray, names: list[str]) -> tuple[float, float]:
    """Shares of right names among true samples, and of phantoms with a name."""
    true = {tuple(np.round(xyz_mm[f, m], 6)): names[m] for f in range(len(xyz_mm)) for m in range(len(names))}
    whose = [true.get(tuple(np.round(p, 6))) for p in named.xyz_mm]
    right = [n == w for n, w in zip(named.label, whose, strict=True) if w is not None]
    ghosts = [bool(n) for n, w in zip(named.label, whose, strict=True) if w is None]
    return float(np.mean(right)), float(np.mean(ghosts)) if ghosts else 0.0


def real(seeds: int) -> None:
    takes = {n: Trajectories.of(ml.read_points(FOLDER / f"{n}.c3d")) for n in NAMES}
    tries = [(n, f"{half} half from the other", n, half) for n in NAMES for half in ("second", "first")]
    tries += [(b, f"from {a}", a, "") for a, b in (NAMES[2:], NAMES[:1:-1])]
    tries += [(n, "odd seconds from even ones", n, "odd") for n in NAMES]
    for name, how, source, part in tries:
        take, known = takes[name], takes[source]
        rate = take.points.rate_hz or 100.0
        second = (np.arange(len(take.frames)) // round(rate)) % 2 == 1
        half = np.arange(len(take.frames)) >= len(take.frames) // 2
        test = {"second": half, "first": ~half, "odd": second, "": np.ones(len(half), bool)}[part]
        learn = known.xyz_mm if part == "" else known.xyz_mm[~test]
        rights = []
        for seed in range(min(seeds, 3)):
            subject = subject_of(learn / 1000.0, rate)
            broken, track = pieces(take.xyz_mm[test], np.random.default_rng(seed))
            named = ml.label(points_of(broken, track, None, rate), subjects=[subject])
            rights.append(by_row(named, take.xyz_mm[test], [f"M{i:02d}" for i in range(len(take.names))]))
        right, ghosts = np.mean(rights, axis=0)
        print(f"real {name}, {how}: right {100 * right:.3f} %, phantoms named {100 * ghosts:.2f} %", flush=True)


NAMES = ("cmu-85_02", "fullbody-44", "KneeltoProne01", "PronetoRun01")


def two(seeds: int) -> None:
    for seed in range(seeds):
        take = ml.simulate(ml.make_scene("duet", frames=1600, seed=seed, cameras=2))
        whole = Trajectories.of(take.truth)
        half = 800
        subjects = [
            replace(subject_of(whole.xyz_mm[:half, first : first + 41] / 1000.0), name=name)
            for name, first in (("A", 0), ("B", 41))
        ]
        broken, track = pieces(whole.xyz_mm[half:], np.random.default_rng(seed))
        named = ml.label(points_of(broken, track, None, 100.0), subjects=subjects)
        names = [f"{who}:M{i:02d}" for who in "AB" for i in range(41)]
        right, ghosts = by_row(named, whole.xyz_mm[half:], names)
        true = {tuple(np.round(whole.xyz_mm[f, m], 6)): names[m][0] for f in range(half, 1600) for m in range(82)}
        others = [
            n[0] != true.get(tuple(np.round(p, 6)), n[0]) for p, n in zip(named.xyz_mm, named.label, strict=True) if n
        ]
        print(
            f"two seed {seed}: right {100 * right:.3f} %, phantoms named {100 * ghosts:.2f} %, "
            f"given to the other {sum(others)}",
            flush=True,
        )


def swaps(seeds: int) -> None:
    for name in ("cmu-85_02", "KneeltoProne01", "PronetoRun01"):
        take = Trajectories.of(ml.read_points(FOLDER / f"{name}.c3d"))
        for seed in range(seeds):
            rng = np.random.default_rng(seed)
            xyz_mm, whose = take.xyz_mm.copy(), np.tile(np.arange(len(take.names)), (len(take.frames), 1))
            pairs = [(i, take.names.index(o)) for i, n in enumerate(take.names) if (o := other_side(n, take.names))]
            pairs = [p for p in pairs if p[0] < p[1]]
            for k in rng.permutation(len(pairs))[: round(len(pairs) / 3)]:
                both = list(pairs[k])
                first = int(rng.integers(len(take.frames) - 60))
                last = first + int(rng.integers(30, len(take.frames) // 2))
                xyz_mm[first:last, both], whose[first:last, both] = (
                    xyz_mm[first:last, both[::-1]],
                    whose[first:last, both[::-1]],
                )
            kind = np.where(np.isfinite(xyz_mm).all(axis=2), 0, -1)
            points = take.changed(xyz_mm, take.sigma_mm, kind).as_points()
            checked = ml.check_labels(points)
            slot = np.searchsorted(take.tracks, points.track)
            true = np.array(take.names)[whose[points.frame - take.frames[0], slot]]
            bad = points.label != true
            print(
                f"swaps {name} seed {seed}: {100 * bad.mean():.1f} % wrong, mended "
                f"{100 * np.mean(checked.label[bad] == true[bad]):.3f} %, new errors "
                f"{100 * np.mean(checked.label[~bad] != true[~bad]):.4f} %",
                flush=True,
            )


def speed(_: int) -> None:
    frames, rate = 72_000, 120.0
    xyz_mm = 1000.0 * figure("dance", 0, 6000)
    xyz_mm = np.tile(xyz_mm, (12, 1, 1))[:frames]
    rng = np.random.default_rng(0)
    for m in range(53):
        for _gap in range(20):
            first = rng.integers(10, frames - 200)
            xyz_mm[first : first + rng.integers(5, 120), m] = np.nan
    subject = subject_of(figure("dance", 0, 2000))
    piece = np.cumsum(~np.isfinite(xyz_mm).all(axis=2), axis=0) + 100_000 * np.arange(53)
    points = points_of(xyz_mm, piece, None, rate)
    clock = time.perf_counter()
    named = ml.label(points, subjects=[subject])
    labelled = time.perf_counter() - clock
    filled = ml.fill(named)
    both = time.perf_counter() - clock
    print(
        f"speed 10 min, 120 Hz, 53 markers: labelled in {labelled:.1f} s, {filled.report['gaps']} gaps filled in "
        f"{both - labelled:.1f} s"
    )
    labeller = ml.Labeller([subject])
    tracks, took = np.arange(53), []
    for i, frame in enumerate(1000.0 * figure("dance", 0, 3000)[1000:]):
        clock = time.perf_counter()
        labeller.push(tracks, frame, time_s=i / 100.0)
        took.append(time.perf_counter() - clock)
    print(f"speed live, 53 markers: mean {1e3 * np.mean(took):.3f} ms, 99.9 % {1e3 * np.quantile(took, 0.999):.2f} ms")


ROWS = {"tpose": tpose, "frames": frames, "real": real, "two": two, "swaps": swaps, "speed": speed}

if __name__ == "__main__":
    main()
