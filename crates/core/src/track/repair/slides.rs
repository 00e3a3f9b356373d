//! Tracklets that slid from one marker to another that passed by, found out by whose chain each of their parts fits.
//!
//! Where two markers meet and one of them is hidden, the forward pass may go on with the other: nothing in the motion shows
//! it, and the links of a short piece tell too little (`breaks.rs`). But the chains tell from the whole take how far each
//! marker is from the others. Between the frames in which a tracklet met another one or was hidden, it is one marker; which
//! chain's it is in each of these parts is found for all of them at once (Viterbi 1967): how well its distances fit, less
//! what motion says against a change.

use super::breaks::chain_of;
use super::bridge::ACCELERATION;
use super::exchange::IMPOSSIBLE;
use super::join::{Distances, Link, Scene};
use super::tracklets::Tracklet;
use nalgebra::Vector3;
use rayon::prelude::*;
use std::ops::Range;

/// Two markers nearer than this have met (m), and for how long before and after they were seen they may have (s).
const MET: f64 = 0.04;
const AFTER_S: f64 = 0.12;
/// Parts are at least so long (measured frames).
const SHORTEST: usize = 8;
/// Time before and after the moment of a change in which it is looked for (s).
const ABOUT_S: f64 = 0.12;
/// What motion says against a change where a marker was seen all the time, and where it was hidden (nats).
const SEEN: f64 = 11.0;
const HIDDEN: f64 = 3.0;
/// A part counts once, and once more for each second, up to so many times.
const MOST_LOOKS: f64 = 5.0;

/// A frame from which on a tracklet may be another marker.
#[derive(Clone, Copy)]
struct Moment {
    frame: usize,
    /// What a change costs (nats).
    change: f64,
}

/// For each tracklet the frames from which on it is another chain's marker.
pub(super) fn slides(scene: &Scene) -> Vec<Vec<usize>> {
    let profiles: Vec<Vec<Link>> = (0..scene.chains.len()).into_par_iter().map(|c| scene.profile(c)).collect();
    let chain_of = chain_of(scene);
    (0..scene.tracklets.len()).into_par_iter().map(|t| scene.slides_of(t, chain_of[t], &profiles)).collect()
}

impl Scene<'_> {
    fn slides_of(&self, tracklet: usize, chain: usize, profiles: &[Vec<Link>]) -> Vec<usize> {
        let one = &self.tracklets[tracklet];
        let moments = self.moments(one);
        if moments.is_empty() || chain == usize::MAX {
            return Vec::new();
        }
        let starts: Vec<usize> = std::iter::once(one.first).chain(moments.iter().map(|m| m.frame)).collect();
        let end = |k: usize| starts.get(k + 1).copied().unwrap_or(one.last() + 1);
        let evidence = |k: usize| {
            let own = self.without(chain, tracklet, starts[k]..end(k));
            self.evidence_of(&one.within(starts[k]..end(k)), (chain, &own), profiles)
        };
        let evidence: Vec<Vec<f64>> = (0..starts.len()).map(evidence).collect();
        let changes: Vec<f64> = std::iter::once(0.0).chain(moments.iter().map(|m| m.change)).collect();
        let whose = likeliest(&evidence, &changes);
        let changed = (1..starts.len()).filter(|&k| whose[k] != whose[k - 1]);
        let about = self.frames_in(ABOUT_S);
        let sharper = |k: usize| {
            // Where it was hidden, that is when.
            one.at(starts[k] - 1)?;
            let within = starts[k].saturating_sub(about).max(starts[k - 1] + 1)..(starts[k] + about).min(end(k));
            self.change_between(one, chain, [whose[k - 1], whose[k]].map(|c| (c, profiles[c].as_slice())), within)
        };
        changed.map(|k| sharper(k).unwrap_or(starts[k])).collect()
    }

    /// The frame within some from which on a tracklet is likelier the other chain's than the one's.
    fn change_between(
        &self,
        one: &Tracklet,
        own: usize,
        [(a, before), (b, after)]: [(usize, &[Link]); 2],
        within: Range<usize>,
    ) -> Option<usize> {
        let nats = |frame: usize| {
            let place = one.at(frame)?;
            let others = self.by_frame[frame].iter().filter(|(other, _)| *other != own);
            let seen = [others.map(|(other, p)| (*other, (p - place).norm())).collect::<Distances>()];
            // A marker is not in two places.
            let [stays, goes] = [(a, before), (b, after)].map(|(chain, profile)| {
                let elsewhere = chain != own && self.by_frame[frame].iter().any(|(other, _)| *other == chain);
                if elsewhere { IMPOSSIBLE } else { Self::links_beside(profile, &seen, [a, b]) }
            });
            Some((frame, stays - goes))
        };
        let mut total = 0.0;
        let mut best: Option<(f64, usize)> = None;
        for (frame, for_the_one) in within.filter_map(nats) {
            if best.is_none_or(|(most, _)| total > most) {
                best = Some((total, frame));
            }
            total += for_the_one;
        }
        best.map(|(_, frame)| frame)
    }

    /// The links of a chain without a part of one of its tracklets.
    fn without(&self, chain: usize, tracklet: usize, part: Range<usize>) -> Vec<Link> {
        let one = &self.tracklets[tracklet];
        let rest = [one.first..part.start, part.end..one.last() + 1].map(|frames| one.within(frames));
        let others = self.chains[chain].tracklets.iter().filter(|&&t| t != tracklet).map(|&t| &self.tracklets[t]);
        let left: Vec<&Tracklet> = others.chain(rest.iter().filter(|r| r.measured > 0)).collect();
        self.profile_by(&left, &[chain])
    }

    /// By chain, how well a part fits it (nats); what is seen elsewhere meanwhile it cannot be.
    fn evidence_of(&self, part: &Tracklet, own: (usize, &[Link]), profiles: &[Vec<Link>]) -> Vec<f64> {
        let seen = self.distances_by(&[part]);
        let count = (1.0 + self.times_s[part.last()] - self.times_s[part.first]).min(MOST_LOOKS);
        let fits = |chain: usize| {
            let profile = if chain == own.0 { own.1 } else { &profiles[chain] };
            let elsewhere = chain != own.0 && {
                let shared = self.chains[chain].tracklets.iter().map(|&t| self.tracklets[t].frames_shared(part));
                2 * shared.sum::<usize>() > part.measured
            };
            (!elsewhere).then(|| count * Self::links_beside(profile, &seen, [chain, own.0]))
        };
        (0..self.chains.len()).map(|c| fits(c).unwrap_or(f64::NEG_INFINITY)).collect()
    }

    /// Where a tracklet may go on with another marker: it was hidden, or met another one.
    fn moments(&self, one: &Tracklet) -> Vec<Moment> {
        let returns = (one.first + 1..=one.last()).filter(|&f| one.at(f).is_some() && one.at(f - 1).is_none());
        let mut all: Vec<Moment> = returns.map(|frame| Moment { frame, change: HIDDEN }).collect();
        all.extend(self.meetings(one).into_iter().map(|frame| Moment { frame, change: SEEN }));
        // Where it was hidden a change is likelier.
        all.sort_by(|a, b| a.change.total_cmp(&b.change).then(a.frame.cmp(&b.frame)));
        let mut apart: Vec<Moment> = Vec::new();
        for moment in all {
            let at = apart.partition_point(|m| m.frame < moment.frame);
            let from = at.checked_sub(1).map_or(one.first, |before| apart[before].frame);
            let to = apart.get(at).map_or(one.last() + 1, |m| m.frame);
            if [from..moment.frame, moment.frame..to].iter().all(|r| one.within(r.clone()).measured >= SHORTEST) {
                apart.insert(at, moment);
            }
        }
        apart
    }

    /// Frames in which a tracklet came nearest to where another one was or may have been.
    fn meetings(&self, one: &Tracklet) -> Vec<usize> {
        let (mut found, after) = (Vec::new(), self.frames_in(AFTER_S));
        for other in self.tracklets.iter().filter(|other| !std::ptr::eq(*other, one)) {
            let frames = one.first.max(other.first.saturating_sub(after))..=one.last().min(other.last() + after);
            let mut nearest: Option<(f64, usize)> = None;
            for frame in frames {
                let Some(place) = one.at(frame) else { continue };
                let off = self.reach(other, frame).map_or(1.0, |(p, reach)| (place - p).norm() / reach);
                if off >= 1.0 {
                    found.extend(nearest.take().map(|n| n.1));
                } else if nearest.is_none_or(|n| off < n.0) {
                    nearest = Some((off, frame));
                }
            }
            found.extend(nearest.map(|n| n.1));
        }
        found
    }

    fn frames_in(&self, time_s: f64) -> usize {
        (time_s / self.frame_s()).round() as usize
    }

    /// Where a tracklet is in a frame, or may be for a while before and after, and how near that is met (m).
    fn reach(&self, other: &Tracklet, frame: usize) -> Option<(Vector3<f64>, f64)> {
        if let Some(place) = other.at(frame) {
            return Some((place, MET));
        }
        let at_end = frame > other.last();
        let end = if at_end { other.last() } else { other.first };
        let dt_s = self.times_s[frame] - self.times_s[end];
        let velocity = self.velocity(other, at_end).unwrap_or_default();
        let outside = at_end || frame < other.first;
        outside.then_some((other.at(end)? + velocity * dt_s, MET + 0.5 * ACCELERATION * dt_s * dt_s))
    }
}

/// For each part the likeliest chain, by the evidence of each and what a change before each part costs (nats).
fn likeliest(evidence: &[Vec<f64>], changes: &[f64]) -> Vec<usize> {
    let chains = evidence.first().map_or(0, Vec::len);
    let mut ways = vec![0.0_f64; chains];
    let mut from: Vec<Vec<usize>> = Vec::new();
    for (evidence, change) in evidence.iter().zip(changes) {
        let best = (0..chains).max_by(|a, b| ways[*a].total_cmp(&ways[*b]).then(b.cmp(a))).unwrap_or(0);
        let before = (0..chains).map(|c| if ways[c] >= ways[best] - change { c } else { best });
        let before: Vec<usize> = before.collect();
        ways =
            (0..chains).map(|c| (if before[c] == c { ways[c] } else { ways[best] - change }) + evidence[c]).collect();
        from.push(before);
    }
    let mut chain = (0..chains).max_by(|a, b| ways[*a].total_cmp(&ways[*b]).then(b.cmp(a))).unwrap_or(0);
    let mut whose = vec![0; evidence.len()];
    for (part, from) in from.iter().enumerate().rev() {
        whose[part] = chain;
        chain = from[chain];
    }
    whose
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::track::repair::join::Chain;
    use nalgebra::Rotation3;

    const FRAMES: usize = 1600;
    /// Two markers meet in this frame.
    const MEET: usize = 800;

    /// Where a marker of one of two bodies is, each of which turns in its own way.
    fn place(body: usize, at: [f64; 3], f: usize) -> Vector3<f64> {
        let t = (f as f64 - MEET as f64) / 100.0;
        let way = [1.0, -1.0][body];
        let turn = Rotation3::from_euler_angles(way * t, 0.5 * (1.3 * t).sin(), 0.8 * way * t);
        turn * Vector3::from(at) + body as f64 * Vector3::from(ASIDE) + Vector3::new(0.2 * way * t, 0.1 * t, 1.0)
    }

    /// How far the second body is from the first when they meet.
    const ASIDE: [f64; 3] = [0.3, 0.1, 0.0];

    const CORNERS: [[f64; 3]; 4] = [[0.2, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.2], [-0.1, -0.1, 0.1]];
    /// The markers of the bodies that meet.
    const MEETING: [[f64; 3]; 2] = [[0.15, 0.05, 0.0], [-0.15, -0.05, 0.0]];

    /// What is found where a tracklet of the one body's chain is another body's marker from a frame on: that one was hidden
    /// shortly before they met, and the one whose place it takes shortly after.
    fn found(body_after: usize, from: usize) -> Vec<Vec<usize>> {
        let seen = |body: usize, at: [f64; 3], frames: Range<usize>| {
            Tracklet::of_places(frames.start, frames.map(|f| Some(place(body, at, f))).collect())
        };
        let mut tracklets: Vec<Tracklet> = (0..8).map(|k| seen(k / 4, CORNERS[k % 4], 0..FRAMES)).collect();
        let of_body = |body: usize, f: usize| place(body, MEETING[body], f);
        let slid = (650..900).map(|f| Some(of_body(if f < from { 0 } else { body_after }, f)));
        tracklets.push(Tracklet::of_places(650, slid.collect()));
        tracklets.push(seen(0, MEETING[0], 0..650));
        tracklets.push(seen(0, MEETING[0], 900..FRAMES));
        tracklets.push(seen(1, MEETING[1], 0..MEET - 5));
        let mut chains: Vec<Chain> = (0..8).map(|t| Chain::of(&tracklets, vec![t])).collect();
        chains.push(Chain::of(&tracklets, vec![9, 8, 10]));
        chains.push(Chain::of(&tracklets, vec![11]));
        let times_s: Vec<f64> = (0..FRAMES).map(|f| f as f64 / 100.0).collect();
        slides(&Scene::new(&tracklets, &times_s, &chains, &[]))
    }

    #[test]
    fn a_tracklet_that_slides_onto_another_bodys_marker_is_cut_where_they_met() {
        let found = found(1, MEET);
        assert!(found.iter().enumerate().all(|(t, f)| (t == 8) != f.is_empty()), "{found:?}");
        assert!(found[8].len() == 1 && found[8][0].abs_diff(MEET) <= 5, "{found:?}");
    }

    #[test]
    fn one_that_only_met_another_stays_whole() {
        assert!(found(0, MEET).iter().all(Vec::is_empty));
    }

    /// Every way to change is the oracle.
    #[test]
    fn the_likeliest_chains_are_found() {
        const PARTS: usize = 5;
        const CHAINS: usize = 3;
        for case in 0..30_usize {
            let number = |k: usize, c: usize| ((case * 7 + k * 31 + c * 13) % 17) as f64;
            let evidence: Vec<Vec<f64>> = (0..PARTS).map(|k| (0..CHAINS).map(|c| number(k, c)).collect()).collect();
            let changes: Vec<f64> = (0..PARTS).map(|k| number(k, 5)).collect();
            let way = |n: usize| -> Vec<usize> { (0..PARTS).map(|k| n / CHAINS.pow(k as u32) % CHAINS).collect() };
            let worth = |whose: &[usize]| -> f64 {
                let change = |k: usize| if k > 0 && whose[k] != whose[k - 1] { changes[k] } else { 0.0 };
                (0..PARTS).map(|k| evidence[k][whose[k]] - change(k)).sum()
            };
            let best = (0..CHAINS.pow(PARTS as u32)).map(|n| worth(&way(n))).fold(f64::MIN, f64::max);
            assert!((worth(&likeliest(&evidence, &changes)) - best).abs() < 1e-9, "case {case}");
        }
    }
}
