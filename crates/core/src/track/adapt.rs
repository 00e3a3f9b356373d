//! What a tracker believes about its take when nobody told it: estimated from the frames so far, never from later ones.
//!
//! A sample of frames is kept (ever sparser, so that it stays small), and the prior is estimated anew at a few fixed
//! frame counts: early, because the first frame alone says little, then ever more rarely.

use crate::camera::Rig;
use crate::correspond::estimate::{EstimateOptions, estimate};
use crate::correspond::frame::Dot;
use crate::correspond::scene::SceneModel;

/// Numbers of frames with dots after which the prior is estimated.
const ESTIMATED_AFTER: [usize; 4] = [1, 10, 100, 1000];
/// Frames kept at most; when there are more, every second one goes.
const KEPT: usize = 16;

/// Frames kept for the estimation.
#[derive(Clone, Debug)]
pub struct Adaptation {
    options: EstimateOptions,
    sample: Vec<Vec<Dot>>,
    spacing: usize,
    filled: usize,
}

impl Adaptation {
    /// Starts without any frame. `noise`: known noise of the dots.
    pub fn new(noise: Option<f64>) -> Self {
        let options = EstimateOptions { noise, ..EstimateOptions::default() };
        Self { options, sample: Vec::new(), spacing: 1, filled: 0 }
    }

    /// Takes in a frame; a new prior where it is time for one.
    pub fn take_in(&mut self, rig: &Rig, dots: &[Dot]) -> Option<SceneModel> {
        if dots.is_empty() {
            return None;
        }
        if self.filled.is_multiple_of(self.spacing) {
            self.sample.push(dots.to_vec());
        }
        if self.sample.len() > KEPT {
            let mut number = 0;
            self.sample.retain(|_| {
                number += 1;
                number % 2 == 1
            });
            self.spacing *= 2;
        }
        self.filled += 1;
        if !ESTIMATED_AFTER.contains(&self.filled) {
            return None;
        }
        let frames: Vec<&[Dot]> = self.sample.iter().map(Vec::as_slice).collect();
        estimate(rig, &frames, &self.options)
    }
}
