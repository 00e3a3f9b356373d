//! The seed paper's method: maximal cliques of the k-partite match graph and relaxation labelling.
//!
//! Lee, Chu, Kim & Jung 2000, §2, equations 1–6. Objects are the dots, a dot's labels are the maximal cliques it is in.
//! As printed the equations contradict themselves in places; what is repaired, and why:
//! - (1), (6): the sums run over the labels a dot has (R_i of them), not over a common K or N.
//! - (2), (3): the support of label w_k for dot i comes from the *other* members j of w_k that carry the same label.
//! - (4): d is measured in one image in the paper, which gives another value when the images are swapped; here it is
//!   the symmetric two-view residual, √(2 RSS) in standard deviations, and the threshold is stated in them too.
//! - A dot whose labels all have no support keeps its weights (the paper divides by zero).
//! - A limit need not be consistent between dots. A clique is accepted if at least two of its members chose it; its
//!   group is the members that did ("all members" loses 8 % of the markers).

use super::cliques::maximal_cliques;
use super::frame::PreparedFrame;
use super::pairs::PairGraph;
use super::scene::Scene;
use super::{Correspondence, group_from_dots};
use nalgebra::Vector3;

/// Options of the relaxation labelling.
#[derive(Clone, Copy, Debug)]
pub struct RelaxationOptions {
    /// Largest epipolar residual of a match, in standard deviations of a dot. Smaller cuts true matches, larger makes
    /// false cliques.
    pub threshold_sigmas: f64,
    /// Iterations at most.
    pub iteration_limit: usize,
    /// Largest change of a weight at which the iteration has converged.
    pub converged: f64,
    /// Cliques at most; a frame with more is given up (the number grows exponentially with clutter).
    pub clique_limit: usize,
}

impl Default for RelaxationOptions {
    fn default() -> Self {
        Self { threshold_sigmas: 5.0, iteration_limit: 100, converged: 1e-4, clique_limit: 200_000 }
    }
}

/// A dot's label: a clique, and its weight P(θ_i = w_k).
struct Label {
    clique: usize,
    weight: f64,
}

/// The correspondence of one frame by relaxation labelling. `certified` is always false: it optimises nothing.
pub fn relaxation(scene: &Scene, frame: &PreparedFrame, options: &RelaxationOptions) -> Correspondence {
    let mut graph = PairGraph::new(scene, frame);
    let strength = |rss: f64| 1.0 - (2.0 * rss).sqrt() / options.threshold_sigmas; // eq 4
    for edges in &mut graph.later {
        edges.retain(|e| strength(e.rss) > 0.0);
    }
    let Some(cliques) = maximal_cliques(&graph, options.clique_limit) else {
        return Correspondence { candidates: options.clique_limit, ..Correspondence::default() };
    };
    let strengths: Vec<Vec<f64>> = cliques.iter().map(|c| clique_strengths(&graph, c, &strength)).collect();
    let mut labels = initial_weights(&cliques, frame.len());
    for _ in 0..options.iteration_limit {
        if update(&cliques, &strengths, &mut labels) < options.converged {
            break;
        }
    }
    let groups = accepted(&cliques, &labels)
        .into_iter()
        .filter_map(|dots| group_from_dots(scene, frame, &dots, starting_point(&graph, &dots)?, None))
        .collect();
    Correspondence { groups, candidates: cliques.len(), ..Correspondence::default() }
}

/// c_ij for all pairs of a clique's members, row by row.
fn clique_strengths(graph: &PairGraph, clique: &[u32], strength: &impl Fn(f64) -> f64) -> Vec<f64> {
    let n = clique.len();
    let mut matrix = vec![0.0; n * n];
    for i in 0..n {
        for j in i + 1..n {
            let edges = &graph.later[clique[i] as usize];
            if let Ok(at) = edges.binary_search_by_key(&clique[j], |e| e.to) {
                matrix[i * n + j] = strength(edges[at].rss);
                matrix[j * n + i] = matrix[i * n + j];
            }
        }
    }
    matrix
}

/// Equation 1: every label of a dot starts with the weight 1/R_i.
fn initial_weights(cliques: &[Vec<u32>], n_dots: usize) -> Vec<Vec<Label>> {
    let mut labels: Vec<Vec<Label>> = (0..n_dots).map(|_| Vec::new()).collect();
    for (clique, members) in cliques.iter().enumerate() {
        members.iter().for_each(|&dot| labels[dot as usize].push(Label { clique, weight: 0.0 }));
    }
    for own in &mut labels {
        let share = 1.0 / own.len() as f64;
        own.iter_mut().for_each(|label| label.weight = share);
    }
    labels
}

/// Equations 2, 3, 5 and 6 for all dots at once; returns the largest change of a weight.
fn update(cliques: &[Vec<u32>], strengths: &[Vec<f64>], labels: &mut [Vec<Label>]) -> f64 {
    let weight_of = |labels: &[Vec<Label>], dot: u32, clique: usize| {
        let own = &labels[dot as usize];
        own.binary_search_by_key(&clique, |l| l.clique).map_or(0.0, |at| own[at].weight)
    };
    let mut supports: Vec<Vec<f64>> = labels.iter().map(|own| vec![0.0; own.len()]).collect();
    for (clique, members) in cliques.iter().enumerate() {
        let n = members.len();
        let weights: Vec<f64> = members.iter().map(|&j| weight_of(labels, j, clique)).collect(); // eq 2
        for (i, &dot) in members.iter().enumerate() {
            let support: f64 = (0..n).map(|j| strengths[clique][i * n + j] * weights[j]).sum(); // eq 3
            if let Ok(at) = labels[dot as usize].binary_search_by_key(&clique, |l| l.clique) {
                supports[dot as usize][at] = support;
            }
        }
    }
    let mut change: f64 = 0.0;
    for (own, support) in labels.iter_mut().zip(&supports) {
        let total: f64 = own.iter().zip(support).map(|(l, q)| l.weight * q).sum(); // eq 6
        if total <= 0.0 {
            continue;
        }
        for (label, q) in own.iter_mut().zip(support) {
            let weight = label.weight * q / total; // eq 5
            change = change.max((weight - label.weight).abs());
            label.weight = weight;
        }
    }
    change
}

/// The members of each clique that chose it, where at least two did.
fn accepted(cliques: &[Vec<u32>], labels: &[Vec<Label>]) -> Vec<Vec<usize>> {
    let mut chosen = vec![Vec::new(); cliques.len()];
    for (dot, own) in labels.iter().enumerate() {
        let best = own.iter().max_by(|a, b| a.weight.total_cmp(&b.weight).then(b.clique.cmp(&a.clique)));
        if let Some(label) = best {
            chosen[label.clique].push(dot);
        }
    }
    chosen.into_iter().filter(|dots| dots.len() >= 2).collect()
}

fn starting_point(graph: &PairGraph, dots: &[usize]) -> Option<Vector3<f64>> {
    let edges = &graph.later[dots[0]];
    edges.binary_search_by_key(&(dots[1] as u32), |e| e.to).ok().map(|at| edges[at].point)
}
