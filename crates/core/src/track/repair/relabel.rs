//! Identities of the markers of a limb given out anew, all at once.
//!
//! A whole limb may be hidden from every camera, and when it comes back its markers may be in each other's chains: forearm
//! and hand together, so that exchanging two of them makes it worse (`exchange.rs`). Here a chain and its nearest ones
//! hand out their tracklets anew, in order of time, every tracklet to any chain that is free: how well its distances fit
//! the links of that chain, within the limb and to everything else, and how well motion leads to it. What matters for
//! the future is only which tracklet each chain had last; so of all ways that agree in that the best goes on
//! (dynamic programming), and of those the best few (a beam).

use super::exchange::IMPOSSIBLE;
use super::join::{Distances, Handout, Link, Scene, samples};
use super::tracklets::Tracklet;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Chains that hand out their tracklets together.
const GROUP: usize = 8;
/// Links of a chain that are asked.
const ASKED: usize = 14;
/// Ways followed at a time.
const BEAM: usize = 64;
/// What it costs to use one more chain (nats).
const ONE_MORE: f64 = -4.0;
/// A tracklet counts once, and once more for each second, up to so many times.
const MOST_LOOKS: f64 = 5.0;

/// What all groups of chains have in common.
struct Known {
    /// By chain, its links to be asked, by the number of the other.
    links: Vec<BTreeMap<usize, Link>>,
    /// By tracklet.
    seen: Vec<Looks>,
}

/// Frames of a tracklet that are looked at, with the distances to everything in each.
struct Looks {
    frames: Vec<usize>,
    distances: Vec<Distances>,
    /// How often the tracklet counts.
    count: f64,
}

/// A way to hand out the tracklets so far.
#[derive(Clone)]
struct Way {
    evidence: f64,
    /// Last tracklet of each chain (number within the group).
    last: Vec<Option<usize>>,
    /// Chain of the newest tracklet, and where in the trail the way before it stands.
    chain: u8,
    before: usize,
}

/// Tracklets of some chains, ready to be handed out.
struct Group<'a> {
    scene: &'a Scene<'a>,
    chains: Vec<usize>,
    /// In order of time, and the chain that each has now.
    tracklets: Vec<usize>,
    now: Vec<u8>,
    /// By tracklet, the earlier one from which the forward pass came to it, and what that says (nats).
    leaders: Vec<Option<(usize, f64)>>,
    /// By chain and chain, how far apart they are (m) if they stay near each other.
    apart_m: Vec<Vec<Option<f64>>>,
    /// By tracklet and chain: evidence of the distances to what is not in the group.
    outside: Vec<Vec<f64>>,
    /// By pair of tracklets (the later first) that share frames: evidence by their chains.
    inside: BTreeMap<(usize, usize), Vec<f64>>,
}

impl Scene<'_> {
    /// For every chain and its nearest ones the best distribution of their tracklets, if it is better.
    pub(super) fn relabellings(&self) -> Vec<Handout> {
        let known = Known {
            links: (0..self.chains.len()).into_par_iter().map(|c| self.asked(c)).collect(),
            seen: (0..self.tracklets.len()).into_par_iter().map(|t| self.seen_from(t)).collect(),
        };
        let groups = self.groups();
        groups.into_par_iter().filter_map(|chains| Group::new(self, &known, chains).better()).collect()
    }

    fn asked(&self, chain: usize) -> BTreeMap<usize, Link> {
        self.profile(chain).into_iter().take(ASKED).map(|l| (l.other, l)).collect()
    }

    fn seen_from(&self, tracklet: usize) -> Looks {
        let frames = self.tracklets[tracklet].frames(super::join::FRAMES);
        let distances = self.distances_of(tracklet);
        let own = &self.tracklets[tracklet];
        let count = (1.0 + self.times_s[own.last()] - self.times_s[own.first]).min(MOST_LOOKS);
        Looks { frames, distances, count }
    }

    /// Each chain with those nearest to it on average; every set once.
    fn groups(&self) -> Vec<Vec<usize>> {
        let n = self.chains.len();
        let near = |c: usize| {
            let mut sums: BTreeMap<usize, [f64; 2]> = BTreeMap::new();
            for (frame, place) in samples(&self.made_of(&self.chains[c]), super::join::FRAMES) {
                for (other, p) in self.by_frame[frame].iter().filter(|(o, _)| *o < n && *o != c) {
                    let sum = sums.entry(*other).or_default();
                    *sum = [sum[0] + (p - place).norm(), sum[1] + 1.0];
                }
            }
            let mut near: Vec<(f64, usize)> = sums.into_iter().map(|(o, [d, k])| (d / k, o)).collect();
            near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let mut group: Vec<usize> = near.into_iter().take(GROUP - 1).map(|(_, o)| o).chain([c]).collect();
            group.sort_unstable();
            group
        };
        let mut groups: Vec<Vec<usize>> = (0..n).into_par_iter().map(near).collect();
        groups.sort_unstable();
        groups.dedup();
        groups
    }
}

impl<'a> Group<'a> {
    fn new(scene: &'a Scene<'a>, known: &Known, chains: Vec<usize>) -> Self {
        let of = |(g, &c): (usize, &usize)| scene.chains[c].tracklets.iter().map(move |&t| (t, g as u8)).collect();
        let mut all: Vec<(usize, u8)> =
            chains.iter().enumerate().flat_map(|pair| -> Vec<(usize, u8)> { of(pair) }).collect();
        all.sort_by_key(|&(t, _)| (scene.tracklets[t].first, t));
        let (tracklets, now): (Vec<usize>, Vec<u8>) = all.into_iter().unzip();
        let outside = tracklets.iter().map(|&t| outside(known, &chains, t)).collect();
        let place: BTreeMap<usize, usize> = tracklets.iter().enumerate().map(|(k, &t)| (t, k)).collect();
        let leader = |(k, &t): (usize, &usize)| {
            let (leader, evidence) = scene.leader(t)?;
            place.get(&leader).filter(|l| **l < k).map(|&l| (l, evidence))
        };
        let leaders = tracklets.iter().enumerate().map(leader).collect();
        let apart = |a: &usize, b: &usize| known.links[*a].get(b).and_then(Link::near_m);
        let apart_m = chains.iter().map(|a| chains.iter().map(|b| apart(a, b)).collect()).collect();
        let mut group = Self { scene, chains, tracklets, now, leaders, apart_m, outside, inside: BTreeMap::new() };
        for later in 0..group.tracklets.len() {
            for earlier in 0..later {
                let (one, other) =
                    (&scene.tracklets[group.tracklets[later]], &scene.tracklets[group.tracklets[earlier]]);
                if other.last() >= one.first {
                    let evidence = group.between(known, later, earlier);
                    group.inside.insert((later, earlier), evidence);
                }
            }
        }
        group
    }

    /// Evidence of the distances between two tracklets, by the chains of the one and the other.
    fn between(&self, known: &Known, one: usize, other: usize) -> Vec<f64> {
        let n = self.chains.len();
        let (t, u) = (self.tracklets[one], self.tracklets[other]);
        let mut found = vec![0.0; n * n];
        let away = |from: usize, to: usize| -> Vec<f64> {
            let (from_places, to_places): (&Tracklet, &Tracklet) =
                (&self.scene.tracklets[from], &self.scene.tracklets[to]);
            let frames = known.seen[from].frames.iter();
            frames.filter_map(|&f| Some((from_places.at(f)? - to_places.at(f)?).norm())).collect()
        };
        for (from, to, turned) in [(t, u, false), (u, t, true)] {
            let distances = away(from, to);
            let seen = &known.seen[from];
            let worth = seen.count / seen.frames.len().max(1) as f64;
            for a in 0..n {
                for b in (0..n).filter(|&b| b != a) {
                    if let Some(link) = known.links[self.chains[a]].get(&self.chains[b]) {
                        let sum: f64 = distances.iter().map(|&d| link.evidence(d)).sum();
                        let at = if turned { b * n + a } else { a * n + b };
                        found[at] += link.weight() * worth * sum;
                    }
                }
            }
        }
        found
    }

    /// The best way to hand out the tracklets, if it is not the present one.
    fn better(&self) -> Option<Handout> {
        let n = self.chains.len();
        if self.tracklets.len() < 2 || n < 2 {
            return None;
        }
        let mut as_is = Way { evidence: 0.0, last: vec![None; n], chain: 0, before: 0 };
        let mut ways = vec![as_is.clone()];
        // Chains along the ways that were followed: each with the place of the one before.
        let mut trail: Vec<(usize, u8)> = vec![(0, 0)];
        for t in 0..self.tracklets.len() {
            as_is = self.after(&as_is, t, self.now[t], |u| self.now[u])?;
            let mut next: BTreeMap<Vec<Option<usize>>, Way> = BTreeMap::new();
            let chain_of = |way: &Way, u: usize| trail[(u + 1..t).fold(way.before, |at, _| trail[at].0)].1;
            let given = |way: &Way, g: u8| self.after(way, t, g, |u| chain_of(way, u));
            for way in ways.iter().flat_map(|way| (0..n as u8).filter_map(move |g| given(way, g))) {
                match next.get(&way.last) {
                    Some(known) if known.evidence >= way.evidence => {}
                    _ => {
                        next.insert(way.last.clone(), way);
                    }
                }
            }
            ways = next.into_values().collect();
            ways.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
            ways.truncate(BEAM);
            for way in &mut ways {
                trail.push((way.before, way.chain));
                way.before = trail.len() - 1;
            }
        }
        let best = ways.into_iter().next().filter(|best| best.evidence > as_is.evidence)?;
        let mut tracklets = vec![Vec::new(); n];
        let mut at = best.before;
        for &t in self.tracklets.iter().rev() {
            let (before, chain) = trail[at];
            tracklets[chain as usize].push(t);
            at = before;
        }
        tracklets.iter_mut().for_each(|own| own.reverse());
        Some(Handout { gain: best.evidence - as_is.evidence, chains: self.chains.clone(), tracklets })
    }

    /// A way with one more tracklet given to a chain; `None` where that has another at the time. `chain_of`: the chains of
    /// those before it.
    fn after(&self, way: &Way, t: usize, chain: u8, chain_of: impl Fn(usize) -> u8) -> Option<Way> {
        let g = chain as usize;
        let own = &self.scene.tracklets[self.tracklets[t]];
        let last_of = |u: usize| self.scene.tracklets[self.tracklets[u]].last();
        if way.last[g].is_some_and(|u| last_of(u) >= own.first) {
            return None;
        }
        let near = way.last.iter().zip(&self.apart_m[g]).filter_map(|(u, apart_m)| u.zip(*apart_m));
        let beside = near.filter(|(u, _)| last_of(*u) < own.first).max_by_key(|(u, _)| (last_of(*u), *u));
        let beside = beside.map(|(u, apart_m)| (self.tracklets[u], apart_m));
        let leads = |u: usize| self.scene.leads(self.tracklets[u], self.tracklets[t], beside).unwrap_or(IMPOSSIBLE);
        let motion = way.last[g].map_or(ONE_MORE, leads);
        let together = self.leaders[t].filter(|&(leader, _)| chain_of(leader) == chain);
        let mut evidence = way.evidence + motion + together.map_or(0.0, |l| l.1) + self.outside[t][g];
        // What shares frames with it is the last of its chain.
        for (other, u) in way.last.iter().enumerate() {
            if let Some(by_chains) = u.and_then(|u| self.inside.get(&(t, u))) {
                evidence += by_chains[g * self.chains.len() + other];
            }
        }
        let mut next = Way { evidence, chain, ..way.clone() };
        next.last[g] = Some(t);
        Some(next)
    }
}

/// Evidence of a tracklet's distances to what is not in the group, by the group's chains.
fn outside(known: &Known, chains: &[usize], tracklet: usize) -> Vec<f64> {
    let seen = &known.seen[tracklet];
    let worth = seen.count / seen.frames.len().max(1) as f64;
    let fits = |chain: &usize| {
        let asked = known.links[*chain].values().filter(|l| chains.binary_search(&l.other).is_err());
        let sum = |link: &Link| -> f64 {
            let of = |d: &Distances| d.binary_search_by_key(&link.other, |o| o.0).ok().map(|at| link.evidence(d[at].1));
            link.weight() * seen.distances.iter().filter_map(of).sum::<f64>()
        };
        worth * asked.map(sum).sum::<f64>()
    };
    chains.iter().map(fits).collect()
}
