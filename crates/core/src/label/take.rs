//! Names for a whole take: what speaks for every marker along every trajectory, in both directions of time.
//!
//! Key frames are searched without history; every trajectory gathers their votes. From then on all samples of the take
//! know roughly who is around, so that what speaks for a marker at a point can be weighed everywhere (`evidence.rs`).
//! Along a trajectory that evidence adds up, and a change of name costs: the best path through every name at every
//! moment (max-marginals of a hidden Markov model, forward and backward) is its score there, and each sample gets the
//! assignment of the largest sum. Repeated until the names stand. A trajectory whose marker was exchanged by the tracker
//! is thus named anew from the moment of the exchange; short pieces and phantoms have their own frames only.
//!
//! Cost: samples × markers × points; in parallel over samples, with the same result for any number of threads.

use super::evidence::{Frame, Names, Naming, at_point, best, sides};
use super::model::Model;
use super::search::{Plan, search_all};
use nalgebra::Vector3;
use rayon::prelude::*;

/// Samples per second at most, and time between key frames (s); fewer key frames than these make no vote.
const SAMPLES_HZ: f64 = 30.0;
const KEY_S: f64 = 0.5;
const KEYS: usize = 24;
/// Time within which frames say the same (s): evidence counts once in it.
const ALIKE_S: f64 = 0.1;
/// What a change of name along a trajectory costs, and what it costs over a hole: the tracker may have taken another marker for
/// the one that was hidden.
const CHANGE: f64 = 14.0;
const CHANGE_OVER_A_HOLE: f64 = 4.0;
/// A hole is longer than so many frames, and than this (s).
const HOLE: usize = 2;
const HOLE_S: f64 = 0.025;
/// Evidence that does not tell two names apart: lengths that are a little off are so in every frame.
const MARGIN: f64 = 0.5;
/// Names of a trajectory that are followed, and rounds, at most.
const FOLLOWED: usize = 8;
const ROUNDS: usize = 4;
/// Passes in which near markers may exchange their names, and how many near ones of each.
const EXCHANGES: usize = 3;
const EXCHANGED: usize = 3;

/// The points of a take.
pub struct Take<'a> {
    /// First row of each frame, and the number of rows.
    starts: &'a [usize],
    /// Places (m).
    points: &'a [Vector3<f64>],
    /// The trajectory of each row, counted from 0, and their number.
    track: &'a [usize],
    tracks: usize,
    /// The piece of its trajectory, between holes, that each row is in, counted from 0, and their number.
    piece: Vec<usize>,
    pieces: usize,
    /// Frames per second.
    rate_hz: f64,
    /// Of each row, the marker that is believed to be there, and how firmly (as evidence); empty, or one for each row.
    believed: &'a [Option<(usize, f64)>],
}

impl<'a> Take<'a> {
    /// First row of each frame and the number of rows; places (m); the trajectory of each row, counted from 0; frames per
    /// second; of each row, the marker that is believed to be there, and how firmly (as evidence), or nothing at all.
    pub fn new(
        starts: &'a [usize],
        points: &'a [Vector3<f64>],
        track: &'a [usize],
        rate_hz: f64,
        believed: &'a [Option<(usize, f64)>],
    ) -> Self {
        let tracks = track.iter().map(|t| t + 1).max().unwrap_or(0);
        let longest = HOLE.max((HOLE_S * rate_hz) as usize);
        let (mut piece, mut pieces) = (vec![0; track.len()], 0);
        let mut last: Vec<Option<(usize, usize)>> = vec![None; tracks];
        for frame in 0..starts.len().saturating_sub(1) {
            for row in starts[frame]..starts[frame + 1] {
                let goes_on = last[track[row]].filter(|(before, _)| frame - before <= longest + 1);
                piece[row] = goes_on.map_or(pieces, |g| g.1);
                pieces = pieces.max(piece[row] + 1);
                last[track[row]] = Some((frame, piece[row]));
            }
        }
        Self { starts, points, track, tracks, piece, pieces, rate_hz, believed }
    }
}

/// The names of a take.
pub struct Labelled {
    /// Of each row its marker.
    pub marker: Vec<Option<usize>>,
    /// Of each row the probability of what is said of it.
    pub probability: Vec<f64>,
    /// Share of the heights over triangles, in the key frames, that are on the wrong side.
    pub mirrored: f64,
}

/// What is weighed at one sample: a frame, its rows and their candidates.
struct Sample {
    frame: usize,
    names: Names,
    /// Of each point of the frame: markers and what speaks for them.
    candidates: Vec<Vec<(usize, f64)>>,
}

/// Of each point of a sample: markers, and the score of each.
type Scores = Vec<Vec<(usize, f64)>>;

/// What is gained by an exchange of names, between whom, and in which samples.
type Exchange = (f64, (usize, usize), Vec<usize>);

/// What a sample says of a trajectory: its frame, the name, the score and the probability of that.
type Said = (usize, Option<usize>, f64, f64);

/// Name the rows of a take.
pub fn label_take(model: &Model, plans: &[Plan], take: &Take) -> Labelled {
    let frames = sampled(take);
    let votes = votes(model, plans, take);
    let mut samples: Vec<Sample> = frames
        .par_iter()
        .map(|&frame| Sample { frame, names: by_votes(model, take, frame, &votes), candidates: Vec::new() })
        .collect();
    let mut scores = name_anew(model, take, &mut samples);
    for _ in 0..EXCHANGES {
        if !exchange(model, take, &mut samples) {
            break;
        }
        scores = name_anew(model, take, &mut samples);
    }
    let mirrored = mirrored(model, take, &samples);
    spread_out(take, &samples, &scores, mirrored)
}

/// Name every sample by what speaks for whom along the trajectories, given the names so far, until they stand.
fn name_anew(model: &Model, take: &Take, samples: &mut [Sample]) -> Vec<Scores> {
    let mut scores = Vec::new();
    for _ in 0..ROUNDS {
        samples.par_iter_mut().for_each(|sample| weigh(model, take, sample));
        scores = along_tracks(take, samples);
        let by_score = |(sample, own): (&Sample, &Scores)| {
            let points = rows(take, sample.frame).len();
            let mut values = vec![0.0; model.len() * points];
            for (point, candidates) in own.iter().enumerate() {
                candidates.iter().for_each(|&(m, s)| values[m * points + point] = s);
            }
            best(&values, model.len(), points, 0.0)
        };
        let next: Vec<Names> = samples.par_iter().zip(&scores).map(by_score).collect();
        let stands = samples.iter().zip(&next).all(|(s, n)| s.names == *n);
        samples.iter_mut().zip(next).for_each(|(s, n)| s.names = n);
        if stands {
            break;
        }
    }
    scores
}

/// Exchange the names of two near markers over the stretches of time in which more speaks for that. One by one neither
/// would change: each is wrong by the other. Returns whether any did.
fn exchange(model: &Model, take: &Take, samples: &mut [Sample]) -> bool {
    let near = |a: usize| model.near(a).iter().copied().take(EXCHANGED);
    let pairs: Vec<(usize, usize)> = (0..model.len())
        .flat_map(|a| near(a).filter(move |&b| a < b || !near(b).any(|o| o == a)).map(move |b| (a, b)))
        .collect();
    let mut found: Vec<Exchange> = pairs
        .par_iter()
        .filter_map(|&pair| {
            let (gain, stretch) = exchanged(model, take, samples, pair);
            (!stretch.is_empty()).then_some((gain, pair, stretch))
        })
        .collect();
    found.sort_by(|x, y| y.0.total_cmp(&x.0).then(x.1.cmp(&y.1)));
    let mut changed = vec![false; model.len()];
    for (_, (a, b), stretch) in &found {
        if !changed[*a] && !changed[*b] {
            (changed[*a], changed[*b]) = (true, true);
            stretch.iter().for_each(|&i| samples[i].names.swap(*a, *b));
        }
    }
    !found.is_empty()
}

/// Samples in which two markers should have each other's place, and what is gained by it all.
fn exchanged(model: &Model, take: &Take, samples: &[Sample], (a, b): (usize, usize)) -> (f64, Vec<usize>) {
    let both: Vec<usize> =
        (0..samples.len()).filter(|&i| samples[i].names[a].is_some() && samples[i].names[b].is_some()).collect();
    let gains: Vec<f64> = both
        .iter()
        .enumerate()
        .map(|(k, &i)| {
            let (Some(p), Some(q)) = (samples[i].names[a], samples[i].names[b]) else { return 0.0 };
            let frame = Frame::new(&take.points[rows(take, samples[i].frame)]);
            let mut names = samples[i].names.clone();
            let now = at_point(model, &frame, &names, a, p) + at_point(model, &frame, &names, b, q);
            names.swap(a, b);
            let then = at_point(model, &frame, &names, a, q) + at_point(model, &frame, &names, b, p);
            let before = if k == 0 { f64::INFINITY } else { seconds(take, samples, both[k - 1], i) };
            // Two markers, and each of them may be off a little.
            let clear = (then - now).signum() * ((then - now).abs() - 2.0 * MARGIN).max(0.0);
            before.min(ALIKE_S) / ALIKE_S * clear
        })
        .collect();
    let costs: Vec<f64> = (0..both.len())
        .map(|k| {
            let before = k.checked_sub(1).map(|k| &samples[both[k]]);
            let across = |m: usize| {
                let (now, then) = (&samples[both[k]], before?);
                let piece = |s: &Sample| s.names[m].map(|p| take.piece[rows(take, s.frame).start + p]);
                Some(piece(now) != piece(then))
            };
            if across(a) == Some(true) || across(b) == Some(true) { CHANGE_OVER_A_HOLE } else { CHANGE }
        })
        .collect();
    let kept_or_not = two_ways(&gains, &costs);
    let gain = gains.iter().zip(&kept_or_not).filter(|x| *x.1).map(|x| x.0).sum();
    (gain, both.iter().zip(&kept_or_not).filter(|x| *x.1).map(|x| *x.0).collect())
}

/// Where it pays to be in the second of two states, a change of state before each moment having its cost (Viterbi).
fn two_ways(gains: &[f64], costs: &[f64]) -> Vec<bool> {
    let mut reached = [0.0, -CHANGE];
    let mut came = Vec::with_capacity(gains.len());
    for (gain, cost) in gains.iter().zip(costs) {
        let from = [reached[1] - cost > reached[0], reached[0] - cost <= reached[1]];
        came.push(from);
        reached = [reached[0].max(reached[1] - cost), reached[1].max(reached[0] - cost) + gain];
    }
    let mut state = reached[1] > reached[0];
    let mut states = vec![false; gains.len()];
    for k in (0..gains.len()).rev() {
        states[k] = state;
        state = came[k][usize::from(state)];
    }
    states
}

fn rows(take: &Take, frame: usize) -> std::ops::Range<usize> {
    take.starts[frame]..take.starts[frame + 1]
}

/// Frames that are weighed: evenly spread ones, and one for each piece of a trajectory that would have none.
fn sampled(take: &Take) -> Vec<usize> {
    let count = take.starts.len() - 1;
    let stride = ((take.rate_hz / SAMPLES_HZ).round() as usize).max(1);
    let mut wanted: Vec<usize> = (0..count).step_by(stride).collect();
    let mut has_one = vec![false; take.pieces];
    wanted.iter().flat_map(|&f| rows(take, f)).for_each(|row| has_one[take.piece[row]] = true);
    let mut frames_of = vec![Vec::new(); take.pieces];
    for frame in 0..count {
        for row in rows(take, frame).filter(|&r| !has_one[take.piece[r]]) {
            frames_of[take.piece[row]].push(frame);
        }
    }
    wanted.extend(frames_of.iter().filter(|f| !f.is_empty()).map(|f| f[f.len() / 2]));
    wanted.sort_unstable();
    wanted.dedup();
    wanted
}

/// Share of the heights over triangles that are on the wrong side.
fn mirrored(model: &Model, take: &Take, samples: &[Sample]) -> f64 {
    let of_sample = |sample: &Sample| {
        let points = &take.points[rows(take, sample.frame)];
        sides(model, &sample.names, points)
    };
    let sides: Vec<[usize; 2]> = samples.par_iter().map(of_sample).collect();
    let [right, wrong] = sides.iter().fold([0, 0], |sum, s| [sum[0] + s[0], sum[1] + s[1]]);
    wrong as f64 / (right + wrong).max(1) as f64
}

/// What key frames, each searched without history, say of every trajectory.
fn votes(model: &Model, plans: &[Plan], take: &Take) -> Vec<Vec<(usize, f64)>> {
    let count = take.starts.len() - 1;
    let stride = ((KEY_S * take.rate_hz) as usize).min(count / KEYS).max(1);
    let keys: Vec<usize> = (0..count).skip(stride / 2).step_by(stride).collect();
    let said: Vec<Vec<(usize, usize, f64)>> = keys
        .par_iter()
        .map(|&f| {
            let points = &take.points[rows(take, f)];
            let frame = Frame::new(points);
            let found = search_all(model, plans, &frame);
            let named = found.names.iter().enumerate().filter_map(|(m, p)| p.map(|p| (m, p)));
            let vote = |(m, p)| (take.track[take.starts[f] + p], m, found.values[m * points.len() + p]);
            named.map(vote).collect()
        })
        .collect();
    let mut votes = vec![Vec::new(); take.tracks];
    for (track, marker, value) in said.iter().flatten() {
        add(&mut votes[*track], *marker, *value);
    }
    for (row, believed) in take.believed.iter().enumerate() {
        if let Some((marker, value)) = believed {
            add(&mut votes[take.track[row]], *marker, *value / stride as f64);
        }
    }
    votes
}

fn add(list: &mut Vec<(usize, f64)>, marker: usize, value: f64) {
    match list.iter_mut().find(|x| x.0 == marker) {
        Some(entry) => entry.1 += value,
        None => list.push((marker, value)),
    }
}

fn by_votes(model: &Model, take: &Take, frame: usize, votes: &[Vec<(usize, f64)>]) -> Names {
    let rows = rows(take, frame);
    let points = rows.len();
    let mut values = vec![0.0; model.len() * points];
    for (point, row) in rows.enumerate() {
        votes[take.track[row]].iter().for_each(|&(m, v)| values[m * points + point] = v);
    }
    best(&values, model.len(), points, 0.0)
}

/// What speaks for whom at every point of a sample, given the names so far.
fn weigh(model: &Model, take: &Take, sample: &mut Sample) {
    let rows = rows(take, sample.frame);
    let points = &take.points[rows.clone()];
    let frame = Frame::new(points);
    let naming = Naming::new(model, &frame, sample.names.clone());
    sample.candidates = vec![Vec::new(); points.len()];
    for m in 0..model.len() {
        for (p, row) in rows.clone().enumerate() {
            let believed = take.believed.get(row).copied().flatten().filter(|b| b.0 == m).map_or(0.0, |b| b.1);
            let value = naming.values[m * points.len() + p] + believed;
            if value > 0.0 || naming.names[m] == Some(p) {
                sample.candidates[p].push((m, value));
            }
        }
    }
}

/// Of each sample and point: the score of the best path of its trajectory through every name, over that through none.
fn along_tracks(take: &Take, samples: &[Sample]) -> Vec<Scores> {
    let mut of_track: Vec<Vec<(usize, usize)>> = vec![Vec::new(); take.tracks];
    for (i, sample) in samples.iter().enumerate() {
        for (p, row) in rows(take, sample.frame).enumerate() {
            of_track[take.track[row]].push((i, p));
        }
    }
    let mut scores: Vec<Scores> = samples.iter().map(|s| vec![Vec::new(); s.candidates.len()]).collect();
    let found: Vec<Scores> = of_track.par_iter().map(|visits| path_scores(take, samples, visits)).collect();
    for (visits, own) in of_track.iter().zip(found) {
        for (&(i, p), candidates) in visits.iter().zip(own) {
            scores[i][p] = candidates;
        }
    }
    scores
}

fn path_scores(take: &Take, samples: &[Sample], visits: &[(usize, usize)]) -> Vec<Vec<(usize, f64)>> {
    let mut total = Vec::new();
    for &(i, p) in visits {
        samples[i].candidates[p].iter().for_each(|&(m, v)| add(&mut total, m, v.max(0.0)));
    }
    total.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    total.truncate(FOLLOWED);
    let markers: Vec<usize> = total.iter().map(|x| x.0).collect();
    let states = markers.len() + 1; // the last: none of them
    let told: Vec<Vec<f64>> = visits
        .iter()
        .enumerate()
        .map(|(k, &(i, p))| {
            let before = if k == 0 { f64::INFINITY } else { seconds(take, samples, visits[k - 1].0, i) };
            let after = visits.get(k + 1).map_or(f64::INFINITY, |v| seconds(take, samples, i, v.0));
            // Alone in its surroundings a sample counts in full; among others by its share of the time.
            let weight = (0.5 * (before.min(ALIKE_S) + after.min(ALIKE_S)) / ALIKE_S).min(1.0);
            let value = |m: usize| samples[i].candidates[p].iter().find(|c| c.0 == m).map_or(OTHERWISE, |c| c.1);
            let most = markers.iter().map(|&m| value(m)).fold(0.0, f64::max);
            let clearly = |value: f64| weight * (value + MARGIN).min(most);
            markers.iter().map(|&m| clearly(value(m))).chain([clearly(0.0)]).collect()
        })
        .collect();
    let run = |order: &mut dyn Iterator<Item = usize>| {
        let mut reached = vec![vec![0.0; states]; visits.len()];
        let mut last: Option<usize> = None;
        for k in order {
            let from = last.map(|l| reached[l].clone());
            let most = from.as_ref().map_or(0.0, |f| f.iter().copied().fold(f64::NEG_INFINITY, f64::max));
            let change = last.map_or(CHANGE, |l| change(take, samples, visits[l], visits[k]));
            for s in 0..states {
                let came = from.as_ref().map_or(0.0, |f| f[s].max(most - change));
                reached[k][s] = came + told[k][s];
            }
            last = Some(k);
        }
        reached
    };
    let forward = run(&mut (0..visits.len()));
    let backward = run(&mut (0..visits.len()).rev());
    (0..visits.len())
        .map(|k| {
            let through = |s: usize| forward[k][s] + backward[k][s] - told[k][s];
            let none = through(states - 1);
            markers.iter().enumerate().map(|(s, &m)| (m, through(s) - none)).collect()
        })
        .collect()
}

/// What a change of name costs between two visits of a trajectory.
fn change(take: &Take, samples: &[Sample], (i, p): (usize, usize), (j, q): (usize, usize)) -> f64 {
    let piece = |i: usize, p: usize| take.piece[rows(take, samples[i].frame).start + p];
    if piece(i, p) == piece(j, q) { CHANGE } else { CHANGE_OVER_A_HOLE }
}

/// What speaks for a marker at a point where it was no candidate.
const OTHERWISE: f64 = -6.0;

fn seconds(take: &Take, samples: &[Sample], a: usize, b: usize) -> f64 {
    (samples[b].frame - samples[a].frame) as f64 / take.rate_hz
}

/// Names of the samples for the rows between them: a row has the name of the nearest sample of its piece.
fn spread_out(take: &Take, samples: &[Sample], scores: &[Vec<Vec<(usize, f64)>>], mirrored: f64) -> Labelled {
    let mut of_piece: Vec<Vec<Said>> = vec![Vec::new(); take.pieces];
    for (sample, own) in samples.iter().zip(scores) {
        let mut name = vec![None; own.len()];
        sample.names.iter().enumerate().for_each(|(m, p)| p.iter().for_each(|&p| name[p] = Some(m)));
        for (p, row) in rows(take, sample.frame).enumerate() {
            let (score, probability) = certainty(&own[p], name[p]);
            of_piece[take.piece[row]].push((sample.frame, name[p], score, probability));
        }
    }
    let count = take.points.len();
    let mut found = Labelled { marker: vec![None; count], probability: vec![0.0; count], mirrored };
    let mut score = vec![0.0; count];
    for frame in 0..take.starts.len() - 1 {
        for row in rows(take, frame) {
            let own = &of_piece[take.piece[row]];
            let after = own.partition_point(|x| x.0 < frame);
            let near = [after.checked_sub(1), Some(after)].into_iter().flatten().filter_map(|i| own.get(i));
            if let Some(&(_, name, s, p)) = near.min_by_key(|x| x.0.abs_diff(frame)) {
                (found.marker[row], score[row], found.probability[row]) = (name, s, p);
            }
        }
        // Between two samples a name may have passed from one trajectory to another: the better one has it.
        for row in rows(take, frame) {
            let twin = rows(take, frame)
                .find(|&r| r != row && found.marker[r].is_some() && found.marker[r] == found.marker[row]);
            if let Some(twin) = twin {
                let loser = if score[row] < score[twin] { row } else { twin };
                found.marker[loser] = None;
                found.probability[loser] = 0.5;
            }
        }
    }
    found
}

/// The score of what is said of a point, and its probability among all that could be said.
fn certainty(scores: &[(usize, f64)], name: Option<usize>) -> (f64, f64) {
    let own = name.and_then(|m| scores.iter().find(|s| s.0 == m)).map_or(0.0, |s| s.1);
    let others = scores.iter().filter(|s| Some(s.0) != name).map(|s| s.1);
    let others = if name.is_some() { others.chain([0.0]).collect::<Vec<_>>() } else { others.collect() };
    (own, 1.0 / (1.0 + others.iter().map(|s| (s - own).clamp(-60.0, 60.0).exp()).sum::<f64>()))
}

#[cfg(test)]
mod tests {
    use super::{CHANGE, two_ways};

    #[test]
    fn an_exchange_must_gain_more_than_going_there_and_back_costs() {
        let brief: Vec<f64> = (0..40).map(|k| if (10..20).contains(&k) { 2.0 } else { -1.0 }).collect();
        assert!(two_ways(&brief, &[CHANGE; 40]).iter().all(|s| !s));
        let lasting: Vec<f64> = (0..60).map(|k| if (20..45).contains(&k) { 2.0 } else { -1.0 }).collect();
        let found: Vec<usize> = (0..60).filter(|&k| two_ways(&lasting, &[CHANGE; 60])[k]).collect();
        assert_eq!(found, (20..45).collect::<Vec<_>>());
    }
}
