//! Simulation for Python.

use crate::errors::RigError;
use crate::rig::PyRig;
use markerloom_core::camera::{Camera, Rig};
use markerloom_core::synth::body::{Body, Capsule, Motion, segment_names};
use markerloom_core::synth::observe::{Hide, Imperfections, observe as engine_observe};
use markerloom_core::synth::{cloud as engine_cloud, rigs};
use nalgebra::Vector3;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// A simulated rig: the keyword arguments that `markerloom.rig.Camera` takes, camera by camera.
#[pyfunction]
#[pyo3(signature = (shape, cameras, distance_m, elevation_deg, angle_deg, size_px, focal_px, target_m))]
#[expect(clippy::too_many_arguments, reason = "each one is a keyword of the scene")]
pub fn rig<'py>(
    py: Python<'py>,
    shape: &str,
    cameras: usize,
    distance_m: f64,
    elevation_deg: f64,
    angle_deg: f64,
    size_px: [f64; 2],
    focal_px: f64,
    target_m: [f64; 3],
) -> PyResult<Vec<Bound<'py, PyDict>>> {
    let mut made = match shape {
        "ring" => rigs::ring(cameras, distance_m, elevation_deg, angle_deg, size_px, focal_px),
        "arc" => rigs::arc(cameras, distance_m, elevation_deg, angle_deg, size_px, focal_px),
        "wall" => {
            let columns = (cameras as f64).sqrt().ceil() as usize;
            let rows = cameras.div_ceil(columns.max(1));
            let mut wall =
                rigs::wall(columns, rows, distance_m, distance_m * angle_deg.to_radians(), size_px, focal_px);
            wall.cameras.truncate(cameras);
            wall
        }
        other => return Err(RigError::new_err(format!("unknown rig shape '{other}': ring, arc or wall"))),
    };
    made.cameras.iter_mut().for_each(|c| c.position_m += Vector3::from(target_m));
    made.cameras.iter().map(|c| described(py, c)).collect()
}

pub fn described<'py>(py: Python<'py>, camera: &Camera) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    let r = &camera.camera_from_world;
    let rows: Vec<[f64; 3]> = (0..3).map(|i| [r[(i, 0)], r[(i, 1)], r[(i, 2)]]).collect();
    out.set_item("id", &camera.id)?;
    out.set_item("size_px", camera.size_px)?;
    out.set_item("focal_px", camera.focal_px)?;
    out.set_item("principal_px", camera.principal_px)?;
    out.set_item("rotation", rows)?;
    out.set_item("position_m", <[f64; 3]>::from(camera.position_m))?;
    Ok(out)
}

/// Random markers of one frame.
#[pyfunction]
pub fn cloud(seed: u64, frame: usize, markers: usize, size_m: [f64; 3], center_m: [f64; 3]) -> Vec<[f64; 3]> {
    engine_cloud(seed, frame, markers, &Vector3::from(size_m), &Vector3::from(center_m))
        .into_iter()
        .map(Into::into)
        .collect()
}

fn body(motion: &str, markers: usize, seed: u64, center_m: [f64; 3]) -> PyResult<Body> {
    Ok(Body::new(motion_of(motion)?, markers, seed, Vector3::from(center_m)))
}

fn motion_of(motion: &str) -> PyResult<Motion> {
    match motion {
        "walk" => Ok(Motion::Walk),
        "dance" => Ok(Motion::Dance),
        "rom" => Ok(Motion::Rom),
        other => Err(RigError::new_err(format!("unknown motion '{other}': walk, dance or rom"))),
    }
}

/// Names of a figure's markers.
#[pyfunction]
pub fn body_labels(motion: &str, markers: usize, seed: u64) -> PyResult<Vec<String>> {
    Ok(body(motion, markers, seed, [0.0; 3])?.labels())
}

type Pose = (Vec<[f64; 3]>, Vec<([f64; 3], [f64; 3], f64)>);

fn pose(body: &Body, time_s: f64) -> Pose {
    let pose = body.pose(time_s);
    let points = pose.markers_m.into_iter().map(Into::into).collect();
    (points, pose.capsules.iter().map(|c| (c.ends_m[0].into(), c.ends_m[1].into(), c.radius_m)).collect())
}

/// Markers and occluding capsules of a figure at a time.
#[pyfunction]
pub fn body_pose(motion: &str, markers: usize, seed: u64, center_m: [f64; 3], time_s: f64) -> PyResult<Pose> {
    Ok(pose(&body(motion, markers, seed, center_m)?, time_s))
}

/// Markers and occluding capsules, at a time, of a figure that wears a marker set and stands in a T-pose first.
#[pyfunction]
pub fn wearing_pose(
    motion: &str,
    set: Vec<(String, String, [f64; 3])>,
    seed: u64,
    center_m: [f64; 3],
    t_pose_s: f64,
    time_s: f64,
) -> PyResult<Pose> {
    let body = Body::wearing(motion_of(motion)?, &set, seed, Vector3::from(center_m), t_pose_s);
    let body = body.ok_or_else(|| RigError::new_err("the marker set has segments that the figure has not"))?;
    Ok(pose(&body, time_s))
}

/// Names and places of the joints of such a figure.
#[pyfunction]
pub fn wearing_joints(
    motion: &str,
    set: Vec<(String, String, [f64; 3])>,
    seed: u64,
    center_m: [f64; 3],
    t_pose_s: f64,
    time_s: f64,
) -> PyResult<Vec<(String, [f64; 3])>> {
    let body = Body::wearing(motion_of(motion)?, &set, seed, Vector3::from(center_m), t_pose_s);
    let body = body.ok_or_else(|| RigError::new_err("the marker set has segments that the figure has not"))?;
    let names = segment_names().into_iter().map(String::from);
    Ok(names.zip(body.pose(time_s).joints_m.into_iter().map(Into::into)).collect())
}

type Seen = (usize, f64, f64, Vec<usize>);

/// Dots of one frame: (camera, x, y, markers).
#[pyfunction]
#[pyo3(signature = (rig, markers, capsules, sigma_px, hide, merge_px, clutter_per_frame, reflections, seed, frame))]
#[expect(clippy::too_many_arguments, reason = "each one is a keyword of the scene")]
pub fn observe(
    rig: &PyRig,
    markers: Vec<[f64; 3]>,
    capsules: Vec<([f64; 3], [f64; 3], f64)>,
    sigma_px: f64,
    hide: &str,
    merge_px: f64,
    clutter_per_frame: f64,
    reflections: usize,
    seed: u64,
    frame: usize,
) -> PyResult<Vec<Seen>> {
    let hide = match hide {
        "none" => Hide::Nothing,
        "one" => Hide::One,
        "quarter" => Hide::Each(0.25),
        other => {
            let p = other.parse::<f64>().ok().filter(|p| (0.0..1.0).contains(p));
            Hide::Each(
                p.ok_or_else(|| RigError::new_err(format!("hide '{other}': none, one, quarter or a probability")))?,
            )
        }
    };
    let what = Imperfections { sigma_px, hide, merge_px, clutter_per_frame, reflections };
    let points: Vec<Vector3<f64>> = markers.into_iter().map(Vector3::from).collect();
    let capsules: Vec<Capsule> = capsules
        .into_iter()
        .map(|(a, b, radius_m)| Capsule { ends_m: [Vector3::from(a), Vector3::from(b)], radius_m })
        .collect();
    let dots = engine_observe(&Rig { cameras: rig.inner.cameras.clone() }, &points, &capsules, &what, seed, frame);
    Ok(dots.into_iter().map(|d| (d.camera, d.pixel[0], d.pixel[1], d.markers)).collect())
}
