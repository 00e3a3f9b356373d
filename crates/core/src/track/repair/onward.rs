//! What motion says against two near markers changing places from one frame to the next.
//!
//! Where both were seen before and are seen now, the vector between them goes on as it was, turned a little. Where one of
//! them was or is hidden, each place is held against where motion leads: from the one's own last places, from the other's,
//! or, where a marker was hidden for long, to anywhere as far from the other as the two are apart.

use super::close::{Habit, MEDIAN, median};
use nalgebra::Vector3;

/// Where a marker was measured (m), and the variance of that (m² per axis).
pub(super) type Place = (Vector3<f64>, f64);
/// Of the two in a frame.
pub(super) type Places = [Option<Place>; 2];

/// What a change costs besides where one of them is hidden (nats), if both were hidden for so long (s) or longer; the chance
/// that they were taken for each other grows with that time.
const CHANGE: f64 = 1.0;
const LONG_S: f64 = 1.0;
/// What motion says at most (nats).
const MOST: f64 = 60.0;
/// Spread of the vector between the two from one frame to the next, besides its turning (m).
const LEAST_SPREAD: f64 = 0.004;
/// Degrees of freedom of what places are off.
const FREEDOM: f64 = 5.0;
/// What a step from a place to one's own next, or to the other's, weighs for the velocity of both.
const OWN: f64 = 2.0;
const OTHERS: f64 = 1.0;
/// Frames from which it is learned how the two move.
const LEAST: usize = 20;
/// Where motion leads is known as long as its spread is less than this part of the distance between the two.
const FRESH: f64 = 0.5;

/// How two near markers move.
pub(super) struct Onward {
    /// Usual time between two frames (s).
    pub(super) step_s: f64,
    /// Variances of a place one frame after two others, and after one (m² per axis).
    variance: f64,
    unknown: f64,
    /// Velocity of both in each frame (m/s).
    velocities: Vec<Option<Vector3<f64>>>,
    /// Of the vector between them.
    habit: Habit,
}

/// Where and when a marker was seen last, and its velocity (m/s).
#[derive(Clone, Copy)]
struct Last {
    place: Place,
    velocity: Option<Vector3<f64>>,
    time_s: f64,
    index: usize,
}

/// What the frames before left.
#[derive(Default)]
pub(super) struct Past {
    last: [Option<Last>; 2],
    time_s: f64,
    index: usize,
}

/// Where a marker may be by now.
#[derive(Clone, Copy)]
enum Reach {
    /// At a place (m), with a variance (m² per axis).
    At(Vector3<f64>, f64),
    /// Somewhere about a place, as far from it as the two are apart.
    About(Vector3<f64>, f64),
}

impl Onward {
    /// From all frames of the take; `None` where the two were seen too rarely.
    pub(super) fn learned(frames: &[Places], times_s: &[f64]) -> Option<Self> {
        let between = frames.iter().zip(times_s).filter_map(|(p, &t)| Some((t, p[1]?.0 - p[0]?.0)));
        let habit = Habit::learned(&between.collect::<Vec<_>>(), LEAST)?;
        let step_s = median(times_s.windows(2).map(|w| w[1] - w[0]).collect())?;
        let seen = |w: &[Places], k: usize| Some([w[0][k]?.0, w[1][k]?.0, w[2][k]?.0]);
        let three = || (0..2).flat_map(|k| frames.windows(3).filter_map(move |w| seen(w, k)));
        let variance = |off: Vec<f64>| if off.len() < LEAST { None } else { Some(median(off)? / MEDIAN) };
        let bent = variance(three().map(|[p, q, r]| (r - 2.0 * q + p).norm_squared()).collect())?;
        let moved = variance(three().map(|[_, q, r]| (r - q).norm_squared()).collect())?;
        let velocities = velocities(frames, times_s, 1.5 * step_s);
        Some(Self { step_s, variance: bent, unknown: bent + moved, velocities, habit })
    }

    /// What it costs that the two are exchanged from the frames before to this one (nats); negative where motion says that
    /// they have been.
    pub(super) fn change(&self, past: &Past, now: &Places, time_s: f64) -> f64 {
        self.turned_round(past, now, time_s).unwrap_or_else(|| self.led_elsewhere(past, now, time_s))
    }

    /// By the vector between the two, where both were seen last and now.
    fn turned_round(&self, past: &Past, now: &Places, time_s: f64) -> Option<f64> {
        let [a, b] = [past.last[0]?, past.last[1]?];
        let [p, q] = [now[0]?, now[1]?];
        let noise: f64 = [a.place, b.place, p, q].iter().map(|p| p.1).sum();
        let variance = LEAST_SPREAD * LEAST_SPREAD + self.habit.turning * (time_s - past.time_s) + noise;
        let nats = (b.place.0 - a.place.0).dot(&(q.0 - p.0)) / variance;
        (a.index == past.index && b.index == past.index).then_some(nats.clamp(-MOST, MOST))
    }

    /// By where motion leads.
    fn led_elsewhere(&self, past: &Past, now: &Places, time_s: f64) -> f64 {
        let reach = self.reach(past, time_s);
        let cost = |from: [Option<Reach>; 2]| -> Option<f64> {
            let seen = now.iter().zip(from).filter_map(|(place, from)| Some(((*place)?, from)));
            seen.map(|(place, from)| Some(self.cost(from?, place))).sum()
        };
        let usual = CHANGE + (LONG_S / (time_s - past.time_s).max(self.step_s)).ln().max(0.0);
        match (cost(reach), cost([reach[1], reach[0]])) {
            (Some(straight), Some(crossed)) => usual + (crossed - straight).clamp(-MOST, MOST),
            _ => usual,
        }
    }

    fn reach(&self, past: &Past, time_s: f64) -> [Option<Reach>; 2] {
        let known = past.last.map(|last| last.and_then(|l| self.ahead(&l, time_s)));
        [0, 1].map(|k| match (known[k], known[1 - k]) {
            (Some((p, variance)), _) => Some(Reach::At(p, variance)),
            (None, Some((p, variance))) => Some(Reach::About(p, variance)),
            _ => None,
        })
    }

    /// Where motion leads, and its variance, as long as that says something.
    fn ahead(&self, last: &Last, time_s: f64) -> Option<(Vector3<f64>, f64)> {
        let dt_s = time_s - last.time_s;
        let steps = dt_s / self.step_s;
        let (way, variance) = match last.velocity {
            Some(velocity) => (velocity * dt_s, self.variance * (0.5 * steps * (steps + 1.0)).powi(2)),
            None => (Vector3::zeros(), self.unknown * steps * steps),
        };
        let variance = variance + last.place.1;
        (variance.sqrt() < FRESH * self.habit.length_m).then_some((last.place.0 + way, variance))
    }

    /// Negative logarithm of the density of a place (Student's t, since motion turns sharply at times), up to a constant.
    fn cost(&self, reach: Reach, (place, noise): Place) -> f64 {
        let tailed = |squared: f64, axes: f64| 0.5 * (FREEDOM + axes) * (squared / FREEDOM).ln_1p();
        match reach {
            Reach::At(p, variance) => {
                let variance = variance + noise;
                tailed((place - p).norm_squared() / variance, 3.0) + 1.5 * variance.ln()
            }
            Reach::About(p, variance) => {
                let length = self.habit.length_m;
                let (off, variance) = ((place - p).norm() - length, variance + noise);
                tailed(off * off / variance, 1.0) + 0.5 * variance.ln() + 2.0 * length.ln() + std::f64::consts::LN_2
            }
        }
    }

    /// The frames before, with this one: its index, places and time (s).
    pub(super) fn take_in(&self, past: &mut Past, (index, now, time_s): (usize, &Places, f64)) {
        for (last, place) in past.last.iter_mut().zip(now) {
            if let Some(place) = *place {
                *last = Some(Last { place, velocity: self.velocities[index], time_s, index });
                (past.time_s, past.index) = (time_s, index);
            }
        }
    }
}

/// Velocity of two that move together in each frame (m/s), from steps no longer than a time (s): of all ways from one of
/// them to one of them in the frames about it, the one that the others agree with most, whoever took whose place.
fn velocities(frames: &[Places], times_s: &[f64], longest_s: f64) -> Vec<Option<Vector3<f64>>> {
    let steps = |f: usize| {
        let dt_s = times_s[f] - times_s[f - 1];
        let from = (0..2).filter(move |_| dt_s < longest_s).flat_map(|k| [(k, k, OWN), (k, 1 - k, OTHERS)]);
        from.filter_map(move |(k, l, weight)| Some(((frames[f][l]?.0 - frames[f - 1][k]?.0) / dt_s, weight)))
    };
    let velocity = |f: usize| {
        let steps: Vec<(Vector3<f64>, f64)> = (f.max(1)..(f + 3).min(frames.len())).flat_map(steps).collect();
        let disagreement =
            |(v, _): &(Vector3<f64>, f64)| steps.iter().map(|(w, weight)| weight * (w - v).norm()).sum::<f64>();
        let best = steps.iter().min_by(|v, w| disagreement(v).total_cmp(&disagreement(w)));
        best.map(|(v, _)| *v)
    };
    (0..frames.len()).map(velocity).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAMES: usize = 200;
    const APART_M: f64 = 0.04;

    /// Two markers 40 mm apart on a part that moves and turns slowly, seen where `seen` says so.
    fn frames(seen: impl Fn(usize) -> [bool; 2]) -> (Vec<Places>, Vec<f64>) {
        let place = |f: usize, k: usize| {
            let t = f as f64 / 100.0;
            let middle = Vector3::new(1.5 * t, 0.3 * (2.0 * t).sin(), 1.0);
            let half = 0.5 * APART_M * Vector3::new((0.5 * t).cos(), (0.5 * t).sin(), 0.0);
            (if k == 0 { middle - half } else { middle + half }, 1e-7)
        };
        let of = |f: usize| [0, 1].map(|k| seen(f)[k].then(|| place(f, k)));
        ((0..FRAMES).map(of).collect(), (0..FRAMES).map(|f| f as f64 / 100.0).collect())
    }

    /// What a change costs in each frame.
    fn costs((frames, times_s): &(Vec<Places>, Vec<f64>)) -> Vec<f64> {
        let onward = Onward::learned(frames, times_s).unwrap();
        let mut past = Past::default();
        let cost = |(index, now): (usize, &Places)| {
            let cost = onward.change(&past, now, times_s[index]);
            onward.take_in(&mut past, (index, now, times_s[index]));
            cost
        };
        frames.iter().enumerate().map(cost).collect()
    }

    /// The same frames, with the two exchanged from one on.
    fn exchanged((frames, times_s): &(Vec<Places>, Vec<f64>), from: usize) -> (Vec<Places>, Vec<f64>) {
        let turn = |(f, &[p, q]): (usize, &Places)| if f < from { [p, q] } else { [q, p] };
        (frames.iter().enumerate().map(turn).collect(), times_s.clone())
    }

    #[test]
    fn markers_that_take_each_others_place_are_found_out() {
        let seen = frames(|_| [true, true]);
        assert!(costs(&seen)[1..].iter().all(|c| *c > 20.0));
        let costs = costs(&exchanged(&seen, 100));
        assert!(costs[100] < -20.0 && costs[99].min(costs[101]) > 20.0, "{:?}", &costs[98..103]);
    }

    #[test]
    fn one_alone_that_goes_on_in_the_others_place_is_found_out() {
        // The second comes back in the frame in which they are exchanged.
        let seen = frames(|f| [true, !(60..100).contains(&f)]);
        assert!(costs(&seen)[1..].iter().all(|c| *c > 5.0));
        let taken = costs(&exchanged(&seen, 100));
        assert!(taken[100] < -10.0 && taken[99].min(taken[101]) > 5.0, "{:?}", &taken[98..103]);
        // Or never, and the first one is hidden for a frame.
        let seen = frames(|f| [f != 99, f < 60]);
        assert!(costs(&seen)[1..].iter().all(|c| *c > 5.0));
        let taken = costs(&exchanged(&seen, 100));
        assert!(taken[100] < 0.0, "{:?}", &taken[98..103]);
    }

    #[test]
    fn after_both_were_hidden_a_change_costs_little_and_less_the_longer_they_were() {
        let [short, long] = [30, 90].map(|hidden| {
            let both = frames(|f| if (60..60 + hidden).contains(&f) { [false; 2] } else { [true, f < 60] });
            costs(&both)[60 + hidden]
        });
        assert!(long < short && long >= CHANGE && short < 5.0, "{short} {long}");
    }
}
