//! What of a camera is adjusted: 15 parameters, each free or held, with the derivatives of a pixel by them.
//!
//! Order: rotation (3, rad, in camera axes), position (3, m), focal length (px), principal point (x, y, px), c1, c2, p1, p2,
//! c3 of the lens, and the ratio of the focal lengths.
//!
//! The lens is OpenCV's with `radial = (1 + c2 r⁴ + c3 r⁶) / (1 − c1 r²)`, that is k2 = c2, k3 = c3, k4 = −c1. Near the middle
//! it is `1 + c1 r²`, as the polynomial is; but a barrel (c1 < 0) does not fold over beyond what was seen, as polynomials do.

use crate::camera::{Camera, Lens, lens};
use nalgebra::{Matrix2x3, Rotation3, SMatrix, SVector, Vector2, Vector3};

/// Parameters of a camera.
pub const PARAMETERS: usize = 15;
/// Rotation.
pub const ROTATION: std::ops::Range<usize> = 0..3;
/// Position.
pub const POSITION: std::ops::Range<usize> = 3..6;
/// Focal length along x; the one along y keeps its ratio.
pub const FOCAL: usize = 6;
/// Principal point.
pub const PRINCIPAL: std::ops::Range<usize> = 7..9;
/// c1 and c2.
pub const RADIAL: std::ops::Range<usize> = 9..11;
/// p1, p2.
pub const TANGENTIAL: std::ops::Range<usize> = 11..13;
/// c3.
pub const SIXTH: usize = 13;
/// Ratio of the focal lengths, y to x.
pub const ASPECT: usize = 14;

/// Which parameters of a camera are free.
pub type Freedom = [bool; PARAMETERS];

/// Nothing free.
pub const HELD: Freedom = [false; PARAMETERS];

/// Freedom with some ranges of parameters free.
pub fn free(ranges: &[std::ops::Range<usize>]) -> Freedom {
    std::array::from_fn(|i| ranges.iter().any(|r| r.contains(&i)))
}

/// Derivatives of a pixel by the camera's parameters.
pub type ByCamera = SMatrix<f64, 2, PARAMETERS>;

/// Coefficients of OpenCV's lens; zero for an ideal one. `None` for another lens.
pub fn coefficients(of: &Lens) -> Option<([f64; 6], [f64; 2])> {
    match of {
        Lens::Ideal => Some(([0.0; 6], [0.0; 2])),
        Lens::BrownConrady { k, p } => Some((*k, *p)),
        Lens::ViconRadial { .. } | Lens::Fisheye { .. } => None,
    }
}

/// Projected pixel, and its derivatives by the point (m, world) and by the camera's parameters.
///
/// `None` behind the camera or beyond the lens. Parameters of lenses other than OpenCV's have derivative zero.
pub fn project(camera: &Camera, point_in_world: &Vector3<f64>) -> Option<(Vector2<f64>, Matrix2x3<f64>, ByCamera)> {
    let (pixel, pose) = camera.project_with_derivatives(point_in_world)?;
    let c = camera.camera_from_world_point(point_in_world);
    let at = c.xy() / c.z;
    let mut by = ByCamera::zeros();
    by.fixed_columns_mut::<3>(0).copy_from(&pose.by_rotation);
    by.fixed_columns_mut::<3>(3).copy_from(&pose.by_position);
    let [fx, fy] = camera.focal_px;
    by.column_mut(7).copy_from(&Vector2::x());
    by.column_mut(8).copy_from(&Vector2::y());
    if let Some((k, p)) = coefficients(&camera.lens) {
        let (distorted, _) = lens::brown_conrady(&k, &p, at);
        let aspect = fy / fx;
        by.column_mut(FOCAL).copy_from(&Vector2::new(distorted.x, aspect * distorted.y));
        by.column_mut(ASPECT).copy_from(&Vector2::new(0.0, fx * distorted.y));
        let (x, y) = (at.x, at.y);
        let r2 = at.norm_squared();
        let denominator = 1.0 + r2 * (k[3] + r2 * (k[4] + r2 * k[5]));
        let factor = (1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[2]))) / denominator;
        let outwards = Vector2::new(fx * x, fy * y) * (r2 / denominator);
        by.column_mut(9).copy_from(&(outwards * factor));
        by.column_mut(10).copy_from(&(outwards * r2));
        by.column_mut(SIXTH).copy_from(&(outwards * (r2 * r2)));
        by.column_mut(11).copy_from(&Vector2::new(fx * 2.0 * x * y, fy * (r2 + 2.0 * y * y)));
        by.column_mut(12).copy_from(&Vector2::new(fx * (r2 + 2.0 * x * x), fy * 2.0 * x * y));
    }
    Some((pixel, pose.by_point, by))
}

/// The camera after a step of its parameters.
pub fn moved(camera: &Camera, step: &SVector<f64, PARAMETERS>) -> Camera {
    let mut other = camera.clone();
    let turn = Rotation3::new(Vector3::new(step[0], step[1], step[2]));
    other.camera_from_world = turn.matrix() * camera.camera_from_world;
    other.position_m += Vector3::new(step[3], step[4], step[5]);
    let aspect = camera.focal_px[1] / camera.focal_px[0] + step[ASPECT];
    let focal = camera.focal_px[0] + step[FOCAL];
    other.focal_px = [focal, aspect * focal];
    other.principal_px = [camera.principal_px[0] + step[7], camera.principal_px[1] + step[8]];
    if step.rows(9, 5).norm() > 0.0
        && let Some((mut k, mut p)) = coefficients(&camera.lens)
    {
        k[3] -= step[9];
        k[1] += step[10];
        k[2] += step[SIXTH];
        p[0] += step[11];
        p[1] += step[12];
        other.lens = Lens::BrownConrady { k, p };
    }
    other
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Mask;

    #[test]
    fn derivatives_by_every_parameter_equal_central_differences() {
        let camera = Camera {
            id: "1".into(),
            size_px: [1280.0, 1024.0],
            focal_px: [1100.0, 1090.0],
            principal_px: [640.0, 500.0],
            camera_from_world: *Rotation3::from_euler_angles(1.8, 0.2, -0.4).matrix(),
            position_m: Vector3::new(0.3, -4.0, 1.5),
            lens: Lens::BrownConrady { k: [-0.02, 0.11, -0.02, 0.26, 0.0, 0.0], p: [6e-4, -7e-4] },
            mask: Mask::default(),
        };
        let point = camera.position_m + 3.0 * camera.ray_in_world(Vector2::new(0.21, -0.17));
        let (_, _, by) = project(&camera, &point).unwrap();
        for i in 0..PARAMETERS {
            let h = if i == FOCAL || PRINCIPAL.contains(&i) { 1e-3 } else { 1e-6 };
            let at = |s: f64| moved(&camera, &(SVector::ith(i, h) * s)).project(&point).unwrap();
            let difference = (at(1.0) - at(-1.0)) / (2.0 * h);
            assert!((by.column(i) - difference).norm() < 1e-5 * (1.0 + difference.norm()), "parameter {i}");
        }
    }
}
