//! Tracking: frames of dots to trajectories, one at a time or a take at once.

use crate::conv::DotArrays;
use crate::errors::InputError;
use crate::reconstruct::PyModel;
use crate::rig::PyRig;
use markerloom_core::correspond::frame::Dot;
use markerloom_core::correspond::scene::Scene;
use markerloom_core::track::paper::{PaperOptions, PaperTracker};
use markerloom_core::track::repair::repair;
use markerloom_core::track::{Kind, Moment, TrackError, TrackOptions, Tracked, Tracker};
use numpy::{IntoPyArray, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Who follows the markers.
enum Engine {
    Default(Box<Tracker>),
    Paper(Box<PaperTracker>),
}

impl Engine {
    fn push(&mut self, dots: &[Dot], moment: Moment) -> Result<Tracked, TrackError> {
        match self {
            Self::Default(tracker) => tracker.push(dots, moment),
            Self::Paper(tracker) => tracker.push(dots, moment),
        }
    }

    fn time_s(&self) -> f64 {
        match self {
            Self::Default(tracker) => tracker.time_s(),
            Self::Paper(tracker) => tracker.time_s(),
        }
    }

    fn scene(&self) -> &Scene {
        match self {
            Self::Default(tracker) => tracker.scene(),
            Self::Paper(tracker) => tracker.scene(),
        }
    }
}

/// A tracker, and the frames it has recorded.
#[pyclass(name = "Tracker")]
pub struct PyTracker {
    tracker: Engine,
    cameras: usize,
    recorded: Vec<Tracked>,
    starts: Vec<usize>,
    times_s: Vec<f64>,
    dots: Vec<Vec<Dot>>,
    frame_ms: Vec<f64>,
}

#[pymethods]
impl PyTracker {
    #[new]
    #[pyo3(signature = (rig, model, rate_hz, noise_px=None, paper=false))]
    fn new(rig: &PyRig, model: Option<&PyModel>, rate_hz: f64, noise_px: Option<f64>, paper: bool) -> PyResult<Self> {
        let options = TrackOptions::default();
        let default = |tracker| Engine::Default(Box::new(tracker));
        let made = match model {
            Some(model) if paper => PaperTracker::new(&rig.inner, &model.inner, rate_hz, PaperOptions::default())
                .map(|tracker| Engine::Paper(Box::new(tracker))),
            Some(model) => Tracker::new(&rig.inner, &model.inner, rate_hz, options).map(default),
            None => Tracker::learning(&rig.inner, noise_px, rate_hz, options).map(default),
        };
        let tracker = made.map_err(|e| InputError::new_err(e.to_string()))?;
        Ok(Self {
            tracker,
            cameras: rig.inner.cameras.len(),
            recorded: Vec::new(),
            starts: vec![0],
            times_s: Vec::new(),
            dots: Vec::new(),
            frame_ms: Vec::new(),
        })
    }

    /// Follows the markers through one frame (`dots` holds just that one); its samples as arrays.
    fn push<'py>(
        &mut self,
        py: Python<'py>,
        dots: DotArrays<'py>,
        frame: Option<i64>,
        time_s: Option<f64>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let (all, _) = dots.frames(self.cameras)?;
        let tracker = &mut self.tracker;
        let found = py
            .detach(|| tracker.push(&all, Moment { frame, time_s }))
            .map_err(|e| InputError::new_err(e.to_string()))?;
        arrays(py, &[found], &[0], true)
    }

    /// Follows and records several frames with the given numbers and times (NaN: by number and rate).
    fn record(
        &mut self,
        py: Python<'_>,
        dots: DotArrays<'_>,
        frames: Vec<i64>,
        times_s: Vec<Option<f64>>,
    ) -> PyResult<()> {
        let (all, ranges) = dots.frames(self.cameras)?;
        let (tracker, recorded, starts) = (&mut self.tracker, &mut self.recorded, &mut self.starts);
        let (times, kept, frame_ms) = (&mut self.times_s, &mut self.dots, &mut self.frame_ms);
        py.detach(|| {
            for ((range, frame), time_s) in ranges.into_iter().zip(frames).zip(times_s) {
                let own: &[Dot] = &all[range];
                let clock = std::time::Instant::now();
                recorded.push(tracker.push(own, Moment { frame: Some(frame), time_s })?);
                frame_ms.push(1000.0 * clock.elapsed().as_secs_f64());
                times.push(tracker.time_s());
                kept.push(own.to_vec());
                starts.push(starts[starts.len() - 1] + own.len());
            }
            Ok(())
        })
        .map_err(|e: TrackError| InputError::new_err(e.to_string()))
    }

    /// How long each recorded frame took (ms).
    fn frame_ms(&self) -> Vec<f64> {
        self.frame_ms.clone()
    }

    /// What the tracker believes about the take.
    fn model(&self) -> PyModel {
        PyModel { inner: self.tracker.scene().model.clone() }
    }

    /// What was recorded. `confirmed_only`: just what a live user saw.
    fn recorded<'py>(&self, py: Python<'py>, confirmed_only: bool) -> PyResult<Bound<'py, PyDict>> {
        if confirmed_only || matches!(self.tracker, Engine::Paper(_)) {
            return arrays(py, &self.recorded, &self.starts, true);
        }
        let kept = py.detach(|| {
            repair(self.tracker.scene(), &TrackOptions::default(), &self.recorded, &self.dots, &self.times_s)
        });
        arrays(py, &kept, &self.starts, false)
    }
}

pub fn arrays<'py>(
    py: Python<'py>,
    frames: &[Tracked],
    starts: &[usize],
    confirmed_only: bool,
) -> PyResult<Bound<'py, PyDict>> {
    let (mut frame, mut track, mut point, mut covariance) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut kind, mut confidence, mut residual, mut distance) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut dot_starts, mut dots) = (vec![0i64], Vec::new());
    for (i, one) in frames.iter().enumerate() {
        for sample in one.samples.iter().filter(|s| s.confirmed || !confirmed_only) {
            frame.push(i as i64);
            track.push(i64::from(sample.track));
            point.extend(sample.point.iter().copied());
            covariance.extend(sample.covariance.iter().copied());
            kind.push(i64::from(sample.kind == Kind::Predicted));
            confidence.push(sample.confidence);
            residual.push(sample.residual_px);
            distance.push(sample.ray_distance_m);
            dots.extend(sample.dots.iter().map(|&d| (starts[i] + d as usize) as i64));
            dot_starts.push(dots.len() as i64);
        }
    }
    let n = frame.len();
    let out = PyDict::new(py);
    out.set_item("frame", frame.into_pyarray(py))?;
    out.set_item("track", track.into_pyarray(py))?;
    out.set_item("point_m", point.into_pyarray(py).reshape([n, 3])?)?;
    out.set_item("covariance_m2", covariance.into_pyarray(py).reshape([n, 3, 3])?)?;
    out.set_item("kind", kind.into_pyarray(py))?;
    out.set_item("confidence", confidence.into_pyarray(py))?;
    out.set_item("residual_px", residual.into_pyarray(py))?;
    out.set_item("ray_distance_m", distance.into_pyarray(py))?;
    out.set_item("dot_starts", dot_starts.into_pyarray(py))?;
    out.set_item("dots", dots.into_pyarray(py))?;
    let searched: Vec<i64> = frames.iter().map(|f| f.searched_dots as i64).collect();
    out.set_item("searched_dots", searched.into_pyarray(py))?;
    out.set_item("certified", frames.iter().map(|f| f.certified).collect::<Vec<_>>().into_pyarray(py))?;
    out.set_item("overfull", frames.iter().map(|f| f.overfull).collect::<Vec<_>>().into_pyarray(py))?;
    Ok(out)
}
