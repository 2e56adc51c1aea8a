//! Whatever comes from outside: the cases that the fuzzer has kept, and some thousand random ones.

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use crate::common::{Random, on_threads};
use crate::fuzz_case::run;

/// A case of a dozen patches takes milliseconds; a machine that is busy with other things is allowed a thousandfold.
const MOST: Duration = Duration::from_secs(10);

fn run_in_time(bytes: &[u8], name: &str) {
    let start = Instant::now();
    // Inside the pool: from outside, each of the thousands of small loops of a case would change threads twice.
    on_threads(2, || run(bytes));
    assert!(start.elapsed() < MOST, "{name} took {:?}", start.elapsed());
}

#[test]
fn the_corpus_neither_panics_nor_hangs() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/corpus/core");
    let mut count = 0;
    for entry in fs::read_dir(&folder).unwrap() {
        let path = entry.unwrap().path();
        run_in_time(&fs::read(&path).unwrap(), &path.display().to_string());
        count += 1;
    }
    assert!(count > 100, "{count} files in {}", folder.display());
}

#[test]
fn random_bytes_neither_panic_nor_hang() {
    let random = Random::new(9);
    for k in 0..3000 {
        let bytes: Vec<u8> = (0..random.below(600)).map(|_| random.below(256) as u8).collect();
        run_in_time(&bytes, &format!("case {k}"));
    }
}
