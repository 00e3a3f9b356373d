//! The epipolar test between dots of two cameras at one moment.

use crate::camera::Camera;
use crate::strands::Moving;
use nalgebra::{Matrix3, Vector2, Vector3};

/// Two cameras, of two recordings.
#[derive(Clone, Debug)]
pub struct CameraPair {
    /// Index of the first camera's view, and of the second's.
    pub views: [usize; 2],
    essential: Matrix3<f64>,
    focal_px: f64,
}

/// A line in the second image, scaled so that a product with a normalised place is a distance in pixels.
pub type Line = Vector3<f64>;

impl CameraPair {
    /// `None` where two cameras stand at one place: they have no epipolar lines.
    pub fn new(views: [usize; 2], first: &Camera, second: &Camera) -> Option<Self> {
        let rotation = second.camera_from_world * first.camera_from_world.transpose();
        let baseline = second.camera_from_world_point(&first.position_m);
        let essential = baseline.cross_matrix() * rotation;
        let focal_px = 0.5 * (second.focal_px[0] + second.focal_px[1]);
        (baseline.norm() > 1e-6).then_some(Self { views, essential, focal_px })
    }

    /// Focal length of the second camera (px).
    pub fn focal_px(&self) -> f64 {
        self.focal_px
    }

    /// The epipolar line of a place in the first image; `None` at the epipole.
    pub fn line(&self, place: &Vector2<f64>) -> Option<Line> {
        let line = self.essential * place.push(1.0);
        let norm = line.xy().norm();
        (norm > 1e-12).then(|| line * (self.focal_px / norm))
    }
}

/// Signed distance of a place from a line (px).
pub fn distance(line: &Line, place: &Vector2<f64>) -> f64 {
    line.x * place.x + line.y * place.y + line.z
}

/// How fast a dot leaves a line (px per frame).
pub fn rate(line: &Line, dot: &Moving) -> f64 {
    line.xy().dot(&dot.per_frame)
}
