//! markerloom's algorithms: from anonymous image dots of calibrated cameras to ghost-free 3D points.
//!
//! Units and frames everywhere: metres, seconds, radians, `f64`; world right-handed with Z up; pixel (0, 0) is the
//! centre of the top-left pixel. Nothing here reads files, prints, or starts threads it was not given.

pub mod active;
pub mod assignment;
pub mod calibrate;
pub mod camera;
pub mod chi2;
pub mod correspond;
pub mod detect;
pub mod fill;
pub mod label;
pub mod motion;
pub mod reconstruct;
pub mod sight;
pub mod skeleton;
pub mod strands;
pub mod sync;
pub mod synth;
pub mod track;
pub mod triangulate;
