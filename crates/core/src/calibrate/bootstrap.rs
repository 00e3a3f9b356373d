//! A first rig from nothing but views of a wand: two cameras, then one after the other by resection.
//!
//! Two views of many wand poses give a fundamental matrix; focal lengths are those under which the wand has the same
//! length wherever it is (Kruppa's equations fail for cameras that look at one point, as all capture rigs do; the
//! known length does not). Every other camera is resected from the wand's places. Until a bundle adjustment follows,
//! principal points lie where the start says and lenses do not distort.

use super::bundle::camera::{FOCAL, POSITION, ROTATION, free};
use super::bundle::robust::{median, noise_px, weigh_softly};
use super::bundle::{Bundle, Pose, Sighting};
use super::epipolar::{Motion, fundamental, meet, motions, sampson};
use super::pose::{View, from_views};
use super::resection::resect;
use super::wand::{Span, Wand};
use crate::camera::Camera;
use nalgebra::{Matrix3, Vector2, Vector3};

/// What is known of the cameras before: identity, sensor, and either a guess or a calibrated lens and focal length.
#[derive(Clone, Debug)]
pub struct Start {
    /// Poses do not matter unless they are known.
    pub cameras: Vec<Camera>,
    /// Whether focal lengths (and lenses) are known.
    pub focal_known: bool,
    /// Whether everything is known roughly: an old calibration.
    pub rig_known: bool,
}

/// Why there is no first rig.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NoRig {
    /// No two cameras saw the wand together often enough.
    #[error("no two cameras see the whole wand together often enough: {0} frames at most, {FEWEST_COMMON} needed")]
    NoPair(usize),
    /// Most views show more than one.
    #[error("{0} views show two wands or more: wave one at a time, and cover the other")]
    Several(usize),
    /// Two cameras see it together, but no camera geometry explains what they see with a wand of constant length.
    #[error("no pair of cameras sees a rigid object of the wand's shape")]
    NoGeometry,
}

/// A first rig, and where the wand was.
#[derive(Clone, Debug)]
pub struct FirstRig {
    /// All cameras, in the axes of one of them.
    pub cameras: Vec<Camera>,
    /// Pose of the wand by frame.
    pub poses: Vec<Option<Pose>>,
    /// Cameras that could not be joined; theirs in `cameras` are meaningless.
    pub missing: Vec<usize>,
}

/// Common frames needed for a first pair, and for a further camera.
pub const FEWEST_COMMON: usize = 20;
/// Pairs of cameras tried for the beginning.
const SEEDS: usize = 6;
/// Focal lengths tried, relative to the guess, and how often the grid is refined.
const FOCAL_RANGE: (f64, f64) = (0.3, 4.5);
const FOCAL_STEPS: usize = 13;
const REFINED: usize = 4;
/// Views of a pair looked at in the search for focal lengths.
const LOOKED_AT: usize = 120;
/// Adjustments of a rig that grows: rounds of weighing, steps of each. The bundle that follows does the rest.
const ROUNDS: usize = 3;
const STEPS: usize = 3;
/// A rig that has grown by this factor is adjusted: the cost of all adjustments together stays that of the last few.
const GROWTH: f64 = 1.3;
/// Without lenses and principal points, projections are off by up to this part of the image's width.
const ROUGH: f64 = 0.015;

/// Makes the first rig. `frames`: the views of each frame, whole wands only.
///
/// A single marker has no length by which focal lengths could be told from two views; it takes all cameras, which are
/// given the same focal length (relative to their sensors) until one fits the marker best.
pub fn first_rig(start: &Start, wand: &Wand, frames: &mut [Vec<View>]) -> Result<FirstRig, NoRig> {
    if start.rig_known
        && let Some(rig) = old_rig(start, wand, frames)
    {
        return Ok(rig);
    }
    if start.focal_known || wand.span != Span::Point {
        return grown_rig(start, wand, frames);
    }
    let ratio = (FOCAL_RANGE.1 / FOCAL_RANGE.0).powf(1.0 / (FOCAL_STEPS - 1) as f64);
    let mut best: Option<((usize, f64), FirstRig)> = None;
    for step in 0..FOCAL_STEPS {
        let mut alike = Start { focal_known: true, ..start.clone() };
        for camera in &mut alike.cameras {
            camera.focal_px = camera.focal_px.map(|f| f * FOCAL_RANGE.0 * ratio.powi(step as i32));
        }
        let Ok(mut rig) = grown_rig(&alike, wand, frames) else { continue };
        adjust(start, wand, frames, &mut rig);
        let worth = (rig.missing.len(), misfit_px(wand, frames, &rig));
        if best.as_ref().is_none_or(|(least, _)| worth < *least) {
            best = Some((worth, rig));
        }
    }
    best.map(|b| b.1).ok_or(NoRig::NoGeometry)
}

/// The old calibration, where it still places the wand often enough; cameras that then see it too seldom are missing.
fn old_rig(start: &Start, wand: &Wand, frames: &mut [Vec<View>]) -> Option<FirstRig> {
    let mut rig = FirstRig { cameras: start.cameras.clone(), poses: vec![None; frames.len()], missing: Vec::new() };
    rename_all(&rig, wand, frames);
    place_all(&mut rig, wand, frames);
    let placed = |c: usize| {
        let seen = |(at, views): (&Option<Pose>, &Vec<View>)| at.is_some() && views.iter().any(|v| v.camera == c);
        rig.poses.iter().zip(frames.iter()).filter(|(a, v)| seen((a, v))).count()
    };
    let missing: Vec<usize> = (0..rig.cameras.len()).filter(|&c| placed(c) < FEWEST_COMMON).collect();
    if rig.cameras.len() - missing.len() < 2 {
        return None;
    }
    rig.missing = missing;
    while add_camera(start, wand, frames, &mut rig) {}
    Some(rig)
}

/// Two cameras, and then one after the other.
fn grown_rig(start: &Start, wand: &Wand, frames: &mut [Vec<View>]) -> Result<FirstRig, NoRig> {
    let mut best: Option<(f64, FirstRig)> = None;
    let seeds = seeds(start.cameras.len(), frames);
    let most = seeds.first().map_or(0, |s| s.0);
    if most < FEWEST_COMMON {
        return Err(NoRig::NoPair(most));
    }
    for (_, i, j) in seeds {
        if let Some((spread, rig)) = two_cameras(start, wand, frames, i, j)
            && best.as_ref().is_none_or(|(least, _)| spread < *least)
        {
            best = Some((spread, rig));
        }
    }
    let (_, mut rig) = best.ok_or(NoRig::NoGeometry)?;
    rename_all(&rig, wand, frames);
    let joined = |rig: &FirstRig| rig.cameras.len() - rig.missing.len();
    let mut adjusted = joined(&rig);
    while add_camera(start, wand, frames, &mut rig) {
        if joined(&rig) as f64 >= GROWTH * adjusted as f64 {
            adjust(start, wand, frames, &mut rig);
            adjusted = joined(&rig);
        }
    }
    if joined(&rig) > adjusted {
        adjust(start, wand, frames, &mut rig);
    }
    Ok(rig)
}

/// Pairs of cameras with the most frames in common: count, first, second.
fn seeds(cameras: usize, frames: &[Vec<View>]) -> Vec<(usize, usize, usize)> {
    let mut count = vec![0; cameras * cameras];
    for views in frames {
        for (k, a) in views.iter().enumerate() {
            for b in &views[k + 1..] {
                count[a.camera.min(b.camera) * cameras + a.camera.max(b.camera)] += 1;
            }
        }
    }
    let mut found: Vec<_> =
        (0..count.len()).map(|k| (count[k], k / cameras, k % cameras)).filter(|c| c.0 > 0).collect();
    found.sort_by_key(|c| (std::cmp::Reverse(c.0), c.1, c.2));
    found.truncate(SEEDS);
    found
}

/// A view's markers on the plane at distance 1 of a camera with the guessed focal length.
type OnPlane = Vec<Vector2<f64>>;

fn on_plane(camera: &Camera, view: &View) -> Option<OnPlane> {
    view.pixels.iter().map(|p| camera.normalised_from_pixel((*p)?)).collect()
}

fn middle(points: &OnPlane) -> Vector2<f64> {
    points.iter().sum::<Vector2<f64>>() / points.len() as f64
}

/// Two cameras from their common views, and the relative spread of the wand's lengths they measure.
fn two_cameras(start: &Start, wand: &Wand, frames: &[Vec<View>], i: usize, j: usize) -> Option<(f64, FirstRig)> {
    let mut common = Vec::new();
    for views in frames {
        let of = |camera: usize| views.iter().find(|v| v.camera == camera);
        if let (Some(a), Some(b)) = (of(i), of(j)) {
            common.push((on_plane(&start.cameras[i], a)?, on_plane(&start.cameras[j], b)?));
        }
    }
    let f = name_and_fit(wand, &mut common, (i * 1000 + j) as u64)?;
    let step = common.len().div_ceil(LOOKED_AT);
    let looked: Vec<_> = common.iter().step_by(step).collect();
    let (focals, measured) = focal_lengths(start.focal_known, wand, &f, &looked)?;
    let mut cameras = start.cameras.clone();
    let world = |c: &mut Camera, focal: f64, (rotation, translation): &Motion, scale: f64| {
        c.focal_px = c.focal_px.map(|f| f * focal);
        c.camera_from_world = *rotation;
        c.position_m = -rotation.transpose() * translation * scale;
    };
    world(&mut cameras[i], focals.0, &(Matrix3::identity(), Vector3::zeros()), 1.0);
    world(&mut cameras[j], focals.1, &measured.motion, measured.scale);
    let missing = (0..cameras.len()).filter(|c| *c != i && *c != j).collect();
    let mut rig = FirstRig { cameras, poses: vec![None; frames.len()], missing };
    let mut named = only(frames, &[i, j]);
    rename_all(&rig, wand, &mut named);
    place_all(&mut rig, wand, &named);
    adjust(start, wand, &named, &mut rig);
    let spread = length_spread(wand, &rig.cameras[i], &rig.cameras[j], &named, &rig.poses)?;
    Some((spread, rig))
}

fn only(frames: &[Vec<View>], cameras: &[usize]) -> Vec<Vec<View>> {
    let of = |views: &Vec<View>| views.iter().filter(|v| cameras.contains(&v.camera)).cloned().collect();
    frames.iter().map(of).collect()
}

/// The fundamental matrix; where the wand's ends look alike, first from middles, then the ends are named by it.
fn name_and_fit(wand: &Wand, common: &mut [(OnPlane, OnPlane)], seed: u64) -> Option<Matrix3<f64>> {
    if wand.other_naming().is_some() {
        let middles: Vec<_> = common.iter().map(|(a, b)| (middle(a), middle(b))).collect();
        let (f, _) = fundamental(&middles, seed)?;
        for (a, b) in common.iter_mut() {
            let off = |b: &[Vector2<f64>]| a.iter().zip(b).map(|p| sampson(&f, &(*p.0, *p.1))).sum::<f64>();
            let turned: OnPlane = b.iter().rev().copied().collect();
            if off(&turned) < off(b) {
                *b = turned;
            }
        }
    }
    let pairs: Vec<_> = common.iter().flat_map(|(a, b)| a.iter().copied().zip(b.iter().copied())).collect();
    let step = pairs.len().div_ceil(2000).max(1) | 1; // odd, so that it meets every marker
    let pairs: Vec<_> = pairs.into_iter().step_by(step).collect();
    fundamental(&pairs, seed).map(|f| f.0)
}

/// What a pair of focal lengths makes of the wand.
struct Measured {
    motion: Motion,
    scale: f64,
    misfit: f64,
}

/// Focal lengths relative to the guess under which the wand keeps its length best.
fn focal_lengths(
    known: bool,
    wand: &Wand,
    f: &Matrix3<f64>,
    looked: &[&(OnPlane, OnPlane)],
) -> Option<((f64, f64), Measured)> {
    let mut best: Option<((f64, f64), Measured)> = None;
    let mut consider = |a: f64, b: f64| {
        if let Some(measured) = measure(wand, f, a, b, looked)
            && best.as_ref().is_none_or(|(_, m)| measured.misfit < m.misfit)
        {
            best = Some(((a, b), measured));
        }
        best.as_ref().map(|b| b.0)
    };
    if known {
        consider(1.0, 1.0);
        return best;
    }
    let mut ratio = (FOCAL_RANGE.1 / FOCAL_RANGE.0).powf(1.0 / (FOCAL_STEPS - 1) as f64);
    let mut around = None;
    for a in 0..FOCAL_STEPS {
        for b in 0..FOCAL_STEPS {
            around = consider(FOCAL_RANGE.0 * ratio.powi(a as i32), FOCAL_RANGE.0 * ratio.powi(b as i32));
        }
    }
    for _ in 0..REFINED {
        ratio = ratio.powf(0.4);
        let (a, b) = around?;
        for (x, y) in (-1..=1).flat_map(|x| (-1..=1).map(move |y| (x, y))) {
            around = consider(a * ratio.powi(x), b * ratio.powi(y));
        }
    }
    best
}

fn measure(wand: &Wand, f: &Matrix3<f64>, a: f64, b: f64, looked: &[&(OnPlane, OnPlane)]) -> Option<Measured> {
    let essential =
        Matrix3::from_diagonal(&Vector3::new(b, b, 1.0)) * f * Matrix3::from_diagonal(&Vector3::new(a, a, 1.0));
    let mut best: Option<Measured> = None;
    for motion in motions(&essential)? {
        let placed = |(first, second): &(OnPlane, OnPlane)| -> Option<Vec<Vector3<f64>>> {
            first.iter().zip(second).map(|(p, q)| meet(&motion, &(p / a), &(q / b))).collect()
        };
        let all: Vec<Vec<Vector3<f64>>> = looked.iter().filter_map(|views| placed(views)).collect();
        if all.len() * 2 <= looked.len() {
            continue;
        }
        let (scale, misfit) = if wand.span == Span::Point {
            let values = essential.singular_values();
            (1.0, 1.0 - values[1] / values[0])
        } else {
            spread(wand, all.iter().map(Vec::as_slice))
        };
        if best.as_ref().is_none_or(|m| misfit < m.misfit) {
            best = Some(Measured { motion, scale, misfit });
        }
    }
    best
}

/// True length over measured length (median), and the relative spread (median absolute deviation) of the latter.
fn spread<'a>(wand: &Wand, placed: impl Iterator<Item = &'a [Vector3<f64>]>) -> (f64, f64) {
    let shortest = 0.3 * wand.length_m();
    let pairs: Vec<(usize, usize, f64)> = wand
        .pairs()
        .map(|(i, j)| (i, j, (wand.markers_m[i] - wand.markers_m[j]).norm()))
        .filter(|p| p.2 >= shortest)
        .collect();
    let mut ratios: Vec<f64> =
        placed.flat_map(|at| pairs.iter().map(|&(i, j, length)| (at[i] - at[j]).norm() / length)).collect();
    let typical = median(&mut ratios).max(1e-12);
    let mut off: Vec<f64> = ratios.iter().map(|r| (r / typical - 1.0).abs()).collect();
    (1.0 / typical, median(&mut off))
}

fn length_spread(wand: &Wand, a: &Camera, b: &Camera, named: &[Vec<View>], poses: &[Option<Pose>]) -> Option<f64> {
    let mut all = Vec::new();
    for (views, _) in named.iter().zip(poses).filter(|(v, p)| v.len() == 2 && p.is_some()) {
        let (p, q) = if views[0].camera < views[1].camera { (&views[0], &views[1]) } else { (&views[1], &views[0]) };
        let place = |(p, q): (&Option<Vector2<f64>>, &Option<Vector2<f64>>)| super::pose::meet(a, b, (*p)?, (*q)?);
        if let Some(placed) = p.pixels.iter().zip(&q.pixels).map(place).collect::<Option<Vec<_>>>() {
            all.push(placed);
        }
    }
    let misfit =
        if wand.span == Span::Point { 1.0 / all.len() as f64 } else { spread(wand, all.iter().map(Vec::as_slice)).1 };
    (all.len() >= FEWEST_COMMON / 2).then_some(misfit)
}

/// Places the wand in every frame that the joined cameras see often enough and where it is not placed yet.
fn place_all(rig: &mut FirstRig, wand: &Wand, frames: &[Vec<View>]) {
    let gate = ROUGH * rig.cameras[0].size_px[0];
    for (at, views) in rig.poses.iter_mut().zip(frames).filter(|(at, _)| at.is_none()) {
        let joined: Vec<View> = views.iter().filter(|v| !rig.missing.contains(&v.camera)).cloned().collect();
        let needed = joined.first().map_or(0, |v| v.pixels.len()) * 3 / 2;
        *at = from_views(&rig.cameras, wand, &joined, gate).filter(|(_, agree)| *agree >= needed).map(|p| p.0);
    }
}

/// Robust adjustment of joined cameras (pose, focal length) and placed wands.
fn adjust(start: &Start, wand: &Wand, frames: &[Vec<View>], rig: &mut FirstRig) {
    let mut bundle = bundle_of(start, wand, frames, rig);
    for _ in 0..ROUNDS {
        let noise = noise_px(&bundle, |_| true);
        weigh_softly(&mut bundle, &noise);
        bundle.adjust(STEPS);
    }
    rig.cameras = bundle.cameras;
    let mut adjusted = bundle.poses.into_iter();
    for at in rig.poses.iter_mut().filter(|p| p.is_some()) {
        *at = adjusted.next();
    }
}

/// Median residual of the joined cameras (px).
fn misfit_px(wand: &Wand, frames: &[Vec<View>], rig: &FirstRig) -> f64 {
    let start = Start { cameras: Vec::new(), focal_known: true, rig_known: false };
    let bundle = bundle_of(&start, wand, frames, rig);
    let mut all: Vec<f64> = bundle.sightings.iter().filter_map(|s| Some(bundle.residual(s)?.norm())).collect();
    if all.is_empty() { f64::INFINITY } else { median(&mut all) }
}

/// Joined cameras (pose and, unless known, focal length free) and placed wands.
fn bundle_of(start: &Start, wand: &Wand, frames: &[Vec<View>], rig: &FirstRig) -> Bundle {
    let mut freedom = free(&[ROTATION, POSITION]);
    freedom[FOCAL] = !start.focal_known;
    let joined = |c: usize| !rig.missing.contains(&c);
    let freedoms =
        (0..rig.cameras.len()).map(|c| if joined(c) { freedom } else { super::bundle::camera::HELD }).collect();
    let mut sightings = Vec::new();
    let mut poses = Vec::new();
    for (at, views) in rig.poses.iter().zip(frames) {
        let Some(at) = at else { continue };
        for view in views.iter().filter(|v| joined(v.camera)) {
            sightings.extend(sightings_of(view, poses.len()));
        }
        poses.push(*at);
    }
    Bundle { cameras: rig.cameras.clone(), freedom: freedoms, wand: wand.clone(), poses, poses_held: false, sightings }
}

/// The markers of a view as sightings of a pose.
pub fn sightings_of(view: &View, pose: usize) -> impl Iterator<Item = Sighting> + '_ {
    let one = move |(marker, pixel): (usize, &Option<Vector2<f64>>)| {
        pixel.map(|pixel| Sighting { pose, camera: view.camera, marker, pixel, weight: 1.0 })
    };
    view.pixels.iter().enumerate().filter_map(one)
}

/// Gives the ends of a wand that looks alike from both the names under which each frame's views meet.
pub fn rename_all(rig: &FirstRig, wand: &Wand, frames: &mut [Vec<View>]) {
    if wand.other_naming().is_none() {
        return;
    }
    for views in frames.iter_mut() {
        let joined: Vec<usize> = (0..views.len()).filter(|&k| !rig.missing.contains(&views[k].camera)).collect();
        for (place, &k) in joined.iter().enumerate().skip(1) {
            let turned = View { camera: views[k].camera, pixels: views[k].pixels.iter().rev().copied().collect() };
            let gap = |view: &View| joined[..place].iter().map(|&o| apart(rig, &views[o], view)).sum::<f64>();
            if gap(&turned) < gap(&views[k]) {
                views[k] = turned;
            }
        }
    }
}

/// How far the rays of two views miss each other, over all markers (m).
fn apart(rig: &FirstRig, a: &View, b: &View) -> f64 {
    let (one, two) = (&rig.cameras[a.camera], &rig.cameras[b.camera]);
    let gap = |(p, q): (&Option<Vector2<f64>>, &Option<Vector2<f64>>)| {
        let (u, v) =
            (one.ray_in_world(one.normalised_from_pixel((*p)?)?), two.ray_in_world(two.normalised_from_pixel((*q)?)?));
        Some((two.position_m - one.position_m).dot(&u.cross(&v).normalize()).abs())
    };
    a.pixels.iter().zip(&b.pixels).filter_map(gap).sum()
}

/// Joins the camera that shares most frames with the placed wands. `false` if none can be.
fn add_camera(start: &Start, wand: &Wand, frames: &mut [Vec<View>], rig: &mut FirstRig) -> bool {
    let ambiguous = wand.other_naming().is_some();
    let mut order: Vec<(usize, usize)> = rig
        .missing
        .iter()
        .map(|&c| {
            let seen = |(at, views): (&Option<Pose>, &Vec<View>)| at.is_some() && views.iter().any(|v| v.camera == c);
            (rig.poses.iter().zip(frames.iter()).filter(|(a, v)| seen((a, v))).count(), c)
        })
        .collect();
    order.sort_by_key(|&(count, camera)| (std::cmp::Reverse(count), camera));
    for (count, camera) in order {
        if count < FEWEST_COMMON {
            return false;
        }
        let mut known = Vec::new();
        for (at, views) in rig.poses.iter().zip(frames.iter()) {
            if let (Some(at), Some(view)) = (at, views.iter().find(|v| v.camera == camera)) {
                let all: Vec<_> =
                    view.pixels.iter().zip(&wand.markers_m).filter_map(|(p, m)| Some((at.place(m), (*p)?))).collect();
                if ambiguous {
                    let n = all.len() as f64;
                    known.push((
                        all.iter().map(|k| k.0).sum::<Vector3<f64>>() / n,
                        all.iter().map(|k| k.1).sum::<Vector2<f64>>() / n,
                    ));
                } else {
                    known.extend(all);
                }
            }
        }
        let [width, _] = start.cameras[camera].size_px;
        let found = resect(&start.cameras[camera], &known, start.focal_known, camera as u64);
        if let Some((found, misfit)) = found
            && misfit < ROUGH * width
        {
            rig.cameras[camera] = found;
            rig.missing.retain(|c| *c != camera);
            rename_all(rig, wand, frames);
            place_all(rig, wand, frames);
            return true;
        }
    }
    false
}
