//! One marker on its way through the frames.

use super::body::{Carried, Seen};
use super::filter::{Filter, Step};
use super::flow::Motion;
use super::frame::Frame;
use super::locate::{Located, posterior};
use super::matching::Prior;
use super::visibility::Visibility;
use super::{Kind, Sample};
use nalgebra::{Matrix3, Vector3};

/// Spread of the acceleration of a marker of which nothing is known (m/s²), and what any marker's stays within.
const FIRST_ACCELERATION: f64 = 20.0;
const ACCELERATION_RANGE: [f64; 2] = [1.0, 400.0];
/// The spread follows the innovations: fast up, slowly down (per frame and unit of normalised squared innovation).
const RISE: f64 = 0.2;
const FALL: f64 = 0.05;
const LARGEST_RATIO: f64 = 3.0;
/// A push is this much stronger than the usual acceleration, and within these bounds (m/s²).
const PUSH: f64 = 8.0;
const LEAST_PUSH: f64 = 60.0;
const LARGEST_PUSH: f64 = 200.0;
/// Squared innovation (χ², 3 degrees, 1e-3) beyond which there was a push.
const PUSHED: f64 = 16.3;
/// Hidden for longer, a marker's own motion says nothing about its speed any more (s).
const STALE_S: f64 = 0.1;
/// Spread beyond which a hidden marker's own motion is no prediction any more (m).
const LOST_SPREAD: f64 = 0.3;
/// Nobody is farther from where the body says (m): what keeps the spread of the lost from growing for ever.
const LARGEST_SPREAD: f64 = 1.5;
/// Spread of the speed relative to the neighbours' (m/s).
const SPEED_AMONG_NEIGHBOURS: f64 = 0.7;
/// Frames in which a new marker must be seen: by three cameras or more, or by two.
const HITS: u32 = 2;
const HITS_OF_PAIRS: u32 = 4;
/// Hidden for longer, an active marker comes back by its identity only (s).
const SILENT_S: f64 = 0.3;
/// Dots that must tell an identity before it is believed.
const TELLERS: usize = 2;
/// Frames in a row in which a tentative marker may be missed.
const MISSES: u32 = 2;
/// Most and each frame's gain of the log odds that a trajectory is a marker.
const SUREST: f64 = 14.0;
const SURER: f64 = 1.5;

/// A marker.
#[derive(Clone, Debug)]
pub struct Marker {
    /// Identity of the trajectory.
    pub track: u32,
    /// Place in the dynamic model.
    pub slot: usize,
    /// Motion.
    pub filter: Filter,
    /// Whether it is believed to be a marker.
    pub confirmed: bool,
    /// Where it is expected in this frame.
    pub prior: Prior,
    /// What was found in this frame.
    pub located: Option<Located>,
    /// The identity that it told, if it is an active marker.
    pub hardware: Option<u32>,
    /// Which cameras see it.
    pub visibility: Visibility,
    acceleration: f64,
    /// Time of the last frame in which it was measured (s), and whether that was the last frame.
    seen_s: f64,
    live: bool,
    /// Whether it has just been exchanged with another.
    exchanged: bool,
    hits: u32,
    wide_hits: u32,
    misses: u32,
    log_odds: f64,
    /// Position and covariance after this frame.
    state: (Vector3<f64>, Matrix3<f64>),
}

impl Marker {
    /// A marker from a point that was nobody's, found with `confidence`.
    pub fn born(
        (track, slot): (u32, usize),
        (found, motion): (Located, Motion),
        confidence: f64,
        time_s: f64,
        confirmed: bool,
    ) -> Self {
        let covariance = found.information.try_inverse().unwrap_or_else(Matrix3::identity);
        let speed_std = motion.variance.sqrt();
        Self {
            track,
            slot,
            filter: Filter::moving(found.point, &covariance, motion.velocity, speed_std, FIRST_ACCELERATION),
            confirmed,
            prior: Prior {
                point: found.point,
                covariance,
                push: 0.0,
                hidden: false,
                hardware: None,
                must_tell: false,
                motion,
            },
            hardware: None,
            visibility: Visibility::default(),
            acceleration: FIRST_ACCELERATION,
            seen_s: time_s,
            live: true,
            exchanged: false,
            hits: 1,
            wide_hits: u32::from(found.rays >= 3),
            misses: 0,
            log_odds: (confidence / (1.0 - confidence).max(1e-9)).ln().min(SUREST),
            state: (found.point, covariance),
            located: Some(found),
        }
    }

    /// Whether it was measured in the last frame.
    pub fn is_live(&self) -> bool {
        self.live
    }

    /// Whether its place in this frame is known: by two dots, merged ones counted.
    pub fn is_found(&self) -> bool {
        self.located.as_ref().is_some_and(|l| l.rays >= 2)
    }

    /// Whether it is measured in this frame: by two dots of its own.
    pub fn is_measured(&self) -> bool {
        self.located.as_ref().is_some_and(|l| l.own >= 2)
    }

    /// Number of dots of its own in this frame.
    pub fn own_dots(&self) -> usize {
        self.located.as_ref().map_or(0, |l| l.own)
    }

    /// Position and covariance after this frame.
    pub fn state(&self) -> &(Vector3<f64>, Matrix3<f64>) {
        &self.state
    }

    /// Where it was found.
    pub fn found_at(&self) -> Option<Vector3<f64>> {
        self.is_found().then(|| self.located.as_ref().map(|l| l.point)).flatten()
    }

    /// Time update.
    pub fn predict(&mut self, step: &Step, time_s: f64) {
        self.filter.predict(step, self.acceleration);
        let push = (PUSH * self.acceleration).clamp(LEAST_PUSH, LARGEST_PUSH);
        self.prior = Prior {
            point: self.filter.position,
            covariance: *self.filter.covariance(),
            push: push * push * step.jump_variance(),
            hidden: !self.live,
            hardware: self.hardware,
            must_tell: self.hardware.is_some() && time_s - self.seen_s > SILENT_S,
            motion: self.filter.motion(),
        };
        self.located = None;
    }

    /// Where it was after the last frame, until this one is settled.
    pub fn last_point(&self) -> Vector3<f64> {
        self.state.0
    }

    /// Where its own motion alone takes it.
    pub fn own_prediction(&self) -> Carried {
        Carried { point: self.filter.position, covariance: *self.filter.covariance() }
    }

    /// A better prediction of a hidden marker, with its neighbours.
    pub fn carry(&mut self, carried: &Carried) {
        self.prior = Prior {
            point: carried.point,
            covariance: carried.covariance,
            push: carried.covariance.trace(),
            hidden: true,
            hardware: self.hardware,
            must_tell: self.prior.must_tell,
            motion: self.filter.motion(),
        };
    }

    /// What is known after this frame's first look, as a prediction for a second.
    pub fn posterior_prior(&self) -> Prior {
        let Some(located) = &self.located else { return self.prior };
        let information = self.prior.wide().try_inverse().map(|i| i + located.information);
        let covariance = information.and_then(Matrix3::try_inverse).unwrap_or(self.prior.covariance);
        Prior { point: located.point, covariance, push: 0.0, hidden: false, ..self.prior }
    }

    /// Whether one of its dots is of a camera.
    pub fn has_dot_of(&self, camera: usize, frame: &Frame) -> bool {
        self.located.as_ref().is_some_and(|l| l.dots.iter().any(|&d| frame.sight(d).camera == camera))
    }

    /// The same for every camera, one after the other.
    pub fn has_dots_of(&self, frame: &Frame, has: &mut [bool]) {
        self.located.iter().flat_map(|l| &l.dots).for_each(|&d| has[frame.sight(d).camera] = true);
    }

    /// Takes possession of its dots.
    pub fn claim(&self, free: &mut [bool]) {
        self.mark(free, false);
    }

    /// Gives its dots back.
    pub fn release(&mut self, free: &mut [bool]) {
        self.mark(free, true);
        self.located = None;
    }

    /// Learns its identity where two of its own dots tell the same, and none another.
    pub fn hear(&mut self, frame: &Frame) {
        let own = self.located.iter().flat_map(|l| &l.dots).filter(|&&d| !frame.is_lent(d));
        let told: Vec<u32> = own.filter_map(|&d| frame.dots[d as usize].hardware).collect();
        if told.len() >= TELLERS && told.iter().all(|t| *t == told[0]) {
            self.hardware = Some(told[0]);
        }
    }

    /// Is nobody any more, and forgotten after this frame.
    pub fn give_up(&mut self) {
        self.misses = u32::MAX;
    }

    /// Becomes the marker that told the same identity before and is lost.
    pub fn inherit(&mut self, lost: &Self) {
        (self.track, self.slot, self.confirmed) = (lost.track, lost.slot, true);
        self.log_odds = self.log_odds.max(lost.log_odds);
    }

    /// Marks its own dots; loans lie beyond the frame's.
    fn mark(&self, free: &mut [bool], as_free: bool) {
        for &dot in self.located.iter().flat_map(|l| &l.dots) {
            if let Some(place) = free.get_mut(dot as usize) {
                *place = as_free;
            }
        }
    }

    /// Found again at a point, wherever it was expected.
    pub fn refind(&mut self, found: Located) {
        let away = (found.point - self.prior.point).norm();
        // The prediction was wrong by this much: it counts for no more than that.
        self.prior.push = self.prior.push.max(away * away);
        self.located = Some(found);
    }

    /// Takes what another marker was taken for: its own motion was wrong and starts anew.
    pub fn take_over(&mut self, found: Option<Located>) {
        if let Some(found) = found {
            self.refind(found);
            self.exchanged = true;
        }
    }

    /// Measurement update; `drift` tells how the marker's neighbours move, where that is needed.
    pub fn settle(&mut self, time_s: f64, drift: impl FnOnce() -> Option<Vector3<f64>>) {
        let Some(located) = &self.located else {
            self.state = (self.prior.point, self.prior.covariance);
            self.missed(drift);
            return;
        };
        let information = located.information;
        let pull = located.pull_from(&self.prior.point);
        if located.rays < 2 {
            self.state = posterior(&self.prior.point, &self.prior.covariance, &information, &pull)
                .unwrap_or((self.prior.point, self.prior.covariance));
            self.settle_unmeasured(&information);
            self.missed(drift);
            return;
        }
        let rays = located.rays;
        let pull_on_filter = located.pull_from(&self.filter.position);
        let hidden_s = time_s - self.seen_s;
        let squared = squared_innovation(self.filter.covariance(), &information, &pull_on_filter);
        let astray = !self.live && (hidden_s > STALE_S || squared > PUSHED);
        if astray || std::mem::take(&mut self.exchanged) {
            self.restart(&information, &pull, drift());
        } else {
            self.settle_live(&information, &pull_on_filter, squared);
        }
        (self.live, self.seen_s, self.misses) = (true, time_s, 0);
        self.hits += 1;
        self.wide_hits += u32::from(rays >= 3);
        self.log_odds = (self.log_odds + if rays >= 3 { SURER } else { 0.5 * SURER }).min(SUREST);
        self.confirmed |= self.wide_hits >= HITS || self.hits >= HITS_OF_PAIRS;
    }

    fn missed(&mut self, drift: impl FnOnce() -> Option<Vector3<f64>>) {
        self.live = false;
        self.misses += 1;
        if self.filter.covariance().trace() > LOST_SPREAD * LOST_SPREAD {
            // Its own motion is forgotten; from here on it moves with its neighbours.
            let (point, covariance) = self.state;
            let wide = covariance * 2.0 + Matrix3::identity() * (0.1 * LOST_SPREAD).powi(2);
            let wide = wide * (LARGEST_SPREAD.powi(2) / wide.trace()).min(1.0);
            let velocity = drift().unwrap_or_default();
            self.filter = Filter::moving(point, &wide, velocity, SPEED_AMONG_NEIGHBOURS, FIRST_ACCELERATION);
        }
    }

    /// One ray moves the filter across its direction; a merged dot a little.
    fn settle_unmeasured(&mut self, information: &Matrix3<f64>) {
        let Some(located) = &self.located else { return };
        let pull = located.pull_from(&self.filter.position);
        if let Some((point, covariance)) =
            posterior(&self.filter.position, self.filter.covariance(), information, &pull)
        {
            self.filter.update(point, &covariance);
        }
    }

    /// The usual update of a marker that is followed without a break.
    fn settle_live(&mut self, information: &Matrix3<f64>, pull: &Vector3<f64>, squared: f64) {
        let Some(located) = &self.located else { return };
        if squared > PUSHED {
            let away = (located.point - self.filter.position).norm();
            self.filter.admit_push(away, self.acceleration);
        }
        if self.live {
            let excess = (squared / 3.0).min(LARGEST_RATIO) - 1.0;
            let rate = if excess > 0.0 { RISE } else { FALL };
            let variance = self.acceleration.powi(2) * (1.0 + rate * excess);
            self.acceleration = variance.sqrt().clamp(ACCELERATION_RANGE[0], ACCELERATION_RANGE[1]);
        }
        if let Some((point, covariance)) = posterior(&self.filter.position, self.filter.covariance(), information, pull)
        {
            self.filter.update(point, &covariance);
            self.state = (point, covariance);
        }
        // What is given out leans on the rays; the prediction, with room for a push, only helps where they are few.
        let pull = located.pull_from(&self.prior.point);
        if let Some(state) = posterior(&self.prior.point, &self.prior.wide(), information, &pull) {
            self.state = state;
        }
    }

    /// Starts the filter anew after a long absence.
    fn restart(&mut self, information: &Matrix3<f64>, pull: &Vector3<f64>, drift: Option<Vector3<f64>>) {
        let wide = self.prior.wide();
        let Some((point, covariance)) = posterior(&self.prior.point, &wide, information, pull) else { return };
        self.acceleration = self.acceleration.max(FIRST_ACCELERATION);
        self.filter = match drift {
            Some(v) => Filter::moving(point, &covariance, v, SPEED_AMONG_NEIGHBOURS, self.acceleration),
            None => Filter::new(point, &covariance, self.acceleration),
        };
        self.state = (point, covariance);
    }

    /// Whether it is to be forgotten. Among active markers, one that has not told who it is comes back as another.
    pub fn is_gone(&self, time_s: f64, memory_s: f64, among_active: bool) -> bool {
        let memory_s = if among_active && self.hardware.is_none() { SILENT_S } else { memory_s };
        if self.confirmed { time_s - self.seen_s > memory_s } else { self.misses >= MISSES }
    }

    /// What the dynamic model learns from it.
    pub fn seen(&self) -> Seen {
        Seen { slot: self.slot, point: self.state.0, covariance: self.state.1, trusted: self.hits > 2 }
    }

    /// What is given out for this frame.
    pub fn sample(&self) -> Sample {
        let dots: &[u32] = self.located.as_ref().map_or(&[], |l| &l.dots);
        let kind = if self.is_measured() { Kind::Measured } else { Kind::Predicted };
        let confidence = 1.0 / (1.0 + (-self.log_odds).exp());
        let sample = Sample::new(self.track, self.state, kind, dots, confidence);
        Sample { confirmed: self.confirmed, hardware: self.hardware, velocity: self.prior.motion.velocity, ..sample }
    }
}

/// Innovation squared in its own covariance: pullᵀ (M P M + M)⁻¹ pull. Rays that hardly cross leave M almost singular; then
/// the direction about which they say nothing must not count.
fn squared_innovation(covariance: &Matrix3<f64>, information: &Matrix3<f64>, pull: &Vector3<f64>) -> f64 {
    let least = Matrix3::identity() * (1e-9 * information.trace());
    let spread = information * covariance * information + information + least;
    spread.cholesky().map_or(0.0, |c| pull.dot(&c.solve(pull)))
}
