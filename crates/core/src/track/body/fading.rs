//! How far off a prediction is, by how far off it was at some moments: what it was off fades as such errors do.
//!
//! A Gaussian process with a Matérn kernel of smoothness 3/2 (Rasmussen & Williams 2006, §2.2 and §4.2): errors are smooth
//! and forgotten after some lengths. Live, what the prediction was off last and how fast that changed go on. In a recorded
//! take it is known from both sides, and what was measured then is as noisy as it is: a noisy sample says little.

use nalgebra::{DMatrix, Matrix3, Vector3};

/// Noise of what a prediction was off, when it goes on (m).
const LAST_NOISE: f64 = 0.000_5;

/// Errors of a prediction.
#[derive(Clone, Debug, Default)]
pub struct Fading {
    /// Variance per axis (m²), and length of the correlation (s).
    variance: f64,
    length_s: f64,
    known: Known,
}

/// What is known of them.
#[derive(Clone, Debug, Default)]
enum Known {
    #[default]
    Nothing,
    /// What it was off at a time, and how fast that changed.
    Last { time_s: f64, off: Vector3<f64>, drift: Vector3<f64> },
    /// What it was off at some times: the inverse covariance of that, 3 × 3 by 3 × 3, and the same times it.
    Around { times_s: Vec<f64>, inverse: Vec<Matrix3<f64>>, weighed: Vec<Vector3<f64>> },
}

impl Fading {
    /// Onward from what it was off (m) at some times (s), the last one first: a line through them, its slope shrunk by how
    /// fast errors change at all.
    pub fn onward(off: impl Iterator<Item = (f64, Vector3<f64>)>, variance: f64, length_s: f64) -> Self {
        let mut off = off;
        let Some((time_s, newest)) = off.next() else { return Self { variance, length_s, known: Known::Nothing } };
        let (mut squared, mut product) = (0.0, Vector3::zeros());
        for (at_s, off) in off {
            let before_s = at_s - time_s;
            squared += before_s * before_s;
            product += (off - newest) * before_s;
        }
        let ridge = (LAST_NOISE * length_s).powi(2) / variance.max(1e-12);
        Self { variance, length_s, known: Known::Last { time_s, off: newest, drift: product / (squared + ridge) } }
    }

    /// Around the times (s) of which is known how far off it was (m), and the covariance of that by noise (m²).
    pub fn around(off: impl Iterator<Item = (f64, Vector3<f64>, Matrix3<f64>)>, variance: f64, length_s: f64) -> Self {
        let off: Vec<(f64, Vector3<f64>, Matrix3<f64>)> = off.collect();
        let nothing = Self { variance, length_s, known: Known::Nothing };
        let n = off.len();
        let mut covariance = DMatrix::zeros(3 * n, 3 * n);
        for (i, (at_s, _, noise)) in off.iter().enumerate() {
            for (k, (other_s, ..)) in off.iter().enumerate() {
                let mut block = Matrix3::identity() * nothing.kernel(at_s - other_s);
                if i == k {
                    block += noise + Matrix3::identity() * (1e-6 * variance);
                }
                covariance.fixed_view_mut::<3, 3>(3 * i, 3 * k).copy_from(&block);
            }
        }
        let Some(factor) = covariance.cholesky() else { return nothing };
        let inverse = factor.inverse();
        let block = |i: usize, k: usize| -> Matrix3<f64> { inverse.fixed_view::<3, 3>(3 * i, 3 * k).into() };
        let known = Known::Around {
            times_s: off.iter().map(|o| o.0).collect(),
            weighed: (0..n).map(|i| (0..n).map(|k| block(i, k) * off[k].1).sum()).collect(),
            inverse: (0..n * n).map(|ik| block(ik / n, ik % n)).collect(),
        };
        Self { known, ..nothing }
    }

    /// How far off the prediction is at a time (m), and the covariance of what is not known of that (m²).
    pub fn at(&self, time_s: f64) -> (Vector3<f64>, Matrix3<f64>) {
        let unknown = Matrix3::identity() * self.variance;
        match &self.known {
            Known::Nothing => (Vector3::zeros(), unknown),
            Known::Last { time_s: last_s, off, drift } => {
                let after_s = (time_s - last_s).max(0.0);
                let x = after_s / self.length_s;
                let kept = (-x).exp();
                let faded = (1.0 - kept * kept * ((1.0 + x).powi(2) + x * x)).max(0.0);
                ((off * (1.0 + x) + drift * after_s) * kept, unknown * faded)
            }
            Known::Around { times_s, inverse, weighed } => {
                let kernel: Vec<f64> = times_s.iter().map(|t| self.kernel(time_s - t)).collect();
                let off = kernel.iter().zip(weighed).map(|(k, w)| w * *k).sum();
                let rows = inverse.chunks_exact(kernel.len().max(1)).zip(&kernel);
                let known =
                    rows.flat_map(|(row, own)| row.iter().zip(&kernel).map(move |(b, other)| b * (own * other)));
                (off, unknown - known.sum::<Matrix3<f64>>())
            }
        }
    }

    fn kernel(&self, apart_s: f64) -> f64 {
        let x = apart_s.abs() / self.length_s;
        self.variance * (1.0 + x) * (-x).exp()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    const LENGTH_S: f64 = 0.1;

    fn fading(times_s: &[f64], noise: f64) -> Fading {
        let off =
            times_s.iter().map(|&t| (t, Vector3::new(0.01 + t, 0.0, -0.02), Matrix3::identity() * (noise * noise)));
        Fading::around(off, 1e-4, LENGTH_S)
    }

    #[test]
    fn what_it_was_off_is_known_then_and_forgotten_later() {
        let one = fading(&[0.0, -0.01, -0.02], 1e-5);
        let (off, left) = one.at(0.0);
        assert_relative_eq!(off, Vector3::new(0.01, 0.0, -0.02), epsilon = 1e-4);
        assert!(left.trace() < 1e-6);
        let (off, left) = one.at(3.0);
        assert!(off.norm() < 1e-6);
        assert_relative_eq!(left, Matrix3::identity() * 1e-4, epsilon = 1e-9);
    }

    #[test]
    fn what_it_was_off_last_goes_on_as_it_changed_and_fades() {
        let times_s = [0.0, -0.01, -0.02];
        let last = times_s.map(|t| (t, Vector3::new(0.01 + t, 0.0, -0.02)));
        let onward = Fading::onward(last.into_iter(), 1e-4, LENGTH_S);
        let (off, left) = onward.at(0.01);
        assert_relative_eq!(off, Vector3::new(0.02, 0.0, -0.02), max_relative = 0.1);
        assert!(left.trace() < 1e-6);
        assert_relative_eq!(onward.at(3.0).1, Matrix3::identity() * 1e-4, epsilon = 1e-9);
        assert_relative_eq!(fading(&times_s, 1e-6).at(0.01).0, off, max_relative = 0.2);
    }

    #[test]
    fn between_two_moments_it_is_known_from_both() {
        let both = fading(&[0.0, 0.1], 1e-5);
        let (off, left) = both.at(0.05);
        assert_relative_eq!(off, Vector3::new(0.06, 0.0, -0.02), max_relative = 0.2);
        assert!(left.trace() < 0.5 * fading(&[0.0], 1e-5).at(0.05).1.trace());
    }

    #[test]
    fn a_noisy_sample_says_little() {
        let (off, left) = fading(&[0.0], 0.05).at(0.0);
        assert!(off.norm() < 0.002);
        assert!(left.trace() > 0.9 * 3e-4);
        let (of_one, of_many) = (left, fading(&[0.0, -0.001, -0.002, -0.003], 0.05).at(0.0).1);
        assert!(of_many.trace() < of_one.trace());
    }
}
