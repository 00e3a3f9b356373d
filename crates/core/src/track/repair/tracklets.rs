//! Stretches of a trajectory within which the identity is beyond doubt.
//!
//! A recorded trajectory is cut where a marker was hidden for more than a moment and where two markers came so near
//! that they may have been exchanged. What belongs together is decided anew, with the whole take in view (`join.rs`).

use crate::track::{Kind, Tracked};
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// Hidden for longer (s), or for more frames than two, a marker may come back as another one.
const SURE_GAP_S: f64 = 0.025;
/// Two markers come into contact when nearer than this, and part when farther than that (m).
const CONTACT: f64 = 0.008;
const PARTED: f64 = 0.020;

/// Measured frames up to which a stretch may be a chance meeting of rays.
const FLICKER: usize = 2;

/// A stretch of measured samples.
#[derive(Clone, Debug)]
pub struct Tracklet {
    /// Identity that the forward pass gave it.
    pub track: u32,
    /// Index of its first frame.
    pub first: usize,
    /// Position in each frame from the first on; `None` where it was hidden for a moment.
    pub places: Vec<Option<Vector3<f64>>>,
    /// Measured samples with three rays or more, and all.
    pub wide: usize,
    /// Number of measured samples.
    pub measured: usize,
    /// Sum of the positions' variances per axis (m²).
    pub variance: f64,
}

impl Tracklet {
    /// Whether it is so short, and seen by so few cameras, that its rays may have met by chance.
    pub fn is_flicker(&self) -> bool {
        self.measured <= FLICKER && self.wide < self.measured
    }

    /// Index of the last frame.
    pub fn last(&self) -> usize {
        self.first + self.places.len() - 1
    }

    /// Position in a frame.
    pub fn at(&self, frame: usize) -> Option<Vector3<f64>> {
        frame.checked_sub(self.first).and_then(|i| self.places.get(i)).copied().flatten()
    }

    /// Frames in which it is measured, at most `most` of them, evenly spread.
    pub fn frames(&self, most: usize) -> Vec<usize> {
        let all: Vec<usize> = (0..self.places.len()).filter(|&i| self.places[i].is_some()).collect();
        let n = all.len().min(most);
        (0..n).map(|k| self.first + all[(2 * k + 1) * all.len() / (2 * n)]).collect()
    }
}

/// Cuts all trajectories that were ever believed. Also returns, by frame and sample, the tracklet of each measured one.
pub fn cut(frames: &[Tracked], times_s: &[f64]) -> (Vec<Tracklet>, Vec<Vec<Option<usize>>>) {
    let believed = believed(frames);
    let mut tracklets: Vec<Tracklet> = Vec::new();
    let mut owner: Vec<Vec<Option<usize>>> = Vec::with_capacity(frames.len());
    let mut open: BTreeMap<u32, usize> = BTreeMap::new();
    let mut touching: BTreeMap<(u32, u32), bool> = BTreeMap::new();
    for (index, frame) in frames.iter().enumerate() {
        for pair in changes_of_contact(frame, &mut touching) {
            open.remove(&pair.0);
            open.remove(&pair.1);
        }
        let mut own = vec![None; frame.samples.len()];
        for (i, sample) in frame.samples.iter().enumerate() {
            if sample.kind != Kind::Measured || believed.binary_search(&sample.track).is_err() {
                continue;
            }
            let goes_on = open.get(&sample.track).copied().filter(|&t| {
                let last = tracklets[t].last();
                index - last <= 2 || times_s[index] - times_s[last] <= SURE_GAP_S
            });
            let tracklet = goes_on.unwrap_or_else(|| {
                tracklets.push(Tracklet {
                    track: sample.track,
                    first: index,
                    places: Vec::new(),
                    wide: 0,
                    measured: 0,
                    variance: 0.0,
                });
                tracklets.len() - 1
            });
            open.insert(sample.track, tracklet);
            let one = &mut tracklets[tracklet];
            one.places.resize(index - one.first, None);
            one.places.push(Some(sample.point));
            one.wide += usize::from(sample.dots.len() >= 3);
            one.measured += 1;
            one.variance += sample.covariance.trace() / 3.0;
            own[i] = Some(tracklet);
        }
        owner.push(own);
    }
    (tracklets, owner)
}

/// Identities of trajectories that were believed at some time, ascending.
fn believed(frames: &[Tracked]) -> Vec<u32> {
    let mut found: Vec<u32> = frames.iter().flat_map(|f| &f.samples).filter(|s| s.confirmed).map(|s| s.track).collect();
    found.sort_unstable();
    found.dedup();
    found
}

/// Pairs of trajectories that begin or end a contact in this frame.
fn changes_of_contact(frame: &Tracked, touching: &mut BTreeMap<(u32, u32), bool>) -> Vec<(u32, u32)> {
    let mut order: Vec<usize> = (0..frame.samples.len()).collect();
    order.sort_unstable_by(|&a, &b| frame.samples[a].point.x.total_cmp(&frame.samples[b].point.x).then(a.cmp(&b)));
    touching.values_mut().for_each(|t| *t = false);
    let mut changed = Vec::new();
    for (k, &a) in order.iter().enumerate() {
        for &b in &order[k + 1..] {
            let (one, other) = (&frame.samples[a], &frame.samples[b]);
            if other.point.x - one.point.x > PARTED {
                break;
            }
            let pair = (one.track.min(other.track), one.track.max(other.track));
            let reach = if touching.contains_key(&pair) { PARTED } else { CONTACT };
            if (one.point - other.point).norm() < reach && touching.insert(pair, true).is_none() {
                changed.push(pair);
            }
        }
    }
    let over: Vec<(u32, u32)> = touching.iter().filter(|(_, t)| !**t).map(|(&pair, _)| pair).collect();
    for pair in &over {
        touching.remove(pair);
    }
    changed.extend(over);
    changed
}
