//! The vector between two markers of one part through time: as long as ever, turned a little from frame to frame.

use super::super::super::filter::fuse;
use nalgebra::{Matrix3, Vector3};

/// Time over which turning is learned (s), and how much faster than its median it may be (variances).
const LAG_S: f64 = 0.05;
const FASTER: f64 = 4.0;
/// What is known of a median of squared distances in three dimensions (variances).
pub const MEDIAN: f64 = 2.366;
/// Slowest and fastest turning (radians in a second, as a random walk).
const TURNING: [f64; 2] = [0.3, 10.0];
/// Least spread of the length (m), and as a part of it.
const LEAST_SPREAD_M: f64 = 5e-4;
/// Nearly all vectors' lengths differ by less (median differences: 4 standard deviations).
const USUAL: f64 = 6.0;

/// What the vector does in general.
#[derive(Clone, Copy, Debug)]
pub struct Habit {
    /// Its length and how much that differs (m).
    pub length_m: f64,
    pub spread_m: f64,
    /// Variance that a second adds (m² per axis).
    pub turning: f64,
}

impl Habit {
    /// From vectors at times (s), whichever way they point; `None` where there are too few.
    pub fn learned(known: &[(f64, Vector3<f64>)], least: usize) -> Option<Self> {
        if known.len() < least {
            return None;
        }
        let length_m = median(known.iter().map(|(_, v)| v.norm()).collect())?;
        let off = median(known.iter().map(|(_, v)| (v.norm() - length_m).abs()).collect())?;
        let change = |lag_s: f64| {
            let pairs = known.iter().enumerate().filter_map(|(k, (time_s, v))| {
                let later = k + 1 + known[k + 1..].partition_point(|(t, _)| *t < time_s + lag_s * 0.999);
                let (then_s, w) = known.get(later).filter(|(t, _)| *t <= time_s + 1.5 * lag_s)?;
                Some(((w - v).norm_squared().min((w + v).norm_squared()), then_s - time_s))
            });
            let (squared, lags): (Vec<f64>, Vec<f64>) = pairs.unzip();
            Some((median(squared)? / MEDIAN, median(lags)?))
        };
        let step_s = median(known.windows(2).map(|w| w[1].0 - w[0].0).collect())?;
        let range = TURNING.map(|t| (t * length_m).powi(2));
        let turning = match (change(step_s), change(LAG_S.max(2.0 * step_s))) {
            (Some((noise, a)), Some((more, b))) if b > a => FASTER * (more - noise).max(0.0) / (b - a),
            _ => range[1],
        };
        let spread_m = off.max(LEAST_SPREAD_M);
        Some(Self { length_m, spread_m, turning: turning.clamp(range[0], range[1]) })
    }

    /// Whether a vector is about as long as it should be.
    pub fn fits(&self, vector: &Vector3<f64>) -> bool {
        (vector.norm() - self.length_m).abs() < USUAL * self.spread_m
    }

    /// Variance of a vector that points this way, roughly (m²).
    pub fn any_way(&self) -> f64 {
        (self.length_m / 3.0).powi(2)
    }

    /// How long the vector is known well enough to tell which way it points (s).
    pub fn holds_s(&self) -> f64 {
        (0.5 * self.length_m).powi(2) / self.turning
    }
}

/// The vector at a time.
#[derive(Clone, Copy, Debug)]
pub struct Between {
    /// From the one to the other (m).
    pub vector: Vector3<f64>,
    /// Its covariance (m²).
    pub covariance: Matrix3<f64>,
}

impl Between {
    /// After some time: less well known, and as long as ever.
    pub fn after(&self, dt_s: f64, habit: &Habit) -> Self {
        let covariance = self.covariance + Matrix3::identity() * (habit.turning * dt_s.abs());
        let length = self.vector.norm().max(1e-6);
        let along = self.vector / length;
        let gain = covariance * along / (along.dot(&(covariance * along)) + habit.spread_m.powi(2));
        let vector = self.vector + gain * (habit.length_m - length);
        let covariance = covariance - gain * (covariance * along).transpose();
        Self { vector, covariance: 0.5 * (covariance + covariance.transpose()) }
    }

    /// What both sides in time know together.
    pub fn with(&self, other: &Self) -> Self {
        fuse((&self.vector, &self.covariance), (&other.vector, &other.covariance))
            .map_or(*self, |(vector, covariance)| Self { vector, covariance })
    }
}

/// The middle one; `None` of none.
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn turning(rate: f64) -> Vec<(f64, Vector3<f64>)> {
        let at = |k: usize| {
            let (sin, cos) = (rate * k as f64 / 100.0).sin_cos();
            // Which is which is not known: every other one points the other way.
            let sign = [1.0, -1.0][k % 2];
            (k as f64 / 100.0, sign * Vector3::new(0.01 * cos, 0.01 * sin, 0.0))
        };
        (0..300).map(at).collect()
    }

    #[test]
    fn length_and_turning_are_learned_whichever_way_the_vectors_point() {
        let slow = Habit::learned(&turning(1.0), 20).unwrap();
        let fast = Habit::learned(&turning(6.0), 20).unwrap();
        assert!((slow.length_m - 0.01).abs() < 1e-6 && (slow.spread_m - LEAST_SPREAD_M).abs() < 1e-6);
        assert!(fast.turning > 4.0 * slow.turning && fast.holds_s() < slow.holds_s());
        assert!(Habit::learned(&turning(1.0)[..10], 20).is_none());
    }

    #[test]
    fn a_vector_gets_as_long_as_ever_and_less_well_known() {
        let habit = Habit::learned(&turning(2.0), 20).unwrap();
        let short = Between { vector: Vector3::new(0.007, 0.0, 0.0), covariance: Matrix3::identity() * 4e-6 };
        let later = short.after(0.05, &habit);
        assert!((later.vector.norm() - 0.01).abs() < 1e-3);
        assert!(later.covariance[(1, 1)] > short.covariance[(1, 1)]);
        assert!(later.covariance[(0, 0)] < later.covariance[(1, 1)], "its length is known");
    }
}
