//! Lens models: where a ray through the camera's centre meets the sensor.
//!
//! A lens maps between the *normalised* image plane (`x = X/Z`, `y = Y/Z` in the camera's frame, no unit) and the
//! *ideal* or *measured* pixel. Two families exist, and they run in opposite directions:
//!
//! - Vicon's radial lens maps the **measured** pixel to the ideal one (Vicon XCP; verified on real rigs).
//! - `OpenCV`'s lenses map the **ideal** normalised point to the measured one: Brown–Conrady with rational terms
//!   (`OpenCV` "Camera Calibration and 3D Reconstruction", `calib3d`) and fisheye (Kannala & Brandt 2006, eq. 6).
//!
//! The closed direction is evaluated, the other one solved by Newton's method with analytic derivatives. A lens
//! polynomial is only meaningful inside the radius where it is monotone; outside it the functions return `None`.

use nalgebra::{Matrix2, Vector2};

/// A lens model with its coefficients.
#[derive(Clone, Debug, PartialEq)]
pub enum Lens {
    /// No distortion.
    Ideal,
    /// Vicon radial: `ideal = c + d (1 + k1 r² + k2 r⁴ + k3 r⁶)`, `d = measured − c`, `r` in pixels.
    ViconRadial {
        /// Distortion centre in pixels.
        center_px: [f64; 2],
        /// k1 (px⁻²), k2 (px⁻⁴), k3 (px⁻⁶).
        k: [f64; 3],
    },
    /// `OpenCV` Brown–Conrady with rational radial terms.
    BrownConrady {
        /// k1…k6 (k4–k6 in the denominator).
        k: [f64; 6],
        /// Tangential p1, p2.
        p: [f64; 2],
    },
    /// `OpenCV` fisheye: `θ_d = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)`.
    Fisheye {
        /// k1…k4.
        k: [f64; 4],
    },
}

const NEWTON_STEPS: usize = 30;
const CONVERGED: f64 = 1e-14;

/// Distorts a normalised point with Brown–Conrady coefficients; also the 2×2 derivative.
pub fn brown_conrady(k: &[f64; 6], p: &[f64; 2], at: Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
    let (x, y) = (at.x, at.y);
    let r2 = x * x + y * y;
    let numerator = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[2]));
    let denominator = 1.0 + r2 * (k[3] + r2 * (k[4] + r2 * k[5]));
    let radial = numerator / denominator;
    let d_numerator = k[0] + r2 * (2.0 * k[1] + 3.0 * r2 * k[2]);
    let d_denominator = k[3] + r2 * (2.0 * k[4] + 3.0 * r2 * k[5]);
    let d_radial = (d_numerator - radial * d_denominator) / denominator; // d radial / d r²
    let distorted = Vector2::new(
        x * radial + 2.0 * p[0] * x * y + p[1] * (r2 + 2.0 * x * x),
        y * radial + p[0] * (r2 + 2.0 * y * y) + 2.0 * p[1] * x * y,
    );
    let jacobian = Matrix2::new(
        radial + 2.0 * x * x * d_radial + 2.0 * p[0] * y + 6.0 * p[1] * x,
        2.0 * x * y * d_radial + 2.0 * p[0] * x + 2.0 * p[1] * y,
        2.0 * x * y * d_radial + 2.0 * p[0] * x + 2.0 * p[1] * y,
        radial + 2.0 * y * y * d_radial + 6.0 * p[0] * y + 2.0 * p[1] * x,
    );
    (distorted, jacobian)
}

/// Inverse of [`brown_conrady`]; `None` where the polynomial has folded over.
pub fn brown_conrady_inverse(k: &[f64; 6], p: &[f64; 2], measured: Vector2<f64>) -> Option<Vector2<f64>> {
    let mut at = measured;
    for _ in 0..NEWTON_STEPS {
        let (distorted, jacobian) = brown_conrady(k, p, at);
        if jacobian.determinant() <= 0.0 || jacobian.trace() <= 0.0 {
            return None;
        }
        let step = jacobian.try_inverse()? * (distorted - measured);
        at -= step;
        if !at.x.is_finite() || !at.y.is_finite() {
            return None;
        }
        if step.norm() < CONVERGED * (1.0 + at.norm()) {
            return Some(at);
        }
    }
    let (distorted, _) = brown_conrady(k, p, at);
    ((distorted - measured).norm() < 1e-9).then_some(at)
}

fn fisheye_angle(k: &[f64; 4], theta: f64) -> (f64, f64) {
    let t2 = theta * theta;
    let value = theta * (1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))));
    let slope = 1.0 + t2 * (3.0 * k[0] + t2 * (5.0 * k[1] + t2 * (7.0 * k[2] + t2 * 9.0 * k[3])));
    (value, slope)
}

/// Distorts a normalised point with fisheye coefficients; also the 2×2 derivative.
pub fn fisheye(k: &[f64; 4], at: Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
    let r = at.norm();
    if r < 1e-9 {
        return (at, Matrix2::identity());
    }
    let (theta_d, slope) = fisheye_angle(k, r.atan());
    let scale = theta_d / r;
    let d_theta_d = slope / (1.0 + r * r); // d θ_d / d r
    let d_scale = (d_theta_d - scale) / r;
    let outer = at * at.transpose() / r;
    (at * scale, Matrix2::identity() * scale + outer * d_scale)
}

/// Inverse of [`fisheye`]; `None` beyond 90° or where the polynomial has folded over.
pub fn fisheye_inverse(k: &[f64; 4], measured: Vector2<f64>) -> Option<Vector2<f64>> {
    let theta_d = measured.norm();
    if theta_d < 1e-9 {
        return Some(measured);
    }
    let mut theta = theta_d.min(1.4);
    for _ in 0..NEWTON_STEPS {
        let (value, slope) = fisheye_angle(k, theta);
        if slope <= 0.0 {
            return None;
        }
        let step = (value - theta_d) / slope;
        theta -= step;
        if step.abs() < CONVERGED {
            break;
        }
    }
    let (value, slope) = fisheye_angle(k, theta);
    let valid = slope > 0.0 && (value - theta_d).abs() < 1e-9 && (0.0..std::f64::consts::FRAC_PI_2).contains(&theta);
    valid.then(|| measured * (theta.tan() / theta_d))
}

/// Vicon's polynomial: measured offset from the centre (px) to the ideal offset (px); also the derivative.
pub fn vicon_ideal_offset(k: &[f64; 3], offset: Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
    let r2 = offset.norm_squared();
    let scale = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[2]));
    let d_scale = k[0] + r2 * (2.0 * k[1] + 3.0 * r2 * k[2]);
    let jacobian = Matrix2::identity() * scale + offset * offset.transpose() * (2.0 * d_scale);
    (offset * scale, jacobian)
}

/// Inverse of [`vicon_ideal_offset`]; `None` where the polynomial has folded over.
pub fn vicon_measured_offset(k: &[f64; 3], ideal: Vector2<f64>) -> Option<Vector2<f64>> {
    let r_ideal = ideal.norm();
    if r_ideal < 1e-12 {
        return Some(ideal);
    }
    let mut r = r_ideal;
    for _ in 0..NEWTON_STEPS {
        let r2 = r * r;
        let value = r * (1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[2])));
        let slope = 1.0 + r2 * (3.0 * k[0] + r2 * (5.0 * k[1] + r2 * 7.0 * k[2]));
        if slope <= 0.0 {
            return None;
        }
        let step = (value - r_ideal) / slope;
        r -= step;
        if step.abs() < CONVERGED * r_ideal {
            return (r > 0.0).then(|| ideal * (r / r_ideal));
        }
    }
    None
}
