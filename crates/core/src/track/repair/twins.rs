//! Tracklets that follow another one's marker: for some frames each of them has a part of its rays.

use super::tracklets::Tracklet;
use crate::correspond::frame::Dot;
use crate::track::duplicate::{NEAR, near};
use crate::track::{Sample, Shot, Tracked};

/// Share of a tracklet's frames in which it must have a twin.
const MOSTLY: f64 = 0.8;
/// A tracklet is much longer with more than so many times the frames.
const MUCH: usize = 2;

/// Takes out the tracklets that are, in most of their frames, in one place with a longer one and seen by other cameras.
pub fn without_twins(
    tracklets: Vec<Tracklet>,
    mut owner: Vec<Vec<Option<usize>>>,
    frames: &[Tracked],
    shots: &[Shot],
) -> (Vec<Tracklet>, Vec<Vec<Option<usize>>>) {
    let mut beside = vec![0.0; tracklets.len()];
    for ((frame, owner), shot) in frames.iter().zip(&owner).zip(shots) {
        for (a, b) in pairs_in_one_place(frame, owner, &shot.dots) {
            beside[if is_twin(&tracklets[a], &tracklets[b]) { a } else { b }] += 1.0;
        }
    }
    let mut number = 0;
    let mut new_number = Vec::with_capacity(tracklets.len());
    for (tracklet, beside) in tracklets.iter().zip(beside) {
        let stays = beside < MOSTLY * tracklet.measured as f64;
        new_number.push(stays.then_some(number));
        number += usize::from(stays);
    }
    owner.iter_mut().flatten().for_each(|t| *t = t.and_then(|t| new_number[t]));
    let kept = tracklets.into_iter().zip(&new_number).filter(|(_, n)| n.is_some()).map(|(t, _)| t).collect();
    (kept, owner)
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
        let (tracklets, owner) = cut(&frames, &times_s, TORN);
        let (kept, owner) = without_twins(tracklets, owner, &frames, &vec![Shot { dots, lag_s: Vec::new() }; 100]);
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
}
