//! Close pairs: two markers of one part so near each other that most cameras see them as one dot at times.
//!
//! Alone, each of them is measured by turns from its own dots, the other's, or both's in one, and takes the other's name
//! with them. Together they are known well: the vector between them is as long as ever and turns slowly ([`between`]), so
//! in each frame their dots are shared out at once ([`fit`]): by what the frames before say, by what those after say, and
//! then by both (the two-filter smoother of Fraser & Potter 1969, with a choice in each frame). A dot of both is a ray of
//! both. Which is which is what most frames had that saw them apart.

mod between;
mod fit;
mod look;
mod part;

use super::super::frame::Frame;
use super::super::share::{QUANTILE, RANGE_PX, nearest_px};
use super::super::{Kind, Sample, Shot, Tracked};
use super::confusion::exchange;
use super::scene_of;
use crate::correspond::scene::Scene;
pub(super) use between::{Habit, MEDIAN, median};
use look::{Given, Look, looks};
use nalgebra::{Vector2, Vector3};
use part::{Anew, parts, turned};
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
/// Frames from which the merging distance is learned.
const SAMPLED: usize = 600;
/// Dots that are explained so much better as it was speak against measuring anew (nats).
const BETTER: f64 = 5.0;
/// A trajectory is much shorter with fewer than one in so many of the frames.
const MUCH: usize = 2;

/// Two trajectories that are a close pair.
struct Pair {
    tracks: [u32; 2],
    /// Indices of the frames that saw them apart.
    apart: Vec<usize>,
    /// Frames in which the one that was measured less often was.
    measured: usize,
    habit: Habit,
}

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
    let given = Given { scenes, merging_px };
    let measured: Vec<Vec<(usize, Anew)>> =
        close.par_iter().zip(&looks).map(|(pair, looks)| pair.measured_anew(looks, &given)).collect();
    for (pair, measured) in close.iter().zip(measured) {
        for (index, anew) in measured {
            write(&mut frames[index], anew, |t| pair.passes(&counts, t), (scene_of(scenes, index), &shots[index]));
        }
    }
    hand_over_leftovers(&counts, &close, frames);
    !close.is_empty()
}

/// What is left of trajectories that pass and lost most of their samples to a pair is the one's of the two that has no
/// sample, measured or carried, where it is as far from the other as the two are, or goes.
fn hand_over_leftovers(before: &BTreeMap<u32, usize>, close: &[&Pair], frames: &mut [Tracked]) {
    let after = counts(frames);
    let is_leftover = |t: u32| MUCH * after.get(&t).copied().unwrap_or(0) < before[&t];
    for &pair in close {
        let leftovers: Vec<u32> =
            before.keys().copied().filter(|t| pair.passes(before, *t) && is_leftover(*t)).collect();
        for frame in frames.iter_mut() {
            let place = |t: u32| frame.samples.iter().find(|s| s.track == t).map(|s| s.point);
            let (free, other) = match pair.tracks.map(place) {
                [Some(other), None] => (pair.tracks[1], other),
                [None, Some(other)] => (pair.tracks[0], other),
                _ => continue,
            };
            let fits = |s: &Sample| leftovers.contains(&s.track) && pair.habit.fits(&(s.point - other));
            if let Some(sample) = frame.samples.iter_mut().find(|s| fits(s)) {
                sample.track = free;
                frame.samples.sort_by_key(|s| s.track);
            }
        }
    }
    let passes = |t: u32| close.iter().any(|p| p.passes(before, t)) && is_leftover(t);
    let gone: Vec<u32> = before.keys().copied().filter(|t| passes(*t)).collect();
    frames.iter_mut().for_each(|f| f.samples.retain(|s| !gone.contains(&s.track)));
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
    low.map_or(RANGE_PX[0], |d| d.clamp(RANGE_PX[0], RANGE_PX[1]))
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
        let images =
            |c: &crate::camera::Camera| Some((c.project_linear(&from)?.0, c.project_linear(&(from + vector))?.0));
        median(cameras.iter().filter_map(images).map(|(p, q)| (q - p).norm()).collect())
    };
    let sampled = apart.iter().step_by(apart.len().div_ceil(100));
    let typical_px = median(sampled.filter_map(image).collect())?;
    let close = habit.spread_m < STIFF * habit.length_m && typical_px < RUN_TOGETHER * merging_px;
    close.then_some(habit)
}

impl Pair {
    /// By frame, the samples of the two.
    fn measured_anew(&self, looks: &[Look], given: &Given) -> Vec<(usize, Anew)> {
        let parts = parts(self, looks, given);
        let turned = turned(&parts, &self.habit);
        let [a, b] = self.tracks;
        let tracks = turned.into_iter().map(|turned| if turned { [b, a] } else { [a, b] });
        parts.into_iter().zip(tracks).flat_map(|(part, tracks)| part.samples(tracks)).collect()
    }

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

/// Puts the two in the place of what their trajectories had, and takes away what has lost its rays of those that pass.
/// Where there may be one only, the dots are another one's by now, or were explained better before (the two's vector was lost),
/// what their trajectories had stays and goes by its place.
fn write(frame: &mut Tracked, anew: Anew, passes: impl Fn(u32) -> bool, (scene, shot): (&Scene, &Shot)) {
    let Anew { samples, two } = anew;
    let tracks = samples.each_ref().map(|s| s.track);
    let others = || frame.samples.iter().filter(|s| !tracks.contains(&s.track) && !passes(s.track));
    let taken = samples.iter().flat_map(|s| &s.dots).any(|d| others().any(|o| o.dots.contains(d)));
    if !two || taken || samples.iter().all(|s| s.dots.is_empty()) {
        rename(frame, &samples);
        return;
    }
    let own: Vec<&Sample> = frame.samples.iter().filter(|s| tracks.contains(&s.track)).collect();
    let mut rays = Frame::new(scene, &shot.dots);
    rays.lag_s.clone_from(&shot.lag_s);
    if explained(&own, &rays, scene) > explained(&samples.each_ref(), &rays, scene) + BETTER {
        rename(frame, &samples);
        return;
    }
    let confidence = own.iter().map(|s| s.confidence).fold(0.0, f64::max);
    let hardware = tracks.map(|t| own.iter().find(|s| s.track == t).and_then(|s| s.hardware));
    frame.samples.retain_mut(|s| {
        let before = s.dots.len();
        s.dots.retain(|d| samples.iter().all(|o| !o.dots.contains(d)));
        !tracks.contains(&s.track) && (s.dots.len() == before || s.dots.len() >= 2)
    });
    let seen = samples.into_iter().zip(hardware).filter(|(s, _)| !s.dots.is_empty());
    frame.samples.extend(seen.map(|(s, hardware)| Sample { confidence, hardware, ..s }.with_rays(&rays)));
    frame.samples.sort_by_key(|s| s.track);
}

/// How much better dots are explained by samples of two markers than by nobody (nats): each by the one that has it, or by
/// the middle of both.
fn explained(samples: &[&Sample], frame: &Frame, scene: &Scene) -> f64 {
    let mut dots: Vec<u32> = samples.iter().flat_map(|s| &s.dots).copied().collect();
    dots.sort_unstable();
    dots.dedup();
    let one = |dot: &u32| {
        let sight = frame.sight(*dot);
        let lag_s = frame.lag_s(sight.camera);
        let image =
            |s: &&&Sample| Some(scene.rig.cameras[sight.camera].project_linear(&(s.point + s.velocity * lag_s))?.0);
        let images: Vec<Vector2<f64>> =
            samples.iter().filter(|s| s.dots.contains(dot)).filter_map(|s| image(&s)).collect();
        let middle = images.iter().sum::<Vector2<f64>>() / images.len().max(1) as f64;
        let squared = (frame.pixel(*dot) - middle).norm_squared() / sight.sigma_px.powi(2);
        -0.5 * squared - (std::f64::consts::TAU * sight.sigma_px.powi(2)).ln() - frame.ln_alone[*dot as usize]
    };
    dots.iter().map(one).sum()
}

/// Gives what the two trajectories have measured to the one or the other by where the two are.
fn rename(frame: &mut Tracked, samples: &[Sample; 2]) {
    let is_own = |s: &Sample| s.kind == Kind::Measured && samples.iter().any(|o| o.track == s.track);
    let off = |crossed: bool| -> f64 {
        let to = |s: &Sample| samples.iter().position(|o| (o.track == s.track) != crossed).map(|k| &samples[k]);
        frame.samples.iter().filter(|s| is_own(s)).filter_map(|s| Some((to(s)?.point - s.point).norm())).sum()
    };
    if off(true) < off(false) {
        exchange(frame, samples.each_ref().map(|s| s.track));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::correspond::frame::Dot;
    use crate::reconstruct::{ReconstructOptions, estimate_model};
    use crate::synth::rigs::ring;
    use nalgebra::Matrix3;

    /// What two trajectories have in a frame in which three cameras see both markers (dots 0 to 5, by turns) and a fourth one
    /// sees both in one dot (6), after these samples were put in their place: track, place on the x axis (m) and dots each.
    fn written(before: &[(u32, f64, &[u32])], anew: [(u32, f64, &[u32]); 2]) -> Vec<(u32, Vec<u32>)> {
        let rig = ring(4, 3.0, 20.0, 0.0, [1000.0, 1000.0], 1000.0);
        let model = estimate_model(&rig, &[], &ReconstructOptions::default()).expect("the rig sees the stage");
        let scene = Scene::new(&rig, &model);
        let dot = |camera: usize, x: f64| {
            let pixel = rig.cameras[camera].project_linear(&Vector3::new(x, 0.0, 0.0)).expect("it is in front").0;
            Dot { camera, pixel: pixel.into(), sigma: 1.0, hardware: None }
        };
        let dots = (0..3).flat_map(|c| [dot(c, 0.0), dot(c, 0.02)]).chain([dot(3, 0.01)]).collect();
        let sample = |(track, x, dots): (u32, f64, &[u32])| {
            Sample::new(track, (Vector3::new(x, 0.0, 0.0), Matrix3::identity() * 1e-6), Kind::Measured, dots, 0.9)
        };
        let samples = before.iter().map(|b| sample(*b)).collect();
        let mut frame = Tracked { samples, ..Tracked::default() };
        let anew = Anew { samples: anew.map(sample), two: true };
        write(&mut frame, anew, |_| false, (&scene, &Shot { dots, lag_s: Vec::new() }));
        frame.samples.into_iter().map(|s| (s.track, s.dots)).collect()
    }

    #[test]
    fn dots_that_are_explained_well_keep_their_samples() {
        let before = [(1, 0.0, &[0, 2, 4][..]), (2, 0.02, &[1, 3, 5])];
        let kept = vec![(1, vec![0, 2, 4]), (2, vec![1, 3, 5])];
        assert_eq!(
            written(&before, [(1, -0.02, &[0][..]), (2, 0.0, &[0, 2, 4])]),
            kept,
            "half of the dots are left over"
        );
        assert_eq!(written(&before, [(1, 0.01, &[0, 3, 5][..]), (2, 0.01, &[1, 2, 4])]), kept, "the dots are mixed up");
    }

    #[test]
    fn kept_samples_go_by_the_names_of_where_the_two_are() {
        let before = [(1, 0.0, &[0, 2, 4][..]), (2, 0.02, &[1, 3, 5])];
        let turned = written(&before, [(1, 0.021, &[1, 3][..]), (2, -0.001, &[0, 2])]);
        assert_eq!(turned, [(1, vec![1, 3, 5]), (2, vec![0, 2, 4])]);
    }

    #[test]
    fn what_explains_more_dots_is_taken() {
        let anew = [(1, 0.0, &[0, 2, 4, 6][..]), (2, 0.02, &[1, 3, 5, 6])];
        let taken = vec![(1, vec![0, 2, 4, 6]), (2, vec![1, 3, 5, 6])];
        assert_eq!(written(&[(1, 0.0, &[0, 2, 4])], anew), taken, "the other was hidden");
        assert_eq!(written(&[(1, 0.01, &[0, 3, 5]), (2, 0.01, &[1, 2, 4])], anew), taken, "the dots were mixed up");
    }
}
