//! Stretches of a trajectory within which the identity is beyond doubt.
//!
//! A recorded trajectory is cut where a marker was hidden for more than a moment, where two markers came so near
//! that they may have been exchanged, and where the forward pass gave one marker's points to another. What belongs
//! together is decided anew, with the whole take in view (`join.rs`).

use crate::track::{Kind, Sample, Tracked};
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// Hidden for longer (s), or for more frames than two, a marker may come back as another one.
const SURE_GAP_S: f64 = 0.025;
/// Two markers come into contact when nearer than this, and part when farther than that (m).
const CONTACT: f64 = 0.008;
const PARTED: f64 = 0.020;

/// Frames before the last from which a tracklet's velocity is taken.
const RUN_UP: usize = 2;
/// A place is off its prediction by the usual acceleration at least so much (m), and without a velocity by this speed (m/s).
const LEAST_SPREAD: f64 = 0.002;
const UNKNOWN_SPEED: f64 = 3.0;
/// Motion leads to a sample up to this many spreads away, and clearly so if the next is this many times as far.
const FARTHEST: f64 = 1.5;
const CLEAR: f64 = 3.0;
/// An uncertain motion (m) does not lead to what the forward pass took for another marker.
const SURE_SPREAD: f64 = 0.012;
/// Farther away, the forward pass's identity does not count either (spreads).
pub const TORN: f64 = 3.0;
/// The same for points of other systems, which jump now and then.
pub const TORN_POINTS: f64 = 40.0;
/// The usual acceleration: from about so many frames, at least (m/s²).
const LOOKED_AT: usize = 500;
const LEAST_ACCELERATION: f64 = 5.0;
/// Two tracklets so near to each other (in their usual errors) may be two halves of one marker's rays.
const BESIDE: f64 = 10.0;
/// Measured frames up to which a stretch may be a chance meeting of rays.
const FLICKER: usize = 2;

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
    fn starting(first: usize) -> Self {
        Self { track: 0, first_track: 0, followed: 0.0, first, places: Vec::new(), wide: 0, measured: 0, variance: 0.0 }
    }

    #[cfg(test)]
    pub(super) fn of_places(first: usize, places: Vec<Option<Vector3<f64>>>) -> Self {
        let measured = places.iter().flatten().count();
        Self { places, wide: measured, measured, variance: 1e-8 * measured as f64, ..Self::starting(first) }
    }

    fn together(parts: &[&Self]) -> Self {
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

    fn take_in(&mut self, index: usize, sample: &Sample) {
        self.track = sample.track;
        self.places.resize(index - self.first, None);
        self.places.push(Some(sample.point));
        self.wide += usize::from(sample.dots.len() >= 3);
        self.measured += 1;
        self.variance += sample.covariance.trace() / 3.0;
    }

    /// Loses a sample at one of its ends.
    fn give_up(&mut self, index: usize, sample: &Sample) {
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

    /// Whether it is so short, and seen by so few cameras, that its rays may have met by chance.
    pub fn is_flicker(&self) -> bool {
        self.measured <= FLICKER && self.wide < self.measured
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
    fn noise(&self) -> f64 {
        (3.0 * self.variance_m2()).sqrt()
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
///
/// A sample goes on with the tracklet whose motion leads to it, whatever identity the forward pass gave it: that pass may
/// have given a visible marker's dots to a hidden one. Where motion is not clear, the forward pass's identity counts.
pub fn cut(frames: &[Tracked], times_s: &[f64], torn: f64) -> (Vec<Tracklet>, Vec<Vec<Option<usize>>>) {
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
    let ways: [PartsOf; 2] = [led_back, fitting_into_holes];
    for parts_of in ways {
        let parts = parts_of(&tracklets, times_s, acceleration);
        tracklets = merged(&tracklets, &parts);
        owner.iter_mut().flatten().flatten().for_each(|t| *t = parts[*t]);
    }
    trim_handovers(&mut tracklets, &mut owner, frames);
    (tracklets, owner)
}

/// Where one tracklet ends and another begins beside it, the forward pass handed a marker over; in a frame or two it had it
/// twice, each with some of its rays. Of the two the one that fewer cameras saw is shortened: else they could not be one.
fn trim_handovers(tracklets: &mut [Tracklet], owner: &mut [Vec<Option<usize>>], frames: &[Tracked]) {
    let mut beginning: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (i, one) in tracklets.iter().enumerate() {
        beginning.entry(one.first).or_default().push(i);
    }
    for a in 0..tracklets.len() {
        for back in 0..RUN_UP {
            let last = tracklets[a].last();
            let Some(first) = last.checked_sub(back).filter(|f| *f > tracklets[a].first) else { continue };
            for &b in beginning.get(&first).into_iter().flatten() {
                if !is_handover(&tracklets[a], &tracklets[b]) {
                    continue;
                }
                let share = |t: usize| tracklets[t].wide as f64 / tracklets[t].measured as f64;
                let shortened = if share(a) < share(b) { a } else { b };
                for f in first..=last {
                    if let Some(s) = owner[f].iter().position(|o| *o == Some(shortened)) {
                        owner[f][s] = None;
                        tracklets[shortened].give_up(f, &frames[f].samples[s]);
                    }
                }
            }
        }
    }
}

/// Whether a tracklet begins where another ends, beside it, so that they may be one marker.
fn is_handover(ended: &Tracklet, begun: &Tracklet) -> bool {
    let (first, last) = (begun.first, ended.last());
    let reach = BESIDE * ended.noise().hypot(begun.noise());
    let is_beside = |f: usize| match (ended.at(f), begun.at(f)) {
        (Some(p), Some(q)) => (p - q).norm() < reach,
        _ => true,
    };
    ended.first < first && first <= last && last < begun.last() && (first..=last).all(is_beside)
}

/// Tells for each tracklet the number of the one that it is part of, by times (s) and the usual acceleration (m/s²).
type PartsOf = fn(&[Tracklet], &[f64], f64) -> Vec<usize>;

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
                let off = tracklets[free[k]].at(first).map_or(f64::MAX, |p| (p - forwards.point).norm());
                if off < FARTHEST * forwards.spread {
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

/// Where a tracklet leads.
struct Ahead {
    track: u32,
    point: Vector3<f64>,
    /// How far off that may be (m).
    spread: f64,
}

impl Ahead {
    fn of(tracklet: &Tracklet, index: usize, times_s: &[f64], acceleration: f64) -> Self {
        let last = tracklet.last();
        let newest = tracklet.places[tracklet.places.len() - 1].unwrap_or_default();
        let dt_s = times_s[index] - times_s[last];
        let before = (tracklet.first..last).rev().take(RUN_UP).find_map(|f| tracklet.at(f).map(|p| (f, p)));
        let (point, lag_s, speed) = match before {
            Some((f, p)) => {
                let lag_s = times_s[last] - times_s[f];
                (newest + (newest - p) * (dt_s / lag_s), lag_s, 0.0)
            }
            None => (newest, 0.0, UNKNOWN_SPEED),
        };
        let spread = LEAST_SPREAD + speed * dt_s + 0.5 * acceleration * dt_s * (dt_s + lag_s);
        Self { track: tracklet.track, point, spread }
    }

    /// Where a tracklet comes from: its place in a frame before its first.
    fn back_from(tracklet: &Tracklet, index: usize, times_s: &[f64], acceleration: f64) -> Self {
        let first = tracklet.first;
        let oldest = tracklet.places[0].unwrap_or_default();
        let dt_s = times_s[first] - times_s[index];
        let later = (first + 1..=tracklet.last()).take(RUN_UP).find_map(|f| tracklet.at(f).map(|p| (f, p)));
        let (velocity, lag_s) = later.map_or((Vector3::zeros(), RUN_UP as f64 * dt_s), |(f, p)| {
            let lag_s = times_s[f] - times_s[first];
            ((p - oldest) / lag_s, lag_s)
        });
        let spread = LEAST_SPREAD + 0.5 * acceleration * dt_s * (dt_s + lag_s);
        Self { track: tracklet.track, point: oldest - velocity * dt_s, spread }
    }
}

/// For each place, the index of what clearly leads to it.
fn clear_pairs(ahead: &[Ahead], places: &[Vector3<f64>]) -> Vec<Option<usize>> {
    let mut of_place = vec![Nearest::default(); places.len()];
    let mut of_ahead = vec![Nearest::default(); ahead.len()];
    for (k, one) in ahead.iter().enumerate() {
        for (s, place) in places.iter().enumerate() {
            let off = (place - one.point).norm() / one.spread;
            of_place[s].take_in(k, off);
            of_ahead[k].take_in(s, off);
        }
    }
    let clearly = |s: usize| {
        let (k, _) = of_place[s].first?;
        let (back, off) = of_ahead[k].first?;
        let second = of_place[s].second.min(of_ahead[k].second);
        (back == s && off < FARTHEST && second > CLEAR * off.max(1.0)).then_some(k)
    };
    (0..places.len()).map(clearly).collect()
}

/// For each sample, the index of what it goes on with.
fn continuations<'a>(ahead: &[Ahead], samples: impl Iterator<Item = &'a Sample>, torn: f64) -> Vec<Option<usize>> {
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
            !taken[*k] && one.track == sample.track && (sample.point - one.point).norm() < torn * one.spread
        };
        *found = (0..ahead.len()).find(goes_on);
        found.iter().for_each(|&k| taken[k] = true);
    }
    found
}

/// The nearest candidate, and how far the second is (spreads).
#[derive(Clone, Copy)]
struct Nearest {
    first: Option<(usize, f64)>,
    second: f64,
}

impl Default for Nearest {
    fn default() -> Self {
        Self { first: None, second: f64::INFINITY }
    }
}

impl Nearest {
    fn take_in(&mut self, who: usize, off: f64) {
        match self.first {
            Some((_, best)) if off >= best => self.second = self.second.min(off),
            first => {
                self.second = first.map_or(f64::INFINITY, |f| f.1);
                self.first = Some((who, off));
            }
        }
    }
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

    #[test]
    fn of_two_that_hand_a_marker_over_the_narrower_loses_the_frame_in_which_both_have_it() {
        let places = [swinging(0, 0), swinging(0, 0) + Vector3::x() * 0.04];
        let frame = |f: usize| {
            let of = |(track, place): (u32, &Vector3<f64>)| {
                let dots: &[u32] = if track == 0 { &[0, 1] } else { &[2, 3, 4] };
                (if track == 0 { f <= 50 } else { f >= 50 }).then(|| sample(track, *place, dots))
            };
            Tracked { samples: (0..).zip(&places).filter_map(of).collect(), ..Tracked::default() }
        };
        let frames: Vec<Tracked> = (0..100).map(frame).collect();
        let mut tracklets = vec![Tracklet::starting(0), Tracklet::starting(50)];
        let mut owner = Vec::new();
        for (f, frame) in frames.iter().enumerate() {
            frame.samples.iter().for_each(|s| tracklets[s.track as usize].take_in(f, s));
            owner.push(frame.samples.iter().map(|s| Some(s.track as usize)).collect::<Vec<_>>());
        }
        trim_handovers(&mut tracklets, &mut owner, &frames);
        let spans: Vec<(usize, usize)> = tracklets.iter().map(|t| (t.first, t.last())).collect();
        assert_eq!(spans, [(0, 49), (50, 99)]);
        assert_eq!(owner[50], [None, Some(1)], "the sample is nobody's any more");
        assert_eq!((tracklets[0].measured, tracklets[1].wide), (50, 50));
    }
}
