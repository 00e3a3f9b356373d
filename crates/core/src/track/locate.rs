//! The multi-view check: a marker's dots, its prediction, and one position that must explain them together.
//!
//! The position minimises whitened reprojection error plus distance to the prediction (with room for a push); its
//! cost is χ² with two degrees of freedom per view. A set that does not pass loses, view by view, the dot without which
//! the rest fits best, so each camera is judged by what the others say (leave-one-out gating).

use super::flow::Motion;
use super::frame::Frame;
use super::matching::Prior;
use super::{Kind, Sample};
use crate::chi2;
use crate::correspond::scene::Scene;
use crate::sight::{Minimum, Normal, Sight};
use nalgebra::{Matrix3, Vector3};
use std::borrow::Cow;

/// Probability with which correct views fail the check.
const MISS_PROBABILITY: f64 = 1e-5;
/// A step this small needs no new linearisation (m).
const SMALL_STEP: f64 = 1e-3;

/// A position found from dots and a prediction.
#[derive(Clone, Debug)]
pub struct Located {
    /// Dots that agree, in ascending order.
    pub dots: Vec<u32>,
    /// Rays that meet there, lent ones counted.
    pub rays: usize,
    /// Rays of dots that are the marker's own.
    pub own: usize,
    /// The position, the prediction counted with room for a push (m).
    pub point: Vector3<f64>,
    /// Information M of the rays alone at that position (m⁻²).
    pub information: Matrix3<f64>,
    /// M (z − point), where z is what the rays alone say.
    pub pull: Vector3<f64>,
}

impl Located {
    /// A position with what the rays say there, of a marker that moves so.
    pub fn at(scene: &Scene, frame: &Frame, dots: Vec<u32>, point: Vector3<f64>, motion: &Motion) -> Self {
        let mut normal = Normal::default();
        for &dot in &dots {
            let linear = frame.ray(dot, motion, &point).linearise(&point);
            let weight = scene.model.tail.map_or(1.0, |t| t.weight(linear.error.norm_squared()));
            normal = normal.plus(&Normal::of(&linear, weight));
        }
        let own = dots.iter().filter(|&&d| !frame.is_lent(d)).count();
        Self { rays: dots.len(), own, dots, point, information: normal.information(), pull: -normal.gradient() }
    }

    /// A position that another system has measured; it counts as seen well. `None` if the covariance is singular.
    pub fn measured(index: u32, point: Vector3<f64>, covariance: &Matrix3<f64>) -> Option<Self> {
        let information = covariance.try_inverse()?;
        Some(Self { dots: vec![index], rays: 3, own: 3, point, information, pull: Vector3::zeros() })
    }

    /// The sample that it makes together with a prediction.
    pub fn sample(&self, frame: &Frame, track: u32, prior: &Prior, confidence: f64) -> Option<Sample> {
        let pull = self.pull_from(&prior.point);
        let (point, covariance) = posterior(&prior.point, &prior.wide(), &self.information, &pull)?;
        let kind = if self.own >= 2 { Kind::Measured } else { Kind::Predicted };
        let sample = Sample::new(track, (point, covariance), kind, &self.dots, confidence);
        Some(Sample { velocity: prior.motion.velocity, ..sample }.with_rays(frame))
    }

    /// M (z − from).
    pub fn pull_from(&self, from: &Vector3<f64>) -> Vector3<f64> {
        self.pull + self.information * (self.point - from)
    }
}

/// Gates by number of views.
pub struct LocateGates(Vec<f64>);

impl LocateGates {
    /// Gates for up to as many views as the scene has cameras.
    pub fn new(scene: &Scene) -> Self {
        let extra = scene.model.tail.map_or(0.0, |t| t.cost(1e9) - 1e9 / (t.scale * t.scale));
        let gate = |n: usize| chi2::quantile(MISS_PROBABILITY, 2.0 * n.max(1) as f64) + extra * (n / 3) as f64;
        Self((0..=scene.rig.cameras.len()).map(gate).collect())
    }
}

/// The position that the dots agree on; `None` if not even one fits the prediction. Where they fall apart, those near
/// the prediction come first if two of them meet: more dots farther away are another marker's.
pub fn locate(scene: &Scene, gates: &LocateGates, frame: &Frame, dots: &[u32], prior: &Prior) -> Option<Located> {
    let wide = prior.wide();
    let pushed = agreeing(scene, gates, frame, dots, prior, &wide)?;
    if pushed.dots.len() < dots.len()
        && let Some(calm) = agreeing(scene, gates, frame, dots, prior, &prior.covariance)
        && calm.dots.len() >= 2
        && !calm.dots.iter().all(|d| pushed.dots.contains(d))
    {
        return Some(calm);
    }
    Some(pushed)
}

/// The position that most of the dots agree on, for a prediction with this covariance (m²).
fn agreeing(
    scene: &Scene,
    gates: &LocateGates,
    frame: &Frame,
    dots: &[u32],
    prior: &Prior,
    covariance: &Matrix3<f64>,
) -> Option<Located> {
    let information = covariance.try_inverse()?;
    let mut dots = dots.to_vec();
    loop {
        // Where nothing moves, no room is made for rays of its own.
        let moved: Vec<Cow<Sight>>;
        let sights: Vec<&Sight> = if frame.lag_s.is_empty() {
            dots.iter().map(|&d| frame.sight(d)).collect()
        } else {
            moved = dots.iter().map(|&d| frame.ray(d, &prior.motion, &prior.point)).collect();
            moved.iter().map(AsRef::as_ref).collect()
        };
        let (point, cost) = solve(scene, &sights, prior, &information)?;
        if cost <= gates.0[dots.len()] {
            return Some(Located::at(scene, frame, dots, point, &prior.motion));
        }
        if dots.len() == 1 {
            return None;
        }
        dots.remove(worst(scene, &sights, prior, &information)?);
    }
}

/// Index of the sight without which the others fit best.
fn worst(scene: &Scene, sights: &[&Sight], prior: &Prior, information: &Matrix3<f64>) -> Option<usize> {
    let without = |out: usize| {
        let rest: Vec<&Sight> = sights.iter().enumerate().filter(|(i, _)| *i != out).map(|(_, s)| *s).collect();
        solve(scene, &rest, prior, information).map(|(_, cost)| cost)
    };
    (0..sights.len()).filter_map(|i| without(i).map(|c| (i, c))).min_by(|a, b| a.1.total_cmp(&b.1)).map(|(i, _)| i)
}

/// Position and cost of all sights with the prediction.
fn solve(scene: &Scene, sights: &[&Sight], prior: &Prior, information: &Matrix3<f64>) -> Option<(Vector3<f64>, f64)> {
    let (mut point, mut cost) = (prior.point, 0.0);
    for round in 0..6 {
        let minimum = step(scene, sights, prior, information, &point)?;
        point += minimum.step;
        cost = minimum.rss;
        // The first look is from afar: weights of a tail need a second one.
        if minimum.step.norm() < SMALL_STEP && (round > 0 || scene.model.tail.is_none()) {
            break;
        }
    }
    // Written so that a search that ran off to infinity is no position either.
    let in_front = sights.iter().all(|s| s.depth(&point) > 1e-6);
    in_front.then_some((point, cost))
}

fn step(
    scene: &Scene,
    sights: &[&Sight],
    prior: &Prior,
    information: &Matrix3<f64>,
    point: &Vector3<f64>,
) -> Option<Minimum> {
    let mut normal = Normal::of_prior(information, &(point - prior.point));
    let mut constant = 0.0;
    for sight in sights {
        let linear = sight.linearise(point);
        let squared = linear.error.norm_squared();
        let weight = scene.model.tail.map_or(1.0, |t| t.weight(squared));
        normal = normal.plus(&Normal::of(&linear, weight));
        constant += scene.model.tail.map_or(0.0, |t| t.cost(squared) - weight * squared);
    }
    let mut minimum = normal.minimum()?;
    minimum.rss += constant;
    Some(minimum)
}

/// Position and covariance when information with a pull `information · (z − point)` is added to a prior.
pub fn posterior(
    point: &Vector3<f64>,
    covariance: &Matrix3<f64>,
    information: &Matrix3<f64>,
    pull: &Vector3<f64>,
) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    let after = (covariance.try_inverse()? + information).try_inverse()?;
    let after = 0.5 * (after + after.transpose());
    Some((point + after * pull, after))
}
