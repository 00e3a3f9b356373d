//! What the place of one of two near markers tells of which of them it is, while the other is hidden.
//!
//! Its place in the frame of their neighbours is nearer to where the one belongs or to where the other does. How far that is
//! to be believed is learned from the frames that show both, in which the vector between them tells who is who: how often
//! a place alone would have been taken for the other's, and for how long places are off alike (a first-order Gauss–Markov
//! process, Gelb 1974, §3.6). What is off alike is said only once.

use nalgebra::Vector3;

/// Steps between frames from which it is learned how places are off alike.
const LEAST: usize = 20;

/// How a place in a frame that shows both is off.
#[derive(Clone, Copy)]
pub(super) struct Off {
    /// Time of the frame (s).
    time_s: f64,
    /// How far it is off towards the other's place, and how far away that is (m).
    towards_m: f64,
    apart_m: f64,
    /// Evidence that it is the other's (nats), as the place alone gives it.
    nats: f64,
}

impl Off {
    /// Of a place, by where its own and the other one's are expected (m).
    pub(super) fn of(time_s: f64, place: &Vector3<f64>, [own, other]: [&Vector3<f64>; 2], nats: f64) -> Self {
        let between = other - own;
        let apart_m = between.norm().max(1e-9);
        Self { time_s, towards_m: (place - own).dot(&between) / apart_m, apart_m, nats }
    }
}

/// How far a place alone is to be believed.
#[derive(Clone, Copy)]
pub(super) struct Belief {
    /// What it says at most (nats).
    most: f64,
    /// For how long places are off alike (s).
    length_s: f64,
}

impl Belief {
    /// From what the places of either marker are off, in order of time; `step_s`: the usual time between two frames;
    /// `least_m`: an error that any place has and that is another one in each frame. `None` where they are too few.
    pub(super) fn learned(off: [&[Off]; 2], step_s: f64, least_m: f64) -> Option<Self> {
        let rho = correlation(off, 1.5 * step_s, least_m)?;
        let length_s = if rho > 0.0 { -step_s / rho.min(1.0 - 1e-9).ln() } else { 0.0 };
        let count = |wrong: bool| off.into_iter().flatten().filter(|o| !wrong || o.nats > 0.0).count() as f64;
        let [all, wrong] = [false, true].map(|w| 1.0 + count(w) * new_after(step_s, length_s));
        Some(Self { most: (all / wrong).ln(), length_s })
    }

    /// What a place says (nats), of the evidence that it gives, some time (s) after that marker was alone the last time.
    pub(super) fn bounded(&self, nats: f64, after_s: f64) -> f64 {
        nats.clamp(-self.most, self.most) * new_after(after_s, self.length_s)
    }
}

/// The part of what a place says that another one, some time before, has not said: with a correlation ρ, n places in a row
/// are worth n (1 − ρ) / (1 + ρ).
fn new_after(after_s: f64, length_s: f64) -> f64 {
    let rho = (-after_s / length_s.max(1e-9)).exp();
    (1.0 - rho) / (1.0 + rho)
}

/// Correlation of what places are off from one frame to the next. Those that are nearer to the other's place are that one's.
fn correlation(off: [&[Off]; 2], longest_s: f64, least_m: f64) -> Option<f64> {
    let (mut product, mut squares, mut count) = (0.0, 0.0, 0);
    for own in off {
        let right: Vec<&Off> = own.iter().filter(|o| o.towards_m.abs() < 0.5 * o.apart_m).collect();
        for pair in right.windows(2).filter(|w| w[1].time_s - w[0].time_s < longest_s) {
            product += pair[0].towards_m * pair[1].towards_m;
            squares += 0.5 * (pair[0].towards_m.powi(2) + pair[1].towards_m.powi(2)) + least_m * least_m;
            count += 1;
        }
    }
    (count >= LEAST).then(|| product / squares.max(1e-300))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::random::Random;
    use approx::assert_relative_eq;

    const STEP_S: f64 = 0.01;

    /// Places that are off with a correlation from frame to frame; every so many frames one looks like the other's.
    fn off(frames: usize, rho: f64, wrong: usize) -> Vec<Off> {
        let mut random = Random::new(3, 0);
        let (own, other) = (Vector3::zeros(), Vector3::new(0.04, 0.0, 0.0));
        let mut x = 0.0;
        let one = |f: usize| {
            x = rho * x + (1.0 - rho * rho).sqrt() * random.normal();
            let nats = if f.is_multiple_of(wrong) { 2.0 } else { -6.0 };
            Off::of(STEP_S * f as f64, &Vector3::new(0.003 * x, 0.01, 0.0), [&own, &other], nats)
        };
        (1..=frames).map(one).collect()
    }

    #[test]
    fn a_place_is_believed_as_often_as_it_is_right() {
        let never = Belief::learned([&off(2000, 0.0, usize::MAX), &off(2000, 0.0, usize::MAX)], STEP_S, 0.0).unwrap();
        assert_relative_eq!(never.bounded(100.0, 1.0), 4001_f64.ln(), max_relative = 0.02);
        let often = Belief::learned([&off(2000, 0.0, 10), &[]], STEP_S, 0.0).unwrap();
        assert_relative_eq!(often.bounded(-100.0, 1.0), -(2001.0_f64 / 201.0).ln(), max_relative = 0.02);
        assert!(often.bounded(0.5, 1.0) < 0.5 + 1e-9 && often.bounded(0.5, 1.0) > 0.49);
    }

    #[test]
    fn what_is_off_alike_is_said_once() {
        let slow = Belief::learned([&off(20_000, 0.9, usize::MAX), &[]], STEP_S, 0.0).unwrap();
        assert_relative_eq!(slow.length_s, -STEP_S / 0.9_f64.ln(), max_relative = 0.1);
        assert_relative_eq!(slow.most, (20_000.0_f64 * 0.1 / 1.9).ln(), max_relative = 0.02);
        // A hundred frames in a row are worth five.
        assert_relative_eq!(100.0 * slow.bounded(1.0, STEP_S), 5.3, max_relative = 0.1);
        assert!(slow.bounded(1.0, f64::INFINITY) > 0.999);
        // They are off by 3 mm; beside an error of 30 mm that hardly counts.
        let beside = Belief::learned([&off(20_000, 0.9, usize::MAX), &[]], STEP_S, 0.03).unwrap();
        assert!(beside.bounded(1.0, STEP_S) > 0.97);
    }

    #[test]
    fn from_few_frames_nothing_is_learned() {
        assert!(Belief::learned([&off(LEAST, 0.5, usize::MAX), &[]], STEP_S, 0.0).is_none());
        // Every second frame is none in a row.
        let some: Vec<Off> = off(200, 0.5, usize::MAX).into_iter().step_by(2).collect();
        assert!(Belief::learned([&some, &[]], STEP_S, 0.0).is_none());
    }
}
