//! Detection for Python.

use crate::errors::InputError;
use markerloom_core::detect::partial::{Patch, Sensor, fit};
use markerloom_core::detect::{Blob, Detected, Fit, Image, Options, Value, detect};
use numpy::ndarray::ArrayView2;
use numpy::{IntoPyArray, PyArrayMethods, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::prelude::*;

/// A grey image of 8 or 16 bit, rows one after the other.
#[derive(FromPyObject)]
pub enum Grey<'py> {
    Eight(PyReadonlyArray2<'py, u8>),
    Sixteen(PyReadonlyArray2<'py, u16>),
}

fn of<V: Value>(view: &ArrayView2<'_, V>, options: &Options) -> Option<Detected> {
    let (height, width) = view.dim();
    let values = view.as_slice()?;
    Some(detect(&Image { values, width, height }, options))
}

/// Markers of one grey image (height, width): see `markerloom/detect`. `limits`: least pixels, most blobs.
#[pyfunction]
#[pyo3(signature = (image, threshold, white, radius_px, blur_px, limits))]
pub fn detect_markers<'py>(
    py: Python<'py>,
    image: Grey<'py>,
    threshold: Option<f64>,
    white: Option<f64>,
    radius_px: Option<f64>,
    blur_px: Option<f64>,
    limits: (usize, usize),
) -> PyResult<Bound<'py, PyDict>> {
    let (least_pixels, most_blobs) = limits;
    let options = Options { threshold, white, radius_px, blur_px, least_pixels, most_blobs };
    let empty = match &image {
        Grey::Eight(a) => a.len() == 0,
        Grey::Sixteen(a) => a.len() == 0,
    };
    let found = match (&image, empty) {
        (_, true) => None,
        (Grey::Eight(a), _) => {
            let view = a.as_array();
            py.detach(|| of(&view, &options))
        }
        (Grey::Sixteen(a), _) => {
            let view = a.as_array();
            py.detach(|| of(&view, &options))
        }
    };
    let found =
        found.ok_or_else(|| InputError::new_err("an image without pixels, or not in rows one after the other"))?;
    arrays(py, &found)
}

/// Centres of markers of which only some pixels (column, row, value) are known, half hidden ones too: x, y, sigma (px) and the
/// part seen; NaN where there are too few.
#[pyfunction]
pub fn fit_patches(
    py: Python<'_>,
    patches: Vec<Vec<(u16, u16, u8)>>,
    threshold: f64,
    radius_px: f64,
    blur_px: f64,
) -> Vec<[f64; 4]> {
    let sensor = Sensor { threshold, radius_px, blur_px };
    let one = |pixels: Vec<(u16, u16, u8)>| {
        let found = fit(&Patch { pixels }, &sensor);
        found.map_or([f64::NAN; 4], |c| [c.center.x, c.center.y, c.sigma_px, c.seen])
    };
    py.detach(|| patches.into_par_iter().map(one).collect())
}

fn arrays<'py>(py: Python<'py>, found: &Detected) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    let n = found.blobs.len();
    let column = |f: fn(&Blob) -> f64| found.blobs.iter().map(f).collect::<Vec<_>>().into_pyarray(py);
    let pixel: Vec<f64> = found.blobs.iter().flat_map(|b| b.pixel).collect();
    let ellipse: Vec<f64> = found.blobs.iter().flat_map(|b| b.ellipse).collect();
    out.set_item("pixel", pixel.into_pyarray(py).reshape([n, 2])?)?;
    out.set_item("ellipse", ellipse.into_pyarray(py).reshape([n, 3])?)?;
    out.set_item("sigma_px", column(|b| b.sigma_px))?;
    out.set_item("radius_px", column(|b| b.radius_px))?;
    out.set_item("peak", column(|b| b.peak))?;
    out.set_item("area_px", found.blobs.iter().map(|b| b.area_px as i64).collect::<Vec<_>>().into_pyarray(py))?;
    let flag = |f: fn(&Blob) -> bool| found.blobs.iter().map(f).collect::<Vec<_>>().into_pyarray(py);
    out.set_item("clipped", flag(|b| b.is_clipped))?;
    out.set_item("saturated", flag(|b| b.is_saturated))?;
    out.set_item("hidden", flag(|b| b.fit == Fit::Arc))?;
    out.set_item("merged", flag(|b| b.fit == Fit::Merged))?;
    out.set_item("background", found.level.background)?;
    out.set_item("noise", found.level.noise)?;
    out.set_item("threshold", found.level.threshold)?;
    out.set_item("blur_px", found.edge.width_px)?;
    out.set_item("left_out", found.left_out)?;
    Ok(out)
}
