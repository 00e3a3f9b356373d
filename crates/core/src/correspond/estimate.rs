//! The take's own prior: noise, volume, number of markers, detection, clutter and fixed reflections, from its frames.
//!
//! 1. The region: the box of all places that two cameras see under 5° or more.
//! 2. The noise scale: the frames' objective is a log-likelihood, so the scale (on a geometric ladder, from small to
//!    large, where small scales are cheap) is the one that maximises it.
//! 3. Expectation–maximisation over the groups found: noise per camera from residuals freed of their leverage, a tail
//!    where the residuals have one, the box of the points, rates of detection and of clutter, dots that never move.
//!
//! Every quantity is shrunk towards a weak prior, so that a single frame with a single marker has a sane answer too.
//! Frames are a deterministic sample spread over the take.

use super::enumerate::EnumerateOptions;
use super::frame::{Dot, PreparedFrame};
use super::noise::fit_noise;
use super::optimal::{OptimalOptions, choose};
use super::scene::{Aabb, Reflection, Scene, SceneModel};
use crate::camera::Rig;
use crate::sight::Sight;
use nalgebra::{Matrix3, Vector2, Vector3};

/// Options of the estimation.
#[derive(Clone, Copy, Debug)]
pub struct EstimateOptions {
    /// Frames used. More cost time, fewer make the rates coarse.
    pub frames: usize,
    /// Fixed noise scale; `None` estimates it.
    pub noise: Option<f64>,
}

impl Default for EstimateOptions {
    fn default() -> Self {
        Self { frames: 40, noise: None }
    }
}

/// Dots at most in the sample: crowded frames say as much as many sparse ones.
const SAMPLE_DOTS: usize = 40_000;
const SCALE_FRAMES: usize = 8;
const SCALE_DOTS: usize = 4_000;
const SMALLEST_SCALE: f64 = 0.04;
const LARGEST_SCALE: f64 = 16.0;
const ROUNDS: usize = 5;
/// Rounds before departures from independent cameras and fixed reflections are believed: until the volume is known,
/// markers that only two cameras saw drown, and a rule learned without them would keep them out for good.
const ROUNDS_INDEPENDENT: usize = 2;
const SMALLEST_ANGLE_DEG: f64 = 5.0;

/// The box of all places that two cameras see under [`SMALLEST_ANGLE_DEG`] or more; `None` if there is no such place.
pub fn visible_region(rig: &Rig) -> Option<Aabb> {
    let centers = Aabb::around(rig.cameras.iter().map(|c| c.position_m))?;
    let reach = reach_of(rig, &centers);
    let mut seen = Vec::new();
    for (i, camera) in rig.cameras.iter().enumerate() {
        for cell in 0..81 {
            let part = |k: usize| (k as f64 + 0.5) / 9.0;
            let pixel = Vector2::new(part(cell % 9) * camera.size_px[0], part(cell / 9) * camera.size_px[1]);
            let Some(at) = camera.normalised_from_pixel(pixel) else { continue };
            let ray = camera.ray_in_world(at);
            for step in 1..=60 {
                let point = camera.position_m + ray * (reach * f64::from(step) / 60.0);
                let crossed = |other: &crate::camera::Camera| {
                    let direction = (point - other.position_m).normalize();
                    direction.cross(&ray).norm() > SMALLEST_ANGLE_DEG.to_radians().sin() && other.sees(&point)
                };
                if rig.cameras.iter().enumerate().any(|(j, other)| j != i && crossed(other)) {
                    seen.push(point);
                }
            }
        }
    }
    let found = Aabb::around(seen)?;
    Some(found.grown(Vector3::repeat(0.05 * found.diagonal())))
}

/// How far from a camera markers may be: across the rig, and on to where the cameras look. Beyond twelve times their
/// spread no two cameras see a place under [`SMALLEST_ANGLE_DEG`].
fn reach_of(rig: &Rig, centers: &Aabb) -> f64 {
    let spread = centers.diagonal();
    let mut matrix = Matrix3::zeros();
    let mut right = Vector3::zeros();
    for camera in &rig.cameras {
        let axis = camera.camera_from_world.row(2).transpose();
        let across = Matrix3::identity() - axis * axis.transpose();
        matrix += across;
        right += across * camera.position_m;
    }
    let middle = 0.5 * (centers.low + centers.high);
    let looked_at = matrix.try_inverse().map_or(f64::INFINITY, |inverse| (inverse * right - middle).norm());
    3.0 * spread + (2.0 * looked_at).min(12.0 * spread)
}

/// Estimates the prior of a take from a sample of its frames.
pub fn estimate(rig: &Rig, frames: &[&[Dot]], options: &EstimateOptions) -> Option<SceneModel> {
    let region = visible_region(rig)?;
    let sample = spread(frames, options.frames, SAMPLE_DOTS);
    let mut model = first_guess(rig, region, &sample);
    if let Some(noise) = options.noise {
        model.noise.fill(noise);
    } else {
        let scale = best_scale(rig, &model, &spread(&sample, SCALE_FRAMES, SCALE_DOTS));
        model.noise.fill(scale);
    }
    for round in 0..ROUNDS {
        model = improved(rig, &model, &sample, options.noise.is_none(), round);
    }
    // Markers further from all that the sample shows than half its extent are not believed.
    model.region = region.intersection(&model.volume.grown(Vector3::repeat(0.5 * model.volume.diagonal())));
    Some(model)
}

/// At most `n` of the frames and about `dots` dots, evenly spread; frames without dots are left out.
fn spread<'a>(frames: &[&'a [Dot]], n: usize, dots: usize) -> Vec<&'a [Dot]> {
    let filled: Vec<&[Dot]> = frames.iter().copied().filter(|f| !f.is_empty()).collect();
    let mean = filled.iter().map(|f| f.len()).sum::<usize>() / filled.len().max(1);
    let m = filled.len().min(n).min((dots / mean.max(1)).max(2));
    (0..m).map(|i| filled[(2 * i + 1) * filled.len() / (2 * m)]).collect()
}

fn first_guess(rig: &Rig, region: Aabb, sample: &[&[Dot]]) -> SceneModel {
    let cameras = rig.cameras.len();
    let mut counts = vec![0.0; cameras];
    for frame in sample {
        frame.iter().for_each(|d| counts[d.camera] += 1.0);
    }
    let n = sample.len().max(1) as f64;
    let mut per_camera: Vec<f64> = counts.iter().map(|c| c / n).collect();
    per_camera.sort_unstable_by(f64::total_cmp);
    let median = per_camera.get(cameras / 2).copied().unwrap_or(1.0);
    SceneModel {
        region,
        volume: region,
        expected_markers: median.max(1.0),
        detection: 0.7,
        view_correction: vec![vec![0.0; cameras + 1]; cameras + 1],
        single_view_factor: 1.0,
        clutter: vec![0.5; cameras],
        noise: vec![1.0; cameras],
        tail: None,
        reflections: vec![Vec::new(); cameras],
    }
}

fn search_options() -> OptimalOptions {
    OptimalOptions { enumerate: EnumerateOptions { step_limit: 200_000 }, node_limit: 2_000 }
}

fn best_scale(rig: &Rig, model: &SceneModel, sample: &[&[Dot]]) -> f64 {
    let mut best = (0.0, 1.0);
    let mut scale = SMALLEST_SCALE;
    let (mut worse, mut share) = (0, 0.0);
    // Where nearly everything is explained the top is behind; where half is, it may have a dip.
    while scale <= LARGEST_SCALE && !(share > 0.8 && worse >= 1 || share > 0.5 && worse >= 3) {
        let trial = SceneModel { noise: vec![scale; rig.cameras.len()], ..model.clone() };
        let (objective, explained) = objective_of(rig, &trial, sample);
        if objective > best.0 {
            best = (objective, scale);
            (worse, share) = (0, explained);
        } else {
            worse += 1;
        }
        scale *= 1.5;
    }
    best.1
}

/// Objective over the sample, and the share of its dots in groups of three or more.
fn objective_of(rig: &Rig, model: &SceneModel, sample: &[&[Dot]]) -> (f64, f64) {
    let scene = Scene::new(rig, model);
    let (mut objective, mut explained, mut all) = (0.0, 0, 0);
    for dots in sample {
        let (candidates, packing) = choose(&scene, &PreparedFrame::new(&scene, dots), &search_options());
        objective += packing.value;
        all += dots.len();
        explained += packing.chosen.iter().map(|&g| candidates.dots(g).len()).filter(|&n| n > 2).sum::<usize>();
    }
    (objective, explained as f64 / all.max(1) as f64)
}

/// What one pass over the sample collects.
struct Evidence {
    /// Groups of three dots or more, with their points.
    members: Vec<(Vec<Sight>, Vector3<f64>)>,
    points: Vec<Vector3<f64>>,
    groups: f64,
    /// Groups by the number of cameras that could see them and that did: `[could][did]`.
    views: Vec<Vec<f64>>,
    /// By camera: pixels of dots that are in no group.
    alone: Vec<Vec<[f64; 2]>>,
    frames: f64,
}

fn improved(rig: &Rig, model: &SceneModel, sample: &[&[Dot]], noise_is_free: bool, round: usize) -> SceneModel {
    let evidence = collect(rig, model, sample);
    let mut next = model.clone();
    let n = evidence.frames.max(1.0);
    next.expected_markers = (evidence.groups / n).max(0.5);
    next.detection = detection_of(&evidence.views);
    let alone: usize = evidence.alone.iter().map(Vec::len).sum();
    let single_views = expected_single_views(&evidence.views, next.detection);
    // What single views do not explain is clutter.
    if round >= ROUNDS_INDEPENDENT {
        next.view_correction = view_correction(&evidence.views, next.detection);
        next.single_view_factor = ((alone as f64 + 1.0) / (single_views + 1.0)).min(1.0);
    }
    let single_views_per_camera = next.single_view_factor * single_views / (n * rig.cameras.len() as f64);
    if let Some(volume) = volume_of(&evidence.points, &model.region) {
        next.volume = volume;
    }
    for camera in 0..rig.cameras.len() {
        if round >= ROUNDS_INDEPENDENT {
            next.reflections[camera] = reflections_of(&evidence.alone[camera], model.noise[camera], evidence.frames);
        }
        let fixed: f64 = next.reflections[camera].iter().map(|r| r.rate).sum();
        let alone = evidence.alone[camera].len() as f64 / n;
        next.clutter[camera] = (alone - fixed - single_views_per_camera).max(0.02);
    }
    if noise_is_free {
        (next.noise, next.tail) = fit_noise(&evidence.members, &model.noise, model.tail, round + 1 < ROUNDS);
    }
    next
}

fn binomial(could: usize, did: usize, detection: f64) -> f64 {
    let choices = (0..did).map(|i| (could - i) as f64 / (i + 1) as f64).product::<f64>();
    choices * detection.powi(did as i32) * (1.0 - detection).powi((could - did) as i32)
}

/// Logarithm of the observed over the independent frequency of each number of views, shrunk towards none.
fn view_correction(views: &[Vec<f64>], detection: f64) -> Vec<Vec<f64>> {
    let correct = |could: usize, observed: &Vec<f64>| {
        let expected = |did: usize| if did <= could { binomial(could, did, detection) } else { 0.0 };
        let (groups, chance) = (observed.iter().sum::<f64>(), (2..=could).map(expected).sum::<f64>().max(1e-12));
        let prior = 5.0;
        let one = |did: usize| {
            let share = if did < 2 { 0.0 } else { expected(did) / chance };
            if share <= 0.0 {
                return 0.0;
            }
            ((observed[did] + prior * share) / ((groups + prior) * share)).ln().clamp(-5.0, 3.0)
        };
        (0..observed.len()).map(one).collect()
    };
    views.iter().enumerate().map(|(could, observed)| correct(could, observed)).collect()
}

/// Detection rate that gives the observed mean number of views, among markers with two views or more (a marker with
/// fewer makes no group, so the plain mean would be too high). Shrunk as if ten views more had been tried, seven seen.
fn detection_of(views: &[Vec<f64>]) -> f64 {
    let mean_excess = |detection: f64| {
        let mut excess = 7.0 - 10.0 * detection;
        for (could, observed) in views.iter().enumerate().filter(|(could, _)| *could >= 2) {
            let chance: f64 = (2..=could).map(|did| binomial(could, did, detection)).sum();
            let mean: f64 = (2..=could).map(|did| did as f64 * binomial(could, did, detection)).sum::<f64>() / chance;
            excess += observed.iter().enumerate().map(|(did, n)| n * (did as f64 - mean)).sum::<f64>();
        }
        excess
    };
    let (mut low, mut high) = (0.2, 0.98);
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if mean_excess(middle) > 0.0 { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// How many markers independent cameras would have seen once each, given those in groups.
fn expected_single_views(views: &[Vec<f64>], detection: f64) -> f64 {
    let mut expected = 0.0;
    for (could, observed) in views.iter().enumerate().filter(|(could, _)| *could >= 2) {
        let in_groups: f64 = (2..=could).map(|did| binomial(could, did, detection)).sum();
        expected += observed.iter().sum::<f64>() * binomial(could, 1, detection) / in_groups.max(1e-9);
    }
    expected
}

fn collect(rig: &Rig, model: &SceneModel, sample: &[&[Dot]]) -> Evidence {
    let scene = Scene::new(rig, model);
    let cameras = rig.cameras.len();
    let mut evidence = Evidence {
        members: Vec::new(),
        points: Vec::new(),
        groups: 0.0,
        views: vec![vec![0.0; cameras + 1]; cameras + 1],
        alone: vec![Vec::new(); cameras],
        frames: sample.len() as f64,
    };
    for dots in sample {
        let frame = PreparedFrame::new(&scene, dots);
        let (candidates, packing) = choose(&scene, &frame, &search_options());
        let mut used = vec![false; frame.len()];
        for &group in &packing.chosen {
            let members = candidates.dots(group);
            members.iter().for_each(|&z| used[z as usize] = true);
            evidence.groups += 1.0;
            let seen = members.iter().fold(0u128, |m, &z| m | (1 << frame.sights[z as usize].camera));
            let could = (scene.visible(&candidates.points[group]) | seen).count_ones();
            evidence.views[could as usize][members.len()] += 1.0;
            if members.len() < 3 {
                continue;
            }
            evidence.points.push(candidates.points[group]);
            let sights = members.iter().map(|&z| frame.sights[z as usize].clone()).collect();
            evidence.members.push((sights, candidates.points[group]));
        }
        for (z, _) in used.iter().enumerate().filter(|(_, u)| !**u) {
            let dot = &dots[frame.input_index[z]];
            evidence.alone[dot.camera].push(dot.pixel);
        }
    }
    evidence
}

/// The box of the points, grown so that unseen frames fit, and never smaller than a tenth of the region.
fn volume_of(points: &[Vector3<f64>], region: &Aabb) -> Option<Aabb> {
    let mut low = Vector3::zeros();
    let mut high = Vector3::zeros();
    if points.is_empty() {
        return None;
    }
    for axis in 0..3 {
        let mut values: Vec<f64> = points.iter().map(|p| p[axis]).collect();
        values.sort_unstable_by(f64::total_cmp);
        let cut = values.len() / 200;
        (low[axis], high[axis]) = (values[cut], values[values.len() - 1 - cut]);
    }
    let n = points.len() as f64;
    // The extremes of n samples miss 1/n of the range on each side; a handful of points says little.
    let margin = (high - low) * (2.0 / n).clamp(0.02, 1.0) + (region.high - region.low) / (n + 10.0);
    Some(Aabb { low, high }.grown(margin).intersection(region))
}

/// Places where dots without a group appear in at least 30 % of the frames.
fn reflections_of(alone: &[[f64; 2]], noise_px: f64, frames: f64) -> Vec<Reflection> {
    if frames < 5.0 {
        return Vec::new();
    }
    let radius = (4.0 * noise_px).max(1.0);
    let mut sorted = alone.to_vec();
    sorted.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let mut used = vec![false; sorted.len()];
    let mut found = Vec::new();
    for i in 0..sorted.len() {
        if used[i] {
            continue;
        }
        let near: Vec<usize> = (i..sorted.len())
            .take_while(|&j| sorted[j][0] - sorted[i][0] <= 2.0 * radius)
            .filter(|&j| !used[j] && (sorted[j][1] - sorted[i][1]).abs() <= radius)
            .collect();
        let rate = near.len() as f64 / frames;
        if rate < 0.3 {
            continue;
        }
        let n = near.len() as f64;
        let mean = [0, 1].map(|axis| near.iter().map(|&j| sorted[j][axis]).sum::<f64>() / n);
        let spread2 =
            near.iter().map(|&j| (sorted[j][0] - mean[0]).powi(2) + (sorted[j][1] - mean[1]).powi(2)).sum::<f64>();
        near.iter().for_each(|&j| used[j] = true);
        let spread_px = (0.5 * spread2 / n).sqrt().max(noise_px).max(0.05);
        found.push(Reflection { pixel: mean, rate: rate.min(1.0), spread_px });
    }
    found
}
