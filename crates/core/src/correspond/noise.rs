//! The noise of a take's dots: one scale per camera, and a tail where the residuals have one.
//!
//! Residuals of groups of three dots or more, freed of their leverage (a dot pulls its point towards itself), give the
//! variance of each camera; the points are weighted by these variances in turn, so the two are iterated to agreement.

use super::scene::Tail;
use crate::sight::Sight;
use crate::triangulate::refine;
use nalgebra::{Matrix2, Vector2, Vector3};

const ITERATIONS: usize = 60;
/// Largest relative change of a camera's noise at which the iteration has converged.
const CONVERGED: f64 = 2e-3;
/// Groups that take part in the iteration.
const GROUPS: usize = 1000;
/// A camera's own residuals count like this many of the rig's.
const PRIOR_DOTS: f64 = 30.0;
const SMALLEST_NOISE: f64 = 1e-3;

/// Residuals by camera, in units of the dots' own sigma.
struct Residuals {
    /// Half the squared length of each.
    half_squares: Vec<Vec<f64>>,
    /// Their sum as vectors.
    sums: Vec<Vector2<f64>>,
}

/// Noise per camera and tail from groups of dots whose sights were made with the noise `before`.
pub fn fit_noise(
    groups: &[(Vec<Sight>, Vector3<f64>)],
    before: &[f64],
    tail: Option<Tail>,
    tail_is_free: bool,
) -> (Vec<f64>, Option<Tail>) {
    let step = groups.len().div_ceil(GROUPS).max(1);
    let sample: Vec<_> = groups.iter().step_by(step).collect();
    let mut noise = before.to_vec();
    for _ in 0..ITERATIONS {
        let next = noise_of(&residuals_of(&sample, before, &noise, tail), &noise, tail);
        let change = next.iter().zip(&noise).map(|(a, b)| (a / b - 1.0).abs()).fold(0.0, f64::max);
        noise = next;
        if change < CONVERGED {
            break;
        }
    }
    let residuals = residuals_of(&sample, before, &noise, tail);
    let tail = if tail_is_free { tail_of(&residuals.half_squares, &noise) } else { tail };
    (noise, tail)
}

fn residuals_of(
    groups: &[&(Vec<Sight>, Vector3<f64>)],
    before: &[f64],
    noise: &[f64],
    tail: Option<Tail>,
) -> Residuals {
    let cameras = noise.len();
    let mut out = Residuals { half_squares: vec![Vec::new(); cameras], sums: vec![Vector2::zeros(); cameras] };
    for (sights, point) in groups {
        let rescaled: Vec<Sight> =
            sights.iter().map(|s| Sight { rows: s.rows * (before[s.camera] / noise[s.camera]), ..s.clone() }).collect();
        add_residuals(&mut out, &rescaled.iter().collect::<Vec<_>>(), *point, noise, tail);
    }
    out
}

fn add_residuals(out: &mut Residuals, sights: &[&Sight], start: Vector3<f64>, noise: &[f64], tail: Option<Tail>) {
    let weight = |squared: f64| tail.map_or(1.0, |t| t.weight(squared));
    let Some((point, normal)) = refine(sights, start, weight) else { return };
    let Some(covariance) = normal.information().try_inverse() else { return };
    for sight in sights {
        let linear = sight.linearise(&point);
        let share = weight(linear.error.norm_squared());
        let kept = Matrix2::identity() - share * (linear.by_point * covariance * linear.by_point.transpose());
        let freedom = 0.5 * kept.trace();
        if freedom > 0.1 {
            let scale = noise[sight.camera];
            out.half_squares[sight.camera].push(0.5 * linear.error.norm_squared() * scale * scale / freedom);
            out.sums[sight.camera] += linear.error * scale / freedom.sqrt();
        }
    }
}

/// Noise per camera: the core of the residuals, shrunk towards the rig's. A residual that points the same way all the
/// time is an error of calibration: it is no measure of a camera's noise, and weighting by it would let the cameras
/// that happen to agree dictate the points. So the own variance counts only as far as it is not bias.
fn noise_of(residuals: &Residuals, before: &[f64], tail: Option<Tail>) -> Vec<f64> {
    let all: Vec<f64> = residuals.half_squares.iter().flatten().copied().collect();
    let Some(overall) = core_variance(&all, tail) else { return before.to_vec() };
    let shrunk = |(own, sum): (&Vec<f64>, &Vector2<f64>)| {
        let variance = core_variance(own, tail).unwrap_or(overall);
        let n = own.len().max(1) as f64;
        let mean_square = 2.0 * own.iter().sum::<f64>() / n;
        let constant = ((sum / n).norm_squared() - mean_square / n) / mean_square.max(1e-300);
        let trust = n / (n + PRIOR_DOTS) * (1.0 - constant).clamp(0.0, 1.0);
        // Shrunk on a logarithmic scale: a linear one would pull the best camera's variance up by a large factor.
        let ln_variance = trust * variance.max(1e-12).ln() + (1.0 - trust) * overall.max(1e-12).ln();
        (0.5 * ln_variance).exp().max(SMALLEST_NOISE)
    };
    residuals.half_squares.iter().zip(&residuals.sums).map(shrunk).collect()
}

/// Variance per axis of two-dimensional residuals (given as half their squared length). Where there is a tail, from
/// the median, so that the tail does not count.
fn core_variance(half_squares: &[f64], tail: Option<Tail>) -> Option<f64> {
    if half_squares.is_empty() {
        return None;
    }
    if tail.is_none() {
        return Some(half_squares.iter().sum::<f64>() / half_squares.len() as f64);
    }
    let mut sorted = half_squares.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    // Half the squared length of a two-dimensional normal is exponential: its median is σ² ln 2.
    Some(sorted[sorted.len() / 2] / std::f64::consts::LN_2)
}

/// Fits the wide component by expectation–maximisation; `None` where one Gaussian explains the residuals as well.
fn tail_of(residuals: &[Vec<f64>], noise: &[f64]) -> Option<Tail> {
    let scaled: Vec<f64> =
        residuals.iter().zip(noise).flat_map(|(own, s)| own.iter().map(move |r| r / (s * s))).collect();
    if scaled.len() < 100 {
        return None;
    }
    // In exponential variables: density = (1 − a)·e^(−r/c)/c + a·e^(−r/d)/d.
    let n = scaled.len() as f64;
    let mean = scaled.iter().sum::<f64>() / n;
    let (mut share, mut core, mut wide) = (0.1, 0.6 * mean, 5.0 * mean);
    for _ in 0..60 {
        let (mut sum_a, mut sum_core, mut sum_wide) = (0.0, 0.0, 0.0);
        for r in &scaled {
            let p_wide = share * (-r / wide).exp() / wide;
            let p_core = (1.0 - share) * (-r / core).exp() / core;
            let a = p_wide / (p_wide + p_core).max(1e-300);
            sum_a += a;
            sum_wide += a * r;
            sum_core += (1.0 - a) * r;
        }
        share = (sum_a / n).clamp(1e-4, 0.5);
        core = sum_core / (n - sum_a).max(1e-9);
        wide = sum_wide / sum_a.max(1e-9);
    }
    let plain: f64 = scaled.iter().map(|r| -r / mean - mean.ln()).sum();
    let density = |r: &f64| share * (-r / wide).exp() / wide + (1.0 - share) * (-r / core).exp() / core;
    let mixed: f64 = scaled.iter().map(|r| density(r).ln()).sum();
    let scale = (wide / core).sqrt();
    // Two more parameters must earn their keep (Schwarz 1978), and a tail that hardly differs is none.
    let worthwhile = mixed - plain > n.ln() + 5.0;
    (worthwhile && scale > 2.0 && share > 0.005).then_some(Tail { share, scale: scale.min(6.0) })
}
