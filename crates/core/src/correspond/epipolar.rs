//! The naive baseline: every epipolar match becomes a point (Lee et al. 2000, figure 11c).

use super::frame::PreparedFrame;
use super::pairs::PairGraph;
use super::scene::Scene;
use super::{Correspondence, group_from_dots};

/// All matches of the pair graph as points; their confidence weighs each match alone.
pub fn epipolar(scene: &Scene, frame: &PreparedFrame) -> Correspondence {
    let graph = PairGraph::new(scene, frame);
    let mut groups = Vec::new();
    for (a, edges) in graph.later.iter().enumerate() {
        for edge in edges {
            groups.extend(group_from_dots(scene, frame, &[a, edge.to as usize], edge.point, None));
        }
    }
    Correspondence { candidates: groups.len(), groups, ..Correspondence::default() }
}
