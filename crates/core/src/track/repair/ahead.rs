//! Where motion leads from a tracklet, forwards and backwards, and which places that clearly explains.

use super::tracklets::Tracklet;
use crate::track::Sample;
use nalgebra::Vector3;

/// Frames before the last from which a tracklet's velocity is taken.
pub(super) const RUN_UP: usize = 2;
/// A place is off its prediction by the usual acceleration at least so much (m), and without a velocity by this speed (m/s).
pub(super) const LEAST_SPREAD: f64 = 0.002;
const UNKNOWN_SPEED: f64 = 3.0;
/// Motion leads to a sample up to this many spreads away, and clearly so if the next is this many times as far.
pub(super) const FARTHEST: f64 = 1.5;
pub(super) const CLEAR: f64 = 3.0;
/// An uncertain motion (m) does not lead to what the forward pass took for another marker.
const SURE_SPREAD: f64 = 0.012;

/// Where a tracklet leads.
pub(super) struct Ahead {
    track: u32,
    pub(super) point: Vector3<f64>,
    /// How far off that may be (m).
    spread: f64,
}

impl Ahead {
    pub(super) fn of(tracklet: &Tracklet, index: usize, times_s: &[f64], acceleration: f64) -> Self {
        let last = tracklet.last();
        let before = (tracklet.first..last).rev().take(RUN_UP).find(|&f| tracklet.at(f).is_some());
        Self::along(tracklet, index, (last, before), times_s, acceleration)
    }

    /// Where a tracklet comes from: its place in a frame before its first.
    pub(super) fn back_from(tracklet: &Tracklet, index: usize, times_s: &[f64], acceleration: f64) -> Self {
        let first = tracklet.first;
        let later = (first + 1..=tracklet.last()).take(RUN_UP).find(|&f| tracklet.at(f).is_some());
        Self::along(tracklet, index, (first, later), times_s, acceleration)
    }

    /// Along the line through its places in two frames, the nearer one first.
    fn along(
        tracklet: &Tracklet,
        index: usize,
        (end, further): (usize, Option<usize>),
        times_s: &[f64],
        acceleration: f64,
    ) -> Self {
        let here = tracklet.at(end).unwrap_or_default();
        let dt_s = (times_s[index] - times_s[end]).abs();
        let line = further.and_then(|f| Some((tracklet.at(f)?, (times_s[f] - times_s[end]).abs())));
        let (point, lag_s, speed, stretch) = match line {
            Some((p, lag_s)) => (here + (here - p) * (dt_s / lag_s), lag_s, 0.0, dt_s / lag_s),
            None => (here, 0.0, UNKNOWN_SPEED, 0.0),
        };
        let spread = LEAST_SPREAD + speed * dt_s + 0.5 * acceleration * dt_s * (dt_s + lag_s);
        // Noise of the two places, and of the one that is held against this. Forwards, the identities of the forward pass count
        // where motion is not clear: noise would only keep them.
        let variances = if index < end { (1.0 + stretch).powi(2) + stretch * stretch + 1.0 } else { 0.0 };
        let noise = (variances * tracklet.variance_m2()).sqrt();
        Self { track: tracklet.track, point, spread: spread.hypot(noise) }
    }

    /// How far off a place is (spreads).
    pub(super) fn off(&self, place: &Vector3<f64>) -> f64 {
        (place - self.point).norm() / self.spread
    }
}

/// For each place, the index of what clearly leads to it: every other way is much farther. What may lead to the place too
/// but has a place of its own would leave it to this one, which counts as well.
pub(super) fn clear_pairs(ahead: &[Ahead], places: &[Vector3<f64>]) -> Vec<Option<usize>> {
    let off = |k: usize, s: usize| ahead[k].off(&places[s]);
    let mut of_place = vec![Nearest::default(); places.len()];
    let mut of_ahead = vec![Nearest::default(); ahead.len()];
    for (k, own) in of_ahead.iter_mut().enumerate() {
        for (s, others) in of_place.iter_mut().enumerate() {
            others.take_in(k, off(k, s));
            own.take_in(s, off(k, s));
        }
    }
    let pair_of = |s: usize| {
        let (k, near) = of_place[s].first?;
        (of_ahead[k].first?.0 == s && near < FARTHEST).then_some(k)
    };
    let own_place = |k: usize| of_ahead[k].first.map(|f| f.0).filter(|&s| pair_of(s) == Some(k));
    // The squared distance of an exchange with another pair, without that pair's own part.
    let exchanged = |k: usize, s: usize, l: usize, t: usize| off(k, t).powi(2) + off(l, s).powi(2) - off(l, t).powi(2);
    let clearly = |s: usize| {
        let k = pair_of(s)?;
        let enough = (CLEAR * off(k, s).max(1.0)).powi(2);
        let others = (0..ahead.len()).filter(|&l| l != k && off(l, s).powi(2) <= enough);
        let elsewhere = (0..places.len()).filter(|&t| t != s && off(k, t).powi(2) <= enough);
        let of_others = others.map(|l| own_place(l).map(|t| (l, t)));
        let mut stands = of_others.chain(elsewhere.map(|t| pair_of(t).map(|l| (l, t))));
        stands.all(|pair| pair.is_some_and(|(l, t)| exchanged(k, s, l, t) > enough)).then_some(k)
    };
    (0..places.len()).map(clearly).collect()
}

/// For each sample, the index of what it goes on with.
pub(super) fn continuations<'a>(
    ahead: &[Ahead],
    samples: impl Iterator<Item = &'a Sample>,
    torn: f64,
) -> Vec<Option<usize>> {
    let samples: Vec<&Sample> = samples.collect();
    let places: Vec<Vector3<f64>> = samples.iter().map(|s| s.point).collect();
    let mut found = clear_pairs(ahead, &places);
    for (sample, found) in samples.iter().zip(&mut found) {
        let believable = |k: &usize| ahead[*k].track == sample.track || ahead[*k].spread < SURE_SPREAD;
        *found = found.filter(believable);
    }
    let mut taken = vec![false; ahead.len()];
    found.iter().flatten().for_each(|&k| taken[k] = true);
    for (sample, found) in samples.iter().zip(&mut found).filter(|(_, f)| f.is_none()) {
        let goes_on = |k: &usize| {
            let one = &ahead[*k];
            !taken[*k] && one.track == sample.track && one.off(&sample.point) < torn
        };
        *found = (0..ahead.len()).find(goes_on);
        found.iter().for_each(|&k| taken[k] = true);
    }
    found
}

/// The nearest candidate, and how far the second is (spreads).
#[derive(Clone, Copy)]
pub(super) struct Nearest {
    pub(super) first: Option<(usize, f64)>,
    pub(super) second: f64,
}

impl Default for Nearest {
    fn default() -> Self {
        Self { first: None, second: f64::INFINITY }
    }
}

impl Nearest {
    pub(super) fn take_in(&mut self, who: usize, off: f64) {
        match self.first {
            Some((_, best)) if off >= best => self.second = self.second.min(off),
            first => {
                self.second = first.map_or(f64::INFINITY, |f| f.1);
                self.first = Some((who, off));
            }
        }
    }
}
