//! Which dots confirm which markers: in each camera one assignment on the likelihood of the innovations (Lee et al.
//! 2000, §3, equations 7–8; the assignment after Bar-Shalom & Li 1995, "Multitarget-Multisensor Tracking", §6).
//!
//! A marker's prediction is projected into a camera; a dot at z with innovation ν has the likelihood of a mixture: the
//! filter's own spread S and, rarely, a much wider one, because limbs are pushed and stopped (the prediction error's
//! 99.9 % quantile is 15–80 times its median). What it must beat: that the dot belongs to nothing known, and that the
//! camera missed the marker.

use super::frame::Frame;
use crate::assignment::assign;
use crate::camera::Rig;
use crate::correspond::scene::Scene;
use nalgebra::{Matrix2, Matrix2x3, Matrix3, Vector2, Vector3};

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
}

impl Prior {
    /// The covariance when there was a push.
    pub fn wide(&self) -> Matrix3<f64> {
        self.covariance + Matrix3::identity() * self.push
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

/// How often a marker is pushed.
const LN_PUSHED: f64 = -4.0;
const LN_NOT_PUSHED: f64 = -0.018_5;
/// How rarely a hidden marker comes back in a given frame.
const LN_REAPPEARS: f64 = -4.0;
/// Squared innovation (standard deviations) beyond which a dot is not looked at: χ², 2 degrees, 1e-4.
const GATE: f64 = 18.4;
/// New or unexplained markers per image, for the density of dots that belong to nothing known.
const UNKNOWN_PER_IMAGE: f64 = 0.1;

/// A predicted marker in one camera.
struct View {
    who: usize,
    pixel: Vector2<f64>,
    /// Covariance of the projection (px²): own, and what a push adds.
    own: Matrix2<f64>,
    push: Matrix2<f64>,
}

/// A dot that may be a marker's, with the gain of believing so (nats).
struct Edge {
    who: usize,
    dot: u32,
    gain: f64,
}

/// One camera's part of the work.
pub struct CameraMatch {
    /// Pairs (index of the prior, dot).
    pub pairs: Vec<(usize, u32)>,
}

/// Matches free dots of one camera to the markers expected at `priors` (indices `who` of those asked for).
pub fn match_camera(
    scene: &Scene,
    frame: &Frame,
    camera: usize,
    priors: &[Option<Prior>],
    wanted: impl Fn(usize) -> bool,
) -> CameraMatch {
    let dots = &frame.by_camera[camera];
    if dots.is_empty() {
        return CameraMatch { pairs: Vec::new() };
    }
    let alone = ln_alone(scene, camera);
    let detection = scene.model.detection;
    let base = (detection / (1.0 - detection)).ln() - alone;
    let mut edges = Vec::new();
    for (who, prior) in priors.iter().enumerate() {
        let Some(prior) = prior.as_ref().filter(|_| wanted(who)) else { continue };
        if let Some(view) = view_of(&scene.rig, camera, who, prior) {
            add_edges(frame, camera, &view, base, &mut edges);
        }
    }
    CameraMatch { pairs: best_pairs(&edges) }
}

/// Logarithm of the density (px⁻²) of dots that belong to nothing known.
fn ln_alone(scene: &Scene, camera: usize) -> f64 {
    let [width, height] = scene.rig.cameras[camera].size_px;
    ((scene.model.clutter[camera] + UNKNOWN_PER_IMAGE) / (width * height)).ln()
}

fn view_of(rig: &Rig, camera: usize, who: usize, prior: &Prior) -> Option<View> {
    let (pixel, by_point) = rig.cameras[camera].project_linear(&prior.point)?;
    let own = spread(&by_point, &prior.covariance);
    let push = by_point * by_point.transpose() * prior.push;
    let reach = (GATE * (own + push).trace()).sqrt() + 2.0;
    let size = rig.cameras[camera].size_px;
    let inside = (0..2).all(|i| pixel[i] > -reach && pixel[i] < size[i] + reach);
    inside.then_some(View { who, pixel, own, push })
}

fn spread(by_point: &Matrix2x3<f64>, covariance: &Matrix3<f64>) -> Matrix2<f64> {
    by_point * covariance * by_point.transpose()
}

fn add_edges(frame: &Frame, camera: usize, view: &View, base: f64, edges: &mut Vec<Edge>) {
    let dots = &frame.by_camera[camera];
    let widest = frame.widest_sigma_px[camera];
    let wide = view.own + view.push + Matrix2::identity() * (widest * widest);
    let reach = Vector2::new((GATE * wide[(0, 0)]).sqrt(), (GATE * wide[(1, 1)]).sqrt());
    let first = dots.partition_point(|&d| frame.pixel(d).x < view.pixel.x - reach.x);
    for &dot in &dots[first..] {
        let offset = frame.pixel(dot) - view.pixel;
        if offset.x > reach.x {
            break;
        }
        if offset.y.abs() > reach.y || !frame.free[dot as usize] {
            continue;
        }
        let sigma = frame.sigma_px(dot);
        if let Some(ln_likelihood) = ln_mixture(view, &offset, sigma * sigma) {
            let gain = base + ln_likelihood;
            if gain > 0.0 {
                edges.push(Edge { who: view.who, dot, gain });
            }
        }
    }
}

/// Logarithm of the larger component of the mixture; `None` outside the gate.
fn ln_mixture(view: &View, offset: &Vector2<f64>, noise: f64) -> Option<f64> {
    let own = view.own + Matrix2::identity() * noise;
    let wide = own + view.push;
    let (wide_distance, wide_determinant) = mahalanobis(&wide, offset);
    if wide_distance > GATE {
        return None;
    }
    let (own_distance, own_determinant) = mahalanobis(&own, offset);
    let ln = |weight: f64, distance: f64, determinant: f64| {
        weight - 0.5 * (distance + determinant.ln()) - std::f64::consts::TAU.ln()
    };
    let calm = ln(LN_NOT_PUSHED, own_distance, own_determinant);
    Some(calm.max(ln(LN_PUSHED, wide_distance, wide_determinant)))
}

fn mahalanobis(s: &Matrix2<f64>, v: &Vector2<f64>) -> (f64, f64) {
    let determinant = s[(0, 0)] * s[(1, 1)] - s[(0, 1)] * s[(0, 1)];
    let squared =
        (s[(1, 1)] * v.x * v.x - 2.0 * s[(0, 1)] * v.x * v.y + s[(0, 0)] * v.y * v.y) / determinant.max(1e-300);
    (squared, determinant)
}

/// The pairs of greatest total gain. Pairs without a rival are taken as they are; the rest is solved group by group.
fn best_pairs(edges: &[Edge]) -> Vec<(usize, u32)> {
    let mut by_dot: Vec<usize> = (0..edges.len()).collect();
    by_dot.sort_unstable_by_key(|&e| (edges[e].dot, edges[e].who));
    let mut group: Vec<usize> = (0..edges.len()).collect();
    for pair in (1..edges.len()).map(|i| [i - 1, i]).filter(|p| edges[p[0]].who == edges[p[1]].who) {
        join(&mut group, pair[0], pair[1]);
    }
    for pair in by_dot.windows(2).filter(|p| edges[p[0]].dot == edges[p[1]].dot) {
        join(&mut group, pair[0], pair[1]);
    }
    let mut members: Vec<(usize, usize)> = (0..edges.len()).map(|e| (root(&mut group, e), e)).collect();
    members.sort_unstable();
    let mut pairs = Vec::with_capacity(edges.len());
    for component in members.chunk_by(|a, b| a.0 == b.0) {
        match component {
            [(_, single)] => pairs.push((edges[*single].who, edges[*single].dot)),
            several => solve(several.iter().map(|&(_, e)| &edges[e]), &mut pairs),
        }
    }
    pairs
}

fn solve<'a>(edges: impl Iterator<Item = &'a Edge> + Clone, pairs: &mut Vec<(usize, u32)>) {
    let mut rows: Vec<usize> = edges.clone().map(|e| e.who).collect();
    let mut columns: Vec<u32> = edges.clone().map(|e| e.dot).collect();
    rows.sort_unstable();
    rows.dedup();
    columns.sort_unstable();
    columns.dedup();
    let mut costs = vec![None; rows.len() * columns.len()];
    for edge in edges {
        let row = rows.partition_point(|&r| r < edge.who);
        let column = columns.partition_point(|&c| c < edge.dot);
        costs[row * columns.len() + column] = Some(-edge.gain);
    }
    let found = assign(rows.len(), columns.len(), |r, c| costs[r * columns.len() + c]);
    pairs.extend(found.iter().enumerate().filter_map(|(r, c)| c.map(|c| (rows[r], columns[c]))));
}

fn root(group: &mut [usize], mut at: usize) -> usize {
    while group[at] != at {
        group[at] = group[group[at]];
        at = group[at];
    }
    at
}

fn join(group: &mut [usize], a: usize, b: usize) {
    let (a, b) = (root(group, a), root(group, b));
    group[a.max(b)] = a.min(b);
}
