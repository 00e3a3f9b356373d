//! Tracking: frames of dots to trajectories, one at a time or a take at once.

use crate::conv::{self, DotArrays, Teller};
use crate::errors::InputError;
use crate::label::PyStart;
use crate::reconstruct::PyModel;
use crate::rig::PyRig;
use crate::synth::described;
use markerloom_core::calibrate::watch::{Moved, Placed, Watch};
use markerloom_core::camera::Camera;
use markerloom_core::correspond::frame::Dot;
use markerloom_core::correspond::scene::Scene;
use markerloom_core::track::paper::{PaperOptions, PaperTracker};
use markerloom_core::track::repair::{Lights, repair};
use markerloom_core::track::{Kind, Moment, Shot, TrackError, TrackOptions, Tracked, Tracker, at_moments};
use numpy::{IntoPyArray, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::collections::VecDeque;

/// Who follows the markers.
enum Engine {
    Default(Box<Tracker>),
    Paper(Box<PaperTracker>),
}

impl Engine {
    fn push(&mut self, shot: &Shot, moment: Moment) -> Result<Tracked, TrackError> {
        let dots = &shot.dots;
        match self {
            Self::Default(tracker) => tracker.push_from_clocks(dots, moment, &shot.lag_s),
            Self::Paper(tracker) => tracker.push(dots, moment),
        }
    }

    /// Number and time (s) of the last frame.
    fn moment(&self) -> (i64, f64) {
        match self {
            Self::Default(tracker) => tracker.moment(),
            Self::Paper(tracker) => tracker.moment(),
        }
    }

    fn scene(&self) -> &Scene {
        match self {
            Self::Default(tracker) => tracker.scene(),
            Self::Paper(tracker) => tracker.scene(),
        }
    }
}

/// A tracker, what is known of its cameras' moves, and the frames it has recorded.
#[pyclass(name = "Tracker")]
pub struct PyTracker {
    tracker: Engine,
    cameras: usize,
    watch: Watch,
    moved: Vec<Moved>,
    /// Whether cameras are replaced when they are found to have moved.
    heal: bool,
    /// Moves that are known before, by frame number.
    planned: VecDeque<(i64, usize, Camera)>,
    /// Index of the recorded frame from which on the present scene holds, and the scenes before it.
    scene_from: usize,
    past: Vec<(usize, Scene)>,
    recorded: Vec<Tracked>,
    starts: Vec<usize>,
    times_s: Vec<f64>,
    shots: Vec<Shot>,
    frame_ms: Vec<f64>,
}

#[pymethods]
impl PyTracker {
    #[new]
    #[pyo3(signature = (rig, model, rate_hz, noise_px=None, paper=false, heal=false, planned=Vec::new(), start=None))]
    #[expect(clippy::too_many_arguments, reason = "each one is a keyword")]
    fn new(
        rig: &PyRig,
        model: Option<&PyModel>,
        rate_hz: f64,
        noise_px: Option<f64>,
        paper: bool,
        heal: bool,
        planned: Vec<(i64, usize, Bound<'_, PyDict>)>,
        start: Option<&PyStart>,
    ) -> PyResult<Self> {
        let camera = |(frame, index, dict): &(i64, usize, Bound<'_, PyDict>)| Ok((*frame, *index, conv::camera(dict)?));
        let planned = planned.iter().map(camera).collect::<PyResult<_>>()?;
        let options = TrackOptions::default();
        let default = |tracker: Tracker| Engine::Default(Box::new(tracker.starting_from(start.map(PyStart::start))));
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
            watch: Watch::new(&rig.inner.cameras),
            moved: Vec::new(),
            heal,
            planned,
            scene_from: 0,
            past: Vec::new(),
            recorded: Vec::new(),
            starts: vec![0],
            times_s: Vec::new(),
            shots: Vec::new(),
            frame_ms: Vec::new(),
        })
    }

    /// Follows the markers through one frame (`dots` holds just that one); its samples as arrays. `lag_s`: by camera, how
    /// much later than the frame's time its image was taken; empty if all saw one moment.
    fn push<'py>(
        &mut self,
        py: Python<'py>,
        dots: DotArrays<'py>,
        frame: Option<i64>,
        time_s: Option<f64>,
        lag_s: Vec<f64>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let (dots, _) = dots.frames(self.cameras)?;
        let shot = Shot { dots, lag_s: self.checked(lag_s)? };
        let found = py
            .detach(|| self.follow(&shot, Moment { frame, time_s }))
            .map_err(|e| InputError::new_err(e.to_string()))?;
        arrays(py, &[found], &[0], true)
    }

    /// Follows and records several frames with the given numbers and times (`None`: by number and rate), and lags as in
    /// `push`.
    fn record(
        &mut self,
        py: Python<'_>,
        dots: DotArrays<'_>,
        frames: Vec<i64>,
        times_s: Vec<Option<f64>>,
        lags_s: Vec<Vec<f64>>,
    ) -> PyResult<()> {
        let (all, ranges) = dots.frames(self.cameras)?;
        let lags_s = lags_s.into_iter().map(|l| self.checked(l)).collect::<PyResult<Vec<_>>>()?;
        py.detach(|| {
            for (((range, frame), time_s), lag_s) in ranges.into_iter().zip(frames).zip(times_s).zip(lags_s) {
                let shot = Shot { dots: all[range].to_vec(), lag_s };
                let clock = std::time::Instant::now();
                let tracked = self.follow(&shot, Moment { frame: Some(frame), time_s })?;
                self.recorded.push(tracked);
                self.frame_ms.push(1000.0 * clock.elapsed().as_secs_f64());
                self.times_s.push(self.tracker.moment().1);
                self.starts.push(self.starts[self.starts.len() - 1] + shot.dots.len());
                self.shots.push(shot);
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

    /// What was recorded. `confirmed_only`: just what a live user saw. `progress(part)` is called now and then.
    /// `lights`: numbers of the frames, and the brightness of all their dots (NaN: not known), where there is one.
    #[pyo3(signature = (confirmed_only, progress=None, lights=None))]
    fn recorded<'py>(
        &self,
        py: Python<'py>,
        confirmed_only: bool,
        progress: Option<Py<PyAny>>,
        lights: Option<(Vec<i64>, Vec<f64>)>,
    ) -> PyResult<Bound<'py, PyDict>> {
        if lights.as_ref().is_some_and(|l| l.0.len() != self.recorded.len() || l.1.len() != self.starts[l.0.len()]) {
            return Err(InputError::new_err("the brightness is not that of the recorded dots"));
        }
        if confirmed_only || matches!(self.tracker, Engine::Paper(_)) {
            return arrays(py, &self.recorded, &self.starts, true);
        }
        let mut scenes: Vec<(usize, &Scene)> = self.past.iter().map(|(from, scene)| (*from, scene)).collect();
        scenes.push((self.scene_from, self.tracker.scene()));
        let (teller, options) = (Teller::new(progress), TrackOptions::default());
        let lights = lights.as_ref().map(|(frames, brightness)| Lights { frames, starts: &self.starts, brightness });
        let kept = py.detach(|| {
            repair(&scenes, &options, &self.recorded, &self.shots, &self.times_s, lights, &|part| teller.tell(part))
        });
        teller.finish()?;
        arrays(py, &kept, &self.starts, false)
    }

    /// Cameras found to have moved so far, a dictionary each; the same camera again where its pose is known better.
    /// `best`: with the poses that all frames so far give, be they in use yet or not.
    fn moved<'py>(&self, py: Python<'py>, best: bool) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let of = |moved: &Moved| {
            let out = described(py, &moved.now)?;
            out.set_item("camera", moved.camera)?;
            out.set_item("frame", moved.since)?;
            out.set_item("found", moved.found)?;
            out.set_item("shift_px", [moved.shift_px.x, moved.shift_px.y])?;
            out.set_item("dots", moved.dots)?;
            Ok(out)
        };
        let latest = if best { self.watch.latest() } else { Vec::new() };
        self.moved.iter().chain(&latest).map(of).collect()
    }
}

impl PyTracker {
    /// Lags of one frame: none, or one for each camera.
    fn checked(&self, lag_s: Vec<f64>) -> PyResult<Vec<f64>> {
        if lag_s.is_empty() || (lag_s.len() == self.cameras && lag_s.iter().all(|l| l.is_finite())) {
            return Ok(lag_s);
        }
        Err(InputError::new_err(format!("{} lags for {} cameras", lag_s.len(), self.cameras)))
    }

    /// Follows the markers through a frame, and watches the cameras.
    fn follow(&mut self, shot: &Shot, moment: Moment) -> Result<Tracked, TrackError> {
        let coming = moment.frame.unwrap_or(self.tracker.moment().0 + 1);
        while self.planned.front().is_some_and(|p| p.0 <= coming)
            && let Some((_, camera, now)) = self.planned.pop_front()
        {
            self.watch.replace(camera, now.clone());
            self.replace(camera, now, self.recorded.len());
        }
        let tracked = self.tracker.push(shot, moment)?;
        if matches!(self.tracker, Engine::Default(_)) {
            let placed: Vec<Placed> = tracked
                .samples
                .iter()
                .filter(|s| s.confirmed)
                .map(|s| Placed { track: s.track, place: s.point, velocity: s.velocity, dots: &s.dots })
                .collect();
            let noise = &self.tracker.scene().model.noise;
            let found = self.watch.push(self.tracker.moment().0, &placed, (&shot.dots, &shot.lag_s), noise);
            if self.heal {
                for moved in &found {
                    self.replace(moved.camera, moved.now.clone(), self.recorded.len() + 1);
                }
            }
            self.moved.extend(found);
        }
        Ok(tracked)
    }

    /// The camera as it stands from the recorded frame of this index on.
    fn replace(&mut self, camera: usize, now: Camera, from: usize) {
        let Engine::Default(tracker) = &mut self.tracker else { return };
        let before = tracker.replace_camera(camera, now);
        if from > self.scene_from {
            self.past.push((self.scene_from, before));
            self.scene_from = from;
        }
    }
}

/// Dots as of their frames' moments, where cameras saw them at others: frame starts, camera, pixel, sigma. Dots whose
/// motion is not known are left out.
#[pyfunction]
pub fn dots_at_moments<'py>(
    py: Python<'py>,
    rig: &PyRig,
    dots: DotArrays<'py>,
    times_s: Vec<f64>,
    lags_s: Vec<Vec<f64>>,
    rate_hz: f64,
) -> PyResult<Bound<'py, PyDict>> {
    let cameras = rig.inner.cameras.len();
    let (all, ranges) = dots.frames(cameras)?;
    if times_s.len() != ranges.len() || lags_s.len() != ranges.len() || lags_s.iter().any(|l| l.len() != cameras) {
        return Err(InputError::new_err("times and lags do not fit the frames and cameras"));
    }
    let shots: Vec<Shot> =
        ranges.into_iter().zip(lags_s).map(|(r, lag_s)| Shot { dots: all[r].to_vec(), lag_s }).collect();
    let moved = py.detach(|| at_moments(&rig.inner, &shots, &times_s, 1.0 / rate_hz));
    let mut starts = vec![0i64];
    moved.iter().for_each(|own| starts.push(starts[starts.len() - 1] + own.len() as i64));
    let flat = || moved.iter().flatten();
    let n = flat().count();
    let out = PyDict::new(py);
    out.set_item("starts", starts.into_pyarray(py))?;
    out.set_item("camera", flat().map(|d| d.camera as i64).collect::<Vec<_>>().into_pyarray(py))?;
    out.set_item("pixel", flat().flat_map(|d| d.pixel).collect::<Vec<_>>().into_pyarray(py).reshape([n, 2])?)?;
    let told = |d: &Dot| d.hardware.map_or(-1, i64::from);
    out.set_item("hardware", flat().map(told).collect::<Vec<_>>().into_pyarray(py))?;
    out.set_item("sigma", flat().map(|d| d.sigma).collect::<Vec<_>>().into_pyarray(py))?;
    Ok(out)
}

pub fn arrays<'py>(
    py: Python<'py>,
    frames: &[Tracked],
    starts: &[usize],
    confirmed_only: bool,
) -> PyResult<Bound<'py, PyDict>> {
    let (mut frame, mut track, mut point, mut covariance) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut velocity, mut hardware) = (Vec::new(), Vec::new());
    let (mut kind, mut confidence, mut residual, mut distance) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut dot_starts, mut dots) = (vec![0i64], Vec::new());
    for (i, one) in frames.iter().enumerate() {
        for sample in one.samples.iter().filter(|s| s.confirmed || !confirmed_only) {
            frame.push(i as i64);
            track.push(i64::from(sample.track));
            point.extend(sample.point.iter().copied());
            covariance.extend(sample.covariance.iter().copied());
            hardware.push(sample.hardware.map_or(-1, i64::from));
            velocity.extend(sample.velocity.iter().copied());
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
    out.set_item("hardware", hardware.into_pyarray(py))?;
    out.set_item("velocity_mps", velocity.into_pyarray(py).reshape([n, 3])?)?;
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
