//! A part that turns so sharply that its markers are where its others were expected.
//!
//! The predictions of a part's markers are off alike then, by as much as the markers are apart or more, and the nearest
//! point is another marker's. What the part does not lose is its shape: of all ways to hand out the points among markers
//! that may be concerned, the one is taken in which the vectors between them go on best, and the links hold (Lee et al.
//! 2000, §5.2). How the part moved as a whole does not count.

use super::body::links::Link;
use super::crowd::Crowd;
use super::locate::Located;
use super::rematch::surprise;
use nalgebra::Vector3;

/// Markers may be concerned that are nearer to a marker than it is off its prediction times this.
const REACH: f64 = 3.0;
/// Fewer are no shape; of more the best linked.
const LEAST: usize = 3;
const MOST: usize = 4;
/// Evidence needed to hand out anew (nats).
const ENOUGH: f64 = 12.0;
/// Turning of a vector from one frame to the next that is nothing special, as a part of its length.
const USUAL_TURN: f64 = 0.1;
/// Least spread of a link (m).
const LEAST_SPREAD: f64 = 0.001;

/// A marker of a part: where it was, and where it was found.
struct Member {
    index: usize,
    last: Vector3<f64>,
    found: Vector3<f64>,
}

impl Crowd {
    /// Hands out the points of parts that turned sharply as their shape says.
    pub fn regroup(&mut self) {
        let at = self.by_slot();
        let mut asked = vec![false; self.markers.len()];
        for one in 0..self.markers.len() {
            if asked[one] {
                continue;
            }
            let part = self.part_about(one, &at);
            if part.len() < LEAST {
                continue;
            }
            part.iter().for_each(|m| asked[m.index] = true);
            let Some(owners) = self.owners_by_shape(&part) else { continue };
            let mut points: Vec<Option<Located>> = part.iter().map(|m| self.markers[m.index].located.take()).collect();
            for (member, from) in part.iter().zip(owners) {
                let found = points[from].take();
                if member.index == part[from].index {
                    self.markers[member.index].located = found;
                } else {
                    self.markers[member.index].take_over(found);
                }
            }
        }
    }

    /// A marker that is off its prediction, and those linked to it best for which it may have been taken.
    fn part_about(&self, one: usize, at: &[Option<usize>]) -> Vec<Member> {
        let Some(first) = self.member(one) else { return Vec::new() };
        let reach = REACH * (first.found - self.markers[one].prior.point).norm();
        let near = |l: &&Link| l.mean_m < reach && !l.is_broken();
        let links = self.body.links.of(self.markers[one].slot).iter().filter(near);
        let others = links.filter_map(|l| self.member(at[l.other]?)).take(MOST - 1);
        std::iter::once(first).chain(others).collect()
    }

    fn member(&self, index: usize) -> Option<Member> {
        let marker = &self.markers[index];
        let may_be_taken = marker.confirmed && marker.is_live() && marker.is_measured() && marker.hardware.is_none();
        let found = marker.found_at().filter(|_| may_be_taken)?;
        Some(Member { index, last: marker.last_point(), found })
    }

    /// For each member of a part, whose point it should have; `None` where all should keep theirs.
    fn owners_by_shape(&self, part: &[Member]) -> Option<Vec<usize>> {
        let link = |a: &Member, b: &Member| {
            let [a, b] = [a, b].map(|m| self.markers[m.index].slot);
            self.body.links.of(a).iter().find(|l| l.other == b && !l.is_broken())
        };
        let n = part.len();
        let pairs: Vec<Bond> = (0..n)
            .flat_map(|a| (a + 1..n).map(move |b| [a, b]))
            .map(|[a, b]| Bond { between: [a, b], before: part[b].last - part[a].last, link: link(&part[a], &part[b]) })
            .collect();
        let cost = |owners: &[usize]| -> f64 {
            pairs
                .iter()
                .map(|bond| bond.cost(part[owners[bond.between[1]]].found - part[owners[bond.between[0]]].found))
                .sum()
        };
        let as_it_is: Vec<usize> = (0..n).collect();
        let best = orders(n).into_iter().min_by(|a, b| cost(a).total_cmp(&cost(b)))?;
        (cost(&as_it_is) - cost(&best) > ENOUGH).then_some(best)
    }
}

/// Two members of a part: the vector between them in the frame before (m), and their link.
struct Bond<'a> {
    between: [usize; 2],
    before: Vector3<f64>,
    link: Option<&'a Link>,
}

impl Bond<'_> {
    /// What it costs that this is the vector between them now (nats).
    fn cost(&self, now: Vector3<f64>) -> f64 {
        let turned = surprise((now - self.before).norm(), USUAL_TURN * self.before.norm());
        let held = |l: &Link| surprise((now.norm() - l.mean_m).abs(), l.range_m().max(LEAST_SPREAD));
        turned + self.link.map_or(0.0, held)
    }
}

/// All orders of the first numbers.
fn orders(n: usize) -> Vec<Vec<usize>> {
    let longer = |(order, k): (Vec<usize>, usize)| {
        (0..=order.len())
            .map(move |at| {
                let mut longer = order.clone();
                longer.insert(at, k);
                longer
            })
            .collect::<Vec<_>>()
    };
    (0..n).fold(vec![Vec::new()], |orders, k| orders.into_iter().flat_map(|order| longer((order, k))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::track::TrackOptions;
    use crate::track::clock::Moment;
    use crate::track::points::{MeasuredPoint, PointTracker};

    const RATE_HZ: f64 = 30.0;
    const FRAMES: usize = 120;
    /// Speed (m/s) and how sharply it turns (m/s²).
    const SPEED: f64 = 2.5;
    const TURN: f64 = 60.0;

    /// How far a foot is that stands for a second and then goes forth and back every 0.8 s (m).
    fn along() -> Vec<f64> {
        let speed = |t: f64| (TURN * (((t - 0.8).rem_euclid(0.8) - 0.4).abs() - 0.2)).clamp(-SPEED, SPEED);
        let step_s = 1.0 / RATE_HZ / 32.0;
        let way = |f: usize| -> f64 {
            (0..32 * f).map(|k| k as f64 * step_s).filter(|t| *t > 1.0).map(|t| speed(t) * step_s).sum()
        };
        (0..FRAMES).map(way).collect()
    }

    /// The trajectory of each point in each frame: those of the foot first, then others that stand.
    fn followed(foot: [[f64; 3]; 3]) -> Vec<Vec<u32>> {
        let others = [[0.0, 0.15, 0.5], [0.2, 0.15, 0.5], [0.0, -0.15, 0.5], [0.3, -0.25, 0.9]];
        let mut tracker = PointTracker::new(RATE_HZ, TrackOptions::default()).unwrap();
        let frame = |along: f64| {
            let foot = foot.map(|p| Vector3::from(p) + Vector3::new(along, 0.0, 0.1));
            let places = foot.into_iter().chain(others.map(Vector3::from));
            let points: Vec<MeasuredPoint> = places.map(|point| MeasuredPoint { point, sigma_m: 0.0003 }).collect();
            let tracked = tracker.push(&points, Moment::default()).unwrap();
            let of = |p: usize| tracked.samples.iter().find(|s| s.dots == [p as u32]).map_or(u32::MAX, |s| s.track);
            (0..points.len()).map(of).collect()
        };
        along().into_iter().map(frame).collect()
    }

    #[test]
    fn a_foot_that_moves_farther_in_a_frame_than_its_markers_are_apart_keeps_its_trajectories() {
        let fastest = along().windows(2).map(|w| (w[1] - w[0]).abs()).fold(0.0, f64::max);
        assert!(fastest > 0.08, "{fastest}");
        for foot in [
            [[0.0, 0.0, 0.0], [0.06, 0.0, 0.01], [0.02, 0.04, 0.0]],
            [[0.0, 0.0, 0.0], [0.05, 0.02, 0.0], [0.01, 0.045, 0.015]],
            [[0.0, 0.0, 0.0], [0.065, 0.01, 0.005], [0.025, 0.045, 0.0]],
        ] {
            let followed = followed(foot);
            for (f, tracks) in followed.iter().enumerate().skip(10) {
                assert_eq!(*tracks, followed[10], "frame {f} of {foot:?}");
            }
        }
    }

    #[test]
    fn every_order_is_tried_once() {
        let mut all = orders(4);
        all.sort();
        all.dedup();
        assert_eq!(all.len(), 24);
        assert!(all.iter().all(|order| (0..4).all(|k| order.contains(&k))));
    }
}
