//! How sure a chosen group is: the posterior odds of the best explanation of the frame without that marker.
//!
//! For a chosen group T, all groups that share two dots or more with it (and so put a marker at nearly the same place)
//! are forbidden, and the explanations of the remaining dots are searched from the chosen one outwards: dots that lost
//! their group are left alone or join another one, which may push others out. Losses are differences of log-posterior,
//! so `1 / (1 + Σ exp(−loss))` over these explanations is the probability of T against them.

use super::enumerate::Candidates;
use super::packing::{Packing, by_dot};

/// Explanations less likely than this (nats below the best) do not count.
const HORIZON: f64 = 7.0;
const NODE_LIMIT: usize = 300;

/// Probability of each chosen group, in the order of `packing.chosen`.
pub fn confidences(candidates: &Candidates, packing: &Packing, n_dots: usize) -> Vec<f64> {
    let price = |g: usize| candidates.dots(g).iter().map(|&z| packing.prices[z as usize]).sum::<f64>();
    let losses: Vec<f64> = (0..candidates.len()).map(|g| price(g) - candidates.weights[g]).collect();
    let own_loss: f64 = packing.chosen.iter().map(|&g| losses[g]).sum();
    let mut holder = vec![None; n_dots];
    for &group in &packing.chosen {
        candidates.dots(group).iter().for_each(|&z| holder[z as usize] = Some(group as u32));
    }
    let uncovered: f64 = (0..n_dots).filter(|&z| holder[z].is_none()).map(|z| packing.prices[z]).sum();
    // Where prices are not exact, part of a loss is won back later.
    let horizon = HORIZON + (own_loss + uncovered).max(0.0);
    let mut groups_of =
        by_dot(candidates, n_dots, (0..candidates.len() as u32).filter(|&g| losses[g as usize] < horizon));
    for groups in &mut groups_of {
        groups.sort_unstable_by(|&a, &b| losses[a as usize].total_cmp(&losses[b as usize]).then(a.cmp(&b)));
    }
    let mut search = Alternatives {
        candidates,
        prices: &packing.prices,
        losses: &losses,
        groups_of: &groups_of,
        holder: &holder,
        state: vec![State::Held; n_dots],
        pending: Vec::new(),
        horizon,
        forbidden: &[],
        odds: 0.0,
        nodes: 0,
    };
    packing.chosen.iter().map(|&group| search.confidence(group as u32)).collect()
}

#[derive(Clone, Copy, PartialEq)]
enum State {
    /// As in the chosen explanation.
    Held,
    /// Lost its group and waits for a decision.
    Pending,
    /// Decided: alone, or in another group.
    Decided,
}

struct Alternatives<'a> {
    candidates: &'a Candidates,
    prices: &'a [f64],
    losses: &'a [f64],
    groups_of: &'a [Vec<u32>],
    holder: &'a [Option<u32>],
    state: Vec<State>,
    pending: Vec<u32>,
    horizon: f64,
    forbidden: &'a [u32],
    odds: f64,
    nodes: usize,
}

impl<'a> Alternatives<'a> {
    fn confidence(&mut self, group: u32) -> f64 {
        self.forbidden = self.candidates.dots(group as usize);
        (self.odds, self.nodes) = (0.0, 0);
        let loss = self.release(group);
        self.descend(loss);
        self.restore(group);
        1.0 / (1.0 + self.odds)
    }

    /// Takes a chosen group apart; its own loss is won back.
    fn release(&mut self, group: u32) -> f64 {
        for &z in self.candidates.dots(group as usize) {
            self.state[z as usize] = State::Pending;
            self.pending.push(z);
        }
        -self.losses[group as usize]
    }

    fn restore(&mut self, group: u32) {
        let dots = self.candidates.dots(group as usize);
        self.pending.retain(|z| !dots.contains(z));
        dots.iter().for_each(|&z| self.state[z as usize] = State::Held);
    }

    fn descend(&mut self, loss: f64) {
        self.nodes += 1;
        if self.nodes > NODE_LIMIT || loss > self.horizon {
            return;
        }
        let Some(&dot) = self.pending.iter().rfind(|&&z| self.state[z as usize] == State::Pending) else {
            self.odds += (-loss).exp();
            return;
        };
        self.state[dot as usize] = State::Decided;
        self.descend(loss + self.prices[dot as usize]);
        self.state[dot as usize] = State::Pending;
        for i in 0..self.groups_of[dot as usize].len() {
            let group = self.groups_of[dot as usize][i];
            if loss + self.losses[group as usize] > self.horizon {
                break;
            }
            self.try_group(group, loss);
        }
    }

    fn try_group(&mut self, group: u32, loss: f64) {
        let candidates: &'a Candidates = self.candidates;
        let dots = candidates.dots(group as usize);
        let allowed = dots.iter().all(|&z| self.state[z as usize] != State::Decided)
            && dots.iter().filter(|z| self.forbidden.contains(z)).count() < 2;
        if !allowed {
            return;
        }
        let mut pushed_out: Vec<u32> = Vec::new();
        let mut next = loss + self.losses[group as usize];
        for &z in dots {
            match (self.state[z as usize], self.holder[z as usize]) {
                (State::Held, Some(held)) if !pushed_out.contains(&held) => pushed_out.push(held),
                // An uncovered dot's price was paid; using it wins the price back.
                (State::Held, None) => next -= self.prices[z as usize],
                _ => {}
            }
        }
        let depth = self.pending.len();
        let before: Vec<State> = dots.iter().map(|&z| self.state[z as usize]).collect();
        for &held in &pushed_out {
            next += self.release(held);
        }
        dots.iter().for_each(|&z| self.state[z as usize] = State::Decided);
        self.descend(next);
        for &held in &pushed_out {
            self.candidates.dots(held as usize).iter().for_each(|&z| self.state[z as usize] = State::Held);
        }
        self.pending.truncate(depth);
        dots.iter().zip(before).for_each(|(&z, state)| self.state[z as usize] = state);
    }
}
