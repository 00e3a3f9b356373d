//! Symmetric banded equations: Cholesky without pivoting (Golub & Van Loan 2013, section 4.3.5).

/// Entries of the lower half: of every row those from `width` columns before the diagonal up to it.
#[derive(Clone, Debug)]
pub struct Banded {
    width: usize,
    rows: Vec<f64>,
    n: usize,
}

impl Banded {
    /// No entry yet; entries further than `width` from the diagonal stay 0.
    pub fn new(n: usize, width: usize) -> Self {
        Self { width, rows: vec![0.0; n * (width + 1)], n }
    }

    /// Add to the entry of a row and a column not after it.
    pub fn add(&mut self, row: usize, column: usize, value: f64) {
        debug_assert!(column <= row && row - column <= self.width);
        self.rows[row * (self.width + 1) + self.width + column - row] += value;
    }

    fn row(&self, row: usize, from: usize) -> &[f64] {
        let start = row * (self.width + 1) + self.width;
        &self.rows[start + from - row..=start]
    }

    /// Solve in place, the entries used up; `false` where they are not positive definite.
    pub fn solve(mut self, b: &mut [f64]) -> bool {
        let w = self.width + 1;
        for i in 0..self.n {
            let low = i.saturating_sub(self.width);
            let (before, own) = self.rows.split_at_mut(i * w);
            let shift = i - low;
            let own = &mut own[self.width - shift..w];
            for j in low..i {
                // Columns that both rows have: from `low` to before j.
                let from = low.max(j.saturating_sub(self.width));
                let other = &before[j * w + self.width + from - j..=j * w + self.width];
                let (used, rest) = own.split_at_mut(j - low);
                let (pivot, other) = (other[j - from], &other[..j - from]);
                rest[0] = (rest[0] - dot(&used[from - low..], other)) / pivot;
            }
            let (row, diagonal) = own.split_at_mut(shift);
            let square = diagonal[0] - dot(row, row);
            if square.is_nan() || square <= 0.0 {
                return false;
            }
            diagonal[0] = square.sqrt();
        }
        for i in 0..self.n {
            let low = i.saturating_sub(self.width);
            let row = self.row(i, low);
            b[i] = (b[i] - dot(&row[..i - low], &b[low..i])) / row[i - low];
        }
        for i in (0..self.n).rev() {
            let low = i.saturating_sub(self.width);
            let row = self.row(i, low);
            let value = b[i] / row[i - low];
            b[i] = value;
            b[low..i].iter_mut().zip(row).for_each(|(b, l)| *b -= l * value);
        }
        true
    }
}

/// Sum of products, in eight parts that the processor adds at once; always in the same order.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut parts = [0.0; 8];
    let (heads, tails) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest: f64 = heads.remainder().iter().zip(tails.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in heads.zip(tails) {
        for k in 0..8 {
            parts[k] += x[k] * y[k];
        }
    }
    parts.iter().sum::<f64>() + rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};

    #[test]
    fn solves_as_a_dense_solver_does() {
        for (n, width) in [(40, 11), (40, 39), (7, 2), (30, 1), (25, 0)] {
            solves(n, width);
        }
    }

    fn solves(n: usize, width: usize) {
        let (mut ours, mut dense) = (Banded::new(n, width), DMatrix::<f64>::zeros(n, n));
        for i in 0..n {
            for j in i.saturating_sub(width)..=i {
                let value = if i == j { 30.0 } else { ((i * 7 + j * 3) % 11) as f64 / 4.0 };
                ours.add(i, j, value);
                (dense[(i, j)], dense[(j, i)]) = (value, value);
            }
        }
        let mut x: Vec<f64> = (0..n).map(|i| (i as f64).sin()).collect();
        let expected = dense.lu().solve(&DVector::from_vec(x.clone())).expect("regular");
        assert!(ours.solve(&mut x));
        assert!((DVector::from_vec(x) - expected).norm() < 1e-12);
    }

    #[test]
    fn what_is_not_positive_is_refused() {
        let mut ours = Banded::new(2, 1);
        ours.add(0, 0, 1.0);
        ours.add(1, 0, 2.0);
        ours.add(1, 1, 1.0);
        assert!(!ours.solve(&mut [1.0, 1.0]));
    }
}
