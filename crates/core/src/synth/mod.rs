//! Simulation with truth: rigs, moving markers, and what the cameras would see of them, all from one seed.
//!
//! - [`rigs`]: rings, arcs, walls.
//! - [`body`]: a walking and a dancing figure whose trunk and limbs hide markers.
//! - [`observe`]: noise, drop-outs, merging, clutter, fixed reflections.

pub mod body;
pub mod observe;
pub mod random;
pub mod rigs;

use nalgebra::Vector3;
use random::Random;

/// Markers uniformly in a box about `center`, new ones in every frame.
pub fn cloud(
    seed: u64,
    frame: usize,
    markers: usize,
    size_m: &Vector3<f64>,
    center_m: &Vector3<f64>,
) -> Vec<Vector3<f64>> {
    let mut random = Random::new(seed, 2 * frame as u64);
    (0..markers).map(|_| random.in_box(size_m) + center_m).collect()
}
