//! How the LEDs of a take are driven: frames that a bit lasts, and where in its word each LED stands.

use super::codes::{LENGTH, book};
use std::collections::BTreeMap;

/// Bits that last longer than this many frames are not looked for.
const MOST_FRAMES_PER_BIT: usize = 10;
/// Share of the brightness's changes that the words must explain.
const EXPLAINED: f64 = 0.5;
/// Periods of dots that a word needs for its phase to be known.
const LEAST_PERIODS: usize = 2;

/// Frames per bit, and the phases of the words that are known: a word is at bit (frame + phase) / frames per bit.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Driving {
    pub frames_per_bit: usize,
    pub phases: BTreeMap<usize, usize>,
}

impl Driving {
    /// What explains the brightness of dots that were told: by word and camera, frames and logarithms of the brightness.
    /// `None` where no driving does, because the identities are not those of the book.
    pub fn of(told: &BTreeMap<(usize, usize), Vec<(i64, f64)>>) -> Option<Self> {
        let tried = (1..=MOST_FRAMES_PER_BIT).filter_map(|frames_per_bit| Self::with(frames_per_bit, told));
        let best = tried.max_by(|a, b| a.1.total_cmp(&b.1))?;
        (best.1 > EXPLAINED).then_some(best.0)
    }

    /// Frames after which all repeats itself.
    pub fn period(&self) -> usize {
        LENGTH * self.frames_per_bit
    }

    /// Whether a word at a phase is bright in a frame.
    pub fn is_bright(&self, word: usize, phase: usize, frame: i64) -> bool {
        let at = frame.rem_euclid(self.period() as i64) as usize;
        book()[word].is_bright((at + phase) / self.frames_per_bit)
    }

    fn with(frames_per_bit: usize, told: &BTreeMap<(usize, usize), Vec<(i64, f64)>>) -> Option<(Self, f64)> {
        let mut driving = Self { frames_per_bit, phases: BTreeMap::new() };
        let period = driving.period();
        // By word: what is above the mean of its camera, in each frame of the period; how much there is, of how many dots.
        let mut folded: BTreeMap<usize, (Vec<f64>, f64, usize)> = BTreeMap::new();
        for ((word, _), dots) in told.iter().filter(|((word, _), _)| *word < book().len()) {
            let mean = dots.iter().map(|d| d.1).sum::<f64>() / dots.len() as f64;
            let own = folded.entry(*word).or_insert_with(|| (vec![0.0; period], 0.0, 0));
            for (frame, level) in dots {
                own.0[frame.rem_euclid(period as i64) as usize] += level - mean;
                own.1 += (level - mean).abs();
            }
            own.2 += dots.len();
        }
        let (mut explained, mut all) = (0.0, 0.0);
        for (word, (sums, size, count)) in folded {
            let score = |phase: usize| {
                let signed =
                    |(at, sum): (usize, &f64)| if driving.is_bright(word, phase, at as i64) { *sum } else { -sum };
                sums.iter().enumerate().map(signed).sum::<f64>()
            };
            let (phase, best) = (0..period).map(|p| (p, score(p))).max_by(|a, b| a.1.total_cmp(&b.1))?;
            if best > EXPLAINED * size && count >= LEAST_PERIODS * period {
                driving.phases.insert(word, phase);
            }
            (explained, all) = (explained + best, all + size);
        }
        (all > 0.0 && !driving.phases.is_empty()).then(|| (driving, explained / all))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slow_leds_are_found_with_their_phases() {
        let truth = Driving { frames_per_bit: 3, phases: [(4, 11), (90, 60)].into() };
        let dots = |(&word, &phase): (&usize, &usize)| {
            let level = |f| if truth.is_bright(word, phase, f) { 5.0 } else { 4.2 };
            ((word, 0), (0..300).map(|f| (f, level(f))).collect::<Vec<_>>())
        };
        assert_eq!(Driving::of(&truth.phases.iter().map(dots).collect()), Some(truth));
    }

    #[test]
    fn identities_of_other_hardware_are_not_read_as_words() {
        let dots = |word: usize| ((word, 0), (0..300).map(|f| (f, (f as f64 * 0.7).sin())).collect::<Vec<_>>());
        assert_eq!(Driving::of(&(0..5).map(dots).collect()), None);
        assert_eq!(Driving::of(&(500..505).map(dots).collect()), None);
    }
}
