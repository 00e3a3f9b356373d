//! How alike the moments of two motions are, wherever they happen and wherever they face: clouds of points, best laid
//! onto each other by a turn about the vertical and a shift on the floor (Kovar, Gleicher & Pighin 2002, section 3.1).

use rayon::prelude::*;

/// Points of every frame (m), weighted; frames are rows of x, y, z of each point.
#[derive(Clone, Debug)]
pub struct Clouds {
    points_m: Vec<f64>,
    weights: Vec<f64>,
    /// Sums over the window that ends a number of frames after each frame.
    means: Vec<[f64; 2]>,
    squares: Vec<f64>,
}

/// How many frames before and after a moment belong to its cloud; frames beyond an end repeat the end.
fn window(frame: usize, half: usize, frames: usize) -> impl Iterator<Item = usize> {
    (0..=2 * half).map(move |k| (frame + k).saturating_sub(half).min(frames - 1))
}

impl Clouds {
    /// Clouds of a motion's points: `points_m` frames × points × 3, one weight per point.
    pub fn new(points_m: Vec<f64>, weights: &[f64], half: usize) -> Self {
        let total: f64 = weights.iter().sum::<f64>() * (2 * half + 1) as f64;
        let weights: Vec<f64> = weights.iter().map(|w| w / total).collect();
        let row = weights.len() * 3;
        let frames = points_m.len() / row.max(1);
        let own: Vec<([f64; 2], f64)> = points_m
            .chunks_exact(row)
            .map(|frame| {
                let (mut mean, mut square) = ([0.0; 2], 0.0);
                for (p, w) in frame.chunks_exact(3).zip(&weights) {
                    mean[0] += w * p[0];
                    mean[1] += w * p[1];
                    square += w * (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]);
                }
                (mean, square)
            })
            .collect();
        let means = (0..frames)
            .map(|f| window(f, half, frames).fold([0.0; 2], |s, k| [s[0] + own[k].0[0], s[1] + own[k].0[1]]));
        let squares = (0..frames).map(|f| window(f, half, frames).map(|k| own[k].1).sum());
        Self { means: means.collect(), squares: squares.collect(), points_m, weights }
    }

    fn frames(&self) -> usize {
        self.squares.len()
    }

    fn frame(&self, frame: usize) -> &[f64] {
        let row = self.weights.len() * 3;
        &self.points_m[frame * row..][..row]
    }

    /// Weighted products of one frame's points with another's: along, across, and up.
    fn products(&self, frame: usize, other: &Self, at: usize) -> [f64; 3] {
        let mut sums = [0.0; 3];
        let pairs = self.frame(frame).chunks_exact(3).zip(other.frame(at).chunks_exact(3));
        for ((p, q), w) in pairs.zip(&self.weights) {
            sums[0] += w * (p[0] * q[0] + p[1] * q[1]);
            sums[1] += w * (p[1] * q[0] - p[0] * q[1]);
            sums[2] += w * p[2] * q[2];
        }
        sums
    }
}

/// The best turn (rad) about the vertical and the root of the mean square distance (m) that is left.
fn laid(a: &Clouds, i: usize, b: &Clouds, j: usize, products: [f64; 3]) -> (f64, f64) {
    let ((ma, mb), [along, across, up]) = ((a.means[i], b.means[j]), products);
    let along = along - (ma[0] * mb[0] + ma[1] * mb[1]);
    let across = across - (ma[1] * mb[0] - ma[0] * mb[1]);
    let spread = a.squares[i] + b.squares[j]
        - (ma[0] * ma[0] + ma[1] * ma[1])
        - (mb[0] * mb[0] + mb[1] * mb[1])
        - 2.0 * up
        - 2.0 * along.hypot(across);
    (across.atan2(along), spread.max(0.0).sqrt())
}

/// Distances (m) of all moments of one motion from all of another: rows are those of `a`.
pub fn distances(a: &Clouds, b: &Clouds, half: usize) -> Vec<f64> {
    let (rows, columns) = (a.frames(), b.frames());
    // Products of single frames are summed along diagonals: a row needs those of the rows around it.
    let mut out = vec![0.0; rows * columns];
    out.par_chunks_mut(columns.max(1) * 64).enumerate().for_each(|(block, out)| {
        let first = block * 64;
        let count = out.len() / columns;
        let low = first.saturating_sub(half);
        let high = (first + count + half).min(rows);
        let single: Vec<[f64; 3]> = (low..high).flat_map(|i| (0..columns).map(move |j| a.products(i, b, j))).collect();
        for i in 0..count {
            for j in 0..columns {
                let mut sum = [0.0; 3];
                for (p, q) in window(first + i, half, rows).zip(window(j, half, columns)) {
                    let own = single[(p - low) * columns + q];
                    (0..3).for_each(|k| sum[k] += own[k]);
                }
                out[i * columns + j] = laid(a, first + i, b, j, sum).1;
            }
        }
    });
    out
}

/// How the other motion's moment is laid onto one of `a`: turn about the vertical (rad), then shift (m) on the floor;
/// and their distance (m).
pub fn alignment(a: &Clouds, i: usize, b: &Clouds, j: usize, half: usize) -> (f64, [f64; 2], f64) {
    let mut sum = [0.0; 3];
    for (p, q) in window(i, half, a.frames()).zip(window(j, half, b.frames())) {
        let own = a.products(p, b, q);
        (0..3).for_each(|k| sum[k] += own[k]);
    }
    let (turn, off) = laid(a, i, b, j, sum);
    let (sin, cos) = turn.sin_cos();
    let (ma, mb) = (a.means[i], b.means[j]);
    (turn, [ma[0] - (cos * mb[0] - sin * mb[1]), ma[1] - (sin * mb[0] + cos * mb[1])], off)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn some(frames: usize, turn: f64) -> Vec<f64> {
        let (s, c) = f64::sin_cos(turn);
        (0..frames * 4)
            .flat_map(|i| {
                let (x, y) = ((0.7 * i as f64).sin(), (1.3 * i as f64).cos());
                [c * x - s * y + turn, s * x + c * y - 2.0 * turn, (0.2 * i as f64).sin()]
            })
            .collect()
    }

    #[test]
    fn the_same_motion_elsewhere_is_alike_and_is_laid_back() {
        let weights = [1.0, 2.0, 1.0, 0.5];
        let (a, b) = (Clouds::new(some(30, 0.0), &weights, 3), Clouds::new(some(30, 0.8), &weights, 3));
        let all = distances(&a, &b, 3);
        for i in 0..30 {
            assert!(all[i * 30 + i] < 1e-7);
        }
        assert!(all[30 * 4 + 9] > 0.1);
        let (turn, shift, off) = alignment(&a, 12, &b, 12, 3);
        assert!((turn + 0.8).abs() < 1e-9 && off < 1e-7);
        let (s, c) = turn.sin_cos();
        assert!((shift[0] + c * 0.8 + s * 1.6).abs() < 1e-9 && (shift[1] + s * 0.8 - c * 1.6).abs() < 1e-9);
    }

    #[test]
    fn distances_are_those_of_single_pairs() {
        let weights = [1.0; 4];
        let (a, b) = (Clouds::new(some(70, 0.1), &weights, 2), Clouds::new(some(9, 0.4), &weights, 2));
        let all = distances(&a, &b, 2);
        for (i, j) in [(0, 0), (1, 8), (63, 4), (64, 4), (69, 8), (33, 0)] {
            assert!((all[i * 9 + j] - alignment(&a, i, &b, j, 2).2).abs() < 1e-9);
        }
    }
}
