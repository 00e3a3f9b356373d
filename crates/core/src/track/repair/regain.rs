//! Markers found again inside their gaps: where a gap is carried from both ends, its marker is known well enough to take
//! the dots that lie there and that nobody owns, in single frames between which it was merged or hidden.

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
        let priors: Vec<Option<Prior>> =
            own.iter().map(|s| is_known(s).then(|| prior(s, velocity(frames, times_s, index, s.track)))).collect();
        let found = found_on_free_dots(scene, &gates, &frame, &priors);
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

fn prior(sample: &Sample, velocity: Vector3<f64>) -> Prior {
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
