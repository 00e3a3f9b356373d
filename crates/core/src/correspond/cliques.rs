//! Maximal cliques of the match graph (Bron & Kerbosch 1973, with the pivot of Tomita, Tanaka & Takahashi 2006).

use super::pairs::PairGraph;

/// All maximal cliques of at least two dots, each in ascending order; `None` if there are more than `limit`.
pub fn maximal_cliques(graph: &PairGraph, limit: usize) -> Option<Vec<Vec<u32>>> {
    let mut neighbours = vec![Vec::new(); graph.later.len()];
    for (a, edges) in graph.later.iter().enumerate() {
        for edge in edges {
            neighbours[a].push(edge.to);
            neighbours[edge.to as usize].push(a as u32);
        }
    }
    neighbours.iter_mut().for_each(|n| n.sort_unstable());
    let mut search = BronKerbosch { neighbours, found: Vec::new(), limit, clique: Vec::new() };
    // Each dot with its later neighbours as candidates and its earlier ones as excluded: small subproblems.
    for a in 0..search.neighbours.len() as u32 {
        let split = search.neighbours[a as usize].partition_point(|&b| b < a);
        let (earlier, later) = search.neighbours[a as usize].split_at(split);
        let (earlier, later) = (earlier.to_vec(), later.to_vec());
        search.clique.push(a);
        search.expand(later, earlier);
        search.clique.pop();
        if search.found.len() > limit {
            return None;
        }
    }
    Some(search.found)
}

struct BronKerbosch {
    neighbours: Vec<Vec<u32>>,
    found: Vec<Vec<u32>>,
    limit: usize,
    clique: Vec<u32>,
}

impl BronKerbosch {
    fn linked(&self, a: u32, b: u32) -> bool {
        self.neighbours[a as usize].binary_search(&b).is_ok()
    }

    fn expand(&mut self, mut candidates: Vec<u32>, mut excluded: Vec<u32>) {
        if candidates.is_empty() {
            if excluded.is_empty() && self.clique.len() >= 2 {
                let mut clique = self.clique.clone();
                clique.sort_unstable();
                self.found.push(clique);
            }
            return;
        }
        if self.found.len() > self.limit {
            return;
        }
        let covers = |p: u32| candidates.iter().filter(|&&z| self.linked(p, z)).count();
        let pivot = candidates.iter().chain(&excluded).copied().max_by_key(|&p| (covers(p), std::cmp::Reverse(p)));
        let Some(pivot) = pivot else { return };
        let branches: Vec<u32> = candidates.iter().copied().filter(|&z| !self.linked(pivot, z)).collect();
        for z in branches {
            let within = |set: &[u32]| set.iter().copied().filter(|&other| self.linked(z, other)).collect::<Vec<_>>();
            let (inner, outer) = (within(&candidates), within(&excluded));
            self.clique.push(z);
            self.expand(inner, outer);
            self.clique.pop();
            candidates.retain(|&c| c != z);
            excluded.push(z);
        }
    }
}
