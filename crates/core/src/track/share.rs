//! Merged blobs: two markers so near in an image that the camera gives one dot for both.
//!
//! Where a marker has no dot in a camera and its rigid neighbour's dot lies where their two images run together, that
//! dot may be one for both. Its owner keeps it, with a noise as large as the blob could hide; the other, where it lacks a
//! second ray, is lent it (a marker placed by loans is predicted, not measured). What "near" is, is learned from
//! the dots: two that are nearer than any two ever were are one.

use super::Tracker;
use super::frame::Frame;
use super::locate::{Located, locate};
use super::marker::Marker;
use crate::sight::Sight;
use nalgebra::{Vector2, Vector3};

/// What the distance of the nearest two dots of a frame tells about merging: its quantile, followed in steps (px).
pub(super) const QUANTILE: f64 = 0.1;
const STEP_PX: f64 = 0.05;
pub(super) const RANGE_PX: [f64; 2] = [1.0, 8.0];
/// Only a marker that is known this well is looked for in the dots of others (m).
const KNOWN: f64 = 0.02;
/// Two markers whose distance in the image is up to this many merging distances can be one blob at times.
const MERGED: f64 = 1.5;
/// Innovation allowed beyond the merging distance (standard deviations).
const GATE_SIGMAS: f64 = 3.0;
/// Room for rounding.
const ROUNDING: f64 = 1.0 + 1e-9;

/// The distance at which two dots become one, as learned.
#[derive(Clone, Copy, Debug)]
pub struct Merging {
    /// Distance (px).
    pub distance_px: f64,
}

impl Default for Merging {
    fn default() -> Self {
        Self { distance_px: 3.0 }
    }
}

impl Merging {
    /// Takes in the nearest two dots of a frame.
    pub fn learn(&mut self, frame: &Frame) {
        let Some(nearest) = nearest_px(frame) else { return };
        let step = if nearest < self.distance_px { QUANTILE - 1.0 } else { QUANTILE };
        self.distance_px = (self.distance_px + STEP_PX * step).clamp(RANGE_PX[0], RANGE_PX[1]);
    }
}

/// Distance of the nearest two dots of a camera (px), where it is small.
pub(super) fn nearest_px(frame: &Frame) -> Option<f64> {
    let mut nearest: Option<f64> = None;
    for dots in &frame.by_camera {
        for (i, &a) in dots.iter().enumerate() {
            for &b in &dots[i + 1..] {
                let offset = frame.pixel(b) - frame.pixel(a);
                if offset.x > nearest.unwrap_or(RANGE_PX[1]) {
                    break;
                }
                nearest = Some(nearest.map_or(offset.norm(), |n| n.min(offset.norm())));
            }
        }
    }
    nearest
}

/// A dot that is one for two markers.
struct Shared {
    dot: u32,
    owner: usize,
    other: usize,
    /// Noise that the merging adds (px).
    noise_px: f64,
}

impl Tracker {
    /// Makes merged dots noisy, and lends them to the markers that lack rays.
    pub(super) fn share(&mut self, frame: &mut Frame) {
        self.merging.learn(frame);
        let shared = self.shared_dots(frame);
        if shared.is_empty() {
            return;
        }
        let mut dots: Vec<Option<Vec<u32>>> = vec![None; self.crowd.markers.len()];
        for s in &shared {
            let camera = frame.sight(s.dot).camera;
            let lent = frame.share(s.dot, s.noise_px);
            let own = |index: usize| self.crowd.markers[index].located.iter().flat_map(|l| l.dots.clone()).collect();
            dots[s.owner].get_or_insert_with(|| own(s.owner));
            if !self.crowd.markers[s.other].is_found() {
                let dots = dots[s.other].get_or_insert_with(|| own(s.other));
                if dots.iter().all(|&d| frame.sight(d).camera != camera) {
                    dots.push(lent);
                }
            }
        }
        for (marker, dots) in self.crowd.markers.iter_mut().zip(dots) {
            let Some(dots) = dots else { continue };
            let located = locate(&self.scene, &self.gates, frame, &dots, &marker.prior);
            if let Some(better) = located.filter(|l| l.rays >= 2) {
                marker.located = Some(better);
            }
        }
    }

    /// Dots that are one for two rigid neighbours.
    fn shared_dots(&self, frame: &Frame) -> Vec<Shared> {
        let at = self.crowd.by_slot();
        let mut found = Vec::new();
        for (owner, one) in self.crowd.markers.iter().enumerate().filter(|(_, m)| m.confirmed) {
            let Some(located) = &one.located else { continue };
            let [here_m, by_depth] = self.widest_m(frame, located);
            for link in self.crowd.body.links.of(one.slot) {
                let Some(other) = at[link.other] else { continue };
                let deeper_m = (place_of(&self.crowd.markers[other]) - located.point).norm();
                if link.mean_m > here_m + by_depth * deeper_m || !link.is_rigid() {
                    continue;
                }
                for &dot in &located.dots {
                    let noise_px = self.merged(frame, dot, link.mean_m, &self.crowd.markers[other]);
                    found.extend(noise_px.map(|noise_px| Shared { dot, owner, other, noise_px }));
                }
            }
        }
        found
    }

    /// The longest distance that may look like one blob in any image of a marker (m), and by how much more it may be with
    /// each metre that the other marker is farther from the camera.
    fn widest_m(&self, frame: &Frame, located: &Located) -> [f64; 2] {
        let mut widest = [0.0_f64; 2];
        for &dot in &located.dots {
            let sight = frame.sight(dot);
            let by_depth = 2.0 * MERGED * self.merging.distance_px / px_at_one_metre(sight);
            let here = by_depth * sight.depth(&located.point);
            widest = [widest[0].max(here), widest[1].max(by_depth)];
        }
        widest.map(|w| w * ROUNDING)
    }

    /// Whether the dot of a marker at a distance (m) is another's too; if so, what noise the merging adds (px).
    fn merged(&self, frame: &Frame, dot: u32, distance_m: f64, other: &Marker) -> Option<f64> {
        let sight = frame.sight(dot);
        let known = other.is_found() || other.prior.covariance.trace() < KNOWN * KNOWN;
        let place = place_of(other);
        let px_per_m = px_at_one_metre(sight) / sight.depth(&place);
        let reach = MERGED * self.merging.distance_px;
        if !known || distance_m * px_per_m > 2.0 * reach || other.has_dot_of(sight.camera, frame) {
            return None;
        }
        let then = place + other.prior.motion.velocity * frame.lag_s(sight.camera);
        let (pixel, by_point) = self.scene.rig.cameras[sight.camera].project_linear(&then)?;
        let spread =
            if other.is_found() { 0.0 } else { (by_point * other.prior.covariance * by_point.transpose()).trace() };
        let offset: Vector2<f64> = frame.pixel(dot) - pixel;
        let near = offset.norm() < self.merging.distance_px + GATE_SIGMAS * (spread + sight.sigma_px.powi(2)).sqrt();
        near.then_some(0.5 * self.merging.distance_px.min(distance_m * px_per_m))
    }
}

/// Where a marker is as far as is known by now.
fn place_of(marker: &Marker) -> Vector3<f64> {
    marker.found_at().unwrap_or(marker.prior.point)
}

/// How long a metre is in an image one metre before the camera (px).
fn px_at_one_metre(sight: &Sight) -> f64 {
    sight.rows.norm() * std::f64::consts::FRAC_1_SQRT_2 * sight.sigma_px
}
