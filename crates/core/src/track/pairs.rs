//! Which marker has which dot of one camera: the pairs of greatest total gain (Bar-Shalom & Li 1995, "Multitarget-
//! Multisensor Tracking", §6). Nearly all of them nothing can beat; what is left is solved group by group.

use crate::assignment::assign;

/// A dot that may be a marker's, with the gain of believing so (nats). Both by their number in the camera.
#[derive(Clone, Copy)]
pub struct Edge {
    pub who: u32,
    pub dot: u32,
    pub gain: f64,
}

/// The pairs of greatest total gain. Pairs that nothing can beat are taken as they are; the rest is solved group by group.
pub fn best_pairs(mut edges: Vec<Edge>) -> Vec<(u32, u32)> {
    let mut pairs = take_lone(&mut edges);
    take_sure(&mut edges, &mut pairs);
    if edges.is_empty() {
        return pairs;
    }
    let mut by_dot: Vec<usize> = (0..edges.len()).collect();
    by_dot.sort_unstable_by_key(|&e| (edges[e].dot, edges[e].who));
    let mut group: Vec<usize> = (0..edges.len()).collect();
    for pair in (1..edges.len()).map(|i| [i - 1, i]).filter(|p| edges[p[0]].who == edges[p[1]].who) {
        join(&mut group, pair[0], pair[1]);
    }
    for pair in by_dot.windows(2).filter(|p| edges[p[0]].dot == edges[p[1]].dot) {
        join(&mut group, pair[0], pair[1]);
    }
    let mut members: Vec<(usize, usize)> = (0..edges.len()).map(|e| (root(&mut group, e), e)).collect();
    members.sort_unstable();
    for component in members.chunk_by(|a, b| a.0 == b.0) {
        match component {
            [(_, single)] => pairs.push((edges[*single].who, edges[*single].dot)),
            several => solve(several.iter().map(|&(_, e)| &edges[e]), &mut pairs),
        }
    }
    pairs
}

/// Takes out the pairs of which neither has another choice.
fn take_lone(edges: &mut Vec<Edge>) -> Vec<(u32, u32)> {
    let (mut of_marker, mut of_dot) = (vec![0_u8; markers_of(edges)], vec![0_u8; dots_of(edges)]);
    for e in &*edges {
        let (marker, dot) = (&mut of_marker[e.who as usize], &mut of_dot[e.dot as usize]);
        (*marker, *dot) = (marker.saturating_add(1), dot.saturating_add(1));
    }
    let mut pairs = Vec::with_capacity(edges.len());
    edges.retain(|e| {
        let lone = of_marker[e.who as usize] == 1 && of_dot[e.dot as usize] == 1;
        if lone {
            pairs.push((e.who, e.dot));
        }
        !lone
    });
    pairs
}

/// Numbers of markers and dots up to the last that has an edge.
fn markers_of(edges: &[Edge]) -> usize {
    edges.iter().map(|e| e.who as usize + 1).max().unwrap_or(0)
}

fn dots_of(edges: &[Edge]) -> usize {
    edges.iter().map(|e| e.dot as usize + 1).max().unwrap_or(0)
}

/// In place of the largest gain: that marker or dot has its own.
const TAKEN: f64 = f64::INFINITY;

/// The two largest gains around a marker or a dot.
#[derive(Clone, Copy, Default)]
struct Best {
    first: f64,
    second: f64,
}

impl Best {
    fn take_in(&mut self, gain: f64) {
        if gain > self.first {
            (self.first, self.second) = (gain, self.first);
        } else {
            self.second = self.second.max(gain);
        }
    }

    /// The best of the others.
    fn beside(&self, gain: f64) -> f64 {
        if gain >= self.first { self.second } else { self.first }
    }
}

/// Takes out the pairs whose gain is at least that of the best others of their marker and their dot together: no exchange
/// could lose less. Edges of what is taken go.
fn take_sure(edges: &mut Vec<Edge>, pairs: &mut Vec<(u32, u32)>) {
    let (mut of_marker, mut of_dot) = (vec![Best::default(); markers_of(edges)], vec![Best::default(); dots_of(edges)]);
    loop {
        of_marker.fill(Best::default());
        of_dot.fill(Best::default());
        for e in &*edges {
            of_marker[e.who as usize].take_in(e.gain);
            of_dot[e.dot as usize].take_in(e.gain);
        }
        let sure = |e: &Edge| e.gain > of_marker[e.who as usize].beside(e.gain) + of_dot[e.dot as usize].beside(e.gain);
        let before = pairs.len();
        pairs.extend(edges.iter().filter(|e| sure(e)).map(|e| (e.who, e.dot)));
        // What is taken has no best any more.
        for &(who, dot) in &pairs[before..] {
            (of_marker[who as usize].first, of_dot[dot as usize].first) = (TAKEN, TAKEN);
        }
        edges.retain(|e| of_marker[e.who as usize].first < TAKEN && of_dot[e.dot as usize].first < TAKEN);
        if edges.is_empty() || pairs.len() == before {
            return;
        }
    }
}

fn solve<'a>(edges: impl Iterator<Item = &'a Edge> + Clone, pairs: &mut Vec<(u32, u32)>) {
    let mut rows: Vec<u32> = edges.clone().map(|e| e.who).collect();
    let mut columns: Vec<u32> = edges.clone().map(|e| e.dot).collect();
    rows.sort_unstable();
    rows.dedup();
    columns.sort_unstable();
    columns.dedup();
    let mut costs = vec![None; rows.len() * columns.len()];
    for edge in edges {
        let row = rows.partition_point(|&r| r < edge.who);
        let column = columns.partition_point(|&c| c < edge.dot);
        costs[row * columns.len() + column] = Some(-edge.gain);
    }
    let found = assign(rows.len(), columns.len(), |r, c| costs[r * columns.len() + c]);
    pairs.extend(found.iter().enumerate().filter_map(|(r, c)| c.map(|c| (rows[r], columns[c]))));
}

fn root(group: &mut [usize], mut at: usize) -> usize {
    while group[at] != at {
        group[at] = group[group[at]];
        at = group[at];
    }
    at
}

fn join(group: &mut [usize], a: usize, b: usize) {
    let (a, b) = (root(group, a), root(group, b));
    group[a.max(b)] = a.min(b);
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::ChaCha8Rng;
    use rand_core::{RngCore, SeedableRng};

    fn uniform(rng: &mut ChaCha8Rng) -> f64 {
        f64::from(rng.next_u32()) / f64::from(u32::MAX)
    }

    /// One assignment of everything at once is the oracle.
    #[test]
    fn no_other_pairs_gain_more() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        for round in 0..200 {
            let (markers, dots) = (1 + rng.next_u32() % 12, 1 + rng.next_u32() % 12);
            let density = uniform(&mut rng);
            let mut edges = Vec::new();
            for (who, dot) in (0..markers).flat_map(|who| (0..dots).map(move |dot| (who, dot))) {
                if uniform(&mut rng) < density {
                    edges.push(Edge { who, dot, gain: 10.0 * uniform(&mut rng) + 1e-3 });
                }
            }
            let gain = |who: usize, dot: usize| {
                edges.iter().find(|e| (e.who as usize, e.dot as usize) == (who, dot)).map(|e| e.gain)
            };
            let best = assign(markers as usize, dots as usize, |who, dot| gain(who, dot).map(|g| -g));
            let most: f64 = best.iter().enumerate().filter_map(|(who, dot)| gain(who, (*dot)?)).sum();
            let pairs = best_pairs(edges.clone());
            let total: f64 = pairs.iter().filter_map(|&(who, dot)| gain(who as usize, dot as usize)).sum();
            approx::assert_relative_eq!(total, most, epsilon = 1e-9);
            for mut ends in [pairs.iter().map(|p| p.0).collect::<Vec<_>>(), pairs.iter().map(|p| p.1).collect()] {
                ends.sort_unstable();
                assert!(ends.windows(2).all(|w| w[0] < w[1]), "round {round}: something has two others");
            }
        }
    }
}
