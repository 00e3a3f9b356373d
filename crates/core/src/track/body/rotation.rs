//! The rotation that brings one set of points nearest to another (Kabsch 1976), from a good first guess.
//!
//! Newton's method on the rotation vector: torque against inertia. From a guess within some tens of degrees three or four
//! steps give full precision, without a singular value decomposition; where the inertia is not positive (far off, or
//! points on a line) a smaller step is taken.

use nalgebra::{Matrix3, Rotation3, Vector3};

/// After a step this small (rad) the next one is below rounding: Newton's method squares the error.
const LAST_STEP: f64 = 1e-5;

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
        let step = solve(&inertia, 1e-9 * dot.abs() + 1e-15, &torque)
            .unwrap_or_else(|| torque / (dot.abs() + torque.norm() + 1e-15));
        let step = if step.norm() > 1.0 { step.normalize() } else { step };
        rotation = turn(&step) * rotation;
        if step.norm() < LAST_STEP {
            break;
        }
    }
    rotation
}

/// Solution of (M + d I) x = v for a symmetric M, by L D Lᵀ; `None` if it is not positive definite.
fn solve(m: &Matrix3<f64>, damping: f64, v: &Vector3<f64>) -> Option<Vector3<f64>> {
    let d1 = m.m11 + damping;
    let (l2, l3) = (m.m21 / d1, m.m31 / d1);
    let d2 = m.m22 + damping - l2 * m.m21;
    let t = m.m32 - l3 * m.m21;
    let l = t / d2;
    let d3 = m.m33 + damping - l3 * m.m31 - l * t;
    if d1 <= 0.0 || d2 <= 0.0 || d3 <= 0.0 {
        return None;
    }
    let y = v.y - l2 * v.x;
    let z = (v.z - l3 * v.x - l * y) / d3;
    let y = y / d2 - l * z;
    Some(Vector3::new(v.x / d1 - l2 * y - l3 * z, y, z))
}

/// A rotation by a small step, to the second order and without a sine (Cayley 1846): what is missed, the next step makes good.
fn turn(step: &Vector3<f64>) -> Rotation3<f64> {
    let h = 0.5 * step;
    let norm2 = h.norm_squared();
    let matrix = Matrix3::identity() * (1.0 - norm2) + 2.0 * (h * h.transpose() + h.cross_matrix());
    Rotation3::from_matrix_unchecked(matrix / (1.0 + norm2))
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
