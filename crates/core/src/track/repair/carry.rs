//! Hidden markers of a recorded take, carried through their gaps from both ends.
//!
//! The frame of the most reliable neighbours (`body/regression.rs`), with the whole take as history, is started from the
//! last frames before the gap and, backwards in time, from the first frames after it; so is the marker's own motion. The
//! estimates are put together by their covariances. Such samples are predicted, never measured.

use super::super::body::links::Links;
use super::super::body::moments::NEIGHBOURS;
use super::super::body::regression::Fit;
use super::super::body::{Carried, Seen, Snapshot};
use super::super::filter::{Filter, Step, fuse};
use super::super::{Kind, Sample, Tracked};
use nalgebra::{Matrix3, Vector3};
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

/// Adds predicted samples to gaps of up to `longest_s` whose spread stays below `largest_sigma_m`.
pub fn carry(frames: &mut [Tracked], times_s: &[f64], longest_s: f64, largest_sigma_m: f64) {
    let tracks = tracks_of(frames);
    let places = snapshots(frames, &tracks);
    let gaps = gaps_of(&places, tracks.len(), times_s, longest_s);
    if gaps.is_empty() {
        return;
    }
    let links = learned_links(frames, &tracks);
    let history = spread(&places);
    let confidence = confidence_of(frames);
    let filled: Vec<Vec<(usize, Sample)>> = gaps
        .par_iter()
        .map(|gap| {
            let track = tracks[gap.slot];
            let sample = |(frame, carried): (usize, Carried)| (frame, sample_of(track, &carried, confidence[&track]));
            let found = carried(gap, &places, &history, &links, times_s);
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

/// Positions within one gap.
fn carried(
    gap: &Gap,
    places: &[Snapshot],
    history: &[&Snapshot],
    links: &Links,
    times_s: &[f64],
) -> Vec<(usize, Carried)> {
    let ends = [ends_of(gap, places, times_s, false), ends_of(gap, places, times_s, true)];
    let mut filters = ends.each_ref().map(|e| motion(gap.slot, e));
    let inside: Vec<usize> = (gap.before + 1..gap.after).collect();
    let middle = &places[inside[inside.len() / 2]];
    let neighbours = links.frame_of(gap.slot, middle, NEIGHBOURS);
    let spacing_s = (times_s[times_s.len() - 1] - times_s[0]) / history.len().max(1) as f64;
    let mut fits = ends.each_ref().map(|e| Fit::new(gap.slot, &neighbours, history, e, spacing_s));
    let mut found: Vec<Option<Carried>> = vec![None; inside.len()];
    for (side, (fit, filter)) in fits.iter_mut().zip(&mut filters).enumerate() {
        let mut clock_s = ends[side].first().map_or(0.0, |e| e.0);
        for k in 0..inside.len() {
            let at = if side == 0 { k } else { inside.len() - 1 - k };
            // Backwards, time runs from the end of the gap.
            let time_s = if side == 0 { times_s[inside[at]] } else { -times_s[inside[at]] };
            let mut estimate = None;
            if let Some(filter) = filter {
                filter.predict(&Step::new((time_s - clock_s).max(1e-6)), ACCELERATION);
                estimate = Some(Carried { point: filter.position, covariance: *filter.covariance() });
            }
            clock_s = time_s;
            let framed = fit.as_mut().and_then(|f| f.predict(&places[inside[at]], time_s));
            found[at] = together(found[at], together(estimate, framed));
        }
    }
    inside.into_iter().zip(found).filter_map(|(frame, c)| c.map(|c| (frame, c))).collect()
}

/// The frames at one end of a gap, the nearest first, with time running into the gap.
fn ends_of(gap: &Gap, places: &[Snapshot], times_s: &[f64], backwards: bool) -> Vec<(f64, Snapshot)> {
    let frame = |k: usize| if backwards { Some(gap.after + k) } else { gap.before.checked_sub(k) };
    let one = |k: usize| {
        let f = frame(k).filter(|&f| f < places.len() && places[f][gap.slot].is_some())?;
        Some((if backwards { -times_s[f] } else { times_s[f] }, places[f].clone()))
    };
    (0..ENDS).map_while(one).collect()
}

/// A filter that has seen the end of the trajectory, the farthest frame first.
fn motion(slot: usize, ends: &[(f64, Snapshot)]) -> Option<Filter> {
    let noise = Matrix3::identity() * 1e-6;
    let mut filter: Option<(Filter, f64)> = None;
    for (time_s, snapshot) in ends.iter().rev() {
        let place: Vector3<f64> = snapshot[slot]?;
        filter = Some(match filter {
            None => (Filter::new(place, &noise, ACCELERATION), *time_s),
            Some((mut f, before_s)) => {
                f.predict(&Step::new((time_s - before_s).max(1e-6)), ACCELERATION);
                let prior = *f.covariance();
                let gain = prior * (prior + noise).try_inverse()?;
                f.update(f.position + gain * (place - f.position), &(prior - gain * prior));
                (f, *time_s)
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
