//! A camera from places that are known in the world and seen in its image: direct linear transform, then refinement.
//!
//! Abdel-Aziz & Karara 1971; Hartley & Zisserman 2003 §7.1. Robust by the least median of squares. The principal point
//! is taken to be where the camera says it is; the focal length is found, or kept where it is known.

use super::bundle::camera::{FOCAL, POSITION, ROTATION, free};
use super::bundle::robust::{median, noise_px, weigh_hard, weigh_softly};
use super::bundle::{Bundle, Pose, Sighting};
use super::wand::Wand;
use crate::camera::Camera;
use crate::synth::random::Random;
use nalgebra::{Matrix3, SMatrix, SVector, SymmetricEigen, Vector2, Vector3};

/// A known place (m) and its pixel.
pub type Known = (Vector3<f64>, Vector2<f64>);

const DRAWS: usize = 150;
/// Points of a draw: six determine a projection; two more make it steady.
const DRAWN: usize = 8;
const INLIER: f64 = 2.5;
/// Fewest points for a camera.
pub const FEWEST: usize = 12;

/// The camera that sees the places where they were measured; position, orientation and (unless known) focal length of
/// `start` do not matter. Gives also the median misfit (px). `None` where no camera sees most of them so.
pub fn resect(start: &Camera, known: &[Known], focal_known: bool, seed: u64) -> Option<(Camera, f64)> {
    if known.len() < FEWEST {
        return None;
    }
    let mut random = Random::new(seed, 1);
    let mut best: Option<(Camera, f64)> = None;
    let mut misfits = Vec::with_capacity(known.len());
    for _ in 0..DRAWS {
        let drawn: Vec<Known> = (0..DRAWN).map(|_| known[random.below(known.len())]).collect();
        let Some(camera) = linear(start, &drawn, focal_known) else { continue };
        let middle = median_misfit(&camera, known, &mut misfits);
        if best.as_ref().is_none_or(|b| middle < b.1) {
            best = Some((camera, middle));
        }
    }
    let (drawn, middle) = best?;
    let near: Vec<Known> = known
        .iter()
        .copied()
        .filter(|(place, pixel)| drawn.project(place).is_some_and(|p| (p - pixel).norm() <= 2.0 * INLIER * middle))
        .collect();
    let all = linear(start, &near, focal_known).filter(|c| median_misfit(c, known, &mut misfits) <= middle);
    let refined = refine(all.as_ref().unwrap_or(&drawn), known, focal_known);
    let middle = median_misfit(&refined, known, &mut misfits);
    middle.is_finite().then_some((refined, middle))
}

fn median_misfit(camera: &Camera, known: &[Known], misfits: &mut Vec<f64>) -> f64 {
    misfits.clear();
    misfits
        .extend(known.iter().map(|(place, pixel)| camera.project(place).map_or(f64::INFINITY, |p| (p - pixel).norm())));
    median(misfits)
}

/// Pose and focal length by robust least squares from a start; the places are taken as exact.
pub fn refine(camera: &Camera, known: &[Known], focal_known: bool) -> Camera {
    let Some(wand) = Wand::new(&[Vector3::zeros()]) else { return camera.clone() };
    let mut freedom = free(&[ROTATION, POSITION]);
    freedom[FOCAL] = !focal_known;
    let poses = known.iter().map(|(place, _)| Pose { rotation: Matrix3::identity(), position_m: *place }).collect();
    let sighting =
        |(i, (_, pixel)): (usize, &Known)| Sighting { pose: i, camera: 0, marker: 0, pixel: *pixel, weight: 1.0 };
    let sightings = known.iter().enumerate().map(sighting).collect();
    let mut bundle =
        Bundle { cameras: vec![camera.clone()], freedom: vec![freedom], wand, poses, sightings, poses_held: true };
    for _ in 0..3 {
        let noise = noise_px(&bundle, |_| true);
        weigh_softly(&mut bundle, &noise);
        bundle.adjust(5);
    }
    let noise = noise_px(&bundle, |_| true);
    weigh_hard(&mut bundle, &noise);
    bundle.adjust(5);
    bundle.cameras.swap_remove(0)
}

/// The linear solution, decomposed and made a camera with square pixels.
pub fn linear(start: &Camera, known: &[Known], focal_known: bool) -> Option<Camera> {
    if known.len() < 6 {
        return None;
    }
    let middle = known.iter().map(|k| k.0).sum::<Vector3<f64>>() / known.len() as f64;
    let spread = known.iter().map(|k| (k.0 - middle).norm()).sum::<f64>() / known.len() as f64;
    let mut normal = SMatrix::<f64, 12, 12>::zeros();
    for (place, pixel) in known {
        let at = start.normalised_from_pixel(*pixel)?;
        let p = ((place - middle) / spread).push(1.0);
        for (axis, value) in [at.x, at.y].into_iter().enumerate() {
            let mut row = SVector::<f64, 12>::zeros();
            for k in 0..4 {
                row[4 * axis + k] = p[k];
                row[8 + k] = -value * p[k];
            }
            normal.ger(1.0, &row, &row, 1.0);
        }
    }
    let eigen = SymmetricEigen::new(normal);
    let v = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
    let rows = |k: usize| Vector3::new(v[4 * k], v[4 * k + 1], v[4 * k + 2]);
    let mut m = Matrix3::from_rows(&[rows(0).transpose(), rows(1).transpose(), rows(2).transpose()]);
    let mut t = Vector3::new(v[3], v[7], v[11]);
    // The last row is a unit vector times a positive number: places lie before the camera.
    let ahead =
        known.iter().filter(|(place, _)| m.row(2).dot(&((place - middle) / spread).transpose()) + t.z > 0.0).count();
    let sign = if 2 * ahead >= known.len() { 1.0 } else { -1.0 };
    let size = sign / m.row(2).norm();
    (m, t) = (m * size, t * size);
    let (rotation, focal) = rotation_and_focal(&m, focal_known)?;
    // m = diag(f, f, 1) R, nearly: the camera's place is where the projection vanishes.
    let center = -m.try_inverse()? * t;
    let mut camera = start.clone();
    camera.camera_from_world = rotation;
    camera.position_m = center * spread + middle;
    if !focal_known {
        camera.focal_px = start.focal_px.map(|f| f * focal);
    }
    camera.position_m.iter().all(|c| c.is_finite()).then_some(camera)
}

/// `m ≈ diag(f, f, 1) R`: the rotation nearest to it, and f relative to the focal length the points were normalised by.
fn rotation_and_focal(m: &Matrix3<f64>, focal_known: bool) -> Option<(Matrix3<f64>, f64)> {
    let forward = m.row(2).transpose();
    let across = |k: usize| {
        let row = m.row(k).transpose();
        row - forward * forward.dot(&row)
    };
    let (right, down) = (across(0), across(1));
    let focal = if focal_known { 1.0 } else { (right.norm() * down.norm()).sqrt() };
    let skewed = Matrix3::from_rows(&[
        (right / right.norm()).transpose(),
        (down / down.norm()).transpose(),
        forward.transpose(),
    ]);
    let svd = skewed.svd(true, true);
    let rotation = svd.u? * svd.v_t?;
    (rotation.determinant() > 0.0 && focal.is_finite() && focal > 0.0).then_some((rotation, focal))
}
