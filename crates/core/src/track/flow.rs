//! How dots move in the image, for cameras whose clocks tick apart.
//!
//! Where cameras of one frame saw it at different moments, rays of a moving marker do not meet. A marker that is followed
//! brings its velocity: its rays are moved by it (`Frame::ray`), and no dot is. Dots of nobody have no velocity yet: to
//! tell which of them belong together they are compared as of the frame's moment, by their own motion since the last
//! frame; the velocity of what is born there comes from the same motion, and its place from its dots as they are.

use super::frame::Frame;
use crate::camera::Rig;
use crate::correspond::frame::Dot;
use crate::strands::{LARGEST_STEP, clearly_nearest};
use nalgebra::{Matrix3, Vector2, Vector3};

/// A speed of which nothing is known (m/s, standard deviation per axis).
const ANY_SPEED: f64 = 1.5;

/// A velocity, for moving rays from one moment to another.
#[derive(Clone, Copy, Debug)]
pub struct Motion {
    /// Velocity (m/s).
    pub velocity: Vector3<f64>,
    /// Its variance per axis (m²/s²).
    pub variance: f64,
}

impl Motion {
    /// Nothing is known.
    pub fn unknown() -> Self {
        Self { velocity: Vector3::zeros(), variance: ANY_SPEED * ANY_SPEED }
    }
}

/// What the cameras gave in one frame.
#[derive(Clone, Debug, Default)]
pub struct Shot {
    /// The dots.
    pub dots: Vec<Dot>,
    /// By camera, how much later than the frame's moment its image was taken (s); empty if all saw one moment.
    pub lag_s: Vec<f64>,
}

/// The dots of the frame before, by camera.
#[derive(Clone, Debug, Default)]
pub struct Flow {
    before: Vec<(f64, Vec<Vector2<f64>>)>,
}

impl Flow {
    /// Takes in a frame; velocity (px/s) of each dot since the last one, where it is clear which dot it was. `times_s` by
    /// camera.
    pub fn take_in(&mut self, rig: &Rig, dots: &[Dot], times_s: &[f64]) -> Vec<Option<Vector2<f64>>> {
        let mut found = vec![None; dots.len()];
        self.before.resize(rig.cameras.len(), (f64::NAN, Vec::new()));
        for (camera, (before_s, before)) in self.before.iter_mut().enumerate() {
            let own: Vec<usize> = (0..dots.len()).filter(|&d| dots[d].camera == camera).collect();
            let now: Vec<Vector2<f64>> = own.iter().map(|&d| Vector2::from(dots[d].pixel)).collect();
            let dt_s = times_s[camera] - *before_s;
            if dt_s > 0.0 {
                let largest = LARGEST_STEP * rig.cameras[camera].size_px[0];
                for (k, place) in now.iter().enumerate() {
                    let nearest = clearly_nearest(place, before, largest);
                    if let Some(j) = nearest.filter(|&j| clearly_nearest(&before[j], &now, largest) == Some(k)) {
                        found[own[k]] = Some((place - before[j]) / dt_s);
                    }
                }
            }
            (*before_s, *before) = (times_s[camera], now);
        }
        found
    }
}

/// Dots as they were at the frame's moment, `lag_s` (by camera) before they were seen; with the noise that this adds.
/// `None` where a dot's motion is not known. `interval_s`: between frames.
pub fn at_moment(dot: &Dot, flow: Option<Vector2<f64>>, lag_s: f64, interval_s: f64) -> Option<Dot> {
    if lag_s == 0.0 {
        return Some(*dot);
    }
    let pixel = Vector2::from(dot.pixel) - flow? * lag_s;
    let part = lag_s / interval_s;
    let noisier = ((1.0 - part).powi(2) + part * part).sqrt();
    Some(Dot { pixel: pixel.into(), sigma: dot.sigma * noisier, ..*dot })
}

/// The dots of all frames of a take as of the frames' moments (`times_s`), for estimates from single frames.
pub fn at_moments(rig: &Rig, shots: &[Shot], times_s: &[f64], interval_s: f64) -> Vec<Vec<Dot>> {
    let mut flow = Flow::default();
    let one = |(shot, time_s): (&Shot, &f64)| {
        let own_s: Vec<f64> = shot.lag_s.iter().map(|lag| time_s + lag).collect();
        let moved = flow.take_in(rig, &shot.dots, &own_s);
        let dots = shot.dots.iter().zip(moved);
        dots.filter_map(|(dot, flow)| at_moment(dot, flow, shot.lag_s[dot.camera], interval_s)).collect()
    };
    shots.iter().zip(times_s).map(one).collect()
}

/// Velocity of a point whose dots move in several images, by least squares.
pub fn motion_of(rig: &Rig, frame: &Frame, dots: &[u32], point: &Vector3<f64>, interval_s: f64) -> Motion {
    let (mut normal, mut right, mut noise) = (Matrix3::zeros(), Vector3::zeros(), 0.0);
    let mut views = 0;
    for &dot in dots {
        let one = &frame.dots[dot as usize];
        let Some(flow) = frame.flow.get(dot as usize).copied().flatten() else { continue };
        let Some((_, by_point)) = rig.cameras[one.camera].project_linear(point) else { continue };
        normal += by_point.transpose() * by_point;
        right += by_point.transpose() * flow;
        noise += 2.0 * (frame.sigma_px(dot) / interval_s).powi(2);
        views += 1;
    }
    let Some(inverse) = normal.try_inverse().filter(|_| views >= 2) else { return Motion::unknown() };
    Motion { velocity: inverse * right, variance: inverse.trace() / 3.0 * noise / f64::from(views) }
}
