//! The program's allocator: the system's allocator, which also counts for `bench` how often each thread requests
//! memory.

#![allow(unsafe_code)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

thread_local! {
    static REQUESTS: Cell<u64> = const { Cell::new(0) };
}

/// Requests for memory that this thread has made so far.
pub fn requests() -> u64 {
    REQUESTS.get()
}

fn count() {
    // A thread that is ending no longer has a counter.
    let _ = REQUESTS.try_with(|requests| requests.set(requests.get() + 1));
}

/// Passes everything on to [`System`].
pub struct Counting;

// SAFETY: every call goes to `System` unchanged; the counter is a plain cell of the thread and allocates nothing.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count();
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        unsafe { System.realloc(block, layout, size) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        unsafe { System.dealloc(block, layout) }
    }
}
