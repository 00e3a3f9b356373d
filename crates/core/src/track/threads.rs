//! Work of one frame shared out among threads, where there is enough of it.

use rayon::prelude::*;

/// Sights (of a marker, by a camera) from which on sharing them out among threads pays.
const WORTH_SHARING: usize = 4000;

/// What `one` makes of each item, in order; shared out if the items stand for enough `sights` together.
pub fn map<T: Send, R: Send>(items: Vec<T>, sights: usize, one: impl Fn(T) -> R + Sync + Send) -> Vec<R> {
    if sights < WORTH_SHARING { items.into_iter().map(one).collect() } else { items.into_par_iter().map(one).collect() }
}
