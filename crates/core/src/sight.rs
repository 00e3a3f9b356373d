//! A sight: one image dot turned into a ray with a noise, ready for least squares.
//!
//! With the camera's centre C, its axes r1, r2, r3 and the dot's normalised place (x, y), the reprojection error of a
//! world point X is `e = W [(r1 − x r3)·(X − C), (r2 − y r3)·(X − C)] / z`, `z = r3·(X − C)`, where W is the lens's
//! d pixel / d normalised at the dot divided by the dot's noise. So `e` is in standard deviations, and it is linear in
//! X but for the depth. The lens is linearised at the dot: the error of that is second order in a sub-pixel residual.

use crate::camera::Camera;
use nalgebra::{Matrix2x3, Vector2, Vector3};

/// One dot of one camera as a ray with whitened error equations.
#[derive(Clone, Debug)]
pub struct Sight {
    /// Index of the camera in its rig.
    pub camera: usize,
    /// Camera centre in world (m).
    pub origin: Vector3<f64>,
    /// Unit direction of the ray in world.
    pub direction: Vector3<f64>,
    /// The camera's optical axis in world.
    pub axis: Vector3<f64>,
    /// Rows that give the whitened error: `rows · (X − origin) / depth` (standard deviations).
    pub rows: Matrix2x3<f64>,
    /// |d normalised / d pixel|: normalised area of one square pixel.
    pub pixel_area: f64,
    /// Standard deviation of the dot (px per axis).
    pub sigma_px: f64,
    /// Largest angle by which one standard deviation turns the ray (rad).
    pub angle_sigma: f64,
}

impl Sight {
    /// `None` if the pixel lies where the lens model has folded over.
    pub fn new(camera: &Camera, index: usize, pixel: Vector2<f64>, sigma_px: f64) -> Option<Self> {
        let at = camera.normalised_from_pixel(pixel)?;
        let (_, pixel_by_normalised) = camera.pixel_from_normalised(at)?;
        let r = &camera.camera_from_world;
        let plain = Matrix2x3::from_rows(&[r.row(0) - at.x * r.row(2), r.row(1) - at.y * r.row(2)]);
        let determinant = pixel_by_normalised.determinant().abs();
        // The smaller singular value of a 2×2 matrix, from its Frobenius norm and determinant.
        let norm2 = pixel_by_normalised.norm_squared();
        let smaller = (0.5 * (norm2 - (norm2 * norm2 - 4.0 * determinant * determinant).max(0.0).sqrt())).sqrt();
        Some(Self {
            camera: index,
            origin: camera.position_m,
            direction: camera.ray_in_world(at),
            axis: r.row(2).transpose(),
            rows: pixel_by_normalised * plain / sigma_px,
            pixel_area: 1.0 / determinant,
            sigma_px,
            angle_sigma: sigma_px / smaller,
        })
    }

    /// The same ray with a noise so many times as large.
    #[must_use]
    pub fn with_noise(&self, factor: f64) -> Self {
        Self {
            rows: self.rows / factor,
            sigma_px: self.sigma_px * factor,
            angle_sigma: self.angle_sigma * factor,
            ..self.clone()
        }
    }

    /// Depth along the optical axis (m).
    pub fn depth(&self, point: &Vector3<f64>) -> f64 {
        self.axis.dot(&(point - self.origin))
    }

    /// Whitened reprojection error at a point and its exact derivative by the point (per metre).
    pub fn linearise(&self, point: &Vector3<f64>) -> Linear {
        let offset = point - self.origin;
        let inverse_depth = 1.0 / self.axis.dot(&offset);
        let error = self.rows * offset * inverse_depth;
        let by_point = (self.rows - error * self.axis.transpose()) * inverse_depth;
        Linear { error, by_point }
    }
}

/// A linearised whitened error: `error + by_point · step`.
#[derive(Clone, Copy, Debug)]
pub struct Linear {
    /// Whitened error (standard deviations).
    pub error: Vector2<f64>,
    /// Its derivative by the point (standard deviations per metre).
    pub by_point: Matrix2x3<f64>,
}

impl Linear {
    /// Squared error after a step.
    pub fn squared_after(&self, step: &Vector3<f64>) -> f64 {
        (self.error + self.by_point * step).norm_squared()
    }
}

/// Accumulated normal equations of a 3D point: information M (6 unique values), gradient v, squared error c.
#[derive(Clone, Copy, Debug, Default)]
pub struct Normal {
    m: [f64; 6],
    v: [f64; 3],
    c: f64,
}

/// Minimum of accumulated normal equations.
#[derive(Clone, Copy, Debug)]
pub struct Minimum {
    /// Step from the point of linearisation (m).
    pub step: Vector3<f64>,
    /// Weighted residual sum of squares at the minimum.
    pub rss: f64,
    /// Determinant of the information matrix (m⁻⁶).
    pub determinant: f64,
}

impl Normal {
    /// Normal equations of one sight with a weight.
    pub fn of(linear: &Linear, weight: f64) -> Self {
        let j = &linear.by_point;
        let e = &linear.error;
        let dot = |a: usize, b: usize| weight * (j[(0, a)] * j[(0, b)] + j[(1, a)] * j[(1, b)]);
        let grad = |a: usize| weight * (j[(0, a)] * e.x + j[(1, a)] * e.y);
        Self {
            m: [dot(0, 0), dot(0, 1), dot(0, 2), dot(1, 1), dot(1, 2), dot(2, 2)],
            v: [grad(0), grad(1), grad(2)],
            c: weight * e.norm_squared(),
        }
    }

    /// Normal equations of a Gaussian prior, at the point of linearisation: `offset` = point − mean.
    pub fn of_prior(information: &nalgebra::Matrix3<f64>, offset: &Vector3<f64>) -> Self {
        let i = information;
        let v = i * offset;
        Self { m: [i[(0, 0)], i[(0, 1)], i[(0, 2)], i[(1, 1)], i[(1, 2)], i[(2, 2)]], v: v.into(), c: offset.dot(&v) }
    }

    /// Adds a multiple of the identity (m⁻²) to the information: keeps ill-conditioned pairs solvable.
    #[must_use]
    pub fn with_ridge(mut self, ridge: f64) -> Self {
        self.m[0] += ridge;
        self.m[3] += ridge;
        self.m[5] += ridge;
        self
    }

    /// Sum of two sets of normal equations at the same point.
    #[must_use]
    #[inline]
    pub fn plus(&self, other: &Self) -> Self {
        let mut sum = *self;
        for i in 0..6 {
            sum.m[i] += other.m[i];
        }
        for i in 0..3 {
            sum.v[i] += other.v[i];
        }
        sum.c += other.c;
        sum
    }

    /// Cholesky solution; `None` if the information is not positive definite.
    #[inline]
    pub fn minimum(&self) -> Option<Minimum> {
        let [a, b, c, d, e, f] = self.m;
        if a <= 0.0 {
            return None;
        }
        // L D Lᵀ with unit L: no square roots.
        let l21 = b / a;
        let l31 = c / a;
        let d2 = d - l21 * b;
        if d2 <= 0.0 {
            return None;
        }
        let t32 = e - l31 * b;
        let l32 = t32 / d2;
        let d3 = f - l31 * c - l32 * t32;
        if d3 <= 1e-13 * f.abs() {
            return None;
        }
        let y1 = self.v[0];
        let y2 = self.v[1] - l21 * y1;
        let y3 = self.v[2] - l31 * y1 - l32 * y2;
        let (w1, w2, w3) = (y1 / a, y2 / d2, y3 / d3);
        let x3 = w3;
        let x2 = w2 - l32 * x3;
        let x1 = w1 - l21 * x2 - l31 * x3;
        let rss = (self.c - (y1 * w1 + y2 * w2 + y3 * w3)).max(0.0);
        Some(Minimum { step: Vector3::new(-x1, -x2, -x3), rss, determinant: a * d2 * d3 })
    }

    /// Half the derivative of the squared error by the point (m⁻¹).
    pub fn gradient(&self) -> Vector3<f64> {
        self.v.into()
    }

    /// The information matrix (m⁻²).
    pub fn information(&self) -> nalgebra::Matrix3<f64> {
        let [a, b, c, d, e, f] = self.m;
        nalgebra::Matrix3::new(a, b, c, b, d, e, c, e, f)
    }
}
