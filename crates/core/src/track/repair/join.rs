//! Which tracklets are one marker, seen over the whole take.
//!
//! Tracklets are joined into trajectories, the surest first: two that do not overlap in time belong together if the
//! one's distances to other trajectories are those of the other (the dynamic model of Lee et al. 2000, §5, with the whole
//! take's statistics) and if motion can have carried the marker from one to the other. Evidence is a log-likelihood
//! ratio against "two different markers"; distances of one stretch of time count once, not once per frame, because
//! poses change slowly.

use super::bridge::leaders;
use super::joints::{Path, joint_centers};
use super::tracklets::{FLICKER, Tracklet, longest_flicker};
use crate::assignment::assign;
use nalgebra::Vector3;
use std::cell::Cell;
use std::collections::BTreeMap;

/// Evidence needed to join (nats): the sure cases first, so that the unsure ones have more to go by. In the end little
/// is needed: a marker that vanishes and another that appears from nowhere are a rare coincidence.
const ENOUGH: [f64; 6] = [8.0, 5.0, 3.0, 1.0, -1.0, -3.0];
const ENOUGH_FOR_FLICKERS: [f64; 3] = [8.0, 5.0, 2.0];
/// Evidence below which no pair is looked at (nats).
const LEAST_EVIDENCE: f64 = 4.0;
/// Rounds of exchanging and of relabelling, and the evidence that they need (nats).
const EXCHANGES: usize = 30;
const RELABELLINGS: usize = 12;
const WORTH_EXCHANGING: f64 = 1.0;
/// How much of the work is done (0–1) when all are joined, and when no exchange is worth it any more.
const JOINED: f64 = 0.4;
const EXCHANGED: f64 = 0.7;
/// Frames looked at per comparison.
pub(super) const FRAMES: usize = 10;
/// Frames from which a trajectory's links are learned.
const PROFILE_FRAMES: usize = 80;
/// Other trajectories asked; witnesses are not independent, so each counts in part.
const WITNESSES: usize = 10;
const SHARE: f64 = 0.3;
/// Spread of the distance of another marker that might be taken for this one, by the distance, and its bounds (m).
const OTHER_BY_LENGTH: f64 = 0.4;
const OTHER_RANGE: [f64; 2] = [0.03, 0.2];
/// Spread of a rigid link (m): markers sit on skin.
const RIGID: f64 = 0.002;
/// A distance may change beyond what was seen: by a part of what was seen, and of its length. The longer the look (s),
/// the less.
const BEYOND_SEEN: f64 = 1.0;
const BEYOND_LENGTH: f64 = 0.15;
const LONG_LOOK_S: f64 = 2.0;
/// How surely a link is rigid that looks so.
const SURELY_RIGID: f64 = 0.98;
/// What a link's spread is held for before anything was seen, by its length, and what that belief is worth (samples).
const UNSEEN_BY_LENGTH: f64 = 0.03;
const UNSEEN_WORTH: f64 = 2.0;
/// Two markers so near to each other, by no more and no less (m), tell of each other's motion.
const NEAR: f64 = 0.12;
const STAYS: f64 = 0.01;
/// How much less is unseen of a joint centre's distance.
const DOUBT_IN_JOINTS: f64 = 0.2;
/// Numbers from which the links' other ends are joint centres.
const JOINTS: usize = 1 << 32;
/// Measured frames that a chain needs to tell of joints, and chains looked at.
const SHORTEST_FOR_JOINTS: usize = 40;
const MOST_FOR_JOINTS: usize = 150;

/// A trajectory in the making: tracklets in order of time.
#[derive(Clone, Debug)]
pub struct Chain {
    /// Indices of the tracklets.
    pub tracklets: Vec<usize>,
    /// Measured frames.
    pub length: usize,
}

impl Chain {
    /// A chain of tracklets in order of time.
    pub(super) fn of(all: &[Tracklet], tracklets: Vec<usize>) -> Self {
        Self { length: tracklets.iter().map(|&t| all[t].measured).sum(), tracklets }
    }
}

/// A better distribution of some chains' tracklets.
pub(super) struct Handout {
    pub gain: f64,
    pub chains: Vec<usize>,
    /// Tracklets of each of the chains, in order of time; a chain without any goes.
    pub tracklets: Vec<Vec<usize>>,
}

/// A witness: another chain, and the distance to it.
pub(super) struct Link {
    pub(super) other: usize,
    mean: f64,
    /// Spread seen (m), without the positions' noise.
    spread: f64,
    /// Variance of one distance by the positions' noise (m²).
    noise: f64,
    /// Probability that the link is rigid.
    rigid: f64,
    /// How much may still be unseen, 0–1.
    unseen: f64,
}

impl Link {
    /// Spread to be reckoned with (m).
    fn loose(&self) -> f64 {
        RIGID + self.spread + self.unseen * (BEYOND_SEEN * self.spread + BEYOND_LENGTH * self.mean)
    }

    /// Distance to a marker that stays near (m).
    pub(super) fn near_m(&self) -> Option<f64> {
        (self.mean < NEAR && self.spread < STAYS).then_some(self.mean)
    }

    /// What the link's evidence counts: witnesses are not independent.
    pub(super) fn weight(&self) -> f64 {
        SHARE + (1.0 - SHARE) * self.rigid
    }

    /// Logarithm of how much better this link explains a distance than "another marker" does.
    pub(super) fn evidence(&self, distance: f64) -> f64 {
        let off = (distance - self.mean).powi(2);
        let density = |variance: f64| (-0.5 * off / variance).exp() / variance.sqrt();
        let loose = self.loose();
        let own =
            self.rigid * density(RIGID * RIGID + self.noise) + (1.0 - self.rigid) * density(loose * loose + self.noise);
        let other = (OTHER_BY_LENGTH * self.mean).clamp(OTHER_RANGE[0], OTHER_RANGE[1]);
        let another = density(other * other).max(0.05 / other);
        (own.max(1e-3 / other) / another).ln()
    }
}

/// Joins tracklets into chains, beginning with those that are known. Flickers come last; those that nothing speaks for, and
/// chains that sit on nothing (`loose`), are left out. `told`: how much is done (0–1), every now and then.
pub fn join(tracklets: &[Tracklet], known: Vec<Chain>, times_s: &[f64], told: &dyn Fn(f64)) -> Vec<Chain> {
    let single = |i: usize| Chain::of(tracklets, vec![i]);
    let longest = longest_flicker(tracklets);
    let mut is_single = vec![true; tracklets.len()];
    known.iter().flat_map(|c| &c.tracklets).for_each(|&t| is_single[t] = false);
    let (flickers, others): (Vec<usize>, Vec<usize>) =
        (0..tracklets.len()).filter(|&i| is_single[i]).partition(|&i| tracklets[i].is_flicker(longest));
    let mut chains = known;
    chains.extend(others.into_iter().map(single));
    for (round, enough) in ENOUGH.into_iter().enumerate() {
        told(JOINED * round as f64 / ENOUGH.len() as f64);
        let joints = joints_of(tracklets, &chains, times_s.len());
        while join_once(tracklets, times_s, &mut chains, &joints, enough) {}
    }
    // Where chains are absorbed, exchanging begins again; what was told before is not taken back.
    let most = Cell::new(0.0);
    let told = |part: f64| {
        most.set(part.max(most.get()));
        told(most.get());
    };
    loop {
        hand_out(tracklets, times_s, &mut chains, &told);
        if !improved(tracklets, times_s, &mut chains, Way::Absorbed) {
            break;
        }
    }
    chains.extend(flickers.into_iter().map(single));
    for enough in ENOUGH_FOR_FLICKERS {
        let joints = joints_of(tracklets, &chains, times_s.len());
        while join_once(tracklets, times_s, &mut chains, &joints, enough) {}
    }
    chains.retain(|c| c.length > FLICKER && c.tracklets.iter().any(|&t| !tracklets[t].is_flicker(longest)));
    let mut loose = Scene::new(tracklets, times_s, &chains, &[]).loose().into_iter();
    chains.retain(|_| loose.next() == Some(false));
    chains
}

/// Two chains at a time, then whole limbs, hand out their tracklets anew until nothing is gained any more; and two at a time
/// once more, because what lies on whose side is only asked there.
fn hand_out(tracklets: &[Tracklet], times_s: &[f64], chains: &mut Vec<Chain>, told: &dyn Fn(f64)) {
    for round in 0..EXCHANGES {
        told(JOINED + (EXCHANGED - JOINED) * round as f64 / EXCHANGES as f64);
        if !improved(tracklets, times_s, chains, Way::Exchanged) {
            break;
        }
    }
    for round in 0..RELABELLINGS {
        told(EXCHANGED + (1.0 - EXCHANGED) * round as f64 / RELABELLINGS as f64);
        if !improved(tracklets, times_s, chains, Way::Relabelled) {
            break;
        }
    }
    for _ in 0..EXCHANGES {
        if !improved(tracklets, times_s, chains, Way::Exchanged) {
            break;
        }
    }
}

/// Ways to hand out tracklets anew: by two chains, by limbs, by three chains that become two.
#[derive(Clone, Copy)]
enum Way {
    Exchanged,
    Relabelled,
    Absorbed,
}

/// Whether chains were improved by better distributions that are found with what they are now.
fn improved(tracklets: &[Tracklet], times_s: &[f64], chains: &mut Vec<Chain>, way: Way) -> bool {
    let joints = joints_of(tracklets, chains, times_s.len());
    let scene = Scene::new(tracklets, times_s, chains, &joints);
    let found = match way {
        Way::Exchanged => scene.exchanges(),
        Way::Relabelled => scene.relabellings(),
        Way::Absorbed => scene.absorbed(),
    };
    hand_over(tracklets, chains, found)
}

/// Hands out tracklets anew where that is worth it, what gains the most first, each chain once. Whether anything changed.
fn hand_over(tracklets: &[Tracklet], chains: &mut Vec<Chain>, mut found: Vec<Handout>) -> bool {
    found.retain(|h| h.gain > WORTH_EXCHANGING);
    found.sort_by(|a, b| b.gain.total_cmp(&a.gain).then(a.chains.cmp(&b.chains)));
    let mut touched = vec![false; chains.len()];
    let mut changed = false;
    for one in found {
        if one.chains.iter().any(|&c| touched[c]) {
            continue;
        }
        for (c, own) in one.chains.into_iter().zip(one.tracklets) {
            (touched[c], changed) = (true, true);
            chains[c] = Chain::of(tracklets, own);
        }
    }
    chains.retain(|c| !c.tracklets.is_empty());
    changed
}

/// One round: the pairs with the most evidence are joined, each chain once. Whether anything was joined.
fn join_once(tracklets: &[Tracklet], times_s: &[f64], chains: &mut Vec<Chain>, joints: &[Path], enough: f64) -> bool {
    let pairs = Scene::new(tracklets, times_s, chains, joints).pairs(enough);
    let mut chosen =
        best_pairs(&pairs, |a, b| tracklets[chains[a].tracklets[0]].first <= tracklets[chains[b].tracklets[0]].first);
    chosen.sort_by(|a, b| b.2.total_cmp(&a.2).then((a.0, a.1).cmp(&(b.0, b.1))));
    let mut taken = vec![false; chains.len()];
    for &(a, b, _) in &chosen {
        if !taken[a] && !taken[b] {
            (taken[a], taken[b]) = (true, true);
            let other = std::mem::take(&mut chains[b].tracklets);
            chains[a].tracklets.extend(other);
            chains[a].tracklets.sort_unstable_by_key(|&t| tracklets[t].first);
            chains[a].length += chains[b].length;
        }
    }
    chains.retain(|c| !c.tracklets.is_empty());
    !chosen.is_empty()
}

/// The pairs with the greatest total evidence when every chain has at most one successor and one predecessor: of two
/// markers lost together, the first to come back must not take the wrong one's place because its gap is shorter.
fn best_pairs(pairs: &[(usize, usize, f64)], in_order: impl Fn(usize, usize) -> bool) -> Vec<(usize, usize, f64)> {
    let ordered: Vec<(usize, usize)> =
        pairs.iter().map(|&(a, b, _)| if in_order(a, b) { (a, b) } else { (b, a) }).collect();
    let mut rows: Vec<usize> = ordered.iter().map(|p| p.0).collect();
    let mut columns: Vec<usize> = ordered.iter().map(|p| p.1).collect();
    for list in [&mut rows, &mut columns] {
        list.sort_unstable();
        list.dedup();
    }
    let mut costs = BTreeMap::new();
    for (index, (a, b)) in ordered.iter().enumerate() {
        costs.insert((rows.partition_point(|r| r < a), columns.partition_point(|c| c < b)), index);
    }
    // Evidence counts from the bottom, so that a joined pair always beats none.
    let gain = |index: usize| pairs[index].2 + LEAST_EVIDENCE;
    let found = assign(rows.len(), columns.len(), |r, c| costs.get(&(r, c)).map(|&i| -gain(i)));
    found.iter().enumerate().filter_map(|(r, c)| c.and_then(|c| costs.get(&(r, c))).map(|&i| pairs[i])).collect()
}

/// Joint centres by the chains that are long enough to tell; what turns about them are tracklets, because those of a limb
/// may still be in the wrong chains.
fn joints_of(tracklets: &[Tracklet], chains: &[Chain], frames: usize) -> Vec<Path> {
    let path_of = |own: &[usize], length: usize| {
        let mut path = vec![None; frames];
        let mut variance = 0.0;
        for &t in own {
            let one = &tracklets[t];
            path[one.first..=one.last()].copy_from_slice(&one.places);
            variance += one.variance;
        }
        (path, (variance / length as f64).sqrt())
    };
    let mut order: Vec<&Chain> = chains.iter().filter(|c| c.length >= SHORTEST_FOR_JOINTS).collect();
    order.sort_by_key(|c| (std::cmp::Reverse(c.length), c.tracklets[0]));
    order.truncate(MOST_FOR_JOINTS);
    let (paths, noise): (Vec<Path>, Vec<f64>) = order.iter().map(|c| path_of(&c.tracklets, c.length)).unzip();
    let mut long: Vec<usize> = (0..tracklets.len()).filter(|&t| tracklets[t].measured >= SHORTEST_FOR_JOINTS).collect();
    long.sort_by_key(|&t| (std::cmp::Reverse(tracklets[t].measured), t));
    long.truncate(MOST_FOR_JOINTS);
    let (pieces, pieces_noise): (Vec<Path>, Vec<f64>) =
        long.iter().map(|&t| path_of(&[t], tracklets[t].measured)).unzip();
    joint_centers(&paths, &noise, &pieces, &pieces_noise)
}

/// Places of all chains and joint centres in each frame, by ascending number.
fn by_frame_with(
    tracklets: &[Tracklet],
    chains: &[Chain],
    joints: &[Path],
    frames: usize,
) -> Vec<Vec<(usize, Vector3<f64>)>> {
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
    for (number, path) in joints.iter().enumerate() {
        let seen = path.iter().enumerate().filter_map(|(frame, place)| place.map(|p| (frame, p)));
        seen.for_each(|(frame, p)| found[frame].push((JOINTS + number, p)));
    }
    found
}

/// Places of tracklets of one marker in some of their frames.
pub(super) fn samples(own: &[&Tracklet], most: usize) -> Vec<(usize, Vector3<f64>)> {
    let share = |t: &Tracklet| (most * t.measured).div_ceil((measured(own) as usize).max(1)).max(1);
    let of = |t: &&Tracklet| -> Vec<(usize, Vector3<f64>)> {
        t.frames(share(t)).into_iter().filter_map(|f| t.at(f).map(|p| (f, p))).collect()
    };
    own.iter().flat_map(of).collect()
}

/// Measured frames of tracklets of one marker.
fn measured(own: &[&Tracklet]) -> f64 {
    own.iter().map(|t| t.measured).sum::<usize>() as f64
}

/// Distances to other chains in one frame, by ascending chain.
pub(super) type Distances = Vec<(usize, f64)>;

/// Chains in the making, and what they are made of.
pub(super) struct Scene<'a> {
    pub(super) tracklets: &'a [Tracklet],
    pub(super) times_s: &'a [f64],
    pub(super) chains: &'a [Chain],
    pub(super) by_frame: Vec<Vec<(usize, Vector3<f64>)>>,
    /// By tracklet, the one from whose end the forward pass came to it under the same identity.
    pub(super) leaders: Vec<Option<usize>>,
}

impl<'a> Scene<'a> {
    /// Chains of tracklets, beside joint centres.
    pub(super) fn new(tracklets: &'a [Tracklet], times_s: &'a [f64], chains: &'a [Chain], joints: &[Path]) -> Self {
        let by_frame = by_frame_with(tracklets, chains, joints, times_s.len());
        Self { tracklets, times_s, chains, by_frame, leaders: leaders(tracklets) }
    }
}

impl Scene<'_> {
    /// Pairs of chains with enough evidence, the longer first.
    fn pairs(&self, enough: f64) -> Vec<(usize, usize, f64)> {
        use rayon::prelude::*;
        let profiles: Vec<Vec<Link>> = (0..self.chains.len()).into_par_iter().map(|c| self.profile(c)).collect();
        let samples: Vec<Vec<Distances>> = (0..self.chains.len()).into_par_iter().map(|c| self.distances(c)).collect();
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
                    let total = motion + Self::links(&profiles[a], &samples[b]);
                    (total > enough).then_some((a, b, total))
                })
            })
            .collect()
    }

    /// Length of a frame (s).
    pub(super) fn frame_s(&self) -> f64 {
        let n = self.times_s.len();
        if n < 2 { 0.01 } else { (self.times_s[n - 1] - self.times_s[0]) / (n - 1) as f64 }
    }

    /// What a chain is made of.
    pub(super) fn made_of(&self, own: &Chain) -> Vec<&Tracklet> {
        own.tracklets.iter().map(|&t| &self.tracklets[t]).collect()
    }

    /// How far apart two chains are (m) if they are markers that stay near each other, by the profile of the one.
    pub(super) fn apart_m(profile: &[Link], other: usize) -> Option<f64> {
        profile.iter().find(|l| l.other == other)?.near_m()
    }

    /// A chain's distances to others, the most constant first.
    pub(super) fn profile(&self, chain: usize) -> Vec<Link> {
        self.profile_of(&self.chains[chain], &[chain])
    }

    /// The same for any chain, to others than these.
    pub(super) fn profile_of(&self, own: &Chain, but: &[usize]) -> Vec<Link> {
        self.profile_by(&self.made_of(own), but)
    }

    /// The same for any tracklets of one marker.
    pub(super) fn profile_by(&self, own: &[&Tracklet], but: &[usize]) -> Vec<Link> {
        let mut sums: BTreeMap<usize, [f64; 3]> = BTreeMap::new();
        for (frame, place) in samples(own, PROFILE_FRAMES) {
            for (other, p) in self.by_frame[frame].iter().filter(|(o, _)| !but.contains(o)) {
                let d = (p - place).norm();
                let s = sums.entry(*other).or_insert([0.0; 3]);
                let n = s[0] + 1.0;
                let off = d - s[1];
                s[0] = n;
                s[1] += off / n;
                s[2] += off * (d - s[1]);
            }
        }
        let length = measured(own);
        let noise_of = |own: &[&Tracklet]| own.iter().map(|t| t.variance).sum::<f64>() / measured(own);
        let noise = |c: usize| if c >= JOINTS { RIGID * RIGID } else { noise_of(&self.made_of(&self.chains[c])) };
        let looked_s = |n: f64| n / PROFILE_FRAMES as f64 * length * self.frame_s();
        let own_noise = noise_of(own);
        let link = |(other, [n, mean, squares]): (usize, [f64; 3])| {
            let noise = own_noise + noise(other);
            let before = UNSEEN_WORTH * (UNSEEN_BY_LENGTH * mean).powi(2);
            let spread = ((before + (squares - n * noise).max(0.0)) / (UNSEEN_WORTH + n)).sqrt();
            let looks_rigid = (-0.5 * (spread / RIGID).powi(2)).exp();
            // A joint centre has been found because distances to it do not change.
            let doubt = if other >= JOINTS { DOUBT_IN_JOINTS } else { 1.0 };
            let unseen = doubt * (-looked_s(n) / LONG_LOOK_S).exp();
            Link { other, mean, spread, noise, rigid: SURELY_RIGID * looks_rigid * (1.0 - unseen), unseen }
        };
        let mut links: Vec<Link> = sums.into_iter().map(link).collect();
        let use_of = |l: &Link| (1.0 - l.rigid) * l.loose() + l.rigid * RIGID;
        links.sort_by(|a, b| use_of(a).total_cmp(&use_of(b)).then(a.other.cmp(&b.other)));
        links
    }

    /// Distances of a chain to all others in some of its frames.
    fn distances(&self, chain: usize) -> Vec<Distances> {
        self.distances_by(&self.made_of(&self.chains[chain]))
    }

    /// Distances of one tracklet to all chains.
    pub(super) fn distances_of(&self, tracklet: usize) -> Vec<Distances> {
        self.distances_by(&[&self.tracklets[tracklet]])
    }

    /// The same for any tracklets of one marker.
    pub(super) fn distances_by(&self, own: &[&Tracklet]) -> Vec<Distances> {
        let to_all = |(frame, place): (usize, Vector3<f64>)| {
            self.by_frame[frame].iter().map(|(other, p)| (*other, (p - place).norm())).collect()
        };
        samples(own, FRAMES).into_iter().map(to_all).collect()
    }

    /// Evidence of the distances: those of one chain under the profile of another.
    pub(super) fn links(profile: &[Link], samples: &[Distances]) -> f64 {
        Self::links_beside(profile, samples, [usize::MAX; 2])
    }

    /// The same without what two chains say.
    pub(super) fn links_beside(profile: &[Link], samples: &[Distances], two: [usize; 2]) -> f64 {
        let (mut total, mut asked) = (0.0, 0);
        for link in profile.iter().filter(|l| !two.contains(&l.other)) {
            let (mut sum, mut n) = (0.0, 0.0);
            for distances in samples {
                if let Ok(at) = distances.binary_search_by_key(&link.other, |d| d.0) {
                    sum += link.evidence(distances[at].1);
                    n += 1.0;
                }
            }
            if n > 0.0 {
                total += link.weight() * sum / n;
                asked += 1;
                if asked == WITNESSES {
                    break;
                }
            }
        }
        total
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::track::repair::tracklets::cut;
    use crate::track::{Kind, Sample, Tracked};
    use nalgebra::{Matrix3, Rotation3};

    /// A body of five markers and an arm of four (two on the forearm, two on the hand) that is hidden now and then.
    fn arm(frames: usize) -> Vec<Tracked> {
        let body = [[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.0, 0.2, 0.1], [0.3, 0.2, 0.0], [0.15, 0.1, 0.3]];
        let forearm = [[0.08, 0.03, 0.0], [0.2, -0.02, 0.02]];
        let hand = [[0.03, 0.02, 0.0], [0.08, -0.03, 0.01]];
        let dots = [0, 1, 2];
        let one = |f: usize| {
            let t = f as f64 / 100.0;
            let away = Vector3::new(0.2 * t.sin(), 0.1 * t, 1.0);
            let elbow = Vector3::new(0.35, 0.0, 0.1);
            let turn = Rotation3::from_euler_angles(0.3 * (0.7 * t).sin(), 0.9 * (1.7 * t).sin(), 0.5 * t.cos());
            let bend = turn * Rotation3::from_euler_angles(0.2 * t.cos(), 0.5 * (2.3 * t).sin(), 0.0);
            let wrist = elbow + turn * Vector3::new(0.26, 0.0, 0.0);
            let mut places: Vec<Vector3<f64>> = body.iter().map(|p| Vector3::from(*p) + away).collect();
            if f % 100 < 80 {
                places.extend(forearm.iter().map(|p| elbow + turn * Vector3::from(*p) + away));
                places.extend(hand.iter().map(|p| wrist + bend * Vector3::from(*p) + away));
            }
            let sample = |(track, place)| {
                let state = (place, Matrix3::identity() * 1e-7);
                Sample::new(track as u32, state, Kind::Measured, &dots, 0.99)
            };
            Tracked { samples: places.into_iter().enumerate().map(sample).collect(), ..Tracked::default() }
        };
        (0..frames).map(one).collect()
    }

    #[test]
    fn a_whole_arm_in_each_others_chains_is_relabelled() {
        let times_s: Vec<f64> = (0..1200).map(|f| f64::from(f) / 100.0).collect();
        let (tracklets, _) = cut(&arm(1200), &times_s, 3.0);
        let is_late = |t: &usize| (500..900).contains(&tracklets[*t].first);
        // Forearm and hand are both exchanged in one part of the take.
        let partner = |track: u32| if track < 5 { track } else { 5 + ((track - 5) ^ 1) };
        let named = |t: usize| if is_late(&t) { partner(tracklets[t].track) } else { tracklets[t].track };
        let mut chains: Vec<Chain> = (0..9)
            .map(|track| {
                let own: Vec<usize> = (0..tracklets.len()).filter(|&t| named(t) == track).collect();
                Chain::of(&tracklets, own)
            })
            .collect();
        let relabel = |chains: &mut Vec<Chain>| {
            let found = Scene::new(&tracklets, &times_s, chains, &[]).relabellings();
            hand_over(&tracklets, chains, found)
        };
        assert!(relabel(&mut chains), "something must be exchanged");
        for chain in &chains {
            let tracks: Vec<u32> = chain.tracklets.iter().map(|&t| tracklets[t].track).collect();
            assert!(tracks.windows(2).all(|w| w[0] == w[1]), "{tracks:?}");
        }
        assert!(!relabel(&mut chains), "what is right stays");
    }
}
