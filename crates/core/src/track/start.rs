//! A start pose: what is known of the markers' places to each other before the first frame (Lee et al. 2000, §5.1, take
//! their links from one).
//!
//! The markers that are followed are recognised by their distances (`label/`): then their links are those of the start
//! pose, and its poses are as good as a history of their own. Who is not recognised is followed as without it.

use super::body::Body;
use super::marker::Marker;
use crate::label::learn::Named;
use crate::label::live::Labeller;
use crate::label::model::{Length, Model};
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// Time between two looks (s).
const LOOKS_S: f64 = 0.04;
/// A marker is recognised when two looks in a row say the same, each as surely as this.
const SURE: f64 = 0.99;

/// Observations of a link that one pose is worth: too few to lean on; and that a pair is worth that is taken for rigid.
const POSE_WORTH: f64 = 20.0;
const RIGID_WORTH: f64 = 100.0;
/// A pair trusted more than this is taken for rigid.
const RIGID: f64 = 0.99;
/// Poses from which others can be foretold.
const ENOUGH_POSES: f64 = 2.0;

/// What is known before the first frame.
pub struct Start {
    model: Model,
    /// Observations that its distances are worth.
    worth: f64,
    labeller: Labeller,
    /// Places of the model's markers (m), in each pose.
    poses: Vec<Named>,
    /// The marker of each trajectory that was recognised, and of each that the last look was sure of.
    known: BTreeMap<u32, usize>,
    likely: BTreeMap<u32, usize>,
    next_s: f64,
}

impl Start {
    /// Markers of a `model` that was learned from so many independent poses, seen in `poses` before (none: only their
    /// distances are known).
    pub fn new(model: Model, independent: f64, poses: Vec<Named>) -> Self {
        let worth = POSE_WORTH * independent;
        let poses = if independent < ENOUGH_POSES { Vec::new() } else { poses };
        let labeller = Labeller::new(model.clone());
        let (known, likely) = (BTreeMap::new(), BTreeMap::new());
        Self { model, worth, labeller, poses, known, likely, next_s: f64::NEG_INFINITY }
    }

    /// Looks at the markers, from time to time and as long as one of the model's is not recognised; what is known of
    /// those that are new goes into the dynamic model.
    pub fn recognise(&mut self, markers: &[Marker], body: &mut Body, time_s: f64) {
        self.known.retain(|track, _| markers.iter().any(|m| m.track == *track));
        if time_s < self.next_s || self.known.len() == self.model.len() {
            return;
        }
        self.next_s = time_s + LOOKS_S;
        let seen: Vec<&Marker> = markers.iter().filter(|m| m.confirmed && m.is_measured()).collect();
        let tracks: Vec<i64> = seen.iter().map(|m| i64::from(m.track)).collect();
        let points: Vec<Vector3<f64>> = seen.iter().map(|m| m.last_point()).collect();
        let names = self.labeller.push(time_s, &tracks, &points);
        let mut likely = BTreeMap::new();
        for (marker, name) in seen.iter().zip(names) {
            let Some(who) = name.marker.filter(|_| name.probability > SURE) else { continue };
            likely.insert(marker.track, who);
            let is_new = !self.known.contains_key(&marker.track) && self.known.values().all(|k| *k != who);
            if is_new && self.likely.get(&marker.track) == Some(&who) {
                self.known.insert(marker.track, who);
                self.tell(markers, (marker.slot, who), body);
            }
        }
        self.likely = likely;
    }

    /// The links of a marker to those that are recognised already, and its places in the poses.
    fn tell(&self, markers: &[Marker], (slot, who): (usize, usize), body: &mut Body) {
        for (track, &other) in &self.known {
            let Some(there) = markers.iter().find(|m| m.track == *track && m.slot != slot) else { continue };
            let tells = |l: &Length| l.trust > RIGID || !self.poses.is_empty();
            if let Some(length) = self.model.distance(who, other).filter(tells) {
                let worth = if length.trust <= RIGID { self.worth } else { self.worth.max(RIGID_WORTH) };
                body.links.know(slot, there.slot, length, worth);
                body.links.know(there.slot, slot, length, worth);
            }
        }
        body.know(slot, self.poses.iter().map(|pose| pose[who]));
    }
}
