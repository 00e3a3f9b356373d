//! Time of the frames: counted by number and rate, or stated.

use super::filter::Step;
use thiserror::Error;

/// When a frame was taken. What is missing follows from the frame before.
#[derive(Clone, Copy, Debug, Default)]
pub struct Moment {
    /// Frame number; one more than the last if missing.
    pub frame: Option<i64>,
    /// Time (s); from the frame number and the rate if missing.
    pub time_s: Option<f64>,
}

/// Why a frame has no place in time.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum TimeError {
    /// A rate that is no rate.
    #[error("a frame rate of {0} Hz: state a rate above 0")]
    Rate(f64),
    /// A frame number or a time that does not come after the last one.
    #[error(
        "frame {frame}: its time {time_s} s is not after the last frame's {last_s} s; frames must come in order of time"
    )]
    Backwards {
        /// The frame.
        frame: i64,
        /// Its time (s).
        time_s: f64,
        /// The time of the frame before (s).
        last_s: f64,
    },
}

/// The tracker's clock.
#[derive(Clone, Debug)]
pub struct Clock {
    rate_hz: f64,
    /// Number and time of the first frame: time counts from there.
    first: Option<(i64, f64)>,
    /// Number of the present frame.
    pub frame: i64,
    /// Time of the present frame (s).
    pub time_s: f64,
}

impl Clock {
    /// A clock for a frame rate.
    pub fn new(rate_hz: f64) -> Result<Self, TimeError> {
        if rate_hz > 0.0 && rate_hz.is_finite() {
            Ok(Self { rate_hz, first: None, frame: -1, time_s: 0.0 })
        } else {
            Err(TimeError::Rate(rate_hz))
        }
    }

    /// Time between frames (s).
    pub fn interval_s(&self) -> f64 {
        1.0 / self.rate_hz
    }

    /// Moves to the next frame.
    pub fn advance(&mut self, moment: Moment) -> Result<Step, TimeError> {
        let frame = moment.frame.unwrap_or(self.frame + 1);
        let Some((first, start_s)) = self.first else {
            let time_s = moment.time_s.unwrap_or(frame as f64 / self.rate_hz);
            (self.first, self.frame, self.time_s) = (Some((frame, time_s)), frame, time_s);
            return Ok(Step::new(1.0 / self.rate_hz));
        };
        let time_s = moment.time_s.unwrap_or(start_s + (frame - first) as f64 / self.rate_hz);
        let dt_s = time_s - self.time_s;
        if !(dt_s > 0.0 && dt_s.is_finite()) {
            return Err(TimeError::Backwards { frame, time_s, last_s: self.time_s });
        }
        (self.frame, self.time_s) = (frame, time_s);
        // A frame counted on time is a frame of the same length every time, to the last bit.
        let frames = dt_s * self.rate_hz;
        let whole = frames.round();
        let regular = whole >= 1.0 && (frames - whole).abs() < 1e-6 * whole;
        Ok(Step::new(if regular { whole / self.rate_hz } else { dt_s }))
    }
}
