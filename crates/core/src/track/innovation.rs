//! How likely dots are where they are, as markers': the likelihood of their innovations, for several at a time.

use super::strips::Free;
use super::views::{BLOCK, Lane, View, Views};

/// How often a marker is pushed.
pub const LN_PUSHED: f64 = -4.0;
pub const LN_NOT_PUSHED: f64 = -0.018_5;
/// Squared innovation (standard deviations) beyond which a dot is not looked at: χ², 2 degrees, 1e-4.
pub const GATE: f64 = 18.4;
/// Where calm fits less than this worse than pushed (squared innovations), it is the likelier one whatever the spreads: a
/// push only makes them wider. A little less than 2 (`LN_NOT_PUSHED` − `LN_PUSHED`), for rounding.
const CALM: f64 = 7.96;
/// ln 2π.
const LN_TAU: f64 = 1.837_877_066_409_345_3;

/// Logarithms of the likelihoods (px⁻²) of dots' offsets from where markers are seen, for pairs of a view and a dot, before
/// what dots there mean that belong to nothing known: of calm and pushed the larger one; −∞ outside the gate.
pub fn ln_innovations(views: &Views, free: &Free, pairs: &[(u32, u32)]) -> Vec<f64> {
    let mut ln = Vec::with_capacity(pairs.len().next_multiple_of(BLOCK));
    for pairs in pairs.chunks(BLOCK) {
        // The last block is filled up with a pair that it has already.
        let four: [(View, usize); BLOCK] = std::array::from_fn(|k| {
            let (who, dot) = pairs[k.min(pairs.len() - 1)];
            (views.at(who as usize), dot as usize)
        });
        let lane = |of: &dyn Fn(&View, usize) -> f64| Lane::from(four.each_ref().map(|(view, dot)| of(view, *dot)));
        let variance = lane(&|_, dot| free.dots[dot].sigma_px * free.dots[dot].sigma_px);
        let offset = [0, 1].map(|i| lane(&|view, dot| free.pixels[dot][i] - view.pixel[i]));
        let own = [0, 1, 2].map(|i| lane(&|view, _| view.own[i]));
        let calm = [own[0] + variance, own[1], own[2] + variance];
        let pushed = [0, 1, 2].map(|i| calm[i] + lane(&|view, _| view.push[i]));
        let (calm_spread, pushed_spread) = (determinant(&calm), determinant(&pushed));
        let near = squared(&calm, &calm_spread, &offset);
        let far = squared(&pushed, &pushed_spread, &offset);
        let mut larger = ln_density(&calm_spread, &near) + Lane::splat(LN_NOT_PUSHED);
        if (near - far).simd_ge(Lane::splat(CALM)).any() {
            larger = larger.max(ln_density(&pushed_spread, &far) + Lane::splat(LN_PUSHED));
        }
        ln.extend(far.simd_le(Lane::splat(GATE)).bitselect(larger, Lane::splat(f64::NEG_INFINITY)).to_array());
    }
    ln.truncate(pairs.len());
    ln
}

/// Determinant of covariances (xx, xy, yy).
fn determinant([xx, xy, yy]: &[Lane; 3]) -> Lane {
    (*xx * *yy - *xy * *xy).max(Lane::splat(1e-300))
}

/// Squared offset in standard deviations.
fn squared([xx, xy, yy]: &[Lane; 3], determinant: &Lane, [x, y]: &[Lane; 2]) -> Lane {
    (*yy * *x * *x - *xy * *x * *y * Lane::splat(2.0) + *xx * *y * *y) / *determinant
}

/// Logarithm of the centred normal density.
fn ln_density(determinant: &Lane, squared: &Lane) -> Lane {
    Lane::splat(-LN_TAU) - (determinant.ln() + *squared) * Lane::splat(0.5)
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    /// The textbook density, one dot after the other.
    fn oracle([xx, xy, yy]: [f64; 3], [x, y]: [f64; 2]) -> (f64, f64) {
        let spread = nalgebra::Matrix2::new(xx, xy, xy, yy);
        let offset = nalgebra::Vector2::new(x, y);
        let squared = offset.dot(&(spread.try_inverse().expect("it is regular") * offset));
        (squared, -0.5 * squared - 0.5 * spread.determinant().ln() - std::f64::consts::TAU.ln())
    }

    #[test]
    fn several_densities_are_what_each_is() {
        let spreads = [[0.3, 0.1, 0.4], [25.0, -7.0, 4.0], [1e-3, 0.0, 2e-3], [300.0, 120.0, 90.0]];
        let offsets = [[0.1, -0.7], [3.0, 2.0], [0.0, 0.0], [-40.0, 11.0]];
        let covariance = [0, 1, 2].map(|i| Lane::from(spreads.map(|s: [f64; 3]| s[i])));
        let offset = [0, 1].map(|i| Lane::from(offsets.map(|o: [f64; 2]| o[i])));
        let spread = determinant(&covariance);
        let far = squared(&covariance, &spread, &offset);
        let ln = ln_density(&spread, &far);
        for k in 0..4 {
            let (expected_squared, expected_ln) = oracle(spreads[k], offsets[k]);
            assert_relative_eq!(far.to_array()[k], expected_squared, max_relative = 1e-12, epsilon = 1e-12);
            assert_relative_eq!(ln.to_array()[k], expected_ln, max_relative = 1e-12);
        }
    }
}
