//! Background, noise and threshold of an image, from the image itself.

use super::{Image, Value};

/// What is dark and what is bright in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    /// Value of the background.
    pub background: f64,
    /// Standard deviation of a pixel's value.
    pub noise: f64,
    /// Value above which a pixel is bright.
    pub threshold: f64,
}

/// Pixels that tell of the background.
const LOOKED_AT: usize = 2_500;
/// Noise of the rounding to whole values.
const ROUNDING: f64 = 0.288_675;
/// A pixel of background alone is brighter than so many standard deviations once in a million images.
const CLEARLY: f64 = 7.0;

impl Level {
    /// The median is the background, the spread below it the noise: markers are few, and bright.
    pub fn of<V: Value>(image: &Image<'_, V>, threshold: Option<f64>) -> Self {
        let step = (image.values.len() / LOOKED_AT).max(1) | 1; // odd, so that it meets all columns
        let sample = V::tally(image.values.iter().step_by(step).copied());
        if sample.is_empty() {
            return Self { background: 0.0, noise: ROUNDING, threshold: threshold.unwrap_or(0.0) };
        }
        let middle = sample.iter().map(|(_, n)| n).sum::<usize>() / 2;
        let mut below = 0;
        let is_middle = |(_, n): &&(V, usize)| {
            below += n;
            below > middle
        };
        let background: f64 = sample.iter().find(is_middle).map_or(0.0, |(v, _)| (*v).into());
        let (mut squares, mut count) = (0.0, 0.0);
        for (value, n) in &sample {
            let off = background - (*value).into();
            if off >= 0.0 {
                squares += *n as f64 * off * off;
                count += *n as f64 * if off > 0.0 { 1.0 } else { 0.5 };
            }
        }
        let noise = (squares / f64::max(count, 1.0)).sqrt().max(ROUNDING);
        let automatic = background + CLEARLY * noise;
        Self { background, noise, threshold: threshold.unwrap_or(automatic) }
    }
}
