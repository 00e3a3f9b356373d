//! What speaks for every marker at every point of a frame, given where the others are, and the best assignment of it.

use super::model::{Around, Model};
use crate::assignment::assign;
use nalgebra::Vector3;

/// Rounds of naming given the names of the round before, at most.
const ROUNDS: usize = 5;
/// A marker's nearest neighbours, of which some are missing: those farther off seldom speak for it.
const HEARD: usize = 10;

/// The points of a frame and their distances.
pub struct Frame<'a> {
    /// Places (m).
    pub points: &'a [Vector3<f64>],
    distances: Vec<f64>,
}

impl<'a> Frame<'a> {
    /// A frame of points.
    pub fn new(points: &'a [Vector3<f64>]) -> Self {
        let n = points.len();
        let mut distances = vec![0.0; n * n];
        for p in 0..n {
            for q in p + 1..n {
                let d = (points[p] - points[q]).norm();
                distances[p * n + q] = d;
                distances[q * n + p] = d;
            }
        }
        Self { points, distances }
    }

    /// Distance of two points (m).
    pub fn distance(&self, p: usize, q: usize) -> f64 {
        self.distances[p * self.points.len() + q]
    }
}

/// Who is where: of each marker its point.
pub type Names = Vec<Option<usize>>;

/// What is known of a marker's place, given where the others are.
pub fn around(model: &Model, frame: &Frame, names: &Names, marker: usize) -> Around {
    model.around(marker, frame.points, |o| names[o])
}

/// What speaks for a marker at a point; whoever else is thought to be there does not speak.
pub fn at(around: &Around, frame: &Frame, point: usize) -> f64 {
    around.evidence(point, &frame.points[point], |q| frame.distance(point, q))
}

/// What speaks for a marker at a point, given where the others are.
pub fn at_point(model: &Model, frame: &Frame, names: &Names, marker: usize, point: usize) -> f64 {
    at(&around(model, frame, names, marker), frame, point)
}

/// What speaks for every marker (row) at every point (column).
pub fn table(model: &Model, frame: &Frame, names: &Names) -> Vec<f64> {
    let points = frame.points.len();
    let mut values = Vec::with_capacity(model.len() * points);
    for marker in 0..model.len() {
        let around = around(model, frame, names, marker);
        values.extend((0..points).map(|point| at(&around, frame, point)));
    }
    values
}

/// The assignment of markers (rows) to points with the largest sum, each point once; only values above `least` count.
pub fn best(values: &[f64], markers: usize, points: usize, least: f64) -> Names {
    let mut names = vec![None; markers];
    let candidates = |m: usize| (0..points).filter(move |&p| values[m * points + p] > least);
    // Markers that compete for points, directly or through others, are decided together.
    let mut group: Vec<usize> = (0..markers + points).collect();
    for m in 0..markers {
        for p in candidates(m) {
            let (a, b) = (root(&mut group, m), root(&mut group, markers + p));
            group[a.max(b)] = a.min(b);
        }
    }
    let mut members: Vec<(usize, usize)> = (0..markers + points).map(|i| (root(&mut group, i), i)).collect();
    members.sort_unstable();
    for part in members.chunk_by(|a, b| a.0 == b.0) {
        let rows: Vec<usize> = part.iter().map(|x| x.1).filter(|&i| i < markers).collect();
        let columns: Vec<usize> = part.iter().map(|x| x.1).filter(|&i| i >= markers).map(|i| i - markers).collect();
        let value = |r: usize, c: usize| values[rows[r] * points + columns[c]];
        if rows.len() == 1 && columns.len() == 1 {
            names[rows[0]] = Some(columns[0]);
            continue;
        }
        let found = assign(rows.len(), columns.len(), |r, c| (value(r, c) > least).then(|| least - value(r, c)));
        for (r, c) in found.into_iter().enumerate() {
            names[rows[r]] = c.map(|c| columns[c]);
        }
    }
    names
}

fn root(group: &mut [usize], mut i: usize) -> usize {
    while group[i] != i {
        group[i] = group[group[i]];
        i = group[i];
    }
    i
}

/// How many markers stand on their side of a triangle of others, and how many do not: in a mirror image none do.
pub fn sides(model: &Model, names: &Names, points: &[Vector3<f64>]) -> [usize; 2] {
    let place = |m: usize| names[m].map(|p| points[p]);
    let side = |m: usize| model.is_on_its_side(m, &place(m)?, place);
    (0..model.len()).filter_map(side).fold(
        [0, 0],
        |[right, wrong], on_it| {
            if on_it { [right + 1, wrong] } else { [right, wrong + 1] }
        },
    )
}

/// Names of a frame and what speaks for every marker at every point, given the names.
#[derive(Clone)]
pub struct Naming {
    /// Who is where.
    pub names: Names,
    /// What speaks for every marker (row) at every point (column).
    pub values: Vec<f64>,
    /// What speaks for all names together.
    pub sum: f64,
}

impl Naming {
    /// Names as they are.
    pub fn new(model: &Model, frame: &Frame, names: Names) -> Self {
        let values = table(model, frame, &names);
        let mut naming = Self { names, values, sum: 0.0 };
        naming.add_up(frame);
        naming
    }

    fn add_up(&mut self, frame: &Frame) {
        let points = frame.points.len();
        self.sum = self.names.iter().enumerate().filter_map(|(m, p)| p.map(|p| self.values[m * points + p])).sum();
    }

    /// What speaks for a marker where it is.
    pub fn of(&self, frame: &Frame, marker: usize) -> Option<f64> {
        self.names[marker].map(|p| self.values[marker * frame.points.len() + p])
    }

    /// How many markers stand on their side of a triangle of others, and how many do not.
    pub fn sides(&self, model: &Model, frame: &Frame) -> [usize; 2] {
        sides(model, &self.names, frame.points)
    }

    /// Take other names: only what the changed ones bear on is weighed again.
    pub fn take(&mut self, model: &Model, frame: &Frame, names: Names) {
        let points = frame.points.len();
        let changed: Vec<bool> = names.iter().zip(&self.names).map(|(a, b)| a != b).collect();
        self.names = names;
        for marker in 0..model.len() {
            let mut heard = model.near(marker).iter().take(HEARD).any(|&o| changed[o]);
            heard |= changed[marker];
            if heard {
                let around = around(model, frame, &self.names, marker);
                let row = &mut self.values[marker * points..(marker + 1) * points];
                row.iter_mut().enumerate().for_each(|(point, value)| *value = at(&around, frame, point));
            }
        }
        self.add_up(frame);
    }

    /// Name anew, each marker by where the others are, until nothing changes.
    pub fn settle(&mut self, model: &Model, frame: &Frame) {
        for _ in 0..ROUNDS {
            let next = best(&self.values, model.len(), frame.points.len(), 0.0);
            if next == self.names {
                break;
            }
            self.take(model, frame, next);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::label::learn::{Said, learn};
    use crate::label::model::Model;
    use crate::label::search::{Plan, search_all};
    use crate::synth::body::{Body, Motion};
    use crate::synth::random::Random;

    const MARKERS: usize = 30;

    fn dancer(seconds: f64) -> Vec<Vector3<f64>> {
        Body::new(Motion::Dance, MARKERS, 7, Vector3::zeros()).pose(seconds).markers_m
    }

    fn model() -> Model {
        let frames: Vec<_> = (0..800).map(|i| dancer(f64::from(i) * 0.02).into_iter().map(Some).collect()).collect();
        let learned = learn(&frames, &[Said::Unknown; MARKERS * MARKERS], 30.0, 0.001);
        Model::new(vec![0; MARKERS], &learned.distances, &learned.heights)
    }

    #[test]
    fn the_best_assignment_is_that_of_all_assignments() {
        let mut random = Random::new(4, 0);
        for _ in 0..200 {
            let values: Vec<f64> = (0..12).map(|_| random.between(-3.0, 3.0)).collect();
            let gain =
                |names: &Names| names.iter().enumerate().filter_map(|(m, p)| p.map(|p| values[m * 4 + p])).sum::<f64>();
            let mut most = 0.0_f64;
            let places: Vec<Option<usize>> = [None].into_iter().chain((0..4).map(Some)).collect();
            for &a in &places {
                for &b in &places {
                    for &c in &places {
                        let names = vec![a, b, c];
                        let mut taken: Vec<usize> = names.iter().flatten().copied().collect();
                        taken.sort_unstable();
                        taken.dedup();
                        if taken.len() == names.iter().flatten().count() {
                            most = most.max(gain(&names));
                        }
                    }
                }
            }
            assert!((gain(&best(&values, 3, 4, 0.0)) - most).abs() < 1e-9);
        }
    }

    #[test]
    fn a_frame_is_named_without_history_in_any_order_and_place() {
        let model = model();
        let plans = [Plan::new(&model, 0)];
        let mut random = Random::new(1, 0);
        for k in 0..20 {
            let shift = Vector3::new(random.between(-3.0, 3.0), random.between(-3.0, 3.0), 0.0);
            let start = random.below(MARKERS);
            let dancer = dancer(16.0 + 0.37 * f64::from(k));
            let points: Vec<_> = (0..MARKERS).map(|i| dancer[(i + start) % MARKERS] + shift).collect();
            let frame = Frame::new(&points);
            let found = search_all(&model, &plans, &frame);
            let right = (0..MARKERS).filter(|&m| found.names[m] == Some((m + MARKERS - start) % MARKERS)).count();
            assert!(right >= MARKERS - 1, "frame {k}: {right} of {MARKERS}");
            let mirrored: Vec<_> = points.iter().map(|p| Vector3::new(-p.x, p.y, p.z)).collect();
            let [on, off] = search_all(&model, &plans, &Frame::new(&mirrored)).sides(&model, &Frame::new(&mirrored));
            assert!(off > on);
        }
    }

    #[test]
    fn what_was_weighed_bit_by_bit_is_what_is_weighed_at_once() {
        let model = model();
        let points = dancer(3.0);
        let frame = Frame::new(&points);
        let mut naming = Naming::new(&model, &frame, (0..MARKERS).map(Some).collect());
        let mut names = naming.names.clone();
        names.swap(3, 18);
        names[7] = None;
        naming.take(&model, &frame, names.clone());
        let anew = Naming::new(&model, &frame, names);
        let off = naming.values.iter().zip(&anew.values).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 1e-9, "{off}");
    }
}
