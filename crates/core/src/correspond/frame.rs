//! One frame's dots, prepared: rays, their chords through the region, and the evidence each dot carries.

use super::scene::Scene;
use crate::sight::Sight;
use nalgebra::Vector2;

/// One dot as it came from a camera.
#[derive(Clone, Copy, Debug)]
pub struct Dot {
    /// Index of the camera in the rig.
    pub camera: usize,
    /// Measured pixel.
    pub pixel: [f64; 2],
    /// The dot's own standard deviation (px), or 1 where it is not known.
    pub sigma: f64,
    /// Identity that an active marker told.
    pub hardware: Option<u32>,
}

impl Dot {
    /// Whether two dots may be one marker's, by what they told of themselves.
    pub fn may_be(&self, other: &Self) -> bool {
        self.hardware.is_none() || other.hardware.is_none() || self.hardware == other.hardware
    }
}

/// A frame's dots as sights, ordered by camera.
#[derive(Clone, Debug)]
pub struct PreparedFrame {
    /// Sights in ascending order of camera.
    pub sights: Vec<Sight>,
    /// Where each sight stands in the input.
    pub input_index: Vec<usize>,
    /// First sight of each camera, and one past the last.
    pub camera_start: Vec<usize>,
    /// Part of each ray inside the region (m along the ray).
    pub chords: Vec<[f64; 2]>,
    /// What a dot adds to the log-likelihood ratio of a group, before its residual (nats).
    pub gains: Vec<f64>,
    /// The dots as they came.
    pub dots: Vec<Dot>,
}

impl PreparedFrame {
    /// Prepares dots; those that cannot belong to a marker (masked, where the lens model has folded over, or looking past
    /// the region) are left out.
    pub fn new(scene: &Scene, dots: &[Dot]) -> Self {
        let mut order: Vec<usize> = (0..dots.len()).collect();
        order.sort_by_key(|&i| dots[i].camera);
        let mut frame = Self {
            sights: Vec::with_capacity(dots.len()),
            input_index: Vec::with_capacity(dots.len()),
            camera_start: vec![0; scene.rig.cameras.len() + 1],
            chords: Vec::with_capacity(dots.len()),
            gains: Vec::with_capacity(dots.len()),
            dots: Vec::with_capacity(dots.len()),
        };
        for i in order {
            frame.push(scene, &dots[i], i);
        }
        for sight in &frame.sights {
            frame.camera_start[sight.camera + 1] += 1;
        }
        for camera in 0..scene.rig.cameras.len() {
            frame.camera_start[camera + 1] += frame.camera_start[camera];
        }
        frame
    }

    /// Adds a dot; `None` if it cannot belong to a marker.
    fn push(&mut self, scene: &Scene, dot: &Dot, index: usize) -> Option<()> {
        let camera = &scene.rig.cameras[dot.camera];
        let pixel = Vector2::from(dot.pixel);
        if camera.mask.covers(pixel) {
            return None;
        }
        let sigma_px = dot.sigma * scene.model.noise[dot.camera];
        let sight = Sight::new(camera, dot.camera, pixel, sigma_px)?;
        let chord = scene.model.region.chord(&sight.origin, &sight.direction)?;
        let alone = scene.ln_alone(&sight, pixel, Some(chord));
        self.gains.push(-(std::f64::consts::TAU * sigma_px * sigma_px).ln() - alone);
        self.sights.push(sight);
        self.dots.push(*dot);
        self.chords.push(chord);
        self.input_index.push(index);
        Some(())
    }

    /// Number of dots.
    pub fn len(&self) -> usize {
        self.sights.len()
    }

    /// Whether there is no dot.
    pub fn is_empty(&self) -> bool {
        self.sights.is_empty()
    }
}
