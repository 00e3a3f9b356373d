//! A rig from a board that several cameras see: the same adjustment as of a wand, with the board's corners for markers.
//!
//! Lenses are known (from the board itself, camera by camera); cameras and board poses are adjusted together, robustly,
//! from where pairwise poses have put them.

use super::bundle::camera::{Freedom, POSITION, ROTATION, free};
use super::bundle::robust::{noise_of_used_px, noise_px, weigh_hard, weigh_softly};
use super::bundle::{Bundle, Pose, Sighting};
use super::pose::fit;
use super::wand::Wand;
use crate::camera::Camera;
use nalgebra::Vector3;

const SOFT_ROUNDS: usize = 3;
const HARD_ROUNDS: usize = 3;
const STEPS: usize = 10;

/// Cameras and board poses adjusted together, and the noise of each camera (px). `None` for a board without extent.
///
/// `corners_m`: on the board; `poses`: of the board as given; `sightings`: of corners, in ascending order of pose, then of camera.
pub fn adjust(
    cameras: &[Camera],
    corners_m: &[Vector3<f64>],
    poses: &[Pose],
    sightings: Vec<Sighting>,
) -> Option<(Bundle, Vec<f64>)> {
    let wand = Wand::new(corners_m)?;
    let in_wand = |pose: &Pose| {
        let places: Vec<Vector3<f64>> = corners_m.iter().map(|c| pose.place(c)).collect();
        fit(&wand.markers_m, &places, wand.span)
    };
    let poses = poses.iter().map(in_wand).collect::<Option<Vec<Pose>>>()?;
    let freedom: Vec<Freedom> = vec![free(&[ROTATION, POSITION]); cameras.len()];
    let mut bundle = Bundle { cameras: cameras.to_vec(), freedom, wand, poses, poses_held: false, sightings };
    for _ in 0..SOFT_ROUNDS {
        let noise = noise_px(&bundle, |_| true);
        weigh_softly(&mut bundle, &noise);
        bundle.adjust(STEPS);
    }
    let mut noise = noise_px(&bundle, |_| true);
    for _ in 0..HARD_ROUNDS {
        weigh_hard(&mut bundle, &noise);
        bundle.adjust(STEPS);
        noise = noise_of_used_px(&bundle);
    }
    Some((bundle, noise))
}
