//! Links as printed (Lee et al. 2000, §5.1, equations 17 and 18): every pair of markers is linked when the second of them
//! appears; a link whose distance or variance leaves its bounds is cut for good. Nothing is forgotten, no noise is taken
//! out, and estimated places of hidden markers count like measured ones. Of equation 18, whose two sides contradict each
//! other, the right one is used, the variance.

use std::collections::BTreeMap;

/// Distance of a pair over the frames so far.
#[derive(Clone, Copy, Debug, Default)]
pub struct Link {
    frames: f64,
    /// E_n (m).
    pub mean_m: f64,
    sum_of_squares: f64,
}

impl Link {
    /// V_n (m²).
    pub fn variance(&self) -> f64 {
        (self.sum_of_squares / self.frames - self.mean_m * self.mean_m).max(0.0) // eq 18
    }

    fn learn(&mut self, distance_m: f64) {
        let n = self.frames + 1.0;
        self.mean_m = (self.mean_m * self.frames + distance_m) / n; // eq 17
        self.sum_of_squares += distance_m * distance_m;
        self.frames = n;
    }
}

/// Links that still hold, by the identities of their two markers, the smaller first.
#[derive(Clone, Debug, Default)]
pub struct Links {
    held: BTreeMap<(u32, u32), Link>,
}

impl Links {
    /// Links two markers.
    pub fn connect(&mut self, a: u32, b: u32) {
        self.held.insert((a.min(b), a.max(b)), Link::default());
    }

    /// Takes in the distances of one frame; cuts links whose distance is off its mean by more than `change_m`, or whose
    /// spread exceeds `spread_m`.
    pub fn learn(&mut self, distance: impl Fn(u32, u32) -> Option<f64>, change_m: f64, spread_m: f64) {
        self.held.retain(|&(a, b), link| {
            let Some(distance_m) = distance(a, b) else { return true };
            link.learn(distance_m);
            (distance_m - link.mean_m).abs() <= change_m && link.variance() <= spread_m * spread_m
        });
    }

    /// Forgets the links of a marker.
    pub fn clear(&mut self, track: u32) {
        self.held.retain(|&(a, b), _| a != track && b != track);
    }

    /// The links of a marker with the markers at their other ends: the longest held first, of these the most constant.
    pub fn of(&self, track: u32) -> Vec<(u32, Link)> {
        let other = |&(a, b): &(u32, u32)| (a == track).then_some(b).or((b == track).then_some(a));
        let mut own: Vec<(u32, Link)> = self.held.iter().filter_map(|(pair, l)| other(pair).map(|o| (o, *l))).collect();
        own.retain(|(_, l)| l.frames > 0.0);
        own.sort_by(|(i, a), (j, b)| {
            b.frames.total_cmp(&a.frames).then(a.variance().total_cmp(&b.variance())).then(i.cmp(j))
        });
        own
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mean_and_variance_are_those_of_the_distances_and_a_jump_cuts_for_good() {
        let mut links = Links::default();
        links.connect(4, 2);
        for distance_m in [0.30, 0.302, 0.298, 0.304] {
            links.learn(|_, _| Some(distance_m), 0.03, 0.015);
        }
        let (other, link) = links.of(4)[0];
        assert_eq!(other, 2);
        assert!((link.mean_m - 0.301).abs() < 1e-12);
        assert!((link.variance() - 5e-6).abs() < 1e-12);
        links.learn(|_, _| Some(0.36), 0.03, 0.015);
        links.learn(|_, _| Some(0.30), 0.03, 0.015);
        assert!(links.of(4).is_empty());
    }
}
