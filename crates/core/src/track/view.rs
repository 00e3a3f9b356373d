//! Which dots confirm which markers: in each camera one assignment on the likelihood of the innovations (Lee et al.
//! 2000, §3, equations 7–8; the assignment after Bar-Shalom & Li 1995, "Multitarget-Multisensor Tracking", §6).
//!
//! A marker's prediction is projected into a camera; a dot at z with innovation ν has the likelihood of a mixture: the
//! filter's own spread S and, rarely, a much wider one, because limbs are pushed and stopped (the prediction error's
//! 99.9 % quantile is 15–80 times its median). What it must beat: that the dot belongs to nothing known, and that the
//! camera missed the marker.

use super::flow::Motion;
use super::frame::Frame;
use crate::assignment::assign;
use crate::camera::Camera;
use crate::correspond::scene::Scene;
use nalgebra::{Matrix2x3, Matrix3, Vector2, Vector3};
use rayon::prelude::*;
use std::ops::Range;

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
    fn covariance_after(&self, lag_s: f64) -> Matrix3<f64> {
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

/// How often a marker is pushed.
const LN_PUSHED: f64 = -4.0;
const LN_NOT_PUSHED: f64 = -0.018_5;
/// How rarely a hidden marker comes back in a given frame.
const LN_REAPPEARS: f64 = -4.0;
/// What a dot that tells a marker's identity has for it (nats).
const LN_TOLD: f64 = 8.0;
/// Squared innovation (standard deviations) beyond which a dot is not looked at: χ², 2 degrees, 1e-4.
const GATE: f64 = 18.4;
/// Views from which on sharing them out among threads pays.
const WORTH_SHARING: usize = 4000;
/// Dots that are counted one by one instead of halving on.
const COUNTED: usize = 32;

/// A symmetric matrix of two rows: xx, xy, yy.
type Symmetric = [f64; 3];

/// J C Jᵀ.
fn seen_by(by_point: &Matrix2x3<f64>, covariance: &Matrix3<f64>) -> Symmetric {
    let turned = by_point * covariance;
    let dot = |i: usize, j: usize| {
        turned[(i, 0)] * by_point[(j, 0)] + turned[(i, 1)] * by_point[(j, 1)] + turned[(i, 2)] * by_point[(j, 2)]
    };
    [dot(0, 0), dot(0, 1), dot(1, 1)]
}

/// A predicted marker in one camera.
struct View {
    who: usize,
    pixel: Vector2<f64>,
    /// Covariance of the projection (px²): own, and what a push adds.
    own: Symmetric,
    push: Symmetric,
}

/// A centred normal density in the image, ready to be evaluated.
#[derive(Clone, Copy)]
struct Density {
    inverse: Symmetric,
    determinant: f64,
}

impl Density {
    fn new([xx, xy, yy]: Symmetric) -> Self {
        let determinant = (xx * yy - xy * xy).max(1e-300);
        Self { inverse: [yy / determinant, -xy / determinant, xx / determinant], determinant }
    }

    fn squared(&self, v: &Vector2<f64>) -> f64 {
        let [a, b, c] = self.inverse;
        a * v.x * v.x + 2.0 * b * v.x * v.y + c * v.y * v.y
    }

    /// Logarithm of the density at a squared distance, with the logarithm of a weight.
    fn ln(&self, weight: f64, squared: f64) -> f64 {
        weight - 0.5 * self.determinant.ln() - std::f64::consts::TAU.ln() - 0.5 * squared
    }
}

/// The likelihood of innovations of one view: calm or pushed, for dots of one noise.
#[derive(Clone, Copy)]
struct Mixture {
    sigma_px: f64,
    calm: Density,
    pushed: Density,
}

impl Mixture {
    fn new(view: &View, sigma_px: f64) -> Self {
        let variance = sigma_px * sigma_px;
        let own = [view.own[0] + variance, view.own[1], view.own[2] + variance];
        let wide = [own[0] + view.push[0], own[1] + view.push[1], own[2] + view.push[2]];
        Self { sigma_px, calm: Density::new(own), pushed: Density::new(wide) }
    }

    /// Logarithm of the larger component; `None` outside the gate.
    fn ln(&self, offset: &Vector2<f64>) -> Option<f64> {
        let pushed = self.pushed.squared(offset);
        if pushed > GATE {
            return None;
        }
        let calm = self.calm.ln(LN_NOT_PUSHED, self.calm.squared(offset));
        Some(calm.max(self.pushed.ln(LN_PUSHED, pushed)))
    }
}

/// Squared innovation of a dot (standard deviations) with room for a push; `None` outside the gate.
pub fn innovation(scene: &Scene, frame: &Frame, dot: u32, prior: &Prior) -> Option<f64> {
    let sight = frame.sight(dot);
    let lag_s = frame.lag_s(sight.camera);
    let (pixel, by_point) = scene.rig.cameras[sight.camera].project_linear(&prior.after(lag_s))?;
    let spread = prior.covariance_after(lag_s) + Matrix3::identity() * prior.push;
    let [xx, xy, yy] = seen_by(&by_point, &spread);
    let variance = sight.sigma_px * sight.sigma_px;
    let squared = Density::new([xx + variance, xy, yy + variance]).squared(&(frame.pixel(dot) - pixel));
    (squared <= GATE).then_some(squared)
}

/// A dot (by its number among the free ones) that may be a marker's, with the gain of believing so (nats).
#[derive(Clone, Copy)]
struct Edge {
    who: usize,
    dot: u32,
    gain: f64,
}

/// Matches free dots to the markers expected at `priors`, camera by camera, of those that are `wanted` there (camera, index
/// of the prior). Pairs (index of the prior, dot) in order of the cameras; large rigs are shared out among threads.
pub fn match_cameras(
    scene: &Scene,
    frame: &Frame,
    priors: &[Option<Prior>],
    wanted: impl Fn(usize, usize) -> bool + Sync,
) -> Vec<(usize, u32)> {
    let cameras = scene.rig.cameras.len();
    let known = Known::of(priors);
    let one = |camera: usize| match_camera(scene, frame, camera, priors, &known, |who| wanted(camera, who));
    if cameras * priors.len() < WORTH_SHARING {
        return (0..cameras).flat_map(one).collect();
    }
    let parts: Vec<Vec<(usize, u32)>> = (0..cameras).into_par_iter().map(one).collect();
    parts.into_iter().flatten().collect()
}

/// Matches free dots of one camera to the markers expected at `priors`, of which those that are `wanted` are asked for.
/// Pairs (index of the prior, dot).
fn match_camera(
    scene: &Scene,
    frame: &Frame,
    camera: usize,
    priors: &[Option<Prior>],
    known: &Known,
    wanted: impl Fn(usize) -> bool,
) -> Vec<(usize, u32)> {
    let free = Free::of(frame, camera);
    if free.dots.is_empty() {
        return Vec::new();
    }
    let detection = scene.model.detection;
    let base = (detection / (1.0 - detection)).ln();
    let mut edges = Vec::with_capacity(2 * free.dots.len());
    for (who, prior) in priors.iter().enumerate() {
        let Some(prior) = prior.as_ref().filter(|_| wanted(who)) else { continue };
        if let Some((view, near)) = free.near(&scene.rig.cameras[camera], frame.lag_s(camera), who, prior) {
            free.add_edges(&view, base, near, |told| known.gain(prior, told), &mut edges);
        }
    }
    best_pairs(edges).into_iter().map(|(who, at)| (who, free.dots[at as usize].dot)).collect()
}

/// Identities that markers are known to have told, in ascending order.
struct Known(Vec<u32>);

impl Known {
    fn of(priors: &[Option<Prior>]) -> Self {
        let mut told: Vec<u32> = priors.iter().flatten().filter_map(|p| p.hardware).collect();
        told.sort_unstable();
        Self(told)
    }

    /// What a dot's identity says for a marker's (nats): `None` if it is another's.
    fn gain(&self, marker: &Prior, dot: Option<u32>) -> Option<f64> {
        match (marker.hardware, dot) {
            (_, None) => (!marker.must_tell).then_some(0.0),
            (Some(marker), Some(dot)) => (marker == dot).then_some(LN_TOLD),
            (None, Some(dot)) => self.0.binary_search(&dot).is_err().then_some(0.0),
        }
    }
}

/// A dot that nobody owns.
struct FreeDot {
    dot: u32,
    pixel: Vector2<f64>,
    sigma_px: f64,
    hardware: Option<u32>,
    /// Logarithm of the density (px⁻²) of dots there that belong to nothing known.
    ln_alone: f64,
}

/// Free dots of one camera, by ascending x.
struct Free {
    dots: Vec<FreeDot>,
    x: Vec<f64>,
    widest_sigma_px: f64,
}

impl Free {
    fn of(frame: &Frame, camera: usize) -> Self {
        let one = |&dot: &u32| FreeDot {
            dot,
            pixel: frame.pixel(dot),
            sigma_px: frame.sigma_px(dot),
            hardware: frame.dots[dot as usize].hardware,
            ln_alone: frame.ln_alone[dot as usize],
        };
        let dots: Vec<FreeDot> = frame.by_camera[camera].iter().filter(|&&d| frame.free[d as usize]).map(one).collect();
        Self { x: dots.iter().map(|d| d.pixel.x).collect(), dots, widest_sigma_px: frame.widest_sigma_px[camera] }
    }

    /// A marker's view, and the dots that may be within its gate; `None` if there are none. Most hidden markers end here.
    fn near(&self, camera: &Camera, lag_s: f64, who: usize, prior: &Prior) -> Option<(View, Range<usize>)> {
        let (pixel, by_point) = camera.project_linear(&prior.after(lag_s))?;
        let covariance = if lag_s == 0.0 { prior.covariance } else { prior.covariance_after(lag_s) };
        let variance = by_point.norm_squared() * (covariance.trace() + prior.push);
        let reach = (GATE * (variance + self.widest_sigma_px * self.widest_sigma_px)).sqrt();
        let first = self.left_of(pixel.x - reach);
        let last = first + self.x[first..].iter().take_while(|&&x| x <= pixel.x + reach).count();
        if !self.dots[first..last].iter().any(|d| (d.pixel.y - pixel.y).abs() <= reach) {
            return None;
        }
        let own = seen_by(&by_point, &covariance);
        let push = seen_by(&by_point, &Matrix3::identity()).map(|v| v * prior.push);
        Some((View { who, pixel, own, push }, first..last))
    }

    fn add_edges(
        &self,
        view: &View,
        base: f64,
        near: Range<usize>,
        trust: impl Fn(Option<u32>) -> Option<f64>,
        edges: &mut Vec<Edge>,
    ) {
        let mut mixture = Mixture::new(view, self.widest_sigma_px);
        for at in near {
            let dot = &self.dots[at];
            if dot.sigma_px.to_bits() != mixture.sigma_px.to_bits() {
                mixture = Mixture::new(view, dot.sigma_px);
            }
            let Some(trusted) = trust(dot.hardware) else { continue };
            let Some(ln) = mixture.ln(&(dot.pixel - view.pixel)) else { continue };
            let gain = base + trusted + ln - dot.ln_alone;
            if gain > 0.0 {
                edges.push(Edge { who: view.who, dot: at as u32, gain });
            }
        }
    }

    /// Number of dots left of a place. Counting a few is faster than jumping about.
    fn left_of(&self, x: f64) -> usize {
        let (mut low, mut high) = (0, self.x.len());
        while high - low > COUNTED {
            let middle = usize::midpoint(low, high);
            if self.x[middle] < x { low = middle } else { high = middle }
        }
        low + self.x[low..high].iter().map(|&other| usize::from(other < x)).sum::<usize>()
    }
}

/// The pairs of greatest total gain. Pairs that nothing can beat are taken as they are; the rest is solved group by group.
fn best_pairs(mut edges: Vec<Edge>) -> Vec<(usize, u32)> {
    let mut pairs = take_sure(&mut edges);
    if edges.is_empty() {
        return pairs;
    }
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
    for component in members.chunk_by(|a, b| a.0 == b.0) {
        match component {
            [(_, single)] => pairs.push((edges[*single].who, edges[*single].dot)),
            several => solve(several.iter().map(|&(_, e)| &edges[e]), &mut pairs),
        }
    }
    pairs
}

/// In place of the largest gain: that marker or dot has its own.
const TAKEN: f64 = f64::INFINITY;

/// The two largest gains around a marker or a dot.
#[derive(Clone, Copy, Default)]
struct Best {
    first: f64,
    second: f64,
}

impl Best {
    fn take_in(&mut self, gain: f64) {
        if gain > self.first {
            (self.first, self.second) = (gain, self.first);
        } else {
            self.second = self.second.max(gain);
        }
    }

    /// The best of the others.
    fn beside(&self, gain: f64) -> f64 {
        if gain >= self.first { self.second } else { self.first }
    }
}

/// Takes out the pairs whose gain is at least that of the best others of their marker and their dot together: no exchange
/// could lose less. Edges of what is taken go.
fn take_sure(edges: &mut Vec<Edge>) -> Vec<(usize, u32)> {
    let markers = edges.iter().map(|e| e.who + 1).max().unwrap_or(0);
    let dots = edges.iter().map(|e| e.dot as usize + 1).max().unwrap_or(0);
    let mut pairs = Vec::with_capacity(edges.len());
    let (mut of_marker, mut of_dot) = (vec![Best::default(); markers], vec![Best::default(); dots]);
    loop {
        of_marker.fill(Best::default());
        of_dot.fill(Best::default());
        for e in &*edges {
            of_marker[e.who].take_in(e.gain);
            of_dot[e.dot as usize].take_in(e.gain);
        }
        let sure = |e: &Edge| e.gain > of_marker[e.who].beside(e.gain) + of_dot[e.dot as usize].beside(e.gain);
        let before = pairs.len();
        pairs.extend(edges.iter().filter(|e| sure(e)).map(|e| (e.who, e.dot)));
        // What is taken has no best any more.
        for &(who, dot) in &pairs[before..] {
            (of_marker[who].first, of_dot[dot as usize].first) = (TAKEN, TAKEN);
        }
        edges.retain(|e| of_marker[e.who].first < TAKEN && of_dot[e.dot as usize].first < TAKEN);
        if edges.is_empty() || pairs.len() == before {
            return pairs;
        }
    }
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
