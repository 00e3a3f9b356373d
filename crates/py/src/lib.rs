//! The extension module `markerloom._core`: converts Python values to the engine's types and back, nothing else.

#![allow(clippy::needless_pass_by_value, reason = "what Python hands over is owned by the call")]

mod active;
mod c3d;
mod calibrate;
mod conv;
mod detect;
mod errors;
mod fill;
mod hidden;
mod label;
mod motion;
mod reconstruct;
mod rig;
mod skeleton;
mod sync;
mod synth;
mod track;
mod track_points;
mod triangulate;
mod x2d;

use mimalloc::MiMalloc;
use pyo3::prelude::*;

/// A frame is full of small short-lived lists; this allocator hands them out faster than the C library's.
#[global_allocator]
static ALLOCATOR: MiMalloc = MiMalloc;

/// Private; the public names are chosen in `markerloom/__init__.py`.
#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    errors::register(module)?;
    module.add_class::<rig::PyRig>()?;
    module.add_class::<reconstruct::PyModel>()?;
    module.add_class::<track::PyTracker>()?;
    module.add_function(wrap_pyfunction!(track::dots_at_moments, module)?)?;
    module.add_function(wrap_pyfunction!(hidden::on_spheres, module)?)?;
    module.add_function(wrap_pyfunction!(track_points::track_points, module)?)?;
    module.add_class::<c3d::PyC3d>()?;
    module.add_class::<label::PyModel>()?;
    module.add_class::<label::PyLabeller>()?;
    module.add_class::<label::PyStart>()?;
    module.add_class::<skeleton::PyFigure>()?;
    module.add_class::<skeleton::PyFollower>()?;
    module.add_class::<motion::PyClouds>()?;
    module.add_function(wrap_pyfunction!(motion::band_count, module)?)?;
    module.add_function(wrap_pyfunction!(motion::split_bands, module)?)?;
    module.add_function(wrap_pyfunction!(motion::equalise_bands, module)?)?;
    module.add_function(wrap_pyfunction!(motion::change_motion, module)?)?;
    module.add_function(wrap_pyfunction!(fill::fill_gap, module)?)?;
    module.add_function(wrap_pyfunction!(fill::in_frames_of, module)?)?;
    module.add_function(wrap_pyfunction!(label::learn_subject, module)?)?;
    module.add_function(wrap_pyfunction!(label::learn_more, module)?)?;
    module.add_function(wrap_pyfunction!(detect::detect_markers, module)?)?;
    module.add_function(wrap_pyfunction!(detect::fit_patches, module)?)?;
    module.add_function(wrap_pyfunction!(calibrate::calibrate_wand, module)?)?;
    module.add_function(wrap_pyfunction!(calibrate::calibrate_points, module)?)?;
    module.add_function(wrap_pyfunction!(calibrate::adjust_board, module)?)?;
    module.add_function(wrap_pyfunction!(calibrate::refine_rig, module)?)?;
    module.add_function(wrap_pyfunction!(reconstruct::estimate_model, module)?)?;
    module.add_function(wrap_pyfunction!(reconstruct::reconstruct, module)?)?;
    module.add_function(wrap_pyfunction!(reconstruct::candidates, module)?)?;
    module.add_function(wrap_pyfunction!(triangulate::triangulate, module)?)?;
    module.add_function(wrap_pyfunction!(triangulate::two_rays, module)?)?;
    module.add_function(wrap_pyfunction!(active::led_codes, module)?)?;
    module.add_function(wrap_pyfunction!(active::decode_leds, module)?)?;
    module.add_function(wrap_pyfunction!(sync::synchronise, module)?)?;
    module.add_function(wrap_pyfunction!(synth::observe, module)?)?;
    module.add_function(wrap_pyfunction!(synth::cloud, module)?)?;
    module.add_function(wrap_pyfunction!(synth::body_labels, module)?)?;
    module.add_function(wrap_pyfunction!(synth::body_pose, module)?)?;
    module.add_function(wrap_pyfunction!(synth::wearing_pose, module)?)?;
    module.add_function(wrap_pyfunction!(synth::wearing_joints, module)?)?;
    module.add_function(wrap_pyfunction!(synth::rig, module)?)?;
    module.add_function(wrap_pyfunction!(x2d::read_x2d, module)?)?;
    Ok(())
}
