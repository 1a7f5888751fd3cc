//! Large buffers kept between operations: asking the system for fresh memory costs a page fault for every 4 KiB, a tenth
//! of a training step.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

/// Smaller buffers (values) are left to the allocator.
const SMALL: usize = 1 << 14;

/// Most values kept: 512 MiB.
const MOST: usize = 1 << 27;

/// Buffers by capacity, and the sum of their capacities.
type Kept = (HashMap<usize, Vec<Vec<f32>>>, usize);

static KEPT: Mutex<Option<Kept>> = Mutex::new(None);

/// An empty vector with room for `n` values.
pub(super) fn take(n: usize) -> Vec<f32> {
    if n >= SMALL {
        let mut kept = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((buffers, total)) = kept.as_mut()
            && let Some(buffer) = buffers.get_mut(&n).and_then(Vec::pop)
        {
            *total -= n;
            return buffer;
        }
    }
    Vec::with_capacity(n)
}

/// Keeps a vector's memory for [`take`]; when too much is kept, all of it is given back to the system.
pub(in super::super) fn give(mut buffer: Vec<f32>) {
    let n = buffer.capacity();
    if n < SMALL {
        return;
    }
    buffer.clear();
    let mut kept = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
    let (buffers, total) = kept.get_or_insert_default();
    if *total + n > MOST {
        buffers.clear();
        *total = 0;
    }
    if n <= MOST {
        buffers.entry(n).or_default().push(buffer);
        *total += n;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_buffer_comes_back_empty_and_only_at_its_size() {
        let n = SMALL + 12_345;
        let mut buffer = Vec::with_capacity(n);
        buffer.push(1.0);
        let at = buffer.as_ptr();
        give(buffer);
        let (other, again) = (take(n + 1), take(n));
        assert_ne!(other.as_ptr(), at);
        assert_eq!((again.as_ptr(), again.len(), again.capacity()), (at, 0, n));
    }
}
