//! To a hundredth of a frame and better: offset and rate by least squares over the distances of dots from their epipolar
//! lines, as the dots are at the moment in question.
//!
//! A dot that moves across its line by v px per frame and lies d px beside it says that the clocks are d / v frames
//! apart. Gauss–Newton over offset and rate, from a short part of the recording to the whole, with Tukey's weights (Beaton
//! & Tukey 1974) and a gate that follows the noise: chance neighbours pull to neither side. The uncertainty comes from
//! parts of the recording that are asked apart (a sandwich estimate): what a rig's errors do is the same for a while.

use super::coarse::Coarse;
use super::epipolar::{CameraPair, Line, distance, rate as line_rate};
use super::view::View;
use crate::strands::Moving;
use nalgebra::{Matrix2, Vector2};
use rayon::prelude::*;

/// What is known of rates beforehand: nominal ones are hardly wrong by more (29.97 Hz called 30).
const RATE_SPREAD: f64 = 1e-3;
/// Frames on each side of the middle at first; doubled until all are in.
const FIRST_REACH: usize = 300;
/// Frames asked at most.
const MOST_ASKED: usize = 2000;
const ROUNDS: usize = 12;
/// The gate, in standard deviations, and the least noise it stands for (px).
const GATE: f64 = 4.5;
const LEAST_NOISE_PX: f64 = 0.03;
/// A step so small settles the offset (frames).
const SETTLED: f64 = 1e-5;
/// Parts of the recording asked apart.
pub const PARTS: usize = 12;

/// How the second recording's frames lie in time against the first's.
#[derive(Clone, Debug)]
pub struct Fine {
    /// Frame of the second at the first's frame 0.
    pub shift: f64,
    /// Standard deviation of the shift (frames).
    pub shift_sigma: f64,
    /// Standard deviation of the shift in the middle of what both saw.
    pub middle_sigma: f64,
    /// Second's frames per frame of the first, over the nominal.
    pub stretch: f64,
    /// Standard deviation of the stretch.
    pub stretch_sigma: f64,
    /// Distance of dots from their lines (px, standard deviation).
    pub noise_px: f64,
    /// Pairs of dots that were used.
    pub matches: usize,
    /// For parts of the recording: frame of the first, what the part alone would add to the shift, its weight (1 / variance).
    pub parts: Vec<[f64; 3]>,
}

/// Shift at a frame of the first recording, and stretch.
#[derive(Clone, Copy)]
struct Guess {
    middle: f64,
    at_middle: f64,
    stretch: f64,
    rate: f64,
}

impl Guess {
    fn moment(&self, frame: f64) -> f64 {
        self.at_middle + (frame - self.middle) * self.rate * self.stretch
    }
}

/// One pair of dots: how far beside its line, and the derivatives by shift and stretch.
#[derive(Clone, Copy)]
struct Match {
    frame: usize,
    beside_px: f64,
    by: Vector2<f64>,
}

/// Offset and rate from where the coarse look stood. `None` where too little moves.
pub fn fine(first: &[View], second: &[View], pairs: &[CameraPair], rate: f64, coarse: &Coarse) -> Option<Fine> {
    let frames = first.iter().map(|v| v.strands.frames()).max()?;
    let middle = coarse.middle as f64;
    let at_middle = (middle * rate).round() + coarse.shift as f64;
    let mut guess = Guess { middle, at_middle, stretch: 1.0, rate };
    let mut reach = FIRST_REACH;
    let mut gate = 1.5 * coarse.near_px;
    loop {
        let range = coarse.middle.saturating_sub(reach)..(coarse.middle + reach).min(frames);
        let whole = range.start == 0 && range.end == frames;
        let step = range.len().div_ceil(MOST_ASKED).max(1);
        let asked: Vec<usize> = range.step_by(step).collect();
        let (matches, noise_px) = settle(first, second, pairs, &asked, &mut guess, &mut gate)?;
        if whole {
            return report(&matches, &guess, noise_px, frames);
        }
        // The farther ends may be off by what the rate is.
        gate = (1.5 * gate).min(1.5 * coarse.near_px);
        reach *= 2;
    }
}

/// Gauss–Newton over some frames: the last matches and their noise.
fn settle(
    first: &[View],
    second: &[View],
    pairs: &[CameraPair],
    asked: &[usize],
    guess: &mut Guess,
    gate: &mut f64,
) -> Option<(Vec<Match>, f64)> {
    let mut found = (Vec::new(), 0.0);
    for _ in 0..ROUNDS {
        let matches: Vec<Match> =
            asked.par_iter().flat_map_iter(|&k| matches_of(first, second, pairs, k, guess, *gate)).collect();
        let noise = noise_px(&matches)?;
        let (normal, right) = sums(&matches, noise);
        let prior = Matrix2::from_diagonal(&Vector2::new(0.0, (noise / RATE_SPREAD).powi(2)));
        let step = (normal + prior).try_inverse()? * (right + prior * Vector2::new(0.0, 1.0 - guess.stretch));
        guess.at_middle += step[0];
        guess.stretch += step[1];
        *gate = (GATE * noise).min(*gate);
        found = (matches, noise);
        if step[0].abs() < SETTLED {
            break;
        }
    }
    Some(found)
}

/// Dots that are each other's nearest across all pairs of cameras in one frame of the first recording.
fn matches_of(
    first: &[View],
    second: &[View],
    pairs: &[CameraPair],
    frame: usize,
    guess: &Guess,
    gate: f64,
) -> Vec<Match> {
    let moment = guess.moment(frame as f64);
    let mut found = Vec::new();
    for pair in pairs {
        let lines: Vec<Line> =
            first[pair.views[0]].strands.dots(frame as i64).iter().filter_map(|p| pair.line(p)).collect();
        if lines.is_empty() {
            continue;
        }
        let dots: Vec<Moving> = second[pair.views[1]].strands.at(moment).collect();
        let nearest_line: Vec<Option<usize>> =
            dots.iter().map(|d| nearest(lines.iter().map(|l| distance(l, &d.place).abs()), gate)).collect();
        for (k, line) in lines.iter().enumerate() {
            let Some(j) = nearest(dots.iter().map(|d| distance(line, &d.place).abs()), gate) else { continue };
            if nearest_line[j] == Some(k) {
                let per_frame = line_rate(line, &dots[j]);
                let by = Vector2::new(per_frame, per_frame * (frame as f64 - guess.middle) * guess.rate);
                found.push(Match { frame, beside_px: distance(line, &dots[j].place), by });
            }
        }
    }
    found
}

fn nearest(distances: impl Iterator<Item = f64>, gate: f64) -> Option<usize> {
    let near = distances.enumerate().filter(|(_, d)| *d < gate);
    near.min_by(|a, b| a.1.total_cmp(&b.1)).map(|n| n.0)
}

/// Robust standard deviation of the distances.
fn noise_px(matches: &[Match]) -> Option<f64> {
    let mut sizes: Vec<f64> = matches.iter().map(|m| m.beside_px.abs()).collect();
    if sizes.len() < 10 {
        return None;
    }
    let middle = sizes.len() / 2;
    let median = *sizes.select_nth_unstable_by(middle, f64::total_cmp).1;
    Some((1.4826 * median).max(LEAST_NOISE_PX))
}

/// Tukey's weight.
fn weight(beside_px: f64, noise_px: f64) -> f64 {
    let u = beside_px / (GATE * noise_px);
    if u.abs() < 1.0 { (1.0 - u * u).powi(2) } else { 0.0 }
}

fn sums<'a>(matches: impl IntoIterator<Item = &'a Match>, noise_px: f64) -> (Matrix2<f64>, Vector2<f64>) {
    let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
    for m in matches {
        let w = weight(m.beside_px, noise_px);
        normal += w * m.by * m.by.transpose();
        right -= w * m.beside_px * m.by;
    }
    (normal, right)
}

fn report(matches: &[Match], guess: &Guess, noise_px: f64, frames: usize) -> Option<Fine> {
    let (normal, _) = sums(matches, noise_px);
    let inverse = normal.try_inverse()?;
    let length = frames.div_ceil(PARTS).max(1);
    let (mut scatter, mut parts) = (Matrix2::zeros(), Vec::new());
    for part in 0..PARTS {
        let own = || matches.iter().filter(|m| m.frame / length == part);
        let (normal, right) = sums(own(), noise_px);
        scatter += right * right.transpose();
        if normal[(0, 0)] > 0.0 {
            let middle = (part * length) as f64 + 0.5 * length as f64;
            parts.push([middle, right[0] / normal[(0, 0)], normal[(0, 0)] / (noise_px * noise_px)]);
        }
    }
    let count = parts.len() as f64;
    if count < 2.0 {
        return None;
    }
    let covariance = inverse * scatter * inverse * (count / (count - 1.0)) + inverse * (noise_px * noise_px);
    let to_start = Vector2::new(1.0, -guess.middle * guess.rate);
    Some(Fine {
        shift: guess.moment(0.0),
        shift_sigma: to_start.dot(&(covariance * to_start)).sqrt(),
        middle_sigma: (covariance[(0, 0)] - covariance[(0, 1)].powi(2) / covariance[(1, 1)]).max(0.0).sqrt(),
        stretch: guess.stretch,
        stretch_sigma: covariance[(1, 1)].sqrt(),
        noise_px,
        matches: matches.len(),
        parts,
    })
}
