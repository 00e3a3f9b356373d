//! Which dots of which cameras belong to one marker: the correspondence problem, behind one interface.
//!
//! Three methods give the same kind of answer, a list of [`Group`]s:
//! - [`Method::Epipolar`]: every epipolar match becomes a point (Lee et al. 2000, figure 11c). A baseline.
//! - [`Method::Relaxation`]: maximal cliques of the k-partite match graph and relaxation labelling (Lee et al. 2000, §2).
//! - [`Method::Optimal`]: disjoint groups of maximal likelihood ratio, found exactly and with a certificate.

pub mod cliques;
pub mod confidence;
pub mod enumerate;
pub mod epipolar;
pub mod estimate;
pub mod frame;
pub mod noise;
pub mod optimal;
pub mod packing;
pub mod pairs;
pub mod relaxation;
pub mod scene;
pub mod solid;

use crate::sight::Normal;
use crate::triangulate::{TriangulateOptions, refine, widest_angle_deg};
use frame::PreparedFrame;
use nalgebra::{Matrix3, Vector3};
use scene::Scene;

/// How dots are joined.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Maximum likelihood with a certificate.
    Optimal,
    /// The relaxation labelling of the seed paper.
    Relaxation,
    /// Every epipolar match.
    Epipolar,
}

/// Dots that belong to one marker, and the point they give.
#[derive(Clone, Debug)]
pub struct Group {
    /// Indices into the frame's dots, in ascending order of camera.
    pub dots: Vec<usize>,
    /// Position (m, world).
    pub point: Vector3<f64>,
    /// Covariance of the position (m²).
    pub covariance: Matrix3<f64>,
    /// Probability that the group is a real marker.
    pub confidence: f64,
    /// Root mean square distance of dots and reprojections (px).
    pub residual_px: f64,
    /// Mean distance between the point and the rays (m).
    pub ray_distance_m: f64,
}

/// The answer for one frame.
#[derive(Clone, Debug, Default)]
pub struct Correspondence {
    /// Groups in ascending order of their first dot.
    pub groups: Vec<Group>,
    /// Whether the choice is proven optimal (only [`Method::Optimal`]).
    pub certified: bool,
    /// Objective of the choice and proven upper bound (nats; only [`Method::Optimal`]).
    pub objective: f64,
    /// See `objective`.
    pub bound: f64,
    /// Candidate groups and search nodes looked at.
    pub candidates: usize,
    /// Search nodes of the packing.
    pub nodes: usize,
}

/// Turns chosen dots into a group with a point; `None` if they have no point (degenerate geometry).
///
/// `confidence` is known where alternatives were weighed; without it, the group is weighed against its dots being alone.
/// The weights of a tail enter here too, so that a half-hidden marker's biased dot does not pull the point.
pub fn group_from_dots(
    scene: &Scene,
    frame: &PreparedFrame,
    dots: &[usize],
    start: Vector3<f64>,
    confidence: Option<f64>,
) -> Option<Group> {
    let sights: Vec<_> = dots.iter().map(|&d| &frame.sights[d]).collect();
    if widest_angle_deg(&sights) < TriangulateOptions::default().min_angle_deg {
        return None;
    }
    let weight = |squared: f64| scene.model.tail.map_or(1.0, |tail| tail.weight(squared));
    let (point, normal) = refine(&sights, start, weight)?;
    if sights.iter().any(|s| s.depth(&point) <= 0.0) || !scene.model.region.contains(&point) {
        return None;
    }
    let covariance = normal.information().try_inverse()?;
    let confidence = confidence.unwrap_or_else(|| odds_alone(scene, frame, dots, &point));
    let (mut squared_px, mut distance) = (0.0, 0.0);
    for sight in &sights {
        squared_px += sight.linearise(&point).error.norm_squared() * sight.sigma_px * sight.sigma_px;
        distance += (point - sight.origin).cross(&sight.direction).norm();
    }
    let n = sights.len() as f64;
    Some(Group {
        dots: dots.iter().map(|&d| frame.input_index[d]).collect(),
        point,
        covariance,
        confidence,
        residual_px: (squared_px / n).sqrt(),
        ray_distance_m: distance / n,
    })
}

/// Probability of a group against "none of its dots is part of a marker", other groups left out of account.
fn odds_alone(scene: &Scene, frame: &PreparedFrame, dots: &[usize], point: &Vector3<f64>) -> f64 {
    let (mut normal, mut cost, mut gain, mut cameras) = (Normal::default(), 0.0, 0.0, 0u128);
    for &dot in dots {
        let linear = frame.sights[dot].linearise(point);
        let squared = linear.error.norm_squared();
        cost += scene.model.tail.map_or(squared, |tail| tail.cost(squared));
        normal = normal.plus(&Normal::of(&linear, 1.0));
        gain += frame.gains[dot];
        cameras |= 1 << frame.sights[dot].camera;
    }
    let visible = (scene.visible(point) | cameras).count_ones() as usize;
    let determinant = normal.information().determinant();
    let weight = enumerate::constant(scene) + scene.ln_density(point) + scene.ln_views[visible][dots.len()] + gain
        - 0.5 * (cost + determinant.ln());
    1.0 / (1.0 + (-weight).exp())
}
