//! Two trajectories on one marker: each takes some of its dots, in this frame or that, and neither is ever seen whole.
//!
//! Real markers, however near, are told apart by some camera now and then: each has its own dot there. Two trajectories
//! in one place that share the cameras out between them for some frames are one, and the younger is given up. In a single
//! frame, a marker that was hidden gives back dots that are another's.

use super::Tracker;
use super::crowd::Crowd;
use super::frame::Frame;
use super::locate::posterior;
use super::marker::Marker;
use nalgebra::{Matrix3, Vector3};
use std::collections::BTreeMap;

/// Trajectories in one place are within so many standard deviations of each other, and within this distance (m).
const SAME_PLACE: f64 = 2.5;
/// Where a prediction is no help (m²).
const ANYWHERE: f64 = 1.0;
pub(super) const NEAR: f64 = 0.02;
/// Frames of shared out cameras that make two trajectories one; a camera that sees both undoes several.
const ENOUGH: i32 = 6;
const UNDONE: i32 = 3;

impl Crowd {
    /// Whether a trajectory may follow another one's marker.
    pub fn is_suspected(&self, track: u32) -> bool {
        self.suspected.keys().any(|pair| pair.0 == track || pair.1 == track)
    }

    /// Gives up trajectories that follow another one's marker.
    pub fn drop_duplicates(&mut self, frame: &Frame) {
        let mut order: Vec<usize> = (0..self.markers.len()).filter(|&i| self.markers[i].own_dots() > 0).collect();
        let x = |i: usize| self.markers[i].state().0.x;
        order.sort_unstable_by(|&a, &b| x(a).total_cmp(&x(b)).then(a.cmp(&b)));
        let mut suspected = BTreeMap::new();
        let mut gone = Vec::new();
        for (k, &a) in order.iter().enumerate() {
            for &b in order[k + 1..].iter().take_while(|&&b| x(b) - x(a) < NEAR) {
                let pair = [a.min(b), a.max(b)].map(|i| &self.markers[i]);
                let tell_apart = matches!(pair.map(|m| m.hardware), [Some(a), Some(b)] if a != b);
                if tell_apart || !in_one_place(pair) {
                    continue;
                }
                let tracks = (pair[0].track, pair[1].track);
                let before = self.suspected.get(&tracks).copied().unwrap_or(0);
                let now = before + if seen_by_one_camera(pair, frame) { -UNDONE } else { 1 };
                if now >= ENOUGH {
                    gone.push(pair[1].track);
                } else if now > 0 {
                    suspected.insert(tracks, now);
                }
            }
        }
        self.suspected = suspected;
        self.forget(|m| gone.contains(&m.track));
    }
}

impl Tracker {
    /// Where two markers are found in one place, each by other cameras, and one of them was hidden until now, its dots are
    /// free again: they are the other's.
    pub(super) fn give_back(&mut self, frame: &mut Frame) {
        let markers = &self.crowd.markers;
        if markers.iter().all(|m| m.is_live() || !m.is_measured()) {
            return;
        }
        let places: Vec<Option<(Vector3<f64>, Matrix3<f64>)>> = markers.iter().map(place).collect();
        let mut wrong = Vec::new();
        for (i, one) in markers.iter().enumerate().filter(|(i, m)| places[*i].is_some() && !m.is_live()) {
            let is_better = |(k, other): (usize, &Marker)| {
                let (Some(here), Some(there)) = (places[i], places[k]) else { return false };
                i != k
                    && near(&here, &there)
                    && !seen_by_one_camera([one, other], frame)
                    && (other.is_live() || (fit(other, &there), i) > (fit(one, &here), k))
            };
            if markers.iter().enumerate().any(is_better) {
                wrong.push(i);
            }
        }
        for i in wrong {
            self.crowd.markers[i].release(&mut frame.free);
        }
    }
}

/// Where the rays alone put a found marker.
fn place(marker: &Marker) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    let located = marker.located.as_ref().filter(|l| l.own >= 2)?;
    posterior(&located.point, &(Matrix3::identity() * ANYWHERE), &located.information, &located.pull)
}

/// How well a place fits a marker's prediction.
fn fit(marker: &Marker, (point, covariance): &(Vector3<f64>, Matrix3<f64>)) -> f64 {
    marker.prior.ln_likelihood(covariance, &(point - marker.prior.point), f64::MAX).unwrap_or(f64::MIN)
}

fn in_one_place([one, other]: [&Marker; 2]) -> bool {
    near(one.state(), other.state())
}

/// Whether two places with their covariances may be one.
pub(super) fn near(
    (p, p_covariance): &(Vector3<f64>, Matrix3<f64>),
    (q, q_covariance): &(Vector3<f64>, Matrix3<f64>),
) -> bool {
    let spread = (p_covariance + q_covariance).trace().sqrt();
    (p - q).norm() < NEAR.min(SAME_PLACE * spread)
}

fn seen_by_one_camera([one, other]: [&Marker; 2], frame: &Frame) -> bool {
    let own = |m: &Marker| m.located.iter().flat_map(|l| &l.dots).copied().filter(|&d| !frame.is_lent(d)).collect();
    let dots: Vec<u32> = own(other);
    dots.into_iter().any(|d| one.has_dot_of(frame.sight(d).camera, frame))
}
