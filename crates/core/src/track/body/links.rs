//! Links: distances between markers with mean and variance (Lee et al. 2000, §5.1, equations 17–18), repaired.
//!
//! As printed, equation 18 mixes the variance with the variance of the mean, loses all digits when the distance is long,
//! never forgets, and one swap breaks a link for good. Here: increments (Welford 1962) with exponential forgetting,
//! deviations clipped (Huber 1964), the noise of the two positions taken out, and the variance shrunk towards that of an
//! unknown link, the less the more the pair has turned: two markers that merely held still have not shown that they are
//! rigid. A link whose distance stays off its mean is broken; it heals when the distance comes back.

use super::{Carried, Seen};
use crate::label::model::Length;
use nalgebra::Vector3;

/// Links that a marker keeps.
const KEPT: usize = 20;
/// Longest link (m).
const LONGEST: f64 = 0.9;
/// Observations after which old ones fade (10 s).
const MEMORY: f64 = 500.0;
/// An unknown link: spread (m), and how many observations that belief is worth.
const UNKNOWN_SPREAD: f64 = 0.010;
const UNKNOWN_WORTH: f64 = 30.0;
/// A pair has turned when its direction has changed by this (cosine of 10°); what one turn is worth in observations.
const TURNED: f64 = 0.985;
const TURN_WORTH: f64 = 10.0;
/// A link of less spread is rigid (m).
const RIGID_SPREAD: f64 = 0.005;
/// Deviation (in spreads) that counts as off, and how often in a row breaks a link.
const OFF: f64 = 5.0;
const OFF_LIMIT: u8 = 10;
/// Links that pull a hidden marker, and what their variance is multiplied with: they are not independent.
const PULLING: usize = 6;
const LINK_DOUBT: f64 = 4.0;
const SMALLEST_COUNT: f64 = 20.0;
/// A frame's further members may cost this many times what its third does.
const LESS_RELIABLE: f64 = 3.0;
/// Frames between two looks for nearer partners of one marker.
const RENEW: usize = 16;

/// The distance of one marker to another.
#[derive(Clone, Debug)]
pub struct Link {
    /// Slot of the other marker.
    pub other: usize,
    /// Mean distance (m).
    pub mean_m: f64,
    variance: f64,
    noise: f64,
    count: f64,
    turns: f64,
    direction: Vector3<f64>,
    off: u8,
}

impl Link {
    fn new(other: usize, between: &Vector3<f64>) -> Self {
        let length = between.norm();
        let direction = between / length.max(1e-9);
        Self { other, mean_m: length, variance: 0.0, noise: 0.0, count: 0.0, turns: 0.0, direction, off: 0 }
    }

    /// A link that is known before it is seen.
    fn known(other: usize, length: &Length, worth: f64) -> Self {
        let (variance, count) = (length.sd.powi(2), worth.min(MEMORY));
        let turns = (count / TURN_WORTH).floor();
        let direction = Vector3::zeros();
        Self { other, mean_m: length.mean, variance, noise: 0.0, count, turns, direction, off: 0 }
    }

    /// Takes in a distance (m) in a direction, and what its variance owes to noise (m²).
    fn learn(&mut self, (length, direction): (f64, Vector3<f64>), noise: f64) {
        let spread = (self.spread_m().powi(2) + noise).sqrt();
        let deviation = length - self.mean_m;
        if self.count > 20.0 && deviation.abs() > OFF * spread {
            self.off = (self.off + 1).min(2 * OFF_LIMIT);
        } else {
            self.off = self.off.saturating_sub(1);
        }
        let clipped = deviation.clamp(-4.0 * spread, 4.0 * spread);
        self.count = (self.count + 1.0).min(MEMORY);
        let mean = self.mean_m + clipped / self.count; // eq 17
        self.variance += (clipped * (length - mean).clamp(-4.0 * spread, 4.0 * spread) - self.variance) / self.count;
        self.mean_m = mean;
        self.noise += (noise - self.noise) / self.count;
        if direction.dot(&self.direction) < TURNED {
            self.turns += 1.0;
            self.direction = direction;
        }
    }

    /// Spread of the distance that belongs to the body (m): the positions' noise is out, unproven links are near 10 mm.
    pub fn spread_m(&self) -> f64 {
        let worth = self.count.min(TURN_WORTH * self.turns);
        let own = (self.variance - self.noise).max(0.0);
        ((UNKNOWN_WORTH * UNKNOWN_SPREAD.powi(2) + worth * own) / (UNKNOWN_WORTH + worth)).sqrt()
    }

    /// Whether the two markers sit on one rigid part, as far as they have shown it.
    pub fn is_rigid(&self) -> bool {
        self.spread_m() < RIGID_SPREAD && !self.is_broken()
    }

    /// Whether the distance has been off lately.
    pub fn is_broken(&self) -> bool {
        self.off >= OFF_LIMIT
    }

    /// Spread of the distance that was seen or must be reckoned with (m).
    pub fn range_m(&self) -> f64 {
        self.spread_m().max((self.variance - self.noise).max(0.0).sqrt())
    }

    /// How much the link helps to place a hidden marker: its spread, or the distance's range where that says more (m).
    fn cost(&self) -> f64 {
        self.range_m() + 0.02 * self.mean_m
    }
}

/// All links, by slot.
#[derive(Clone, Debug, Default)]
pub struct Links {
    by_slot: Vec<Vec<Link>>,
    rounds: usize,
}

impl Links {
    /// Makes room.
    pub fn reserve(&mut self, slots: usize) {
        if self.by_slot.len() < slots {
            self.by_slot.resize(slots, Vec::new());
        }
    }

    /// Forgets a slot.
    pub fn clear(&mut self, slot: usize) {
        for links in &mut self.by_slot {
            links.retain(|l| l.other != slot);
        }
        self.by_slot[slot].clear();
    }

    /// The links of one marker.
    pub fn of(&self, slot: usize) -> &[Link] {
        self.by_slot.get(slot).map_or(&[], Vec::as_slice)
    }

    /// A distance that is known before, as well as from `worth` observations.
    pub fn know(&mut self, slot: usize, other: usize, length: Length, worth: f64) {
        let own = &mut self.by_slot[slot];
        if own.iter().any(|l| l.other == other && l.count >= worth) {
            return;
        }
        own.retain(|l| l.other != other);
        own.push(Link::known(other, &length, worth));
        keep_best(own);
    }

    /// Takes in the distances of one frame.
    pub fn learn(&mut self, seen: &[Seen]) {
        let mut at: Vec<Option<usize>> = vec![None; self.by_slot.len()];
        seen.iter().enumerate().filter(|(_, s)| s.trusted).for_each(|(i, s)| at[s.slot] = Some(i));
        self.rounds += 1;
        for one in seen.iter().filter(|s| s.trusted) {
            let own = &mut self.by_slot[one.slot];
            if own.is_empty() || (self.rounds + one.slot).is_multiple_of(RENEW) {
                renew(own, one, seen);
            }
            for link in own.iter_mut() {
                if let Some(other) = at[link.other].map(|i| &seen[i]) {
                    let between = other.point - one.point;
                    let length = between.norm();
                    let along = between / length.max(1e-9);
                    link.learn((length, along), along.dot(&((one.covariance + other.covariance) * along)));
                }
            }
        }
    }

    /// A hidden marker's place improved by the distances to its most reliable neighbours (Gauss–Newton on distances that
    /// count as independent with [`LINK_DOUBT`] times their variance); `None` if no link helps.
    pub fn pull(&self, slot: usize, start: &Carried, now: &[Option<Vector3<f64>>]) -> Option<Carried> {
        let information = start.covariance.try_inverse()?;
        let spread = (start.covariance.trace() / 3.0).sqrt();
        let helps = |l: &&Link| !l.is_broken() && l.count > SMALLEST_COUNT && l.range_m() < spread;
        let known: Vec<(&Link, Vector3<f64>)> = self
            .of(slot)
            .iter()
            .filter(helps)
            .filter_map(|l| now.get(l.other).copied().flatten().map(|p| (l, p)))
            .take(PULLING)
            .collect();
        if known.is_empty() {
            return None;
        }
        let mut point = start.point;
        let mut total = information;
        for _ in 0..5 {
            total = information;
            let mut gradient = information * (point - start.point);
            for (link, other) in &known {
                let between = point - other;
                let length = between.norm().max(1e-6);
                let along = between / length;
                let weight = 1.0 / (LINK_DOUBT * link.range_m().powi(2) + 1e-6);
                total += along * along.transpose() * weight;
                gradient += along * (weight * (length - link.mean_m));
            }
            let step = total.try_inverse()? * gradient;
            point -= step;
            if step.norm() < 1e-5 {
                break;
            }
        }
        Some(Carried { point, covariance: total.try_inverse()? })
    }

    /// The markers that place a hidden one best, among those that are known `now`, best first.
    pub fn best(&self, slot: usize, now: &[Option<Vector3<f64>>], most: usize) -> Vec<usize> {
        self.best_of(slot, |other| now.get(other).is_some_and(Option::is_some), most)
    }

    /// The markers that make a frame for a hidden one: at least three, and others that are not much less reliable.
    pub fn frame_of(&self, slot: usize, now: &[Option<Vector3<f64>>], most: usize) -> Vec<usize> {
        let mut best = self.best(slot, now, most);
        let cost = |other: usize| self.of(slot).iter().find(|l| l.other == other).map_or(f64::INFINITY, Link::cost);
        if let Some(&third) = best.get(2) {
            let worst = LESS_RELIABLE * cost(third);
            best.retain(|&o| cost(o) <= worst);
        }
        best
    }

    /// The markers that place another one best, among those that are `usable`, best first.
    pub fn best_of(&self, slot: usize, usable: impl Fn(usize) -> bool, most: usize) -> Vec<usize> {
        let mut found: Vec<(f64, usize)> = Vec::with_capacity(most + 1);
        for link in self.of(slot).iter().filter(|l| usable(l.other) && !l.is_broken()) {
            let one = (link.cost(), link.other);
            let at = found.partition_point(|f| f.0.total_cmp(&one.0).then(f.1.cmp(&one.1)).is_lt());
            if at < most {
                found.insert(at, one);
                found.truncate(most);
            }
        }
        found.into_iter().map(|f| f.1).collect()
    }
}

/// Adds nearer partners; the least useful links make room.
fn renew(own: &mut Vec<Link>, one: &Seen, seen: &[Seen]) {
    let mut near: Vec<(f64, &Seen)> = seen
        .iter()
        .filter(|s| s.trusted && s.slot != one.slot)
        .map(|s| ((s.point - one.point).norm(), s))
        .filter(|(distance, _)| *distance < LONGEST)
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.slot.cmp(&b.1.slot)));
    for (_, other) in near.into_iter().take(KEPT) {
        if own.iter().all(|l| l.other != other.slot) {
            own.push(Link::new(other.slot, &(other.point - one.point)));
        }
    }
    keep_best(own);
}

fn keep_best(own: &mut Vec<Link>) {
    own.sort_by(|a, b| a.cost().total_cmp(&b.cost()).then(a.other.cmp(&b.other)));
    own.truncate(KEPT);
}
