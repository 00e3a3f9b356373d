//! Calibration: a rig from a wand wave, from known points, from a take's own markers; and what it is worth.
//!
//! The way of a wand wave: [`identify`] finds the wand in single views, [`bootstrap`] makes a first rig from nothing
//! (two views, then resections), [`bundle`] adjusts cameras and wand poses together, [`wave`] is the whole chain.
//! World frame of a rig that nothing else defines: see [`bootstrap`].

pub mod board;
pub mod bootstrap;
pub mod bundle;
pub mod epipolar;
pub mod gather;
pub mod identify;
pub mod points;
pub mod pose;
pub mod refine;
pub mod resection;
pub mod shape;
pub mod still;
pub mod wand;
pub mod watch;
pub mod wave;
