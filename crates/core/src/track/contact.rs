//! Markers that met: which of them is which afterwards is decided late.
//!
//! Two markers that come so near that they may be taken for each other part as one way round or as the other. Both are kept:
//! the trajectories go on one way, and for a while after they parted the links of each to the others say in every frame which
//! way fits better (Lee et al. 2000, §5.2). Once that is clear against them, the two identities change places. Links that are
//! not rigid count by as much as they vary.

use super::body::links::Link;
use super::crowd::Crowd;
use super::marker::Marker;
use super::rematch::surprise;
use nalgebra::Vector3;

/// Markers nearer than this may be taken for each other, and have parted when farther apart than that (m).
const TOUCHING: f64 = 0.015;
const PARTED: f64 = 0.03;
/// Frames within this time say the same (s); evidence that decides (nats); time after which both stay what they are (s).
const ALIKE_S: f64 = 0.05;
const ENOUGH: f64 = 6.0;
const WATCHED_S: f64 = 0.5;
/// Links that are asked, their least spread (m), and what their evidence is worth, as they are not independent.
const LINKS: usize = 6;
const LEAST_SPREAD: f64 = 0.005;
const WORTH: f64 = 0.5;

/// Two identities in doubt.
#[derive(Clone, Debug)]
pub struct Contact {
    /// Their trajectories, ascending.
    tracks: [u32; 2],
    /// For how long they have been seen apart since (s), and the evidence that they are exchanged (nats).
    watched_s: f64,
    evidence: f64,
}

impl Crowd {
    /// Notes who touches whom, and decides about those that have parted.
    pub fn decide_contacts(&mut self) {
        self.note_contacts();
        if self.contacts.is_empty() {
            return;
        }
        let dt_s = self.clock.interval_s();
        let now = self.places(Marker::found_at);
        for mut contact in std::mem::take(&mut self.contacts) {
            let [Some(one), Some(other)] = contact.tracks.map(|t| self.markers.iter().position(|m| m.track == t))
            else {
                continue;
            };
            if let Some(gain) = self.gain_after_contact([one, other], &now) {
                contact.watched_s += dt_s;
                contact.evidence += gain * (dt_s / ALIKE_S).min(1.0);
            }
            if contact.evidence > ENOUGH {
                self.change_places(one, other);
            } else if contact.evidence > -ENOUGH && contact.watched_s < WATCHED_S {
                self.contacts.push(contact);
            }
        }
    }

    fn note_contacts(&mut self) {
        let place = |m: &Marker| m.found_at().filter(|_| m.confirmed && m.hardware.is_none());
        let mut found: Vec<(&Marker, Vector3<f64>)> =
            self.markers.iter().filter_map(|m| Some((m, place(m)?))).collect();
        found.sort_by(|a, b| a.1.x.total_cmp(&b.1.x).then(a.0.track.cmp(&b.0.track)));
        let mut met: Vec<[u32; 2]> = Vec::new();
        for (k, (one, p)) in found.iter().enumerate() {
            for (other, q) in found[k + 1..].iter().take_while(|(_, q)| q.x - p.x < TOUCHING) {
                // Those that are always near are told by their neighbours at once (`exchange.rs`).
                let usual = self.body.links.of(one.slot).iter().find(|l| l.other == other.slot).map(|l| l.mean_m);
                if (q - p).norm() < TOUCHING && usual.is_none_or(|u| u > 2.0 * PARTED) {
                    met.push([one.track.min(other.track), one.track.max(other.track)]);
                }
            }
        }
        for tracks in met {
            self.contacts.retain(|c| c.tracks != tracks);
            self.contacts.push(Contact { tracks, watched_s: 0.0, evidence: 0.0 });
        }
    }

    /// How much better the links fit if the two are exchanged (nats); `None` as long as they are not both seen apart.
    fn gain_after_contact(&self, pair: [usize; 2], now: &[Option<Vector3<f64>>]) -> Option<f64> {
        let [one, other] = pair.map(|i| &self.markers[i]);
        let (p, q) = (one.found_at()?, other.found_at()?);
        if (p - q).norm() < PARTED {
            return None;
        }
        let slots = [one.slot, other.slot];
        let cost = |marker: &Marker, place: &Vector3<f64>| -> f64 {
            let known = |l: &&Link| !l.is_broken() && !slots.contains(&l.other);
            let links = self.body.links.of(marker.slot).iter().filter(known);
            let off =
                |l: &Link| Some(((place - now[l.other]?).norm() - l.mean_m).abs() / l.range_m().max(LEAST_SPREAD));
            links.filter_map(off).take(LINKS).map(|off| surprise(off, 1.0)).sum()
        };
        Some(WORTH * (cost(one, &p) + cost(other, &q) - cost(one, &q) - cost(other, &p)))
    }

    /// The two motions go on under each other's identity.
    fn change_places(&mut self, one: usize, other: usize) {
        let (head, tail) = self.markers.split_at_mut(one.max(other));
        let (a, b) = (&mut head[one.min(other)], &mut tail[0]);
        std::mem::swap(&mut a.track, &mut b.track);
        std::mem::swap(&mut a.slot, &mut b.slot);
    }
}
