//! From the raw dots of a wand wave to a calibrated rig: the whole chain.

use super::bootstrap::{FirstRig, NoRig, Start, first_rig, sightings_of};
use super::bundle::Bundle;
use super::bundle::camera::{
    FOCAL, Freedom, HELD, POSITION, PRINCIPAL, RADIAL, ROTATION, SIXTH, TANGENTIAL, coefficients, free,
};
use super::bundle::robust::{noise_of_used_px, noise_px, weigh_hard, weigh_softly};
use super::gather::{Gathered, Seen, gather};
use super::identify::{Found, Pattern};
use super::pose::View;
use super::shape;
use super::still::still;
use super::wand::{Span, Wand};
use crate::camera::{Camera, Lens};
use crate::correspond::frame::Dot;
use nalgebra::Vector2;
use rayon::prelude::*;
use std::ops::Range;

/// How poses are used.
#[derive(Clone, Debug)]
pub struct Options {
    /// One pose in this many is left out of the fit that is judged by it.
    pub left_out_every: usize,
    /// Poses used at most, spread over the wave.
    pub most_poses: usize,
}

/// A calibrated rig and everything by which it is judged.
pub struct Wave {
    /// Cameras, poses and sightings as adjusted; weights are `1/σ²`, 0 for what was left out as wrong.
    pub bundle: Bundle,
    /// Frame index of each pose.
    pub frame: Vec<usize>,
    /// The dot behind each sighting.
    pub dot: Vec<usize>,
    /// Noise of each camera (px per axis).
    pub noise_px: Vec<f64>,
    /// Residual (px) of sightings of poses that a first fit left out, by that fit; camera beside it.
    pub left_out_px: Vec<(usize, f64)>,
    /// Measured and true distance (m) of every two markers on poses left out, each marker placed on its own.
    pub left_out_lengths_m: Vec<(f64, f64)>,
    /// Cameras that could not be joined.
    pub missing: Vec<usize>,
    /// Views per camera in which the whole wand was found.
    pub whole_views: Vec<usize>,
    /// Those of them in frames whose pose is used.
    pub whole_views_placed: Vec<usize>,
    /// Dots that stay where they are, per camera.
    pub still_dots: Vec<usize>,
    /// Whether the adjustment converged.
    pub converged: bool,
}

/// Frames used for the first rig: as many as give every camera enough views.
const BOOTSTRAP_FRAMES: usize = 250;
const BOOTSTRAP_VIEWS: usize = 80;
/// Steps of the last adjustments: a wand needs a handful, a single marker, whose cameras calibrate themselves, dozens.
const LAST_STEPS: usize = 100;

/// Calibrates. `dots` in ascending order of frame; `ranges`: those of each frame.
pub fn calibrate(
    start: &Start,
    wand: &Wand,
    dots: &[Dot],
    ranges: &[Range<usize>],
    options: &Options,
) -> Result<Wave, NoRig> {
    let fixed = still_dots(start.cameras.len(), dots, ranges);
    let found = whole_views(start.cameras.len(), wand, dots, ranges, &fixed);
    if found.several > found.count.iter().sum() {
        return Err(NoRig::Several(found.several));
    }
    let mut views = found.views;
    let chosen = bootstrap_frames(start.cameras.len(), &views);
    let mut few: Vec<Vec<View>> = chosen.iter().map(|&f| views[f].clone()).collect();
    let first = first_rig(start, wand, &mut few)?;
    let freedom = freedom(start, wand);
    let mut rough = rough_bundle(start, wand, &few, &first, &freedom);
    for _ in 0..4 {
        let noise = noise_px(&rough, |_| true);
        weigh_softly(&mut rough, &noise);
        rough.adjust(5);
    }
    let noise = noise_px(&rough, |_| true);
    let mut wave = Wave {
        frame: Vec::new(),
        dot: Vec::new(),
        noise_px: noise,
        left_out_px: Vec::new(),
        left_out_lengths_m: Vec::new(),
        missing: first.missing,
        whole_views: found.count,
        whole_views_placed: vec![0; start.cameras.len()],
        still_dots: (0..start.cameras.len())
            .map(|c| dots.iter().zip(&fixed).filter(|(d, f)| d.camera == c && **f).count())
            .collect(),
        converged: false,
        bundle: rough,
    };
    settle_names(&wave, &mut views);
    let seen = Seen { dots, ranges, fixed: &fixed, views: &views };
    let gathered = gather(&wave.bundle, &wave.missing, &wave.noise_px, &seen, options.most_poses);
    wave.take_in(gathered, &views);
    finish(&mut wave, options);
    Ok(wave)
}

impl Wave {
    fn take_in(&mut self, gathered: Gathered, views: &[Vec<View>]) {
        (self.bundle.poses, self.bundle.sightings) = (gathered.poses, gathered.sightings);
        (self.frame, self.dot) = (gathered.frame, gathered.dot);
        for view in self.frame.iter().flat_map(|&f| &views[f]) {
            self.whole_views_placed[view.camera] += 1;
        }
    }
}

fn freedom(start: &Start, wand: &Wand) -> Freedom {
    let pose = [ROTATION, POSITION];
    if start.focal_known {
        return free(&pose);
    }
    if wand.span == Span::Point {
        let mut some = free(&[ROTATION, POSITION, RADIAL]);
        some[FOCAL] = true;
        return some;
    }
    let mut all = free(&[ROTATION, POSITION, PRINCIPAL, RADIAL, TANGENTIAL]);
    all[SIXTH] = true;
    all[FOCAL] = true;
    all
}

fn still_dots(cameras: usize, dots: &[Dot], ranges: &[Range<usize>]) -> Vec<bool> {
    let mut fixed = vec![false; dots.len()];
    for camera in 0..cameras {
        let (mut own, mut frames, mut pixels) = (Vec::new(), Vec::new(), Vec::new());
        for (frame, range) in ranges.iter().enumerate() {
            for i in range.clone().filter(|&i| dots[i].camera == camera) {
                own.push(i);
                frames.push(frame);
                pixels.push(Vector2::from(dots[i].pixel));
            }
        }
        for (i, is_still) in own.into_iter().zip(still(&frames, &pixels)) {
            fixed[i] = is_still;
        }
    }
    fixed
}

struct WholeViews {
    views: Vec<Vec<View>>,
    count: Vec<usize>,
    /// Views in which there are two wands or more.
    several: usize,
}

/// Every view in which the whole wand is found.
fn whole_views(cameras: usize, wand: &Wand, dots: &[Dot], ranges: &[Range<usize>], fixed: &[bool]) -> WholeViews {
    let pattern = Pattern::new(wand);
    let of_frame = |range: &Range<usize>| -> (Vec<View>, usize) {
        let mut by_camera = vec![Vec::new(); cameras];
        for i in range.clone().filter(|&i| !fixed[i]) {
            by_camera[dots[i].camera].push(Vector2::from(dots[i].pixel));
        }
        let (mut views, mut several) = (Vec::new(), 0);
        for (camera, own) in by_camera.iter().enumerate() {
            match pattern.find(own) {
                Found::Whole(naming) => {
                    views.push(View { camera, pixels: naming.into_iter().map(|d| Some(own[d])).collect() });
                }
                Found::Several => several += 1,
                Found::Nothing => {}
            }
        }
        (views, several)
    };
    let (views, several): (Vec<Vec<View>>, Vec<usize>) = ranges.par_iter().map(of_frame).unzip();
    let several = several.into_iter().sum();
    let mut count = vec![0; cameras];
    views.iter().flatten().for_each(|v| count[v.camera] += 1);
    WholeViews { views, count, several }
}

/// Frames spread over the wave, and more for cameras that see little.
fn bootstrap_frames(cameras: usize, views: &[Vec<View>]) -> Vec<usize> {
    let usable: Vec<usize> = (0..views.len()).filter(|&f| views[f].len() >= 2).collect();
    let spread = |from: &[usize], most: usize| -> Vec<usize> {
        let step = from.len().div_ceil(most.max(1)).max(1);
        from.iter().copied().step_by(step).collect()
    };
    let mut chosen = spread(&usable, BOOTSTRAP_FRAMES);
    for camera in 0..cameras {
        let sees = |f: &&usize| views[**f].iter().any(|v| v.camera == camera);
        if chosen.iter().filter(sees).count() < BOOTSTRAP_VIEWS {
            let own: Vec<usize> = usable.iter().filter(sees).copied().collect();
            chosen.extend(spread(&own, BOOTSTRAP_VIEWS));
        }
    }
    chosen.sort_unstable();
    chosen.dedup();
    chosen
}

fn rough_bundle(start: &Start, wand: &Wand, few: &[Vec<View>], first: &FirstRig, freedom: &Freedom) -> Bundle {
    let (mut poses, mut sightings) = (Vec::new(), Vec::new());
    for (at, views) in first.poses.iter().zip(few) {
        let Some(at) = at else { continue };
        for view in views.iter().filter(|v| !first.missing.contains(&v.camera)) {
            sightings.extend(sightings_of(view, poses.len()));
        }
        poses.push(*at);
    }
    let mut cameras = first.cameras.clone();
    if !start.focal_known {
        let ideal = |c: &&mut Camera| !start.rig_known || coefficients(&c.lens).is_none();
        for camera in cameras.iter_mut().filter(ideal) {
            camera.lens = Lens::BrownConrady { k: [0.0; 6], p: [0.0; 2] };
        }
    }
    let freedoms = (0..cameras.len()).map(|c| if first.missing.contains(&c) { HELD } else { *freedom }).collect();
    Bundle { cameras, freedom: freedoms, wand: wand.clone(), poses, poses_held: false, sightings }
}

/// Names the ends of a wand that looks alike from both, now that the cameras are known.
fn settle_names(wave: &Wave, views: &mut [Vec<View>]) {
    let rig = FirstRig { cameras: wave.bundle.cameras.clone(), poses: Vec::new(), missing: wave.missing.clone() };
    super::bootstrap::rename_all(&rig, &wave.bundle.wand, views);
}

/// Adjusts without the poses left out, judges by them, and adjusts with all.
fn finish(wave: &mut Wave, options: &Options) {
    let every = options.left_out_every.max(2);
    let left_out = |pose: usize| pose % every == every - 1;
    for round in 0..4 {
        if round >= 2 {
            shape::refine(&mut wave.bundle);
        }
        wave.noise_px = noise_px(&wave.bundle, |_| true);
        if round < 2 {
            weigh_softly(&mut wave.bundle, &wave.noise_px);
        } else {
            weigh_hard(&mut wave.bundle, &wave.noise_px);
        }
        drop_left_out(&mut wave.bundle, &left_out);
        wave.bundle.adjust(if round < 2 { 3 } else { 5 });
    }
    judge(wave, &left_out);
    for _ in 0..3 {
        wave.noise_px = noise_of_used_px(&wave.bundle);
        weigh_hard(&mut wave.bundle, &wave.noise_px);
        wave.converged = wave.bundle.adjust(LAST_STEPS).converged;
    }
}

fn drop_left_out(bundle: &mut Bundle, left_out: &impl Fn(usize) -> bool) {
    bundle.sightings.iter_mut().filter(|s| left_out(s.pose)).for_each(|s| s.weight = 0.0);
}

/// Residuals and lengths on the poses left out, cameras as they are; those poses are adjusted to them.
fn judge(wave: &mut Wave, left_out: &impl Fn(usize) -> bool) {
    let noise = noise_px(&wave.bundle, |i| wave.bundle.sightings[i].weight > 0.0);
    let mut check = wave.bundle.clone();
    check.freedom = vec![HELD; check.cameras.len()];
    check.sightings.retain(|s| left_out(s.pose));
    for round in 0..3 {
        if round == 0 {
            weigh_softly(&mut check, &noise);
        } else {
            weigh_hard(&mut check, &noise);
        }
        check.adjust(10);
    }
    wave.left_out_px =
        check.sightings.iter().map(|s| (s.camera, check.residual(s).map_or(f64::INFINITY, |r| r.norm()))).collect();
    wave.left_out_lengths_m = lengths(&check);
    wave.bundle.poses = check.poses;
}

/// Measured and true distances of markers that are placed each on its own from the sightings of positive weight.
fn lengths(check: &Bundle) -> Vec<(f64, f64)> {
    let markers = check.wand.markers_m.len();
    if check.wand.span == Span::Point {
        return Vec::new();
    }
    let place = shape::places(check);
    let mut out = Vec::new();
    for pose in 0..check.poses.len() {
        for (i, j) in check.wand.pairs() {
            if let (Some(a), Some(b)) = (place[pose * markers + i], place[pose * markers + j]) {
                out.push(((a - b).norm(), (check.wand.markers_m[i] - check.wand.markers_m[j]).norm()));
            }
        }
    }
    out
}
