//! Rays that met by chance: a marker that one camera sees, and a hidden one's dot in another camera, look like one marker
//! that two see. Where the rays are near enough to meet, something is measured, anywhere along them.
//!
//! Once the whole take says where hidden markers are, such a pair of dots is asked again: with the sample forgotten and its
//! marker carried instead, is the second dot rather the marker's, which the first one shows where to look for, or rather a
//! hidden one's? Lee et al. 2000, §5.2, ask the same of two lost markers before one is born.

use super::super::frame::Frame;
use super::super::innovation::GATE;
use super::super::matching::Prior;
use super::super::{Kind, Sample, Shot, TrackOptions, Tracked};
use super::carry::{carry, forget_carried};
use super::regain::{prior, velocity};
use super::scene_of;
use crate::correspond::scene::Scene;
use nalgebra::{Matrix2, Matrix2x3, Vector2};
use rayon::prelude::*;

/// What is taken out tells better where others are, so it is asked again, so many times at most.
const ROUNDS: usize = 3;
/// A marker whose place is known up to so many times worse than what is given out is still asked which dots are its own.
const WORSE: f64 = 3.0;

/// A recorded take, and how far markers are carried in it.
pub struct Take<'a> {
    pub scenes: &'a [(usize, &'a Scene)],
    pub shots: &'a [Shot],
    pub times_s: &'a [f64],
    pub options: &'a TrackOptions,
}

impl Take<'_> {
    /// Takes out the samples of carried `frames` whose two rays met by chance; what is hidden then is carried anew.
    pub fn without_chance(&self, frames: &mut [Tracked]) {
        for _ in 0..ROUNDS {
            let suspects: Vec<Vec<u32>> =
                (0..frames.len()).into_par_iter().map(|index| self.suspects(index, frames)).collect();
            let without = self.carried_without(frames, &suspects, WORSE);
            let met =
                |(index, suspects): (usize, &Vec<u32>)| self.met_by_chance(index, suspects, &frames[index], &without);
            let found: Vec<Vec<u32>> = suspects.par_iter().enumerate().map(met).collect();
            if found.iter().all(Vec::is_empty) {
                return;
            }
            frames.clone_from_slice(&self.carried_without(frames, &found, 1.0));
        }
    }

    /// The frames without some of their tracks, and with all that is hidden carried, known up to so many times worse than
    /// what is given out.
    fn carried_without(&self, frames: &[Tracked], tracks: &[Vec<u32>], worse: f64) -> Vec<Tracked> {
        let mut without = frames.to_vec();
        forget_carried(&mut without);
        for (frame, tracks) in without.iter_mut().zip(tracks) {
            frame.samples.retain(|s| !tracks.contains(&s.track));
        }
        carry(&mut without, self.times_s, self.options.memory_s, worse * self.options.largest_sigma_m);
        without
    }

    /// Tracks that two dots measure in a frame, one of which may be a hidden marker's.
    fn suspects(&self, index: usize, frames: &[Tracked]) -> Vec<u32> {
        let hidden = self.hidden(index, frames);
        let measured = |s: &&Sample| s.kind == Kind::Measured && s.dots.len() == 2;
        let samples: Vec<&Sample> = frames[index].samples.iter().filter(measured).collect();
        if hidden.is_empty() || samples.is_empty() {
            return Vec::new();
        }
        let image = self.image(index);
        let near = |dot: u32| hidden.iter().any(|(_, p)| image.seen(dot, p).is_some_and(|s| s.squared < GATE));
        samples.into_iter().filter(|s| s.dots.iter().any(|&d| near(d))).map(|s| s.track).collect()
    }

    /// Those of the `suspects` of a frame of which one dot is rather a hidden marker's, given the other one.
    fn met_by_chance(&self, index: usize, suspects: &[u32], frame: &Tracked, without: &[Tracked]) -> Vec<u32> {
        if suspects.is_empty() {
            return Vec::new();
        }
        let (hidden, image) = (self.hidden(index, without), self.image(index));
        let is_given_out = |p: &Prior| p.covariance.trace().sqrt() < self.options.largest_sigma_m;
        let is_anothers = |track: u32, known: u32, asked: u32| -> Option<bool> {
            let own = &hidden.iter().find(|(t, _)| *t == track)?.1;
            let as_own = image.seen(asked, &image.seen(known, own)?.posterior(own))?.ln;
            let others = hidden.iter().filter(|(t, p)| *t != track && is_given_out(p));
            Some(others.filter_map(|(_, p)| image.seen(asked, p)).any(|s| s.ln > as_own))
        };
        let met = |s: &&Sample| match s.dots[..] {
            [a, b] if suspects.contains(&s.track) => {
                [(a, b), (b, a)].into_iter().any(|(a, b)| is_anothers(s.track, a, b) == Some(true))
            }
            _ => false,
        };
        frame.samples.iter().filter(met).map(|s| s.track).collect()
    }

    /// Where the hidden markers of a frame are, by track.
    fn hidden(&self, index: usize, frames: &[Tracked]) -> Vec<(u32, Prior)> {
        let hidden = frames[index].samples.iter().filter(|s| s.kind == Kind::Predicted);
        hidden.map(|s| (s.track, prior(s, velocity(frames, self.times_s, index, s.track)))).collect()
    }

    fn image(&self, index: usize) -> Image<'_> {
        let scene = scene_of(self.scenes, index);
        let mut frame = Frame::new(scene, &self.shots[index].dots);
        frame.lag_s.clone_from(&self.shots[index].lag_s);
        Image { scene, frame }
    }
}

/// The dots of one frame.
struct Image<'a> {
    scene: &'a Scene,
    frame: Frame<'a>,
}

/// A dot as a marker's.
struct Seen {
    /// Offset from where the marker is expected (px), what it is by the marker's place (px/m), and its covariance (px²).
    offset: Vector2<f64>,
    by_point: Matrix2x3<f64>,
    inverse: Matrix2<f64>,
    /// Squared offset in its spreads, and the logarithm of its likelihood (px⁻²).
    squared: f64,
    ln: f64,
}

impl Image<'_> {
    fn seen(&self, dot: u32, prior: &Prior) -> Option<Seen> {
        let sight = self.frame.sight(dot);
        let lag_s = self.frame.lag_s(sight.camera);
        let (pixel, by_point) = self.scene.rig.cameras[sight.camera].project_linear(&prior.after(lag_s))?;
        let spread = by_point * prior.covariance_after(lag_s) * by_point.transpose()
            + Matrix2::identity() * sight.sigma_px.powi(2);
        let (offset, inverse) = (self.frame.pixel(dot) - pixel, spread.try_inverse()?);
        let squared = offset.dot(&(inverse * offset));
        let ln = -0.5 * (squared + spread.determinant().ln()) - std::f64::consts::TAU.ln();
        Some(Seen { offset, by_point, inverse, squared, ln })
    }
}

impl Seen {
    /// Where the marker is if the dot is its own.
    fn posterior(&self, prior: &Prior) -> Prior {
        let gain = prior.covariance * self.by_point.transpose() * self.inverse;
        let covariance = prior.covariance - gain * self.by_point * prior.covariance;
        Prior { point: prior.point + gain * self.offset, covariance, ..*prior }
    }
}
