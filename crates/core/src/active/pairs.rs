//! Two LEDs so near each other that a tracker exchanges their samples for a frame or two: too short to be read from bits, but
//! the vector between them turns round. Which of them is which is found for all frames at once (Viterbi 1967), from their
//! bits and the vector between them, as long as both are seen near each other.

use super::along::{Reading, Stretch, chances};
use super::driving::Driving;
use nalgebra::Vector3;
use std::collections::{BTreeMap, BTreeSet};

/// Markers farther apart than this are not exchanged (m), nor over more frames than this in which one is not seen.
const NEAR: f64 = 0.03;
const LONGEST_HOLE: i64 = 3;
/// How much the vector between two near markers changes (m): by noise, and per second.
const NOISE: f64 = 0.004;
const TURNING: f64 = 0.3;
/// What it costs that the two meet or part exchanged, and what motion says at most (nats).
const AT_THE_ENDS: f64 = 6.0;
const MOST_OF_MOTION: f64 = 12.0;

/// A sample: its stretch, and its place in it.
type Sample = (usize, usize);

/// One frame in which both are seen near each other.
struct Look {
    frame: i64,
    time_s: f64,
    samples: [Sample; 2],
    /// From the one to the other (m).
    between: Vector3<f64>,
    /// Evidence of the bits that they are exchanged (nats).
    exchanged: f64,
}

/// Gives back what near LEDs have of each other.
pub fn part(stretches: &[Stretch], bits: &[Vec<f64>], driving: &Driving, readings: &mut [Vec<Reading>]) {
    let by_frame = by_frame(stretches, readings);
    for pair in near_pairs(stretches, &by_frame) {
        let looks: Vec<Look> =
            by_frame.iter().filter_map(|(f, own)| look(stretches, bits, driving, pair, *f, own)).collect();
        for meeting in looks.chunk_by(|a, b| b.frame - a.frame <= LONGEST_HOLE + 1) {
            for (look, _) in meeting.iter().zip(exchanged(meeting)).filter(|(_, e)| *e) {
                for ((stretch, at), other) in look.samples.into_iter().zip([pair[1], pair[0]]) {
                    readings[stretch][at].word = Some(other);
                }
            }
        }
    }
}

/// By frame, the sample that most surely is each word.
fn by_frame(stretches: &[Stretch], readings: &[Vec<Reading>]) -> BTreeMap<i64, BTreeMap<usize, (Sample, f64)>> {
    let mut found: BTreeMap<i64, BTreeMap<usize, (Sample, f64)>> = BTreeMap::new();
    for (k, (stretch, readings)) in stretches.iter().zip(readings).enumerate() {
        for (at, (frame, reading)) in stretch.frames.iter().zip(readings).enumerate() {
            let Reading { word: Some(word), chance } = reading else { continue };
            let own = found.entry(*frame).or_default().entry(*word).or_insert(((k, at), 0.0));
            if *chance > own.1 {
                *own = ((k, at), *chance);
            }
        }
    }
    found
}

fn near_pairs(stretches: &[Stretch], by_frame: &BTreeMap<i64, BTreeMap<usize, (Sample, f64)>>) -> BTreeSet<[usize; 2]> {
    let place = |(k, at): Sample| stretches[k].places[at];
    let mut found = BTreeSet::new();
    for own in by_frame.values() {
        for (a, (p, _)) in own {
            for (b, (q, _)) in own.range(a + 1..) {
                if (place(*p) - place(*q)).norm() < NEAR {
                    found.insert([*a, *b]);
                }
            }
        }
    }
    found
}

fn look(
    stretches: &[Stretch],
    bits: &[Vec<f64>],
    driving: &Driving,
    pair: [usize; 2],
    frame: i64,
    own: &BTreeMap<usize, (Sample, f64)>,
) -> Option<Look> {
    let samples = [own.get(&pair[0])?.0, own.get(&pair[1])?.0];
    let [p, q] = samples.map(|(stretch, at)| stretches[stretch].places[at]);
    if (q - p).norm() > NEAR {
        return None;
    }
    let bright = pair.map(|word| driving.phases.get(&word).is_some_and(|p| driving.is_bright(word, *p, frame)));
    let evidence = |index: usize| {
        let (stretch, at) = samples[index];
        let likely = chances(bits[stretch][at]);
        (likely[usize::from(bright[1 - index])] / likely[usize::from(bright[index])]).ln()
    };
    let time_s = stretches[samples[0].0].times_s[samples[0].1];
    Some(Look { frame, time_s, samples, between: q - p, exchanged: evidence(0) + evidence(1) })
}

/// For each look of a meeting, whether the two are exchanged in it.
fn exchanged(looks: &[Look]) -> Vec<bool> {
    let mut ways = [0.0, -AT_THE_ENDS];
    let mut from: Vec<[usize; 2]> = Vec::with_capacity(looks.len());
    for (k, look) in looks.iter().enumerate() {
        let change = k.checked_sub(1).map_or(f64::INFINITY, |k| {
            let spread = NOISE + TURNING * (look.time_s - looks[k].time_s);
            (2.0 * looks[k].between.dot(&look.between) / (spread * spread)).clamp(-MOST_OF_MOTION, MOST_OF_MOTION)
        });
        let came = [0, 1].map(|way| if ways[way] >= ways[1 - way] - change { way } else { 1 - way });
        let cost = |way: usize| ways[came[way]] - if came[way] == way { 0.0 } else { change };
        ways = [cost(0) - 0.5 * look.exchanged, cost(1) + 0.5 * look.exchanged];
        from.push(came);
    }
    let mut way = usize::from(ways[1] - AT_THE_ENDS > ways[0]);
    let mut found = vec![false; looks.len()];
    for (k, came) in from.iter().enumerate().rev() {
        found[k] = way == 1;
        way = came[way];
    }
    found
}
