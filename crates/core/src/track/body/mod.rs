//! The dynamic model (Lee et al. 2000, §5): what is known about the places of markers relative to each other, learned
//! while capturing, and the place of a hidden marker from it.
//!
//! - `fading`: how long what a prediction was off holds.
//! - [`links`]: the mean and variance of distances, equations 17–18 repaired.
//! - [`moments`]: ridge regression from moments.
//! - [`regression`]: a hidden marker from its most reliable neighbours.
//! - [`spheres`]: the paper's own constructions for a hidden marker with two neighbours or one.
//!
//! Markers are named by slots, small numbers that are used again when a marker is gone for good; so memory is bounded.

mod fading;
pub mod links;
pub(in crate::track) mod moments;
pub mod regression;
pub mod rotation;
pub mod spheres;

use super::filter::fuse;
use links::Links;
use moments::NEIGHBOURS;
use nalgebra::{Matrix3, Vector3};
use regression::Fit;
use std::collections::VecDeque;

/// Times per second at which links are updated and the history is extended: motion of a body holds nothing faster.
const LINKS_HZ: f64 = 50.0;
const HISTORY_HZ: f64 = 20.0;
/// How far back the history reaches (snapshots).
const HISTORY: usize = 400;

/// A body comes into poses beyond those that are known: in this time a hidden marker's variance doubles (s).
const EXPLORES_S: f64 = 1.7;
/// A frame is given up when a neighbour of it has been hidden for so many frames; and so many are fitted anew at most before
/// the next frame comes, so that time stays bounded.
const PATIENCE: usize = 3;
const FITS_PER_FRAME: usize = 2;
/// Frames from which a hidden marker's last motion is known.
const LAST_FRAMES: usize = 4;

/// A measured marker.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// Its slot.
    pub slot: usize,
    /// Position (m).
    pub point: Vector3<f64>,
    /// Covariance of the position (m²).
    pub covariance: Matrix3<f64>,
    /// Whether links may learn from it: measured for some time, not in contact with another marker.
    pub trusted: bool,
}

/// A hidden marker's place from its neighbours.
#[derive(Clone, Copy, Debug)]
pub struct Carried {
    /// Position (m).
    pub point: Vector3<f64>,
    /// Covariance (m²).
    pub covariance: Matrix3<f64>,
}

/// The frame of neighbours that carries a hidden marker.
#[derive(Clone, Debug, Default)]
struct Framing {
    fit: Option<Box<Fit>>,
    /// Frames in a row in which it could not be used.
    idle: usize,
}

/// Positions by slot at one moment.
pub type Snapshot = Vec<Option<Vector3<f64>>>;

/// A moment of a recorded take in which a marker was seen, before or after it was hidden.
#[derive(Clone, Debug)]
pub struct SeenAt {
    /// Time (s).
    pub time_s: f64,
    /// Where all were.
    pub places: Snapshot,
    /// Covariance of its place (m²).
    pub covariance: Matrix3<f64>,
}

/// The dynamic model of everything in the volume.
#[derive(Clone, Debug, Default)]
pub struct Body {
    /// Distances between markers.
    pub links: Links,
    history: Vec<Snapshot>,
    oldest: usize,
    /// Snapshots from before the first frame.
    before: Vec<Snapshot>,
    /// The last frames with their times (s), newest first.
    last: VecDeque<(f64, Snapshot)>,
    /// The last frames in which a hidden marker was seen, newest first.
    lost: Vec<Option<Vec<(f64, Snapshot)>>>,
    fits: Vec<Framing>,
    /// Frames fitted since markers were last learned from.
    fitted: usize,
    next_links_s: f64,
    next_history_s: f64,
}

impl Body {
    /// Forgets everything about a slot.
    pub fn clear(&mut self, slot: usize) {
        self.reserve(slot + 1);
        self.links.clear(slot);
        for snapshot in self.history.iter_mut().chain(&mut self.before) {
            if let Some(place) = snapshot.get_mut(slot) {
                *place = None;
            }
        }
        (self.lost[slot], self.fits[slot]) = (None, Framing::default());
        for (_, snapshot) in self.last.iter_mut().chain(self.lost.iter_mut().flatten().flatten()) {
            if let Some(place) = snapshot.get_mut(slot) {
                *place = None;
            }
        }
        for framing in &mut self.fits {
            if framing.fit.as_ref().is_some_and(|f| f.uses(slot)) {
                *framing = Framing::default();
            }
        }
    }

    fn reserve(&mut self, slots: usize) {
        if self.lost.len() < slots {
            self.lost.resize(slots, None);
            self.fits.resize(slots, Framing::default());
            self.links.reserve(slots);
        }
    }

    /// Where a slot's marker was in the poses from before the first frame (m): as many at every call.
    pub fn know(&mut self, slot: usize, places: impl ExactSizeIterator<Item = Option<Vector3<f64>>>) {
        self.before.resize(places.len(), Snapshot::new());
        for (snapshot, place) in self.before.iter_mut().zip(places) {
            if snapshot.len() <= slot {
                snapshot.resize(slot + 1, None);
            }
            snapshot[slot] = place;
        }
    }

    /// Takes in what was measured in one frame.
    pub fn learn(&mut self, seen: &[Seen], time_s: f64) {
        let slots = seen.iter().map(|s| s.slot + 1).max().unwrap_or(0);
        self.reserve(slots);
        self.fitted = 0;
        if time_s >= self.next_links_s {
            self.next_links_s = time_s + 0.999 / LINKS_HZ;
            self.links.learn(seen);
        }
        let mut now = vec![None; self.lost.len()];
        seen.iter().filter(|s| s.trusted).for_each(|s| now[s.slot] = Some(s.point));
        if time_s >= self.next_history_s {
            self.next_history_s = time_s + 0.999 / HISTORY_HZ;
            self.remember(now.clone());
        }
        for s in seen {
            now[s.slot] = Some(s.point);
            (self.lost[s.slot], self.fits[s.slot]) = (None, Framing::default());
        }
        for (slot, place) in now.iter().enumerate() {
            let was_seen = self.last.front().is_some_and(|(_, s)| s.get(slot).is_some_and(Option::is_some));
            if was_seen && place.is_none() {
                self.lost[slot] = Some(self.last.iter().cloned().collect());
            }
        }
        self.last.push_front((time_s, now));
        self.last.truncate(LAST_FRAMES);
    }

    fn remember(&mut self, snapshot: Snapshot) {
        if self.history.len() < HISTORY {
            self.history.push(snapshot);
        } else {
            self.history[self.oldest] = snapshot;
            self.oldest = (self.oldest + 1) % HISTORY;
        }
    }

    /// Snapshots from the newest to the oldest.
    fn recent(&self) -> impl Iterator<Item = &Snapshot> {
        let (newer, older) = self.history.split_at(self.oldest);
        newer.iter().rev().chain(older.iter().rev()).chain(&self.before)
    }

    /// Where a hidden marker is: its own motion, the frame of its neighbours and the links to them, put together by their
    /// covariances. `now`: the markers whose places are known. `framed`: whether it was hidden before; for a moment its
    /// own motion is enough.
    pub fn carry(
        &mut self,
        slot: usize,
        own: &Carried,
        now: &[Option<Vector3<f64>>],
        time_s: f64,
        framed: bool,
    ) -> Carried {
        self.reserve(slot + 1);
        if framed {
            self.renew_frame(slot, now);
        }
        let framed = self.fits[slot].fit.as_mut().and_then(|f| f.predict(now, time_s));
        let fused = framed.and_then(|c| fuse((&own.point, &own.covariance), (&c.point, &c.covariance)));
        let start = fused.map_or(*own, |(point, covariance)| Carried { point, covariance });
        let pulled = self.links.pull(slot, &start, now).unwrap_or(start);
        let hidden_s = self.lost[slot].as_ref().and_then(|l| l.first()).map_or(0.0, |(at, _)| time_s - at);
        Carried { covariance: pulled.covariance * (1.0 + hidden_s.max(0.0) / EXPLORES_S), ..pulled }
    }

    /// Fits a frame of neighbours that are known where there is none that can be used.
    fn renew_frame(&mut self, slot: usize, now: &[Option<Vector3<f64>>]) {
        let framing = &mut self.fits[slot];
        if framing.fit.as_ref().is_some_and(|f| f.can_use(now)) {
            framing.idle = 0;
            return;
        }
        framing.idle += 1;
        if self.fitted >= FITS_PER_FRAME || (framing.fit.is_some() && framing.idle < PATIENCE) {
            return;
        }
        let neighbours = self.links.frame_of(slot, now, NEIGHBOURS);
        let history: Vec<&Snapshot> = self.recent().collect();
        let lost = self.lost[slot].as_deref().unwrap_or_default();
        let fit = Fit::new(slot, &neighbours, &history, lost, 1.0 / HISTORY_HZ);
        self.fitted += 1;
        self.fits[slot] = Framing { fit: fit.map(Box::new), idle: 0 };
    }
}
