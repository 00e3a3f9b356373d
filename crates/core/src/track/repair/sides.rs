//! Two chains that were exchanged again and again, told apart by the side on which the others lie.
//!
//! A profile learned from two chains that have each other's pieces half of the time fits both alike, and no exchange pays
//! (`exchange.rs`). But how far another marker or a joint lies on the one's side of the middle between the two changes its
//! sign when they are exchanged, and how far it is from the middle does not. So those that are most constantly as far from
//! the middle are asked. Each proposes which blocks to exchange, so that it is always on the same side; those that are clear
//! then agree on what they say of every block; and the proposal counts after which all of them lie most clearly off the
//! middle. That holds for two markers of one part, which stay as far apart as ever.

use super::exchange::Block;
use super::join::{Chain, Scene};
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// Frames of a block that are looked at.
const FRAMES: usize = 20;
/// A witness lies so many spreads off the middle between the two; so many are heard, and at least two.
const CLEAR: f64 = 2.0;
const WITNESSES: usize = 10;
const FEWEST: usize = 2;
/// Witnesses are not independent: the clearest counts in full, each further one in part.
const SHARE: f64 = 0.3;
/// How much clearer the others must lie off the middle in all (logarithm of their spreads).
const CLEARER: f64 = 0.5;
/// Share of the looks in which a witness must be seen.
const OFTEN: f64 = 0.5;
/// Two markers are of one part if they are as far apart as ever (m) in so many of the blocks: skin moves.
const STEADY_M: f64 = 0.005;
const STEADY: f64 = 0.8;
/// Least spread of where a witness lies (m): poses change.
const LEAST_SPREAD: f64 = 0.002;
/// What a pose never seen before says at most: this density, of one that is as expected.
const UNFORESEEN: f64 = 1e-3;
/// A block counts once, and once more for each second, up to so many times.
const MOST_LOOKS: f64 = 5.0;
const ROUNDS: usize = 10;

/// A frame in which both are seen, and their places.
type Both = (usize, Vector3<f64>, Vector3<f64>);

/// What one block shows of the others.
struct Seen {
    block: usize,
    /// How far each lies on the one's side of the middle between the two, on average (m).
    off_m: BTreeMap<usize, f64>,
    /// How far each is from the middle: mean (m) and mean square (m²).
    far: BTreeMap<usize, [f64; 2]>,
    /// How often the block counts.
    looks: f64,
}

/// What the sides of the others tell of two chains.
pub(super) struct Turned {
    /// If their history is mixed, the two of those pieces that were seen at the same time, each on its own side.
    pub(super) chains: Option<[Chain; 2]>,
    /// Of each of these blocks (number), evidence that it stays as it is, against exchanging its two (nats).
    pub(super) stays: Vec<(usize, f64)>,
}

/// A witness of two chains: how far on the one's side it lies (m), and the spread of that.
struct Witness {
    other: usize,
    off_m: f64,
    spread_m: f64,
}

impl Scene<'_> {
    /// Two chains of one part told apart by the sides of the others; `None` where these tell nothing.
    pub(super) fn turned(&self, pair: [usize; 2], blocks: &[Block]) -> Option<Turned> {
        let both: Vec<Vec<Both>> = blocks.iter().map(|b| self.both(b)).collect();
        if !are_steady(&both) {
            return None;
        }
        let shown = both.iter().enumerate().filter(|(_, frames)| !frames.is_empty());
        let seen: Vec<Seen> = shown.map(|(k, frames)| self.seen(k, frames, pair)).collect();
        let (stays, some) = stays(&seen)?;
        let stays: Vec<(usize, f64)> = seen.iter().map(|s| s.block).zip(stays).collect();
        Some(Turned { chains: some.then(|| self.with_exchanged(blocks, &stays)), stays })
    }

    /// Two chains of those blocks, exchanged where more speaks for that.
    fn with_exchanged(&self, blocks: &[Block], stays: &[(usize, f64)]) -> [Chain; 2] {
        let mut turned = [Vec::new(), Vec::new()];
        for &(block, evidence) in stays {
            let block = &blocks[block];
            let parts = if evidence < 0.0 { [&block.others, &block.ones] } else { [&block.ones, &block.others] };
            turned.iter_mut().zip(parts).for_each(|(own, part)| own.extend(part));
        }
        turned.map(|own| Chain::of(self.tracklets, own))
    }

    /// Some of the frames of a block in which both are seen.
    fn both(&self, block: &Block) -> Vec<Both> {
        let place = |own: &[usize], frame: usize| own.iter().find_map(|&t| self.tracklets[t].at(frame));
        let frames = block.ones.iter().flat_map(|&t| self.tracklets[t].first..=self.tracklets[t].last());
        let both: Vec<Both> = frames
            .filter_map(|f| Some((f, place(&block.ones, f)?, place(&block.others, f)?)))
            .filter(|(_, p, q)| p != q)
            .collect();
        let n = both.len().min(FRAMES);
        (0..n).map(|k| both[(2 * k + 1) * both.len() / (2 * n)]).collect()
    }

    fn seen(&self, block: usize, both: &[Both], pair: [usize; 2]) -> Seen {
        let mut sums: BTreeMap<usize, [f64; 4]> = BTreeMap::new();
        for (frame, p, q) in both {
            let (way, middle) = ((p - q).normalize(), 0.5 * (p + q));
            for (other, at) in self.by_frame[*frame].iter().filter(|(o, _)| !pair.contains(o)) {
                let (sum, away) = (sums.entry(*other).or_default(), at - middle);
                let new = [1.0, way.dot(&away), away.norm(), away.norm_squared()];
                sum.iter_mut().zip(new).for_each(|(s, new)| *s += new);
            }
        }
        let off_m = sums.iter().map(|(other, [n, off, ..])| (*other, off / n)).collect();
        let far = sums.iter().map(|(other, [n, _, far, squares])| (*other, [far / n, squares / n])).collect();
        let seen_s = self.times_s[both[both.len() - 1].0] - self.times_s[both[0].0];
        Seen { block, off_m, far, looks: (1.0 + seen_s).min(MOST_LOOKS) }
    }
}

/// What witnesses say of a block (nats): for it as it is, against its two chains exchanged.
fn says(witnesses: &[Witness], seen: &Seen) -> f64 {
    let one = |w: &Witness| {
        let off = seen.off_m.get(&w.other)?;
        let fits = |expected: f64| (-0.5 * ((off - expected) / w.spread_m).powi(2)).exp() + UNFORESEEN;
        Some((fits(w.off_m) / fits(-w.off_m)).ln())
    };
    let heard = witnesses.iter().filter_map(one).take(WITNESSES);
    heard.enumerate().map(|(k, said)| if k == 0 { said } else { SHARE * said }).sum()
}

/// Evidence of each block that it stays, when every witness is on its own side in most of them, and whether others would be
/// clearer if some were exchanged; `None` where nobody tells.
fn stays(seen: &[Seen]) -> Option<(Vec<f64>, bool)> {
    let others = others(seen);
    let proposed = others.iter().map(|&o| settled(seen, &others, o));
    let found = proposed.map(|e| (clearer(seen, &others, &e), e));
    let best = found.reduce(|best, next| if next.0 > best.0 { next } else { best });
    let told = |evidence: &[f64]| heard(seen, &others, evidence).len() >= FEWEST;
    match best {
        Some((gain, e)) if gain > CLEARER && told(&e) && e.iter().any(|e| *e < 0.0) => Some((e, true)),
        _ => {
            let witnesses = heard(seen, &others, &vec![1.0; seen.len()]);
            let say = || seen.iter().map(|s| says(&witnesses, s)).collect();
            (witnesses.len() >= FEWEST).then(|| (say(), false))
        }
    }
}

/// Evidence of each block that it stays, beginning with those in which one of the others is on the one's side, until all that
/// are clear then agree.
fn settled(seen: &[Seen], others: &[usize], first: usize) -> Vec<f64> {
    let mut evidence: Vec<f64> = seen.iter().map(|s| s.off_m.get(&first).copied().unwrap_or(0.0)).collect();
    for _ in 0..ROUNDS {
        let witnesses = heard(seen, others, &evidence);
        let next: Vec<f64> = seen.iter().map(|s| says(&witnesses, s)).collect();
        let stands = next.iter().zip(&evidence).all(|(a, b)| a * b >= 0.0);
        evidence = next;
        if stands {
            break;
        }
    }
    evidence
}

/// How much clearer all others lie off the middle when blocks with evidence against them are exchanged, by the logarithms of
/// their spreads: also those that are less clear then.
fn clearer(seen: &[Seen], others: &[usize], evidence: &[f64]) -> f64 {
    let gain = |other: &usize| {
        let own = |turned: bool| {
            let off =
                |(s, e): (&Seen, &f64)| Some((if turned { e.signum() } else { 1.0 } * s.off_m.get(other)?, s.looks));
            seen.iter().zip(evidence).filter_map(off).collect::<Vec<_>>()
        };
        (spread_of(own(false).into_iter()).1 / spread_of(own(true).into_iter()).1).ln()
    };
    others.iter().map(gain).sum()
}

/// Those of the others, seen beside the two often enough, that are most constantly as far from the middle between them: a
/// distance that exchanging the two does not change.
fn others(seen: &[Seen]) -> Vec<usize> {
    let all: f64 = seen.iter().map(|s| s.looks).sum();
    let mut sums: BTreeMap<usize, [f64; 3]> = BTreeMap::new();
    for one in seen {
        for (other, [far, squares]) in &one.far {
            let sum = sums.entry(*other).or_default();
            *sum = [sum[0] + one.looks, sum[1] + one.looks * far, sum[2] + one.looks * squares];
        }
    }
    let steady = |(other, [n, far, squares]): (usize, [f64; 3])| {
        (n > OFTEN * all).then(|| ((squares / n - (far / n).powi(2)).max(0.0).sqrt(), other))
    };
    let mut found: Vec<(f64, usize)> = sums.into_iter().filter_map(steady).collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    found.into_iter().take(WITNESSES).map(|(_, other)| other).collect()
}

/// Whether two stay as far from each other in almost all of two blocks or more, as markers of one part do.
fn are_steady(both: &[Vec<Both>]) -> bool {
    let mean = |frames: &Vec<Both>| frames.iter().map(|(_, p, q)| (p - q).norm()).sum::<f64>() / frames.len() as f64;
    let mut apart_m: Vec<f64> = both.iter().filter(|frames| !frames.is_empty()).map(mean).collect();
    apart_m.sort_unstable_by(f64::total_cmp);
    let Some(&median) = apart_m.get(apart_m.len() / 2) else { return false };
    let steady = apart_m.iter().filter(|apart| (*apart - median).abs() < STEADY_M).count();
    apart_m.len() >= 2 && steady as f64 >= STEADY * apart_m.len() as f64
}

/// The clearest witnesses when blocks with evidence against them are exchanged.
fn heard(seen: &[Seen], others: &[usize], evidence: &[f64]) -> Vec<Witness> {
    let witness = |&other: &usize| {
        let own = seen.iter().zip(evidence).filter_map(|(s, e)| Some((e.signum() * s.off_m.get(&other)?, s.looks)));
        let (off_m, spread_m) = spread_of(own);
        (off_m.abs() > CLEAR * spread_m).then_some(Witness { other, off_m, spread_m })
    };
    let mut found: Vec<Witness> = others.iter().filter_map(witness).collect();
    let clear = |w: &Witness| w.off_m.abs() / w.spread_m;
    found.sort_by(|a, b| clear(b).total_cmp(&clear(a)).then(a.other.cmp(&b.other)));
    found
}

/// Mean and spread of weighted values.
fn spread_of(values: impl Iterator<Item = (f64, f64)>) -> (f64, f64) {
    let [n, sum, squares] =
        values.fold([0.0; 3], |[n, sum, squares], (v, w)| [n + w, sum + w * v, squares + w * v * v]);
    let mean = sum / f64::max(n, 1e-9);
    let variance = (squares / f64::max(n, 1e-9) - mean * mean).max(0.0);
    (mean, (variance + LEAST_SPREAD * LEAST_SPREAD).sqrt())
}

#[cfg(test)]
mod tests {
    use super::super::joints::Path;
    use super::super::tracklets::Tracklet;
    use super::*;
    use nalgebra::Rotation3;

    const FRAMES: usize = 1200;

    /// A trunk of four, an upper arm of three (its first two 54 mm apart, as far from the third) and a forearm of two; the
    /// first two of the arm are hidden in the last 20 of every 100 frames. Paths by frame.
    fn body() -> Vec<Path> {
        let trunk = [[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.0, 0.2, 0.3], [0.3, 0.2, 0.3]].map(Vector3::from);
        let arm = [[0.12, 0.027, 0.0], [0.12, -0.027, 0.0], [0.2, 0.0, 0.05]].map(Vector3::from);
        let forearm = [[0.08, 0.03, 0.0], [0.2, 0.02, 0.02]].map(Vector3::from);
        let mut paths = vec![Vec::new(); 9];
        for f in 0..FRAMES {
            let t = f as f64 / 100.0;
            let away = Vector3::new(0.2 * t.sin(), 0.1 * t, 1.0);
            let shoulder = Vector3::new(0.3, 0.1, 0.35);
            let turn = Rotation3::from_euler_angles(0.5 * (0.7 * t).sin(), 0.9 * (1.7 * t).sin(), 0.5 * t.cos());
            let bend = turn * Rotation3::from_euler_angles(0.0, 0.0, 0.8 + 0.5 * (2.3 * t).sin());
            let elbow = shoulder + turn * Vector3::new(0.28, 0.0, 0.0);
            let places = trunk.into_iter().chain(arm.map(|p| shoulder + turn * p));
            let places = places.chain(forearm.map(|p| elbow + bend * p));
            for (m, place) in places.enumerate() {
                paths[m].push((!(4..6).contains(&m) || f % 100 < 80).then_some(place + away));
            }
        }
        paths
    }

    /// Tracklets of the paths between their gaps, and of each its path.
    fn pieces(paths: &[Path]) -> (Vec<Tracklet>, Vec<usize>) {
        let mut found = Vec::new();
        for (m, path) in paths.iter().enumerate() {
            let starts = (0..FRAMES).filter(|&f| path[f].is_some() && (f == 0 || path[f - 1].is_none()));
            for first in starts {
                let places: Path = path[first..].iter().copied().take_while(Option::is_some).collect();
                found.push((Tracklet::of_places(first, places), m));
            }
        }
        found.into_iter().unzip()
    }

    #[test]
    fn two_that_were_exchanged_half_of_the_time_are_told_apart_by_the_sides_of_the_others() {
        let paths = body();
        let (tracklets, owner) = pieces(&paths);
        // The first two of the arm have each other's piece every other time.
        let chain_of = |t: usize| match owner[t] {
            m @ (4 | 5) if tracklets[t].first / 100 % 2 == 1 => 9 - m,
            m => m,
        };
        let chains: Vec<Chain> = (0..paths.len())
            .map(|c| {
                let own: Vec<usize> = (0..tracklets.len()).filter(|&t| chain_of(t) == c).collect();
                Chain::of(&tracklets, own)
            })
            .collect();
        let times_s: Vec<f64> = (0..FRAMES).map(|f| f as f64 / 100.0).collect();
        let scene = Scene::new(&tracklets, &times_s, &chains, &[]);
        let found = scene.exchanges();
        let exchange = found.iter().find(|h| h.chains == [4, 5]).expect("they are exchanged");
        for own in &exchange.tracklets {
            let owners: Vec<usize> = own.iter().map(|&t| owner[t]).collect();
            assert!(owners.windows(2).all(|w| w[0] == w[1]), "{owners:?}");
        }
        // Nobody else is exchanged.
        assert!(found.iter().all(|h| h.chains == [4, 5]));
    }
}
