//! Skeletons for Python.

use crate::errors::RigError;
use markerloom_core::skeleton::fit::{Known, fit as engine_fit};
use markerloom_core::skeleton::hold::hold;
use markerloom_core::skeleton::kinematics::vector_of;
use markerloom_core::skeleton::solve::{Orientation, Pin, residuals};
use markerloom_core::skeleton::take::{Follower, Frame, Seen, solve_take};
use markerloom_core::skeleton::{Figure, Joint, Marker, Pose};
use nalgebra::{Rotation3, Vector3};
use numpy::ndarray::{Array2, Array3, ArrayView1, ArrayView2};
use numpy::{IntoPyArray, PyArray2, PyArray3, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::prelude::*;

type Pins = Vec<(usize, usize, [f64; 3], [f64; 3], f64)>;
type Orientations = Vec<(usize, usize, [f64; 3], f64)>;
type Poses<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>, Bound<'py, PyArray3<f64>>);
type GivenPoses<'py> = (PyReadonlyArray2<'py, f64>, PyReadonlyArray2<'py, f64>, PyReadonlyArray3<'py, f64>);
type Certain<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray3<f64>>);

/// A skeleton that wears markers: lengths in metres, angles in radians.
#[pyclass(name = "Figure", frozen)]
pub struct PyFigure {
    inner: Figure,
}

fn vector(row: ArrayView1<'_, f64>) -> Vector3<f64> {
    Vector3::new(row[0], row[1], row[2])
}

fn markers(frame: ArrayView2<'_, f64>) -> Vec<Option<Vector3<f64>>> {
    let place = |row: ArrayView1<'_, f64>| Some(vector(row)).filter(|p| p.iter().all(|v| v.is_finite()));
    frame.outer_iter().map(place).collect()
}

fn rows(vectors: impl Iterator<Item = Vector3<f64>>) -> Array2<f64> {
    let all: Vec<f64> = vectors.flat_map(<[f64; 3]>::from).collect();
    Array2::from_shape_vec((all.len() / 3, 3), all).expect("three numbers each")
}

fn as_arrays<'py>(py: Python<'py>, poses: &[&Pose], joints: usize) -> Poses<'py> {
    let mut turns = Array3::zeros((poses.len(), joints, 3));
    for (f, pose) in poses.iter().enumerate() {
        for (j, turn) in pose.turns.iter().enumerate() {
            (0..3).for_each(|k| turns[(f, j, k)] = turn[k]);
        }
    }
    (
        rows(poses.iter().map(|p| p.root_m)).into_pyarray(py),
        rows(poses.iter().map(|p| vector_of(&p.root))).into_pyarray(py),
        turns.into_pyarray(py),
    )
}

fn as_poses(given: &GivenPoses<'_>, frames: usize) -> Vec<Pose> {
    let (root, root_turn, turns) = (given.0.as_array(), given.1.as_array(), given.2.as_array());
    (0..frames)
        .map(|f| Pose {
            root_m: vector(root.row(f)),
            root: Rotation3::new(vector(root_turn.row(f))),
            turns: turns.index_axis(numpy::ndarray::Axis(0), f).outer_iter().map(vector).collect(),
        })
        .collect()
}

impl PyFigure {
    fn seen(&self, xyz_m: &PyReadonlyArray3<'_, f64>, pins: Pins, orientations: Orientations) -> PyResult<Vec<Seen>> {
        let n = self.inner.joints.len();
        let mut frames: Vec<Seen> =
            xyz_m.as_array().outer_iter().map(|frame| Seen { markers_m: markers(frame), ..Seen::default() }).collect();
        let bad = || RigError::new_err("a pin or orientation names a frame or joint that is not there");
        for (frame, joint, place, target, sigma_m) in pins {
            let seen = frames.get_mut(frame).filter(|_| joint < n).ok_or_else(bad)?;
            seen.pins.push(Pin { joint, place_m: place.into(), target_m: target.into(), sigma_m });
        }
        for (frame, joint, turn, sigma_rad) in orientations {
            let seen = frames.get_mut(frame).filter(|_| joint < n).ok_or_else(bad)?;
            seen.orientations.push(Orientation { joint, target: Rotation3::new(turn.into()), sigma_rad });
        }
        Ok(frames)
    }

    /// Poses, and how certain those frames are that say it.
    fn as_solved<'a, 'py>(
        &self,
        py: Python<'py>,
        each: impl ExactSizeIterator<Item = (&'a Pose, Option<&'a Frame>)>,
    ) -> (Poses<'py>, Certain<'py>) {
        let n = self.inner.joints.len();
        let mut place = Array2::from_elem((each.len(), n), f64::NAN);
        let mut turn = Array3::from_elem((each.len(), n, 3), f64::NAN);
        let mut poses = Vec::with_capacity(each.len());
        for (f, (pose, frame)) in each.enumerate() {
            poses.push(pose);
            let Some(certain) = frame.and_then(|f| f.certainty.as_ref()) else { continue };
            for j in 0..n {
                place[(f, j)] = certain.joint_m2[j].max(0.0).sqrt();
                let own = if j == 0 { certain.root_rad2 } else { certain.turn_rad2[j] };
                (0..3).for_each(|k| turn[(f, j, k)] = own[k].max(0.0).sqrt());
            }
        }
        (as_arrays(py, &poses, n), (place.into_pyarray(py), turn.into_pyarray(py)))
    }
}

#[pymethods]
impl PyFigure {
    #[new]
    #[expect(clippy::too_many_arguments, reason = "one list per property of joints and markers")]
    fn new(
        parents: Vec<Option<usize>>,
        offsets_m: Vec<[f64; 3]>,
        orders: Vec<Option<[usize; 3]>>,
        free: Vec<[bool; 3]>,
        limits_rad: Vec<[[f64; 2]; 3]>,
        rest_sd_rad: Vec<[f64; 3]>,
        marker_joint: Vec<usize>,
        marker_place_m: Vec<[f64; 3]>,
        marker_sigma_m: Vec<f64>,
    ) -> PyResult<Self> {
        let n = parents.len();
        let ordered = parents.iter().enumerate().all(|(j, p)| p.map_or(j == 0, |p| p < j));
        if !ordered || [offsets_m.len(), orders.len(), free.len(), limits_rad.len(), rest_sd_rad.len()] != [n; 5] {
            return Err(RigError::new_err("joints must come after their parents, and have all properties"));
        }
        let permuted = |order: &[usize; 3]| (0..3).all(|k| order.contains(&k));
        if !orders.iter().flatten().all(permuted) {
            return Err(RigError::new_err("an order names each of the three axes once"));
        }
        if marker_joint.iter().any(|&j| j >= n) {
            return Err(RigError::new_err("a marker is on a joint that is not there"));
        }
        let joints = (0..n)
            .map(|j| Joint {
                parent: parents[j],
                offset_m: offsets_m[j].into(),
                order: orders[j],
                free: free[j],
                limits_rad: limits_rad[j],
                rest_sd_rad: rest_sd_rad[j],
            })
            .collect();
        let markers = marker_joint
            .into_iter()
            .zip(marker_place_m)
            .zip(marker_sigma_m)
            .map(|((joint, place), sigma_m)| Marker { joint, place_m: place.into(), sigma_m })
            .collect();
        Ok(Self { inner: Figure { joints, markers } })
    }

    /// Offsets of the joints (m).
    fn offsets_m<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        rows(self.inner.joints.iter().map(|j| j.offset_m)).into_pyarray(py)
    }

    /// Places of the markers in their segments (m).
    fn places_m<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        rows(self.inner.markers.iter().map(|m| m.place_m)).into_pyarray(py)
    }

    /// Standard deviations of the markers (m, per axis).
    fn sigmas_m(&self) -> Vec<f64> {
        self.inner.markers.iter().map(|m| m.sigma_m).collect()
    }

    /// A take (frames, markers, 3; m; NaN where absent) solved: poses; and sigma of every joint's place (m) and
    /// standard deviations of its turn (rad).
    fn solve<'py>(
        &self,
        py: Python<'py>,
        xyz_m: PyReadonlyArray3<'py, f64>,
        step_s: f64,
        pins: Pins,
        orientations: Orientations,
    ) -> PyResult<(Poses<'py>, Certain<'py>)> {
        let frames = self.seen(&xyz_m, pins, orientations)?;
        let solved = py.detach(|| solve_take(&self.inner, step_s, &frames));
        Ok(self.as_solved(py, solved.iter().map(|f| (&f.pose, Some(f)))))
    }

    /// Places held in a take that is solved already (`poses`, under the same markers, pins and orientations): as
    /// `solve`, with `holds` as pins; certainties of frames in which nothing is held are NaN.
    #[expect(clippy::too_many_arguments, reason = "all that the poses know, and the holds")]
    fn hold<'py>(
        &self,
        py: Python<'py>,
        xyz_m: PyReadonlyArray3<'py, f64>,
        step_s: f64,
        pins: Pins,
        orientations: Orientations,
        poses: GivenPoses<'py>,
        holds: Pins,
    ) -> PyResult<(Poses<'py>, Certain<'py>)> {
        let frames = self.seen(&xyz_m, pins, orientations)?;
        let held: Vec<Vec<Pin>> = self.seen(&xyz_m, holds, Vec::new())?.into_iter().map(|f| f.pins).collect();
        let known = as_poses(&poses, frames.len());
        let solved = py.detach(|| hold(&self.inner, step_s, &frames, &known, &held));
        let each =
            known.iter().zip(&solved).map(|(pose, frame)| (frame.as_ref().map_or(pose, |f| &f.pose), frame.as_ref()));
        Ok(self.as_solved(py, each))
    }

    /// Poses of frames that know nothing of each other.
    fn pose<'py>(&self, py: Python<'py>, xyz_m: PyReadonlyArray3<'py, f64>) -> PyResult<Poses<'py>> {
        let frames = self.seen(&xyz_m, Vec::new(), Vec::new())?;
        let poses = py.detach(|| alone(&self.inner, &frames));
        Ok(as_arrays(py, &poses.iter().collect::<Vec<_>>(), self.inner.joints.len()))
    }

    /// The figure fitted to frames, from poses to start with; `None` for them: each frame is solved on its own first.
    #[expect(clippy::too_many_arguments, reason = "what is known of the fit")]
    fn fit<'py>(
        &self,
        py: Python<'py>,
        xyz_m: PyReadonlyArray3<'py, f64>,
        poses: Option<GivenPoses<'py>>,
        offset_sd_m: Vec<[f64; 3]>,
        place_sd_m: Vec<f64>,
        mirrored: Vec<(usize, usize, f64)>,
        pins: Pins,
        orientations: Orientations,
    ) -> PyResult<(Self, Poses<'py>, f64)> {
        let frames = self.seen(&xyz_m, pins, orientations)?;
        if offset_sd_m.len() != self.inner.joints.len() || place_sd_m.len() != self.inner.markers.len() {
            return Err(RigError::new_err("what is known must be said of every joint and marker"));
        }
        let known = Known { offset_sd_m: offset_sd_m.into_iter().map(Into::into).collect(), place_sd_m, mirrored };
        let starts = poses.map_or_else(Vec::new, |given| as_poses(&given, frames.len()));
        let fitted = py.detach(|| {
            let starts = if starts.is_empty() { alone(&self.inner, &frames) } else { starts };
            engine_fit(&self.inner, &frames, starts, &known)
        });
        let poses: Vec<&Pose> = fitted.poses.iter().collect();
        let arrays = as_arrays(py, &poses, self.inner.joints.len());
        Ok((Self { inner: fitted.figure }, arrays, fitted.residual_m))
    }

    /// How far markers are from poses (frames, markers; m), NaN where absent.
    fn residuals_m<'py>(
        &self,
        py: Python<'py>,
        xyz_m: PyReadonlyArray3<'py, f64>,
        root_m: PyReadonlyArray2<'py, f64>,
        root_turn: PyReadonlyArray2<'py, f64>,
        turns: PyReadonlyArray3<'py, f64>,
    ) -> Bound<'py, PyArray2<f64>> {
        let frames = xyz_m.as_array();
        let poses = as_poses(&(root_m, root_turn, turns), frames.len_of(numpy::ndarray::Axis(0)));
        let mut out = Array2::from_elem((poses.len(), self.inner.markers.len()), f64::NAN);
        for (f, (frame, pose)) in frames.outer_iter().zip(&poses).enumerate() {
            for (m, off) in residuals(&self.inner, pose, &markers(frame)).into_iter().enumerate() {
                out[(f, m)] = off.unwrap_or(f64::NAN);
            }
        }
        out.into_pyarray(py)
    }
}

/// Poses of frames that know nothing of each other.
fn alone(figure: &Figure, frames: &[Seen]) -> Vec<Pose> {
    let solve = |seen: &Seen| Follower::new(figure.clone(), 1.0, joints_of(seen)).push(seen).map(|s| s.pose);
    frames.iter().map(|seen| solve(seen).unwrap_or_else(|| figure.rest())).collect()
}

fn joints_of(seen: &Seen) -> Vec<usize> {
    seen.pins.iter().map(|p| p.joint).chain(seen.orientations.iter().map(|o| o.joint)).collect()
}

/// A figure followed frame by frame.
#[pyclass(name = "Follower")]
pub struct PyFollower {
    inner: Follower,
    joints: usize,
}

#[pymethods]
impl PyFollower {
    #[new]
    fn new(figure: &PyFigure, step_s: f64) -> Self {
        let inner = Follower::new(figure.inner.clone(), step_s, std::iter::empty());
        Self { inner, joints: figure.inner.joints.len() }
    }

    /// The pose of the next frame (markers, 3; m; NaN where absent): root, its turn, turns; `None` before anything is
    /// known.
    fn push<'py>(&mut self, py: Python<'py>, xyz_m: PyReadonlyArray2<'py, f64>) -> Option<Poses<'py>> {
        let seen = Seen { markers_m: markers(xyz_m.as_array()), ..Seen::default() };
        let solved = self.inner.push(&seen)?;
        Some(as_arrays(py, &[&solved.pose], self.joints))
    }
}
