//! The code book of active markers.
//!
//! A code is a word of [`LENGTH`] bits that an LED repeats for ever, one bit per frame, bright or dim. A reader may start
//! anywhere, so words must differ whatever their phase: every cyclic shift of a word differs from every shift of any other
//! in at least [`LEAST_DISTANCE`] bits (so two wrong bits in one period make no other word), half of the bits are
//! bright, and no bit stays for more than [`LONGEST_RUN`] frames, so that the two levels can be told at any time. The
//! words are found by going through all in ascending order (a lexicode; Conway & Sloane 1986) and never change.

use std::sync::LazyLock;

/// Bits of a word: a period at 100 Hz is a quarter of a second.
pub const LENGTH: usize = 24;
/// Bits in which two words differ, whatever their phases.
pub const LEAST_DISTANCE: u32 = 6;
/// Equal bits in a row at most, around the end too.
pub const LONGEST_RUN: u32 = 5;
/// Words in the book.
pub const WORDS: usize = 128;

const MASK: u32 = (1 << LENGTH) - 1;

/// A word: bit k is that of frame k, modulo the length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Word(u32);

impl Word {
    /// Whether the LED is bright in a frame of its period.
    pub fn is_bright(self, frame: usize) -> bool {
        self.0 >> (frame % LENGTH) & 1 == 1
    }

    fn turned(self, by: usize) -> u32 {
        (self.0 << by | self.0 >> (LENGTH - by)) & MASK
    }

    /// Bits in which two words differ at the phase at which they are most alike.
    pub fn distance(self, other: Self) -> u32 {
        (0..LENGTH).map(|k| (self.0 ^ other.turned(k)).count_ones()).min().unwrap_or(0)
    }

    fn longest_run(self) -> u32 {
        // A change is a one in the word against itself turned by one frame; runs are what lies between changes.
        let changes = self.0 ^ self.turned(1);
        if changes == 0 {
            return LENGTH as u32;
        }
        let start = changes.trailing_zeros() as usize;
        let turned = (changes >> start | changes << (LENGTH - start)) & MASK;
        let (mut longest, mut run) = (0, 0);
        for k in 1..=LENGTH {
            run += 1;
            if k == LENGTH || turned >> k & 1 == 1 {
                longest = longest.max(run);
                run = 0;
            }
        }
        longest
    }
}

static BOOK: LazyLock<Vec<Word>> = LazyLock::new(|| {
    let mut words: Vec<Word> = Vec::with_capacity(WORDS);
    for bits in 0..=MASK {
        let word = Word(bits);
        // Of a word and its turns only the smallest is looked at: it begins with the longest run of dim.
        let is_first = || (1..LENGTH).all(|k| word.turned(k) >= bits);
        if bits.count_ones() as usize == LENGTH / 2
            && word.longest_run() <= LONGEST_RUN
            && is_first()
            && (1..LENGTH).all(|k| word.turned(k) != bits)
            && words.iter().all(|w| w.distance(word) >= LEAST_DISTANCE)
        {
            words.push(word);
            if words.len() == WORDS {
                break;
            }
        }
    }
    words
});

/// All words; a marker's identity is its word's place.
pub fn book() -> &'static [Word] {
    &BOOK
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_differ_at_every_phase_and_their_bits_change_often() {
        assert!(book().len() == WORDS, "{}", book().len());
        for (k, word) in book().iter().enumerate() {
            assert_eq!(word.0.count_ones() as usize, LENGTH / 2);
            let bits: Vec<bool> = (0..2 * LENGTH).map(|f| word.is_bright(f)).collect();
            let longest = bits.chunk_by(|a, b| a == b).map(<[bool]>::len).max().unwrap();
            assert!(longest <= LONGEST_RUN as usize);
            for other in &book()[..k] {
                assert!(word.distance(*other) >= LEAST_DISTANCE);
            }
        }
    }

    #[test]
    fn the_book_never_changes() {
        let sum = book()
            .iter()
            .enumerate()
            .fold(0_u64, |s, (k, w)| s.wrapping_mul(31).wrapping_add(u64::from(w.0) + k as u64));
        assert_eq!((book()[0].0, sum), (268_255, 14_223_857_686_440_130_198));
    }
}
