//! Two markers taken for each other, found out by how their neighbours move and by the links.
//!
//! Near each other and fast, two markers can change places in the predictions (one is then where the other was a frame
//! before, and a velocity learned from a swap foretells the next one). A marker's own motion would go on with the swap;
//! the markers around it tell: they do not take part (Lee et al. 2000, §5.2: which point fits a marker is decided by its
//! rigid links).

use super::body::links::Link;
use super::crowd::Crowd;
use super::marker::Marker;
use super::rematch::{link_cost, surprise};
use nalgebra::Vector3;

/// Markers farther apart than this are not taken for each other (m).
const NEAR: f64 = 0.06;
/// Evidence needed to exchange (nats).
const ENOUGH: f64 = 4.0;

/// Deviation from the neighbours' motion that is nothing special, as a part of the two markers' distance.
const USUAL_DEVIATION: f64 = 0.1;
/// Neighbours asked.
const ASKED: usize = 3;

type Places = Vec<Option<Vector3<f64>>>;

impl Crowd {
    /// Exchanges the measurements of near markers where that fits the others so much better that their own motion does
    /// not count.
    pub fn exchange(&mut self) {
        let now = self.places(|m| m.is_measured().then(|| m.found_at()).flatten());
        let last = self.places(|m| m.is_live().then(|| m.last_point()));
        let at = self.by_slot();
        for one in 0..self.markers.len() {
            let slot = self.markers[one].slot;
            // Who told its identity is not taken for another.
            let is_told = |index: usize| self.markers[index].hardware.is_some();
            if !self.markers[one].confirmed || now[slot].is_none() || is_told(one) {
                continue;
            }
            let near = |l: &&Link| l.other > slot && l.mean_m < NEAR && now[l.other].is_some();
            let other =
                self.body.links.of(slot).iter().filter(near).filter_map(|l| at[l.other]).filter(|&o| !is_told(o));
            let worth = |&o: &usize| self.gain_of_exchange(&self.markers[one], &self.markers[o], &now, &last) > ENOUGH;
            if let Some(other) = other.into_iter().find(worth) {
                let located = self.markers[one].located.take();
                let back = self.markers[other].located.take();
                self.markers[one].take_over(back);
                self.markers[other].take_over(located);
            }
        }
    }

    /// Evidence for an exchange (nats): what it costs now, less what it would cost then.
    fn gain_of_exchange(&self, one: &Marker, other: &Marker, now: &Places, last: &Places) -> f64 {
        let (Some(p), Some(q)) = (now[one.slot], now[other.slot]) else { return 0.0 };
        let (Some(a), Some(b)) = (last[one.slot], last[other.slot]) else { return 0.0 };
        let pair = [one.slot, other.slot];
        let spread = USUAL_DEVIATION * (p - q).norm();
        let cost = |m: &Marker, from: Vector3<f64>, to: Vector3<f64>| {
            let drift = self.drift(m.slot, pair, now, last).unwrap_or_else(|| m.prior.point - from);
            let others = |slot: usize| now[slot].filter(|_| !pair.contains(&slot));
            surprise((to - from - drift).norm(), spread) + link_cost(m, &to, &self.body.links, others)
        };
        cost(one, a, p) + cost(other, b, q) - cost(one, a, q) - cost(other, b, p)
    }

    /// How a marker's best neighbours beside a pair have moved since the last frame (m).
    fn drift(&self, slot: usize, pair: [usize; 2], now: &Places, last: &Places) -> Option<Vector3<f64>> {
        let moved = |other: usize| Some(now[other]? - last[other]?).filter(|_| !pair.contains(&other));
        let moved: Vec<Vector3<f64>> =
            self.body.links.best_of(slot, |o| moved(o).is_some(), ASKED).into_iter().filter_map(moved).collect();
        (!moved.is_empty()).then(|| moved.iter().sum::<Vector3<f64>>() / moved.len() as f64)
    }
}
