//! The paper's tracking of 3D points (Lee et al. 2000, §4.2 and §5.2): greedy matching by distance, global re-matching of
//! what is left by the rigid links, and places of hidden markers from the spheres around their linked neighbours.

use super::super::body::spheres::{one_sphere, two_spheres};
use super::super::clock::{Clock, Moment, TimeError};
use super::kalman::Kalman;
use super::links::{Link, Links};
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// The paper's thresholds. It states none of their values.
#[derive(Clone, Copy, Debug)]
pub struct PaperOptions {
    /// "Maximum speed" of §4.2: a point farther from a prediction is not matched to it (m/s).
    pub fastest_m_per_s: f64,
    /// threshold₁ of §5.1: a link whose distance is off its mean by more is cut (m).
    pub link_change_m: f64,
    /// threshold₂ of §5.1 as a standard deviation: a link of more spread is cut (m).
    pub link_spread_m: f64,
    /// Longest distance at which two markers are linked at first (m).
    pub longest_link_m: f64,
    /// How long a hidden marker is carried (s): "for a short time".
    pub memory_s: f64,
}

impl Default for PaperOptions {
    fn default() -> Self {
        Self { fastest_m_per_s: 8.0, link_change_m: 0.03, link_spread_m: 0.015, longest_link_m: 0.6, memory_s: 0.5 }
    }
}

/// One followed marker.
#[derive(Clone, Debug)]
pub struct Trajectory {
    /// Its identity.
    pub track: u32,
    /// Its motion; the position is where it is in this frame.
    pub motion: Kalman,
    /// Index of its point in this frame; `None` where it is hidden.
    pub measured: Option<usize>,
    seen_s: f64,
}

/// All followed markers.
pub struct Trajectories {
    options: PaperOptions,
    rate_hz: f64,
    clock: Clock,
    links: Links,
    next_track: u32,
    /// In ascending order of identity.
    pub all: Vec<Trajectory>,
}

impl Trajectories {
    /// Nobody yet.
    pub fn new(rate_hz: f64, options: PaperOptions) -> Result<Self, TimeError> {
        let clock = Clock::new(rate_hz)?;
        Ok(Self { options, rate_hz, clock, links: Links::default(), next_track: 0, all: Vec::new() })
    }

    /// Number and time (s) of the last frame.
    pub fn moment(&self) -> (i64, f64) {
        (self.clock.frame, self.clock.time_s)
    }

    /// Moves to the next frame: predictions.
    pub fn advance(&mut self, moment: Moment) -> Result<(), TimeError> {
        self.clock.advance(moment)?;
        for one in &mut self.all {
            one.motion.predict();
            one.measured = None;
        }
        Ok(())
    }

    /// Matches the points of the frame, carries hidden markers, learns the links.
    pub fn follow(&mut self, points: &[Vector3<f64>]) {
        let mut free = vec![true; points.len()];
        self.match_near(points, &mut free);
        self.match_by_links(points, &mut free);
        for (one, point) in self.all.iter_mut().filter_map(|t| t.measured.map(|i| (t, points[i]))) {
            one.motion.update(&point);
            one.seen_s = self.clock.time_s;
        }
        self.carry_hidden();
        self.forget();
        for (index, point) in points.iter().enumerate().filter(|(i, _)| free[*i]) {
            self.give_birth(index, point);
        }
        self.learn_links();
    }

    /// §4.2: pairs of prediction and point, the nearest first, each taken once.
    fn match_near(&mut self, points: &[Vector3<f64>], free: &mut [bool]) {
        let reach = self.options.fastest_m_per_s / self.rate_hz;
        let mut pairs = Vec::new();
        for (t, one) in self.all.iter().enumerate() {
            let distances = points.iter().map(|p| (p - one.motion.position).norm()).enumerate();
            pairs.extend(distances.filter(|(_, d)| *d < reach).map(|(p, d)| (d, t, p)));
        }
        self.take_best(pairs, free);
    }

    /// §5.2: what is left is matched wherever it is, by how well it fits the links.
    fn match_by_links(&mut self, points: &[Vector3<f64>], free: &mut [bool]) {
        let places = self.visible(points);
        let mut pairs = Vec::new();
        for (t, one) in self.all.iter().enumerate().filter(|(_, one)| one.measured.is_none()) {
            let links: Vec<(Link, Vector3<f64>)> =
                self.links.of(one.track).into_iter().filter_map(|(o, l)| places.get(&o).map(|p| (l, *p))).collect();
            if links.len() < 2 {
                continue;
            }
            for (p, point) in points.iter().enumerate().filter(|(p, _)| free[*p]) {
                let off = |(link, other): &(Link, Vector3<f64>)| ((point - other).norm() - link.mean_m).abs();
                let mean = links.iter().map(off).sum::<f64>() / links.len() as f64;
                if mean < self.options.link_change_m {
                    pairs.push((mean, t, p));
                }
            }
        }
        self.take_best(pairs, free);
    }

    /// Takes pairs (cost, trajectory, point) by ascending cost, neither of them twice.
    fn take_best(&mut self, mut pairs: Vec<(f64, usize, usize)>, free: &mut [bool]) {
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        for (_, t, p) in pairs {
            if free[p] && self.all[t].measured.is_none() {
                self.all[t].measured = Some(p);
                free[p] = false;
            }
        }
    }

    /// Measured places by identity.
    fn visible(&self, points: &[Vector3<f64>]) -> BTreeMap<u32, Vector3<f64>> {
        self.all.iter().filter_map(|t| t.measured.map(|i| (t.track, points[i]))).collect()
    }

    /// §5.2, figures 8 and 9: the spheres around up to two linked markers; the estimate counts as a measurement.
    fn carry_hidden(&mut self) {
        let seen: BTreeMap<u32, Vector3<f64>> =
            self.all.iter().filter(|t| t.measured.is_some()).map(|t| (t.track, t.motion.position)).collect();
        for one in self.all.iter_mut().filter(|t| t.measured.is_none()) {
            let links = self.links.of(one.track);
            let spheres: Vec<_> =
                links.iter().filter_map(|(o, l)| seen.get(o).map(|p| (*p, l.mean_m))).take(2).collect();
            let place = match spheres[..] {
                [first, second] => two_spheres(first, second, &one.motion.position),
                [only] => one_sphere(only, &one.motion.position),
                _ => continue,
            };
            one.motion.update(&place);
        }
    }

    fn forget(&mut self) {
        let (now_s, memory_s, links) = (self.clock.time_s, self.options.memory_s, &mut self.links);
        self.all.retain(|t| {
            let kept = now_s - t.seen_s <= memory_s;
            if !kept {
                links.clear(t.track);
            }
            kept
        });
    }

    fn give_birth(&mut self, index: usize, point: &Vector3<f64>) {
        let track = self.next_track;
        self.next_track += 1;
        for other in &self.all {
            if (other.motion.position - point).norm() < self.options.longest_link_m {
                self.links.connect(track, other.track);
            }
        }
        let motion = Kalman::new(*point, self.rate_hz);
        self.all.push(Trajectory { track, motion, measured: Some(index), seen_s: self.clock.time_s });
    }

    fn learn_links(&mut self) {
        let places: BTreeMap<u32, Vector3<f64>> = self.all.iter().map(|t| (t.track, t.motion.position)).collect();
        let distance = |a: u32, b: u32| Some((places.get(&a)? - places.get(&b)?).norm());
        self.links.learn(distance, self.options.link_change_m, self.options.link_spread_m);
    }
}
