//! Cameras and rigs: projection, un-projection to rays, analytic derivatives.
//!
//! Conventions: world in metres, right-handed, Z up; the camera looks along its +Z, x right, y down; pixel (0, 0) is
//! the centre of the top-left pixel. `point_in_camera = camera_from_world * (point_in_world − position_m)`.

pub mod lens;
mod mask;

pub use lens::Lens;
pub use mask::Mask;

use nalgebra::{Matrix2, Matrix2x3, Matrix3, Vector2, Vector3};

/// A pinhole camera with a lens, as calibrated.
#[derive(Clone, Debug)]
pub struct Camera {
    /// The identity by which observations name this camera.
    pub id: String,
    /// Sensor width and height in pixels.
    pub size_px: [f64; 2],
    /// Focal length in pixels, x and y.
    pub focal_px: [f64; 2],
    /// Principal point in pixels.
    pub principal_px: [f64; 2],
    /// Rotation from world to camera axes.
    pub camera_from_world: Matrix3<f64>,
    /// Centre of projection in world metres.
    pub position_m: Vector3<f64>,
    /// Lens model.
    pub lens: Lens,
    /// Image regions whose centroids are ignored.
    pub mask: Mask,
}

/// Derivatives of a pixel: by the point, and by the pose.
#[derive(Clone, Copy, Debug)]
pub struct PixelDerivatives {
    /// d pixel / d point in world (px per metre).
    pub by_point: Matrix2x3<f64>,
    /// d pixel / d camera position in world (px per metre).
    pub by_position: Matrix2x3<f64>,
    /// d pixel / d rotation: a small rotation vector (rad) in camera axes, applied after `camera_from_world`.
    pub by_rotation: Matrix2x3<f64>,
}

impl Camera {
    /// World point (m) in camera axes (m).
    pub fn camera_from_world_point(&self, point_in_world: &Vector3<f64>) -> Vector3<f64> {
        self.camera_from_world * (point_in_world - self.position_m)
    }

    /// Measured pixel of a point on the normalised image plane, with d pixel / d normalised.
    pub fn pixel_from_normalised(&self, normalised: Vector2<f64>) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        let focal = Vector2::from(self.focal_px);
        let principal = Vector2::from(self.principal_px);
        match &self.lens {
            Lens::Ideal => Some((focal.component_mul(&normalised) + principal, Matrix2::from_diagonal(&focal))),
            Lens::BrownConrady { k, p } => {
                let (distorted, jacobian) = lens::brown_conrady(k, p, normalised);
                unfolded(&jacobian)
                    .then(|| (focal.component_mul(&distorted) + principal, Matrix2::from_diagonal(&focal) * jacobian))
            }
            Lens::Fisheye { k } => {
                let (distorted, jacobian) = lens::fisheye(k, normalised);
                Some((focal.component_mul(&distorted) + principal, Matrix2::from_diagonal(&focal) * jacobian))
            }
            Lens::ViconRadial { center_px, k } => {
                let center = Vector2::from(*center_px);
                let ideal = focal.component_mul(&normalised) + principal;
                let measured = lens::vicon_measured_offset(k, ideal - center)?;
                let (_, ideal_by_measured) = lens::vicon_ideal_offset(k, measured);
                let jacobian = ideal_by_measured.try_inverse()? * Matrix2::from_diagonal(&focal);
                Some((measured + center, jacobian))
            }
        }
    }

    /// Normalised image plane point of a measured pixel; `None` where the lens model has folded over.
    pub fn normalised_from_pixel(&self, pixel: Vector2<f64>) -> Option<Vector2<f64>> {
        let focal = Vector2::from(self.focal_px);
        let principal = Vector2::from(self.principal_px);
        let plain = (pixel - principal).component_div(&focal);
        match &self.lens {
            Lens::Ideal => Some(plain),
            Lens::BrownConrady { k, p } => lens::brown_conrady_inverse(k, p, plain),
            Lens::Fisheye { k } => lens::fisheye_inverse(k, plain),
            Lens::ViconRadial { center_px, k } => {
                let center = Vector2::from(*center_px);
                let (ideal, jacobian) = lens::vicon_ideal_offset(k, pixel - center);
                unfolded(&jacobian).then(|| (ideal + center - principal).component_div(&focal))
            }
        }
    }

    /// Measured pixel of a world point (m); `None` behind the camera or outside the lens model.
    pub fn project(&self, point_in_world: &Vector3<f64>) -> Option<Vector2<f64>> {
        let in_camera = self.camera_from_world_point(point_in_world);
        if in_camera.z <= 1e-9 {
            return None;
        }
        self.pixel_from_normalised(in_camera.xy() / in_camera.z).map(|(pixel, _)| pixel)
    }

    /// Measured pixel of a world point and d pixel / d point (px per metre).
    pub fn project_linear(&self, point_in_world: &Vector3<f64>) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        let c = self.camera_from_world_point(point_in_world);
        if c.z <= 1e-9 {
            return None;
        }
        let (iz, r) = (1.0 / c.z, &self.camera_from_world);
        let at = c.xy() * iz;
        let (pixel, by_normalised) = self.pixel_from_normalised(at)?;
        let plain = Matrix2x3::from_rows(&[(r.row(0) - at.x * r.row(2)) * iz, (r.row(1) - at.y * r.row(2)) * iz]);
        Some((pixel, by_normalised * plain))
    }

    /// Measured pixel and its derivatives by point and pose.
    pub fn project_with_derivatives(&self, point_in_world: &Vector3<f64>) -> Option<(Vector2<f64>, PixelDerivatives)> {
        let c = self.camera_from_world_point(point_in_world);
        if c.z <= 1e-9 {
            return None;
        }
        let (pixel, by_normalised) = self.pixel_from_normalised(c.xy() / c.z)?;
        let iz = 1.0 / c.z;
        let normalised_by_camera = Matrix2x3::new(iz, 0.0, -c.x * iz * iz, 0.0, iz, -c.y * iz * iz);
        let by_camera = by_normalised * normalised_by_camera;
        let by_point = by_camera * self.camera_from_world;
        let by_rotation = by_camera * -c.cross_matrix();
        Some((pixel, PixelDerivatives { by_point, by_position: -by_point, by_rotation }))
    }

    /// Unit direction in world of the ray through a normalised point.
    pub fn ray_in_world(&self, normalised: Vector2<f64>) -> Vector3<f64> {
        (self.camera_from_world.transpose() * normalised.push(1.0)).normalize()
    }

    /// Whether a measured pixel lies on the sensor and outside the mask.
    pub fn sees_pixel(&self, pixel: Vector2<f64>) -> bool {
        pixel.x >= -0.5
            && pixel.y >= -0.5
            && pixel.x <= self.size_px[0] - 0.5
            && pixel.y <= self.size_px[1] - 0.5
            && !self.mask.covers(pixel)
    }

    /// Whether the point projects onto the unmasked sensor.
    pub fn sees(&self, point_in_world: &Vector3<f64>) -> bool {
        self.project(point_in_world).is_some_and(|pixel| self.sees_pixel(pixel))
    }
}

/// Whether a lens keeps the order of image points here. The derivative of a radial lens is symmetric: it must be positive
/// definite, or the polynomial has turned back.
fn unfolded(jacobian: &Matrix2<f64>) -> bool {
    jacobian.determinant() > 0.0 && jacobian.trace() > 0.0
}

/// All cameras of a capture, in ascending order of identity.
#[derive(Clone, Debug, Default)]
pub struct Rig {
    /// The cameras.
    pub cameras: Vec<Camera>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use nalgebra::Rotation3;

    fn with_lens(lens: Lens) -> Camera {
        Camera {
            id: "1".into(),
            size_px: [1280.0, 1024.0],
            focal_px: [1100.0, 1090.0],
            principal_px: [640.0, 500.0],
            camera_from_world: *Rotation3::from_euler_angles(1.8, 0.2, -0.4).matrix(),
            position_m: Vector3::new(0.3, -4.0, 1.5),
            lens,
            mask: Mask::default(),
        }
    }

    fn all_lenses() -> Vec<Lens> {
        vec![
            Lens::Ideal,
            Lens::ViconRadial { center_px: [645.0, 505.0], k: [5.6e-8, -4.7e-15, -8.3e-21] },
            Lens::BrownConrady { k: [-0.28, 0.11, -0.02, 0.01, 0.003, 0.001], p: [6e-4, -7e-4] },
            Lens::Fisheye { k: [-0.02, 0.004, -0.001, 0.0002] },
        ]
    }

    fn points() -> Vec<Vector3<f64>> {
        let pixels = [(100.0, 80.0), (640.0, 500.0), (1200.0, 950.0), (300.5, 900.25)];
        let camera = with_lens(Lens::Ideal);
        pixels
            .iter()
            .map(|&(x, y)| {
                camera.position_m + 3.0 * camera.ray_in_world(camera.normalised_from_pixel(Vector2::new(x, y)).unwrap())
            })
            .collect()
    }

    #[test]
    fn unprojection_inverts_projection_for_every_lens() {
        for lens in all_lenses() {
            let camera = with_lens(lens);
            for point in points() {
                let pixel = camera.project(&point).unwrap();
                let ray = camera.ray_in_world(camera.normalised_from_pixel(pixel).unwrap());
                let along = ray.dot(&(point - camera.position_m));
                assert_relative_eq!(camera.position_m + ray * along, point, epsilon = 1e-9);
            }
        }
    }

    #[test]
    fn derivatives_equal_central_differences_for_every_lens() {
        let h = 1e-6;
        for lens in all_lenses() {
            let camera = with_lens(lens);
            for point in points() {
                let (_, derivatives) = camera.project_with_derivatives(&point).unwrap();
                let (_, by_point) = camera.project_linear(&point).unwrap();
                assert_relative_eq!(by_point, derivatives.by_point, epsilon = 1e-9, max_relative = 1e-9);
                for axis in 0..3 {
                    let step = Vector3::ith(axis, h);
                    let by_point = (camera.project(&(point + step)).unwrap()
                        - camera.project(&(point - step)).unwrap())
                        / (2.0 * h);
                    assert_relative_eq!(
                        derivatives.by_point.column(axis),
                        by_point.column(0),
                        epsilon = 1e-3,
                        max_relative = 1e-5
                    );
                    let moved = |s: f64| {
                        let mut other = camera.clone();
                        other.position_m += step * s;
                        other.project(&point).unwrap()
                    };
                    let by_position = (moved(1.0) - moved(-1.0)) / (2.0 * h);
                    assert_relative_eq!(
                        derivatives.by_position.column(axis),
                        by_position.column(0),
                        epsilon = 1e-3,
                        max_relative = 1e-5
                    );
                    let turned = |s: f64| {
                        let mut other = camera.clone();
                        other.camera_from_world = Rotation3::new(step * s).matrix() * camera.camera_from_world;
                        other.project(&point).unwrap()
                    };
                    let by_rotation = (turned(1.0) - turned(-1.0)) / (2.0 * h);
                    assert_relative_eq!(
                        derivatives.by_rotation.column(axis),
                        by_rotation.column(0),
                        epsilon = 1e-3,
                        max_relative = 1e-5
                    );
                }
            }
        }
    }

    #[test]
    fn a_point_behind_the_camera_has_no_pixel() {
        let camera = with_lens(Lens::Ideal);
        let behind = camera.position_m - camera.ray_in_world(Vector2::zeros());
        assert!(camera.project(&behind).is_none());
    }

    #[test]
    fn a_lens_that_folds_over_gives_none_instead_of_a_wrong_pixel() {
        let folded = Lens::BrownConrady { k: [-2.0, 0.0, 0.0, 0.0, 0.0, 0.0], p: [0.0; 2] };
        assert!(with_lens(folded).pixel_from_normalised(Vector2::new(0.8, 0.0)).is_none());
        let vicon = Lens::ViconRadial { center_px: [640.0, 500.0], k: [-4e-6, 0.0, 0.0] };
        assert!(with_lens(vicon).normalised_from_pixel(Vector2::new(1200.0, 900.0)).is_none());
    }
}
