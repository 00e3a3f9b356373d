//! The Kalman filter of one marker (Lee et al. 2000, §4.1, equations 9–16), with true time steps.
//!
//! State: position, velocity, acceleration (the paper's equation 9 with one more derivative); the acceleration forgets
//! itself with a time constant (Singer 1970, "Estimating optimal tracking filter performance for manned maneuvering
//! targets"). All axes share one dynamic, so the 9×9 covariance is six 3×3 blocks and a prediction (equations 10–13)
//! only adds them up. Measurements enter as an improved position with its covariance (equations 14–16 in information
//! form): so rays, triangulated points and points of other systems are all the same to the filter.

use super::flow::Motion;
use nalgebra::{Matrix3, Vector3};

/// Time constant of a limb's acceleration (s): how long a push lasts.
pub const ACCELERATION_TIME_S: f64 = 0.15;
/// Spread of the speed of a marker that was pushed (m/s), at least.
const PUSHED_SPEED: f64 = 3.0;

/// What a time step does to any filter.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// Length (s).
    pub dt_s: f64,
    /// How much of acceleration goes into position, velocity, acceleration.
    acceleration_into: [f64; 3],
    /// Process noise of unit acceleration variance: blocks pp, pv, pa, vv, va, aa.
    noise: [f64; 6],
}

impl Step {
    /// A step of `dt_s` > 0 seconds.
    pub fn new(dt_s: f64) -> Self {
        let tau = ACCELERATION_TIME_S;
        let x = dt_s / tau;
        let e = (-x).exp();
        let acceleration_into = [tau * tau * (x - 1.0 + e), tau * (1.0 - e), e];
        Self { dt_s, acceleration_into, noise: singer_noise(x, tau) }
    }

    /// Variance of the position that one unit of unforeseen acceleration variance makes within the step (m² per (m/s²)²).
    pub fn jump_variance(&self) -> f64 {
        0.25 * self.dt_s.powi(4)
    }
}

/// Singer 1970, equation for Q, divided by the variance of the acceleration. Below x = 0.02 by its series.
fn singer_noise(x: f64, tau: f64) -> [f64; 6] {
    let (e, e2) = ((-x).exp(), (-2.0 * x).exp());
    let [t2, t3, t4] = [tau.powi(2), tau.powi(3), tau.powi(4)];
    if x < 0.02 {
        return [
            t4 * x.powi(5) / 10.0,
            t3 * x.powi(4) / 4.0,
            t2 * x.powi(3) / 3.0,
            t2 * 2.0 * x.powi(3) / 3.0,
            tau * x * x,
            2.0 * x,
        ];
    }
    [
        t4 * (1.0 - e2 + 2.0 * x + 2.0 * x.powi(3) / 3.0 - 2.0 * x * x - 4.0 * x * e),
        t3 * (e2 + 1.0 - 2.0 * e + 2.0 * x * e - 2.0 * x + x * x),
        t2 * (1.0 - e2 - 2.0 * x * e),
        t2 * (4.0 * e - 3.0 - e2 + 2.0 * x),
        tau * (e2 + 1.0 - 2.0 * e),
        1.0 - e2,
    ]
}

/// Position, velocity and acceleration with their covariance.
#[derive(Clone, Debug)]
pub struct Filter {
    /// Position (m, world).
    pub position: Vector3<f64>,
    /// Velocity (m/s).
    pub velocity: Vector3<f64>,
    /// Acceleration (m/s²).
    pub acceleration: Vector3<f64>,
    /// Blocks pp, pv, pa, vv, va, aa of the covariance; a block "pv" is the covariance of position with velocity.
    blocks: [Matrix3<f64>; 6],
}

const PP: usize = 0;
const PV: usize = 1;
const PA: usize = 2;
const VV: usize = 3;
const VA: usize = 4;
const AA: usize = 5;

impl Filter {
    /// A marker seen for the first time, nothing known of its motion.
    pub fn new(position: Vector3<f64>, covariance: &Matrix3<f64>, acceleration_std: f64) -> Self {
        let any = Motion::unknown();
        Self::moving(position, covariance, any.velocity, any.variance.sqrt(), acceleration_std)
    }

    /// A marker with a velocity known to some spread.
    pub fn moving(
        position: Vector3<f64>,
        covariance: &Matrix3<f64>,
        velocity: Vector3<f64>,
        speed_std: f64,
        acceleration_std: f64,
    ) -> Self {
        let mut blocks = [Matrix3::zeros(); 6];
        blocks[PP] = *covariance;
        blocks[VV] = Matrix3::identity() * speed_std.powi(2);
        blocks[AA] = Matrix3::identity() * acceleration_std.powi(2);
        Self { position, velocity, acceleration: Vector3::zeros(), blocks }
    }

    /// Velocity with its variance.
    pub fn motion(&self) -> Motion {
        Motion { velocity: self.velocity, variance: self.blocks[VV].trace() / 3.0 }
    }

    /// Covariance of the position (m²).
    pub fn covariance(&self) -> &Matrix3<f64> {
        &self.blocks[PP]
    }

    /// Time update, equations 10–13. `acceleration_std` in m/s².
    pub fn predict(&mut self, step: &Step, acceleration_std: f64) {
        let (t, [c, b, r]) = (step.dt_s, step.acceleration_into);
        self.position += self.velocity * t + self.acceleration * c;
        self.velocity += self.acceleration * b;
        self.acceleration *= r;
        let [pp, pv, pa, vv, va, aa] = self.blocks;
        // Rows of F·P, then columns: F = [1 t c; 0 1 b; 0 0 r] by blocks.
        let vp = pv.transpose();
        let ap = pa.transpose();
        let av = va.transpose();
        let position = [pp + vp * t + ap * c, pv + vv * t + av * c, pa + va * t + aa * c];
        let velocity = [vv + av * b, va + aa * b];
        self.blocks = [
            position[0] + position[1] * t + position[2] * c,
            position[1] + position[2] * b,
            position[2] * r,
            velocity[0] + velocity[1] * b,
            velocity[1] * r,
            aa * (r * r),
        ];
        let variance = acceleration_std * acceleration_std;
        for (block, noise) in self.blocks.iter_mut().zip(step.noise) {
            for i in 0..3 {
                block[(i, i)] += variance * noise;
            }
        }
        // What rounding adds to the difference of a block and its transpose would grow from update to update.
        for block in [PP, VV, AA] {
            self.blocks[block] = 0.5 * (self.blocks[block] + self.blocks[block].transpose());
        }
    }

    /// Admits that the marker was pushed: where it is now is open by a distance (m), how fast it goes by its speed's spread.
    /// Nothing is concluded from the jump, which may as well be another marker's.
    pub fn admit_push(&mut self, away: f64, acceleration_std: f64) {
        let covariance = self.blocks[PP] + Matrix3::identity() * (away * away);
        let speed_std = (self.blocks[VV].trace() / 3.0).sqrt().max(PUSHED_SPEED);
        *self = Self::moving(self.position, &covariance, self.velocity, speed_std, acceleration_std);
    }

    /// Measurement update, equations 14–16: the position and its covariance after a measurement; the rest follows.
    /// Nothing changes where the prior covariance is singular.
    pub fn update(&mut self, position: Vector3<f64>, covariance: &Matrix3<f64>) {
        let Some(prior_information) = self.blocks[PP].try_inverse() else { return };
        let gain_v = self.blocks[PV].transpose() * prior_information;
        let gain_a = self.blocks[PA].transpose() * prior_information;
        let moved = position - self.position;
        let learned = self.blocks[PP] - covariance;
        self.position = position;
        self.velocity += gain_v * moved;
        self.acceleration += gain_a * moved;
        self.blocks[VV] -= gain_v * learned * gain_v.transpose();
        self.blocks[VA] -= gain_v * learned * gain_a.transpose();
        self.blocks[AA] -= gain_a * learned * gain_a.transpose();
        self.blocks[PV] = covariance * gain_v.transpose();
        self.blocks[PA] = covariance * gain_a.transpose();
        self.blocks[PP] = *covariance;
    }
}

/// The two estimates of one position put together by their covariances; `None` if a covariance is singular.
pub fn fuse(
    a: (&Vector3<f64>, &Matrix3<f64>),
    b: (&Vector3<f64>, &Matrix3<f64>),
) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    let gain = a.1 * (a.1 + b.1).try_inverse()?;
    let covariance = a.1 - gain * a.1;
    Some((a.0 + gain * (b.0 - a.0), 0.5 * (covariance + covariance.transpose())))
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use nalgebra::{SMatrix, SVector};

    type M9 = SMatrix<f64, 9, 9>;

    fn full(filter: &Filter) -> M9 {
        let mut p = M9::zeros();
        for (block, (i, j)) in filter.blocks.iter().zip([(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]) {
            p.fixed_view_mut::<3, 3>(3 * i, 3 * j).copy_from(block);
            p.fixed_view_mut::<3, 3>(3 * j, 3 * i).copy_from(&block.transpose());
        }
        p
    }

    fn state(filter: &Filter) -> SVector<f64, 9> {
        let mut s = SVector::<f64, 9>::zeros();
        s.fixed_rows_mut::<3>(0).copy_from(&filter.position);
        s.fixed_rows_mut::<3>(3).copy_from(&filter.velocity);
        s.fixed_rows_mut::<3>(6).copy_from(&filter.acceleration);
        s
    }

    /// The textbook filter with full matrices is the oracle.
    #[test]
    fn the_blocks_equal_the_full_kalman_filter() {
        let step = Step::new(0.02);
        let mut filter = Filter::new(Vector3::new(1.0, 2.0, 3.0), &(Matrix3::identity() * 1e-4), 20.0);
        let (mut s, mut p) = (state(&filter), full(&filter));
        let [c, b, r] = step.acceleration_into;
        let mut f = M9::identity();
        let mut q = M9::zeros();
        for i in 0..3 {
            (f[(i, 3 + i)], f[(i, 6 + i)], f[(3 + i, 6 + i)], f[(6 + i, 6 + i)]) = (step.dt_s, c, b, r);
        }
        for (noise, (i, j)) in step.noise.iter().zip([(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]) {
            for k in 0..3 {
                q[(3 * i + k, 3 * j + k)] = 400.0 * noise;
                q[(3 * j + k, 3 * i + k)] = 400.0 * noise;
            }
        }
        let h = SMatrix::<f64, 3, 9>::from_fn(|i, j| f64::from(u8::from(i == j)));
        let noise = Matrix3::new(2e-6, 1e-6, 0.0, 1e-6, 3e-6, 0.0, 0.0, 0.0, 5e-5);
        for k in 0..20 {
            let z = Vector3::new(1.0 + 0.03 * f64::from(k), 2.0 - 0.02 * f64::from(k * k) * 0.02, 3.0);
            filter.predict(&step, 20.0);
            let (x, pp) = (filter.position, *filter.covariance());
            let gain = pp * (pp + noise).try_inverse().unwrap();
            filter.update(x + gain * (z - x), &(pp - gain * pp));
            (s, p) = (f * s, f * p * f.transpose() + q); // eq 10, 13
            let k = p * h.transpose() * (h * p * h.transpose() + noise).try_inverse().unwrap(); // eq 14
            s += k * (z - h * s); // eq 15
            p = (M9::identity() - k * h) * p; // eq 16
            assert_relative_eq!(state(&filter), s, epsilon = 1e-9);
            assert_relative_eq!(full(&filter), p, epsilon = 1e-9, max_relative = 1e-7);
        }
    }

    /// Left to itself, the difference of the covariance and its transpose grows wherever one ray follows a marker for long.
    #[test]
    fn the_covariance_stays_symmetric() {
        let mut filter = Filter::new(Vector3::zeros(), &(Matrix3::identity() * 1e-4), 20.0);
        let step = Step::new(0.01);
        let mut worst: f64 = 0.0;
        for k in 0..20_000 {
            filter.predict(&step, if k % 40 < 20 { 60.0 } else { 5.0 });
            let prior = *filter.covariance();
            worst = worst.max((prior - prior.transpose()).norm() / prior.norm());
            // One camera sees it across its ray only, and that from another side by and by; then two do.
            let ray = Vector3::new((1e-3 * f64::from(k)).sin(), (1e-3 * f64::from(k)).cos(), 0.3).normalize();
            let along = if k % 25 < 20 { 0.0 } else { 1e7 };
            let information = (Matrix3::identity() - ray * ray.transpose()) * 1e7 + ray * ray.transpose() * along;
            let after = (prior.try_inverse().expect("it is regular") + information).try_inverse().expect("it is, too");
            filter.update(Vector3::zeros(), &(0.5 * (after + after.transpose())));
        }
        assert!(worst < 1e-12, "{worst}");
    }

    #[test]
    fn one_long_step_equals_many_short_ones() {
        let start = Filter::moving(Vector3::zeros(), &Matrix3::identity(), Vector3::new(1.0, 0.0, -2.0), 0.5, 9.0);
        let (mut long, mut short) = (start.clone(), start);
        long.predict(&Step::new(0.3), 9.0);
        for _ in 0..30 {
            short.predict(&Step::new(0.01), 9.0);
        }
        assert_relative_eq!(state(&long), state(&short), epsilon = 1e-12);
        assert_relative_eq!(full(&long), full(&short), max_relative = 1e-8, epsilon = 1e-9);
    }

    #[test]
    fn the_series_of_the_process_noise_meets_the_closed_form() {
        for (a, b) in singer_noise(0.019_999, 0.15).iter().zip(singer_noise(0.020_001, 0.15)) {
            assert_relative_eq!(*a, b, max_relative = 0.02);
        }
    }

    #[test]
    fn fusing_weighs_by_certainty() {
        let (sure, vague) = (Matrix3::identity() * 1e-6, Matrix3::identity());
        let (mean, covariance) =
            fuse((&Vector3::zeros(), &sure), (&Vector3::repeat(1.0), &vague)).expect("both are regular");
        assert!(mean.norm() < 1e-5);
        assert_relative_eq!(covariance[(0, 0)], 1e-6, max_relative = 1e-5);
    }
}
