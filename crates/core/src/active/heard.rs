//! What all stretches told of themselves, as evidence for those that told too little: where each LED was around them, and who
//! has it in a frame.

use super::along::{Reading, SURE, Stretch};
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// How far a marker is from where it was last seen (m): at once, by its acceleration (m/s²) as long as its velocity is known,
/// at most by its speed (m/s) afterwards.
const AT_ONCE: f64 = 0.003;
const ACCELERATION: f64 = 20.0;
const SPEED: f64 = 2.0;
/// What is known of a marker that was never told on one side of a stretch: it is within some metres.
const ANYWHERE: f64 = 2.0;
/// Frames on which a velocity rests.
const RUN: usize = 4;
/// Frames around a sample in which another stretch's place tells whose it is; a place that it does not tell of is somewhere
/// within this (m).
const AROUND: i64 = 3;
const SOMEWHERE: f64 = 0.05;
/// A stretch of the same trajectory as the one before or after it is so much likelier the same LED.
const SAME_TRAJECTORY: f64 = 20.0;

/// One moment at which an LED was told.
#[derive(Clone, Copy, Debug)]
struct Moment {
    stretch: usize,
    at: usize,
}

/// What was told.
pub struct Told<'a> {
    stretches: &'a [Stretch],
    /// By word, the moments at which it is surely told, in order of time.
    sure: BTreeMap<usize, Vec<Moment>>,
    /// By frame, the words that are surely told in it.
    by_frame: BTreeMap<i64, Vec<(usize, Moment)>>,
    /// By frame, the words that are told in it, ascending, and how surely at most.
    held: BTreeMap<i64, Vec<(usize, f64)>>,
}

impl<'a> Told<'a> {
    pub fn of(stretches: &'a [Stretch], readings: &[Vec<Reading>]) -> Self {
        let mut told = Self { stretches, sure: BTreeMap::new(), by_frame: BTreeMap::new(), held: BTreeMap::new() };
        for (k, (stretch, readings)) in stretches.iter().zip(readings).enumerate() {
            for (at, (frame, reading)) in stretch.frames.iter().zip(readings).enumerate() {
                let Reading { word: Some(word), chance } = reading else { continue };
                told.held.entry(*frame).or_default().push((*word, *chance));
                if *chance > SURE {
                    told.sure.entry(*word).or_default().push(Moment { stretch: k, at });
                    told.by_frame.entry(*frame).or_default().push((*word, Moment { stretch: k, at }));
                }
            }
        }
        let time = |m: &Moment| stretches[m.stretch].times_s[m.at];
        for held in told.held.values_mut() {
            held.sort_by(|a, b| a.0.cmp(&b.0).then(b.1.total_cmp(&a.1)));
            held.dedup_by_key(|h| h.0);
        }
        told.sure.values_mut().for_each(|own| own.sort_by(|a, b| time(a).total_cmp(&time(b))));
        told
    }

    /// Words that another stretch has in a frame, more surely than this one, which reads itself so.
    pub fn held_by_others(&self, frame: i64, own: Reading) -> impl Iterator<Item = usize> {
        let held = self.held.get(&frame).into_iter().flatten();
        let mine = move |word| if own.word == Some(word) { own.chance } else { 0.0 };
        held.filter(move |(word, most)| *most > 0.5 && *most > mine(*word)).map(|h| h.0)
    }

    /// Words that other stretches lead to the place of a sample, and how much likelier each is for it.
    pub fn led_here(&self, stretch: usize, at: usize) -> Vec<(usize, f64)> {
        let own = &self.stretches[stretch];
        let (frame, place) = (own.frames[at], own.places[at]);
        let mut found: Vec<(usize, f64)> = Vec::new();
        let around = self.by_frame.range(frame - AROUND..=frame + AROUND).filter(|(f, _)| **f != frame);
        for (word, moment) in around.flat_map(|(_, told)| told).filter(|(_, m)| m.stretch != stretch) {
            let other = &self.stretches[moment.stretch];
            if (other.places[moment.at] - place).norm() > 2.0 * SOMEWHERE {
                continue;
            }
            let expected = Expected::of(other, moment.at, own.times_s[at]);
            let off = (place - expected.place).norm() / expected.spread_m;
            let likelier = (-0.5 * off * off).exp() * (SOMEWHERE / expected.spread_m).powi(3);
            if likelier > 1.0 {
                found.push((*word, likelier));
            }
        }
        found.sort_by(|a, b| a.0.cmp(&b.0).then(b.1.total_cmp(&a.1)));
        found.dedup_by_key(|f| f.0);
        found
    }

    /// How likely a stretch is an LED's by where that was before and after it (density of place, m⁻³ on either side).
    pub fn likely(&self, stretch: &Stretch, word: usize) -> f64 {
        let none = Vec::new();
        let told = self.sure.get(&word).unwrap_or(&none);
        let last = stretch.times_s.len() - 1;
        let (from, until) = (stretch.times_s[0], stretch.times_s[last]);
        let time = |m: &Moment| self.stretches[m.stretch].times_s[m.at];
        let before = told.partition_point(|m| time(m) < from).checked_sub(1).map(|k| told[k]);
        let after = told.get(told.partition_point(|m| time(m) <= until)).copied();
        let density = |moment: Option<Moment>, time_s: f64, place: &Vector3<f64>| {
            let (off, spread, same) = moment.map_or((0.0, ANYWHERE, 1.0), |m| {
                let Expected { place: expected, spread_m: spread } =
                    Expected::of(&self.stretches[m.stretch], m.at, time_s);
                let same = if self.stretches[m.stretch].track == stretch.track { SAME_TRAJECTORY } else { 1.0 };
                ((place - expected).norm(), spread, same)
            });
            same * (-0.5 * (off / spread).powi(2)).exp().max(1e-9) / spread.powi(3)
        };
        density(before, from, &stretch.places[0]) * density(after, until, &stretch.places[last])
    }
}

/// Where a marker is at another time than that of a sample, and how far off that may be (m).
pub struct Expected {
    pub place: Vector3<f64>,
    pub spread_m: f64,
}

impl Expected {
    /// From the motion of a stretch up to a sample of it (from there on, for a time before it).
    pub fn of(stretch: &Stretch, at: usize, time_s: f64) -> Self {
        let away_s = time_s - stretch.times_s[at];
        let run = if away_s > 0.0 { at.checked_sub(RUN.min(at.max(1))) } else { Some(at + RUN) };
        let place = stretch.places[at];
        let slow = SPEED * away_s.abs();
        let led = run.filter(|r| *r < stretch.times_s.len()).map(|r| {
            let base_s = stretch.times_s[at] - stretch.times_s[r];
            let velocity = (place - stretch.places[r]) / base_s;
            (place + velocity * away_s, 0.5 * ACCELERATION * away_s.abs() * (away_s.abs() + base_s.abs()))
        });
        match led.filter(|(_, spread)| *spread < slow) {
            Some((place, spread)) => Self { place, spread_m: AT_ONCE + spread },
            None => Self { place, spread_m: (AT_ONCE + slow).min(ANYWHERE) },
        }
    }
}
