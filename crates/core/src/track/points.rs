//! Trajectories of points that another system has measured, anonymous or broken (Lee et al. 2000, §6.2, starts from
//! such points): the same filter, links and re-matching, with one assignment per frame instead of one per camera.

use super::clock::{Moment, TimeError};
use super::crowd::Crowd;
use super::flow::Motion;
use super::locate::Located;
use super::marker::Marker;
use super::matching::Prior;
use super::rematch::WORST_OF_POINTS;
use super::start::Start;
use super::{TrackOptions, Tracked};
use crate::assignment::assign;
use crate::chi2;
use crate::correspond::Group;
use nalgebra::{Matrix3, Vector3};

/// Odds that a marker is measured, and density of points that belong to nothing known (m⁻³).
const LN_MEASURED: f64 = 3.0;
const UNKNOWN_PER_M3: f64 = 0.1;
/// Probability with which a marker's own point is not looked at.
const MISSED: f64 = 1e-4;
/// How rarely a marker that moves stays where it was (nats).
const STAYED: f64 = 3.0;
/// How surely a point is a marker.
const CONFIDENCE: f64 = 0.9;

/// A measured point.
#[derive(Clone, Copy, Debug)]
pub struct MeasuredPoint {
    /// Position (m).
    pub point: Vector3<f64>,
    /// Standard deviation per axis (m).
    pub sigma_m: f64,
}

impl MeasuredPoint {
    fn covariance(&self) -> Matrix3<f64> {
        Matrix3::identity() * self.sigma_m.powi(2)
    }
}

/// Follows markers through frames of points.
pub struct PointTracker {
    crowd: Crowd,
    gate: f64,
}

impl PointTracker {
    /// A tracker for a frame rate.
    pub fn new(rate_hz: f64, options: TrackOptions) -> Result<Self, TimeError> {
        Ok(Self { crowd: Crowd::new(rate_hz, options)?, gate: chi2::quantile(MISSED, 3.0) })
    }

    /// The same tracker, for markers whose places to each other are known before the first frame.
    #[must_use]
    pub fn starting_from(mut self, start: Option<Start>) -> Self {
        self.crowd.start = start;
        self
    }

    /// Number and time (s) of the last frame.
    pub fn moment(&self) -> (i64, f64) {
        (self.crowd.clock.frame, self.crowd.clock.time_s)
    }

    /// Follows the markers into the next frame; a sample's dot is the index of its point.
    pub fn push(&mut self, points: &[MeasuredPoint], moment: Moment) -> Result<Tracked, TimeError> {
        self.crowd.advance(moment)?;
        let mut free = vec![true; points.len()];
        self.assign(points, &mut free, |m| m.confirmed && m.is_live());
        self.crowd.carry_lost();
        self.assign(points, &mut free, |m| m.confirmed && !m.is_found());
        self.assign(points, &mut free, |m| !m.confirmed);
        self.rematch(points, &mut free);
        self.crowd.regroup();
        self.crowd.exchange();
        self.crowd.settle();
        self.crowd.decide_contacts();
        for (index, point) in points.iter().enumerate().filter(|(i, _)| free[*i]) {
            if let Some(found) = Located::measured(index as u32, point.point, &point.covariance()) {
                self.crowd.give_birth((found, Motion::unknown()), CONFIDENCE, false);
            }
        }
        let samples = self.crowd.samples(|_| true);
        self.crowd.learn_and_forget();
        Ok(Tracked { samples, searched_dots: free.iter().filter(|f| **f).count(), overfull: false, certified: true })
    }

    /// Assigns free points to some of the markers.
    fn assign(&mut self, points: &[MeasuredPoint], free: &mut [bool], which: impl Fn(&Marker) -> bool) {
        let asked: Vec<usize> = (0..self.crowd.markers.len()).filter(|&i| which(&self.crowd.markers[i])).collect();
        let left: Vec<usize> = (0..points.len()).filter(|&p| free[p]).collect();
        let gain = |m: usize, p: usize| self.gain(&self.crowd.markers[asked[m]], &points[left[p]]);
        let chosen = assign(asked.len(), left.len(), |m, p| gain(m, p).map(|g| -g));
        for (m, p) in chosen.into_iter().enumerate().filter_map(|(m, p)| p.map(|p| (asked[m], left[p]))) {
            self.crowd.markers[m].located = Located::measured(p as u32, points[p].point, &points[p].covariance());
            free[p] = false;
        }
    }

    /// What it gains to believe that a point is a marker's (nats); `None` where that is out of the question. A point that
    /// jumped to and fro is where it was rather than where its last jump leads: both are tried.
    fn gain(&self, marker: &Marker, point: &MeasuredPoint) -> Option<f64> {
        let moved = self.gain_at(&marker.prior, &marker.prior.point, point);
        if !marker.is_live() {
            return moved;
        }
        let stayed = self.gain_at(&marker.prior, &marker.last_point(), point).map(|g| g - STAYED);
        moved.into_iter().chain(stayed).max_by(f64::total_cmp).filter(|g| *g > 0.0)
    }

    fn gain_at(&self, prior: &Prior, expected: &Vector3<f64>, point: &MeasuredPoint) -> Option<f64> {
        let off = point.point - expected;
        let noise = point.covariance();
        if off.norm_squared() > self.gate * (prior.wide() + noise).trace() {
            return None;
        }
        let gain =
            prior.ln_likelihood(&noise, &off, self.gate)? + prior.ln_rarity() + LN_MEASURED - UNKNOWN_PER_M3.ln();
        (gain > 0.0).then_some(gain)
    }

    /// Gives points that are left to lost markers, wherever these were expected.
    fn rematch(&mut self, points: &[MeasuredPoint], free: &mut [bool]) {
        let left: Vec<usize> = (0..points.len()).filter(|&p| free[p]).collect();
        let group = |&p: &usize| Group {
            dots: vec![p],
            point: points[p].point,
            covariance: points[p].covariance(),
            confidence: CONFIDENCE,
            residual_px: 0.0,
            ray_distance_m: 0.0,
        };
        let groups: Vec<Group> = left.iter().map(group).collect();
        for (owner, p) in self.crowd.owners(&groups, &vec![None; groups.len()], WORST_OF_POINTS).into_iter().zip(left) {
            let found = Located::measured(p as u32, points[p].point, &points[p].covariance());
            if let (Some(owner), Some(found)) = (owner, found) {
                self.crowd.markers[owner].refind(found);
                free[p] = false;
            }
        }
    }
}
