//! A whole take: followed forwards frame by frame (live is the same), then solved once more with what both sides of
//! each frame say of it.
//!
//! What the neighbours say of a component is its smoothed value without the frame itself: a Kalman filter and
//! Rauch–Tung–Striebel smoother per component, with the take's own accelerations as noise, and the frame's part taken
//! out again. Where the markers say much, this changes little; where they are gone, it is all there is.

use super::certainty::Certainty;
use super::kinematics::{best_turn, segments, vector_of};
use super::series::{carried, data_alone, without_itself};
use super::solve::{Evidence, Orientation, Pin, Prior, Solved, Solver};
use super::{Figure, Pose};
use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};

/// Largest acceleration that bodies have and live following expects: of turns (rad/s²) and of the root (m/s²).
const TURN_ACCELERATION: f64 = 300.0;
const ROOT_ACCELERATION: f64 = 60.0;
/// Least acceleration of turns (rad/s²) and of the root (m/s²) that smoothing expects.
const LEAST_TURN: f64 = 2.0;
const LEAST_ROOT: f64 = 0.5;
/// How fast the velocity of what is not seen dies away (1/s).
const DECAY: f64 = 8.0;
/// Turns that differ by less than this are the same motion (rad).
const ALIKE_RAD: f64 = 0.3;
/// The frame's own pose is believed before that of its neighbours where it leaves this part of the cost.
const MUCH_BETTER: f64 = 0.5;
/// A marker this far from its place (in its sigmas, and at least so much, m) does not follow the pose.
const LOST_SIGMAS: f64 = 10.0;
const LOST_M: f64 = 0.03;

/// Everything observed in one frame.
#[derive(Clone, Debug, Default)]
pub struct Seen {
    /// One entry per marker of the figure, or none at all.
    pub markers_m: Vec<Option<Vector3<f64>>>,
    /// Places that are known.
    pub pins: Vec<Pin>,
    /// Orientations that are known.
    pub orientations: Vec<Orientation>,
}

impl Seen {
    pub(super) fn evidence(&self) -> Evidence<'_> {
        Evidence { markers_m: &self.markers_m, pins: &self.pins, orientations: &self.orientations }
    }

    /// Of which joints something at or below them was seen.
    fn tells(&self, figure: &Figure) -> Vec<bool> {
        let mut told = vec![false; figure.joints.len()];
        let markers = figure.markers.iter().zip(&self.markers_m).filter(|(_, seen)| seen.is_some());
        let joints = markers.map(|(m, _)| m.joint).chain(self.pins.iter().map(|p| p.joint));
        for j in joints.chain(self.orientations.iter().map(|o| o.joint)) {
            told[j] = true;
        }
        for j in (1..told.len()).rev() {
            if told[j] {
                told[figure.joints[j].parent.unwrap_or(0)] = true;
            }
        }
        told
    }

    fn count(&self) -> usize {
        self.markers_m.iter().flatten().count() + self.pins.len() + 2 * self.orientations.len()
    }
}

/// One frame of a solved take.
#[derive(Clone, Debug)]
pub struct Frame {
    /// The pose.
    pub pose: Pose,
    /// How certain it is; `None` where nothing at all is known.
    pub certainty: Option<Certainty>,
}

/// Follows a figure frame by frame.
#[derive(Clone, Debug)]
pub struct Follower {
    figure: Figure,
    solver: Solver,
    step_s: f64,
    now: Option<Pose>,
    before: Option<Pose>,
    /// Frames since each joint's turn was last told by markers below it; the root's is entry 0.
    unseen: Vec<usize>,
}

impl Follower {
    /// A follower that has seen nothing yet; `also`: joints that pins or orientations may name.
    pub fn new(figure: Figure, step_s: f64, also: impl IntoIterator<Item = usize>) -> Self {
        let solver = Solver::of(&figure, also);
        let unseen = vec![0; figure.joints.len()];
        Self { figure, solver, step_s, now: None, before: None, unseen }
    }

    /// The next frame. Before anything was seen, `None`.
    pub fn push(&mut self, seen: &Seen) -> Option<Solved> {
        let enough = seen.count() >= 3;
        let solved = match &self.now {
            None if !enough => return None,
            None => self.first(seen),
            Some(now) => {
                let prior = self.expected(now);
                let tracked = self.solver.solve(&self.figure, prior.pose.clone(), seen.evidence(), Some(&prior));
                self.again_if_lost(seen, tracked)
            }
        };
        self.note(seen);
        self.before = self.now.replace(solved.pose.clone());
        Some(solved)
    }

    /// Start over where the pose went astray: where a segment's markers are all far from where it has them, the joints
    /// above it are searched again from rest; where most markers are, everything is.
    fn again_if_lost(&mut self, seen: &Seen, tracked: Solved) -> Solved {
        let off = super::solve::residuals(&self.figure, &tracked.pose, &seen.markers_m);
        let n = self.figure.joints.len();
        let (mut near, mut far) = (vec![0usize; n], vec![0usize; n]);
        for (off, marker) in off.iter().zip(&self.figure.markers) {
            let Some(off) = off else { continue };
            let count =
                if *off > LOST_SIGMAS * marker.sigma_m.max(LOST_M / LOST_SIGMAS) { &mut far } else { &mut near };
            count[marker.joint] += 1;
        }
        let lost: Vec<usize> = (1..n).filter(|&j| near[j] == 0 && far[j] > 0).collect();
        if lost.is_empty() {
            return tracked;
        }
        let mut pose = tracked.pose.clone();
        for &j in &lost {
            let mut at = j;
            while at > 0 && near[at] == 0 {
                pose.turns[at] = Vector3::zeros();
                at = self.figure.joints[at].parent.unwrap_or(0);
            }
        }
        let mut best = tracked;
        let mut found = self.solver.solve(&self.figure, pose, seen.evidence(), None);
        if found.cost < best.cost {
            std::mem::swap(&mut best, &mut found);
        }
        let total = |count: &[usize]| count.iter().sum::<usize>();
        if total(&far) > total(&near) {
            let anew = self.first(seen);
            if anew.cost < best.cost {
                return anew;
            }
        }
        best
    }

    /// The pose of a frame without history: the rest pose laid onto the markers, and several others.
    fn first(&mut self, seen: &Seen) -> Solved {
        let mut best: Option<Solved> = None;
        for start in starts(&self.figure, seen, &self.solver) {
            let found = self.solver.solve(&self.figure, start, seen.evidence(), None);
            if best.as_ref().is_none_or(|b| found.cost < b.cost) {
                best = Some(found);
            }
        }
        best.expect("there is always a start")
    }

    /// What the last two frames let expect.
    fn expected(&self, now: &Pose) -> Prior {
        let dt = self.step_s;
        let mut pose = now.clone();
        let growth = |unseen: usize| 1.0 + unseen as f64;
        let keep = |unseen: usize| if unseen == 0 { 1.0 } else { (-DECAY * dt * unseen as f64).exp() };
        if let Some(before) = &self.before {
            pose.root_m += (now.root_m - before.root_m) * keep(self.unseen[0]);
            let turned = vector_of(&(now.root * before.root.inverse())) * keep(self.unseen[0]);
            pose.root = Rotation3::new(turned) * now.root;
            for (j, turn) in pose.turns.iter_mut().enumerate() {
                let moved = now.turns[j] - before.turns[j];
                if moved.norm() < 1.0 {
                    *turn += moved * keep(self.unseen[j]);
                }
            }
        }
        let turn = TURN_ACCELERATION * dt * dt;
        let sd = |j: usize| Vector3::repeat((turn * growth(self.unseen[j])).min(3.0));
        Prior {
            pose,
            turn_sd_rad: (0..self.figure.joints.len()).map(sd).collect(),
            root_sd_m: Vector3::repeat(ROOT_ACCELERATION * dt * dt * growth(self.unseen[0])),
            root_sd_rad: (turn * growth(self.unseen[0])).min(3.0),
        }
    }

    fn note(&mut self, seen: &Seen) {
        let told = seen.tells(&self.figure);
        for (unseen, told) in self.unseen.iter_mut().zip(told) {
            *unseen = if told { 0 } else { *unseen + 1 };
        }
    }
}

/// Poses to start from: rest, arms raised or lowered and knees bent a little by limits, laid onto the markers.
fn starts(figure: &Figure, seen: &Seen, solver: &Solver) -> Vec<Pose> {
    let rest = figure.rest();
    let mut out = vec![laid(figure, rest.clone(), seen)];
    for share in [0.35_f64, -0.35] {
        let mut bent = rest.clone();
        for (j, (joint, turn)) in figure.joints.iter().zip(&mut bent.turns).enumerate().skip(1) {
            for k in (0..3).filter(|&k| joint.free[k] && solver.turns(j)) {
                let [low, high] = joint.limits_rad[k];
                let towards = if share > 0.0 { high } else { low };
                if towards.abs() < std::f64::consts::PI {
                    turn[k] = share.abs() * towards;
                }
            }
        }
        out.push(laid(figure, bent, seen));
    }
    out
}

/// A pose moved and turned as a whole so that its markers lie on the observed ones as well as they can.
fn laid(figure: &Figure, mut pose: Pose, seen: &Seen) -> Pose {
    let all = segments(&figure.joints, &pose);
    let markers = figure.markers.iter().zip(&seen.markers_m);
    let mut pairs: Vec<(Vector3<f64>, Vector3<f64>, f64)> =
        markers.filter_map(|(m, s)| s.map(|s| (all[m.joint].place(&m.place_m), s, depth(figure, m.joint)))).collect();
    pairs.extend(seen.pins.iter().map(|p| (all[p.joint].place(&p.place_m), p.target_m, depth(figure, p.joint))));
    if let Some(known) = seen.orientations.iter().min_by_key(|o| o.joint) {
        let turn = known.target * all[known.joint].turn.inverse();
        pose.root = turn * pose.root;
        if let Some((here, there, _)) = pairs.first() {
            pose.root_m = there - turn * (here - pose.root_m);
        }
        return pose;
    }
    let weight: f64 = pairs.iter().map(|p| p.2).sum();
    let here = pairs.iter().map(|p| p.0 * p.2).sum::<Vector3<f64>>() / weight;
    let there = pairs.iter().map(|p| p.1 * p.2).sum::<Vector3<f64>>() / weight;
    let spread: Matrix3<f64> = pairs.iter().map(|p| (p.1 - there) * (p.0 - here).transpose() * p.2).sum();
    let turn = best_turn(&spread);
    pose.root_m = there + turn * (pose.root_m - here);
    pose.root = turn * pose.root;
    pose
}

/// Weight of a segment's markers for laying a pose: the trunk counts most.
fn depth(figure: &Figure, joint: usize) -> f64 {
    let moving = std::iter::successors(Some(joint), |&j| figure.joints[j].parent).count();
    1.0 / (moving * moving) as f64
}

/// Joints that pins and orientations name.
pub(super) fn joints_of(frames: &[Seen]) -> Vec<usize> {
    let also = frames.iter().flat_map(|f| f.pins.iter().map(|p| p.joint).chain(f.orientations.iter().map(|o| o.joint)));
    let mut also: Vec<usize> = also.collect();
    also.sort_unstable();
    also.dedup();
    also
}

/// A whole take. Frames before anything was seen get the first pose that was found.
pub fn solve_take(figure: &Figure, step_s: f64, frames: &[Seen]) -> Vec<Frame> {
    let also = joints_of(frames);
    let mut solver = Solver::of(figure, also.iter().copied());
    let poses = followed(figure, step_s, frames, &also);
    let mut round = Round::of(&mut solver, figure, step_s, frames, &poses);
    if round.misled {
        // Frames whose neighbours misled them were among the neighbours of others: once more from what came out.
        let poses: Vec<Pose> = round.out.into_iter().map(|f| f.pose).collect();
        round = Round::of(&mut solver, figure, step_s, frames, &poses);
    }
    let Round { mut out, certain, mut priors, .. } = round;
    bridge(&mut solver, figure, step_s, frames, &certain, &mut priors, &mut out);
    out
}

/// All frames solved with what their neighbours say of them; `misled`: some were better off without it.
struct Round {
    out: Vec<Frame>,
    certain: Vec<Option<Certainty>>,
    priors: Vec<Prior>,
    misled: bool,
}

impl Round {
    fn of(solver: &mut Solver, figure: &Figure, step_s: f64, frames: &[Seen], poses: &[Pose]) -> Self {
        let certain: Vec<Option<Certainty>> =
            frames.iter().zip(poses).map(|(f, p)| solver.certainty(figure, p, f.evidence(), None, false)).collect();
        let priors = neighbours(figure, step_s, poses, &certain);
        let (mut out, mut misled) = (Vec::with_capacity(frames.len()), false);
        for ((seen, prior), pose) in frames.iter().zip(&priors).zip(poses) {
            let starts = if told_alike(figure, pose, prior) { vec![pose] } else { vec![&prior.pose, pose] };
            let (frame, other) = settled(solver, figure, seen, &starts, prior);
            out.push(frame);
            misled |= other;
        }
        Self { out, certain, priors, misled }
    }
}

/// A frame with what its neighbours say of it, from the first start, or from another that explains it much better; and
/// whether it was another.
fn settled(solver: &mut Solver, figure: &Figure, seen: &Seen, starts: &[&Pose], prior: &Prior) -> (Frame, bool) {
    let mut from = |start: &&Pose| solver.solve(figure, (*start).clone(), seen.evidence(), Some(prior));
    let (mut solved, mut another) = (from(&starts[0]), false);
    for start in &starts[1..] {
        let other = from(start);
        if other.cost < MUCH_BETTER * solved.cost {
            (solved, another) = (other, true);
        }
    }
    let certainty = solver.certainty(figure, &solved.pose, seen.evidence(), Some(prior), true);
    (Frame { pose: solved.pose, certainty }, another)
}

/// Frames in which something was not told are solved once more: what is carried through keeps the motion on both sides,
/// and meets the settled frames there without a step.
fn bridge(
    solver: &mut Solver,
    figure: &Figure,
    step_s: f64,
    frames: &[Seen],
    certain: &[Option<Certainty>],
    priors: &mut [Prior],
    out: &mut [Frame],
) {
    let told: Vec<Vec<bool>> = frames.iter().map(|f| f.tells(figure)).collect();
    let mut untold = vec![false; frames.len()];
    for (j, joint) in figure.joints.iter().enumerate().skip(1).filter(|(j, _)| solver.turns(*j)) {
        for k in (0..3).filter(|&k| joint.free[k]) {
            let rest = joint.rest_sd_rad[k] * joint.rest_sd_rad[k];
            let variance = |(told, c): (&Vec<bool>, &Option<Certainty>)| match c {
                Some(c) if told[j] => c.turn_rad2[j][k].min(rest),
                _ => f64::INFINITY,
            };
            let variance: Vec<f64> = told.iter().zip(certain).map(variance).collect();
            if variance.iter().all(|v| v.is_finite()) || variance.iter().filter(|v| v.is_finite()).count() < 2 {
                continue;
            }
            let values = unwrapped(joint, out, j, &variance).map(|turn| turn[k]).collect::<Vec<f64>>();
            for (t, (mean, sd)) in carried(&values, &variance, step_s, LEAST_TURN).into_iter().enumerate() {
                if variance[t].is_infinite() {
                    priors[t].pose.turns[j][k] = mean;
                    priors[t].turn_sd_rad[j][k] = sd;
                    untold[t] = true;
                }
            }
        }
    }
    bridge_root(step_s, certain, &told, priors, out);
    for t in (0..frames.len()).filter(|&t| untold[t] || !told[t][0]) {
        let start = priors[t].pose.clone();
        out[t] = settled(solver, figure, &frames[t], &[&start], &priors[t]).0;
    }
}

/// The root through frames in which nothing at all was seen.
fn bridge_root(step_s: f64, certain: &[Option<Certainty>], told: &[Vec<bool>], priors: &mut [Prior], out: &[Frame]) {
    let known = told.iter().filter(|t| t[0]).count();
    if known == told.len() || known < 2 {
        return;
    }
    let variances = |of: &dyn Fn(&Certainty) -> f64| -> Vec<f64> {
        let own =
            |(told, c): (&Vec<bool>, &Option<Certainty>)| c.as_ref().filter(|_| told[0]).map_or(f64::INFINITY, of);
        told.iter().zip(certain).map(own).collect()
    };
    for k in 0..3 {
        let values: Vec<f64> = out.iter().map(|f| f.pose.root_m[k]).collect();
        let found = carried(&values, &variances(&|c| c.root_m2[k]), step_s, LEAST_ROOT);
        for (t, (mean, sd)) in found.into_iter().enumerate().filter(|(t, _)| !told[*t][0]) {
            priors[t].pose.root_m[k] = mean;
            priors[t].root_sd_m[k] = sd;
        }
    }
    let mut last: Option<Quaternion<f64>> = None;
    let mut continued = |(frame, told): (&Frame, &Vec<bool>)| {
        let q = UnitQuaternion::from_rotation_matrix(&frame.pose.root).into_inner();
        let q = if last.is_some_and(|last| last.dot(&q) < 0.0) { -q } else { q };
        last = if told[0] { Some(q) } else { last };
        q
    };
    let turns: Vec<Quaternion<f64>> = out.iter().zip(told).map(&mut continued).collect();
    let variance = variances(&|c| 0.25 * c.root_rad2.max());
    let parts: Vec<Vec<(f64, f64)>> = (0..4)
        .map(|k| {
            let values: Vec<f64> = turns.iter().map(|q| q.coords[k]).collect();
            carried(&values, &variance, step_s, 0.5 * LEAST_TURN)
        })
        .collect();
    for t in (0..told.len()).filter(|&t| !told[t][0]) {
        let q = Quaternion::new(parts[3][t].0, parts[0][t].0, parts[1][t].0, parts[2][t].0);
        priors[t].pose.root = UnitQuaternion::from_quaternion(q).to_rotation_matrix();
        priors[t].root_sd_rad = 2.0 * parts.iter().map(|p| p[t].1).fold(0.0, f64::max);
    }
}

/// A joint's turns without jumps by whole turns, over what was told.
fn unwrapped<'a>(
    joint: &'a super::Joint,
    frames: &'a [Frame],
    j: usize,
    variance: &'a [f64],
) -> impl Iterator<Item = Vector3<f64>> + 'a {
    let mut last: Option<Vector3<f64>> = None;
    frames.iter().zip(variance).map(move |(frame, variance)| {
        let turn = last.map_or(frame.pose.turns[j], |last| joint.near(&frame.pose.turns[j], &last));
        if variance.is_finite() {
            last = Some(turn);
        }
        turn
    })
}

fn followed(figure: &Figure, step_s: f64, frames: &[Seen], also: &[usize]) -> Vec<Pose> {
    let mut follower = Follower::new(figure.clone(), step_s, also.iter().copied());
    let found: Vec<Option<Pose>> = frames.iter().map(|f| follower.push(f).map(|s| s.pose)).collect();
    let first = found.iter().flatten().next().cloned().unwrap_or_else(|| figure.rest());
    found.into_iter().map(|p| p.unwrap_or_else(|| first.clone())).collect()
}

/// Whether a frame's own pose is where its neighbours have it, so that it is the better place to start from.
fn told_alike(figure: &Figure, pose: &Pose, prior: &Prior) -> bool {
    (1..figure.joints.len()).all(|j| (pose.turns[j] - prior.pose.turns[j]).amax() < ALIKE_RAD)
}

/// For every frame, what the others say of it.
pub(super) fn neighbours(figure: &Figure, step_s: f64, poses: &[Pose], certain: &[Option<Certainty>]) -> Vec<Prior> {
    let n = poses.len();
    let mut priors: Vec<Prior> = poses
        .iter()
        .map(|pose| Prior {
            pose: pose.clone(),
            turn_sd_rad: vec![Vector3::repeat(f64::INFINITY); figure.joints.len()],
            root_sd_m: Vector3::repeat(f64::INFINITY),
            root_sd_rad: f64::INFINITY,
        })
        .collect();
    for (j, joint) in figure.joints.iter().enumerate().skip(1) {
        let mut turns: Vec<Vector3<f64>> = poses.iter().map(|p| p.turns[j]).collect();
        for t in 1..n {
            turns[t] = joint.near(&turns[t], &turns[t - 1]);
        }
        for k in 0..3 {
            let rest = joint.rest_sd_rad[k] * joint.rest_sd_rad[k];
            let own = |c: &Option<Certainty>| data_alone(c.as_ref().map_or(f64::INFINITY, |c| c.turn_rad2[j][k]), rest);
            let variance: Vec<f64> = certain.iter().map(own).collect();
            let values: Vec<f64> = turns.iter().map(|t| t[k]).collect();
            for (t, (mean, sd)) in without_itself(&values, &variance, step_s, LEAST_TURN).into_iter().enumerate() {
                // The frame's own vector may be the other one of the same rotation.
                priors[t].pose.turns[j][k] = mean + poses[t].turns[j][k] - turns[t][k];
                priors[t].turn_sd_rad[j][k] = sd;
            }
        }
    }
    for k in 0..3 {
        let values: Vec<f64> = poses.iter().map(|p| p.root_m[k]).collect();
        let variance: Vec<f64> = certain.iter().map(|c| c.as_ref().map_or(f64::INFINITY, |c| c.root_m2[k])).collect();
        for (t, (mean, sd)) in without_itself(&values, &variance, step_s, LEAST_ROOT).into_iter().enumerate() {
            priors[t].pose.root_m[k] = mean;
            priors[t].root_sd_m[k] = sd;
        }
    }
    root_turns(step_s, poses, certain, &mut priors);
    priors
}

/// The root's turn by the four numbers of its quaternion, each along time.
fn root_turns(step_s: f64, poses: &[Pose], certain: &[Option<Certainty>], priors: &mut [Prior]) {
    let mut quaternions: Vec<Quaternion<f64>> =
        poses.iter().map(|p| UnitQuaternion::from_rotation_matrix(&p.root).into_inner()).collect();
    for t in 1..quaternions.len() {
        if quaternions[t].dot(&quaternions[t - 1]) < 0.0 {
            quaternions[t] = -quaternions[t];
        }
    }
    let variance: Vec<f64> =
        certain.iter().map(|c| c.as_ref().map_or(f64::INFINITY, |c| 0.25 * c.root_rad2.max())).collect();
    let mut sums = vec![(Vec::with_capacity(4), 0.0f64); poses.len()];
    for k in 0..4 {
        let values: Vec<f64> = quaternions.iter().map(|q| q.coords[k]).collect();
        for (sum, (mean, sd)) in sums.iter_mut().zip(without_itself(&values, &variance, step_s, 0.5 * LEAST_TURN)) {
            sum.0.push(mean);
            sum.1 = sum.1.max(2.0 * sd);
        }
    }
    for (prior, (q, sd)) in priors.iter_mut().zip(sums) {
        let mean = UnitQuaternion::from_quaternion(Quaternion::new(q[3], q[0], q[1], q[2]));
        prior.pose.root = mean.to_rotation_matrix();
        prior.root_sd_rad = sd;
    }
}

#[cfg(test)]
mod tests {
    use super::super::solve::tests::{posed, puppet, seen};
    use super::*;

    /// A second of smooth motion at 100 Hz.
    fn frames(figure: &Figure) -> (Vec<Pose>, Vec<Seen>) {
        let pose = |t: usize| {
            let mut pose = posed();
            let phase = t as f64 * 0.05;
            pose.root_m.x += 0.2 * phase;
            pose.turns[1].y += 0.5 * phase.sin();
            pose.turns[2].z += 0.4 * (1.3 * phase).cos();
            pose
        };
        let poses: Vec<Pose> = (0..100).map(pose).collect();
        let all = poses.iter().map(|p| Seen { markers_m: seen(figure, p), ..Seen::default() }).collect();
        (poses, all)
    }

    fn hand(figure: &Figure, pose: &Pose) -> Vector3<f64> {
        segments(&figure.joints, pose)[2].place(&Vector3::new(0.25, 0.0, 0.0))
    }

    #[test]
    fn a_take_without_noise_is_found_within_its_noise() {
        let figure = puppet();
        let (poses, all) = frames(&figure);
        let solved = solve_take(&figure, 0.01, &all);
        for (found, truth) in solved.iter().zip(&poses) {
            assert!((hand(&figure, &found.pose) - hand(&figure, truth)).norm() < 1.5e-3);
        }
    }

    #[test]
    fn an_arm_that_is_gone_is_carried_through_and_taken_up_again() {
        let mut figure = puppet();
        figure.markers.iter_mut().for_each(|m| m.sigma_m = 1e-4);
        let (poses, mut all) = frames(&figure);
        for seen in &mut all[40..70] {
            seen.markers_m[3..9].fill(None);
        }
        let solved = solve_take(&figure, 0.01, &all);
        let off = |t: usize| (hand(&figure, &solved[t].pose) - hand(&figure, &poses[t])).norm();
        assert!((40..70).map(off).fold(0.0, f64::max) < 0.05);
        let after = (72..100).map(off).fold(0.0, f64::max);
        assert!(after < 3e-3, "{after}");
        let bend = |at: &dyn Fn(usize) -> Vector3<f64>, t: usize| (at(t + 1) - 2.0 * at(t) + at(t - 1)).norm();
        let ours = |t: usize| hand(&figure, &solved[t].pose);
        let truth = |t: usize| hand(&figure, &poses[t]);
        let sharpest = |at: &dyn Fn(usize) -> Vector3<f64>| (1..99).map(|t| bend(at, t)).fold(0.0, f64::max);
        assert!(sharpest(&ours) < 2.0 * sharpest(&truth), "{} {}", sharpest(&ours), sharpest(&truth));
    }

    #[test]
    fn a_pinned_place_stays() {
        let figure = puppet();
        let (poses, mut all) = frames(&figure);
        let place_m = Vector3::new(-0.2, 0.0, 0.0);
        let target_m = segments(&figure.joints, &poses[50])[4].place(&place_m);
        for seen in &mut all[48..53] {
            seen.pins.push(Pin { joint: 4, place_m, target_m, sigma_m: 1e-4 });
        }
        let solved = solve_take(&figure, 0.01, &all);
        for frame in &solved[48..53] {
            let at = segments(&figure.joints, &frame.pose)[4].place(&place_m);
            assert!((at - target_m).norm() < 1e-3);
        }
    }
}
