//! From turns to places.

use super::{Joint, Pose};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use std::f64::consts::TAU;

/// A segment in the world.
#[derive(Clone, Copy, Debug)]
pub struct Segment {
    /// From the segment's axes to the world's.
    pub turn: Rotation3<f64>,
    /// Place of its joint (m).
    pub joint_m: Vector3<f64>,
}

impl Segment {
    /// A place of the segment in the world (m).
    pub fn place(&self, local_m: &Vector3<f64>) -> Vector3<f64> {
        self.joint_m + self.turn * local_m
    }
}

impl Joint {
    /// The rotation against the parent.
    pub fn turned(&self, turn: &Vector3<f64>) -> Rotation3<f64> {
        match self.order {
            None => Rotation3::new(*turn),
            Some(order) => order.iter().fold(Rotation3::identity(), |before, &k| before * about(k, turn[k])),
        }
    }

    /// The axes about which a change of each component turns, in the parent's axes: one column per component.
    pub fn axes(&self, turn: &Vector3<f64>) -> Matrix3<f64> {
        let Some(order) = self.order else { return left_jacobian(turn) };
        let mut axes = Matrix3::zeros();
        let mut before = Rotation3::identity();
        for k in order {
            axes.set_column(k, &before.matrix().column(k));
            before *= about(k, turn[k]);
        }
        axes
    }

    /// The same turn told so that it is near another one: whole turns taken off or added.
    pub fn near(&self, turn: &Vector3<f64>, to: &Vector3<f64>) -> Vector3<f64> {
        match self.order {
            None => nearest_turn(turn, to),
            Some(_) => turn.zip_map(to, |t, near| t - TAU * ((t - near) / TAU).round()),
        }
    }
}

/// Rotation about one of the axes.
fn about(axis: usize, angle: f64) -> Rotation3<f64> {
    let (s, c) = angle.sin_cos();
    let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
    let mut m = Matrix3::identity();
    (m[(i, i)], m[(i, j)], m[(j, i)], m[(j, j)]) = (c, -s, s, c);
    Rotation3::from_matrix_unchecked(m)
}

/// All segments of a pose.
pub fn segments(joints: &[Joint], pose: &Pose) -> Vec<Segment> {
    let mut all: Vec<Segment> = Vec::with_capacity(joints.len());
    for (j, joint) in joints.iter().enumerate() {
        all.push(match joint.parent {
            None => Segment { turn: pose.root, joint_m: pose.root_m },
            Some(p) => {
                Segment { turn: all[p].turn * joint.turned(&pose.turns[j]), joint_m: all[p].place(&joint.offset_m) }
            }
        });
    }
    all
}

/// The matrix of the cross product.
pub fn cross(v: &Vector3<f64>) -> Matrix3<f64> {
    v.cross_matrix()
}

/// Left Jacobian of the exponential map: exp(r + d) ≈ exp(J d) exp(r) (Barfoot 2017, eq 7.77b).
pub fn left_jacobian(r: &Vector3<f64>) -> Matrix3<f64> {
    let angle = r.norm();
    let skew = cross(r);
    if angle < 1e-5 {
        return Matrix3::identity() + skew * 0.5 + skew * skew / 6.0;
    }
    let square = angle * angle;
    Matrix3::identity()
        + skew * ((1.0 - angle.cos()) / square)
        + skew * skew * ((angle - angle.sin()) / (square * angle))
}

/// The rotation vector of the same rotation that is nearest to another one: vectors that differ by whole turns are the
/// same rotation, and a motion should not jump between them.
pub fn nearest_turn(r: &Vector3<f64>, to: &Vector3<f64>) -> Vector3<f64> {
    let angle = r.norm();
    if angle < 1e-9 {
        return *r;
    }
    let axis = r / angle;
    let turns = ((axis.dot(to) - angle) / TAU).round();
    axis * (angle + turns * TAU)
}

/// The rotation vector of a rotation, exact for small ones and sound where rounding has touched the matrix.
pub fn vector_of(turn: &Rotation3<f64>) -> Vector3<f64> {
    UnitQuaternion::from_rotation_matrix(turn).scaled_axis()
}

/// The rotation R that makes the trace of Rᵀ Σ there hereᵀ largest: that turns here onto there (Kabsch 1976).
pub fn best_turn(spread: &Matrix3<f64>) -> Rotation3<f64> {
    let svd = spread.svd(true, true);
    let (Some(u), Some(vt)) = (svd.u, svd.v_t) else { return Rotation3::identity() };
    let mirror = Vector3::new(1.0, 1.0, (u * vt).determinant().signum());
    Rotation3::from_matrix_unchecked(u * Matrix3::from_diagonal(&mirror) * vt)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The vector of a rotation by next to nothing.
    fn small(turn: &Rotation3<f64>) -> Vector3<f64> {
        let m = (turn.matrix() - turn.matrix().transpose()) * 0.5;
        Vector3::new(m[(2, 1)], m[(0, 2)], m[(1, 0)])
    }

    #[test]
    fn the_axes_of_a_joint_are_the_derivative_of_its_turn() {
        for order in [None, Some([0, 1, 2]), Some([2, 1, 0]), Some([1, 2, 0])] {
            let joint = Joint {
                parent: Some(0),
                offset_m: Vector3::x(),
                order,
                free: [true; 3],
                limits_rad: [[-3.0, 3.0]; 3],
                rest_sd_rad: [1.0; 3],
            };
            let turn = Vector3::new(0.4, -0.9, 1.3);
            let axes = joint.axes(&turn);
            for k in 0..3 {
                let step = Vector3::from_fn(|i, _| if i == k { 1e-6 } else { 0.0 });
                let moved = joint.turned(&(turn + step)) * joint.turned(&(turn - step)).inverse();
                assert!((small(&moved) / 2e-6 - axes.column(k)).norm() < 1e-6);
            }
        }
    }

    #[test]
    fn the_left_jacobian_is_the_derivative_of_the_exponential() {
        for r in [Vector3::new(0.3, -1.2, 0.7), Vector3::new(1e-7, 0.0, 2e-7), Vector3::new(0.0, 2.9, 0.1)] {
            let jacobian = left_jacobian(&r);
            for k in 0..3 {
                let step = Vector3::from_fn(|i, _| if i == k { 1e-6 } else { 0.0 });
                let turned = Rotation3::new(r + step) * Rotation3::new(r - step).inverse();
                assert!((small(&turned) / 2e-6 - jacobian.column(k)).norm() < 1e-6);
            }
        }
    }

    #[test]
    fn a_vector_past_half_a_turn_stays_with_its_neighbours() {
        let before = Vector3::new(0.0, 0.0, 3.1);
        let after = Rotation3::new(Vector3::new(0.0, 0.0, 3.2)).scaled_axis();
        assert!((nearest_turn(&after, &before) - Vector3::new(0.0, 0.0, 3.2)).norm() < 1e-9);
    }
}
