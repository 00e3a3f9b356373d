//! Single points for Python.

use crate::errors::{RigError, of_no_point};
use crate::rig::PyRig;
use markerloom_core::sight::Sight;
use markerloom_core::triangulate as engine;
use nalgebra::{Vector2, Vector3};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// The point that best explains pixels of several cameras.
#[pyfunction]
#[pyo3(signature = (rig, cameras, pixels, sigma_px, min_angle_deg=0.5, refuse_probability=1e-6))]
pub fn triangulate<'py>(
    py: Python<'py>,
    rig: &PyRig,
    cameras: Vec<usize>,
    pixels: Vec<[f64; 2]>,
    sigma_px: f64,
    min_angle_deg: f64,
    refuse_probability: f64,
) -> PyResult<Bound<'py, PyDict>> {
    let mut sights = Vec::new();
    for (&index, pixel) in cameras.iter().zip(&pixels) {
        let camera = rig.camera(index)?;
        let sight = Sight::new(camera, index, Vector2::from(*pixel), sigma_px);
        sights.push(sight.ok_or_else(|| RigError::new_err("a pixel lies where the lens model has folded over"))?);
    }
    let options = engine::TriangulateOptions { min_angle_deg, refuse_probability };
    let found = engine::triangulate(&sights.iter().collect::<Vec<_>>(), &options).map_err(|e| of_no_point(&e))?;
    let result = PyDict::new(py);
    let c = &found.covariance;
    let rows: Vec<[f64; 3]> = (0..3).map(|i| [c[(i, 0)], c[(i, 1)], c[(i, 2)]]).collect();
    result.set_item("point_m", <[f64; 3]>::from(found.point))?;
    result.set_item("covariance_m2", rows)?;
    result.set_item("rss", found.rss)?;
    result.set_item("left_out", found.left_out)?;
    Ok(result)
}

/// Halfway point and gap of two rays (lecture notes §6.4).
#[pyfunction]
pub fn two_rays(origins: [[f64; 3]; 2], directions: [[f64; 3]; 2]) -> PyResult<([f64; 3], f64)> {
    let [o1, o2] = origins.map(Vector3::from);
    let [d1, d2] = directions.map(|d| Vector3::from(d).normalize());
    let meeting = engine::two_rays([&o1, &o2], [&d1, &d2]).map_err(|e| of_no_point(&e))?;
    Ok((meeting.midpoint.into(), meeting.gap_m))
}
