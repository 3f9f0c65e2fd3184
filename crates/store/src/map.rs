//! Read-only memory windows on files: the only `unsafe` code of the store.
//!
//! A memory map has two risks that reading with system calls doesn't have. First, the file may change while it is
//! mapped. Second, access to a page that the file no longer has (because the file was truncated, or the disk failed)
//! raises SIGBUS, which kills the process. This module handles both risks:
//!
//! - Every window is entered into a table of address ranges. A SIGBUS handler, installed with the first window, looks
//!   up the faulting address. If it lies in a window, the handler maps a page of zeros at the address and marks the
//!   window. The reader continues, and [`Window::check`] reports the fault afterwards. If the address lies outside all
//!   windows, the handler restores the previous SIGBUS handler and returns, so that the access faults again under the
//!   previous handler.
//! - [`Window::check`] fails after use if a page was missing or the file's size or modification time has changed.
//!   Results computed from a window are valid only once this check has passed.
//!
//! A window gives access only to types for which every bit pattern is valid: bytes, integers and floating-point
//! numbers. If a file changes while it is mapped, the values may be wrong, and the check then rejects them; they are
//! never undefined behaviour.

#![allow(unsafe_code)]

use std::io;
use std::sync::Once;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use memmap2::{Advice, Mmap, MmapOptions};

use crate::error::StoreError;
use crate::source::Source;

/// A range of a file's bytes, mapped read-only.
#[derive(Debug)]
pub(crate) struct Window {
    map: Mmap,
    slot: usize,
}

impl Window {
    /// Maps `len > 0` bytes from `offset` on; the offset need not be page-aligned.
    pub(crate) fn new(source: &Source, offset: u64, len: usize) -> Result<Self, StoreError> {
        install_handler();
        // SAFETY: the map is read-only and private to this type. The file may change or shrink meanwhile, which is
        // handled as described at the head of the module: bytes are only read as plain numbers, missing pages become
        // zeros, and `check` rejects the values read.
        let map = unsafe { MmapOptions::new().offset(offset).len(len).map(source.file()) }
            .map_err(StoreError::io(source.path(), "cannot map"))?;
        let start = map.as_ptr() as usize;
        let slot = claim_slot(start, start + len).ok_or_else(|| {
            StoreError::io(source.path(), "cannot map")(io::Error::other("too many windows are open at once"))
        })?;
        Ok(Self { map, slot })
    }

    pub(crate) fn bytes(&self) -> &[u8] {
        &self.map
    }

    /// Asks the system to start reading a range of the window from disk. A hint: failure is ignored.
    pub(crate) fn will_need(&self, offset: usize, len: usize) {
        let _ = self.map.advise_range(Advice::WillNeed, offset, len);
    }

    /// Maps all pages of a range with one system call, which costs less than one page fault per page. A hint: failure
    /// is ignored.
    #[cfg(target_os = "linux")]
    pub(crate) fn populate(&self, offset: usize, len: usize) {
        let _ = self.map.advise_range(Advice::PopulateRead, offset, len);
    }

    #[cfg(not(target_os = "linux"))]
    pub(crate) fn populate(&self, offset: usize, len: usize) {
        self.will_need(offset, len);
    }

    /// Fails if a page was missing when it was accessed, or if the file has changed since it was opened.
    pub(crate) fn check(&self, source: &Source) -> Result<(), StoreError> {
        if SLOTS[self.slot].faulted.load(Ordering::Acquire) {
            return Err(StoreError::ChangedWhileRead { path: source.path().to_path_buf() });
        }
        source.check()
    }
}

impl Drop for Window {
    fn drop(&mut self) {
        // Release the slot first: once the memory is unmapped, the system may reuse its addresses. `map` is dropped
        // after this function.
        SLOTS[self.slot].release();
    }
}

/// Prefetches a range of memory into the L2 cache. The range has the size of `values` and starts `ahead` bytes after
/// the beginning of `values`. Useful because the processor's own prefetcher stops at page boundaries. A hint: the range
/// need not be mapped.
#[inline(always)]
pub fn prefetch<T>(values: &[T], ahead: isize) {
    #[cfg(target_arch = "x86_64")]
    {
        const LINE: usize = 64;
        let start = values.as_ptr().cast::<i8>().wrapping_offset(ahead);
        for at in (0..size_of_val(values)).step_by(LINE) {
            // SAFETY: a prefetch reads nothing that the program could see and never faults, whatever the address; SSE
            // is part of every x86-64.
            unsafe { std::arch::x86_64::_mm_prefetch::<{ std::arch::x86_64::_MM_HINT_T1 }>(start.wrapping_add(at)) };
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (values, ahead);
}

/// One mapped range, as read by the signal handler. Signal handlers must not lock or allocate, so all fields are
/// atomics.
struct Slot {
    /// 0 if the slot is free, 1 while it is being set up, otherwise the first address of the range.
    start: AtomicUsize,
    end: AtomicUsize,
    faulted: AtomicBool,
}

const FREE: usize = 0;
const CLAIMED: usize = 1;
/// Maximum number of open windows: enough for 64 threads with one window for each of 500 degrees. Operating systems
/// allow about 65,000 maps per process.
const SLOT_COUNT: usize = 32_768;

static SLOTS: [Slot; SLOT_COUNT] =
    [const { Slot { start: AtomicUsize::new(FREE), end: AtomicUsize::new(0), faulted: AtomicBool::new(false) } };
        SLOT_COUNT];

impl Slot {
    fn release(&self) {
        self.start.store(FREE, Ordering::Release);
    }

    fn holds(&self, address: usize) -> bool {
        let start = self.start.load(Ordering::Acquire);
        start > CLAIMED && (start..self.end.load(Ordering::Acquire)).contains(&address)
    }
}

fn claim_slot(start: usize, end: usize) -> Option<usize> {
    let claim = |slot: &Slot| slot.start.compare_exchange(FREE, CLAIMED, Ordering::AcqRel, Ordering::Relaxed).is_ok();
    let index = SLOTS.iter().position(claim)?;
    let slot = &SLOTS[index];
    slot.faulted.store(false, Ordering::Release);
    slot.end.store(end, Ordering::Release);
    slot.start.store(start, Ordering::Release);
    Some(index)
}

static INSTALL: Once = Once::new();
static PAGE: AtomicUsize = AtomicUsize::new(4096);
/// The SIGBUS handler installed before ours. It is never freed, because our handler may run at any time.
static PREVIOUS: std::sync::atomic::AtomicPtr<libc::sigaction> =
    std::sync::atomic::AtomicPtr::new(std::ptr::null_mut());

fn install_handler() {
    INSTALL.call_once(|| {
        PAGE.store(rustix::param::page_size(), Ordering::Relaxed);
        // SAFETY: both structures are plain data for which zeros are valid. The handler has the signature that
        // SA_SIGINFO requires and only does what is allowed in a signal handler: atomics, mmap and sigaction.
        unsafe {
            let previous = Box::leak(Box::new(std::mem::zeroed::<libc::sigaction>()));
            let mut action = std::mem::zeroed::<libc::sigaction>();
            action.sa_sigaction = on_bus_error as *const () as usize;
            action.sa_flags = libc::SA_SIGINFO | libc::SA_ONSTACK | libc::SA_NODEFER;
            libc::sigemptyset(&mut action.sa_mask);
            libc::sigaction(libc::SIGBUS, std::ptr::null(), previous);
            PREVIOUS.store(previous, Ordering::Release);
            libc::sigaction(libc::SIGBUS, &action, std::ptr::null_mut());
        }
    });
}

extern "C" fn on_bus_error(_signal: libc::c_int, info: *mut libc::siginfo_t, _context: *mut libc::c_void) {
    // SAFETY: the system passes a valid siginfo_t to a handler with SA_SIGINFO.
    let address = unsafe { (*info).si_addr() } as usize;
    for slot in &SLOTS {
        if slot.holds(address) {
            slot.faulted.store(true, Ordering::Release);
            if put_zero_page(address) {
                return;
            }
        }
    }
    let previous = PREVIOUS.load(Ordering::Acquire);
    // SAFETY: `previous` was stored by sigaction before this handler was installed. After it is restored, the faulting
    // access is repeated and handled by the previous handler.
    unsafe { libc::sigaction(libc::SIGBUS, previous, std::ptr::null_mut()) };
}

fn put_zero_page(address: usize) -> bool {
    let page = PAGE.load(Ordering::Relaxed);
    let start = address & !(page - 1);
    let flags = libc::MAP_PRIVATE | libc::MAP_ANONYMOUS | libc::MAP_FIXED;
    // SAFETY: `start` lies in a window of this process, which stays mapped while its slot is taken. Readers of a window
    // are prepared for pages replaced by zeros.
    let result = unsafe { libc::mmap(start as *mut libc::c_void, page, libc::PROT_READ, flags, -1, 0) };
    result != libc::MAP_FAILED
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_truncated_under_a_window_reads_as_zeros_and_is_reported() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let len = 64 * 4096;
        std::fs::write(file.path(), vec![7u8; len]).unwrap();
        let source = Source::open(file.path()).unwrap();
        let window = Window::new(&source, 0, len).unwrap();
        assert_eq!(window.bytes()[len - 1], 7);
        window.check(&source).unwrap();
        file.as_file().set_len(4096).unwrap();
        let sum: u64 = window.bytes().iter().map(|&b| u64::from(b)).sum();
        assert_eq!(sum, 7 * 4096);
        assert!(SLOTS[window.slot].faulted.load(Ordering::Acquire));
        assert!(matches!(window.check(&source), Err(StoreError::ChangedWhileRead { .. })));
    }

    #[test]
    fn a_slot_holds_its_addresses_alone_and_only_while_it_is_taken() {
        let slot = |start: usize| Slot { start: start.into(), end: 0x3000.into(), faulted: false.into() };
        let taken = slot(0x1000);
        let held: Vec<usize> = (0..0x5000).step_by(0x800).filter(|&at| taken.holds(at)).collect();
        assert_eq!(held, [0x1000, 0x1800, 0x2000, 0x2800]);
        assert!(taken.holds(0x2fff) && !taken.holds(0xfff) && !taken.holds(0x3000));
        taken.release();
        for slot in [taken, slot(FREE), slot(CLAIMED)] {
            assert!((0..0x5000).step_by(0x800).chain([1]).all(|at| !slot.holds(at)));
        }
    }

    #[test]
    fn windows_share_no_slot_and_give_theirs_back() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), [7u8; 8192]).unwrap();
        let source = Source::open(file.path()).unwrap();
        let [first, second] = [0, 4096].map(|offset| Window::new(&source, offset, 4096).unwrap());
        assert_ne!(first.slot, second.slot);
        for window in [&first, &second] {
            let start = window.bytes().as_ptr() as usize;
            assert!(SLOTS[window.slot].holds(start) && SLOTS[window.slot].holds(start + 4095));
            assert!(!SLOTS[window.slot].holds(start + 4096));
        }
        let (slot, start) = (first.slot, first.bytes().as_ptr() as usize);
        drop(first);
        assert!(!SLOTS[slot].holds(start) || SLOTS[slot].start.load(Ordering::Acquire) == FREE);
    }

    #[test]
    fn a_file_written_to_is_reported() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), [7u8; 4096]).unwrap();
        let source = Source::open(file.path()).unwrap();
        let window = Window::new(&source, 0, 4096).unwrap();
        std::thread::sleep(std::time::Duration::from_millis(20));
        std::fs::write(file.path(), [8u8; 4096]).unwrap();
        assert!(window.check(&source).is_err());
    }
}
