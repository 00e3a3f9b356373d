//! Where the wand was in one frame, from calibrated views of it with wrong ones among them.

use super::bundle::{Bundle, POSE, Pose, Sighting};
use super::wand::{Span, Wand};
use crate::camera::Camera;
use nalgebra::{Matrix3, SMatrix, SVD, SVector, Vector2, Vector3};

/// One camera's view: the pixel of each marker, where it saw it.
#[derive(Clone, Debug)]
pub struct View {
    /// Index of the camera.
    pub camera: usize,
    /// One per marker of the wand.
    pub pixels: Vec<Option<Vector2<f64>>>,
}

/// Pairs of views tried; a pose on which nearly all agree ends the search before.
const MOST_PAIRS: usize = 12;
const NEARLY_ALL: f64 = 0.9;
/// Rays that meet at a smaller angle fix no point.
const SMALLEST_SINE: f64 = 0.05;

/// The pose on which most views agree within `gate_px`, and how many markers they see there.
///
/// Every pair of views with enough markers in common proposes one. `None` where none places the wand.
pub fn from_views(cameras: &[Camera], wand: &Wand, views: &[View], gate_px: f64) -> Option<(Pose, usize)> {
    let seen: usize = views.iter().map(|v| v.pixels.iter().flatten().count()).sum();
    let mut best: Option<(Pose, usize)> = None;
    let mut tried = 0;
    for (i, a) in views.iter().enumerate() {
        for b in &views[i + 1..] {
            let Some(pose) = from_pair(cameras, wand, a, b) else { continue };
            let agree = agreeing(cameras, wand, views, &pose, gate_px);
            if best.as_ref().is_none_or(|(_, most)| agree > *most) {
                best = Some((pose, agree));
            }
            tried += 1;
            let done = best.as_ref().is_some_and(|(_, most)| *most as f64 >= NEARLY_ALL * seen as f64);
            if done || tried >= MOST_PAIRS {
                return best;
            }
        }
    }
    best
}

/// Markers seen within `gate_px` of where a pose puts them.
fn agreeing(cameras: &[Camera], wand: &Wand, views: &[View], pose: &Pose, gate_px: f64) -> usize {
    let off = |view: &View, marker: usize, pixel: &Vector2<f64>| {
        let place = pose.place(&wand.markers_m[marker]);
        cameras[view.camera].project(&place).map_or(f64::INFINITY, |p| (p - pixel).norm())
    };
    let of_view = |view: &View| {
        let near = |(m, p): (usize, &Option<Vector2<f64>>)| p.is_some_and(|p| off(view, m, &p) < gate_px);
        view.pixels.iter().enumerate().filter(|(m, p)| near((*m, p))).count()
    };
    views.iter().map(of_view).sum()
}

fn from_pair(cameras: &[Camera], wand: &Wand, a: &View, b: &View) -> Option<Pose> {
    let mut own = Vec::new();
    let mut world = Vec::new();
    for (marker, (p, q)) in a.pixels.iter().zip(&b.pixels).enumerate() {
        if let (Some(p), Some(q)) = (p, q) {
            own.push(wand.markers_m[marker]);
            world.push(meet(&cameras[a.camera], &cameras[b.camera], *p, *q)?);
        }
    }
    fit(&own, &world, wand.span)
}

/// Midpoint of two cameras' rays; `None` where they are nearly parallel or meet behind a camera.
pub fn meet(a: &Camera, b: &Camera, p: Vector2<f64>, q: Vector2<f64>) -> Option<Vector3<f64>> {
    let (u, v) = (a.ray_in_world(a.normalised_from_pixel(p)?), b.ray_in_world(b.normalised_from_pixel(q)?));
    let base = b.position_m - a.position_m;
    let cosine = u.dot(&v);
    let determinant = 1.0 - cosine * cosine;
    if determinant < SMALLEST_SINE * SMALLEST_SINE {
        return None;
    }
    let s = (u.dot(&base) - cosine * v.dot(&base)) / determinant;
    let t = (cosine * u.dot(&base) - v.dot(&base)) / determinant;
    (s > 0.0 && t > 0.0).then(|| 0.5 * (a.position_m + u * s + b.position_m + v * t))
}

/// The rigid motion that lays an object's markers on places in the world by least squares (Kabsch 1976; Umeyama 1991).
///
/// `None` where there are too few for the object's span. The turn of a line about itself is any.
pub fn fit(own: &[Vector3<f64>], world: &[Vector3<f64>], span: Span) -> Option<Pose> {
    let needed = match span {
        Span::Point => 1,
        Span::Line => 2,
        Span::Plane | Span::Solid => 3,
    };
    if own.len() < needed || own.len() != world.len() {
        return None;
    }
    let n = own.len() as f64;
    let (own_middle, world_middle) = (own.iter().sum::<Vector3<f64>>() / n, world.iter().sum::<Vector3<f64>>() / n);
    let scatter: Matrix3<f64> =
        own.iter().zip(world).map(|(p, q)| (q - world_middle) * (p - own_middle).transpose()).sum();
    let svd = SVD::new(scatter, true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let mirror = (u * v_t).determinant().signum();
    // Singular values are sorted: the least certain direction takes the sign that makes a rotation.
    let rotation = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, mirror)) * v_t;
    Some(Pose { rotation, position_m: world_middle - rotation * own_middle })
}

/// Steps of [`settle`].
const STEPS: usize = 10;

/// A pose adjusted to sightings of it by robust least squares (Cauchy's loss), cameras as they are.
///
/// `None` where they do not determine it.
pub fn settle(bundle: &Bundle, from: &Pose, sightings: &[Sighting], noise_px: &[f64]) -> Option<Pose> {
    let held = bundle.held_in_pose();
    let mut pose = *from;
    for _ in 0..STEPS {
        let (mut normal, mut right) = (SMatrix::<f64, POSE, POSE>::zeros(), SVector::<f64, POSE>::zeros());
        for s in sightings {
            let marker = &bundle.wand.markers_m[s.marker];
            let Some((pixel, by_point)) = bundle.cameras[s.camera].project_linear(&pose.place(marker)) else {
                continue;
            };
            let mut by_pose = pose.derivatives(&by_point, marker);
            held.iter().enumerate().filter(|h| *h.1).for_each(|(k, _)| by_pose.column_mut(k).fill(0.0));
            let (off, variance) = (s.pixel - pixel, noise_px[s.camera].powi(2));
            let weight = 1.0 / (variance + off.norm_squared() / 4.0);
            normal += by_pose.transpose() * by_pose * weight;
            right += by_pose.transpose() * off * weight;
        }
        held.iter().enumerate().filter(|h| *h.1).for_each(|(k, _)| normal[(k, k)] = 1.0);
        let step = normal.cholesky()?.solve(&right);
        pose = pose.moved(&step);
        if step.norm() < 1e-7 {
            break;
        }
    }
    Some(pose)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;

    #[test]
    fn a_rigid_motion_comes_back_for_every_span() {
        let turn = *Rotation3::from_euler_angles(0.4, -1.0, 2.0).matrix();
        let at = Vector3::new(0.2, 0.5, -0.3);
        let sets: [(&[[f64; 3]], Span); 3] = [
            (&[[-0.3, 0.0, 0.0], [0.3, 0.0, 0.0]], Span::Line),
            (&[[-0.1, -0.1, 0.0], [0.2, 0.0, 0.0], [-0.1, 0.1, 0.0]], Span::Plane),
            (&[[-0.1, -0.1, 0.1], [0.2, 0.0, 0.0], [-0.1, 0.1, 0.0], [0.0, 0.0, -0.1]], Span::Solid),
        ];
        for (own, span) in sets {
            let own: Vec<Vector3<f64>> = own.iter().map(|p| Vector3::from(*p)).collect();
            let world: Vec<Vector3<f64>> = own.iter().map(|p| turn * p + at).collect();
            let pose = fit(&own, &world, span).unwrap();
            assert!((pose.rotation.determinant() - 1.0).abs() < 1e-9);
            assert!(own.iter().zip(&world).all(|(p, q)| (pose.place(p) - q).norm() < 1e-9), "{span:?}");
        }
    }
}
