//! Large arrays in large pages, and their memory kept for the next ones.
//!
//! A fit makes and drops arrays of megabytes in every step. By default the C library gives the end of its heap back to the
//! system as soon as it is free, and takes it again a moment later: each page of 4 KiB is then a fault and has to be cleared,
//! a quarter of the time of a small fit. So up to [`KEPT`] bytes stay in the heap, and arrays from [`LARGE`] bytes on ask for pages
//! of 2 MiB where the system grants them on request (`/sys/kernel/mm/transparent_hugepage/enabled`: `madvise`, the default of most
//! distributions). Neither takes more memory than before at its peak but for the rest of a page.
//!
//! As with the [kernels](crate::kernels), that is for programs to choose, not for libraries.

#![allow(unsafe_code)]

use std::alloc::{GlobalAlloc, Layout, System};

/// Bytes from which on an array asks for large pages: it has some of them wholly.
const LARGE: usize = 4 << 20;

/// A large page.
const PAGE: usize = 2 << 20;

/// Bytes of arrays that get a mapping of their own, which goes back to the system with them.
const MAPPED: libc::c_int = 32 << 20;

/// Free bytes at the end of the heap that aren't given back.
const KEPT: libc::c_int = 64 << 20;

/// Runs before `main`.
#[used]
#[unsafe(link_section = ".init_array.00200")]
static KEEP_MEMORY: extern "C" fn() = keep_memory;

/// Whoever has set the C library's variables knows better than this.
extern "C" fn keep_memory() {
    // SAFETY: the texts end in a zero, `mallopt` takes numbers, and no other thread runs before `main`.
    unsafe {
        let set = |name: &std::ffi::CStr| !libc::getenv(name.as_ptr()).is_null();
        if set(c"MALLOC_MMAP_THRESHOLD_") || set(c"MALLOC_TRIM_THRESHOLD_") || set(c"GLIBC_TUNABLES") {
            return;
        }
        libc::mallopt(libc::M_MMAP_THRESHOLD, MAPPED);
        libc::mallopt(libc::M_TRIM_THRESHOLD, KEPT);
    }
}

struct LargePages;

#[global_allocator]
static ALLOCATOR: LargePages = LargePages;

/// Asks for large pages within an array. What the system doesn't grant changes nothing.
fn advise(array: *mut u8, bytes: usize) {
    if bytes < LARGE || array.is_null() {
        return;
    }
    let before = array.align_offset(PAGE);
    let within = bytes.saturating_sub(before) / PAGE * PAGE;
    if within > 0 {
        // SAFETY: the range lies within the array, which is this program's; the advice doesn't change what is in it.
        unsafe { libc::madvise(array.wrapping_add(before).cast(), within, libc::MADV_HUGEPAGE) };
    }
}

// SAFETY: all memory is the system allocator's, which is given what this is given.
unsafe impl GlobalAlloc for LargePages {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller's promises are those of `System`.
        let array = unsafe { System.alloc(layout) };
        advise(array, layout.size());
        array
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as above.
        let array = unsafe { System.alloc_zeroed(layout) };
        advise(array, layout.size());
        array
    }

    unsafe fn dealloc(&self, array: *mut u8, layout: Layout) {
        // SAFETY: as above; the array is one of `System`'s.
        unsafe { System.dealloc(array, layout) };
    }

    unsafe fn realloc(&self, array: *mut u8, layout: Layout, bytes: usize) -> *mut u8 {
        // SAFETY: as above.
        let array = unsafe { System.realloc(array, layout, bytes) };
        advise(array, bytes);
        array
    }
}
