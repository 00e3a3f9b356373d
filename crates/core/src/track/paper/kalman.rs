//! The constant-velocity Kalman filter as printed (Lee et al. 2000, §4.1, equations 9–16): unit time steps, whatever the
//! frame rate, and constant noise. All axes share one 2 × 2 covariance, because F, Q and R treat them alike.

use nalgebra::{Matrix2, Vector2, Vector3};

/// Spread of a frame's change of velocity (m per frame) relative to acceleration times squared frame time.
const ACCELERATION: f64 = 20.0;
/// Noise of a measured position (m).
const MEASUREMENT: f64 = 0.002;

/// State s = [p v] (equation 9) with its covariance per axis.
#[derive(Clone, Debug)]
pub struct Kalman {
    /// Position p (m).
    pub position: Vector3<f64>,
    /// Velocity v (m per frame).
    pub velocity: Vector3<f64>,
    covariance: Matrix2<f64>,
    /// Q of one axis.
    noise: Matrix2<f64>,
}

impl Kalman {
    /// A marker seen for the first time, standing still as far as is known.
    pub fn new(position: Vector3<f64>, rate_hz: f64) -> Self {
        let change = ACCELERATION / (rate_hz * rate_hz);
        let into = Vector2::new(0.5, 1.0) * change;
        let covariance = Matrix2::new(MEASUREMENT.powi(2), 0.0, 0.0, (1.0 / rate_hz).powi(2));
        Self { position, velocity: Vector3::zeros(), covariance, noise: into * into.transpose() }
    }

    /// Time update: equations 10, 11 and 13.
    pub fn predict(&mut self) {
        let step = Matrix2::new(1.0, 1.0, 0.0, 1.0);
        self.position += self.velocity;
        self.covariance = step * self.covariance * step.transpose() + self.noise;
    }

    /// Variance of the position per axis (m²).
    pub fn variance(&self) -> f64 {
        self.covariance[(0, 0)]
    }

    /// Measurement update: equations 14–16.
    pub fn update(&mut self, measured: &Vector3<f64>) {
        let gain = self.covariance.column(0) / (self.variance() + MEASUREMENT.powi(2)); // eq 14
        let innovation = measured - self.position;
        self.position += innovation * gain[0]; // eq 15
        self.velocity += innovation * gain[1];
        let row = self.covariance.row(0).into_owned();
        self.covariance -= gain * row; // eq 16
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_marker_at_constant_velocity_is_predicted_exactly_in_the_end() {
        let step = Vector3::new(0.01, -0.004, 0.002);
        let mut kalman = Kalman::new(Vector3::zeros(), 100.0);
        for k in 1..200 {
            kalman.predict();
            kalman.update(&(step * f64::from(k)));
        }
        kalman.predict();
        assert!((kalman.position - step * 200.0).norm() < 1e-6);
    }
}
