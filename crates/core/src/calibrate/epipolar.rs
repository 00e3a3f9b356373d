//! Two views: fundamental matrix from correspondences with wrong ones among them, and the motions it allows.
//!
//! Hartley & Zisserman 2003: normalised eight-point algorithm (alg. 11.1), Sampson distance (eq. 11.9), essential
//! matrix and its four motions (§9.6). Robust by the least median of squares (Rousseeuw 1984): no threshold is needed
//! as long as more than half of the correspondences are right.

use crate::calibrate::bundle::robust::median;
use crate::synth::random::Random;
use nalgebra::{Matrix3, SMatrix, SVector, SymmetricEigen, Vector2, Vector3};

/// Draws of eight: with 20 % wrong, all but one in 10¹⁵ searches draw a clean eight.
const DRAWS: usize = 200;
/// A correspondence belongs to the fit within this many standard deviations.
const INLIER: f64 = 2.5;

/// Points of two images that belong together.
pub type Pairs = [(Vector2<f64>, Vector2<f64>)];

/// Fundamental matrix with `second · F first = 0`, and the median Sampson distance. `None` for fewer than 16 pairs.
pub fn fundamental(pairs: &Pairs, seed: u64) -> Option<(Matrix3<f64>, f64)> {
    if pairs.len() < 16 {
        return None;
    }
    let mut random = Random::new(seed, 0);
    let mut best: Option<(Matrix3<f64>, f64)> = None;
    let mut distances = Vec::with_capacity(pairs.len());
    for _ in 0..DRAWS {
        let drawn: Vec<_> = (0..8).map(|_| pairs[random.below(pairs.len())]).collect();
        let Some(f) = eight_point(&drawn) else { continue };
        let middle = median_distance(&f, pairs, &mut distances);
        if best.as_ref().is_none_or(|b| middle < b.1) {
            best = Some((f, middle));
        }
    }
    let (mut f, mut middle) = best?;
    for _ in 0..3 {
        // 1.4826 (1 + 5 / (n − 8)): Rousseeuw & Leroy 1987, for a scale from a median of squares.
        let sigma = 1.4826 * (1.0 + 5.0 / (pairs.len() - 8) as f64) * middle;
        let near: Vec<_> = pairs.iter().copied().filter(|p| sampson(&f, p) <= INLIER * sigma).collect();
        let Some(next) = eight_point(&near) else { break };
        let next_middle = median_distance(&next, pairs, &mut distances);
        if next_middle > middle * 1.2 {
            break;
        }
        (f, middle) = (next, next_middle);
    }
    Some((f, middle))
}

fn median_distance(f: &Matrix3<f64>, pairs: &Pairs, distances: &mut Vec<f64>) -> f64 {
    distances.clear();
    distances.extend(pairs.iter().map(|p| sampson(f, p)));
    median(distances)
}

/// First-order distance of a pair from the epipolar geometry, in the units of the points.
pub fn sampson(f: &Matrix3<f64>, (a, b): &(Vector2<f64>, Vector2<f64>)) -> f64 {
    let (a, b) = (a.push(1.0), b.push(1.0));
    let (line_b, line_a) = (f * a, f.transpose() * b);
    b.dot(&line_b).abs() / (line_a.xy().norm_squared() + line_b.xy().norm_squared()).sqrt().max(1e-300)
}

/// The linear solution, of rank 2; `None` for fewer than eight pairs or where they coincide.
fn eight_point(pairs: &Pairs) -> Option<Matrix3<f64>> {
    if pairs.len() < 8 {
        return None;
    }
    let (first, second) = (normaliser(pairs.iter().map(|p| p.0))?, normaliser(pairs.iter().map(|p| p.1))?);
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    for (a, b) in pairs {
        let (a, b) = (first * a.push(1.0), second * b.push(1.0));
        let row =
            SVector::<f64, 9>::from_row_slice(&[b.x * a.x, b.x * a.y, b.x, b.y * a.x, b.y * a.y, b.y, a.x, a.y, 1.0]);
        normal.ger(1.0, &row, &row, 1.0);
    }
    let eigen = SymmetricEigen::new(normal);
    let smallest = eigen.eigenvalues.imin();
    let v = eigen.eigenvectors.column(smallest);
    let svd = Matrix3::from_row_slice(v.as_slice()).svd(true, true);
    let mut values = svd.singular_values;
    let least = values.imin();
    values[least] = 0.0;
    let rank_two = svd.u? * Matrix3::from_diagonal(&values) * svd.v_t?;
    let f = second.transpose() * rank_two * first;
    let norm = f.norm();
    (norm.is_finite() && norm > 0.0).then(|| f / norm)
}

/// Moves points to their centroid and a mean distance of √2.
fn normaliser(points: impl Iterator<Item = Vector2<f64>> + Clone) -> Option<Matrix3<f64>> {
    let n = points.clone().count() as f64;
    let middle = points.clone().sum::<Vector2<f64>>() / n;
    let spread = points.map(|p| (p - middle).norm()).sum::<f64>() / n;
    let s = std::f64::consts::SQRT_2 / spread;
    s.is_finite().then(|| Matrix3::new(s, 0.0, -s * middle.x, 0.0, s, -s * middle.y, 0.0, 0.0, 1.0))
}

/// A motion from the first camera's axes to the second's: `second = rotation * first + translation`, |translation| = 1.
pub type Motion = (Matrix3<f64>, Vector3<f64>);

/// The four motions of an essential matrix, made exact first.
pub fn motions(essential: &Matrix3<f64>) -> Option<[Motion; 4]> {
    let svd = essential.svd(true, true);
    let (mut u, mut v_t) = (svd.u?, svd.v_t?);
    // Singular values come sorted; rotations must not mirror.
    if u.determinant() < 0.0 {
        u.column_mut(2).neg_mut();
    }
    if v_t.determinant() < 0.0 {
        v_t.row_mut(2).neg_mut();
    }
    let w = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
    let (one, two) = (u * w * v_t, u * w.transpose() * v_t);
    let t = u.column(2).into_owned();
    Some([(one, t), (one, -t), (two, t), (two, -t)])
}

/// The point nearest to two rays (midpoint of the shortest line between them), in the first camera's axes.
///
/// `first` and `second` are normalised image points. `None` where the rays are parallel or meet behind a camera.
pub fn meet(motion: &Motion, first: &Vector2<f64>, second: &Vector2<f64>) -> Option<Vector3<f64>> {
    let (rotation, translation) = motion;
    let center = -rotation.transpose() * translation;
    let (a, b) = (first.push(1.0), rotation.transpose() * second.push(1.0));
    let (aa, ab, bb) = (a.dot(&a), a.dot(&b), b.dot(&b));
    let determinant = aa * bb - ab * ab;
    if determinant < 1e-10 * aa * bb {
        return None;
    }
    let s = (bb * a.dot(&center) - ab * b.dot(&center)) / determinant;
    let t = (ab * a.dot(&center) - aa * b.dot(&center)) / determinant;
    (s > 0.0 && t > 0.0).then(|| 0.5 * (a * s + center + b * t))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;

    type Scene = (Motion, Vec<(Vector2<f64>, Vector2<f64>)>, Vec<Vector3<f64>>);

    fn scene(wrong: usize, sigma: f64) -> Scene {
        let rotation = *Rotation3::from_euler_angles(0.1, -0.9, 0.2).matrix();
        let motion = (rotation, Vector3::new(0.8, 0.1, 0.59).normalize());
        let mut random = Random::new(3, 1);
        let mut points = Vec::new();
        let mut pairs = Vec::new();
        for i in 0..120 {
            let p = random.in_box(&Vector3::new(0.5, 0.5, 0.5)) + Vector3::new(0.0, 0.0, 1.2);
            let q = motion.0 * p + motion.1;
            let noise = |r: &mut Random| Vector2::new(r.normal(), r.normal()) * sigma;
            let b = if i < wrong { Vector2::new(random.normal(), random.normal()) * 0.3 } else { q.xy() / q.z };
            pairs.push((p.xy() / p.z + noise(&mut random), b + noise(&mut random)));
            points.push(p);
        }
        (motion, pairs, points)
    }

    #[test]
    fn without_noise_the_motion_and_the_points_come_back() {
        let (motion, pairs, points) = scene(0, 0.0);
        let (f, middle) = fundamental(&pairs, 1).unwrap();
        assert!(middle < 1e-9);
        let found = motions(&f).unwrap();
        let right = found.iter().find(|m| (m.0 - motion.0).norm() < 1e-6 && (m.1 - motion.1).norm() < 1e-6).unwrap();
        for (pair, point) in pairs.iter().zip(&points) {
            assert!((meet(right, &pair.0, &pair.1).unwrap() - point).norm() < 1e-6);
        }
    }

    #[test]
    fn a_third_of_wrong_pairs_does_no_harm() {
        let (motion, pairs, _) = scene(40, 1e-4);
        let (f, _) = fundamental(&pairs, 1).unwrap();
        assert!(motions(&f).unwrap().iter().any(|m| (m.0 - motion.0).norm() < 0.02));
    }
}
