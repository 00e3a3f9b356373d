//! Uniform cubic B-splines over frames.

/// Knots `spacing` frames apart, the first in frame 0.
#[derive(Clone, Copy, Debug)]
pub struct Spline {
    /// Frames from knot to knot.
    pub spacing: usize,
    /// How many controls there are.
    pub controls: usize,
}

impl Spline {
    /// A spline over `frames` frames.
    pub fn over(frames: usize, spacing: usize) -> Self {
        Self { spacing, controls: frames.saturating_sub(1) / spacing + 4 }
    }

    /// The first of the four controls that a frame depends on, and their weights (de Boor 1978).
    pub fn weights(&self, frame: usize) -> (usize, [f64; 4]) {
        let first = frame / self.spacing;
        let t = (frame % self.spacing) as f64 / self.spacing as f64;
        let r = 1.0 - t;
        let (t2, t3) = (t * t, t * t * t);
        (first, [r * r * r, 3.0 * t3 - 6.0 * t2 + 4.0, 3.0 * (t + t2 - t3) + 1.0, t3].map(|w| w / 6.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_add_up_and_reach_every_frame() {
        let spline = Spline::over(50, 8);
        for frame in 0..50 {
            let (first, weights) = spline.weights(frame);
            assert!(first + 4 <= spline.controls);
            assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-15);
            // A straight line of controls is a straight line of frames.
            let line: f64 = weights.iter().enumerate().map(|(k, w)| w * (first + k) as f64).sum();
            assert!((line - 1.0 - frame as f64 / 8.0).abs() < 1e-12);
        }
    }
}
