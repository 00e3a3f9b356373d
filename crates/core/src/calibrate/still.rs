//! Dots that stay where they are: fixed reflections, lamps, other cameras. A waved wand is never among them.

use nalgebra::Vector2;
use std::collections::BTreeMap;

/// Side of a cell (px): a fixed dot wanders by its noise only.
const CELL_PX: f64 = 2.0;
/// A cell that holds a dot in this part of the frames in which the camera saw anything is fixed.
const OFTEN: f64 = 0.2;

/// Whether each dot of one camera stays where it is. `frame_of` ascends.
pub fn still(frame_of: &[usize], pixels: &[Vector2<f64>]) -> Vec<bool> {
    let cell = |p: &Vector2<f64>| ((p.x / CELL_PX).round() as i64, (p.y / CELL_PX).round() as i64);
    let mut frames = frame_of.to_vec();
    frames.dedup();
    let mut count: BTreeMap<(i64, i64), usize> = BTreeMap::new();
    for p in pixels {
        *count.entry(cell(p)).or_default() += 1;
    }
    let around = |c: (i64, i64)| -> usize {
        (-1..=1).flat_map(|x| (-1..=1).map(move |y| (c.0 + x, c.1 + y))).filter_map(|n| count.get(&n)).sum()
    };
    let least = OFTEN * frames.len() as f64;
    pixels.iter().map(|p| around(cell(p)) as f64 > least.max(3.0)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lamp_is_still_and_a_moving_dot_is_not() {
        let frames: Vec<usize> = (0..100).flat_map(|f| [f, f]).collect();
        let pixels: Vec<Vector2<f64>> = (0..100)
            .flat_map(|f| [Vector2::new(200.0 + 0.3 * f64::from(f % 2), 80.0), Vector2::new(3.0 * f64::from(f), 50.0)])
            .collect();
        let found = still(&frames, &pixels);
        assert!(found.iter().enumerate().all(|(i, s)| *s == (i % 2 == 0)));
    }
}
