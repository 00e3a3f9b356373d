//! Which LED a dot is, from how bright its strand was over time.
//!
//! A strand is one camera's dots linked from frame to frame. Its brightness has two levels, found anew around every frame,
//! because an LED that comes nearer grows brighter. Its bits are read by a hidden Markov model: the state is a word of the
//! code book with its phase, or something that is no LED; from frame to frame it stays, but rarely the strand has gone
//! over to another marker. Forward–backward (Rabiner 1989, §III) gives each frame's probability of each word, from all
//! bits before and after. A dot is told only if that leaves no doubt; near a place where a strand changes over it does.
//!
//! An LED keeps its phase. What long strands tell of the words' phases is used to read all strands again: then a dozen bits
//! name a word, where a whole period is needed as long as any phase is possible.
//!
//! Cost: words × phases per dot, four times.

use super::codes::{LENGTH, Word, book};
use super::levels::middle;
use crate::strands::Strands;
use rayon::prelude::*;

/// Probability that a bit is read wrongly: more than it should be, so that nothing is told too early.
const WRONG_BIT: f32 = 0.08;
/// Probability per frame that a strand goes over to another marker.
const CHANGES_OVER: f32 = 1e-4;
/// A strand that is no LED at all, beforehand.
const NO_LED: f32 = 0.01;
/// Share of a word's dots that must agree on its phase, and their least number in periods.
const AGREED: f64 = 0.9;
const LEAST_PERIODS: usize = 2;
/// How likely it is that an LED is not at the phase that is known of it.
const OTHER_PHASE: f32 = 1e-4;
/// Frames in a row that a dot may be missed without its strand coming to an end.
const LONGEST_GAP: usize = 3;
/// Fewer bits name no word, however much is known.
const LEAST_BITS: usize = 6;
/// Probability of a word from which on it is told.
const SURE: f32 = 0.9999;
/// Smallest difference of the two levels (natural logarithm): less is the noise of one level.
const LEAST_STEP: f64 = 0.25;
/// Part of the difference around the middle where a bit cannot be read.
const UNREADABLE: f64 = 0.15;

/// How the LEDs are driven.
#[derive(Clone, Copy, Debug)]
pub struct Blinking {
    /// Frames that a bit lasts.
    pub frames_per_bit: usize,
}

/// The word (its place in the book) of each dot, counted through all frames; `None` where it is not sure.
///
/// No marker's image goes farther than `largest` (as the strands' places) from where it is expected.
pub fn decode(strands: &Strands, brightness: &[f64], largest: f64, blinking: Blinking) -> Vec<Option<usize>> {
    let mut states = States::new(blinking);
    let all = strands.bridged(LONGEST_GAP, largest);
    // Frames that were missed on the way have no bit.
    let read = |strand: &Vec<(usize, usize)>| {
        let first = strand[0].0;
        let mut levels = vec![f64::NAN; strand[strand.len() - 1].0 + 1 - first];
        strand.iter().for_each(|(frame, dot)| levels[frame - first] = brightness[*dot]);
        (first, bits(&levels, states.period))
    };
    let bits: Vec<(usize, Vec<Option<bool>>)> = all.par_iter().map(read).collect();
    let told = |states: &States| -> Vec<Vec<Option<(usize, usize)>>> {
        bits.par_iter().map(|(first, bits)| states.told(*first, bits)).collect()
    };
    let once = told(&states);
    states.learn_phases(once.iter().flatten().flatten());
    let mut found = vec![None; strands.len()];
    for (strand, told) in all.iter().zip(told(&states)) {
        strand.iter().for_each(|(frame, dot)| found[*dot] = told[frame - strand[0].0].map(|t| t.0));
    }
    found
}

/// Bits of a strand: whether a frame is bright, as far as that can be read from a period around it.
fn bits(brightness: &[f64], period: usize) -> Vec<Option<bool>> {
    let logs: Vec<f64> = brightness.iter().map(|b| if *b > 0.0 { b.ln() } else { f64::NAN }).collect();
    (0..logs.len())
        .map(|k| {
            let (middle, step) = middle(&logs, k, period)?;
            let above = logs[k] - middle;
            (step > LEAST_STEP && above.abs() > UNREADABLE * step).then_some(above > 0.0)
        })
        .collect()
}

/// Words with their phases.
struct States {
    period: usize,
    /// By frame modulo the period: whether the LED of each state is bright then, 1 or 0.
    bright: Vec<Vec<f32>>,
    words: usize,
    /// Probability of each state, and of no LED, beforehand.
    prior: Vec<f32>,
}

impl States {
    fn new(blinking: Blinking) -> Self {
        let period = LENGTH * blinking.frames_per_bit.max(1);
        let words: &[Word] = book();
        let at = |frame: usize| {
            let of = |w: &Word| {
                let w = *w;
                (0..period).map(move |phase| {
                    f32::from(u8::from(w.is_bright((frame + phase) % period / blinking.frames_per_bit.max(1))))
                })
            };
            words.iter().flat_map(of).collect()
        };
        let n = words.len() * period;
        let mut prior = vec![(1.0 - NO_LED) / n as f32; n];
        prior.push(NO_LED);
        Self { period, bright: (0..period).map(at).collect(), words: words.len(), prior }
    }

    /// From words with phases that were told: an LED is where it was, and words that nobody told are rare.
    fn learn_phases<'a>(&mut self, told: impl Iterator<Item = &'a (usize, usize)>) {
        let mut counts = vec![0_usize; self.words * self.period];
        told.for_each(|(word, phase)| counts[word * self.period + phase] += 1);
        let known: Vec<usize> = (0..self.words)
            .filter_map(|word| {
                let own = &counts[word * self.period..(word + 1) * self.period];
                let (phase, most) = own.iter().enumerate().max_by_key(|(_, n)| **n)?;
                let of: usize = own.iter().sum();
                let sure = *most >= LEAST_PERIODS * self.period && *most as f64 >= AGREED * of as f64;
                sure.then_some(word * self.period + phase)
            })
            .collect();
        if known.is_empty() {
            return;
        }
        let n = self.words * self.period;
        self.prior[..n].fill(OTHER_PHASE / n as f32);
        for state in &known {
            self.prior[*state] = (1.0 - NO_LED) / known.len() as f32;
        }
    }

    /// Word and phase of each frame of a strand that begins in frame `first`.
    fn told(&self, first: usize, bits: &[Option<bool>]) -> Vec<Option<(usize, usize)>> {
        if bits.iter().flatten().count() < LEAST_BITS {
            return vec![None; bits.len()];
        }
        let mut forward: Vec<Vec<f32>> = Vec::with_capacity(bits.len());
        let mut now = self.prior.clone();
        for (k, bit) in bits.iter().enumerate() {
            if k > 0 {
                self.move_on(&mut now);
            }
            self.weigh(&mut now, first + k, *bit);
            forward.push(now.clone());
        }
        let mut told = vec![None; bits.len()];
        let mut after = vec![1.0; self.prior.len()];
        for k in (0..bits.len()).rev() {
            told[k] = self.sure(&forward[k], &after);
            self.weigh(&mut after, first + k, bits[k]);
            self.move_back(&mut after);
        }
        told
    }

    /// The strand may have gone over to another marker; sums to one afterwards.
    fn move_on(&self, chance: &mut [f32]) {
        let sum: f32 = chance.iter().sum();
        let stays = (1.0 - CHANGES_OVER) / sum;
        chance.iter_mut().zip(&self.prior).for_each(|(c, prior)| *c = *c * stays + CHANGES_OVER * prior);
    }

    /// The same backwards in time.
    fn move_back(&self, after: &mut [f32]) {
        let over: f32 = after.iter().zip(&self.prior).map(|(a, prior)| a * prior).sum();
        let sum: f32 = after.iter().sum();
        after.iter_mut().for_each(|a| *a = ((1.0 - CHANGES_OVER) * *a + CHANGES_OVER * over) / sum);
    }

    /// Takes in a bit.
    fn weigh(&self, chance: &mut [f32], frame: usize, bit: Option<bool>) {
        let Some(bit) = bit else { return };
        let (if_dim, if_bright) = if bit { (WRONG_BIT, 1.0 - WRONG_BIT) } else { (1.0 - WRONG_BIT, WRONG_BIT) };
        let (words, other) = chance.split_at_mut(self.words * self.period);
        for (c, bright) in words.iter_mut().zip(&self.bright[frame % self.period]) {
            *c *= if_dim + bright * (if_bright - if_dim);
        }
        other[0] *= 0.5;
    }

    /// The word that is sure, with its likeliest phase.
    fn sure(&self, before: &[f32], after: &[f32]) -> Option<(usize, usize)> {
        let joint: Vec<f32> = before.iter().zip(after).map(|(b, a)| b * a).collect();
        let total: f32 = joint.iter().sum();
        let own = |w: usize| &joint[w * self.period..(w + 1) * self.period];
        let word = (0..self.words).find(|&w| own(w).iter().sum::<f32>() > SURE * total)?;
        let phase = own(word).iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?.0;
        Some((word, phase))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::random::Random;
    use nalgebra::Vector2;

    const BLINKING: Blinking = Blinking { frames_per_bit: 1 };

    /// A strand that stands still: one LED after the other, each for some frames, with wrong bits.
    fn strand(leds: &[(usize, usize)], wrong: f64, seed: u64) -> (Strands, Vec<f64>, Vec<usize>) {
        let mut random = Random::new(seed, 0);
        let owner: Vec<usize> = leds.iter().flat_map(|&(led, frames)| vec![led; frames]).collect();
        let level = |(frame, led): (usize, &usize), random: &mut Random| {
            let bright = book()[*led].is_bright(frame + 5 * led) ^ random.happens(wrong);
            (if bright { 200.0 } else { 90.0 }) * (1.0 + 0.001 * frame as f64)
        };
        let brightness = owner.iter().enumerate().map(|at| level(at, &mut random)).collect();
        let frames = vec![vec![Vector2::new(10.0, 10.0)]; owner.len()];
        (Strands::new(&frames, 5.0), brightness, owner)
    }

    #[test]
    fn one_period_without_errors_names_the_led_and_ten_frames_do_not() {
        let (strands, brightness, _) = strand(&[(17, LENGTH)], 0.0, 1);
        // At the very ends the strand may have been another's.
        assert_eq!(decode(&strands, &brightness, 5.0, BLINKING)[1..LENGTH - 1], vec![Some(17); LENGTH - 2]);
        let (strands, brightness, _) = strand(&[(17, 10)], 0.0, 1);
        assert_eq!(decode(&strands, &brightness, 5.0, BLINKING), vec![None; 10]);
    }

    #[test]
    fn what_is_told_is_right_even_where_a_strand_goes_over_to_another_led() {
        let (mut told, mut wrong, mut of) = (0, 0, 0);
        for seed in 0..40 {
            let (strands, brightness, owner) = strand(&[(seed as usize, 150), (seed as usize + 40, 150)], 0.05, seed);
            let found = decode(&strands, &brightness, 5.0, BLINKING);
            of += owner.len();
            told += found.iter().flatten().count();
            wrong += found.iter().zip(&owner).filter(|(f, o)| f.is_some_and(|f| f != **o)).count();
        }
        assert!(told as f64 > 0.9 * f64::from(of as u32), "{told} of {of}");
        assert!(wrong as f64 <= 0.001 * told as f64, "{wrong} of {told}");
    }

    #[test]
    fn a_passive_marker_is_nobody() {
        let mut random = Random::new(3, 0);
        let frames = vec![vec![Vector2::new(10.0, 10.0)]; 400];
        let strands = Strands::new(&frames, 5.0);
        let steady: Vec<f64> = (0..400).map(|_| 150.0 * (1.0 + 0.03 * random.normal())).collect();
        let flickering: Vec<f64> = (0..400).map(|_| random.between(50.0, 250.0)).collect();
        for brightness in [steady, flickering, vec![f64::NAN; 400]] {
            assert!(decode(&strands, &brightness, 5.0, BLINKING).iter().all(Option::is_none));
        }
    }

    #[test]
    fn bits_may_last_several_frames() {
        let word = book()[9];
        let brightness: Vec<f64> = (0..200).map(|f| if word.is_bright((f + 11) / 3) { 200.0 } else { 100.0 }).collect();
        let strands = Strands::new(&vec![vec![Vector2::new(10.0, 10.0)]; 200], 5.0);
        let told = decode(&strands, &brightness, 5.0, Blinking { frames_per_bit: 3 });
        assert_eq!(told[4..196], vec![Some(9); 192]);
    }
}
