//! How bright a camera sees LEDs that are dim or bright, and what a dot's brightness says of its bit.

use nalgebra::{Matrix3, Vector3};

/// Probability that an LED is seen as if its bit were the other one.
const WRONG_BIT: f64 = 0.06;
/// Dots from which a camera's levels are known, and the smallest difference of the two (natural logarithm).
const LEAST_DOTS: usize = 48;
const LEAST_STEP: f64 = 0.25;
/// Brightness so far off both levels (in spreads) is no LED's, and is left out of the fit.
const FAR: f64 = 3.0;
const ROUNDS: usize = 6;
/// The spread is at least this (natural logarithm).
const LEAST_SPREAD: f64 = 0.02;

/// One dot, as bright and as far away as it is.
#[derive(Clone, Copy, Debug)]
pub struct Light {
    /// Logarithm of its brightness (any unit; NaN where it is not known).
    pub ln_brightness: f64,
    /// Logarithm of the distance of its marker (m).
    pub ln_distance: f64,
}

/// ln brightness = dim + falloff · ln distance, + step if bright.
#[derive(Clone, Copy, Debug)]
pub struct Levels {
    dim: f64,
    falloff: f64,
    step: f64,
    spread: f64,
}

impl Levels {
    /// From dots whose bits are known, least squares without those that lie far off; `None` where they do not tell.
    pub fn of(dots: &[(Light, bool)]) -> Option<Self> {
        if dots.len() < LEAST_DOTS {
            return None;
        }
        let row = |(light, bright): &(Light, bool)| Vector3::new(1.0, light.ln_distance, f64::from(u8::from(*bright)));
        let mut near = f64::INFINITY;
        let mut found = None;
        for _ in 0..ROUNDS {
            let off = |dot: &(Light, bool)| found.map_or(0.0, |x: Vector3<f64>| dot.0.ln_brightness - row(dot).dot(&x));
            // A little for the falloff: distances may all be the same.
            let mut matrix = Matrix3::from_diagonal(&Vector3::new(0.0, 1e-3, 0.0));
            let mut right = Vector3::zeros();
            for dot in dots.iter().filter(|d| off(d).abs() < near) {
                matrix += row(dot) * row(dot).transpose();
                right += row(dot) * dot.0.ln_brightness;
            }
            let solved = matrix.lu().solve(&right)?;
            let mut offs: Vec<f64> = dots.iter().map(|d| (d.0.ln_brightness - row(d).dot(&solved)).abs()).collect();
            offs.sort_unstable_by(f64::total_cmp);
            near = FAR * (1.4826 * offs[offs.len() / 2]).max(LEAST_SPREAD);
            found = Some(solved);
        }
        let x = found?;
        (x[2] > LEAST_STEP).then_some(Self { dim: x[0], falloff: x[1], step: x[2], spread: near / FAR })
    }

    /// Whether the two levels of a strand are as far apart as the camera's are by about a half.
    pub fn is_step(&self, step: f64) -> bool {
        (0.5 * self.step..1.5 * self.step).contains(&step)
    }

    /// Logarithm of how much likelier the brightness is if the LED is bright than if it is dim.
    ///
    /// `middle`: where the middle of the strand's own two levels lies, where that is known.
    pub fn for_bright(&self, light: &Light, middle: Option<f64>) -> f64 {
        let dim = middle.map_or(self.dim + self.falloff * light.ln_distance, |m| m - 0.5 * self.step);
        let density = |level: f64| (-0.5 * ((light.ln_brightness - level) / self.spread).powi(2)).exp();
        let (if_dim, if_bright) = (density(dim), density(dim + self.step));
        let other = (-0.5 * FAR * FAR).exp();
        let mixed = |own: f64, wrong: f64| ((1.0 - WRONG_BIT) * own + WRONG_BIT * wrong + other).ln();
        mixed(if_bright, if_dim) - mixed(if_dim, if_bright)
    }
}

/// Middle and difference of the two levels of a strand around its k-th place, from a period of logarithms of its
/// brightness (NaN: not seen): words are bright for half of their period.
pub fn middle(logs: &[f64], k: usize, period: usize) -> Option<(f64, f64)> {
    let from = k.saturating_sub(period / 2).min(logs.len().saturating_sub(period));
    let mut near: Vec<f64> =
        logs[from..(from + period).min(logs.len())].iter().copied().filter(|l| l.is_finite()).collect();
    near.sort_unstable_by(f64::total_cmp);
    let (low, high) = (near.get(near.len() / 4)?, near.get((3 * near.len() / 4).min(near.len() - 1))?);
    Some((0.5 * (low + high), high - low))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::random::Random;

    #[test]
    fn levels_are_found_among_wrong_bits_and_tell_as_much_as_they_can() {
        let mut random = Random::new(5, 0);
        let mut made = |n: usize| -> Vec<(Light, bool)> {
            let one = |random: &mut Random| {
                let (bright, ln_distance) = (random.happens(0.5), random.between(0.5, 1.5));
                let seen = bright ^ random.happens(0.05);
                let ln_brightness = 4.0 - 2.0 * ln_distance + if seen { 0.8 } else { 0.0 } + 0.05 * random.normal();
                (Light { ln_brightness, ln_distance }, bright)
            };
            (0..n).map(|_| one(&mut random)).collect()
        };
        let levels = Levels::of(&made(500)).unwrap();
        assert!((levels.step - 0.8).abs() < 0.02 && (levels.falloff + 2.0).abs() < 0.05 && levels.spread < 0.06);
        let right =
            made(2000).iter().filter(|(light, bright)| (levels.for_bright(light, None) > 0.0) == *bright).count();
        assert!(right > 1880, "{right}");
        // What no LED looks like says nothing.
        let blinding = Light { ln_brightness: 9.0, ln_distance: 1.0 };
        assert!(levels.for_bright(&blinding, None).abs() < 1e-6);
        assert!(Levels::of(&made(20)).is_none());
    }
}
