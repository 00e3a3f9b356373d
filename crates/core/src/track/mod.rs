//! Trajectories: every marker followed through time, one frame after the other.
//!
//! A frame goes through these stages ([`Tracker::push`]):
//! 1. **predict** (`filter.rs`; hidden markers also from their neighbours, `body/`);
//! 2. **confirm**: per camera, dots are assigned to the predictions (`matching.rs`: seen in `views.rs`, near dots from
//!    `strips.rs`, their likelihood in `innovation.rs`, the best pairs in `pairs.rs`); per marker, its dots must meet in
//!    one point (`locate.rs`). Lee et al. 2000, §3: what is known already need not be searched for. A marker that a camera
//!    saw before takes its dot back from one that it did not (`reclaim.rs`);
//! 3. **search**: markers not found are looked for where their neighbours, now known, say they are;
//! 4. **fall back**: only dots that nobody owns go through the full correspondence; its points are offered to lost
//!    markers first (`rematch.rs`; §5.2's global re-matching), what is left may be born. Points of a part that turned
//!    sharply are handed out anew as its shape says (`regroup.rs`), those of two near markers as their neighbours do
//!    (`exchange.rs`);
//! 5. **settle**: filters and the dynamic model learn, births are confirmed, second trajectories of one marker are given
//!    up (`duplicate.rs`), the lost are forgotten after a while.
//!
//! The tracker is causal and deterministic: what [`Tracker::push`] returns depends on the frames so far and on nothing
//! else. What later frames reveal is worked in by `repair/`, over a whole take.

mod adapt;
pub mod body;
mod clock;
mod contact;
mod crowd;
mod duplicate;
mod exchange;
pub mod filter;
mod flow;
mod frame;
mod innovation;
mod locate;
mod marker;
mod matching;
mod pairs;
pub mod paper;
pub mod points;
mod reclaim;
mod regroup;
mod rematch;
pub mod repair;
mod share;
mod start;
mod strips;
mod threads;
mod views;
mod visibility;

pub use clock::{Moment, TimeError};
pub use flow::{Shot, at_moments};
pub use start::Start;

use adapt::Adaptation;

use crate::camera::{Camera, Rig};
use crate::correspond::Group;
use crate::correspond::frame::{Dot, PreparedFrame};
use crate::correspond::optimal::{OptimalOptions, optimal};
use crate::correspond::scene::{Scene, SceneModel};
use crate::reconstruct::{ReconstructError, ReconstructOptions, estimate_model};
use crowd::Crowd;
use flow::{Flow, Motion, at_moment, motion_of};
use frame::Frame;
use locate::{LocateGates, Located, locate};
use marker::Marker;
use matching::{Prior, match_cameras};
use nalgebra::{Matrix3, Vector2, Vector3};
use share::Merging;
use thiserror::Error;

/// How a position came about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// At least two rays of this frame met.
    Measured,
    /// Carried by motion and neighbours, with one ray or none.
    Predicted,
}

/// One marker in one frame.
#[derive(Clone, Debug)]
pub struct Sample {
    /// Identity of the trajectory.
    pub track: u32,
    /// Position (m, world).
    pub point: Vector3<f64>,
    /// Covariance of the position (m²).
    pub covariance: Matrix3<f64>,
    /// Measured or predicted.
    pub kind: Kind,
    /// Indices of its dots in the frame, ascending.
    pub dots: Vec<u32>,
    /// Root mean square distance of dots and reprojections (px); 0 without dots.
    pub residual_px: f64,
    /// Mean distance of point and rays (m).
    pub ray_distance_m: f64,
    /// Probability that the trajectory is a marker.
    pub confidence: f64,
    /// The velocity (m/s) by which its rays were moved, where cameras saw different moments.
    pub velocity: Vector3<f64>,
    /// The identity that the marker told, if it is an active one.
    pub hardware: Option<u32>,
    /// Whether the trajectory was believed when the frame was pushed; others may turn out to be markers or ghosts later.
    pub confirmed: bool,
}

impl Sample {
    /// A believed sample, as yet without what its rays say.
    fn new(
        track: u32,
        (point, covariance): (Vector3<f64>, Matrix3<f64>),
        kind: Kind,
        dots: &[u32],
        confidence: f64,
    ) -> Self {
        let (residual_px, ray_distance_m) = (0.0, 0.0);
        let dots = dots.to_vec();
        let velocity = Vector3::zeros();
        Self {
            track,
            point,
            covariance,
            kind,
            dots,
            residual_px,
            ray_distance_m,
            confidence,
            velocity,
            hardware: None,
            confirmed: true,
        }
    }

    /// Adds how far its own dots are from where it is; loans go.
    fn with_rays(mut self, frame: &Frame) -> Self {
        self.dots.retain(|&d| !frame.is_lent(d));
        let (mut squared_px, mut distance) = (0.0, 0.0);
        let motion = Motion { velocity: self.velocity, variance: 0.0 };
        for &dot in &self.dots {
            let sight = frame.ray(dot, &motion, &self.point);
            squared_px += sight.linearise(&self.point).error.norm_squared() * sight.sigma_px.powi(2);
            distance += (self.point - sight.origin).cross(&sight.direction).norm();
        }
        let n = self.dots.len().max(1) as f64;
        (self.residual_px, self.ray_distance_m) = ((squared_px / n).sqrt(), distance / n);
        self
    }
}

/// Why a take or a frame cannot be tracked.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum TrackError {
    /// A frame has no place in time.
    #[error(transparent)]
    Time(#[from] TimeError),
    /// The rig cannot give a depth.
    #[error(transparent)]
    Rig(#[from] ReconstructError),
}

/// What one frame gave.
#[derive(Clone, Debug, Default)]
pub struct Tracked {
    /// Samples in ascending order of track.
    pub samples: Vec<Sample>,
    /// Dots that had to go through the full correspondence.
    pub searched_dots: usize,
    /// Whether the frame had more dots than the tracker looks at.
    pub overfull: bool,
    /// Whether the correspondence of the dots that were searched is proven optimal.
    pub certified: bool,
}

/// What the full correspondence of the left-over dots gave.
struct Searched {
    groups: Vec<Group>,
    /// By dot, the marker that had to make do with it alone.
    claims: Vec<Option<usize>>,
    dots: usize,
    overfull: bool,
    certified: bool,
}

/// Options of a tracker. None of them needs to be set.
#[derive(Clone, Copy, Debug)]
pub struct TrackOptions {
    /// How long the identity of a lost marker is kept (s). Too short makes new trajectories, too long fills memory.
    pub memory_s: f64,
    /// Predicted samples with a larger spread are not given out (m).
    pub largest_sigma_m: f64,
    /// Limits of the full correspondence of what is left over.
    pub fall_back: OptimalOptions,
}

impl Default for TrackOptions {
    fn default() -> Self {
        let mut fall_back = OptimalOptions::default();
        fall_back.enumerate.step_limit = 100_000;
        fall_back.node_limit = 2_000;
        Self { memory_s: 10.0, largest_sigma_m: 0.1, fall_back }
    }
}

/// Left-over dots beyond which the full correspondence is not tried, so that time stays bounded: this many, or so many
/// times the dots of a usual frame.
const MOST_LEFT_OVER: usize = 600;
const MOST_TIMES_USUAL: f64 = 3.0;
/// Weight of one frame in what is usual.
const USUAL: f64 = 0.05;
/// A marker is not born nearer than this to a known one: if three rays meet there, and if only two do (m). Markers are not
/// smaller, and two rays may be a known marker's half-hidden image.
const SMALLEST_DISTANCE: f64 = 0.006;
const SMALLEST_DISTANCE_OF_PAIRS: f64 = 0.012;
/// Left-over dots nearer to an owned one are its halves (px).
const SAME_BLOB_PX: f64 = 1.2;
/// Markers expected to appear from nowhere in one frame.
const BIRTHS_PER_FRAME: f64 = 0.1;

/// Follows markers through the frames of one rig.
pub struct Tracker {
    scene: Scene,
    gates: LocateGates,
    crowd: Crowd,
    /// `None` where the prior was given.
    adaptation: Option<Adaptation>,
    /// Dots of a usual frame.
    usual_dots: Option<f64>,
    merging: Merging,
    flow: Flow,
}

impl Tracker {
    /// A tracker with a known prior.
    pub fn new(rig: &Rig, model: &SceneModel, rate_hz: f64, options: TrackOptions) -> Result<Self, TrackError> {
        let scene = Scene::new(rig, model);
        Ok(Self {
            gates: LocateGates::new(&scene),
            scene,
            crowd: Crowd::new(rate_hz, options)?,
            adaptation: None,
            usual_dots: None,
            merging: Merging::default(),
            flow: Flow::default(),
        })
    }

    /// A tracker that learns its prior from the frames as they come. `noise_px`: noise of the dots, where it is known.
    pub fn learning(rig: &Rig, noise_px: Option<f64>, rate_hz: f64, options: TrackOptions) -> Result<Self, TrackError> {
        let mut reconstruct = ReconstructOptions::default();
        reconstruct.estimate.noise = noise_px;
        let model = estimate_model(rig, &[], &reconstruct)?;
        let tracker = Self::new(rig, &model, rate_hz, options)?;
        Ok(Self { adaptation: Some(Adaptation::new(noise_px)), ..tracker })
    }

    /// The same tracker, for markers whose places to each other are known before the first frame.
    #[must_use]
    pub fn starting_from(mut self, start: Option<Start>) -> Self {
        self.crowd.start = start;
        self
    }

    /// Follows the markers into the next frame. The order of the dots does not matter.
    pub fn push(&mut self, dots: &[Dot], moment: Moment) -> Result<Tracked, TrackError> {
        self.push_from_clocks(dots, moment, &[])
    }

    /// The same where cameras saw the frame at different moments: `lag_s` by camera, how much later than the frame's moment
    /// (s); empty if all saw one.
    pub fn push_from_clocks(&mut self, dots: &[Dot], moment: Moment, lag_s: &[f64]) -> Result<Tracked, TrackError> {
        let order = place_order(dots);
        let sorted: Vec<Dot> = order.iter().map(|&i| dots[i as usize]).collect();
        let mut tracked = self.push_sorted(&sorted, moment, lag_s)?;
        for sample in &mut tracked.samples {
            sample.dots.iter_mut().for_each(|d| *d = order[*d as usize]);
            sample.dots.sort_unstable();
        }
        Ok(tracked)
    }

    fn push_sorted(&mut self, dots: &[Dot], moment: Moment, lag_s: &[f64]) -> Result<Tracked, TrackError> {
        self.crowd.advance(moment)?;
        let flow = self.flow_of(dots, lag_s);
        if lag_s.is_empty() {
            self.adapt(dots);
        } else {
            let then = |(dot, flow): (&Dot, &Option<Vector2<f64>>)| {
                at_moment(dot, *flow, lag_s[dot.camera], self.crowd.clock.interval_s())
            };
            let dots: Vec<Dot> = dots.iter().zip(&flow).filter_map(then).collect();
            self.adapt(&dots);
        }
        let mut frame = Frame::new(&self.scene, dots);
        (frame.lag_s, frame.flow) = (lag_s.to_vec(), flow);
        self.assign(&mut frame, |m| m.confirmed);
        self.search(&mut frame);
        self.assign(&mut frame, |m| !m.confirmed);
        self.give_back(&mut frame);
        self.regate(&mut frame);
        self.reclaim(&mut frame);
        self.share(&mut frame);
        let searched = self.fall_back(&frame);
        let groups = self.rematch(&mut frame, &searched);
        if !searched.overfull {
            let usual = self.usual_dots.unwrap_or(dots.len() as f64);
            self.usual_dots = Some(usual + USUAL * (dots.len() as f64 - usual));
        }
        self.crowd.regroup();
        self.crowd.exchange();
        self.crowd.settle();
        self.crowd.decide_contacts();
        self.crowd.watch(&frame, self.scene.model.detection);
        self.crowd.drop_duplicates(&frame);
        self.give_birth(&frame, &groups);
        self.crowd.hear(&frame);
        let samples = self.crowd.samples(|p| self.scene.model.region.contains(p));
        self.crowd.learn_and_forget();
        Ok(Tracked {
            samples: threads::map(samples, dots.len(), |s| s.with_rays(&frame)),
            searched_dots: searched.dots,
            overfull: searched.overfull,
            certified: searched.certified,
        })
    }

    fn adapt(&mut self, dots: &[Dot]) {
        if let Some(model) = self.adaptation.as_mut().and_then(|a| a.take_in(&self.scene.rig, dots)) {
            self.scene = Scene::new(&self.scene.rig, &model);
            self.gates = LocateGates::new(&self.scene);
        }
    }

    /// What the tracker believes about the take.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Number and time (s) of the last frame.
    pub fn moment(&self) -> (i64, f64) {
        (self.crowd.clock.frame, self.crowd.clock.time_s)
    }

    /// From the next frame on, a camera stands elsewhere. Gives the scene until then.
    pub fn replace_camera(&mut self, index: usize, camera: Camera) -> Scene {
        let mut rig = self.scene.rig.clone();
        rig.cameras[index] = camera;
        let next = Scene::new(&rig, &self.scene.model);
        std::mem::replace(&mut self.scene, next)
    }

    /// Looks for confirmed markers that were not found where their neighbours say they are.
    fn search(&mut self, frame: &mut Frame) {
        if self.crowd.markers.iter().all(|m| !m.confirmed || m.is_found()) {
            return;
        }
        for marker in self.crowd.markers.iter_mut().filter(|m| m.confirmed && !m.is_found()) {
            marker.release(&mut frame.free);
        }
        self.crowd.carry_lost();
        self.assign(frame, |m| m.confirmed && !m.is_found());
    }

    /// Assigns free dots to some of the markers and checks that each marker's dots meet.
    fn assign(&mut self, frame: &mut Frame, which: impl Fn(&Marker) -> bool) {
        let priors: Vec<Option<Prior>> = self.crowd.markers.iter().map(|m| which(m).then_some(m.prior)).collect();
        let found = match_cameras(&self.scene, frame, &priors, |_, _| true);
        let (scene, gates) = (&self.scene, &self.gates);
        let asked = self.crowd.markers.iter_mut().zip(&found).filter(|(_, dots)| !dots.is_empty());
        let markers = threads::map(asked.collect(), found.iter().map(Vec::len).sum(), |(marker, dots)| {
            marker.located = locate(scene, gates, frame, dots, &marker.prior);
            marker
        });
        markers.into_iter().for_each(|marker| marker.claim(&mut frame.free));
    }

    /// Offers left-over dots to markers that are known well by now, camera by camera.
    fn regate(&mut self, frame: &mut Frame) {
        let priors: Vec<Option<Prior>> =
            self.crowd.markers.iter().map(|m| m.is_found().then(|| m.posterior_prior())).collect();
        let cameras = frame.by_camera.len();
        let mut seen = vec![false; cameras * priors.len()];
        let by_marker = seen.chunks_exact_mut(cameras.max(1));
        self.crowd.markers.iter().zip(by_marker).for_each(|(marker, seen)| marker.has_dots_of(frame, seen));
        let more = match_cameras(&self.scene, frame, &priors, |camera, who| !seen[who * cameras + camera]);
        for (marker, more) in self.crowd.markers.iter_mut().zip(more).filter(|(_, more)| !more.is_empty()) {
            let mut dots = more;
            dots.extend(marker.located.iter().flat_map(|l| &l.dots));
            dots.sort_unstable();
            if let Some(better) = locate(&self.scene, &self.gates, frame, &dots, &marker.prior)
                && marker.located.as_ref().is_none_or(|l| better.dots.len() > l.dots.len())
            {
                marker.release(&mut frame.free);
                marker.located = Some(better);
                marker.claim(&mut frame.free);
            }
        }
    }

    /// The full correspondence of what no marker's place is known by: dots that nobody owns, and those with which a marker
    /// that is not found has to make do.
    fn fall_back(&mut self, frame: &Frame) -> Searched {
        let claims = self.single_claims(frame.dots.len());
        let unexplained = |d: usize| frame.sights[d].is_some() && (frame.free[d] || claims[d].is_some());
        let mut left: Vec<usize> =
            (0..frame.dots.len()).filter(|&d| unexplained(d) && !is_half(frame, &claims, d)).collect();
        let then = |d: &usize| self.as_of_moment(frame, *d);
        left.retain(|d| then(d).is_some());
        let dots: Vec<Dot> = left.iter().filter_map(then).collect();
        let live = self.crowd.markers.iter().filter(|m| m.is_found()).count() as f64;
        let lost = self.crowd.markers.iter().filter(|m| !m.is_found()).count() as f64;
        let missing =
            (self.scene.model.expected_markers - live).max(0.0).min(if live == 0.0 { f64::MAX } else { lost });
        self.scene.ln_expected = (missing + BIRTHS_PER_FRAME).ln();
        let mut searched =
            Searched { groups: Vec::new(), claims, dots: left.len(), overfull: false, certified: left.len() < 2 };
        if left.len() < 2 {
            return searched;
        }
        let most = MOST_LEFT_OVER.max((MOST_TIMES_USUAL * self.usual_dots.unwrap_or(f64::MAX)) as usize);
        if left.len() > most {
            searched.overfull = true;
            return searched;
        }
        let prepared = PreparedFrame::new(&self.scene, &dots);
        let solved = optimal(&self.scene, &prepared, &self.crowd.options.fall_back);
        searched.certified = solved.certified;
        searched.groups = solved.groups;
        for group in &mut searched.groups {
            group.dots.iter_mut().for_each(|d| *d = left[*d]);
        }
        searched
    }

    /// A dot as of the frame's moment.
    fn as_of_moment(&self, frame: &Frame, dot: usize) -> Option<Dot> {
        let one = &frame.dots[dot];
        let flow = frame.flow.get(dot).copied().flatten();
        at_moment(one, flow, frame.lag_s(one.camera), self.crowd.clock.interval_s())
    }

    /// How the dots move in the image, where cameras saw different moments.
    fn flow_of(&mut self, dots: &[Dot], lag_s: &[f64]) -> Vec<Option<Vector2<f64>>> {
        if lag_s.is_empty() {
            return Vec::new();
        }
        let times_s: Vec<f64> = lag_s.iter().map(|lag| self.crowd.clock.time_s + lag).collect();
        self.flow.take_in(&self.scene.rig, dots, &times_s)
    }

    /// By dot, the index of the marker that has it and no second one.
    fn single_claims(&self, dots: usize) -> Vec<Option<usize>> {
        let mut claims = vec![None; dots];
        for (index, marker) in self.crowd.markers.iter().enumerate().filter(|(_, m)| !m.is_found()) {
            for &dot in marker.located.iter().flat_map(|l| &l.dots) {
                if let Some(claim) = claims.get_mut(dot as usize) {
                    *claim = Some(index);
                }
            }
        }
        claims
    }

    /// Gives new points to lost markers; returns those that are nobody's.
    fn rematch(&mut self, frame: &mut Frame, searched: &Searched) -> Vec<Group> {
        let told: Vec<Option<u32>> = searched.groups.iter().map(|g| told_by(frame, g)).collect();
        let owners = self.crowd.owners(&searched.groups, &told, rematch::WORST);
        let interval_s = self.crowd.clock.interval_s();
        let mut left = Vec::new();
        for ((group, owner), told) in searched.groups.iter().zip(owners).zip(told) {
            let owner = owner.or_else(|| self.impostor(frame, group, told));
            let claimed: Vec<usize> = group.dots.iter().filter_map(|&d| searched.claims[d]).collect();
            // Two hidden markers, each seen by one camera, explain two dots that happen to meet.
            if owner.is_none() && !claimed.is_empty() && group.dots.len() < 3 {
                continue;
            }
            for other in claimed {
                self.crowd.markers[other].release(&mut frame.free);
            }
            let Some(owner) = owner else {
                left.push(group.clone());
                continue;
            };
            let marker = &mut self.crowd.markers[owner];
            marker.release(&mut frame.free);
            let motion = motion_of(&self.scene.rig, frame, &dots_of(group), &group.point, interval_s);
            marker.refind(Located::at(&self.scene, frame, dots_of(group), group.point, &motion));
            marker.claim(&mut frame.free);
        }
        left
    }

    /// The marker that bears an identity which a point tells, while its own dots do not: it is another's place that it holds.
    fn impostor(&self, frame: &Frame, group: &Group, told: Option<u32>) -> Option<usize> {
        let told = told.filter(|_| group.dots.iter().filter(|&&d| frame.dots[d].hardware.is_some()).count() >= 2)?;
        let bears = |m: &Marker| {
            m.hardware == Some(told)
                && !m
                    .located
                    .iter()
                    .flat_map(|l| &l.dots)
                    .any(|&d| frame.dots.get(d as usize).is_some_and(|dot| dot.hardware == Some(told)))
        };
        self.crowd.markers.iter().position(bears)
    }

    /// New markers from points that are nobody's.
    fn give_birth(&mut self, frame: &Frame, groups: &[Group]) {
        // Before anything is known of how dots move, only cameras of one clock could tell.
        if !frame.lag_s.is_empty() && frame.flow.iter().all(Option::is_none) {
            return;
        }
        let first = self.crowd.is_new();
        for group in groups {
            let near = |m: &Marker| {
                let smallest = if group.dots.len() < 3 { SMALLEST_DISTANCE_OF_PAIRS } else { SMALLEST_DISTANCE };
                let least = smallest.max(2.0 * group.covariance.trace().sqrt());
                m.is_found() && (m.filter.position - group.point).norm() < least
            };
            if self.crowd.markers.iter().any(near) || group.confidence < 0.5 {
                continue;
            }
            let confirmed = first && group.dots.len() >= 3 && group.confidence > 0.9;
            let motion =
                motion_of(&self.scene.rig, frame, &dots_of(group), &group.point, self.crowd.clock.interval_s());
            let found = Located::at(&self.scene, frame, dots_of(group), group.point, &motion);
            self.crowd.give_birth((found, motion), group.confidence, confirmed);
        }
    }
}

/// The identity that a group's dots tell: pairs of dots that tell different ones do not match.
fn told_by(frame: &Frame, group: &Group) -> Option<u32> {
    group.dots.iter().find_map(|&d| frame.dots[d].hardware)
}

fn dots_of(group: &Group) -> Vec<u32> {
    let mut dots: Vec<u32> = group.dots.iter().map(|&d| d as u32).collect();
    dots.sort_unstable();
    dots
}

/// Indices of the dots by camera and place.
fn place_order(dots: &[Dot]) -> Vec<u32> {
    let cameras = dots.iter().map(|d| d.camera + 1).max().unwrap_or(0);
    let mut starts = vec![0; cameras + 1];
    dots.iter().for_each(|d| starts[d.camera + 1] += 1);
    for camera in 0..cameras {
        starts[camera + 1] += starts[camera];
    }
    let (mut keys, mut next) = (vec![(0_u64, 0_u32); dots.len()], starts.clone());
    for (index, dot) in dots.iter().enumerate() {
        keys[next[dot.camera]] = (ascending(dot.pixel[0]), index as u32);
        next[dot.camera] += 1;
    }
    let rest = |index: u32| [dots[index as usize].pixel[1], dots[index as usize].sigma].map(ascending);
    for own in starts.windows(2) {
        let by_place =
            |a: &(u64, u32), b: &(u64, u32)| a.0.cmp(&b.0).then_with(|| rest(a.1).cmp(&rest(b.1))).then(a.1.cmp(&b.1));
        keys[own[0]..own[1]].sort_unstable_by(by_place);
    }
    keys.into_iter().map(|(_, index)| index).collect()
}

/// Bits that ascend as the numbers do (IEEE 754 total order).
fn ascending(value: f64) -> u64 {
    let bits = value.to_bits();
    if bits >> 63 == 1 { !bits } else { bits | (1 << 63) }
}

/// Whether a dot lies so near to an owned one that it is a half of the same blob.
fn is_half(frame: &Frame, claims: &[Option<usize>], dot: usize) -> bool {
    let camera = frame.dots[dot].camera;
    let at = frame.pixel(dot as u32);
    let reach = SAME_BLOB_PX.max(3.0 * frame.sigma_px(dot as u32));
    let dots = &frame.by_camera[camera];
    let first = dots.partition_point(|&d| frame.pixel(d).x < at.x - reach);
    dots[first..]
        .iter()
        .take_while(|&&d| frame.pixel(d).x <= at.x + reach)
        .any(|&d| !frame.free[d as usize] && claims[d as usize].is_none() && (frame.pixel(d) - at).norm() < reach)
}
