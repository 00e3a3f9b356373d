//! Gaps for Python.

use crate::errors::InputError;
use markerloom_core::fill::{Around, Gap, Way, fill, frames_of};
use nalgebra::Vector3;
use numpy::ndarray::{Array2, Array3};
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

type Framed<'py> =
    (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray3<f64>>, Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>);

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

/// The frame of neighbours (frames, points, 3) in every frame, against that of row `reference`, and a marker (frames, 3) in
/// it: middle (frames, 3), turn (frames, 3, 3), marker (frames, 3) and neighbours (frames, 3 points) there.
#[pyfunction]
pub fn in_frames_of<'py>(
    py: Python<'py>,
    neighbours: PyReadonlyArray3<'py, f64>,
    marker: PyReadonlyArray2<'py, f64>,
    reference: usize,
) -> PyResult<Framed<'py>> {
    let vectors =
        |values: &[f64]| -> Vec<Vector3<f64>> { values.chunks_exact(3).map(Vector3::from_column_slice).collect() };
    let count = neighbours.as_array().dim().1;
    let (neighbours, marker) = (vectors(neighbours.as_slice()?), vectors(marker.as_slice()?));
    if neighbours.len() != count * marker.len() || reference >= marker.len().max(1) {
        return Err(InputError::new_err("neighbours and marker have other frames"));
    }
    let frames = py.detach(|| frames_of(&neighbours, count, reference));
    let n = frames.len();
    let (mut middle, mut turn) = (Array2::zeros((n, 3)), Array3::zeros((n, 3, 3)));
    let (mut local, mut features) = (Array2::zeros((n, 3)), Array2::zeros((n, 3 * count)));
    for (f, frame) in frames.iter().enumerate() {
        let back = frame.turn.inverse();
        let own = back * (marker[f] - frame.middle);
        (0..3).for_each(|k| (middle[(f, k)], local[(f, k)]) = (frame.middle[k], own[k]));
        (0..9).for_each(|i| turn[(f, i / 3, i % 3)] = frame.turn.matrix()[(i / 3, i % 3)]);
        for (p, point) in neighbours[f * count..(f + 1) * count].iter().enumerate() {
            let own = back * (point - frame.middle);
            (0..3).for_each(|k| features[(f, 3 * p + k)] = own[k]);
        }
    }
    Ok((middle.into_pyarray(py), turn.into_pyarray(py), local.into_pyarray(py), features.into_pyarray(py)))
}
