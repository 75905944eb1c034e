//! An allocator that counts, so that "no allocation per frame" can be seen from outside.

use std::{
    alloc::{GlobalAlloc, Layout, System},
    cell::Cell,
    ptr,
    sync::atomic::{AtomicU64, Ordering},
};

/// What this process has taken from the heap since its start.
static ALLOCATIONS: AtomicU64 = AtomicU64::new(0);

/// The system's allocator, counting the calls that take memory from the heap; `netcord` installs it as its global
/// allocator. One relaxed addition for each.
///
/// Small blocks that a thread gives back wait in its pocket, a few of each size, and are what it gets when it next
/// asks for as much: that never reaches the heap, so it is not counted. This is for iceoryx2, which makes a small
/// reference count whenever a slot of shared memory is loaned (0.10, `port/details/chunk_mut_shared_state.rs`): in
/// the steady state each loan finds the last one's block, without a lock, in the same time always.
#[derive(Debug, Clone, Copy, Default)]
pub struct CountingAllocator;

/// Allocations of this process so far; stays 0 where [`CountingAllocator`] is not installed.
pub fn allocations() -> u64 {
    ALLOCATIONS.load(Ordering::Relaxed)
}

/// Sizes of blocks in the pocket are multiples of this, bytes.
const STEP: usize = 64;
/// Sizes that there are: what iceoryx2 asks for has 100 to 300 bytes.
const SIZES: usize = 8;
/// Blocks of one size: slots of a stage that are on loan at a time.
const DEPTH: usize = 4;
/// What the heap gives without being asked for more.
const ALIGN: usize = 16;

thread_local! {
    /// A thread that ends leaves its pocket's blocks behind: 8 KB at most.
    static POCKET: [[Cell<*mut u8>; DEPTH]; SIZES] =
        const { [const { [const { Cell::new(ptr::null_mut()) }; DEPTH] }; SIZES] };
}

/// The place of a block's size in the pocket, and the layout that all blocks there have.
fn size_class(layout: &Layout) -> Option<(usize, Layout)> {
    let class = layout.size().div_ceil(STEP);
    if class == 0 || class > SIZES || layout.align() > ALIGN {
        return None;
    }
    Some((class - 1, Layout::from_size_align(class * STEP, ALIGN).ok()?))
}

// SAFETY: a block is either the system's for this layout, handed through unchanged, or, for small layouts, the
// system's for its size class, which is at least as large and aligned. Which of the two it is follows from the layout
// alone, which callers repeat when they give a block back. A block in a pocket belongs to no caller.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let Some((class, layout)) = size_class(&layout) else {
            ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
            // SAFETY: the caller keeps GlobalAlloc's contract, which is the system's.
            return unsafe { System.alloc(layout) };
        };
        // A thread that is ending may have no pocket any more.
        let kept = POCKET.try_with(|pocket| {
            let full = pocket[class].iter().find(|place| !place.get().is_null());
            full.map(|place| place.replace(ptr::null_mut()))
        });
        if let Ok(Some(block)) = kept {
            return block;
        }
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the size is not zero.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        let Some((class, layout)) = size_class(&layout) else {
            // SAFETY: as for alloc; the pointer came from the system's allocator with this layout.
            return unsafe { System.dealloc(pointer, layout) };
        };
        let kept = POCKET.try_with(|pocket| {
            let empty = pocket[class].iter().find(|place| place.get().is_null());
            empty.map(|place| place.set(pointer))
        });
        if !matches!(kept, Ok(Some(()))) {
            // SAFETY: the pointer came from the system's allocator with its class's layout.
            unsafe { System.dealloc(pointer, layout) }
        }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        if size_class(&layout).is_none() {
            ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
            // SAFETY: as for alloc.
            return unsafe { System.alloc_zeroed(layout) };
        }
        // SAFETY: as for alloc.
        let block = unsafe { self.alloc(layout) };
        if !block.is_null() {
            // SAFETY: the block is that long, and the caller's.
            unsafe { block.write_bytes(0, layout.size()) };
        }
        block
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: the caller says that `size`, rounded up to the alignment, does not overflow.
        let wanted = unsafe { Layout::from_size_align_unchecked(size, layout.align()) };
        match (size_class(&layout), size_class(&wanted)) {
            (None, None) => {
                ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
                // SAFETY: as for dealloc and alloc.
                unsafe { System.realloc(pointer, layout, size) }
            }
            (Some((old, _)), Some((new, _))) if old == new => pointer,
            _ => {
                // SAFETY: as for alloc; both blocks are at least as long as what is copied, and differ.
                unsafe {
                    let block = self.alloc(wanted);
                    if !block.is_null() {
                        ptr::copy_nonoverlapping(pointer, block, layout.size().min(size));
                        self.dealloc(pointer, layout);
                    }
                    block
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_that_is_given_back_is_what_the_next_call_of_its_size_gets() {
        let a = CountingAllocator;
        let layout = Layout::from_size_align(200, 8).expect("valid");
        // SAFETY: every block is used within its size, and given back once with its layout.
        unsafe {
            let first = a.alloc(layout);
            a.dealloc(first, layout);
            for _ in 0..100 {
                let other = Layout::from_size_align(250, 16).expect("valid");
                let block = a.alloc_zeroed(other);
                assert_eq!(block, first);
                assert!(std::slice::from_raw_parts(block, 250).iter().all(|b| *b == 0));
                block.write_bytes(7, 250);
                a.dealloc(block, other);
            }
        }
    }

    #[test]
    fn contents_survive_growth_and_shrinking_across_sizes() {
        let a = CountingAllocator;
        let at = |size| Layout::from_size_align(size, 8).expect("valid");
        // SAFETY: every block is used within its size, and given back once with its layout.
        unsafe {
            let mut block = a.alloc(at(60));
            for i in 0..60 {
                block.add(i).write(i as u8);
            }
            let mut size = 60;
            for next in [64, 65, 500, 513, 5000, 4000, 300, 60] {
                block = a.realloc(block, at(size), next);
                size = next;
                assert!((0..60).all(|i| block.add(i).read() == i as u8), "at {next}");
            }
            a.dealloc(block, at(size));
        }
    }
}
