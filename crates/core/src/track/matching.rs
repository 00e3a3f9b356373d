//! Which dots confirm which markers: in each camera one assignment on the likelihood of the innovations (Lee et al.
//! 2000, §3, equations 7–8; the assignment after Bar-Shalom & Li 1995, "Multitarget-Multisensor Tracking", §6).
//!
//! A marker's prediction is projected into a camera; a dot at z with innovation ν has the likelihood of a mixture: the
//! filter's own spread S and, rarely, a much wider one, because limbs are pushed and stopped (the prediction error's
//! 99.9 % quantile is 15–80 times its median). What it must beat: that the dot belongs to nothing known, and that the
//! camera missed the marker.

use super::flow::Motion;
use super::frame::Frame;
use super::innovation::{GATE, LN_NOT_PUSHED, LN_PUSHED, ln_innovations};
use super::pairs::{Edge, best_pairs};
use super::strips::Free;
use super::threads;
use super::views::{Asked, Views};
use crate::correspond::scene::Scene;
use nalgebra::{Matrix2, Matrix3, Vector3};

/// Where a marker is expected.
#[derive(Clone, Copy, Debug)]
pub struct Prior {
    /// Expected position (m).
    pub point: Vector3<f64>,
    /// Its covariance (m²).
    pub covariance: Matrix3<f64>,
    /// Variance that a sudden push adds on each axis (m²).
    pub push: f64,
    /// Whether the marker was hidden in the frame before: then it is likely to be hidden still.
    pub hidden: bool,
    /// The identity that it told, if it is an active marker.
    pub hardware: Option<u32>,
    /// Whether only dots that tell this identity are taken for it: hidden for long, its place says too little.
    pub must_tell: bool,
    /// How it moves: for cameras that saw it at another moment.
    pub motion: Motion,
}

impl Prior {
    /// The covariance when there was a push.
    pub fn wide(&self) -> Matrix3<f64> {
        self.covariance + Matrix3::identity() * self.push
    }

    /// Where it is some time later (s).
    pub fn after(&self, lag_s: f64) -> Vector3<f64> {
        self.point + self.motion.velocity * lag_s
    }

    /// The covariance some time later (m²).
    pub fn covariance_after(&self, lag_s: f64) -> Matrix3<f64> {
        self.covariance + Matrix3::identity() * (self.motion.variance * lag_s * lag_s)
    }

    /// What it costs to believe that it is seen (nats), beyond what it costs of a marker that was seen just now.
    pub fn ln_rarity(&self) -> f64 {
        if self.hidden { LN_REAPPEARS } else { 0.0 }
    }

    /// Logarithm of the likelihood (m⁻³) of a position measured with a noise (m²) at an offset: the larger component of
    /// calm and pushed; `None` outside the gate (squared innovation) or where a covariance is singular.
    pub fn ln_likelihood(&self, noise: &Matrix3<f64>, offset: &Vector3<f64>, gate: f64) -> Option<f64> {
        let ln = |weight: f64, spread: Matrix3<f64>| {
            let squared = offset.dot(&(spread.try_inverse()? * offset));
            let density = -0.5 * (squared + spread.determinant().ln()) - 1.5 * std::f64::consts::TAU.ln();
            Some((squared, weight + density))
        };
        let (squared, pushed) = ln(LN_PUSHED, self.wide() + noise)?;
        let (_, calm) = ln(LN_NOT_PUSHED, self.covariance + noise)?;
        (squared < gate).then_some(calm.max(pushed))
    }
}

/// How rarely a hidden marker comes back in a given frame.
const LN_REAPPEARS: f64 = -4.0;
/// What a dot that tells a marker's identity has for it (nats).
const LN_TOLD: f64 = 8.0;

/// Squared innovation of a dot (standard deviations) with room for a push; `None` outside the gate.
pub fn innovation(scene: &Scene, frame: &Frame, dot: u32, prior: &Prior) -> Option<f64> {
    let sight = frame.sight(dot);
    let lag_s = frame.lag_s(sight.camera);
    let (pixel, by_point) = scene.rig.cameras[sight.camera].project_linear(&prior.after(lag_s))?;
    let spread = prior.covariance_after(lag_s) + Matrix3::identity() * prior.push;
    let seen = by_point * spread * by_point.transpose() + Matrix2::identity() * sight.sigma_px.powi(2);
    let offset = frame.pixel(dot) - pixel;
    let squared = offset.dot(&(seen.try_inverse()? * offset));
    (squared <= GATE).then_some(squared)
}

/// Matches free dots to the markers expected at `priors`, camera by camera, of those that are `wanted` there (camera, index
/// of the prior). By prior, its dots in order of the cameras; large rigs are shared out among threads.
pub fn match_cameras(
    scene: &Scene,
    frame: &Frame,
    priors: &[Option<Prior>],
    wanted: impl Fn(usize, usize) -> bool + Sync,
) -> Vec<Vec<u32>> {
    let cameras = scene.rig.cameras.len();
    let asked = Asked::of(priors);
    if asked.index.is_empty() {
        return vec![Vec::new(); priors.len()];
    }
    let known = Known::of(&asked);
    let one = |camera: usize| match_camera(scene, frame, camera, &asked, &known, |who| wanted(camera, who));
    let parts = threads::map((0..cameras).collect(), cameras * asked.index.len(), one);
    let mut found = vec![Vec::new(); priors.len()];
    for (who, dot) in parts.into_iter().flatten() {
        let own: &mut Vec<u32> = &mut found[who];
        if own.is_empty() {
            own.reserve(cameras);
        }
        own.push(dot);
    }
    found
}

/// Matches free dots of one camera to the markers asked for that are `wanted`. Pairs (index among all, dot).
fn match_camera(
    scene: &Scene,
    frame: &Frame,
    camera: usize,
    asked: &Asked,
    known: &Known,
    wanted: impl Fn(usize) -> bool,
) -> Vec<(usize, u32)> {
    let free = Free::of(frame, camera);
    if free.dots.is_empty() {
        return Vec::new();
    }
    let seen_by = (&scene.rig.cameras[camera], frame.widest_sigma_px[camera]);
    let views = Views::of(seen_by, frame.lag_s(camera), asked, |k| wanted(asked.index[k]));
    let detection = scene.model.detection;
    let base = (detection / (1.0 - detection)).ln();
    let near = free.near(&views);
    let ln = ln_innovations(&views, &free, &near);
    let gain = |(&(number, at), ln): (&(u32, u32), f64)| {
        let who = views.who[number as usize];
        let dot = &free.dots[at as usize];
        let gain = base + known.gain(asked.priors[who as usize], dot.hardware)? + ln - dot.ln_alone;
        (gain > 0.0).then_some(Edge { who, dot: at, gain })
    };
    let mut edges = Vec::with_capacity(near.len());
    edges.extend(near.iter().zip(ln).filter_map(gain));
    let pairs = best_pairs(edges).into_iter();
    pairs.map(|(who, at)| (asked.index[who as usize], free.dots[at as usize].dot)).collect()
}

/// Identities that markers are known to have told, in ascending order.
struct Known {
    told: Vec<u32>,
    /// Whether there are none, and none need be told.
    silent: bool,
}

impl Known {
    fn of(asked: &Asked) -> Self {
        let mut told: Vec<u32> = asked.priors.iter().filter_map(|p| p.hardware).collect();
        told.sort_unstable();
        let silent = told.is_empty() && asked.priors.iter().all(|p| !p.must_tell);
        Self { told, silent }
    }

    /// What a dot's identity says for a marker's (nats): `None` if it is another's.
    fn gain(&self, marker: &Prior, dot: Option<u32>) -> Option<f64> {
        if self.silent {
            return Some(0.0);
        }
        match (marker.hardware, dot) {
            (_, None) => (!marker.must_tell).then_some(0.0),
            (Some(marker), Some(dot)) => (marker == dot).then_some(LN_TOLD),
            (None, Some(dot)) => self.told.binary_search(&dot).is_err().then_some(0.0),
        }
    }
}
