//! Clocks of two recordings of one scene, from the motion of the markers that both saw (epipolar consistency).
//!
//! Both recordings are of one calibrated rig; each has its own clock. At the true offset a dot of the first has, in every
//! camera of the second that sees the marker, a dot on its epipolar line. `crate::strands` links each camera's dots so that they
//! have a place between frames; `coarse` tries all whole shifts; `fine` solves offset and rate. After Caspi & Irani 2002,
//! "Spatio-temporal alignment of sequences", without correspondence: which dot is whose is never asked.
//!
//! Cost: shifts × frames asked × lines × dots for the coarse look. Not handled: recordings that share no moment, scenes in
//! which nothing moves (refused: nothing stands out), cameras that stand on one line with all motion.

mod coarse;
mod epipolar;
mod fine;
mod view;

pub use fine::Fine;
pub use view::View;

use crate::camera::Camera;
use epipolar::CameraPair;

/// Pairs of cameras that are used.
const MOST_PAIRS: usize = 24;
/// The best shift must stand above the usual and ahead of the next by this many standard deviations.
const LEAST_ABOVE: f64 = 6.0;
const LEAST_AHEAD: f64 = 5.0;
/// A clock is known where its shift in the middle is known to this (frames).
const LARGEST_SIGMA: f64 = 0.25;

/// Why two recordings cannot be aligned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NoSync {
    /// There is nothing to compare: no dots, no common moment, or all cameras at one place.
    NothingInCommon,
    /// No shift stands out.
    NoPeak {
        /// Share of dots that fit at the best shift.
        best: f64,
        /// Share of dots that fit by chance.
        chance: f64,
    },
    /// Two shifts fit alike: the motion repeats itself or stands still.
    SeveralPeaks,
    /// Too little moves across the lines to tell fractions of a frame.
    TooLittleMotion,
}

/// The second recording's clock against the first's. `rate`: nominal frames of the second per frame of the first.
pub fn synchronise(cameras: &[Camera], first: &[View], second: &[View], rate: f64) -> Result<Fine, NoSync> {
    let pairs = pairs(cameras, first, second);
    let found = coarse::coarse(first, second, &pairs, rate).ok_or(NoSync::NothingInCommon)?;
    if found.above < LEAST_ABOVE {
        return Err(NoSync::NoPeak { best: found.share, chance: found.by_chance });
    }
    if found.ahead < LEAST_AHEAD {
        return Err(NoSync::SeveralPeaks);
    }
    let fine = fine::fine(first, second, &pairs, rate, &found).ok_or(NoSync::TooLittleMotion)?;
    if fine.middle_sigma.is_nan() || fine.middle_sigma > LARGEST_SIGMA {
        return Err(NoSync::TooLittleMotion);
    }
    Ok(fine)
}

/// Pairs of a camera of each recording, those that saw most first; each camera comes once before any comes twice.
fn pairs(cameras: &[Camera], first: &[View], second: &[View]) -> Vec<CameraPair> {
    let mut all: Vec<(usize, CameraPair)> = Vec::new();
    for (i, a) in first.iter().enumerate() {
        for (j, b) in second.iter().enumerate() {
            if let Some(pair) = CameraPair::new([i, j], &cameras[a.camera], &cameras[b.camera]) {
                all.push((a.strands.len().min(b.strands.len()), pair));
            }
        }
    }
    all.retain(|(seen, _)| *seen > 0);
    all.sort_by_key(|(seen, pair)| (std::cmp::Reverse(*seen), pair.views));
    let (mut used, mut ordered) = ([vec![0; first.len()], vec![0; second.len()]], Vec::new());
    while ordered.len() < MOST_PAIRS && !all.is_empty() {
        let least_used = |(_, (_, p)): &(usize, &(usize, CameraPair))| used[0][p.views[0]] + used[1][p.views[1]];
        let Some((at, _)) = all.iter().enumerate().min_by_key(least_used) else { break };
        let (_, pair) = all.remove(at);
        used[0][pair.views[0]] += 1;
        used[1][pair.views[1]] += 1;
        ordered.push(pair);
    }
    ordered
}
