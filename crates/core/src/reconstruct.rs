//! A take's frames to points, each frame on its own: the prior is estimated once, then frames are solved in parallel
//! on the caller's thread pool. The result does not depend on the number of threads.

use crate::camera::Rig;
use crate::correspond::epipolar::epipolar;
use crate::correspond::estimate::{EstimateOptions, estimate};
use crate::correspond::frame::{Dot, PreparedFrame};
use crate::correspond::optimal::{OptimalOptions, optimal};
use crate::correspond::relaxation::{RelaxationOptions, relaxation};
use crate::correspond::scene::{Scene, SceneModel};
use crate::correspond::{Correspondence, Method};
use rayon::prelude::*;
use thiserror::Error;

/// Options of a reconstruction.
#[derive(Clone, Copy, Debug)]
pub struct ReconstructOptions {
    /// How dots are joined.
    pub method: Method,
    /// How the prior is estimated.
    pub estimate: EstimateOptions,
    /// Limits of the exact method.
    pub optimal: OptimalOptions,
    /// Options of the relaxation labelling.
    pub relaxation: RelaxationOptions,
}

impl Default for ReconstructOptions {
    fn default() -> Self {
        Self {
            method: Method::Optimal,
            estimate: EstimateOptions::default(),
            optimal: OptimalOptions::default(),
            relaxation: RelaxationOptions::default(),
        }
    }
}

/// Why a take cannot be reconstructed.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ReconstructError {
    /// One camera or none.
    #[error("{0} camera(s) in the calibration: a 3D point needs at least 2")]
    TooFewCameras(usize),
    /// More cameras than the solver's bit masks hold.
    #[error("{0} cameras: at most 128 are supported")]
    TooManyCameras(usize),
    /// No place is seen by two cameras.
    #[error("no two cameras see a common place from different directions: check the calibration's poses and units")]
    NothingInCommon,
}

/// Estimates the prior of a take.
pub fn estimate_model(
    rig: &Rig,
    frames: &[&[Dot]],
    options: &ReconstructOptions,
) -> Result<SceneModel, ReconstructError> {
    let n = rig.cameras.len();
    if n < 2 {
        return Err(ReconstructError::TooFewCameras(n));
    }
    if n > 128 {
        return Err(ReconstructError::TooManyCameras(n));
    }
    estimate(rig, frames, &options.estimate).ok_or(ReconstructError::NothingInCommon)
}

/// Solves one frame.
pub fn reconstruct_frame(scene: &Scene, dots: &[Dot], options: &ReconstructOptions) -> Correspondence {
    let frame = PreparedFrame::new(scene, dots);
    match options.method {
        Method::Optimal => optimal(scene, &frame, &options.optimal),
        Method::Relaxation => relaxation(scene, &frame, &options.relaxation),
        Method::Epipolar => epipolar(scene, &frame),
    }
}

/// Solves all frames with a given prior.
pub fn reconstruct(
    rig: &Rig,
    frames: &[&[Dot]],
    model: &SceneModel,
    options: &ReconstructOptions,
) -> Vec<Correspondence> {
    let scene = Scene::new(rig, model);
    frames.par_iter().map(|dots| reconstruct_frame(&scene, dots, options)).collect()
}
