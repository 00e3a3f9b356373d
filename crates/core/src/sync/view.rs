//! What one camera of a recording saw, on the normalised image plane.

use crate::camera::Camera;
use crate::strands::{LARGEST_STEP, Strands};
use nalgebra::Vector2;

/// One camera's dots, linked from frame to frame.
#[derive(Clone, Debug)]
pub struct View {
    /// Index of the camera.
    pub camera: usize,
    /// Its dots on the normalised image plane.
    pub strands: Strands,
}

impl View {
    /// From the dots (px) of each frame. Dots where the lens model has folded over are left out.
    pub fn new(camera: &Camera, index: usize, frames: &[Vec<Vector2<f64>>]) -> Self {
        let ideal = |dots: &Vec<Vector2<f64>>| dots.iter().filter_map(|p| camera.normalised_from_pixel(*p)).collect();
        let places: Vec<Vec<Vector2<f64>>> = frames.iter().map(ideal).collect();
        Self { camera: index, strands: Strands::new(&places, LARGEST_STEP * camera.size_px[0] / camera.focal_px[0]) }
    }
}
