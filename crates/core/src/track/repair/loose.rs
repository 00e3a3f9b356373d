//! Chains that are no marker: two rays that met by chance for some frames, here and there.
//!
//! What only two rays ever saw may be two markers' dots, where others were seen by more. A marker sits on something, so it
//! keeps its distance to one beside it; where rays meet does not. A lone marker goes with them if no third camera ever sees it
//! and it is measured for less than half a second in all.

use super::join::{Chain, Scene, samples};
use super::tracklets::rarity;
use std::collections::BTreeMap;

/// Chance of a marker never to be seen by more than two rays, by how often others are so (nats).
const RARE: f64 = 3.0;
/// Rays of two markers do not meet for longer than this (s).
const LONGEST_S: f64 = 0.5;
/// Frames looked at.
const LOOKS: usize = 80;
/// How far away a marker of the same part may be, and the spread of that beyond the noise (m).
const BESIDE: f64 = 0.35;
const STAYS: f64 = 0.01;

impl Scene<'_> {
    /// For each chain, whether it is where rays met by chance.
    pub(super) fn loose(&self) -> Vec<bool> {
        let rarity = rarity(self.tracklets);
        let is_loose = |(number, chain): (usize, &Chain)| {
            let two_rays = chain.tracklets.iter().all(|&t| self.tracklets[t].wide == 0);
            let length = chain.length as f64;
            two_rays && length * rarity > RARE && length * self.frame_s() < LONGEST_S && !self.sits_on_something(number)
        };
        self.chains.iter().enumerate().map(is_loose).collect()
    }

    /// Whether a chain keeps its distance to another one that is seen most of the time when it is.
    fn sits_on_something(&self, chain: usize) -> bool {
        let own = self.made_of(&self.chains[chain]);
        let looks = samples(&own, LOOKS);
        let mut seen: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
        for (frame, place) in &looks {
            for (other, p) in &self.by_frame[*frame] {
                seen.entry(*other).or_default().push((p - place).norm());
            }
        }
        let noise = own.iter().map(|t| t.variance).sum::<f64>() / self.chains[chain].length as f64;
        let keeps = |distances: &Vec<f64>| {
            let n = distances.len() as f64;
            let mean = distances.iter().sum::<f64>() / n;
            let squared = distances.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
            mean < BESIDE && 2 * distances.len() > looks.len() && squared < STAYS * STAYS + noise
        };
        seen.iter().any(|(other, distances)| *other != chain && keeps(distances))
    }
}

#[cfg(test)]
mod tests {
    use super::super::tracklets::Tracklet;
    use super::*;
    use nalgebra::{Rotation3, Vector3};

    const FRAMES: usize = 200;

    /// Whether something that two rays see in some frames, beside a body that turns, is loose: where it is in a frame, in which
    /// frames it is seen, and whether the body is seen by more than two rays.
    fn is_loose(place: impl Fn(usize) -> Vector3<f64>, seen: std::ops::Range<usize>, by_more_than_two: bool) -> bool {
        let own = [[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1], [-0.1, -0.1, 0.0]];
        let narrow = |t: Tracklet| Tracklet { wide: 0, ..t };
        let of = |at: &[f64; 3]| {
            let t = Tracklet::of_places(0, (0..FRAMES).map(|f| Some(turn(f) * Vector3::from(*at))).collect());
            if by_more_than_two { t } else { narrow(t) }
        };
        let mut tracklets: Vec<Tracklet> = own.iter().map(of).collect();
        let first = seen.start;
        tracklets.push(narrow(Tracklet::of_places(first, seen.map(|f| Some(place(f))).collect())));
        let chains: Vec<Chain> = (0..tracklets.len()).map(|t| Chain::of(&tracklets, vec![t])).collect();
        let times_s: Vec<f64> = (0..FRAMES).map(|f| f as f64 / 100.0).collect();
        let found = Scene::new(&tracklets, &times_s, &chains, &[]).loose();
        assert!(found[..own.len()].iter().all(|l| !l), "what is on the body is no chance");
        found[own.len()]
    }

    fn turn(f: usize) -> Rotation3<f64> {
        let t = f as f64 / 100.0;
        Rotation3::from_euler_angles(5.0 * t, 2.0 * t.sin(), 3.0 * t)
    }

    /// A point that goes past the body.
    fn past(f: usize) -> Vector3<f64> {
        Vector3::new(0.2, 0.03 * (f as f64 - 100.0), 0.1)
    }

    #[test]
    fn two_rays_that_go_past_everything_are_no_marker() {
        assert!(is_loose(past, 100..110, true));
    }

    #[test]
    fn two_rays_that_keep_their_distance_are_a_marker() {
        assert!(!is_loose(|f| turn(f) * Vector3::new(0.05, 0.05, 0.1), 100..110, true));
    }

    #[test]
    fn what_goes_past_is_a_marker_if_it_lasts_or_if_two_rays_are_usual() {
        assert!(!is_loose(past, 80..140, true), "rays of two markers do not meet for so long");
        assert!(!is_loose(past, 100..110, false), "two rays are all that is ever seen");
    }
}
