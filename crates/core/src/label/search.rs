//! Who is who in one frame, without any history: islands of named points, joined.
//!
//! A seed is a triangle of markers of which all three sides keep their lengths. Wherever three points make it, an island
//! starts; it looks for the markers about the triangle, each where those before it say, or nowhere. Islands are joined to
//! the best one, each time the one for which, given all names so far, most speaks; then the names are settled
//! (`evidence.rs`). Every part of a body is thus found by its own rigid markers, and placed by its neighbours: left and
//! right arms fit each other's triangles, but not each other's shoulders.

use super::evidence::{Frame, Names, Naming, around, at, at_point};
use super::model::{Model, NEIGHBOURS};

/// Triangles that a marker takes part in, at most.
const SEEDS_OF_MARKER: usize = 1;
/// Islands started from each seed, and markers looked for about a seed, at most.
const STARTS: usize = 4;
const AROUND: usize = 6;
/// Part of the most that could speak for a marker which must speak for it to join an island.
const FIRM: f64 = 0.5;
/// Islands to which the others are joined in turn; the best outcome counts.
const BASES: usize = 1;
/// Improvements of the names at most, and changes tried for each.
const IMPROVEMENTS: usize = 10;
const TRIES: usize = 6;
/// A marker is doubtful when so much less speaks for it than could.
const DOUBT: f64 = 6.0;
/// Neighbours that are looked for anew with a doubtful marker, and the ways kept side by side.
const TOGETHER: usize = 4;
const BEAM: usize = 6;
/// What a marker costs that is not there: one in ten is missing.
const MISSING: f64 = -2.3;
/// Evidence that joins an island to the names so far.
const JOINS: f64 = 4.0;

/// A triangle of markers, and the order in which the others are looked for.
struct Seed {
    triangle: [usize; 3],
    order: Vec<usize>,
}

/// The seeds of a subject; made once.
pub struct Plan {
    seeds: Vec<Seed>,
}

impl Plan {
    /// The plan for one subject of a model.
    pub fn new(model: &Model, subject: usize) -> Self {
        let own = model.of_subject(subject);
        let mut triangles: Vec<(f64, [usize; 3])> = own.iter().flat_map(|&m| triangles_of(model, m)).collect();
        triangles.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        triangles.dedup_by_key(|t| t.1);
        let mut uses = vec![0; model.len()];
        let mut seeds = Vec::new();
        for (_, triangle) in triangles {
            if triangle.iter().all(|&m| uses[m] < SEEDS_OF_MARKER) {
                triangle.iter().for_each(|&m| uses[m] += 1);
                seeds.push(Seed { triangle, order: order(model, &own, triangle) });
            }
        }
        Self { seeds }
    }
}

/// Triangles of a marker with its most rigid neighbours, by what their sides tell together.
fn triangles_of(model: &Model, m: usize) -> Vec<(f64, [usize; 3])> {
    let near: Vec<usize> = model.near(m).iter().copied().take(5).collect();
    let mut found = Vec::new();
    for (i, &a) in near.iter().enumerate() {
        for &b in &near[i + 1..] {
            let mut triangle = [m, a, b];
            triangle.sort_unstable();
            let [x, y, z] = triangle;
            let sides = [(x, y), (x, z), (y, z)];
            let lengths = sides.map(|(p, q)| model.distance(p, q).map_or(0.0, |l| l.mean));
            let peak: f64 = sides.iter().map(|&(p, q)| model.peak(p, q)).sum();
            // A triangle whose sides are alike fits in several ways, as does a straight one.
            let unlike = (lengths[0] - lengths[1]).abs().min((lengths[0] - lengths[2]).abs());
            let unlike = unlike.min((lengths[1] - lengths[2]).abs());
            found.push((peak + (0.01 + unlike).ln(), triangle));
        }
    }
    found
}

/// The markers about a triangle, each as soon as it is best known from those before it.
fn order(model: &Model, own: &[usize], triangle: [usize; 3]) -> Vec<usize> {
    let mut done = triangle.to_vec();
    let mut order = Vec::new();
    while done.len() < own.len() && order.len() < AROUND {
        let known = |m: usize| {
            let before = model.near(m).iter().filter(|o| done.contains(o)).take(NEIGHBOURS);
            before.map(|&o| model.peak(m, o).max(0.0)).sum::<f64>()
        };
        let rest = own.iter().copied().filter(|m| !done.contains(m));
        let Some(next) = rest.max_by(|&a, &b| known(a).total_cmp(&known(b)).then(b.cmp(&a))) else { break };
        done.push(next);
        order.push(next);
    }
    order
}

/// Names that belong together.
struct Island {
    names: Vec<(usize, usize)>,
    score: f64,
}

/// The names of one subject's markers among the points that are not `taken`, and the evidence for them all.
pub fn search(model: &Model, plan: &Plan, frame: &Frame, taken: &[bool]) -> Naming {
    let mut islands = islands(model, plan, frame, taken);
    islands.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut best = Naming::new(model, frame, vec![None; model.len()]);
    let mut bases = 0;
    for base in 0..islands.len() {
        // An island that the best names hold already leads nowhere else.
        if bases == BASES || islands[base].names.iter().all(|&(m, p)| best.names[m] == Some(p)) {
            continue;
        }
        bases += 1;
        let mut joined = Naming::new(model, frame, join(model, frame, &islands, base, taken));
        joined.settle(model, frame);
        improve(model, frame, &islands, &mut joined, taken);
        if joined.sum > best.sum {
            best = joined;
        }
    }
    best
}

/// The names of the markers of all subjects: one after the other in each order that begins with another of them.
pub fn search_all(model: &Model, plans: &[Plan], frame: &Frame) -> Naming {
    let orders = (0..plans.len()).map(|first| (first..plans.len()).chain(0..first));
    let found = orders.map(|order| {
        let mut taken = vec![false; frame.points.len()];
        let mut names = vec![None; model.len()];
        for subject in order {
            let own = search(model, &plans[subject], frame, &taken);
            own.names.iter().flatten().for_each(|&p| taken[p] = true);
            names.iter_mut().zip(own.names).for_each(|(name, own)| *name = name.or(own));
        }
        let mut naming = Naming::new(model, frame, names);
        naming.settle(model, frame);
        naming
    });
    found.max_by(|a, b| a.sum.total_cmp(&b.sum)).unwrap_or_else(|| Naming::new(model, frame, vec![None; model.len()]))
}

fn islands(model: &Model, plan: &Plan, frame: &Frame, taken: &[bool]) -> Vec<Island> {
    let free: Vec<usize> = (0..frame.points.len()).filter(|&p| !taken[p]).collect();
    let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
    for (i, &p) in free.iter().enumerate() {
        pairs.extend(free[i + 1..].iter().map(|&q| (frame.distance(p, q), p, q)));
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut all = Vec::new();
    let mut names = vec![None; model.len()];
    let mut used = taken.to_vec();
    for seed in &plan.seeds {
        let mut found = placed(model, frame, seed.triangle, &pairs, &free);
        found.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        for (score, corners) in found.into_iter().take(STARTS) {
            let mut island = Island { names: Vec::new(), score };
            for (marker, point) in seed.triangle.into_iter().zip(corners) {
                island.names.push((marker, point));
                names[marker] = Some(point);
                used[point] = true;
            }
            for &marker in &seed.order {
                grow(model, frame, marker, &mut island, &mut names, &mut used);
            }
            for &(marker, point) in &island.names {
                names[marker] = None;
                used[point] = false;
            }
            all.push(island);
        }
    }
    all
}

/// A further marker of an island, where most speaks for it.
fn grow(model: &Model, frame: &Frame, marker: usize, island: &mut Island, names: &mut Names, used: &mut [bool]) {
    // Nothing doubtful: a wrong name would spoil the whole island.
    let least = FIRM * model.potential(marker, |o| names[o].is_some());
    let mut best = (least.max(0.0), None);
    let around = around(model, frame, names, marker);
    for point in (0..frame.points.len()).filter(|&p| !used[p]) {
        let value = at(&around, frame, point);
        if value > best.0 {
            best = (value, Some(point));
        }
    }
    if let (value, Some(point)) = best {
        island.names.push((marker, point));
        island.score += value;
        names[marker] = Some(point);
        used[point] = true;
    }
}

/// All islands that fit, joined to one of them.
fn join(model: &Model, frame: &Frame, islands: &[Island], base: usize, taken: &[bool]) -> Names {
    let mut names = vec![None; model.len()];
    let mut used = taken.to_vec();
    let mut rest: Vec<usize> = (0..islands.len()).filter(|&i| i != base).collect();
    let mut next = Some(base);
    while let Some(island) = next {
        for &(marker, point) in &islands[island].names {
            if names[marker].is_none() && !used[point] {
                names[marker] = Some(point);
                used[point] = true;
            }
        }
        next = None;
        let mut most = JOINS;
        rest.retain(|&i| {
            let gain = gain(model, frame, &islands[i], &mut names, &used);
            if gain.is_some_and(|g| g > most) {
                most = gain.unwrap_or(most);
                next = Some(i);
            }
            gain.is_some()
        });
        rest.retain(|&i| Some(i) != next);
    }
    names
}

/// Islands put over the names so far, and doubtful parts grown anew, wherever that makes more of the evidence.
fn improve(model: &Model, frame: &Frame, islands: &[Island], so_far: &mut Naming, taken: &[bool]) {
    for _ in 0..IMPROVEMENTS {
        // What grew about a triangle may be wrong in a pose that is new; the triangle itself keeps its lengths.
        let parts = islands.iter().flat_map(|island| [&island.names[..], &island.names[..3]]);
        let mut tried: Vec<(f64, Names)> = parts.filter_map(|part| put_over(model, frame, part, so_far)).collect();
        for marker in (0..model.len()).filter(|&m| is_doubtful(model, frame, so_far, m)) {
            tried.extend(grow_anew(model, frame, marker, so_far, taken));
        }
        tried.sort_by(|a, b| b.0.total_cmp(&a.0));
        tried.dedup_by(|a, b| a.1 == b.1);
        let better = tried.into_iter().take(TRIES).find_map(|(_, names)| {
            let mut naming = so_far.clone();
            naming.take(model, frame, names);
            naming.settle(model, frame);
            (naming.sum > so_far.sum + 1e-9).then_some(naming)
        });
        match better {
            Some(naming) => *so_far = naming,
            None => break,
        }
    }
}

/// Names with others put over them, where that gains: by how much, on those concerned alone.
fn put_over(model: &Model, frame: &Frame, island: &[(usize, usize)], so_far: &Naming) -> Option<(f64, Names)> {
    if island.iter().all(|&(m, p)| so_far.names[m] == Some(p)) {
        return None;
    }
    let mut next = so_far.names.clone();
    let mut before = 0.0;
    for (m, place) in next.iter_mut().enumerate() {
        let Some(p) = *place else { continue };
        if island.iter().any(|&(marker, point)| marker == m || point == p) {
            before += so_far.of(frame, m).unwrap_or(0.0);
            *place = None;
        }
    }
    for &(m, p) in island {
        next[m] = Some(p);
    }
    let after: f64 = island.iter().map(|&(m, p)| at_point(model, frame, &next, m, p)).sum();
    (after > before).then_some((after - before, next))
}

/// Whether a marker is missing, or much less speaks for it than should.
fn is_doubtful(model: &Model, frame: &Frame, naming: &Naming, marker: usize) -> bool {
    let potential = model.potential(marker, |o| naming.names[o].is_some());
    naming.of(frame, marker).is_none_or(|value| value < potential - DOUBT)
}

/// A marker and its nearest neighbours looked for anew, all together: the best other way to name them, and its gain.
fn grow_anew(model: &Model, frame: &Frame, marker: usize, so_far: &Naming, taken: &[bool]) -> Option<(f64, Names)> {
    let mut part: Vec<usize> = model.near(marker).iter().copied().take(TOGETHER).collect();
    part.push(marker);
    let mut base = so_far.names.clone();
    part.iter().for_each(|&m| base[m] = None);
    part.sort_by(|&a, &b| {
        let potential = |m: usize| model.potential(m, |o| base[o].is_some());
        potential(b).total_cmp(&potential(a)).then(a.cmp(&b))
    });
    let mut used = taken.to_vec();
    base.iter().flatten().for_each(|&p| used[p] = true);
    let mut beam = vec![(0.0, base.clone())];
    let mut before = (0.0, base);
    for &m in &part {
        let mut next = Vec::new();
        for (score, names) in &beam {
            next.push((score + MISSING, names.clone()));
            let around = around(model, frame, names, m);
            for p in (0..frame.points.len()).filter(|&p| !used[p] && !part.iter().any(|&o| names[o] == Some(p))) {
                let value = at(&around, frame, p);
                if value > 0.0 {
                    let mut with = names.clone();
                    with[m] = Some(p);
                    next.push((score + value, with));
                }
            }
        }
        next.sort_by(|a, b| b.0.total_cmp(&a.0));
        next.truncate(BEAM);
        beam = next;
        before.0 += so_far.names[m].map_or(MISSING, |p| at_point(model, frame, &before.1, m, p));
        before.1[m] = so_far.names[m];
    }
    let other = beam.into_iter().find(|(_, names)| *names != so_far.names);
    other.map(|(score, names)| (score - before.0, names))
}

/// What speaks for an island's further names, given the names so far; `None` where it has nothing to add.
fn gain(model: &Model, frame: &Frame, island: &Island, names: &mut Names, used: &[bool]) -> Option<f64> {
    let new: Vec<(usize, usize)> =
        island.names.iter().copied().filter(|&(m, p)| names[m].is_none() && !used[p]).collect();
    if new.is_empty() {
        return None;
    }
    for &(m, p) in &new {
        names[m] = Some(p);
    }
    let sum = new.iter().map(|&(m, p)| at_point(model, frame, names, m, p)).sum();
    for &(m, _) in &new {
        names[m] = None;
    }
    Some(sum)
}

/// Wherever three points make a triangle of markers: the evidence of its sides, and the points.
fn placed(
    model: &Model,
    frame: &Frame,
    [a, b, c]: [usize; 3],
    pairs: &[(f64, usize, usize)],
    free: &[usize],
) -> Vec<(f64, [usize; 3])> {
    let mut found = Vec::new();
    let Some(side) = model.distance(a, b) else { return found };
    let peak = model.peak(a, b).max(0.0);
    let window = side.sd * (3.0 * ((0.5 * peak).exp() - 1.0)).sqrt();
    let first = pairs.partition_point(|x| x.0 < side.mean - window);
    for &(d, p, q) in pairs[first..].iter().take_while(|x| x.0 <= side.mean + window) {
        let of_side = model.of_distance(a, b, d);
        for (p, q) in [(p, q), (q, p)] {
            for &r in free.iter().filter(|&&r| r != p && r != q) {
                let second = model.of_distance(a, c, frame.distance(p, r));
                if second > 0.0 {
                    let third = model.of_distance(b, c, frame.distance(q, r));
                    if third > 0.0 {
                        found.push((of_side + second + third, [p, q, r]));
                    }
                }
            }
        }
    }
    found
}
