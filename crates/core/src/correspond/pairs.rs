//! The match graph: pairs of dots of two cameras whose rays meet within their noise, inside the region.
//!
//! Candidates come from an epipolar index: the plane through a ray and the baseline of two cameras cuts both images in
//! corresponding epipolar lines, so a pair can only match if the two planes have the same angle about the baseline.
//! Sorting by that angle replaces the all-pairs test by a sweep. Cost O(n log n + candidates) per pair of cameras.
//! Close to an epipole the angle means nothing; such dots are compared with all others.

use super::frame::PreparedFrame;
use super::scene::Scene;
use crate::sight::{Normal, Sight};
use crate::triangulate::two_rays;
use nalgebra::Vector3;
use std::f64::consts::{PI, TAU};

/// A plane angle less certain than this (rad, one standard deviation) is not used for indexing.
const VAGUE_ANGLE: f64 = 0.05;

/// A match of a dot with a dot of a later camera.
#[derive(Clone, Copy, Debug)]
pub struct Edge {
    /// The later dot.
    pub to: u32,
    /// Squared whitened residual of the pair (χ² with one degree of freedom).
    pub rss: f64,
    /// Where the rays meet (m, world).
    pub point: Vector3<f64>,
}

/// All matches, by their earlier dot, in ascending order of the later one.
#[derive(Clone, Debug, Default)]
pub struct PairGraph {
    /// Matches of each dot with dots of later cameras.
    pub later: Vec<Vec<Edge>>,
    /// All dots that each dot matches, in ascending order.
    pub neighbours: Vec<Vec<u32>>,
}

impl PairGraph {
    /// Finds all pairs whose residual is within the scene's gate.
    pub fn new(scene: &Scene, frame: &PreparedFrame) -> Self {
        let mut graph = Self { later: vec![Vec::new(); frame.len()], neighbours: vec![Vec::new(); frame.len()] };
        let gate = scene.pair_gate;
        let reach = gate.sqrt();
        let cameras = scene.rig.cameras.len();
        let mut index = PlaneIndex::default();
        for first in 0..cameras {
            for second in first + 1..cameras {
                let ranges = [first, second].map(|c| frame.camera_start[c]..frame.camera_start[c + 1]);
                if ranges.iter().any(std::ops::Range::is_empty) {
                    continue;
                }
                let origins = [first, second].map(|c| scene.rig.cameras[c].position_m);
                index.fill(frame, origins, &ranges);
                index.matches(reach, |a, b| {
                    if frame.dots[a].may_be(&frame.dots[b])
                        && let Some((rss, point)) = meet(frame, a, b, scene.model.region.diagonal())
                        && rss <= gate
                    {
                        graph.later[a].push(Edge { to: b as u32, rss, point });
                    }
                });
            }
        }
        for edges in &mut graph.later {
            edges.sort_unstable_by_key(|e| e.to);
        }
        // Earlier dots come first because they are visited in order.
        for (a, edges) in graph.later.iter().enumerate() {
            edges.iter().for_each(|e| graph.neighbours[e.to as usize].push(a as u32));
        }
        for (a, edges) in graph.later.iter().enumerate() {
            graph.neighbours[a].extend(edges.iter().map(|e| e.to));
        }
        graph
    }

    /// Whether two dots match.
    pub fn linked(&self, a: u32, b: u32) -> bool {
        self.neighbours[a as usize].binary_search(&b).is_ok()
    }

    /// Dots that match both of two dots, in ascending order.
    pub fn common(&self, a: u32, b: u32) -> impl Iterator<Item = u32> + '_ {
        let (of_a, of_b) = (&self.neighbours[a as usize], &self.neighbours[b as usize]);
        let mut at = 0;
        of_a.iter().copied().filter(move |&z| {
            while at < of_b.len() && of_b[at] < z {
                at += 1;
            }
            of_b.get(at) == Some(&z)
        })
    }

    /// Number of pairs.
    pub fn len(&self) -> usize {
        self.later.iter().map(Vec::len).sum()
    }

    /// Whether there is no pair.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Squared residual and meeting point of two dots; `None` if they meet behind a camera or outside the region by more
/// than their depth's uncertainty.
fn meet(frame: &PreparedFrame, a: usize, b: usize, region_diagonal: f64) -> Option<(f64, Vector3<f64>)> {
    let (first, second) = (&frame.sights[a], &frame.sights[b]);
    let meeting = two_rays([&first.origin, &second.origin], [&first.direction, &second.direction]).ok()?;
    let [s, t] = meeting.along_m;
    let sine = first.direction.cross(&second.direction).norm();
    let spread = 5.0 * (first.angle_sigma * s.abs() + second.angle_sigma * t.abs()) / sine;
    let inside = |along: f64, chord: [f64; 2]| along >= chord[0] - spread && along <= chord[1] + spread;
    if !inside(s, frame.chords[a]) || !inside(t, frame.chords[b]) {
        return None;
    }
    let clamped = s.clamp(frame.chords[a][0], frame.chords[a][1]);
    let start = if (s - clamped).abs() < 1e-12 { meeting.midpoint } else { first.origin + first.direction * clamped };
    if first.depth(&start) <= 1e-6 || second.depth(&start) <= 1e-6 {
        return None;
    }
    let minimum = pair_normal(first, second, &start, region_diagonal).minimum()?;
    Some((minimum.rss, start + minimum.step))
}

/// Normal equations of two sights, with the region's size as a weak prior so that near-parallel rays stay solvable.
pub fn pair_normal(first: &Sight, second: &Sight, at: &Vector3<f64>, region_diagonal: f64) -> Normal {
    Normal::of(&first.linearise(at), 1.0)
        .plus(&Normal::of(&second.linearise(at), 1.0))
        .with_ridge(12.0 / (region_diagonal * region_diagonal))
}

/// Plane angles of two cameras' dots about their baseline.
#[derive(Default)]
struct PlaneIndex {
    first: Vec<Plane>,
    second: Vec<Plane>,
    vague: Vec<Plane>,
    widest: f64,
}

#[derive(Clone, Copy)]
struct Plane {
    angle: f64,
    sigma: f64,
    dot: usize,
}

impl PlaneIndex {
    fn fill(&mut self, frame: &PreparedFrame, origins: [Vector3<f64>; 2], ranges: &[std::ops::Range<usize>; 2]) {
        let baseline = origins[1] - origins[0];
        let along = baseline.try_normalize(1e-9).unwrap_or_else(Vector3::z);
        let other = if along.z.abs() < 0.9 { Vector3::z() } else { Vector3::x() };
        let e1 = along.cross(&other).normalize();
        let e2 = along.cross(&e1);
        let plane = |dot: usize| {
            let sight = &frame.sights[dot];
            let (x, y) = (sight.direction.dot(&e1), sight.direction.dot(&e2));
            // The ray's offset from the baseline shrinks towards the epipole, and the angle becomes vague.
            Plane { angle: y.atan2(x), sigma: sight.angle_sigma / (x * x + y * y).sqrt().max(1e-9), dot }
        };
        self.first.clear();
        self.second.clear();
        self.vague.clear();
        self.first.extend(ranges[0].clone().map(plane));
        for p in ranges[1].clone().map(plane) {
            if p.sigma > VAGUE_ANGLE || baseline.norm() < 1e-6 {
                self.vague.push(p);
            } else {
                self.second.push(p);
            }
        }
        self.second.sort_unstable_by(|a, b| a.angle.total_cmp(&b.angle).then(a.dot.cmp(&b.dot)));
        self.widest = self.second.iter().map(|p| p.sigma).fold(0.0, f64::max);
    }

    /// Calls `visit` with every pair whose planes agree within `reach` standard deviations.
    fn matches(&self, reach: f64, mut visit: impl FnMut(usize, usize)) {
        for a in &self.first {
            for b in &self.vague {
                visit(a.dot, b.dot);
            }
            let window = 1.1 * reach * (a.sigma * a.sigma + self.widest * self.widest).sqrt();
            if a.sigma > VAGUE_ANGLE || window > 1.0 {
                for b in &self.second {
                    visit(a.dot, b.dot);
                }
                continue;
            }
            for (low, high) in circular_windows(a.angle, window) {
                let start = self.second.partition_point(|b| b.angle < low);
                for b in self.second[start..].iter().take_while(|b| b.angle <= high) {
                    let gap = (a.angle - b.angle).abs();
                    if gap.min(TAU - gap) <= 1.1 * reach * (a.sigma * a.sigma + b.sigma * b.sigma).sqrt() {
                        visit(a.dot, b.dot);
                    }
                }
            }
        }
    }
}

/// The interval `angle ± window` on the circle (−π, π], as one or two plain intervals.
fn circular_windows(angle: f64, window: f64) -> impl Iterator<Item = (f64, f64)> {
    let wrapped = if angle - window < -PI {
        Some((angle - window + TAU, PI))
    } else if angle + window > PI {
        Some((-PI, angle + window - TAU))
    } else {
        None
    };
    std::iter::once((angle - window, angle + window)).chain(wrapped)
}
