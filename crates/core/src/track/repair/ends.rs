//! The ends of tracklets, where the forward pass is least sure of them.

use super::ahead::{Ahead, RUN_UP};
use super::tracklets::Tracklet;
use crate::track::Tracked;
use std::collections::BTreeMap;

/// Another one's motion leads better by so much (squared spreads).
const BETTER: f64 = 4.0;
/// Two tracklets so near to each other (in their usual errors) may be two halves of one marker's rays.
const BESIDE: f64 = 10.0;

/// Makes a tracklet of its own of each first or last sample to which the motion of the others does not lead, or that of
/// another tracklet leads better: a marker that has just come back has no velocity, and one that is about to vanish may be
/// taken for another one that comes back.
pub(super) fn set_ends_apart(
    tracklets: &mut Vec<Tracklet>,
    owner: &mut [Vec<Option<usize>>],
    (frames, times_s): (&[Tracked], &[f64]),
    acceleration: f64,
    torn: f64,
) {
    let mut beginning: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (t, one) in tracklets.iter().enumerate().filter(|(_, t)| t.measured > RUN_UP) {
        beginning.entry(one.first).or_default().push(t);
    }
    let mut apart: Vec<(usize, usize, usize)> = Vec::new();
    for t in (0..tracklets.len()).filter(|&t| tracklets[t].measured > 1) {
        for end in [tracklets[t].first, tracklets[t].last()] {
            let Some(s) = owner[end].iter().position(|o| *o == Some(t)) else { continue };
            let place = &frames[end].samples[s].point;
            let mut rest = tracklets[t].clone();
            rest.give_up(end, &frames[end].samples[s]);
            let to_end = if end < rest.first { Ahead::back_from } else { Ahead::of };
            let off = to_end(&rest, end, times_s, acceleration).off(place);
            let back = |u: &usize| Ahead::back_from(&tracklets[*u], end, times_s, acceleration).off(place);
            let next = (1..=RUN_UP).filter_map(|k| beginning.get(&(end + k))).flatten();
            let other = next.filter(|u| **u != t).map(back).fold(f64::INFINITY, f64::min);
            let hidden = if end < rest.first { rest.first - end } else { end - rest.last() } > 1;
            let better = if hidden { 0.0 } else { BETTER };
            if off > torn || off * off > other * other + better {
                apart.push((t, end, s));
            }
        }
    }
    for (t, end, s) in apart {
        if tracklets[t].measured == 1 {
            continue;
        }
        let sample = &frames[end].samples[s];
        let mut alone = Tracklet { first_track: sample.track, ..Tracklet::starting(end) };
        alone.take_in(end, sample);
        tracklets[t].give_up(end, sample);
        if end < tracklets[t].first {
            // The forward pass came to what is set apart, and from there to the rest.
            alone.followed = std::mem::take(&mut tracklets[t].followed);
        }
        owner[end][s] = Some(tracklets.len());
        tracklets.push(alone);
    }
}

/// Where one tracklet ends and another begins beside it, the forward pass handed a marker over; in a frame or two it had it
/// twice, each with some of its rays. Of the two the one that fewer cameras saw is shortened: else they could not be one.
pub(super) fn trim_handovers(tracklets: &mut [Tracklet], owner: &mut [Vec<Option<usize>>], frames: &[Tracked]) {
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

#[cfg(test)]
mod tests {
    use super::super::tracklets::{TORN, cut};
    use super::*;
    use crate::track::{Kind, Sample};
    use nalgebra::{Matrix3, Vector3};

    const FRAMES: usize = 200;

    fn sample(track: u32, point: Vector3<f64>, dots: &[u32]) -> Sample {
        Sample::new(track, (point, Matrix3::identity() * 1e-6), Kind::Measured, dots, 0.99)
    }

    /// Pieces of two markers on their way, so far apart (m), by what the forward pass called each where it was seen: first
    /// and last frame, and how far it gets off its own way (m).
    fn pieces(apart_m: f64, name: impl Fn(u32, usize) -> Option<u32>) -> Vec<(usize, usize, f64)> {
        let frame = |f: usize| {
            let place = |m: u32| Vector3::new(0.004 * f as f64, apart_m * f64::from(m), 1.0);
            let seen = (0..2).filter_map(|m| Some(sample(name(m, f)?, place(m), &[0, 1, 2])));
            let mut samples: Vec<Sample> = seen.collect();
            samples.sort_by_key(|s| s.track);
            Tracked { samples, ..Tracked::default() }
        };
        let frames: Vec<Tracked> = (0..FRAMES).map(frame).collect();
        let times_s: Vec<f64> = (0..FRAMES).map(|f| f as f64 / 100.0).collect();
        let (tracklets, _) = cut(&frames, &times_s, TORN);
        let jump = |t: &Tracklet| {
            let y: Vec<f64> = t.places.iter().flatten().map(|p| p.y).collect();
            y.iter().fold(0.0, |most: f64, v| most.max((v - y[0]).abs()))
        };
        tracklets.iter().map(|t| (t.first, t.last(), jump(t))).collect()
    }

    #[test]
    fn a_first_sample_that_is_anothers_is_given_back() {
        // Both come back after a while, the one a frame later; the forward pass gives its identity to the other at first.
        let name = |m: u32, f: usize| match (m, f) {
            (_, 80..100) | (0, 100) => None,
            (1, 100) => Some(0),
            _ => Some(m),
        };
        let found = pieces(0.075, name);
        assert!(found.iter().all(|p| p.2 < 0.005), "{found:?}");
        assert!(found.iter().any(|p| (p.0, p.1) == (100, FRAMES - 1)), "{found:?}");
    }

    #[test]
    fn a_last_sample_that_is_anothers_is_given_back() {
        // The one was hidden, and comes back when the other vanishes.
        let name = |m: u32, f: usize| match (m, f) {
            (0, 60..100) | (1, 99..130) => None,
            (0, 100) => Some(1),
            _ => Some(m),
        };
        let found = pieces(0.009, name);
        assert!(found.iter().all(|p| p.2 < 0.005), "{found:?}");
    }

    #[test]
    fn of_two_that_hand_a_marker_over_the_narrower_loses_the_frame_in_which_both_have_it() {
        let places = [Vector3::z(), Vector3::z() + Vector3::x() * 0.02];
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
