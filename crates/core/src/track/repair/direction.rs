//! Which of two near markers is which, by the direction from the one to the other in the frame of their neighbours.
//!
//! At the end of a limb two markers may sit so near each other that the neighbours cannot place them well enough to tell
//! them apart; but where the one is from the other they still tell, if the joint between does not bend too far.

use super::super::body::Snapshot;
use super::super::body::regression::centered;
use super::super::body::rotation::align;
use super::close::{MEDIAN, median};
use nalgebra::{Matrix3, Rotation3, Vector3};

/// Frames in which the two and their neighbours must have been seen.
const SHARED: usize = 20;
/// Neighbours of which three are a frame.
const CANDIDATES: usize = 5;
/// The direction is told if it lies within this much of a line (cosine) in almost all frames, whichever way it points.
const ALONG: f64 = 0.5;
const ALMOST_ALL: f64 = 0.97;

/// The frame of some neighbours and the middle of the two: as they were when it was first seen.
struct Bearings {
    neighbours: [usize; 3],
    reference: Option<Vec<Vector3<f64>>>,
    rotation: Rotation3<f64>,
}

/// The direction in the frame of some neighbours.
pub(super) struct Direction {
    bearings: Bearings,
    /// From the one to the other (m), and its variance (m² per axis).
    vector: Vector3<f64>,
    variance: f64,
}

impl Bearings {
    /// The vector from the one to the other, turned into this frame.
    fn vector(&mut self, [a, b]: [usize; 2], now: &Snapshot) -> Option<Vector3<f64>> {
        let points: Option<Vec<Vector3<f64>>> = self.neighbours.iter().map(|&n| now[n]).collect();
        let (p, q, mut points) = (now[a]?, now[b]?, points?);
        points.push(0.5 * (p + q));
        let (_, points) = centered(&points);
        let reference = self.reference.get_or_insert_with(|| points.clone());
        self.rotation = align(&points, reference, &vec![1.0; points.len()], self.rotation);
        Some(self.rotation * (q - p))
    }
}

/// The line along which most vectors lie, pointing the way most of them do.
pub(super) fn line_along(vectors: &[Vector3<f64>]) -> Vector3<f64> {
    let moments: Matrix3<f64> = vectors.iter().map(|v| v * v.transpose()).sum();
    let eigen = moments.symmetric_eigen();
    let line = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
    let along = vectors.iter().filter(|v| v.dot(&line) > 0.0).count();
    if 2 * along >= vectors.len() { line } else { -line }
}

/// The directions that tell two apart, by the neighbours that keep their distance best. `places`: frames of the take.
pub(super) fn directions(places: &[&Snapshot], pair: [usize; 2]) -> Vec<Direction> {
    let slots = places.first().map_or(0, |p| p.len());
    let spread = |slot: usize| {
        let distances = pair.map(|p| {
            let all: Vec<f64> = places.iter().filter_map(|s| Some((s[p]? - s[slot]?).norm())).collect();
            let middle = median(all.clone()).filter(|_| all.len() >= SHARED)?;
            median(all.into_iter().map(|d| (d - middle).abs()).collect())
        });
        Some((distances[0]?.max(distances[1]?), slot))
    };
    let mut nearest: Vec<(f64, usize)> = (0..slots).filter(|s| !pair.contains(s)).filter_map(spread).collect();
    nearest.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let best: Vec<usize> = nearest.into_iter().take(CANDIDATES).map(|n| n.1).collect();
    let n = best.len();
    let sets = (0..n).flat_map(|i| (i + 1..n).flat_map(move |j| (j + 1..n).map(move |k| [i, j, k])));
    sets.filter_map(|set| Direction::learned(places, pair, set.map(|i| best[i]))).collect()
}

impl Direction {
    /// From frames of the take; `None` if these neighbours do not tell it.
    fn learned(places: &[&Snapshot], pair: [usize; 2], neighbours: [usize; 3]) -> Option<Self> {
        let mut bearings = Bearings { neighbours, reference: None, rotation: Rotation3::identity() };
        let mut vectors: Vec<Vector3<f64>> = places.iter().filter_map(|now| bearings.vector(pair, now)).collect();
        if vectors.len() < SHARED {
            return None;
        }
        let line = line_along(&vectors);
        let clear = vectors.iter().filter(|v| v.dot(&line).abs() > ALONG * v.norm()).count();
        if (clear as f64) < ALMOST_ALL * vectors.len() as f64 {
            return None;
        }
        vectors.iter_mut().filter(|v| v.dot(&line) < 0.0).for_each(|v| *v = -*v);
        let vector = vectors.iter().sum::<Vector3<f64>>() / vectors.len() as f64;
        let variance = median(vectors.iter().map(|v| (v - vector).norm_squared()).collect())? / MEDIAN;
        Some(Self { bearings, vector, variance })
    }

    /// Evidence that the two are exchanged in a frame (nats); `None` where something is hidden.
    pub(super) fn exchanged(&mut self, pair: [usize; 2], now: &Snapshot) -> Option<f64> {
        Some(-2.0 * self.bearings.vector(pair, now)?.dot(&self.vector) / self.variance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAMES: usize = 300;

    /// A hand of two markers 11 mm apart at the end of an arm of three; the wrist bends by up to an angle; the two are
    /// exchanged in some frames.
    fn places(bends: f64, exchanged: impl Fn(usize) -> bool) -> Vec<Snapshot> {
        let snapshot = |f: usize| {
            let t = f as f64 / 20.0;
            let arm = Rotation3::from_euler_angles(0.7 * t.sin(), 0.4 * t, 0.9 * (0.6 * t).sin());
            let wrist = Rotation3::from_euler_angles(0.0, 0.0, bends * (1.7 * t).sin());
            let away = Vector3::new(0.1 * t, t.sin(), 1.0);
            let of_arm = [[0.0, 0.0, 0.0], [0.2, 0.03, 0.0], [0.1, 0.0, 0.04]].map(|p| arm * Vector3::from(p) + away);
            let of_hand = [[0.06, 0.0, 0.0], [0.065, 0.01, 0.0]]
                .map(|p| arm * (Vector3::new(0.22, 0.0, 0.0) + wrist * Vector3::from(p)) + away);
            let mut now: Snapshot = of_hand.into_iter().chain(of_arm).map(Some).collect();
            if exchanged(f) {
                now.swap(0, 1);
            }
            now
        };
        (0..FRAMES).map(snapshot).collect()
    }

    #[test]
    fn the_arm_tells_who_was_exchanged_at_the_wrist() {
        let swapped = |f: usize| (80..190).contains(&f);
        let places = places(0.6, swapped);
        let mut found = directions(&places.iter().collect::<Vec<_>>(), [0, 1]);
        assert_eq!(found.len(), 1);
        for (f, now) in places.iter().enumerate() {
            let nats = found[0].exchanged([0, 1], now).unwrap();
            assert!((nats > 1.0) == swapped(f) && nats.abs() > 1.0, "frame {f}: {nats}");
        }
        let hidden = vec![places[0][0], places[0][1], None, places[0][3], places[0][4]];
        assert!(found[0].exchanged([0, 1], &hidden).is_none());
    }

    #[test]
    fn where_the_joint_turns_right_round_nothing_is_told() {
        assert!(directions(&places(4.0, |_| false).iter().collect::<Vec<_>>(), [0, 1]).is_empty());
    }
}
