//! Tracklets that follow another one's marker: for some frames each of them has a part of its rays.

use super::tracklets::Tracklet;
use crate::correspond::frame::Dot;
use crate::track::duplicate::{NEAR, near};
use crate::track::{Sample, Tracked};

/// Share of a tracklet's frames in which it must have a twin.
const MOSTLY: f64 = 0.8;

/// Takes out the tracklets that are, in most of their frames, in one place with a longer one and seen by other cameras.
pub fn without_twins(
    tracklets: Vec<Tracklet>,
    mut owner: Vec<Vec<Option<usize>>>,
    frames: &[Tracked],
    dots: &[Vec<Dot>],
) -> (Vec<Tracklet>, Vec<Vec<Option<usize>>>) {
    let mut beside = vec![0.0; tracklets.len()];
    for ((frame, owner), dots) in frames.iter().zip(&owner).zip(dots) {
        for (a, b) in pairs_in_one_place(frame, owner, dots) {
            let length = |t: usize| (tracklets[t].measured, t);
            beside[if length(a) < length(b) { a } else { b }] += 1.0;
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
