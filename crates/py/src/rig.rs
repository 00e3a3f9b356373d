//! Cameras for Python: projection and rays over arrays.

use crate::conv;
use crate::errors::RigError;
use markerloom_core::camera::{Camera, Rig};
use nalgebra::{Vector2, Vector3};
use numpy::ndarray::ArrayView1;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// The cameras of a capture.
#[pyclass(name = "Rig", frozen)]
pub struct PyRig {
    pub inner: Rig,
}

impl PyRig {
    /// One camera by its place in the rig.
    pub fn camera(&self, index: usize) -> PyResult<&Camera> {
        self.inner.cameras.get(index).ok_or_else(|| RigError::new_err(format!("the rig has no camera number {index}")))
    }
}

/// Rows of N numbers as an array; NaN where there is none.
fn rows<const N: usize>(
    py: Python<'_>,
    found: impl ExactSizeIterator<Item = Option<[f64; N]>>,
) -> PyResult<Bound<'_, PyArray2<f64>>> {
    let n = found.len();
    let flat: Vec<f64> = found.flat_map(|row| row.unwrap_or([f64::NAN; N])).collect();
    flat.into_pyarray(py).reshape([n, N])
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
        let camera = self.camera(camera)?;
        let points = points.as_array();
        let project = |row: ArrayView1<'_, f64>| camera.project(&Vector3::new(row[0], row[1], row[2])).map(Into::into);
        rows(py, points.rows().into_iter().map(project))
    }

    /// Normalised image points (n, 2) of measured pixels (n, 2); NaN where the lens has folded over.
    fn normalise<'py>(
        &self,
        py: Python<'py>,
        camera: usize,
        pixels: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let camera = self.camera(camera)?;
        let pixels = pixels.as_array();
        let at = |row: ArrayView1<'_, f64>| camera.normalised_from_pixel(Vector2::new(row[0], row[1])).map(Into::into);
        rows(py, pixels.rows().into_iter().map(at))
    }

    /// Unit directions (n, 3) in world of measured pixels (n, 2); NaN where the lens has folded over.
    fn rays<'py>(
        &self,
        py: Python<'py>,
        camera: usize,
        pixels: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let camera = self.camera(camera)?;
        let pixels = pixels.as_array();
        let ray = |row: ArrayView1<'_, f64>| {
            let at = camera.normalised_from_pixel(Vector2::new(row[0], row[1]));
            at.map(|p| camera.ray_in_world(p).into())
        };
        rows(py, pixels.rows().into_iter().map(ray))
    }

    /// Which of the points (n, 3) one camera can see.
    fn sees<'py>(
        &self,
        py: Python<'py>,
        camera: usize,
        points: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray1<bool>>> {
        let camera = self.camera(camera)?;
        let seen: Vec<bool> =
            points.as_array().rows().into_iter().map(|r| camera.sees(&Vector3::new(r[0], r[1], r[2]))).collect();
        Ok(seen.into_pyarray(py))
    }
}
