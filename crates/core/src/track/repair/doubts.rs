//! Moments from which on a tracklet may be another marker: it was hidden before, the forward pass takes it for another one
//! from then on, or a marker passes it that is hidden then.

use super::tracklets::Cut;
use crate::track::{Kind, Sample, Tracked};
use std::collections::BTreeMap;

/// A hidden marker that comes nearer than this passes (m).
const PASSING: f64 = 0.02;

/// How near a hidden marker has come to a tracklet so far (m), and the index of the frame.
type Nearest = (f64, usize);

/// For each tracklet the indices of such frames, in ascending order.
pub(super) fn doubts((tracklets, owner): &Cut, frames: &[Tracked]) -> Vec<Vec<usize>> {
    let mut found: Vec<Vec<usize>> = vec![Vec::new(); tracklets.len()];
    let mut last: Vec<Option<(usize, u32)>> = vec![None; tracklets.len()];
    let mut passing: BTreeMap<(usize, u32), Nearest> = BTreeMap::new();
    for (index, (frame, owner)) in frames.iter().zip(owner).enumerate() {
        let before = std::mem::take(&mut passing);
        for (sample, t) in frame.samples.iter().zip(owner).filter_map(|(s, t)| Some((s, (*t)?))) {
            if last[t].replace((index, sample.track)).is_some_and(|before| before != (index - 1, sample.track)) {
                found[t].push(index);
            }
            for (track, apart_m) in passing_by(sample, frame) {
                let own = (apart_m, index);
                let nearest = before.get(&(t, track)).copied().filter(|n| n.0 < apart_m).unwrap_or(own);
                passing.insert((t, track), nearest);
            }
        }
        for (key @ (t, _), (_, at)) in before {
            if !passing.contains_key(&key) {
                found[t].push(at);
            }
        }
    }
    passing.into_iter().for_each(|((t, _), (_, at))| found[t].push(at));
    for (own, tracklet) in found.iter_mut().zip(tracklets) {
        own.retain(|&f| f > tracklet.first);
        own.sort_unstable();
        own.dedup();
    }
    found
}

/// Hidden markers that pass a measured one in a frame, by track, and how far they are from it (m).
fn passing_by<'a>(sample: &'a Sample, frame: &'a Tracked) -> impl Iterator<Item = (u32, f64)> + 'a {
    let hidden = frame.samples.iter().filter(|s| s.kind == Kind::Predicted);
    hidden.map(|s| (s.track, (s.point - sample.point).norm())).filter(|(_, apart_m)| *apart_m < PASSING)
}

#[cfg(test)]
mod tests {
    use super::super::tracklets::Tracklet;
    use super::*;
    use nalgebra::{Matrix3, Vector3};

    /// What is in doubt of one tracklet: the forward pass's name and place (m) of it in each frame, and of a hidden marker.
    fn doubts_of(seen: &[Option<(u32, f64)>], hidden: impl Fn(usize) -> Option<f64>) -> Vec<usize> {
        let sample = |(track, x): (u32, f64), kind: Kind| {
            Sample::new(track, (Vector3::new(x, 0.0, 0.0), Matrix3::identity() * 1e-6), kind, &[], 0.9)
        };
        let frame = |(index, own): (usize, &Option<(u32, f64)>)| {
            let own = own.map(|own| sample(own, Kind::Measured));
            let other = hidden(index).map(|x| sample((9, x), Kind::Predicted));
            Tracked { samples: own.into_iter().chain(other).collect(), ..Tracked::default() }
        };
        let frames: Vec<Tracked> = seen.iter().enumerate().map(frame).collect();
        let owned = |f: &Tracked| f.samples.iter().map(|s| (s.kind == Kind::Measured).then_some(0)).collect();
        let owner = frames.iter().map(owned).collect();
        let places = seen.iter().map(|s| s.map(|(_, x)| Vector3::new(x, 0.0, 0.0))).collect();
        doubts(&(vec![Tracklet::of_places(0, places)], owner), &frames).remove(0)
    }

    #[test]
    fn a_marker_that_is_seen_all_the_time_is_beyond_doubt() {
        assert!(doubts_of(&[Some((3, 0.0)); 20], |_| Some(0.05)).is_empty());
    }

    #[test]
    fn one_that_comes_back_or_gets_another_name_is_in_doubt_from_then_on() {
        let mut seen = [Some((3, 0.0)); 20];
        seen[7] = None;
        seen[12..].fill(Some((4, 0.0)));
        assert_eq!(doubts_of(&seen, |_| None), [8, 12]);
    }

    #[test]
    fn one_that_a_hidden_marker_passes_is_in_doubt_where_they_were_nearest() {
        let passing = |index: usize| Some(0.005 * (index as f64 - 10.2));
        assert_eq!(doubts_of(&[Some((3, 0.0)); 20], passing), [10]);
        assert_eq!(doubts_of(&[Some((3, 0.0)); 12], passing), [10], "it is still near at the end");
    }
}
