//! Everything that turns Python objects into engine types.

use crate::errors::RigError;
use markerloom_core::camera::{Camera, Lens, Mask};
use markerloom_core::correspond::frame::Dot;
use nalgebra::{Matrix3, Vector3};
use numpy::{PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::Mutex;

fn required<'py, T: FromPyObjectOwned<'py>>(dict: &Bound<'py, PyDict>, key: &str) -> PyResult<T> {
    let value = dict.get_item(key)?.ok_or_else(|| RigError::new_err(format!("a camera needs '{key}'")))?;
    value.extract().map_err(Into::into)
}

/// A camera from the dictionary that `markerloom/rig.py` makes.
pub fn camera(dict: &Bound<'_, PyDict>) -> PyResult<Camera> {
    let rotation: [[f64; 3]; 3] = required(dict, "rotation")?;
    let position: [f64; 3] = required(dict, "position_m")?;
    Ok(Camera {
        id: required(dict, "id")?,
        size_px: required(dict, "size_px")?,
        focal_px: required(dict, "focal_px")?,
        principal_px: required(dict, "principal_px")?,
        camera_from_world: Matrix3::from_fn(|i, j| rotation[i][j]),
        position_m: Vector3::from(position),
        lens: lens(dict)?,
        mask: mask(dict)?,
    })
}

fn lens(dict: &Bound<'_, PyDict>) -> PyResult<Lens> {
    let model: String = required(dict, "lens")?;
    let c: Vec<f64> = required(dict, "coefficients")?;
    let wrong = || RigError::new_err(format!("{} coefficients do not fit a '{model}' lens", c.len()));
    match model.as_str() {
        "ideal" => Ok(Lens::Ideal),
        "vicon_radial" => {
            let &[cx, cy, k1, k2, k3] = c.as_slice() else { return Err(wrong()) };
            Ok(Lens::ViconRadial { center_px: [cx, cy], k: [k1, k2, k3] })
        }
        "brown_conrady" => {
            // OpenCV's order: k1, k2, p1, p2, k3, k4, k5, k6.
            let &[k1, k2, p1, p2, k3, k4, k5, k6] = c.as_slice() else { return Err(wrong()) };
            Ok(Lens::BrownConrady { k: [k1, k2, k3, k4, k5, k6], p: [p1, p2] })
        }
        "fisheye" => Ok(Lens::Fisheye { k: c.as_slice().try_into().map_err(|_| wrong())? }),
        _ => Err(RigError::new_err(format!("unknown lens model '{model}'"))),
    }
}

fn mask(dict: &Bound<'_, PyDict>) -> PyResult<Mask> {
    let Some(value) = dict.get_item("mask")?.filter(|v| !v.is_none()) else { return Ok(Mask::default()) };
    let (tile_px, grid, tiles): ([f64; 2], [usize; 2], Vec<bool>) = value.extract()?;
    Ok(Mask { tile_px, grid, tiles })
}

/// Dots of a take as arrays: where each frame starts, and each dot's camera, pixel and sigma.
#[derive(FromPyObject)]
pub struct DotArrays<'py> {
    pub starts: PyReadonlyArray1<'py, i64>,
    pub camera: PyReadonlyArray1<'py, i64>,
    pub pixel: PyReadonlyArray2<'py, f64>,
    pub sigma: PyReadonlyArray1<'py, f64>,
    /// Identities of active markers, or −1.
    pub hardware: PyReadonlyArray1<'py, i64>,
}

impl DotArrays<'_> {
    /// All dots, and the range of each frame.
    pub fn frames(&self, cameras: usize) -> PyResult<(Vec<Dot>, Vec<std::ops::Range<usize>>)> {
        let (camera, sigma, hardware) = (self.camera.as_array(), self.sigma.as_array(), self.hardware.as_array());
        let pixel = self.pixel.as_array();
        let starts = self.starts.as_array();
        let wrong = |what: &str| RigError::new_err(format!("dots: {what}"));
        let same = [pixel.nrows(), sigma.len(), hardware.len()].iter().all(|n| *n == camera.len());
        if !same || pixel.ncols() != 2 {
            return Err(wrong("camera, pixel, sigma and identity differ in length"));
        }
        let mut dots = Vec::with_capacity(camera.len());
        for i in 0..camera.len() {
            let index =
                usize::try_from(camera[i]).ok().filter(|c| *c < cameras).ok_or_else(|| wrong("no such camera"))?;
            dots.push(Dot {
                camera: index,
                pixel: [pixel[(i, 0)], pixel[(i, 1)]],
                sigma: sigma[i],
                hardware: u32::try_from(hardware[i]).ok(),
            });
        }
        let mut ranges = Vec::with_capacity(starts.len());
        for pair in starts.to_vec().windows(2) {
            let (from, to) = (usize::try_from(pair[0]), usize::try_from(pair[1]));
            match (from, to) {
                (Ok(from), Ok(to)) if from <= to && to <= dots.len() => ranges.push(from..to),
                _ => return Err(wrong("frame starts are out of order")),
            }
        }
        Ok((dots, ranges))
    }
}

/// Places from an (n, 3) array.
pub fn places(xyz: &PyReadonlyArray2<'_, f64>) -> Vec<Vector3<f64>> {
    xyz.as_array().outer_iter().map(|row| Vector3::new(row[0], row[1], row[2])).collect()
}

/// Calls Python now and then while it is detached, with how much is done (0–1), and keeps the first error.
pub struct Teller {
    progress: Option<Py<PyAny>>,
    failed: Mutex<Option<PyErr>>,
}

impl Teller {
    /// For a function of one number, or nobody.
    pub fn new(progress: Option<Py<PyAny>>) -> Self {
        Self { progress, failed: Mutex::new(None) }
    }

    /// Tells how much is done.
    pub fn tell(&self, part: f64) {
        let Some(progress) = &self.progress else { return };
        if let Err(error) = Python::attach(|py| progress.call1(py, (part,)))
            && let Ok(mut failed) = self.failed.lock()
        {
            failed.get_or_insert(error);
        }
    }

    /// What went wrong, an interruption by the user among it.
    pub fn finish(self) -> PyResult<()> {
        self.failed.into_inner().ok().flatten().map_or(Ok(()), Err)
    }
}
