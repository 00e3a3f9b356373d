//! Distances and heights of a subject from frames with names.

use super::model::{Height, Length, height_over};
use nalgebra::Vector3;
use std::cmp::Ordering;

/// Frames looked at, at most: more of one take say little that is new.
const FRAMES: usize = 800;
/// Part of the values at either end that may be wrong.
const CLIPPED: f64 = 0.015;
/// Heights kept of a marker, and the neighbours from which their triangles are made.
const HEIGHTS: usize = 3;
const BASE_OF: usize = 7;
/// A height tells left from right when it is this many times its spread.
const CLEAR: f64 = 3.0;
/// Area below which a triangle has no side to speak of (m²).
const SMALLEST_AREA: f64 = 0.000_4;
/// What the belief before any frame is worth, in independent poses: for a pair that may be rigid, and for another.
const WORTH_RIGID: f64 = 0.9;
const WORTH: f64 = 1.0;
/// Poses after which half of what is seen of a pair that is not rigid is trusted.
const HALF_TRUSTED: f64 = 10.0;
/// The same for the side of a triangle on which a marker stands: it changes in fewer poses than a distance does.
const HALF_TRUSTED_SIDE: f64 = 2.0;
/// A pair is taken for rigid when its spread is at most this many times that of the body's most rigid pairs.
const RIGID: f64 = 2.5;
/// Spread of a rigid pair before any frame was seen (m), and by its distance: without and with a marker set's word.
const SKIN: f64 = 0.005;
const BY_DISTANCE: f64 = 0.15;
const BY_DISTANCE_SAID: f64 = 0.05;
/// The body has moved when its distances vary this many times more than its most rigid ones; where it has not, pairs up
/// to this part of its reach are taken for rigid.
const MOVED: f64 = 3.0;
const NEAR: f64 = 0.12;
/// Length of the mean of unit directions below which a line has turned: a spread of some 15 degrees.
const TURNED: f64 = 0.97;
/// Share of the frames in which a pair must be seen to be taken for rigid.
const OFTEN: f64 = 0.5;
/// Least spread of a rigid pair (m): skin and noise.
const LEAST_SD: f64 = 0.001;
/// Spread of a pair that is not rigid, before any frame was seen, by its distance.
const LOOSE: f64 = 0.3;

/// Places of all markers in one frame; `None` where one is missing.
pub type Named = Vec<Option<Vector3<f64>>>;

/// What frames say of one subject.
pub struct Learned {
    /// Row by row, n × n; `None` where two markers were never seen together.
    pub distances: Vec<Option<Length>>,
    /// Heights over triangles, of each marker.
    pub heights: Vec<Vec<Height>>,
}

/// What is said of a pair before any frame was seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Said {
    /// Both markers are on one segment.
    Rigid,
    /// They are on different segments.
    Soft,
    /// Nothing.
    Unknown,
}

/// Learn a subject. `said` (n × n) is what a marker set says of each pair; `poses`: how many independent poses the
/// frames are worth. The extremes are clipped, so that jumps and swaps of a few frames do not count.
///
/// A pair that kept its distance while others changed theirs much is rigid, and its spread is as seen. A pair that moved
/// a little may move more tomorrow: its spread is widened, and it is trusted only by the number of poses. Where nothing
/// moved at all, only near markers are taken for rigid, unless a marker set tells or the pair turned.
pub fn learn(frames: &[Named], said: &[Said], poses: f64, noise_m: f64) -> Learned {
    let n = frames.first().map_or(0, Vec::len);
    let step = frames.len().div_ceil(FRAMES).max(1);
    let kept: Vec<&Named> = frames.iter().step_by(step).collect();
    let mut seen = vec![None; n * n];
    for a in 0..n {
        for b in a + 1..n {
            seen[a * n + b] = robust(kept.iter().filter_map(|f| Some((f[a]? - f[b]?).norm())).collect());
            seen[b * n + a] = seen[a * n + b];
        }
    }
    let least = typical(&seen, n).max(LEAST_SD);
    let mut spreads: Vec<f64> = seen.iter().flatten().map(|s: &Seen| s.variance.sqrt()).collect();
    spreads.sort_by(f64::total_cmp);
    let contrast = spreads.get(spreads.len() / 2).map_or(1.0, |s| (s / least).max(1.0));
    let reach = seen.iter().flatten().map(|s| s.mean).fold(0.0, f64::max);
    let length = |i: usize| {
        let Seen { mean, variance, frames } = seen[i]?;
        // A pair that was seldom seen together was seen in few poses.
        let share = frames as f64 / kept.len() as f64;
        let poses = poses * share;
        let pooled = |worth: f64, sd: f64| ((poses * variance + worth * sd * sd) / (poses + worth)).sqrt();
        let steady = variance.sqrt() <= RIGID * least && share >= OFTEN;
        let rigid = match said[i] {
            Said::Rigid => variance.sqrt() <= SKIN + RIGID * least,
            Said::Soft => false,
            Said::Unknown => steady && (contrast > MOVED || mean <= NEAR * reach || has_turned(&kept, i / n, i % n)),
        };
        Some(if rigid {
            let by_distance = if said[i] == Said::Rigid { BY_DISTANCE_SAID } else { BY_DISTANCE };
            let believed = SKIN + by_distance * mean;
            let sd = pooled(WORTH_RIGID / contrast, believed).max(least).max(noise_m);
            Length { mean, sd, trust: 1.0 }
        } else {
            let sd = pooled(WORTH, LOOSE * mean).max(noise_m);
            Length { mean, sd, trust: poses / (poses + HALF_TRUSTED) }
        })
    };
    let distances: Vec<Option<Length>> = (0..n * n).map(length).collect();
    let heights = (0..n).map(|m| heights_of(m, &kept, &distances, (poses, noise_m))).collect();
    Learned { distances, heights }
}

/// What further frames add to a subject that is known from `known_poses` poses: pairs that were not rigid are allowed
/// what they did, rigid ones are made more exact; a rigid pair of another length is a wrong name, and changes nothing.
/// Heights that turn out to be on either side are dropped.
pub fn learn_more(known: &Learned, known_poses: f64, frames: &[Named], poses: f64, noise_m: f64) -> Learned {
    let n = known.heights.len();
    let step = frames.len().div_ceil(FRAMES).max(1);
    let kept: Vec<&Named> = frames.iter().step_by(step).collect();
    let joined = |a: usize, b: usize| {
        let before = known.distances[a * n + b];
        let Some(Seen { mean, variance, frames }) =
            robust(kept.iter().filter_map(|f| Some((f[a]? - f[b]?).norm())).collect())
        else {
            return before;
        };
        let poses = poses * frames as f64 / kept.len() as f64;
        let all = known_poses + poses;
        let Some(before) = before else {
            let sd = ((poses * variance + WORTH * (LOOSE * mean).powi(2)) / (poses + WORTH)).sqrt();
            return Some(Length { mean, sd: sd.max(noise_m), trust: poses / (poses + HALF_TRUSTED) });
        };
        if before.trust >= 1.0 && ((mean - before.mean).abs() > 3.0 * before.sd || variance.sqrt() > 3.0 * before.sd) {
            return Some(before);
        }
        let middle = (known_poses * before.mean + poses * mean) / all;
        let about = |m: f64, v: f64| v + (m - middle).powi(2);
        let pooled = (known_poses * about(before.mean, before.sd * before.sd) + poses * about(mean, variance)) / all;
        let trust = if before.trust >= 1.0 { 1.0 } else { all / (all + HALF_TRUSTED) };
        Some(Length { mean: middle, sd: pooled.sqrt().max(noise_m), trust })
    };
    let distances = (0..n * n).map(|i| if i / n == i % n { None } else { joined(i / n, i % n) }).collect();
    let keeps_its_side = |m: usize, height: &Height| {
        let sides = kept.iter().filter_map(|f| {
            let [Some(a), Some(b), Some(c)] = height.base.map(|o| f[o]) else { return None };
            height_over(&a, &b, &c, &f[m]?).map(|h| (h > 0.0) == (height.length.mean > 0.0))
        });
        let (right, count) = sides.fold((0, 0), |(r, n), side| (r + usize::from(side), n + 1));
        10 * right >= 9 * count
    };
    let heights = known.heights.iter().enumerate();
    let heights = heights.map(|(m, own)| own.iter().filter(|h| keeps_its_side(m, h)).copied().collect()).collect();
    Learned { distances, heights }
}

/// Whether the line through two markers turned: a pair that kept its length through that is rigid.
fn has_turned(frames: &[&Named], a: usize, b: usize) -> bool {
    let directions = frames.iter().filter_map(|f| (f[a]? - f[b]?).try_normalize(1e-9));
    let (sum, count) = directions.fold((Vector3::zeros(), 0.0), |(s, n), d| (s + d, n + 1.0));
    count > 0.0 && sum.norm() / count < TURNED
}

/// Spread of the body's most rigid pairs (m): the median over markers of their second most rigid neighbour.
fn typical(seen: &[Option<Seen>], n: usize) -> f64 {
    let second = |m: usize| {
        let mut own: Vec<f64> = (0..n).filter_map(|o| seen[m * n + o].map(|s| s.variance.sqrt())).collect();
        own.sort_by(f64::total_cmp);
        own.get(1).copied()
    };
    let mut all: Vec<f64> = (0..n).filter_map(second).collect();
    all.sort_by(f64::total_cmp);
    all.get(all.len() / 2).copied().unwrap_or(0.0)
}

/// A length as it was seen: mean (m), variance (m²), and in how many frames.
#[derive(Clone, Copy)]
struct Seen {
    mean: f64,
    variance: f64,
    frames: usize,
}

/// Mean and variance; the smallest and the largest few are taken for jumps and swaps, and clipped.
fn robust(mut values: Vec<f64>) -> Option<Seen> {
    if values.is_empty() {
        return None;
    }
    values.sort_by(f64::total_cmp);
    let cut = (CLIPPED * values.len() as f64) as usize;
    let (low, high) = (values[cut], values[values.len() - 1 - cut]);
    let count = values.len() as f64;
    let mean = values.iter().map(|v| v.clamp(low, high)).sum::<f64>() / count;
    let variance = values.iter().map(|v| (v.clamp(low, high) - mean).powi(2)).sum::<f64>() / count;
    Some(Seen { mean, variance, frames: values.len() })
}

fn heights_of(m: usize, frames: &[&Named], distances: &[Option<Length>], (poses, noise_m): (f64, f64)) -> Vec<Height> {
    let n = frames.first().map_or(0, |f| f.len());
    let mut near: Vec<usize> = (0..n).filter(|&o| o != m && distances[m * n + o].is_some()).collect();
    let sd = |o: usize| distances[m * n + o].map_or(f64::INFINITY, |l| l.sd);
    near.sort_by(|&a, &b| sd(a).total_cmp(&sd(b)).then(a.cmp(&b)));
    near.truncate(BASE_OF);
    let mut found: Vec<(f64, Height)> = Vec::new();
    for i in 0..near.len() {
        for j in i + 1..near.len() {
            for k in j + 1..near.len() {
                let base = [near[i], near[j], near[k]];
                found.extend(height(m, base, frames, distances, (poses, noise_m)));
            }
        }
    }
    // Those over triangles that are rigid with the marker come first: they hold in every pose.
    found.sort_by(|a, b| (b.1.length.trust, b.0).partial_cmp(&(a.1.length.trust, a.0)).unwrap_or(Ordering::Equal));
    found.into_iter().take(HEIGHTS).map(|(_, h)| h).collect()
}

/// A height and how clear it is, where the triangle is wide enough and the height keeps its sign.
fn height(
    m: usize,
    base: [usize; 3],
    frames: &[&Named],
    distances: &[Option<Length>],
    (poses, noise_m): (f64, f64),
) -> Option<(f64, Height)> {
    let n = frames.first()?.len();
    let [a, b, c] = base;
    let lengths = [(m, a), (m, b), (m, c), (a, b), (a, c), (b, c)].map(|(i, j)| distances[i * n + j]);
    let softest = lengths[..3].iter().flatten().map(|l| l.sd).fold(0.0, f64::max);
    let rigid = lengths.iter().all(|l| l.is_some_and(|l| l.trust >= 1.0));
    let trust = if rigid { 1.0 } else { poses / (poses + HALF_TRUSTED_SIDE) };
    let mut areas = Vec::new();
    let mut seen = Vec::new();
    for frame in frames {
        let [Some(a), Some(b), Some(c), Some(at)] = [frame[base[0]], frame[base[1]], frame[base[2]], frame[m]] else {
            continue;
        };
        areas.push(0.5 * (b - a).cross(&(c - a)).norm());
        seen.extend(height_over(&a, &b, &c, &at));
    }
    areas.sort_by(f64::total_cmp);
    if areas.is_empty() || areas[areas.len() / 10] < SMALLEST_AREA {
        return None;
    }
    let Seen { mean, variance, .. } = robust(seen)?;
    // Skin and noise move a height as much as the softest of the distances that make it.
    let sd = variance.sqrt().max(0.5 * softest).max(noise_m);
    let clear = mean.abs() / sd;
    (clear > CLEAR).then_some((clear, Height { base, length: Length { mean, sd, trust } }))
}
