//! Gaps for Python.

use crate::errors::InputError;
use markerloom_core::fill::{Around, Gap, Way, fill, turns};
use nalgebra::Vector3;
use numpy::ndarray::Array3;
use numpy::{IntoPyArray, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::prelude::*;

/// What surrounds a gap (see `Surroundings`): frames, world, local, features, neighbours, turn, middle.
type Surroundings<'py> = (
    PyReadonlyArray1<'py, i64>,
    PyReadonlyArray2<'py, f64>,
    PyReadonlyArray2<'py, f64>,
    PyReadonlyArray2<'py, f64>,
    PyReadonlyArray3<'py, f64>,
    PyReadonlyArray3<'py, f64>,
    PyReadonlyArray2<'py, f64>,
);

/// Places (frames, 3) within a gap from `first` to before `last`, by one of the ways from neighbours; `None` where it cannot
/// tell. `learn`: rows that may be learned from.
#[pyfunction]
pub fn fill_gap<'py>(
    py: Python<'py>,
    way: &str,
    around: Surroundings<'py>,
    first: i64,
    last: i64,
    learn: PyReadonlyArray1<'py, i64>,
) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
    let way = match way {
        "pattern" => Way::Pattern,
        "rigid" => Way::Rigid,
        "links" => Way::Links,
        "regression" => Way::Regression,
        "cyclic" => Way::Cyclic,
        _ => return Err(InputError::new_err(format!("there is no way '{way}' to fill from neighbours"))),
    };
    let (frames, world, local, features, neighbours, turn, middle) = &around;
    let (frames, learn) = (frames.as_slice()?, learn.as_slice()?);
    let around = Around {
        frames,
        world: world.as_slice()?.as_chunks().0,
        local: local.as_slice()?.as_chunks().0,
        features: features.as_slice()?,
        neighbours: neighbours.as_slice()?.as_chunks().0,
        turn: turn.as_slice()?.as_chunks().0,
        middle: middle.as_slice()?.as_chunks().0,
    };
    let n = frames.len();
    let fits = [around.world.len(), around.local.len(), around.turn.len(), around.middle.len()].iter().all(|&l| l == n)
        && around.features.len() == 3 * around.neighbours.len()
        && learn.iter().all(|&row| (0..n as i64).contains(&row));
    if !fits {
        return Err(InputError::new_err("the surroundings of a gap do not belong together"));
    }
    let found = py.detach(|| fill(way, &Gap { around: &around, first, last, learn }));
    found.map(|places| rows(py, places)).transpose()
}

fn rows(py: Python<'_>, places: Vec<Vector3<f64>>) -> PyResult<Bound<'_, PyArray2<f64>>> {
    let count = places.len();
    let all: Vec<f64> = places.into_iter().flat_map(<[f64; 3]>::from).collect();
    numpy::PyArrayMethods::reshape(&all.into_pyarray(py), [count, 3])
}

/// The rotations (frames, 3, 3) that bring a reference (points, 3) nearest to each frame (frames, points, 3).
#[pyfunction]
pub fn turns_onto<'py>(
    py: Python<'py>,
    reference: PyReadonlyArray2<'py, f64>,
    about: PyReadonlyArray3<'py, f64>,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let vectors =
        |values: &[f64]| -> Vec<Vector3<f64>> { values.chunks_exact(3).map(Vector3::from_column_slice).collect() };
    let (reference, points) = (vectors(reference.as_slice()?), vectors(about.as_slice()?));
    let found = py.detach(|| turns(&reference, &points));
    let mut out = Array3::zeros((found.len(), 3, 3));
    for (f, turn) in found.iter().enumerate() {
        (0..9).for_each(|i| out[(f, i / 3, i % 3)] = turn.matrix()[(i / 3, i % 3)]);
    }
    Ok(out.into_pyarray(py))
}
