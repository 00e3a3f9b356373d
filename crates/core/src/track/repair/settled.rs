//! Two near markers of different parts: the one keeps its place among the markers of its part, the other comes and goes.
//!
//! However often the two were exchanged, in almost every frame one of them is where the one belongs. That place is the one
//! which the nearer of the two is nearest to by median (least median of squares, Rousseeuw 1984), in the frame of the markers
//! that keep it best.

use super::super::body::Snapshot;
use super::super::body::links::Links;
use super::super::body::moments::NEIGHBOURS;
use super::super::body::regression::centered;
use super::super::body::rotation::align;
use super::close::median;
use nalgebra::{Rotation3, Vector3};

/// Markers about the pair whose parts are tried, and frames whose places are tried.
const ANCHORS: usize = 6;
const TRIED: usize = 25;
/// Frames that must show the two and their neighbours.
const SHARED: usize = 20;
/// Fewer markers make no frame.
const FEWEST: usize = 3;
/// The other is so many times as far from the one's place, by median (squared).
const FARTHER: f64 = 25.0;

/// The past of such a pair.
pub(super) struct Settled {
    /// Snapshots of the two and their neighbours, the two told apart.
    pub history: Vec<Snapshot>,
    /// Neighbours that keep the one's place, the best first.
    pub sets: Vec<Vec<usize>>,
}

impl Settled {
    /// From frames of the take; `None` if neither of the two keeps its place anywhere.
    pub(super) fn of(links: &Links, places: &[&Snapshot], pair: [usize; 2]) -> Option<Self> {
        let tried = sets(links, places, pair).into_iter();
        let mut kept: Vec<(f64, Vec<usize>, Vec<Snapshot>)> =
            tried.filter_map(|set| told_apart(places, pair, &set).map(|(ratio, told)| (ratio, set, told))).collect();
        kept.sort_by(|a, b| a.0.total_cmp(&b.0).then_with(|| a.1.cmp(&b.1)));
        let sets = kept.iter().map(|k| k.1.clone()).collect();
        let (_, _, history) = kept.into_iter().next()?;
        Some(Self { history, sets })
    }
}

/// The parts of the markers that are best linked to the two.
fn sets(links: &Links, places: &[&Snapshot], pair: [usize; 2]) -> Vec<Vec<usize>> {
    let slots = places.first().map_or(0, |p| p.len());
    let mut others: Snapshot = vec![Some(Vector3::zeros()); slots];
    pair.iter().for_each(|&p| others[p] = None);
    let mut sets = Vec::new();
    for anchor in pair.iter().flat_map(|&p| links.best(p, &others, ANCHORS)) {
        let beside = links.frame_of(anchor, &others, NEIGHBOURS - 1);
        // Fewer of them are seen together more often.
        for others in [&beside[..], &beside[..beside.len().min(FEWEST - 1)]] {
            let mut set = others.to_vec();
            set.push(anchor);
            set.sort_unstable();
            if set.len() >= FEWEST && !sets.contains(&set) {
                sets.push(set);
            }
        }
    }
    sets
}

/// How near the one stays to its place compared with the other (medians, squared), and the frames with the two told apart;
/// `None` if it is not much nearer.
fn told_apart(places: &[&Snapshot], pair: [usize; 2], neighbours: &[usize]) -> Option<(f64, Vec<Snapshot>)> {
    let seen = local(places, pair, neighbours);
    if seen.len() < SHARED {
        return None;
    }
    let squared =
        |place: &Vector3<f64>, (_, two): &(&Snapshot, [Vector3<f64>; 2])| two.map(|p| (p - place).norm_squared());
    let off = |place: &Vector3<f64>| median(seen.iter().map(|s| squared(place, s)).map(|[p, q]| p.min(q)).collect());
    let tried = seen.iter().step_by(seen.len().div_ceil(TRIED)).flat_map(|(_, two)| *two);
    let (near, place) = tried.filter_map(|place| Some((off(&place)?, place))).min_by(|a, b| a.0.total_cmp(&b.0))?;
    let far = median(seen.iter().map(|s| squared(&place, s)).map(|[p, q]| p.max(q)).collect())?;
    let first = |s: &(&Snapshot, [Vector3<f64>; 2])| {
        let [p, q] = squared(&place, s);
        p < q
    };
    let first_is_settled = 2 * seen.iter().filter(|s| first(s)).count() >= seen.len();
    let told = |s: &(&Snapshot, [Vector3<f64>; 2])| {
        let mut snapshot = s.0.clone();
        if first(s) != first_is_settled {
            snapshot.swap(pair[0], pair[1]);
        }
        snapshot
    };
    (far > FARTHER * near).then(|| (near / far, seen.iter().map(told).collect()))
}

/// The snapshots that hold both markers and their neighbours, with where the two are in the neighbours' frame (m).
fn local<'a>(
    places: &[&'a Snapshot],
    pair: [usize; 2],
    neighbours: &[usize],
) -> Vec<(&'a Snapshot, [Vector3<f64>; 2])> {
    let mut reference: Option<Vec<Vector3<f64>>> = None;
    let mut rotation = Rotation3::identity();
    let one = |&snapshot: &&'a Snapshot| {
        let points: Vec<Vector3<f64>> = neighbours.iter().map(|&n| snapshot[n]).collect::<Option<_>>()?;
        let [p, q] = [snapshot[pair[0]]?, snapshot[pair[1]]?];
        let (centre, points) = centered(&points);
        let reference = reference.get_or_insert_with(|| points.clone());
        rotation = align(&points, reference, &[1.0; NEIGHBOURS], rotation);
        Some((snapshot, [p, q].map(|p| rotation * (p - centre))))
    };
    places.iter().filter_map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::random::Random;
    use crate::track::body::Seen;
    use nalgebra::Matrix3;

    const FRAMES: usize = 240;
    const PAIR: [usize; 2] = [4, 5];

    /// A part of four markers that turns, with a fifth that keeps its place on it (with a spread, m); a sixth comes and goes
    /// beside it, and in every third frame the two are exchanged.
    fn places(spread_m: f64) -> Vec<Snapshot> {
        let part = [[0.0, 0.0, 0.0], [0.12, 0.0, 0.0], [0.0, 0.1, 0.02], [0.05, 0.05, 0.11], [0.15, 0.05, 0.0]];
        let mut random = Random::new(5, 0);
        let snapshot = |f: usize| {
            let t = f as f64 * 0.05;
            let turn = Rotation3::from_euler_angles(0.8 * t, t.sin(), 0.0);
            let mut local: Vec<Vector3<f64>> = part.iter().map(|p| Vector3::from(*p)).collect();
            local[4] += random.in_box(&Vector3::repeat(spread_m));
            local.push(local[4] + Vector3::new(0.02, 0.03 * (1.7 * t).sin(), 0.01 * (2.3 * t).cos()));
            let mut now: Snapshot = local.into_iter().map(|p| Some(turn * p + Vector3::z() * t)).collect();
            if f.is_multiple_of(3) {
                now.swap(PAIR[0], PAIR[1]);
            }
            now
        };
        (0..FRAMES).map(snapshot).collect()
    }

    fn settled(places: &[Snapshot]) -> Option<Settled> {
        let mut links = Links::default();
        links.reserve(6);
        for now in places {
            let seen = now.iter().enumerate().filter_map(|(slot, p)| {
                Some(Seen { slot, point: (*p)?, covariance: Matrix3::identity() * 1e-8, trusted: true })
            });
            links.learn(&seen.collect::<Vec<_>>());
        }
        Settled::of(&links, &places.iter().collect::<Vec<_>>(), PAIR)
    }

    #[test]
    fn the_one_that_keeps_its_place_is_told_in_every_frame() {
        let places = places(0.001);
        let settled = settled(&places).expect("one keeps its place");
        assert_eq!(settled.history.len(), FRAMES);
        for (f, (told, now)) in settled.history.iter().zip(&places).enumerate() {
            let mut right = now.clone();
            if f.is_multiple_of(3) {
                right.swap(PAIR[0], PAIR[1]);
            }
            assert_eq!(told, &right, "frame {f}");
        }
        assert!(settled.sets.iter().all(|set| set.iter().all(|slot| !PAIR.contains(slot))));
    }

    #[test]
    fn where_neither_keeps_a_place_nothing_is_told() {
        assert!(settled(&places(0.03)).is_none());
    }

    #[test]
    fn from_few_frames_nothing_is_told() {
        assert!(settled(&places(0.001)[..SHARED - 1]).is_none());
    }
}
