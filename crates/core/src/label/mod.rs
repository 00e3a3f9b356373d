//! Names for anonymous points: who is who among the markers of known subjects.
//!
//! A subject is known by the distances between its markers, their means and spreads, and by the signed heights of
//! markers over triangles of others (`learn.rs`), which a mirror image has with the wrong sign. Every term is a
//! logarithm of a likelihood ratio against a point that stands anywhere, with heavy tails and a floor (`model.rs`).
//!
//! - `search.rs`: one frame without any history: rigid triangles grown into islands, islands joined.
//! - `evidence.rs`: what speaks for every marker at every point, given where the others are; the best assignment.
//! - `live.rs`: frame by frame; a trajectory keeps its name while the evidence of its recent frames allows it.
//! - `take.rs`: a whole take: evidence of both directions of time along every trajectory.
//!
//! Sources: distance graphs with tolerance after Meyer et al. 2014 ("Online marker labeling for fully automatic skeleton
//! tracking in optical motion capture"); the islands and the evidence are ours. Units: metres, seconds.

pub mod evidence;
pub mod learn;
pub mod live;
pub mod model;
pub mod search;
pub mod take;
