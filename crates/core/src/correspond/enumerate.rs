//! All groups of dots that could be one marker, each with its log-likelihood ratio.
//!
//! A group is a clique of the match graph, at most one dot per camera, whose joint residual is within the gate of its
//! size. Its weight is the log of how much better "these dots are one marker" explains them than "none of them is part
//! of a marker" does, the position integrated out by Laplace's method:
//!
//! `w(T) = ln λ p(X) + ln P(these views) + Σ_z g_z − RSS/2 + (3/2) ln 2π − ½ ln det Σ JᵀJ`
//!
//! with `g_z = −ln 2πσ_z² − ln s_z` (see `frame.rs`; `ln P` in `scene.rs`). Every group grows from its two earliest dots
//! by adding dots of later cameras, so each is met once; the residuals are linearised once at the pair's point (and
//! again at the triple's when it moved far), after which a step of the search is a sum and a 3×3 solution.
//!
//! A marker that n cameras see has 2ⁿ subsets. Groups of more than [`full_views`] views are grown first (`solid.rs`),
//! and of their subsets only the largest are listed; a frame with such groups is not certified.

use super::frame::PreparedFrame;
use super::pairs::PairGraph;
use super::scene::{Scene, Tail};
use super::solid::{self, Solid};
use crate::sight::{Linear, Minimum, Normal};
use nalgebra::Vector3;

/// Relinearise when the second-order error of the residual could exceed this (standard deviations).
const LINEAR_LIMIT: f64 = 0.1;

/// Up to this many views that fit together, all their subsets are listed: 8, and more where the frame has few dots.
pub fn full_views(dots: usize) -> usize {
    8 + (1200 / dots.max(1)).checked_ilog2().unwrap_or(0).min(3) as usize
}

/// Search steps of each pair after the limit of the frame.
const STEPS_BEYOND_LIMIT: usize = 100;
/// Search steps at most around one grown group.
const SOLID_STEPS: usize = 20_000;

/// Limits of the enumeration.
#[derive(Clone, Copy, Debug)]
pub struct EnumerateOptions {
    /// Search steps of a frame. Beyond, each pair that is left gets a few steps more, and the frame is not certified. Too
    /// small loses certificates in crowded frames, too large spends seconds on one frame.
    pub step_limit: usize,
}

impl Default for EnumerateOptions {
    fn default() -> Self {
        Self { step_limit: 1_000_000 }
    }
}

/// Candidate groups with positive weight, stored flat.
#[derive(Clone, Debug, Default)]
pub struct Candidates {
    /// Log-likelihood ratio of each group (nats).
    pub weights: Vec<f64>,
    /// Position of each group (m, world), to first order.
    pub points: Vec<Vector3<f64>>,
    /// First member of each group in `members`, and one past the last.
    pub starts: Vec<u32>,
    /// Dots of all groups.
    pub members: Vec<u32>,
    /// Search steps taken.
    pub steps: usize,
    /// Whether all groups are listed.
    pub complete: bool,
    /// Whether a limit cut something off.
    pub truncated: bool,
}

impl Candidates {
    fn new() -> Self {
        Self { starts: vec![0], complete: true, ..Self::default() }
    }

    /// Number of groups.
    pub fn len(&self) -> usize {
        self.weights.len()
    }

    /// Whether there is no group.
    pub fn is_empty(&self) -> bool {
        self.weights.is_empty()
    }

    /// The dots of one group.
    pub fn dots(&self, group: usize) -> &[u32] {
        &self.members[self.starts[group] as usize..self.starts[group + 1] as usize]
    }

    fn push(&mut self, weight: f64, point: Vector3<f64>, dots: impl Iterator<Item = u32>) {
        self.members.extend(dots);
        self.starts.push(self.members.len() as u32);
        self.weights.push(weight);
        self.points.push(point);
    }
}

/// Enumerates all candidate groups of a frame.
pub fn enumerate(scene: &Scene, frame: &PreparedFrame, graph: &PairGraph, options: &EnumerateOptions) -> Candidates {
    let model = &scene.model;
    let mut search = Search {
        scene,
        frame,
        graph,
        options,
        found: Candidates::new(),
        local: Local::default(),
        members: Vec::with_capacity(Local::CAPACITY),
        ridge: 12.0 / model.region.diagonal().powi(2),
        constant: constant(scene),
        step_limit: 0,
        solid_step_limit: 0,
    };
    let many = scene.rig.cameras.len() > full_views(frame.len());
    let solids = if many { solid::grow(scene, frame, graph) } else { Vec::new() };
    let mut in_solid = vec![false; frame.len()];
    for group in &solids {
        group.dots.iter().for_each(|&z| in_solid[z as usize] = true);
        search.around_solid(group);
    }
    for a in 0..frame.len() as u32 {
        for edge in &graph.later[a as usize] {
            if !solids.is_empty() && search.belongs_to_solids(&in_solid, a, edge.to) {
                continue;
            }
            search.grow_pair(a, edge.to, edge.point);
        }
    }
    search.found
}

/// The part of a group's weight that is the same for all groups.
pub fn constant(scene: &Scene) -> f64 {
    scene.ln_expected + 1.5 * std::f64::consts::TAU.ln()
}

/// Dots around one pair, linearised at its point.
#[derive(Default)]
struct Local {
    at: Vector3<f64>,
    dots: Vec<u32>,
    linear: Vec<Linear>,
    normal: Vec<Normal>,
    /// Bit j of `linked[i]`: local dots i < j can be in one group.
    linked: Vec<u128>,
}

impl Local {
    const CAPACITY: usize = 128;

    fn clear(&mut self, at: Vector3<f64>) {
        self.at = at;
        self.dots.clear();
        self.linear.clear();
        self.normal.clear();
        self.linked.clear();
    }

    fn push(&mut self, frame: &PreparedFrame, dot: u32) {
        let linear = frame.sights[dot as usize].linearise(&self.at);
        self.dots.push(dot);
        self.normal.push(Normal::of(&linear, 1.0));
        self.linear.push(linear);
    }

    fn pop(&mut self) {
        self.dots.pop();
        self.linear.pop();
        self.normal.pop();
    }

    fn relinearise(&mut self, frame: &PreparedFrame, at: Vector3<f64>) {
        self.at = at;
        for i in 0..self.dots.len() {
            self.linear[i] = frame.sights[self.dots[i] as usize].linearise(&at);
            self.normal[i] = Normal::of(&self.linear[i], 1.0);
        }
    }

    /// Connects local dots of different cameras that match each other.
    fn link(&mut self, graph: &PairGraph) {
        for i in 0..self.dots.len() {
            let mut mask = 0u128;
            for j in i + 1..self.dots.len() {
                mask |= u128::from(graph.linked(self.dots[i], self.dots[j])) << j;
            }
            self.linked.push(mask);
        }
    }
}

struct Search<'a> {
    scene: &'a Scene,
    frame: &'a PreparedFrame,
    graph: &'a PairGraph,
    options: &'a EnumerateOptions,
    found: Candidates,
    local: Local,
    /// The growing group: indices into the local dots.
    members: Vec<u8>,
    ridge: f64,
    constant: f64,
    step_limit: usize,
    solid_step_limit: usize,
}

/// Running sums of a growing group.
#[derive(Clone, Copy)]
struct Sums {
    normal: Normal,
    gain: f64,
    cameras: u128,
}

impl Search<'_> {
    fn grow_pair(&mut self, a: u32, b: u32, at: Vector3<f64>) {
        self.step_limit = self.options.step_limit.max(self.found.steps + STEPS_BEYOND_LIMIT);
        self.local.clear(at);
        self.local.push(self.frame, a);
        self.local.push(self.frame, b);
        let start = Sums { normal: Normal::default().with_ridge(self.ridge), gain: 0.0, cameras: 0 };
        let pair = self.plus(&self.plus(&start, 0), 1);
        let Some(minimum) = pair.normal.minimum() else { return };
        self.members.clear();
        self.members.extend([0, 1]);
        if minimum.rss <= self.scene.group_gates[2] {
            self.emit(&pair, minimum.rss, &minimum);
        }
        self.gather(a, b, &pair.normal);
        if self.local.dots.len() > 2 {
            self.local.link(self.graph);
            let candidates = self.local.linked[0] & self.local.linked[1];
            self.grow(&pair, candidates);
        }
    }

    /// Whether a pair needs no look of its own: both dots are in grown groups, or so many views fit it that it belongs
    /// to one.
    fn belongs_to_solids(&self, in_solid: &[bool], a: u32, b: u32) -> bool {
        if in_solid[a as usize] && in_solid[b as usize] {
            return true;
        }
        if !in_solid[a as usize] && !in_solid[b as usize] {
            return false;
        }
        let views = self.graph.common(a, b).fold(0u128, |seen, z| seen | 1 << self.frame.sights[z as usize].camera);
        views.count_ones() as usize + 2 > full_views(self.frame.len())
    }

    /// Lists a grown group with its alternatives: any fitting dot in each camera; dots that are not certain may be left
    /// out, of the group's own at most [`solid::OMISSIONS`].
    fn around_solid(&mut self, group: &Solid) {
        self.found.complete = false;
        self.solid_step_limit = self.found.steps + SOLID_STEPS;
        self.local.clear(group.point);
        for &dot in group.fitting.iter().take(Local::CAPACITY) {
            self.local.push(self.frame, dot);
        }
        self.members.clear();
        let start = Sums { normal: Normal::default().with_ridge(self.ridge), gain: 0.0, cameras: 0 };
        self.choose_or_omit(group, &start, 0, solid::OMISSIONS);
    }

    /// Decides about the camera of local dot `next`: one of its dots, or none.
    fn choose_or_omit(&mut self, group: &Solid, sums: &Sums, next: usize, spare: usize) {
        let camera_of = |s: &Self, i: usize| s.frame.sights[s.local.dots[i] as usize].camera;
        if next == self.local.dots.len() {
            if let Some(minimum) = sums.normal.minimum()
                && let Some((cost, minimum)) = self.cost(minimum)
                && cost <= self.scene.group_gates[self.members.len()]
            {
                self.emit(sums, cost, &minimum);
            }
            return;
        }
        let camera = camera_of(self, next);
        let end =
            (next..self.local.dots.len()).find(|&i| camera_of(self, i) != camera).unwrap_or(self.local.dots.len());
        for i in next..end {
            self.found.steps += 1;
            if self.found.steps > self.solid_step_limit {
                return;
            }
            let with = self.plus(sums, i);
            self.members.push(i as u8);
            let gate = self.scene.group_gates[self.members.len()];
            if with.normal.minimum().is_none_or(|m| m.rss <= gate) || self.members.len() < 2 {
                self.choose_or_omit(group, &with, end, spare);
            }
            self.members.pop();
        }
        if group.certain[next..end].contains(&true) {
            return;
        }
        let own = group.fitting[next..end].iter().any(|z| group.dots.binary_search(z).is_ok());
        if let Some(left) = spare.checked_sub(usize::from(own)) {
            self.choose_or_omit(group, sums, end, left);
        }
    }

    /// Adds to the local dots all dots of later cameras that match both of a pair, near enough to its point.
    fn gather(&mut self, a: u32, b: u32, pair: &Normal) {
        let frame = self.frame;
        let widening = self.scene.model.tail.map_or(1.0, |tail| tail.scale * tail.scale);
        let gate = self.scene.group_gates[3.min(self.scene.group_gates.len() - 1)] * widening;
        let [of_a, of_b] = [a, b].map(|z| {
            let all = &self.graph.neighbours[z as usize];
            &all[all.partition_point(|&other| other <= b)..]
        });
        let (mut i, mut j) = (0, 0);
        while i < of_a.len() && j < of_b.len() {
            let dot = of_a[i];
            match dot.cmp(&of_b[j]) {
                std::cmp::Ordering::Less => i += 1,
                std::cmp::Ordering::Greater => j += 1,
                std::cmp::Ordering::Equal => {
                    (i, j) = (i + 1, j + 1);
                    self.found.steps += 1;
                    if self.local.dots.len() == Local::CAPACITY {
                        (self.found.complete, self.found.truncated) = (false, true);
                        return;
                    }
                    if frame.sights[dot as usize].depth(&self.local.at) <= 1e-6 {
                        continue;
                    }
                    self.local.push(frame, dot);
                    let with = pair.plus(&self.local.normal[self.local.dots.len() - 1]).minimum();
                    // Far moves make the linearised residual meaningless: those are kept for the exact look later.
                    if with.is_some_and(|m| m.rss > gate && self.second_order(&m.step) < 1.0) {
                        self.local.pop();
                    }
                }
            }
        }
    }

    fn plus(&self, sums: &Sums, local: usize) -> Sums {
        let dot = self.local.dots[local] as usize;
        Sums {
            normal: sums.normal.plus(&self.local.normal[local]),
            gain: sums.gain + self.frame.gains[dot],
            cameras: sums.cameras | 1 << self.frame.sights[dot].camera,
        }
    }

    /// How wrong (standard deviations) the linearised residual can be after a step: (step/depth)² focal/σ.
    fn second_order(&self, step: &Vector3<f64>) -> f64 {
        let sight = &self.frame.sights[self.local.dots[0] as usize];
        let relative = step.norm_squared() / (self.local.at - sight.origin).norm_squared();
        relative / sight.angle_sigma
    }

    fn grow(&mut self, sums: &Sums, candidates: u128) {
        let mut rest = candidates;
        while rest != 0 {
            let next = rest.trailing_zeros() as usize;
            rest &= rest - 1;
            self.found.steps += 1;
            if self.found.steps > self.step_limit {
                (self.found.complete, self.found.truncated) = (false, true);
                return;
            }
            let with = self.plus(sums, next);
            let Some(minimum) = with.normal.minimum() else { continue };
            self.members.push(next as u8);
            let beyond = rest & self.local.linked[next];
            if self.members.len() == 3 && self.second_order(&minimum.step) > LINEAR_LIMIT {
                self.grow_elsewhere(&with, minimum.step, beyond);
            } else {
                self.visit(&with, minimum, beyond);
            }
            self.members.pop();
        }
    }

    fn visit(&mut self, sums: &Sums, minimum: Minimum, candidates: u128) {
        let Some((cost, minimum)) = self.cost(minimum) else { return };
        if cost <= self.scene.group_gates[self.members.len()] {
            self.emit(sums, cost, &minimum);
            self.grow(sums, candidates);
        }
    }

    /// A triple that moved far from the pair's point: linearise there, look at its branch, and come back.
    fn grow_elsewhere(&mut self, sums: &Sums, step: Vector3<f64>, candidates: u128) {
        let home = self.local.at;
        let mut at = home + step;
        for _ in 0..5 {
            if self.members.iter().any(|&i| self.frame.sights[self.local.dots[i as usize] as usize].depth(&at) <= 1e-6)
            {
                break;
            }
            self.local.relinearise(self.frame, at);
            let add = |sum: Normal, &i: &u8| sum.plus(&self.local.normal[i as usize]);
            let normal = self.members.iter().fold(Normal::default().with_ridge(self.ridge), add);
            let Some(minimum) = normal.minimum() else { break };
            if self.second_order(&minimum.step) <= LINEAR_LIMIT {
                self.visit(&Sums { normal, ..*sums }, minimum, candidates);
                break;
            }
            at += minimum.step;
        }
        self.local.relinearise(self.frame, home);
    }

    /// −2 ln likelihood of the residuals (χ² without a tail), with the minimum it belongs to.
    fn cost(&self, minimum: Minimum) -> Option<(f64, Minimum)> {
        let Some(tail) = self.scene.model.tail else { return Some((minimum.rss, minimum)) };
        robust_cost(&self.local, &self.members, tail, minimum)
    }

    fn emit(&mut self, sums: &Sums, cost: f64, minimum: &Minimum) {
        let point = self.local.at + minimum.step;
        let visible = (self.scene.visible(&point) | sums.cameras).count_ones();
        let weight = self.constant
            + self.scene.ln_density(&point)
            + self.scene.ln_views[visible as usize][self.members.len()]
            + sums.gain
            - 0.5 * (cost + minimum.determinant.ln());
        if weight > 0.0 {
            let local = &self.local;
            self.found.push(weight, point, self.members.iter().map(|&i| local.dots[i as usize]));
        }
    }
}

/// Two reweighted steps with the tail's weights, from the least-squares minimum.
fn robust_cost(local: &Local, members: &[u8], tail: Tail, start: Minimum) -> Option<(f64, Minimum)> {
    let total =
        |step: &Vector3<f64>| members.iter().map(|&i| tail.cost(local.linear[i as usize].squared_after(step))).sum();
    let mut best: (f64, Minimum) = (total(&start.step), start);
    let mut step = start.step;
    for _ in 0..2 {
        let weighted = members.iter().fold(Normal::default(), |sum, &i| {
            let linear = &local.linear[i as usize];
            sum.plus(&Normal::of(linear, tail.weight(linear.squared_after(&step))))
        });
        let minimum = weighted.with_ridge(1e-6).minimum()?;
        step = minimum.step;
        let cost = total(&step);
        if cost < best.0 {
            best = (cost, minimum);
        }
    }
    Some(best)
}
