//! Normal equations of a tree: only columns on one way to the root meet, and elimination from the leaves keeps it so.
//!
//! Featherstone 2008, "Rigid Body Dynamics Algorithms", table 6.3 (H = LᵀL), and the entries of the inverse that a
//! covariance needs, from the root outwards (Takahashi's recursion on the same pattern). A row holds a column's entries
//! with those above it, nearest first; since these have the rest of the same way above them, all loops run along rows.

/// A value per column, and one per column and each of those above it.
#[derive(Clone, Debug)]
struct Entries {
    diagonal: Vec<f64>,
    rows: Vec<f64>,
}

/// Symmetric equations over columns that form a forest.
#[derive(Clone, Debug)]
pub struct Normal {
    /// The columns above each one, nearest first, one list after the other; and where each list begins.
    ways: Vec<usize>,
    begins: Vec<usize>,
    h: Entries,
    /// Right-hand side: the gradient.
    pub g: Vec<f64>,
}

impl Normal {
    /// Empty equations; `above[c]` is the next column towards the root.
    pub fn new(above: &[Option<usize>]) -> Self {
        let (mut ways, mut begins) = (Vec::new(), vec![0]);
        for &first in above {
            ways.extend(std::iter::successors(first, |&c| above[c]));
            begins.push(ways.len());
        }
        let n = above.len();
        let h = Entries { diagonal: vec![0.0; n], rows: vec![0.0; ways.len()] };
        Self { ways, begins, h, g: vec![0.0; n] }
    }

    /// How many columns there are.
    pub fn len(&self) -> usize {
        self.g.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.g.is_empty()
    }

    /// The columns above one, nearest first.
    pub fn way(&self, column: usize) -> &[usize] {
        &self.ways[self.begins[column]..self.begins[column + 1]]
    }

    /// Add to a column's entry with itself.
    pub fn add(&mut self, column: usize, value: f64) {
        self.h.diagonal[column] += value;
    }

    /// Set a column's entries with itself and with each column above it.
    pub fn set(&mut self, column: usize, value: f64, with: impl Fn(usize) -> f64) {
        self.h.diagonal[column] = value;
        for at in self.begins[column]..self.begins[column + 1] {
            self.h.rows[at] = with(self.ways[at]);
        }
    }

    /// The factor L with H = LᵀL, the diagonal raised by `damping` times itself; `None` where H is not positive.
    pub fn factor(&self, damping: f64) -> Option<Factor<'_>> {
        let mut l = self.h.clone();
        let mut own = Vec::new();
        for k in (0..self.len()).rev() {
            let pivot = l.diagonal[k] + damping * self.h.diagonal[k];
            if pivot.is_nan() || pivot <= 0.0 {
                return None;
            }
            let root = pivot.sqrt();
            l.diagonal[k] = root;
            let row = &mut l.rows[self.begins[k]..self.begins[k + 1]];
            row.iter_mut().for_each(|v| *v /= root);
            own.clear();
            own.extend_from_slice(row);
            for (a, &i) in self.way(k).iter().enumerate() {
                let factor = own[a];
                l.diagonal[i] -= factor * factor;
                let target = &mut l.rows[self.begins[i]..self.begins[i + 1]];
                for (v, other) in target.iter_mut().zip(&own[a + 1..]) {
                    *v -= factor * other;
                }
            }
        }
        Some(Factor { normal: self, l })
    }
}

/// The factor of [`Normal`].
pub struct Factor<'a> {
    normal: &'a Normal,
    l: Entries,
}

impl Factor<'_> {
    fn row(&self, column: usize) -> &[f64] {
        &self.l.rows[self.normal.begins[column]..self.normal.begins[column + 1]]
    }

    /// Solve H x = b in place.
    pub fn solve(&self, b: &mut [f64]) {
        self.half(b);
        for i in 0..self.normal.len() {
            let sum: f64 = self.normal.way(i).iter().zip(self.row(i)).map(|(&j, v)| v * b[j]).sum();
            b[i] = (b[i] - sum) / self.l.diagonal[i];
        }
    }

    /// Solve Lᵀ y = b in place: then |y|² = bᵀ H⁻¹ b.
    pub fn half(&self, b: &mut [f64]) {
        for i in (0..self.normal.len()).rev() {
            b[i] /= self.l.diagonal[i];
            let own = b[i];
            for (&j, v) in self.normal.way(i).iter().zip(self.row(i)) {
                b[j] -= v * own;
            }
        }
    }

    /// The inverse, for every column with itself and those above it.
    pub fn inverse(&self) -> Inverse {
        let (n, begins) = (self.normal.len(), &self.normal.begins);
        let mut z = Entries { diagonal: vec![0.0; n], rows: vec![0.0; self.l.rows.len()] };
        let (mut share, mut sums) = (Vec::new(), Vec::new());
        for i in 0..n {
            let pivot = self.l.diagonal[i];
            share.clear();
            share.extend(self.row(i).iter().map(|v| v / pivot));
            sums.clear();
            sums.resize(share.len(), 0.0);
            for (a, &k) in self.normal.way(i).iter().enumerate() {
                let above = &z.rows[begins[k]..begins[k + 1]];
                let mut own = share[a] * z.diagonal[k];
                for (b, entry) in above.iter().enumerate() {
                    sums[a + 1 + b] += share[a] * entry;
                    own += share[a + 1 + b] * entry;
                }
                sums[a] += own;
            }
            for (entry, sum) in z.rows[begins[i]..begins[i + 1]].iter_mut().zip(&sums) {
                *entry = -sum;
            }
            z.diagonal[i] = 1.0 / (pivot * pivot) + share.iter().zip(&sums).map(|(u, s)| u * s).sum::<f64>();
        }
        Inverse { z, begins: begins.clone() }
    }
}

/// Entries of the inverse of [`Normal`].
pub struct Inverse {
    z: Entries,
    begins: Vec<usize>,
}

impl Inverse {
    /// The entry of a column with itself.
    pub fn diagonal(&self, column: usize) -> f64 {
        self.z.diagonal[column]
    }

    /// The entries of a column with those above it, nearest first.
    pub fn row(&self, column: usize) -> &[f64] {
        &self.z.rows[self.begins[column]..self.begins[column + 1]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};

    fn example() -> (Normal, DMatrix<f64>) {
        let mut normal = Normal::new(&[None, Some(0), Some(1), Some(1), Some(0), Some(4)]);
        let mut dense = DMatrix::zeros(6, 6);
        for c in 0..6 {
            let entry = |a: usize| 0.7 - 0.2 * a as f64 + 0.1 * c as f64;
            normal.set(c, 5.0 + c as f64, entry);
            dense[(c, c)] = 5.0 + c as f64;
            for &a in normal.way(c) {
                (dense[(c, a)], dense[(a, c)]) = (entry(a), entry(a));
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
            assert!((ours.diagonal(c) - inverse[(c, c)]).abs() < 1e-12);
            for (&a, entry) in normal.way(c).iter().zip(ours.row(c)) {
                assert!((entry - inverse[(c, a)]).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn what_is_not_positive_is_refused() {
        let mut normal = Normal::new(&[None, Some(0)]);
        normal.set(0, 1.0, |_| 0.0);
        normal.set(1, 1.0, |_| 2.0);
        assert!(normal.factor(0.0).is_none());
    }
}
