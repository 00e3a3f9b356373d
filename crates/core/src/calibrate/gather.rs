//! Where the wand was in every frame, and which dots are its markers, once the cameras are roughly known.
//!
//! Two views of the whole wand place it. Where there are not two, it is carried on from the frames beside (forwards,
//! then backwards): the dots near where it must be then place it, hidden markers or not.

use super::bundle::{Bundle, Pose, Sighting};
use super::pose::{View, from_views, settle};
use crate::camera::Camera;
use crate::correspond::frame::Dot;
use nalgebra::Vector2;
use rayon::prelude::*;
use std::ops::Range;

/// Dots of a wave by frame, which of them are still, and the views in which the whole wand was found.
pub struct Seen<'a> {
    /// In ascending order of frame.
    pub dots: &'a [Dot],
    /// Dots of each frame.
    pub ranges: &'a [Range<usize>],
    /// Dots that stay where they are.
    pub fixed: &'a [bool],
    /// Whole views of each frame.
    pub views: &'a [Vec<View>],
}

/// Poses, their frames, and the sightings of their markers with the dot behind each.
#[derive(Default)]
pub struct Gathered {
    /// Where the wand was.
    pub poses: Vec<Pose>,
    /// Frame index of each pose.
    pub frame: Vec<usize>,
    /// In ascending order of pose, camera, marker; all of weight 1.
    pub sightings: Vec<Sighting>,
    /// The dot of each sighting.
    pub dot: Vec<usize>,
}

/// Dots lie within so many standard deviations of a rough rig's projections, or this part of the image's width.
const GATE_NOISES: f64 = 12.0;
const GATE_WIDTHS: f64 = 0.002;
/// A carried wand is looked for this many times farther off than it is in all but one frame of twenty.
const REACH: f64 = 2.0;
/// A carried pose needs so many measurements more than it has unknowns: wrong dots do not agree so often.
const REDUNDANCY: usize = 4;

/// Places the wand in all frames (in at most `most_poses` of them, evenly spread) and gives it its dots.
///
/// `missing`: cameras that are not known.
pub fn gather(bundle: &Bundle, missing: &[usize], noise_px: &[f64], seen: &Seen, most_poses: usize) -> Gathered {
    let joined: Vec<usize> = (0..bundle.cameras.len()).filter(|c| !missing.contains(c)).collect();
    let gate_px: Vec<f64> = (0..bundle.cameras.len())
        .map(|c| (GATE_NOISES * noise_px[c]).max(GATE_WIDTHS * bundle.cameras[c].size_px[0]))
        .collect();
    let place = Placing { bundle, joined, gate_px, noise_px, seen };
    let mut placed: Vec<Option<Pose>> = (0..seen.views.len()).into_par_iter().map(|f| place.whole(f)).collect();
    let reach_m = place.reach_m(&placed);
    place.carry(&mut placed, reach_m, true);
    place.carry(&mut placed, reach_m, false);
    let usable: Vec<usize> = (0..placed.len()).filter(|&f| placed[f].is_some()).collect();
    let step = usable.len().div_ceil(most_poses).max(1);
    let mut gathered = Gathered::default();
    for &f in usable.iter().step_by(step) {
        let Some(pose) = placed[f] else { continue };
        let own = place.explained(&pose, gathered.poses.len(), f, 0.0);
        if !own.is_empty() {
            gathered.poses.push(pose);
            gathered.frame.push(f);
            gathered.dot.extend(own.iter().map(|o| o.0));
            gathered.sightings.extend(own.iter().map(|o| o.1));
        }
    }
    gathered
}

struct Placing<'a> {
    bundle: &'a Bundle,
    joined: Vec<usize>,
    gate_px: Vec<f64>,
    noise_px: &'a [f64],
    seen: &'a Seen<'a>,
}

impl Placing<'_> {
    /// The pose on which two or more whole views of a frame agree.
    fn whole(&self, frame: usize) -> Option<Pose> {
        let views: Vec<View> =
            self.seen.views[frame].iter().filter(|v| self.joined.contains(&v.camera)).cloned().collect();
        let widest = self.joined.iter().map(|&c| self.gate_px[c]).fold(0.0, f64::max);
        let needed = self.bundle.wand.markers_m.len() * 3 / 2;
        from_views(&self.bundle.cameras, &self.bundle.wand, &views, widest).filter(|(_, n)| *n >= needed).map(|p| p.0)
    }

    /// How far (m) markers are from where steady motion would have carried them, in all but one frame of twenty.
    fn reach_m(&self, placed: &[Option<Pose>]) -> f64 {
        let off = |poses: &[Option<Pose>]| {
            let (expected, found) = (carried(&poses[0]?, &poses[1]?), poses[2]?);
            let markers = self.bundle.wand.markers_m.iter();
            Some(markers.map(|m| (expected.place(m) - found.place(m)).norm()).fold(0.0, f64::max))
        };
        let mut all: Vec<f64> = placed.windows(3).filter_map(off).collect();
        if all.is_empty() {
            return 0.0;
        }
        let most = all.len() * 19 / 20;
        *all.select_nth_unstable_by(most, f64::total_cmp).1
    }

    /// Places the wand in frames where it is not placed, from the two frames before (or, backwards, after).
    fn carry(&self, placed: &mut [Option<Pose>], reach_m: f64, forwards: bool) {
        let n = placed.len();
        let at = |k: usize| if forwards { k } else { n - 1 - k };
        for k in 2..n {
            if placed[at(k)].is_none()
                && let (Some(before), Some(last)) = (placed[at(k - 2)], placed[at(k - 1)])
            {
                placed[at(k)] = self.near(&carried(&before, &last), at(k), REACH * reach_m);
            }
        }
    }

    /// The pose near an expected one that a frame's dots agree on.
    fn near(&self, expected: &Pose, frame: usize, reach_m: f64) -> Option<Pose> {
        let mut pose = *expected;
        for reach in [reach_m, 0.25 * reach_m, 0.0] {
            let own = self.explained(&pose, 0, frame, reach);
            let free = self.bundle.wand.pose_freedom();
            if 2 * own.len() < free + REDUNDANCY {
                return None;
            }
            let sightings: Vec<Sighting> = own.into_iter().map(|o| o.1).collect();
            pose = settle(self.bundle, &pose, &sightings, self.noise_px)?;
        }
        let own = self.explained(&pose, 0, frame, 0.0);
        (2 * own.len() >= self.bundle.wand.pose_freedom() + REDUNDANCY).then_some(pose)
    }

    /// The dots of a frame that a pose explains: each marker its nearest dot in each camera, each dot one marker.
    ///
    /// `reach_m`: how far (m) off the pose may be.
    fn explained(&self, pose: &Pose, index: usize, frame: usize, reach_m: f64) -> Vec<(usize, Sighting)> {
        let mut found: Vec<(f64, usize, Sighting)> = Vec::new();
        let dots = self.seen.dots;
        for &camera in &self.joined {
            let mine = |&i: &usize| dots[i].camera == camera && !self.seen.fixed[i];
            let own: Vec<usize> = self.seen.ranges[frame].clone().filter(mine).collect();
            if own.is_empty() {
                continue;
            }
            let one = &self.bundle.cameras[camera];
            for (marker, at) in self.bundle.wand.markers_m.iter().enumerate() {
                let place = pose.place(at);
                let Some(expected) = one.project(&place) else { continue };
                let gate = self.gate_px[camera] + reach_m * pixels_per_metre(one, &place);
                for &i in &own {
                    let pixel = Vector2::from(dots[i].pixel);
                    let off = (pixel - expected).norm() / gate;
                    if off < 1.0 {
                        found.push((off, i, Sighting { pose: index, camera, marker, pixel, weight: 1.0 }));
                    }
                }
            }
        }
        each_once(found)
    }
}

/// Nearest first: every dot for one marker, every marker of a camera one dot.
fn each_once(mut found: Vec<(f64, usize, Sighting)>) -> Vec<(usize, Sighting)> {
    found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut taken: Vec<(usize, Sighting)> = Vec::new();
    for (_, i, s) in found {
        if taken.iter().all(|(j, t)| *j != i && (t.camera != s.camera || t.marker != s.marker)) {
            taken.push((i, s));
        }
    }
    taken.sort_by_key(|(_, s)| (s.camera, s.marker));
    taken
}

fn pixels_per_metre(camera: &Camera, place: &nalgebra::Vector3<f64>) -> f64 {
    camera.focal_px[0] / camera.camera_from_world_point(place).z.abs().max(1e-3)
}

/// The pose one step on, moving and turning as it did from `before` to `last`.
fn carried(before: &Pose, last: &Pose) -> Pose {
    Pose {
        rotation: last.rotation * (before.rotation.transpose() * last.rotation),
        position_m: 2.0 * last.position_m - before.position_m,
    }
}
