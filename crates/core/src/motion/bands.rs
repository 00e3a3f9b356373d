//! Frequency bands of a signal: Gaussian and Laplacian pyramid without decimation (Bruderlin & Williams 1995, section 2;
//! Burt & Adelson 1983).
//!
//! Level k + 1 is level k convolved with (1/16, 1/4, 3/8, 1/4, 1/16), its taps 2ᵏ frames apart; a band is the difference
//! of two levels, so that all bands and the last level add up to the signal. Beyond its ends a signal goes on mirrored
//! through its end point: first and last frame belong to no band but the last.

const KERNEL: [f64; 5] = [1.0 / 16.0, 1.0 / 4.0, 3.0 / 8.0, 1.0 / 4.0, 1.0 / 16.0];

/// How many bands a signal of so many frames has: taps stay within its length.
pub fn count(frames: usize) -> usize {
    let mut bands = 0;
    while (2usize << bands) < frames {
        bands += 1;
    }
    bands
}

/// A signal as rows of channels, one row per frame.
#[derive(Clone, Copy)]
struct Rows<'a> {
    values: &'a [f64],
    channels: usize,
    frames: usize,
}

impl<'a> Rows<'a> {
    fn row(&self, frame: usize) -> &'a [f64] {
        &self.values[frame * self.channels..][..self.channels]
    }

    /// Add `weight` times the row of any frame, also beyond the ends, to `out`.
    fn add(&self, frame: isize, weight: f64, out: &mut [f64]) {
        let last = self.frames as isize - 1;
        if (0..=last).contains(&frame) {
            out.iter_mut().zip(self.row(frame as usize)).for_each(|(o, v)| *o += weight * v);
            return;
        }
        if last == 0 {
            out.iter_mut().zip(self.row(0)).for_each(|(o, v)| *o += weight * v);
            return;
        }
        let (turns, within) = (frame.div_euclid(2 * last), frame.rem_euclid(2 * last));
        let (first, end) = (self.row(0), self.row(last as usize));
        let mirrored = within > last;
        let own = self.row(if mirrored { 2 * last - within } else { within } as usize);
        for (c, o) in out.iter_mut().enumerate() {
            let value = if mirrored { 2.0 * end[c] - own[c] } else { own[c] };
            *o += weight * (value + 2.0 * turns as f64 * (end[c] - first[c]));
        }
    }
}

/// The next level of the pyramid.
fn smoothed(signal: Rows<'_>, step: usize, out: &mut [f64]) {
    for (frame, row) in out.chunks_exact_mut(signal.channels).enumerate() {
        let taps = (frame >= 2 * step && frame + 2 * step < signal.frames)
            .then(|| [0, 1, 2, 3, 4].map(|m| signal.row(frame + m * step - 2 * step)));
        if let Some([a, b, c, d, e]) = taps {
            for (k, o) in row.iter_mut().enumerate() {
                *o = KERNEL[0] * (a[k] + e[k]) + KERNEL[1] * (b[k] + d[k]) + KERNEL[2] * c[k];
            }
        } else {
            row.fill(0.0);
            for (m, weight) in KERNEL.iter().enumerate() {
                signal.add(frame as isize + (m as isize - 2) * step as isize, *weight, row);
            }
        }
    }
}

/// Go through the pyramid: `each` is handed every level with the next one, finest first; returns the last level.
fn levels(values: &[f64], channels: usize, bands: usize, mut each: impl FnMut(usize, &[f64], &[f64])) -> Vec<f64> {
    let frames = values.len() / channels.max(1);
    let (mut now, mut next) = (values.to_vec(), vec![0.0; values.len()]);
    for band in 0..bands {
        smoothed(Rows { values: &now, channels, frames }, 1 << band, &mut next);
        each(band, &now, &next);
        std::mem::swap(&mut now, &mut next);
    }
    now
}

/// All bands of a signal, finest first, and the last level: `bands + 1` arrays like `values`, one after the other.
pub fn split(values: &[f64], channels: usize, bands: usize) -> Vec<f64> {
    let mut all = Vec::with_capacity(values.len() * (bands + 1));
    let last = levels(values, channels, bands, |_, now, next| all.extend(now.iter().zip(next).map(|(a, b)| a - b)));
    all.extend(last);
    all
}

/// The signal with its bands weighted: `gains[band * channels + channel]`, the last level's after those of the bands.
pub fn equalised(values: &[f64], channels: usize, gains: &[f64]) -> Vec<f64> {
    let bands = gains.len() / channels.max(1) - 1;
    let mut out = vec![0.0; values.len()];
    let last = levels(values, channels, bands, |band, now, next| {
        let own = &gains[band * channels..][..channels];
        for ((o, a), b) in
            out.chunks_exact_mut(channels).zip(now.chunks_exact(channels)).zip(next.chunks_exact(channels))
        {
            for c in 0..channels {
                o[c] += own[c] * (a[c] - b[c]);
            }
        }
    });
    let own = &gains[bands * channels..];
    for (o, v) in out.chunks_exact_mut(channels).zip(last.chunks_exact(channels)) {
        o.iter_mut().zip(own).zip(v).for_each(|((o, g), v)| *o += g * v);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn signal(frames: usize) -> Vec<f64> {
        (0..frames * 2).map(|i| (0.37 * i as f64).sin() + 0.01 * i as f64).collect()
    }

    #[test]
    fn bands_add_up_to_the_signal() {
        for frames in [1, 2, 3, 17, 300] {
            let values = signal(frames);
            let bands = count(frames);
            let all = split(&values, 2, bands);
            for (i, v) in values.iter().enumerate() {
                let sum: f64 = all.chunks_exact(values.len()).map(|band| band[i]).sum();
                assert!((sum - v).abs() < 1e-13);
            }
            let same = equalised(&values, 2, &vec![1.0; 2 * (bands + 1)]);
            assert!(same.iter().zip(&values).all(|(a, b)| (a - b).abs() < 1e-13));
        }
    }

    #[test]
    fn a_straight_line_and_the_ends_have_no_bands() {
        let line: Vec<f64> = (0..100).map(|i| 3.0 - 0.2 * f64::from(i)).collect();
        assert!(split(&line, 1, 6)[..600].iter().all(|v| v.abs() < 1e-12));
        let values = signal(64);
        for band in split(&values, 2, 5).chunks_exact(values.len()).take(5) {
            assert!(band[..2].iter().chain(&band[values.len() - 2..]).all(|v| v.abs() < 1e-12));
        }
    }

    #[test]
    fn a_fast_wave_is_in_the_first_band() {
        let wave: Vec<f64> = (0..256).map(|i| if i % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let all = split(&wave, 1, 3);
        assert!((all[100] - 1.0).abs() < 1e-12 && all[256 + 100].abs() < 1e-12);
    }
}
