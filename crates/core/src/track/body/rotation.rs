//! The rotation that brings one set of points nearest to another (Kabsch 1976), from a good first guess.
//!
//! Newton's method on the rotation vector: torque against inertia. From a guess within some tens of degrees three or four
//! steps give full precision, without a singular value decomposition; where the inertia is not positive (far off, or
//! points on a line) a smaller step is taken.

use nalgebra::{Matrix3, Rotation3, Vector3};

/// The rotation R that minimises Σ w |R a − b|², for points relative to their centroids.
pub fn align(a: &[Vector3<f64>], b: &[Vector3<f64>], weights: &[f64], guess: Rotation3<f64>) -> Rotation3<f64> {
    let mut moments = Matrix3::zeros();
    for ((a, b), w) in a.iter().zip(b).zip(weights) {
        moments += a * b.transpose() * *w;
    }
    let mut rotation = guess;
    for _ in 0..30 {
        // Σ w (R a) bᵀ: its antisymmetric part is the torque, its trace the alignment.
        let cross = rotation * moments;
        let dot = cross.trace();
        let torque =
            Vector3::new(cross[(1, 2)] - cross[(2, 1)], cross[(2, 0)] - cross[(0, 2)], cross[(0, 1)] - cross[(1, 0)]);
        let inertia = Matrix3::identity() * dot - 0.5 * (cross + cross.transpose());
        // A hair of damping leaves the turn about a line of points alone.
        let damped = inertia + Matrix3::identity() * (1e-9 * dot.abs() + 1e-15);
        let step = match damped.cholesky() {
            Some(factor) => factor.solve(&torque),
            None => torque / (dot.abs() + torque.norm() + 1e-15),
        };
        let step = if step.norm() > 1.0 { step.normalize() } else { step };
        rotation = Rotation3::new(step) * rotation;
        if step.norm() < 1e-10 {
            break;
        }
    }
    rotation
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::random::Random;
    use approx::assert_relative_eq;

    #[test]
    fn a_rotation_is_found_from_any_side() {
        let mut random = Random::new(3, 0);
        for k in 0..200 {
            let points: Vec<Vector3<f64>> = (0..4).map(|_| random.in_box(&Vector3::repeat(0.4))).collect();
            let center = points.iter().sum::<Vector3<f64>>() / 4.0;
            let a: Vec<Vector3<f64>> = points.iter().map(|p| p - center).collect();
            let truth = Rotation3::new(Vector3::new(0.9, -0.4, 0.2) * (f64::from(k) / 100.0));
            let b: Vec<Vector3<f64>> = a.iter().map(|p| truth * p).collect();
            let found = align(&a, &b, &[1.0; 4], Rotation3::identity());
            assert_relative_eq!(found.matrix(), truth.matrix(), epsilon = 1e-6);
        }
    }

    #[test]
    fn points_on_a_line_give_some_rotation_that_fits() {
        let a: Vec<Vector3<f64>> = [-0.1, 0.0, 0.1].iter().map(|&x| Vector3::new(x, 0.0, 0.0)).collect();
        let b: Vec<Vector3<f64>> = [-0.1, 0.0, 0.1].iter().map(|&y| Vector3::new(0.0, y, 0.0)).collect();
        let found = align(&a, &b, &[1.0; 3], Rotation3::identity());
        assert_relative_eq!(found * a[2], b[2], epsilon = 1e-6);
    }
}
