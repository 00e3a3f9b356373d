//! Predicted markers as one camera sees them, computed for several at a time.

use super::innovation::GATE;
use super::matching::Prior;
use crate::camera::{Camera, Lens};
use nalgebra::{Matrix3, Vector2, Vector3};
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
        let (index, priors): (_, Vec<&Prior>) =
            priors.iter().enumerate().filter_map(|(i, p)| Some((i, p.as_ref()?))).unzip();
        Self { index, expected: expected(&priors, 0.0), priors }
    }
}

/// Where a block of markers is expected (m, m²).
struct Expected {
    point: [Lane; 3],
    /// xx, xy, xz, yy, yz, zz.
    covariance: [Lane; 6],
    push: Lane,
}

/// Where markers are expected some time later (s).
fn expected(priors: &[&Prior], lag_s: f64) -> Vec<Expected> {
    let mut later: Vec<_> = priors.iter().map(|p| (p.after(lag_s), p.covariance_after(lag_s), p.push)).collect();
    // The last block is filled up with a marker that nobody asks for.
    let last = later.last().copied();
    later.extend(last.into_iter().cycle().take(later.len().next_multiple_of(BLOCK) - later.len()));
    let block = |markers: &[(Vector3<f64>, Matrix3<f64>, f64)]| {
        let lane = |of: &dyn Fn(usize) -> f64| Lane::from(std::array::from_fn::<f64, BLOCK, _>(of));
        let unique = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
        Expected {
            point: [0, 1, 2].map(|i| lane(&|k| markers[k].0[i])),
            covariance: unique.map(|ij| lane(&|k| markers[k].1[ij])),
            push: lane(&|k| markers[k].2),
        }
    };
    later.chunks_exact(BLOCK).map(block).collect()
}

/// A predicted marker in one camera.
pub struct View {
    /// Where it is seen (px).
    pub pixel: Vector2<f64>,
    /// Covariance of the projection (px²; xx, xy, yy): own, and what a push adds.
    pub own: [f64; 3],
    pub push: [f64; 3],
}

impl View {
    /// Half width and height of the gate for dots of a noise (px).
    pub fn reach(&self, sigma_px: f64) -> [f64; 2] {
        [0, 2].map(|i| (WIDER_GATE * (self.own[i] + self.push[i] + sigma_px * sigma_px)).sqrt())
    }
}

/// All markers asked for as one camera sees them; those that it cannot see are nowhere (NaN).
pub struct Views {
    blocks: Vec<Seen>,
    markers: usize,
}

/// A block of views.
struct Seen {
    pixel: [[f64; BLOCK]; 2],
    own: [[f64; BLOCK]; 3],
    push: [[f64; BLOCK]; 3],
}

impl Views {
    /// How a camera sees them, later than the frame's moment (s).
    pub fn of(camera: &Camera, lag_s: f64, asked: &Asked) -> Self {
        let seen = |expected: &Expected| Seen::of(camera, expected);
        let blocks = if lag_s == 0.0 {
            asked.expected.iter().map(seen).collect()
        } else {
            expected(&asked.priors, lag_s).iter().map(seen).collect()
        };
        Self { blocks, markers: asked.index.len() }
    }

    /// Their number.
    pub fn len(&self) -> usize {
        self.markers
    }

    /// One of them.
    pub fn at(&self, who: usize) -> View {
        let (block, k) = (&self.blocks[who / BLOCK], who % BLOCK);
        let pixel = Vector2::new(block.pixel[0][k], block.pixel[1][k]);
        View { pixel, own: [0, 1, 2].map(|i| block.own[i][k]), push: [0, 1, 2].map(|i| block.push[i][k]) }
    }
}

impl Seen {
    fn of(camera: &Camera, expected: &Expected) -> Self {
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
        Self {
            pixel: pixel.map(Lane::to_array),
            own: [dot(&by_u, &u), dot(&by_u, &v), dot(&by_v, &v)].map(Lane::to_array),
            push: [dot(&u, &u), dot(&u, &v), dot(&v, &v)].map(|v| (v * expected.push).to_array()),
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
            let views = Views::of(&camera, lag_s, &asked);
            assert_eq!(views.len(), 6);
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
            }
        }
    }

    #[test]
    fn behind_the_camera_they_are_nowhere() {
        let camera = rigs::ring(3, 4.0, 20.0, 0.0, [1280.0, 1024.0], 1300.0).cameras.remove(1);
        let behind = Prior { point: camera.position_m * 2.0, ..marker(0) };
        let views = Views::of(&camera, 0.0, &Asked::of(&[Some(behind), Some(marker(1))]));
        assert!(views.at(0).pixel.x.is_nan() && views.at(1).pixel.x.is_finite());
    }
}
