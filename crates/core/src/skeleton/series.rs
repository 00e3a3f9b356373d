//! A number over time with its variance, infinite where nothing was told: smoothed, without the sample itself, and
//! carried through gaps (Kalman filter and Rauch–Tung–Striebel smoother; value and velocity, white acceleration).

use nalgebra::{Matrix2, Vector2};

/// What is carried through a gap follows from so much on both sides of it (s).
const AROUND_S: f64 = 2.0;
/// Accelerations are told over such steps (s), within which they may be so many times as large.
const BEND_S: f64 = 0.05;
const SHARPER: f64 = 2.0;
/// How fast a series leaves its smoothed course at the edge of a gap is told over such a step (s).
const EDGE_S: f64 = 0.02;
/// A component is observed where its variance is below this part of that of rest.
const OBSERVED: f64 = 0.2;
/// This quantile of a series' accelerations is the size that smoothing expects.
const SHARPEST: f64 = 0.99;

/// A series over its gaps: smoothed with accelerations of the size that it shows around each gap beyond its noise, and
/// shifted within the gap so that it meets the samples on both sides, their slopes too. Outside of gaps the samples themselves.
pub fn carried(values: &[f64], variance: &[f64], step_s: f64, least: f64) -> Vec<(f64, f64)> {
    let mut out: Vec<(f64, f64)> = values.iter().zip(variance).map(|(v, s)| (*v, s.sqrt())).collect();
    let around = (AROUND_S / step_s).round() as usize;
    let lag = ((EDGE_S / step_s).round() as usize).max(1);
    let mut t = 0;
    while t < values.len() {
        if variance[t].is_finite() {
            t += 1;
            continue;
        }
        let end = (t..values.len()).find(|&e| variance[e].is_finite()).unwrap_or(values.len());
        let (low, high) = (t.saturating_sub(around), (end + around).min(values.len()));
        let (own, spread) = (&values[low..high], &variance[low..high]);
        let (mean, sd2) = smoothed(own, spread, step_s, true_acceleration(own, spread, step_s).max(least));
        let off = |at: usize| variance[at].is_finite().then(|| values[at] - mean[at - low]);
        let before = t.checked_sub(1).map(|edge| departure(edge, t.saturating_sub(1 + lag).max(low), off));
        let after = (end < values.len()).then(|| departure(end, (end + lag).min(high - 1), off));
        for (step, place) in (t..end).enumerate() {
            let shift = match (before, after) {
                (Some(b), Some(a)) => between(b, a, step + 1, end - t + 1),
                (b, a) => b.or(a).map_or(0.0, |edge| edge.0),
            };
            out[place] = (mean[place - low] + shift, sd2[place - low].sqrt());
        }
        t = end;
    }
    out
}

/// By how much the samples are off at an edge, and how fast that changes up to there (per sample, in order of time).
fn departure(edge: usize, other: usize, off: impl Fn(usize) -> Option<f64>) -> (f64, f64) {
    let value = off(edge).unwrap_or(0.0);
    let slope = off(other).filter(|_| other != edge).map_or(0.0, |far| (value - far) / (edge as f64 - other as f64));
    (value, slope)
}

/// A cubic between two values with their slopes (per sample), so many samples of all after the first (Hermite).
fn between((b, b_slope): (f64, f64), (a, a_slope): (f64, f64), samples: usize, all: usize) -> f64 {
    let (s, length) = (samples as f64 / all as f64, all as f64);
    let (s2, s3) = (s * s, s * s * s);
    b * (2.0 * s3 - 3.0 * s2 + 1.0)
        + b_slope * length * (s3 - 2.0 * s2 + s)
        + a * (3.0 * s2 - 2.0 * s3)
        + a_slope * length * (s3 - s2)
}

/// Size of the accelerations in a series beyond what its noise makes: over steps so long that noise makes little.
fn true_acceleration(values: &[f64], variance: &[f64], step_s: f64) -> f64 {
    let lag = ((BEND_S / step_s).round() as usize).max(1);
    let (mut sum, mut count) = (0.0, 0usize);
    for t in lag..values.len().saturating_sub(lag) {
        let noise = variance[t - lag] + 4.0 * variance[t] + variance[t + lag];
        if noise.is_finite() {
            sum += (values[t - lag] - 2.0 * values[t] + values[t + lag]).powi(2) - noise;
            count += 1;
        }
    }
    if count == 0 { 0.0 } else { (f64::max(sum, 0.0) / count as f64).sqrt() / (lag as f64 * step_s).powi(2) }
}

/// Variance that the data alone give, where a prior of variance `rest` was in it; infinite where they say little.
pub fn data_alone(variance: f64, rest: f64) -> f64 {
    if variance > OBSERVED * rest || variance.is_infinite() {
        return f64::INFINITY;
    }
    if rest.is_infinite() { variance } else { 1.0 / (1.0 / variance - 1.0 / rest) }
}

/// For every sample, what the others say: mean and standard deviation (infinite where they say nothing).
///
/// The state is value and velocity, moved by white acceleration of the size that the series itself shows.
pub fn without_itself(values: &[f64], variance: &[f64], step_s: f64, least: f64) -> Vec<(f64, f64)> {
    let known = variance.iter().filter(|v| v.is_finite()).count();
    if known < 2 {
        return values.iter().map(|&v| (v, f64::INFINITY)).collect();
    }
    let acceleration = shown_acceleration(values, variance, step_s).max(least);
    let (mean, spread) = smoothed(values, variance, step_s, acceleration);
    let take_out = |t: usize| {
        let share = spread[t] / variance[t];
        if variance[t].is_infinite() {
            (mean[t], spread[t].sqrt())
        } else if share > 0.999 {
            (values[t], f64::INFINITY)
        } else {
            ((mean[t] - share * values[t]) / (1.0 - share), (spread[t] / (1.0 - share)).sqrt())
        }
    };
    (0..values.len()).map(take_out).collect()
}

/// Size of the accelerations in a series: that of the sharpest moments, so that no motion that the data show is smoothed
/// away; over steps so long that noise makes little of it.
fn shown_acceleration(values: &[f64], variance: &[f64], step_s: f64) -> f64 {
    let lag = ((BEND_S / step_s).round() as usize).max(1);
    let bend = |t: usize| {
        let known = [t - lag, t, t + lag].iter().all(|&t| variance[t].is_finite());
        known.then(|| (values[t - lag] - 2.0 * values[t] + values[t + lag]).abs() / (lag as f64 * step_s).powi(2))
    };
    let mut bends: Vec<f64> = (lag..values.len().saturating_sub(lag)).filter_map(bend).collect();
    if bends.is_empty() {
        return 0.0;
    }
    let at = ((bends.len() as f64 * SHARPEST) as usize).min(bends.len() - 1);
    let (_, high, _) = bends.select_nth_unstable_by(at, f64::total_cmp);
    SHARPER * *high
}

/// Mean and variance of every sample given all (Rauch, Tung & Striebel 1965).
fn smoothed(values: &[f64], variance: &[f64], dt: f64, acceleration: f64) -> (Vec<f64>, Vec<f64>) {
    let n = values.len();
    let first = variance.iter().position(|v| v.is_finite()).unwrap_or(0);
    let go = Matrix2::new(1.0, dt, 0.0, 1.0);
    let noise = Matrix2::new(dt.powi(4) / 4.0, dt.powi(3) / 2.0, dt.powi(3) / 2.0, dt * dt) * acceleration.powi(2);
    let velocity = acceleration * 0.2;
    let mut x = Vector2::new(values[first], 0.0);
    let mut p = Matrix2::new(1e2, 0.0, 0.0, velocity * velocity + 1e-6);
    let (mut filtered, mut predicted) = (Vec::with_capacity(n), Vec::with_capacity(n));
    for t in 0..n {
        if t > 0 {
            x = go * x;
            p = go * p * go.transpose() + noise;
        }
        predicted.push((x, p));
        if variance[t].is_finite() {
            let total = p[(0, 0)] + variance[t];
            let gain = p.column(0) / total;
            x += gain * (values[t] - x[0]);
            let row = p.row(0).into_owned();
            p -= gain * row;
            p = (p + p.transpose()) * 0.5;
        }
        filtered.push((x, p));
    }
    let (mut mean, mut spread) = (vec![0.0; n], vec![0.0; n]);
    let (mut later_x, mut later_p) = filtered[n - 1];
    for t in (0..n).rev() {
        if t + 1 < n {
            let (x, p) = filtered[t];
            let (ahead_x, ahead_p) = predicted[t + 1];
            let back = p * go.transpose() * ahead_p.try_inverse().unwrap_or_else(Matrix2::zeros);
            later_x = x + back * (later_x - ahead_x);
            later_p = p + back * (later_p - ahead_p) * back.transpose();
        }
        mean[t] = later_x[0];
        spread[t] = later_p[(0, 0)].max(1e-18);
    }
    (mean, spread)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gap_is_left_and_entered_at_the_samples_own_speed() {
        // A swing that is hidden where it is fastest, in a series that is calm elsewhere.
        let value = |t: usize| if (180..320).contains(&t) { (t as f64 * 0.05).sin() } else { (9.0_f64).sin() };
        let values: Vec<f64> = (0..500).map(value).collect();
        let variance: Vec<f64> = (0..500).map(|t| if (230..260).contains(&t) { f64::INFINITY } else { 1e-3 }).collect();
        let filled: Vec<f64> = carried(&values, &variance, 0.01, 2.0).into_iter().map(|f| f.0).collect();
        for edge in [229, 259] {
            let (step, truth) = (filled[edge + 1] - filled[edge], value(edge + 1) - value(edge));
            assert!((step - truth).abs() < 6e-4, "{edge}: {step} instead of {truth}");
        }
        assert!((filled[229] - values[229]).abs() + (filled[260] - values[260]).abs() < 1e-12);
    }

    #[test]
    fn a_cubic_has_the_values_and_slopes_of_its_ends() {
        let at = |samples: usize| between((1.0, 0.2), (3.0, -0.1), samples, 1000);
        assert!((at(0) - 1.0).abs() < 1e-12 && (at(1000) - 3.0).abs() < 1e-12);
        assert!((at(1) - at(0) - 0.2).abs() < 1e-3 && (at(1000) - at(999) + 0.1).abs() < 1e-3);
    }
}
