//! A chain too many: three chains of which no more than two are ever seen at once may be two markers.
//!
//! Where two near markers come and go, a piece of the one in the other's chain keeps the rest of its own chain out, because
//! a marker is not in two places; so a third chain arises that overlaps both, which nobody can join (`join.rs`) or exchange
//! (`exchange.rs`). Here the tracklets of all three fall into blocks that do not overlap in time. If none of them needs a
//! third marker (for more than a moment, in which rays met by chance), each can be handed out to two chains in two ways, and
//! the best of all combinations is found as for an exchange.

use super::exchange::{Block, dealt, weigh};
use super::join::{Chain, Distances, Handout, Link, Scene};
use super::tracklets::SURE_GAP_S;
use rayon::prelude::*;

/// Chains that another one is held against, the likeliest first.
const NEIGHBOURS: usize = 4;
/// Rounds in which the two chains are learned anew from what they have been given.
const ROUNDS: usize = 5;

impl Scene<'_> {
    /// For every chain the best way to hand it out to two longer ones, if any.
    pub(super) fn absorbed(&self) -> Vec<Handout> {
        let profiles: Vec<Vec<Link>> = (0..self.chains.len()).into_par_iter().map(|c| self.profile(c)).collect();
        let seen: Vec<Vec<Distances>> =
            (0..self.tracklets.len()).into_par_iter().map(|t| self.distances_of(t)).collect();
        (0..self.chains.len()).into_par_iter().filter_map(|c| self.absorb(c, &profiles, &seen)).collect()
    }

    fn absorb(&self, third: usize, profiles: &[Vec<Link>], seen: &[Vec<Distances>]) -> Option<Handout> {
        let likely = |c: usize| {
            let own = &self.chains[third].tracklets;
            own.iter().map(|&t| Self::links_beside(&profiles[c], &seen[t], [c, third])).sum::<f64>()
        };
        let is_longer = |c: &usize| (self.chains[*c].length, third) > (self.chains[third].length, *c);
        let mut near: Vec<(f64, usize)> =
            (0..self.chains.len()).filter(|c| *c != third).filter(is_longer).map(|c| (likely(c), c)).collect();
        near.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        near.truncate(NEIGHBOURS);
        // What nothing keeps out of a chain is a matter of joining.
        near.retain(|&(_, c)| self.overlap(third, c));
        let pairs = (0..near.len()).flat_map(|b| (0..b).map(move |a| (a, b)));
        let ways = pairs.filter_map(|(a, b)| self.handed_out([near[a].1, near[b].1, third], profiles, seen));
        ways.max_by(|a, b| a.gain.total_cmp(&b.gain))
    }

    /// Whether two chains are seen at the same time.
    fn overlap(&self, one: usize, other: usize) -> bool {
        let of = |c: usize| self.chains[c].tracklets.iter().map(|&t| &self.tracklets[t]);
        of(one).any(|a| of(other).any(|b| a.first <= b.last() && b.first <= a.last()))
    }

    /// The best way to hand out three chains' tracklets to the first two; `None` if it takes three.
    fn handed_out(&self, chains: [usize; 3], profiles: &[Vec<Link>], seen: &[Vec<Distances>]) -> Option<Handout> {
        let mut blocks = self.in_two(chains)?;
        let [one, other, _] = chains;
        let apart_m = Self::apart_m(&profiles[one], other);
        let fits = |profile: &[Link], own: &[usize]| -> f64 {
            own.iter().map(|&t| Self::links_beside(profile, &seen[t], [one, other])).sum()
        };
        let motion: f64 = chains.iter().filter_map(|&c| self.path_evidence(&self.chains[c].tracklets)).sum();
        let mut two = [one, other].map(|c| self.chains[c].clone());
        let mut gain = 0.0;
        let mut before = Vec::new();
        // Where the two's histories are mixed, it may go to and fro between ways that are as good as each other.
        for _ in 0..ROUNDS {
            let [a, b] = [0, 1].map(|i| self.profile_of(&two[i], &chains));
            let as_is = motion + fits(&a, &self.chains[one].tracklets) + fits(&b, &self.chains[other].tracklets);
            weigh(&mut blocks, [&a, &b], [one, other], seen);
            let (evidence, exchanged) = self.likeliest(&blocks, apart_m);
            gain = evidence - as_is;
            two = dealt(&blocks, &exchanged).map(|own| Chain::of(self.tracklets, own));
            if before == exchanged {
                break;
            }
            before = exchanged;
        }
        let possible = two.iter().all(|c| self.path_evidence(&c.tracklets).is_some());
        let [ones, others] = two.map(|c| c.tracklets);
        possible.then(|| Handout { gain, chains: chains.to_vec(), tracklets: vec![ones, others, Vec::new()] })
    }

    /// Three chains' tracklets in blocks that overlap in time, each in two parts that do not; `None` if that cannot be.
    /// What is one too many for a moment is left out.
    fn in_two(&self, chains: [usize; 3]) -> Option<Vec<Block>> {
        let mut all: Vec<usize> = chains.iter().flat_map(|&c| &self.chains[c].tracklets).copied().collect();
        all.sort_unstable_by_key(|&t| (self.tracklets[t].first, t));
        let left = self.one_too_many(&all);
        let mut blocks: Vec<Block> = Vec::new();
        // The last frame of each part of the newest.
        let mut ends: [Option<usize>; 2] = [None; 2];
        for t in all.into_iter().filter(|t| !left.contains(t)) {
            let (first, last) = (self.tracklets[t].first, self.tracklets[t].last());
            let is_free = |end: Option<usize>| end.is_none_or(|end| end < first);
            if ends.iter().all(|&end| is_free(end)) {
                blocks.push(Block { ones: vec![t], ..Block::default() });
                ends = [Some(last), None];
                continue;
            }
            let part = ends.iter().position(|&end| is_free(end))?;
            let block = blocks.last_mut()?;
            if part == 0 {
                block.ones.push(t);
            } else {
                block.others.push(t);
            }
            ends[part] = Some(last);
        }
        self.follow(&mut blocks);
        Some(blocks)
    }

    /// Tracklets of a moment in which two others are seen.
    fn one_too_many(&self, all: &[usize]) -> Vec<usize> {
        let mut left: Vec<usize> = Vec::new();
        let frames = |t: usize| self.tracklets[t].first..=self.tracklets[t].last();
        let seconds = |t: usize| self.times_s[*frames(t).end()] - self.times_s[*frames(t).start()];
        for &t in all.iter().filter(|&&t| seconds(t) <= SURE_GAP_S) {
            let others =
                |f: usize| all.iter().filter(|&&u| u != t && frames(u).contains(&f) && !left.contains(&u)).count();
            if frames(t).any(|f| others(f) > 1) {
                left.push(t);
            }
        }
        left
    }
}

#[cfg(test)]
mod tests {
    use super::super::tracklets::Tracklet;
    use super::*;
    use nalgebra::{Rotation3, Vector3};

    const FRAMES: usize = 1200;

    /// Where a marker sits on its part (m), and in which frames it is seen.
    type Seen = ([f64; 3], fn(usize) -> bool);

    /// Tracklets of markers of one part, each with its marker.
    fn pieces(markers: &[Seen]) -> (Vec<Tracklet>, Vec<usize>) {
        let place = |at: &[f64; 3], f: usize| {
            let t = f as f64 / 100.0;
            let turn = Rotation3::from_euler_angles(0.5 * (0.7 * t).sin(), 0.9 * (1.7 * t).sin(), 0.5 * t.cos());
            turn * Vector3::from(*at) + Vector3::new(0.3 * t.sin(), 0.2 * t, 1.0)
        };
        let mut found = Vec::new();
        for (m, (at, is_seen)) in markers.iter().enumerate() {
            for first in (0..FRAMES).filter(|&f| is_seen(f) && (f == 0 || !is_seen(f - 1))) {
                let seen = (first..FRAMES).take_while(|&f| is_seen(f));
                found.push((Tracklet::of_places(first, seen.map(|f| Some(place(at, f))).collect()), m));
            }
        }
        found.sort_by_key(|(t, m)| (t.first, *m));
        found.into_iter().unzip()
    }

    /// What is handed out, as the markers that the two chains come to have.
    fn absorbed(markers: &[Seen], chain_of: impl Fn(usize, usize) -> usize) -> Vec<[Vec<usize>; 2]> {
        let (tracklets, owner) = pieces(markers);
        let count = (0..tracklets.len()).map(|t| chain_of(owner[t], tracklets[t].first) + 1).max().unwrap_or(0);
        let chain = |c: usize| {
            let own: Vec<usize> =
                (0..tracklets.len()).filter(|&t| chain_of(owner[t], tracklets[t].first) == c).collect();
            Chain::of(&tracklets, own)
        };
        let chains: Vec<Chain> = (0..count).map(chain).collect();
        let times_s: Vec<f64> = (0..FRAMES).map(|f| f as f64 / 100.0).collect();
        let found = Scene::new(&tracklets, &times_s, &chains, &[]).absorbed();
        let owners = |own: &[usize]| {
            let mut owners: Vec<usize> = own.iter().map(|&t| owner[t]).collect();
            owners.sort_unstable();
            owners.dedup();
            owners
        };
        found.iter().filter(|a| a.gain > 1.0).map(|a| [owners(&a.tracklets[0]), owners(&a.tracklets[1])]).collect()
    }

    fn always(_: usize) -> bool {
        true
    }

    fn early(f: usize) -> bool {
        f % 100 < 60
    }

    fn late(f: usize) -> bool {
        f % 100 >= 40
    }

    fn between(f: usize) -> bool {
        (65..95).contains(&(f % 100)) && f < 600
    }

    const TRUNK: [[f64; 3]; 4] = [[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.0, 0.2, 0.3], [0.3, 0.2, 0.3]];

    /// In one place the first of the near ones has a piece of the other, in another the other of the first; what they lost by
    /// that is a third chain.
    fn mixed(marker: usize, first: usize) -> usize {
        match (marker, first / 100) {
            (4, 3) | (5, 7) => 6,
            (5, 3) => 4,
            (4, 7) => 5,
            (m, _) => m,
        }
    }

    #[test]
    fn a_chain_that_a_wrong_piece_kept_out_is_handed_out_to_the_other_two() {
        let mut markers: Vec<Seen> = TRUNK.map(|p| (p, always as fn(usize) -> bool)).to_vec();
        markers.extend([([0.1, 0.1, 0.1], early as fn(usize) -> bool), ([0.13, 0.12, 0.12], late)]);
        let mut found = absorbed(&markers, mixed);
        found.iter_mut().for_each(|two| two.sort());
        assert_eq!(found, [[vec![4], vec![5]]]);
    }

    #[test]
    fn what_is_one_too_many_for_a_moment_keeps_nothing_apart() {
        let mut markers: Vec<Seen> = TRUNK.map(|p| (p, always as fn(usize) -> bool)).to_vec();
        let a_moment = |f: usize| f == 445 || f == 446;
        markers.extend([
            ([0.1, 0.1, 0.1], early as fn(usize) -> bool),
            ([0.13, 0.12, 0.12], late),
            ([0.11, 0.1, 0.12], a_moment),
        ]);
        let mut found = absorbed(&markers, mixed);
        found.iter_mut().for_each(|two| two.sort());
        assert_eq!(found, [[vec![4], vec![5]]]);
    }

    #[test]
    fn three_markers_stay_three_even_if_no_more_than_two_are_seen_at_once() {
        let mut markers: Vec<Seen> = TRUNK.map(|p| (p, always as fn(usize) -> bool)).to_vec();
        markers.extend([
            ([0.1, 0.1, 0.1], early as fn(usize) -> bool),
            ([0.13, 0.12, 0.12], late),
            ([0.05, 0.15, 0.1], between),
        ]);
        assert!(absorbed(&markers, |marker, _| marker).is_empty());
    }
}
