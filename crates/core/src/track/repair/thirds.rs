//! Which of two near markers is which, by how far each is from a third one.
//!
//! A third marker of the same part is nearer to the one than to the other, by as much in every frame; however often the two
//! were exchanged, the smaller and the larger distance stay what they are. Most frames tell which of the two is nearer.

use super::super::body::Snapshot;
use super::close::median;
use nalgebra::Vector3;

/// Frames in which the three must have been seen.
const SHARED: usize = 20;
/// The difference of the two distances is this many of their spreads, and almost all are one of the two.
const CLEAR: f64 = 5.0;
const ALMOST_ALL: f64 = 0.95;
/// Spread of what is off its median by so much.
const SPREAD: f64 = 1.4826;
/// Degrees of freedom of what distances are off.
const FREEDOM: f64 = 5.0;
/// Least spread of a distance (m).
const LEAST_SPREAD: f64 = 0.001;

/// A third marker that tells two others apart.
pub(super) struct Third {
    slot: usize,
    /// Its distances from the one and from the other (m).
    distances: [f64; 2],
    /// How much they differ from frame to frame (m).
    spread: f64,
}

/// The third markers that tell two apart, the clearest first. `places`: frames of the take.
pub(super) fn thirds(places: &[&Snapshot], pair: [usize; 2]) -> Vec<Third> {
    let slots = places.first().map_or(0, |p| p.len());
    let others = (0..slots).filter(|slot| !pair.contains(slot));
    let mut found: Vec<Third> = others.filter_map(|slot| Third::learned(places, pair, slot)).collect();
    found.sort_by(|a, b| b.clearness().total_cmp(&a.clearness()).then(a.slot.cmp(&b.slot)));
    found
}

/// Evidence that the two are exchanged in a frame (nats): of the clearest third marker that is there.
pub(super) fn exchanged(thirds: &[Third], now: &Snapshot, places: [Option<Vector3<f64>>; 2]) -> Option<f64> {
    let (third, from) = thirds.iter().find_map(|t| Some((t, now[t.slot]?)))?;
    Some(third.exchanged(places.map(|p| p.map(|p| (p - from).norm()))))
}

impl Third {
    fn learned(places: &[&Snapshot], pair: [usize; 2], slot: usize) -> Option<Self> {
        let distances = |s: &&Snapshot| Some(pair.map(|p| Some((s[p]? - s[slot]?).norm())));
        let seen: Vec<[Option<f64>; 2]> = places.iter().filter_map(distances).collect();
        let both: Vec<[f64; 2]> = seen.iter().filter_map(|d| Some([d[0]?, d[1]?])).collect();
        if both.len() < SHARED {
            return None;
        }
        let middle = |of: fn(f64, f64) -> f64| {
            let all: Vec<f64> = both.iter().map(|d| of(d[0], d[1])).collect();
            let middle = median(all.clone())?;
            Some((middle, SPREAD * median(all.into_iter().map(|d| (d - middle).abs()).collect())?))
        };
        let (near, far) = (middle(f64::min)?, middle(f64::max)?);
        let (apart, spread) = (far.0 - near.0, near.1.max(far.1).max(LEAST_SPREAD));
        // A part that bends is as long in some postures only.
        let holds = |d: &f64| (d - near.0).abs().min((d - far.0).abs()) < apart / 4.0;
        let each: Vec<f64> = seen.iter().flatten().flatten().copied().collect();
        let held = each.iter().filter(|d| holds(d)).count();
        if apart < CLEAR * spread || (held as f64) < ALMOST_ALL * each.len() as f64 {
            return None;
        }
        let one_is_nearer = 2 * both.iter().filter(|d| d[0] < d[1]).count() >= both.len();
        let distances = if one_is_nearer { [near.0, far.0] } else { [far.0, near.0] };
        Some(Self { slot, distances, spread })
    }

    fn clearness(&self) -> f64 {
        (self.distances[0] - self.distances[1]).abs() / self.spread
    }

    /// Evidence for the exchange, by the distances of the two as they are.
    fn exchanged(&self, now: [Option<f64>; 2]) -> f64 {
        // Student's t: a place that is off for once says little, wherever it is.
        let off = |d: f64, expected: f64| {
            let squared = ((d - expected) / self.spread).powi(2);
            0.5 * (FREEDOM + 1.0) * (squared / FREEDOM).ln_1p()
        };
        let by = |k: usize| now[k].map_or(0.0, |d| off(d, self.distances[k]) - off(d, self.distances[1 - k]));
        by(0) + by(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAMES: usize = 200;

    /// Two markers 20 mm apart and a third one, 60 mm from the one and 50 mm from the other, that moves about them with
    /// the cosine of some angle of bending; the two are exchanged in some frames.
    fn places(bending: f64, exchanged: impl Fn(usize) -> bool) -> Vec<Snapshot> {
        let snapshot = |f: usize| {
            let (sin, cos) = (f as f64 * 0.1).sin_cos();
            let turned = |x: f64, y: f64| Vector3::new(cos * x - sin * y, sin * x + cos * y, 0.01 * f as f64);
            let third = 0.05 * (bending * (f as f64 * 0.03).sin()).cos();
            let mut now = vec![Some(turned(-0.01, 0.0)), Some(turned(0.01, 0.0)), Some(turned(third, 0.01))];
            if exchanged(f) {
                now.swap(0, 1);
            }
            now
        };
        (0..FRAMES).map(snapshot).collect()
    }

    fn learned(places: &[Snapshot]) -> Vec<Third> {
        thirds(&places.iter().collect::<Vec<_>>(), [0, 1])
    }

    #[test]
    fn a_third_marker_of_the_part_tells_who_was_exchanged() {
        let swapped = |f: usize| (50..120).contains(&f);
        let places = places(0.0, swapped);
        let thirds = learned(&places);
        assert_eq!(thirds.len(), 1);
        for (f, now) in places.iter().enumerate() {
            let both = exchanged(&thirds, now, [now[0], now[1]]).unwrap();
            let one = exchanged(&thirds, now, [now[0], None]).unwrap();
            assert!((both > 10.0) == swapped(f) && both.abs() > 10.0, "frame {f}: {both}");
            assert!((one > 5.0) == swapped(f) && one.abs() > 5.0, "frame {f}: {one}");
        }
        assert!(exchanged(&thirds, &vec![places[0][0], places[0][1], None], [None, None]).is_none());
    }

    #[test]
    fn one_beyond_a_joint_that_bends_does_not() {
        assert!(learned(&places(1.4, |_| false)).is_empty());
    }

    #[test]
    fn one_as_far_from_both_does_not() {
        let mut places = places(0.0, |_| false);
        places
            .iter_mut()
            .for_each(|now| now[2] = Some(0.5 * (now[0].unwrap() + now[1].unwrap()) + Vector3::z() * 0.05));
        assert!(learned(&places).is_empty());
    }
}
