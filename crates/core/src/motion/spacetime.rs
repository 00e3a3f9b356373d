//! A motion changed as little as its goals allow: one least-squares problem over all frames of a clip.
//!
//! After Gleicher 1998, "Retargetting motion to new characters", and Lee & Shin 1999, "A hierarchical approach to
//! interactive motion editing": the change is a sum of uniform cubic B-splines, coarse ones first, so that fast change
//! enters only where goals cannot be met without. Each level is solved by Gauss–Newton with banded normal equations;
//! goals become stiffer from level to level, and the last has a knot in every frame. Long clips are solved in windows:
//! each begins where the one before it still holds, and changes nothing of its value, slope and curvature there.

use super::banded::Banded;
use super::goals::{Goal, Row};
use super::spline::Spline;
use crate::skeleton::kinematics::{Segment, vector_of};
use nalgebra::{Rotation3, Vector3};
use std::ops::Range;

/// Joints of a skeleton with constant bones.
#[derive(Clone, Debug)]
pub struct Bones {
    /// The joint above; smaller than the joint's own index. `None` only for joint 0.
    pub parents: Vec<Option<usize>>,
    /// Place in the parent's axes (m).
    pub offsets_m: Vec<Vector3<f64>>,
}

/// A motion of such a skeleton.
#[derive(Clone, Debug)]
pub struct Clip {
    /// Place of the root in every frame (m, world).
    pub root_m: Vec<Vector3<f64>>,
    /// Turns of all joints against their parents, frame after frame.
    pub turns: Vec<Rotation3<f64>>,
}

/// One way in which a pose may be changed.
#[derive(Clone, Debug)]
pub struct Freedom {
    /// The joint that turns, or 0 for a shift.
    pub joint: usize,
    /// About which axis of its own segment, or along which of the world.
    pub axis: Vector3<f64>,
    /// Whether it is a shift of the root.
    pub shift: bool,
    /// A change of this size costs 1 (rad or m).
    pub usual: f64,
}

/// How the problem is solved.
#[derive(Clone, Debug)]
pub struct Options {
    /// Levels: frames from knot to knot, and what a goal may be missed by at the price of a usual change (m).
    pub levels: Vec<(usize, f64)>,
    /// How sharply each freedom may change in each frame (second difference; rad or m per frame²): a change that does
    /// costs 1. Frame after frame, of all freedoms.
    pub sharp: Vec<f64>,
    /// Goals are missed by less than this (m).
    pub tolerance_m: f64,
    /// Frames of a window, and how many two of them share.
    pub window: usize,
    /// See `window`.
    pub overlap: usize,
}

/// Rounds of Gauss–Newton on a level: only the last must meet its goals.
const ROUNDS: usize = 3;
const LAST_ROUNDS: usize = 24;
/// A round that gains less than this part of the cost is the last of its level.
const GAINS: f64 = 0.02;
const LAST_GAINS: f64 = 1e-5;
/// Damping of steps, in parts of what a change costs: raised after a step that made things worse, lowered after others.
const MORE_DAMPING: f64 = 10.0;
const LESS_DAMPING: f64 = 0.2;
const KEPT_DAMPING: f64 = 0.7;
const MOST_DAMPING: f64 = 1e7;
/// Second differences.
const BEND: [f64; 3] = [1.0, -2.0, 1.0];
/// Controls that keep their value cost this.
const FROZEN: f64 = 1e12;

/// Change the clip in place; returns what every goal is missed by (m).
pub fn change(bones: &Bones, clip: &mut Clip, freedoms: &[Freedom], goals: &[Goal], options: &Options) -> Vec<f64> {
    let frames = clip.root_m.len();
    let mut start = 0;
    while start < frames && !freedoms.is_empty() {
        let end = if start + options.window + options.overlap >= frames { frames } else { start + options.window };
        let before = (end < frames).then(|| clip.clone());
        Window::new(bones, freedoms, goals, start..end, options).solve(clip);
        let Some(before) = before else { break };
        start = end - options.overlap;
        fade(clip, &before, start..end, bones.parents.len());
    }
    missed(bones, clip, goals)
}

/// Within a range, go over from the changed clip to what it was.
fn fade(clip: &mut Clip, before: &Clip, range: Range<usize>, joints: usize) {
    let length = range.len() as f64;
    for frame in range.clone() {
        let gone = (frame - range.start) as f64 / length;
        let share = 1.0 - gone * gone * gone * (gone * (6.0 * gone - 15.0) + 10.0);
        clip.root_m[frame] = before.root_m[frame].lerp(&clip.root_m[frame], share);
        for j in frame * joints..(frame + 1) * joints {
            let change = vector_of(&(before.turns[j].inverse() * clip.turns[j]));
            clip.turns[j] = before.turns[j] * Rotation3::new(change * share);
        }
    }
}

/// By how much each goal is missed (m).
fn missed(bones: &Bones, clip: &Clip, goals: &[Goal]) -> Vec<f64> {
    let (mut rows, mut pose) = (Vec::new(), Vec::new());
    let length = |goal: &Goal| {
        posed(bones, clip, goal.frame, &mut pose);
        goal.rows(&pose, &mut rows);
        rows.iter().map(|r: &Row| r.off * r.off).sum::<f64>().sqrt()
    };
    goals.iter().map(length).collect()
}

/// All segments of a frame.
fn posed(bones: &Bones, clip: &Clip, frame: usize, pose: &mut Vec<Segment>) {
    pose.clear();
    let turns = &clip.turns[frame * bones.parents.len()..];
    for (j, parent) in bones.parents.iter().enumerate() {
        pose.push(match parent {
            None => Segment { turn: turns[j], joint_m: clip.root_m[frame] },
            Some(p) => Segment { turn: pose[*p].turn * turns[j], joint_m: pose[*p].place(&bones.offsets_m[j]) },
        });
    }
}

/// A part of a clip, and what is wanted in it.
struct Window<'a> {
    bones: &'a Bones,
    freedoms: &'a [Freedom],
    goals: Vec<&'a Goal>,
    range: Range<usize>,
    options: &'a Options,
    /// Of every joint, the freedoms that move it.
    above: Vec<Vec<usize>>,
}

/// A level while it is solved.
struct Level {
    spline: Spline,
    controls: Vec<f64>,
    /// Stiffness of the goals (1/m²).
    stiffness: f64,
    /// Cost of bends: of every second difference of controls, of all freedoms.
    bends: Vec<f64>,
    /// What earlier levels have changed, frame by frame.
    done: Vec<f64>,
}

impl<'a> Window<'a> {
    fn new(
        bones: &'a Bones,
        freedoms: &'a [Freedom],
        goals: &'a [Goal],
        range: Range<usize>,
        options: &'a Options,
    ) -> Self {
        let mut above: Vec<Vec<usize>> = Vec::new();
        for (j, parent) in bones.parents.iter().enumerate() {
            let mut own: Vec<usize> = parent.map_or_else(Vec::new, |p| above[p].clone());
            own.extend((0..freedoms.len()).filter(|&d| freedoms[d].joint == j));
            above.push(own);
        }
        let mut goals: Vec<&Goal> = goals.iter().filter(|g| range.contains(&g.frame)).collect();
        goals.sort_by_key(|g| g.frame);
        Self { bones, freedoms, goals, range, options, above }
    }

    fn solve(&self, clip: &mut Clip) {
        let mut done = vec![0.0; self.range.len() * self.freedoms.len()];
        for (at, &(spacing, soft_m)) in self.options.levels.iter().enumerate() {
            let last = at + 1 == self.options.levels.len();
            let rounds = if last { LAST_ROUNDS } else { ROUNDS };
            if self.worst(clip) < self.options.tolerance_m {
                return;
            }
            self.solve_level(clip, spacing, soft_m, rounds, &mut done);
        }
    }

    /// The largest distance from a goal.
    fn worst(&self, clip: &Clip) -> f64 {
        self.cost_of_goals(clip).1
    }

    /// Sum of squares (m²) of what is missed, and the largest (m).
    fn cost_of_goals(&self, clip: &Clip) -> (f64, f64) {
        let (mut rows, mut pose, mut at) = (Vec::new(), Vec::new(), None);
        let (mut sum, mut worst) = (0.0, 0.0f64);
        for goal in &self.goals {
            if at != Some(goal.frame) {
                posed(self.bones, clip, goal.frame, &mut pose);
                at = Some(goal.frame);
            }
            goal.rows(&pose, &mut rows);
            for row in &rows {
                sum += row.off * row.off;
                worst = worst.max(row.off.abs());
            }
        }
        (sum, worst)
    }

    fn solve_level(&self, clip: &mut Clip, spacing: usize, soft_m: f64, rounds: usize, done: &mut Vec<f64>) {
        let spline = Spline::over(self.range.len(), spacing);
        let mut level = Level {
            controls: vec![0.0; spline.controls * self.freedoms.len()],
            stiffness: 1.0 / (soft_m * soft_m),
            bends: self.bends(spline),
            done: std::mem::take(done),
            spline,
        };
        let mut cost = self.cost(clip, &level, &level.controls);
        let mut damping = 0.0;
        let enough = if soft_m > self.options.tolerance_m { GAINS } else { LAST_GAINS };
        for _ in 0..rounds {
            let Some((changed, now)) = self.step(clip, &mut level, &mut damping, cost) else { break };
            *clip = changed;
            let gained = cost - now;
            cost = now;
            if gained < enough * cost || self.worst(clip) < self.options.tolerance_m {
                break;
            }
        }
        let mut change = vec![0.0; self.freedoms.len()];
        for (frame, sum) in level.done.chunks_exact_mut(change.len()).enumerate() {
            self.at(level.spline, &level.controls, frame, &mut change);
            sum.iter_mut().zip(&change).for_each(|(s, c)| *s += c);
        }
        *done = level.done;
    }

    fn bends(&self, spline: Spline) -> Vec<f64> {
        let (n, h) = (self.freedoms.len(), spline.spacing as f64);
        let mut out = Vec::with_capacity((spline.controls - 2) * n);
        for k in 0..spline.controls - 2 {
            // The middle one of three controls lies on its own knot, one before the spline's first.
            let frame = self.range.start + (k * spline.spacing).min(self.range.len() - 1);
            out.extend(self.options.sharp[frame * n..][..n].iter().map(|s| h / (h * h * s).powi(2)));
        }
        out
    }

    /// One step of Gauss–Newton, shortened by damping until it makes things better (Marquardt 1963): along what goals
    /// leave open a straight step is too long, since these are curved.
    fn step(&self, clip: &Clip, level: &mut Level, damping: &mut f64, cost: f64) -> Option<(Clip, f64)> {
        let mut failed = false;
        while *damping < MOST_DAMPING {
            let (normal, gradient) = self.equations(clip, level, *damping);
            let mut step: Vec<f64> = gradient.iter().map(|g| -g).collect();
            if normal.solve(&mut step) {
                let changed = self.applied(clip, level.spline, &step);
                let controls: Vec<f64> = level.controls.iter().zip(&step).map(|(c, s)| c + s).collect();
                let now = self.cost(&changed, level, &controls);
                if now < cost {
                    level.controls = controls;
                    *damping *= if failed { KEPT_DAMPING } else { LESS_DAMPING };
                    return Some((changed, now));
                }
            }
            failed = true;
            *damping = (*damping * MORE_DAMPING).max(1.0);
        }
        None
    }

    /// The change of every freedom in a frame.
    fn at(&self, spline: Spline, controls: &[f64], frame: usize, out: &mut [f64]) {
        let (first, weights) = spline.weights(frame);
        let n = self.freedoms.len();
        out.fill(0.0);
        for (k, weight) in weights.iter().enumerate() {
            let own = &controls[(first + k) * n..][..n];
            out.iter_mut().zip(own).for_each(|(o, c)| *o += weight * c);
        }
    }

    fn applied(&self, clip: &Clip, spline: Spline, controls: &[f64]) -> Clip {
        let mut out = clip.clone();
        let joints = self.bones.parents.len();
        let mut change = vec![0.0; self.freedoms.len()];
        for frame in self.range.clone() {
            self.at(spline, controls, frame - self.range.start, &mut change);
            let mut d = 0;
            while d < change.len() {
                let joint = self.freedoms[d].joint;
                if self.freedoms[d].shift {
                    out.root_m[frame] += self.freedoms[d].axis * change[d];
                    d += 1;
                    continue;
                }
                let mut vector = Vector3::zeros();
                while d < change.len() && !self.freedoms[d].shift && self.freedoms[d].joint == joint {
                    vector += self.freedoms[d].axis * change[d];
                    d += 1;
                }
                out.turns[frame * joints + joint] *= Rotation3::new(vector);
            }
        }
        out
    }

    /// Twice what is minimised: goals, and change.
    fn cost(&self, clip: &Clip, level: &Level, controls: &[f64]) -> f64 {
        let n = self.freedoms.len();
        let mut change = vec![0.0; n];
        let price: Vec<f64> = self.freedoms.iter().map(|f| 1.0 / (f.usual * f.usual)).collect();
        let mut cost = self.cost_of_goals(clip).0 * level.stiffness;
        for (frame, done) in level.done.chunks_exact(n).enumerate() {
            self.at(level.spline, controls, frame, &mut change);
            cost += change.iter().zip(done).zip(&price).map(|((c, d), p)| p * (c + d).powi(2)).sum::<f64>();
        }
        for (at, bend) in level.bends.iter().enumerate() {
            let c = |k: usize| controls[at + k * n];
            cost += bend * (c(0) - 2.0 * c(1) + c(2)).powi(2);
        }
        cost
    }

    /// Normal equations and gradient of half the cost.
    fn equations(&self, clip: &Clip, level: &Level, damping: f64) -> (Banded, Vec<f64>) {
        let n = self.freedoms.len();
        let mut normal = Banded::new(level.controls.len(), 4 * n - 1);
        let mut gradient = vec![0.0; level.controls.len()];
        self.add_change(level, damping, &mut normal, &mut gradient);
        let (mut pose, mut rows) = (Vec::new(), Vec::new());
        let mut at = 0;
        while at < self.goals.len() {
            let frame = self.goals[at].frame;
            posed(self.bones, clip, frame, &mut pose);
            let mut own = Sum::new(n);
            while at < self.goals.len() && self.goals[at].frame == frame {
                self.goals[at].rows(&pose, &mut rows);
                rows.iter().for_each(|row| own.add(&self.entries(&pose, row), row.off));
                at += 1;
            }
            own.into_controls(level, frame - self.range.start, &mut normal, &mut gradient);
        }
        if self.range.start > 0 {
            (0..3 * n).for_each(|i| normal.add(i, i, FROZEN));
        }
        (normal, gradient)
    }

    /// What the change itself costs, and the damping of the step.
    fn add_change(&self, level: &Level, damping: f64, normal: &mut Banded, gradient: &mut [f64]) {
        let n = self.freedoms.len();
        let mut change = vec![0.0; n];
        let price: Vec<f64> = self.freedoms.iter().map(|f| 1.0 / (f.usual * f.usual)).collect();
        for frame in 0..self.range.len() {
            self.at(level.spline, &level.controls, frame, &mut change);
            change.iter_mut().zip(&level.done[frame * n..]).for_each(|(c, d)| *c += d);
            let (first, weights) = level.spline.weights(frame);
            for (a, wa) in weights.iter().enumerate() {
                for d in 0..n {
                    gradient[(first + a) * n + d] += wa * price[d] * change[d];
                    for (b, wb) in weights[..=a].iter().enumerate() {
                        normal.add((first + a) * n + d, (first + b) * n + d, wa * wb * (1.0 + damping) * price[d]);
                    }
                }
            }
        }
        for (first, bend) in level.bends.iter().enumerate() {
            let at = |m: usize| first + m * n;
            let off: f64 = (0..3).map(|m| BEND[m] * level.controls[at(m)]).sum();
            for a in 0..3 {
                gradient[at(a)] += bend * BEND[a] * off;
                (0..=a).for_each(|b| normal.add(at(a), at(b), bend * BEND[a] * BEND[b]));
            }
        }
    }

    /// Derivatives of a row by the freedoms that move it.
    fn entries(&self, pose: &[Segment], row: &Row) -> Vec<(usize, f64)> {
        let mut entries: Vec<(usize, f64)> = Vec::new();
        let mut add = |d: usize, value: f64| match entries.iter_mut().find(|(e, _)| *e == d) {
            Some((_, sum)) => *sum += value,
            None => entries.push((d, value)),
        };
        for (joint, place, direction) in row.moves.iter().flatten() {
            for &d in &self.above[*joint] {
                let freedom = &self.freedoms[d];
                if freedom.shift {
                    add(d, freedom.axis.dot(direction));
                } else {
                    let segment = &pose[freedom.joint];
                    let axis = segment.turn * freedom.axis;
                    add(d, axis.cross(&(place - segment.joint_m)).dot(direction));
                }
            }
        }
        if let Some((joint, about)) = &row.turns {
            for &d in self.above[*joint].iter().filter(|&&d| !self.freedoms[d].shift) {
                add(d, (pose[self.freedoms[d].joint].turn * self.freedoms[d].axis).dot(about));
            }
        }
        entries
    }
}

/// Sums over the goals of one frame.
struct Sum {
    n: usize,
    squares: Vec<f64>,
    gradient: Vec<f64>,
    used: Vec<bool>,
}

impl Sum {
    fn new(n: usize) -> Self {
        Self { n, squares: vec![0.0; n * n], gradient: vec![0.0; n], used: vec![false; n] }
    }

    fn add(&mut self, entries: &[(usize, f64)], off: f64) {
        for &(d, value) in entries {
            self.used[d] = true;
            self.gradient[d] += value * off;
            entries.iter().for_each(|&(e, other)| self.squares[d * self.n + e] += value * other);
        }
    }

    fn into_controls(self, level: &Level, frame: usize, normal: &mut Banded, gradient: &mut [f64]) {
        let (first, weights) = level.spline.weights(frame);
        let used: Vec<usize> = (0..self.n).filter(|&d| self.used[d]).collect();
        for (a, wa) in weights.iter().enumerate() {
            for &d in &used {
                let row = (first + a) * self.n + d;
                gradient[row] += level.stiffness * wa * self.gradient[d];
                for (b, wb) in weights[..=a].iter().enumerate() {
                    for &e in used.iter().filter(|&&e| b < a || e <= d) {
                        let value = level.stiffness * wa * wb * self.squares[d * self.n + e];
                        normal.add(row, (first + b) * self.n + e, value);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::goals::{Place, Want};
    use super::*;

    /// A leg that hangs from a root: hip, knee, ankle; it swings and bends.
    fn leg(frames: usize) -> (Bones, Clip) {
        let bones = Bones {
            parents: vec![None, Some(0), Some(1), Some(2)],
            offsets_m: vec![
                Vector3::zeros(),
                Vector3::zeros(),
                Vector3::new(0.0, 0.0, -0.4),
                Vector3::new(0.0, 0.0, -0.4),
            ],
        };
        let mut clip = Clip { root_m: Vec::new(), turns: Vec::new() };
        for f in 0..frames {
            let t = f as f64 * 0.03;
            clip.root_m.push(Vector3::new(0.0, 0.01 * f as f64, 0.75));
            clip.turns.extend([
                Rotation3::identity(),
                Rotation3::new(Vector3::new(0.4 * t.sin() - 0.4, 0.05 * t.cos(), 0.0)),
                Rotation3::new(Vector3::new(0.7 + 0.2 * (1.7 * t).sin(), 0.0, 0.0)),
                Rotation3::identity(),
            ]);
        }
        (bones, clip)
    }

    fn freedoms() -> Vec<Freedom> {
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
        let shift = axes.map(|axis| Freedom { joint: 0, axis, shift: true, usual: 0.03 });
        let hip = axes.map(|axis| Freedom { joint: 1, axis, shift: false, usual: 0.15 });
        let knee = Freedom { joint: 2, axis: Vector3::x(), shift: false, usual: 0.3 };
        shift.into_iter().chain(hip).chain([knee]).collect()
    }

    fn options(frames: usize, window: usize) -> Options {
        Options {
            levels: vec![(4, 3e-3), (2, 1e-3), (1, 1e-4), (1, 1e-5)],
            sharp: vec![0.01; frames * 7],
            tolerance_m: 1e-5,
            window,
            overlap: 40,
        }
    }

    const ANKLE: Place = Place { joint: 3, local_m: Vector3::new(0.0, 0.0, 0.0) };

    fn stand(bones: &Bones, clip: &Clip, range: Range<usize>) -> Vec<Goal> {
        let mut pose = Vec::new();
        posed(bones, clip, usize::midpoint(range.start, range.end), &mut pose);
        let target = ANKLE.of(&pose);
        range.map(|frame| Goal { frame, want: Want::At(ANKLE, target) }).collect()
    }

    #[test]
    fn goals_are_met_and_what_is_free_of_them_hardly_changes() {
        let (bones, before) = leg(120);
        let mut clip = before.clone();
        let mut goals = stand(&bones, &clip, 50..62);
        goals.extend((0..120).map(|frame| Goal { frame, want: Want::Above(ANKLE, -0.02) }));
        let off = change(&bones, &mut clip, &freedoms(), &goals, &options(120, 1000));
        assert!(off.iter().all(|o| *o < 1e-5), "{off:?}");
        for frame in [0, 10, 110, 119] {
            assert!((clip.root_m[frame] - before.root_m[frame]).norm() < 5e-3);
        }
        assert_eq!(clip.turns[4 * 55], before.turns[4 * 55], "what has no freedom stays to the bit");
    }

    #[test]
    fn windows_change_a_long_clip_as_one_does() {
        let (bones, before) = leg(400);
        let goals: Vec<Goal> = (0..8).flat_map(|k| stand(&bones, &before, 30 + 48 * k..40 + 48 * k)).collect();
        let mut whole = before.clone();
        let mut parts = before.clone();
        let off = change(&bones, &mut whole, &freedoms(), &goals, &options(400, 1000));
        let again = change(&bones, &mut parts, &freedoms(), &goals, &options(400, 120));
        assert!(off.iter().chain(&again).all(|o| *o < 1e-5));
        for frame in 0..400 {
            assert!((whole.root_m[frame] - parts.root_m[frame]).norm() < 2e-3, "frame {frame}");
        }
    }

    #[test]
    fn without_goals_nothing_changes() {
        let (bones, before) = leg(30);
        let mut clip = before.clone();
        change(&bones, &mut clip, &freedoms(), &[], &options(30, 1000));
        assert_eq!(clip.root_m, before.root_m);
        assert_eq!(clip.turns, before.turns);
    }

    #[test]
    fn every_kind_of_goal_has_its_derivative() {
        let (bones, clip) = leg(3);
        let free = freedoms();
        let knee = Place { joint: 2, local_m: Vector3::new(0.03, 0.1, 0.0) };
        let mut pose = Vec::new();
        posed(&bones, &clip, 1, &mut pose);
        let ahead = knee.of(&pose) + pose[2].turn * Vector3::new(0.01, 2.0, -0.02);
        let wants = [
            Want::At(ANKLE, Vector3::new(0.1, 0.2, 0.3)),
            Want::Above(ANKLE, 2.0),
            Want::Apart(ANKLE, knee, Vector3::new(0.1, 0.0, 0.1)),
            Want::Within(Place { joint: 0, local_m: Vector3::zeros() }, ANKLE, 0.2),
            Want::Look(knee, Vector3::y(), ahead),
        ];
        let set = options(3, 1000);
        for want in wants {
            let goals = [Goal { frame: 1, want }];
            let window = Window::new(&bones, &free, &goals, 0..3, &set);
            let rows_at = |clip: &Clip| {
                let (mut pose, mut rows) = (Vec::new(), Vec::new());
                posed(&bones, clip, 1, &mut pose);
                goals[0].rows(&pose, &mut rows);
                (pose, rows)
            };
            let (pose, rows) = rows_at(&clip);
            assert!(!rows.is_empty());
            for (d, freedom) in free.iter().enumerate() {
                let step = 1e-6;
                let moved = |by: f64| {
                    let mut out = clip.clone();
                    if freedom.shift {
                        out.root_m[1] += freedom.axis * by;
                    } else {
                        out.turns[4 + freedom.joint] *= Rotation3::new(freedom.axis * by);
                    }
                    rows_at(&out).1
                };
                let (up, down) = (moved(step), moved(-step));
                for (r, row) in rows.iter().enumerate() {
                    let ours = window.entries(&pose, row).iter().find(|(e, _)| *e == d).map_or(0.0, |(_, v)| *v);
                    let slope = (up[r].off - down[r].off) / (2.0 * step);
                    // A look is told in axes that turn along with it: its rows may differ by what it misses.
                    let allowed = if matches!(goals[0].want, Want::Look(..)) { 0.02 } else { 1e-5 };
                    assert!((ours - slope).abs() < allowed, "{:?} freedom {d}: {ours} {slope}", goals[0].want);
                }
            }
        }
    }
}
