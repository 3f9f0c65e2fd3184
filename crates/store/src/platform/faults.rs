//! Lets a process survive access to missing pages of mapped files. Such an access, for example to a page after the end
//! of a truncated file, raises SIGBUS, which would kill the process.
//!
//! Every guarded range of addresses is entered into a table. A SIGBUS handler, installed with the first range, looks up
//! the faulting address. If the address lies in a range, the handler maps a page of zeros at the address and marks the
//! range. The reader continues, and [`FaultGuard::faulted`] reports the fault afterwards. If the address lies outside
//! all ranges, the handler restores the previous SIGBUS handler and returns, so that the access faults again under the
//! previous handler.

#![allow(unsafe_code)]

use std::sync::Once;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Guards a mapped range of addresses. Drop the guard before the range is unmapped, because the system may reuse the
/// addresses after that.
#[derive(Debug)]
pub(crate) struct FaultGuard {
    slot: usize,
}

impl FaultGuard {
    /// Guards the addresses from `start` to `end`, exclusive. Returns `None` if too many ranges are guarded already.
    pub(crate) fn new(start: usize, end: usize) -> Option<Self> {
        install_handler();
        Some(Self { slot: claim_slot(start, end)? })
    }

    /// Returns whether a page of the range was missing when it was accessed.
    pub(crate) fn faulted(&self) -> bool {
        SLOTS[self.slot].faulted.load(Ordering::Acquire)
    }
}

impl Drop for FaultGuard {
    fn drop(&mut self) {
        SLOTS[self.slot].release();
    }
}

/// One mapped range, as read by the signal handler. Signal handlers must not lock or allocate, so all fields are
/// atomics.
struct Slot {
    /// 0 if the slot is free, 1 while it is being set up, otherwise the first address of the mapped range.
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
    // check afterwards whether a page was replaced by zeros.
    let result = unsafe { libc::mmap(start as *mut libc::c_void, page, libc::PROT_READ, flags, -1, 0) };
    result != libc::MAP_FAILED
}

#[cfg(test)]
mod tests {
    use super::*;

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
    fn guards_share_no_slot_and_give_theirs_back() {
        let memory = [0u8; 64];
        let start = memory.as_ptr() as usize;
        let [first, second] = [0, 32].map(|at| FaultGuard::new(start + at, start + at + 32).unwrap());
        assert_ne!(first.slot, second.slot);
        for (guard, start) in [(&first, start), (&second, start + 32)] {
            assert!(SLOTS[guard.slot].holds(start) && SLOTS[guard.slot].holds(start + 31));
            assert!(!SLOTS[guard.slot].holds(start + 32));
        }
        let slot = first.slot;
        drop(first);
        assert!(!SLOTS[slot].holds(start) || SLOTS[slot].start.load(Ordering::Acquire) == FREE);
    }
}
