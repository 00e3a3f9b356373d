//! Bones and marker places of one person: adjusted together with the poses of many frames.
//!
//! The poses are eliminated frame by frame with the tree's sparsity (Schur complement), the shared parameters solved
//! for, and the poses solved anew: a bundle adjustment of a body. What motion does not show (a joint that never turned)
//! stays where the prior has it. Each marker's sigma follows from its own residuals.

use super::kinematics::{Segment, segments};
use super::solve::{Evidence, Pin, Solver, residuals, trust, velocity};
use super::take::Seen;
use super::{Figure, Marker, Pose};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use rayon::prelude::*;

const ROUNDS: usize = 4;
const STEPS: usize = 12;
/// A round ends when a step lowers the cost by less than this part.
const ENOUGH: f64 = 1e-4;
/// Least and largest sigma of a marker (m).
const SIGMA: [f64; 2] = [0.0003, 0.05];
/// No marker is this many times better or worse than the typical one: few markers on a segment cannot tell.
const UNLIKE: f64 = 2.0;
/// At least this share of a marker's noise is taken to be left in its residuals.
const LEAST_SHARE: f64 = 0.1;
/// Frames whose equations are held at once.
const BATCH: usize = 16;

/// What is known before the fit; means are the figure's own values.
#[derive(Clone, Debug)]
pub struct Known {
    /// How well each joint's offset is known (m, standard deviation); 0 keeps it.
    pub offset_sd_m: Vec<Vector3<f64>>,
    /// How well each marker's place is known (m, standard deviation).
    pub place_sd_m: Vec<f64>,
    /// Joints of the left and the right whose offsets mirror each other, and how exactly (m).
    pub mirrored: Vec<(usize, usize, f64)>,
}

/// The fitted figure and the poses it was fitted in.
pub struct Fitted {
    /// With its sigmas.
    pub figure: Figure,
    /// One per frame.
    pub poses: Vec<Pose>,
    /// Root mean square of the markers' residuals, outliers left out (m).
    pub residual_m: f64,
}

/// Shared parameters: offsets of the joints that may change, then places of the markers.
struct Shared {
    joints: Vec<usize>,
    column_of: Vec<Option<usize>>,
    markers: usize,
}

impl Shared {
    fn new(figure: &Figure, known: &Known) -> Self {
        let joints: Vec<usize> = (1..figure.joints.len()).filter(|&j| known.offset_sd_m[j].max() > 0.0).collect();
        let mut column_of = vec![None; figure.joints.len()];
        for (i, &j) in joints.iter().enumerate() {
            column_of[j] = Some(3 * i);
        }
        Self { joints, column_of, markers: figure.markers.len() }
    }

    fn len(&self) -> usize {
        3 * (self.joints.len() + self.markers)
    }

    fn of_marker(&self, m: usize) -> usize {
        3 * (self.joints.len() + m)
    }

    fn moved(&self, figure: &Figure, step: &DVector<f64>) -> Figure {
        let mut next = figure.clone();
        for (i, &j) in self.joints.iter().enumerate() {
            next.joints[j].offset_m += step.fixed_rows::<3>(3 * i);
        }
        for m in 0..self.markers {
            next.markers[m].place_m += step.fixed_rows::<3>(self.of_marker(m));
        }
        next
    }
}

/// Fit a figure to frames, starting from poses.
pub fn fit(start: &Figure, frames: &[Seen], poses: Vec<Pose>, known: &Known) -> Fitted {
    let shared = Shared::new(start, known);
    let mut figure = start.clone();
    let mut poses = poses;
    for _ in 0..ROUNDS {
        let mut damping = 1e-6;
        let (found, at) = solve_all(&figure, frames, &poses);
        let mut cost = at + prior_cost(&shared, start, &figure, known);
        poses = found;
        let mut rejected = 0;
        for _ in 0..STEPS {
            let Some(step) = shared_step(&shared, start, &figure, frames, &poses, known, damping) else { break };
            let tried = shared.moved(&figure, &step);
            let (found, at) = solve_all(&tried, frames, &poses);
            let total = at + prior_cost(&shared, start, &tried, known);
            let gained = cost - total;
            if gained > 0.0 {
                (figure, poses, cost) = (tried, found, total);
                damping *= 0.1;
                rejected = 0;
            } else {
                damping = 100.0 * damping.max(1e-6);
                rejected += 1;
            }
            if rejected > 2 || (gained > 0.0 && gained < ENOUGH * cost) {
                break;
            }
        }
        update_sigmas(&mut figure, frames, &poses);
    }
    let residual_m = rms(&figure, frames, &poses);
    Fitted { figure, poses, residual_m }
}

fn evidence(seen: &Seen) -> Evidence<'_> {
    Evidence { markers_m: &seen.markers_m, pins: &seen.pins, orientations: &seen.orientations }
}

fn solver_of(figure: &Figure, frames: &[Seen]) -> Solver {
    let told = frames.iter().flat_map(|f| f.orientations.iter().map(|o| o.joint).chain(f.pins.iter().map(|p| p.joint)));
    Solver::of(figure, told)
}

fn solve_all(figure: &Figure, frames: &[Seen], poses: &[Pose]) -> (Vec<Pose>, f64) {
    let solver = solver_of(figure, frames);
    let solve = |(seen, pose): (&Seen, &Pose)| solver.clone().solve(figure, pose.clone(), evidence(seen), None);
    let solved: Vec<_> = frames.par_iter().zip(poses.par_iter()).map(solve).collect();
    let cost = solved.iter().map(|s| s.cost).sum();
    (solved.into_iter().map(|s| s.pose).collect(), cost)
}

/// Something known of shared parameters: columns with signs, how far the figure is from it, and how well it is known.
struct Fact {
    columns: Vec<(usize, f64)>,
    off: f64,
    sd: f64,
}

/// How far a figure is from what is known.
fn knowledge(shared: &Shared, start: &Figure, figure: &Figure, known: &Known) -> Vec<Fact> {
    let mut rows = Vec::new();
    for (i, &j) in shared.joints.iter().enumerate() {
        let off = figure.joints[j].offset_m - start.joints[j].offset_m;
        for k in 0..3 {
            rows.push(Fact { columns: vec![(3 * i + k, 1.0)], off: off[k], sd: known.offset_sd_m[j][k] });
        }
    }
    for m in 0..shared.markers {
        let off = figure.markers[m].place_m - start.markers[m].place_m;
        for k in 0..3 {
            rows.push(Fact { columns: vec![(shared.of_marker(m) + k, 1.0)], off: off[k], sd: known.place_sd_m[m] });
        }
    }
    for &(left, right, sd) in &known.mirrored {
        let (Some(l), Some(r)) = (shared.column_of[left], shared.column_of[right]) else { continue };
        let (a, b) = (figure.joints[left].offset_m, figure.joints[right].offset_m);
        for k in 0..3 {
            let sign = if k == 0 { 1.0 } else { -1.0 };
            rows.push(Fact { columns: vec![(l + k, 1.0), (r + k, sign)], off: a[k] + sign * b[k], sd });
        }
    }
    rows
}

fn prior_cost(shared: &Shared, start: &Figure, figure: &Figure, known: &Known) -> f64 {
    knowledge(shared, start, figure, known).iter().map(|fact| 0.5 * (fact.off / fact.sd).powi(2)).sum()
}

/// The best change of the shared parameters with the poses following.
fn shared_step(
    shared: &Shared,
    start: &Figure,
    figure: &Figure,
    frames: &[Seen],
    poses: &[Pose],
    known: &Known,
    damping: f64,
) -> Option<DVector<f64>> {
    let n = shared.len();
    let (mut h, mut g) = (DMatrix::zeros(n, n), DVector::zeros(n));
    let solver = solver_of(figure, frames);
    for (seen, pose) in frames.chunks(BATCH).zip(poses.chunks(BATCH)) {
        let reduced: Vec<_> = seen
            .par_iter()
            .zip(pose.par_iter())
            .map(|(seen, pose)| reduced(shared, figure, solver.clone(), seen, pose))
            .collect();
        for (own, gradient) in reduced.into_iter().flatten() {
            h += own;
            g += gradient;
        }
    }
    for Fact { columns, off, sd } in knowledge(shared, start, figure, known) {
        let weight = 1.0 / (sd * sd);
        for &(a, x) in &columns {
            g[a] += weight * x * off;
            for &(b, y) in &columns {
                h[(a, b)] += weight * x * y;
            }
        }
    }
    for k in 0..n {
        h[(k, k)] *= 1.0 + damping;
    }
    h.cholesky().map(|factor| -factor.solve(&g))
}

/// What one frame says of the shared parameters once its pose is eliminated.
fn reduced(
    shared: &Shared,
    figure: &Figure,
    mut solver: Solver,
    seen: &Seen,
    pose: &Pose,
) -> Option<(DMatrix<f64>, DVector<f64>)> {
    solver.assemble(figure, pose, evidence(seen), None, 1.0);
    let all = segments(&figure.joints, pose);
    let twists = solver.twists(&figure.joints, pose, &all);
    let (n, poses) = (shared.len(), solver.columns.len());
    let last = solver.last_columns(&figure.joints);
    let (mut h, mut g, mut mixed) = (DMatrix::zeros(n, n), DVector::zeros(n), DMatrix::zeros(poses, n));
    let mut own: Vec<(usize, Matrix3<f64>)> = Vec::new();
    for place in places(shared, figure, seen, &all) {
        own.clear();
        own.extend(place.column.map(|column| (column, *all[place.joint].turn.matrix())));
        let mut at = place.joint;
        while let Some(p) = figure.joints[at].parent {
            own.extend(shared.column_of[at].map(|column| (column, *all[p].turn.matrix())));
            at = p;
        }
        for (a, turn_a) in &own {
            let pull = turn_a.transpose() * place.off * place.weight;
            let mut rows = g.fixed_rows_mut::<3>(*a);
            rows += pull;
            for (b, turn_b) in &own {
                let mut block = h.fixed_view_mut::<3, 3>(*a, *b);
                block += turn_a.transpose() * turn_b * place.weight;
            }
        }
        let relative = place.x - pose.root_m;
        let lowest = last[place.joint];
        for &c in std::iter::once(&lowest).chain(solver.normal.way(lowest)) {
            let moves = velocity(&twists[c], &relative);
            for (a, turn) in &own {
                let part = moves.transpose() * turn * place.weight;
                for k in 0..3 {
                    mixed[(c, a + k)] += part[k];
                }
            }
        }
    }
    let factor = solver.normal.factor(0.0)?;
    for mut column in mixed.column_iter_mut() {
        factor.half(column.as_mut_slice());
    }
    let mut gradient = DVector::from_column_slice(&solver.normal.g);
    factor.half(gradient.as_mut_slice());
    let across = mixed.transpose();
    h -= &across * &mixed;
    g -= across * gradient;
    Some((h, g))
}

/// A place on a segment that should be somewhere: where it is, how far off, and the column of its place, where it has one.
struct Placed {
    joint: usize,
    column: Option<usize>,
    x: Vector3<f64>,
    off: Vector3<f64>,
    weight: f64,
}

/// Markers that are seen, and pins.
fn places(shared: &Shared, figure: &Figure, seen: &Seen, all: &[Segment]) -> Vec<Placed> {
    let marker = |(m, marker): (usize, &Marker)| {
        let x = all[marker.joint].place(&marker.place_m);
        let off = x - seen.markers_m.get(m)?.as_ref()?;
        let information = 1.0 / (marker.sigma_m * marker.sigma_m);
        let weight = trust(off.norm_squared() * information, 1.0) * information;
        Some(Placed { joint: marker.joint, column: Some(shared.of_marker(m)), x, off, weight })
    };
    let pin = |pin: &Pin| {
        let x = all[pin.joint].place(&pin.place_m);
        Placed { joint: pin.joint, column: None, x, off: x - pin.target_m, weight: 1.0 / (pin.sigma_m * pin.sigma_m) }
    };
    figure.markers.iter().enumerate().filter_map(marker).chain(seen.pins.iter().map(pin)).collect()
}

/// Each marker's sigma from its residuals, which are smaller than its noise by what went into the poses (its leverage).
/// Without that a marker that decides over a joint would seem ever more exact.
fn update_sigmas(figure: &mut Figure, frames: &[Seen], poses: &[Pose]) {
    let solver = solver_of(figure, frames);
    let own = |(seen, pose): (&Seen, &Pose)| {
        let leverage = solver.clone().leverage(figure, pose, evidence(seen));
        (residuals(figure, pose, &seen.markers_m), leverage.unwrap_or_default())
    };
    let all: Vec<_> = frames.par_iter().zip(poses.par_iter()).map(own).collect();
    let own_sigma = |m: usize| {
        let of = |(off, leverage): &(Vec<Option<f64>>, Vec<Option<f64>>)| {
            Some((off.get(m).copied().flatten()?, leverage.get(m).copied().flatten()?))
        };
        let seen: Vec<(f64, f64)> = all.iter().filter_map(of).collect();
        if seen.len() < 4 {
            return None;
        }
        // The scale of Student's t, by the same weights as in the solver (iterated over the rounds).
        let information = 1.0 / (figure.markers[m].sigma_m * figure.markers[m].sigma_m);
        let (mut sum, mut weights, mut left) = (0.0, 0.0, 0.0);
        for (off, leverage) in &seen {
            let weight = trust(off * off * information, 1.0);
            sum += weight * off * off;
            weights += 1.0;
            left += 1.0 - leverage;
        }
        let share = (left / weights).max(LEAST_SHARE);
        Some((sum / (3.0 * weights * share)).sqrt())
    };
    let sigmas: Vec<Option<f64>> = (0..figure.markers.len()).map(own_sigma).collect();
    let mut known: Vec<f64> = sigmas.iter().flatten().copied().collect();
    if known.is_empty() {
        return;
    }
    known.sort_unstable_by(f64::total_cmp);
    let typical = known[known.len() / 2];
    for (marker, sigma) in figure.markers.iter_mut().zip(sigmas) {
        let sigma = sigma.unwrap_or(typical).clamp(typical / UNLIKE, typical * UNLIKE);
        marker.sigma_m = sigma.clamp(SIGMA[0], SIGMA[1]);
    }
}

fn rms(figure: &Figure, frames: &[Seen], poses: &[Pose]) -> f64 {
    let (mut sum, mut count) = (0.0, 0usize);
    for (seen, pose) in frames.iter().zip(poses) {
        for (off, marker) in residuals(figure, pose, &seen.markers_m).into_iter().zip(&figure.markers) {
            if let Some(off) = off.filter(|o| *o < 8.0 * marker.sigma_m) {
                sum += off * off;
                count += 1;
            }
        }
    }
    (sum / count.max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::super::solve::tests::{posed, puppet, seen};
    use super::*;

    #[test]
    fn bones_and_places_are_found_from_motion() {
        let truth = puppet();
        let pose = |t: usize| {
            let mut pose = posed();
            for (j, turn) in pose.turns.iter_mut().enumerate().skip(1) {
                let phase = t as f64 * (0.3 + 0.11 * j as f64);
                *turn += Vector3::new(phase.sin(), (1.7 * phase).cos(), (0.6 * phase).sin()) * 0.6;
            }
            pose
        };
        let poses: Vec<Pose> = (0..60).map(pose).collect();
        let frames: Vec<Seen> = poses.iter().map(|p| Seen { markers_m: seen(&truth, p), ..Seen::default() }).collect();
        let mut start = truth.clone();
        start.joints[2].offset_m += Vector3::new(0.02, -0.015, 0.01);
        start.joints[3].offset_m += Vector3::new(-0.01, 0.02, 0.01);
        for marker in &mut start.markers {
            marker.sigma_m = 0.02;
        }
        let known = Known {
            offset_sd_m: vec![Vector3::repeat(0.05); 5],
            place_sd_m: vec![0.05; truth.markers.len()],
            mirrored: Vec::new(),
        };
        let fitted = fit(&start, &frames, poses, &known);
        assert!(fitted.residual_m < 2e-4, "{}", fitted.residual_m);
        for (found, true_joint) in fitted.figure.joints.iter().zip(&truth.joints).skip(1) {
            assert!((found.offset_m.norm() - true_joint.offset_m.norm()).abs() < 2e-3);
        }
    }
}
