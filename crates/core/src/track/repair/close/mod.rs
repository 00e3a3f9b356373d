//! Close pairs: two markers of one part so near each other that most cameras see them as one dot at times.
//!
//! Alone, each of them is measured by turns from its own dots, the other's, or both's in one, and takes the other's name
//! with them. Together they are known well: the vector between them is as long as ever and turns slowly ([`between`]), so
//! in each frame their dots are shared out at once ([`fit`]): by what the frames before say, by what those after say, and
//! then by both (the two-filter smoother of Fraser & Potter 1969, with a choice in each frame). A dot of both is a ray of
//! both. Which is which is what most frames had that saw them apart.

mod between;
mod fit;

use super::super::frame::Frame;
use super::super::share::nearest_px;
use super::super::{Kind, Sample, Shot, Tracked};
use super::regain::velocity;
use crate::correspond::scene::Scene;
use between::{Between, Habit, median};
use fit::{Candidate, Pose, Seen, View, both_sides, fit, remembered, usual};
use nalgebra::{Matrix3, Vector2, Vector3};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Markers farther apart than this are no close pair (m).
const NEAR: f64 = 0.06;
/// Frames that must have seen the two apart.
const APART: usize = 20;
/// A part's vector differs by no more than this part of its length.
const STIFF: f64 = 0.3;
/// Two markers whose images are up to this many merging distances apart, by median, run together at times.
const RUN_TOGETHER: f64 = 2.0;
/// Frames from which the merging distance is learned, its quantile among the nearest dots, and its range (px).
const SAMPLED: usize = 600;
const QUANTILE: f64 = 0.1;
const MERGING_PX: [f64; 2] = [1.0, 8.0];
/// A trajectory is much shorter with fewer than one in so many of the frames.
const MUCH: usize = 2;
/// Dots of a camera that are considered, and how far off they may be (standard deviations).
const DOTS: usize = 4;
const GATE_SIGMAS: f64 = 4.0;
/// Places known less well than this are not measured (m).
const KNOWN: f64 = 0.03;

/// Two that no camera has seen apart for so long may be one by now (s).
const MERGED_S: f64 = 0.5;

/// Two trajectories that are a close pair.
struct Pair {
    tracks: [u32; 2],
    /// Indices of the frames that saw them apart.
    apart: Vec<usize>,
    /// Frames in which the one that was measured less often was.
    measured: usize,
    habit: Habit,
}

/// One frame of a pair.
struct Look {
    index: usize,
    time_s: f64,
    /// Where the trajectories are (m, m²).
    samples: [Option<(Vector3<f64>, Matrix3<f64>)>; 2],
    /// The vector between them, where they were seen apart.
    apart: Option<Vector3<f64>>,
    velocity: Vector3<f64>,
    images: Vec<Image>,
}

/// What a camera shows of a pair.
struct Image {
    camera: usize,
    /// How much later than the frame's moment (s).
    lag_s: f64,
    candidates: Vec<Candidate>,
}

/// The two places of a frame, and what dots are whose.
struct SharedOut {
    pose: Pose,
    dots: [Vec<u32>; 2],
    /// Whether a camera saw both in dots of their own.
    apart: bool,
}

/// What one pass says before each frame.
type Before = Vec<Option<(Between, BTreeMap<usize, Seen>)>>;

/// Measures close pairs anew; whether there were any.
pub fn measure_close(scenes: &[(usize, &Scene)], shots: &[Shot], times_s: &[f64], frames: &mut [Tracked]) -> bool {
    let apart = seen_apart(frames, shots);
    if apart.is_empty() {
        return false;
    }
    let merging_px = merging_px(scenes, shots);
    let counts = counts(frames);
    let found = apart.iter().filter_map(|(tracks, apart)| {
        let habit = habit(*tracks, apart, scenes, times_s, frames, merging_px)?;
        let measured = tracks.iter().map(|t| counts[t]).min()?;
        Some(Pair { tracks: *tracks, apart: apart.iter().map(|a| a.0).collect(), measured, habit })
    });
    let found: Vec<Pair> = found.collect();
    let close: Vec<&Pair> = found.iter().filter(|p| !found.iter().any(|q| q.excludes(p, &counts))).collect();
    let looks = looks(&close, &counts, scenes, shots, times_s, frames);
    let measured: Vec<Vec<(usize, [Sample; 2])>> = close
        .par_iter()
        .zip(looks)
        .map(|(pair, looks)| {
            let parts = looks.chunk_by(|a, b| b.time_s - a.time_s <= pair.habit.holds_s());
            parts.flat_map(|part| solved(pair, part, scenes, merging_px)).collect()
        })
        .collect();
    for (pair, measured) in close.iter().zip(measured) {
        for (index, samples) in measured {
            write(&mut frames[index], samples, |t| pair.passes(&counts, t), (scene_of(scenes, index), &shots[index]));
        }
    }
    !close.is_empty()
}

fn scene_of<'a>(scenes: &[(usize, &'a Scene)], index: usize) -> &'a Scene {
    scenes[scenes.partition_point(|s| s.0 <= index) - 1].1
}

/// By pair of near trajectories, the frames in which a camera saw them apart, with the vector from the one to the other.
fn seen_apart(frames: &[Tracked], shots: &[Shot]) -> BTreeMap<[u32; 2], Vec<(usize, Vector3<f64>)>> {
    let mut found: BTreeMap<[u32; 2], Vec<(usize, Vector3<f64>)>> = BTreeMap::new();
    for (index, (frame, shot)) in frames.iter().zip(shots).enumerate() {
        let mut own: Vec<&Sample> = frame.samples.iter().filter(|s| s.kind == Kind::Measured).collect();
        own.sort_by(|a, b| a.point.x.total_cmp(&b.point.x));
        for (k, a) in own.iter().enumerate() {
            for b in own[k + 1..].iter().take_while(|b| b.point.x - a.point.x < NEAR) {
                if (b.point - a.point).norm() < NEAR && in_one_image(a, b, shot) {
                    let (a, b) = if a.track < b.track { (a, b) } else { (b, a) };
                    found.entry([a.track, b.track]).or_default().push((index, b.point - a.point));
                }
            }
        }
    }
    found.retain(|_, frames| frames.len() >= APART);
    found
}

fn in_one_image(a: &Sample, b: &Sample, shot: &Shot) -> bool {
    let camera = |d: &u32| shot.dots[*d as usize].camera;
    a.dots.iter().any(|d| b.dots.iter().any(|e| d != e && camera(d) == camera(e)))
}

/// The distance at which two dots of an image become one (px).
fn merging_px(scenes: &[(usize, &Scene)], shots: &[Shot]) -> f64 {
    let sampled = (0..shots.len()).step_by(shots.len().div_ceil(SAMPLED).max(1));
    let mut nearest: Vec<f64> =
        sampled.filter_map(|i| nearest_px(&Frame::new(scene_of(scenes, i), &shots[i].dots))).collect();
    nearest.sort_unstable_by(f64::total_cmp);
    let low = nearest.get((QUANTILE * nearest.len() as f64) as usize);
    low.map_or(MERGING_PX[0], |d| d.clamp(MERGING_PX[0], MERGING_PX[1]))
}

/// In how many frames each trajectory was measured.
fn counts(frames: &[Tracked]) -> BTreeMap<u32, usize> {
    let mut found = BTreeMap::new();
    for sample in frames.iter().flat_map(|f| &f.samples) {
        *found.entry(sample.track).or_insert(0) += usize::from(sample.kind == Kind::Measured);
    }
    found
}

/// How the vector between two goes, if they are a close pair: their images run together and it is stiff.
fn habit(
    tracks: [u32; 2],
    apart: &[(usize, Vector3<f64>)],
    scenes: &[(usize, &Scene)],
    times_s: &[f64],
    frames: &[Tracked],
    merging_px: f64,
) -> Option<Habit> {
    let known: Vec<(f64, Vector3<f64>)> = apart.iter().map(|(i, v)| (times_s[*i], *v)).collect();
    let habit = Habit::learned(&known, APART)?;
    let image = |&(index, vector): &(usize, Vector3<f64>)| {
        let from = frames[index].samples.iter().find(|s| s.track == tracks[0])?.point;
        let cameras = &scene_of(scenes, index).rig.cameras;
        let images = |c: &crate::camera::Camera| Some((c.project_linear(&from)?.0, c.project_linear(&(from + vector))?.0));
        median(cameras.iter().filter_map(images).map(|(p, q)| (q - p).norm()).collect())
    };
    let sampled = apart.iter().step_by(apart.len().div_ceil(100));
    let typical_px = median(sampled.filter_map(image).collect())?;
    let close = habit.spread_m < STIFF * habit.length_m && typical_px < RUN_TOGETHER * merging_px;
    close.then_some(habit)
}

impl Pair {
    /// Whether a trajectory is much shorter than the pair's: one that lives on what the pair's dots leave over.
    fn passes(&self, counts: &BTreeMap<u32, usize>, track: u32) -> bool {
        !self.tracks.contains(&track) && MUCH * counts.get(&track).copied().unwrap_or(0) < self.measured
    }

    /// Whether another is a pair of one of this pair's and one that passes.
    fn excludes(&self, other: &Self, counts: &BTreeMap<u32, usize>) -> bool {
        other.tracks.iter().any(|t| self.tracks.contains(t)) && other.tracks.iter().any(|t| self.passes(counts, *t))
    }

    /// Whether one of the two was seen beside another marker since (or will be before) it was seen beside this one.
    fn is_outlived(&self, close: &[&Self], index: usize) -> bool {
        let own = self.frames_from(index);
        let rival = |p: &&&Self| p.tracks != self.tracks && p.tracks.iter().any(|t| self.tracks.contains(t));
        close.iter().filter(rival).any(|p| p.frames_from(index) < own)
    }

    /// Whether a sample is where one of the two may be.
    fn reaches(&self, own: [Option<&Sample>; 2], sample: &Sample) -> bool {
        own.into_iter().flatten().any(|s| (s.point - sample.point).norm() < self.habit.length_m)
    }

    /// How many frames from one the two were seen apart.
    fn frames_from(&self, index: usize) -> usize {
        let after = self.apart.partition_point(|a| *a < index);
        let beside = [after.checked_sub(1), Some(after)].into_iter().flatten().filter_map(|k| self.apart.get(k));
        beside.map(|a| a.abs_diff(index)).min().unwrap_or(usize::MAX)
    }
}

/// The frames of each pair.
fn looks(
    close: &[&Pair],
    counts: &BTreeMap<u32, usize>,
    scenes: &[(usize, &Scene)],
    shots: &[Shot],
    times_s: &[f64],
    frames: &[Tracked],
) -> Vec<Vec<Look>> {
    let mut found: Vec<Vec<Look>> = close.iter().map(|_| Vec::new()).collect();
    for (index, (tracked, shot)) in frames.iter().zip(shots).enumerate() {
        let scene = scene_of(scenes, index);
        let mut frame = Frame::new(scene, &shot.dots);
        frame.lag_s.clone_from(&shot.lag_s);
        tracked.samples.iter().flat_map(|s| &s.dots).for_each(|&d| frame.free[d as usize] = false);
        for (pair, looks) in close.iter().zip(&mut found) {
            let own = pair.tracks.map(|t| tracked.samples.iter().find(|s| s.track == t));
            let Some(some) = own[0].or(own[1]).filter(|_| !pair.is_outlived(close, index)) else { continue };
            let [from, to] = own.map(|s| s.filter(|s| s.kind == Kind::Measured));
            let apart = from.zip(to).filter(|(a, b)| in_one_image(a, b, shot)).map(|(a, b)| b.point - a.point);
            let velocity = velocity(frames, times_s, index, some.track);
            let passing = tracked.samples.iter().filter(|s| pair.passes(counts, s.track) && pair.reaches(own, s));
            let more: Vec<u32> = passing.flat_map(|s| s.dots.clone()).collect();
            let images = images(scene, &frame, (own, &more), pair.habit.length_m, velocity);
            let samples = own.map(|s| s.map(|s| (s.point, s.covariance)));
            looks.push(Look { index, time_s: times_s[index], samples, apart, velocity, images });
        }
    }
    found
}

/// By camera, the dots that may be the pair's near where they are: free ones, their own, and more.
fn images(
    scene: &Scene,
    frame: &Frame,
    (own, more): ([Option<&Sample>; 2], &[u32]),
    length_m: f64,
    velocity: Vector3<f64>,
) -> Vec<Image> {
    let known: Vec<&Sample> = own.into_iter().flatten().collect();
    let mut found = Vec::new();
    for (camera, dots) in frame.by_camera.iter().enumerate() {
        let moved = velocity * frame.lag_s(camera);
        let places: Vec<(Vector2<f64>, f64)> = known
            .iter()
            .filter_map(|s| {
                let (pixel, by) = scene.rig.cameras[camera].project_linear(&(s.point + moved))?;
                let spread = 0.5 * (by * s.covariance * by.transpose()).trace();
                let noise = frame.widest_sigma_px[camera];
                let across = by.norm() * std::f64::consts::FRAC_1_SQRT_2 * length_m;
                Some((pixel, across + GATE_SIGMAS * (spread + noise * noise).sqrt()))
            })
            .collect();
        let off = |dot: u32| {
            let away = places.iter().map(|(p, r)| ((frame.pixel(dot) - p).norm(), *r)).filter(|(d, r)| d < r);
            away.map(|(d, _)| d).min_by(f64::total_cmp)
        };
        let usable = |dot: u32| frame.free[dot as usize] || more.contains(&dot) || known.iter().any(|s| s.dots.contains(&dot));
        let mut near: Vec<(f64, u32)> =
            dots.iter().filter(|&&d| usable(d)).filter_map(|&d| Some((off(d)?, d))).collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        near.truncate(DOTS);
        let candidate = |&(_, dot): &(f64, u32)| Candidate {
            dot,
            pixel: frame.pixel(dot),
            sigma_px: frame.sigma_px(dot),
            ln_alone: frame.ln_alone[dot as usize],
        };
        if !near.is_empty() {
            let candidates = near.iter().map(candidate).collect();
            found.push(Image { camera, lag_s: frame.lag_s(camera), candidates });
        }
    }
    found
}

/// A part of the take in which the vector between the two never gets lost.
fn solved(pair: &Pair, looks: &[Look], scenes: &[(usize, &Scene)], merging_px: f64) -> Vec<(usize, [Sample; 2])> {
    let forwards: Vec<usize> = (0..looks.len()).collect();
    let backwards: Vec<usize> = forwards.iter().rev().copied().collect();
    let pass = |order: &[usize]| passed(pair, looks, order, scenes, merging_px);
    let (before, after) = (pass(&forwards), pass(&backwards));
    let both = |(k, look): (usize, &Look)| {
        let (between, seen) = match (&before[k], &after[k]) {
            (Some(a), Some(b)) => (a.0.with(&b.0), together(&a.1, &b.1)),
            (Some(one), None) | (None, Some(one)) => one.clone(),
            (None, None) => return None,
        };
        let prior = look.pose(&between, pair)?;
        Some(look.shared_out(&prior, &seen, scene_of(scenes, look.index), merging_px))
    };
    let found: Vec<Option<SharedOut>> = looks.iter().enumerate().map(both).collect();
    let agreed = |(look, found): (&Look, &Option<SharedOut>)| {
        Some(look.apart?.dot(&found.as_ref()?.pose.between().0).signum())
    };
    let agreed: f64 = looks.iter().zip(&found).filter_map(agreed).sum();
    let tracks = if agreed < 0.0 { [pair.tracks[1], pair.tracks[0]] } else { pair.tracks };
    let two = two_at(looks, &found);
    let measured = |((look, found), _): ((&Look, Option<SharedOut>), bool)| Some((look.index, found?.samples(tracks, look)));
    looks.iter().zip(found).zip(two).filter(|(_, two)| *two).filter_map(measured).collect()
}

/// Whether there are two markers at each look: some camera saw them apart not long before and after.
fn two_at(looks: &[Look], found: &[Option<SharedOut>]) -> Vec<bool> {
    let apart_s: Vec<f64> =
        looks.iter().zip(found).filter(|(_, f)| f.as_ref().is_some_and(|f| f.apart)).map(|(l, _)| l.time_s).collect();
    let near = |look: &Look| {
        let after = apart_s.partition_point(|t| *t < look.time_s);
        let next = apart_s.get(after).copied();
        let last = after.checked_sub(1).map(|k| apart_s[k]);
        match (last, next) {
            (_, Some(t)) if t == look.time_s => true,
            (Some(last), Some(next)) => next - last < MERGED_S,
            _ => false,
        }
    };
    looks.iter().map(near).collect()
}

/// What the frames before say of each frame, in this order.
fn passed(pair: &Pair, looks: &[Look], order: &[usize], scenes: &[(usize, &Scene)], merging_px: f64) -> Before {
    let mut said: Before = vec![None; looks.len()];
    let mut state: Option<(Between, BTreeMap<usize, Seen>, f64)> = None;
    for &k in order {
        let look = &looks[k];
        let (between, seen) = match state.take() {
            Some((between, seen, then_s)) => (between.after(look.time_s - then_s, &pair.habit), seen),
            None => {
                let Some(vector) = look.apart else { continue };
                let covariance = Matrix3::identity() * (pair.habit.length_m / 3.0).powi(2);
                (Between { vector, covariance }, BTreeMap::new())
            }
        };
        let next = look.pose(&between, pair).map(|prior| {
            let scene = scene_of(scenes, look.index);
            let views = look.views(&prior, &seen, scene);
            let fitted = fit(&prior, &views, merging_px);
            let choices = views.iter().zip(&fitted.choices);
            (fitted.pose.between(), choices.map(|(v, c)| (v.camera, remembered(*c))).collect())
        });
        said[k] = Some((between, seen));
        state = next.map(|((vector, covariance), seen)| (Between { vector, covariance }, seen, look.time_s));
    }
    said
}

fn together(before: &BTreeMap<usize, Seen>, after: &BTreeMap<usize, Seen>) -> BTreeMap<usize, Seen> {
    let mut both = before.clone();
    for (camera, seen) in after {
        both.entry(*camera).and_modify(|s| *s = both_sides(s, seen)).or_insert(*seen);
    }
    both
}

impl Look {
    /// Where the two are by their trajectories and the vector between them. `None` where there is no trajectory.
    fn pose(&self, between: &Between, pair: &Pair) -> Option<Pose> {
        let doubt = Matrix3::identity() * (0.5 * pair.habit.length_m).powi(2);
        let half = 0.5 * between.vector;
        let (middle, covariance) = match self.samples {
            [Some((p, c)), Some((q, d))] => (0.5 * (p + q), 0.5 * (c + d)),
            [Some((p, c)), None] => (p + half, c),
            [None, Some((q, d))] => (q - half, d),
            [None, None] => return None,
        };
        Some(Pose::new((&middle, &(covariance + doubt)), (&between.vector, &between.covariance)))
    }

    fn views(&self, prior: &Pose, seen: &BTreeMap<usize, Seen>, scene: &Scene) -> Vec<View<'_>> {
        let view = |image: &'_ Image| {
            let moved = self.velocity * image.lag_s;
            let camera = &scene.rig.cameras[image.camera];
            let expected = [0, 1].map(|k| camera.project_linear(&(prior.place(k).0 + moved)));
            (expected, seen.get(&image.camera).copied().unwrap_or_else(usual))
        };
        let usable = |image| {
            let ([Some(p), Some(q)], seen) = view(image) else { return None };
            Some(View { camera: image.camera, candidates: &image.candidates, expected: [p, q], seen })
        };
        self.images.iter().filter_map(usable).collect()
    }

    fn shared_out(&self, prior: &Pose, seen: &BTreeMap<usize, Seen>, scene: &Scene, merging_px: f64) -> SharedOut {
        let views = self.views(prior, seen, scene);
        let fitted = fit(prior, &views, merging_px);
        let own = |which: usize| {
            let chosen = views.iter().zip(&fitted.choices).filter_map(|(v, c)| Some(v.candidates[c.of[which]?].dot));
            let mut dots: Vec<u32> = chosen.collect();
            dots.sort_unstable();
            dots
        };
        let dots = [own(0), own(1)];
        let apart = fitted.choices.iter().any(|c| matches!(c.of, [Some(k), Some(l)] if k != l));
        SharedOut { pose: fitted.pose, dots, apart }
    }
}

impl SharedOut {
    fn samples(self, tracks: [u32; 2], look: &Look) -> [Sample; 2] {
        [0, 1].map(|k| {
            let state = self.pose.place(k);
            let known = self.dots[k].len() >= 2 && state.1.trace().sqrt() < KNOWN;
            let kind = if known { Kind::Measured } else { Kind::Predicted };
            Sample { velocity: look.velocity, ..Sample::new(tracks[k], state, kind, &self.dots[k], 1.0) }
        })
    }
}

/// Puts the two in the place of what their trajectories had, unless their dots are another one's by now; of those that
/// pass, what has lost its rays goes.
fn write(frame: &mut Tracked, samples: [Sample; 2], passes: impl Fn(u32) -> bool, (scene, shot): (&Scene, &Shot)) {
    let tracks = samples.each_ref().map(|s| s.track);
    let others = || frame.samples.iter().filter(|s| !tracks.contains(&s.track) && !passes(s.track));
    let taken = samples.iter().flat_map(|s| &s.dots).any(|d| others().any(|o| o.dots.contains(d)));
    if taken || samples.iter().all(|s| s.dots.is_empty()) {
        return;
    }
    let own: Vec<&Sample> = frame.samples.iter().filter(|s| tracks.contains(&s.track)).collect();
    let confidence = own.iter().map(|s| s.confidence).fold(0.0, f64::max);
    let hardware = tracks.map(|t| own.iter().find(|s| s.track == t).and_then(|s| s.hardware));
    let mut rays = Frame::new(scene, &shot.dots);
    rays.lag_s.clone_from(&shot.lag_s);
    frame.samples.retain_mut(|s| {
        let before = s.dots.len();
        s.dots.retain(|d| samples.iter().all(|o| !o.dots.contains(d)));
        !tracks.contains(&s.track) && (s.dots.len() == before || s.dots.len() >= 2)
    });
    let seen = samples.into_iter().zip(hardware).filter(|(s, _)| !s.dots.is_empty());
    frame.samples.extend(seen.map(|(s, hardware)| Sample { confidence, hardware, ..s }.with_rays(&rays)));
    frame.samples.sort_by_key(|s| s.track);
}
