//! A skeleton with constant bones: forward kinematics, inverse kinematics over all markers of a frame, the take solved
//! forwards and smoothed with what comes later, and the fit of bones and marker places to one person.
//!
//! A joint turns about its three axes one after the other, in the order that anatomy gives them (flexion, abduction,
//! rotation), or, as a ball, by a rotation vector (Grassia 1998); components can be locked, limited, or drawn to rest. Normal equations are summed over the tree of joints and solved with the tree's sparsity (Featherstone 2008,
//! sections 6.2 and 6.5).

pub mod certainty;
pub mod fit;
pub mod hold;
pub mod kinematics;
pub mod normal;
pub mod series;
pub mod solve;
pub mod take;

use nalgebra::{Rotation3, Vector3};

/// A joint and the segment that hangs from it. In the rest pose all segments' axes are the world's.
#[derive(Clone, Debug)]
pub struct Joint {
    /// The joint above; smaller than the joint's own index. `None` only for the root, which is joint 0.
    pub parent: Option<usize>,
    /// Place in the parent segment's axes, from the parent joint (m).
    pub offset_m: Vector3<f64>,
    /// In which order it turns about its axes; `None`: by a rotation vector.
    pub order: Option<[usize; 3]>,
    /// Which components of the turn may differ from 0.
    pub free: [bool; 3],
    /// Least and largest value of each component (rad).
    pub limits_rad: [[f64; 2]; 3],
    /// How far each component usually is from rest (rad, standard deviation).
    pub rest_sd_rad: [f64; 3],
}

/// A marker glued to a segment.
#[derive(Clone, Debug)]
pub struct Marker {
    /// The joint whose segment carries it.
    pub joint: usize,
    /// Place in the segment's axes, from the joint (m).
    pub place_m: Vector3<f64>,
    /// Noise and soft tissue together, per axis (m, standard deviation).
    pub sigma_m: f64,
}

/// A skeleton that wears markers.
#[derive(Clone, Debug)]
pub struct Figure {
    /// Parents before children.
    pub joints: Vec<Joint>,
    /// In the order of the columns of a take.
    pub markers: Vec<Marker>,
}

/// Where the root is and how every joint is turned.
#[derive(Clone, Debug)]
pub struct Pose {
    /// Place of the root joint (m, world).
    pub root_m: Vector3<f64>,
    /// Turn of the root segment.
    pub root: Rotation3<f64>,
    /// Turn of every joint against its parent: angles about the three axes, or a rotation vector; that of the root is
    /// not used.
    pub turns: Vec<Vector3<f64>>,
}

impl Figure {
    /// The rest pose with the root in the origin.
    pub fn rest(&self) -> Pose {
        Pose { root_m: Vector3::zeros(), root: Rotation3::identity(), turns: vec![Vector3::zeros(); self.joints.len()] }
    }
}
