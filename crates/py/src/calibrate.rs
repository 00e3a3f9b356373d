//! Calibration for Python.

use crate::conv::{self, DotArrays};
use crate::errors::InputError;
use crate::rig::PyRig;
use crate::synth::described;
use markerloom_core::calibrate::board;
use markerloom_core::calibrate::bootstrap::Start;
use markerloom_core::calibrate::bundle::covariance::covariance;
use markerloom_core::calibrate::bundle::{Pose, Sighting};
use markerloom_core::calibrate::points::from_points;
use markerloom_core::calibrate::refine::refine;
use markerloom_core::calibrate::wand::{Span, Wand};
use markerloom_core::calibrate::wave::{Options, Wave, calibrate};
use markerloom_core::camera::{Camera, Lens};
use nalgebra::{Matrix3, Vector2, Vector3};
use numpy::{IntoPyArray, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

fn table(py: Python<'_>, rows: Vec<f64>, columns: usize) -> PyResult<Bound<'_, PyArray2<f64>>> {
    let n = rows.len() / columns;
    rows.into_pyarray(py).reshape([n, columns])
}

/// A wand from marker places (m).
fn wand(markers_m: Vec<[f64; 3]>) -> PyResult<Wand> {
    let places: Vec<Vector3<f64>> = markers_m.into_iter().map(Vector3::from).collect();
    Wand::new(&places).ok_or_else(|| InputError::new_err("a wand needs markers, each at a place of its own"))
}

/// Calibrates cameras from the raw dots of a wand wave; `known` of them: `nothing`, `intrinsics` or (roughly) `rig`; see `markerloom/calibrate/wand.py`.
#[pyfunction]
#[pyo3(signature = (cameras, known, markers_m, dots, left_out_every, most_poses))]
pub fn calibrate_wand<'py>(
    py: Python<'py>,
    cameras: Vec<Bound<'py, PyDict>>,
    known: &str,
    markers_m: Vec<[f64; 3]>,
    dots: DotArrays<'py>,
    left_out_every: usize,
    most_poses: usize,
) -> PyResult<Bound<'py, PyDict>> {
    let cameras: Vec<_> = cameras.iter().map(conv::camera).collect::<PyResult<_>>()?;
    let (all, ranges) = dots.frames(cameras.len())?;
    let wand = wand(markers_m)?;
    let start = Start { cameras, focal_known: known == "intrinsics", rig_known: known == "rig" };
    let options = Options { left_out_every, most_poses };
    let solved = py.detach(|| calibrate(&start, &wand, &all, &ranges, &options));
    let wave = solved.map_err(|e| InputError::new_err(e.to_string()))?;
    of_wave(py, &wave)
}

/// A camera with the coefficients of its lens, if it is OpenCV's.
fn with_lens<'py>(py: Python<'py>, camera: &Camera) -> PyResult<Bound<'py, PyDict>> {
    let out = described(py, camera)?;
    if let Lens::BrownConrady { k, p } = &camera.lens {
        out.set_item("coefficients", [k[0], k[1], p[0], p[1], k[2], k[3], k[4], k[5]])?;
    }
    Ok(out)
}

/// Everything of an adjusted wave as arrays.
fn of_wave<'py>(py: Python<'py>, wave: &Wave) -> PyResult<Bound<'py, PyDict>> {
    let bundle = &wave.bundle;
    let out = PyDict::new(py);
    let cameras: Vec<_> = bundle.cameras.iter().map(|c| with_lens(py, c)).collect::<PyResult<_>>()?;
    out.set_item("cameras", cameras)?;
    out.set_item("parameters_free", bundle.freedom.iter().map(|f| f.to_vec()).collect::<Vec<_>>())?;
    out.set_item("noise_px", &wave.noise_px)?;
    out.set_item("missing", &wave.missing)?;
    out.set_item("whole_views", &wave.whole_views)?;
    out.set_item("whole_views_placed", &wave.whole_views_placed)?;
    out.set_item("still_dots", &wave.still_dots)?;
    out.set_item("converged", wave.converged)?;
    out.set_item("pose_freedom", bundle.wand.pose_freedom())?;
    let places: Vec<f64> = bundle.poses.iter().flat_map(|p| [p.position_m.x, p.position_m.y, p.position_m.z]).collect();
    out.set_item("pose_position_m", table(py, places, 3)?)?;
    let turns: Vec<f64> = bundle.poses.iter().flat_map(|p| p.rotation.transpose().as_slice().to_vec()).collect();
    out.set_item("pose_rotation", turns.into_pyarray(py).reshape([bundle.poses.len(), 3, 3])?)?;
    let markers: Vec<f64> = bundle.wand.markers_m.iter().flat_map(|m| [m.x, m.y, m.z]).collect();
    out.set_item("markers_m", table(py, markers, 3)?)?;
    out.set_item("pose_frame", wave.frame.iter().map(|f| *f as i64).collect::<Vec<_>>().into_pyarray(py))?;
    out.set_item("dot", wave.dot.iter().map(|f| *f as i64).collect::<Vec<_>>().into_pyarray(py))?;
    let index =
        |f: fn(&Sighting) -> usize| bundle.sightings.iter().map(|s| f(s) as i64).collect::<Vec<_>>().into_pyarray(py);
    out.set_item("pose", index(|s| s.pose))?;
    out.set_item("camera", index(|s| s.camera))?;
    out.set_item("marker", index(|s| s.marker))?;
    out.set_item("used", bundle.sightings.iter().map(|s| s.weight > 0.0).collect::<Vec<_>>().into_pyarray(py))?;
    let off = |s| bundle.residual(s).map_or([f64::NAN; 2], Into::into);
    out.set_item("residual_px", table(py, bundle.sightings.iter().flat_map(off).collect(), 2)?)?;
    let pairs = |v: &[(f64, f64)]| v.iter().flat_map(|(a, b)| [*a, *b]).collect::<Vec<_>>();
    out.set_item("left_out_lengths_m", table(py, pairs(&wave.left_out_lengths_m), 2)?)?;
    let left_out: Vec<f64> = wave.left_out_px.iter().flat_map(|(c, r)| [*c as f64, *r]).collect();
    out.set_item("left_out_px", table(py, left_out, 2)?)?;
    let known = covariance(bundle, bundle.wand.span != Span::Point);
    out.set_item("determined", known.is_some())?;
    if let Some(matrix) = known {
        let n = matrix.nrows();
        out.set_item("covariance", table(py, matrix.iter().copied().collect(), n)?)?;
    }
    Ok(out)
}

/// One camera from markers at known places (m) and their pixels: camera, noise, residuals, which are used, covariance.
#[pyfunction]
pub fn calibrate_points<'py>(
    py: Python<'py>,
    camera: Bound<'py, PyDict>,
    places_m: Vec<[f64; 3]>,
    pixel: Vec<[f64; 2]>,
    focal_known: bool,
) -> PyResult<Option<Bound<'py, PyDict>>> {
    let start = conv::camera(&camera)?;
    let known: Vec<_> =
        places_m.iter().zip(&pixel).map(|(place, pixel)| (Vector3::from(*place), Vector2::from(*pixel))).collect();
    let Some(solved) = py.detach(|| from_points(&start, &known, focal_known)) else { return Ok(None) };
    let out = PyDict::new(py);
    out.set_item("camera", with_lens(py, &solved.camera)?)?;
    out.set_item("noise_px", solved.noise_px)?;
    let off = |r: &Option<Vector2<f64>>| r.map_or([f64::NAN; 2], Into::into);
    out.set_item("residual_px", table(py, solved.residual_px.iter().flat_map(off).collect(), 2)?)?;
    out.set_item("used", solved.used.into_pyarray(py))?;
    out.set_item("parameters_free", solved.freedom.to_vec())?;
    if let Some(matrix) = solved.covariance {
        let n = matrix.nrows();
        out.set_item("covariance", table(py, matrix.iter().copied().collect(), n)?)?;
    }
    Ok(Some(out))
}

/// Camera poses adjusted to points that are seen: cameras, noise (px). `point` and `camera` index each pixel.
#[pyfunction]
pub fn refine_rig<'py>(
    py: Python<'py>,
    rig: &PyRig,
    points_m: Vec<[f64; 3]>,
    point: Vec<usize>,
    camera: Vec<usize>,
    pixel: Vec<[f64; 2]>,
) -> PyResult<(Vec<Bound<'py, PyDict>>, Vec<f64>)> {
    let places: Vec<Vector3<f64>> = points_m.into_iter().map(Vector3::from).collect();
    let cameras = &rig.inner.cameras;
    if point.len() != camera.len()
        || point.len() != pixel.len()
        || point.iter().any(|p| *p >= places.len())
        || camera.iter().any(|c| *c >= cameras.len())
    {
        return Err(InputError::new_err("points, cameras and pixels do not fit together"));
    }
    let mut sightings: Vec<Sighting> = (0..point.len())
        .map(|i| Sighting { pose: point[i], camera: camera[i], marker: 0, pixel: pixel[i].into(), weight: 1.0 })
        .collect();
    sightings.sort_by_key(|s| (s.pose, s.camera));
    let refined = py.detach(|| refine(cameras, &places, sightings));
    let (cameras, noise) =
        refined.ok_or_else(|| InputError::new_err("the cameras cannot be refined from these points"))?;
    Ok((cameras.iter().map(|c| described(py, c)).collect::<PyResult<_>>()?, noise))
}

/// Cameras and board poses (rotation, position) adjusted together: cameras, noise (px), residuals, which are used,
/// covariance. `view`: pose, camera and corner of each pixel.
#[pyfunction]
pub fn adjust_board<'py>(
    py: Python<'py>,
    rig: &PyRig,
    corners_m: Vec<[f64; 3]>,
    poses: Vec<([[f64; 3]; 3], [f64; 3])>,
    view: Vec<[usize; 3]>,
    pixel: Vec<[f64; 2]>,
) -> PyResult<Bound<'py, PyDict>> {
    let cameras = &rig.inner.cameras;
    let in_range = |v: &[usize; 3]| v[0] < poses.len() && v[1] < cameras.len() && v[2] < corners_m.len();
    if view.len() != pixel.len() || !view.iter().all(in_range) {
        return Err(InputError::new_err("poses, cameras, corners and pixels do not fit together"));
    }
    let mut order: Vec<usize> = (0..view.len()).collect();
    order.sort_by_key(|&i| view[i]);
    let sightings = order.iter().map(|&i| {
        let [pose, camera, marker] = view[i];
        Sighting { pose, camera, marker, pixel: pixel[i].into(), weight: 1.0 }
    });
    let sightings: Vec<Sighting> = sightings.collect();
    let corners: Vec<Vector3<f64>> = corners_m.into_iter().map(Vector3::from).collect();
    let pose = |(r, t): &([[f64; 3]; 3], [f64; 3])| Pose {
        rotation: Matrix3::from_fn(|i, j| r[i][j]),
        position_m: Vector3::from(*t),
    };
    let poses: Vec<Pose> = poses.iter().map(pose).collect();
    let (bundle, noise) = py
        .detach(|| board::adjust(cameras, &corners, &poses, sightings))
        .ok_or_else(|| InputError::new_err("the board has no extent"))?;
    let out = PyDict::new(py);
    out.set_item("cameras", bundle.cameras.iter().map(|c| with_lens(py, c)).collect::<PyResult<Vec<_>>>()?)?;
    out.set_item("noise_px", noise)?;
    out.set_item("row", order.iter().map(|&i| i as i64).collect::<Vec<_>>().into_pyarray(py))?;
    out.set_item("used", bundle.sightings.iter().map(|s| s.weight > 0.0).collect::<Vec<_>>().into_pyarray(py))?;
    let off = |s| bundle.residual(s).map_or([f64::NAN; 2], Into::into);
    out.set_item("residual_px", table(py, bundle.sightings.iter().flat_map(off).collect(), 2)?)?;
    out.set_item("redundancy_factor", bundle.redundancy_factor())?;
    if let Some(matrix) = covariance(&bundle, true) {
        let n = matrix.nrows();
        out.set_item("covariance", table(py, matrix.iter().copied().collect(), n)?)?;
    }
    Ok(out)
}
