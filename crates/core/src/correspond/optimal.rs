//! The default method: the most likely set of disjoint groups, with a proof that no other set is more likely.

use super::confidence::confidences;
use super::enumerate::{Candidates, EnumerateOptions, enumerate};
use super::frame::PreparedFrame;
use super::packing::{Packing, pack};
use super::pairs::PairGraph;
use super::scene::Scene;
use super::{Correspondence, group_from_dots};

/// Limits of the exact method; the defaults suit any rig.
#[derive(Clone, Copy, Debug)]
pub struct OptimalOptions {
    /// Limits of the enumeration of candidate groups.
    pub enumerate: EnumerateOptions,
    /// Branch-and-bound nodes before the best choice so far is kept and the remaining gap reported. Too small loses
    /// certificates in hopelessly ambiguous frames, too large spends seconds on one frame.
    pub node_limit: usize,
}

impl Default for OptimalOptions {
    fn default() -> Self {
        Self { enumerate: EnumerateOptions::default(), node_limit: 20_000 }
    }
}

/// Candidate groups of a frame and the best packing of them.
pub fn choose(scene: &Scene, frame: &PreparedFrame, options: &OptimalOptions) -> (Candidates, Packing) {
    let graph = PairGraph::new(scene, frame);
    let candidates = enumerate(scene, frame, &graph, &options.enumerate);
    let packing = pack(&candidates, frame.len(), options.node_limit);
    (candidates, packing)
}

/// The most likely correspondence of one frame.
pub fn optimal(scene: &Scene, frame: &PreparedFrame, options: &OptimalOptions) -> Correspondence {
    let (candidates, packing) = choose(scene, frame, options);
    let confidence = confidences(&candidates, &packing, frame.len());
    let groups = packing
        .chosen
        .iter()
        .zip(confidence)
        .filter_map(|(&group, confidence)| {
            let dots: Vec<usize> = candidates.dots(group).iter().map(|&z| z as usize).collect();
            group_from_dots(scene, frame, &dots, candidates.points[group], Some(confidence))
        })
        .collect();
    Correspondence {
        groups,
        certified: candidates.complete && packing.is_optimal(),
        objective: packing.value,
        bound: if candidates.complete { packing.bound } else { f64::INFINITY },
        candidates: candidates.len(),
        nodes: packing.nodes,
    }
}
