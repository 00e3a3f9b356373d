//! Groups of many views, grown greedily: for rigs with so many cameras that listing all subsets is out of the question.
//!
//! From the pair that most cameras support, the dot that raises the residual least is added while the group stays within
//! its gate. With more than [`full_views`] views such a group is beyond doubt as a whole; which of its dots truly belong
//! to it is left to the packing, which sees the group with its alternatives and without those of its dots that others may claim.

use super::enumerate::full_views;
use super::frame::PreparedFrame;
use super::pairs::PairGraph;
use super::scene::Scene;
use crate::sight::{Minimum, Normal, Sight};
use crate::triangulate::refine;
use nalgebra::Vector3;

/// Contested views of a grown group that may be left out when its subsets are listed.
pub const OMISSIONS: usize = 3;
/// A view whose squared residual is above this may be somebody else's.
const DOUBTFUL: f64 = 6.0;

/// A grown group.
pub struct Solid {
    /// Its dots, in ascending order.
    pub dots: Vec<u32>,
    /// All dots that fit its point, its own included, in ascending order.
    pub fitting: Vec<u32>,
    /// Whether each fitting dot is certain: the group's own, fitting well, and fitting no other grown group.
    pub certain: Vec<bool>,
    /// Its point (m, world).
    pub point: Vector3<f64>,
}

/// Grows disjoint groups of more than [`full_views`] views.
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
    mark_certain(frame, &mut found);
    found
}

fn mark_certain(frame: &PreparedFrame, solids: &mut [Solid]) {
    let mut fits = vec![0; frame.len()];
    solids.iter().flat_map(|s| &s.fitting).for_each(|&z| fits[z as usize] += 1);
    for solid in solids {
        let good = |z: u32| frame.sights[z as usize].linearise(&solid.point).error.norm_squared() <= DOUBTFUL;
        let certain = |&z: &u32| solid.dots.binary_search(&z).is_ok() && fits[z as usize] == 1 && good(z);
        solid.certain = solid.fitting.iter().map(certain).collect();
    }
}

/// The match of a dot that most other cameras support; `None` if too few support any.
fn best_partner(frame: &PreparedFrame, graph: &PairGraph, taken: &[bool], a: u32) -> Option<(u32, Vector3<f64>)> {
    let mut best: Option<(usize, u32, Vector3<f64>)> = None;
    for edge in graph.later[a as usize].iter().filter(|e| !taken[e.to as usize]) {
        let common = graph.common(a, edge.to).filter(|&z| !taken[z as usize]);
        let cameras = common.fold(0u128, |seen, z| seen | 1 << frame.sights[z as usize].camera);
        let support = cameras.count_ones() as usize;
        if support + 2 > full_views(frame.len()) && best.is_none_or(|(most, ..)| support > most) {
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
    if dots.len() <= full_views(frame.len()) {
        return None;
    }
    gather(scene, frame, taken, dots, point)
}

/// Takes the best fitting dot of every camera at the point that a grown group gives: the pair it grew from may have
/// missed some, or let foreign ones in while the point was uncertain.
fn gather(
    scene: &Scene,
    frame: &PreparedFrame,
    taken: &[bool],
    mut dots: Vec<u32>,
    mut point: Vector3<f64>,
) -> Option<Solid> {
    let gate = scene.group_gates[2];
    let error2 = |z: u32, at: &Vector3<f64>| frame.sights[z as usize].linearise(at).error.norm_squared();
    for _ in 0..2 {
        let sights: Vec<&Sight> = dots.iter().map(|&z| &frame.sights[z as usize]).collect();
        point = refine(&sights, point, |_| 1.0)?.0;
        dots = (0..scene.rig.cameras.len())
            .filter_map(|camera| {
                let own = frame.camera_start[camera] as u32..frame.camera_start[camera + 1] as u32;
                let free = own.filter(|&z| !taken[z as usize]).map(|z| (error2(z, &point), z));
                free.min_by(|x, y| x.0.total_cmp(&y.0)).filter(|(e, _)| *e <= gate).map(|(_, z)| z)
            })
            .collect();
    }
    if dots.len() <= full_views(frame.len()) {
        return None;
    }
    let fitting = (0..frame.len() as u32).filter(|&z| error2(z, &point) <= gate).collect();
    Some(Solid { dots, certain: Vec::new(), fitting, point })
}
