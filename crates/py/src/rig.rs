//! Cameras for Python: projection and rays over arrays.

use crate::conv;
use crate::errors::RigError;
use markerloom_core::camera::Rig;
use nalgebra::{Vector2, Vector3};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// The cameras of a capture.
#[pyclass(name = "Rig", frozen)]
pub struct PyRig {
    pub inner: Rig,
}

#[pymethods]
impl PyRig {
    #[new]
    fn new(cameras: Vec<Bound<'_, PyDict>>) -> PyResult<Self> {
        let cameras = cameras.iter().map(conv::camera).collect::<PyResult<_>>()?;
        Ok(Self { inner: Rig { cameras } })
    }

    /// Pixels (n, 2) of points (n, 3) in one camera; NaN where there is none.
    fn project<'py>(
        &self,
        py: Python<'py>,
        camera: usize,
        points: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let camera = self.inner.cameras.get(camera).ok_or_else(|| RigError::new_err("no such camera"))?;
        let points = points.as_array();
        let mut out = Vec::with_capacity(2 * points.nrows());
        for row in points.rows() {
            let pixel = camera.project(&Vector3::new(row[0], row[1], row[2]));
            out.extend(pixel.map_or([f64::NAN; 2], |p| [p.x, p.y]));
        }
        out.into_pyarray(py).reshape([points.nrows(), 2])
    }

    /// Normalised image points (n, 2) of measured pixels (n, 2); NaN where the lens has folded over.
    fn normalise<'py>(
        &self,
        py: Python<'py>,
        camera: usize,
        pixels: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let camera = self.inner.cameras.get(camera).ok_or_else(|| RigError::new_err("no such camera"))?;
        let pixels = pixels.as_array();
        let mut out = Vec::with_capacity(2 * pixels.nrows());
        for row in pixels.rows() {
            let at = camera.normalised_from_pixel(Vector2::new(row[0], row[1]));
            out.extend(at.map_or([f64::NAN; 2], |p| [p.x, p.y]));
        }
        out.into_pyarray(py).reshape([pixels.nrows(), 2])
    }

    /// Unit directions (n, 3) in world of measured pixels (n, 2); NaN where the lens has folded over.
    fn rays<'py>(
        &self,
        py: Python<'py>,
        camera: usize,
        pixels: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let camera = self.inner.cameras.get(camera).ok_or_else(|| RigError::new_err("no such camera"))?;
        let pixels = pixels.as_array();
        let mut out = Vec::with_capacity(3 * pixels.nrows());
        for row in pixels.rows() {
            let at = camera.normalised_from_pixel(Vector2::new(row[0], row[1]));
            out.extend(at.map_or([f64::NAN; 3], |p| camera.ray_in_world(p).into()));
        }
        out.into_pyarray(py).reshape([pixels.nrows(), 3])
    }

    /// Which of the points (n, 3) one camera can see.
    fn sees<'py>(
        &self,
        py: Python<'py>,
        camera: usize,
        points: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray1<bool>>> {
        let camera = self.inner.cameras.get(camera).ok_or_else(|| RigError::new_err("no such camera"))?;
        let seen: Vec<bool> =
            points.as_array().rows().into_iter().map(|r| camera.sees(&Vector3::new(r[0], r[1], r[2]))).collect();
        Ok(seen.into_pyarray(py))
    }
}
