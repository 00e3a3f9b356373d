//! Hidden markers of a recorded take, carried through their gaps from both ends.
//!
//! The frame of the most reliable neighbours (`body/regression.rs`), with the whole take as history, knows what it was off
//! in the last frames before the gap and the first ones after it. The marker's own motion is started from the ones and,
//! backwards in time, from the others. The estimates are put together by their covariances. Such samples are predicted,
//! never measured.

use super::super::body::links::Links;
use super::super::body::moments::NEIGHBOURS;
use super::super::body::regression::Fit;
use super::super::body::{Carried, Seen, SeenAt, Snapshot};
use super::super::filter::{Filter, Step, fuse};
use super::super::{Kind, Sample, Tracked};
use super::close::median;
use nalgebra::Vector3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Snapshots of the take that serve as history.
const HISTORY: usize = 240;
/// Frames of each end from which the last motion is known.
const ENDS: usize = 4;
/// Acceleration of a marker while it is hidden (m/s²).
const ACCELERATION: f64 = 20.0;
/// Frames of the take from which links are learned.
const LINK_FRAMES: usize = 3000;

/// One gap of one trajectory.
struct Gap {
    slot: usize,
    /// Last frame before and first frame after it.
    before: usize,
    after: usize,
}

/// What carries hidden markers in a take.
struct Model<'a> {
    frames: &'a [Tracked],
    times_s: &'a [f64],
    tracks: &'a [u32],
    places: &'a [Snapshot],
    links: Links,
    /// Usual variance per axis of what is measured, by slot (m²).
    noise: Vec<f64>,
}

/// Adds predicted samples to gaps of up to `longest_s` whose spread stays below `largest_sigma_m`.
pub fn carry(frames: &mut [Tracked], times_s: &[f64], longest_s: f64, largest_sigma_m: f64) {
    let tracks = tracks_of(frames);
    let places = snapshots(frames, &tracks);
    let gaps = gaps_of(&places, tracks.len(), times_s, longest_s);
    if gaps.is_empty() {
        return;
    }
    let (links, noise) = (learned_links(frames, &tracks), usual_noise(frames, &tracks));
    let model = Model { frames, times_s, tracks: &tracks, places: &places, links, noise };
    let history = spread(&places);
    let confidence = confidence_of(frames);
    let filled: Vec<Vec<(usize, Sample)>> = gaps
        .par_iter()
        .map(|gap| {
            let track = tracks[gap.slot];
            let sample = |(frame, carried): (usize, Carried)| (frame, sample_of(track, &carried, confidence[&track]));
            let found = model.carried(gap, &history);
            found.into_iter().filter(|(_, c)| c.covariance.trace().sqrt() < largest_sigma_m).map(sample).collect()
        })
        .collect();
    for (frame, sample) in filled.into_iter().flatten() {
        let own = &mut frames[frame].samples;
        let at = own.partition_point(|s| s.track < sample.track);
        own.insert(at, sample);
    }
}

/// Takes out what is carried.
pub(super) fn forget_carried(frames: &mut [Tracked]) {
    frames.iter_mut().for_each(|f| f.samples.retain(|s| s.kind == Kind::Measured));
}

fn sample_of(track: u32, carried: &Carried, confidence: f64) -> Sample {
    Sample {
        track,
        point: carried.point,
        covariance: carried.covariance,
        kind: Kind::Predicted,
        dots: Vec::new(),
        residual_px: 0.0,
        ray_distance_m: 0.0,
        confidence,
        velocity: Vector3::zeros(),
        hardware: None,
        confirmed: true,
    }
}

pub(super) fn tracks_of(frames: &[Tracked]) -> Vec<u32> {
    let mut tracks: Vec<u32> = frames.iter().flat_map(|f| &f.samples).map(|s| s.track).collect();
    tracks.sort_unstable();
    tracks.dedup();
    tracks
}

fn confidence_of(frames: &[Tracked]) -> BTreeMap<u32, f64> {
    let mut found = BTreeMap::new();
    for sample in frames.iter().flat_map(|f| &f.samples) {
        let best = found.entry(sample.track).or_insert(sample.confidence);
        *best = sample.confidence.max(*best);
    }
    found
}

fn slot_of(tracks: &[u32], sample: &Sample) -> Option<usize> {
    (sample.kind == Kind::Measured).then(|| tracks.binary_search(&sample.track).ok()).flatten()
}

pub(super) fn snapshots(frames: &[Tracked], tracks: &[u32]) -> Vec<Snapshot> {
    let snapshot = |frame: &Tracked| {
        let mut places = vec![None; tracks.len()];
        for sample in &frame.samples {
            if let Some(slot) = slot_of(tracks, sample) {
                places[slot] = Some(sample.point);
            }
        }
        places
    };
    frames.iter().map(snapshot).collect()
}

fn gaps_of(places: &[Snapshot], slots: usize, times_s: &[f64], longest_s: f64) -> Vec<Gap> {
    let mut gaps = Vec::new();
    let mut last: Vec<Option<usize>> = vec![None; slots];
    for (frame, snapshot) in places.iter().enumerate() {
        for slot in (0..slots).filter(|&s| snapshot[s].is_some()) {
            if let Some(before) = last[slot].filter(|b| frame - b > 1 && times_s[frame] - times_s[*b] <= longest_s) {
                gaps.push(Gap { slot, before, after: frame });
            }
            last[slot] = Some(frame);
        }
    }
    gaps
}

pub(super) fn learned_links(frames: &[Tracked], tracks: &[u32]) -> Links {
    let mut links = Links::default();
    links.reserve(tracks.len());
    for frame in frames.iter().step_by(frames.len().div_ceil(LINK_FRAMES).max(1)) {
        let seen: Vec<Seen> = frame
            .samples
            .iter()
            .filter_map(|s| {
                let slot = slot_of(tracks, s)?;
                Some(Seen { slot, point: s.point, covariance: s.covariance, trusted: true })
            })
            .collect();
        links.learn(&seen);
    }
    links
}

pub(super) fn spread(places: &[Snapshot]) -> Vec<&Snapshot> {
    places.iter().step_by(places.len().div_ceil(HISTORY).max(1)).rev().collect()
}

/// Usual variance per axis of what is measured, by slot (m²).
fn usual_noise(frames: &[Tracked], tracks: &[u32]) -> Vec<f64> {
    let mut found: Vec<Vec<f64>> = vec![Vec::new(); tracks.len()];
    for sample in frames.iter().flat_map(|f| &f.samples) {
        if let Some(slot) = slot_of(tracks, sample) {
            found[slot].push(sample.covariance.trace() / 3.0);
        }
    }
    found.into_iter().map(|variances| median(variances).unwrap_or(0.0)).collect()
}

impl Model<'_> {
    /// Positions within one gap.
    fn carried(&self, gap: &Gap, history: &[&Snapshot]) -> Vec<(usize, Carried)> {
        let ends = [false, true].map(|backwards| self.end_of(gap, backwards));
        let inside: Vec<usize> = (gap.before + 1..gap.after).collect();
        let mut found = self.framed(gap, history, &inside, &ends.concat());
        for (end, backwards) in ends.iter().zip([false, true]) {
            // Backwards, time runs from the end of the gap.
            let clock_s = |time_s: f64| if backwards { -time_s } else { time_s };
            let Some(mut filter) = motion(gap.slot, end, clock_s) else { continue };
            let mut last_s = clock_s(end[0].time_s);
            for k in 0..inside.len() {
                let at = if backwards { inside.len() - 1 - k } else { k };
                let now_s = clock_s(self.times_s[inside[at]]);
                filter.predict(&Step::new((now_s - last_s).max(1e-6)), ACCELERATION);
                last_s = now_s;
                let moved = Carried { point: filter.position, covariance: *filter.covariance() };
                found[at] = together(found[at], Some(moved));
            }
        }
        inside.into_iter().zip(found).filter_map(|(frame, c)| c.map(|c| (frame, c))).collect()
    }

    /// Positions in some frames by the frame of the neighbours, given when the marker was seen around them.
    fn framed(&self, gap: &Gap, history: &[&Snapshot], inside: &[usize], seen: &[SeenAt]) -> Vec<Option<Carried>> {
        let middle = &self.places[inside[inside.len() / 2]];
        let neighbours = self.links.frame_of(gap.slot, middle, NEIGHBOURS);
        let spacing_s = (self.times_s[self.times_s.len() - 1] - self.times_s[0]) / history.len().max(1) as f64;
        let Some(mut fit) = Fit::between(gap.slot, &neighbours, &self.noise, history, seen, spacing_s) else {
            return vec![None; inside.len()];
        };
        inside.iter().map(|&frame| fit.predict(&self.places[frame], self.times_s[frame])).collect()
    }

    /// The moments in which the marker was seen at one end of a gap, the nearest first.
    fn end_of(&self, gap: &Gap, backwards: bool) -> Vec<SeenAt> {
        let frame = |k: usize| if backwards { Some(gap.after + k) } else { gap.before.checked_sub(k) };
        let one = |k: usize| {
            let frame = frame(k).filter(|&f| f < self.places.len() && self.places[f][gap.slot].is_some())?;
            let own = |s: &&Sample| s.kind == Kind::Measured && s.track == self.tracks[gap.slot];
            let covariance = self.frames[frame].samples.iter().find(own)?.covariance;
            Some(SeenAt { time_s: self.times_s[frame], places: self.places[frame].clone(), covariance })
        };
        (0..ENDS).map_while(one).collect()
    }
}

/// A filter that has seen one end of a gap, the farthest frame first.
fn motion(slot: usize, end: &[SeenAt], clock_s: impl Fn(f64) -> f64) -> Option<Filter> {
    let mut filter: Option<(Filter, f64)> = None;
    for seen in end.iter().rev() {
        let (place, time_s): (Vector3<f64>, f64) = (seen.places[slot]?, clock_s(seen.time_s));
        filter = Some(match filter {
            None => (Filter::new(place, &seen.covariance, ACCELERATION), time_s),
            Some((mut f, before_s)) => {
                f.predict(&Step::new((time_s - before_s).max(1e-6)), ACCELERATION);
                let prior = *f.covariance();
                let gain = prior * (prior + seen.covariance).try_inverse()?;
                f.update(f.position + gain * (place - f.position), &(prior - gain * prior));
                (f, time_s)
            }
        });
    }
    filter.map(|(f, _)| f)
}

fn together(a: Option<Carried>, b: Option<Carried>) -> Option<Carried> {
    match (a, b) {
        (Some(a), Some(b)) => {
            let (point, covariance) = fuse((&a.point, &a.covariance), (&b.point, &b.covariance))?;
            Some(Carried { point, covariance })
        }
        (one, other) => one.or(other),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::random::Random;
    use nalgebra::{Matrix3, Rotation3};

    /// A body of five markers that turns as it goes, and the first of them hidden for so many frames in every forty.
    fn take(noise_m: f64, hidden: usize) -> (Vec<Tracked>, Vec<f64>, Vec<Vector3<f64>>) {
        let own = [[0.1, 0.0, 0.05], [0.0, 0.1, 0.0], [-0.1, 0.0, 0.1], [0.0, -0.12, 0.0], [0.05, 0.05, -0.1]];
        let times_s: Vec<f64> = (0..800).map(|i| f64::from(i) / 100.0).collect();
        let place = |at: [f64; 3], t: f64| {
            let turn = Rotation3::from_euler_angles(0.6 * (2.0 * t).sin(), 0.3 * t, 0.5 * (1.1 * t).cos());
            turn * Vector3::from(at) + Vector3::new(0.4 * (1.5 * t).sin(), 0.2 * t, 1.0)
        };
        let mut random = Random::new(7, 0);
        let mut measured = |(index, t): (usize, &f64)| {
            let seen = own.iter().enumerate().filter(|(k, _)| *k > 0 || index % 40 >= hidden);
            let sample = |(k, at): (usize, &[f64; 3])| {
                let noise = Vector3::from_fn(|_, _| noise_m * random.normal());
                let covariance = Matrix3::identity() * (noise_m * noise_m);
                Sample::new(k as u32, (place(*at, *t) + noise, covariance), Kind::Measured, &[], 0.9)
            };
            Tracked { samples: seen.map(sample).collect(), ..Tracked::default() }
        };
        let frames = times_s.iter().enumerate().map(&mut measured).collect();
        let truth = times_s.iter().map(|t| place(own[0], *t)).collect();
        (frames, times_s, truth)
    }

    /// Root mean square of the errors of what is carried (m), and their mean square in its spreads.
    fn errors(noise_m: f64, hidden: usize) -> (f64, f64) {
        let (mut frames, times_s, truth) = take(noise_m, hidden);
        carry(&mut frames, &times_s, 10.0, 1.0);
        let carried = frames.iter().zip(&truth).flat_map(|(frame, truth)| {
            let carried = frame.samples.iter().filter(|s| s.kind == Kind::Predicted);
            carried.map(move |s| ((s.point - truth).norm_squared(), s.covariance.trace()))
        });
        let all: Vec<(f64, f64)> = carried.collect();
        assert!(all.len() >= 19 * hidden, "what is hidden between two frames that saw it is carried");
        let mean = |of: fn(&(f64, f64)) -> f64| all.iter().map(of).sum::<f64>() / all.len() as f64;
        (mean(|e| e.0).sqrt(), mean(|e| e.0 / e.1))
    }

    #[test]
    fn without_noise_a_rigid_body_carries_its_marker_exactly() {
        assert!(errors(1e-6, 1).0 < 1e-4);
        assert!(errors(1e-6, 10).0 < 1e-3);
    }

    #[test]
    fn what_is_carried_is_as_far_off_as_it_says() {
        for (noise_m, hidden) in [(0.001, 1), (0.004, 1), (0.004, 3), (0.004, 15)] {
            let (off_m, squared) = errors(noise_m, hidden);
            let measured_m = 3.0_f64.sqrt() * noise_m;
            assert!(off_m < 1.5 * measured_m, "{off_m} m off by a noise of {noise_m} m and {hidden} frames hidden");
            assert!((0.4..1.5).contains(&squared), "{squared} by a noise of {noise_m} m and {hidden} frames hidden");
        }
    }
}
