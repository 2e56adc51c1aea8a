//! How far a long computation has come, and the wish to stop it: shared between the one who works and the one who waits.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use crate::error::{Error, Result};

/// Counters that the worker raises and the waiting side reads; flags that go the other way.
#[derive(Debug, Default)]
pub struct Progress {
    done: AtomicU64,
    total: AtomicU64,
    stop: AtomicBool,
    out_of_memory: Option<&'static AtomicBool>,
}

impl Progress {
    /// Of work that also ends when the flag says that the memory has run out.
    pub fn that_watches(out_of_memory: &'static AtomicBool) -> Progress {
        Progress { out_of_memory: Some(out_of_memory), ..Progress::default() }
    }

    /// Work items finished so far, and how many there are as far as is known.
    pub fn get(&self) -> (u64, u64) {
        (self.done.load(Ordering::Relaxed), self.total.load(Ordering::Relaxed))
    }

    /// Asks the worker to stop soon.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// Announces `items` more to do.
    pub fn expect(&self, items: u64) {
        self.total.fetch_add(items, Ordering::Relaxed);
    }

    /// Records `items` as done.
    ///
    /// # Errors
    /// [`Error::Interrupted`] once the other side has asked to stop, [`Error::OutOfMemory`].
    pub fn advance(&self, items: u64) -> Result<()> {
        self.done.fetch_add(items, Ordering::Relaxed);
        if self.out_of_memory.is_some_and(|flag| flag.load(Ordering::Relaxed)) {
            return Err(Error::OutOfMemory);
        }
        if self.stop.load(Ordering::Relaxed) { Err(Error::Interrupted) } else { Ok(()) }
    }
}
