//! Identities that active markers told, over a whole take: they stand above all that motion and neighbours say.
//!
//! Where two or more dots of a sample tell the same identity, the sample belongs to that identity's trajectory: the one that
//! tells it most often. Samples between go with what is told nearest to them in time on their own trajectory. Where that
//! puts two into one place of a frame, the one that tells stays.

use super::super::{Sample, Shot, Tracked};
use std::collections::BTreeMap;

/// Dots that must tell an identity.
const TELLERS: usize = 2;

/// Hands samples over to the trajectories of the identities they tell. Nothing changes where no dot tells one.
pub fn follow_told(frames: &mut [Tracked], shots: &[Shot]) {
    let told: Vec<Vec<Option<u32>>> =
        frames.iter().zip(shots).map(|(f, shot)| f.samples.iter().map(|s| told_by(s, shot)).collect()).collect();
    if told.iter().flatten().all(Option::is_none) {
        return;
    }
    let home = homes(frames, &told);
    let nearest = nearest_told(frames, &told);
    let taken: Vec<u32> = home.values().copied().collect();
    for ((frame, told), nearest) in frames.iter_mut().zip(&told).zip(nearest) {
        let mut renamed: Vec<(u32, bool, Sample)> = Vec::with_capacity(frame.samples.len());
        for ((sample, told), nearest) in frame.samples.drain(..).zip(told).zip(nearest) {
            let hardware = told.or(nearest);
            let track = hardware.map_or(sample.track, |h| home[&h]);
            // A trajectory that is an identity's home keeps nobody else's samples.
            if hardware.is_some() || !taken.contains(&track) {
                renamed.push((track, told.is_none(), Sample { track, hardware, ..sample }));
            }
        }
        renamed.sort_by_key(|(track, is_silent, _)| (*track, *is_silent));
        renamed.dedup_by_key(|r| r.0);
        frame.samples = renamed.into_iter().map(|r| r.2).collect();
    }
}

fn told_by(sample: &Sample, shot: &Shot) -> Option<u32> {
    let told: Vec<u32> = sample.dots.iter().filter_map(|&d| shot.dots[d as usize].hardware).collect();
    (told.len() >= TELLERS && told.iter().all(|t| *t == told[0])).then(|| told[0])
}

/// The trajectory of each identity: the one that tells it most often, and each trajectory is one identity's at most.
fn homes(frames: &[Tracked], told: &[Vec<Option<u32>>]) -> BTreeMap<u32, u32> {
    let mut counts: BTreeMap<(u32, u32), usize> = BTreeMap::new();
    let mut next = 0;
    for (frame, told) in frames.iter().zip(told) {
        for (sample, told) in frame.samples.iter().zip(told) {
            next = next.max(sample.track + 1);
            if let Some(hardware) = told {
                *counts.entry((*hardware, sample.track)).or_default() += 1;
            }
        }
    }
    let mut by_count: Vec<((u32, u32), usize)> = counts.into_iter().collect();
    by_count.sort_by_key(|((hardware, track), n)| (std::cmp::Reverse(*n), *hardware, *track));
    let mut home: BTreeMap<u32, u32> = BTreeMap::new();
    for ((hardware, track), _) in &by_count {
        if !home.contains_key(hardware) && home.values().all(|t| t != track) {
            home.insert(*hardware, *track);
        }
    }
    for ((hardware, _), _) in &by_count {
        home.entry(*hardware).or_insert_with(|| {
            next += 1;
            next - 1
        });
    }
    home
}

/// For each sample, the identity told nearest in time on its trajectory.
fn nearest_told(frames: &[Tracked], told: &[Vec<Option<u32>>]) -> Vec<Vec<Option<u32>>> {
    let mut nearest: Vec<Vec<Option<(usize, u32)>>> = told.iter().map(|t| vec![None; t.len()]).collect();
    let n = frames.len();
    let (forwards, backwards): (Vec<usize>, Vec<usize>) = ((0..n).collect(), (0..n).rev().collect());
    for order in [forwards, backwards] {
        let mut last: BTreeMap<u32, (usize, u32)> = BTreeMap::new();
        for index in order {
            for (k, sample) in frames[index].samples.iter().enumerate() {
                if let Some(hardware) = told[index][k] {
                    last.insert(sample.track, (index, hardware));
                }
                let Some(&(at, hardware)) = last.get(&sample.track) else { continue };
                let away = at.abs_diff(index);
                if nearest[index][k].is_none_or(|(other, _)| away < other) {
                    nearest[index][k] = Some((away, hardware));
                }
            }
        }
    }
    nearest.into_iter().map(|frame| frame.into_iter().map(|n| n.map(|n| n.1)).collect()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::correspond::frame::Dot;
    use crate::track::Kind;
    use nalgebra::{Matrix3, Vector3};

    /// Two markers that tell 7 and 9 until frame 10 and from frame 20 on; the tracker took them for each other from 15 on.
    fn swapped() -> (Vec<Tracked>, Vec<Shot>) {
        let frame = |k: usize| {
            let sample = |track: u32, x: f64, dots: &[u32]| {
                Sample::new(track, (Vector3::new(x, 0.0, 0.0), Matrix3::identity()), Kind::Measured, dots, 1.0)
            };
            let (left, right) = (sample(0, 0.0, &[0, 1]), sample(1, 1.0, &[2, 3]));
            let (left, right) =
                if k < 15 { (left, right) } else { (Sample { track: 1, ..left }, Sample { track: 0, ..right }) };
            let mut samples = vec![left, right];
            samples.sort_by_key(|s| s.track);
            Tracked { samples, ..Tracked::default() }
        };
        let shot = |k: usize| {
            let dot = |camera: usize, hardware: u32| {
                let told = !(10..20).contains(&k);
                Dot { camera, pixel: [0.0, 0.0], sigma: 1.0, hardware: told.then_some(hardware) }
            };
            Shot { dots: vec![dot(0, 7), dot(1, 7), dot(0, 9), dot(1, 9)], lag_s: Vec::new() }
        };
        ((0..40).map(frame).collect(), (0..40).map(shot).collect())
    }

    #[test]
    fn a_swap_is_undone_where_the_markers_tell() {
        let (mut frames, shots) = swapped();
        follow_told(&mut frames, &shots);
        for frame in frames.iter().take(15).chain(frames.iter().skip(20)) {
            let left = frame.samples.iter().find(|s| s.point.x < 0.5).unwrap();
            let right = frame.samples.iter().find(|s| s.point.x > 0.5).unwrap();
            assert_eq!((left.hardware, right.hardware), (Some(7), Some(9)));
            assert_ne!(left.track, right.track);
        }
        let track = |k: usize| frames[k].samples.iter().find(|s| s.point.x < 0.5).map(|s| s.track);
        assert_eq!(track(0), track(39));
    }

    #[test]
    fn nothing_changes_where_nothing_is_told() {
        let (mut frames, mut shots) = swapped();
        shots.iter_mut().flat_map(|s| &mut s.dots).for_each(|d| d.hardware = None);
        let before: Vec<Vec<u32>> = frames.iter().map(|f| f.samples.iter().map(|s| s.track).collect()).collect();
        follow_told(&mut frames, &shots);
        let after: Vec<Vec<u32>> = frames.iter().map(|f| f.samples.iter().map(|s| s.track).collect()).collect();
        assert_eq!(before, after);
    }
}
