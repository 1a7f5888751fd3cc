//! Large buffers kept between operations: asking the system for fresh memory costs a page fault for every 4 KiB, a tenth
//! of a training step.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

/// Smaller buffers (values) are left to the allocator.
const SMALL: usize = 1 << 14;

/// Most values kept: 512 MiB.
const MOST: usize = 1 << 27;

static KEPT: Mutex<Kept> = Mutex::new(Kept { buffers: BTreeMap::new(), total: 0 });

/// A vector of `n` values, whatever they were.
pub(super) fn take(n: usize) -> Vec<f32> {
    kept(n).unwrap_or_else(|| vec![0.0; n])
}

/// A vector of `n` zeros.
pub(super) fn zeros(n: usize) -> Vec<f32> {
    kept(n).map_or_else(
        || vec![0.0; n],
        |mut buffer| {
            buffer.fill(0.0);
            buffer
        },
    )
}

fn kept(n: usize) -> Option<Vec<f32>> {
    (n >= SMALL).then(|| KEPT.lock().unwrap_or_else(PoisonError::into_inner).take(n)).flatten()
}

/// Keeps a vector's memory for [`take`]; when too much is kept, all of it is given back to the system.
pub(in super::super) fn give(buffer: Vec<f32>) {
    if buffer.capacity() >= SMALL {
        KEPT.lock().unwrap_or_else(PoisonError::into_inner).give(buffer);
    }
}

/// Buffers by capacity.
struct Kept {
    buffers: BTreeMap<usize, Vec<Vec<f32>>>,
    /// Sum of their capacities.
    total: usize,
}

impl Kept {
    /// `n` values in the smallest buffer with room for them: what lies idle at one scale of the network serves the others.
    fn take(&mut self, n: usize) -> Option<Vec<f32>> {
        let (&capacity, buffers) = self.buffers.range_mut(n..).next()?;
        let mut buffer = buffers.pop();
        if buffers.is_empty() {
            self.buffers.remove(&capacity);
        }
        self.total -= capacity;
        if let Some(buffer) = &mut buffer {
            buffer.resize(n, 0.0);
        }
        buffer
    }

    fn give(&mut self, buffer: Vec<f32>) {
        let n = buffer.capacity();
        if self.total + n > MOST {
            self.buffers.clear();
            self.total = 0;
        }
        if n <= MOST {
            self.buffers.entry(n).or_default().push(buffer);
            self.total += n;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_smallest_buffer_that_is_large_enough_comes_back() {
        let mut kept = Kept { buffers: BTreeMap::new(), total: 0 };
        let places = [300usize, 100, 200].map(|n| {
            let mut buffer = Vec::with_capacity(n);
            buffer.push(1.0);
            let place = buffer.as_ptr();
            kept.give(buffer);
            place
        });
        let mut take = |n| kept.take(n).map(|b| (b.as_ptr(), b.len(), b.capacity()));
        assert_eq!(take(301), None);
        assert_eq!(take(150), Some((places[2], 150, 200)));
        assert_eq!(take(150), Some((places[0], 150, 300)));
        assert_eq!(take(150), None);
        assert_eq!(take(100), Some((places[1], 100, 100)));
        assert_eq!((kept.total, kept.buffers.len()), (0, 0));
    }

    #[test]
    fn what_is_too_much_is_not_kept() {
        let mut kept = Kept { buffers: BTreeMap::new(), total: 0 };
        kept.give(Vec::with_capacity(MOST - 10));
        kept.give(Vec::with_capacity(10));
        assert_eq!(kept.total, MOST);
        kept.give(Vec::with_capacity(20));
        assert_eq!(kept.total, 20);
        assert!(kept.take(21).is_none());
    }
}
