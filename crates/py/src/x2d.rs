//! Vicon x2d for Python.

use crate::errors::of_format;
use markerloom_formats::x2d;
use numpy::IntoPyArray;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Centroids of a `.x2d` as arrays.
#[pyfunction]
pub fn read_x2d<'py>(py: Python<'py>, bytes: &[u8]) -> PyResult<Bound<'py, PyDict>> {
    let file = x2d::read(bytes).map_err(|e| of_format(&e))?;
    let out = PyDict::new(py);
    let column = |f: fn(&x2d::Centroid) -> f64| file.centroids.iter().map(f).collect::<Vec<f64>>().into_pyarray(py);
    out.set_item("frames", file.frames)?;
    out.set_item("cameras", file.cameras.clone())?;
    out.set_item("grey_blobs", file.grey_blobs)?;
    let patches: Vec<_> = file.patches.iter().map(|p| (p.frame, p.camera, p.pixels.clone())).collect();
    out.set_item("patches", patches)?;
    out.set_item("frame", file.centroids.iter().map(|c| i64::from(c.frame)).collect::<Vec<_>>().into_pyarray(py))?;
    out.set_item("camera", file.centroids.iter().map(|c| i64::from(c.camera)).collect::<Vec<_>>().into_pyarray(py))?;
    out.set_item("x", column(|c| c.x))?;
    out.set_item("y", column(|c| c.y))?;
    out.set_item("radius", column(|c| c.radius))?;
    out.set_item("quality", column(|c| c.quality))?;
    Ok(out)
}
