//! Parts of a take through which the vector between the two of a close pair is followed without getting lost.

use super::Pair;
use super::between::{Between, Habit};
use super::fit::{Seen, both_sides, remembered};
use super::look::{Given, Look, SharedOut};
use crate::track::Sample;
use nalgebra::Matrix3;
use std::collections::BTreeMap;

/// What a frame that had the two this way is worth, and what motion from part to part says at most (nats).
const AGREED: f64 = 0.2;
const MOST_OF_MOTION: f64 = 12.0;
/// Two that no camera has seen apart for so long may be one by now (s).
const MERGED_S: f64 = 0.5;

/// What is known of the vector, and of what each camera sees.
#[derive(Clone)]
struct State {
    between: Between,
    seen: BTreeMap<usize, Seen>,
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

/// Forwards, backwards, and both together; where one way in time has the vector point against the other, it was lost
/// between, and a new part begins.
fn smoothed<'a>(pair: &Pair, looks: &'a [Look], given: &Given) -> Vec<Part<'a>> {
    let (before, end) = passed(pair, looks, 0..looks.len(), None, given);
    let doubt = Matrix3::identity() * pair.habit.any_way();
    let end = end.map(|s| State { between: Between { covariance: doubt, ..s.between }, ..s });
    let (after, _) = passed(pair, looks, (0..looks.len()).rev(), end, given);
    let mut parts: Vec<Part> = Vec::new();
    let (mut from, mut agreed) = (0, true);
    let mut found = Vec::with_capacity(looks.len());
    for (k, look) in looks.iter().enumerate() {
        let agree = before[k].iter().zip(&after[k]).all(|(a, b)| a.between.vector.dot(&b.between.vector) >= 0.0);
        if agree != agreed {
            parts.push(Part { looks: &looks[from..k], found: std::mem::take(&mut found) });
            (from, agreed) = (k, agree);
        }
        let state = match (before[k].clone(), after[k].clone()) {
            (Some(a), Some(b)) if agree => Some(a.with(&b)),
            (Some(a), Some(b)) => Some(a.with(&b.turned())),
            (one, other) => one.or(other),
        };
        found.push(state.and_then(|s| look.shared_out(&s.between, &s.seen, given)));
    }
    parts.push(Part { looks: &looks[from..], found });
    parts
}

/// What the frames before say of each frame, in this order, and what is known in the end. Without a `start`, the first
/// frame that saw the two apart is one.
fn passed(
    pair: &Pair,
    looks: &[Look],
    order: impl Iterator<Item = usize>,
    start: Option<State>,
    given: &Given,
) -> (Vec<Option<State>>, Option<State>) {
    let mut said: Vec<Option<State>> = vec![None; looks.len()];
    let mut last_s = None;
    let mut state = start;
    for k in order {
        let look = &looks[k];
        let dt_s: f64 = look.time_s - last_s.unwrap_or(look.time_s);
        let first = || {
            let covariance = Matrix3::identity() * pair.habit.any_way();
            look.apart.map(|vector| State { between: Between { vector, covariance }, seen: BTreeMap::new() })
        };
        let now = state.map(|s| State { between: s.between.after(dt_s, &pair.habit), ..s }).or_else(first);
        last_s = Some(look.time_s);
        said[k].clone_from(&now);
        state = now.map(|now| look.taken_in(&now.between, &now.seen, given).map_or(now, |(vector, choices)| {
            let seen = choices.into_iter().map(|(camera, choice)| (camera, remembered(choice))).collect();
            State { between: vector, seen }
        }));
    }
    (said, state)
}

impl State {
    fn with(mut self, other: &Self) -> Self {
        for (camera, seen) in &other.seen {
            self.seen.entry(*camera).and_modify(|s| *s = both_sides(s, seen)).or_insert(*seen);
        }
        Self { between: self.between.with(&other.between), ..self }
    }

    /// The one as the other.
    fn turned(mut self) -> Self {
        self.seen.values_mut().for_each(|s| s.swap(1, 2));
        self.between.vector = -self.between.vector;
        self
    }
}

impl Part<'_> {
    /// In how many more frames the trajectories had the two as they are here than the other way round.
    fn agreed(&self) -> f64 {
        let agrees = |(look, found): (&Look, &Option<SharedOut>)| {
            Some(look.apart?.dot(&found.as_ref()?.pose.between().0).signum())
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

    /// By frame, the samples of the two under their trajectories' identities.
    pub fn samples(self, tracks: [u32; 2]) -> Vec<(usize, [Sample; 2])> {
        let two = two_at(self.looks, &self.found);
        let sample =
            |((look, found), _): ((&Look, Option<SharedOut>), bool)| Some((look.index, found?.samples(tracks, look)));
        self.looks.iter().zip(self.found).zip(two).filter(|(_, two)| *two).filter_map(sample).collect()
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
        let evidence = 0.5 * AGREED * part.agreed();
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

/// Whether there are two markers at each look: some camera saw them apart not long before and after.
fn two_at(looks: &[Look], found: &[Option<SharedOut>]) -> Vec<bool> {
    let apart = looks.iter().zip(found).filter(|(_, f)| f.as_ref().is_some_and(|f| f.apart));
    let apart_s: Vec<f64> = apart.map(|(l, _)| l.time_s).collect();
    let near = |look: &Look| {
        let after = apart_s.partition_point(|t| *t < look.time_s);
        let next = apart_s.get(after).copied();
        let last = after.checked_sub(1).map(|k| apart_s[k]);
        match (last, next) {
            (_, Some(t)) if t == look.time_s => true,
            (Some(last), Some(next)) => next - last < MERGED_S,
            _ => false,
        }
    };
    looks.iter().map(near).collect()
}
