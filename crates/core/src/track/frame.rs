//! One frame's dots as the tracker uses them: rays, sorted by place within each camera, free until somebody owns them.

use super::flow::Motion;
use super::threads;
use crate::correspond::frame::Dot;
use crate::correspond::scene::Scene;
use crate::sight::Sight;
use nalgebra::{Vector2, Vector3};
use std::borrow::Cow;

/// New or unexplained markers per image.
const UNKNOWN_PER_IMAGE: f64 = 0.1;
/// A reflection says nothing about a dot so far away (squared, in its spreads).
const BESIDE: f64 = 50.0;

/// A frame in work.
pub struct Frame<'a> {
    /// The dots as they came.
    pub dots: &'a [Dot],
    /// Their rays; `None` for dots that cannot belong to a marker (masked, or where the lens model has folded over).
    pub sights: Vec<Option<Sight>>,
    /// Usable dots of each camera, by ascending x.
    pub by_camera: Vec<Vec<u32>>,
    /// Largest noise of each camera's dots (px).
    pub widest_sigma_px: Vec<f64>,
    /// Logarithm of the density (px⁻²) of dots that belong to nothing known, at each dot: clutter, fixed reflections.
    pub ln_alone: Vec<f64>,
    /// Whether nobody owns the dot yet.
    pub free: Vec<bool>,
    /// By camera, how much later than the frame's moment its image was taken (s); empty where all saw one moment.
    pub lag_s: Vec<f64>,
    /// How the dots move in the image (px/s), where cameras saw different moments and it is known.
    pub flow: Vec<Option<Vector2<f64>>>,
    /// Dots that markers look at without owning them; numbered after the frame's own.
    borrowed: Vec<Sight>,
}

impl<'a> Frame<'a> {
    /// Prepares the dots of one frame.
    pub fn new(scene: &Scene, dots: &'a [Dot]) -> Self {
        let cameras = scene.rig.cameras.len();
        let mut frame = Self {
            dots,
            sights: Vec::new(),
            by_camera: (0..cameras).map(|_| Vec::with_capacity(2 * dots.len() / cameras.max(1))).collect(),
            widest_sigma_px: vec![0.0; cameras],
            ln_alone: Vec::with_capacity(dots.len()),
            free: vec![true; dots.len()],
            lag_s: Vec::new(),
            flow: Vec::new(),
            borrowed: Vec::new(),
        };
        let ln_clutter: Vec<f64> = (0..cameras).map(|camera| clutter(scene, camera).ln()).collect();
        let sight = |dot: &Dot| {
            let (camera, pixel) = (&scene.rig.cameras[dot.camera], Vector2::from(dot.pixel));
            let sigma = dot.sigma * scene.model.noise[dot.camera];
            let usable = !camera.mask.covers(pixel);
            usable.then(|| Sight::new(camera, dot.camera, pixel, sigma)).flatten()
        };
        frame.sights = threads::map(dots.iter().collect(), dots.len(), sight);
        for (index, (dot, sight)) in dots.iter().zip(&frame.sights).enumerate() {
            if let Some(Sight { camera, sigma_px, .. }) = sight {
                frame.by_camera[*camera].push(index as u32);
                frame.widest_sigma_px[*camera] = frame.widest_sigma_px[*camera].max(*sigma_px);
            }
            frame.free[index] = sight.is_some();
            frame.ln_alone.push(ln_alone(scene, dot.camera, dot.pixel.into()).unwrap_or(ln_clutter[dot.camera]));
        }
        for own in &mut frame.by_camera {
            own.sort_unstable_by(|&a, &b| {
                dots[a as usize].pixel[0].total_cmp(&dots[b as usize].pixel[0]).then(a.cmp(&b))
            });
        }
        frame
    }

    /// Where a dot is (px).
    pub fn pixel(&self, dot: u32) -> Vector2<f64> {
        Vector2::from(self.dots[dot as usize].pixel)
    }

    /// Noise of a usable dot (px).
    pub fn sigma_px(&self, dot: u32) -> f64 {
        self.sight(dot).sigma_px
    }

    /// How much later than the frame's moment a camera saw it (s).
    pub fn lag_s(&self, camera: usize) -> f64 {
        self.lag_s.get(camera).copied().unwrap_or(0.0)
    }

    /// The ray of a dot for a marker that moves, near a place, as of the frame's moment: a marker that goes on by v·lag seen
    /// from one place is one that stays seen from a place v·lag behind. What is not known of its velocity adds noise.
    pub fn ray(&self, dot: u32, motion: &Motion, near: &Vector3<f64>) -> Cow<'_, Sight> {
        let sight = self.sight(dot);
        let lag_s = self.lag_s(sight.camera);
        if lag_s == 0.0 {
            return Cow::Borrowed(sight);
        }
        let spread = motion.variance.sqrt() * lag_s.abs() / (sight.angle_sigma * sight.depth(near).max(1e-3));
        let noisier = sight.with_noise((1.0 + spread * spread).sqrt());
        Cow::Owned(Sight { origin: sight.origin - motion.velocity * lag_s, ..noisier })
    }

    /// Gives a dot at least so much noise (px), because it may be two markers' in one; returns the number of a loan of
    /// it for the other marker.
    pub fn share(&mut self, dot: u32, least_sigma_px: f64) -> u32 {
        let sight = self.sight(dot);
        let factor = sight.sigma_px.max(least_sigma_px) / sight.sigma_px;
        let shared = sight.with_noise(factor);
        self.sights[dot as usize] = Some(shared.clone());
        self.borrowed.push(shared);
        (self.dots.len() + self.borrowed.len() - 1) as u32
    }

    /// Whether a number stands for a loan.
    pub fn is_lent(&self, dot: u32) -> bool {
        dot as usize >= self.dots.len()
    }

    /// The ray of a usable dot or a loan.
    pub fn sight(&self, dot: u32) -> &Sight {
        if let Some(loan) = (dot as usize).checked_sub(self.dots.len()) {
            return &self.borrowed[loan];
        }
        self.sights[dot as usize].as_ref().expect("only usable dots are handed out")
    }
}

/// Density of a camera's dots that belong to nothing known and to no reflection (px⁻²).
fn clutter(scene: &Scene, camera: usize) -> f64 {
    let [width, height] = scene.rig.cameras[camera].size_px;
    (scene.model.clutter[camera] + UNKNOWN_PER_IMAGE) / (width * height)
}

/// Logarithm of the density (px⁻²) of dots that belong to nothing known, beside a reflection; `None` where there is none.
fn ln_alone(scene: &Scene, camera: usize, pixel: Vector2<f64>) -> Option<f64> {
    let mut reflected = None;
    for reflection in &scene.model.reflections[camera] {
        let variance = reflection.spread_px * reflection.spread_px;
        let squared = (pixel - Vector2::from(reflection.pixel)).norm_squared() / variance;
        if squared < BESIDE {
            let density = reflection.rate * (-0.5 * squared).exp() / (std::f64::consts::TAU * variance);
            *reflected.get_or_insert_with(|| clutter(scene, camera)) += density;
        }
    }
    reflected.map(f64::ln)
}
