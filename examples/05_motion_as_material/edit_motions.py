"""One walk through every operation of `ml.motion`, and the pictures of docs/guides/motion.md.

    python examples/05_motion_as_material/edit_motions.py [FOLDER]

The clips are made here, so that nothing has to be downloaded: a figure that walks by inverse kinematics. The pictures
go into FOLDER (out/motion unless said).
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import markerloom as ml
from markerloom import pictures
from markerloom.motion import drawing

THIGH, SHANK = 0.42, 0.42
BONES = {
    "Hips": (None, (0.0, 0.0, 0.0)),
    "Spine": ("Hips", (0.0, 0.0, 0.15)),
    "Chest": ("Spine", (0.0, 0.0, 0.18)),
    "Neck": ("Chest", (0.0, 0.0, 0.2)),
    "Head": ("Neck", (0.0, 0.0, 0.1)),
    **{
        name: row
        for side, x in (("Left", 1.0), ("Right", -1.0))
        for name, row in {
            f"{side}Arm": ("Chest", (0.18 * x, 0.0, 0.15)),
            f"{side}ForeArm": (f"{side}Arm", (0.28 * x, 0.0, 0.0)),
            f"{side}Hand": (f"{side}ForeArm", (0.26 * x, 0.0, 0.0)),
            f"{side}UpLeg": ("Hips", (0.1 * x, 0.0, 0.0)),
            f"{side}Leg": (f"{side}UpLeg", (0.0, 0.0, -THIGH)),
            f"{side}Foot": (f"{side}Leg", (0.0, 0.0, -SHANK)),
            f"{side}ToeBase": (f"{side}Foot", (0.0, -0.14, -0.06)),
        }.items()
    },
}


def figure() -> ml.Skeleton:
    """A skeleton in a T-pose that faces −y."""
    names = tuple(BONES)
    ends = {"Head": (0.0, 0.0, 0.2), "LeftToeBase": (0.0, -0.06, -0.02), "RightToeBase": (0.0, -0.06, -0.02)}
    return ml.Skeleton(
        name="figure",
        joints=names,
        parents=tuple(-1 if parent is None else names.index(parent) for parent, _ in BONES.values()),
        offsets_m=np.array([offset for _, offset in BONES.values()]),
        sites=tuple(ml.Site(f"{name}_end", names.index(name), place) for name, place in ends.items()),
    )


def walk(seconds: float, *, step_m: float = 0.45, period_s: float = 1.1, slip_m: float = 0.0) -> ml.Motion:
    """A walk along −y at 60 Hz; with ``slip_m`` its feet slide to and fro."""
    body, rate = figure(), 60.0
    at = np.arange(round(seconds * rate)) / rate
    turns = np.tile(np.eye(3), (len(at), len(body), 1, 1))
    root = np.stack([0 * at, -2.0 * step_m * at / period_s, 0.84 + 0.01 * np.cos(4 * np.pi * at / period_s)], axis=1)
    swing = np.sin(2 * np.pi * at / period_s)
    for side, sign, ahead in (("Left", 1.0, 0.0), ("Right", -1.0, 0.5)):
        phase = at / period_s + ahead
        part = np.clip((phase - np.floor(phase) - 0.6) / 0.4, 0.0, 1.0)
        gone = part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
        along = -2.0 * step_m * (np.floor(phase) - ahead + gone + 0.3) - root[:, 1]
        up = 0.08 + 0.12 * np.sin(np.pi * part) ** 2 - root[:, 2]
        reach = np.hypot(along, up)
        thigh = np.arctan2(along, -up) - np.arccos((THIGH**2 + reach**2 - SHANK**2) / (2 * THIGH * reach))
        knee = np.pi - np.arccos((THIGH**2 + SHANK**2 - reach**2) / (2 * THIGH * SHANK))
        angles = {"UpLeg": thigh, "Leg": knee, "Foot": -thigh - knee, "ForeArm": -0.4 + 0.1 * sign * swing}
        for name, angle in angles.items():
            turns[:, body.index(side + name)] = ml.motion.rotations.exp(angle[:, None] * [1.0, 0.0, 0.0])
        hang = ml.motion.rotations.exp(np.array([0.0, 1.3 * sign, 0.0]))
        arm = ml.motion.rotations.exp((-0.5 * sign * swing)[:, None] * [1.0, 0.0, 0.0])
        turns[:, body.index(f"{side}Arm")] = arm @ hang
    root[:, 0] += slip_m * np.sin(2 * np.pi * at / 0.9)
    return ml.Motion(body, root, turns, rate, source=f"walk of {step_m:g} m steps")


def taller(skeleton: ml.Skeleton) -> ml.Skeleton:
    """The figure with legs and arms a third longer."""
    limbs = [j for j, name in enumerate(skeleton.joints) if name.startswith(("Left", "Right"))]
    offsets = skeleton.offsets_m.copy()
    offsets[[j for j in limbs if skeleton.parents[j] in limbs]] *= 1.3
    return replace(skeleton, name="taller", offsets_m=offsets)


MOMENTS = (0.1, 0.3, 0.5, 0.7, 0.9)
folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out/motion")
folder.mkdir(parents=True, exist_ok=True)


def save(name: str, picture: str) -> None:
    """Write a picture."""
    (folder / f"{name}.svg").write_text(picture + "\n", encoding="utf-8")


clip, slow = walk(4.0), replace(walk(4.0, step_m=0.36, period_s=1.3), source="slow walk")

# Frequency bands: every joint's turns split into bands, weighted, and added up again.
lively = ml.motion.bands(clip, preset="livelier")
save("bands", drawing.strip([(clip, drawing.BEFORE), (lively.motion, drawing.AFTER)], MOMENTS, "A walk, and livelier"))
arm = ml.motion.split(clip, "RightArm")
rows = [(f"band {k}", np.degrees(arm[k, :, 0]), drawing.COLORS[k % 4]) for k in (3, 4, 5, 6)]
save("band-split", drawing.curves(rows, clip.rate_hz, "°", "Bands of a swinging arm"))

# Warping: a clip bent through key poses.
head = clip.skeleton.index("Head")
place = clip.joints_m()[130, head] * 1000.0 + [300.0, -250.0, 250.0]
key = ml.motion.by_reach(clip, 130, {"LeftHand": place.tolist()})
waved = ml.motion.warp(clip, [key], reach_s=0.8)
save(
    "warp",
    drawing.strip([(clip, drawing.BEFORE), (waved.motion, drawing.AFTER)], (0.3, 0.42, 0.54, 0.66, 0.78), "A wave"),
)
late = ml.motion.timewarp(clip, [(1.0, 1.6), (2.0, 2.4)])
knee = clip.skeleton.index("RightLeg")
bent = [np.degrees(np.linalg.norm(ml.motion.rotations.log(m.turns[:, knee]), axis=1)) for m in (clip, late.motion)]
rows = [("before", bent[0], drawing.BEFORE), ("after", bent[1], drawing.AFTER)]
save("timewarp", drawing.curves(rows, clip.rate_hz, "°", "A knee whose second step comes late"))

# Feet: those that stand are held where they stand.
skating = walk(4.0, slip_m=0.006)
steady = ml.motion.footlock(skating)
feet = ml.motion.feet_of(ml.motion.body_of(clip.skeleton))
sideways = [1000.0 * feet.world_m(m)["l_ball"][:, 0] for m in (skating, steady.motion)]
rows = [("before", sideways[0], drawing.BEFORE), ("after", sideways[1], drawing.AFTER)]
save("footlock", drawing.curves(rows, clip.rate_hz, "mm", "The left ball, sideways"))

# Retargeting: another body; feet that stood stand there, too.
hero = ml.motion.retarget(clip, taller(clip.skeleton))
save("retarget", drawing.strip([(clip, drawing.BEFORE), (hero.motion, drawing.AFTER)], MOMENTS, "On longer limbs"))

# Joining.
joined = ml.motion.blend(clip, slow)
save(
    "blend",
    drawing.strip(
        [(joined.motion, drawing.AFTER)], np.linspace(0.02, 0.98, 9).tolist(), "Two walks as one", along=True
    ),
)
between = ml.motion.mix([clip, slow], [0.5, 0.5])
ways = [(m.source, m.root_m[:, :2], c) for m, c in ((clip, pictures.GREY), (slow, pictures.AMBER))]
flipped = ml.motion.mirror(waved.motion)
save(
    "mirror",
    drawing.strip([(waved.motion, drawing.BEFORE), (flipped.motion, drawing.AFTER)], (0.42, 0.54, 0.66), "A mirror"),
)
looped = ml.motion.loop(clip, times=3, length_s=0.3)

# Motion graphs: new clips of any length from a library.
turning = clip
for corner in (0.5, 1.0):
    turning = replace(turning, turns=turning.turns.copy(), root_m=turning.root_m.copy())
    angle = corner * np.clip((np.arange(len(turning)) - 60) / 120, 0.0, 1.0)
    spin = ml.motion.rotations.about_vertical(angle)
    turning.turns[:, 0] = spin @ turning.turns[:, 0]
    steps = np.einsum("fab,fb->fa", spin[:-1], np.diff(turning.root_m, axis=0))
    turning.root_m[1:] = turning.root_m[0] + np.cumsum(steps, axis=0)
turning = replace(ml.motion.footlock(turning).motion, source="turn")
other = replace(ml.motion.mirror(turning).motion, source="turn, mirrored")
library = ml.motion.build([clip, slow, turning, other])
line = np.array([[0.0, 0.0], [4.0, 0.0], [6.0, 2.0]])
along = ml.motion.follow(library, line)
save(
    "graph",
    drawing.floor_plan(
        [("line", line, pictures.GREY), ("the clip", along.motion.root_m[:, :2], drawing.AFTER)], "Along a line"
    ),
)

print(f"livelier: joints moved by {lively.report['moved_mm']['rms']:.0f} mm rms")
print(f"wave: key missed by {waved.report['key_error']['rad']:.0e} rad")
print(f"feet: slid {steady.report['before']['slide_mm']:.1f} mm, now {steady.report['slide_mm']:.3f} mm")
print(f"on longer limbs: feet slide {hero.report['slide_mm']:.3f} mm")
print(f"blend: joins {joined.report['joins'][0]['sharpness']:.2f} times as sharp as the clips")
print(f"mix: {len(between.motion)} frames between {len(clip)} and {len(slow)}; loop: {len(looped.motion)} frames")
print(f"along the line: {along.report['off_line_m']['rms']:.2f} m rms from it")
