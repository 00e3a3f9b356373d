//! Names frame by frame, in bounded time: a trajectory keeps its name while the evidence of its recent frames allows it.
//!
//! What speaks for every marker at a point is averaged along the point's trajectory over the last half second; the
//! assignment of the largest sum names the frame, the present owner of a name having a little more. A frame is searched
//! without history where many points have no name, at most a few times a second.

use super::evidence::{Frame, Names, Naming, best};
use super::model::Model;
use super::search::{Plan, search_all};
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// Time over which evidence is averaged, after which a trajectory that is gone is forgotten, and between searches (s).
const HEARD_S: f64 = 0.5;
const FORGOTTEN_S: f64 = 10.0;
const SEARCH_S: f64 = 0.2;
/// What the present owner of a name has more, and how much better a search must be to be believed.
const OWNER: f64 = 1.5;
const BETTER: f64 = 10.0;
/// Points without a name from which a search is worth it.
const NAMELESS: usize = 3;

struct Heard {
    mean: Vec<f64>,
    weight: f64,
    last_s: f64,
    marker: Option<usize>,
}

/// The name of a point: its marker, and the probability of what is said.
#[derive(Clone, Copy, Debug)]
pub struct Name {
    /// The marker, or that it is none.
    pub marker: Option<usize>,
    /// Probability.
    pub probability: f64,
}

/// Names points as they come.
pub struct Labeller {
    model: Model,
    plans: Vec<Plan>,
    heard: BTreeMap<i64, Heard>,
    searched_s: f64,
}

impl Labeller {
    /// A labeller that has seen nothing.
    pub fn new(model: Model) -> Self {
        let plans = (0..model.subjects()).map(|s| Plan::new(&model, s)).collect();
        Self { model, plans, heard: BTreeMap::new(), searched_s: f64::NEG_INFINITY }
    }

    /// The names of a frame's points, given their trajectories.
    pub fn push(&mut self, time_s: f64, tracks: &[i64], points: &[Vector3<f64>]) -> Vec<Name> {
        let frame = Frame::new(points);
        let mut names: Names = vec![None; self.model.len()];
        for (point, track) in tracks.iter().enumerate() {
            if let Some(marker) = self.heard.get(track).and_then(|h| h.marker) {
                names[marker] = Some(point);
            }
        }
        let mut naming = Naming::new(&self.model, &frame, names);
        if let Some(found) = self.searched(time_s, &frame, &naming) {
            naming = found;
            tracks.iter().for_each(|track| drop(self.heard.remove(track)));
        }
        let values = self.listen(time_s, tracks, &naming);
        let names = best(&values, self.model.len(), points.len(), 0.0);
        self.heard.retain(|_, heard| heard.last_s >= time_s - FORGOTTEN_S);
        self.answer(tracks, &names, &values)
    }

    fn searched(&mut self, time_s: f64, frame: &Frame, naming: &Naming) -> Option<Naming> {
        let named = naming.names.iter().flatten().count();
        let nameless = (frame.points.len() - named).min(self.model.len() - named);
        if nameless < NAMELESS || time_s < self.searched_s + SEARCH_S {
            return None;
        }
        self.searched_s = time_s;
        let found = search_all(&self.model, &self.plans, frame);
        let [right, wrong] = found.sides(&self.model, frame);
        (found.sum > naming.sum + BETTER && wrong <= right).then_some(found)
    }

    /// Average what speaks for every marker along the trajectories: the values by which the frame is named.
    fn listen(&mut self, time_s: f64, tracks: &[i64], naming: &Naming) -> Vec<f64> {
        let (markers, points) = (self.model.len(), tracks.len());
        let mut values = vec![0.0; markers * points];
        for (point, &track) in tracks.iter().enumerate() {
            let new = || Heard { mean: vec![0.0; markers], weight: 0.0, last_s: time_s, marker: None };
            let heard = self.heard.entry(track).or_insert_with(new);
            let kept = heard.weight * (-(time_s - heard.last_s).max(0.0) / HEARD_S).exp();
            (heard.weight, heard.last_s) = (kept + 1.0, time_s);
            for marker in 0..markers {
                let told = naming.values[marker * points + point];
                let mean = &mut heard.mean[marker];
                *mean = (*mean * kept + told) / (kept + 1.0);
                let owns = heard.marker == Some(marker) || naming.names[marker] == Some(point);
                values[marker * points + point] = *mean + if owns { OWNER } else { 0.0 };
            }
        }
        values
    }

    fn answer(&mut self, tracks: &[i64], names: &Names, values: &[f64]) -> Vec<Name> {
        let points = tracks.len();
        let mut marker_of = vec![None; points];
        names.iter().enumerate().for_each(|(m, p)| p.iter().for_each(|&p| marker_of[p] = Some(m)));
        let name = |(point, track): (usize, &i64)| {
            let marker = marker_of[point];
            if let Some(heard) = self.heard.get_mut(track) {
                heard.marker = marker;
            }
            let value = |m: usize| values[m * points + point];
            let own = marker.map_or(0.0, value);
            let others = (0..names.len()).filter(|&m| Some(m) != marker).map(|m| (value(m) - own).min(60.0).exp());
            let none = if marker.is_some() { (-own).min(60.0).exp() } else { 0.0 };
            Name { marker, probability: 1.0 / (1.0 + none + others.sum::<f64>()) }
        };
        tracks.iter().enumerate().map(name).collect()
    }
}
