//! Simulated rigs: rings, arcs and walls of equal cameras that look at the origin's surroundings.

use crate::camera::{Camera, Lens, Mask, Rig};
use nalgebra::{Matrix3, Vector3};

/// A camera at a place, looking at a target, upright.
pub fn looking_at(id: usize, position: Vector3<f64>, target: Vector3<f64>, size_px: [f64; 2], focal_px: f64) -> Camera {
    let forward = (target - position).normalize();
    let up = if forward.z.abs() > 0.999 { Vector3::y() } else { Vector3::z() };
    let right = forward.cross(&up).normalize();
    let down = forward.cross(&right);
    Camera {
        id: id.to_string(),
        size_px,
        focal_px: [focal_px; 2],
        principal_px: [0.5 * (size_px[0] - 1.0), 0.5 * (size_px[1] - 1.0)],
        camera_from_world: Matrix3::from_rows(&[right.transpose(), down.transpose(), forward.transpose()]),
        position_m: position,
        lens: Lens::Ideal,
        mask: Mask::default(),
    }
}

fn on_sphere(azimuth_deg: f64, elevation_deg: f64, distance_m: f64) -> Vector3<f64> {
    let (azimuth, elevation) = (azimuth_deg.to_radians(), elevation_deg.to_radians());
    distance_m * Vector3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin())
}

/// `n` cameras evenly around the origin at one elevation; the first stands at `first_azimuth_deg`.
pub fn ring(
    n: usize,
    distance_m: f64,
    elevation_deg: f64,
    first_azimuth_deg: f64,
    size_px: [f64; 2],
    focal_px: f64,
) -> Rig {
    let azimuth = |i: usize| first_azimuth_deg + 360.0 * i as f64 / n as f64;
    around(n, distance_m, elevation_deg, azimuth, size_px, focal_px)
}

/// `n` cameras on an arc of `span_deg` about the x axis, at one elevation.
pub fn arc(n: usize, distance_m: f64, elevation_deg: f64, span_deg: f64, size_px: [f64; 2], focal_px: f64) -> Rig {
    let azimuth = |i: usize| span_deg * (i as f64 / (n.max(2) - 1) as f64 - 0.5);
    around(n, distance_m, elevation_deg, azimuth, size_px, focal_px)
}

fn around(
    n: usize,
    distance_m: f64,
    elevation_deg: f64,
    azimuth: impl Fn(usize) -> f64,
    size_px: [f64; 2],
    focal_px: f64,
) -> Rig {
    let camera =
        |i| looking_at(i, on_sphere(azimuth(i), elevation_deg, distance_m), Vector3::zeros(), size_px, focal_px);
    Rig { cameras: (0..n).map(camera).collect() }
}

/// Cameras in a grid on a wall `distance_m` from the origin, `spacing_m` apart, all looking at the origin.
pub fn wall(columns: usize, rows: usize, distance_m: f64, spacing_m: f64, size_px: [f64; 2], focal_px: f64) -> Rig {
    let offset = |i: usize, n: usize| (i as f64 - 0.5 * (n as f64 - 1.0)) * spacing_m;
    let camera = |i: usize| {
        let position = Vector3::new(distance_m, offset(i % columns, columns), offset(i / columns, rows));
        looking_at(i, position, Vector3::zeros(), size_px, focal_px)
    };
    Rig { cameras: (0..columns * rows).map(camera).collect() }
}
