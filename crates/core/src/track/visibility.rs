//! Which cameras see a marker: what hides it now hides it in the next frame, too.
//!
//! For each camera a hidden Markov model of two states, in sight or hidden (Rabiner 1989, §II, the forward recursion).
//! A detector misses a marker in sight now and then; a hidden one's dot is another's.

/// How often a marker comes into a camera's sight or goes out of it (1/s).
const CHANGES_PER_S: f64 = 3.0;
/// How often a marker in sight has a dot, and how rarely a hidden one is given one.
const DETECTED: f64 = 0.95;
const MISTAKEN: f64 = 0.02;
/// Bounds of the part of its time that a marker is in sight.
const IN_SIGHT: [f64; 2] = [0.05, 0.98];

/// By camera, the probability that a marker is in sight.
#[derive(Clone, Debug, Default)]
pub struct Visibility(Vec<f64>);

impl Visibility {
    /// Probability that a camera sees the marker; `None` where nothing is known of it.
    pub fn of(&self, camera: usize) -> Option<f64> {
        self.0.get(camera).copied()
    }

    /// Goes on by some time (s), with the part of all cameras that see a marker usually.
    pub fn predict(&mut self, interval_s: f64, usual: f64) {
        let in_sight = (usual / DETECTED).clamp(IN_SIGHT[0], IN_SIGHT[1]);
        let kept = (-CHANGES_PER_S * interval_s).exp();
        self.0.iter_mut().for_each(|p| *p = in_sight + kept * (*p - in_sight));
    }

    /// Takes in, by camera, whether it has a dot of the marker.
    pub fn take_in(&mut self, has_dot: &[bool], usual: f64) {
        self.0.resize(has_dot.len(), (usual / DETECTED).clamp(IN_SIGHT[0], IN_SIGHT[1]));
        for (p, has_dot) in self.0.iter_mut().zip(has_dot) {
            let [seen, hidden] = if *has_dot { [DETECTED, MISTAKEN] } else { [1.0 - DETECTED, 1.0 - MISTAKEN] };
            *p = *p * seen / (*p * seen + (1.0 - *p) * hidden);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after(frames: usize, interval_s: f64, has_dot: impl Fn(usize, usize) -> bool) -> Visibility {
        let mut visibility = Visibility::default();
        for frame in 0..frames {
            visibility.take_in(&[has_dot(frame, 0), has_dot(frame, 1)], 0.6);
            visibility.predict(interval_s, 0.6);
        }
        visibility
    }

    #[test]
    fn a_camera_that_saw_the_marker_still_does_and_one_that_did_not_does_not() {
        let visibility = after(20, 0.01, |_, camera| camera == 0);
        assert!(visibility.of(0).is_some_and(|p| p > 0.95));
        assert!(visibility.of(1).is_some_and(|p| p < 0.05));
        assert_eq!(visibility.of(2), None);
    }

    #[test]
    fn one_missed_dot_is_not_hidden_yet_but_two_are() {
        let missed = |last: usize| after(20, 0.01, move |frame, _| frame < 20 - last);
        assert!(missed(1).of(0).is_some_and(|p| p > 0.5));
        assert!(missed(2).of(0).is_some_and(|p| p < 0.3));
    }

    #[test]
    fn after_some_seconds_nothing_is_known_any_more() {
        let mut visibility = after(20, 0.01, |_, camera| camera == 0);
        visibility.predict(3.0, 0.6);
        let usual = 0.6 / DETECTED;
        assert!((0..2).all(|camera| visibility.of(camera).is_some_and(|p| (p - usual).abs() < 1e-3)));
    }
}
