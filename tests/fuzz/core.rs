//! The core under libFuzzer. What the bytes mean is told where the tests read them too.

#![no_main]

#[path = "../rust/fuzz_case.rs"]
mod fuzz_case;

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use rayon::{ThreadPool, ThreadPoolBuilder};

/// One thread, on which all runs: the same bytes always take the same way through the code.
static POOL: LazyLock<ThreadPool> = LazyLock::new(|| ThreadPoolBuilder::new().num_threads(1).build().unwrap());

fuzz_target!(|bytes: &[u8]| POOL.install(|| fuzz_case::run(bytes)));
