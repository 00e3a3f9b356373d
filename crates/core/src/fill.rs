//! Ways to fill a marker's gap from its neighbours: each a function of the gap and of what surrounds it.
//!
//! The donor's path (pattern), the rigid frame, distances held near it (links; damped least squares), ridge regression in
//! the neighbours' frame (low rank; cf. Gløersen & Federolf 2016), and moments in which the neighbours stood alike
//! (cyclic). What they tell is led into the samples on both sides by fading out what it is off there. Lengths in mm.

use crate::skeleton::kinematics::best_turn;
use crate::track::body::rotation::align;
use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, Vector3};
use std::ops::Range;

/// Ridge of the regression, relative to the mean variance of the features, and noise of a sample (mm).
const RIDGE: f64 = 0.02;
const NOISE_MM: f64 = 0.7;
/// Moments averaged by the cyclic way, and how many it chooses from at most.
const ALIKE: usize = 6;
const MOMENTS: usize = 240;
/// Samples beside the gap from which is told what a prediction is off.
const LEADING: i64 = 3;
/// Steps of the links' search, and how far they may pull a marker from its rigid place (mm, standard deviation).
const ROUNDS: usize = 6;
const HELD_MM: f64 = 15.0;
/// Frames to learn from, at least.
const FEW: usize = 8;

/// The ways.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// The path of the most rigid neighbour, shifted.
    Pattern,
    /// The place in the rigid frame of the neighbours, as it was on both sides.
    Rigid,
    /// The place that keeps the distances to the neighbours, held near the rigid one.
    Links,
    /// The place in the neighbours' frame as it goes with how they stand to each other.
    Regression,
    /// The place in the neighbours' frame at the moments in which they stood most alike.
    Cyclic,
}

/// A marker in the frame of its neighbours, in the frames in which all of these are seen.
pub struct Around<'a> {
    /// Numbers of the frames, ascending.
    pub frames: &'a [i64],
    /// The marker (world), and in the neighbours' frame; NaN where it is not seen.
    pub world: &'a [[f64; 3]],
    /// See above.
    pub local: &'a [[f64; 3]],
    /// The neighbours in their frame, one after the other, `3 * neighbours` for each frame.
    pub features: &'a [f64],
    /// The neighbours (world), so many for each frame.
    pub neighbours: &'a [[f64; 3]],
    /// From the neighbours' frame to the world, row by row, and the frame's origin.
    pub turn: &'a [[f64; 9]],
    /// See above.
    pub middle: &'a [[f64; 3]],
}

/// A gap from frame `first` to before `last`, and the rows that may be learned from.
pub struct Gap<'a> {
    /// What surrounds it.
    pub around: &'a Around<'a>,
    /// First frame.
    pub first: i64,
    /// One past the last.
    pub last: i64,
    /// Rows of the surroundings.
    pub learn: &'a [i64],
}

impl Around<'_> {
    fn rows(&self, first: i64, last: i64) -> Range<usize> {
        self.frames.partition_point(|&f| f < first)..self.frames.partition_point(|&f| f < last)
    }

    fn per_frame(&self) -> usize {
        self.neighbours.len() / self.frames.len().max(1)
    }

    fn neighbour(&self, row: usize, which: usize) -> Vector3<f64> {
        Vector3::from(self.neighbours[row * self.per_frame() + which])
    }

    fn features(&self, row: usize) -> &[f64] {
        let width = 3 * self.per_frame();
        &self.features[row * width..(row + 1) * width]
    }

    fn to_world(&self, row: usize, local: &Vector3<f64>) -> Vector3<f64> {
        Matrix3::from_row_slice(&self.turn[row]) * local + Vector3::from(self.middle[row])
    }

    fn is_seen(&self, row: usize) -> bool {
        self.world[row].iter().all(|v| v.is_finite())
    }
}

/// The places of a marker within its gap; `None` where this way cannot tell them.
pub fn fill(way: Way, gap: &Gap) -> Option<Vec<Vector3<f64>>> {
    let around = gap.around;
    let needed = match way {
        Way::Pattern => 0,
        Way::Rigid | Way::Links => FEW,
        Way::Regression | Way::Cyclic => 3 * FEW,
    };
    if around.per_frame() == 0 || gap.learn.len() < needed {
        return None;
    }
    match way {
        Way::Pattern => led(gap, |row| around.neighbour(row, 0)),
        Way::Rigid => rigid(gap),
        Way::Links => Some(links(gap, rigid(gap)?)),
        Way::Regression => regression(gap),
        Way::Cyclic => cyclic(gap),
    }
}

/// A prediction led into the samples on both sides: what it is off there fades over the gap.
fn led(gap: &Gap, predict: impl Fn(usize) -> Vector3<f64>) -> Option<Vec<Vector3<f64>>> {
    let around = gap.around;
    let rows = around.rows(gap.first, gap.last);
    let before = around.rows(gap.first - LEADING, gap.first).rev().find(|&r| around.is_seen(r))?;
    let after = around.rows(gap.last, gap.last + LEADING).find(|&r| around.is_seen(r))?;
    if rows.len() as i64 != gap.last - gap.first {
        return None;
    }
    let off = |row: usize| Vector3::from(around.world[row]) - predict(row);
    let (off_before, off_after) = (off(before), off(after));
    let length = (gap.last - gap.first + 1) as f64;
    let place = |row: usize| {
        let share = (around.frames[row] - gap.first + 1) as f64 / length;
        predict(row) + off_before * (1.0 - share) + off_after * share
    };
    Some(rows.map(place).collect())
}

fn rigid(gap: &Gap) -> Option<Vec<Vector3<f64>>> {
    let around = gap.around;
    let away = |&row: &i64| {
        let frame = around.frames[row as usize];
        (frame - gap.first).abs().min((frame - gap.last).abs()) as f64
    };
    let reach = (gap.learn.iter().map(away).fold(0.0, f64::max) / 4.0).max(1.0);
    let (mut place, mut total) = (Vector3::zeros(), 0.0);
    for row in gap.learn {
        let weight = (-away(row) / reach).exp();
        place += Vector3::from(around.local[*row as usize]) * weight;
        total += weight;
    }
    let place = place / total;
    led(gap, |row| around.to_world(row, &place))
}

fn links(gap: &Gap, start: Vec<Vector3<f64>>) -> Vec<Vector3<f64>> {
    let around = gap.around;
    let count = gap.learn.len() as f64;
    let known: Vec<(f64, f64)> = (0..around.per_frame())
        .map(|k| {
            let apart =
                |&row: &i64| (around.neighbour(row as usize, k) - Vector3::from(around.world[row as usize])).norm();
            let mean = gap.learn.iter().map(apart).sum::<f64>() / count;
            let variance = gap.learn.iter().map(|row| (apart(row) - mean).powi(2)).sum::<f64>() / count;
            (mean, variance.sqrt().max(NOISE_MM))
        })
        .collect();
    let pulled = |(row, start): (usize, Vector3<f64>)| {
        let mut found = start;
        for _ in 0..ROUNDS {
            let mut normal = Matrix3::identity() / (HELD_MM * HELD_MM);
            let mut gradient = (found - start) / (HELD_MM * HELD_MM);
            for (k, (mean, sd)) in known.iter().enumerate() {
                let ray = found - around.neighbour(row, k);
                let length = ray.norm().max(1e-6);
                let direction = ray / (length * sd);
                normal += direction * direction.transpose();
                gradient += direction * ((length - mean) / sd);
            }
            let Some(factor) = normal.cholesky() else { break };
            found -= factor.solve(&gradient);
        }
        found
    };
    around.rows(gap.first, gap.last).zip(start).map(pulled).collect()
}

fn regression(gap: &Gap) -> Option<Vec<Vector3<f64>>> {
    let around = gap.around;
    let (width, count) = (3 * around.per_frame(), gap.learn.len() as f64);
    let (mut mean, mut middle) = (DVector::<f64>::zeros(width), Vector3::zeros());
    for &row in gap.learn {
        mean.iter_mut().zip(around.features(row as usize)).for_each(|(m, f)| *m += f / count);
        middle += Vector3::from(around.local[row as usize]) / count;
    }
    let centred = DMatrix::from_fn(width, gap.learn.len(), |k, i| around.features(gap.learn[i] as usize)[k] - mean[k]);
    let places = DMatrix::from_fn(gap.learn.len(), 3, |i, k| around.local[gap.learn[i] as usize][k] - middle[k]);
    let mut covariance = &centred * centred.transpose() / count;
    let strength = RIDGE * covariance.trace() / width as f64 + NOISE_MM * NOISE_MM * width as f64 / count;
    (0..width).for_each(|k| covariance[(k, k)] += strength);
    let weights = covariance.cholesky()?.solve(&(centred * places / count));
    led(gap, |row| {
        let mut local = middle;
        for (k, (feature, mean)) in around.features(row).iter().zip(mean.iter()).enumerate() {
            (0..3).for_each(|c| local[c] += (feature - mean) * weights[(k, c)]);
        }
        around.to_world(row, &local)
    })
}

fn cyclic(gap: &Gap) -> Option<Vec<Vector3<f64>>> {
    let around = gap.around;
    let learn: Vec<usize> =
        gap.learn.iter().step_by((gap.learn.len() / MOMENTS).max(1)).map(|&row| row as usize).collect();
    let (width, count) = (3 * around.per_frame(), learn.len() as f64);
    let spread: Vec<f64> = (0..width)
        .map(|k| {
            let mean = learn.iter().map(|&r| around.features(r)[k]).sum::<f64>() / count;
            let variance = learn.iter().map(|&r| (around.features(r)[k] - mean).powi(2)).sum::<f64>() / count;
            variance.sqrt() + NOISE_MM
        })
        .collect();
    let scaled = |row: usize| -> Vec<f64> { around.features(row).iter().zip(&spread).map(|(f, s)| f / s).collect() };
    let known: Vec<(Vec<f64>, Vector3<f64>)> =
        learn.iter().map(|&r| (scaled(r), Vector3::from(around.local[r]))).collect();
    led(gap, |row| {
        let asked = scaled(row);
        let apart = |known: &[f64]| known.iter().zip(&asked).map(|(a, b)| (a - b) * (a - b)).sum::<f64>();
        let mut near: Vec<(f64, usize)> = known.iter().enumerate().map(|(i, (k, _))| (apart(k), i)).collect();
        if near.len() > ALIKE {
            near.select_nth_unstable_by(ALIKE, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            near.truncate(ALIKE);
            near.sort_unstable_by_key(|n| n.1);
        }
        let weight = |n: &(f64, usize)| 1.0 / (n.0 + 0.1);
        let place = near.iter().map(|n| known[n.1].1 * weight(n)).sum::<Vector3<f64>>();
        around.to_world(row, &(place / near.iter().map(weight).sum::<f64>()))
    })
}

/// The frame of the neighbours at one moment: from it to the world by `turn` and `middle`, and where they are in it.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// From the neighbours' frame to the world.
    pub turn: Rotation3<f64>,
    /// Their middle (world).
    pub middle: Vector3<f64>,
}

/// The frames of neighbours (`count` for each moment) against those of one of the moments, `reference`: the rotations
/// that bring it nearest to each (Kabsch 1976).
pub fn frames_of(neighbours: &[Vector3<f64>], count: usize, reference: usize) -> Vec<Frame> {
    let moments: Vec<&[Vector3<f64>]> = neighbours.chunks_exact(count.max(1)).collect();
    let Some(first) = moments.get(reference) else { return Vec::new() };
    let middle = |points: &[Vector3<f64>]| points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    let about = |points: &[Vector3<f64>]| -> Vec<Vector3<f64>> {
        let middle = middle(points);
        points.iter().map(|p| p - middle).collect()
    };
    let first = about(first);
    let mut last = None;
    let mut frame = |points: &&[Vector3<f64>]| {
        let turn = turn_onto(&first, &about(points), last);
        last = Some(turn);
        Frame { turn, middle: middle(points) }
    };
    moments.iter().map(&mut frame).collect()
}

/// From moment to moment bodies hardly turn; where they do, the search is done without a guess.
fn turn_onto(reference: &[Vector3<f64>], points: &[Vector3<f64>], guess: Option<Rotation3<f64>>) -> Rotation3<f64> {
    let moments: Matrix3<f64> = points.iter().zip(reference).map(|(p, r)| p * r.transpose()).sum();
    let near = guess.map(|guess| align(reference, points, &vec![1.0; points.len()], guess));
    near.filter(|r| is_best(r, &moments)).unwrap_or_else(|| best_turn(&moments))
}

/// Whether no small turn would bring the points nearer: the moments turned back are symmetric, and positive enough.
fn is_best(turn: &Rotation3<f64>, moments: &Matrix3<f64>) -> bool {
    let back = turn.inverse() * moments;
    let firm = Matrix3::identity() * back.trace() - 0.5 * (back + back.transpose());
    (back - back.transpose()).norm() < 1e-9 * back.norm() && firm.cholesky().is_some()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::random::Random;
    use approx::assert_relative_eq;

    #[test]
    fn turns_are_found_over_jumps_too() {
        let mut random = Random::new(5, 0);
        let points: Vec<Vector3<f64>> = (0..5).map(|_| random.in_box(&Vector3::repeat(300.0))).collect();
        let truth: Vec<Rotation3<f64>> = (0..300)
            .map(|f| Rotation3::new(random.in_box(&Vector3::repeat(if f % 50 == 0 { 6.0 } else { 0.1 }))))
            .scan(Rotation3::identity(), |at, step| {
                *at = step * *at;
                Some(*at)
            })
            .collect();
        let moved: Vec<Vector3<f64>> = truth.iter().flat_map(|t| points.iter().map(move |p| t * p)).collect();
        for (found, now) in frames_of(&moved, 5, 0).iter().zip(&truth) {
            assert_relative_eq!((found.turn * truth[0]).matrix(), now.matrix(), epsilon = 1e-6);
        }
    }
}
