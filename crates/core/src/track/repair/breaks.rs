//! Tracklets that go on with another marker, found out by their links.
//!
//! Two markers that pass each other while one or both are hidden for a frame or two may leave no trace in their motion. But
//! what kept its distance from one of them changes it from then on. A tracklet is cut where the links of the part before do not
//! hold after it, and those of the part after did not hold before; what belongs together is joined again with more to go by
//! (`join.rs`).

use super::doubts::doubts;
use super::join::{Chain, Scene};
use super::slides::slides;
use super::tracklets::{Cut, Tracklet};
use crate::track::Tracked;
use rayon::prelude::*;

/// Measured frames that a part needs to tell of its links.
const LEAST: usize = 12;
/// Frames after a doubtful moment that are looked at.
const LOOK: usize = 100;

/// Tracklets cut where their links to the others break; `None` if they hold everywhere.
pub(super) fn cut_at_breaks(cut: &Cut, frames: &[Tracked], times_s: &[f64]) -> Option<Cut> {
    let chains = singles(&cut.0);
    let found = breaks(&Scene::new(&cut.0, times_s, &chains, &[]), &doubts(cut, frames));
    cut_at(cut, &found, frames).map(|(cut, _)| cut)
}

/// The same once there are chains, which tell more: also where a tracklet slid from one's marker to another's. With what is
/// left of the chains when the parts of those that were cut are out.
pub(super) fn cut_at_slides(
    cut: &Cut,
    chains: &[Chain],
    frames: &[Tracked],
    times_s: &[f64],
) -> Option<(Cut, Vec<Chain>)> {
    let scene = Scene::new(&cut.0, times_s, chains, &[]);
    let mut found = breaks(&scene, &doubts(cut, frames));
    for ((found, slides), one) in found.iter_mut().zip(slides(&scene)).zip(&cut.0) {
        let apart = |a: usize, b: usize| one.within(a.min(b)..a.max(b)).measured >= LEAST;
        let new: Vec<usize> = slides.into_iter().filter(|&f| found.iter().all(|&b| apart(b, f))).collect();
        found.extend(new);
        found.sort_unstable();
    }
    let (anew, numbers) = cut_at(cut, &found, frames)?;
    let whole = |chain: &Chain| {
        let left = chain.tracklets.iter().filter(|&&t| found[t].is_empty()).map(|&t| numbers[t]);
        Chain::of(&anew.0, left.collect())
    };
    let left = chains.iter().map(whole).filter(|c| !c.tracklets.is_empty()).collect();
    Some((anew, left))
}

/// Tracklets cut at some frames of each, and the number of each one's first part; `None` if there are none.
fn cut_at((tracklets, owner): &Cut, breaks: &[Vec<usize>], frames: &[Tracked]) -> Option<(Cut, Vec<usize>)> {
    if breaks.iter().all(Vec::is_empty) {
        return None;
    }
    let mut numbers = vec![0];
    breaks.iter().for_each(|b| numbers.push(numbers[numbers.len() - 1] + 1 + b.len()));
    let mut parts: Vec<Option<Tracklet>> = vec![None; numbers[breaks.len()]];
    let mut owner = owner.clone();
    for (f, (frame, owner)) in frames.iter().zip(&mut owner).enumerate() {
        for (sample, owner) in frame.samples.iter().zip(owner) {
            let Some(t) = *owner else { continue };
            let part = numbers[t] + breaks[t].partition_point(|&from| from <= f);
            let Tracklet { first_track, followed, .. } = tracklets[t];
            let known = if part == numbers[t] { (first_track, followed) } else { (sample.track, 0.0) };
            let new = || Tracklet { first_track: known.0, followed: known.1, ..Tracklet::starting(f) };
            parts[part].get_or_insert_with(new).take_in(f, sample);
            *owner = Some(part);
        }
    }
    Some(((parts.into_iter().flatten().collect(), owner), numbers))
}

/// Each tracklet as a chain.
fn singles(tracklets: &[Tracklet]) -> Vec<Chain> {
    (0..tracklets.len()).map(|t| Chain::of(tracklets, vec![t])).collect()
}

/// The chain of each tracklet; `usize::MAX` for one that is in none.
pub(super) fn chain_of(scene: &Scene) -> Vec<usize> {
    let mut chain_of = vec![usize::MAX; scene.tracklets.len()];
    for (c, chain) in scene.chains.iter().enumerate() {
        chain.tracklets.iter().for_each(|&t| chain_of[t] = c);
    }
    chain_of
}

/// For each tracklet the frames, of those in doubt, from which on its links to others are another marker's.
fn breaks(scene: &Scene, doubts: &[Vec<usize>]) -> Vec<Vec<usize>> {
    let chain_of = chain_of(scene);
    let breaks_of = |t: usize| scene.breaks_of(&scene.tracklets[t], chain_of[t], &doubts[t]);
    (0..chain_of.len()).into_par_iter().map(breaks_of).collect()
}

impl Scene<'_> {
    /// Frames from which on a tracklet of a chain is another marker, of those in doubt.
    fn breaks_of(&self, one: &Tracklet, chain: usize, doubts: &[usize]) -> Vec<usize> {
        let mut found = Vec::new();
        let mut from = one.first;
        for &doubt in doubts {
            let (before, after) = (one.within(from..doubt), one.within(doubt..(doubt + LOOK).min(one.last() + 1)));
            if before.measured.min(after.measured) < LEAST {
                continue;
            }
            let fits = |part: &Tracklet, of: &Tracklet| {
                Self::links(&self.profile_by(&[part], &[chain]), &self.distances_by(&[of]))
            };
            if fits(&before, &after) < 0.0 && fits(&after, &before) < 0.0 {
                from = doubt;
                found.push(doubt);
            }
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, Vector3};

    const FRAMES: usize = 300;
    /// One marker is hidden in this frame.
    const HIDDEN: usize = 150;

    /// Where a marker of one of two bodies is, each of which turns in its own way; they meet in the hidden frame.
    fn place(body: usize, at: [f64; 3], f: usize) -> Vector3<f64> {
        let t = (f as f64 - HIDDEN as f64) / 100.0;
        let way = [1.0, -1.0][body];
        let turn = Rotation3::from_euler_angles(way * t, 0.5 * (1.3 * t).sin(), 0.8 * way * t);
        turn * Vector3::from(at) + Vector3::new(0.2 * way * t, 0.1 * t, 1.0)
    }

    const CORNERS: [[f64; 3]; 4] = [[0.2, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.2], [-0.1, -0.1, 0.1]];

    /// What is found when the last tracklet goes on with a marker of this body after the hidden frame.
    fn found(body_after: usize) -> Vec<Vec<usize>> {
        let of_body = |body: usize| {
            CORNERS.map(|at| Tracklet::of_places(0, (0..FRAMES).map(|f| Some(place(body, at, f))).collect()))
        };
        let at = |f: usize| {
            let body = if f < HIDDEN { 0 } else { body_after };
            (f != HIDDEN).then(|| place(body, [0.05, 0.05, 0.0], f))
        };
        let mut tracklets: Vec<Tracklet> = [of_body(0), of_body(1)].concat();
        tracklets.push(Tracklet::of_places(0, (0..FRAMES).map(at).collect()));
        let times_s: Vec<f64> = (0..FRAMES).map(|f| f as f64 / 100.0).collect();
        let chains = singles(&tracklets);
        let mut doubts = vec![Vec::new(); tracklets.len()];
        doubts[8] = vec![HIDDEN + 1];
        breaks(&Scene::new(&tracklets, &times_s, &chains, &[]), &doubts)
    }

    #[test]
    fn a_tracklet_that_goes_on_with_another_bodys_marker_is_cut_where_it_was_hidden() {
        let mut expected = vec![Vec::new(); 9];
        assert_eq!(found(0), expected, "the same marker comes back");
        expected[8] = vec![HIDDEN + 1];
        assert_eq!(found(1), expected);
    }
}
