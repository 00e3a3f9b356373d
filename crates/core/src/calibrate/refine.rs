//! Camera poses adjusted to a take's own markers: no wand, no labels; lenses stay.
//!
//! Every marker of every frame is a point of its own. Seven motions of the world are free in that; the result is laid
//! onto the given camera centres by a similarity (Umeyama 1991), so that origin, axes and scale stay.

use super::bundle::camera::{POSITION, ROTATION, free};
use super::bundle::robust::adjust_robustly;
use super::bundle::{Bundle, Pose, Sighting};
use super::pose::fit;
use super::wand::{Span, Wand};
use crate::camera::Camera;
use nalgebra::{Matrix3, Vector3};

/// The cameras adjusted, and the noise of each (px). `None` for fewer than three cameras or nothing seen.
///
/// `places`: of the points (m); `sightings` of them, in ascending order of point, then camera.
pub fn refine(
    cameras: &[Camera],
    places: &[Vector3<f64>],
    sightings: Vec<Sighting>,
) -> Option<(Vec<Camera>, Vec<f64>)> {
    let wand = Wand::new(&[Vector3::zeros()])?;
    let poses = places.iter().map(|p| Pose { rotation: Matrix3::identity(), position_m: *p }).collect();
    let freedom = vec![free(&[ROTATION, POSITION]); cameras.len()];
    let mut bundle = Bundle { cameras: cameras.to_vec(), freedom, wand, poses, poses_held: false, sightings };
    let noise = adjust_robustly(&mut bundle);
    Some((laid_onto(cameras, &bundle.cameras)?, noise))
}

/// The adjusted rig moved, turned and scaled so that its camera centres lie on the given ones by least squares.
fn laid_onto(given: &[Camera], adjusted: &[Camera]) -> Option<Vec<Camera>> {
    let (to, from): (Vec<_>, Vec<_>) = given.iter().zip(adjusted).map(|(g, a)| (g.position_m, a.position_m)).unzip();
    let pose = fit(&from, &to, Span::Solid)?;
    let middle = |places: &[Vector3<f64>]| places.iter().sum::<Vector3<f64>>() / places.len() as f64;
    let (to_middle, from_middle) = (middle(&to), middle(&from));
    let overlap: f64 =
        to.iter().zip(&from).map(|(t, f)| (t - to_middle).dot(&(pose.rotation * (f - from_middle)))).sum();
    let scale = overlap / from.iter().map(|f| (f - from_middle).norm_squared()).sum::<f64>();
    let laid = |camera: &Camera| {
        let mut camera = camera.clone();
        camera.position_m = to_middle + scale * (pose.rotation * (camera.position_m - from_middle));
        camera.camera_from_world *= pose.rotation.transpose();
        camera
    };
    Some(adjusted.iter().map(laid).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::random::Random;
    use crate::synth::rigs::ring;
    use nalgebra::{Rotation3, Vector2};

    #[test]
    fn a_rig_that_crept_comes_back() {
        let truth = ring(6, 4.0, 25.0, 10.0, [1280.0, 1024.0], 1300.0).cameras;
        let mut random = Random::new(5, 0);
        let crept: Vec<Camera> = truth
            .iter()
            .map(|c| {
                let mut c = c.clone();
                let turn = Rotation3::new(random.in_box(&Vector3::repeat(0.002)));
                c.camera_from_world = turn.matrix() * c.camera_from_world;
                c.position_m += random.in_box(&Vector3::repeat(0.002));
                c
            })
            .collect();
        let places: Vec<Vector3<f64>> = (0..400).map(|_| random.in_box(&Vector3::repeat(1.5))).collect();
        let mut sightings = Vec::new();
        for (pose, place) in places.iter().enumerate() {
            for (camera, one) in truth.iter().enumerate() {
                let noise = Vector2::new(random.normal(), random.normal()) * 0.1;
                sightings.push(Sighting {
                    pose,
                    camera,
                    marker: 0,
                    pixel: one.project(place).unwrap() + noise,
                    weight: 1.0,
                });
            }
        }
        let (refined, noise) = refine(&crept, &places, sightings).unwrap();
        assert!(noise.iter().all(|n| (n - 0.1).abs() < 0.02), "{noise:?}");
        let apart = |a: &[Camera], i: usize, j: usize| (a[i].position_m - a[j].position_m).norm();
        for (i, j) in (0..6).flat_map(|i| (0..i).map(move |j| (i, j))) {
            assert!((apart(&refined, i, j) / apart(&truth, i, j) - 1.0).abs() < 5e-4, "{i} {j}");
        }
    }
}
