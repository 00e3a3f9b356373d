//! Groups of many views, grown greedily: for rigs with so many cameras that listing all subsets is out of the question.
//!
//! From the pair that most cameras support, the dot that raises the residual least is added while the group stays within
//! its gate. With more than [`FULL_VIEWS`] views such a group is beyond doubt as a whole; which of its dots truly belong
//! to it is left to the packing, which sees the group with its alternatives and with a few dots left out.

use super::enumerate::FULL_VIEWS;
use super::frame::PreparedFrame;
use super::pairs::PairGraph;
use super::scene::Scene;
use crate::sight::{Minimum, Normal};
use nalgebra::Vector3;

/// Views of a grown group that may be left out when its subsets are listed.
pub const OMISSIONS: usize = 2;

/// A grown group.
pub struct Solid {
    /// Its dots, in ascending order.
    pub dots: Vec<u32>,
    /// All dots that fit its point, its own included, in ascending order.
    pub fitting: Vec<u32>,
    /// Its point (m, world).
    pub point: Vector3<f64>,
}

/// Grows disjoint groups of more than [`FULL_VIEWS`] views.
pub fn grow(scene: &Scene, frame: &PreparedFrame, graph: &PairGraph) -> Vec<Solid> {
    let mut taken = vec![false; frame.len()];
    let mut found = Vec::new();
    for a in 0..frame.len() as u32 {
        if taken[a as usize] {
            continue;
        }
        if let Some((b, start)) = best_partner(frame, graph, &taken, a)
            && let Some(solid) = grow_from(scene, frame, graph, &taken, [a, b], start)
        {
            solid.dots.iter().for_each(|&z| taken[z as usize] = true);
            found.push(solid);
        }
    }
    found
}

/// The match of a dot that most other cameras support; `None` if too few support any.
fn best_partner(frame: &PreparedFrame, graph: &PairGraph, taken: &[bool], a: u32) -> Option<(u32, Vector3<f64>)> {
    let mut best: Option<(usize, u32, Vector3<f64>)> = None;
    for edge in graph.later[a as usize].iter().filter(|e| !taken[e.to as usize]) {
        let common = graph.common(a, edge.to).filter(|&z| !taken[z as usize]);
        let cameras = common.fold(0u128, |seen, z| seen | 1 << frame.sights[z as usize].camera);
        let support = cameras.count_ones() as usize;
        if support + 2 > FULL_VIEWS && best.is_none_or(|(most, ..)| support > most) {
            best = Some((support, edge.to, edge.point));
        }
    }
    best.map(|(_, b, point)| (b, point))
}

fn grow_from(
    scene: &Scene,
    frame: &PreparedFrame,
    graph: &PairGraph,
    taken: &[bool],
    pair: [u32; 2],
    start: Vector3<f64>,
) -> Option<Solid> {
    let camera = |z: u32| frame.sights[z as usize].camera;
    let mut rest: Vec<u32> = graph.common(pair[0], pair[1]).filter(|&z| !taken[z as usize]).collect();
    let mut dots = pair.to_vec();
    let mut point = start;
    let ridge = 12.0 / scene.model.region.diagonal().powi(2);
    while !rest.is_empty() {
        let at = |z: u32| Normal::of(&frame.sights[z as usize].linearise(&point), 1.0);
        let own = dots.iter().fold(Normal::default().with_ridge(ridge), |sum, &z| sum.plus(&at(z)));
        let with = |&z: &u32| own.plus(&at(z)).minimum().map(|m: Minimum| (m.rss, z, m.step));
        let best = rest.iter().filter_map(with).min_by(|x, y| x.0.total_cmp(&y.0))?;
        if best.0 > scene.group_gates[dots.len() + 1] {
            break;
        }
        dots.push(best.1);
        point += best.2;
        rest.retain(|&z| camera(z) != camera(best.1));
    }
    if dots.len() <= FULL_VIEWS {
        return None;
    }
    dots.sort_unstable();
    let fits = |z: &u32| frame.sights[*z as usize].linearise(&point).error.norm_squared() <= scene.group_gates[2];
    let mut fitting: Vec<u32> = graph.common(pair[0], pair[1]).filter(fits).chain(dots.iter().copied()).collect();
    fitting.sort_unstable();
    fitting.dedup();
    Some(Solid { dots, fitting, point })
}
