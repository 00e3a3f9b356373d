//! Normal equations of a tree: only columns on one way to the root meet, and elimination from the leaves keeps it so.
//!
//! Featherstone 2008, "Rigid Body Dynamics Algorithms", table 6.3 (H = LᵀL), and the entries of the inverse that a
//! covariance needs, from the root outwards (Takahashi's recursion on the same pattern).

/// Symmetric equations over columns that form a forest: `above[c]` is the next column towards the root.
#[derive(Clone, Debug)]
pub struct Normal {
    n: usize,
    above: Vec<Option<usize>>,
    /// Row by row; entry (c, a) only for a = c or a above c.
    h: Vec<f64>,
    /// Right-hand side: the gradient.
    pub g: Vec<f64>,
}

impl Normal {
    /// Empty equations.
    pub fn new(above: Vec<Option<usize>>) -> Self {
        let n = above.len();
        Self { n, above, h: vec![0.0; n * n], g: vec![0.0; n] }
    }

    /// How many columns there are.
    pub fn len(&self) -> usize {
        self.n
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.n == 0
    }

    /// The next column towards the root.
    pub fn above(&self, column: usize) -> Option<usize> {
        self.above[column]
    }

    /// Start again from zero.
    pub fn clear(&mut self) {
        self.h.fill(0.0);
        self.g.fill(0.0);
    }

    /// Add to the entry of a column with itself or one above it.
    pub fn add(&mut self, column: usize, above: usize, value: f64) {
        self.h[column * self.n + above] += value;
    }

    /// The entry of a column with itself or one above it.
    pub fn entry(&self, column: usize, above: usize) -> f64 {
        self.h[column * self.n + above]
    }

    fn chain(&self, column: usize) -> impl Iterator<Item = usize> + '_ {
        std::iter::successors(self.above[column], |&c| self.above[c])
    }

    /// The factor L with H = LᵀL, the diagonal raised by `damping` times itself; `None` where H is not positive.
    pub fn factor(&self, damping: f64) -> Option<Factor<'_>> {
        let n = self.n;
        let mut l = self.h.clone();
        for k in (0..n).rev() {
            let pivot = l[k * n + k] + damping * self.h[k * n + k];
            if pivot.is_nan() || pivot <= 0.0 {
                return None;
            }
            let root = pivot.sqrt();
            l[k * n + k] = root;
            for i in self.chain(k) {
                l[k * n + i] /= root;
            }
            for i in self.chain(k) {
                let factor = l[k * n + i];
                l[i * n + i] -= factor * factor;
                for j in self.chain(i) {
                    l[i * n + j] -= factor * l[k * n + j];
                }
            }
        }
        Some(Factor { normal: self, l })
    }
}

/// The factor of [`Normal`].
pub struct Factor<'a> {
    normal: &'a Normal,
    l: Vec<f64>,
}

impl Factor<'_> {
    /// Solve H x = b in place.
    pub fn solve(&self, b: &mut [f64]) {
        let n = self.normal.n;
        self.half(b);
        for i in 0..n {
            let sum: f64 = self.normal.chain(i).map(|j| self.l[i * n + j] * b[j]).sum();
            b[i] = (b[i] - sum) / self.l[i * n + i];
        }
    }

    /// Solve Lᵀ y = b in place: then |y|² = bᵀ H⁻¹ b.
    pub fn half(&self, b: &mut [f64]) {
        let n = self.normal.n;
        for i in (0..n).rev() {
            b[i] /= self.l[i * n + i];
            for j in self.normal.chain(i) {
                b[j] -= self.l[i * n + j] * b[i];
            }
        }
    }

    /// Entries of the inverse for every column with itself and those above it, row by row.
    pub fn inverse(&self) -> Vec<f64> {
        let n = self.normal.n;
        let mut z = vec![0.0; n * n];
        for i in 0..n {
            let pivot = self.l[i * n + i];
            for j in self.normal.chain(i) {
                let sum: f64 = self.normal.chain(i).map(|k| self.l[i * n + k] * z[k.max(j) * n + k.min(j)]).sum();
                z[i * n + j] = -sum / pivot;
            }
            let sum: f64 = self.normal.chain(i).map(|k| self.l[i * n + k] * z[i * n + k]).sum();
            z[i * n + i] = 1.0 / (pivot * pivot) - sum / pivot;
        }
        z
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};

    fn example() -> (Normal, DMatrix<f64>) {
        let mut normal = Normal::new(vec![None, Some(0), Some(1), Some(1), Some(0), Some(4)]);
        let mut dense = DMatrix::zeros(6, 6);
        for c in 0..6 {
            let chain: Vec<usize> = std::iter::once(c).chain(normal.chain(c)).collect();
            for (k, &a) in chain.iter().enumerate() {
                let value = if a == c { 5.0 + c as f64 } else { 0.7 - 0.3 * k as f64 + 0.1 * c as f64 };
                normal.add(c, a, value);
                dense[(c, a)] = value;
                dense[(a, c)] = value;
            }
        }
        (normal, dense)
    }

    #[test]
    fn solves_and_inverts_as_a_dense_solver_does() {
        let (normal, dense) = example();
        let factor = normal.factor(0.0).expect("positive");
        let mut x: Vec<f64> = (0..6).map(|i| f64::from(i) - 2.0).collect();
        let expected = dense.clone().lu().solve(&DVector::from_vec(x.clone())).expect("regular");
        factor.solve(&mut x);
        assert!((DVector::from_vec(x) - expected).norm() < 1e-12);
        let (ours, inverse) = (factor.inverse(), dense.try_inverse().expect("regular"));
        for c in 0..6 {
            for a in std::iter::once(c).chain(normal.chain(c)) {
                assert!((ours[c * 6 + a] - inverse[(c, a)]).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn what_is_not_positive_is_refused() {
        let mut normal = Normal::new(vec![None, Some(0)]);
        normal.add(0, 0, 1.0);
        normal.add(1, 1, 1.0);
        normal.add(1, 0, 2.0);
        assert!(normal.factor(0.0).is_none());
    }
}
