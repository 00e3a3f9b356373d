//! Places held in a take that is solved already: what a frame knew of its pose stays, and the pins join it.
//!
//! Solved anew, a take would also drift on along what its markers hardly tell. Here each frame expects its own pose, as
//! firmly as its neighbours told it, displaced so that everything it knew is in balance there: without pins nothing
//! moves, and with them only what they move.

use super::solve::{Pin, Prior, Solver, spread};
use super::take::{Frame, Seen, joints_of, neighbours};
use super::{Figure, Pose};
use nalgebra::{Rotation3, Vector3};

/// The frames in which something is held, with the pins of `holds`; `None` for all others. `poses`: of the take under
/// `frames`, as `solve_take` found them.
pub fn hold(figure: &Figure, step_s: f64, frames: &[Seen], poses: &[Pose], holds: &[Vec<Pin>]) -> Vec<Option<Frame>> {
    let joints = joints_of(frames).into_iter().chain(holds.iter().flatten().map(|p| p.joint));
    let mut solver = Solver::of(figure, joints);
    let certain: Vec<_> =
        frames.iter().zip(poses).map(|(f, p)| solver.certainty(figure, p, f.evidence(), None, false)).collect();
    let priors = neighbours(figure, step_s, poses, &certain);
    let mut one = |((seen, pose), (firm, pins)): ((&Seen, &Pose), (Prior, &Vec<Pin>))| {
        if pins.is_empty() {
            return None;
        }
        let prior = balanced(&mut solver, figure, seen, pose, firm);
        let mut held = seen.clone();
        held.pins.extend(pins.iter().cloned());
        let solved = solver.solve(figure, pose.clone(), held.evidence(), Some(&prior));
        let certainty = solver.certainty(figure, &solved.pose, held.evidence(), Some(&prior), true);
        Some(Frame { pose: solved.pose, certainty })
    };
    frames.iter().zip(poses).zip(priors.into_iter().zip(holds)).map(&mut one).collect()
}

/// An expectation as firm as `firm` under which the pose is the best one: displaced against the pull of the evidence.
fn balanced(solver: &mut Solver, figure: &Figure, seen: &Seen, pose: &Pose, firm: Prior) -> Prior {
    let scale = spread(figure, pose, seen.evidence()).max(1.0);
    solver.assemble(figure, pose, seen.evidence(), None, scale);
    let mut prior = Prior { pose: pose.clone(), ..firm };
    let mut turned = Vector3::zeros();
    for (column, pull) in solver.columns.iter().zip(&solver.normal.g) {
        let (j, k) = (column.joint, column.component);
        let displaced = |sd: f64| if sd.is_finite() { sd * sd * pull } else { 0.0 };
        match (j, k) {
            (0, 0..3) => prior.pose.root_m[k] += displaced(prior.root_sd_m[k]),
            (0, _) => turned[k - 3] = displaced(prior.root_sd_rad),
            _ => {
                // What neither markers nor neighbours tell would go back to rest.
                let sd = prior.turn_sd_rad[j][k].min(figure.joints[j].rest_sd_rad[k]);
                prior.turn_sd_rad[j][k] = sd;
                prior.pose.turns[j][k] += displaced(sd);
            }
        }
    }
    prior.pose.root = Rotation3::new(turned) * pose.root;
    prior
}

#[cfg(test)]
mod tests {
    use super::super::kinematics::segments;
    use super::super::solve::tests::{posed, puppet, seen};
    use super::super::take::solve_take;
    use super::*;

    /// A take of one pose, seen with a little error, and its poses.
    fn take(figure: &Figure) -> (Vec<Seen>, Vec<Pose>) {
        let shaken = |f: usize| {
            let shake =
                |(i, m): (usize, Option<Vector3<f64>>)| m.map(|m| m.add_scalar(1e-3 * ((7 * i + f) as f64).sin()));
            seen(figure, &posed()).into_iter().enumerate().map(shake).collect()
        };
        let frames: Vec<Seen> = (0..40).map(|f| Seen { markers_m: shaken(f), ..Seen::default() }).collect();
        let poses = solve_take(figure, 0.01, &frames).into_iter().map(|f| f.pose).collect();
        (frames, poses)
    }

    fn pin(figure: &Figure, pose: &Pose, off_m: f64, sigma_m: f64) -> Pin {
        let place_m = Vector3::new(-0.2, 0.0, 0.0);
        let at = segments(&figure.joints, pose)[4].place(&place_m);
        Pin { joint: 4, place_m, target_m: at + Vector3::new(0.0, 0.0, off_m), sigma_m }
    }

    fn farthest(figure: &Figure, one: &Pose, other: &Pose) -> f64 {
        let (one, other) = (segments(&figure.joints, one), segments(&figure.joints, other));
        one.iter().zip(&other).map(|(a, b)| (a.joint_m - b.joint_m).norm()).fold(0.0, f64::max)
    }

    #[test]
    fn a_pin_where_the_place_is_moves_nothing() {
        let figure = puppet();
        let (frames, poses) = take(&figure);
        let mut holds = vec![Vec::new(); frames.len()];
        holds[20].push(pin(&figure, &poses[20], 0.0, 1e-4));
        let held = hold(&figure, 0.01, &frames, &poses, &holds);
        assert!(held.iter().enumerate().all(|(f, frame)| frame.is_some() == (f == 20)));
        let frame = held[20].as_ref().expect("held");
        assert!(farthest(&figure, &frame.pose, &poses[20]) < 1e-6);
        assert!(frame.certainty.is_some());
    }

    #[test]
    fn a_place_goes_to_its_pin_as_firmly_as_it_is_held() {
        let figure = puppet();
        let (frames, poses) = take(&figure);
        for (sigma_m, left_m) in [(1e-4, 0.0..1e-3), (1.0, 9e-3..1.1e-2)] {
            let mut holds = vec![Vec::new(); frames.len()];
            holds[20].push(pin(&figure, &poses[20], 0.01, sigma_m));
            let held = hold(&figure, 0.01, &frames, &poses, &holds);
            let all = segments(&figure.joints, &held[20].as_ref().expect("held").pose);
            let off_m = (all[4].place(&holds[20][0].place_m) - holds[20][0].target_m).norm();
            assert!(left_m.contains(&off_m), "{off_m}");
        }
    }
}
