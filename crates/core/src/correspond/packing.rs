//! Weighted set packing, exactly: disjoint candidate groups with the largest total weight, and a proof.
//!
//! Lagrangian relaxation of "each dot in at most one group" (Poore & Rijavec 1993 for multi-sensor assignment; Held &
//! Karp 1971 for the method): with a price u_z ≥ 0 per dot, `Σ u_z + Σ_T max(0, w_T − u(T))` bounds the optimum from
//! above. Subgradient steps lower the bound, a greedy choice by reduced weight raises the incumbent, groups whose
//! reduced weight is below the gap can never be part of a better choice and are fixed to zero. What then remains is
//! searched by branch and bound in terms of *losses*: with prices made feasible (no positive reduced weight) the value
//! of a choice is `Σ u − Σ_chosen (u(T) − w_T) − Σ_uncovered u_z`.
//!
//! Numerics: values are compared with an absolute tolerance of 1e-9 nats.

use super::enumerate::Candidates;

const TOLERANCE: f64 = 1e-9;
const SUBGRADIENT_STEPS: usize = 300;
/// Passes over all groups between which the prices move.
const ROUNDS: usize = 8;
/// Groups whose reduced weight is above minus this (nats) move the prices.
const NEAR: f64 = 1.0;

/// A packing with its certificate.
#[derive(Clone, Debug, Default)]
pub struct Packing {
    /// Chosen groups in ascending order.
    pub chosen: Vec<usize>,
    /// Their total weight.
    pub value: f64,
    /// Proven upper bound on the weight of any choice; equals `value` where the choice is proven optimal.
    pub bound: f64,
    /// Search nodes used.
    pub nodes: usize,
    /// Feasible prices of the dots: no group's weight exceeds the sum of its dots' prices.
    pub prices: Vec<f64>,
}

impl Packing {
    /// Whether no better choice exists.
    pub fn is_optimal(&self) -> bool {
        self.bound <= self.value + 1e-7 * (1.0 + self.value.abs())
    }
}

/// Chooses disjoint groups of `candidates` over `n_dots` dots. Stops branching after `node_limit` nodes.
pub fn pack(candidates: &Candidates, n_dots: usize, node_limit: usize) -> Packing {
    let mut solver = Solver::new(candidates, n_dots);
    solver.greedy(&best_of_each_dot(candidates, n_dots), |s, g| s.candidates.weights[g]);
    solver.initial_prices();
    let active = solver.lower_bound_gap();
    let mut nodes = 0;
    if solver.bound > solver.best + TOLERANCE {
        // Groups that are not active cannot improve on the incumbent: prices need to be feasible for the others only.
        make_feasible(candidates, &active, &mut solver.prices);
        let total: f64 = solver.prices.iter().sum();
        let search = BranchAndBound::new(candidates, &active, &solver.prices, total - solver.best, node_limit);
        let (better, finished, used) = search.run(n_dots);
        nodes = used;
        if let Some((loss, chosen)) = better {
            solver.best = total - loss;
            solver.chosen = chosen;
        }
        solver.bound = if finished { solver.best } else { solver.bound.min(total) };
    }
    solver.chosen.sort_unstable();
    let chosen: Vec<usize> = solver.chosen.iter().map(|&g| g as usize).collect();
    let value = chosen.iter().map(|&g| candidates.weights[g]).sum();
    Packing { chosen, value, bound: solver.bound.max(value), nodes, prices: solver.prices }
}

/// The heaviest group of each dot, in ascending order.
fn best_of_each_dot(candidates: &Candidates, n_dots: usize) -> Vec<u32> {
    let mut best = vec![(0.0, u32::MAX); n_dots];
    for group in 0..candidates.len() {
        for &z in candidates.dots(group) {
            if candidates.weights[group] > best[z as usize].0 {
                best[z as usize] = (candidates.weights[group], group as u32);
            }
        }
    }
    let mut groups: Vec<u32> = best.into_iter().map(|(_, g)| g).filter(|&g| g != u32::MAX).collect();
    groups.sort_unstable();
    groups.dedup();
    groups
}

struct Solver<'a> {
    candidates: &'a Candidates,
    prices: Vec<f64>,
    chosen: Vec<u32>,
    best: f64,
    bound: f64,
    taken: Vec<bool>,
}

impl<'a> Solver<'a> {
    fn new(candidates: &'a Candidates, n_dots: usize) -> Self {
        Self {
            candidates,
            prices: vec![0.0; n_dots],
            chosen: Vec::new(),
            best: 0.0,
            bound: f64::INFINITY,
            taken: vec![false; n_dots],
        }
    }

    fn reduced(&self, group: usize) -> f64 {
        self.candidates.weights[group]
            - self.candidates.dots(group).iter().map(|&z| self.prices[z as usize]).sum::<f64>()
    }

    /// Takes groups in descending order of a key while they are disjoint; keeps the choice if it is the best so far.
    fn greedy(&mut self, among: &[u32], key: impl Fn(&Self, usize) -> f64) {
        let mut keyed: Vec<(f64, u32)> = among.iter().map(|&g| (key(self, g as usize), g)).collect();
        keyed.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        self.taken.fill(false);
        let (mut chosen, mut value) = (Vec::new(), 0.0);
        for (_, group) in keyed {
            let dots = self.candidates.dots(group as usize);
            if dots.iter().all(|&z| !self.taken[z as usize]) {
                dots.iter().for_each(|&z| self.taken[z as usize] = true);
                chosen.push(group);
                value += self.candidates.weights[group as usize];
            }
        }
        if value > self.best {
            (self.best, self.chosen) = (value, chosen);
        }
    }

    /// Shares the weight of each chosen group equally among its dots.
    fn initial_prices(&mut self) {
        for &group in &self.chosen {
            let dots = self.candidates.dots(group as usize);
            let share = self.candidates.weights[group as usize] / dots.len() as f64;
            dots.iter().for_each(|&z| self.prices[z as usize] = share);
        }
    }

    /// Lowers the bound by price changes; returns the groups that may still be part of a better choice.
    ///
    /// Only groups near a reduced weight of zero move the prices, so the steps run over those, and passes over all
    /// groups in between make the bound valid and fix what cannot matter any more.
    fn lower_bound_gap(&mut self) -> Vec<u32> {
        let mut active: Vec<u32> = (0..self.candidates.len() as u32).collect();
        let mut best_prices = self.prices.clone();
        for round in 0..ROUNDS {
            let mut bound: f64 = self.prices.iter().sum();
            let reduced: Vec<f64> = active.iter().map(|&g| self.reduced(g as usize)).collect();
            bound += reduced.iter().filter(|r| **r > 0.0).sum::<f64>();
            let improved = bound < self.bound - TOLERANCE;
            if improved {
                self.bound = bound;
                best_prices.clone_from(&self.prices);
            }
            let near = |r: f64| r > -NEAR;
            let mut working: Vec<u32> =
                active.iter().zip(&reduced).filter(|(_, r)| near(**r)).map(|(&g, _)| g).collect();
            self.greedy(&working, Self::reduced_scaled);
            let best = self.best;
            let mut value = reduced.iter();
            active.retain(|_| value.next().is_some_and(|r| bound + r.min(0.0) > best - TOLERANCE));
            if self.bound - self.best < TOLERANCE || (round > 0 && !improved) {
                break;
            }
            working.retain(|g| active.binary_search(g).is_ok());
            self.subgradient(&working);
        }
        self.prices = best_prices;
        active
    }

    /// Subgradient steps (Held & Karp 1971) over a working set of groups; leaves the best prices found for it.
    fn subgradient(&mut self, working: &[u32]) {
        let mut best_prices = self.prices.clone();
        let mut lowest = f64::INFINITY;
        let mut usage = vec![1.0_f64; self.prices.len()];
        let (mut pace, mut stale) = (1.0, 0);
        for step in 0..SUBGRADIENT_STEPS {
            usage.fill(1.0);
            let mut bound: f64 = self.prices.iter().sum();
            for &group in working {
                let reduced = self.reduced(group as usize);
                if reduced > 0.0 {
                    bound += reduced;
                    self.candidates.dots(group as usize).iter().for_each(|&z| usage[z as usize] -= 1.0);
                }
            }
            if bound < lowest - TOLERANCE {
                lowest = bound;
                best_prices.clone_from(&self.prices);
                stale = 0;
            } else {
                stale += 1;
            }
            if step % 10 == 9 {
                self.greedy(working, Self::reduced_scaled);
            }
            if lowest - self.best < TOLERANCE {
                break;
            }
            if stale >= 8 {
                (pace, stale) = (pace * 0.6, 0);
                self.prices.clone_from(&best_prices);
                if pace < 0.05 {
                    break;
                }
                continue;
            }
            // A dot without price that nobody wants does not push prices below zero.
            let norm2: f64 =
                usage.iter().zip(&self.prices).map(|(&s, &u)| if s > 0.0 && u <= 0.0 { 0.0 } else { s * s }).sum();
            if norm2 < 0.5 {
                break;
            }
            let length = pace * (bound - self.best).max(0.05) / norm2;
            for (price, &slack) in self.prices.iter_mut().zip(&usage) {
                *price = (*price - length * slack).max(0.0);
            }
        }
        self.prices = best_prices;
    }

    fn reduced_scaled(&self, group: usize) -> f64 {
        // Ties between groups of reduced weight zero go to the larger group.
        self.reduced(group) + 1e-6 * self.candidates.weights[group]
    }
}

/// Raises prices until no active group's reduced weight is positive, then lowers each as far as that allows.
fn make_feasible(candidates: &Candidates, active: &[u32], prices: &mut [f64]) {
    let slack = |prices: &[f64], group: u32| {
        let dots = candidates.dots(group as usize);
        dots.iter().map(|&z| prices[z as usize]).sum::<f64>() - candidates.weights[group as usize]
    };
    for &group in active {
        let missing = -slack(prices, group);
        if missing > 0.0 {
            let dots = candidates.dots(group as usize);
            dots.iter().for_each(|&z| prices[z as usize] += missing / dots.len() as f64);
        }
    }
    let groups_of = by_dot(candidates, prices.len(), active.iter().copied());
    for dot in 0..prices.len() {
        let room = groups_of[dot].iter().map(|&g| slack(prices, g)).fold(prices[dot], f64::min);
        prices[dot] -= room.max(0.0);
    }
}

/// The given groups, by the dots they hold.
pub fn by_dot(candidates: &Candidates, n_dots: usize, groups: impl Iterator<Item = u32>) -> Vec<Vec<u32>> {
    let mut groups_of = vec![Vec::new(); n_dots];
    for group in groups {
        candidates.dots(group as usize).iter().for_each(|&z| groups_of[z as usize].push(group));
    }
    groups_of
}

/// Root of a set in a disjoint-set forest, with path halving.
fn find(root: &mut [u32], mut z: u32) -> u32 {
    while root[z as usize] != z {
        root[z as usize] = root[root[z as usize] as usize];
        z = root[z as usize];
    }
    z
}

/// Depth-first search for the choice with the smallest loss below a cutoff.
struct BranchAndBound<'a> {
    candidates: &'a Candidates,
    prices: &'a [f64],
    losses: Vec<f64>,
    groups_of: Vec<Vec<u32>>,
    cutoff: f64,
    node_limit: usize,
    nodes: usize,
    state: Vec<u8>,
    chosen: Vec<u32>,
    best: Option<Vec<u32>>,
}

const FREE: u8 = 0;
const COVERED: u8 = 1;
const LEFT: u8 = 2;

impl<'a> BranchAndBound<'a> {
    fn new(candidates: &'a Candidates, active: &[u32], prices: &'a [f64], cutoff: f64, node_limit: usize) -> Self {
        let price = |g: usize| candidates.dots(g).iter().map(|&z| prices[z as usize]).sum::<f64>();
        let losses: Vec<f64> = (0..candidates.len()).map(|g| (price(g) - candidates.weights[g]).max(0.0)).collect();
        let mut groups_of = by_dot(
            candidates,
            prices.len(),
            active.iter().copied().filter(|&g| losses[g as usize] < cutoff - TOLERANCE),
        );
        for groups in &mut groups_of {
            groups.sort_unstable_by(|&a, &b| losses[a as usize].total_cmp(&losses[b as usize]).then(a.cmp(&b)));
        }
        Self {
            candidates,
            prices,
            losses,
            groups_of,
            cutoff,
            node_limit,
            nodes: 0,
            state: vec![FREE; prices.len()],
            chosen: Vec::new(),
            best: None,
        }
    }

    /// The best choice below the cutoff with its loss, whether the search was complete, and the nodes used.
    fn run(mut self, n_dots: usize) -> (Option<(f64, Vec<u32>)>, bool, usize) {
        // Dots without price never decide anything: they cost nothing when left.
        let open: Vec<u32> = (0..n_dots as u32).filter(|&z| self.prices[z as usize] > TOLERANCE).collect();
        let components = self.components(&open);
        let (mut total, mut all) = (0.0, Vec::new());
        let mut finished = true;
        for component in components {
            let limit = self.cutoff;
            self.best = None;
            self.chosen.clear();
            self.cutoff -= total;
            self.descend(&component, 0.0);
            finished &= self.nodes <= self.node_limit;
            let found = self.best.take();
            let loss = self.cutoff;
            self.cutoff = limit;
            match found {
                Some(chosen) => {
                    total += loss;
                    all.extend(chosen);
                }
                None => return (None, finished, self.nodes),
            }
        }
        (Some((total, all)), finished, self.nodes)
    }

    /// Dots that share no useful group are decided independently.
    fn components(&self, open: &[u32]) -> Vec<Vec<u32>> {
        let mut root: Vec<u32> = (0..self.state.len() as u32).collect();
        for groups in &self.groups_of {
            for &g in groups {
                let dots = self.candidates.dots(g as usize);
                let first = find(&mut root, dots[0]);
                for &z in &dots[1..] {
                    let other = find(&mut root, z);
                    root[other as usize] = first;
                }
            }
        }
        let mut keyed: Vec<(u32, u32)> = open.iter().map(|&z| (find(&mut root, z), z)).collect();
        keyed.sort_unstable();
        keyed.chunk_by(|a, b| a.0 == b.0).map(|c| c.iter().map(|&(_, z)| z).collect()).collect()
    }

    /// Extends the choice; `self.cutoff` is the loss to beat, and on success the loss of the best.
    fn descend(&mut self, component: &[u32], loss: f64) {
        self.nodes += 1;
        if self.nodes > self.node_limit || loss >= self.cutoff - TOLERANCE {
            return;
        }
        let Some((dot, _)) = self.most_constrained(component, loss) else {
            self.cutoff = loss;
            self.best = Some(self.chosen.clone());
            return;
        };
        for i in 0..self.groups_of[dot as usize].len() {
            let group = self.groups_of[dot as usize][i];
            let next = loss + self.losses[group as usize];
            if next >= self.cutoff - TOLERANCE {
                break;
            }
            let candidates = self.candidates;
            let dots = candidates.dots(group as usize);
            if dots.iter().any(|&z| self.state[z as usize] != FREE) {
                continue;
            }
            dots.iter().for_each(|&z| self.state[z as usize] = COVERED);
            self.chosen.push(group);
            self.descend(component, next);
            self.chosen.pop();
            dots.iter().for_each(|&z| self.state[z as usize] = FREE);
        }
        self.state[dot as usize] = LEFT;
        self.descend(component, loss + self.prices[dot as usize]);
        self.state[dot as usize] = FREE;
    }

    /// The free dot with the fewest ways on within the cutoff.
    fn most_constrained(&self, component: &[u32], loss: f64) -> Option<(u32, usize)> {
        let mut best: Option<(u32, usize)> = None;
        for &dot in component {
            if self.state[dot as usize] != FREE {
                continue;
            }
            let mut ways = usize::from(loss + self.prices[dot as usize] < self.cutoff - TOLERANCE);
            for &group in &self.groups_of[dot as usize] {
                if loss + self.losses[group as usize] >= self.cutoff - TOLERANCE {
                    break;
                }
                let free = self.candidates.dots(group as usize).iter().all(|&z| self.state[z as usize] == FREE);
                ways += usize::from(free);
                if best.is_some_and(|(_, fewest)| ways >= fewest) {
                    break;
                }
            }
            if best.is_none_or(|(_, fewest)| ways < fewest) {
                best = Some((dot, ways));
                if ways <= 1 {
                    break;
                }
            }
        }
        best
    }
}
