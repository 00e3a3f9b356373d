//! The seed paper's places of a hidden marker (Lee et al. 2000, §5.2, figures 8 and 9), made total.
//!
//! Two linked markers: the two spheres around them meet in a circle; the point of it nearest to the prediction. As
//! printed this fails when the spheres do not meet (distances change a little all the time); then the point between
//! them on their axis is taken. One linked marker: the point of the sphere in the direction of the prediction.

use nalgebra::Vector3;

/// A visible marker and the hidden marker's distance to it (m).
pub type Sphere = (Vector3<f64>, f64);

/// The point on both spheres nearest to a prediction; the nearest point on the axis where the spheres do not meet.
pub fn two_spheres(first: Sphere, second: Sphere, predicted: &Vector3<f64>) -> Vector3<f64> {
    let ((p0, d0), (p1, d1)) = (first, second);
    let between = p1 - p0;
    let length = between.norm();
    if length < 1e-9 {
        return one_sphere(first, predicted);
    }
    let axis = between / length;
    // Distance of the circle's plane from p0 along the axis.
    let along = (length * length + d0 * d0 - d1 * d1) / (2.0 * length);
    let radius_squared = d0 * d0 - along * along;
    if radius_squared <= 0.0 {
        // Apart: between the spheres. One inside the other: beyond the inner one.
        let side = if d0 + d1 < length || d0 > d1 { 1.0 } else { -1.0 };
        let (on_first, on_second) = (side * d0, if d0 + d1 < length { length - d1 } else { length + side * d1 });
        return p0 + axis * (0.5 * (on_first + on_second));
    }
    let center = p0 + axis * along;
    let offset = predicted - center;
    let across = offset - axis * offset.dot(&axis);
    let direction = across.try_normalize(1e-12).unwrap_or_else(|| any_normal(&axis));
    center + direction * radius_squared.sqrt()
}

/// The point on a sphere in the direction of a prediction.
pub fn one_sphere(sphere: Sphere, predicted: &Vector3<f64>) -> Vector3<f64> {
    let (center, radius) = sphere;
    let direction = (predicted - center).try_normalize(1e-12).unwrap_or_else(Vector3::z);
    center + direction * radius
}

fn any_normal(axis: &Vector3<f64>) -> Vector3<f64> {
    let other = if axis.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
    axis.cross(&other).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use proptest::prelude::*;

    fn point() -> impl Strategy<Value = Vector3<f64>> {
        prop::array::uniform3(-1.0..1.0f64).prop_map(Vector3::from)
    }

    proptest! {
        /// A marker at its learned distances is found exactly when the prediction lies in its half plane.
        #[test]
        fn the_true_place_is_found(p0 in point(), p1 in point(), hidden in point(), away in 0.1..3.0f64) {
            let axis = (p1 - p0).normalize();
            let foot = p0 + axis * (hidden - p0).dot(&axis);
            prop_assume!((p1 - p0).norm() > 0.05 && (hidden - foot).norm() > 0.01);
            let predicted = foot + (hidden - foot) * away;
            let found = two_spheres((p0, (hidden - p0).norm()), (p1, (hidden - p1).norm()), &predicted);
            prop_assert!((found - hidden).norm() < 1e-6);
        }

        #[test]
        fn spheres_that_do_not_meet_still_give_a_point_between(p0 in point(), p1 in point(), q in point()) {
            let length = (p1 - p0).norm();
            prop_assume!(length > 0.05);
            let apart = two_spheres((p0, 0.3 * length), (p1, 0.3 * length), &q);
            assert_relative_eq!(apart, 0.5 * (p0 + p1), epsilon = 1e-9);
            let inside = two_spheres((p0, 3.0 * length), (p1, length), &q);
            prop_assert!(((inside - p0).norm() - 2.5 * length).abs() < 1e-6);
            prop_assert!(((inside - p1).norm() - 1.5 * length).abs() < 1e-6);
        }
    }

    #[test]
    fn one_sphere_keeps_the_distance_and_the_direction() {
        let found = one_sphere((Vector3::zeros(), 0.2), &Vector3::new(0.0, 3.0, 0.0));
        assert_relative_eq!(found, Vector3::new(0.0, 0.2, 0.0));
        assert_relative_eq!(one_sphere((Vector3::zeros(), 0.2), &Vector3::zeros()).norm(), 0.2);
    }
}
