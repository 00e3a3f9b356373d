//! A walking and a dancing figure: capsules for trunk and limbs, markers on their surface.
//!
//! Segments are chained by joint rotations; the motions are sums of sines with incommensurate frequencies, so that a
//! take never repeats. The capsules hide markers from cameras as a body does. Not anatomy: a test bed for occlusion.

use super::random::Random;
use nalgebra::{Rotation3, Unit, Vector3};
use std::f64::consts::TAU;

/// A cylinder with round ends.
#[derive(Clone, Copy, Debug)]
pub struct Capsule {
    /// Ends of the axis (m, world).
    pub ends_m: [Vector3<f64>; 2],
    /// Radius (m).
    pub radius_m: f64,
}

impl Capsule {
    /// Whether the capsule cuts the line of sight from a marker to a camera. A marker on this capsule's own surface is
    /// hidden only if the line goes through the capsule's inside.
    pub fn hides(&self, marker: &Vector3<f64>, camera: &Vector3<f64>) -> bool {
        let start = marker + (camera - marker).normalize() * 1e-3;
        segment_distance(&start, camera, &self.ends_m[0], &self.ends_m[1]) < self.radius_m - 2e-3
    }
}

/// Smallest distance between two segments (Ericson 2005, "Real-Time Collision Detection", 5.1.9).
fn segment_distance(p1: &Vector3<f64>, q1: &Vector3<f64>, p2: &Vector3<f64>, q2: &Vector3<f64>) -> f64 {
    let (d1, d2, r) = (q1 - p1, q2 - p2, p1 - p2);
    let (a, e, f) = (d1.norm_squared(), d2.norm_squared(), d2.dot(&r));
    let (b, c) = (d1.dot(&d2), d1.dot(&r));
    let denominator = a * e - b * b;
    let mut s = if denominator > 1e-12 { ((b * f - c * e) / denominator).clamp(0.0, 1.0) } else { 0.0 };
    let mut t = (b * s + f) / e.max(1e-12);
    if !(0.0..=1.0).contains(&t) {
        t = t.clamp(0.0, 1.0);
        s = ((b * t - c) / a.max(1e-12)).clamp(0.0, 1.0);
    }
    ((p1 + d1 * s) - (p2 + d2 * t)).norm()
}

/// What the figure does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// Walks in a circle of 1 m radius.
    Walk,
    /// Turns, bends and throws arms and legs about.
    Dance,
    /// Stands and takes every joint through its range, one group after the other, both sides at once.
    Rom,
}

struct Segment {
    name: &'static str,
    parent: Option<usize>,
    /// Start of the segment in its parent's frame (m): x right, y forward, z up, from the parent's start.
    offset: [f64; 3],
    /// Direction and length in its own frame (m).
    axis: [f64; 3],
    radius: f64,
}

const SEGMENTS: [Segment; 14] = [
    Segment { name: "pelvis", parent: None, offset: [0.0, 0.0, 0.0], axis: [0.0, 0.0, 0.14], radius: 0.13 },
    Segment { name: "thorax", parent: Some(0), offset: [0.0, 0.0, 0.16], axis: [0.0, 0.0, 0.34], radius: 0.14 },
    Segment { name: "head", parent: Some(1), offset: [0.0, 0.02, 0.52], axis: [0.0, 0.0, 0.12], radius: 0.1 },
    Segment { name: "upper_arm_l", parent: Some(1), offset: [-0.2, 0.0, 0.36], axis: [0.0, 0.0, -0.28], radius: 0.045 },
    Segment { name: "forearm_l", parent: Some(3), offset: [0.0, 0.0, -0.28], axis: [0.0, 0.0, -0.25], radius: 0.035 },
    Segment { name: "hand_l", parent: Some(4), offset: [0.0, 0.0, -0.25], axis: [0.0, 0.0, -0.14], radius: 0.03 },
    Segment { name: "upper_arm_r", parent: Some(1), offset: [0.2, 0.0, 0.36], axis: [0.0, 0.0, -0.28], radius: 0.045 },
    Segment { name: "forearm_r", parent: Some(6), offset: [0.0, 0.0, -0.28], axis: [0.0, 0.0, -0.25], radius: 0.035 },
    Segment { name: "hand_r", parent: Some(7), offset: [0.0, 0.0, -0.25], axis: [0.0, 0.0, -0.14], radius: 0.03 },
    Segment { name: "thigh_l", parent: Some(0), offset: [-0.1, 0.0, -0.02], axis: [0.0, 0.0, -0.42], radius: 0.075 },
    Segment { name: "shank_l", parent: Some(9), offset: [0.0, 0.0, -0.42], axis: [0.0, 0.0, -0.4], radius: 0.05 },
    Segment { name: "thigh_r", parent: Some(0), offset: [0.1, 0.0, -0.02], axis: [0.0, 0.0, -0.42], radius: 0.075 },
    Segment { name: "shank_r", parent: Some(11), offset: [0.0, 0.0, -0.42], axis: [0.0, 0.0, -0.4], radius: 0.05 },
    Segment { name: "foot_l", parent: Some(10), offset: [0.0, -0.04, -0.4], axis: [0.0, 0.2, 0.0], radius: 0.04 },
];
const RIGHT_FOOT: Segment =
    Segment { name: "foot_r", parent: Some(12), offset: [0.0, -0.04, -0.4], axis: [0.0, 0.2, 0.0], radius: 0.04 };
const N_SEGMENTS: usize = SEGMENTS.len() + 1;

fn segment(i: usize) -> &'static Segment {
    if i < SEGMENTS.len() { &SEGMENTS[i] } else { &RIGHT_FOOT }
}

/// Stature of the figure (m): soles to the top of the head.
const STATURE: f64 = 1.79;
/// Height of the pelvis in the T-pose (m).
const T_POSE_ROOT: f64 = 0.93;
/// Time from the T-pose into the motion (s).
const INTO_MOTION_S: f64 = 1.0;
/// How long the figure takes for one group of joints of a range of motion (s), and the groups: middle and reach of the
/// turns about the axes right, forward, up of the left side (rad).
const ROM_S: f64 = 5.0;
const ROM: [(&str, [(f64, f64); 3]); 8] = [
    ("thorax", [(0.0, 0.4), (0.0, 0.3), (0.0, 0.5)]),
    ("head", [(0.0, 0.5), (0.0, 0.3), (0.0, 0.7)]),
    ("upper", [(0.0, 0.8), (-0.3, 0.7), (0.0, 0.6)]),
    ("forearm", [(0.9, 0.9), (0.0, 0.0), (0.0, 0.8)]),
    ("hand", [(0.0, 0.7), (0.0, 0.3), (0.0, 0.0)]),
    ("thigh", [(0.5, 0.5), (0.0, 0.35), (0.0, 0.25)]),
    ("shank", [(-0.8, 0.8), (0.0, 0.0), (0.0, 0.1)]),
    ("foot", [(0.0, 0.45), (0.0, 0.2), (0.0, 0.15)]),
];
/// How far markers are put beside their places (m, standard deviation), and how much statures differ (part).
const CARELESS: f64 = 0.008;
const STATURES: f64 = 0.08;

/// A marker glued to a segment.
struct Glued {
    label: String,
    segment: usize,
    /// Place in the segment's frame (m).
    place: Vector3<f64>,
}

/// A figure with its markers and its own habits of motion.
pub struct Body {
    markers: Vec<Glued>,
    motion: Motion,
    phases: Vec<f64>,
    center: Vector3<f64>,
    /// Size, and for how long the figure stands in a T-pose first (s).
    scale: f64,
    t_pose_s: f64,
}

/// The figure at one moment.
pub struct Pose {
    /// Marker positions (m, world), in the order of [`Body::labels`].
    pub markers_m: Vec<Vector3<f64>>,
    /// What hides markers.
    pub capsules: Vec<Capsule>,
    /// Where segments start: the joints (m, world), in the order of [`segment_names`].
    pub joints_m: Vec<Vector3<f64>>,
}

/// Names of the figure's segments.
pub fn segment_names() -> Vec<&'static str> {
    (0..N_SEGMENTS).map(|i| segment(i).name).collect()
}

impl Body {
    /// A figure with `n_markers` markers spread over its segments, at least one on each where there are enough.
    pub fn new(motion: Motion, n_markers: usize, seed: u64, center: Vector3<f64>) -> Self {
        let mut random = Random::new(seed, u64::MAX);
        let phases = (0..3 * N_SEGMENTS).map(|_| random.between(0.0, TAU)).collect();
        let mut markers = Vec::new();
        for k in 0..n_markers {
            let i = k % N_SEGMENTS;
            let part = segment(i);
            let axis = Vector3::from(part.axis);
            let along = random.between(0.1, 0.9);
            let across = Unit::new_normalize(axis.cross(&Vector3::new(0.3, 0.4, 0.2)));
            let around = Rotation3::from_axis_angle(&Unit::new_normalize(axis), random.between(0.0, TAU));
            let place = axis * along + around * across.into_inner() * (part.radius + 0.008);
            markers.push(Glued { label: format!("{}_{}", part.name, k / N_SEGMENTS + 1), segment: i, place });
        }
        Self { markers, motion, phases, center, scale: 1.0, t_pose_s: 0.0 }
    }

    /// A figure that wears a marker set: names, segments and places in the T-pose (parts of the stature: forward, left,
    /// up). It stands in the T-pose for `t_pose_s`, then moves. Markers are put on carelessly and statures differ, both
    /// from the seed. `None` for a segment that the figure does not have.
    pub fn wearing(
        motion: Motion,
        set: &[(String, String, [f64; 3])],
        seed: u64,
        center: Vector3<f64>,
        t_pose_s: f64,
    ) -> Option<Self> {
        let mut body = Self::new(motion, 0, seed, center);
        let mut random = Random::new(seed, u64::MAX - 1);
        body.t_pose_s = t_pose_s;
        body.scale = random.between(1.0 - STATURES, 1.0 + STATURES);
        let pose = frames(&Vector3::new(0.0, 0.0, T_POSE_ROOT), &Rotation3::identity(), 1.0, t_pose);
        for (label, name, place) in set {
            let segment = (0..N_SEGMENTS).find(|&i| segment(i).name == name)?;
            let world = Vector3::new(-place[1], place[0], place[2]) * STATURE;
            let careless = Vector3::from_fn(|_, _| CARELESS * random.normal());
            let local = pose[segment].1.inverse() * (world - pose[segment].0) + careless;
            body.markers.push(Glued { label: label.clone(), segment, place: on_surface(segment, &local) });
        }
        Some(body)
    }

    /// Names of the markers.
    pub fn labels(&self) -> Vec<String> {
        self.markers.iter().map(|m| m.label.clone()).collect()
    }

    /// The figure at a time (s).
    pub fn pose(&self, time_s: f64) -> Pose {
        let (moving_s, share) = self.moment(time_s);
        let (mut root, heading) = self.root(moving_s);
        root.z *= self.scale;
        let joint = |i: usize| {
            let moved = self.joint(i, moving_s);
            if share < 1.0 { t_pose(i).slerp(&moved, share) } else { moved }
        };
        let frames = frames(&root, &heading, self.scale, joint);
        let capsule = |i: usize| {
            let (start, turn) = &frames[i];
            let end = start + turn * Vector3::from(segment(i).axis) * self.scale;
            Capsule { ends_m: [*start, end], radius_m: segment(i).radius * self.scale }
        };
        let place = |m: &Glued| frames[m.segment].0 + frames[m.segment].1 * m.place * self.scale;
        Pose {
            markers_m: self.markers.iter().map(place).collect(),
            capsules: (0..N_SEGMENTS).map(capsule).collect(),
            joints_m: frames.iter().map(|f| f.0).collect(),
        }
    }

    /// Time within the motion (s), and how much of it the pose shows: it sets out gently from the T-pose.
    fn moment(&self, time_s: f64) -> (f64, f64) {
        if self.t_pose_s <= 0.0 {
            return (time_s, 1.0);
        }
        let after = ((time_s - self.t_pose_s) / INTO_MOTION_S).max(0.0);
        let begun = after.min(1.0);
        (INTO_MOTION_S * (after - begun + 0.5 * begun * begun), begun * begun * (3.0 - 2.0 * begun))
    }

    fn root(&self, t: f64) -> (Vector3<f64>, Rotation3<f64>) {
        match self.motion {
            Motion::Walk => {
                let angle = 1.2 * t + self.phases[0];
                let bob = 0.02 * (2.0 * TAU * 0.9 * t).sin();
                let place = Vector3::new(angle.cos(), angle.sin(), 0.93 + bob);
                (place + self.center, Rotation3::from_axis_angle(&Vector3::z_axis(), angle))
            }
            Motion::Rom => {
                let sway = |rate: f64, phase: f64| (TAU * rate * t + phase).sin();
                let place =
                    Vector3::new(0.02 * sway(0.2, self.phases[0]), 0.02 * sway(0.13, self.phases[1]), T_POSE_ROOT);
                (place + self.center, Rotation3::from_axis_angle(&Vector3::z_axis(), 0.1 * sway(0.1, self.phases[2])))
            }
            Motion::Dance => {
                let sway = |rate: f64, phase: f64| (TAU * rate * t + phase).sin();
                let place = Vector3::new(
                    0.5 * sway(0.23, self.phases[0]),
                    0.4 * sway(0.31, self.phases[1]),
                    0.9 + 0.06 * sway(1.1, self.phases[2]),
                );
                let turn = 1.6 * sway(0.17, self.phases[3]) + 0.9 * t;
                (place + self.center, Rotation3::from_axis_angle(&Vector3::z_axis(), turn))
            }
        }
    }

    /// Rotation of a segment against its parent.
    fn joint(&self, i: usize, t: f64) -> Rotation3<f64> {
        let name = segment(i).name;
        let side = if name.ends_with("_l") { 1.0 } else { -1.0 };
        let swing = |rate: f64, phase: f64| (TAU * rate * t + phase).sin();
        match self.motion {
            Motion::Walk => {
                let stride = swing(0.9, 0.0) * side;
                let bend = match name.split('_').next().unwrap_or_default() {
                    "thigh" => 0.45 * stride,
                    "shank" => -0.4 - 0.4 * swing(0.9, 1.2 * side),
                    "upper" => -0.4 * stride,
                    "forearm" => 0.4 - 0.2 * stride,
                    _ => 0.03 * swing(0.9, 0.5),
                };
                Rotation3::from_axis_angle(&Vector3::x_axis(), bend)
            }
            Motion::Rom => {
                let bodypart = name.split('_').next().unwrap_or_default();
                let Some(turn) = ROM.iter().position(|(part, _)| *part == bodypart) else { return t_pose(i) };
                let since = (t / ROM_S).rem_euclid(ROM.len() as f64) - turn as f64;
                let wave = if (0.0..1.0).contains(&since) { (0.5 * TAU * since).sin() } else { 0.0 };
                let phase = TAU * since;
                let swings = [(2.0 * phase).sin(), (3.0 * phase).cos(), (4.0 * phase).sin()];
                let bend = |axis: usize| {
                    let mirror = if axis == 0 { 1.0 } else { side };
                    let (middle, reach) = ROM[turn].1[axis];
                    mirror * (middle * wave + reach * wave * swings[axis])
                };
                t_pose(i) * Rotation3::from_euler_angles(bend(0), bend(1), bend(2))
            }
            Motion::Dance => {
                let reach = match name.split('_').next().unwrap_or_default() {
                    "pelvis" => [0.15, 0.15, 0.2],
                    "thorax" | "head" => [0.35, 0.25, 0.4],
                    "upper" => [1.4, 1.0, 0.6],
                    "forearm" => [0.9, 0.1, 0.5],
                    "thigh" => [0.6, 0.3, 0.2],
                    "shank" => [0.5, 0.02, 0.05],
                    _ => [0.4, 0.2, 0.1],
                };
                let bias = match name.split('_').next().unwrap_or_default() {
                    "upper" => [0.5, -0.8 * side, 0.0],
                    "forearm" => [1.0, 0.0, 0.0],
                    "thigh" => [0.3, 0.0, 0.0],
                    "shank" => [-0.55, 0.0, 0.0],
                    _ => [0.0; 3],
                };
                let rates = [0.53 + 0.031 * i as f64, 0.37 + 0.023 * i as f64, 0.29 + 0.017 * i as f64];
                let angle = |axis: usize| bias[axis] + reach[axis] * swing(rates[axis], self.phases[3 * i + axis]);
                Rotation3::from_euler_angles(angle(0), angle(1), angle(2))
            }
        }
    }
}

/// Start and turn of every segment, from the root and the turns of the joints.
fn frames(
    root: &Vector3<f64>,
    heading: &Rotation3<f64>,
    scale: f64,
    joint: impl Fn(usize) -> Rotation3<f64>,
) -> Vec<(Vector3<f64>, Rotation3<f64>)> {
    let mut frames: Vec<(Vector3<f64>, Rotation3<f64>)> = Vec::with_capacity(N_SEGMENTS);
    for i in 0..N_SEGMENTS {
        let part = segment(i);
        let frame = match part.parent {
            None => (*root, heading * joint(i)),
            Some(p) => {
                let (start, turn) = &frames[p];
                (start + turn * Vector3::from(part.offset) * scale, turn * joint(i))
            }
        };
        frames.push(frame);
    }
    frames
}

/// Turns of the joints in the T-pose: the arms to the sides.
fn t_pose(i: usize) -> Rotation3<f64> {
    let turn = match segment(i).name {
        "upper_arm_l" => 0.25 * TAU,
        "upper_arm_r" => -0.25 * TAU,
        _ => 0.0,
    };
    Rotation3::from_axis_angle(&Vector3::y_axis(), turn)
}

/// The place on a segment's surface nearest to a place in its frame.
fn on_surface(i: usize, place: &Vector3<f64>) -> Vector3<f64> {
    let axis = Vector3::from(segment(i).axis);
    let along = (place.dot(&axis) / axis.norm_squared()).clamp(0.0, 1.0);
    let out = place - axis * along;
    axis * along + out * ((segment(i).radius + 0.008) / out.norm().max(1e-6))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn markers_of_one_segment_stay_rigid_and_move_smoothly() {
        let body = Body::new(Motion::Dance, 41, 5, Vector3::zeros());
        let (a, b) = (0, N_SEGMENTS); // both on the pelvis
        let distance = |p: &Pose| (p.markers_m[a] - p.markers_m[b]).norm();
        let first = distance(&body.pose(0.0));
        let mut before = body.pose(0.0);
        for frame in 1..500 {
            let pose = body.pose(f64::from(frame) * 0.01);
            assert!((distance(&pose) - first).abs() < 1e-9);
            let fastest = pose.markers_m.iter().zip(&before.markers_m).map(|(p, q)| (p - q).norm()).fold(0.0, f64::max);
            assert!(fastest < 0.12, "a marker moved {fastest} m in 10 ms");
            before = pose;
        }
    }

    #[test]
    fn a_figure_stands_on_the_floor_at_human_size() {
        let pose = Body::new(Motion::Walk, 41, 5, Vector3::zeros()).pose(0.0);
        let heights = pose.markers_m.iter().map(|p| p.z);
        assert!(heights.clone().fold(f64::INFINITY, f64::min) > -0.15);
        assert!((1.4..2.0).contains(&heights.fold(0.0, f64::max)));
    }
}
