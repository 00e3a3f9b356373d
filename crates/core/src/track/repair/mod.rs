//! What a whole take knows better than its single frames: identities that hold from end to end.
//!
//! 1. [`tracklets`]: the forward pass's trajectories are cut wherever their identity could be wrong, by where motion leads
//!    (`ahead`, `ends`) and where links break (`breaks`, asked where there is doubt: `doubts`); once there are chains, also
//!    where one slid from one chain's marker to another's (`slides`), and its parts are joined anew. Pieces that follow
//!    another one's marker go or become one with it (`twins`).
//! 2. [`join`]: the pieces are joined by the dynamic model, joint centres ([`joints`]) and motion (`bridge`); then two
//!    chains at a time (`exchange`, and `sides` where their histories are mixed) and whole limbs (`relabel`) hand out their
//!    pieces anew, and three of which only two are ever seen at once become two (`absorb`). Where two rays met by
//!    chance now and then there is no marker (`loose`).
//! 3. `confusion`: near markers that were taken for each other are found out by the frame of their neighbours, of different
//!    parts by the place of the one that keeps it (`settled`), their distances from a third one (`thirds`), the direction
//!    between them (`direction`) and motion (`onward`); how far the place of one is to be believed while the other is hidden
//!    is learned (`alone`). What active markers told of themselves stands above all that (`told`), read with all cameras
//!    together where their brightness is known.
//! 4. [`extend`]: trajectories are followed into their gaps, backwards and forwards, on the dots that nobody owns; also into
//!    the first frames of the take.
//! 5. [`carry`]: what stays hidden is predicted from both ends of each gap; samples of two rays that are rather two
//!    hidden markers' go (`chance`); where free dots lie that are no other hidden marker's, it is measured (`regain`). Two
//!    near markers that cameras see as one dot are measured together (`close`), looked at once more for confusion, and looked
//!    for on free dots once more.

mod absorb;
mod ahead;
mod alone;
mod breaks;
mod bridge;
pub mod carry;
mod chance;
mod close;
mod confusion;
mod direction;
mod doubts;
mod ends;
mod exchange;
pub mod extend;
pub mod join;
pub mod joints;
mod loose;
mod onward;
mod regain;
mod relabel;
mod settled;
mod sides;
mod slides;
mod thirds;
mod told;
pub mod tracklets;
mod twins;

use super::{Sample, Shot, TrackOptions, Tracked};
use crate::correspond::scene::Scene;
use breaks::{cut_at_breaks, cut_at_slides};
use carry::{carry, forget_carried};
use chance::Take;
use close::measure_close;
use confusion::untangle;
use extend::{extend, forget_the_beginning, recall_the_beginning};
use join::{Chain, join};
use regain::regain;
use told::follow_told;
use tracklets::{TORN, TORN_POINTS, Tracklet, cut};
use twins::without_twins;

/// How much of the work identities are (0–1).
const IDENTIFIED: f64 = 0.9;

/// How bright the dots of a take are.
#[derive(Clone, Copy, Debug)]
pub struct Lights<'a> {
    /// Number of each frame.
    pub frames: &'a [i64],
    /// Place of each frame's first dot among all.
    pub starts: &'a [usize],
    /// Brightness of every dot (any unit; NaN where it is not known).
    pub brightness: &'a [f64],
}

/// Repairs a recorded take. `shots`, `times_s`: dots and time of each frame; `lights`: their brightness, where it is known;
/// `scenes`: the index of the first frame from which on each holds, in ascending order from 0; `told`: how much is done
/// (0–1), every now and then.
pub fn repair(
    scenes: &[(usize, &Scene)],
    options: &TrackOptions,
    frames: &[Tracked],
    shots: &[Shot],
    times_s: &[f64],
    lights: Option<Lights>,
    told: &dyn Fn(f64),
) -> Vec<Tracked> {
    let mut repaired = identify(frames, times_s, TORN, Some(shots), &|part| told(IDENTIFIED * part));
    follow_told(&mut repaired, shots, scenes, times_s, lights);
    told(IDENTIFIED);
    let forgotten = forget_the_beginning(&mut repaired);
    extend(scenes, shots, times_s, &mut repaired);
    recall_the_beginning(&mut repaired, forgotten);
    carry(&mut repaired, times_s, options.memory_s, options.largest_sigma_m);
    Take { scenes, shots, times_s, options }.without_chance(&mut repaired);
    let regained = regain(scenes, shots, times_s, &mut repaired);
    if measure_close(scenes, shots, times_s, &mut repaired) || regained {
        forget_carried(&mut repaired);
        untangle(&mut repaired, times_s);
        carry(&mut repaired, times_s, options.memory_s, options.largest_sigma_m);
        if regain(scenes, shots, times_s, &mut repaired) {
            forget_carried(&mut repaired);
            carry(&mut repaired, times_s, options.memory_s, options.largest_sigma_m);
        }
    }
    repaired
}

/// Repairs a recorded take of points: there are no dots to prolong a trajectory on.
pub fn repair_points(options: &TrackOptions, frames: &[Tracked], times_s: &[f64], told: &dyn Fn(f64)) -> Vec<Tracked> {
    let mut repaired = identify(frames, times_s, TORN_POINTS, None, &|part| told(IDENTIFIED * part));
    told(IDENTIFIED);
    carry(&mut repaired, times_s, options.memory_s, options.largest_sigma_m);
    repaired
}

/// Measured samples under the identities that the whole take gives them.
fn identify(
    frames: &[Tracked],
    times_s: &[f64],
    torn: f64,
    shots: Option<&[Shot]>,
    told: &dyn Fn(f64),
) -> Vec<Tracked> {
    let mut cut = cut(frames, times_s, torn);
    if let Some(shots) = shots {
        cut = without_twins(cut, frames, shots);
    }
    cut = cut_at_breaks(&cut, frames, times_s).unwrap_or(cut);
    let mut chains = join(&cut.0, Vec::new(), times_s, &|part| told(0.5 * part));
    // Those that are joined tell more.
    if let Some((anew, left)) = cut_at_slides(&cut, &chains, frames, times_s) {
        cut = anew;
        chains = join(&cut.0, left, times_s, &|part| told(0.5 + 0.5 * part));
    }
    let (tracklets, owner) = cut;
    let identity = identities(&tracklets, &chains);
    let renamed = |(frame, owner): (&Tracked, &Vec<Option<usize>>)| {
        let named = |(sample, tracklet): (&Sample, &Option<usize>)| {
            let track = identity[(*tracklet)?]?;
            Some(Sample { track, confirmed: true, ..sample.clone() })
        };
        let mut samples: Vec<Sample> = frame.samples.iter().zip(owner).filter_map(named).collect();
        samples.sort_by_key(|s| s.track);
        Tracked { samples, ..*frame }
    };
    let mut named: Vec<Tracked> = frames.iter().zip(&owner).map(renamed).collect();
    untangle(&mut named, times_s);
    named
}

/// Identity of each tracklet: the first of its chain's; `None` for what is no marker.
fn identities(tracklets: &[Tracklet], chains: &[Chain]) -> Vec<Option<u32>> {
    let mut identity = vec![None; tracklets.len()];
    let mut chains: Vec<&Chain> = chains.iter().collect();
    chains.sort_by_key(|c| c.tracklets[0]);
    for (number, chain) in chains.into_iter().enumerate() {
        chain.tracklets.iter().for_each(|&t| identity[t] = Some(number as u32));
    }
    identity
}

/// The scene that holds in the frame of an index.
fn scene_of<'a>(scenes: &[(usize, &'a Scene)], index: usize) -> &'a Scene {
    scenes[scenes.partition_point(|s| s.0 <= index) - 1].1
}
