//! Trajectories prolonged into their gaps: a marker that comes back is followed backwards in time to the moment when two
//! cameras first saw it, and one that got lost forwards to the last such moment.
//!
//! The same prediction, assignment and multi-view check as in the forward pass, on the dots that nobody owns.

use super::super::filter::{Filter, Step};
use super::super::flow::Motion;
use super::super::frame::Frame;
use super::super::locate::{LocateGates, Located, locate};
use super::super::matching::{Prior, match_cameras};
use super::super::{Kind, Sample, Shot, Tracked};
use super::scene_of;
use crate::correspond::scene::Scene;
use std::collections::{BTreeMap, BTreeSet};

/// Samples from which the motion at a gap is learned.
const RUN_UP: usize = 8;
/// Frames in a row that may be missed before the search is given up, and time without a ray (s).
const PATIENCE_S: f64 = 0.03;
/// Acceleration of a marker at a gap (m/s²), and of a push.
const ACCELERATION: f64 = 30.0;
const PUSH: f64 = 100.0;

/// Frames at the beginning of a take into which the forward pass went without knowing how anything moves.
const BEGINNING: usize = 5;
/// So many rays do not meet by chance.
const NO_CHANCE: usize = 3;

/// One trajectory on its way into a gap.
struct Runner {
    filter: Filter,
    last: usize,
    confidence: f64,
}

/// Prolongs all trajectories backwards and forwards. `identity` in the samples must be final.
///
/// `scenes`: the index of the first frame from which on each holds, in ascending order from 0.
pub fn extend(scenes: &[(usize, &Scene)], shots: &[Shot], times_s: &[f64], frames: &mut [Tracked]) {
    for forwards in [false, true] {
        run(scenes, shots, times_s, frames, forwards);
    }
}

/// Takes out what was measured in the first frames, so that it is found again backwards in time, by markers whose motion is
/// known. What comes back only later, and could not be, stays. By frame, what was taken out.
pub fn forget_the_beginning(frames: &mut [Tracked]) -> Vec<Vec<Sample>> {
    if frames.len() < 2 * BEGINNING {
        return Vec::new();
    }
    let tracks = |part: &[Tracked]| -> BTreeSet<u32> { part.iter().flat_map(measured).map(|s| s.track).collect() };
    let (soon, later) = (tracks(&frames[BEGINNING..2 * BEGINNING]), tracks(&frames[2 * BEGINNING..]));
    let stays = |s: &Sample| later.contains(&s.track) && !soon.contains(&s.track);
    let forget = |frame: &mut Tracked| {
        let (stay, forgotten) = std::mem::take(&mut frame.samples).into_iter().partition(stays);
        frame.samples = stay;
        forgotten
    };
    frames[..BEGINNING].iter_mut().map(forget).collect()
}

/// Puts back what was `forgotten` of the first frames and not found again, where nothing else has its dots by now: of
/// trajectories that enough rays saw not to be their chance meeting.
pub fn recall_the_beginning(frames: &mut [Tracked], forgotten: Vec<Vec<Sample>>) {
    let lost = |(frame, samples): (&Tracked, Vec<Sample>)| -> Vec<Sample> {
        let is_lost = |s: &Sample| {
            frame.samples.iter().all(|own| own.track != s.track && own.dots.iter().all(|d| !s.dots.contains(d)))
        };
        samples.into_iter().filter(is_lost).collect()
    };
    let lost: Vec<Vec<Sample>> = frames.iter().zip(forgotten).map(lost).collect();
    let sure: BTreeSet<u32> = lost.iter().flatten().filter(|s| s.dots.len() >= NO_CHANCE).map(|s| s.track).collect();
    for (frame, lost) in frames.iter_mut().zip(lost) {
        frame.samples.extend(lost.into_iter().filter(|s| sure.contains(&s.track)));
        frame.samples.sort_by_key(|s| s.track);
    }
}

fn run(scenes: &[(usize, &Scene)], shots: &[Shot], times_s: &[f64], frames: &mut [Tracked], forwards: bool) {
    let gates = LocateGates::new(scenes[0].1);
    let n = frames.len();
    let mut runners: BTreeMap<u32, Runner> = BTreeMap::new();
    let mut recent: BTreeMap<u32, Vec<(usize, Sample)>> = BTreeMap::new();
    for step in 0..n {
        let index = if forwards { step } else { n - 1 - step };
        let here: Vec<u32> = measured(&frames[index]).map(|s| s.track).collect();
        for track in &here {
            runners.remove(track);
        }
        start_runners(&mut runners, &recent, &here, index, times_s);
        advance(&mut runners, index, times_s);
        if !runners.is_empty() {
            let scene = scene_of(scenes, index);
            let found = search(scene, &gates, &shots[index], &frames[index], &mut runners, (index, forwards));
            insert(&mut frames[index], found);
        }
        for sample in measured(&frames[index]) {
            let own = recent.entry(sample.track).or_default();
            own.push((index, sample.clone()));
            if own.len() > RUN_UP {
                own.remove(0);
            }
        }
    }
}

fn measured(frame: &Tracked) -> impl Iterator<Item = &Sample> {
    frame.samples.iter().filter(|s| s.kind == Kind::Measured)
}

/// A trajectory that was there in the frame before and is not in this one sets off.
fn start_runners(
    runners: &mut BTreeMap<u32, Runner>,
    recent: &BTreeMap<u32, Vec<(usize, Sample)>>,
    here: &[u32],
    index: usize,
    times_s: &[f64],
) {
    for (&track, samples) in recent {
        let Some((last, sample)) = samples.last() else { continue };
        let just_left = last.abs_diff(index) == 1;
        if !just_left || runners.contains_key(&track) || here.contains(&track) {
            continue;
        }
        let mut filter: Option<Filter> = None;
        let mut before = 0;
        for (at, one) in samples {
            match &mut filter {
                None => filter = Some(Filter::new(one.point, &one.covariance, ACCELERATION)),
                Some(f) => {
                    f.predict(&Step::new((times_s[*at] - times_s[before]).abs()), ACCELERATION);
                    let prior = *f.covariance();
                    if let Some(gain) = (prior + one.covariance).try_inverse().map(|i| prior * i) {
                        let point = f.position + gain * (one.point - f.position);
                        f.update(point, &(prior - gain * prior));
                    }
                }
            }
            before = *at;
        }
        if let Some(filter) = filter {
            runners.insert(track, Runner { filter, last: *last, confidence: sample.confidence });
        }
    }
}

/// Time update of all runners; those without a ray for long give up.
fn advance(runners: &mut BTreeMap<u32, Runner>, index: usize, times_s: &[f64]) {
    runners.retain(|_, r| r.last.abs_diff(index) <= 2 || (times_s[index] - times_s[r.last]).abs() <= PATIENCE_S);
    for runner in runners.values_mut() {
        let neighbour = if index > runner.last { index - 1 } else { index + 1 };
        runner.filter.predict(&Step::new((times_s[index] - times_s[neighbour]).abs()), ACCELERATION);
    }
}

fn search(
    scene: &Scene,
    gates: &LocateGates,
    shot: &Shot,
    tracked: &Tracked,
    runners: &mut BTreeMap<u32, Runner>,
    (index, forwards): (usize, bool),
) -> Vec<Sample> {
    let mut frame = Frame::new(scene, &shot.dots);
    frame.lag_s.clone_from(&shot.lag_s);
    tracked.samples.iter().flat_map(|s| &s.dots).for_each(|&d| frame.free[d as usize] = false);
    let step = Step::new(0.01);
    let jump = PUSH * PUSH * step.jump_variance();
    let priors: Vec<Option<Prior>> = runners
        .values()
        .map(|r| {
            let motion = r.filter.motion();
            // Backwards in time the filter's velocity points against the marker's.
            let motion = if forwards { motion } else { Motion { velocity: -motion.velocity, ..motion } };
            let (point, covariance) = (r.filter.position, *r.filter.covariance());
            Some(Prior { point, covariance, push: jump, hidden: false, hardware: None, must_tell: false, motion })
        })
        .collect();
    let mut found = found_on_free_dots(scene, gates, &frame, &priors).into_iter().peekable();
    let mut samples = Vec::new();
    for (k, ((track, runner), prior)) in runners.iter_mut().zip(&priors).enumerate() {
        let Some((_, located)) = found.next_if(|(who, _)| *who == k) else { continue };
        let sample = prior.as_ref().and_then(|p| located.sample(&frame, *track, p, runner.confidence));
        let Some(sample) = sample else { continue };
        runner.filter.update(sample.point, &sample.covariance);
        runner.last = index;
        samples.push(sample);
    }
    samples
}

/// Where markers are found by two free dots or more, with their index, in ascending order.
pub(super) fn found_on_free_dots(
    scene: &Scene,
    gates: &LocateGates,
    frame: &Frame,
    priors: &[Option<Prior>],
) -> Vec<(usize, Located)> {
    let found = match_cameras(scene, frame, priors, |_, _| true);
    let located = |(who, mut dots): (usize, Vec<u32>)| {
        dots.sort_unstable();
        let prior = priors[who].as_ref().filter(|_| dots.len() >= 2)?;
        let located = locate(scene, gates, frame, &dots, prior).filter(|l| l.dots.len() >= 2)?;
        Some((who, located))
    };
    found.into_iter().enumerate().filter_map(located).collect()
}

fn insert(frame: &mut Tracked, found: Vec<Sample>) {
    let tracks: Vec<u32> = found.iter().map(|s| s.track).collect();
    frame.samples.retain(|s| !tracks.contains(&s.track));
    frame.samples.extend(found);
    frame.samples.sort_by_key(|s| s.track);
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Vector3};

    fn sample(track: u32, dots: &[u32]) -> Sample {
        Sample::new(track, (Vector3::zeros(), Matrix3::identity() * 1e-6), Kind::Measured, dots, 0.9)
    }

    /// A take in which a marker is seen by these dots in the first frames and from a frame on by three.
    fn take(first: &[&[u32]], from: usize) -> Vec<Tracked> {
        let frame = |index: usize| {
            let dots = first.get(index).copied().or((index >= from).then_some(&[0, 1, 2][..]));
            Tracked { samples: dots.map(|d| sample(4, d)).into_iter().collect(), ..Tracked::default() }
        };
        (0..4 * BEGINNING).map(frame).collect()
    }

    fn seen(frames: &[Tracked]) -> Vec<usize> {
        (0..BEGINNING).filter(|&f| !frames[f].samples.is_empty()).collect()
    }

    #[test]
    fn what_is_not_found_again_of_the_first_frames_comes_back_if_enough_rays_saw_it() {
        for (first, from, stays, back) in [
            (&[&[0, 1, 2][..], &[0, 1]][..], 0, vec![], vec![0, 1]),
            (&[&[0, 1, 2], &[0, 1]], usize::MAX, vec![], vec![0, 1]),
            (&[&[0, 1], &[0, 1]], usize::MAX, vec![], vec![]),
            (&[&[0, 1], &[0, 1]], 2 * BEGINNING, vec![0, 1], vec![0, 1]),
        ] {
            let mut frames = take(first, from.max(first.len()));
            let forgotten = forget_the_beginning(&mut frames);
            assert_eq!(seen(&frames), stays, "what could not be found again stays");
            recall_the_beginning(&mut frames, forgotten);
            assert_eq!(seen(&frames)[..back.len()], back);
            assert!(back.is_empty() == seen(&frames).is_empty());
        }
    }

    #[test]
    fn what_was_found_again_or_lost_its_dots_stays_as_it_is() {
        for found in [sample(4, &[3, 5, 6]), sample(7, &[2, 8])] {
            let mut frames = take(&[&[0, 1, 2]], usize::MAX);
            let forgotten = forget_the_beginning(&mut frames);
            frames[0].samples.push(found.clone());
            recall_the_beginning(&mut frames, forgotten);
            let left: Vec<(u32, Vec<u32>)> = frames[0].samples.iter().map(|s| (s.track, s.dots.clone())).collect();
            assert_eq!(left, [(found.track, found.dots)]);
        }
    }
}
