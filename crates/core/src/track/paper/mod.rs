//! The seed paper's whole system as written (Lee, Chu, Kim & Jung 2000), to be compared with.
//!
//! A frame: predictions are projected into the cameras of each marker's last clique, and where a dot lies at every one of
//! them the clique is confirmed (§3, equations 7 and 8); the other dots go through the relaxation labelling (§2,
//! `correspond/relaxation.rs`); the points are matched to the predictions (`trajectories.rs`). There is no second look at
//! the whole take, no confirmation of births, and no uncertainty but the filter's.

mod kalman;
mod links;
mod trajectories;

pub use trajectories::PaperOptions;

use super::clock::{Moment, TimeError};
use super::frame::Frame;
use super::points::MeasuredPoint;
use super::{Kind, Sample, TrackError, Tracked};
use crate::camera::Rig;
use crate::correspond::frame::{Dot, PreparedFrame};
use crate::correspond::relaxation::{RelaxationOptions, relaxation};
use crate::correspond::scene::{Scene, SceneModel};
use crate::correspond::{Group, group_from_dots};
use nalgebra::Matrix3;
use std::collections::BTreeMap;
use trajectories::{Trajectories, Trajectory};

/// A dot confirms a prediction within so many standard deviations.
const CONFIRMED: f64 = 3.0;

/// The paper's tracker.
pub struct PaperTracker {
    scene: Scene,
    trajectories: Trajectories,
    /// Cameras of each trajectory's last clique (equation 7).
    cliques: BTreeMap<u32, Vec<usize>>,
}

impl PaperTracker {
    /// A tracker with a known prior (of which the noise and the region are used).
    pub fn new(rig: &Rig, model: &SceneModel, rate_hz: f64, options: PaperOptions) -> Result<Self, TrackError> {
        let trajectories = Trajectories::new(rate_hz, options)?;
        Ok(Self { scene: Scene::new(rig, model), trajectories, cliques: BTreeMap::new() })
    }

    /// Number and time (s) of the last frame.
    pub fn moment(&self) -> (i64, f64) {
        self.trajectories.moment()
    }

    /// What is believed about the take.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Follows the markers into the next frame.
    pub fn push(&mut self, dots: &[Dot], moment: Moment) -> Result<Tracked, TrackError> {
        self.trajectories.advance(moment)?;
        let mut frame = Frame::new(&self.scene, dots);
        let mut groups = self.confirmed_cliques(&mut frame);
        let left: Vec<usize> = (0..dots.len()).filter(|&d| frame.free[d]).collect();
        let rest: Vec<Dot> = left.iter().map(|&d| dots[d]).collect();
        let prepared = PreparedFrame::new(&self.scene, &rest);
        for mut group in relaxation(&self.scene, &prepared, &RelaxationOptions::default()).groups {
            group.dots.iter_mut().for_each(|d| *d = left[*d]);
            groups.push(group);
        }
        let points: Vec<_> = groups.iter().map(|g| g.point).collect();
        self.trajectories.follow(&points);
        self.cliques.clear();
        let mut samples = Vec::with_capacity(self.trajectories.all.len());
        for one in &self.trajectories.all {
            if let Some(group) = one.measured.map(|i| &groups[i]) {
                let cameras = group.dots.iter().map(|&d| dots[d].camera).collect();
                self.cliques.insert(one.track, cameras);
                samples.push(measured(one.track, group));
            } else {
                samples.push(carried(one));
            }
        }
        Ok(Tracked { samples, searched_dots: rest.len(), ..Tracked::default() })
    }

    /// §3: the cliques of the frame before that are found again, whole and without a dot in another camera; what has
    /// changed goes through the relaxation again.
    fn confirmed_cliques(&self, frame: &mut Frame) -> Vec<Group> {
        let mut groups = Vec::new();
        for one in &self.trajectories.all {
            let Some(cameras) = self.cliques.get(&one.track) else { continue };
            let found: Option<Vec<u32>> = cameras.iter().map(|&c| self.nearest(frame, c, one)).collect();
            let Some(found) = found else { continue };
            let others = (0..frame.by_camera.len()).filter(|c| !cameras.contains(c));
            if others.into_iter().any(|c| self.nearest(frame, c, one).is_some()) {
                continue;
            }
            let dots: Vec<Dot> = found.iter().map(|&d| frame.dots[d as usize]).collect();
            let prepared = PreparedFrame::new(&self.scene, &dots);
            let all: Vec<usize> = (0..prepared.len()).collect();
            let group = group_from_dots(&self.scene, &prepared, &all, one.motion.position, None);
            if let Some(mut group) = group.filter(|_| all.len() == dots.len()) {
                group.dots.iter_mut().for_each(|d| *d = found[*d] as usize);
                found.iter().for_each(|&d| frame.free[d as usize] = false);
                groups.push(group);
            }
        }
        groups
    }

    /// Equation 8: the free dot nearest to the projected prediction, if it is near enough.
    fn nearest(&self, frame: &Frame, camera: usize, one: &Trajectory) -> Option<u32> {
        let (pixel, by_point) = self.scene.rig.cameras[camera].project_linear(&one.motion.position)?;
        let spread = by_point.norm_squared() / 2.0 * one.motion.variance();
        let off = |d: u32| (frame.pixel(d) - pixel).norm();
        let free = frame.by_camera[camera].iter().copied().filter(|&d| frame.free[d as usize]);
        let nearest = free.min_by(|&a, &b| off(a).total_cmp(&off(b)).then(a.cmp(&b)))?;
        (off(nearest) < CONFIRMED * (spread + frame.sigma_px(nearest).powi(2)).sqrt()).then_some(nearest)
    }
}

/// The paper's tracking of points that another system has measured (§6.2).
pub struct PaperPointTracker {
    trajectories: Trajectories,
}

impl PaperPointTracker {
    /// A tracker for a frame rate.
    pub fn new(rate_hz: f64, options: PaperOptions) -> Result<Self, TimeError> {
        Ok(Self { trajectories: Trajectories::new(rate_hz, options)? })
    }

    /// Number and time (s) of the last frame.
    pub fn moment(&self) -> (i64, f64) {
        self.trajectories.moment()
    }

    /// Follows the markers into the next frame; a sample's dot is the index of its point.
    pub fn push(&mut self, points: &[MeasuredPoint], moment: Moment) -> Result<Tracked, TimeError> {
        self.trajectories.advance(moment)?;
        let places: Vec<_> = points.iter().map(|p| p.point).collect();
        self.trajectories.follow(&places);
        let sample = |one: &Trajectory| match one.measured {
            Some(i) => {
                let covariance = Matrix3::identity() * points[i].sigma_m.powi(2);
                Sample::new(one.track, (places[i], covariance), Kind::Measured, &[i as u32], 1.0)
            }
            None => carried(one),
        };
        Ok(Tracked { samples: self.trajectories.all.iter().map(sample).collect(), ..Tracked::default() })
    }
}

fn measured(track: u32, group: &Group) -> Sample {
    let mut dots: Vec<u32> = group.dots.iter().map(|&d| d as u32).collect();
    dots.sort_unstable();
    let sample = Sample::new(track, (group.point, group.covariance), Kind::Measured, &dots, group.confidence);
    Sample { residual_px: group.residual_px, ray_distance_m: group.ray_distance_m, ..sample }
}

fn carried(one: &Trajectory) -> Sample {
    let covariance = Matrix3::identity() * one.motion.variance();
    Sample::new(one.track, (one.motion.position, covariance), Kind::Predicted, &[], 0.5)
}
