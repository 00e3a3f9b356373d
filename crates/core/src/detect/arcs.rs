//! Markers that are half hidden, or two that have run together: circles of known radius laid on what is left of the edges.
//!
//! The edge is where the values pass half the height, found between neighbouring pixels. Two points of it and the radius
//! give two circles; the one with most edge along it, bright inside, is a marker (random sample consensus, Fischler &
//! Bolles 1981, over all pairs up to a limit). The edge of what hides a marker lies on no such circle.

use super::level::Level;
use super::runs::Component;
use super::{Image, Value};
use nalgebra::{Matrix2, Vector2};

/// A place where the values pass half the height, and the direction in which they fall.
#[derive(Clone, Copy, Debug)]
struct EdgePoint {
    at: Vector2<f64>,
    outwards: Vector2<f64>,
}

/// A circle laid on edges.
#[derive(Clone, Copy, Debug)]
pub struct Circle {
    /// Centre (px).
    pub center: Vector2<f64>,
    /// Standard deviation of the centre (px per axis), from the edge points' scatter.
    pub sigma_px: f64,
    /// Share of its circumference along which there is an edge.
    pub seen: f64,
}

/// Edge points belong to a circle within this distance (px).
const NEAR_PX: f64 = 0.35;
/// Cosine between an edge's direction and the circle's that is demanded.
const ALIKE: f64 = 0.7;
/// Pairs of points tried at most.
const MOST_PAIRS: usize = 4000;
/// A circle needs an edge along this part of it.
const LEAST_SEEN: f64 = 0.2;
/// How much less than a pixel's half a located edge scatters at least (px).
const EDGE_SIGMA_PX: f64 = 0.05;

/// Up to `most` circles of a radius on a component's edges, the best seen first.
pub fn circles<V: Value>(
    image: &Image<'_, V>,
    component: &Component,
    level: &Level,
    height: f64,
    radius: f64,
    most: usize,
) -> Vec<Circle> {
    let mut edge = edge_points(image, component, level.background + 0.5 * height);
    let mut found = Vec::new();
    while found.len() < most {
        let Some(center) = best_center(&edge, radius) else { break };
        let Some((circle, own)) = settled(&edge, center, radius) else { break };
        if circle.seen < LEAST_SEEN {
            break;
        }
        found.push(circle);
        edge = edge.into_iter().zip(own).filter(|(_, own)| !own).map(|(p, _)| p).collect();
    }
    found
}

/// Where values pass a level between a pixel of the component's box and its right or lower neighbour.
fn edge_points<V: Value>(image: &Image<'_, V>, component: &Component, half: f64) -> Vec<EdgePoint> {
    let (left, top) = (component.left.saturating_sub(2), component.top.saturating_sub(2));
    let (right, bottom) = ((component.right + 2).min(image.width - 1), (component.bottom + 2).min(image.height - 1));
    let mut points = Vec::new();
    for y in top..=bottom {
        for x in left..=right {
            for (dx, dy) in [(1, 0), (0, 1)] {
                if x + dx > right || y + dy > bottom {
                    continue;
                }
                let (a, b) = (image.at(x, y), image.at(x + dx, y + dy));
                if (a > half) == (b > half) {
                    continue;
                }
                let part = (half - a) / (b - a);
                let at = Vector2::new(x as f64 + part * dx as f64, y as f64 + part * dy as f64);
                if let Some(outwards) = falling(image, &at) {
                    points.push(EdgePoint { at, outwards });
                }
            }
        }
    }
    points
}

/// Direction in which the values fall at a place, by Sobel's differences; `None` at the image's edge.
fn falling<V: Value>(image: &Image<'_, V>, at: &Vector2<f64>) -> Option<Vector2<f64>> {
    let (x, y) = (at.x.round() as usize, at.y.round() as usize);
    if x == 0 || y == 0 || x + 1 >= image.width || y + 1 >= image.height {
        return None;
    }
    let value = |dx: usize, dy: usize| image.at(x + dx - 1, y + dy - 1);
    let across = |a: [(usize, usize); 3], b: [(usize, usize); 3]| {
        let side = |s: [(usize, usize); 3]| value(s[0].0, s[0].1) + 2.0 * value(s[1].0, s[1].1) + value(s[2].0, s[2].1);
        side(a) - side(b)
    };
    let down = Vector2::new(
        across([(0, 0), (0, 1), (0, 2)], [(2, 0), (2, 1), (2, 2)]),
        across([(0, 0), (1, 0), (2, 0)], [(0, 2), (1, 2), (2, 2)]),
    );
    let norm = down.norm();
    (norm > 0.0).then(|| down / norm)
}

fn is_on(point: &EdgePoint, center: &Vector2<f64>, radius: f64) -> bool {
    let arm = point.at - center;
    let distance = arm.norm();
    (distance - radius).abs() < NEAR_PX && arm.dot(&point.outwards) > ALIKE * distance
}

/// The centre on whose circle most edge points lie.
fn best_center(edge: &[EdgePoint], radius: f64) -> Option<Vector2<f64>> {
    let n = edge.len();
    let step = (n * n / 2).div_ceil(MOST_PAIRS).max(1);
    let mut best: Option<(usize, Vector2<f64>)> = None;
    for (k, (i, j)) in (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j))).enumerate() {
        if k % step != 0 {
            continue;
        }
        let chord = edge[j].at - edge[i].at;
        let length = chord.norm();
        // Points too near to each other, or opposite ones, fix a centre badly.
        if length < 0.5 * radius || length > 1.95 * radius {
            continue;
        }
        let rise = (radius * radius - 0.25 * length * length).sqrt();
        let normal = Vector2::new(-chord.y, chord.x) / length;
        for side in [rise, -rise] {
            let center = edge[i].at + 0.5 * chord + side * normal;
            let count = edge.iter().filter(|p| is_on(p, &center, radius)).count();
            if best.as_ref().is_none_or(|(most, _)| count > *most) {
                best = Some((count, center));
            }
        }
    }
    best.map(|b| b.1)
}

/// The centre by least squares over the edge points on its circle, and which those are.
fn settled(edge: &[EdgePoint], start: Vector2<f64>, radius: f64) -> Option<(Circle, Vec<bool>)> {
    let mut center = start;
    let (mut sigma_px, mut own) = (0.0, Vec::new());
    for _ in 0..6 {
        own = edge.iter().map(|p| is_on(p, &center, radius)).collect();
        let (mut normal, mut right, mut squares, mut count) = (Matrix2::zeros(), Vector2::zeros(), 0.0, 0.0);
        for (point, _) in edge.iter().zip(&own).filter(|(_, own)| **own) {
            let arm = point.at - center;
            let distance = arm.norm();
            let ahead = arm / distance;
            normal += ahead * ahead.transpose();
            right += ahead * (distance - radius);
            squares += (distance - radius).powi(2);
            count += 1.0;
        }
        let inverse = normal.try_inverse()?;
        center += inverse * right;
        let scatter = (squares / f64::max(count - 2.0, 1.0)).max(EDGE_SIGMA_PX * EDGE_SIGMA_PX);
        sigma_px = (0.5 * inverse.trace() * scatter).sqrt();
    }
    let mut directions: Vec<bool> = vec![false; SECTORS];
    for (point, _) in edge.iter().zip(&own).filter(|(_, own)| **own) {
        let arm = point.at - center;
        let turn = arm.y.atan2(arm.x) / std::f64::consts::TAU + 0.5;
        directions[((turn * SECTORS as f64) as usize).min(SECTORS - 1)] = true;
    }
    let seen = directions.iter().filter(|d| **d).count() as f64 / SECTORS as f64;
    Some((Circle { center, sigma_px, seen }, own))
}

/// Sectors in which a circle's edge is counted.
const SECTORS: usize = 16;
