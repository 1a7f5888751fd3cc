//! The allocator of the programs: where the system refuses memory, one line and the exit code of bad input in place of an abort.

use std::alloc::{GlobalAlloc, Layout, System};
use std::io::Write;

/// The system's allocator, which ends the program with exit code 2 where there is no memory left. Of programs alone: a library's caller decides for itself.
#[derive(Debug)]
pub struct Refusing;

// SAFETY: every call is handed to `System` as it came, so its contract holds; what is added takes no part in memory, and where it acts it does not return.
#[expect(unsafe_code, reason = "an allocator is unsafe to implement; it hands every call on")]
unsafe impl GlobalAlloc for Refusing {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller's promise for this call.
        there(unsafe { System.alloc(layout) }, layout.size())
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller's promise for this call.
        there(unsafe { System.alloc_zeroed(layout) }, layout.size())
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: the caller's promise for this call.
        there(unsafe { System.realloc(pointer, layout, size) }, size)
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise for this call.
        unsafe { System.dealloc(pointer, layout) }
    }
}

fn there(pointer: *mut u8, size: usize) -> *mut u8 {
    if pointer.is_null() {
        refuse(size);
    }
    pointer
}

/// Says so without asking for memory, and ends the program.
#[cold]
fn refuse(size: usize) -> ! {
    let mut line = [0u8; 160];
    let room = line.len();
    let mut rest = &mut line[..];
    // What does not fit is cut.
    let _ = writeln!(
        rest,
        "error: memory: {size} bytes more were refused by the system; a larger limit (--memory-gib) or smaller work"
    );
    let written = room - rest.len();
    let _ = std::io::stderr().write_all(&line[..written]);
    std::process::exit(2);
}
