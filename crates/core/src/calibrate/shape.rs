//! The wand as it is: markers sit where their maker meant them only to a fraction of a millimetre.
//!
//! Every marker is placed on its own in every pose; the mean of these places in the wand's axes is its true shape
//! (generalised Procrustes analysis, Gower 1975). The mean length is held: it is the scale of the world.

use super::bundle::{Bundle, Sighting};
use super::pose::fit;
use super::wand::Span;
use nalgebra::{Matrix3, Vector3};

/// Rays must cross by 10° for a place to count.
const SMALLEST_SINE: f64 = 0.17;
/// A marker is moved when its mean place is this many standard deviations off.
const CLEARLY: f64 = 5.0;
/// Fewer whole placings tell nothing of a shape.
const FEWEST: usize = 50;
const ROUNDS: usize = 5;

/// Moves the wand's markers to where the sightings have them, where that is clearly elsewhere. Whether it did.
///
/// Two markers have no shape, and neither has a single one.
pub fn refine(bundle: &mut Bundle) -> bool {
    let markers = bundle.wand.markers_m.len();
    if markers < 3 {
        return false;
    }
    let all = places(bundle);
    let whole: Vec<Vec<Vector3<f64>>> =
        all.chunks(markers).filter_map(|places| places.iter().copied().collect::<Option<Vec<_>>>()).collect();
    if whole.len() < FEWEST {
        return false;
    }
    let given = bundle.wand.markers_m.clone();
    let mut shape = given.clone();
    let mut spread = vec![0.0; markers];
    for _ in 0..ROUNDS {
        let (mean, own_spread) = mean_shape(&whole, &shape, bundle.wand.span);
        (shape, spread) = (mean, own_spread);
    }
    let length = |s: &[Vector3<f64>]| bundle.wand.pairs().map(|(i, j)| (s[i] - s[j]).norm()).sum::<f64>();
    let scale = length(&given) / length(&shape);
    shape.iter_mut().for_each(|p| *p *= scale);
    let moved = |k: usize| (shape[k] - given[k]).norm() > CLEARLY * spread[k];
    let changes = (0..markers).any(moved);
    if changes {
        bundle.wand.markers_m = shape;
    }
    changes
}

/// Mean place of every marker in the axes of a shape, and its standard deviation of the mean (m).
fn mean_shape(whole: &[Vec<Vector3<f64>>], shape: &[Vector3<f64>], span: Span) -> (Vec<Vector3<f64>>, Vec<f64>) {
    let n = whole.len() as f64;
    let mut sum = vec![Vector3::zeros(); shape.len()];
    let mut squares = vec![0.0; shape.len()];
    for places in whole {
        let Some(pose) = fit(shape, places, span) else { continue };
        for (k, place) in places.iter().enumerate() {
            let mut own = pose.rotation.transpose() * (place - pose.position_m);
            if span == Span::Line {
                own = Vector3::new(own.x, 0.0, 0.0);
            }
            sum[k] += own;
            squares[k] += (own - shape[k]).norm_squared();
        }
    }
    let middle = sum.iter().sum::<Vector3<f64>>() / (n * shape.len() as f64);
    let mean = sum.iter().map(|s| s / n - middle).collect();
    (mean, squares.iter().map(|s| (s / n / n).sqrt()).collect())
}

/// Each marker of each pose (pose by pose) placed on its own from its sightings of positive weight.
///
/// `None` where fewer than two cameras saw it or their rays hardly cross.
pub fn places(bundle: &Bundle) -> Vec<Option<Vector3<f64>>> {
    let markers = bundle.wand.markers_m.len();
    let mut used: Vec<Vec<&Sighting>> = vec![Vec::new(); bundle.poses.len() * markers];
    for s in bundle.sightings.iter().filter(|s| s.weight > 0.0) {
        used[s.pose * markers + s.marker].push(s);
    }
    let from = |k: usize| bundle.poses[k / markers].place(&bundle.wand.markers_m[k % markers]);
    used.iter().enumerate().map(|(k, own)| alone(bundle, own, from(k))).collect()
}

/// One marker's place from its own sightings by least squares.
fn alone(bundle: &Bundle, sightings: &[&Sighting], from: Vector3<f64>) -> Option<Vector3<f64>> {
    let rays: Vec<Vector3<f64>> =
        sightings.iter().map(|s| (from - bundle.cameras[s.camera].position_m).normalize()).collect();
    let widest = |a: &Vector3<f64>| rays.iter().map(|b| a.cross(b).norm()).fold(0.0, f64::max);
    if rays.iter().map(widest).fold(0.0, f64::max) < SMALLEST_SINE {
        return None;
    }
    let mut place = from;
    for _ in 0..3 {
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for s in sightings {
            let (pixel, by_point) = bundle.cameras[s.camera].project_linear(&place)?;
            normal += by_point.transpose() * by_point * s.weight;
            right += by_point.transpose() * (s.pixel - pixel) * s.weight;
        }
        place += normal.cholesky()?.solve(&right);
    }
    Some(place)
}
