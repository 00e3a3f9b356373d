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
