//! Global re-matching (Lee et al. 2000, §5.2): points that no prediction explains, offered to markers that were lost.
//!
//! The cost of a pair is heavy-tailed in the distance from the expected place (a Gaussian would turn every sharp turn into
//! a new identity), plus how badly the point fits the marker's links to markers that are visible. One assignment over
//! all lost markers and all points.

use super::body::links::Links;
use super::marker::Marker;
use crate::assignment::assign;
use crate::correspond::Group;
use nalgebra::Vector3;

/// A lost marker may be this far from where it is expected (m), beyond four of its standard deviations, at most.
const MARGIN: f64 = 0.06;
const FARTHEST: f64 = 0.15;
/// What a pair may cost at most (nats): points from dots do not jump, points of other systems do now and then. A fitting
/// link brings as much as [`LINK_GAIN`].
pub const WORST: f64 = 8.0;
pub const WORST_OF_POINTS: f64 = 30.0;
const LINK_GAIN: f64 = 0.7;
/// What an identity brings (nats): more than all else.
const CERTAIN: f64 = 1000.0;
/// Largest cost of one link: one broken link does not decide.
const WORST_LINK: f64 = 4.0;
/// Links that are asked.
const LINKS: usize = 6;

/// For each point, the index in `lost` of the marker that it is. A point that tells an identity is the marker that told it
/// before, wherever that was expected, and no other that told one.
pub fn rematch(
    markers: &[Marker],
    lost: &[usize],
    (groups, told): (&[Group], &[Option<u32>]),
    links: &Links,
    now: &[Option<Vector3<f64>>],
    worst: f64,
) -> Vec<Option<usize>> {
    assign(groups.len(), lost.len(), |g, l| {
        let marker = &markers[lost[l]];
        if let (Some(told), Some(own)) = (told[g], marker.hardware) {
            return (told == own).then_some(-CERTAIN);
        }
        if marker.prior.must_tell {
            return None;
        }
        let cost = place_cost(marker, &groups[g])? + link_cost(marker, &groups[g].point, links, |slot| now[slot]);
        (cost < worst).then_some(cost - worst)
    })
}

fn place_cost(marker: &Marker, group: &Group) -> Option<f64> {
    let away = (group.point - marker.prior.point).norm();
    let spread = (marker.prior.covariance + group.covariance).trace().sqrt();
    let reach = (4.0 * spread + MARGIN).min(FARTHEST).max(2.0 * spread);
    (away < reach).then(|| surprise(away, spread))
}

/// Heavy-tailed cost of being this far from where a marker is expected (nats).
pub fn surprise(away: f64, spread: f64) -> f64 {
    2.0 * (away * away / (4.0 * spread * spread)).ln_1p()
}

/// How badly a point fits a marker's rigid links (nats).
pub fn link_cost(
    marker: &Marker,
    point: &Vector3<f64>,
    links: &Links,
    now: impl Fn(usize) -> Option<Vector3<f64>>,
) -> f64 {
    let mut cost = 0.0;
    for link in links.of(marker.slot).iter().take(LINKS) {
        if let Some(other) = now(link.other).filter(|_| link.is_rigid()) {
            let off = ((point - other).norm() - link.mean_m) / link.spread_m().max(1e-3);
            cost += (off * off / 2.0).min(WORST_LINK) - LINK_GAIN;
        }
    }
    cost
}
