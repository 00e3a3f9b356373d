//! A rig from a board that several cameras see: the same adjustment as of a wand, with the board's corners for markers.
//!
//! Lenses are known (from the board itself, camera by camera); cameras and board poses are adjusted together, robustly,
//! from where pairwise poses have put them.

use super::bundle::camera::{Freedom, POSITION, ROTATION, free};
use super::bundle::robust::adjust_robustly;
use super::bundle::{Bundle, Pose, Sighting};
use super::pose::fit;
use super::wand::Wand;
use crate::camera::Camera;
use nalgebra::Vector3;

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
    let noise = adjust_robustly(&mut bundle);
    Some((bundle, noise))
}
