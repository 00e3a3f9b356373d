//! Identities of two chains exchanged over stretches of time.
//!
//! Where two markers were hidden together, either of the pieces that follow may be either's. Between two chains the
//! tracklets fall into blocks that do not overlap in time; each block stays as it is or is exchanged, and the best of
//! all combinations is found by dynamic programming (Viterbi 1967): how well the distances of each tracklet fit the
//! profile of the chain it comes to, and how well motion leads from block to block.

use super::join::{Distances, Handout, Link, Scene};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// What it costs that motion cannot lead from one tracklet to the next (nats).
pub(super) const IMPOSSIBLE: f64 = -30.0;
/// Evidence that an exchange by the sides of the others needs (nats).
const WORTH_TURNING: f64 = 5.0;

/// Tracklets of two chains that overlap in time, directly or by others.
#[derive(Default)]
pub(super) struct Block {
    pub(super) ones: Vec<usize>,
    pub(super) others: Vec<usize>,
    /// Evidence of the distances if it stays and if it is exchanged (nats).
    pub(super) stays: f64,
    pub(super) exchanged: f64,
    pub(super) led: Vec<Led>,
}

/// A tracklet to which the forward pass came from another one.
pub(super) struct Led {
    is_one: bool,
    /// Number of the other's block, and whether it is a one there.
    leader: (usize, bool),
    /// Evidence that the two are one marker (nats).
    evidence: f64,
}

/// A way to distribute the blocks so far.
#[derive(Clone, Default)]
struct Way {
    evidence: f64,
    exchanged: Vec<bool>,
    /// The last tracklet of each chain.
    last: [Option<usize>; 2],
}

impl Scene<'_> {
    /// For every two chains the best exchange, if any.
    pub(super) fn exchanges(&self) -> Vec<Handout> {
        let profiles: Vec<Vec<Link>> = (0..self.chains.len()).into_par_iter().map(|c| self.profile(c)).collect();
        let seen: Vec<Vec<Distances>> =
            (0..self.tracklets.len()).into_par_iter().map(|t| self.distances_of(t)).collect();
        (0..self.chains.len())
            .into_par_iter()
            .flat_map_iter(|one| {
                let (profiles, seen) = (&profiles, &seen);
                (one + 1..self.chains.len()).filter_map(move |other| self.swap(one, other, profiles, seen))
            })
            .collect()
    }

    fn swap(&self, one: usize, other: usize, profiles: &[Vec<Link>], seen: &[Vec<Distances>]) -> Option<Handout> {
        let mut blocks = self.blocks(one, other);
        let (turned, stays) = self.turned([one, other], &blocks).map_or((None, Vec::new()), |t| (t.chains, t.stays));
        let enough = if turned.is_some() { WORTH_TURNING } else { 0.0 };
        if let Some(turned) = turned {
            let [a, b] = turned.map(|chain| self.profile_of(&chain, &[one, other]));
            weigh(&mut blocks, [&a, &b], [one, other], seen);
        } else {
            weigh(&mut blocks, [&profiles[one], &profiles[other]], [one, other], seen);
        }
        for (block, stays) in stays {
            (blocks[block].stays, blocks[block].exchanged) = (stays, 0.0);
        }
        let apart_m = Self::apart_m(&profiles[one], other);
        let (gain, exchanged) = self.best_of(&blocks, apart_m).filter(|(gain, _)| *gain > enough)?;
        Some(Handout { gain, chains: vec![one, other], tracklets: dealt(&blocks, &exchanged).into() })
    }

    /// The best way to hand out the blocks of two chains, so far apart if they stay near each other (m), and what it gains;
    /// `None` if it is the present one.
    fn best_of(&self, blocks: &[Block], apart_m: Option<f64>) -> Option<(f64, Vec<bool>)> {
        let as_is = blocks.iter().fold(Way::default(), |way, block| self.after(&way, block, false, apart_m));
        let (evidence, exchanged) = self.likeliest(blocks, apart_m);
        let other = exchanged != as_is.exchanged && !exchanged.iter().all(|e| *e);
        other.then_some((evidence - as_is.evidence, exchanged))
    }

    /// The best way to hand out the blocks: its evidence, and which are exchanged.
    pub(super) fn likeliest(&self, blocks: &[Block], apart_m: Option<f64>) -> (f64, Vec<bool>) {
        let mut ways = vec![Way::default()];
        for block in blocks {
            ways = [false, true].map(|e| self.best_after(&ways, block, e, apart_m)).to_vec();
        }
        let best = ways.into_iter().max_by(|a, b| a.evidence.total_cmp(&b.evidence)).unwrap_or_default();
        (best.evidence, best.exchanged)
    }

    /// The tracklets of two chains by blocks, in order of time.
    fn blocks(&self, one: usize, other: usize) -> Vec<Block> {
        let of = |chain: usize, is_one: bool| self.chains[chain].tracklets.iter().map(move |&t| (t, is_one));
        let mut all: Vec<(usize, bool)> = of(one, true).chain(of(other, false)).collect();
        all.sort_by_key(|&(t, _)| (self.tracklets[t].first, t));
        let mut blocks: Vec<Block> = Vec::new();
        let mut end = None;
        for (t, is_one) in all {
            let (first, last) = (self.tracklets[t].first, self.tracklets[t].last());
            if end.is_none_or(|end| first > end) {
                blocks.push(Block::default());
            }
            end = end.max(Some(last));
            let Some(block) = blocks.last_mut() else { continue };
            if is_one { block.ones.push(t) } else { block.others.push(t) }
        }
        self.follow(&mut blocks);
        blocks
    }

    /// Notes to which tracklets of blocks the forward pass came from others of them.
    pub(super) fn follow(&self, blocks: &mut [Block]) {
        let sides = |(k, b): (usize, &Block)| {
            let of = |own: &[usize], is_one: bool| own.iter().map(move |&t| (t, (k, is_one))).collect::<Vec<_>>();
            [of(&b.ones, true), of(&b.others, false)].concat()
        };
        let place: BTreeMap<usize, (usize, bool)> = blocks.iter().enumerate().flat_map(sides).collect();
        for (&t, &(block, is_one)) in &place {
            if let Some((leader, evidence)) = self.leader(t)
                && let Some(&leader) = place.get(&leader)
            {
                blocks[block].led.push(Led { is_one, leader, evidence });
            }
        }
    }

    fn best_after(&self, ways: &[Way], block: &Block, exchanged: bool, apart_m: Option<f64>) -> Way {
        let all = ways.iter().map(|way| self.after(way, block, exchanged, apart_m));
        all.max_by(|a, b| a.evidence.total_cmp(&b.evidence)).unwrap_or_default()
    }

    /// A way with one more block.
    fn after(&self, way: &Way, block: &Block, exchanged: bool, apart_m: Option<f64>) -> Way {
        let mut next = way.clone();
        next.exchanged.push(exchanged);
        next.evidence += if exchanged { block.exchanged } else { block.stays };
        let together = |l: &&Led| l.is_one ^ exchanged == l.leader.1 ^ next.exchanged[l.leader.0];
        next.evidence += block.led.iter().filter(together).map(|l| l.evidence).sum::<f64>();
        let parts = if exchanged { [&block.others, &block.ones] } else { [&block.ones, &block.others] };
        for k in [0, 1] {
            for &t in parts[k] {
                let first = self.tracklets[t].first;
                let beside =
                    parts[1 - k].iter().copied().rfind(|&u| self.tracklets[u].last() < first).or(way.last[1 - k]);
                if let Some(before) = next.last[k] {
                    next.evidence += self.leads(before, t, beside.zip(apart_m)).unwrap_or(IMPOSSIBLE);
                }
                next.last[k] = Some(t);
            }
        }
        next
    }
}

/// The tracklets of two chains when some of their blocks are exchanged.
pub(super) fn dealt(blocks: &[Block], exchanged: &[bool]) -> [Vec<usize>; 2] {
    let mut own = [Vec::new(), Vec::new()];
    for (block, &exchanged) in blocks.iter().zip(exchanged) {
        own[usize::from(exchanged)].extend(&block.ones);
        own[usize::from(!exchanged)].extend(&block.others);
    }
    own
}

/// What the distances say of blocks, as they are and exchanged.
pub(super) fn weigh(blocks: &mut [Block], profiles: [&[Link]; 2], pair: [usize; 2], seen: &[Vec<Distances>]) {
    let fits = |profile: &[Link], tracklets: &[usize]| -> f64 {
        tracklets.iter().map(|&t| Scene::links_beside(profile, &seen[t], pair)).sum()
    };
    let [one, other] = profiles;
    for block in blocks {
        block.stays = fits(one, &block.ones) + fits(other, &block.others);
        block.exchanged = fits(other, &block.ones) + fits(one, &block.others);
    }
}
