//! What a motion must do: where places are, how they lie to each other, how far from the floor.

use crate::skeleton::kinematics::Segment;
use nalgebra::Vector3;

/// A place on a segment (m, segment's axes).
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Whose segment carries it.
    pub joint: usize,
    /// From the joint (m).
    pub local_m: Vector3<f64>,
}

impl Place {
    /// Where it is in the world (m).
    pub fn of(&self, pose: &[Segment]) -> Vector3<f64> {
        pose[self.joint].place(&self.local_m)
    }
}

/// One thing wanted in one frame.
#[derive(Clone, Debug)]
pub enum Want {
    /// A place is here (m, world).
    At(Place, Vector3<f64>),
    /// A place is at least so high (m, world).
    Above(Place, f64),
    /// From the second place to the first is so much (m, world).
    Apart(Place, Place, Vector3<f64>),
    /// A direction of a segment points at a place of the world (m).
    Look(Place, Vector3<f64>, Vector3<f64>),
    /// Two places are at most so far from each other (m).
    Within(Place, Place, f64),
}

/// A want and the frame it holds in.
#[derive(Clone, Debug)]
pub struct Goal {
    /// Frame of the clip, from 0.
    pub frame: usize,
    /// What is wanted.
    pub want: Want,
}

/// A joint, a place that moves with it (m, world), and the direction in which its moving adds to what is missing.
type Moves = (usize, Vector3<f64>, Vector3<f64>);

/// What is missing, and how that changes as places move and joints turn.
pub struct Row {
    /// What is missing (m).
    pub off: f64,
    /// Places whose moving changes it.
    pub moves: [Option<Moves>; 2],
    /// A joint whose turning adds to `off` by this axis.
    pub turns: Option<(usize, Vector3<f64>)>,
}

impl Goal {
    /// The rows of this goal in a pose; none where an inequality is met.
    pub fn rows(&self, pose: &[Segment], out: &mut Vec<Row>) {
        out.clear();
        let along = |out: &mut Vec<Row>, off: f64, moves, turns| out.push(Row { off, moves, turns });
        match &self.want {
            Want::At(place, target) => {
                let at = place.of(pose);
                for k in 0..3 {
                    along(out, at[k] - target[k], [Some((place.joint, at, axis(k))), None], None);
                }
            }
            Want::Above(place, height) => {
                let at = place.of(pose);
                if at.z < *height {
                    along(out, at.z - height, [Some((place.joint, at, axis(2))), None], None);
                }
            }
            Want::Apart(a, b, offset) => {
                let (pa, pb) = (a.of(pose), b.of(pose));
                for k in 0..3 {
                    let moves = [Some((a.joint, pa, axis(k))), Some((b.joint, pb, -axis(k)))];
                    along(out, pa[k] - pb[k] - offset[k], moves, None);
                }
            }
            Want::Within(a, b, longest) => {
                let (pa, pb) = (a.of(pose), b.of(pose));
                let (way, length) = (pa - pb, (pa - pb).norm());
                if length > *longest {
                    let unit = way / length;
                    let moves = [Some((a.joint, pa, unit)), Some((b.joint, pb, -unit))];
                    along(out, length - longest, moves, None);
                }
            }
            Want::Look(from, direction, target) => look(pose, from, direction, target, out),
        }
    }
}

/// How far beside the target a look passes, per metre of distance: two rows across the way to the target.
fn look(pose: &[Segment], from: &Place, direction: &Vector3<f64>, target: &Vector3<f64>, out: &mut Vec<Row>) {
    let eye = from.of(pose);
    let way = target - eye;
    let distance = way.norm();
    if distance < 1e-6 {
        return;
    }
    let (unit, seen) = (way / distance, pose[from.joint].turn * direction);
    let side = unit.cross(&axis(unit.iamin())).normalize();
    for across in [side, unit.cross(&side)] {
        // A look that points away must still turn: behind, the sine would be flat.
        let off = across.dot(&seen) * if unit.dot(&seen) < 0.0 { 2.0 } else { 1.0 };
        let moves = [Some((from.joint, eye, across / distance)), None];
        out.push(Row { off, moves, turns: Some((from.joint, seen.cross(&across))) });
    }
}

fn axis(k: usize) -> Vector3<f64> {
    Vector3::from_fn(|i, _| f64::from(u8::from(i == k)))
}
