//! One frame of a close pair: where its trajectories are, and the dots that may be the two markers'.

use super::super::super::filter::fuse;
use super::super::super::frame::Frame;
use super::super::super::{Kind, Sample, Shot, Tracked};
use super::super::regain::velocity;
use super::super::scene_of;
use super::between::Between;
use super::fit::{Candidate, Choice, Fitted, Pose, Seen, View, fit, usual};
use super::{Pair, in_one_image};
use crate::correspond::scene::Scene;
use nalgebra::{Matrix3, Vector2, Vector3};
use std::collections::BTreeMap;

/// Dots of a camera that are considered, and how far off they may be (standard deviations).
const DOTS: usize = 4;
const GATE_SIGMAS: f64 = 4.0;
/// Rays that measure a place; places known less well than this are not measured (m).
const RAYS: usize = 2;
const KNOWN: f64 = 0.03;

/// What all looks of a take have in common: its scenes, and the distance at which two dots become one (px).
pub struct Given<'a> {
    pub scenes: &'a [(usize, &'a Scene)],
    pub merging_px: f64,
}

/// What other looks say.
#[derive(Clone)]
pub struct Known {
    /// The vector from the one to the other.
    pub between: Between,
    /// The middle of the two with its covariance, where it is known (m, m²).
    pub middle: Option<(Vector3<f64>, Matrix3<f64>)>,
    /// What each camera sees.
    pub seen: BTreeMap<usize, Seen>,
}

/// One frame of a pair.
pub struct Look {
    pub index: usize,
    pub time_s: f64,
    /// Where the trajectories are (m, m²).
    samples: [Option<(Vector3<f64>, Matrix3<f64>)>; 2],
    /// The vector between them, where they were seen apart.
    pub apart: Option<Vector3<f64>>,
    /// Whether both told who they are.
    pub told: bool,
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
pub struct SharedOut {
    pub pose: Pose,
    dots: [Vec<u32>; 2],
    /// Whether a camera saw both in dots of their own.
    pub apart: bool,
}

/// The frames of each pair.
pub fn looks(
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
            let told = own.iter().all(|s| s.is_some_and(|s| s.hardware.is_some()));
            let velocity = velocity(frames, times_s, index, some.track);
            let passing = tracked.samples.iter().filter(|s| pair.passes(counts, s.track) && pair.reaches(own, s));
            let more: Vec<u32> = passing.flat_map(|s| s.dots.clone()).collect();
            let images = images(scene, &frame, (own, &more), pair.habit.length_m, velocity);
            if images.len() < RAYS {
                continue;
            }
            // What is carried beside what is measured may be on the wrong side of it.
            let lone = own.iter().flatten().filter(|s| s.kind == Kind::Measured).count() == 1;
            let usable = |s: &&Sample| !lone || s.kind == Kind::Measured;
            let samples = own.map(|s| s.filter(usable).map(|s| (s.point, s.covariance)));
            looks.push(Look { index, time_s: times_s[index], samples, apart, told, velocity, images });
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
        let usable =
            |dot: u32| frame.free[dot as usize] || more.contains(&dot) || known.iter().any(|s| s.dots.contains(&dot));
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

impl Look {
    /// Where the two are by their trajectories and what is known. Which of them a lone trajectory has is open.
    fn pose(&self, known: &Known) -> Option<Pose> {
        let doubt = Matrix3::identity() * (0.25 * known.between.vector.norm_squared());
        let (mut middle, mut covariance) = match self.samples {
            [Some((p, c)), Some((q, d))] => (0.5 * (p + q), 0.5 * (c + d) + doubt),
            [Some((p, c)), None] | [None, Some((p, c))] => (p, c + 2.0 * doubt),
            [None, None] => return None,
        };
        if let Some((point, spread)) = &known.middle {
            (middle, covariance) = fuse((&middle, &covariance), (point, spread))?;
        }
        Some(Pose::new((&middle, &covariance), (&known.between.vector, &known.between.covariance)))
    }

    fn views(&self, prior: &Pose, seen: &BTreeMap<usize, Seen>, scene: &Scene) -> Vec<View<'_>> {
        let mut views = Vec::with_capacity(self.images.len());
        for Image { camera, lag_s, candidates } in &self.images {
            let image =
                |k: usize| scene.rig.cameras[*camera].project_linear(&(prior.place(k).0 + self.velocity * *lag_s));
            if let (Some(p), Some(q)) = (image(0), image(1)) {
                let seen = seen.get(camera).copied().unwrap_or_else(usual);
                views.push(View { camera: *camera, candidates, expected: [p, q], seen });
            }
        }
        views
    }

    fn fitted(&self, known: &Known, given: &Given) -> Option<(Vec<View<'_>>, Fitted)> {
        let prior = self.pose(known)?;
        let views = self.views(&prior, &known.seen, scene_of(given.scenes, self.index));
        let fitted = fit(&prior, &views, given.merging_px);
        Some((views, fitted))
    }

    /// Where the two are after this look, and what each camera saw.
    pub fn taken_in(&self, known: &Known, given: &Given) -> Option<(Pose, Vec<(usize, Choice)>)> {
        let (views, fitted) = self.fitted(known, given)?;
        let cameras = views.iter().map(|v| v.camera);
        Some((fitted.pose, cameras.zip(fitted.choices).collect()))
    }

    /// The two places and the dots of each.
    pub fn shared_out(&self, known: &Known, given: &Given) -> Option<SharedOut> {
        let (views, fitted) = self.fitted(known, given)?;
        let own = |which: usize| {
            let chosen = views.iter().zip(&fitted.choices).filter_map(|(v, c)| Some(v.candidates[c.of[which]?].dot));
            let mut dots: Vec<u32> = chosen.collect();
            dots.sort_unstable();
            dots
        };
        let dots = [own(0), own(1)];
        let apart = fitted.choices.iter().any(|c| matches!(c.of, [Some(k), Some(l)] if k != l));
        Some(SharedOut { pose: fitted.pose, dots, apart })
    }
}

impl SharedOut {
    /// As samples of these trajectories.
    pub fn samples(self, tracks: [u32; 2], look: &Look) -> [Sample; 2] {
        [0, 1].map(|k| {
            let state = self.pose.place(k);
            let known = self.dots[k].len() >= RAYS && state.1.trace().sqrt() < KNOWN;
            let kind = if known { Kind::Measured } else { Kind::Predicted };
            Sample { velocity: look.velocity, ..Sample::new(tracks[k], state, kind, &self.dots[k], 1.0) }
        })
    }
}
