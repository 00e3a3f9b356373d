//! The seed paper's constructions for a hidden marker.

use markerloom_core::track::body::spheres::{one_sphere, two_spheres};
use nalgebra::Vector3;
use pyo3::prelude::*;

/// The point of one sphere, or of two, nearest to a prediction; lengths in one unit.
#[pyfunction]
#[pyo3(signature = (first, predicted, second=None))]
pub fn on_spheres(first: ([f64; 3], f64), predicted: [f64; 3], second: Option<([f64; 3], f64)>) -> [f64; 3] {
    let sphere = |(center, radius): ([f64; 3], f64)| (Vector3::from(center), radius);
    let predicted = Vector3::from(predicted);
    match second {
        Some(second) => two_spheres(sphere(first), sphere(second), &predicted).into(),
        None => one_sphere(sphere(first), &predicted).into(),
    }
}
