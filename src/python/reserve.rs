//! Memory that runs out in the middle of work: an error, not the end of the process.
//!
//! Forecasts refuse before any work what cannot be had. What they do not see is left to this file: a limit on the address
//! space, of which threads take their part, or another process that takes the memory meanwhile. Rust ends the process when
//! an allocation fails, and stable Rust knows no other way. So the first import sets a block aside. When the system refuses
//! memory, all work is told to stop at its next report of progress, and lives until then on what is cut from that block; what
//! does not fit waits a little for others to end.
//!
//! The block is cut from one end to the other, and is whole again when everything cut from it has been given back. A single
//! allocation larger than the block still ends the process where the system refuses it: such are forecast, or asked for by
//! [`crate::memory::room`].

use std::alloc::{GlobalAlloc, Layout, System};
use std::ptr::{copy_nonoverlapping, null_mut};
use std::sync::atomic::{AtomicBool, AtomicPtr, AtomicU64, Ordering};
use std::thread::sleep;
use std::time::Duration;

/// Of the block, which takes addresses only until it is needed.
const SIZE: usize = 40 << 20;
/// Work begins with at least so much of it.
const LEAST: usize = SIZE / 2;
/// How often, and after what time, an allocation that the block cannot serve is tried again.
const TRIES: usize = 100;
const PAUSE: Duration = Duration::from_millis(10);

/// Whether the system has refused memory, so that all work must end.
pub(super) static OUT: AtomicBool = AtomicBool::new(false);

static BLOCK: AtomicPtr<u8> = AtomicPtr::new(null_mut());
/// Bytes cut from the block (lower half), and the pieces of it that are in use (upper half).
static CUT: AtomicU64 = AtomicU64::new(0);
const ONE_PIECE: u64 = 1 << 32;

/// The system's allocator with the block behind it.
struct Reserved;

#[global_allocator]
static ALLOCATOR: Reserved = Reserved;

/// Makes sure that there is a block with enough left of it; false where the system has not even that.
pub(super) fn hold() -> bool {
    if BLOCK.load(Ordering::Acquire).is_null() {
        let layout = Layout::new::<[u8; SIZE]>();
        // SAFETY: the layout is not empty.
        let block = unsafe { System.alloc(layout) };
        if block.is_null() {
            return false;
        }
        if BLOCK.compare_exchange(null_mut(), block, Ordering::AcqRel, Ordering::Acquire).is_err() {
            // Another thread was faster.
            // SAFETY: made above with this layout, and known to nobody else.
            unsafe { System.dealloc(block, layout) };
        }
    }
    let has_enough = CUT.load(Ordering::Acquire) as u32 as usize <= SIZE - LEAST;
    if has_enough {
        OUT.store(false, Ordering::Relaxed);
    }
    has_enough
}

/// Whether this is a piece of the block.
fn is_piece(pointer: *mut u8) -> bool {
    let block = BLOCK.load(Ordering::Acquire);
    !block.is_null() && (pointer as usize).wrapping_sub(block as usize) < SIZE
}

/// A piece of the block, null where none is left that fits.
fn cut(layout: Layout) -> *mut u8 {
    let block = BLOCK.load(Ordering::Acquire);
    if block.is_null() {
        return null_mut();
    }
    let mut before = CUT.load(Ordering::Acquire);
    loop {
        let from = block as usize + before as u32 as usize;
        let at = from.next_multiple_of(layout.align()) - block as usize;
        let Some(end) = at.checked_add(layout.size()).filter(|end| *end <= SIZE) else { return null_mut() };
        let after = (before >> 32 << 32) + ONE_PIECE + end as u64;
        match CUT.compare_exchange_weak(before, after, Ordering::AcqRel, Ordering::Acquire) {
            // Inside the block, which is never given back.
            Ok(_) => return block.wrapping_add(at),
            Err(now) => before = now,
        }
    }
}

/// Takes a piece back; the last one makes the block whole.
fn give_back() {
    let less = |before: u64| Some(if before >> 32 == 1 { 0 } else { before - ONE_PIECE });
    // It always succeeds: the closure never says `None`.
    let _ = CUT.fetch_update(Ordering::AcqRel, Ordering::Acquire, less);
}

/// What the system has refused: from the block, or from the system once others have ended.
#[cold]
fn insist(layout: Layout) -> *mut u8 {
    if layout.size() > SIZE {
        return null_mut();
    }
    OUT.store(true, Ordering::Relaxed);
    for _ in 0..TRIES {
        let piece = cut(layout);
        if !piece.is_null() {
            return piece;
        }
        // SAFETY: the layout is that of an allocation, which is not empty.
        let found = unsafe { System.alloc(layout) };
        if !found.is_null() {
            return found;
        }
        sleep(PAUSE);
    }
    null_mut()
}

// SAFETY: blocks come from the system's allocator or are pieces of the block, which do not overlap: CUT moves on with every
// piece, and back to the start only when none is in use. Nothing here allocates or unwinds.
unsafe impl GlobalAlloc for Reserved {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller's promise, that the layout is not empty, passed on.
        let found = unsafe { System.alloc(layout) };
        if found.is_null() { insist(layout) } else { found }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as above.
        let found = unsafe { System.alloc_zeroed(layout) };
        if !found.is_null() {
            return found;
        }
        let found = insist(layout);
        if !found.is_null() {
            // SAFETY: `insist` has found so many bytes.
            unsafe { found.write_bytes(0, layout.size()) };
        }
        found
    }

    unsafe fn realloc(&self, old: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        if !is_piece(old) {
            // SAFETY: the caller's promises, passed on: this allocation is the system's.
            let found = unsafe { System.realloc(old, layout, size) };
            if !found.is_null() {
                return found;
            }
        }
        // SAFETY: the caller promises that the size fits the alignment.
        let wanted = unsafe { Layout::from_size_align_unchecked(size, layout.align()) };
        // SAFETY: the caller promises that the size is not zero.
        let found = unsafe { self.alloc(wanted) };
        if !found.is_null() {
            // SAFETY: two allocations that do not overlap, each at least so long; the old one is given back as it was made.
            unsafe {
                copy_nonoverlapping(old, found, layout.size().min(size));
                self.dealloc(old, layout);
            }
        }
        found
    }

    unsafe fn dealloc(&self, old: *mut u8, layout: Layout) {
        if is_piece(old) {
            give_back();
        } else {
            // SAFETY: the caller's promises, passed on: this allocation is the system's.
            unsafe { System.dealloc(old, layout) };
        }
    }
}
