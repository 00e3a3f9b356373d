//! Two trajectories on one marker: each takes some of its dots, in this frame or that, and neither is ever seen whole.
//!
//! Real markers, however near, are told apart by some camera now and then: each has its own dot there. Two trajectories
//! in one place that share the cameras out between them for some frames are one, and the younger is given up.

use super::crowd::Crowd;
use super::frame::Frame;
use super::marker::Marker;
use std::collections::BTreeMap;

/// Trajectories in one place are within so many standard deviations of each other, and within this distance (m).
const SAME_PLACE: f64 = 3.0;
const NEAR: f64 = 0.02;
/// Frames of shared out cameras that make two trajectories one; a camera that sees both undoes several.
const ENOUGH: i32 = 6;
const UNDONE: i32 = 3;

impl Crowd {
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
                if !in_one_place(pair) {
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

fn in_one_place([one, other]: [&Marker; 2]) -> bool {
    let ((p, p_covariance), (q, q_covariance)) = (one.state(), other.state());
    let spread = (p_covariance + q_covariance).trace().sqrt();
    (p - q).norm() < NEAR.min(SAME_PLACE * spread)
}

fn seen_by_one_camera([one, other]: [&Marker; 2], frame: &Frame) -> bool {
    let own = |m: &Marker| m.located.iter().flat_map(|l| &l.dots).copied().filter(|&d| !frame.is_lent(d)).collect();
    let dots: Vec<u32> = own(other);
    dots.into_iter().any(|d| one.has_dot_of(frame.sight(d).camera, frame))
}
