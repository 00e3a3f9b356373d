//! A marker of which something hides a part: a blurred disk of known radius, cut by a straight edge.
//!
//! `value = height · Φ((radius − distance) / s) · Φ((along − cut) / s)`: the disk's own edge, and that of what hides it, seen so
//! closely that it is straight. Only pixels above a threshold are given, as motion-capture cameras send them; of the others
//! it is known that they are darker. Least squares over centre, direction and place of the cut, and height, from many
//! directions (Levenberg–Marquardt): an uncut disk is among the answers.

use super::disk::across_edge_f64;
use nalgebra::{SMatrix, SVector, Vector2};

/// Bright pixels of one blob.
#[derive(Clone, Debug, Default)]
pub struct Patch {
    /// Column, row and value of each.
    pub pixels: Vec<(u16, u16, u8)>,
}

/// What the camera is known to do.
#[derive(Clone, Copy, Debug)]
pub struct Sensor {
    /// Pixels that are not given are darker than this.
    pub threshold: f64,
    /// Radius of a whole marker's image (px).
    pub radius_px: f64,
    /// Blur of the edges (px, the pixels' own size included).
    pub blur_px: f64,
}

/// A fitted disk.
#[derive(Clone, Copy, Debug)]
pub struct Cut {
    /// Centre of the whole disk (px).
    pub center: Vector2<f64>,
    /// Standard deviation of the centre (px per axis), from the fit's residuals.
    pub sigma_px: f64,
    /// Part of the disk's diameter that is seen across the cut, 0 to 1.
    pub seen: f64,
    /// Residuals (rms, grey values).
    pub rest: f64,
}

const WHITE: f64 = 255.0;
/// Pixels around the blob of which is known that they are dark.
const MARGIN: usize = 3;
const DIRECTIONS: usize = 24;
/// Places of the cut that are tried, in radii from the centre towards what is seen.
const CUTS: [f64; 6] = [-0.9, -0.6, -0.3, 0.0, 0.3, 0.6];
/// Best starts that are followed, and their steps.
const FOLLOWED: usize = 3;
const STEPS: usize = 20;
/// Grey values by which the model itself is wrong: markers are no perfect disks.
const LEAST_REST: f64 = 8.0;

type Vector5 = SVector<f64, 5>;

/// One pixel near the blob; `None`: darker than the threshold.
struct Near {
    at: Vector2<f64>,
    value: Option<f64>,
}

/// The disk that explains a blob best. `None` for fewer than three pixels.
pub fn fit(patch: &Patch, sensor: &Sensor) -> Option<Cut> {
    if patch.pixels.len() < 3 {
        return None;
    }
    let near = surroundings(patch);
    let middle = weighted_middle(patch, sensor.threshold);
    let mut starts: Vec<(f64, Vector5)> = Vec::with_capacity(DIRECTIONS * CUTS.len());
    for k in 0..DIRECTIONS {
        let turn = std::f64::consts::TAU * k as f64 / DIRECTIONS as f64;
        let ahead = Vector2::new(turn.cos(), turn.sin());
        for cut in CUTS {
            let center = middle - ahead * (sensor.radius_px * visible_offset(cut));
            let mut start = Vector5::from([center.x, center.y, turn, cut * sensor.radius_px, 1.0]);
            start[4] = best_height(&near, &start, sensor);
            starts.push((cost(&near, &start, sensor), start));
        }
    }
    starts.sort_by(|a, b| a.0.total_cmp(&b.0));
    let followed = starts.iter().take(FOLLOWED).map(|(_, start)| refined(&near, *start, sensor));
    let (cost, best, information) = followed.min_by(|a, b| a.0.total_cmp(&b.0))?;
    let lit = patch.pixels.len() as f64;
    let rest = (cost / (lit - 5.0).max(1.0)).sqrt().max(LEAST_REST);
    let covariance = information.try_inverse()?;
    let variance = 0.5 * (covariance[(0, 0)] + covariance[(1, 1)]) * rest * rest;
    let seen = (0.5 * (1.0 - best[3] / sensor.radius_px)).clamp(0.0, 1.0);
    Some(Cut { center: Vector2::new(best[0], best[1]), sigma_px: variance.sqrt(), seen, rest })
}

fn surroundings(patch: &Patch) -> Vec<Near> {
    let x = patch.pixels.iter().map(|p| usize::from(p.0));
    let y = patch.pixels.iter().map(|p| usize::from(p.1));
    let (left, right) = (x.clone().min().unwrap_or(0), x.max().unwrap_or(0) + 2 * MARGIN);
    let (top, bottom) = (y.clone().min().unwrap_or(0), y.max().unwrap_or(0) + 2 * MARGIN);
    let width = right - left + 1;
    let mut near: Vec<Near> = (0..width * (bottom - top + 1))
        .map(|k| Near {
            at: Vector2::new((left + k % width) as f64 - MARGIN as f64, (top + k / width) as f64 - MARGIN as f64),
            value: None,
        })
        .collect();
    for (x, y, value) in &patch.pixels {
        let at = (usize::from(*y) + MARGIN - top) * width + usize::from(*x) + MARGIN - left;
        near[at].value = Some(f64::from(*value));
    }
    near
}

fn weighted_middle(patch: &Patch, threshold: f64) -> Vector2<f64> {
    let (mut sum, mut weight) = (Vector2::zeros(), 0.0);
    for (x, y, value) in &patch.pixels {
        let w = (f64::from(*value) - threshold).max(1.0);
        sum += w * Vector2::new(f64::from(*x), f64::from(*y));
        weight += w;
    }
    sum / weight
}

/// How far the middle of what is seen of a disk of radius 1 lies from its centre, where it is cut at a place.
fn visible_offset(cut: f64) -> f64 {
    let (mut moment, mut area) = (0.0, 0.0);
    for k in 0..100 {
        let u = cut + (1.0 - cut) * (f64::from(k) + 0.5) / 100.0;
        let width = (1.0 - u * u).max(0.0).sqrt();
        moment += u * width;
        area += width;
    }
    moment / area
}

/// Share of the height at a place, and its derivatives by centre, turn and cut.
fn model(at: &Vector2<f64>, p: &Vector5, sensor: &Sensor) -> (f64, [f64; 4]) {
    let arm = at - Vector2::new(p[0], p[1]);
    let distance = arm.norm().max(1e-9);
    let (sin, cos) = p[2].sin_cos();
    let s = sensor.blur_px;
    let (disk, disk_slope) = across_edge_f64((sensor.radius_px - distance) / s);
    let (open, open_slope) = across_edge_f64((arm.x * cos + arm.y * sin - p[3]) / s);
    let (by_disk, by_cut) = (open * disk_slope / s, disk * open_slope / s);
    let by = [
        by_disk * arm.x / distance - by_cut * cos,
        by_disk * arm.y / distance - by_cut * sin,
        by_cut * (arm.y * cos - arm.x * sin),
        -by_cut,
    ];
    (disk * open, by)
}

/// Residual of a pixel, and whether the model can change it: a saturated pixel may be brighter, a dark one darker.
fn residual(value: Option<f64>, expected: f64, threshold: f64) -> Option<f64> {
    match value {
        Some(value) if value >= WHITE && expected >= WHITE => None,
        Some(value) => Some(value - expected),
        None => (expected > threshold).then_some(threshold - expected),
    }
}

fn cost(near: &[Near], p: &Vector5, sensor: &Sensor) -> f64 {
    let off = |n: &Near| residual(n.value, p[4] * model(&n.at, p, sensor).0, sensor.threshold).unwrap_or(0.0);
    near.iter().map(|n| off(n).powi(2)).sum()
}

fn best_height(near: &[Near], p: &Vector5, sensor: &Sensor) -> f64 {
    let (mut product, mut square) = (0.0, 0.0);
    for n in near {
        if let Some(value) = n.value {
            let share = model(&n.at, p, sensor).0;
            product += share * value;
            square += share * share;
        }
    }
    (product / square.max(1e-9)).clamp(sensor.threshold, 2.0 * WHITE)
}

/// Levenberg–Marquardt: cost, parameters, and their information for residuals of variance 1.
fn refined(near: &[Near], start: Vector5, sensor: &Sensor) -> (f64, Vector5, SMatrix<f64, 5, 5>) {
    let (mut p, mut damping) = (start, 1e-2);
    let mut now = cost(near, &p, sensor);
    let mut information = SMatrix::<f64, 5, 5>::zeros();
    for _ in 0..STEPS {
        let mut gradient = Vector5::zeros();
        information = SMatrix::zeros();
        for n in near {
            let (share, by) = model(&n.at, &p, sensor);
            let Some(off) = residual(n.value, p[4] * share, sensor.threshold) else { continue };
            let row = Vector5::from([p[4] * by[0], p[4] * by[1], p[4] * by[2], p[4] * by[3], share]);
            information += row * row.transpose();
            gradient += row * off;
        }
        let mut damped = information;
        (0..5).for_each(|k| damped[(k, k)] += damping * information[(k, k)].max(1e-6));
        let Some(step) = damped.cholesky().map(|c| c.solve(&gradient)) else { break };
        let mut next = p + step;
        // A cut beyond the disk is none.
        next[3] = next[3].clamp(-1.5 * sensor.radius_px, sensor.radius_px);
        let then = cost(near, &next, sensor);
        if then < now {
            let settled = now - then < 1e-4 * now;
            (p, now, damping) = (next, then, damping * 0.3);
            if settled {
                break;
            }
        } else {
            damping *= 5.0;
            if damping > 1e6 {
                break;
            }
        }
    }
    // Directions of which the pixels say nothing are as open as the disk is large.
    let open = [1.0, 1.0, 1.0, 1.0, WHITE].map(|s| (LEAST_REST / s).powi(2));
    (0..5).for_each(|k| information[(k, k)] += open[k]);
    (now, p, information)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::random::Random;

    const SENSOR: Sensor = Sensor { threshold: 50.0, radius_px: 2.4, blur_px: 0.7 };

    fn rendered(p: &Vector5, noise: f64, random: &mut Random) -> Patch {
        let mut pixels = Vec::new();
        for y in 90..112_u16 {
            for x in 90..112_u16 {
                let at = Vector2::new(f64::from(x), f64::from(y));
                let value = p[4] * model(&at, p, &SENSOR).0 + noise * random.normal();
                if value > SENSOR.threshold {
                    pixels.push((x, y, value.min(WHITE) as u8));
                }
            }
        }
        Patch { pixels }
    }

    #[test]
    fn whole_half_and_saturated_disks_have_their_centres() {
        let mut random = Random::new(7, 0);
        for (cut, height, allowed) in [(-3.0, 200.0, 0.1), (-0.6, 200.0, 0.25), (0.0, 240.0, 0.4), (-0.6, 420.0, 0.3)] {
            let (mut squares, mut ratio) = (0.0, 0.0);
            for _ in 0..40 {
                let turn = random.between(0.0, std::f64::consts::TAU);
                let (x, y) = (random.between(100.0, 101.0), random.between(100.0, 101.0));
                let truth = Vector5::from([x, y, turn, cut * SENSOR.radius_px, height]);
                let found = fit(&rendered(&truth, 4.0, &mut random), &SENSOR).unwrap();
                let off = (found.center - Vector2::new(x, y)).norm_squared();
                squares += off;
                ratio += off / (2.0 * found.sigma_px.powi(2));
            }
            assert!((squares / 40.0_f64).sqrt() < allowed, "cut {cut}: {}", (squares / 40.0_f64).sqrt());
            assert!(ratio / 40.0 < 1.5, "cut {cut}: {ratio}");
        }
    }

    #[test]
    fn a_few_pixels_are_no_disk() {
        assert!(fit(&Patch { pixels: vec![(5, 5, 80), (6, 5, 80)] }, &SENSOR).is_none());
    }
}
