//! Everything that can go wrong, in one type.
//!
//! Input is validated once, at the door, and every problem found is reported together: a user with a bad mesh wants
//! the whole list, not the first line of it.

/// The result of anything in this crate that can fail.
pub type Result<T> = std::result::Result<T, Error>;

/// What went wrong, in words that name the patch, the value and the allowed range.
#[derive(Debug, Clone, thiserror::Error)]
pub enum Error {
    /// Input outside its allowed range; the text holds one problem a line.
    #[error("{0}")]
    Invalid(String),

    /// The answer would need more memory than the machine can be expected to have.
    #[error("{what} needs {} but only {} can be used; {remedy}", human_bytes(*needed), human_bytes(*available))]
    Memory {
        /// What was to be stored.
        what: String,
        /// Bytes that it needs.
        needed: u64,
        /// Bytes that can be had.
        available: u64,
        /// What to do instead.
        remedy: String,
    },

    /// The memory has run out in the middle of the work, before the forecast.
    #[error("the memory has run out; use fewer patches (a larger max_edge), fewer pixels or a looser tolerance")]
    OutOfMemory,

    /// The caller asked to stop.
    #[error("interrupted")]
    Interrupted,
}

impl Error {
    /// An [`Error::Invalid`] that lists the problems one a line; `Ok` when there are none.
    pub(crate) fn from_problems(problems: Vec<String>) -> Result<()> {
        if problems.is_empty() { Ok(()) } else { Err(Error::Invalid(problems.join("\n"))) }
    }
}

/// A byte count as a person says it: `1.5 GiB`.
fn human_bytes(bytes: u64) -> String {
    let mut value = bytes as f64;
    let mut unit = "B";
    for next in ["KiB", "MiB", "GiB", "TiB", "PiB"] {
        if value < 1024.0 {
            break;
        }
        value /= 1024.0;
        unit = next;
    }
    if unit == "B" { format!("{bytes} B") } else { format!("{value:.1} {unit}") }
}
