//! Dots of one camera linked from frame to frame, so that a marker's image has a place at any moment between two frames.
//!
//! A dot goes on in the next frame where its own motion says, if that dot's own nearest is this one, and no other dot is
//! nearly as near. Between frames the place is a cubic through the neighbouring frames (Catmull & Rom 1974): its error
//! falls with the third power of the frame's length. Places may be pixels or normalised ones.

use nalgebra::Vector2;
use std::ops::Range;

/// Farthest that a dot goes from where it is expected in one frame, in image widths.
pub const LARGEST_STEP: f64 = 0.05;
/// The second nearest dot must be this many times as far.
const CLEARLY_NEARER: f64 = 2.0;

/// What one camera saw, frame by frame.
#[derive(Clone, Debug)]
pub struct Strands {
    starts: Vec<usize>,
    places: Vec<Vector2<f64>>,
    next: Vec<Option<usize>>,
    previous: Vec<Option<usize>>,
}

/// A dot at a moment between frames: place, and velocity per frame.
#[derive(Clone, Copy, Debug)]
pub struct Moving {
    /// Place.
    pub place: Vector2<f64>,
    /// Its change per frame, over the frames around those between which it lies: so its noise is not the place's.
    pub per_frame: Vector2<f64>,
}

impl Strands {
    /// Links the dots of each frame. None goes farther than `largest` from where it is expected.
    pub fn new(frames: &[Vec<Vector2<f64>>], largest: f64) -> Self {
        let (mut starts, mut places) = (vec![0], Vec::new());
        for dots in frames {
            places.extend(dots);
            starts.push(places.len());
        }
        let n = places.len();
        let mut strands = Self { starts, places, next: vec![None; n], previous: vec![None; n] };
        for frame in 1..frames.len() {
            strands.link(frame - 1, largest);
        }
        strands
    }

    /// Every strand: number of its first frame, and its dots, counted through all frames.
    pub fn all(&self) -> Vec<(usize, Vec<usize>)> {
        let mut found = Vec::new();
        for frame in 0..self.frames() {
            for first in (self.starts[frame]..self.starts[frame + 1]).filter(|d| self.previous[*d].is_none()) {
                found.push((frame, std::iter::successors(Some(first), |d| self.next[*d]).collect()));
            }
        }
        found
    }

    /// Strands put together over gaps of up to `longest` frames: frame and dot (counted through all frames) of each link.
    ///
    /// A strand goes on in the one that begins where its motion leads, if each is clearly the other's nearest.
    pub fn bridged(&self, longest: usize, largest: f64) -> Vec<Vec<(usize, usize)>> {
        let all = self.all();
        let mut follower: Vec<Option<usize>> = vec![None; all.len()];
        let mut is_follower = vec![false; all.len()];
        for gap in 1..=longest {
            let mut begin: Vec<Vec<usize>> = vec![Vec::new(); self.frames()];
            (0..all.len()).filter(|&s| !is_follower[s]).for_each(|s| begin[all[s].0].push(s));
            let mut ends: Vec<Vec<usize>> = vec![Vec::new(); self.frames()];
            for s in (0..all.len()).filter(|&s| follower[s].is_none()) {
                let next = all[s].0 + all[s].1.len() + gap;
                if next < self.frames() {
                    ends[next].push(s);
                }
            }
            for (ends, begin) in ends.iter().zip(&begin) {
                let expected: Vec<Vector2<f64>> = ends.iter().map(|&s| self.beyond(&all[s].1, gap + 1)).collect();
                let begun: Vec<Vector2<f64>> = begin.iter().map(|&s| self.places[all[s].1[0]]).collect();
                for (k, place) in expected.iter().enumerate() {
                    let Some(j) = clearly_nearest(place, &begun, largest) else { continue };
                    if clearly_nearest(&begun[j], &expected, largest) == Some(k) {
                        (follower[ends[k]], is_follower[begin[j]]) = (Some(begin[j]), true);
                    }
                }
            }
        }
        let links = |s: usize| {
            let (first, dots) = &all[s];
            dots.iter().enumerate().map(|(k, d)| (first + k, *d)).collect::<Vec<_>>()
        };
        let first = (0..all.len()).filter(|&s| !is_follower[s]);
        first.map(|s| std::iter::successors(Some(s), |&s| follower[s]).flat_map(links).collect()).collect()
    }

    /// Where a strand's motion leads some frames after its end.
    fn beyond(&self, dots: &[usize], frames: usize) -> Vector2<f64> {
        let [.., last] = dots else { return Vector2::zeros() };
        let moved = self.previous[*last].map(|p| self.places[*last] - self.places[p]).unwrap_or_default();
        self.places[*last] + frames as f64 * moved
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.starts.len() - 1
    }

    /// Number of dots.
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// Whether nothing was seen.
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// Dots of a frame; none for one that the recording does not have.
    pub fn dots(&self, frame: i64) -> &[Vector2<f64>] {
        self.range(frame).map_or(&[], |r| &self.places[r])
    }

    /// Dots of a frame as they move there.
    pub fn moving(&self, frame: i64) -> impl Iterator<Item = Moving> {
        let linked = |at: usize| {
            let (before, after) = (self.previous[at].map(|p| self.places[p]), self.next[at].map(|n| self.places[n]));
            let here = self.places[at];
            let per_frame = match (before, after) {
                (Some(before), Some(after)) => 0.5 * (after - before),
                (Some(before), None) => here - before,
                (None, Some(after)) => after - here,
                (None, None) => return None,
            };
            Some(Moving { place: here, per_frame })
        };
        self.range(frame).unwrap_or(0..0).filter_map(linked)
    }

    /// Dots that are seen in two frames before and two after a moment (frames, with a fraction), as they are then.
    pub fn at(&self, moment: f64) -> impl Iterator<Item = Moving> {
        let part = moment - moment.floor();
        let range = self.range(moment.floor() as i64).unwrap_or(0..0);
        range.filter_map(move |at| {
            let next = self.next[at]?;
            let [before, a, b, after] = [self.previous[at]?, at, next, self.next[next]?].map(|d| self.places[d]);
            let (out, back) = (0.5 * (b - before), 0.5 * (after - a));
            let square = 3.0 * (b - a) - 2.0 * out - back;
            let cube = 2.0 * (a - b) + out + back;
            let place = a + part * (out + part * (square + part * cube));
            Some(Moving { place, per_frame: (after - before) / 3.0 })
        })
    }

    fn range(&self, frame: i64) -> Option<Range<usize>> {
        let frame = usize::try_from(frame).ok().filter(|f| *f < self.frames())?;
        Some(self.starts[frame]..self.starts[frame + 1])
    }

    fn link(&mut self, frame: usize, largest: f64) {
        let (own, next) = (self.starts[frame]..self.starts[frame + 1], self.starts[frame + 1]..self.starts[frame + 2]);
        let moved = |at: usize| self.previous[at].map(|p| self.places[at] - self.places[p]);
        // What has just appeared moves like what is next to it.
        let beside = |at: usize| {
            let distance = |other: &usize| (self.places[*other] - self.places[at]).norm_squared();
            let nearest =
                own.clone().filter(|o| moved(*o).is_some()).min_by(|a, b| distance(a).total_cmp(&distance(b)));
            nearest.filter(|o| distance(o) < largest * largest).and_then(moved).unwrap_or_default()
        };
        let expected: Vec<Vector2<f64>> =
            own.clone().map(|at| self.places[at] + moved(at).unwrap_or_else(|| beside(at))).collect();
        let later = &self.places[next.clone()];
        for (k, place) in expected.iter().enumerate() {
            let Some(j) = clearly_nearest(place, later, largest) else { continue };
            if clearly_nearest(&later[j], &expected, largest) == Some(k) {
                self.next[own.start + k] = Some(next.start + j);
                self.previous[next.start + j] = Some(own.start + k);
            }
        }
    }
}

/// Index of the nearest place within a distance, if no other is nearly as near.
pub fn clearly_nearest(to: &Vector2<f64>, places: &[Vector2<f64>], largest: f64) -> Option<usize> {
    let (mut best, mut first, mut second) = (None, f64::MAX, f64::MAX);
    for (k, place) in places.iter().enumerate() {
        let squared = (place - to).norm_squared();
        if squared < first {
            (best, first, second) = (Some(k), squared, first);
        } else {
            second = second.min(squared);
        }
    }
    best.filter(|_| first < largest * largest && second > CLEARLY_NEARER * CLEARLY_NEARER * first)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn strands(path: impl Fn(f64) -> Vec<Vector2<f64>>) -> Strands {
        let frames: Vec<Vec<Vector2<f64>>> = (0..30).map(|k| path(f64::from(k))).collect();
        Strands::new(&frames, LARGEST_STEP * 640.0)
    }

    #[test]
    fn a_curve_is_met_between_frames() {
        let path = |t: f64| vec![Vector2::new(300.0 + 40.0 * (0.3 * t).sin(), 200.0 + 5.0 * t)];
        let strands = strands(path);
        for moment in [4.25, 12.5, 20.9] {
            let found: Vec<Moving> = strands.at(moment).collect();
            assert_eq!(found.len(), 1);
            assert!((found[0].place - path(moment)[0]).norm() < 0.02);
            let slope = (path(moment + 0.01)[0] - path(moment)[0]) / 0.01;
            assert!((slope - found[0].per_frame).norm() < 1.0);
        }
    }

    #[test]
    fn two_dots_that_pass_closely_are_not_mixed_up() {
        let path = |t: f64| {
            let x = 100.0 + 6.0 * t;
            vec![Vector2::new(x, 200.0), Vector2::new(370.0 - x, 202.0)]
        };
        let strands = strands(path);
        for found in (1..28).flat_map(|k| strands.at(f64::from(k) + 0.5).collect::<Vec<_>>()) {
            assert!((found.per_frame.x.abs() - 6.0).abs() < 0.5, "{found:?}");
        }
    }

    #[test]
    fn frames_that_are_not_there_hold_nothing() {
        let strands = strands(|t| vec![Vector2::new(100.0 + t, 100.0)]);
        assert!(strands.dots(-1).is_empty() && strands.dots(30).is_empty());
        assert_eq!(strands.at(-0.5).count() + strands.at(29.5).count(), 0);
    }
}
