//! Motions as material, for Python.

use markerloom_core::motion::alike::{Clouds, alignment, distances};
use markerloom_core::motion::bands;
use markerloom_core::motion::goals::{Goal, Place, Want};
use markerloom_core::motion::spacetime::{Bones, Clip, Freedom, Options, change};
use nalgebra::{Matrix3, Rotation3, Vector3};
use numpy::ndarray::{Array2, Array3, Array4};
use numpy::{IntoPyArray, PyArray2, PyArray3, PyArray4, PyReadonlyArray2, PyReadonlyArray3, PyReadonlyArray4};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// How many bands a signal of so many frames has.
#[pyfunction]
pub fn band_count(frames: usize) -> usize {
    bands::count(frames)
}

/// All bands of a signal (frames × channels), finest first, and the last level.
#[pyfunction]
pub fn split_bands<'py>(
    py: Python<'py>,
    values: PyReadonlyArray2<'py, f64>,
    count: usize,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let shape = values.as_array().dim();
    let values = values.as_slice()?;
    let all = py.detach(|| bands::split(values, shape.1, count));
    Ok(Array3::from_shape_vec((count + 1, shape.0, shape.1), all).expect("as many as there are").into_pyarray(py))
}

/// The signal with its bands weighted: `gains` (bands + 1) × channels.
#[pyfunction]
pub fn equalise_bands<'py>(
    py: Python<'py>,
    values: PyReadonlyArray2<'py, f64>,
    gains: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let shape = values.as_array().dim();
    if gains.as_array().ncols() != shape.1 || gains.as_array().nrows() == 0 {
        return Err(PyValueError::new_err("one gain per band and channel"));
    }
    let (values, gains) = (values.as_slice()?, gains.as_slice()?);
    let all = py.detach(|| bands::equalised(values, shape.1, gains));
    Ok(Array2::from_shape_vec(shape, all).expect("as many as there were").into_pyarray(py))
}

/// Clouds of points around the moments of a motion.
#[pyclass(name = "Clouds", frozen)]
pub struct PyClouds {
    inner: Clouds,
    frames: usize,
    half: usize,
}

#[pymethods]
impl PyClouds {
    #[new]
    fn new(points_m: PyReadonlyArray3<'_, f64>, weights: Vec<f64>, half: usize) -> PyResult<Self> {
        let (frames, points, _) = points_m.as_array().dim();
        if frames == 0 || points != weights.len() || points == 0 {
            return Err(PyValueError::new_err("frames with one weight per point"));
        }
        Ok(Self { inner: Clouds::new(points_m.as_slice()?.to_vec(), &weights, half), frames, half })
    }

    /// Distances (m) of all moments from all of another motion.
    fn distances<'py>(&self, py: Python<'py>, other: &Self) -> Bound<'py, PyArray2<f64>> {
        let all = py.detach(|| distances(&self.inner, &other.inner, self.half));
        Array2::from_shape_vec((self.frames, other.frames), all).expect("every pair").into_pyarray(py)
    }

    /// How the other motion's moment is laid onto one of this: turn (rad), shift (m), distance (m).
    fn alignment(&self, at: usize, other: &Self, other_at: usize) -> PyResult<(f64, [f64; 2], f64)> {
        if at >= self.frames || other_at >= other.frames {
            return Err(PyValueError::new_err("no such frame"));
        }
        Ok(alignment(&self.inner, at, &other.inner, other_at, self.half))
    }
}

type GivenFreedom = (usize, [f64; 3], bool, f64);
type GivenGoal = (String, usize, usize, [f64; 3], usize, [f64; 3], [f64; 3], f64);
type Changed<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray4<f64>>, Vec<f64>);

fn goal(given: GivenGoal, frames: usize, joints: usize) -> PyResult<Goal> {
    let (kind, frame, a, at_a, b, at_b, vector, number) = given;
    if frame >= frames || a >= joints || b >= joints {
        return Err(PyValueError::new_err("a goal outside of the clip"));
    }
    let first = Place { joint: a, local_m: at_a.into() };
    let second = Place { joint: b, local_m: at_b.into() };
    let want = match kind.as_str() {
        "at" => Want::At(first, vector.into()),
        "above" => Want::Above(first, number),
        "apart" => Want::Apart(first, second, vector.into()),
        "within" => Want::Within(first, second, number),
        "look" => Want::Look(first, at_b.into(), vector.into()),
        other => return Err(PyValueError::new_err(format!("no goal is called {other}"))),
    };
    Ok(Goal { frame, want })
}

fn clip_of(root_m: &PyReadonlyArray2<'_, f64>, turns: &PyReadonlyArray4<'_, f64>) -> PyResult<Clip> {
    let turns = turns.as_slice()?;
    Ok(Clip {
        root_m: root_m.as_array().outer_iter().map(|r| Vector3::new(r[0], r[1], r[2])).collect(),
        turns: turns.chunks_exact(9).map(|m| Rotation3::from_matrix_unchecked(Matrix3::from_row_slice(m))).collect(),
    })
}

/// Change a motion as little as its goals allow; returns root, turns, and what every goal is missed by (m).
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "as many as the problem has parts")]
pub fn change_motion<'py>(
    py: Python<'py>,
    parents: Vec<Option<usize>>,
    offsets_m: Vec<[f64; 3]>,
    root_m: PyReadonlyArray2<'py, f64>,
    turns: PyReadonlyArray4<'py, f64>,
    freedoms: Vec<GivenFreedom>,
    goals: Vec<GivenGoal>,
    levels: Vec<(usize, f64)>,
    sharp: PyReadonlyArray2<'py, f64>,
    tolerance_m: f64,
    window: (usize, usize),
) -> PyResult<Changed<'py>> {
    let (frames, joints) = (root_m.as_array().nrows(), parents.len());
    let turned = turns.as_array().dim();
    if turned != (frames, joints, 3, 3) || offsets_m.len() != joints || freedoms.iter().any(|f| f.0 >= joints) {
        return Err(PyValueError::new_err("a motion of another skeleton"));
    }
    if window.1 == 0 || window.0 <= window.1 || levels.iter().any(|l| l.0 == 0 || l.1 <= 0.0) {
        return Err(PyValueError::new_err("windows that do not advance"));
    }
    if sharp.as_array().dim() != (frames, freedoms.len()) || sharp.as_array().iter().any(|s| s.is_nan() || *s <= 0.0) {
        return Err(PyValueError::new_err("how sharply each freedom may change in each frame"));
    }
    let sharp = sharp.as_slice()?.to_vec();
    let goals = goals.into_iter().map(|g| goal(g, frames, joints)).collect::<PyResult<Vec<_>>>()?;
    let bones = Bones { parents, offsets_m: offsets_m.into_iter().map(Vector3::from).collect() };
    let freedoms: Vec<Freedom> = freedoms
        .into_iter()
        .map(|(joint, axis, shift, usual)| Freedom { joint, axis: axis.into(), shift, usual })
        .collect();
    let options = Options { levels, sharp, tolerance_m, window: window.0, overlap: window.1 };
    let mut clip = clip_of(&root_m, &turns)?;
    let before = clip.clone();
    let off = py.detach(|| change(&bones, &mut clip, &freedoms, &goals, &options));
    let (mut root, mut out) = (root_m.as_array().to_owned(), turns.as_array().to_owned());
    for f in 0..frames {
        (0..3).for_each(|k| root[(f, k)] = clip.root_m[f][k]);
        for j in 0..joints {
            if clip.turns[f * joints + j] != before.turns[f * joints + j] {
                write_turn(&mut out, f, j, &clip.turns[f * joints + j]);
            }
        }
    }
    Ok((root.into_pyarray(py), out.into_pyarray(py), off))
}

fn write_turn(out: &mut Array4<f64>, f: usize, j: usize, turn: &Rotation3<f64>) {
    let turn = Rotation3::from(nalgebra::UnitQuaternion::from_rotation_matrix(turn));
    for a in 0..3 {
        (0..3).for_each(|b| out[(f, j, a, b)] = turn[(a, b)]);
    }
}
