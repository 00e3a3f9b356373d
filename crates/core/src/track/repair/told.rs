//! Identities that active markers told, over a whole take: they stand above all that motion and neighbours say.
//!
//! Where the dots' brightness is known, each trajectory is read with all its cameras together (`active/along.rs`), and a
//! sample belongs to the LED that it most likely is. Otherwise, where two or more dots of a sample tell the same identity,
//! the sample belongs to that identity's trajectory: the one that tells it most often. Samples between go with what is told
//! nearest to them in time on their own trajectory. Where that puts two into one place of a frame, the surer one stays.

use super::super::{Kind, Sample, Shot, Tracked};
use super::Lights;
use crate::active::along::{Reading, Seen, Stretch, read};
use crate::active::levels::Light;
use crate::correspond::scene::Scene;
use std::collections::BTreeMap;

/// Dots that must tell an identity.
const TELLERS: usize = 2;
/// Frames in a row that a stretch may lack.
const LONGEST_HOLE: usize = 3;
/// A reading below this probability names nobody.
const LIKELIER_THAN_NOT: f64 = 0.5;

/// What a sample told.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Word {
    Nothing,
    /// That it is none of the LEDs.
    Nobody,
    /// Its identity, and how sure that is (0–1).
    Identity(u32, f64),
}

/// Hands samples over to the trajectories of the identities they tell. Nothing changes where no dot tells one.
pub fn follow_told(
    frames: &mut [Tracked],
    shots: &[Shot],
    scenes: &[(usize, &Scene)],
    times_s: &[f64],
    lights: Option<Lights>,
) -> bool {
    let by_dots: Vec<Vec<Word>> =
        frames.iter().zip(shots).map(|(f, shot)| f.samples.iter().map(|s| told_by(s, shot)).collect()).collect();
    if by_dots.iter().flatten().all(|w| *w == Word::Nothing) {
        return false;
    }
    let told = lights.and_then(|l| read_along(frames, shots, scenes, times_s, l)).unwrap_or(by_dots);
    let home = homes(frames, &told);
    let nearest = nearest_told(frames, &told);
    let taken: Vec<u32> = home.values().copied().collect();
    for ((frame, told), nearest) in frames.iter_mut().zip(&told).zip(nearest) {
        let mut renamed: Vec<(f64, Sample)> = Vec::with_capacity(frame.samples.len());
        for ((sample, told), nearest) in frame.samples.drain(..).zip(told).zip(nearest) {
            let (hardware, chance) = match told {
                Word::Identity(hardware, chance) => (Some(*hardware), *chance),
                Word::Nothing => (nearest, 0.0),
                Word::Nobody => (None, 0.0),
            };
            let track = hardware.map_or(sample.track, |h| home[&h]);
            // A trajectory that is an identity's home keeps nobody else's samples.
            if hardware.is_some() || !taken.contains(&track) {
                renamed.push((chance, Sample { track, hardware, ..sample }));
            }
        }
        renamed.sort_by(|a, b| a.1.track.cmp(&b.1.track).then(b.0.total_cmp(&a.0)));
        renamed.dedup_by_key(|r| r.1.track);
        frame.samples = renamed.into_iter().map(|r| r.1).collect();
    }
    true
}

fn told_by(sample: &Sample, shot: &Shot) -> Word {
    let told: Vec<u32> = sample.dots.iter().filter_map(|&d| shot.dots[d as usize].hardware).collect();
    let agreed = told.len() >= TELLERS && told.iter().all(|t| *t == told[0]);
    if agreed { Word::Identity(told[0], 1.0) } else { Word::Nothing }
}

/// What the samples tell when all cameras are read together; `None` where identities and brightness are no LEDs' of ours.
fn read_along(
    frames: &[Tracked],
    shots: &[Shot],
    scenes: &[(usize, &Scene)],
    times_s: &[f64],
    lights: Lights,
) -> Option<Vec<Vec<Word>>> {
    let mut told: Vec<Vec<Word>> = frames.iter().map(|f| vec![Word::Nothing; f.samples.len()]).collect();
    let mut stretches: Vec<Stretch> = Vec::new();
    let mut places: Vec<Vec<(usize, usize)>> = Vec::new();
    let mut open: BTreeMap<u32, usize> = BTreeMap::new();
    for (index, (frame, shot)) in frames.iter().zip(shots).enumerate() {
        let mut owners = vec![0; shot.dots.len()];
        frame.samples.iter().flat_map(|s| &s.dots).for_each(|&d| owners[d as usize] += 1);
        let scene = scenes.iter().rev().find(|s| s.0 <= index)?.1;
        for (k, sample) in frame.samples.iter().enumerate().filter(|(_, s)| s.kind == Kind::Measured) {
            let goes_on = open
                .get(&sample.track)
                .copied()
                .filter(|&s| places[s].last().is_some_and(|&(before, _)| index - before <= LONGEST_HOLE));
            let stretch = goes_on.unwrap_or(stretches.len());
            if stretch == stretches.len() {
                stretches.push(Stretch { track: sample.track, ..Stretch::default() });
                places.push(Vec::new());
                open.insert(sample.track, stretch);
            }
            let seen = |&d: &u32| {
                let dot = &shot.dots[d as usize];
                let away = (sample.point - scene.rig.cameras[dot.camera].position_m).norm();
                let ln_brightness = lights.brightness[lights.starts[index] + d as usize].ln();
                let light = Light { ln_brightness, ln_distance: away.max(1e-3).ln() };
                Seen { camera: dot.camera, light, told: dot.hardware.map(|h| h as usize) }
            };
            stretches[stretch].frames.push(lights.frames[index]);
            stretches[stretch].times_s.push(times_s[index]);
            stretches[stretch].places.push(sample.point);
            let alone = sample.dots.iter().filter(|d| owners[**d as usize] == 1);
            stretches[stretch].dots.push(alone.map(seen).filter(|s| s.light.ln_brightness.is_finite()).collect());
            places[stretch].push((index, k));
        }
    }
    for (places, readings) in places.iter().zip(read(&stretches)?) {
        for (&(index, k), Reading { word, chance }) in places.iter().zip(readings) {
            told[index][k] = match word {
                _ if chance < LIKELIER_THAN_NOT => Word::Nothing,
                Some(word) => Word::Identity(word as u32, chance),
                None => Word::Nobody,
            };
        }
    }
    Some(told)
}

/// The trajectory of each identity: the one that tells it most often, and each trajectory is one identity's at most.
fn homes(frames: &[Tracked], told: &[Vec<Word>]) -> BTreeMap<u32, u32> {
    let mut counts: BTreeMap<(u32, u32), usize> = BTreeMap::new();
    let mut next = 0;
    for (frame, told) in frames.iter().zip(told) {
        for (sample, told) in frame.samples.iter().zip(told) {
            next = next.max(sample.track + 1);
            if let Word::Identity(hardware, _) = told {
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
fn nearest_told(frames: &[Tracked], told: &[Vec<Word>]) -> Vec<Vec<Option<u32>>> {
    let mut nearest: Vec<Vec<Option<(usize, u32)>>> = told.iter().map(|t| vec![None; t.len()]).collect();
    let n = frames.len();
    let (forwards, backwards): (Vec<usize>, Vec<usize>) = ((0..n).collect(), (0..n).rev().collect());
    for order in [forwards, backwards] {
        let mut last: BTreeMap<u32, (usize, u32)> = BTreeMap::new();
        for index in order {
            for (k, sample) in frames[index].samples.iter().enumerate() {
                if let Word::Identity(hardware, _) = told[index][k] {
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
        follow_told(&mut frames, &shots, &[], &[], None);
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
        follow_told(&mut frames, &shots, &[], &[], None);
        let after: Vec<Vec<u32>> = frames.iter().map(|f| f.samples.iter().map(|s| s.track).collect()).collect();
        assert_eq!(before, after);
    }
}
