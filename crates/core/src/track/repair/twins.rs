//! Tracklets that follow another one's marker: for some frames each of them has a part of its rays, or they have it by
//! turns.

use super::tracklets::{Cut, Tracklet};
use crate::correspond::frame::Dot;
use crate::track::duplicate::{NEAR, near};
use crate::track::{Sample, Shot, Tracked};
use std::collections::BTreeMap;

/// Share of a tracklet's frames in which it must have a twin; or of the frames in which both are seen.
const MOSTLY: f64 = 0.8;
/// A tracklet is much longer with more than so many times the frames.
const MUCH: usize = 2;

/// Takes out the tracklets that are, in most of their frames, in one place with a longer one and seen by other cameras; and
/// makes one of those that are so wherever both are seen.
pub fn without_twins((tracklets, mut owner): Cut, frames: &[Tracked], shots: &[Shot]) -> Cut {
    let mut together = Together::new();
    for ((frame, owner), shot) in frames.iter().zip(&owner).zip(shots) {
        for (a, b) in pairs_in_one_place(frame, owner, &shot.dots) {
            *together.entry((a.min(b), a.max(b))).or_default() += 1;
        }
    }
    let mut beside = vec![0; tracklets.len()];
    for (&(a, b), n) in &together {
        beside[if is_twin(&tracklets[a], &tracklets[b]) { a } else { b }] += n;
    }
    let stays: Vec<bool> = tracklets.iter().zip(beside).map(|(t, n)| !is_mostly(n, t.measured)).collect();
    together.retain(|&(a, b), _| stays[a] && stays[b]);
    owner.iter_mut().flatten().for_each(|t| *t = t.filter(|&t| stays[t]));
    one_of_each((tracklets, owner), frames, &together, &stays)
}

/// In how many frames two tracklets, the earlier first, are in one place and seen by different cameras.
type Together = BTreeMap<(usize, usize), usize>;

fn is_mostly(some: usize, all: usize) -> bool {
    some as f64 >= MOSTLY * all as f64
}

/// Puts together the tracklets that are one marker; where both are seen, the one with more rays counts.
fn one_of_each((mut tracklets, mut owner): Cut, frames: &[Tracked], together: &Together, stays: &[bool]) -> Cut {
    let whole = wholes(&tracklets, together);
    for (f, (frame, owner)) in frames.iter().zip(&mut owner).enumerate() {
        let mut best: BTreeMap<usize, usize> = BTreeMap::new();
        for s in 0..owner.len() {
            let Some(t) = owner[s] else { continue };
            let Some(&known) = best.get(&whole[t]) else {
                best.insert(whole[t], s);
                continue;
            };
            let is_wider = frame.samples[s].dots.len() > frame.samples[known].dots.len();
            let (kept, lost) = if is_wider { (s, known) } else { (known, s) };
            best.insert(whole[t], kept);
            if let Some(t) = owner[lost].take() {
                tracklets[t].give_up(f, &frame.samples[lost]);
            }
        }
    }
    let roots = (0..tracklets.len()).filter(|&t| stays[t] && whole[t] == t);
    let number: BTreeMap<usize, usize> = roots.enumerate().map(|(n, t)| (t, n)).collect();
    owner.iter_mut().flatten().for_each(|t| *t = t.map(|t| number[&whole[t]]));
    let mut parts: Vec<Vec<&Tracklet>> = vec![Vec::new(); number.len()];
    let own = (0..tracklets.len()).filter(|&t| stays[t] && tracklets[t].measured > 0);
    own.for_each(|t| parts[number[&whole[t]]].push(&tracklets[t]));
    (parts.iter().map(|own| Tracklet::together(own)).collect(), owner)
}

/// For each tracklet the first of those that are one marker with it: in one place wherever both are seen.
fn wholes(tracklets: &[Tracklet], together: &Together) -> Vec<usize> {
    let in_one_place = |a: usize, b: usize| {
        let both = tracklets[a].frames_shared(&tracklets[b]);
        is_mostly(together.get(&(a.min(b), a.max(b))).copied().unwrap_or(0), both)
    };
    let mut members: Vec<Vec<usize>> = (0..tracklets.len()).map(|t| vec![t]).collect();
    let mut whole: Vec<usize> = (0..tracklets.len()).collect();
    let mut pairs: Vec<(usize, (usize, usize))> = together.iter().map(|(&pair, &n)| (n, pair)).collect();
    pairs.sort_by_key(|&(n, pair)| (std::cmp::Reverse(n), pair));
    for (_, (a, b)) in pairs {
        let [first, second] = [whole[a].min(whole[b]), whole[a].max(whole[b])];
        let fits = |a: &usize| members[second].iter().all(|b| in_one_place(*a, *b));
        if first != second && members[first].iter().all(fits) {
            let other = std::mem::take(&mut members[second]);
            other.iter().for_each(|&t| whole[t] = first);
            members[first].extend(other);
        }
    }
    whole
}

/// Whether of two tracklets in one place the first is the twin: the much shorter one, or else (both are short where markers
/// come into contact) the one that was hidden just before.
fn is_twin(one: &Tracklet, other: &Tracklet) -> bool {
    if one.measured.max(other.measured) > MUCH * one.measured.min(other.measured) {
        return one.measured < other.measured;
    }
    (one.followed, one.wide) < (other.followed, other.wide)
}

/// Tracklets whose samples are in one place, each seen by other cameras.
fn pairs_in_one_place(frame: &Tracked, owner: &[Option<usize>], dots: &[Dot]) -> Vec<(usize, usize)> {
    let mut own: Vec<(&Sample, usize)> =
        frame.samples.iter().zip(owner).filter_map(|(s, t)| t.map(|t| (s, t))).collect();
    own.sort_by(|a, b| a.0.point.x.total_cmp(&b.0.point.x).then(a.1.cmp(&b.1)));
    let cameras = |s: &Sample| s.dots.iter().fold(0u128, |mask, &d| mask | (1 << dots[d as usize].camera));
    let mut found = Vec::new();
    for (k, (one, a)) in own.iter().enumerate() {
        let reach = own[k + 1..].iter().take_while(|(other, _)| other.point.x - one.point.x < NEAR);
        for (other, b) in reach {
            let here = near(&(one.point, one.covariance), &(other.point, other.covariance));
            if here && cameras(one) & cameras(other) == 0 {
                found.push((*a, *b));
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::super::tracklets::{TORN, cut};
    use super::*;
    use crate::track::Kind;
    use nalgebra::{Matrix3, Vector3};

    /// A marker on its way, seen by cameras 0–2, and another `apart` (m) from it in frames 40–45, seen by `cameras`.
    fn kept(apart: f64, cameras: [usize; 2]) -> usize {
        let dot = |camera| Dot { camera, pixel: [0.0, 0.0], sigma: 1.0, hardware: None };
        let dots: Vec<Dot> = [0, 1, 2].into_iter().chain(cameras).map(dot).collect();
        let sample = |track, x, dots: &[u32]| {
            let state = (Vector3::new(x, 0.0, 1.0), Matrix3::identity() * 1e-6);
            Sample::new(track, state, Kind::Measured, dots, 0.9)
        };
        let frame = |f: usize| {
            let x = 0.01 * f as f64;
            let mut samples = vec![sample(0, x, &[0, 1, 2])];
            if (40..46).contains(&f) {
                samples.push(sample(1, x + apart, &[3, 4]));
            }
            Tracked { samples, ..Tracked::default() }
        };
        let frames: Vec<Tracked> = (0..100).map(frame).collect();
        let times_s: Vec<f64> = (0..100).map(|f| f64::from(f) / 100.0).collect();
        let shots = vec![Shot { dots, lag_s: Vec::new() }; 100];
        let (kept, owner) = without_twins(cut(&frames, &times_s, TORN), &frames, &shots);
        let last = owner.iter().flatten().flatten().max().copied();
        assert_eq!(last, kept.len().checked_sub(1), "owners are numbered anew");
        usize::from(kept.iter().any(|t| t.track == 1))
    }

    #[test]
    fn a_twin_goes_and_a_neighbour_stays() {
        assert_eq!(kept(0.001, [3, 4]), 0);
        assert_eq!(kept(0.001, [2, 3]), 1, "one camera sees both: they are two");
        assert_eq!(kept(0.030, [3, 4]), 1, "too far apart to be one");
    }

    /// Measured frames of what becomes of a marker that one trajectory has until frame 42, by cameras 0–2, and another from
    /// frame 40 on, `apart` (m) from it, by cameras 2–3 or 3–4.
    fn shared(apart: f64, cameras: [usize; 2]) -> Vec<usize> {
        let dot = |camera| Dot { camera, pixel: [0.0, 0.0], sigma: 1.0, hardware: None };
        let dots: Vec<Dot> = [0, 1, 2].into_iter().chain(cameras).map(dot).collect();
        let sample = |track, x, dots: &[u32]| {
            let state = (Vector3::new(x, 0.0, 1.0), Matrix3::identity() * 1e-5);
            Sample::new(track, state, Kind::Measured, dots, 0.9)
        };
        let frame = |f: usize| {
            let x = 0.01 * f as f64;
            let one = (f <= 42).then(|| sample(0, x, &[0, 1, 2]));
            let other = (f >= 40).then(|| sample(1, x + apart, &[3, 4]));
            Tracked { samples: one.into_iter().chain(other).collect(), ..Tracked::default() }
        };
        let frames: Vec<Tracked> = (0..100).map(frame).collect();
        let times_s: Vec<f64> = (0..100).map(|f| f64::from(f) / 100.0).collect();
        let shots = vec![Shot { dots, lag_s: Vec::new() }; 100];
        let (kept, owner) = without_twins(cut(&frames, &times_s, TORN), &frames, &shots);
        let mut counts = vec![0; kept.len()];
        owner.iter().flatten().flatten().for_each(|&t| counts[t] += 1);
        assert_eq!(counts, kept.iter().map(|t| t.measured).collect::<Vec<_>>());
        counts
    }

    #[test]
    fn two_that_have_one_marker_by_turns_become_one() {
        assert_eq!(shared(0.010, [3, 4]), [100]);
        assert_eq!(shared(0.010, [2, 3]), [43, 60], "one camera sees both: they are two");
        assert_eq!(shared(0.030, [3, 4]), [43, 60], "too far apart to be one");
    }
}
