//! One camera's free dots, in strips across the image: those that may be a marker's are found by a look at a few.

use super::frame::Frame;
use super::views::Views;
use nalgebra::Vector2;

/// Strips for each dot.
const STRIPS_PER_DOT: f64 = 2.0;

/// A dot that nobody owns.
pub struct FreeDot {
    pub dot: u32,
    pub sigma_px: f64,
    pub hardware: Option<u32>,
    /// Logarithm of the density (px⁻²) of dots there that belong to nothing known.
    pub ln_alone: f64,
}

/// Free dots of one camera, strip by strip.
pub struct Free {
    pub dots: Vec<FreeDot>,
    /// Where they are (px).
    pub pixels: Vec<Vector2<f64>>,
    strips: Strips,
}

impl Free {
    /// The camera's dots that nobody owns yet.
    pub fn of(frame: &Frame, camera: usize) -> Self {
        let own = &frame.by_camera[camera];
        let mut free: Vec<u32> = Vec::with_capacity(own.len());
        free.extend(own.iter().filter(|&&d| frame.free[d as usize]));
        let places: Vec<Vector2<f64>> = free.iter().map(|&d| frame.pixel(d)).collect();
        let (strips, order) = Strips::of(&places);
        let one = |&at: &u32| {
            let dot = free[at as usize];
            let (hardware, ln_alone) = (frame.dots[dot as usize].hardware, frame.ln_alone[dot as usize]);
            FreeDot { dot, sigma_px: frame.sigma_px(dot), hardware, ln_alone }
        };
        let dots = order.iter().map(one).collect();
        let pixels = order.iter().map(|&at| places[at as usize]).collect();
        Self { dots, pixels, strips }
    }

    /// Views and the dots in their gates' bounding boxes, by their numbers.
    pub fn near(&self, views: &Views) -> Vec<(u32, u32)> {
        let mut near = vec![(0, 0); views.who.len()];
        let mut found = 0;
        for number in 0..views.who.len() {
            let (pixel, reach) = views.gate(number);
            let dots = self.strips.within(&pixel, reach);
            if found + dots.len() > near.len() {
                near.resize(2 * (found + dots.len()), (0, 0));
            }
            // Each is written down, and the next one over it if it was not near: who is near cannot be foreseen, and
            // guessing wrong takes the processor longer than writing.
            for at in dots {
                let offset = self.pixels[at] - pixel;
                near[found] = (number as u32, at as u32);
                found += usize::from((offset.x.abs() <= reach[0]) & (offset.y.abs() <= reach[1]));
            }
        }
        near.truncate(found);
        near
    }
}

/// Strips across the longer side of the box around some places.
struct Strips {
    /// 0: side by side, 1: one below the other.
    axis: usize,
    origin: f64,
    per_px: f64,
    /// By strip, the number of places in those before it; and the number of all.
    starts: Vec<u32>,
}

impl Strips {
    /// The strips of places, and the places' numbers strip by strip.
    fn of(places: &[Vector2<f64>]) -> (Self, Vec<u32>) {
        let (mut least, mut most) = (Vector2::repeat(f64::MAX), Vector2::repeat(f64::MIN));
        for place in places {
            (least, most) = (least.inf(place), most.sup(place));
        }
        let size = most - least;
        let axis = usize::from(size.y > size.x);
        let count = (STRIPS_PER_DOT * places.len() as f64) as usize + 1;
        let per_px = (count - 1) as f64 / size[axis].max(1.0);
        let mut strips = Self { axis, origin: least[axis], per_px, starts: vec![0; count + 1] };
        let of_place: Vec<u32> = places.iter().map(|p| strips.strip(p[axis]) as u32).collect();
        of_place.iter().for_each(|&s| strips.starts[s as usize + 1] += 1);
        for strip in 1..=count {
            strips.starts[strip] += strips.starts[strip - 1];
        }
        let (mut next, mut order) = (strips.starts.clone(), vec![0; places.len()]);
        for (number, &strip) in of_place.iter().enumerate() {
            order[next[strip as usize] as usize] = number as u32;
            next[strip as usize] += 1;
        }
        (strips, order)
    }

    /// The strip of a coordinate; the first and the last one go on for ever.
    fn strip(&self, coordinate: f64) -> usize {
        (((coordinate - self.origin) * self.per_px) as usize).min(self.starts.len().saturating_sub(2))
    }

    /// Places, strip by strip, among which are all those within reach of a pixel (px).
    fn within(&self, pixel: &Vector2<f64>, reach: [f64; 2]) -> std::ops::Range<usize> {
        let (middle, reach) = (pixel[self.axis], reach[self.axis]);
        let (first, last) = (self.strip(middle - reach), self.strip(middle + reach));
        self.starts[first] as usize..self.starts[last + 1] as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Looking at every place is the oracle.
    #[test]
    fn nothing_within_reach_is_left_out() {
        let place = |i: usize, wide: f64, high: f64| {
            let part = |n: usize| (i * n % 101) as f64 / 101.0;
            Vector2::new(wide * part(37), high * part(53))
        };
        for (wide, high, count) in
            [(900.0, 300.0, 80), (20.0, 700.0, 33), (500.0, 0.0, 7), (0.0, 0.0, 3), (1.0, 1.0, 1)]
        {
            let places: Vec<Vector2<f64>> = (0..count).map(|i| place(i, wide, high)).collect();
            let (strips, order) = Strips::of(&places);
            for pixel in (0..200).map(|i| place(7 * i, 1.4 * wide, 1.4 * high) - Vector2::new(0.2 * wide, 0.2 * high)) {
                let reach = [0.05 * wide + 1.0, 0.05 * high + 1.0];
                let told: Vec<u32> = strips.within(&pixel, reach).map(|at| order[at]).collect();
                for (number, place) in places.iter().enumerate() {
                    let offset = place - pixel;
                    let near = offset.x.abs() <= reach[0] && offset.y.abs() <= reach[1];
                    assert!(!near || told.contains(&(number as u32)), "{place} is near {pixel}");
                }
                assert!(count < 30 || told.len() < count / 2, "{} of {count} were looked at", told.len());
            }
        }
    }
}
