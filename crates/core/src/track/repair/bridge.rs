//! How well motion leads from one tracklet to another.
//!
//! From the places and velocities at both ends of a gap: the longer it is, the less it says, until only how the others moved
//! counts. Two markers of one part tell of each other's motion; and the forward pass may have followed one by its rays.

use super::join::Scene;
use super::tracklets::Tracklet;
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// Acceleration that a limb may undergo unseen (m/s²), and the fastest marker (m/s).
pub(super) const ACCELERATION: f64 = 25.0;
const FASTEST: f64 = 9.0;
/// Time from which a velocity is taken (s).
const RUN_UP_S: f64 = 0.03;
/// How often a limb's acceleration turns into another (1/s).
const CHANGES_PER_S: f64 = 6.0;
/// What it says that the forward pass followed a marker from one tracklet to another by its rays (nats).
const FOLLOWED: f64 = 4.0;
/// Volume in which another marker could as well have appeared (m³), and bounds of the evidence of motion (nats).
const ELSEWHERE: f64 = 0.2;
const MOTION_FOR: f64 = 8.0;
/// How far a limb's marker may get about its body, however long it was hidden (m); from there on motion says little.
const LIMB_RANGE: f64 = 0.35;
const MOTION_AGAINST_LATER: f64 = -2.0;

impl Scene<'_> {
    /// Evidence of motion along tracklets in order of time; `None` if they overlap or nothing moves so fast.
    pub(super) fn path_evidence(&self, sequence: &[usize]) -> Option<f64> {
        let mut total = 0.0;
        for pair in sequence.windows(2) {
            let (before, after) = (&self.tracklets[pair[0]], &self.tracklets[pair[1]]);
            if before.last() >= after.first {
                return None;
            }
            total += self.bridge(before, after)?;
        }
        let led = |&t: &usize| self.leader(t).filter(|(leader, _)| sequence.contains(leader)).map(|l| l.1);
        Some(total + sequence.iter().filter_map(led).sum::<f64>())
    }

    /// The tracklet from whose end the forward pass came to another one, and the evidence that they are one marker (nats).
    pub(super) fn leader(&self, tracklet: usize) -> Option<(usize, f64)> {
        self.leaders[tracklet].map(|l| (l, FOLLOWED * self.tracklets[tracklet].followed))
    }

    /// Evidence of motion that two chains are one: along both together, beyond that along each. `None` if they overlap
    /// or nothing moves so fast.
    pub(super) fn motion(&self, a: usize, b: usize) -> Option<f64> {
        let (one, other) = (&self.chains[a].tracklets, &self.chains[b].tracklets);
        let mut both: Vec<usize> = one.iter().chain(other).copied().collect();
        both.sort_unstable_by_key(|&t| (self.tracklets[t].first, t));
        let together = self.path_evidence(&both)?;
        Some((together - self.path_evidence(one)? - self.path_evidence(other)?).min(2.0 * MOTION_FOR))
    }

    /// Evidence that one tracklet goes on as another, by their places and velocities at the gap.
    pub(super) fn bridge(&self, before: &Tracklet, after: &Tracklet) -> Option<f64> {
        self.bridge_beside(before, after, 0.0)
    }

    /// The same if the two are markers of one part, so far from each other (m).
    pub(super) fn bridge_beside(&self, before: &Tracklet, after: &Tracklet, apart_m: f64) -> Option<f64> {
        // On a sphere about the other, by its spread on each axis.
        let beside = apart_m / 3f64.sqrt();
        let gap_s = self.times_s[after.first] - self.times_s[before.last()];
        let (p, q) = (before.at(before.last())?, after.at(after.first)?);
        if (q - p).norm() > FASTEST * gap_s + 0.05 {
            return None;
        }
        let later = |from: &Vector3<f64>| {
            let moved = from + self.drift(before.last(), after.first, from);
            ln_near((q - moved).norm(), LIMB_RANGE).max(MOTION_AGAINST_LATER)
        };
        let (v, w) = (self.velocity(before, true), self.velocity(after, false));
        let carried = match (v, w) {
            (Some(v), Some(w)) => p + (v + w) * (0.5 * gap_s),
            (Some(v), None) | (None, Some(v)) => p + v * gap_s,
            (None, None) => p,
        };
        let unknown = if v.is_some() || w.is_some() { 0.0 } else { 2.0 * gap_s };
        // With both velocities, only what the acceleration changes by is unforeseen.
        let smooth = if v.is_some() && w.is_some() { CHANGES_PER_S * gap_s } else { 1.0 };
        let noise =
            (before.variance_m2() + after.variance_m2()).sqrt() * (1.0 + 0.5 * (gap_s / RUN_UP_S).powi(2)).sqrt();
        let spread =
            (0.004 + 0.25 * ACCELERATION * gap_s * gap_s * smooth.min(1.0) + unknown).hypot(noise).hypot(beside);
        let motion = if spread > LIMB_RANGE { later(&p) } else { ln_near((q - carried).norm(), spread) };
        Some(motion)
    }

    /// Velocity at the end or the beginning of a tracklet (m/s), over up to [`RUN_UP_S`] or two frames.
    pub(super) fn velocity(&self, tracklet: &Tracklet, at_end: bool) -> Option<Vector3<f64>> {
        let here = if at_end { tracklet.last() } else { tracklet.first };
        let mut best = None;
        for step in 1..tracklet.places.len() {
            let there = if at_end { here - step } else { here + step };
            let dt_s = self.times_s[here] - self.times_s[there];
            if let (Some(p), Some(q)) = (tracklet.at(here), tracklet.at(there)) {
                best = Some((p - q) / dt_s);
            }
            if dt_s.abs() > RUN_UP_S {
                break;
            }
        }
        best
    }

    /// Evidence of motion that one tracklet goes on as another. Of two markers of one part, the one that was seen later tells
    /// where both are: `beside`, its tracklet and how far apart they are (m).
    pub(super) fn leads(&self, before: usize, to: usize, beside: Option<(usize, f64)>) -> Option<f64> {
        let [before, to] = [before, to].map(|t| &self.tracklets[t]);
        let own = self.bridge(before, to)?;
        let other = beside.map(|(u, apart_m)| (&self.tracklets[u], apart_m)).filter(|(u, _)| u.last() > before.last());
        let by_other = other.and_then(|(u, apart_m)| self.bridge_beside(u, to, apart_m));
        Some(by_other.map_or(own, |by_other| own.max(by_other)))
    }

    /// How the others moved between two frames, on average: nearby ones count more (m).
    fn drift(&self, from: usize, to: usize, place: &Vector3<f64>) -> Vector3<f64> {
        let (mut sum, mut weight) = (Vector3::zeros(), 1e-9);
        for (chain, p) in &self.by_frame[from] {
            if let Some((_, q)) = self.by_frame[to].iter().find(|(o, _)| o == chain) {
                let w = 1.0 / ((p - place).norm_squared() + 0.04);
                sum += (q - p) * w;
                weight += w;
            }
        }
        sum / weight
    }
}

/// Logarithm of a heavy-tailed density of an offset over that of another marker, within bounds.
fn ln_near(off: f64, spread: f64) -> f64 {
    let squared = off * off / (spread * spread);
    let ln_here = -1.5 * std::f64::consts::TAU.ln() - 3.0 * spread.ln() - 2.5 * (squared / 5.0).ln_1p();
    (ln_here + ELSEWHERE.ln()).clamp(-MOTION_FOR, MOTION_FOR)
}

/// For each tracklet the one that had its first identity last before it began.
pub(super) fn leaders(tracklets: &[Tracklet]) -> Vec<Option<usize>> {
    let mut of_track: BTreeMap<u32, Vec<(usize, usize)>> = BTreeMap::new();
    for (t, one) in tracklets.iter().enumerate() {
        of_track.entry(one.track).or_default().push((one.last(), t));
    }
    of_track.values_mut().for_each(|own| own.sort_unstable());
    let leader = |one: &Tracklet| {
        let own = of_track.get(&one.first_track)?;
        let before = own.partition_point(|o| o.0 < one.first);
        before.checked_sub(1).map(|k| own[k].1)
    };
    tracklets.iter().map(leader).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A tracklet of a marker that stands still.
    fn standing(track: u32, at: [f64; 3], frames: std::ops::RangeInclusive<usize>) -> Tracklet {
        let mut one = Tracklet::of_places(*frames.start(), frames.map(|_| Some(Vector3::from(at))).collect());
        (one.track, one.first_track) = (track, track);
        one
    }

    #[test]
    fn what_the_forward_pass_followed_counts_across_a_piece_in_between() {
        let times_s: Vec<f64> = (0..300).map(|f| f64::from(f) / 100.0).collect();
        let pieces = |followed: f64| {
            let at = [0.0, 0.0, 1.0];
            let last = Tracklet { followed, ..standing(7, at, 120..=200) };
            [standing(7, at, 0..=100), standing(8, at, 105..=110), last]
        };
        let evidence = |followed: f64, sequence: &[usize]| {
            let tracklets = pieces(followed);
            Scene::new(&tracklets, &times_s, &[], &[]).path_evidence(sequence).expect("nothing moves")
        };
        for sequence in [&[0, 2][..], &[0, 1, 2]] {
            assert!((evidence(1.0, sequence) - evidence(0.0, sequence) - FOLLOWED).abs() < 1e-9);
        }
        assert!((evidence(1.0, &[1, 2]) - evidence(0.0, &[1, 2])).abs() < 1e-9, "it came from the first");
    }

    #[test]
    fn a_marker_of_the_same_part_tells_where_a_hidden_one_is() {
        let times_s: Vec<f64> = (0..300).map(|f| f64::from(f) / 100.0).collect();
        // Hidden for a second and a half; the other was seen until just before.
        let tracklets = [
            standing(0, [0.0, 0.0, 1.0], 0..=40),
            standing(1, [0.05, 0.0, 1.0], 0..=188),
            standing(0, [0.0, 0.0, 1.0], 190..=250),
        ];
        let scene = Scene::new(&tracklets, &times_s, &[], &[]);
        let alone = scene.leads(0, 2, None).expect("nothing moves");
        let beside = scene.leads(0, 2, Some((1, 0.05))).expect("nothing moves");
        assert!(beside > alone + 2.0, "{alone} {beside}");
        // As sure as that it is the other one itself, to within what the distance between them leaves open.
        assert!((beside - scene.leads(1, 2, None).expect("nothing moves")).abs() < 2.0);
    }
}
