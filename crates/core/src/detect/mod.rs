//! From an image to centroids: the accuracy of everything else starts here.
//!
//! Bright runs of each row are joined into components ([`runs`]); a component gives first a centroid weighted by what
//! lies above the threshold, then a least-squares fit of a blurred disk to all pixels around it ([`disk`]), which
//! reaches the Cramér–Rao bound of a disk's edge. What is no disk, because the marker is half hidden or two have run
//! together, is fitted by circles of the radius that the other markers have ([`arcs`]). Memory is that of the bright pixels; one thread per image.

pub mod arcs;
pub mod disk;
pub mod level;
pub mod partial;
pub mod runs;

use disk::{Disk, Edge};
use level::Level;
use runs::{Component, components};

/// A value of a pixel: 8 or 16 bit.
pub trait Value: Copy + Ord + Into<f64> {
    /// The largest value.
    const WHITE: Self;
    /// The largest value that is not above a threshold.
    fn at_most(threshold: f64) -> Self;
    /// In single precision.
    fn grey(self) -> f32;
    /// The values in ascending order, each with how often there is it.
    fn tally(values: impl Iterator<Item = Self>) -> Vec<(Self, usize)>;
}

impl Value for u8 {
    const WHITE: Self = Self::MAX;
    fn at_most(threshold: f64) -> Self {
        threshold.clamp(0.0, 255.0) as Self
    }
    fn grey(self) -> f32 {
        f32::from(self)
    }
    fn tally(values: impl Iterator<Item = Self>) -> Vec<(Self, usize)> {
        let mut counts = [0; 256];
        values.for_each(|v| counts[usize::from(v)] += 1);
        (0..=Self::MAX).zip(counts).filter(|(_, count)| *count > 0).collect()
    }
}

impl Value for u16 {
    const WHITE: Self = Self::MAX;
    fn at_most(threshold: f64) -> Self {
        threshold.clamp(0.0, 65535.0) as Self
    }
    fn grey(self) -> f32 {
        f32::from(self)
    }
    fn tally(values: impl Iterator<Item = Self>) -> Vec<(Self, usize)> {
        let mut sorted: Vec<Self> = values.collect();
        sorted.sort_unstable();
        sorted.chunk_by(|a, b| a == b).map(|own| (own[0], own.len())).collect()
    }
}

/// A grey image, row by row.
#[derive(Clone, Copy)]
pub struct Image<'a, V> {
    /// `width * height` values.
    pub values: &'a [V],
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl<V: Value> Image<'_, V> {
    /// A pixel's value.
    pub fn at(&self, x: usize, y: usize) -> f64 {
        self.values[y * self.width + x].into()
    }
}

/// What is looked for. Nothing needs to be set.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Grey value above which a pixel is bright; from the image itself if missing.
    pub threshold: Option<f64>,
    /// Value at which the sensor saturates; the largest of its type if missing (a 12-bit camera in 16 bits: 4095).
    pub white: Option<f64>,
    /// Radius of a marker's image (px), where it is known; otherwise that of the image's other markers.
    pub radius_px: Option<f64>,
    /// Blur of the edges (px, the pixels' own size included), where it is known; otherwise it is fitted to some blobs.
    pub blur_px: Option<f64>,
    /// Components of fewer bright pixels are noise.
    pub least_pixels: usize,
    /// Blobs given out at most, brightest first: an overexposed frame must not take all time.
    pub most_blobs: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self { threshold: None, white: None, radius_px: None, blur_px: None, least_pixels: 2, most_blobs: 10_000 }
    }
}

/// A marker's image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Blob {
    /// Centre (px): (0, 0) is the middle of the top-left pixel.
    pub pixel: [f64; 2],
    /// Standard deviation of the centre (px per axis).
    pub sigma_px: f64,
    /// Radius of the disk (px).
    pub radius_px: f64,
    /// Bright pixels.
    pub area_px: usize,
    /// Largest value above the background.
    pub peak: f64,
    /// Axes of the ellipse of the same moments (px), the longer first, and the angle of the longer one (rad, from x to y).
    pub ellipse: [f64; 3],
    /// Cut by the image's edge.
    pub is_clipped: bool,
    /// Some pixels are at the sensor's limit.
    pub is_saturated: bool,
    /// How the centre was found.
    pub fit: Fit,
}

/// How a blob's centre was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fit {
    /// A blurred disk on all grey values.
    Disk,
    /// Weighted by what lies above the threshold: no disk fits, or the sensor or the image ends.
    Moments,
    /// A circle of known radius, seen along a part: the marker is half hidden.
    Arc,
    /// A circle of known radius, one of several in what has run together.
    Merged,
}

/// What an image gave.
#[derive(Clone, Debug)]
pub struct Detected {
    /// Blobs from top to bottom, then from left to right.
    pub blobs: Vec<Blob>,
    /// Background, noise and threshold.
    pub level: Level,
    /// Blur of the edges.
    pub edge: Edge,
    /// Components left out because there were too many.
    pub left_out: usize,
}

/// Finds the markers of an image.
pub fn detect<V: Value>(image: &Image<'_, V>, options: &Options) -> Detected {
    let level = Level::of(image, options.threshold);
    let white = options.white.unwrap_or_else(|| V::WHITE.into());
    let mut found = components(image, V::at_most(level.threshold));
    found.retain(|c| c.pixels >= options.least_pixels);
    let left_out = found.len().saturating_sub(options.most_blobs);
    if left_out > 0 {
        found.sort_by_key(|c| (std::cmp::Reverse(c.pixels), c.top, c.left));
        found.truncate(options.most_blobs);
        found.sort_by_key(|c| (c.top, c.left));
    }
    let moments: Vec<Moments> = found.iter().map(|c| Moments::of(image, c, &level)).collect();
    let starts: Vec<Disk> = moments.iter().map(Moments::disk).collect();
    let known = options.blur_px.map(|width_px| Edge { width_px });
    let edge = known.unwrap_or_else(|| Edge::of(image, &starts, &level));
    let mut seen: Vec<Seen> = Vec::with_capacity(found.len());
    for ((component, moments), start) in found.iter().zip(&moments).zip(&starts) {
        let is_saturated = level.background + moments.peak >= white;
        let is_clipped = component.touches(image.width, image.height);
        let fitted = (!is_saturated && !is_clipped).then(|| disk::fit(image, start, &level, edge)).flatten();
        seen.push(Seen { component, moments, start, fitted, is_saturated, is_clipped });
    }
    let radius = options.radius_px.or_else(|| usual_radius(&seen));
    let blobs = seen.iter().flat_map(|s| s.blobs(image, &level, edge, radius)).collect();
    Detected { blobs, level, edge, left_out }
}

/// A fit leaves so many times the noise where something is no disk.
const NO_DISK: f64 = 1.6;
/// And its residuals are this part of the disk's height: of a bright marker, the model's own errors exceed the noise.
const NO_DISK_SHARE: f64 = 0.04;
/// A component of so many disks' area is several markers.
const SEVERAL: f64 = 1.25;
/// Markers that are told apart in one component.
const MOST_MERGED: usize = 4;
/// A circle that is seen along less of it is half hidden.
const WHOLE: f64 = 0.8;

/// A component with its fit.
struct Seen<'a> {
    component: &'a Component,
    moments: &'a Moments,
    start: &'a Disk,
    fitted: Option<Disk>,
    is_saturated: bool,
    is_clipped: bool,
}

/// Median radius of the components that are disks.
fn usual_radius(seen: &[Seen]) -> Option<f64> {
    let mut radii: Vec<f64> = seen.iter().filter_map(|s| s.fitted.filter(is_disk).map(|d| d.radius)).collect();
    if radii.is_empty() {
        return None;
    }
    let middle = radii.len() / 2;
    Some(*radii.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Whether a fit explains the values.
fn is_disk(disk: &Disk) -> bool {
    disk.misfit < NO_DISK || disk.rest < NO_DISK_SHARE * disk.height
}

impl Seen<'_> {
    /// The markers of a component: one, or several that have run together.
    fn blobs<V: Value>(&self, image: &Image<'_, V>, level: &Level, edge: Edge, radius: Option<f64>) -> Vec<Blob> {
        let whole = self.fitted.filter(is_disk);
        let several = |r: f64| self.moments.mass > SEVERAL * std::f64::consts::PI * r * r * self.moments.peak;
        if let (None, Some(radius), false) = (whole, radius, self.is_clipped) {
            let most = if several(radius) { MOST_MERGED } else { 1 };
            let circles = arcs::circles(image, self.component, level, self.moments.peak, radius, most);
            let fit = |c: &arcs::Circle| match circles.len() {
                1 if c.seen >= WHOLE => Fit::Disk,
                1 => Fit::Arc,
                _ => Fit::Merged,
            };
            let blob = |c: &arcs::Circle| Blob {
                pixel: c.center.into(),
                sigma_px: c.sigma_px,
                radius_px: radius,
                fit: fit(c),
                ..self.blob(self.start, level, edge)
            };
            if !circles.is_empty() {
                return circles.iter().map(blob).collect();
            }
        }
        let disk = whole.or(self.fitted).unwrap_or(*self.start);
        vec![self.blob(&disk, level, edge)]
    }

    fn blob(&self, disk: &Disk, level: &Level, edge: Edge) -> Blob {
        Blob {
            pixel: disk.center.into(),
            sigma_px: disk.sigma_px(level, edge),
            radius_px: disk.radius,
            area_px: self.component.pixels,
            peak: self.moments.peak,
            ellipse: self.moments.ellipse(),
            is_clipped: self.is_clipped,
            is_saturated: self.is_saturated,
            fit: if self.fitted.is_some() { Fit::Disk } else { Fit::Moments },
        }
    }
}

/// Moments of a component, weighted by what lies above the threshold.
struct Moments {
    center: nalgebra::Vector2<f64>,
    /// Second central moments: xx, xy, yy (px²).
    second: [f64; 3],
    /// Sum above the background.
    mass: f64,
    peak: f64,
}

impl Moments {
    fn of<V: Value>(image: &Image<'_, V>, component: &Component, level: &Level) -> Self {
        let origin = nalgebra::Vector2::new(component.left as f64, component.top as f64);
        let (mut sum, mut first, mut second) = (0.0, nalgebra::Vector2::zeros(), [0.0; 3]);
        let mut peak = 0.0_f64;
        for run in &component.runs {
            let row = &image.values[run.row * image.width..][run.first..run.last];
            let (mut own, mut along, mut square) = (0.0, 0.0, 0.0);
            let mut x = (run.first - component.left) as f64;
            for &value in row {
                let value: f64 = value.into();
                let weight = value - level.threshold;
                own += weight;
                along += weight * x;
                square += weight * x * x;
                peak = peak.max(value);
                x += 1.0;
            }
            let y = (run.row - component.top) as f64;
            sum += own;
            first += nalgebra::Vector2::new(along, own * y);
            second = [second[0] + square, second[1] + along * y, second[2] + own * y * y];
        }
        let mass = sum + component.pixels as f64 * (level.threshold - level.background);
        let peak = (peak - level.background).max(0.0);
        let mean = first / sum;
        let products = [mean.x * mean.x, mean.x * mean.y, mean.y * mean.y];
        Self { center: origin + mean, second: std::array::from_fn(|k| second[k] / sum - products[k]), mass, peak }
    }

    /// A disk of the same mass and centre.
    fn disk(&self) -> Disk {
        let radius = (self.mass / (std::f64::consts::PI * self.peak.max(1e-9))).sqrt();
        Disk { center: self.center, radius, height: self.peak, misfit: 1.0, rest: 0.0 }
    }

    fn ellipse(&self) -> [f64; 3] {
        let [xx, xy, yy] = self.second;
        let (middle, half) = (0.5 * (xx + yy), (0.25 * (xx - yy).powi(2) + xy * xy).sqrt());
        // A uniform disk's moment is r² / 4.
        let axis = |moment: f64| 2.0 * moment.max(0.0).sqrt();
        [axis(middle + half), axis(middle - half), 0.5 * (2.0 * xy).atan2(xx - yy)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::random::Random;
    use nalgebra::Vector2;

    /// A 64 x 64 image of disks (centre, radius) of height 200 over 20, blurred by 0.6 px, with noise.
    fn rendered(disks: &[(Vector2<f64>, f64)], noise: f64, seed: u64) -> Vec<u8> {
        let mut random = Random::new(seed, 0);
        let mut values = Vec::with_capacity(64 * 64);
        for y in 0..64 {
            for x in 0..64 {
                let mut share: f64 = 0.0;
                for (center, radius) in disks {
                    // Areas of the pixel inside the disk, blurred: 9 x 9 samples of the edge's profile.
                    let mut own = 0.0;
                    for k in 0..81 {
                        let offset = Vector2::new(f64::from(k % 9) - 4.0, f64::from(k / 9) - 4.0) / 9.0;
                        let at = Vector2::new(f64::from(x), f64::from(y)) + offset;
                        own += disk::tests::profile((radius - (at - center).norm()) / 0.6) / 81.0;
                    }
                    share = share.max(own);
                }
                values.push((20.0 + 200.0 * share + noise * random.normal()).round().clamp(0.0, 255.0) as u8);
            }
        }
        values
    }

    fn found(values: &[u8]) -> Detected {
        detect(&Image { values, width: 64, height: 64 }, &Options::default())
    }

    #[test]
    fn without_noise_centres_come_back_to_a_hundredth_of_a_pixel() {
        for (k, radius) in [1.5, 3.0, 5.0].into_iter().enumerate() {
            let center = Vector2::new(30.3 + 0.1 * k as f64, 28.85);
            let blobs = found(&rendered(&[(center, radius)], 0.0, 0)).blobs;
            assert_eq!(blobs.len(), 1);
            assert!((Vector2::from(blobs[0].pixel) - center).norm() < 0.01, "{radius}: {:?}", blobs[0]);
            assert!((blobs[0].radius_px - radius).abs() < 0.1, "{radius}: {:?}", blobs[0]);
        }
    }

    #[test]
    fn with_noise_the_error_is_the_stated_one() {
        let (mut squares, mut stated, tries) = (0.0, 0.0, 200);
        let mut random = Random::new(8, 0);
        for seed in 0..tries {
            let center = Vector2::new(30.0 + random.between(0.0, 1.0), 30.0 + random.between(0.0, 1.0));
            let blob = found(&rendered(&[(center, 3.0)], 4.0, seed)).blobs[0];
            squares += (Vector2::from(blob.pixel) - center).norm_squared() / 2.0;
            stated += blob.sigma_px.powi(2);
        }
        let ratio = squares / stated;
        assert!((0.7..1.4).contains(&ratio), "{ratio}");
        assert!((squares / tries as f64).sqrt() < 1.3 * 0.0105);
    }

    #[test]
    fn clipped_and_saturated_blobs_say_so_and_dark_images_are_empty() {
        let edge = found(&rendered(&[(Vector2::new(1.0, 30.0), 3.0)], 1.0, 1)).blobs;
        assert!(edge[0].is_clipped && !edge[0].is_saturated);
        let bright: Vec<u8> =
            rendered(&[(Vector2::new(30.0, 30.0), 3.0)], 1.0, 1).iter().map(|v| v.saturating_mul(3)).collect();
        assert!(found(&bright).blobs[0].is_saturated);
        assert!(found(&rendered(&[], 2.0, 1)).blobs.is_empty());
        assert!(found(&vec![0; 64 * 64]).blobs.is_empty());
    }

    #[test]
    fn a_half_hidden_marker_is_found_by_its_arc() {
        let mut random = Random::new(3, 0);
        let options = Options { radius_px: Some(4.0), ..Options::default() };
        let (mut squares, tries) = (0.0, 60);
        for seed in 0..tries {
            let center = Vector2::new(30.0 + random.between(0.0, 1.0), 30.0 + random.between(0.0, 1.0));
            let turn = random.between(0.0, std::f64::consts::TAU);
            let side = Vector2::new(turn.cos(), turn.sin());
            let mut values = rendered(&[(center, 4.0)], 0.0, 0);
            for (k, value) in values.iter_mut().enumerate() {
                let at = Vector2::new((k % 64) as f64, (k / 64) as f64);
                let shown = disk::tests::profile((at - center).dot(&side) / 0.6);
                *value = (20.0 + (f64::from(*value) - 20.0) * shown + 2.0 * random.normal()).round() as u8;
            }
            let blobs = detect(&Image { values: &values, width: 64, height: 64 }, &options).blobs;
            assert_eq!(blobs.len(), 1, "{seed}");
            assert!(blobs[0].fit == Fit::Arc, "{seed} {:?}", blobs[0]);
            squares += (Vector2::from(blobs[0].pixel) - center).norm_squared();
        }
        let rms = (squares / f64::from(tries)).sqrt();
        assert!(rms < 0.2, "{rms}");
    }

    #[test]
    fn two_merged_markers_are_both_found() {
        let mut random = Random::new(5, 0);
        let options = Options { radius_px: Some(4.0), ..Options::default() };
        let (mut good, tries) = (0, 60);
        for seed in 0..tries {
            let center = Vector2::new(30.0 + random.between(0.0, 1.0), 30.0 + random.between(0.0, 1.0));
            let turn = random.between(0.0, std::f64::consts::TAU);
            let apart = 0.5 * 1.2 * 4.0 * Vector2::new(turn.cos(), turn.sin());
            let truth = [center - apart, center + apart];
            let values = rendered(&truth.map(|c| (c, 4.0)), 2.0, seed);
            let blobs = detect(&Image { values: &values, width: 64, height: 64 }, &options).blobs;
            let near = |t: &Vector2<f64>| blobs.iter().any(|b| (Vector2::from(b.pixel) - t).norm() < 0.3);
            good += usize::from(blobs.len() == 2 && blobs[0].fit == Fit::Merged && truth.iter().all(near));
        }
        assert!(good * 100 >= 95 * tries as usize, "{good} of {tries}");
    }

    #[test]
    fn an_overexposed_frame_gives_the_largest_blobs_and_says_what_is_left_out() {
        let disks: Vec<(Vector2<f64>, f64)> = (0..9)
            .map(|k| (Vector2::new(10.0 + 20.0 * f64::from(k % 3), 10.0 + 20.0 * f64::from(k / 3)), 2.0))
            .collect();
        let values = rendered(&disks, 1.0, 2);
        let options = Options { most_blobs: 4, ..Options::default() };
        let detected = detect(&Image { values: &values, width: 64, height: 64 }, &options);
        assert_eq!((detected.blobs.len(), detected.left_out), (4, 5));
    }
}
