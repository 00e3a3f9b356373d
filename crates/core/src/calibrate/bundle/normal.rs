//! Normal equations of a bundle, reduced to the cameras.

use super::camera::{PARAMETERS, project};
use super::{Bundle, POSE};
use nalgebra::{Cholesky, DMatrix, DVector, SMatrix, SVector};

type CameraBlock = SMatrix<f64, PARAMETERS, PARAMETERS>;
type PoseBlock = SMatrix<f64, POSE, POSE>;
type Cross = SMatrix<f64, PARAMETERS, POSE>;

/// What one camera saw of one pose.
struct Shared {
    camera: usize,
    cross: Cross,
}

/// One pose's share: its block, its right side, and the cameras that saw it in `shared[first..last]`.
struct OfPose {
    block: PoseBlock,
    right: SVector<f64, POSE>,
    first: usize,
    last: usize,
}

/// The equations at one state of a bundle; held parameters have an empty row and column.
pub struct Normal {
    cameras: Vec<CameraBlock>,
    right: Vec<SVector<f64, PARAMETERS>>,
    poses: Vec<OfPose>,
    shared: Vec<Shared>,
    held_in_pose: [bool; POSE],
}

/// Beyond this the digits of a pose's inverse are lost in rounding.
const LARGEST_INFLATION: f64 = 1e9;

/// Adds `Aᵀ W B` of two rows `A`, `B` (matrix in column-major order): the inner loop of the linearisation.
fn add_product<const R: usize, const C: usize>(
    target: &mut SMatrix<f64, R, C>,
    left: &SMatrix<f64, 2, R>,
    right: &SMatrix<f64, 2, C>,
) {
    for c in 0..C {
        let (x, y) = (right[(0, c)], right[(1, c)]);
        for r in 0..R {
            target[(r, c)] += left[(0, r)] * x + left[(1, r)] * y;
        }
    }
}

/// Subtracts `gain crossᵀ`, column by column with the sums in registers: the inner loop of the reduction.
fn subtract_product(target: &mut CameraBlock, gain: &Cross, cross: &Cross) {
    for c in 0..PARAMETERS {
        let mut sum = [0.0; PARAMETERS];
        for k in 0..POSE {
            let factor = cross[(c, k)];
            for r in 0..PARAMETERS {
                sum[r] += gain[(r, k)] * factor;
            }
        }
        for r in 0..PARAMETERS {
            target[(r, c)] -= sum[r];
        }
    }
}

impl Normal {
    /// Linearises all sightings of positive weight.
    pub fn of(bundle: &Bundle) -> Self {
        let n = bundle.cameras.len();
        let mut made = Self {
            cameras: vec![CameraBlock::zeros(); n],
            right: vec![SVector::zeros(); n],
            poses: Vec::with_capacity(bundle.poses.len()),
            shared: Vec::new(),
            held_in_pose: bundle.held_in_pose(),
        };
        let mut at = 0;
        for pose in 0..bundle.poses.len() {
            let first = made.shared.len();
            let mut own = OfPose { block: PoseBlock::zeros(), right: SVector::zeros(), first, last: first };
            while at < bundle.sightings.len() && bundle.sightings[at].pose == pose {
                made.add(bundle, at, &mut own);
                at += 1;
            }
            own.last = made.shared.len();
            made.poses.push(own);
        }
        made
    }

    fn add(&mut self, bundle: &Bundle, index: usize, own: &mut OfPose) {
        let s = &bundle.sightings[index];
        if s.weight <= 0.0 {
            return;
        }
        let (pose, marker) = (&bundle.poses[s.pose], &bundle.wand.markers_m[s.marker]);
        let camera = &bundle.cameras[s.camera];
        let Some((pixel, by_point, mut by_camera)) = project(camera, &pose.place(marker)) else { return };
        for (i, free) in bundle.freedom[s.camera].iter().enumerate() {
            if !free {
                by_camera.column_mut(i).fill(0.0);
            }
        }
        let mut by_pose = pose.derivatives(&by_point, marker);
        for (i, held) in self.held_in_pose.iter().enumerate() {
            if *held {
                by_pose.column_mut(i).fill(0.0);
            }
        }
        let residual = s.pixel - pixel;
        if self.shared[own.first..].last().is_none_or(|o| o.camera != s.camera) {
            self.shared.push(Shared { camera: s.camera, cross: Cross::zeros() });
        }
        let Some(shared) = self.shared.last_mut() else { return };
        let (weighted_camera, weighted_pose) = (by_camera * s.weight, by_pose * s.weight);
        add_product(&mut self.cameras[s.camera], &weighted_camera, &by_camera);
        add_product(&mut own.block, &weighted_pose, &by_pose);
        add_product(&mut shared.cross, &weighted_camera, &by_pose);
        self.right[s.camera] += weighted_camera.transpose() * residual;
        own.right += weighted_pose.transpose() * residual;
    }

    /// The step of cameras and poses for a damping relative to the diagonal; `None` where the equations are singular.
    pub fn step(&self, damping: f64) -> Option<(DVector<f64>, Vec<SVector<f64, POSE>>)> {
        let inverses: Vec<PoseBlock> =
            self.poses.iter().map(|p| self.inverse(&p.block, damping)).collect::<Option<_>>()?;
        let (matrix, right) = self.reduced(&inverses, damping);
        let cameras = Cholesky::new(matrix)?.solve(&right);
        let step_of = |i: usize| SVector::<f64, PARAMETERS>::from_fn(|k, _| cameras[i * PARAMETERS + k]);
        let pose_step = |p: &OfPose, inverse: &PoseBlock| {
            let mut right = p.right;
            for s in &self.shared[p.first..p.last] {
                right -= s.cross.transpose() * step_of(s.camera);
            }
            inverse * right
        };
        let poses = self.poses.iter().zip(&inverses).map(|(p, inverse)| pose_step(p, inverse)).collect();
        Some((cameras, poses))
    }

    /// Inverse of a pose's block; zero rows where a parameter is held.
    fn inverse(&self, block: &PoseBlock, damping: f64) -> Option<PoseBlock> {
        let mut damped = *block;
        for i in 0..POSE {
            damped[(i, i)] *= 1.0 + damping;
            if self.held_in_pose[i] || damped[(i, i)] <= 0.0 {
                damped[(i, i)] = 1.0;
            }
        }
        let mut inverse = Cholesky::new(damped)?.inverse();
        for (i, held) in self.held_in_pose.iter().enumerate() {
            if *held {
                inverse[(i, i)] = 0.0;
            }
        }
        Some(inverse)
    }

    /// The cameras' equations with the poses eliminated; a diagonal of one where nothing is known or free.
    fn reduced(&self, inverses: &[PoseBlock], damping: f64) -> (DMatrix<f64>, DVector<f64>) {
        let n = self.cameras.len();
        let mut blocks: Vec<CameraBlock> = vec![CameraBlock::zeros(); n * (n + 1) / 2];
        let mut right = self.right.clone();
        for (p, inverse) in self.poses.iter().zip(inverses) {
            let own = &self.shared[p.first..p.last];
            for a in own {
                let gain = a.cross * inverse;
                right[a.camera] -= gain * p.right;
                for b in own.iter().filter(|b| b.camera <= a.camera) {
                    let block = &mut blocks[a.camera * (a.camera + 1) / 2 + b.camera];
                    subtract_product(block, &gain, &b.cross);
                }
            }
        }
        let mut matrix = DMatrix::zeros(n * PARAMETERS, n * PARAMETERS);
        for i in 0..n {
            for j in 0..=i {
                let mut block = blocks[i * (i + 1) / 2 + j];
                if i == j {
                    block += self.cameras[i];
                    for k in 0..PARAMETERS {
                        let diagonal = self.cameras[i][(k, k)];
                        block[(k, k)] += if diagonal > 0.0 { damping * diagonal } else { 1.0 };
                    }
                }
                matrix.view_mut((i * PARAMETERS, j * PARAMETERS), (PARAMETERS, PARAMETERS)).copy_from(&block);
                matrix
                    .view_mut((j * PARAMETERS, i * PARAMETERS), (PARAMETERS, PARAMETERS))
                    .copy_from(&block.transpose());
            }
        }
        (matrix, DVector::from_iterator(n * PARAMETERS, right.iter().flat_map(|r| r.iter().copied())))
    }

    /// The reduced matrix without damping; poses that the views do not fix are left out.
    pub fn information(&self) -> DMatrix<f64> {
        let of = |p: &OfPose| self.inverse(&p.block, 0.0).filter(|i| is_fixed(&p.block, i));
        let inverses: Vec<PoseBlock> = self.poses.iter().map(|p| of(p).unwrap_or_else(PoseBlock::zeros)).collect();
        self.reduced(&inverses, 0.0).0
    }
}

/// Whether a block's inverse can be trusted: no parameter's variance grows beyond all digits because the others are
/// unknown too (the variance inflation factor of regression).
fn is_fixed(block: &PoseBlock, inverse: &PoseBlock) -> bool {
    (0..POSE).all(|k| block[(k, k)] * inverse[(k, k)] < LARGEST_INFLATION)
}
