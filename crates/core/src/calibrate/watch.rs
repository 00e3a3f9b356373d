//! Watches a rig while it is used: a camera that is knocked is found, and its pose solved anew from the others.
//!
//! Every point is placed without a camera's own ray; where that camera's dots lie beside the place's projection, and by
//! how much, is a *look*. A camera moved when, from one frame on, the same trajectories lie elsewhere in it than just
//! before: comparing each trajectory with itself leaves what was wrong already out of it. Its new pose is a resection
//! from the others' places; they stay exactly as they are. Works on a stream: nothing but the frames so far is used.

use super::bundle::robust::median;
use super::resection::{FEWEST, Known, refine};
use crate::camera::Camera;
use crate::correspond::frame::Dot;
use nalgebra::{Matrix3, Vector2, Vector3};
use std::collections::VecDeque;

/// One marker of one frame: its trajectory, where it is (m), and the dots (indices) that say so.
#[derive(Clone, Copy, Debug)]
pub struct Placed<'a> {
    /// Identity of the trajectory.
    pub track: u32,
    /// Place (m, world).
    pub place: Vector3<f64>,
    /// Velocity (m/s), for cameras that saw it at another moment.
    pub velocity: Vector3<f64>,
    /// Indices of its dots in the frame.
    pub dots: &'a [u32],
}

/// A camera that was moved.
#[derive(Clone, Debug)]
pub struct Moved {
    /// Index of the camera.
    pub camera: usize,
    /// Number of the first frame in which it stood elsewhere.
    pub since: i64,
    /// Number of the frame in which it was found out.
    pub found: i64,
    /// By how much (px) its dots lay beside their places.
    pub shift_px: Vector2<f64>,
    /// The camera as it stands now.
    pub now: Camera,
    /// Dots from which that is known.
    pub dots: usize,
}

/// Looks before and after a step that must agree on it.
const BESIDE: usize = 6;
/// Fewer markers in a frame say nothing about a camera.
const FEWEST_MARKERS: usize = 4;
/// A dot belongs to a place within this many standard deviations.
const NEAR: f64 = 6.0;
/// Places less certain in the image than so many times the dots' noise tell nothing.
const UNSURE: f64 = 5.0;
/// A step counts when it is this many times the dots' noise and its own standard error.
const STEP_NOISES: f64 = 2.0;
const STEP_ERRORS: f64 = 8.0;
/// A moved camera's dots are looked for within this part of the image's diagonal.
const REACH: f64 = 0.03;
/// Markers looked at in a frame, always the same ones; more would tell hardly more.
const MOST_MARKERS: usize = 60;
/// The pose of a moved camera is solved again each time the dots have doubled, up to so many.
const MOST_PAIRS: usize = 6000;
/// Weight of one frame in what share of its places a camera usually has a dot of.
const USUAL: f64 = 0.05;

/// What one camera saw of one trajectory placed by the others.
#[derive(Clone, Copy)]
struct Seen {
    track: u32,
    place: Vector3<f64>,
    pixel: Vector2<f64>,
    offset: Vector2<f64>,
}

struct Look {
    frame: i64,
    seen: Vec<Seen>,
    /// Median offset (px).
    middle: Vector2<f64>,
}

/// A place by the other cameras and where a camera should see it.
struct Expected {
    track: u32,
    place: Vector3<f64>,
    pixel: Vector2<f64>,
}

#[derive(Default)]
struct Eye {
    looks: VecDeque<Look>,
    usual: Option<f64>,
    /// After a move: what is known since, and from how many dots the pose was solved.
    moved: Option<(Moved, Vec<Known>)>,
}

/// Watches the cameras of a rig.
pub struct Watch {
    cameras: Vec<Camera>,
    eyes: Vec<Eye>,
}

/// A step of a camera's dots.
struct Step {
    /// Looks of the camera before it.
    at: usize,
    shift_px: Vector2<f64>,
    /// Times what it must be to count.
    clearness: f64,
}

impl Watch {
    /// Watches these cameras.
    pub fn new(cameras: &[Camera]) -> Self {
        Self { cameras: cameras.to_vec(), eyes: cameras.iter().map(|_| Eye::default()).collect() }
    }

    /// From the next frame on, a camera is known to stand elsewhere.
    pub fn replace(&mut self, camera: usize, now: Camera) {
        self.cameras[camera] = now;
        self.eyes.iter_mut().for_each(|eye| eye.looks.clear());
    }

    /// Takes in a frame; the cameras that are known to stand elsewhere since, or whose new pose is known better now.
    ///
    /// `shot`: the frame's dots, and by camera how much later than the frame's moment they were seen (s; empty if not).
    /// `noise_px`: standard deviation of a dot of sigma 1, by camera.
    pub fn push(&mut self, frame: i64, placed: &[Placed], shot: (&[Dot], &[f64]), noise_px: &[f64]) -> Vec<Moved> {
        let (dots, expected) = (shot.0, self.expected(placed, shot, noise_px));
        for (camera, expected) in expected.into_iter().enumerate() {
            let mut pixels: Vec<Vector2<f64>> =
                dots.iter().filter(|d| d.camera == camera).map(|d| Vector2::from(d.pixel)).collect();
            pixels.sort_by(|a, b| a.x.total_cmp(&b.x));
            self.look(camera, frame, &expected, &pixels, noise_px[camera]);
        }
        let mut found: Vec<Moved> = (0..self.eyes.len()).filter_map(|c| self.settle(c)).collect();
        found.extend(self.clearest(frame, noise_px));
        for moved in &found {
            self.cameras[moved.camera] = moved.now.clone();
        }
        found
    }

    /// The cameras that were moved last, each solved from all its dots so far.
    pub fn latest(&self) -> Vec<Moved> {
        let best = |(moved, pairs): &(Moved, Vec<Known>)| {
            let now = refine(&self.cameras[moved.camera], pairs, true);
            Moved { now, dots: pairs.len(), ..moved.clone() }
        };
        self.eyes.iter().filter_map(|eye| eye.moved.as_ref().map(best)).collect()
    }

    /// For each camera, the places that the others give, and where it should see them.
    fn expected(&self, placed: &[Placed], (dots, lag_s): (&[Dot], &[f64]), noise_px: &[f64]) -> Vec<Vec<Expected>> {
        let lag_s = |camera: usize| lag_s.get(camera).copied().unwrap_or(0.0);
        let mut expected: Vec<Vec<Expected>> = self.cameras.iter().map(|_| Vec::new()).collect();
        let one_in = placed.len().div_ceil(MOST_MARKERS).max(1) as u32;
        for marker in placed.iter().filter(|p| p.dots.len() >= 2 && p.track % one_in == 0) {
            let rays: Vec<Ray> = marker
                .dots
                .iter()
                .filter_map(|&d| {
                    let dot = &dots[d as usize];
                    Ray::new(&self.cameras, dot, &(marker.place + marker.velocity * lag_s(dot.camera)), noise_px)
                })
                .collect();
            let all = rays.iter().fold(Ray::none(), |sum, ray| sum.plus(ray, 1.0));
            for (camera, one) in self.cameras.iter().enumerate() {
                let own = rays.iter().filter(|r| r.camera == camera);
                let others = own.clone().fold(all, |sum, ray| sum.plus(ray, -1.0));
                if rays.len() >= 2 + own.count()
                    && let Some((place, covariance)) = others.meet(&(marker.place + marker.velocity * lag_s(camera)))
                    && let Some((pixel, by_place)) = one.project_linear(&place)
                    && (by_place * covariance * by_place.transpose()).trace()
                        < 2.0 * (UNSURE * noise_px[camera]).powi(2)
                {
                    expected[camera].push(Expected { track: marker.track, place, pixel });
                }
            }
        }
        expected
    }

    /// What a camera sees of the places: near where it should, or all of them beside it.
    fn look(&mut self, camera: usize, frame: i64, expected: &[Expected], pixels: &[Vector2<f64>], noise_px: f64) {
        if expected.len() < FEWEST_MARKERS {
            return;
        }
        let [width, height] = self.cameras[camera].size_px;
        let eye = &mut self.eyes[camera];
        let mut seen = near(expected, pixels, Vector2::zeros(), NEAR * noise_px);
        let needed = (0.5 * eye.usual.unwrap_or(0.0) * expected.len() as f64).max(FEWEST_MARKERS as f64);
        if (seen.len() as f64) < needed
            && let Some(shift) = common_shift(expected, pixels, REACH * width.hypot(height), needed, NEAR * noise_px)
        {
            seen = near(expected, pixels, shift, NEAR * noise_px);
        }
        if (seen.len() as f64) < needed {
            return;
        }
        let share = seen.len() as f64 / expected.len() as f64;
        let usual = eye.usual.unwrap_or(share);
        eye.usual = Some(usual + USUAL * (share - usual));
        if let Some((_, pairs)) = &mut eye.moved
            && pairs.len() < MOST_PAIRS
        {
            pairs.extend(seen.iter().map(|s| (s.place, s.pixel)));
        }
        let middle = middle(seen.iter().map(|s| s.offset));
        eye.looks.push_back(Look { frame, seen, middle });
        if eye.looks.len() > 2 * BESIDE {
            eye.looks.pop_front();
        }
    }

    /// The pose of a moved camera, solved again when twice as many dots tell of it.
    fn settle(&mut self, camera: usize) -> Option<Moved> {
        let (moved, pairs) = self.eyes[camera].moved.as_mut()?;
        if pairs.len() < 2 * moved.dots {
            return None;
        }
        moved.now = refine(&self.cameras[camera], pairs, true);
        moved.dots = pairs.len();
        let better = moved.clone();
        if pairs.len() >= MOST_PAIRS {
            self.eyes[camera].moved = None;
        }
        self.eyes[camera].looks.clear();
        Some(better)
    }

    /// The camera whose dots stepped aside most clearly, if any did. Others follow it a little, as their points have a
    /// ray of it: they are looked at anew.
    fn clearest(&mut self, frame: i64, noise_px: &[f64]) -> Option<Moved> {
        let steps = self.eyes.iter().enumerate().filter_map(|(c, eye)| Some((c, eye.step(noise_px[c])?)));
        let (camera, step) = steps.max_by(|a, b| a.1.clearness.total_cmp(&b.1.clearness))?;
        let after: Vec<&Look> = self.eyes[camera].looks.iter().skip(step.at).collect();
        let pairs: Vec<Known> = after.iter().flat_map(|l| l.seen.iter().map(|s| (s.place, s.pixel))).collect();
        if pairs.len() < FEWEST {
            return None;
        }
        let now = refine(&self.cameras[camera], &pairs, true);
        let moved =
            Moved { camera, since: after[0].frame, found: frame, shift_px: step.shift_px, now, dots: pairs.len() };
        self.eyes[camera].moved = Some((moved.clone(), pairs));
        self.eyes.iter_mut().for_each(|eye| eye.looks.clear());
        Some(moved)
    }
}

impl Eye {
    /// The step between the older and the newer half of the looks, if it counts.
    fn step(&self, noise_px: f64) -> Option<Step> {
        if self.looks.len() < 2 * BESIDE {
            return None;
        }
        let half = |range: std::ops::Range<usize>| middle(self.looks.range(range).map(|l| l.middle));
        if (half(BESIDE..2 * BESIDE) - half(0..BESIDE)).norm() < 0.5 * STEP_NOISES * noise_px {
            return None;
        }
        let mut by_track: Vec<(u32, usize, Vector2<f64>)> = Vec::new();
        for (k, look) in self.looks.iter().enumerate() {
            by_track.extend(look.seen.iter().map(|s| (s.track, k, s.offset)));
        }
        by_track.sort_by_key(|s| (s.0, s.1));
        let halves = |own: &[(u32, usize, Vector2<f64>)]| {
            let (before, after): (Vec<_>, Vec<_>) = own.iter().partition(|s| s.1 < BESIDE);
            let enough = before.len().min(after.len()) * 2 >= BESIDE;
            let middle = |half: &[(u32, usize, Vector2<f64>)]| middle(half.iter().map(|s| s.2));
            enough.then(|| (middle(&before), middle(&after)))
        };
        let own: Vec<(Vector2<f64>, Vector2<f64>)> = by_track.chunk_by(|a, b| a.0 == b.0).filter_map(halves).collect();
        if own.len() < FEWEST_MARKERS {
            return None;
        }
        let shift_px = middle(own.iter().map(|(before, after)| after - before));
        let mut off: Vec<f64> = own.iter().map(|(b, a)| (a - b - shift_px).norm()).collect();
        let error = median(&mut off) / (own.len() as f64).sqrt();
        let clearness = shift_px.norm() / (STEP_NOISES * noise_px).max(STEP_ERRORS * error);
        let at = self.first_after(shift_px);
        // All of the newer half must lie after it: a step that has just begun is waited for.
        (clearness > 1.0 && at <= BESIDE).then_some(Step { at, shift_px, clearness })
    }

    /// The first look of the newer half, or a little before or after, whose dots lie where the later ones do.
    fn first_after(&self, shift_px: Vector2<f64>) -> usize {
        let all = |range: std::ops::Range<usize>| {
            middle(self.looks.range(range).flat_map(|l| l.seen.iter().map(|s| s.offset)))
        };
        let n = self.looks.len();
        let (old, new) = (all(0..BESIDE / 2), all(n - BESIDE / 2..n));
        let halfway = 0.5 * (old + new);
        let later = |k: &usize| (all(*k..*k + 1) - halfway).dot(&shift_px) > 0.0;
        (0..n).find(later).unwrap_or(BESIDE)
    }
}

/// A dot's ray linearised at a marker's place, or the sum of several.
#[derive(Clone, Copy)]
struct Ray {
    camera: usize,
    information: Matrix3<f64>,
    gradient: Vector3<f64>,
}

impl Ray {
    fn new(cameras: &[Camera], dot: &Dot, place: &Vector3<f64>, noise_px: &[f64]) -> Option<Self> {
        let (pixel, by_place) = cameras[dot.camera].project_linear(place)?;
        let weight = (dot.sigma * noise_px[dot.camera]).powi(-2);
        let off = Vector2::from(dot.pixel) - pixel;
        Some(Self {
            camera: dot.camera,
            information: by_place.transpose() * by_place * weight,
            gradient: by_place.transpose() * off * weight,
        })
    }

    fn none() -> Self {
        Self { camera: usize::MAX, information: Matrix3::zeros(), gradient: Vector3::zeros() }
    }

    fn plus(&self, other: &Self, times: f64) -> Self {
        Self {
            camera: self.camera,
            information: self.information + other.information * times,
            gradient: self.gradient + other.gradient * times,
        }
    }

    /// The place where summed rays meet, by one step of least squares, and the covariance.
    fn meet(&self, from: &Vector3<f64>) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        let covariance = self.information.cholesky()?.inverse();
        Some((from + covariance * self.gradient, covariance))
    }
}

/// The dot nearest to every place shifted, within a gate. Pixels in ascending order of x.
fn near(expected: &[Expected], pixels: &[Vector2<f64>], shift: Vector2<f64>, gate_px: f64) -> Vec<Seen> {
    let nearest = |e: &Expected| {
        let at = e.pixel + shift;
        let first = pixels.partition_point(|p| p.x < at.x - gate_px);
        let near = pixels[first..].iter().take_while(|p| p.x <= at.x + gate_px);
        let dot = near.min_by(|a, b| (*a - at).norm().total_cmp(&(*b - at).norm()))?;
        let seen = Seen { track: e.track, place: e.place, pixel: *dot, offset: dot - e.pixel };
        ((dot - at).norm() < gate_px).then_some(seen)
    };
    expected.iter().filter_map(nearest).collect()
}

/// The shift on which most pairs of a place and a dot agree, if enough do: every pair proposes its own.
fn common_shift(
    expected: &[Expected],
    pixels: &[Vector2<f64>],
    reach_px: f64,
    needed: f64,
    gate_px: f64,
) -> Option<Vector2<f64>> {
    let proposals: Vec<Vector2<f64>> = expected
        .iter()
        .flat_map(|e| pixels.iter().map(move |p| p - e.pixel))
        .filter(|shift| shift.norm() < reach_px)
        .collect();
    // A camera that turned shifts all dots alike but for a few per cent.
    let width = |shift: &Vector2<f64>| gate_px + 0.05 * shift.norm();
    let votes = |s: &Vector2<f64>| proposals.iter().filter(|o| (*o - s).norm() < width(s)).count();
    let (most, best) = proposals.iter().map(|s| (votes(s), s)).max_by_key(|v| v.0)?;
    let agree = proposals.iter().filter(|o| (*o - best).norm() < width(best)).copied();
    (most as f64 >= needed).then(|| middle(agree))
}

/// Median of each coordinate; zero for none.
fn middle(of: impl Iterator<Item = Vector2<f64>>) -> Vector2<f64> {
    let (mut x, mut y): (Vec<f64>, Vec<f64>) = of.map(|v| (v.x, v.y)).unzip();
    Vector2::new(median(&mut x), median(&mut y))
}
