//! How well an adjustment knows its cameras.
//!
//! A wand wave fixes no world: six combinations of the parameters (seven without a known length) are free. The
//! covariance is given for the rig laid onto its own camera centres by least squares, so that it is what is left of the errors
//! after such an alignment with the truth (inner constraints; Triggs et al. 2000, §9.2). Centres on one line, as two always
//! are, leave the turn about it open: then the cameras' directions are laid onto their own as well.

use super::Bundle;
use super::camera::PARAMETERS;
use nalgebra::{Cholesky, DMatrix, Matrix3, Vector3};

/// Centres whose extent across is this part of that along lie on one line.
const LINE: f64 = 1e-3;

/// Covariance of all cameras' parameters (15 each), where the weights are true inverse variances.
///
/// `scale_known`: whether a length fixes the scale. Cameras or poses that are held define the world instead; then
/// nothing is aligned. `None` where the sightings do not determine the cameras.
pub fn covariance(bundle: &Bundle, scale_known: bool) -> Option<DMatrix<f64>> {
    let information = bundle.information();
    let n = bundle.cameras.len();
    let sees = |i: usize| bundle.sightings.iter().any(|s| s.camera == i && s.weight > 0.0);
    let seeing: Vec<usize> = (0..n).filter(|i| sees(*i)).collect();
    let held = bundle.poses_held || seeing.iter().any(|i| !bundle.freedom[*i][3]);
    let scale = DMatrix::from_diagonal(&information.diagonal().map(|d| 1.0 / d.max(1e-300).sqrt()));
    let scaled = &scale * &information * &scale;
    if held {
        return Some(clear_held(bundle, &scale * Cholesky::new(scaled)?.inverse() * &scale));
    }
    let (freedoms, constraints) = gauge(bundle, &seeing, scale_known);
    let scaled_constraints = &constraints * &scale;
    let weight = 1.0 / scaled_constraints.norm_squared().max(1e-300);
    let fixed = scaled + scaled_constraints.transpose() * &scaled_constraints * weight;
    let moved = &constraints * &freedoms;
    let inner = (moved.transpose() * &moved * weight).try_inverse()?;
    let result = &scale * Cholesky::new(fixed)?.inverse() * &scale - &freedoms * inner * freedoms.transpose();
    Some(clear_held(bundle, result))
}

/// Held parameters are known exactly.
fn clear_held(bundle: &Bundle, mut matrix: DMatrix<f64>) -> DMatrix<f64> {
    for (camera, freedom) in bundle.freedom.iter().enumerate() {
        for (k, free) in freedom.iter().enumerate() {
            if !free {
                let at = camera * PARAMETERS + k;
                matrix.row_mut(at).fill(0.0);
                matrix.column_mut(at).fill(0.0);
            }
        }
    }
    matrix
}

/// What the cameras' directions count beside their centres (m²): nothing, unless the centres lie on one line.
fn direction_weight(arms: &[Vector3<f64>]) -> f64 {
    let scatter: Matrix3<f64> = arms.iter().map(|a| a * a.transpose()).sum();
    let spread = scatter.symmetric_eigenvalues();
    let mut ordered = [spread[0], spread[1], spread[2]];
    ordered.sort_by(f64::total_cmp);
    if ordered[1] < LINE * LINE * ordered[2] { ordered[2] / arms.len().max(1) as f64 } else { 0.0 }
}

/// Motions of the whole world (columns), and the constraints (rows) by which the centres of the cameras that see
/// something hold it.
fn gauge(bundle: &Bundle, seeing: &[usize], scale_known: bool) -> (DMatrix<f64>, DMatrix<f64>) {
    let n = bundle.cameras.len();
    let kinds = if scale_known { 6 } else { 7 };
    let centers = seeing.iter().map(|i| bundle.cameras[*i].position_m);
    let middle = centers.sum::<Vector3<f64>>() / seeing.len() as f64;
    let mut freedoms = DMatrix::zeros(n * PARAMETERS, kinds);
    let mut constraints = DMatrix::zeros(kinds, n * PARAMETERS);
    let arms: Vec<Vector3<f64>> = seeing.iter().map(|i| bundle.cameras[*i].position_m - middle).collect();
    let reach = direction_weight(&arms);
    for &i in seeing {
        let camera = &bundle.cameras[i];
        let at = i * PARAMETERS;
        let arm = camera.position_m - middle;
        let turn: Matrix3<f64> = -arm.cross_matrix();
        // X → (1 + [w]×) X: centres move by w × arm, the rotation becomes R (1 − [w]×) = (1 − [R w]×) R.
        freedoms.view_mut((at + 3, 0), (3, 3)).copy_from(&Matrix3::identity());
        freedoms.view_mut((at + 3, 3), (3, 3)).copy_from(&turn);
        freedoms.view_mut((at, 3), (3, 3)).copy_from(&-camera.camera_from_world);
        constraints.view_mut((0, at + 3), (3, 3)).copy_from(&Matrix3::identity());
        constraints.view_mut((3, at + 3), (3, 3)).copy_from(&turn.transpose());
        constraints.view_mut((3, at), (3, 3)).copy_from(&(camera.camera_from_world.transpose() * -reach));
        if !scale_known {
            freedoms.view_mut((at + 3, 6), (3, 1)).copy_from(&arm);
            constraints.view_mut((6, at + 3), (1, 3)).copy_from(&arm.transpose());
        }
    }
    (freedoms, constraints)
}
