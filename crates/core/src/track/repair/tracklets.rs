//! Stretches of a trajectory within which the identity is beyond doubt.
//!
//! A recorded trajectory is cut where a marker was hidden for more than a moment, where two markers came so near
//! that they may have been exchanged, and where the forward pass gave one marker's points to another. What belongs
//! together is decided anew, with the whole take in view (`join.rs`).

use super::ahead::{Ahead, CLEAR, FARTHEST, LEAST_SPREAD, Nearest, RUN_UP, clear_pairs, continuations};
use super::ends::{set_ends_apart, trim_handovers};
use crate::track::{Kind, Sample, Tracked};
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// Hidden for longer (s), or for more frames than two, a marker may come back as another one.
pub(super) const SURE_GAP_S: f64 = 0.025;
/// Two markers come into contact when nearer than this, and part when farther than that (m).
const CONTACT: f64 = 0.008;
const PARTED: f64 = 0.020;

/// Farther away, the forward pass's identity does not count either (spreads).
pub const TORN: f64 = 3.0;
/// The same for points of other systems, which jump now and then.
pub const TORN_POINTS: f64 = 40.0;
/// The usual acceleration: from about so many frames, at least (m/s²).
const LOOKED_AT: usize = 500;
const LEAST_ACCELERATION: f64 = 5.0;
/// Measured frames up to which a stretch may be a chance meeting of rays.
pub(super) const FLICKER: usize = 2;

/// Tracklets, and by frame and sample the tracklet of each measured one.
pub type Cut = (Vec<Tracklet>, Vec<Vec<Option<usize>>>);

/// A stretch of measured samples.
#[derive(Clone, Debug)]
pub struct Tracklet {
    /// Identity that the forward pass gave it last, and first.
    pub track: u32,
    pub(super) first_track: u32,
    /// Share of the hidden frames before it in which the forward pass followed that first identity by a ray that met its
    /// predictions; a name alone that comes back says nothing.
    pub(super) followed: f64,
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
    pub(super) fn starting(first: usize) -> Self {
        Self { track: 0, first_track: 0, followed: 0.0, first, places: Vec::new(), wide: 0, measured: 0, variance: 0.0 }
    }

    #[cfg(test)]
    pub(super) fn of_places(first: usize, places: Vec<Option<Vector3<f64>>>) -> Self {
        let measured = places.iter().flatten().count();
        Self { places, wide: measured, measured, variance: 1e-8 * measured as f64, ..Self::starting(first) }
    }

    /// Its part in a range of frames.
    pub(super) fn within(&self, frames: std::ops::Range<usize>) -> Self {
        let places: Vec<Option<Vector3<f64>>> = frames.clone().map(|f| self.at(f)).collect();
        let measured = places.iter().flatten().count();
        Self { places, measured, variance: self.variance_m2() * measured as f64, ..Self::starting(frames.start) }
    }

    /// What the parts of one make.
    pub(super) fn together(parts: &[&Self]) -> Self {
        let first = parts.iter().map(|p| p.first).min().unwrap_or(0);
        let last = parts.iter().map(|p| p.last()).max().unwrap_or(0);
        let newest = parts.iter().max_by_key(|p| p.last()).map_or(0, |p| p.track);
        let (first_track, followed) =
            parts.iter().min_by_key(|p| p.first).map_or((0, 0.0), |p| (p.first_track, p.followed));
        let places = vec![None; last + 1 - first];
        let mut whole = Self { track: newest, first_track, followed, places, ..Self::starting(first) };
        for part in parts {
            for (k, place) in part.places.iter().enumerate().filter(|(_, p)| p.is_some()) {
                whole.places[part.first + k - first] = *place;
            }
            whole.wide += part.wide;
            whole.measured += part.measured;
            whole.variance += part.variance;
        }
        whole
    }

    pub(super) fn take_in(&mut self, index: usize, sample: &Sample) {
        self.track = sample.track;
        self.places.resize(index - self.first, None);
        self.places.push(Some(sample.point));
        self.wide += usize::from(sample.dots.len() >= 3);
        self.measured += 1;
        self.variance += sample.covariance.trace() / 3.0;
    }

    /// Loses a sample.
    pub(super) fn give_up(&mut self, index: usize, sample: &Sample) {
        self.places[index - self.first] = None;
        self.wide -= usize::from(sample.dots.len() >= 3);
        self.measured -= 1;
        self.variance -= sample.covariance.trace() / 3.0;
        let lost = self.places.iter().take_while(|p| p.is_none()).count();
        self.places.drain(..lost);
        self.first += lost;
        while self.places.last().is_some_and(Option::is_none) {
            self.places.pop();
        }
    }

    /// Whether it is so short, and seen by so few cameras, that its rays may have met by chance; `longest`: frames of such a
    /// stretch that was never seen by more than two ([`longest_flicker`]).
    pub fn is_flicker(&self, longest: usize) -> bool {
        let narrow = self.measured - self.wide;
        narrow > 0 && self.measured <= if self.wide == 0 { longest } else { FLICKER }
    }

    /// Index of the last frame.
    pub fn last(&self) -> usize {
        self.first + self.places.len() - 1
    }

    /// Usual variance of a place per axis (m²).
    pub(super) fn variance_m2(&self) -> f64 {
        self.variance / self.measured as f64
    }

    /// Usual error of a place (m).
    pub(super) fn noise(&self) -> f64 {
        (3.0 * self.variance_m2()).sqrt()
    }

    /// Position in a frame.
    pub fn at(&self, frame: usize) -> Option<Vector3<f64>> {
        frame.checked_sub(self.first).and_then(|i| self.places.get(i)).copied().flatten()
    }

    /// Number of frames in which it and another one are measured.
    pub(super) fn frames_shared(&self, other: &Self) -> usize {
        let frames =
            self.first.max(other.first)..(self.first + self.places.len()).min(other.first + other.places.len());
        frames.filter(|&f| self.at(f).is_some() && other.at(f).is_some()).count()
    }

    /// Frames in which it is measured, at most `most` of them, evenly spread.
    pub fn frames(&self, most: usize) -> Vec<usize> {
        let all: Vec<usize> = (0..self.places.len()).filter(|&i| self.places[i].is_some()).collect();
        let n = all.len().min(most);
        (0..n).map(|k| self.first + all[(2 * k + 1) * all.len() / (2 * n)]).collect()
    }
}

/// Cuts all trajectories that were ever believed. Also returns, by frame and sample, the tracklet of each measured one.
///
/// A sample goes on with the tracklet whose motion leads to it, whatever identity the forward pass gave it: that pass may
/// have given a visible marker's dots to a hidden one. Where motion is not clear, the forward pass's identity counts.
pub fn cut(frames: &[Tracked], times_s: &[f64], torn: f64) -> Cut {
    let believed = believed(frames);
    let acceleration = usual_acceleration(frames, times_s);
    let mut tracklets: Vec<Tracklet> = Vec::new();
    let mut owner: Vec<Vec<Option<usize>>> = Vec::with_capacity(frames.len());
    let mut open: Vec<usize> = Vec::new();
    let mut touching: BTreeMap<(u32, u32), bool> = BTreeMap::new();
    // Frames since a marker was last measured, and those of them with a ray.
    let mut hidden: BTreeMap<u32, [f64; 2]> = BTreeMap::new();
    for (index, frame) in frames.iter().enumerate() {
        open.retain(|&t| {
            let last = tracklets[t].last();
            index - last <= 2 || times_s[index] - times_s[last] <= SURE_GAP_S
        });
        let changed = changes_of_contact(frame, &mut touching);
        open.retain(|&t| !changed.iter().any(|c| c.0 == tracklets[t].track || c.1 == tracklets[t].track));
        let is_own = |s: &Sample| s.kind == Kind::Measured && believed.binary_search(&s.track).is_ok();
        let own: Vec<usize> = (0..frame.samples.len()).filter(|&i| is_own(&frame.samples[i])).collect();
        let ahead: Vec<Ahead> = open.iter().map(|&t| Ahead::of(&tracklets[t], index, times_s, acceleration)).collect();
        let goes_on = continuations(&ahead, own.iter().map(|&i| &frame.samples[i]), torn);
        let mut owners = vec![None; frame.samples.len()];
        for (&i, goes_on) in own.iter().zip(goes_on) {
            let tracklet = goes_on.map_or(tracklets.len(), |k| open[k]);
            if tracklet == tracklets.len() {
                let track = frame.samples[i].track;
                let followed = hidden.get(&track).map_or(0.0, |h| if h[0] == 0.0 { 1.0 } else { h[1] / h[0].max(1.0) });
                tracklets.push(Tracklet { first_track: track, followed, ..Tracklet::starting(index) });
                open.push(tracklet);
            }
            tracklets[tracklet].take_in(index, &frame.samples[i]);
            owners[i] = Some(tracklet);
        }
        owner.push(owners);
        for sample in &frame.samples {
            let own = hidden.entry(sample.track).or_default();
            if sample.kind == Kind::Measured {
                *own = [0.0; 2];
            } else {
                *own = [own[0] + 1.0, own[1] + f64::from(u8::from(!sample.dots.is_empty()))];
            }
        }
    }
    set_ends_apart(&mut tracklets, &mut owner, (frames, times_s), acceleration, torn);
    let ways: [PartsOf; 2] = [led_back, fitting_into_holes];
    for parts_of in ways {
        let parts = parts_of(&tracklets, times_s, acceleration);
        tracklets = merged(&tracklets, &parts);
        owner.iter_mut().flatten().flatten().for_each(|t| *t = parts[*t]);
    }
    trim_handovers(&mut tracklets, &mut owner, frames);
    (tracklets, owner)
}

/// Tells for each tracklet the number of the one that it is part of, by times (s) and the usual acceleration (m/s²).
type PartsOf = fn(&[Tracklet], &[f64], f64) -> Vec<usize>;

/// Measured frames up to which a stretch that only two rays ever saw may be their chance meeting: longer the rarer such
/// samples are in this take (times their rarity in nats). Where cameras are few, markers themselves are seen so.
pub(super) fn longest_flicker(tracklets: &[Tracklet]) -> usize {
    (FLICKER as f64 * rarity(tracklets).max(1.0)).round() as usize
}

/// How rare samples of only two rays are in this take (nats).
pub(super) fn rarity(tracklets: &[Tracklet]) -> f64 {
    let measured: usize = tracklets.iter().map(|t| t.measured).sum();
    let wide: usize = tracklets.iter().map(|t| t.wide).sum();
    (measured as f64 / (measured - wide).max(1) as f64).ln()
}

/// For each tracklet the number of the one that it is part of, when it fits into the hole of another: for a frame or two the
/// forward pass gave a marker's points to somebody else.
fn fitting_into_holes(tracklets: &[Tracklet], times_s: &[f64], acceleration: f64) -> Vec<usize> {
    let mut holes: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (i, one) in tracklets.iter().enumerate() {
        for (k, _) in one.places.iter().enumerate().filter(|(_, p)| p.is_none()) {
            holes.entry(one.first + k).or_default().push(i);
        }
    }
    let mut filled: Vec<(usize, usize)> = Vec::new();
    let mut host: Vec<Option<usize>> = vec![None; tracklets.len()];
    for (i, one) in tracklets.iter().enumerate().filter(|(_, t)| t.places.len() <= RUN_UP) {
        let frames: Vec<usize> = (one.first..=one.last()).filter(|&f| one.at(f).is_some()).collect();
        let mut best = Nearest::default();
        for &h in holes.get(&one.first).into_iter().flatten() {
            if frames.iter().any(|&f| tracklets[h].at(f).is_some() || filled.contains(&(h, f))) {
                continue;
            }
            let off = |f: &usize| off_the_line(&tracklets[h], *f, one.at(*f)?, times_s, acceleration);
            let offs: Option<Vec<f64>> = frames.iter().map(off).collect();
            if let Some(offs) = offs {
                best.take_in(h, offs.into_iter().fold(0.0, f64::max));
            }
        }
        let clear = best.first.filter(|b| b.1 < FARTHEST && best.second > CLEAR * b.1.max(1.0));
        // Where motion is not clear, the forward pass's identity counts.
        let named = best.first.filter(|b| tracklets[b.0].track == one.track && b.1 < TORN);
        if let Some((h, _)) = clear.or(named) {
            host[i] = Some(h);
            filled.extend(frames.into_iter().map(|f| (h, f)));
        }
    }
    numbered(&host)
}

/// How far a place is from the line between a tracklet's neighbouring places (spreads); `None` outside it.
fn off_the_line(
    tracklet: &Tracklet,
    frame: usize,
    place: Vector3<f64>,
    times_s: &[f64],
    acceleration: f64,
) -> Option<f64> {
    let before = (tracklet.first..frame).rev().find(|&f| tracklet.at(f).is_some())?;
    let after = (frame + 1..=tracklet.last()).find(|&f| tracklet.at(f).is_some())?;
    let (p, q) = (tracklet.at(before)?, tracklet.at(after)?);
    let (since_s, until_s) = (times_s[frame] - times_s[before], times_s[after] - times_s[frame]);
    let line = p + (q - p) * (since_s / (since_s + until_s));
    Some((place - line).norm() / (LEAST_SPREAD + tracklet.noise() + 0.5 * acceleration * since_s * until_s))
}

/// Numbers of wholes, by part, where `host` is what a part belongs to; a host is never a part itself.
fn numbered(host: &[Option<usize>]) -> Vec<usize> {
    let mut number = vec![0; host.len()];
    for (count, i) in (0..host.len()).filter(|&i| host[i].is_none()).enumerate() {
        number[i] = count;
    }
    for i in 0..host.len() {
        if let Some(h) = host[i] {
            number[i] = number[h];
        }
    }
    number
}

/// For each tracklet the number of the one that it is part of, when those that lead back to the end of another go on with
/// it: a marker that has just come back has no velocity yet, so that only what follows can tell.
fn led_back(tracklets: &[Tracklet], times_s: &[f64], acceleration: f64) -> Vec<usize> {
    let mut ending: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (i, one) in tracklets.iter().enumerate() {
        ending.entry(one.last()).or_default().push(i);
    }
    let mut before: Vec<Option<usize>> = vec![None; tracklets.len()];
    let mut starting: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (i, one) in tracklets.iter().enumerate().filter(|(_, t)| t.places.len() > RUN_UP) {
        starting.entry(one.first).or_default().push(i);
    }
    for (&first, started) in &starting {
        for gap in 1..=2 {
            let Some(last) = first.checked_sub(gap).filter(|l| ending.contains_key(l)) else { continue };
            let ended: Vec<usize> = ending[&last].iter().copied().filter(|e| !before.contains(&Some(*e))).collect();
            let free: Vec<usize> = started.iter().copied().filter(|&u| before[u].is_none()).collect();
            let ahead: Vec<Ahead> =
                free.iter().map(|&u| Ahead::back_from(&tracklets[u], last, times_s, acceleration)).collect();
            let places: Vec<Vector3<f64>> = ended.iter().filter_map(|&e| tracklets[e].at(last)).collect();
            for (e, k) in clear_pairs(&ahead, &places).into_iter().enumerate().filter_map(|(e, k)| k.map(|k| (e, k))) {
                let forwards = Ahead::of(&tracklets[ended[e]], first, times_s, acceleration);
                let off = tracklets[free[k]].at(first).map_or(f64::MAX, |p| forwards.off(&p));
                if off < FARTHEST {
                    before[free[k]] = Some(ended[e]);
                }
            }
        }
    }
    let mut root = before;
    for i in 0..root.len() {
        // A piece comes later than what it goes on with, whose own beginning is known by now.
        if let Some(b) = root[i] {
            root[i] = Some(root[b].unwrap_or(b));
        }
    }
    numbered(&root)
}

/// Tracklets put together from their parts.
fn merged(tracklets: &[Tracklet], parts: &[usize]) -> Vec<Tracklet> {
    let count = parts.iter().map(|p| p + 1).max().unwrap_or(0);
    let mut members: Vec<Vec<&Tracklet>> = vec![Vec::new(); count];
    parts.iter().zip(tracklets).for_each(|(&part, one)| members[part].push(one));
    members.into_iter().map(|own| Tracklet::together(&own)).collect()
}

/// Acceleration that is rarely exceeded in this take (m/s²): its 95 % quantile over what the forward pass followed.
fn usual_acceleration(frames: &[Tracked], times_s: &[f64]) -> f64 {
    let place = |f: usize, track: u32| {
        let samples = &frames[f].samples;
        let at = samples.binary_search_by_key(&track, |s| s.track).ok()?;
        (samples[at].kind == Kind::Measured).then_some(samples[at].point)
    };
    let mut found = Vec::new();
    for f in (2..frames.len()).step_by(frames.len().div_ceil(LOOKED_AT).max(1)) {
        let (early, late) = (times_s[f - 1] - times_s[f - 2], times_s[f] - times_s[f - 1]);
        for sample in frames[f].samples.iter().filter(|s| s.kind == Kind::Measured) {
            if let (Some(p), Some(q)) = (place(f - 2, sample.track), place(f - 1, sample.track)) {
                let change = (sample.point - q) / late - (q - p) / early;
                found.push(change.norm() / (0.5 * (early + late)));
            }
        }
    }
    found.sort_unstable_by(f64::total_cmp);
    found.get(found.len() * 19 / 20).copied().unwrap_or(0.0).max(LEAST_ACCELERATION)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::random::Random;
    use nalgebra::Matrix3;

    const FRAMES: usize = 600;
    const NOISE: f64 = 0.003;

    fn sample(track: u32, point: Vector3<f64>, dots: &[u32]) -> Sample {
        Sample::new(track, (point, Matrix3::identity() * NOISE * NOISE), Kind::Measured, dots, 0.99)
    }

    /// Where a marker is that swings to and fro.
    fn swinging(marker: u32, f: usize) -> Vector3<f64> {
        let t = f as f64 / 100.0;
        Vector3::new(f64::from(marker), 0.3 * (2.0 * t + f64::from(marker)).sin(), 1.0)
    }

    fn times_s() -> Vec<f64> {
        (0..FRAMES).map(|f| f as f64 / 100.0).collect()
    }

    /// With few cameras, two rays are the rule; with many, a stretch that only two ever saw is strange.
    #[test]
    fn how_long_two_rays_may_meet_by_chance_goes_by_how_rare_they_are() {
        let of = |measured: usize, wide: usize| Tracklet { wide, measured, ..Tracklet::starting(0) };
        let few_cameras = longest_flicker(&[of(1000, 400), of(500, 200), of(4, 0)]);
        let many_cameras = longest_flicker(&[of(1000, 960), of(500, 470), of(5, 0)]);
        assert_eq!((few_cameras, many_cameras), (FLICKER, 6));
        assert!(!of(5, 0).is_flicker(few_cameras) && of(5, 0).is_flicker(many_cameras));
        assert!(!of(5, 2).is_flicker(many_cameras), "a third ray is no chance");
    }

    #[test]
    fn noise_tears_nothing_out_of_a_trajectory() {
        let mut random = Random::new(5, 0);
        let mut frame = |f: usize| {
            let mut off = |place: Vector3<f64>| place.map(|x| x + NOISE * random.normal());
            let mut samples: Vec<Sample> = (0..8).map(|m| sample(m, off(swinging(m, f)), &[0, 1])).collect();
            // Now and then two rays that hardly cross put a marker far off.
            if f % 20 == 10 {
                samples[f / 20 % 8].point.x += 15.0 * NOISE;
            }
            Tracked { samples, ..Tracked::default() }
        };
        let frames: Vec<Tracked> = (0..FRAMES).map(&mut frame).collect();
        let (tracklets, _) = cut(&frames, &times_s(), TORN);
        assert_eq!(tracklets.iter().map(|t| t.measured).collect::<Vec<_>>(), [FRAMES; 8]);
    }
}
