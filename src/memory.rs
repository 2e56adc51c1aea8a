//! Memory that runs out in the middle of work.
//!
//! Forecasts refuse before any work what cannot be had ([`crate::Error::Memory`]). What they do not see comes to light here, in
//! vectors that may be large, or to an allocator, which ends the work by [`crate::progress::Progress`].

use crate::error::{Error, Result};

/// An empty vector that takes `count` elements.
pub(crate) fn room<T>(count: usize) -> Result<Vec<T>> {
    let mut values = Vec::new();
    values.try_reserve_exact(count).map_err(|_| Error::OutOfMemory)?;
    Ok(values)
}

/// `count` times the same.
pub(crate) fn filled<T: Clone>(count: usize, value: T) -> Result<Vec<T>> {
    let mut values = room(count)?;
    values.resize(count, value);
    Ok(values)
}
