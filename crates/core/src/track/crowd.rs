//! All markers that are being followed, and what their motion and the dynamic model say about them, however they are
//! measured: by dots (`mod.rs`) or by points of another system (`points.rs`).

use super::body::{Body, Seen};
use super::clock::{Clock, Moment, TimeError};
use super::contact::Contact;
use super::flow::Motion;
use super::frame::Frame;
use super::locate::Located;
use super::marker::Marker;
use super::rematch::rematch;
use super::start::Start;
use super::{Kind, Sample, TrackOptions};
use crate::correspond::Group;
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// Markers that steer a lost one.
const STEERING: usize = 3;

/// The markers.
pub struct Crowd {
    pub options: TrackOptions,
    pub clock: Clock,
    pub markers: Vec<Marker>,
    pub body: Body,
    slots: Vec<bool>,
    next_track: u32,
    /// Frames in which two trajectories, by identity, shared one marker's cameras out between them.
    pub suspected: BTreeMap<(u32, u32), i32>,
    /// Pairs that met and whose identities are in doubt.
    pub contacts: Vec<Contact>,
    /// What was known before the first frame.
    pub start: Option<Start>,
}

impl Crowd {
    /// Nobody yet.
    pub fn new(rate_hz: f64, options: TrackOptions) -> Result<Self, TimeError> {
        let clock = Clock::new(rate_hz)?;
        Ok(Self {
            options,
            clock,
            markers: Vec::new(),
            body: Body::default(),
            slots: Vec::new(),
            next_track: 0,
            suspected: BTreeMap::new(),
            contacts: Vec::new(),
            start: None,
        })
    }

    /// Whether no marker was ever born.
    pub fn is_new(&self) -> bool {
        self.next_track == 0
    }

    /// Moves to the next frame: predictions of all markers; of hidden ones also by their neighbours' predicted places.
    pub fn advance(&mut self, moment: Moment) -> Result<(), TimeError> {
        let step = self.clock.advance(moment)?;
        for marker in &mut self.markers {
            marker.predict(&step, self.clock.time_s);
        }
        let now = self.places(|m| m.is_live().then_some(m.filter.position));
        self.carry(&now);
        Ok(())
    }

    /// Places of confirmed markers by slot.
    pub fn places(&self, place: impl Fn(&Marker) -> Option<Vector3<f64>>) -> Vec<Option<Vector3<f64>>> {
        let mut now = vec![None; self.slots.len()];
        self.markers.iter().filter(|m| m.confirmed).for_each(|m| now[m.slot] = place(m));
        now
    }

    /// Index of each slot's marker, where it is confirmed.
    pub fn by_slot(&self) -> Vec<Option<usize>> {
        let mut at = vec![None; self.slots.len()];
        self.markers.iter().enumerate().filter(|(_, m)| m.confirmed).for_each(|(i, m)| at[m.slot] = Some(i));
        at
    }

    /// Improves the predictions of markers that are not found by the places of those that are.
    pub fn carry_lost(&mut self) {
        let now = self.places(Marker::found_at);
        self.carry(&now);
    }

    fn carry(&mut self, now: &[Option<Vector3<f64>>]) {
        let time_s = self.clock.time_s;
        for marker in &mut self.markers {
            if !marker.is_found() && marker.confirmed && now[marker.slot].is_none() {
                let own = marker.own_prediction();
                let carried = self.body.carry(marker.slot, &own, now, time_s, !marker.is_live());
                marker.carry(&carried);
            }
        }
    }

    /// For each new point, the index of the lost marker that it is, if that costs less than `worst` (nats).
    /// `told`: identities that the points told.
    pub fn owners(&self, groups: &[Group], told: &[Option<u32>], worst: f64) -> Vec<Option<usize>> {
        let now = self.places(Marker::found_at);
        let lost: Vec<usize> =
            (0..self.markers.len()).filter(|&i| self.markers[i].confirmed && !self.markers[i].is_found()).collect();
        let given = rematch(&self.markers, &lost, (groups, told), &self.body.links, &now, worst);
        given.into_iter().map(|owner| owner.map(|l| lost[l])).collect()
    }

    /// Active markers learn who they are. One that tells the identity of a lost one is that one.
    pub fn hear(&mut self, frame: &Frame) {
        let is_heir: Vec<bool> = self
            .markers
            .iter_mut()
            .map(|m| {
                let before = m.hardware;
                m.hear(frame);
                m.hardware.is_some() && m.hardware != before
            })
            .collect();
        for heir in (0..self.markers.len()).filter(|&i| is_heir[i]) {
            let told = self.markers[heir].hardware;
            let same = |(i, m): (usize, &Marker)| i != heir && m.hardware == told;
            let Some(other) = self.markers.iter().enumerate().position(same) else { continue };
            if self.markers[other].is_found() {
                self.markers[heir].hardware = None;
                continue;
            }
            let lost = self.markers[other].clone();
            let slot = self.markers[heir].slot;
            self.markers[heir].inherit(&lost);
            // The lost one is forgotten in the place where the heir was.
            self.markers[other].slot = slot;
            (self.markers[other].hardware, self.markers[other].confirmed) = (None, false);
            self.markers[other].give_up();
        }
    }

    /// Filters take in the measurements; markers count their hits and misses.
    pub fn settle(&mut self) {
        let time_s = self.clock.time_s;
        let velocities = self.places(|m| m.is_live().then_some(m.filter.velocity));
        for marker in &mut self.markers {
            let (body, slot) = (&self.body, marker.slot);
            marker.settle(time_s, || mean_velocity(body, slot, &velocities));
        }
    }

    /// Markers learn which cameras see them; `usual`: the part of all cameras that see a marker usually.
    pub fn watch(&mut self, frame: &Frame, usual: f64) {
        let interval_s = self.clock.interval_s();
        let mut has_dot = vec![false; frame.by_camera.len()];
        for marker in &mut self.markers {
            has_dot.fill(false);
            marker.has_dots_of(frame, &mut has_dot);
            marker.visibility.take_in(&has_dot, usual);
            marker.visibility.predict(interval_s, usual);
        }
    }

    /// A new marker.
    pub fn give_birth(&mut self, found: (Located, Motion), confidence: f64, confirmed: bool) {
        let slot = self.slots.iter().position(|used| !used).unwrap_or(self.slots.len());
        if slot == self.slots.len() {
            self.slots.push(true);
        }
        self.slots[slot] = true;
        self.body.clear(slot);
        self.markers.push(Marker::born((self.next_track, slot), found, confidence, self.clock.time_s, confirmed));
        self.next_track += 1;
    }

    /// What is given out: measured markers, and carried ones that are known well enough and may be `visible` there.
    pub fn samples(&self, visible: impl Fn(&Vector3<f64>) -> bool) -> Vec<Sample> {
        let given = |m: &Marker| {
            let sample = m.sample();
            // Not so for a covariance that rounding has left without a spread.
            let known = sample.covariance.trace().sqrt() <= self.options.largest_sigma_m;
            (sample.kind == Kind::Measured || (m.confirmed && known && visible(&sample.point))).then_some(sample)
        };
        let mut samples: Vec<Sample> = self.markers.iter().filter_map(given).collect();
        samples.sort_by_key(|s| s.track);
        samples
    }

    /// The dynamic model learns; tentative markers that are not seen again go soon, others after a while.
    pub fn learn_and_forget(&mut self) {
        let time_s = self.clock.time_s;
        let seen: Vec<Seen> =
            self.markers.iter().filter(|m| m.confirmed && m.is_measured()).map(Marker::seen).collect();
        self.body.learn(&seen, time_s);
        if let Some(start) = &mut self.start {
            start.recognise(&self.markers, &mut self.body, time_s);
        }
        let memory_s = self.options.memory_s;
        let told = self.markers.iter().filter(|m| m.hardware.is_some()).count();
        let among_active = 2 * told > self.markers.len();
        self.forget(|m| m.is_gone(time_s, memory_s, among_active));
    }

    /// Forgets some of the markers; their slots are free for others.
    pub fn forget(&mut self, which: impl Fn(&Marker) -> bool) {
        for marker in self.markers.iter().filter(|m| which(m)) {
            self.slots[marker.slot] = false;
        }
        let slots = &self.slots;
        self.markers.retain(|m| slots[m.slot]);
    }
}

/// Mean velocity of a marker's best neighbours: how its part of the body moves.
fn mean_velocity(body: &Body, slot: usize, velocities: &[Option<Vector3<f64>>]) -> Option<Vector3<f64>> {
    let best = body.links.best(slot, velocities, STEERING);
    let known: Vec<Vector3<f64>> = best.iter().filter_map(|&n| velocities[n]).collect();
    (!known.is_empty()).then(|| known.iter().sum::<Vector3<f64>>() / known.len() as f64)
}
