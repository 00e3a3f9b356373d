//! What is believed about a take before a frame is looked at: where markers can be, how often a camera sees one, how
//! noisy its dots are, how much clutter it has. Estimated from the take itself (`estimate.rs`).

use crate::camera::Rig;
use crate::chi2;
use crate::sight::Sight;
use nalgebra::{Vector2, Vector3};

/// An axis-aligned box in world metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Corner with the smallest coordinates (m).
    pub low: Vector3<f64>,
    /// Corner with the largest coordinates (m).
    pub high: Vector3<f64>,
}

impl Aabb {
    /// The smallest box around points; `None` without points.
    pub fn around(points: impl IntoIterator<Item = Vector3<f64>>) -> Option<Self> {
        points.into_iter().fold(None, |found: Option<Self>, p| {
            Some(found.map_or(Self { low: p, high: p }, |b| Self { low: b.low.inf(&p), high: b.high.sup(&p) }))
        })
    }

    /// Whether a point lies inside.
    pub fn contains(&self, p: &Vector3<f64>) -> bool {
        (0..3).all(|i| p[i] >= self.low[i] && p[i] <= self.high[i])
    }

    /// Volume (m³), at least that of a 1 mm cube.
    pub fn volume(&self) -> f64 {
        (self.high - self.low).iter().map(|side| side.max(1e-3)).product()
    }

    /// What two boxes have in common; empty (not positive) where they do not touch.
    #[must_use]
    pub fn intersection(&self, other: &Self) -> Self {
        Self { low: self.low.sup(&other.low), high: self.high.inf(&other.high) }
    }

    /// Length of the diagonal (m).
    pub fn diagonal(&self) -> f64 {
        (self.high - self.low).norm()
    }

    /// Grown by a margin (m) on each side.
    #[must_use]
    pub fn grown(&self, margin: Vector3<f64>) -> Self {
        Self { low: self.low - margin, high: self.high + margin }
    }

    /// Part of the ray `origin + t·direction`, t ≥ 0, inside the box.
    pub fn chord(&self, origin: &Vector3<f64>, direction: &Vector3<f64>) -> Option<[f64; 2]> {
        let (mut enter, mut leave) = (0.0_f64, f64::INFINITY);
        for i in 0..3 {
            let inverse = 1.0 / direction[i];
            let (a, b) = ((self.low[i] - origin[i]) * inverse, (self.high[i] - origin[i]) * inverse);
            enter = enter.max(a.min(b));
            leave = leave.min(a.max(b));
        }
        (enter < leave).then_some([enter, leave])
    }
}

/// The wide component of the residuals: a real rig's errors have a core and a tail (drift, half-hidden markers).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tail {
    /// Share of dots that belong to the tail, 0–0.5.
    pub share: f64,
    /// Standard deviation of the tail in units of the core's.
    pub scale: f64,
}

impl Tail {
    /// −2 ln of a dot's residual density relative to that of a pure core, without the constant both have.
    pub fn cost(&self, squared_error: f64) -> f64 {
        let (core, tail) = self.costs(squared_error);
        core.min(tail)
    }

    /// Whether the core explains the residual better than the tail does.
    pub fn weight(&self, squared_error: f64) -> f64 {
        let (core, tail) = self.costs(squared_error);
        if core <= tail { 1.0 } else { 1.0 / (self.scale * self.scale) }
    }

    fn costs(&self, squared_error: f64) -> (f64, f64) {
        let variance = self.scale * self.scale;
        (squared_error - 2.0 * (-self.share).ln_1p(), squared_error / variance + 2.0 * (variance / self.share).ln())
    }
}

/// A dot that stays at one place of one camera's image: a lamp, a tripod, another camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reflection {
    /// Where it appears (px).
    pub pixel: [f64; 2],
    /// Fraction of frames in which it appears.
    pub rate: f64,
    /// How much it wanders (px, standard deviation per axis).
    pub spread_px: f64,
}

/// The prior of a take.
#[derive(Clone, Debug)]
pub struct SceneModel {
    /// Where two cameras can see at all; no point is made outside it.
    pub region: Aabb,
    /// Where the markers are, as far as known.
    pub volume: Aabb,
    /// Expected number of markers in a frame.
    pub expected_markers: f64,
    /// Probability that a camera which could see a marker has a dot of it.
    pub detection: f64,
    /// How the number of views departs from independent cameras: `view_correction[could][did]` (nats) is added for a
    /// marker that `could` cameras can see and `did` cameras saw. Occlusion is not independent between cameras.
    pub view_correction: Vec<Vec<f64>>,
    /// Factor on the expected number of markers that only one camera saw.
    pub single_view_factor: f64,
    /// False dots per frame, by camera.
    pub clutter: Vec<f64>,
    /// Noise by camera: multiplies the dots' own sigma (px where they have none).
    pub noise: Vec<f64>,
    /// Tail of the residuals.
    pub tail: Option<Tail>,
    /// Fixed reflections, by camera.
    pub reflections: Vec<Vec<Reflection>>,
}

/// Probability with which a true pair or group is missed by the gate of its size.
const MISS_PROBABILITY: f64 = 1e-6;
/// Share of the markers that may be anywhere in the region instead of inside the estimated volume.
const OUTSIDE_SHARE: f64 = 0.05;
const VISIBILITY_CELLS: usize = 20;
const CHORD_SAMPLES: usize = 8;

/// A rig and a model with what is computed from them once per take.
pub struct Scene {
    /// The cameras.
    pub rig: Rig,
    /// The prior.
    pub model: SceneModel,
    /// Logarithm of the number of markers that the dots of a frame are expected to show. A tracker, whose known markers
    /// have been taken out of the frame, expects few.
    pub ln_expected: f64,
    visible: Vec<u128>,
    cell_from_point: Vector3<f64>,
    /// Density of a marker's position (m⁻³): outside and inside the volume; and its logarithm.
    density: [f64; 2],
    ln_density: [f64; 2],
    /// Probability that n cameras which could see a marker all miss it.
    missed: Vec<f64>,
    /// Logarithm of the probability that of `could` cameras a given set of `did` has a dot: `[could][did]`.
    pub ln_views: Vec<Vec<f64>>,
    /// Largest squared residual of a pair.
    pub pair_gate: f64,
    /// Largest squared residual of a group of n dots.
    pub group_gates: Vec<f64>,
}

impl Scene {
    /// Prepares a scene. At most 128 cameras.
    pub fn new(rig: &Rig, model: &SceneModel) -> Self {
        let size = model.volume.high - model.volume.low;
        let cell_from_point = size.map(|side| VISIBILITY_CELLS as f64 / side.max(1e-6));
        let n = VISIBILITY_CELLS;
        let center = |i: usize, axis: usize| model.volume.low[axis] + (i as f64 + 0.5) / cell_from_point[axis];
        let mut visible = Vec::with_capacity(n * n * n);
        for cell in 0..n * n * n {
            let p = Vector3::new(center(cell / (n * n), 0), center(cell / n % n, 1), center(cell % n, 2));
            visible.push(cameras_that_see(rig, &p));
        }
        let outside = OUTSIDE_SHARE / model.region.volume();
        let inside = (1.0 - OUTSIDE_SHARE) / model.volume.volume() + outside;
        let missed = (0..=rig.cameras.len()).map(|n| (1.0 - model.detection).powi(n as i32)).collect();
        let density = [outside, inside];
        Self {
            rig: rig.clone(),
            model: model.clone(),
            ln_expected: model.expected_markers.ln(),
            visible,
            cell_from_point,
            density,
            ln_density: density.map(f64::ln),
            missed,
            ln_views: ln_views(model, rig.cameras.len()),
            pair_gate: pair_gate(model.tail),
            group_gates: (0..=rig.cameras.len().max(2)).map(|n| group_gate(n, model.tail)).collect(),
        }
    }

    /// Logarithm of the density of a marker's position (m⁻³).
    pub fn ln_density(&self, point: &Vector3<f64>) -> f64 {
        self.ln_density[usize::from(self.model.volume.contains(point))]
    }

    /// The cameras that can see a place, as a bit mask. Exact outside the volume, by cells inside it.
    pub fn visible(&self, point: &Vector3<f64>) -> u128 {
        if !self.model.volume.contains(point) {
            return cameras_that_see(&self.rig, point);
        }
        self.visible_near(point)
    }

    /// As [`Self::visible`], but a place outside the volume gets the answer of the nearest cell.
    fn visible_near(&self, point: &Vector3<f64>) -> u128 {
        let last = VISIBILITY_CELLS as f64 - 1.0;
        let cell = (point - self.model.volume.low).component_mul(&self.cell_from_point);
        let (i, j, k) =
            (cell.x.clamp(0.0, last) as usize, cell.y.clamp(0.0, last) as usize, cell.z.clamp(0.0, last) as usize);
        self.visible[(i * VISIBILITY_CELLS + j) * VISIBILITY_CELLS + k]
    }

    /// Logarithm of the density (px⁻²) with which this dot is *not* part of a point: a marker that no other camera
    /// saw, clutter, or a fixed reflection.
    pub fn ln_alone(&self, sight: &Sight, pixel: Vector2<f64>, chord: Option<[f64; 2]>) -> f64 {
        let model = &self.model;
        let camera = &self.rig.cameras[sight.camera];
        let mut density = model.clutter[sight.camera] / (camera.size_px[0] * camera.size_px[1]);
        for reflection in &model.reflections[sight.camera] {
            let variance = reflection.spread_px * reflection.spread_px;
            let distance2 = (pixel - Vector2::from(reflection.pixel)).norm_squared();
            density += reflection.rate * (-0.5 * distance2 / variance).exp() / (std::f64::consts::TAU * variance);
        }
        if let Some([near, far]) = chord {
            let step = (far - near) / CHORD_SAMPLES as f64;
            let depth_per_length = sight.direction.dot(&sight.axis);
            let mut sum = 0.0;
            for i in 0..CHORD_SAMPLES {
                let along = near + (i as f64 + 0.5) * step;
                let point = sight.origin + sight.direction * along;
                let others = (self.visible_near(&point) & !(1 << sight.camera)).count_ones();
                let depth = along * depth_per_length;
                sum += self.density[usize::from(model.volume.contains(&point))]
                    * depth
                    * depth
                    * self.missed[others as usize];
            }
            // dX = Z² dx dy dZ on the normalised plane.
            density += model.single_view_factor
                * model.expected_markers
                * model.detection
                * sum
                * step
                * depth_per_length
                * sight.pixel_area;
        }
        density.max(1e-12).ln()
    }
}

fn cameras_that_see(rig: &Rig, point: &Vector3<f64>) -> u128 {
    rig.cameras.iter().enumerate().fold(0, |mask, (i, camera)| mask | (u128::from(camera.sees(point)) << i))
}

fn ln_views(model: &SceneModel, cameras: usize) -> Vec<Vec<f64>> {
    let (seen, missed) = (model.detection.ln(), (1.0 - model.detection).ln());
    let plain = |could: usize, did: usize| did as f64 * seen + could.saturating_sub(did) as f64 * missed;
    (0..=cameras)
        .map(|could| (0..=could).map(|did| plain(could, did) + model.view_correction[could][did]).collect())
        .collect()
}

/// A true pair's squared residual (χ² with one degree of freedom) exceeds this with [`MISS_PROBABILITY`]. With a tail,
/// one of the two dots may come from it.
fn pair_gate(tail: Option<Tail>) -> f64 {
    let widening = tail.map_or(1.0, |tail| 0.5 * (1.0 + tail.scale * tail.scale));
    chi2::quantile(MISS_PROBABILITY, 1.0) * widening
}

/// The same for a group of n dots. A tail's dots cost more than a core's. A third of the views may be such, but none
/// of a pair: two rays have no majority that could tell which of them is off.
fn group_gate(n: usize, tail: Option<Tail>) -> f64 {
    if n < 2 {
        return 0.0;
    }
    let extra = tail.map_or(0.0, |t| t.cost(1e9) - 1e9 / (t.scale * t.scale));
    chi2::quantile(MISS_PROBABILITY, (2 * n - 3) as f64) + extra * (n / 3) as f64
}
