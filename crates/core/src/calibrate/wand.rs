//! Calibration objects: a few markers at known places on something rigid.

use nalgebra::{Matrix3, SymmetricEigen, Vector3};

/// Relative extent below which a direction counts as flat: a wand of 240 mm whose markers are 2 mm off a plane is flat.
const FLAT: f64 = 0.02;

/// How many directions the markers of an object span.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Span {
    /// A single marker.
    Point,
    /// All markers on a line.
    Line,
    /// All markers in a plane.
    Plane,
    /// Markers in all three directions.
    Solid,
}

/// A wand: its markers in axes of its own, the centroid at the origin, the longest extent along x, the shortest along z.
#[derive(Clone, Debug)]
pub struct Wand {
    /// Marker places (m) in the wand's axes.
    pub markers_m: Vec<Vector3<f64>>,
    /// What the markers span.
    pub span: Span,
}

impl Wand {
    /// A wand from marker places (m) in any axes. `None` without markers or with two at one place.
    pub fn new(markers_m: &[Vector3<f64>]) -> Option<Self> {
        let n = markers_m.len();
        let apart = |i: usize, j: usize| (markers_m[i] - markers_m[j]).norm() > 1e-6;
        if n == 0 || !(0..n).all(|i| (i + 1..n).all(|j| apart(i, j))) {
            return None;
        }
        let middle = markers_m.iter().sum::<Vector3<f64>>() / n as f64;
        let scatter: Matrix3<f64> = markers_m.iter().map(|p| (p - middle) * (p - middle).transpose()).sum();
        let eigen = SymmetricEigen::new(scatter);
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        let axes: [Vector3<f64>; 2] = [0, 1].map(|k| eigen.eigenvectors.column(order[k]).into_owned());
        let local_from_given =
            Matrix3::from_rows(&[axes[0].transpose(), axes[1].transpose(), axes[0].cross(&axes[1]).transpose()]);
        let extent = |k: usize| eigen.eigenvalues[order[k]].max(0.0).sqrt();
        let span = match n {
            1 => Span::Point,
            _ if extent(1) < FLAT * extent(0) => Span::Line,
            _ if extent(2) < FLAT * extent(0) => Span::Plane,
            _ => Span::Solid,
        };
        Some(Self { markers_m: markers_m.iter().map(|p| local_from_given * (p - middle)).collect(), span })
    }

    /// Largest distance of two markers (m); 0 for a single one.
    pub fn length_m(&self) -> f64 {
        self.pairs().map(|(i, j)| (self.markers_m[i] - self.markers_m[j]).norm()).fold(0.0, f64::max)
    }

    /// All pairs of markers.
    pub fn pairs(&self) -> impl Iterator<Item = (usize, usize)> + use<> {
        let n = self.markers_m.len();
        (0..n).flat_map(move |i| (i + 1..n).map(move |j| (i, j)))
    }

    /// Whether the wand looks the same from its other end: markers 0…n−1 at the places of n−1…0.
    ///
    /// Only a line can be: then no single view tells its ends apart. Gives the other naming.
    pub fn other_naming(&self) -> Option<Vec<usize>> {
        if self.span != Span::Line {
            return None;
        }
        let x = |i: usize| self.markers_m[i].x;
        let tolerance = FLAT * self.length_m();
        let middle = (0..self.markers_m.len()).map(x).fold(f64::MIN, f64::max)
            + (0..self.markers_m.len()).map(x).fold(f64::MAX, f64::min);
        (0..self.markers_m.len())
            .map(|i| (0..self.markers_m.len()).find(|&j| (middle - x(i) - x(j)).abs() < tolerance))
            .collect()
    }

    /// Number of parameters of a pose that views can tell: 3 for a point, 5 for a line, 6 otherwise.
    pub fn pose_freedom(&self) -> usize {
        match self.span {
            Span::Point => 3,
            Span::Line => 5,
            Span::Plane | Span::Solid => 6,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wand(mm: &[[f64; 3]]) -> Wand {
        Wand::new(&mm.iter().map(|p| Vector3::from(*p) / 1000.0).collect::<Vec<_>>()).unwrap()
    }

    #[test]
    fn spans_are_told_and_distances_kept() {
        let t = wand(&[[-80.0, 0.0, 0.0], [0.0; 3], [160.0, 0.0, 0.0], [0.0, 120.0, 0.0], [0.0, 240.0, 0.0]]);
        assert_eq!(t.span, Span::Plane);
        assert!((t.length_m() - 0.08f64.hypot(0.24).max(0.16f64.hypot(0.24))).abs() < 1e-12);
        assert!(t.markers_m.iter().all(|p| p.z.abs() < 1e-12));
        assert_eq!(wand(&[[0.0; 3], [0.0, 0.0, 500.0]]).span, Span::Line);
        assert_eq!(wand(&[[5.0; 3]]).span, Span::Point);
        assert_eq!(wand(&[[0.0; 3], [300.0, 0.0, 0.0], [0.0, 200.0, 0.0], [0.0, 0.0, 100.0]]).span, Span::Solid);
        assert!(Wand::new(&[Vector3::zeros(), Vector3::zeros()]).is_none());
    }

    #[test]
    fn only_a_line_with_equal_ends_has_another_naming() {
        assert_eq!(wand(&[[0.0; 3], [500.0, 0.0, 0.0]]).other_naming(), Some(vec![1, 0]));
        assert_eq!(wand(&[[0.0; 3], [250.0, 0.0, 0.0], [500.0, 0.0, 0.0]]).other_naming(), Some(vec![2, 1, 0]));
        assert_eq!(wand(&[[0.0; 3], [200.0, 0.0, 0.0], [600.0, 0.0, 0.0]]).other_naming(), None);
    }
}
