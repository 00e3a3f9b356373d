//! Two near markers taken for each other, found out frame by frame.
//!
//! Their places in the frame of their neighbours tell two markers apart (`body/regression.rs`, with the whole take as
//! history): if both are measured, an exchange turns the vector between them round; if one is, it is nearer to the one's
//! place or the other's, which is believed as far as it proves right where both are (`alone`). So do their distances from
//! a third marker of the part (`thirds`), and where neither does, at the end of a limb, the direction from the one to the
//! other (`direction`). Which of them is which changes rarely, and is found for all frames at once (Viterbi 1967): a change
//! costs what motion says against it (`onward`). Of two of different parts only one keeps its place, and that decides
//! (`settled`).
//!
//! A history in which they are exchanged half of the time expects both of them half-way. Then it is turned first: in the
//! frame of the neighbours the vector between them lies along one line, and all that point against it are turned round.

use super::super::Tracked;
use super::super::body::Snapshot;
use super::super::body::links::Links;
use super::super::body::moments::NEIGHBOURS;
use super::super::body::regression::{Fit, centered};
use super::super::body::rotation::align;
use super::alone::{Belief, Off};
use super::carry::{learned_links, snapshots, spread, tracks_of};
use super::close::median;
use super::direction::{Direction, directions, line_along};
use super::onward::{Onward, Past, Places};
use super::settled::Settled;
use super::thirds::{self, Third, thirds};
use nalgebra::{Rotation3, Vector3};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Markers farther apart than this, by median, are not taken for each other (m).
const NEAR: f64 = 0.12;
/// Frames that two markers must share, and frames of reference tried for a pair.
const SHARED: usize = 20;
const FRAMES_OF_REFERENCE: usize = 8;
/// The neighbours tell two markers apart if the vector between them points along or against what is expected (cosine) in
/// almost all frames.
const ALIGNED: f64 = 0.8;
const CLEAR: f64 = 0.95;
/// One that keeps its place is within this (squared, in its spreads) in almost all frames.
const HELD: f64 = 25.0;
/// The vector between two of different parts is off by so many times the place of one that keeps it (squared).
const RESTLESS: f64 = 4.0;
/// A place that is kept is off by at most so many times what measurement alone is off (squared).
const KEPT: f64 = 4.0;
/// Evidence of one frame at most (nats). Where one of the two is hidden and it is not known better (`alone`), what others say
/// of the one that is seen is off alike for a while: it counts anew after so long (s).
const MOST: f64 = 4.0;
const ANEW_S: f64 = 0.2;
/// Evidence for as they are (nats in a second): what is known so far is right most of the time.
const AS_IS_PER_S: f64 = 5.0;
/// Evidence that changes need in all (nats), and rounds.
const WORTH_CHANGING: f64 = 5.0;
const ROUNDS: usize = 3;
/// Least error of a place in the frame of its neighbours (m).
const LEAST_ERROR: f64 = 0.002;

/// Gives back what two near markers have of each other.
pub fn untangle(frames: &mut [Tracked], times_s: &[f64]) {
    for _ in 0..ROUNDS {
        let tracks = tracks_of(frames);
        let take = Take::new(frames, &tracks, times_s);
        let mut found: Vec<(f64, [usize; 2], Vec<bool>)> = take
            .pairs()
            .into_par_iter()
            .filter_map(|pair| take.changed(pair).map(|(gain, c)| (gain, pair, c)))
            .collect();
        found.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let mut touched = vec![false; tracks.len()];
        for (_, [a, b], changed) in &found {
            if !touched[*a] && !touched[*b] {
                (touched[*a], touched[*b]) = (true, true);
                exchange_where(frames, [tracks[*a], tracks[*b]], changed);
            }
        }
        if found.is_empty() {
            break;
        }
    }
}

fn exchange_where(frames: &mut [Tracked], tracks: [u32; 2], changed: &[bool]) {
    frames.iter_mut().zip(changed).filter(|(_, c)| **c).for_each(|(frame, _)| exchange(frame, tracks));
}

/// Gives each of two trajectories what the other has in a frame.
pub(super) fn exchange(frame: &mut Tracked, [a, b]: [u32; 2]) {
    for sample in &mut frame.samples {
        sample.track = match sample.track {
            t if t == a => b,
            t if t == b => a,
            t => t,
        };
    }
    frame.samples.sort_by_key(|s| s.track);
}

struct Take<'a> {
    times_s: &'a [f64],
    places: Vec<Snapshot>,
    /// Variance of each place (m² per axis; 0 where there is none).
    noise: Vec<Vec<f64>>,
    links: Links,
    slots: usize,
}

/// What is taken for the two markers' places in the past.
#[derive(Clone, Copy, PartialEq)]
enum History {
    AsItIs,
    Turned,
    Settled,
}

/// What one frame says: places of the two markers, and where they should be by their neighbours.
#[derive(Clone, Copy, Default)]
struct Look {
    places: [Option<Vector3<f64>>; 2],
    expected: Option<[Vector3<f64>; 2]>,
}

/// What places are off those in the frame of their neighbours (m² per axis): the one's, the other's, and the vector between
/// the two; `None` where it points anywhere.
#[derive(Clone, Copy)]
struct Errors {
    places: [f64; 2],
    between: Option<f64>,
}

/// What tells two markers apart.
struct Told {
    looks: Vec<Look>,
    /// What the places are off those in the frame of their neighbours, where that tells them apart.
    errors: Option<Errors>,
    /// How far the place of one alone is to be believed there.
    belief: Option<Belief>,
    thirds: Vec<Third>,
    directions: Vec<Direction>,
}

impl Told {
    /// Evidence that the two are exchanged in a frame (nats), some time after the one before (s), and after the one of them
    /// that is seen was alone the last time, if only one is.
    fn exchanged(
        &mut self,
        pair: [usize; 2],
        (index, now): (usize, &Snapshot),
        dt_s: f64,
        alone_s: Option<f64>,
    ) -> f64 {
        let look = &self.looks[index];
        let by_frame = self.errors.map_or(0.0, |errors| by_frame(look, errors));
        let by_thirds = thirds::exchanged(&self.thirds, now, look.places).unwrap_or(0.0);
        // Without the vector between them, the places of both are off as alike from frame to frame as that of one alone.
        let settled = self.errors.is_some_and(|e| e.between.is_none());
        if let (Some(since_s), Some(belief)) = (alone_s.or(settled.then_some(dt_s)), self.belief) {
            return belief.bounded(by_frame, since_s) + look.bounded(by_thirds, dt_s);
        }
        let by_direction = self.directions.iter_mut().find_map(|d| d.exchanged(pair, now)).unwrap_or(0.0);
        look.bounded(by_frame + by_thirds + by_direction, dt_s)
    }
}

impl Look {
    fn of(pair: [usize; 2], now: &Snapshot) -> Self {
        Self { places: pair.map(|p| now[p]), expected: None }
    }

    /// What one frame says of evidence (nats), some time after the last one that showed one of the two (s).
    fn bounded(&self, nats: f64, dt_s: f64) -> f64 {
        let both = self.places.iter().all(Option::is_some);
        nats.clamp(-MOST, MOST) * if both { 1.0 } else { (dt_s / ANEW_S).min(1.0) }
    }
}

impl<'a> Take<'a> {
    fn new(frames: &[Tracked], tracks: &[u32], times_s: &'a [f64]) -> Self {
        let places = snapshots(frames, tracks);
        let noise_of = |frame: &Tracked| {
            let mut noise = vec![0.0; tracks.len()];
            for sample in &frame.samples {
                if let Ok(slot) = tracks.binary_search(&sample.track) {
                    noise[slot] = sample.covariance.trace() / 3.0;
                }
            }
            noise
        };
        let noise = frames.iter().map(noise_of).collect();
        Self { times_s, places, noise, links: learned_links(frames, tracks), slots: tracks.len() }
    }

    /// Pairs of markers that are near each other.
    fn pairs(&self) -> Vec<[usize; 2]> {
        let sample: Vec<&Snapshot> = spread(&self.places);
        let near = |&[a, b]: &[usize; 2]| {
            let mut apart: Vec<f64> = sample.iter().filter_map(|s| Some((s[a]? - s[b]?).norm())).collect();
            apart.sort_unstable_by(f64::total_cmp);
            apart.len() >= SHARED && apart.get(apart.len() / 2).is_some_and(|m| *m < NEAR)
        };
        (0..self.slots).flat_map(|a| (a + 1..self.slots).map(move |b| [a, b])).filter(near).collect()
    }

    /// What tells the two apart, if anything does; `step_s`: the usual time between two frames.
    fn told(&self, pair: [usize; 2], step_s: f64) -> Told {
        let thirds = thirds(&spread(&self.places), pair);
        let by = |history: History| {
            let looks = self.looks(pair, history);
            errors(&looks, history).map(|errors| (looks, errors))
        };
        let mut by_frame = by(History::AsItIs).or_else(|| by(History::Turned));
        let is_better =
            |place: f64| by_frame.as_ref().is_none_or(|(_, e)| e.between.is_none_or(|b| b > RESTLESS * place));
        if is_better(LEAST_ERROR * LEAST_ERROR) {
            let kept = |place: f64| place < KEPT * self.usual_noise(pair) && is_better(place);
            let settled = by(History::Settled).filter(|(_, e)| kept(e.places[0].min(e.places[1])));
            by_frame = settled.or(by_frame);
        }
        if let Some((looks, errors)) = by_frame {
            let belief = self.belief(&looks, errors, step_s);
            return Told { looks, errors: Some(errors), belief, thirds, directions: Vec::new() };
        }
        let looks = self.places.iter().map(|now| Look::of(pair, now)).collect();
        let directions = if thirds.is_empty() { directions(&spread(&self.places), pair) } else { Vec::new() };
        Told { looks, errors: None, belief: None, thirds, directions }
    }

    /// Variance of a place of the two by measurement (m² per axis).
    fn usual_noise(&self, pair: [usize; 2]) -> f64 {
        let noise = self.noise.iter().flat_map(|noise| pair.map(|p| noise[p])).filter(|noise| *noise > 0.0);
        median(noise.collect()).unwrap_or(0.0).max(LEAST_ERROR * LEAST_ERROR)
    }

    /// Frames in which the two are to be exchanged, with the evidence for it; `None` if there are none.
    fn changed(&self, pair: [usize; 2]) -> Option<(f64, Vec<bool>)> {
        let place = |p: usize, (now, noise): (&Snapshot, &Vec<f64>)| now[p].map(|point| (point, noise[p]));
        let frames = self.places.iter().zip(&self.noise);
        let places: Vec<Places> = frames.map(|frame| pair.map(|p| place(p, frame))).collect();
        let onward = Onward::learned(&places, self.times_s)?;
        let (mut told, mut past) = (self.told(pair, onward.step_s), Past::default());
        let mut last_s = self.times_s.first().copied().unwrap_or(0.0);
        let mut alone_s = [f64::NEG_INFINITY; 2];
        let one = |(index, (seen, &time_s)): (usize, (&Places, &f64))| {
            let (change, dt_s) = (onward.change(&past, seen, time_s), time_s - last_s);
            let as_they_are = AS_IS_PER_S * dt_s.min(ANEW_S);
            let alone = alone(seen).filter(|_| told.looks[index].expected.is_some());
            let alone = alone.map(|k| time_s - std::mem::replace(&mut alone_s[k], time_s));
            let evidence = told.exchanged(pair, (index, &self.places[index]), dt_s, alone) - as_they_are;
            onward.take_in(&mut past, (index, seen, time_s));
            if seen.iter().any(Option::is_some) {
                last_s = time_s;
            }
            (evidence, change)
        };
        let (gain, changed) = likeliest(places.iter().zip(self.times_s).enumerate().map(one));
        let some = changed.iter().any(|c| *c) && !changed.iter().all(|c| *c);
        (some && gain > WORTH_CHANGING).then_some((gain, changed))
    }

    fn looks(&self, pair: [usize; 2], way: History) -> Vec<Look> {
        let mut fits = self.fits(pair, way);
        let look = |now: &Snapshot| {
            let fit = fits.iter_mut().find(|f| f[0].can_use(now));
            let expected = fit.and_then(|[a, b]| Some([a.predict(now, 0.0)?.point, b.predict(now, 0.0)?.point]));
            Look { expected, ..Look::of(pair, now) }
        };
        self.places.iter().map(look).collect()
    }

    /// Of the two in the frames of some sets of neighbours, the one to be used before the others first.
    fn fits(&self, pair: [usize; 2], way: History) -> Vec<[Fit; 2]> {
        let history = spread(&self.places);
        let fit = |set: &Vec<usize>, history: &[Snapshot]| self.fit(pair, set, &history.iter().collect::<Vec<_>>());
        match way {
            History::AsItIs => self.sets(pair).iter().filter_map(|set| self.fit(pair, set, &history)).collect(),
            History::Turned => {
                self.sets(pair).iter().filter_map(|set| fit(set, &turned(pair, set, &history))).collect()
            }
            History::Settled => {
                let settled = Settled::of(&self.links, &history, pair);
                settled.map_or(Vec::new(), |s| s.sets.iter().filter_map(|set| fit(set, &s.history)).collect())
            }
        }
    }

    /// How far the place of one of the two alone is to be believed.
    fn belief(&self, looks: &[Look], errors: Errors, step_s: f64) -> Option<Belief> {
        let mut off: [Vec<Off>; 2] = Default::default();
        for (look, &time_s) in looks.iter().zip(self.times_s) {
            let (Some([a, b]), [Some(p), Some(q)]) = (look.expected, look.places) else { continue };
            let places = if by_frame(look, errors) > 0.0 { [q, p] } else { [p, q] };
            let alone =
                |k: usize| by_frame(&Look { places: [0, 1].map(|i| (i == k).then_some(places[i])), ..*look }, errors);
            off[0].push(Off::of(time_s, &places[0], [&a, &b], alone(0)));
            off[1].push(Off::of(time_s, &places[1], [&b, &a], alone(1)));
        }
        Belief::learned([&off[0], &off[1]], step_s, LEAST_ERROR)
    }

    /// The sets of neighbours that most frames have.
    fn sets(&self, pair: [usize; 2]) -> Vec<Vec<usize>> {
        let mut count: BTreeMap<Vec<usize>, usize> = BTreeMap::new();
        for now in self.places.iter().filter(|s| pair.iter().any(|&p| s[p].is_some())) {
            *count.entry(self.neighbours(pair, now)).or_default() += 1;
        }
        let mut sets: Vec<(usize, Vec<usize>)> = count.into_iter().map(|(set, n)| (n, set)).collect();
        sets.sort_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(&b.1)));
        sets.into_iter().take(FRAMES_OF_REFERENCE).map(|(_, set)| set).collect()
    }

    /// The visible markers that place the pair best.
    fn neighbours(&self, pair: [usize; 2], now: &Snapshot) -> Vec<usize> {
        let mut others = now.clone();
        pair.iter().for_each(|&p| others[p] = None);
        self.links.frame_of(pair[0], &others, NEIGHBOURS)
    }

    fn fit(&self, pair: [usize; 2], neighbours: &[usize], history: &[&Snapshot]) -> Option<[Fit; 2]> {
        let reference = history.iter().find(|s| neighbours.iter().all(|&n| s[n].is_some()))?;
        // What the markers were off at some moment long ago is forgotten.
        let long_ago = [(-1e9, (*reference).clone())];
        let spacing_s = (self.times_s[self.times_s.len() - 1] - self.times_s[0]) / history.len().max(1) as f64;
        let fit = |slot: usize| Fit::new(slot, neighbours, history, &long_ago, spacing_s);
        Some([fit(pair[0])?, fit(pair[1])?])
    }
}

/// The likeliest frames to exchange the two in, by the evidence for it in each and what a change before it costs (nats), and
/// how much likelier that is than no exchange (Viterbi 1967).
fn likeliest(frames: impl Iterator<Item = (f64, f64)>) -> (f64, Vec<bool>) {
    // Of "as they are" and "exchanged", and for each frame whether the frame before was exchanged.
    let (mut ways, mut from, mut as_is) = ([0.0_f64; 2], Vec::new(), 0.0);
    for (evidence, change) in frames {
        from.push([ways[1] - change > ways[0], ways[1] > ways[0] - change]);
        let half = 0.5 * evidence;
        ways = [ways[0].max(ways[1] - change) - half, ways[1].max(ways[0] - change) + half];
        as_is -= half;
    }
    let mut exchanged = ways[1] > ways[0];
    let mut changed = vec![false; from.len()];
    for (frame, from) in from.iter().enumerate().rev() {
        changed[frame] = exchanged;
        exchanged = from[usize::from(exchanged)];
    }
    (ways[0].max(ways[1]) - as_is, changed)
}

/// The snapshots that hold both markers and their neighbours, each pair so that the vector between them points the way that
/// most of them do in the neighbours' frame.
fn turned([a, b]: [usize; 2], neighbours: &[usize], history: &[&Snapshot]) -> Vec<Snapshot> {
    let weights = vec![1.0; neighbours.len()];
    let mut reference: Option<Vec<Vector3<f64>>> = None;
    let mut rotation = Rotation3::identity();
    let mut found: Vec<(&Snapshot, Vector3<f64>)> = Vec::new();
    for &snapshot in history {
        let points: Option<Vec<Vector3<f64>>> = neighbours.iter().map(|&n| snapshot[n]).collect();
        let (Some(p), Some(q), Some(points)) = (snapshot[a], snapshot[b], points) else { continue };
        let (_, points) = centered(&points);
        rotation = align(&points, reference.get_or_insert_with(|| points.clone()), &weights, rotation);
        found.push((snapshot, rotation * (q - p)));
    }
    let line = line_along(&found.iter().map(|(_, v)| *v).collect::<Vec<_>>());
    let turn = |(snapshot, v): (&Snapshot, Vector3<f64>)| {
        let mut turned = snapshot.clone();
        if v.dot(&line) < 0.0 {
            turned.swap(a, b);
        }
        turned
    };
    found.into_iter().map(turn).collect()
}

/// Errors by median; `None` where too few frames tell.
fn errors(looks: &[Look], history: History) -> Option<Errors> {
    if history == History::Settled {
        return errors_of_settled(looks);
    }
    let mut off: [Vec<f64>; 3] = Default::default();
    let mut clear = 0;
    for look in looks {
        let Some([a, b]) = look.expected else { continue };
        let [p, q] = look.places;
        off[0].extend(p.map(|p| (p - a).norm_squared()));
        off[1].extend(q.map(|q| (q - b).norm_squared()));
        if let (Some(p), Some(q)) = (p, q) {
            let (between, expected) = (q - p, b - a);
            let cos = between.dot(&expected) / (between.norm() * expected.norm()).max(1e-12);
            clear += usize::from(cos.abs() > ALIGNED);
            off[2].push((between - expected).norm_squared().min((between + expected).norm_squared()));
        }
    }
    let [one, other, both] = off;
    if (clear as f64) < CLEAR * both.len() as f64 {
        return None;
    }
    Some(Errors { places: [variance(one)?, variance(other)?], between: Some(variance(both)?) })
}

/// The same where one of the two keeps its place and the other comes and goes, whichever of them is called which.
fn errors_of_settled(looks: &[Look]) -> Option<Errors> {
    let seen = || looks.iter().filter_map(|l| Some((l.expected?, [l.places[0]?, l.places[1]?])));
    let off = |k: usize| {
        let nearer = |(expected, [p, q]): ([Vector3<f64>; 2], [Vector3<f64>; 2])| {
            let [p_off, q_off] = [p, q].map(|p| (p - expected[k]).norm_squared());
            let other = if p_off < q_off { q } else { p };
            [p_off.min(q_off), (other - expected[1 - k]).norm_squared()]
        };
        let (own, other): (Vec<f64>, Vec<f64>) = seen().map(nearer).map(|[own, other]| (own, other)).unzip();
        let held = |own: &[f64], variance: f64| own.iter().filter(|o| **o < HELD * variance).count() as f64;
        let spread = variance(own.clone())?;
        (held(&own, spread) >= CLEAR * own.len() as f64).then_some([spread, variance(other)?])
    };
    let places = match [off(0), off(1)] {
        [Some([one, other]), Some([again, _])] if one <= again => [one, other],
        [_, Some([one, other])] => [other, one],
        [Some([one, other]), None] => [one, other],
        [None, None] => return None,
    };
    Some(Errors { places, between: None })
}

/// Variance per axis by the median of squares.
fn variance(squared: Vec<f64>) -> Option<f64> {
    let enough = squared.len() >= SHARED;
    median(squared).filter(|_| enough).map(|m| (m / 2.4).max(LEAST_ERROR * LEAST_ERROR))
}

/// Evidence for the exchange of one frame (nats), by the two's places in the frame of their neighbours.
fn by_frame(look: &Look, errors: Errors) -> f64 {
    let Some([a, b]) = look.expected else { return 0.0 };
    let cost = |p: Vector3<f64>, q: Vector3<f64>, variance: f64| {
        let squared = (p - q).norm_squared() / variance;
        // Heavy-tailed: poses beyond those that are known.
        2.5 * (squared / 5.0).ln_1p() + 1.5 * variance.ln()
    };
    let [one, other] = errors.places;
    let alone = |p: Vector3<f64>| cost(p, a, one) - cost(p, b, other);
    match (look.places, errors.between) {
        ([Some(p), Some(q)], Some(both)) => {
            let (between, expected) = (q - p, b - a);
            cost(between, expected, both) - cost(-between, expected, both)
        }
        ([Some(p), Some(q)], None) => alone(p) - alone(q),
        ([Some(p), None], _) => alone(p),
        ([None, Some(q)], _) => -alone(q),
        ([None, None], _) => 0.0,
    }
}

/// The one of two that is seen, if the other is hidden.
fn alone(seen: &Places) -> Option<usize> {
    match seen {
        [Some(_), None] => Some(0),
        [None, Some(_)] => Some(1),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::track::{Kind, Sample};
    use nalgebra::{Matrix3, Rotation3};

    /// Four markers of a part, and two 10 mm apart beside it; the part turns and wanders.
    fn take(frames: usize) -> (Vec<Tracked>, Vec<f64>) {
        let part = [
            [0.0, 0.0, 0.0],
            [0.12, 0.0, 0.0],
            [0.0, 0.1, 0.02],
            [0.05, 0.05, 0.11],
            [0.2, 0.03, 0.0],
            [0.21, 0.03, 0.0],
        ];
        let one = |f: usize| {
            let t = f as f64 / 100.0;
            let turn = Rotation3::from_euler_angles(0.8 * t, (1.3 * t).sin(), 0.4 * t);
            let away = Vector3::new(t.sin(), 0.3 * t, 1.0);
            let place = |p: &[f64; 3]| turn * Vector3::from(*p) + away;
            let dots = [0, 1, 2];
            let sample = |(track, p)| {
                let state = (place(p), Matrix3::identity() * 1e-7);
                Sample::new(track as u32, state, Kind::Measured, &dots, 0.99)
            };
            Tracked { samples: part.iter().enumerate().map(sample).collect(), ..Tracked::default() }
        };
        ((0..frames).map(one).collect(), (0..frames).map(|f| f as f64 / 100.0).collect())
    }

    fn points(frames: &[Tracked]) -> Vec<Vec<(u32, Vector3<f64>)>> {
        frames.iter().map(|f| f.samples.iter().map(|s| (s.track, s.point)).collect()).collect()
    }

    #[test]
    fn near_markers_get_back_what_they_have_of_each_other() {
        let (truth, times_s) = take(400);
        let mut frames = truth.clone();
        exchange_where(
            &mut frames,
            [4, 5],
            &(0..400).map(|f| (150..230).contains(&f) || f == 300).collect::<Vec<bool>>(),
        );
        // In a part of the time only one of the two is seen.
        let hidden = |f: usize, track: u32| (150..180).contains(&f) && track == 5;
        let hide = |frames: &mut Vec<Tracked>| {
            frames.iter_mut().enumerate().for_each(|(f, frame)| frame.samples.retain(|s| !hidden(f, s.track)));
        };
        hide(&mut frames);
        assert_ne!(points(&frames), points(&truth));
        untangle(&mut frames, &times_s);
        let seen_as = |f: usize| frames[f].samples.iter().map(|s| (s.track, s.point)).collect::<Vec<_>>();
        for (f, frame) in truth.iter().enumerate() {
            let whole: Vec<(u32, Vector3<f64>)> = frame.samples.iter().map(|s| (s.track, s.point)).collect();
            assert!(seen_as(f).iter().all(|s| whole.contains(s)), "frame {f}");
        }
    }

    #[test]
    fn one_that_was_seen_alone_for_a_moment_is_told_by_its_neighbours() {
        let (mut truth, times_s) = take(400);
        // Both are hidden but for two frames that show the one of them.
        let hidden = |f: usize, track: u32| (200..220).contains(&f) && !(track == 4 && (209..211).contains(&f));
        truth
            .iter_mut()
            .enumerate()
            .for_each(|(f, frame)| frame.samples.retain(|s| s.track < 4 || !hidden(f, s.track)));
        let mut frames = truth.clone();
        frames[209..211].iter_mut().for_each(|frame| exchange(frame, [4, 5]));
        untangle(&mut frames, &times_s);
        assert_eq!(points(&frames), points(&truth));
    }

    #[test]
    fn near_markers_that_were_exchanged_half_of_the_time_are_told_apart() {
        let (mut truth, times_s) = take(400);
        // Both are hidden before each exchange: only their neighbours tell.
        let hidden = |f: usize, track: u32| f % 40 < 10 && track >= 4;
        truth.iter_mut().enumerate().for_each(|(f, frame)| frame.samples.retain(|s| !hidden(f, s.track)));
        let mut frames = truth.clone();
        exchange_where(&mut frames, [4, 5], &(0..400).map(|f| (f / 40) % 2 == 1).collect::<Vec<bool>>());
        untangle(&mut frames, &times_s);
        let (right, mut round) = (points(&truth), truth.clone());
        exchange_where(&mut round, [4, 5], &[true; 400]);
        assert!(points(&frames) == right || points(&frames) == points(&round));
    }

    #[test]
    fn one_that_comes_and_goes_beside_another_part_is_told_by_the_one_that_stays() {
        let (mut truth, times_s) = take(400);
        for (frame, time_s) in truth.iter_mut().zip(&times_s) {
            let [origin, along, up, beside] = [0, 1, 2, 4].map(|k| frame.samples[k].point);
            let swing = Vector3::new(0.1 + 0.1 * (9.0 * time_s).sin(), 0.15 * (7.0 * time_s).cos(), 0.05);
            let axes =
                Matrix3::from_columns(&[along - origin, up - origin, (along - origin).cross(&(up - origin)) * 10.0]);
            frame.samples[5].point = beside + axes * swing;
        }
        // Both are hidden before each exchange.
        let hidden = |f: usize, track: u32| f % 40 < 10 && track >= 4;
        truth.iter_mut().enumerate().for_each(|(f, frame)| frame.samples.retain(|s| !hidden(f, s.track)));
        let mut frames = truth.clone();
        exchange_where(&mut frames, [4, 5], &(0..400).map(|f| (f / 40) % 2 == 1).collect::<Vec<bool>>());
        untangle(&mut frames, &times_s);
        let (right, mut round) = (points(&truth), truth.clone());
        exchange_where(&mut round, [4, 5], &[true; 400]);
        assert!(points(&frames) == right || points(&frames) == points(&round));
    }

    #[test]
    fn what_is_right_stays() {
        let (truth, times_s) = take(200);
        let mut frames = truth.clone();
        untangle(&mut frames, &times_s);
        assert_eq!(points(&frames), points(&truth));
    }

    /// Every way to exchange them is the oracle.
    #[test]
    fn the_likeliest_frames_to_exchange_are_found() {
        const FRAMES: usize = 9;
        for case in 0..50_usize {
            let number = |n: usize, k: usize| ((case * 7 + n * 31 + k * 13) % 17) as f64 - 8.0;
            let frames: Vec<(f64, f64)> = (0..FRAMES).map(|f| (number(f, 1), number(f, 5))).collect();
            let worth = |way: usize| -> f64 {
                let exchanged = |f: usize| way >> f & 1 == 1;
                let evidence = |f: usize| if exchanged(f) { frames[f].0 } else { 0.0 };
                let change = |f: usize| {
                    let before = f.checked_sub(1).is_some_and(exchanged);
                    if f > 0 && before != exchanged(f) { frames[f].1 } else { 0.0 }
                };
                (0..FRAMES).map(|f| evidence(f) - change(f)).sum()
            };
            let best = (0..1 << FRAMES).map(worth).fold(f64::MIN, f64::max);
            // Before the first frame nothing can have changed.
            let given = frames.iter().enumerate().map(|(f, &(e, c))| (e, if f == 0 { 0.0 } else { c }));
            let (gain, changed) = likeliest(given);
            let way = changed.iter().enumerate().map(|(f, c)| usize::from(*c) << f).sum();
            assert!((gain - best).abs() < 1e-9 && (worth(way) - best).abs() < 1e-9, "case {case}: {gain} {best}");
        }
    }
}
