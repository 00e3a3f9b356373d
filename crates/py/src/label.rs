//! Naming of points for Python.

use crate::conv::places;
use crate::errors::InputError;
use markerloom_core::label::evidence::{Frame, Names, Naming};
use markerloom_core::label::learn::{Learned, Named, Said, learn, learn_more as engine_learn_more};
use markerloom_core::label::live::Labeller;
use markerloom_core::label::model::{Height, Length, Model};
use markerloom_core::label::search::{Plan, search_all};
use markerloom_core::label::take::{Take, label_take};
use markerloom_core::track::Start;
use nalgebra::Vector3;
use numpy::ndarray::ArrayView1;
use numpy::{PyReadonlyArray2, PyReadonlyArray3};
use pyo3::prelude::*;

type Numbers = (f64, f64, f64);
type Lengths = Vec<Option<Numbers>>;
type Heights = Vec<Vec<([usize; 3], Numbers)>>;

fn numbers(length: &Length) -> Numbers {
    (length.mean, length.sd, length.trust)
}

fn length((mean, sd, trust): Numbers) -> Length {
    Length { mean, sd, trust }
}

/// Frames with names from (frames, markers, 3), NaN where missing.
fn named(xyz_m: &PyReadonlyArray3<'_, f64>) -> Vec<Named> {
    let place = |row: ArrayView1<'_, f64>| {
        let p = Vector3::new(row[0], row[1], row[2]);
        p.iter().all(|v| v.is_finite()).then_some(p)
    };
    xyz_m.as_array().outer_iter().map(|frame| frame.outer_iter().map(place).collect()).collect()
}

fn as_lists(learned: &Learned) -> (Lengths, Heights) {
    let lengths = learned.distances.iter().map(|d| d.as_ref().map(numbers)).collect();
    let heights = learned.heights.iter();
    (lengths, heights.map(|own| own.iter().map(|h| (h.base, numbers(&h.length))).collect()).collect())
}

fn as_learned(distances: Lengths, heights: Heights) -> Learned {
    let height = |(base, numbers)| Height { base, length: length(numbers) };
    Learned {
        distances: distances.into_iter().map(|d| d.map(length)).collect(),
        heights: heights.into_iter().map(|own| own.into_iter().map(height).collect()).collect(),
    }
}

/// Distances (row by row) and heights of a subject from frames with names: (frames, markers, 3), NaN where missing.
/// `same_segment` (row by row): what a marker set says of each pair.
#[pyfunction]
pub fn learn_subject(
    py: Python<'_>,
    xyz_m: PyReadonlyArray3<'_, f64>,
    same_segment: Vec<Option<bool>>,
    poses: f64,
    noise_m: f64,
) -> (Lengths, Heights) {
    let frames = named(&xyz_m);
    let said = |pair: &Option<bool>| match pair {
        Some(true) => Said::Rigid,
        Some(false) => Said::Soft,
        None => Said::Unknown,
    };
    let said: Vec<Said> = same_segment.iter().map(said).collect();
    as_lists(&py.detach(|| learn(&frames, &said, poses, noise_m)))
}

/// What further frames add to a subject.
#[pyfunction]
pub fn learn_more(
    py: Python<'_>,
    known: (Lengths, Heights),
    known_poses: f64,
    xyz_m: PyReadonlyArray3<'_, f64>,
    poses: f64,
    noise_m: f64,
) -> (Lengths, Heights) {
    let (frames, known) = (named(&xyz_m), as_learned(known.0, known.1));
    as_lists(&py.detach(|| engine_learn_more(&known, known_poses, &frames, poses, noise_m)))
}

/// What is known of the markers of one or several subjects.
#[pyclass(name = "LabelModel", module = "markerloom._core", frozen)]
pub struct PyModel {
    inner: Model,
    plans: Vec<Plan>,
}

#[pymethods]
impl PyModel {
    #[new]
    fn new(subject: Vec<usize>, distances: Lengths, heights: Heights) -> Self {
        let known = as_learned(distances, heights);
        let inner = Model::new(subject, &known.distances, &known.heights);
        let plans = (0..inner.subjects()).map(|s| Plan::new(&inner, s)).collect();
        Self { inner, plans }
    }

    /// Names given the names of before: settled, with the evidence of each.
    fn settle(&self, xyz_m: PyReadonlyArray2<'_, f64>, names: Vec<i64>) -> (Vec<i64>, f64) {
        let points = places(&xyz_m);
        let frame = Frame::new(&points);
        let names = names.iter().map(|&p| usize::try_from(p).ok()).collect();
        let mut naming = Naming::new(&self.inner, &frame, names);
        naming.settle(&self.inner, &frame);
        (as_numbers(&naming.names), naming.sum)
    }

    /// The markers of a frame without any history: of each marker its point, or −1; the evidence; how many markers
    /// stand on their side of a triangle, and how many on the other.
    fn search(&self, py: Python<'_>, xyz_m: PyReadonlyArray2<'_, f64>) -> (Vec<i64>, f64, [usize; 2]) {
        let points = places(&xyz_m);
        py.detach(|| {
            let frame = Frame::new(&points);
            let found = search_all(&self.inner, &self.plans, &frame);
            (as_numbers(&found.names), found.sum, found.sides(&self.inner, &frame))
        })
    }

    /// Names of a whole take: of each row its marker (or −1) and the probability; and the share of heights on the wrong
    /// side. `believed`: of each row a marker and how firmly it is believed, or nothing at all.
    fn label_take(
        &self,
        py: Python<'_>,
        starts: Vec<usize>,
        xyz_m: PyReadonlyArray2<'_, f64>,
        track: Vec<usize>,
        rate_hz: f64,
        believed: Vec<Option<(usize, f64)>>,
    ) -> (Vec<i64>, Vec<f64>, f64) {
        let points = places(&xyz_m);
        py.detach(|| {
            let take = Take::new(&starts, &points, &track, rate_hz, &believed);
            let found = label_take(&self.inner, &self.plans, &take);
            (as_numbers(&found.marker), found.probability, found.mirrored)
        })
    }
}

/// What is known of the markers before the first frame: a model from so many independent poses, and its markers' places in poses seen before
/// (poses, markers, 3; m; NaN where missing).
#[pyclass(name = "StartPose", module = "markerloom._core", frozen)]
pub struct PyStart {
    model: Model,
    independent: f64,
    poses: Vec<Named>,
}

#[pymethods]
impl PyStart {
    #[new]
    fn new(model: &PyModel, independent: f64, poses_m: PyReadonlyArray3<'_, f64>) -> PyResult<Self> {
        let poses = named(&poses_m);
        if poses.iter().any(|pose| pose.len() != model.inner.len()) {
            return Err(InputError::new_err("the poses have other markers than the model"));
        }
        Ok(Self { model: model.inner.clone(), independent, poses })
    }
}

impl PyStart {
    /// For a tracker.
    pub fn start(&self) -> Start {
        Start::new(self.model.clone(), self.independent, self.poses.clone())
    }
}

/// Names points as they come.
#[pyclass(name = "Labeller", module = "markerloom._core")]
pub struct PyLabeller {
    inner: Labeller,
}

#[pymethods]
impl PyLabeller {
    #[new]
    fn new(model: &PyModel) -> Self {
        Self { inner: Labeller::new(model.inner.clone()) }
    }

    /// Of each point its marker, or −1, and the probability.
    fn push(
        &mut self,
        py: Python<'_>,
        time_s: f64,
        tracks: Vec<i64>,
        xyz_m: PyReadonlyArray2<'_, f64>,
    ) -> (Vec<i64>, Vec<f64>) {
        let points = places(&xyz_m);
        let names = py.detach(|| self.inner.push(time_s, &tracks, &points));
        names.iter().map(|n| (n.marker.map_or(-1, |m| m as i64), n.probability)).unzip()
    }
}

fn as_numbers(names: &Names) -> Vec<i64> {
    names.iter().map(|p| p.map_or(-1, |p| p as i64)).collect()
}
