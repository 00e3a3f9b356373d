//! To the nearest frame: every shift of one recording against the other is tried, and the dots are counted that have a dot
//! near their epipolar line.
//!
//! By chance the same share of dots has one at any shift; at the true one it is far more. Only the frames with most motion
//! are asked, a few of them: what stands still says nothing.

use super::epipolar::{CameraPair, Line, distance};
use super::view::View;
use rayon::prelude::*;

/// Frames of the first recording that are asked.
const ASKED: usize = 64;
/// Frames by which the best shifts are told apart, and how many shifts those are.
const ASKED_AGAIN: usize = 512;
const PEAKS: usize = 8;
/// Parts into which the questions are divided to compare two shifts.
const PARTS: usize = 16;
/// Frames from which they are taken (the part with most motion).
const SPAN: usize = 3000;
/// Pairs of cameras that are asked.
const PAIRS: usize = 4;
/// A shift must compare this part of the frames asked.
const LEAST_OVERLAP: f64 = 0.25;
/// Frames of the first recording within which a shift belongs to the same peak.
const BESIDE: f64 = 20.0;
/// Noise of a dot's distance from its line (px): a rig that has drifted a little.
const USUAL_NOISE_PX: f64 = 0.7;

/// The best shift and how it stands out.
#[derive(Clone, Copy, Debug)]
pub struct Coarse {
    /// Frame of the second recording at the first's frame 0.
    pub shift: i64,
    /// Frame of the first recording in the middle of those asked.
    pub middle: usize,
    /// Share of dots with a dot near their line there.
    pub share: f64,
    /// The same by the median of all shifts.
    pub by_chance: f64,
    /// How much better it is than the best other shift (standard deviations).
    pub ahead: f64,
    /// How much better it is than the usual shift (standard deviations).
    pub above: f64,
    /// Distance within which a dot was near (px).
    pub near_px: f64,
}

/// What is asked of one frame: lines in one view of the second recording.
struct Question {
    frame: usize,
    view: usize,
    lines: Vec<Line>,
}

/// The best shift of `second` against `first`. `rate` is second's frames per frame of first. `None` where nothing can be
/// compared.
pub fn coarse(first: &[View], second: &[View], pairs: &[CameraPair], rate: f64) -> Option<Coarse> {
    let start = most_moving(first);
    let frames = first.iter().map(|v| v.strands.frames()).max()?;
    let stop = (start + SPAN).min(frames);
    let others = second.iter().map(|v| v.strands.frames()).max()? as i64;
    let reach = |frame: usize| (frame as f64 * rate).round() as i64;
    let all: Vec<i64> = (-reach(stop - 1)..=others - reach(start)).collect();
    let few = spread_over(start..stop, ASKED);
    let near_px = near_px(first, pairs, &few);
    let look = |pairs: &[CameraPair], asked: &[usize], shifts: &[i64]| {
        let questions = questions(first, pairs, asked);
        Look { answers: shifts.par_iter().map(|s| hits(&questions, second, rate, *s, near_px)).collect(), questions }
    };
    let once = look(&pairs[..pairs.len().min(PAIRS)], &few, &all);
    let by_chance = once.by_chance()?;
    let beside = (BESIDE * rate).ceil() as i64;
    let peaks = once.peaks(&all, by_chance, few.len(), beside);
    // The best are asked again, more closely: a gait repeats itself, but not exactly.
    let many = spread_over(start..stop, ASKED_AGAIN);
    let near: Vec<i64> = peaks.iter().flat_map(|p| [p - 1, *p, p + 1]).collect();
    let again = look(pairs, &many, &near);
    let scores = again.scores(by_chance, many.len());
    let order = |a: &&(usize, f64), b: &&(usize, f64)| a.1.total_cmp(&b.1);
    let best = *scores.iter().max_by(order)?;
    let other = scores.iter().filter(|(k, _)| near[*k].abs_diff(near[best.0]) > beside as u64).max_by(order);
    let parts = |k: usize| by_part(&again.questions, second, rate, near[k], near_px);
    let ahead = other.map_or(best.1, |o| ahead(&parts(best.0), &parts(o.0)));
    Some(Coarse {
        shift: near[best.0],
        middle: usize::midpoint(start, stop),
        share: again.share(best.0),
        by_chance,
        ahead,
        above: best.1,
        near_px,
    })
}

/// Answers of several shifts to the same questions.
struct Look {
    questions: Vec<Question>,
    answers: Vec<(usize, usize)>,
}

impl Look {
    fn share(&self, k: usize) -> f64 {
        self.answers[k].0 as f64 / self.answers[k].1 as f64
    }

    /// Shifts that compare enough.
    fn usable(&self) -> impl Iterator<Item = usize> {
        let total: usize = self.questions.iter().map(|q| q.lines.len()).sum();
        let least = (LEAST_OVERLAP * total as f64).max(1.0);
        (0..self.answers.len()).filter(move |&k| self.answers[k].1 as f64 >= least)
    }

    /// The usual share.
    fn by_chance(&self) -> Option<f64> {
        let mut shares: Vec<f64> = self.usable().map(|k| self.share(k)).collect();
        let middle = shares.len() / 2;
        (!shares.is_empty()).then(|| *shares.select_nth_unstable_by(middle, f64::total_cmp).1)
    }

    /// How much better each shift is than the usual, in standard deviations: dots of one frame hit or miss together, so
    /// the frames are the sample.
    fn scores(&self, by_chance: f64, frames: usize) -> Vec<(usize, f64)> {
        let total: usize = self.questions.iter().map(|q| q.lines.len()).sum();
        let score = |k: usize| {
            let frames = frames as f64 * self.answers[k].1 as f64 / total as f64;
            (self.share(k) - by_chance) * frames.sqrt() / 0.5
        };
        self.usable().map(|k| (k, score(k))).collect()
    }

    /// The best shifts, none beside another.
    fn peaks(&self, shifts: &[i64], by_chance: f64, frames: usize, beside: i64) -> Vec<i64> {
        let mut scores = self.scores(by_chance, frames);
        scores.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        let mut peaks: Vec<i64> = Vec::new();
        for (k, _) in scores {
            if peaks.iter().all(|p| (p - shifts[k]).abs() > beside) {
                peaks.push(shifts[k]);
            }
            if peaks.len() == PEAKS {
                break;
            }
        }
        peaks
    }
}

fn spread_over(range: std::ops::Range<usize>, most: usize) -> Vec<usize> {
    let step = range.len().div_ceil(most).max(1);
    range.step_by(step).collect()
}

/// First frame of the part with most motion in the image.
fn most_moving(views: &[View]) -> usize {
    let frames = views.iter().map(|v| v.strands.frames()).max().unwrap_or(0);
    if frames <= SPAN {
        return 0;
    }
    let motion = |start: usize| -> f64 {
        let sampled = (start..start + SPAN).step_by(SPAN / ASKED);
        sampled
            .flat_map(|k| views.iter().flat_map(move |v| v.strands.moving(k as i64)))
            .map(|m| m.per_frame.norm())
            .sum()
    };
    let starts = (0..=frames - SPAN).step_by(SPAN / 2);
    starts.map(|s| (s, motion(s))).max_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |b| b.0)
}

fn questions(first: &[View], pairs: &[CameraPair], asked: &[usize]) -> Vec<Question> {
    let of = |frame: usize, pair: &CameraPair| {
        let lines: Vec<Line> =
            first[pair.views[0]].strands.dots(frame as i64).iter().filter_map(|p| pair.line(p)).collect();
        (!lines.is_empty()).then_some(Question { frame, view: pair.views[1], lines })
    };
    asked.iter().flat_map(|&k| pairs.iter().filter_map(move |p| of(k, p))).collect()
}

/// Half a frame of the usual motion, and noise.
fn near_px(first: &[View], pairs: &[CameraPair], asked: &[usize]) -> f64 {
    let mut speeds: Vec<f64> = Vec::new();
    for pair in pairs.iter().take(PAIRS) {
        for &frame in asked {
            speeds.extend(
                first[pair.views[0]].strands.moving(frame as i64).map(|m| m.per_frame.norm() * pair.focal_px()),
            );
        }
    }
    if speeds.is_empty() {
        return USUAL_NOISE_PX;
    }
    let middle = speeds.len() / 2;
    let median = *speeds.select_nth_unstable_by(middle, f64::total_cmp).1;
    USUAL_NOISE_PX + 0.5 * median
}

/// Shares of lines with a dot near them in consecutive parts of the questions; `None` where none could be asked.
fn by_part(questions: &[Question], second: &[View], rate: f64, shift: i64, near_px: f64) -> Vec<Option<f64>> {
    let parts = questions.chunks(questions.len().div_ceil(PARTS).max(1));
    let answers = parts.map(|own| hits(own, second, rate, shift, near_px));
    answers.map(|(count, of)| (of > 0).then(|| count as f64 / of as f64)).collect()
}

/// By how many standard deviations one shift's shares are above another's, part for part (a paired t value).
fn ahead(best: &[Option<f64>], other: &[Option<f64>]) -> f64 {
    let gains: Vec<f64> = best.iter().zip(other).filter_map(|(b, o)| Some((*b)? - (*o)?)).collect();
    let n = gains.len() as f64;
    if n < 4.0 {
        // They share no time: the usual comparison has to do.
        return (best.len() as f64).sqrt();
    }
    let mean = gains.iter().sum::<f64>() / n;
    let variance = gains.iter().map(|g| (g - mean).powi(2)).sum::<f64>() / (n - 1.0);
    mean / (variance / n).sqrt().max(1e-9)
}

/// Lines with a dot near them, and lines that could be asked.
fn hits(questions: &[Question], second: &[View], rate: f64, shift: i64, near_px: f64) -> (usize, usize) {
    let (mut count, mut of) = (0, 0);
    for question in questions {
        let frame = (question.frame as f64 * rate).round() as i64 + shift;
        let view = &second[question.view].strands;
        if frame < 0 || frame >= view.frames() as i64 {
            continue;
        }
        let dots = view.dots(frame);
        of += question.lines.len();
        count += question.lines.iter().filter(|l| dots.iter().any(|p| distance(l, p).abs() < near_px)).count();
    }
    (count, of)
}
