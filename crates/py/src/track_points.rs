//! Tracking of points that another system has measured.

use crate::conv::Teller;
use crate::errors::InputError;
use crate::label::PyStart;
use crate::track::arrays;
use markerloom_core::track::paper::{PaperOptions, PaperPointTracker};
use markerloom_core::track::points::{MeasuredPoint, PointTracker};
use markerloom_core::track::repair::repair_points;
use markerloom_core::track::{Moment, TrackOptions, Tracked};
use nalgebra::Vector3;
use numpy::{PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Follows a take of points: `starts` (frames + 1) are the first rows of each frame, `point_m` (n, 3), `sigma_m` (n,)
/// per axis. `confirmed_only`: just what a live user saw; `paper`: the seed paper's tracking. `progress(part)` is called now
/// and then.
#[pyfunction]
#[pyo3(signature = (starts, point_m, sigma_m, frames, rate_hz, confirmed_only, paper, progress=None, start=None))]
#[expect(clippy::too_many_arguments, reason = "each one is a keyword")]
pub fn track_points<'py>(
    py: Python<'py>,
    starts: Vec<usize>,
    point_m: PyReadonlyArray2<'py, f64>,
    sigma_m: PyReadonlyArray1<'py, f64>,
    frames: Vec<i64>,
    rate_hz: f64,
    confirmed_only: bool,
    paper: bool,
    progress: Option<Py<PyAny>>,
    start: Option<&PyStart>,
) -> PyResult<Bound<'py, PyDict>> {
    let sigma_m = sigma_m.as_slice()?;
    let rows = point_m.as_array();
    let fits = rows.ncols() == 3
        && rows.nrows() == sigma_m.len()
        && starts.len() == frames.len() + 1
        && starts.is_sorted()
        && starts.last() == Some(&rows.nrows());
    if !fits {
        return Err(InputError::new_err("points, sigmas, frames and starts do not belong together"));
    }
    let point =
        |i: usize| MeasuredPoint { point: Vector3::new(rows[(i, 0)], rows[(i, 1)], rows[(i, 2)]), sigma_m: sigma_m[i] };
    let all: Vec<MeasuredPoint> = (0..rows.nrows()).map(point).collect();
    let teller = Teller::new(progress);
    let start = start.map(PyStart::start);
    let tracked = py
        .detach(|| {
            let (mut recorded, mut times_s): (Vec<Tracked>, Vec<f64>) = (Vec::new(), Vec::new());
            let mut default = PointTracker::new(rate_hz, TrackOptions::default())?.starting_from(start);
            let mut as_written = PaperPointTracker::new(rate_hz, PaperOptions::default())?;
            for (range, &frame) in starts.windows(2).zip(&frames) {
                let moment = Moment { frame: Some(frame), time_s: None };
                let points = &all[range[0]..range[1]];
                recorded.push(if paper { as_written.push(points, moment) } else { default.push(points, moment) }?);
                times_s.push(if paper { as_written.moment() } else { default.moment() }.1);
            }
            if !confirmed_only && !paper {
                let told = |part| teller.tell(part);
                recorded = repair_points(&TrackOptions::default(), &recorded, &times_s, &told);
            }
            Ok(recorded)
        })
        .map_err(|e: markerloom_core::track::TimeError| InputError::new_err(e.to_string()))?;
    teller.finish()?;
    arrays(py, &tracked, &starts, confirmed_only)
}
