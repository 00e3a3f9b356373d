//! One camera from markers whose places in the world are known: the oldest way to calibrate.
//!
//! A linear solution, then least squares over what the number of markers allows: the pose always, then the focal
//! length, the lens's first coefficient, the principal point, the rest of the lens.

use super::bundle::camera::{FOCAL, Freedom, POSITION, PRINCIPAL, RADIAL, ROTATION, SIXTH, TANGENTIAL, free};
use super::bundle::covariance::covariance;
use super::bundle::robust::{noise_of_used_px, noise_px, weigh_hard, weigh_softly};
use super::bundle::{Bundle, Pose, Sighting};
use super::resection::{self, Known, linear};
use super::wand::Wand;
use crate::camera::{Camera, Lens};
use nalgebra::{DMatrix, Matrix3, Vector2, Vector3};

/// A projection has eleven unknowns: six markers.
pub const FEWEST: usize = 6;
/// Markers from which on the lens's first coefficient, the principal point, and the whole lens are free too.
const FOR_RADIAL: usize = 12;
const FOR_PRINCIPAL: usize = 20;
const FOR_ALL: usize = 40;

/// A calibrated camera and what it is worth.
#[derive(Clone, Debug)]
pub struct Solved {
    /// The camera.
    pub camera: Camera,
    /// √(RSS/(n − p)) of the markers in use (px per axis).
    pub noise_px: f64,
    /// Residual of each marker (px); `None` where it cannot be projected.
    pub residual_px: Vec<Option<Vector2<f64>>>,
    /// Markers in use; the others lie too far off.
    pub used: Vec<bool>,
    /// Which parameters were free.
    pub freedom: Freedom,
    /// Covariance of all parameters; zero for those held. `None` where the markers do not determine them.
    pub covariance: Option<DMatrix<f64>>,
}

/// The camera that sees the known places where they were measured. `None` for too few, or for places in one plane.
pub fn from_points(start: &Camera, known: &[Known], focal_known: bool) -> Option<Solved> {
    if known.len() < FEWEST {
        return None;
    }
    let found = resection::resect(start, known, focal_known, 0).map(|f| f.0);
    let mut camera = found.or_else(|| linear(start, known, focal_known))?;
    if !focal_known && !matches!(camera.lens, Lens::BrownConrady { .. }) {
        camera.lens = Lens::BrownConrady { k: [0.0; 6], p: [0.0; 2] };
    }
    let mut bundle = bundle_of(&camera, known)?;
    for stage in stages(known.len(), focal_known) {
        bundle.freedom = vec![stage];
        for _ in 0..3 {
            let noise = noise_px(&bundle, |_| true);
            weigh_softly(&mut bundle, &noise);
            bundle.adjust(20);
        }
    }
    let mut noise = noise_px(&bundle, |_| true);
    for _ in 0..3 {
        weigh_hard(&mut bundle, &noise);
        bundle.adjust(20);
        noise = noise_of_used_px(&bundle);
    }
    let residual_px = bundle.sightings.iter().map(|s| bundle.residual(s)).collect();
    let used = bundle.sightings.iter().map(|s| s.weight > 0.0).collect();
    bundle.sightings.iter_mut().filter(|s| s.weight > 0.0).for_each(|s| s.weight = noise[0].powi(-2));
    Some(Solved {
        covariance: covariance(&bundle, true),
        camera: bundle.cameras[0].clone(),
        noise_px: noise[0],
        residual_px,
        used,
        freedom: bundle.freedom[0],
    })
}

fn bundle_of(camera: &Camera, known: &[Known]) -> Option<Bundle> {
    let poses = known.iter().map(|(place, _)| Pose { rotation: Matrix3::identity(), position_m: *place }).collect();
    let sighting =
        |(pose, (_, pixel)): (usize, &Known)| Sighting { pose, camera: 0, marker: 0, pixel: *pixel, weight: 1.0 };
    Some(Bundle {
        cameras: vec![camera.clone()],
        freedom: Vec::new(),
        wand: Wand::new(&[Vector3::zeros()])?,
        poses,
        poses_held: true,
        sightings: known.iter().enumerate().map(sighting).collect(),
    })
}

/// What is free, one stage after the other.
fn stages(markers: usize, focal_known: bool) -> Vec<Freedom> {
    let mut now = free(&[ROTATION, POSITION]);
    let mut all = vec![now];
    if focal_known {
        return all;
    }
    now[FOCAL] = true;
    all.push(now);
    let mut add = |from: usize, parameters: &[usize]| {
        if markers >= from {
            parameters.iter().for_each(|p| now[*p] = true);
            all.push(now);
        }
    };
    add(FOR_RADIAL, &[RADIAL.start]);
    add(FOR_PRINCIPAL, &[PRINCIPAL.start, PRINCIPAL.start + 1]);
    add(FOR_ALL, &[RADIAL.start + 1, TANGENTIAL.start, TANGENTIAL.start + 1, SIXTH]);
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::random::Random;
    use crate::synth::rigs::ring;

    fn seen(count: usize, noise: f64) -> (Camera, Vec<Known>) {
        let mut camera = ring(4, 4.0, 25.0, 10.0, [1280.0, 1024.0], 1300.0).cameras.swap_remove(1);
        camera.lens = Lens::BrownConrady { k: [0.0, 0.02, 0.0, 0.15, 0.0, 0.0], p: [0.0; 2] };
        let mut random = Random::new(9, 0);
        let known = (0..count)
            .map(|_| {
                let place = random.in_box(&Vector3::new(1.6, 1.6, 1.2));
                let noise = Vector2::new(random.normal(), random.normal()) * noise;
                (place, camera.project(&place).unwrap() + noise)
            })
            .collect();
        (camera, known)
    }

    fn guess(camera: &Camera) -> Camera {
        Camera { focal_px: [1000.0; 2], lens: Lens::Ideal, ..camera.clone() }
    }

    #[test]
    fn without_noise_the_camera_and_its_lens_come_back() {
        let (camera, known) = seen(60, 0.0);
        let found = from_points(&guess(&camera), &known, false).unwrap();
        assert!((found.camera.position_m - camera.position_m).norm() < 1e-6);
        assert!((found.camera.focal_px[0] / 1300.0 - 1.0).abs() < 1e-6);
        assert!(found.noise_px < 1e-5);
    }

    #[test]
    fn with_noise_the_error_is_the_stated_one_and_a_wrong_marker_is_left_out() {
        let (camera, mut known) = seen(60, 0.2);
        known[7].1.x += 40.0;
        let found = from_points(&guess(&camera), &known, false).unwrap();
        assert!(!found.used[7]);
        assert!((found.noise_px / 0.2 - 1.0).abs() < 0.25, "{}", found.noise_px);
        let covariance = found.covariance.unwrap();
        let sigma = (3..6).map(|k| covariance[(k, k)]).sum::<f64>().sqrt();
        let error = (found.camera.position_m - camera.position_m).norm();
        assert!(error < 3.0 * sigma, "{error} {sigma}");
        assert!(sigma < 0.02);
    }

    #[test]
    fn too_few_markers_give_no_camera() {
        let (camera, known) = seen(5, 0.0);
        assert!(from_points(&guess(&camera), &known, false).is_none());
    }
}
