//! Reconstruction for Python: arrays of dots in, arrays of points out, the GIL released in between.

use crate::conv::DotArrays;
use crate::errors::{RigError, of_reconstruct};
use crate::rig::PyRig;
use markerloom_core::correspond::frame::{Dot, PreparedFrame};
use markerloom_core::correspond::optimal::choose;
use markerloom_core::correspond::scene::{Scene, SceneModel};
use markerloom_core::correspond::{Correspondence, Method};
use markerloom_core::reconstruct::{self as engine, ReconstructOptions};
use numpy::{IntoPyArray, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// The prior of a take.
#[pyclass(name = "SceneModel", frozen)]
pub struct PyModel {
    pub inner: SceneModel,
}

#[pymethods]
impl PyModel {
    /// The model's values, for reports.
    fn describe<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let m = &self.inner;
        let corners =
            |b: &markerloom_core::correspond::scene::Aabb| [<[f64; 3]>::from(b.low), <[f64; 3]>::from(b.high)];
        let out = PyDict::new(py);
        out.set_item("noise", m.noise.clone())?;
        out.set_item("tail", m.tail.map(|t| (t.share, t.scale)))?;
        out.set_item("expected_markers", m.expected_markers)?;
        out.set_item("detection", m.detection)?;
        out.set_item("clutter_per_frame", m.clutter.clone())?;
        out.set_item("volume_m", corners(&m.volume))?;
        out.set_item("region_m", corners(&m.region))?;
        let fixed: Vec<Vec<(f64, f64, f64)>> =
            m.reflections.iter().map(|r| r.iter().map(|x| (x.pixel[0], x.pixel[1], x.rate)).collect()).collect();
        out.set_item("fixed_reflections", fixed)?;
        Ok(out)
    }
}

fn options(method: &str, noise: Option<f64>) -> PyResult<ReconstructOptions> {
    let method = match method {
        "optimal" => Method::Optimal,
        "relaxation" => Method::Relaxation,
        "epipolar" => Method::Epipolar,
        other => return Err(RigError::new_err(format!("unknown method '{other}'"))),
    };
    let mut options = ReconstructOptions { method, ..ReconstructOptions::default() };
    options.estimate.noise = noise;
    Ok(options)
}

/// Estimates the prior of a take from its dots.
#[pyfunction]
#[pyo3(signature = (rig, dots, noise=None))]
pub fn estimate_model(py: Python<'_>, rig: &PyRig, dots: DotArrays<'_>, noise: Option<f64>) -> PyResult<PyModel> {
    let (all, ranges) = dots.frames(rig.inner.cameras.len())?;
    let options = options("optimal", noise)?;
    let found = py.detach(|| {
        let frames: Vec<&[Dot]> = ranges.into_iter().map(|r| &all[r]).collect();
        engine::estimate_model(&rig.inner, &frames, &options)
    });
    Ok(PyModel { inner: found.map_err(|e| of_reconstruct(&e))? })
}

/// Points of all frames, as a dictionary of arrays.
#[pyfunction]
#[pyo3(signature = (rig, dots, model, method="optimal", threads=0))]
pub fn reconstruct<'py>(
    py: Python<'py>,
    rig: &PyRig,
    dots: DotArrays<'py>,
    model: &PyModel,
    method: &str,
    threads: usize,
) -> PyResult<Bound<'py, PyDict>> {
    let (all, ranges) = dots.frames(rig.inner.cameras.len())?;
    let options = options(method, None)?;
    let pool =
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().map_err(|e| RigError::new_err(e.to_string()))?;
    let solved = py.detach(|| {
        let frames: Vec<&[Dot]> = ranges.iter().map(|r| &all[r.clone()]).collect();
        pool.install(|| engine::reconstruct(&rig.inner, &frames, &model.inner, &options))
    });
    arrays(py, &solved, &ranges)
}

fn arrays<'py>(
    py: Python<'py>,
    solved: &[Correspondence],
    ranges: &[std::ops::Range<usize>],
) -> PyResult<Bound<'py, PyDict>> {
    let (mut frame, mut point, mut covariance) = (Vec::new(), Vec::new(), Vec::new());
    let (mut confidence, mut residual_px, mut ray_distance_m) = (Vec::new(), Vec::new(), Vec::new());
    let (mut dot_starts, mut dots) = (vec![0i64], Vec::new());
    for (i, (one, range)) in solved.iter().zip(ranges).enumerate() {
        for group in &one.groups {
            frame.push(i as i64);
            point.extend(group.point.iter().copied());
            covariance.extend(group.covariance.iter().copied());
            confidence.push(group.confidence);
            residual_px.push(group.residual_px);
            ray_distance_m.push(group.ray_distance_m);
            dots.extend(group.dots.iter().map(|&d| (d + range.start) as i64));
            dot_starts.push(dots.len() as i64);
        }
    }
    let n = frame.len();
    let out = PyDict::new(py);
    out.set_item("frame", frame.into_pyarray(py))?;
    out.set_item("point_m", point.into_pyarray(py).reshape([n, 3])?)?;
    out.set_item("covariance_m2", covariance.into_pyarray(py).reshape([n, 3, 3])?)?;
    out.set_item("confidence", confidence.into_pyarray(py))?;
    out.set_item("residual_px", residual_px.into_pyarray(py))?;
    out.set_item("ray_distance_m", ray_distance_m.into_pyarray(py))?;
    out.set_item("dot_starts", dot_starts.into_pyarray(py))?;
    out.set_item("dots", dots.into_pyarray(py))?;
    out.set_item("certified", solved.iter().map(|s| s.certified).collect::<Vec<_>>().into_pyarray(py))?;
    out.set_item("objective", solved.iter().map(|s| s.objective).collect::<Vec<_>>().into_pyarray(py))?;
    out.set_item("bound", solved.iter().map(|s| s.bound).collect::<Vec<_>>().into_pyarray(py))?;
    out.set_item("candidates", solved.iter().map(|s| s.candidates as i64).collect::<Vec<_>>().into_pyarray(py))?;
    out.set_item("nodes", solved.iter().map(|s| s.nodes as i64).collect::<Vec<_>>().into_pyarray(py))?;
    Ok(out)
}

/// All candidate groups of the first frame with their weights, and the optimum found: for checks by another solver.
#[pyfunction]
pub fn candidates<'py>(
    py: Python<'py>,
    rig: &PyRig,
    dots: DotArrays<'py>,
    model: &PyModel,
) -> PyResult<Bound<'py, PyDict>> {
    let (all, ranges) = dots.frames(rig.inner.cameras.len())?;
    let frame = ranges.first().map_or(&all[..0], |r| &all[r.clone()]);
    let scene = Scene::new(&rig.inner, &model.inner);
    let prepared = PreparedFrame::new(&scene, frame);
    let (found, packing) = choose(&scene, &prepared, &ReconstructOptions::default().optimal);
    let out = PyDict::new(py);
    let groups: Vec<Vec<usize>> =
        (0..found.len()).map(|g| found.dots(g).iter().map(|&z| prepared.input_index[z as usize]).collect()).collect();
    out.set_item("groups", groups)?;
    out.set_item("weights", found.weights.into_pyarray(py))?;
    out.set_item("complete", found.complete)?;
    out.set_item("objective", packing.value)?;
    out.set_item("optimal", packing.is_optimal())?;
    Ok(out)
}
