//! Numbers that an operator reads and never changes: its own, or in memory that its caller keeps, such as a mapped file.

use std::fmt::{Debug, Formatter};
use std::ops::Deref;
use std::sync::Arc;

/// A row of numbers; a copy of it is the same memory.
#[derive(Clone)]
pub struct Numbers(Arc<dyn AsRef<[f64]> + Send + Sync>);

impl Numbers {
    /// Those of whatever keeps them.
    pub fn of(owner: impl AsRef<[f64]> + Send + Sync + 'static) -> Numbers {
        Numbers(Arc::new(owner))
    }
}

impl Deref for Numbers {
    type Target = [f64];

    fn deref(&self) -> &[f64] {
        (*self.0).as_ref()
    }
}

impl Debug for Numbers {
    fn fmt(&self, out: &mut Formatter<'_>) -> std::fmt::Result {
        write!(out, "Numbers({})", self.len())
    }
}
