//! Clocks of recordings, for Python.

use crate::conv::DotArrays;
use crate::errors::InputError;
use crate::rig::PyRig;
use markerloom_core::sync::{Fine, NoSync, View, synchronise as engine_synchronise};
use nalgebra::Vector2;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// One recording: views of the cameras that saw anything.
fn views(rig: &PyRig, recording: &DotArrays<'_>) -> PyResult<Vec<View>> {
    let cameras = &rig.inner.cameras;
    let (dots, frames) = recording.frames(cameras.len())?;
    let of = |camera: usize| {
        let own = |range: &std::ops::Range<usize>| {
            dots[range.clone()].iter().filter(|d| d.camera == camera).map(|d| Vector2::from(d.pixel)).collect()
        };
        let by_frame: Vec<Vec<Vector2<f64>>> = frames.iter().map(own).collect();
        View::new(&cameras[camera], camera, &by_frame)
    };
    Ok((0..cameras.len()).map(of).filter(|v| !v.strands.is_empty()).collect())
}

/// The second recording's clock against the first's; `rate`: nominal frames of the second per frame of the first.
#[pyfunction]
pub fn synchronise<'py>(
    py: Python<'py>,
    rig: &PyRig,
    first: DotArrays<'_>,
    second: DotArrays<'_>,
    rate: f64,
) -> PyResult<Bound<'py, PyDict>> {
    let (a, b) = (views(rig, &first)?, views(rig, &second)?);
    let cameras = &rig.inner.cameras;
    let fine = py.detach(|| engine_synchronise(cameras, &a, &b, rate)).map_err(|e| InputError::new_err(told(e)))?;
    described(py, &fine)
}

fn told(error: NoSync) -> String {
    match error {
        NoSync::NothingInCommon => "they have no moment or no view in common".into(),
        NoSync::NoPeak { best, chance } => format!(
            "no offset stands out: at the best one {:.0} % of the dots fit, {:.0} % by chance; is it the same capture, \
             and the right calibration?",
            100.0 * best,
            100.0 * chance
        ),
        NoSync::SeveralPeaks => "several offsets fit alike: the motion repeats itself, or stands still".into(),
        NoSync::TooLittleMotion => "the markers move too little to tell the offset".into(),
    }
}

fn described<'py>(py: Python<'py>, fine: &Fine) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    out.set_item("shift", fine.shift)?;
    out.set_item("shift_sigma", fine.shift_sigma)?;
    out.set_item("middle_sigma", fine.middle_sigma)?;
    out.set_item("stretch", fine.stretch)?;
    out.set_item("stretch_sigma", fine.stretch_sigma)?;
    out.set_item("noise_px", fine.noise_px)?;
    out.set_item("matches", fine.matches)?;
    out.set_item("parts", fine.parts.clone())?;
    Ok(out)
}
