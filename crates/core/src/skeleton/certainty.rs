//! How certain a pose is: from the inverse of its normal equations, only where columns meet.

use super::kinematics::{Segment, segments};
use super::normal::Inverse;
use super::solve::{Evidence, Prior, Solver, trust, velocity};
use super::{Figure, Marker, Pose};
use nalgebra::{Vector3, Vector6};

/// How certain a pose is.
#[derive(Clone, Debug)]
pub struct Certainty {
    /// Variance of every component of every turn (rad²); infinite where it is not solved for.
    pub turn_rad2: Vec<Vector3<f64>>,
    /// Variance of the root's place (m²).
    pub root_m2: Vector3<f64>,
    /// Variance of the root's turn (rad²).
    pub root_rad2: Vector3<f64>,
    /// Variance of every joint's place, over all three axes together (m²); empty where it was not asked for.
    pub joint_m2: Vec<f64>,
}

impl Solver {
    /// How certain a pose is: variances of its components and of the joints' places.
    pub fn certainty(
        &mut self,
        figure: &Figure,
        pose: &Pose,
        evidence: Evidence<'_>,
        prior: Option<&Prior>,
        of_joints: bool,
    ) -> Option<Certainty> {
        self.assemble(figure, pose, evidence, prior, 1.0);
        let all = segments(&figure.joints, pose);
        let factor = self.normal.factor(0.0)?;
        let inverse = factor.inverse();
        let mut turn = vec![Vector3::repeat(f64::INFINITY); figure.joints.len()];
        let (mut root_m, mut root_rad) = (Vector3::zeros(), Vector3::zeros());
        for (c, column) in self.columns.iter().enumerate() {
            let variance = inverse.diagonal(c);
            match (column.joint, column.component) {
                (0, k) if k < 3 => root_m[k] = variance,
                (0, k) => root_rad[k - 3] = variance,
                (j, k) => turn[j][k] = variance,
            }
        }
        let joint_m2 = if of_joints {
            let twists = self.twists(&figure.joints, pose, &all);
            self.joint_variances(figure, pose, &all, &twists, &inverse)
        } else {
            Vec::new()
        };
        Some(Certainty { turn_rad2: turn, root_m2: root_m, root_rad2: root_rad, joint_m2 })
    }

    /// How much of each marker's own noise goes into the pose (0: none, 1: all), per marker; `None` where not seen.
    pub fn leverage(&mut self, figure: &Figure, pose: &Pose, evidence: Evidence<'_>) -> Option<Vec<Option<f64>>> {
        self.assemble(figure, pose, evidence, None, 1.0);
        let all = segments(&figure.joints, pose);
        let twists = self.twists(&figure.joints, pose, &all);
        let inverse = self.normal.factor(0.0)?.inverse();
        let last = self.last_columns(&figure.joints);
        let own = |(marker, seen): (&Marker, &Option<Vector3<f64>>)| {
            let at = all[marker.joint].place(&marker.place_m);
            let information = 1.0 / (marker.sigma_m * marker.sigma_m);
            let weight = trust((at - (*seen)?).norm_squared() * information, 1.0) * information;
            let variance = self.variance(last[marker.joint], &(at - pose.root_m), &twists, &inverse);
            Some((weight * variance / 3.0).min(1.0))
        };
        Some(figure.markers.iter().zip(evidence.markers_m).map(own).collect())
    }

    /// Variance, over all three axes together, of a point that moves with a column and those above it; `at` from the
    /// root.
    fn variance(&self, last: usize, at: &Vector3<f64>, twists: &[Vector6<f64>], inverse: &Inverse) -> f64 {
        let above = self.normal.way(last);
        let moves: Vec<Vector3<f64>> = std::iter::once(&last).chain(above).map(|&c| velocity(&twists[c], at)).collect();
        let mut sum = 0.0;
        for (p, c) in std::iter::once(&last).chain(above).enumerate() {
            sum += inverse.diagonal(*c) * moves[p].norm_squared();
            let with = inverse.row(*c).iter().zip(&moves[p + 1..]);
            sum += 2.0 * with.map(|(entry, there)| entry * moves[p].dot(there)).sum::<f64>();
        }
        sum
    }

    /// Variance of the joints' places; those that are not solved for are as certain as what they hang from.
    fn joint_variances(
        &self,
        figure: &Figure,
        pose: &Pose,
        all: &[Segment],
        twists: &[Vector6<f64>],
        inverse: &Inverse,
    ) -> Vec<f64> {
        let last = self.last_columns(&figure.joints);
        let mut out: Vec<f64> = Vec::with_capacity(figure.joints.len());
        for (j, joint) in figure.joints.iter().enumerate() {
            // A joint's place does not depend on its own turn.
            out.push(match joint.parent {
                Some(p) if last[j] == last[p] => out[p],
                above => {
                    let column = above.map_or(5, |p| last[p]);
                    self.variance(column, &(all[j].joint_m - pose.root_m), twists, inverse)
                }
            });
        }
        out
    }
}
