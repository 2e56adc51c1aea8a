//! Kernel x set x cost x error, and pairs a second of a whole room; run by `form_factor.py`, which writes the sets
//! (`RADIOSITY_PAIRS`, a folder of files of 19 f64 a pair: a, b, exact F_ab). The argument `kernels` leaves the first
//! table only.
//!
//! Times are CPU times of the one thread, medians. Errors are relative, of all pairs of a set or all rows of a room.
#![expect(clippy::print_stdout, clippy::expect_used, reason = "a bench prints, and stops at what is wrong")]

use std::hint::black_box;
use std::path::{Path, PathBuf};

use cpu_time::ThreadTime;
use radiosity::form_factor::{Accuracy, Batch, Kernel, Patch};
use radiosity::geometry::Vec3;
use radiosity::visibility::Instructions;

const RUNS: usize = 7;
/// A set is repeated until a run has so many pairs.
const PAIRS: usize = 20_000;

struct Set {
    name: String,
    a: Vec<Patch>,
    b: Vec<Patch>,
    exact: Vec<f64>,
}

fn read(path: &Path) -> Set {
    let bytes = std::fs::read(path).expect("a readable set");
    let numbers: Vec<f64> =
        bytes.chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().expect("eight bytes"))).collect();
    let patch = |row: &[f64], first: usize| {
        Patch::new(std::array::from_fn(|k| Vec3::from_slice(&row[first + 3 * k..first + 3 * k + 3])))
    };
    let rows: Vec<&[f64]> = numbers.chunks_exact(19).collect();
    Set {
        name: path.file_stem().expect("a name").to_string_lossy().into_owned(),
        a: rows.iter().map(|row| patch(row, 0)).collect(),
        b: rows.iter().map(|row| patch(row, 9)).collect(),
        exact: rows.iter().map(|row| row[18]).collect(),
    }
}

/// Median nanoseconds a pair, and the exchanges.
fn measure(
    a: &[Patch],
    b: &[Patch],
    pairs: &[[u32; 2]],
    accuracy: &Accuracy,
    instructions: Instructions,
) -> (f64, Vec<f64>) {
    let mut batch = Batch::with_instructions(instructions);
    let mut out = vec![0.0; pairs.len()];
    let repeats = PAIRS.div_ceil(pairs.len());
    let mut times: Vec<f64> = (0..RUNS)
        .map(|_| {
            let start = ThreadTime::now();
            for _ in 0..repeats {
                batch.exchange_pairs(a, b, pairs, accuracy, black_box(&mut out)).expect("a place a pair");
            }
            start.elapsed().as_secs_f64() * 1e9 / (repeats * pairs.len()) as f64
        })
        .collect();
    times.sort_by(f64::total_cmp);
    (times[RUNS / 2], out)
}

/// The sorted relative errors of a set.
fn errors(set: &Set, exchange: &[f64]) -> Vec<f64> {
    let mut errors: Vec<f64> = set
        .exact
        .iter()
        .zip(exchange)
        .zip(&set.a)
        .map(|((exact, g), a)| (g / a.area - exact).abs() / if *exact > 0.0 { *exact } else { 1.0 })
        .collect();
    errors.sort_by(f64::total_cmp);
    errors
}

fn kernels(sets: &[Set]) {
    println!("\nevery kernel on every set: ns a pair, median and worst relative error\n");
    print!("{:16}", "set");
    Kernel::ALL.iter().for_each(|kernel| print!(" {:>22}", kernel.name()));
    println!();
    for set in sets {
        let pairs: Vec<[u32; 2]> = (0..set.a.len() as u32).map(|k| [k, k]).collect();
        print!("{:16}", set.name);
        for kernel in Kernel::ALL {
            let (ns, out) =
                measure(&set.a, &set.b, &pairs, &Accuracy::by(kernel).expect("one of all"), Instructions::best());
            let errors = errors(set, &out);
            print!(" {ns:6.0} {:7.0e} {:7.0e}", errors[errors.len() / 2], errors[errors.len() - 1]);
        }
        println!();
    }
}

fn tolerances(sets: &[Set]) {
    println!("\nchosen kernels: pairs over the tolerance, worst error over tolerance, ns a pair\n");
    print!("{:16}", "set");
    const TOLERANCES: [f64; 6] = [1e-2, 1e-3, 1e-4, 1e-6, 1e-8, 1e-10];
    TOLERANCES.iter().for_each(|tolerance| print!(" {:>20}", format!("{tolerance:e}")));
    println!();
    let mut over_all = [0; TOLERANCES.len()];
    for set in sets {
        let pairs: Vec<[u32; 2]> = (0..set.a.len() as u32).map(|k| [k, k]).collect();
        print!("{:16}", set.name);
        for (tolerance, over_all) in TOLERANCES.iter().zip(&mut over_all) {
            let accuracy = Accuracy::new(*tolerance).expect("a tolerance in range");
            let (ns, out) = measure(&set.a, &set.b, &pairs, &accuracy, Instructions::best());
            let errors = errors(set, &out);
            let over = errors.iter().filter(|error| *error > tolerance).count();
            *over_all += over;
            print!(" {over:4} {:8.1e} {ns:6.0}", errors[errors.len() - 1] / tolerance);
        }
        println!();
    }
    let pairs: usize = sets.iter().map(|set| set.a.len()).sum();
    print!("{:16}", "inside");
    over_all.iter().for_each(|over| print!(" {:>19.2}%", 100.0 - 100.0 * *over as f64 / pairs as f64));
    println!();
}

/// The inside of a unit cube, 2 k^2 triangles a side.
fn cube(k: usize) -> Vec<Patch> {
    let mut patches = Vec::new();
    for axis in 0..3 {
        for far in [0.0, 1.0] {
            let place = |i: usize, j: usize| {
                let mut v = [0.0; 3];
                (v[axis], v[(axis + 1) % 3], v[(axis + 2) % 3]) = (far, i as f64 / k as f64, j as f64 / k as f64);
                Vec3::from(v)
            };
            for (i, j) in (0..k).flat_map(|i| (0..k).map(move |j| (i, j))) {
                let [a, b, c, d] = [place(i, j), place(i + 1, j), place(i + 1, j + 1), place(i, j + 1)];
                for t in [[a, b, c], [a, c, d]] {
                    patches.push(Patch::new(if far > 0.0 { [t[0], t[2], t[1]] } else { t }));
                }
            }
        }
    }
    patches
}

fn room() {
    let patches = cube(8);
    let n = patches.len() as u32;
    println!("\ncube of {n} triangles, every pair, one thread: M pairs/s, largest |row sum - 1|\n");
    print!("{:10}", "tolerance");
    Instructions::available().iter().for_each(|i| print!(" {:>12}", format!("{i:?}")));
    println!(" {:>10}", "row error");
    let pairs: Vec<[u32; 2]> = (0..n).flat_map(|i| (0..i).map(move |j| [i, j])).collect();
    for tolerance in [1e-2, 1e-3, 1e-4, 1e-6, 1e-8, 1e-10] {
        let accuracy = Accuracy::new(tolerance).expect("a tolerance in range");
        print!("{tolerance:10e}");
        let mut sums = vec![0.0; patches.len()];
        for instructions in Instructions::available() {
            let (ns, out) = measure(&patches, &patches, &pairs, &accuracy, instructions);
            print!(" {:12.2}", 1e3 / ns);
            sums.fill(0.0);
            for (&[i, j], g) in pairs.iter().zip(out) {
                sums[i as usize] += g / patches[i as usize].area;
                sums[j as usize] += g / patches[j as usize].area;
            }
        }
        println!(" {:10.1e}", sums.iter().map(|sum| (sum - 1.0).abs()).fold(0.0, f64::max));
    }
}

fn main() {
    // The picture of docs/form_factors.py needs one table only.
    let everything = !std::env::args().any(|argument| argument == "kernels");
    if everything {
        room();
    }
    let Some(folder) = std::env::var_os("RADIOSITY_PAIRS") else { return };
    let mut paths: Vec<PathBuf> =
        std::fs::read_dir(folder).expect("the folder of the sets").flatten().map(|entry| entry.path()).collect();
    paths.sort();
    let sets: Vec<Set> = paths.iter().map(|path| read(path)).collect();
    if everything {
        tolerances(&sets);
    }
    kernels(&sets);
}
