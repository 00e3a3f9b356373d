//! Noise of each camera from the residuals themselves, robust weights, and which sightings are wrong.

use super::Bundle;

/// Median of the length of a 2D error of standard deviation 1 per axis (Rayleigh).
const RAYLEIGH_MEDIAN: f64 = 1.177_410_022_5;
/// A sighting this many standard deviations off is left out. Wrong dots lie anywhere, so that few are nearer; blurred
/// ones of a fast wand have long tails and stay.
pub const OUTLYING: f64 = 6.0;
/// Fewer residuals say nothing about a camera's noise.
const FEWEST: usize = 8;

/// Noise (px per axis) of each camera from the median residual of its sightings that `counts` names.
///
/// Cameras with too few take the median of the others; a perfect fit counts as a millionth of a pixel.
pub fn noise_px(bundle: &Bundle, counts: impl Fn(usize) -> bool) -> Vec<f64> {
    let mut lengths = vec![Vec::new(); bundle.cameras.len()];
    for (i, s) in bundle.sightings.iter().enumerate() {
        if counts(i)
            && let Some(r) = bundle.residual(s)
        {
            lengths[s.camera].push(r.norm());
        }
    }
    let own: Vec<Option<f64>> =
        lengths.iter_mut().map(|l| (l.len() >= FEWEST).then(|| (median(l) / RAYLEIGH_MEDIAN).max(1e-6))).collect();
    let mut known: Vec<f64> = own.iter().copied().flatten().collect();
    let common = if known.is_empty() { 1.0 } else { median(&mut known) };
    own.into_iter().map(|o| o.unwrap_or(common)).collect()
}

/// Noise (px per axis) of each camera from the squares of the sightings in use, √(RSS/(n − p)); never below the median's.
///
/// Dots of a fast wand are blurred and err more than most: clipping at the median's noise would lose them.
pub fn noise_of_used_px(bundle: &Bundle) -> Vec<f64> {
    let mut sums = vec![(0.0, 0); bundle.cameras.len()];
    for s in bundle.sightings.iter().filter(|s| s.weight > 0.0) {
        if let Some(r) = bundle.residual(s) {
            sums[s.camera].0 += 0.5 * r.norm_squared();
            sums[s.camera].1 += 1;
        }
    }
    let typical = noise_px(bundle, |i| bundle.sightings[i].weight > 0.0);
    let lost = bundle.redundancy_factor();
    let rms = |(sum, n): &(f64, usize)| if *n > 0 { (lost * sum / *n as f64).sqrt() } else { 0.0 };
    sums.iter().zip(typical).map(|(own, typical)| rms(own).max(typical)).collect()
}

const SOFT_ROUNDS: usize = 4;
const HARD_ROUNDS: usize = 2;
const STEPS: usize = 8;

/// Adjusts with soft weights first, then without what lies too far off; the noise of each camera (px per axis).
pub fn adjust_robustly(bundle: &mut Bundle) -> Vec<f64> {
    for _ in 0..SOFT_ROUNDS {
        let noise = noise_px(bundle, |_| true);
        weigh_softly(bundle, &noise);
        bundle.adjust(STEPS);
    }
    let mut noise = noise_px(bundle, |_| true);
    for _ in 0..HARD_ROUNDS {
        weigh_hard(bundle, &noise);
        bundle.adjust(STEPS);
        noise = noise_of_used_px(bundle);
    }
    noise
}

/// The middle value; 0 for none.
pub fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Weights of Cauchy's loss: `1 / σ² / (1 + (r / 2σ)²)`, so that gross errors pull with almost nothing.
pub fn weigh_softly(bundle: &mut Bundle, noise_px: &[f64]) {
    for i in 0..bundle.sightings.len() {
        let s = bundle.sightings[i];
        let sigma = noise_px[s.camera];
        let soft = bundle.residual(&s).map_or(0.0, |r| 1.0 / (1.0 + r.norm_squared() / (4.0 * sigma * sigma)));
        bundle.sightings[i].weight = soft / (sigma * sigma);
    }
}

/// Weights `1 / σ²`, and none for sightings that lie too far off. Gives the number of those used.
pub fn weigh_hard(bundle: &mut Bundle, noise_px: &[f64]) -> usize {
    let mut used = 0;
    for i in 0..bundle.sightings.len() {
        let s = bundle.sightings[i];
        let sigma = noise_px[s.camera];
        let good = bundle.residual(&s).is_some_and(|r| r.norm() < OUTLYING * sigma);
        bundle.sightings[i].weight = if good { 1.0 / (sigma * sigma) } else { 0.0 };
        used += usize::from(good);
    }
    used
}
