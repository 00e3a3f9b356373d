//! Markers found again inside their gaps: where a gap is carried from both ends, its marker is known well enough to take
//! the dots that lie there and that nobody owns, in single frames between which it was merged or hidden. Dots that another
//! hidden marker explains better, however little is known of where that is, are left alone.

use super::super::flow::Motion;
use super::super::frame::Frame;
use super::super::locate::LocateGates;
use super::super::matching::Prior;
use super::super::{Kind, Sample, Shot, Tracked};
use super::extend::found_on_free_dots;
use super::scene_of;
use crate::correspond::scene::Scene;
use nalgebra::Vector3;

/// A carried sample that is known less well is no place to look at (m).
const KNOWN: f64 = 0.03;
/// What is not known of the velocity of a carried marker (m/s).
const SPEED: f64 = 1.0;

/// Measures carried samples where free dots allow it; whether there were any.
pub fn regain(scenes: &[(usize, &Scene)], shots: &[Shot], times_s: &[f64], frames: &mut [Tracked]) -> bool {
    let gates = LocateGates::new(scenes[0].1);
    let mut any = false;
    for index in 0..frames.len() {
        if frames[index].samples.iter().all(|s| !is_known(s)) {
            continue;
        }
        let scene = scene_of(scenes, index);
        let mut frame = Frame::new(scene, &shots[index].dots);
        frame.lag_s.clone_from(&shots[index].lag_s);
        let own = &frames[index].samples;
        own.iter().flat_map(|s| &s.dots).for_each(|&d| frame.free[d as usize] = false);
        // Dots where one lies that is known less well may be that one's.
        let hidden = |s: &Sample| s.kind == Kind::Predicted;
        let priors: Vec<Option<Prior>> =
            own.iter().map(|s| hidden(s).then(|| prior(s, velocity(frames, times_s, index, s.track)))).collect();
        let mut found = found_on_free_dots(scene, &gates, &frame, &priors);
        found.retain(|(k, _)| is_known(&own[*k]));
        for (k, located) in found {
            let sample = &mut frames[index].samples[k];
            if let Some(measured) =
                priors[k].as_ref().and_then(|p| located.sample(&frame, sample.track, p, sample.confidence))
            {
                *sample = measured;
                any = true;
            }
        }
    }
    any
}

fn is_known(sample: &Sample) -> bool {
    sample.kind == Kind::Predicted && sample.covariance.trace().sqrt() < KNOWN
}

/// A carried marker as it is looked for.
pub(super) fn prior(sample: &Sample, velocity: Vector3<f64>) -> Prior {
    Prior {
        point: sample.point,
        covariance: sample.covariance,
        push: 0.0,
        hidden: true,
        hardware: None,
        must_tell: false,
        motion: Motion { velocity, variance: SPEED * SPEED },
    }
}

/// Velocity (m/s) of a trajectory, from the frames beside one.
pub(super) fn velocity(frames: &[Tracked], times_s: &[f64], index: usize, track: u32) -> Vector3<f64> {
    let place = |at: usize| frames[at].samples.iter().find(|s| s.track == track).map(|s| (times_s[at], s.point));
    let beside = [index.saturating_sub(1), (index + 1).min(frames.len() - 1)].map(place);
    match beside {
        [Some((from, a)), Some((to, b))] if to > from => (b - a) / (to - from),
        _ => Vector3::zeros(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::correspond::frame::Dot;
    use crate::reconstruct::{ReconstructOptions, estimate_model};
    use crate::synth::rigs::ring;
    use nalgebra::Matrix3;

    /// Which of some carried markers (how far from the dots and how well known, m) are measured by dots of one place.
    fn measured(carried: &[(f64, f64)]) -> Vec<bool> {
        let rig = ring(4, 3.0, 20.0, 0.0, [1000.0, 1000.0], 1000.0);
        let model = estimate_model(&rig, &[], &ReconstructOptions::default()).expect("the rig sees the stage");
        let scene = Scene::new(&rig, &model);
        let dot = |(camera, own): (usize, &crate::camera::Camera)| {
            let pixel = own.project_linear(&Vector3::zeros()).expect("it is in front").0;
            Dot { camera, pixel: pixel.into(), sigma: 1.0, hardware: None }
        };
        let dots = rig.cameras.iter().enumerate().map(dot).collect();
        let sample = |(track, &(away, sigma)): (usize, &(f64, f64))| {
            let state = (Vector3::new(0.0, 0.0, away), Matrix3::identity() * (sigma * sigma));
            Sample::new(track as u32, state, Kind::Predicted, &[], 0.9)
        };
        let samples = carried.iter().enumerate().map(sample).collect();
        let mut frames = [Tracked { samples, ..Tracked::default() }];
        let any = regain(&[(0, &scene)], &[Shot { dots, lag_s: Vec::new() }], &[0.0], &mut frames);
        let found: Vec<bool> = frames[0].samples.iter().map(|s| s.kind == Kind::Measured).collect();
        assert_eq!(any, found.contains(&true));
        found
    }

    #[test]
    fn a_carried_marker_takes_free_dots_where_it_is_well_known() {
        assert_eq!(measured(&[(0.005, 0.01)]), [true]);
        assert_eq!(measured(&[(0.035, 0.01)]), [true], "it may have gone farther than it seems");
        assert_eq!(measured(&[(0.1, 0.01)]), [false], "it is too far away");
        assert_eq!(measured(&[(0.005, 0.03)]), [false], "it is not known well enough");
    }

    #[test]
    fn dots_that_may_be_another_hidden_ones_are_left_to_it() {
        assert_eq!(measured(&[(0.035, 0.01), (0.0, 0.04)]), [false, false]);
        assert_eq!(measured(&[(0.005, 0.01), (0.06, 0.04)]), [true, false]);
    }
}
