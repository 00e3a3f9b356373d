//! Predicted markers as one camera sees them, computed for several at a time.

use super::innovation::GATE;
use super::matching::Prior;
use crate::camera::{Camera, Lens};
use nalgebra::Vector2;
use wide::f64x4;

/// The gate with room for rounding: nothing within it lies outside its bounding box.
const WIDER_GATE: f64 = GATE * (1.0 + 1e-6);
/// Nothing nearer to a camera is seen (m).
const NEAREST: f64 = 1e-9;

/// One number of each marker of a block.
pub type Lane = f64x4;
pub const BLOCK: usize = 4;

/// The markers that are asked for.
pub struct Asked<'a> {
    /// Their indices among all.
    pub index: Vec<usize>,
    pub priors: Vec<&'a Prior>,
    expected: Vec<Expected>,
}

impl<'a> Asked<'a> {
    /// Those that have a prior.
    pub fn of(priors: &'a [Option<Prior>]) -> Self {
        let (index, priors): (Vec<usize>, Vec<&Prior>) =
            priors.iter().enumerate().filter_map(|(i, p)| Some((i, p.as_ref()?))).unzip();
        Self { expected: expected(priors.len(), |k| priors[k], 0.0), index, priors }
    }
}

/// Where a block of markers is expected (m, m²).
struct Expected {
    point: [Lane; 3],
    /// xx, xy, xz, yy, yz, zz.
    covariance: [Lane; 6],
    push: Lane,
}

/// Where so many markers are expected some time later (s).
fn expected<'a>(count: usize, prior: impl Fn(usize) -> &'a Prior, lag_s: f64) -> Vec<Expected> {
    let block = |first: usize| {
        // The last block is filled up with a marker that it has already.
        let priors: [&Prior; BLOCK] = std::array::from_fn(|k| prior((first + k).min(count - 1)));
        let (points, covariances) = (priors.map(|p| p.after(lag_s)), priors.map(|p| p.covariance_after(lag_s)));
        let unique = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
        Expected {
            point: [0, 1, 2].map(|i| Lane::from(points.map(|p| p[i]))),
            covariance: unique.map(|ij| Lane::from(covariances.map(|c| c[ij]))),
            push: Lane::from(priors.map(|p| p.push)),
        }
    };
    (0..count).step_by(BLOCK).map(block).collect()
}

/// A predicted marker in one camera.
pub struct View {
    /// Where it is seen (px).
    pub pixel: Vector2<f64>,
    /// Covariance of the projection (px²; xx, xy, yy): own, and what a push adds.
    pub own: [f64; 3],
    pub push: [f64; 3],
}

/// Markers asked for as one camera sees them; those that it cannot see are nowhere (NaN).
pub struct Views {
    blocks: Vec<Seen>,
    /// Their numbers among those asked for.
    pub who: Vec<u32>,
}

/// A block of views.
struct Seen {
    pixel: [[f64; BLOCK]; 2],
    own: [[f64; BLOCK]; 3],
    push: [[f64; BLOCK]; 3],
    /// Half width and height of the gate.
    reach: [[f64; BLOCK]; 2],
}

impl Views {
    /// How a camera sees those of them that are `wanted` (by number), later than the frame's moment (s). Gates have room
    /// for dots of a noise (px).
    pub fn of((camera, sigma_px): (&Camera, f64), lag_s: f64, asked: &Asked, wanted: impl Fn(usize) -> bool) -> Self {
        let mut who = Vec::with_capacity(asked.index.len());
        who.extend((0..asked.index.len()).filter(|&k| wanted(k)).map(|k| k as u32));
        let seen = |expected: &Expected| Seen::of(camera, expected, sigma_px);
        let blocks = if lag_s == 0.0 && who.len() == asked.index.len() {
            asked.expected.iter().map(seen).collect()
        } else {
            expected(who.len(), |k| asked.priors[who[k] as usize], lag_s).iter().map(seen).collect()
        };
        Self { blocks, who }
    }

    /// Where one of them is, and half width and height of its gate (px).
    pub fn gate(&self, number: usize) -> (Vector2<f64>, [f64; 2]) {
        let (block, k) = (&self.blocks[number / BLOCK], number % BLOCK);
        (Vector2::new(block.pixel[0][k], block.pixel[1][k]), [block.reach[0][k], block.reach[1][k]])
    }

    /// One of them.
    pub fn at(&self, number: usize) -> View {
        let (block, k) = (&self.blocks[number / BLOCK], number % BLOCK);
        let pixel = Vector2::new(block.pixel[0][k], block.pixel[1][k]);
        View { pixel, own: [0, 1, 2].map(|i| block.own[i][k]), push: [0, 1, 2].map(|i| block.push[i][k]) }
    }
}

impl Seen {
    fn of(camera: &Camera, expected: &Expected, sigma_px: f64) -> Self {
        let r = [0, 1, 2].map(|i| [0, 1, 2].map(|j| Lane::splat(camera.camera_from_world[(i, j)])));
        let offset = [0, 1, 2].map(|i| expected.point[i] - Lane::splat(camera.position_m[i]));
        let [x, y, z] = r.map(|row| dot(&row, &offset));
        let seen = z.simd_gt(Lane::splat(NEAREST));
        let inverse_depth = seen.bitselect(Lane::splat(1.0) / z, Lane::splat(f64::NAN));
        let at = [x * inverse_depth, y * inverse_depth];
        let (pixel, by_normalised) = through_lens(camera, &at);
        let plain = [0, 1].map(|i| [0, 1, 2].map(|j| (r[i][j] - at[i] * r[2][j]) * inverse_depth));
        let [u, v] =
            [0, 1].map(|i| [0, 1, 2].map(|j| by_normalised[i][0] * plain[0][j] + by_normalised[i][1] * plain[1][j]));
        let [xx, xy, xz, yy, yz, zz] = expected.covariance;
        let spread = |u: &[Lane; 3]| [dot(u, &[xx, xy, xz]), dot(u, &[xy, yy, yz]), dot(u, &[xz, yz, zz])];
        let (by_u, by_v) = (spread(&u), spread(&v));
        let own = [dot(&by_u, &u), dot(&by_u, &v), dot(&by_v, &v)];
        let push = [dot(&u, &u), dot(&u, &v), dot(&v, &v)].map(|v| v * expected.push);
        let noise = Lane::splat(sigma_px * sigma_px);
        let reach = [0, 2].map(|i| (Lane::splat(WIDER_GATE) * (own[i] + push[i] + noise)).sqrt());
        Self {
            pixel: pixel.map(Lane::to_array),
            own: own.map(Lane::to_array),
            push: push.map(Lane::to_array),
            reach: reach.map(Lane::to_array),
        }
    }
}

fn dot(a: &[Lane; 3], b: &[Lane; 3]) -> Lane {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Pixels of normalised points, with d pixel / d normalised; NaN outside the lens model.
fn through_lens(camera: &Camera, at: &[Lane; 2]) -> ([Lane; 2], [[Lane; 2]; 2]) {
    if camera.lens == Lens::Ideal {
        let focal = camera.focal_px.map(Lane::splat);
        let pixel = [0, 1].map(|i| focal[i] * at[i] + Lane::splat(camera.principal_px[i]));
        return (pixel, [[focal[0], Lane::ZERO], [Lane::ZERO, focal[1]]]);
    }
    let [x, y] = at.map(Lane::to_array);
    let (mut pixel, mut by_normalised) = ([[f64::NAN; BLOCK]; 2], [[[0.0; BLOCK]; 2]; 2]);
    for k in 0..BLOCK {
        let Some((p, j)) = camera.pixel_from_normalised(Vector2::new(x[k], y[k])) else { continue };
        for i in 0..2 {
            pixel[i][k] = p[i];
            (by_normalised[i][0][k], by_normalised[i][1][k]) = (j[(i, 0)], j[(i, 1)]);
        }
    }
    (pixel.map(Lane::from), by_normalised.map(|row| row.map(Lane::from)))
}

#[cfg(test)]
mod tests {
    use super::super::flow::Motion;
    use super::*;
    use crate::synth::rigs;
    use approx::assert_relative_eq;
    use nalgebra::{Matrix2, Matrix3, Vector3};

    fn marker(i: usize) -> Prior {
        let t = i as f64;
        let root = Matrix3::new(2.0, 0.3, -0.1, 0.0, 1.0 + 0.1 * t, 0.4, 0.0, 0.0, 3.0) * 1e-3;
        Prior {
            point: Vector3::new(0.3 * t.sin(), 0.4 * t.cos(), 0.2 * t),
            covariance: root * root.transpose(),
            push: 1e-5 * (1.0 + t),
            hidden: false,
            hardware: None,
            must_tell: false,
            motion: Motion { velocity: Vector3::new(1.0, -2.0, 0.5), variance: 0.1 },
        }
    }

    /// One marker after the other through the camera's own projection is the oracle.
    #[test]
    fn side_by_side_they_are_seen_as_one_by_one() {
        let vicon = Lens::ViconRadial { center_px: [650.0, 500.0], k: [1e-8, 1e-15, 0.0] };
        let brown = Lens::BrownConrady { k: [-0.1, 0.02, 0.0, 0.0, 0.0, 0.0], p: [1e-3, -5e-4] };
        let priors: Vec<Option<Prior>> = (0..7).map(|i| (i != 2).then(|| marker(i))).collect();
        let asked = Asked::of(&priors);
        assert_eq!(asked.index, [0, 1, 3, 4, 5, 6]);
        for (lens, lag_s) in [(Lens::Ideal, 0.0), (vicon, 0.0), (brown, 0.004)] {
            let mut camera = rigs::ring(3, 4.0, 20.0, 0.0, [1280.0, 1024.0], 1300.0).cameras.remove(1);
            camera.lens = lens;
            let sigma_px = 0.4;
            let views = Views::of((&camera, sigma_px), lag_s, &asked, |_| true);
            assert_eq!(views.who, [0, 1, 2, 3, 4, 5]);
            let some = Views::of((&camera, sigma_px), lag_s, &asked, |k| k > 3);
            assert_eq!(some.who, [4, 5]);
            assert_eq!((some.gate(0), some.gate(1)), (views.gate(4), views.gate(5)));
            for (who, prior) in asked.priors.iter().enumerate() {
                let (pixel, by_point) = camera.project_linear(&prior.after(lag_s)).expect("it is in sight");
                let own = by_point * prior.covariance_after(lag_s) * by_point.transpose();
                let push = by_point * by_point.transpose() * prior.push;
                let view = views.at(who);
                assert_relative_eq!(view.pixel, pixel, max_relative = 1e-12);
                for (k, ij) in [(0, 0), (0, 1), (1, 1)].into_iter().enumerate() {
                    assert_relative_eq!(view.own[k], own[ij], max_relative = 1e-9);
                    assert_relative_eq!(view.push[k], push[ij], max_relative = 1e-9);
                }
                let variance = (own + push + Matrix2::identity() * sigma_px * sigma_px).diagonal();
                let (at, reach) = views.gate(who);
                assert_eq!(at, view.pixel);
                assert_relative_eq!(Vector2::from(reach), (variance * GATE).map(f64::sqrt), max_relative = 1e-5);
            }
        }
    }

    #[test]
    fn behind_the_camera_they_are_nowhere() {
        let camera = rigs::ring(3, 4.0, 20.0, 0.0, [1280.0, 1024.0], 1300.0).cameras.remove(1);
        let behind = Prior { point: camera.position_m * 2.0, ..marker(0) };
        let views = Views::of((&camera, 0.4), 0.0, &Asked::of(&[Some(behind), Some(marker(1))]), |_| true);
        assert!(views.at(0).pixel.x.is_nan() && views.at(1).pixel.x.is_finite());
    }
}
