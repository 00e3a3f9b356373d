//! Bright pixels as runs of rows, joined into components where they touch (also at corners).

use super::{Image, Value};

/// Bright pixels `first..last` of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Run {
    /// Row.
    pub row: usize,
    /// First column.
    pub first: usize,
    /// One past the last column.
    pub last: usize,
}

/// Runs that touch each other.
#[derive(Clone, Debug)]
pub struct Component {
    /// In ascending order of row, then column.
    pub runs: Vec<Run>,
    /// Number of pixels.
    pub pixels: usize,
    /// First row and column, last row and column.
    pub top: usize,
    /// First column.
    pub left: usize,
    /// Last row.
    pub bottom: usize,
    /// Last column.
    pub right: usize,
}

impl Component {
    /// Whether it reaches the image's edge.
    pub fn touches(&self, width: usize, height: usize) -> bool {
        self.top == 0 || self.left == 0 || self.bottom + 1 == height || self.right + 1 == width
    }
}

/// Pixels looked at together: dark rows are passed over as a whole, in others so many at a time.
const PART: usize = 32;
const LANES: usize = 16;

/// All components of pixels above `limit`, in ascending order of their first row, then column.
pub fn components<V: Value>(image: &Image<'_, V>, limit: V) -> Vec<Component> {
    let mut runs: Vec<Run> = Vec::new();
    let mut parent: Vec<u32> = Vec::new();
    let mut above = 0..0;
    for (row, values) in image.values.chunks_exact(image.width.max(1)).enumerate() {
        let start = runs.len();
        runs_of_row(values, limit, row, &mut runs);
        parent.extend(start as u32..runs.len() as u32);
        join(&runs, &mut parent, above, start..runs.len(), row);
        above = start..runs.len();
    }
    let roots: Vec<usize> = (0..runs.len()).map(|k| root(&mut parent, k as u32) as usize).collect();
    let mut members = vec![0; runs.len()];
    roots.iter().for_each(|&root| members[root] += 1);
    let mut index = vec![usize::MAX; runs.len()];
    let mut found: Vec<Component> = Vec::new();
    for (run, &root) in runs.iter().zip(&roots) {
        if index[root] == usize::MAX {
            index[root] = found.len();
            let (top, left, bottom, right) = (run.row, run.first, run.row, run.last - 1);
            let runs = Vec::with_capacity(members[root]);
            found.push(Component { runs, pixels: 0, top, left, bottom, right });
        }
        let own = &mut found[index[root]];
        own.runs.push(*run);
        own.pixels += run.last - run.first;
        (own.left, own.right, own.bottom) = (own.left.min(run.first), own.right.max(run.last - 1), run.row);
    }
    found
}

/// The largest of some values and a least one: in lanes, so that whole registers are compared.
fn brightest<V: Value>(values: &[V], least: V) -> V {
    let mut lanes = [least; LANES];
    let whole = values.chunks_exact(LANES);
    let rest = whole.remainder().iter().copied().fold(least, V::max);
    for part in whole {
        for (lane, value) in lanes.iter_mut().zip(part) {
            *lane = V::max(*lane, *value);
        }
    }
    lanes.into_iter().fold(rest, V::max)
}

/// Which of [`PART`] values are above a limit, as bits from the lowest on.
fn brighter<V: Value>(part: &[V; PART], limit: V) -> u64 {
    let mut bits = 0;
    for (k, value) in part.iter().enumerate() {
        bits |= u64::from(*value > limit) << k;
    }
    bits
}

fn runs_of_row<V: Value>(values: &[V], limit: V, row: usize, runs: &mut Vec<Run>) {
    let is_dark = |part: &[V]| brightest(part, limit) <= limit;
    if is_dark(values) {
        return;
    }
    let mut open: Option<usize> = None;
    for (k, part) in values.chunks(PART).enumerate() {
        let left = k * PART;
        if is_dark(part) {
            runs.extend(open.take().map(|first| Run { row, first, last: left }));
            continue;
        }
        let bright = match part.try_into() {
            Ok(whole) => brighter(whole, limit),
            Err(_) => brighter(&std::array::from_fn(|k| part.get(k).copied().unwrap_or(limit)), limit),
        };
        // Bits where bright follows dark or dark follows bright.
        let mut changes = bright ^ (bright << 1 | u64::from(open.is_some()));
        changes &= (1 << part.len()) - 1;
        while changes != 0 {
            let at = left + changes.trailing_zeros() as usize;
            match open.take() {
                Some(first) => runs.push(Run { row, first, last: at }),
                None => open = Some(at),
            }
            changes &= changes - 1;
        }
    }
    runs.extend(open.map(|first| Run { row, first, last: values.len() }));
}

/// Joins runs of a row with those of the row above that they touch.
fn join(runs: &[Run], parent: &mut [u32], above: std::ops::Range<usize>, own: std::ops::Range<usize>, row: usize) {
    let mut other = above.start;
    for k in own {
        while other < above.end && runs[other].last < runs[k].first {
            other += 1;
        }
        let mut touching = other;
        while touching < above.end && runs[touching].first <= runs[k].last && runs[touching].row + 1 == row {
            let (a, b) = (root(parent, touching as u32), root(parent, k as u32));
            parent[a.max(b) as usize] = a.min(b);
            touching += 1;
        }
    }
}

fn root(parent: &mut [u32], mut of: u32) -> u32 {
    while parent[of as usize] != of {
        parent[of as usize] = parent[parent[of as usize] as usize];
        of = parent[of as usize];
    }
    of
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::random::Random;

    fn of(rows: &[&str]) -> Vec<Component> {
        let values: Vec<u8> = rows.iter().flat_map(|r| r.bytes().map(|b| if b == b'#' { 200 } else { 10 })).collect();
        components(&Image { values: &values, width: rows[0].len(), height: rows.len() }, 100)
    }

    #[test]
    fn corners_touch_and_arms_that_meet_late_are_one() {
        let found = of(&["#...#..", "#...#.#", "#.#.#..", "#####..", "......#", ".....#."]);
        let sizes: Vec<usize> = found.iter().map(|c| c.pixels).collect();
        assert_eq!(sizes, [12, 1, 2]);
        assert_eq!((found[0].top, found[0].left, found[0].bottom, found[0].right), (0, 0, 3, 4));
        assert!(found.iter().all(|c| c.touches(7, 6)));
    }

    #[test]
    fn flood_fill_finds_the_same_components() {
        let mut random = Random::new(4, 0);
        let (width, height) = (150, 40);
        for density in [0.02, 0.3, 0.6] {
            let values: Vec<u8> =
                (0..width * height).map(|_| if random.between(0.0, 1.0) < density { 255 } else { 0 }).collect();
            let found = components(&Image { values: &values, width, height }, 128);
            let mut seen = vec![false; values.len()];
            let mut sizes = Vec::new();
            for start in 0..values.len() {
                if values[start] == 0 || seen[start] {
                    continue;
                }
                let (mut stack, mut size) = (vec![start], 0);
                seen[start] = true;
                while let Some(at) = stack.pop() {
                    size += 1;
                    let (x, y) = ((at % width) as i64, (at / width) as i64);
                    for (dx, dy) in (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (dx, dy))) {
                        let (nx, ny) = (x + dx, y + dy);
                        if nx >= 0 && ny >= 0 && nx < width as i64 && ny < height as i64 {
                            let next = (ny * width as i64 + nx) as usize;
                            if values[next] > 0 && !seen[next] {
                                seen[next] = true;
                                stack.push(next);
                            }
                        }
                    }
                }
                sizes.push(size);
            }
            assert_eq!(found.iter().map(|c| c.pixels).collect::<Vec<_>>(), sizes);
        }
    }
}
