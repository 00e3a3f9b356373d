//! Bundle adjustment of cameras and of the poses of one rigid object (a wand; a single marker is one too).
//!
//! Minimises `Σ w |pixel − project(camera, R p + t)|²`, w = 1/σ² times a robust factor, over cameras (pose, focal length,
//! aspect, principal point, OpenCV's lens; each may be held, see [`camera`]) and object poses, by Levenberg–Marquardt. The
//! normal equations
//!
//! ```text
//! | U  W | |δcameras|   |a|        S = U − W V⁻¹ Wᵀ   (dense, 15 per camera)
//! | Wᵀ V | |δposes  | = |b|        V is block diagonal, one block of 6 per pose
//! ```
//!
//! are reduced to the cameras (Schur complement; Triggs et al. 2000, "Bundle adjustment – a modern synthesis", §6).
//! Order of a camera's parameters: see [`camera`]; rotations are updated by small rotation vectors: a camera's in
//! its own axes, applied after; a pose's in the object's axes, applied before. Cost per iteration: O(poses × views²).

pub mod camera;
pub mod covariance;
mod normal;
pub mod robust;

use crate::calibrate::wand::{Span, Wand};
use crate::camera::Camera;
use camera::{Freedom, PARAMETERS};
use nalgebra::{DMatrix, DVector, Matrix2x3, Matrix2x6, Matrix3, Rotation3, SVector, Vector2, Vector3};
use normal::Normal;

/// Parameters of a pose: rotation (3), position (3).
pub const POSE: usize = 6;

/// Where the object was in one frame: `point_in_world = rotation * marker + position_m`.
#[derive(Clone, Copy, Debug)]
pub struct Pose {
    /// World from object axes.
    pub rotation: Matrix3<f64>,
    /// The object's centroid in world metres.
    pub position_m: Vector3<f64>,
}

impl Pose {
    /// A marker's place in the world (m).
    pub fn place(&self, marker_m: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * marker_m + self.position_m
    }

    /// Derivatives of a marker's pixel by the pose, from those by the marker's place.
    pub fn derivatives(&self, by_place: &Matrix2x3<f64>, marker_m: &Vector3<f64>) -> Matrix2x6<f64> {
        let mut by_pose = Matrix2x6::zeros();
        by_pose.fixed_columns_mut::<3>(0).copy_from(&(by_place * self.rotation * -marker_m.cross_matrix()));
        by_pose.fixed_columns_mut::<3>(3).copy_from(by_place);
        by_pose
    }

    /// The pose after a step: a turn in the object's axes, a shift in the world's.
    #[must_use]
    pub fn moved(&self, step: &SVector<f64, POSE>) -> Self {
        let turn = Rotation3::new(Vector3::new(step[0], step[1], step[2]));
        Self {
            rotation: self.rotation * turn.matrix(),
            position_m: self.position_m + Vector3::new(step[3], step[4], step[5]),
        }
    }
}

/// One marker of one pose in one camera.
#[derive(Clone, Copy, Debug)]
pub struct Sighting {
    /// Index of the pose.
    pub pose: usize,
    /// Index of the camera.
    pub camera: usize,
    /// Index of the object's marker.
    pub marker: usize,
    /// Measured pixel.
    pub pixel: Vector2<f64>,
    /// Weight 1/σ² (px⁻²), robust factor included; 0 = left out.
    pub weight: f64,
}

/// Everything that is adjusted together.
#[derive(Clone, Debug)]
pub struct Bundle {
    /// The cameras. Lens parameters can be free only where the lens is ideal or OpenCV's without denominator.
    pub cameras: Vec<Camera>,
    /// Which parameters of each camera are free.
    pub freedom: Vec<Freedom>,
    /// The object.
    pub wand: Wand,
    /// One pose per frame used.
    pub poses: Vec<Pose>,
    /// Whether the poses are known and stay.
    pub poses_held: bool,
    /// In ascending order of pose, then of camera.
    pub sightings: Vec<Sighting>,
}

/// How an adjustment ended.
#[derive(Clone, Copy, Debug)]
pub struct Ended {
    /// Iterations done.
    pub iterations: usize,
    /// Weighted cost at the end.
    pub cost: f64,
    /// Whether the last step was too small to matter.
    pub converged: bool,
}

/// A relative decrease of the cost below this ends an adjustment.
const SETTLED: f64 = 1e-7;
const LARGEST_DAMPING: f64 = 1e12;

impl Bundle {
    /// Residual (px) of a sighting: measured minus projected; `None` behind the camera or beyond the lens.
    pub fn residual(&self, s: &Sighting) -> Option<Vector2<f64>> {
        let place = self.poses[s.pose].place(&self.wand.markers_m[s.marker]);
        Some(s.pixel - self.cameras[s.camera].project(&place)?)
    }

    /// `Σ w r²`; a sighting that cannot be projected counts as one that is off by the image's diagonal.
    pub fn cost(&self) -> f64 {
        self.sightings.iter().filter(|s| s.weight > 0.0).map(|s| s.weight * self.squared(s)).sum()
    }

    fn squared(&self, s: &Sighting) -> f64 {
        let [width, height] = self.cameras[s.camera].size_px;
        self.residual(s).map_or(width * width + height * height, |r| r.norm_squared())
    }

    /// Measurements in use over what is left of them when the parameters are taken off: `n / (n − p)`.
    ///
    /// Residuals are smaller than errors by its root; the world's own motions are no parameters.
    pub fn redundancy_factor(&self) -> f64 {
        let measurements = 2.0 * self.sightings.iter().filter(|s| s.weight > 0.0).count() as f64;
        let cameras = self.freedom.iter().flatten().filter(|f| **f).count();
        let poses = if self.poses_held { 0 } else { (self.wand.pose_freedom() * self.poses.len()).saturating_sub(6) };
        measurements / (measurements - (cameras + poses) as f64).max(1.0)
    }

    /// Which parameters of a pose are held: the turn of a line about itself, any turn of a point.
    pub fn held_in_pose(&self) -> [bool; POSE] {
        match self.wand.span {
            _ if self.poses_held => [true; POSE],
            Span::Point => [true, true, true, false, false, false],
            Span::Line => [true, false, false, false, false, false],
            Span::Plane | Span::Solid => [false; POSE],
        }
    }

    /// Levenberg–Marquardt (Moré 1978's diagonal scaling) for at most `iterations` steps, weights as they are.
    pub fn adjust(&mut self, iterations: usize) -> Ended {
        let mut damping = 1e-7;
        let mut cost = self.cost();
        let mut ended = Ended { iterations: 0, cost, converged: false };
        while ended.iterations < iterations {
            ended.iterations += 1;
            let normal = Normal::of(self);
            let before = (self.cameras.clone(), self.poses.clone());
            let mut improved = false;
            while damping < LARGEST_DAMPING {
                if let Some((cameras, poses)) = normal.step(damping) {
                    self.apply(&cameras, &poses);
                }
                let next = self.cost();
                if next < cost {
                    improved = cost - next > SETTLED * cost;
                    cost = next;
                    damping = (damping / 10.0).max(1e-12);
                    break;
                }
                (self.cameras, self.poses) = before.clone();
                damping *= 10.0;
            }
            if !improved {
                ended.converged = true;
                break;
            }
        }
        Ended { cost, ..ended }
    }

    fn apply(&mut self, cameras: &DVector<f64>, poses: &[SVector<f64, POSE>]) {
        for (i, one) in self.cameras.iter_mut().enumerate() {
            *one = camera::moved(one, &SVector::from_fn(|k, _| cameras[i * PARAMETERS + k]));
        }
        for (pose, step) in self.poses.iter_mut().zip(poses) {
            *pose = pose.moved(step);
        }
    }

    /// The reduced normal matrix of the cameras without damping: their information when all poses are unknown.
    pub fn information(&self) -> DMatrix<f64> {
        Normal::of(self).information()
    }
}
