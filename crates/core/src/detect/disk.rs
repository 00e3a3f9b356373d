//! A blurred disk fitted to grey values.
//!
//! A marker's image is a disk whose edge is blurred by the lens and by the pixels' own size; across the edge the value is
//! `background + height · Φ((radius − distance) / s)`, Φ the normal distribution. Least squares over centre, radius and height
//! reaches the bound `σ ≥ (1 / SNR) √(2 s / (√π r))` of a disk located by its edge, where a centroid stays 1.3 to 2 times
//! above it. s is the camera's, not the marker's: it is fitted to some blobs of the image, and the median counts.

use super::level::Level;
use super::{Image, Value};
use nalgebra::{SMatrix, SVector, Vector2};
use std::sync::LazyLock;

/// A disk and how well it was fitted.
#[derive(Clone, Copy, Debug)]
pub struct Disk {
    /// Centre (px).
    pub center: Vector2<f64>,
    /// Radius (px).
    pub radius: f64,
    /// Value inside, above the background.
    pub height: f64,
    /// Residuals over what noise explains (rms, 1 or more).
    pub misfit: f64,
    /// Residuals (rms, grey values).
    pub rest: f64,
}

impl Disk {
    /// Standard deviation (px per axis) of the centre: that of its edge's location, and what the residuals say.
    pub fn sigma_px(&self, level: &Level, edge: Edge) -> f64 {
        let bound = (2.0 * edge.width_px / (std::f64::consts::PI.sqrt() * self.radius.max(0.5))).sqrt();
        let excess = if self.misfit > USUAL_MISFIT { self.misfit } else { 1.0 };
        excess * bound * level.noise / self.height.max(level.noise)
    }
}

impl Disk {
    /// Whether a fit has not run away from where it started.
    fn is_near(&self, start: &Self) -> bool {
        let moved = (self.center - start.center).norm();
        moved < 1.0 + 0.5 * start.radius && self.radius > 0.2 && self.radius < 3.0 * start.radius + 2.0
    }
}

/// The blur of a camera's edges.
#[derive(Clone, Copy, Debug)]
pub struct Edge {
    /// Standard deviation of the blur (px), the pixels' own size included.
    pub width_px: f64,
}

/// Φ and its derivative in the middle of each of the cells between −REACH and REACH.
static TABLE: LazyLock<Vec<(f32, f32)>> = LazyLock::new(|| {
    let at = |k: usize| {
        let u = REACH * ((2 * k + 1) as f64 / CELLS as f64 - 1.0);
        (normal_distribution(u) as f32, ((-0.5 * u * u).exp() / std::f64::consts::TAU.sqrt()) as f32)
    };
    (0..CELLS).map(at).collect()
});

/// Residuals so little above the noise say nothing.
const USUAL_MISFIT: f64 = 1.25;
/// Blur where an image tells none: a sharp lens.
const USUAL: f64 = 0.6;
/// Blobs to which the blur is fitted.
const LOOKED_AT: usize = 5;
/// A disk's values are known this many blur widths from its edge.
const REACH: f64 = 2.7;
/// Cells of the table: Φ changes by less than a thousandth in one.
const CELLS: usize = 2048;
const STEPS: usize = 5;
/// After a step d of the centre an error of about d² / 2s is left; this part of the centre's own uncertainty is enough.
const SETTLED: f64 = 0.2;
/// A step of the blur this small settles it (px).
const SETTLED_WIDTH_PX: f64 = 3e-3;
/// Blurs that a fit may give (px).
const WIDTHS: (f64, f64) = (0.3, 3.0);

impl Edge {
    /// The blur of an image's blobs.
    pub fn of<V: Value>(image: &Image<'_, V>, starts: &[Disk], level: &Level) -> Self {
        let usual = Self { width_px: USUAL };
        let good = |d: &&Disk| d.height > 10.0 * level.noise && d.radius > 1.0 && d.radius < 20.0;
        let step = (starts.len() / LOOKED_AT).max(1);
        let mut widths: Vec<f64> = starts
            .iter()
            .filter(good)
            .step_by(step)
            .filter_map(|start| solve::<V, 5>(image, start, level, usual).map(|f| f.1))
            .filter(|w| *w > WIDTHS.0 && *w < WIDTHS.1)
            .collect();
        if widths.is_empty() {
            return usual;
        }
        let middle = widths.len() / 2;
        Self { width_px: *widths.select_nth_unstable_by(middle, f64::total_cmp).1 }
    }
}

/// Φ(u) and its derivative, from the table.
fn across_edge(table: &[(f32, f32)], u: f32) -> (f32, f32) {
    const REACHED: f32 = REACH as f32;
    let place = (u + REACHED) * (CELLS as f32 / (2.0 * REACHED));
    if place <= 0.0 {
        return (0.0, 0.0);
    }
    match table.get(place as i32 as usize) {
        Some(&pair) => pair,
        None => (1.0, 0.0),
    }
}

/// Φ(u) and its derivative, zero or one far from the edge.
pub(super) fn across_edge_f64(u: f64) -> (f64, f64) {
    let (share, slope) = across_edge(&TABLE, u as f32);
    (f64::from(share), f64::from(slope))
}

/// Φ by the error function of Abramowitz & Stegun 7.1.26, good to 1.5e-7.
fn normal_distribution(u: f64) -> f64 {
    let z = u.abs() / std::f64::consts::SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * z);
    let series =
        t * (0.254_829_592 + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    let upper = 0.5 * series * (-z * z).exp();
    if u > 0.0 { 1.0 - upper } else { upper }
}

/// The disk that fits the values around a start best. `None` where it runs away or another blob is in the way.
pub fn fit<V: Value>(image: &Image<'_, V>, start: &Disk, level: &Level, edge: Edge) -> Option<Disk> {
    solve::<V, 4>(image, start, level, edge).map(|f| f.0)
}

/// The smallest pixel that is not left of a place (a cast is many times as fast as rounding where the processor has none).
fn not_below(place: f64) -> usize {
    let whole = place.max(0.0) as usize;
    whole + usize::from((whole as f64) < place)
}

/// A pixel's part of the normal equations. Both halves of the symmetric products: whole rows go through one register.
#[inline]
fn add<const N: usize>(products: &mut [[f32; N]; N], gradient: &mut [f32; N], by: &[f32; N], residual: f32) {
    for j in 0..N {
        gradient[j] += by[j] * residual;
        for i in 0..N {
            products[j][i] += by[i] * by[j];
        }
    }
}

/// Gauss–Newton over centre, radius, height and, with five parameters, the width of the edge.
fn solve<V: Value, const N: usize>(
    image: &Image<'_, V>,
    start: &Disk,
    level: &Level,
    edge: Edge,
) -> Option<(Disk, f64)> {
    let reach = start.radius + REACH * edge.width_px + 0.5;
    let low = start.center.map(|c| (c - reach).max(0.0) as usize);
    let (right, bottom) = (
        not_below(start.center.x + reach).min(image.width - 1),
        not_below(start.center.y + reach).min(image.height - 1),
    );
    let (mut disk, mut width) = (*start, edge.width_px);
    let table: &[(f32, f32)] = &TABLE;
    for _ in 0..STEPS {
        // Sums over a hundred pixels or so: single precision is enough, and twice as fast.
        let (mut products, mut gradient) = ([[0.0_f32; N]; N], [0.0_f32; N]);
        let (inverse_width, radius, height) = ((1.0 / width) as f32, disk.radius as f32, disk.height as f32);
        let background = level.background as f32;
        let (mut squares, mut count) = (0.0_f32, 0_u32);
        for y in low.y..=bottom {
            let rise = y as f64 - disk.center.y;
            let half = (reach * reach - rise * rise).max(0.0).sqrt();
            let first = not_below(disk.center.x - half).max(low.x);
            let last = ((disk.center.x + half).max(0.0) as usize).min(right);
            let (left, rise) = ((first as f64 - disk.center.x) as f32, rise as f32);
            let row = &image.values[y * image.width + first..=y * image.width + last.max(first)];
            for (k, value) in (0_i32..).zip(row.iter().take((last + 1).saturating_sub(first))) {
                let run = left + k as f32;
                let distance = (run * run + rise * rise).sqrt();
                let u = (radius - distance) * inverse_width;
                let (share, slope) = across_edge(table, u);
                let residual = value.grey() - background - height * share;
                squares += residual * residual;
                count += 1;
                if slope == 0.0 {
                    // Inside, only the height tells; outside, nothing does.
                    products[3][3] += share;
                    gradient[3] += share * residual;
                    continue;
                }
                let steep = height * slope * inverse_width;
                let outwards = steep / distance.max(1e-6);
                let all: [f32; 5] = [outwards * run, outwards * rise, steep, share, -steep * u];
                let by: [f32; N] = std::array::from_fn(|k| all[k]);
                add(&mut products, &mut gradient, &by, residual);
            }
        }
        let normal = SMatrix::<f64, N, N>::from_fn(|i, j| f64::from(products[i][j]));
        let gradient = SVector::<f64, N>::from(gradient.map(f64::from));
        let step = normal.cholesky()?.solve(&gradient);
        disk.center += Vector2::new(step[0], step[1]);
        disk.radius += step[2];
        disk.height += step[3];
        if N == 5 {
            width = (width + step[4]).clamp(WIDTHS.0, WIDTHS.1);
        }
        // What the step takes away is known before it is looked at.
        let squares = (f64::from(squares) - step.dot(&gradient)).max(0.0);
        disk.rest = (squares / (f64::from(count) - N as f64).max(1.0)).sqrt();
        disk.misfit = disk.rest.max(level.noise) / level.noise;
        if !disk.is_near(start) {
            return None;
        }
        let left = (step[0] * step[0] + step[1] * step[1]) / (2.0 * width);
        if left < SETTLED * disk.sigma_px(level, edge) && (N == 4 || step[4].abs() < SETTLED_WIDTH_PX) {
            break;
        }
    }
    (disk.height > 0.0).then_some((disk, width))
}

#[cfg(test)]
/// Tests; the profile is for rendering in others.
pub mod tests {
    use super::*;

    /// Φ(u), for rendering.
    pub fn profile(u: f64) -> f64 {
        normal_distribution(u)
    }

    #[test]
    fn the_normal_distribution_has_its_known_values() {
        for (u, value) in [(0.0, 0.5), (1.0, 0.841_344_746), (-1.959_964, 0.025), (3.0, 0.998_650_102)] {
            assert!((normal_distribution(u) - value).abs() < 2e-7, "{u}");
        }
    }

    #[test]
    fn the_table_follows_the_edge() {
        for k in 0..100 {
            let u = -2.6 + 0.052 * f64::from(k);
            let (value, slope) = across_edge(&TABLE, u as f32);
            let (value, slope) = (f64::from(value), f64::from(slope));
            assert!((value - normal_distribution(u)).abs() < 6e-4);
            assert!((slope - (normal_distribution(u + 1e-3) - normal_distribution(u - 1e-3)) / 2e-3).abs() < 1e-3);
        }
    }
}
