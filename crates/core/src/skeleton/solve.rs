//! Inverse kinematics of one frame: the pose that explains markers, pins and orientations best, near what is expected.
//!
//! Levenberg–Marquardt on a robust cost (Student's t over markers, its scale following the frame's own residuals, so
//! that a bad start or a swapped marker does not decide). Every derivative is analytic: a column is a twist, all that a
//! subtree's markers say of it is one 6 × 6 matrix.

use super::kinematics::{Segment, cross, segments, vector_of};
use super::normal::Normal;
use super::{Figure, Joint, Pose};
use nalgebra::{Matrix3, Matrix6, Rotation3, Vector3, Vector6};
use std::f64::consts::PI;

/// Degrees of freedom of the residuals' distribution.
const NU: f64 = 6.0;
/// How firm limits are (rad): a degree beyond them costs as much as one standard deviation.
const LIMIT_SD: f64 = 0.0175;
const ITERATIONS: usize = 30;
/// A step of less than this everywhere ends the search (rad, m).
const STILL: f64 = 1e-6;
/// A step that lowers the cost by less than this part ends it, too.
const ENOUGH: f64 = 1e-6;
/// Largest change of a component in one step (rad).
const STEP: f64 = 0.6;
/// Median of the squared length of a vector of three standard normal components.
const MEDIAN_CHI2: f64 = 2.366;

/// A place of a segment that must be at a place of the world: a planted foot, or a sensor's position.
#[derive(Clone, Debug)]
pub struct Pin {
    /// Whose segment.
    pub joint: usize,
    /// Place in its axes (m).
    pub place_m: Vector3<f64>,
    /// Where it must be (m, world).
    pub target_m: Vector3<f64>,
    /// How firmly (m, standard deviation per axis).
    pub sigma_m: f64,
}

/// A segment's orientation, as a sensor gives it.
#[derive(Clone, Debug)]
pub struct Orientation {
    /// Whose segment.
    pub joint: usize,
    /// From the segment's axes to the world's.
    pub target: Rotation3<f64>,
    /// Standard deviation about each axis (rad).
    pub sigma_rad: f64,
}

/// What was observed in a frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct Evidence<'a> {
    /// One entry per marker of the figure, or none at all.
    pub markers_m: &'a [Option<Vector3<f64>>],
    /// Places that are known.
    pub pins: &'a [Pin],
    /// Orientations that are known.
    pub orientations: &'a [Orientation],
}

/// What is expected before looking.
#[derive(Clone, Debug)]
pub struct Prior {
    /// The expected pose.
    pub pose: Pose,
    /// Standard deviation of every component of every turn (rad); infinite where nothing is expected.
    pub turn_sd_rad: Vec<Vector3<f64>>,
    /// Standard deviation of the root's place (m).
    pub root_sd_m: Vector3<f64>,
    /// Standard deviation of the root's turn (rad).
    pub root_sd_rad: f64,
}

/// A frame's solution.
#[derive(Clone, Debug)]
pub struct Solved {
    /// The best pose found.
    pub pose: Pose,
    /// Half of the sum of robust squares, expectations included.
    pub cost: f64,
    /// Iterations that were needed.
    pub iterations: usize,
}

/// What each column of the equations moves: components 0–2 of joint 0 are the root's place, 3–5 its turn.
#[derive(Clone, Copy, Debug)]
pub(super) struct Column {
    pub(super) joint: usize,
    pub(super) component: usize,
}

/// The equations of one figure, ready for any frame.
#[derive(Clone, Debug)]
pub struct Solver {
    pub(super) columns: Vec<Column>,
    pub(super) normal: Normal,
}

impl Solver {
    /// For joints with something to observe at or below them; the others stay at rest.
    pub fn new(joints: &[Joint], observed: impl IntoIterator<Item = usize>) -> Self {
        let mut active = vec![false; joints.len()];
        for j in observed {
            let mut at = Some(j);
            while let Some(i) = at {
                active[i] = true;
                at = joints[i].parent;
            }
        }
        let mut columns: Vec<Column> = (0..6).map(|component| Column { joint: 0, component }).collect();
        let mut above: Vec<Option<usize>> = (0..6).map(|c: usize| c.checked_sub(1)).collect();
        let mut last = vec![5usize; joints.len()];
        for (j, joint) in joints.iter().enumerate().skip(1) {
            last[j] = last[joint.parent.unwrap_or(0)];
            if !active[j] {
                continue;
            }
            for component in (0..3).filter(|&k| joint.free[k]) {
                columns.push(Column { joint: j, component });
                above.push(Some(last[j]));
                last[j] = columns.len() - 1;
            }
        }
        Self { columns, normal: Normal::new(&above) }
    }

    /// Solver for a figure's own markers and what else is observed.
    pub fn of(figure: &Figure, also: impl IntoIterator<Item = usize>) -> Self {
        Self::new(&figure.joints, figure.markers.iter().map(|m| m.joint).chain(also))
    }

    /// Whether a joint's turn is solved for.
    pub fn turns(&self, joint: usize) -> bool {
        self.columns.iter().any(|c| c.joint == joint)
    }

    /// How many components are solved for.
    pub fn len(&self) -> usize {
        self.columns.len()
    }

    /// Whether nothing is solved for; never, since the root always is.
    pub fn is_empty(&self) -> bool {
        self.columns.is_empty()
    }

    /// The pose of a frame, searched from `start`.
    pub fn solve(&mut self, figure: &Figure, start: Pose, evidence: Evidence<'_>, prior: Option<&Prior>) -> Solved {
        let mut pose = start;
        let mut scale = f64::INFINITY;
        let mut damping = 0.0;
        let mut iterations = 0;
        let mut cost = f64::INFINITY;
        while iterations < ITERATIONS {
            scale = spread(figure, &pose, evidence).clamp(1.0, scale);
            cost = self.assemble(figure, &pose, evidence, prior, scale);
            let Some(step) = self.step(damping) else {
                damping = f64::max(10.0 * damping, 1e-6);
                iterations += 1;
                continue;
            };
            iterations += 1;
            let largest = step.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
            let next = self.moved(&figure.joints, &pose, &step);
            let next_cost = self.value(figure, &next, evidence, prior, scale);
            if next_cost <= cost {
                let gained = cost - next_cost;
                pose = next;
                cost = next_cost;
                damping = if damping > 1e-9 { damping * 0.1 } else { 0.0 };
                if largest < STILL || (scale <= 1.0 && gained < ENOUGH * (1.0 + cost)) {
                    break;
                }
            } else {
                if largest < STILL {
                    break;
                }
                damping = f64::max(10.0 * damping, 1e-4);
            }
        }
        Solved { pose, cost, iterations }
    }

    /// Equations at a pose; returns the cost there.
    pub(super) fn assemble(
        &mut self,
        figure: &Figure,
        pose: &Pose,
        evidence: Evidence<'_>,
        prior: Option<&Prior>,
        scale: f64,
    ) -> f64 {
        let all = segments(&figure.joints, pose);
        let (inertia, wrench, mut cost) = moments(figure, &all, evidence, scale);
        let twists = self.twists(&figure.joints, pose, &all);
        for (c, column) in self.columns.iter().enumerate() {
            let force = inertia[column.joint] * twists[c];
            self.normal.set(c, force.dot(&twists[c]), |above| force.dot(&twists[above]));
            self.normal.g[c] = wrench[column.joint].dot(&twists[c]);
        }
        cost += self.expect(&figure.joints, pose, prior);
        cost
    }

    /// What every column does to the world: angular velocity, and velocity of the point at the root's place.
    pub(super) fn twists(&self, joints: &[Joint], pose: &Pose, all: &[Segment]) -> Vec<Vector6<f64>> {
        let mut axes = (usize::MAX, Matrix3::zeros());
        let mut out = Vec::with_capacity(self.columns.len());
        for column in &self.columns {
            let (j, k) = (column.joint, column.component);
            let mut twist = Vector6::zeros();
            if j == 0 {
                twist[if k < 3 { k + 3 } else { k - 3 }] = 1.0;
            } else {
                if axes.0 != j {
                    let above = all[joints[j].parent.unwrap_or(0)].turn;
                    axes = (j, above.matrix() * joints[j].axes(&pose.turns[j]));
                }
                let axis = axes.1.column(k).into_owned();
                let moves = -axis.cross(&(all[j].joint_m - pose.root_m));
                twist.fixed_rows_mut::<3>(0).copy_from(&axis);
                twist.fixed_rows_mut::<3>(3).copy_from(&moves);
            }
            out.push(twist);
        }
        out
    }

    /// Add rest, limits and what is expected to the equations; returns their cost.
    fn expect(&mut self, joints: &[Joint], pose: &Pose, prior: Option<&Prior>) -> f64 {
        let mut cost = 0.0;
        for (c, column) in self.columns.iter().enumerate() {
            for (off, sd) in expectations(joints, pose, prior, *column).into_iter().flatten() {
                let weight = 1.0 / (sd * sd);
                self.normal.add(c, weight);
                self.normal.g[c] += weight * off;
                cost += 0.5 * weight * off * off;
            }
        }
        cost
    }

    /// The cost alone.
    fn value(&self, figure: &Figure, pose: &Pose, evidence: Evidence<'_>, prior: Option<&Prior>, scale: f64) -> f64 {
        let all = segments(&figure.joints, pose);
        let mut cost: f64 = squares(figure, &all, evidence).map(|square| robust(square, scale)).sum();
        for pin in evidence.pins {
            let off = all[pin.joint].place(&pin.place_m) - pin.target_m;
            cost += 0.5 * off.norm_squared() / (pin.sigma_m * pin.sigma_m);
        }
        for known in evidence.orientations {
            let off = vector_of(&(all[known.joint].turn * known.target.inverse()));
            cost += 0.5 * off.norm_squared() / (known.sigma_rad * known.sigma_rad);
        }
        for column in &self.columns {
            for (off, sd) in expectations(&figure.joints, pose, prior, *column).into_iter().flatten() {
                cost += 0.5 * (off / sd).powi(2);
            }
        }
        cost
    }

    fn step(&self, damping: f64) -> Option<Vec<f64>> {
        let mut step: Vec<f64> = self.normal.g.iter().map(|g| -g).collect();
        self.normal.factor(damping)?.solve(&mut step);
        let largest = step.iter().skip(3).fold(0.0, |most: f64, v| most.max(v.abs()));
        if largest > STEP {
            step.iter_mut().for_each(|v| *v *= STEP / largest);
        }
        step.iter().all(|v| v.is_finite()).then_some(step)
    }

    pub(super) fn moved(&self, joints: &[Joint], pose: &Pose, step: &[f64]) -> Pose {
        let mut next = pose.clone();
        next.root_m += Vector3::new(step[0], step[1], step[2]);
        next.root = Rotation3::new(Vector3::new(step[3], step[4], step[5])) * pose.root;
        for (column, v) in self.columns.iter().zip(step).skip(6) {
            next.turns[column.joint][column.component] += v;
        }
        // A vector near a whole turn has no derivative: take the same rotation by the short way.
        for (joint, turn) in joints.iter().zip(&mut next.turns).filter(|(_, t)| t.norm() > 1.9 * PI) {
            *turn = joint.near(turn, &Vector3::zeros());
        }
        next
    }

    /// The last column at or above every joint.
    pub(super) fn last_columns(&self, joints: &[Joint]) -> Vec<usize> {
        let mut last = vec![5usize; joints.len()];
        let mut at = 6;
        for j in 1..joints.len() {
            last[j] = last[joints[j].parent.unwrap_or(0)];
            while at < self.columns.len() && self.columns[at].joint == j {
                last[j] = at;
                at += 1;
            }
        }
        last
    }
}

/// Velocity of a point, from the root, under a twist.
pub(super) fn velocity(twist: &Vector6<f64>, at: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(twist[3], twist[4], twist[5]) + Vector3::new(twist[0], twist[1], twist[2]).cross(at)
}

/// Differences from rest, limits and prior with their standard deviations, of one column.
fn expectations(joints: &[Joint], pose: &Pose, prior: Option<&Prior>, column: Column) -> [Option<(f64, f64)>; 3] {
    let (j, k) = (column.joint, column.component);
    if j == 0 {
        let known = prior.map(|p| {
            if k < 3 {
                (pose.root_m[k] - p.pose.root_m[k], p.root_sd_m[k])
            } else {
                (vector_of(&(pose.root * p.pose.root.inverse()))[k - 3], p.root_sd_rad)
            }
        });
        return [known.filter(|(_, sd)| sd.is_finite()), None, None];
    }
    let value = pose.turns[j][k];
    let [low, high] = joints[j].limits_rad[k];
    // Half a turn is no limit: a vector may go on beyond it to stay near its neighbours in time.
    let none = high - low >= 2.0 * PI;
    let beyond = if value > high { value - high } else { (value - low).min(0.0) };
    let beyond = if none { 0.0 } else { beyond };
    let known = prior.map(|p| (value - p.pose.turns[j][k], p.turn_sd_rad[j][k]));
    [
        Some((value, joints[j].rest_sd_rad[k])).filter(|(_, sd)| sd.is_finite()),
        (beyond != 0.0).then_some((beyond, LIMIT_SD)),
        known.filter(|(_, sd)| sd.is_finite()),
    ]
}

/// What the markers below each joint say, as moments about the root's place: information and gradient of twists.
fn moments(
    figure: &Figure,
    all: &[Segment],
    evidence: Evidence<'_>,
    scale: f64,
) -> (Vec<Matrix6<f64>>, Vec<Vector6<f64>>, f64) {
    let n = figure.joints.len();
    let (mut inertia, mut wrench) = (vec![Matrix6::zeros(); n], vec![Vector6::zeros(); n]);
    let mut cost = 0.0;
    let origin = all[0].joint_m;
    let mut add = |j: usize, at: &Vector3<f64>, off: &Vector3<f64>, weight: f64| {
        let x = at - origin;
        let skew = cross(&x);
        let own: &mut Matrix6<f64> = &mut inertia[j];
        let mut block = own.fixed_view_mut::<3, 3>(0, 0);
        block -= skew * skew * weight;
        let mut block = own.fixed_view_mut::<3, 3>(0, 3);
        block += skew * weight;
        let mut block = own.fixed_view_mut::<3, 3>(3, 0);
        block -= skew * weight;
        for k in 3..6 {
            own[(k, k)] += weight;
        }
        let turn = x.cross(off) * weight;
        for k in 0..3 {
            wrench[j][k] += turn[k];
            wrench[j][k + 3] += off[k] * weight;
        }
    };
    for (marker, seen) in figure.markers.iter().zip(evidence.markers_m) {
        let Some(seen) = seen else { continue };
        let at = all[marker.joint].place(&marker.place_m);
        let off = at - seen;
        let square = off.norm_squared() / (marker.sigma_m * marker.sigma_m);
        cost += robust(square, scale);
        add(marker.joint, &at, &off, trust(square, scale) / (marker.sigma_m * marker.sigma_m));
    }
    for pin in evidence.pins {
        let at = all[pin.joint].place(&pin.place_m);
        let off = at - pin.target_m;
        let weight = 1.0 / (pin.sigma_m * pin.sigma_m);
        cost += 0.5 * weight * off.norm_squared();
        add(pin.joint, &at, &off, weight);
    }
    for known in evidence.orientations {
        let off = vector_of(&(all[known.joint].turn * known.target.inverse()));
        let weight = 1.0 / (known.sigma_rad * known.sigma_rad);
        cost += 0.5 * weight * off.norm_squared();
        for k in 0..3 {
            inertia[known.joint][(k, k)] += weight;
            wrench[known.joint][k] += weight * off[k];
        }
    }
    for j in (1..n).rev() {
        let p = figure.joints[j].parent.unwrap_or(0);
        let (below, force) = (inertia[j], wrench[j]);
        inertia[p] += below;
        wrench[p] += force;
    }
    (inertia, wrench, cost)
}

fn squares<'a>(figure: &'a Figure, all: &'a [Segment], evidence: Evidence<'a>) -> impl Iterator<Item = f64> + 'a {
    figure.markers.iter().zip(evidence.markers_m).filter_map(|(marker, seen)| {
        let off = all[marker.joint].place(&marker.place_m) - seen.as_ref()?;
        Some(off.norm_squared() / (marker.sigma_m * marker.sigma_m))
    })
}

/// How far the frame's markers typically are from the pose, in their own standard deviations.
pub(super) fn spread(figure: &Figure, pose: &Pose, evidence: Evidence<'_>) -> f64 {
    let all = segments(&figure.joints, pose);
    let mut squares: Vec<f64> = squares(figure, &all, evidence).collect();
    if squares.is_empty() {
        return 1.0;
    }
    let middle = squares.len() / 2;
    let (_, median, _) = squares.select_nth_unstable_by(middle, f64::total_cmp);
    (*median / MEDIAN_CHI2).sqrt()
}

fn robust(square: f64, scale: f64) -> f64 {
    0.5 * (NU + 3.0) * scale * scale * (square / (NU * scale * scale)).ln_1p()
}

pub(super) fn trust(square: f64, scale: f64) -> f64 {
    (NU + 3.0) / (NU + square / (scale * scale))
}

/// How far every marker is from a pose (m); `None` where it was not seen.
pub fn residuals(figure: &Figure, pose: &Pose, markers_m: &[Option<Vector3<f64>>]) -> Vec<Option<f64>> {
    let all = segments(&figure.joints, pose);
    let off = |(marker, seen): (&super::Marker, &Option<Vector3<f64>>)| {
        seen.map(|seen| (all[marker.joint].place(&marker.place_m) - seen).norm())
    };
    figure.markers.iter().zip(markers_m).map(off).collect()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::skeleton::Marker;

    /// A trunk with two arms of two bones, three markers on each segment.
    pub(crate) fn puppet() -> Figure {
        let joint = |parent: Option<usize>, offset: [f64; 3], order| Joint {
            parent,
            offset_m: offset.into(),
            order,
            free: [true; 3],
            limits_rad: [[-PI, PI]; 3],
            rest_sd_rad: [3.0; 3],
        };
        let joints = vec![
            joint(None, [0.0; 3], None),
            joint(Some(0), [0.2, 0.0, 0.4], None),
            joint(Some(1), [0.3, 0.0, 0.0], Some([2, 1, 0])),
            joint(Some(0), [-0.2, 0.0, 0.4], None),
            joint(Some(3), [-0.3, 0.0, 0.0], Some([2, 1, 0])),
        ];
        let places = [[0.05, 0.04, 0.1], [-0.06, 0.05, 0.12], [0.1, -0.05, -0.02]];
        let markers = (0..5)
            .flat_map(|joint| places.map(|place| Marker { joint, place_m: place.into(), sigma_m: 0.001 }))
            .collect();
        Figure { joints, markers }
    }

    pub(crate) fn posed() -> Pose {
        Pose {
            root_m: Vector3::new(1.0, -2.0, 0.9),
            root: Rotation3::new(Vector3::new(0.3, -0.4, 2.0)),
            turns: vec![
                Vector3::zeros(),
                Vector3::new(0.5, 0.8, -0.3),
                Vector3::new(0.2, 0.1, 1.1),
                Vector3::new(-0.4, -0.6, 0.2),
                Vector3::new(0.1, 0.05, -0.7),
            ],
        }
    }

    pub(crate) fn seen(figure: &Figure, pose: &Pose) -> Vec<Option<Vector3<f64>>> {
        let all = segments(&figure.joints, pose);
        figure.markers.iter().map(|m| Some(all[m.joint].place(&m.place_m))).collect()
    }

    fn far(figure: &Figure, a: &Pose, b: &Pose) -> f64 {
        let (a, b) = (segments(&figure.joints, a), segments(&figure.joints, b));
        a.iter().zip(&b).map(|(p, q)| (p.joint_m - q.joint_m).norm()).fold(0.0, f64::max)
    }

    #[test]
    fn the_gradient_is_the_derivative_of_the_cost() {
        let mut figure = puppet();
        figure.joints[2].limits_rad[2] = [-1.0, 0.5];
        let markers = seen(&figure, &posed());
        let pins = [Pin { joint: 4, place_m: Vector3::x() * -0.2, target_m: Vector3::zeros(), sigma_m: 0.5 }];
        let orientations =
            [Orientation { joint: 1, target: Rotation3::new(Vector3::new(0.3, -0.4, 1.9)), sigma_rad: 0.2 }];
        let evidence = Evidence { markers_m: &markers, pins: &pins, orientations: &orientations };
        let mut pose = posed();
        pose.turns[1] += Vector3::new(0.01, -0.02, 0.03);
        pose.root_m.x += 0.01;
        let mut solver = Solver::of(&figure, []);
        // Orientations are differentiated as if the difference were small: compare where it is.
        let all = segments(&figure.joints, &pose);
        let turn = Rotation3::new(Vector3::new(0.004, 0.003, -0.005)) * all[1].turn;
        let orientations = [Orientation { target: turn, ..orientations[0].clone() }];
        let evidence = Evidence { orientations: &orientations, ..evidence };
        solver.assemble(&figure, &pose, evidence, None, 1.0);
        let gradient = solver.normal.g.clone();
        for (c, g) in gradient.iter().enumerate() {
            let step = |size: f64| {
                let step: Vec<f64> = (0..solver.len()).map(|k| if k == c { size } else { 0.0 }).collect();
                let moved = solver.moved(&figure.joints, &pose, &step);
                solver.value(&figure, &moved, evidence, None, 1.0)
            };
            let numeric = (step(1e-6) - step(-1e-6)) / 2e-6;
            assert!((g - numeric).abs() < 2e-3 * (1.0 + numeric.abs()), "column {c}: {g} is not {numeric}");
        }
    }

    #[test]
    fn a_pose_is_found_exactly_without_noise() {
        let figure = puppet();
        let markers = seen(&figure, &posed());
        let evidence = Evidence { markers_m: &markers, ..Evidence::default() };
        let mut start = figure.rest();
        start.root_m = posed().root_m;
        start.root = posed().root * Rotation3::new(Vector3::new(0.2, 0.1, 0.3));
        let solved = Solver::of(&figure, []).solve(&figure, start, evidence, None);
        assert!(far(&figure, &solved.pose, &posed()) < 1e-6, "{}", far(&figure, &solved.pose, &posed()));
    }

    #[test]
    fn two_swapped_markers_hardly_move_the_pose() {
        let figure = puppet();
        let mut markers = seen(&figure, &posed());
        markers.swap(3, 9);
        let evidence = Evidence { markers_m: &markers, ..Evidence::default() };
        let solved = Solver::of(&figure, []).solve(&figure, posed(), evidence, None);
        assert!(far(&figure, &solved.pose, &posed()) < 1e-3);
    }

    #[test]
    fn an_orientation_turns_a_segment_without_markers() {
        let mut figure = puppet();
        figure.markers.retain(|m| m.joint < 3);
        let markers = seen(&figure, &posed());
        let all = segments(&figure.joints, &posed());
        let known: Vec<Orientation> =
            [3, 4].map(|joint| Orientation { joint, target: all[joint].turn, sigma_rad: 0.01 }).into();
        let evidence = Evidence { markers_m: &markers, orientations: &known, ..Evidence::default() };
        let mut start = posed();
        (start.turns[3], start.turns[4]) = (Vector3::zeros(), Vector3::zeros());
        let solved = Solver::of(&figure, [3, 4]).solve(&figure, start, evidence, None);
        assert!(far(&figure, &solved.pose, &posed()) < 1e-4);
    }

    #[test]
    fn what_nothing_is_seen_of_is_less_certain() {
        let figure = puppet();
        let mut markers = seen(&figure, &posed());
        let certain = |markers: &[Option<Vector3<f64>>]| {
            let evidence = Evidence { markers_m: markers, ..Evidence::default() };
            Solver::of(&figure, []).certainty(&figure, &posed(), evidence, None, true).expect("positive")
        };
        let all = certain(&markers);
        markers[6..9].fill(None);
        let fewer = certain(&markers);
        assert!(all.turn_rad2[2].max() < 1e-3 && fewer.turn_rad2[2].min() > 1.0);
        assert!((all.joint_m2[4] - fewer.joint_m2[4]).abs() < 0.5 * all.joint_m2[4]);
    }
}
