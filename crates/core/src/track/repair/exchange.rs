//! Identities of two chains exchanged over stretches of time.
//!
//! Where two markers were hidden together, either of the pieces that follow may be either's. Between two chains the
//! tracklets fall into blocks that do not overlap in time; each block stays as it is or is exchanged, and the best of
//! all combinations is found by dynamic programming (Viterbi 1967): how well the distances of each tracklet fit the
//! profile of the chain it comes to, and how well motion leads from block to block.

use super::join::{Distances, Link, Scene};
use rayon::prelude::*;

/// What it costs that motion cannot lead from one tracklet to the next (nats).
pub(super) const IMPOSSIBLE: f64 = -30.0;

/// A better distribution of two chains' tracklets.
pub(super) struct Swap {
    pub gain: f64,
    pub one: usize,
    pub other: usize,
    /// Tracklets of the two chains after the exchange, in order of time.
    pub ones: Vec<usize>,
    pub others: Vec<usize>,
}

/// Tracklets of two chains that overlap in time, directly or by others.
struct Block {
    ones: Vec<usize>,
    others: Vec<usize>,
    /// Evidence of the distances if it stays and if it is exchanged (nats).
    stays: f64,
    exchanged: f64,
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
    pub(super) fn swaps(&self) -> Vec<Swap> {
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

    fn swap(&self, one: usize, other: usize, profiles: &[Vec<Link>], seen: &[Vec<Distances>]) -> Option<Swap> {
        let fits = |chain: usize, tracklets: &[usize]| -> f64 {
            tracklets.iter().map(|&t| Self::links_beside(&profiles[chain], &seen[t], [one, other])).sum()
        };
        let mut blocks = self.blocks(one, other);
        for block in &mut blocks {
            block.stays = fits(one, &block.ones) + fits(other, &block.others);
            block.exchanged = fits(other, &block.ones) + fits(one, &block.others);
        }
        let as_is = blocks.iter().fold(Way::default(), |way, block| self.after(&way, block, false));
        let mut ways = vec![Way::default()];
        for block in &blocks {
            ways = [false, true].map(|e| self.best_after(&ways, block, e)).to_vec();
        }
        let best = ways.into_iter().max_by(|a, b| a.evidence.total_cmp(&b.evidence))?;
        if best.exchanged == as_is.exchanged || best.exchanged.iter().all(|e| *e) {
            return None;
        }
        let (mut ones, mut others) = (Vec::new(), Vec::new());
        for (block, exchanged) in blocks.into_iter().zip(&best.exchanged) {
            let (a, b) = if *exchanged { (block.others, block.ones) } else { (block.ones, block.others) };
            ones.extend(a);
            others.extend(b);
        }
        Some(Swap { gain: best.evidence - as_is.evidence, one, other, ones, others })
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
                blocks.push(Block { ones: Vec::new(), others: Vec::new(), stays: 0.0, exchanged: 0.0 });
            }
            end = end.max(Some(last));
            let Some(block) = blocks.last_mut() else { continue };
            if is_one { block.ones.push(t) } else { block.others.push(t) }
        }
        blocks
    }

    fn best_after(&self, ways: &[Way], block: &Block, exchanged: bool) -> Way {
        let all = ways.iter().map(|way| self.after(way, block, exchanged));
        all.max_by(|a, b| a.evidence.total_cmp(&b.evidence)).unwrap_or_default()
    }

    /// A way with one more block.
    fn after(&self, way: &Way, block: &Block, exchanged: bool) -> Way {
        let mut next = way.clone();
        next.exchanged.push(exchanged);
        next.evidence += if exchanged { block.exchanged } else { block.stays };
        let parts = if exchanged { [&block.others, &block.ones] } else { [&block.ones, &block.others] };
        for (last, part) in next.last.iter_mut().zip(parts) {
            for &t in part {
                if let Some(before) = *last {
                    let bridge = self.bridge(&self.tracklets[before], &self.tracklets[t]);
                    next.evidence += bridge.unwrap_or(IMPOSSIBLE);
                }
                *last = Some(t);
            }
        }
        next
    }
}
