//! Which dots of one image are the wand, and which marker each is; nothing of the cameras is known.
//!
//! A small object far away is seen by an affine camera, nearly: a basis of its markers (2 on a line, 3 in a plane, 4 in
//! space) laid on dots says where the others must be. What fits is then fitted with perspective, whose strength is
//! bounded by the object being no larger than a good part of its distance; the fit must hold to a small part of the
//! object's image, and no other naming may fit nearly as well (a plane seen from its edge is ambiguous).

use super::wand::Wand;
use nalgebra::{DMatrix, DVector, Vector2};

/// How far a marker may lie from its affine place, relative to the object's image: perspective moves it.
const AFFINE: f64 = 0.15;
/// Largest rms misfit of the perspective fit, relative to the object's image, and what is always allowed (px).
const FITS: f64 = 0.015;
const FITS_PX: f64 = 1.0;
/// The object's size over its distance: one standard deviation of what perspective may be.
const NEARNESS: f64 = 0.25;
/// A second naming must fit this many times worse.
const CLEARLY: f64 = 3.0;
/// With more dots than this in a view, namings by chance come too often (and cost the fourth power).
const MOST_DOTS: usize = 24;

/// What is in a view.
#[derive(Clone, Debug, PartialEq)]
pub enum Found {
    /// The whole object is not there, or it is not clear which dot is which marker.
    Nothing,
    /// The dot of each marker.
    Whole(Vec<usize>),
    /// Two objects or more, of different dots.
    Several,
}

/// An object prepared for looking: basis markers and where the others lie in terms of them.
pub struct Pattern {
    basis: Vec<usize>,
    others: Vec<(usize, Vec<f64>)>,
    /// Coordinates along the spanned directions, relative to the object's length.
    local: Vec<Vec<f64>>,
    ambiguous: bool,
}

impl Pattern {
    /// Prepares an object; one whose ends look alike is named from either end at will.
    pub fn new(wand: &Wand) -> Self {
        let span = wand.span as usize;
        let length = wand.length_m().max(1e-9);
        let local: Vec<Vec<f64>> =
            wand.markers_m.iter().map(|p| p.iter().take(span).map(|v| v / length).collect()).collect();
        let basis = widest_basis(&local, span + 1);
        let others = (0..local.len())
            .filter(|i| !basis.contains(i))
            .filter_map(|i| Some((i, combination(&local, &basis, i)?)))
            .collect();
        Self { basis, others, local, ambiguous: wand.other_naming().is_some() }
    }

    /// What is in a view.
    pub fn find(&self, dots: &[Vector2<f64>]) -> Found {
        let markers = self.local.len();
        if dots.len() < markers || dots.len() > MOST_DOTS {
            return Found::Nothing;
        }
        if self.others.is_empty() && self.local.len() <= 2 {
            return if dots.len() == markers { Found::Whole((0..markers).collect()) } else { Found::Nothing };
        }
        let mut found: Vec<(f64, Vec<usize>)> = Vec::new();
        let mut chosen = Vec::with_capacity(self.basis.len());
        self.lay(dots, &mut chosen, &mut found);
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        let Some((best, naming)) = found.first() else { return Found::Nothing };
        let same = |other: &[usize]| self.ambiguous && other.iter().rev().eq(naming.iter());
        let rivals: Vec<&Vec<usize>> = found[1..]
            .iter()
            .filter(|(misfit, other)| *misfit <= CLEARLY * best && other != naming && !same(other))
            .map(|(_, other)| other)
            .collect();
        if rivals.iter().any(|other| other.iter().all(|dot| !naming.contains(dot))) {
            Found::Several
        } else if rivals.is_empty() {
            Found::Whole(naming.clone())
        } else {
            Found::Nothing
        }
    }

    /// Lays the basis on every ordered choice of dots.
    fn lay(&self, dots: &[Vector2<f64>], chosen: &mut Vec<usize>, found: &mut Vec<(f64, Vec<usize>)>) {
        if chosen.len() == self.basis.len() {
            if let Some(naming) = self.complete(dots, chosen) {
                let (misfit, size) = self.misfit_px(dots, &naming);
                if misfit < (FITS * size).max(FITS_PX) {
                    found.push((misfit.max(0.05 * FITS * size), naming));
                }
            }
            return;
        }
        for dot in 0..dots.len() {
            if !chosen.contains(&dot) {
                chosen.push(dot);
                self.lay(dots, chosen, found);
                chosen.pop();
            }
        }
    }

    /// The nearest free dot to the affine place of every marker outside the basis.
    fn complete(&self, dots: &[Vector2<f64>], chosen: &[usize]) -> Option<Vec<usize>> {
        let size = extent(&chosen.iter().map(|&d| dots[d]));
        let mut naming = vec![usize::MAX; self.local.len()];
        for (marker, dot) in self.basis.iter().zip(chosen) {
            naming[*marker] = *dot;
        }
        for (marker, weights) in &self.others {
            let place: Vector2<f64> = weights.iter().zip(chosen).map(|(w, d)| dots[*d] * *w).sum();
            let free = (0..dots.len()).filter(|d| !naming.contains(d));
            let nearest = free.min_by(|&a, &b| (dots[a] - place).norm().total_cmp(&(dots[b] - place).norm()))?;
            if (dots[nearest] - place).norm() > AFFINE * size {
                return None;
            }
            naming[*marker] = nearest;
        }
        Some(naming)
    }

    /// Rms misfit (px per degree of freedom) of `u = (A p + b) / (1 + q p)` with q bounded; and the image's size (px).
    fn misfit_px(&self, dots: &[Vector2<f64>], naming: &[usize]) -> (f64, f64) {
        let (markers, span) = (self.local.len(), self.local[0].len());
        let size = extent(&naming.iter().map(|&d| dots[d])).max(1e-9);
        let middle = naming.iter().map(|&d| dots[d]).sum::<Vector2<f64>>() / markers as f64;
        let at: Vec<Vector2<f64>> = naming.iter().map(|&d| (dots[d] - middle) / size).collect();
        let unknowns = 3 * span + 2;
        let rows = 2 * markers + span;
        // A p + b − u (q p) = u is linear; the prior on q has the fit's tolerance as unit.
        let mut matrix = DMatrix::zeros(rows, unknowns);
        let mut right = DVector::zeros(rows);
        for (m, u) in at.iter().enumerate() {
            for axis in 0..2 {
                let row = 2 * m + axis;
                for k in 0..span {
                    matrix[(row, axis * (span + 1) + k)] = self.local[m][k];
                    matrix[(row, 2 * span + 2 + k)] = -u[axis] * self.local[m][k];
                }
                matrix[(row, axis * (span + 1) + span)] = 1.0;
                right[row] = u[axis];
            }
        }
        for k in 0..span {
            matrix[(2 * markers + k, 2 * span + 2 + k)] = FITS / NEARNESS;
        }
        let normal = matrix.transpose() * &matrix;
        let Some(solved) = normal.cholesky().map(|c| c.solve(&(matrix.transpose() * &right))) else {
            return (f64::INFINITY, size);
        };
        let freedom = (2 * markers - 2 * span - 2).max(1) as f64;
        (size * ((matrix * solved - right).norm_squared() / freedom).sqrt(), size)
    }
}

fn extent(points: &(impl Iterator<Item = Vector2<f64>> + Clone)) -> f64 {
    let of = |axis: usize| {
        let values = points.clone().map(move |p| p[axis]);
        values.clone().fold(f64::MIN, f64::max) - values.fold(f64::MAX, f64::min)
    };
    of(0).hypot(of(1))
}

/// The `count` markers that span the largest length, area or volume.
fn widest_basis(local: &[Vec<f64>], count: usize) -> Vec<usize> {
    let mut best = (-1.0, Vec::new());
    let mut chosen = Vec::new();
    widest(local, count, 0, &mut chosen, &mut best);
    best.1
}

fn widest(local: &[Vec<f64>], count: usize, from: usize, chosen: &mut Vec<usize>, best: &mut (f64, Vec<usize>)) {
    if chosen.len() == count {
        let edges = DMatrix::from_fn(count - 1, count - 1, |i, k| local[chosen[i + 1]][k] - local[chosen[0]][k]);
        let volume = if count == 1 { 0.0 } else { edges.determinant().abs() };
        if volume > best.0 {
            *best = (volume, chosen.clone());
        }
        return;
    }
    for i in from..local.len() {
        chosen.push(i);
        widest(local, count, i + 1, chosen, best);
        chosen.pop();
    }
}

/// Weights (sum 1) of the basis markers that give marker `i`.
fn combination(local: &[Vec<f64>], basis: &[usize], i: usize) -> Option<Vec<f64>> {
    let n = basis.len();
    let matrix = DMatrix::from_fn(n, n, |row, k| if row + 1 < n { local[basis[k]][row] } else { 1.0 });
    let right = DVector::from_fn(n, |row, _| if row + 1 < n { local[i][row] } else { 1.0 });
    matrix.lu().solve(&right).map(|w| w.iter().copied().collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::random::Random;
    use crate::synth::rigs::looking_at;
    use nalgebra::{Rotation3, Vector3};

    fn t_wand() -> Wand {
        let mm = [[-80.0, 0.0], [0.0, 0.0], [160.0, 0.0], [0.0, 120.0], [0.0, 240.0]];
        Wand::new(&mm.map(|p| Vector3::new(p[0], p[1], 0.0) / 1000.0)).unwrap()
    }

    /// Shares of views named rightly and named wrongly, over random poses with false dots.
    fn named(wand: &Wand, clutter: usize, sigma_px: f64) -> (f64, f64) {
        let camera = looking_at(0, Vector3::new(3.0, 0.0, 1.0), Vector3::zeros(), [1024.0, 1024.0], 1100.0);
        let pattern = Pattern::new(wand);
        let (mut right, mut wrong, tries) = (0, 0, 300);
        let mut random = Random::new(1, 0);
        for _ in 0..tries {
            let turn = Rotation3::new(random.in_box(&Vector3::new(6.0, 6.0, 6.0)));
            let at = random.in_box(&Vector3::new(1.0, 1.0, 1.0));
            let noise = |r: &mut Random| Vector2::new(r.normal(), r.normal()) * sigma_px;
            let mut dots: Vec<Vector2<f64>> =
                wand.markers_m.iter().map(|p| camera.project(&(turn * p + at)).unwrap() + noise(&mut random)).collect();
            dots.extend((0..clutter).map(|_| Vector2::new(random.between(0.0, 1024.0), random.between(0.0, 1024.0))));
            match pattern.find(&dots) {
                Found::Whole(naming) if naming.iter().copied().eq(0..wand.markers_m.len()) => right += 1,
                Found::Whole(_) => wrong += 1,
                Found::Nothing | Found::Several => {}
            }
        }
        (f64::from(right) / f64::from(tries), f64::from(wrong) / f64::from(tries))
    }

    #[test]
    fn a_t_wand_is_found_among_false_dots() {
        let (right, wrong) = named(&t_wand(), 5, 0.2);
        assert!(right > 0.9 && wrong < 0.01, "{right} {wrong}");
    }

    #[test]
    fn two_wands_are_told_to_be_two() {
        let camera = looking_at(0, Vector3::new(3.0, 0.0, 1.0), Vector3::zeros(), [1024.0, 1024.0], 1100.0);
        let wand = t_wand();
        let at = |x: f64| wand.markers_m.iter().map(move |p| Vector3::new(0.0, p.x + x, p.y));
        let dots: Vec<Vector2<f64>> = at(-0.4).chain(at(0.4)).map(|p| camera.project(&p).unwrap()).collect();
        assert_eq!(Pattern::new(&wand).find(&dots), Found::Several);
        assert_eq!(Pattern::new(&wand).find(&dots[..5]), Found::Whole((0..5).collect()));
        assert_eq!(Pattern::new(&wand).find(&dots[..4]), Found::Nothing);
    }

    #[test]
    fn a_line_of_three_is_named_by_its_unequal_parts() {
        let wand = Wand::new(&[0.0, 0.2, 0.6].map(|x| Vector3::new(x, 0.0, 0.0))).unwrap();
        let (right, wrong) = named(&wand, 0, 0.2);
        assert!(right > 0.9 && wrong < 0.02, "{right} {wrong}");
    }
}
