//! Which LED a trajectory is, from what all cameras saw along it.
//!
//! One camera's strand must be a dozen frames long to name an LED. Where the LEDs' words and phases are known from long
//! strands, and all cameras are read together, a few frames name a marker that comes back, and dots that merge in some
//! cameras are told by the others. The reading is a hidden Markov model as in `decode.rs`, whose states are the words that
//! the take has; each camera's brightness says what it can (`levels.rs`), and all of them in a frame say so much at most.

use super::codes::book;
use super::driving::Driving;
use super::heard::{Expected, Told};
use super::levels::{Levels, Light, middle};
use super::pairs::part;
use nalgebra::Vector3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Probability that a frame's dots are not the trajectory's own, so that they say nothing.
const STRAY: f64 = 0.02;
/// Probability per frame that the trajectory goes over to another marker, where it moves on smoothly.
const CHANGES_OVER: f64 = 1e-3;
/// A trajectory that is no LED, beforehand.
const NO_LED: f64 = 1e-3;
/// Periods that are read at once for words that are not known, and how clear (nats) a word at a phase must be in all of them
/// together; of those in which it is hardly the best nothing is believed.
const PERIODS_READ: usize = 2;
const CLEAR: f64 = 20.0;
const LEAST_CLEAR: f64 = 3.0;
/// A probability that leaves no doubt.
pub const SURE: f64 = 0.999;
/// Times that all is read with what the others told in mind, and how likely it is that two are one LED in a frame.
const ROUNDS: usize = 2;
const TWICE: f64 = 1e-2;

/// One dot of a trajectory.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// The camera that saw it.
    pub camera: usize,
    /// How bright it is, and how far away.
    pub light: Light,
    /// What the dot itself told.
    pub told: Option<usize>,
}

/// A stretch of a trajectory without long holes.
#[derive(Clone, Debug, Default)]
pub struct Stretch {
    /// The trajectory.
    pub track: u32,
    /// Numbers of its frames.
    pub frames: Vec<i64>,
    /// Their times (s).
    pub times_s: Vec<f64>,
    /// Where it is in them (m).
    pub places: Vec<Vector3<f64>>,
    /// In each frame the dots that are its alone.
    pub dots: Vec<Vec<Seen>>,
}

/// What a sample is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reading {
    /// The likeliest word, `None` if it is likeliest no LED.
    pub word: Option<usize>,
    /// Its probability.
    pub chance: f64,
}

/// Reads all stretches. `None` where the dots' identities and brightness are not those of the code book.
pub fn read(stretches: &[Stretch]) -> Option<Vec<Vec<Reading>>> {
    let dots = || {
        stretches.iter().flat_map(|s| s.frames.iter().zip(&s.dots).flat_map(|(f, d)| d.iter().map(move |d| (*f, d))))
    };
    let mut told: BTreeMap<(usize, usize), Vec<(i64, f64)>> = BTreeMap::new();
    for (frame, dot) in dots() {
        let Some(word) = dot.told.filter(|_| dot.light.ln_brightness.is_finite()) else { continue };
        told.entry((word, dot.camera)).or_default().push((frame, dot.light.ln_brightness));
    }
    let mut driving = Driving::of(&told)?;
    let mut known: BTreeMap<usize, Vec<(Light, bool)>> = BTreeMap::new();
    for (frame, dot) in dots() {
        let Some((word, phase)) = dot.told.and_then(|w| driving.phases.get_key_value(&w)) else { continue };
        known.entry(dot.camera).or_default().push((dot.light, driving.is_bright(*word, *phase, frame)));
    }
    let levels = known.iter().filter_map(|(camera, dots)| Some((*camera, Levels::of(dots)?))).collect();
    let bits: Vec<Vec<f64>> = stretches.par_iter().map(|s| for_bright(s, &levels, driving.period())).collect();
    learn_phases(&mut driving, stretches, &bits);
    let words = Words::of(&driving);
    let mut readings: Vec<Vec<Reading>> = Vec::new();
    for round in 0..=ROUNDS {
        let told = (round > 0).then(|| Told::of(stretches, &readings));
        let one = |(k, (stretch, bits)): (usize, (&Stretch, &Vec<f64>))| {
            let Some(told) = &told else { return words.read(stretch, bits, &words.prior(|_| 1.0), |_| Vec::new()) };
            let prior = words.prior(|word| told.likely(stretch, word));
            words.read(stretch, bits, &prior, |at| {
                let others = told.held_by_others(stretch.frames[at], readings[k][at]).map(|word| (word, TWICE));
                others.chain(told.led_here(k, at)).collect()
            })
        };
        let next = stretches.par_iter().zip(&bits).enumerate().map(one).collect();
        readings = next;
    }
    part(stretches, &bits, &driving, &mut readings);
    Some(readings)
}

/// For each frame, the logarithm of how much likelier its dots are if the LED is bright.
fn for_bright(stretch: &Stretch, levels: &BTreeMap<usize, Levels>, period: usize) -> Vec<f64> {
    let (first, last) = (stretch.frames[0], stretch.frames[stretch.frames.len() - 1]);
    let length = (last - first + 1) as usize;
    let mut strands: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
    for (frame, dots) in stretch.frames.iter().zip(&stretch.dots) {
        for dot in dots {
            let strand = strands.entry(dot.camera).or_insert_with(|| vec![f64::NAN; length]);
            strand[(frame - first) as usize] = dot.light.ln_brightness;
        }
    }
    let whole: BTreeMap<usize, bool> = strands
        .iter()
        .map(|(camera, strand)| (*camera, strand.iter().filter(|l| l.is_finite()).count() >= period))
        .collect();
    let says = |at: usize, dot: &Seen| {
        let levels = levels.get(&dot.camera).filter(|_| dot.light.ln_brightness.is_finite())?;
        let own = whole[&dot.camera].then(|| middle(&strands[&dot.camera], at, period)).flatten();
        let own = own.filter(|(_, step)| levels.is_step(*step)).map(|m| m.0);
        Some(levels.for_bright(&dot.light, own))
    };
    let of = |(frame, dots): (&i64, &Vec<Seen>)| dots.iter().filter_map(|d| says((frame - first) as usize, d)).sum();
    stretch.frames.iter().zip(&stretch.dots).map(of).collect()
}

/// Probabilities of what was seen in a frame if the LED is dim, and if it is bright.
pub fn chances(for_bright: f64) -> [f64; 2] {
    let bright = 1.0 / (1.0 + (-for_bright).exp());
    [1.0 - bright, bright].map(|own| (1.0 - STRAY) * own + STRAY * 0.5)
}

/// Adds the phases of words that only all cameras together tell.
fn learn_phases(driving: &mut Driving, stretches: &[Stretch], bits: &[Vec<f64>]) {
    let (period, most) = (driving.period(), PERIODS_READ * driving.period());
    let windows: Vec<(&[i64], &[f64])> = stretches
        .iter()
        .zip(bits)
        .flat_map(|(s, bits)| s.frames.chunks(most).zip(bits.chunks(most)))
        .filter(|w| w.0.len() >= period)
        .collect();
    let found: Vec<(usize, usize, f64)> = windows.into_par_iter().map(|(f, b)| best_word(driving, f, b)).collect();
    let mut clear: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
    for (word, phase, by) in found.into_iter().filter(|f| f.2 > LEAST_CLEAR) {
        clear.entry(word).or_insert_with(|| vec![0.0; period])[phase] += by;
    }
    for (word, clear) in clear {
        let Some((phase, &most)) = clear.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)) else { continue };
        if most > CLEAR && 2.0 * most > clear.iter().sum() {
            driving.phases.entry(word).or_insert(phase);
        }
    }
}

/// The word and phase that a window shows, and how clear that is (nats).
fn best_word(driving: &Driving, frames: &[i64], bits: &[f64]) -> (usize, usize, f64) {
    let period = driving.period();
    let mut folded = vec![0.0; period];
    for (frame, bit) in frames.iter().zip(bits) {
        let [dim, bright] = chances(*bit);
        folded[frame.rem_euclid(period as i64) as usize] += 0.5 * (bright / dim).ln();
    }
    let (mut best, mut second) = ((0, 0, f64::NEG_INFINITY), f64::NEG_INFINITY);
    for word in 0..book().len() {
        for phase in 0..period {
            let signed = |(at, sum): (usize, &f64)| if driving.is_bright(word, phase, at as i64) { *sum } else { -sum };
            let score: f64 = folded.iter().enumerate().map(signed).sum();
            if score > best.2 {
                // The neighbouring phases of slow bits are no rivals.
                second = if word == best.0 { second } else { best.2 };
                best = (word, phase, score);
            } else if word != best.0 {
                second = second.max(score);
            }
        }
    }
    (best.0, best.1, best.2 - second)
}

/// How likely a stretch has gone over to another marker since the sample before, by how far that leads away from it.
fn changes_over(stretch: &Stretch, k: usize) -> f64 {
    let Some(before) = k.checked_sub(1) else { return 0.0 };
    let expected = Expected::of(stretch, before, stretch.times_s[k]);
    let off = (stretch.places[k] - expected.place).norm() / expected.spread_m;
    let odds = CHANGES_OVER * (0.5 * off * off).min(20.0).exp();
    odds / (1.0 + odds)
}

/// The words of a take with their phases.
struct Words {
    period: usize,
    known: Vec<usize>,
    /// By frame of the period: whether each word is bright.
    bright: Vec<Vec<bool>>,
}

impl Words {
    fn of(driving: &Driving) -> Self {
        let at = |frame: usize| driving.phases.iter().map(|(w, p)| driving.is_bright(*w, *p, frame as i64)).collect();
        let bright = (0..driving.period()).map(at).collect();
        Self { period: driving.period(), known: driving.phases.keys().copied().collect(), bright }
    }

    /// Probability of each word, and of no LED, beforehand, by how likely each word is against the others.
    fn prior(&self, likely: impl Fn(usize) -> f64) -> Vec<f64> {
        let mut prior: Vec<f64> = self.known.iter().map(|w| likely(*w)).collect();
        let sum: f64 = prior.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        prior.iter_mut().for_each(|p| *p *= (1.0 - NO_LED) / sum);
        prior.push(NO_LED);
        prior
    }

    /// Forwards and backwards (Rabiner 1989, §III). `others`: by place in the stretch, words of which the other stretches say
    /// something there, and how much likelier that makes each.
    fn read(
        &self,
        stretch: &Stretch,
        bits: &[f64],
        prior: &[f64],
        others: impl Fn(usize) -> Vec<(usize, f64)>,
    ) -> Vec<Reading> {
        let n = stretch.frames.len();
        let others: Vec<Vec<(usize, f64)>> = (0..n).map(others).collect();
        let weigh = |chance: &mut [f64], k: usize| {
            self.weigh(chance, stretch.frames[k], bits[k]);
            for (word, likelier) in &others[k] {
                self.known.binary_search(word).into_iter().for_each(|place| chance[place] *= likelier);
            }
            let sum: f64 = chance.iter().sum();
            chance.iter_mut().for_each(|c| *c /= sum);
        };
        let over: Vec<f64> = (0..n).map(|k| changes_over(stretch, k)).collect();
        let mut forward: Vec<Vec<f64>> = Vec::with_capacity(n);
        let mut now = prior.to_vec();
        for (k, over) in over.iter().enumerate() {
            now.iter_mut().zip(prior).for_each(|(c, p)| *c = (1.0 - over) * *c + over * p);
            weigh(&mut now, k);
            forward.push(now.clone());
        }
        let mut readings = vec![Reading::default(); n];
        let mut after = vec![1.0; prior.len()];
        for k in (0..n).rev() {
            let joint: Vec<f64> = forward[k].iter().zip(&after).map(|(f, a)| f * a).collect();
            readings[k] = self.reading(&joint);
            weigh(&mut after, k);
            let anew: f64 = after.iter().zip(prior).map(|(a, p)| a * p).sum();
            after.iter_mut().for_each(|a| *a = (1.0 - over[k]) * *a + over[k] * anew);
        }
        readings
    }

    fn reading(&self, joint: &[f64]) -> Reading {
        let best = (0..joint.len()).max_by(|a, b| joint[*a].total_cmp(&joint[*b])).unwrap_or_default();
        Reading { word: self.known.get(best).copied(), chance: joint[best] / joint.iter().sum::<f64>() }
    }

    fn weigh(&self, chance: &mut [f64], frame: i64, bit: f64) {
        let likely = chances(bit);
        let bright = &self.bright[frame.rem_euclid(self.period as i64) as usize];
        let (words, other) = chance.split_at_mut(self.known.len());
        words.iter_mut().zip(bright).for_each(|(c, b)| *c *= likely[usize::from(*b)]);
        other[0] *= 0.5;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::random::Random;

    const PHASES: [(usize, usize); 4] = [(3, 5), (40, 17), (77, 0), (101, 9)];

    fn driving() -> Driving {
        Driving { frames_per_bit: 1, phases: PHASES.into() }
    }

    /// An LED at a place, seen by three cameras with 5 % wrong bits; `told`: whether its dots tell who they are.
    fn stretch(track: u32, word: usize, frames: std::ops::Range<i64>, place: Vector3<f64>, told: bool) -> Stretch {
        let mut random = Random::new(word as u64, frames.start as u64);
        let phase = driving().phases[&word];
        let mut made = Stretch { track, ..Stretch::default() };
        for frame in frames {
            let mut seen = |camera: usize| {
                let bright = driving().is_bright(word, phase, frame) ^ random.happens(0.05);
                let ln_brightness = 4.0 + 0.1 * camera as f64 + if bright { 0.8 } else { 0.0 } + 0.03 * random.normal();
                Seen { camera, light: Light { ln_brightness, ln_distance: 1.0 }, told: told.then_some(word) }
            };
            made.dots.push((0..3).map(&mut seen).collect());
            made.frames.push(frame);
            made.times_s.push(frame as f64 / 100.0);
            made.places.push(place + Vector3::new(0.01 * frame as f64, 0.0, 0.0));
        }
        made
    }

    fn words(readings: &[Reading]) -> Vec<Option<usize>> {
        readings.iter().map(|r| r.word).collect()
    }

    #[test]
    fn a_few_frames_of_all_cameras_name_a_marker_that_comes_back() {
        let away = |k: usize| Vector3::new(0.0, 0.3 * k as f64, 0.0);
        let mut all: Vec<Stretch> = (0..3).map(|k| stretch(k as u32, PHASES[k].0, 0..200, away(k), true)).collect();
        // Three take turns in short stretches, under names of their own, not far from where they were last seen.
        all.extend((0..3).map(|k| stretch(10 + k as u32, PHASES[k].0, 215..222, away(k) + away(1) * 0.2, false)));
        let readings = read(&all).unwrap();
        for k in 0..3 {
            assert_eq!(words(&readings[k]), vec![Some(PHASES[k].0); 200]);
            assert_eq!(words(&readings[3 + k]), vec![Some(PHASES[k].0); 7]);
        }
    }

    #[test]
    fn a_word_that_no_camera_could_tell_alone_is_learned() {
        let mut all = vec![stretch(0, 3, 0..200, Vector3::zeros(), true)];
        all.push(stretch(1, 40, 0..100, Vector3::new(0.0, 1.0, 0.0), false));
        assert_eq!(words(&read(&all).unwrap()[1]), vec![Some(40); 100]);
    }

    #[test]
    fn near_leds_exchanged_for_two_frames_are_given_back() {
        let mut pair = [
            stretch(0, 77, 0..150, Vector3::zeros(), true),
            stretch(1, 101, 0..150, Vector3::new(0.0, 0.011, 0.0), true),
        ];
        let [one, other] = &mut pair;
        for k in [70, 71] {
            std::mem::swap(&mut one.places[k], &mut other.places[k]);
            std::mem::swap(&mut one.dots[k], &mut other.dots[k]);
        }
        let readings = read(&pair).unwrap();
        let expected =
            |own: usize, other: usize| (0..150).map(move |k| Some(if k == 70 || k == 71 { other } else { own }));
        assert_eq!(words(&readings[0]), expected(77, 101).collect::<Vec<_>>());
        assert_eq!(words(&readings[1]), expected(101, 77).collect::<Vec<_>>());
    }

    #[test]
    fn identities_of_other_hardware_are_left_alone() {
        let mut all = vec![stretch(0, 3, 0..200, Vector3::zeros(), true)];
        all[0].dots.iter_mut().flatten().for_each(|d| d.told = Some(5000));
        assert!(read(&all).is_none());
    }
}
