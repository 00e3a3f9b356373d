//! Motions as material: frequency bands of signals, how alike moments are, and motions changed as little as constraints
//! allow.

pub mod alike;
pub mod banded;
pub mod bands;
pub mod goals;
pub mod spacetime;
pub mod spline;
