//! Rays that met by chance: a marker that one camera sees, and a hidden one's dot in another camera, look like one marker
//! that two see. Where the rays are near enough to meet, something is measured, anywhere along them.
//!
//! Once the whole take says where hidden markers are, such a pair of dots is asked again: with the sample forgotten and its
//! marker carried instead, are the dots rather one marker's, or one each of two that are hidden? Lee et al. 2000, §5.2, ask
//! the same of two lost markers before one is born.

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

    /// Tracks that two dots measure in a frame, one of which may be a hidden marker's; not those that told who they are.
    fn suspects(&self, index: usize, frames: &[Tracked]) -> Vec<u32> {
        let hidden = self.hidden(index, frames);
        let measured = |s: &&Sample| s.kind == Kind::Measured && s.dots.len() == 2 && s.hardware.is_none();
        let samples: Vec<&Sample> = frames[index].samples.iter().filter(measured).collect();
        if hidden.is_empty() || samples.is_empty() {
            return Vec::new();
        }
        let image = self.image(index);
        let near = |dot: u32| hidden.iter().any(|(_, p)| image.seen(dot, p).is_some_and(|s| s.squared < GATE));
        samples.into_iter().filter(|s| s.dots.iter().any(|&d| near(d))).map(|s| s.track).collect()
    }

    /// Those of the `suspects` of a frame whose two dots are rather those of two hidden markers.
    fn met_by_chance(&self, index: usize, suspects: &[u32], frame: &Tracked, without: &[Tracked]) -> Vec<u32> {
        if suspects.is_empty() {
            return Vec::new();
        }
        let (hidden, image) = (self.hidden(index, without), self.image(index));
        let met = |s: &&Sample| {
            let is_asked = |(t, p): &&(u32, Prior)| *t == s.track || self.is_given_out(p);
            let asked: Vec<&Prior> = hidden.iter().filter(is_asked).map(|(_, p)| p).collect();
            let known = hidden.iter().any(|(t, _)| *t == s.track);
            known && suspects.contains(&s.track) && image.is_rather_two(&asked, &s.dots)
        };
        frame.samples.iter().filter(met).map(|s| s.track).collect()
    }

    /// Whether a hidden marker is known well enough to be given out.
    fn is_given_out(&self, prior: &Prior) -> bool {
        prior.covariance.trace().sqrt() < self.options.largest_sigma_m
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
    /// Offset from where the marker is expected (px), its derivative by the marker's place (px/m), and its inverse covariance (px⁻²).
    offset: Vector2<f64>,
    by_point: Matrix2x3<f64>,
    inverse: Matrix2<f64>,
    /// Squared offset in its spreads, and the logarithm of its likelihood (px⁻²).
    squared: f64,
    ln: f64,
}

impl Image<'_> {
    /// Whether two dots are rather those of two of some markers than of one.
    fn is_rather_two(&self, markers: &[&Prior], dots: &[u32]) -> bool {
        let &[a, b] = dots else { return false };
        let seen = |dot: u32| -> Vec<Option<Seen>> { markers.iter().map(|p| self.seen(dot, p)).collect() };
        let (first, second) = (seen(a), seen(b));
        let (mut one, mut two) = (f64::NEG_INFINITY, f64::NEG_INFINITY);
        for (k, as_first) in first.iter().enumerate().filter_map(|(k, s)| Some((k, s.as_ref()?))) {
            if let Some(both) = self.seen(b, &as_first.posterior(markers[k])) {
                one = one.max(as_first.ln + both.ln);
            }
            let others = second.iter().enumerate().filter(|(other, _)| *other != k).filter_map(|(_, s)| s.as_ref());
            two = others.map(|s| as_first.ln + s.ln).fold(two, f64::max);
        }
        two > one
    }

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::correspond::frame::Dot;
    use crate::reconstruct::{ReconstructOptions, estimate_model};
    use crate::synth::rigs::ring;
    use nalgebra::{Matrix3, Vector3};

    /// The frame in which two markers that stand still are asked about.
    const ASKED: usize = 6;

    /// Whether a marker stays measured in a frame by the dots that two cameras see of a place, with another one hidden then:
    /// given how far the place and the other one are from the marker, along the rays of the first camera and the second (m).
    fn stays(place_along_first: f64, other_along_second: f64) -> bool {
        let rig = ring(4, 3.0, 20.0, 0.0, [1000.0, 1000.0], 1000.0);
        let model = estimate_model(&rig, &[], &ReconstructOptions::default()).expect("the rig sees the stage");
        let scene = Scene::new(&rig, &model);
        let towards = |camera: usize, point: Vector3<f64>| (point - rig.cameras[camera].position_m).normalize();
        let own = Vector3::new(0.02, 0.01, 0.0);
        let place = own + place_along_first * towards(0, own);
        let other = place + other_along_second * towards(1, place);
        let dot = |camera: usize| {
            let pixel = rig.cameras[camera].project_linear(&place).expect("it is in front").0;
            Dot { camera, pixel: pixel.into(), sigma: 1.0, hardware: None }
        };
        let sample = |track: u32, point: Vector3<f64>, dots: &[u32]| {
            Sample::new(track, (point, Matrix3::identity() * 1e-6), Kind::Measured, dots, 0.9)
        };
        let frame = |index: usize| match index {
            ASKED => vec![sample(0, place, &[0, 1])],
            _ => vec![sample(0, own, &[0, 1, 2]), sample(1, other, &[3, 4, 5])],
        };
        let mut frames: Vec<Tracked> =
            (0..2 * ASKED).map(|i| Tracked { samples: frame(i), ..Tracked::default() }).collect();
        let shot =
            |i: usize| Shot { dots: if i == ASKED { vec![dot(0), dot(1)] } else { Vec::new() }, lag_s: Vec::new() };
        let shots: Vec<Shot> = (0..frames.len()).map(shot).collect();
        let times_s: Vec<f64> = (0..frames.len()).map(|i| i as f64 / 100.0).collect();
        let options = TrackOptions::default();
        carry(&mut frames, &times_s, options.memory_s, options.largest_sigma_m);
        Take { scenes: &[(0, &scene)], shots: &shots, times_s: &times_s, options: &options }
            .without_chance(&mut frames);
        let found = frames[ASKED].samples.iter().find(|s| s.track == 0).expect("it is measured or carried");
        let nearest = if found.kind == Kind::Measured { place } else { own };
        assert!((found.point - nearest).norm() < 1e-3);
        found.kind == Kind::Measured
    }

    #[test]
    fn a_hidden_markers_dot_is_not_taken_for_another_ray() {
        assert!(!stays(0.06, 0.05), "the second dot is the hidden one's");
        assert!(!stays(-0.1, -0.08));
    }

    #[test]
    fn two_rays_that_meet_where_the_marker_is_expected_stay() {
        assert!(stays(0.0, 0.05), "the hidden one is behind it");
        assert!(stays(0.0005, -0.1), "it is off by no more than its noise");
    }
}
