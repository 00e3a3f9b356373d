//! Parts of a take through which the vector between the two of a close pair is followed without getting lost.

use super::Pair;
use super::between::{Between, Habit};
use super::fit::{Choice, Pose, both_sides, remembered};
use super::look::{Given, Known, Look, SharedOut};
use crate::track::Sample;
use crate::track::filter::{Filter, Step, fuse};
use nalgebra::{Matrix3, Vector3};
use std::collections::BTreeMap;

/// What a frame that had the two this way is worth, also if they are active markers that told who they are, and what motion
/// from part to part says at most (nats).
const AGREED: f64 = 0.05;
const TOLD: f64 = 1.0;
const MOST_OF_MOTION: f64 = 20.0;
/// Acceleration of the middle of the two (m/s²), and of a push.
const ACCELERATION: f64 = 30.0;
const PUSH: f64 = 40.0;
/// Variance of a middle of which nothing is known (m²).
const UNKNOWN_M2: f64 = 1.0;
/// Two that no camera has seen apart for so long may be one by now (s).
const MERGED_S: f64 = 0.5;

/// What is known on the way through the looks: besides what the next one is told, how the middle of the two moves.
#[derive(Clone)]
struct State {
    known: Known,
    motion: Option<Filter>,
    time_s: f64,
}

/// What one way in time says of a look: before it, and where the two are with it (m).
struct Said {
    known: Known,
    places: [Vector3<f64>; 2],
}

/// Two markers measured anew.
pub struct Anew {
    pub samples: [Sample; 2],
    /// Whether there are two: some camera saw them apart not long before and after.
    pub two: bool,
}

/// A part of the take.
pub struct Part<'a> {
    looks: &'a [Look],
    found: Vec<Option<SharedOut>>,
}

/// The looks of a pair by parts, the dots shared out in each.
pub fn parts<'a>(pair: &Pair, looks: &'a [Look], given: &Given) -> Vec<Part<'a>> {
    let chunks = looks.chunk_by(|a, b| b.time_s - a.time_s <= pair.habit.holds_s());
    chunks.flat_map(|chunk| smoothed(pair, chunk, given)).collect()
}

/// Forwards, backwards, and both together. Where one way in time has the two elsewhere, one of them got lost: there is a
/// new part, in which the surer way counts.
fn smoothed<'a>(pair: &Pair, looks: &'a [Look], given: &Given) -> Vec<Part<'a>> {
    let (before, end) = passed(pair, looks, 0..looks.len(), None, given);
    let (after, _) = passed(pair, looks, (0..looks.len()).rev(), end.map(|s| s.known.between.vector), given);
    let agree = |k: usize| before[k].iter().zip(&after[k]).all(|(a, b)| a.agrees_with(b, &pair.habit));
    let all: Vec<usize> = (0..looks.len()).collect();
    let part = |own: &[usize]| {
        let doubt =
            |ways: &[Option<Said>]| -> f64 { own.iter().filter_map(|&k| Some(ways[k].as_ref()?.ln_spread())).sum() };
        let ways = match (agree(own[0]), doubt(&before) <= doubt(&after)) {
            (true, _) => [Some(&before), Some(&after)],
            (false, true) => [Some(&before), None],
            (false, false) => [None, Some(&after)],
        };
        let known = |k: usize| {
            let said = ways.into_iter().flatten().filter_map(|w| w[k].as_ref()).map(|s| s.known.clone());
            said.reduce(|a, b| a.with(&b))
        };
        let found = own.iter().map(|&k| looks[k].shared_out(&known(k)?, given)).collect();
        Part { looks: &looks[own[0]..=own[own.len() - 1]], found }
    };
    all.chunk_by(|&a, &b| agree(a) == agree(b)).map(part).collect()
}

/// What the frames before say of each frame, in this order, and what is known in the end. It starts with a vector (m), or
/// with the first frame that saw the two apart.
fn passed(
    pair: &Pair,
    looks: &[Look],
    order: impl Iterator<Item = usize>,
    start: Option<Vector3<f64>>,
    given: &Given,
) -> (Vec<Option<Said>>, Option<State>) {
    let mut said: Vec<Option<Said>> = looks.iter().map(|_| None).collect();
    let mut state: Option<State> = None;
    for k in order {
        let look = &looks[k];
        let now = match state.take() {
            Some(state) => Some(state.at(look.time_s, &pair.habit)),
            None => start.or(look.apart).map(|vector| State::starting(vector, &pair.habit)),
        };
        state = now.map(|now| {
            let known = now.known.clone();
            let now = State { time_s: look.time_s, ..now };
            let Some((pose, choices)) = look.taken_in(&known, given) else { return now };
            said[k] = Some(Said { known, places: [pose.place(0).0, pose.place(1).0] });
            now.with(&pose, choices)
        });
    }
    (said, state)
}

impl State {
    fn starting(vector: Vector3<f64>, habit: &Habit) -> Self {
        let between = Between { vector, covariance: Matrix3::identity() * habit.any_way() };
        Self { known: Known { between, middle: None, seen: BTreeMap::new() }, motion: None, time_s: 0.0 }
    }

    fn at(self, time_s: f64, habit: &Habit) -> Self {
        let dt_s = (time_s - self.time_s).abs();
        let step = Step::new(dt_s.max(1e-6));
        let motion = self.motion.map(|mut m| {
            m.predict(&step, ACCELERATION);
            m
        });
        let pushed = Matrix3::identity() * (PUSH * PUSH * step.jump_variance());
        let middle = motion.as_ref().map(|m| (m.position, m.covariance() + pushed));
        let between = self.known.between.after(dt_s, habit);
        Self { known: Known { between, middle, ..self.known }, motion, ..self }
    }

    /// With what a look had.
    fn with(self, pose: &Pose, choices: Vec<(usize, Choice)>) -> Self {
        let (vector, covariance) = pose.between();
        let (place, spread) = pose.middle();
        let seen = choices.into_iter().map(|(camera, choice)| (camera, remembered(choice))).collect();
        let motion = match self.motion {
            Some(mut motion) => {
                motion.update(place, &spread);
                motion
            }
            None => Filter::new(place, &spread, ACCELERATION),
        };
        let known = Known { between: Between { vector, covariance }, middle: None, seen };
        Self { known, motion: Some(motion), ..self }
    }
}

impl Said {
    /// Whether both ways have the two in the same places, and not one of them in the other's.
    fn agrees_with(&self, other: &Self, habit: &Habit) -> bool {
        let squared = |k: usize| (self.places[k] - other.places[k]).norm_squared();
        squared(0) + squared(1) < habit.length_m.powi(2)
    }

    /// Logarithm of the variance of what is said before the look (m²).
    fn ln_spread(&self) -> f64 {
        let middle = self.known.middle.map_or(UNKNOWN_M2, |m| m.1.trace());
        (middle + self.known.between.covariance.trace()).ln()
    }
}

impl Known {
    fn with(mut self, other: &Self) -> Self {
        for (camera, seen) in &other.seen {
            self.seen.entry(*camera).and_modify(|s| *s = both_sides(s, seen)).or_insert(*seen);
        }
        let middle = match (&self.middle, &other.middle) {
            (Some((p, c)), Some((q, d))) => fuse((p, c), (q, d)),
            (one, other) => (*one).or(*other),
        };
        Self { between: self.between.with(&other.between), middle, seen: self.seen }
    }
}

impl Part<'_> {
    /// How surely (nats) the trajectories had the two as they are here, not the other way round.
    fn agreed(&self) -> f64 {
        let agrees = |(look, found): (&Look, &Option<SharedOut>)| {
            let worth = if look.told { TOLD } else { AGREED };
            Some(worth * look.apart?.dot(&found.as_ref()?.pose.between().0).signum())
        };
        self.looks.iter().zip(&self.found).filter_map(agrees).sum()
    }

    /// How surely (nats) another part goes on as this one ended, not the other way round.
    fn goes_on_in(&self, next: &Self, habit: &Habit) -> f64 {
        let end = |part: &Self, k: Option<usize>| {
            let k = k?;
            let (vector, covariance) = part.found[k].as_ref()?.pose.between();
            Some((part.looks[k].time_s, vector, covariance.trace() / 3.0))
        };
        let last = end(self, self.found.iter().rposition(Option::is_some));
        let first = end(next, next.found.iter().position(Option::is_some));
        let (Some((then_s, v, noise)), Some((time_s, w, more))) = (last, first) else { return 0.0 };
        let variance = noise + more + habit.turning * (time_s - then_s);
        (2.0 * v.dot(&w) / variance).clamp(-MOST_OF_MOTION, MOST_OF_MOTION)
    }

    /// By frame, the two under their trajectories' identities.
    pub fn samples(self, tracks: [u32; 2]) -> Vec<(usize, Anew)> {
        let two = two_at(self.looks, &self.found);
        let anew = |((look, found), two): ((&Look, Option<SharedOut>), bool)| {
            Some((look.index, Anew { samples: found?.samples(tracks, look), two }))
        };
        self.looks.iter().zip(self.found).zip(two).filter_map(anew).collect()
    }
}

/// For each part, whether the two have each other's trajectories in it: by what most frames had, and by the vector between
/// them from the end of one part to the beginning of the next (Viterbi 1967).
pub fn turned(parts: &[Part], habit: &Habit) -> Vec<bool> {
    let mut ways = [0.0; 2];
    let mut from: Vec<[usize; 2]> = Vec::with_capacity(parts.len());
    for (k, part) in parts.iter().enumerate() {
        let goes_on = k.checked_sub(1).map_or(0.0, |k| parts[k].goes_on_in(part, habit));
        let came = [0, 1].map(|way| if ways[way] + goes_on >= ways[1 - way] { way } else { 1 - way });
        let evidence = 0.5 * part.agreed();
        let gain = |way: usize| ways[came[way]] + if came[way] == way { goes_on } else { 0.0 };
        ways = [gain(0) + evidence, gain(1) - evidence];
        from.push(came);
    }
    let mut way = usize::from(ways[1] > ways[0]);
    let mut found = vec![false; parts.len()];
    for (k, came) in from.iter().enumerate().rev() {
        found[k] = way == 1;
        way = came[way];
    }
    found
}

/// Whether there are two markers at each look: some camera saw them apart then, or not long before and after.
fn two_at(looks: &[Look], found: &[Option<SharedOut>]) -> Vec<bool> {
    let apart: Vec<usize> = (0..looks.len()).filter(|&k| found[k].as_ref().is_some_and(|f| f.apart)).collect();
    let near = |k: usize| {
        let next = apart.partition_point(|&a| a < k);
        let [last, next] = [next.checked_sub(1), Some(next)].map(|i| apart.get(i?));
        let between = last.zip(next).is_some_and(|(&a, &b)| looks[b].time_s - looks[a].time_s < MERGED_S);
        next == Some(&k) || between
    };
    (0..looks.len()).map(near).collect()
}
