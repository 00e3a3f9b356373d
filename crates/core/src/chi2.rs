//! Quantiles of the χ² distribution, for gates that are stated as probabilities instead of pixels.
//!
//! `quantile(p_above, dof)` inverts the regularised upper incomplete gamma function (series and continued fraction,
//! Abramowitz & Stegun 1964, 6.5.29 and 6.5.31) by bisection. Exact to about 1e-10; called once per gate, never per dot.

/// Value that a χ² variable with `dof` degrees of freedom exceeds with probability `p_above`.
pub fn quantile(p_above: f64, dof: f64) -> f64 {
    let (mut low, mut high) = (0.0, 10.0 * dof + 400.0);
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if upper_tail(middle, dof) > p_above {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

/// Probability that a χ² variable with `dof` degrees of freedom exceeds `x`.
pub fn upper_tail(x: f64, dof: f64) -> f64 {
    let (a, x) = (0.5 * dof, 0.5 * x);
    if x <= 0.0 {
        return 1.0;
    }
    let scale = (a * x.ln() - x - ln_gamma(a)).exp();
    if x < a + 1.0 {
        let (mut term, mut sum, mut n) = (1.0 / a, 1.0 / a, a);
        while term > sum * 1e-17 {
            n += 1.0;
            term *= x / n;
            sum += term;
        }
        return 1.0 - scale * sum;
    }
    let mut b = x + 1.0 - a;
    let mut c = 1e300;
    let mut d = 1.0 / b;
    let mut fraction = d;
    for i in 1..10_000 {
        let an = -f64::from(i) * (f64::from(i) - a);
        b += 2.0;
        d = 1.0 / (an * d + b);
        c = b + an / c;
        let change = d * c;
        fraction *= change;
        if (change - 1.0).abs() < 1e-16 {
            break;
        }
    }
    scale * fraction
}

/// Logarithm of the gamma function for x > 0 (Stirling's series after shifting x above 12).
pub fn ln_gamma(x: f64) -> f64 {
    let (mut x, mut shift) = (x, 0.0);
    while x < 12.0 {
        shift -= x.ln();
        x += 1.0;
    }
    let inverse2 = 1.0 / (x * x);
    let series = (1.0 / 12.0 - inverse2 * (1.0 / 360.0 - inverse2 * (1.0 / 1260.0 - inverse2 / 1680.0))) / x;
    shift + (x - 0.5) * x.ln() - x + 0.918_938_533_204_672_8 + series
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn quantiles_equal_published_tables() {
        // NIST/SEMATECH e-Handbook of Statistical Methods, table 1.3.6.7.4.
        for (p, dof, value) in [(0.05, 1.0, 3.841), (0.01, 3.0, 11.345), (0.001, 5.0, 20.515), (0.001, 13.0, 34.528)] {
            assert_relative_eq!(quantile(p, dof), value, epsilon = 6e-4);
        }
    }

    #[test]
    fn ln_gamma_equals_factorials() {
        assert_relative_eq!(ln_gamma(6.0), 120.0_f64.ln(), epsilon = 1e-11);
        assert_relative_eq!(ln_gamma(0.5), std::f64::consts::PI.sqrt().ln(), epsilon = 1e-11);
    }
}
