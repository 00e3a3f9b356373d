//! Which tracklets are one marker, seen over the whole take.
//!
//! Tracklets are joined into trajectories, the surest first: two that do not overlap in time belong together if the
//! one's distances to other trajectories are those of the other (the dynamic model of Lee et al. 2000, §5, with the whole
//! take's statistics) and if motion can have carried the marker from one to the other. Evidence is a log-likelihood
//! ratio against "two different markers"; distances of one stretch of time count once, not once per frame, because
//! poses change slowly.

use super::tracklets::Tracklet;
use nalgebra::Vector3;

/// Evidence needed to join (nats): the sure cases first, so that the unsure ones have more to go by. In the end little
/// is needed: a marker that vanishes and another that appears from nowhere are a rare coincidence.
const ENOUGH: [f64; 6] = [8.0, 5.0, 3.0, 1.0, -1.0, -3.0];
/// Frames looked at per comparison.
const FRAMES: usize = 10;
/// Frames from which a trajectory's links are learned.
const PROFILE_FRAMES: usize = 80;
/// Other trajectories asked; witnesses are not independent, so each counts in part.
const WITNESSES: usize = 10;
const SHARE: f64 = 0.6;
/// Spread of the distance of an unrelated marker (m).
const UNRELATED: f64 = 0.20;
/// Spread of a rigid link (m): markers sit on skin.
const RIGID: f64 = 0.002;
/// A link that is not rigid may change beyond what was seen: by a part of what was seen, and of its length.
const BEYOND_SEEN: f64 = 1.0;
const BEYOND_LENGTH: f64 = 0.15;
/// How surely a link is rigid that looks so; how long a look counts in full (s).
const SURELY_RIGID: f64 = 0.9;
const LONG_LOOK_S: f64 = 2.0;
/// Acceleration that a limb may undergo unseen (m/s²), and the fastest marker (m/s).
const ACCELERATION: f64 = 25.0;
const FASTEST: f64 = 9.0;
/// Volume in which another marker could as well have appeared (m³), and bounds of the evidence of motion (nats).
const ELSEWHERE: f64 = 0.2;
const MOTION_FOR: f64 = 8.0;
/// How far a limb's marker may get about its body, however long it was hidden (m); from there on motion says little.
const LIMB_RANGE: f64 = 0.35;
const MOTION_AGAINST_LATER: f64 = -2.0;

/// A trajectory in the making: tracklets in order of time.
#[derive(Clone, Debug)]
pub struct Chain {
    /// Indices of the tracklets.
    pub tracklets: Vec<usize>,
    /// Measured frames.
    pub length: usize,
}

/// A witness: another chain, and the distance to it.
struct Link {
    other: usize,
    mean: f64,
    /// Spread seen (m), without the positions' noise.
    spread: f64,
    /// Variance of one distance by the positions' noise (m²).
    noise: f64,
    /// Probability that the link is rigid.
    rigid: f64,
}

impl Link {
    /// Logarithm of how much better this link explains a distance than "some other marker" does.
    fn evidence(&self, distance: f64) -> f64 {
        let off = (distance - self.mean).powi(2);
        let density = |variance: f64| (-0.5 * off / variance).exp() / variance.sqrt();
        let loose = self.spread + BEYOND_SEEN * self.spread + BEYOND_LENGTH * self.mean;
        let own = self.rigid * density(RIGID * RIGID + self.noise)
            + (1.0 - self.rigid) * density(loose * loose + self.noise);
        let unrelated = density(UNRELATED * UNRELATED).max(0.05 / UNRELATED);
        (own.max(1e-6 / UNRELATED) / unrelated).ln()
    }
}

/// Joins tracklets into chains.
pub fn join(tracklets: &[Tracklet], times_s: &[f64]) -> Vec<Chain> {
    let mut chains: Vec<Chain> =
        tracklets.iter().enumerate().map(|(i, t)| Chain { tracklets: vec![i], length: t.measured }).collect();
    for enough in ENOUGH {
        while join_once(tracklets, times_s, &mut chains, enough) {}
    }
    chains
}

/// One round: the pairs with the most evidence are joined, each chain once. Whether anything was joined.
fn join_once(tracklets: &[Tracklet], times_s: &[f64], chains: &mut Vec<Chain>, enough: f64) -> bool {
    let by_frame = by_frame(tracklets, chains, times_s.len());
    let mut pairs = Scene { tracklets, times_s, chains, by_frame }.pairs(enough);
    pairs.sort_by(|a, b| b.2.total_cmp(&a.2).then((a.0, a.1).cmp(&(b.0, b.1))));
    let mut taken = vec![false; chains.len()];
    for &(a, b, _) in &pairs {
        if !taken[a] && !taken[b] {
            (taken[a], taken[b]) = (true, true);
            let other = std::mem::take(&mut chains[b].tracklets);
            chains[a].tracklets.extend(other);
            chains[a].tracklets.sort_unstable_by_key(|&t| tracklets[t].first);
            chains[a].length += chains[b].length;
        }
    }
    chains.retain(|c| !c.tracklets.is_empty());
    !pairs.is_empty()
}

/// Logarithm of a heavy-tailed density of an offset over that of another marker, within bounds.
fn ln_near(off: f64, spread: f64) -> f64 {
    let squared = off * off / (spread * spread);
    let ln_here = -1.5 * std::f64::consts::TAU.ln() - 3.0 * spread.ln() - 2.5 * (squared / 5.0).ln_1p();
    (ln_here + ELSEWHERE.ln()).clamp(-MOTION_FOR, MOTION_FOR)
}

/// Chain of each tracklet present in each frame.
fn by_frame(tracklets: &[Tracklet], chains: &[Chain], frames: usize) -> Vec<Vec<(usize, Vector3<f64>)>> {
    let mut found = vec![Vec::new(); frames];
    for (c, chain) in chains.iter().enumerate() {
        for &t in &chain.tracklets {
            for (i, place) in tracklets[t].places.iter().enumerate() {
                if let Some(p) = place {
                    found[tracklets[t].first + i].push((c, *p));
                }
            }
        }
    }
    found
}

/// Distances to other chains in one frame, by ascending chain.
type Distances = Vec<(usize, f64)>;

struct Scene<'a> {
    tracklets: &'a [Tracklet],
    times_s: &'a [f64],
    chains: &'a [Chain],
    by_frame: Vec<Vec<(usize, Vector3<f64>)>>,
}

impl Scene<'_> {
    /// Pairs of chains with enough evidence, the longer first.
    fn pairs(&self, enough: f64) -> Vec<(usize, usize, f64)> {
        use rayon::prelude::*;
        let profiles: Vec<Vec<Link>> = (0..self.chains.len()).into_par_iter().map(|c| self.profile(c)).collect();
        let samples: Vec<Vec<Distances>> =
            (0..self.chains.len()).into_par_iter().map(|c| self.distances(c)).collect();
        (0..self.chains.len())
            .into_par_iter()
            .flat_map_iter(|a| {
                let (profiles, samples) = (&profiles, &samples);
                (0..self.chains.len()).filter_map(move |b| {
                    let longer = (self.chains[b].length, a) < (self.chains[a].length, b);
                    if a == b || !longer {
                        return None;
                    }
                    let motion = self.motion(a, b)?;
                    let total = motion + self.links(&profiles[a], &samples[b]);
                    (total > enough).then_some((a, b, total))
                })
            })
            .collect()
    }

    /// Length of a frame (s).
    fn frame_s(&self) -> f64 {
        let n = self.times_s.len();
        if n < 2 { 0.01 } else { (self.times_s[n - 1] - self.times_s[0]) / (n - 1) as f64 }
    }

    /// How the others moved between two frames, on average: nearby ones count more (m).
    fn drift(&self, from: usize, to: usize, place: &Vector3<f64>) -> Vector3<f64> {
        let (mut sum, mut weight) = (Vector3::zeros(), 1e-9);
        for (chain, p) in &self.by_frame[from] {
            if let Some((_, q)) = self.by_frame[to].iter().find(|(o, _)| o == chain) {
                let w = 1.0 / ((p - place).norm_squared() + 0.04);
                sum += (q - p) * w;
                weight += w;
            }
        }
        sum / weight
    }

    /// Positions of a chain in some of its frames.
    fn samples(&self, chain: usize, most: usize) -> Vec<(usize, Vector3<f64>)> {
        let own = &self.chains[chain];
        let mut found = Vec::new();
        for &t in &own.tracklets {
            let share = (most * self.tracklets[t].measured).div_ceil(own.length.max(1)).max(1);
            let frames = self.tracklets[t].frames(share);
            found.extend(frames.into_iter().filter_map(|f| self.tracklets[t].at(f).map(|p| (f, p))));
        }
        found
    }

    /// A chain's distances to others, the most constant first.
    fn profile(&self, chain: usize) -> Vec<Link> {
        let mut sums: std::collections::BTreeMap<usize, [f64; 3]> = std::collections::BTreeMap::new();
        for (frame, place) in self.samples(chain, PROFILE_FRAMES) {
            for (other, p) in self.by_frame[frame].iter().filter(|(o, _)| *o != chain) {
                let d = (p - place).norm();
                let s = sums.entry(*other).or_insert([0.0; 3]);
                let n = s[0] + 1.0;
                let off = d - s[1];
                s[0] = n;
                s[1] += off / n;
                s[2] += off * (d - s[1]);
            }
        }
        let noise = |c: usize| {
            let own = self.chains[c].tracklets.iter().map(|&t| self.tracklets[t].variance).sum::<f64>();
            own / self.chains[c].length as f64
        };
        let looked_s = |n: f64| n / PROFILE_FRAMES as f64 * self.chains[chain].length as f64 * self.frame_s();
        let own_noise = noise(chain);
        let link = |(other, [n, mean, squares]): (usize, [f64; 3])| {
            let noise = own_noise + noise(other);
            let seen = squares / (n - 1.0).max(1.0);
            let spread = (seen - noise).max(0.0).sqrt();
            let looks_rigid = (-0.5 * (spread / RIGID).powi(2)).exp();
            let rigid = SURELY_RIGID * looks_rigid * (looked_s(n) / LONG_LOOK_S).min(1.0);
            Link { other, mean, spread, noise, rigid }
        };
        let mut links: Vec<Link> = sums.into_iter().map(link).collect();
        let use_of = |l: &Link| (1.0 - l.rigid) * (2.0 * l.spread + BEYOND_LENGTH * l.mean) + l.rigid * RIGID;
        links.sort_by(|a, b| use_of(a).total_cmp(&use_of(b)).then(a.other.cmp(&b.other)));
        links
    }

    /// Distances of a chain to all others in some of its frames.
    fn distances(&self, chain: usize) -> Vec<Distances> {
        let to_all = |(frame, place): (usize, Vector3<f64>)| {
            self.by_frame[frame].iter().map(|(other, p)| (*other, (p - place).norm())).collect()
        };
        self.samples(chain, FRAMES).into_iter().map(to_all).collect()
    }

    /// Evidence of the distances: those of one chain under the profile of another.
    fn links(&self, profile: &[Link], samples: &[Distances]) -> f64 {
        let (mut total, mut asked) = (0.0, 0);
        for link in profile {
            let (mut sum, mut n) = (0.0, 0.0);
            for distances in samples {
                if let Ok(at) = distances.binary_search_by_key(&link.other, |d| d.0) {
                    sum += link.evidence(distances[at].1);
                    n += 1.0;
                }
            }
            if n > 0.0 {
                total += sum / n;
                asked += 1;
                if asked == WITNESSES {
                    break;
                }
            }
        }
        SHARE * total
    }

    /// Evidence of motion between neighbours in time; `None` if the chains overlap or nothing moves so fast.
    fn motion(&self, a: usize, b: usize) -> Option<f64> {
        let mut order: Vec<(usize, bool)> = Vec::new();
        order.extend(self.chains[a].tracklets.iter().map(|&t| (t, true)));
        order.extend(self.chains[b].tracklets.iter().map(|&t| (t, false)));
        order.sort_unstable_by_key(|&(t, _)| (self.tracklets[t].first, t));
        let mut evidence = 0.0;
        for pair in order.windows(2) {
            let (before, after) = (&self.tracklets[pair[0].0], &self.tracklets[pair[1].0]);
            if before.last() >= after.first {
                return None;
            }
            if pair[0].1 != pair[1].1 {
                evidence += self.bridge(before, after)?;
            }
        }
        Some(evidence.min(2.0 * MOTION_FOR))
    }

    /// Evidence that one tracklet goes on as another, by their places and velocities at the gap.
    fn bridge(&self, before: &Tracklet, after: &Tracklet) -> Option<f64> {
        let gap_s = self.times_s[after.first] - self.times_s[before.last()];
        let (p, q) = (before.at(before.last())?, after.at(after.first)?);
        if (q - p).norm() > FASTEST * gap_s + 0.05 {
            return None;
        }
        let later = |from: &Vector3<f64>| {
            let moved = from + self.drift(before.last(), after.first, from);
            ln_near((q - moved).norm(), LIMB_RANGE).max(MOTION_AGAINST_LATER)
        };
        let (v, w) = (self.velocity(before, true), self.velocity(after, false));
        let carried = match (v, w) {
            (Some(v), Some(w)) => p + (v + w) * (0.5 * gap_s),
            (Some(v), None) | (None, Some(v)) => p + v * gap_s,
            (None, None) => p,
        };
        let unknown = if v.is_some() || w.is_some() { 0.0 } else { 2.0 * gap_s };
        let spread = 0.004 + 0.25 * ACCELERATION * gap_s * gap_s + unknown;
        if spread > LIMB_RANGE { Some(later(&p)) } else { Some(ln_near((q - carried).norm(), spread)) }
    }

    /// Velocity at the end or the beginning of a tracklet (m/s), over up to 30 ms or two frames.
    fn velocity(&self, tracklet: &Tracklet, at_end: bool) -> Option<Vector3<f64>> {
        let here = if at_end { tracklet.last() } else { tracklet.first };
        let mut best = None;
        for step in 1..tracklet.places.len() {
            let there = if at_end { here - step } else { here + step };
            let dt_s = self.times_s[here] - self.times_s[there];
            if let (Some(p), Some(q)) = (tracklet.at(here), tracklet.at(there)) {
                best = Some((p - q) / dt_s);
            }
            if dt_s.abs() > 0.03 {
                break;
            }
        }
        best
    }
}
