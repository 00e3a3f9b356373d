//! Active markers for Python.

use crate::errors::InputError;
use markerloom_core::active::codes::{LENGTH, book};
use markerloom_core::active::decode::{Blinking, decode};
use markerloom_core::strands::{LARGEST_STEP, Strands};
use nalgebra::Vector2;
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

/// The code book: for each identity the bits of its period, frame by frame.
#[pyfunction]
pub fn led_codes() -> Vec<Vec<bool>> {
    book().iter().map(|w| (0..LENGTH).map(|k| w.is_bright(k)).collect()).collect()
}

/// Identities of one camera's dots, by how bright they are; −1 where none is sure. `starts` of the frames' dots.
#[pyfunction]
pub fn decode_leds<'py>(
    py: Python<'py>,
    starts: Vec<usize>,
    pixel: PyReadonlyArray2<'py, f64>,
    brightness: PyReadonlyArray1<'py, f64>,
    width_px: f64,
    frames_per_bit: usize,
) -> PyResult<Bound<'py, PyArray1<i64>>> {
    let (pixel, brightness) = (pixel.as_array(), brightness.as_array().to_vec());
    let in_order = starts.windows(2).all(|p| p[0] <= p[1]);
    if !in_order || starts.last() != Some(&brightness.len()) || pixel.dim() != (brightness.len(), 2) {
        return Err(InputError::new_err("frame starts, pixels and brightness do not fit together"));
    }
    let frames: Vec<Vec<Vector2<f64>>> =
        starts.windows(2).map(|p| (p[0]..p[1]).map(|i| Vector2::new(pixel[(i, 0)], pixel[(i, 1)])).collect()).collect();
    let told = py.detach(|| {
        let largest = LARGEST_STEP * width_px;
        decode(&Strands::new(&frames, largest), &brightness, largest, Blinking { frames_per_bit })
    });
    Ok(told.into_iter().map(|t| t.map_or(-1, |t| t as i64)).collect::<Vec<_>>().into_pyarray(py))
}
