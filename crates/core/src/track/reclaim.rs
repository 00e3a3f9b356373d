//! Dots taken back: a marker without a second dot, where the camera that saw it gave its dot to another.
//!
//! Cameras are assigned one by one; a marker that goes out of a camera's sight may take the dot of one beside it, and a
//! frame's rays alone do not contradict. What tells is who was seen there before (`visibility.rs`).

use super::Tracker;
use super::frame::Frame;
use super::locate::{Located, locate};
use super::marker::Marker;
use super::matching::{Prior, innovation};

/// A camera sees a marker, or does not, with at least this probability where that decides whose a dot is.
const SURE: f64 = 0.7;
/// So near to where a marker is expected must its dots meet (squared, in its spreads; χ², 3 degrees, 25 %).
const EXPECTED: f64 = 4.1;
/// A marker that gives dots away keeps so many.
const KEPT: usize = 2;

impl Tracker {
    /// Gives markers that are not found the dots back that others have taken: those of cameras that saw them in the frame
    /// before, and not the other, which is found without them just as well.
    pub(super) fn reclaim(&mut self, frame: &mut Frame) {
        for who in 0..self.crowd.markers.len() {
            let marker = &self.crowd.markers[who];
            if !marker.confirmed || marker.is_found() || !marker.is_live() || self.crowd.is_suspected(marker.track) {
                continue;
            }
            let prior = Prior { push: 0.0, ..marker.prior };
            let taken = self.taken_from(marker, &prior, frame);
            if taken.is_empty() {
                continue;
            }
            let mut dots: Vec<u32> = marker.located.iter().flat_map(|l| l.dots.clone()).collect();
            dots.extend(taken.iter().map(|&(_, dot)| dot));
            dots.sort_unstable();
            let located = locate(&self.scene, &self.gates, frame, &dots, &prior);
            let Some(located) = located.filter(|l| l.rays >= 2 && is_expected(l, &prior)) else { continue };
            for (owner, dot) in taken.into_iter().filter(|(_, dot)| located.dots.contains(dot)) {
                self.take_from(owner, dot, frame);
            }
            let marker = &mut self.crowd.markers[who];
            marker.release(&mut frame.free);
            marker.located = Some(located);
            marker.claim(&mut frame.free);
        }
    }

    /// Dots that may be a marker's, with their owners: the nearest in each camera that saw it and not them.
    fn taken_from(&self, marker: &Marker, prior: &Prior, frame: &Frame) -> Vec<(usize, u32)> {
        let mut taken: Vec<(usize, u32, f64)> = Vec::new();
        for (owner, other) in self.crowd.markers.iter().enumerate().filter(|(_, m)| m.own_dots() > KEPT) {
            for &dot in other.located.iter().flat_map(|l| &l.dots).filter(|&&d| !frame.is_lent(d)) {
                let camera = frame.sight(dot).camera;
                let saw = marker.visibility.of(camera).is_some_and(|p| p > SURE);
                let did_not = other.visibility.of(camera).is_some_and(|p| p < 1.0 - SURE);
                if !saw || !did_not || marker.has_dot_of(camera, frame) {
                    continue;
                }
                let Some(squared) = innovation(&self.scene, frame, dot, prior) else { continue };
                let enough = other.own_dots() - taken.iter().filter(|t| t.0 == owner).count() > KEPT;
                match taken.iter_mut().find(|t| frame.sight(t.1).camera == camera) {
                    Some(best) if squared < best.2 && (enough || best.0 == owner) => *best = (owner, dot, squared),
                    None if enough => taken.push((owner, dot, squared)),
                    _ => {}
                }
            }
        }
        taken.into_iter().map(|(owner, dot, _)| (owner, dot)).collect()
    }

    fn take_from(&mut self, owner: usize, dot: u32, frame: &mut Frame) {
        let other = &mut self.crowd.markers[owner];
        let rest: Vec<u32> = other.located.iter().flat_map(|l| &l.dots).copied().filter(|&d| d != dot).collect();
        other.release(&mut frame.free);
        other.located = locate(&self.scene, &self.gates, frame, &rest, &other.prior);
        other.claim(&mut frame.free);
    }
}

fn is_expected(located: &Located, prior: &Prior) -> bool {
    let offset = located.point - prior.point;
    prior.covariance.try_inverse().is_some_and(|i| offset.dot(&(i * offset)) < EXPECTED)
}
