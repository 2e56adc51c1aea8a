//! Matrix inversion: LU factorisation of I - rho F (Goral et al. 1984), by the faer crate.
//!
//! O(n^3) time and O(n^2) memory; the reference that the iterations are tested against. Bands with the same reflectances
//! share one factorisation.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::lu::partial_pivoting::{factor, solve as substitute};
use faer::{Conj, Mat, Par};

use super::{Options, Run, System, irradiance, residual};
use crate::error::{Error, Result};
use crate::memory::room;

/// Bytes of scratch of a thread: twice the last cache of the processor, which has 64 MiB at most for most.
const SCRATCH: usize = 128 << 20;
/// How far the library splits its work, whatever the number of threads: the same bits every time.
const SPLIT: usize = 16;

pub(super) fn solve(system: &System, options: &Options, run: &mut Run) -> Result<Vec<f64>> {
    let System { form_factors, emission, reflectance, bands } = *system;
    let n = form_factors.len();
    // The factors take the place of the matrix.
    let needed = 8 * (n as u64) * (n as u64);
    if needed > options.memory {
        return Err(Error::Memory {
            what: format!("the LU factorisation of {n} patches"),
            needed,
            available: options.memory,
            remedy: "use an iterative method such as \"gauss_seidel\"".to_string(),
        });
    }
    // The library ends the process where there is no room for its matrix or its scratch: both are asked for beforehand.
    drop(room::<u8>(needed as usize + rayon::current_num_threads().min(SPLIT) * SCRATCH)?);
    let mut radiosity = vec![0.0; n * bands];
    let mut pending: Vec<usize> = (0..bands).collect();
    while let Some(&first) = pending.first() {
        let same = |&b: &usize| (0..n).all(|i| reflectance[i * bands + b] == reflectance[i * bands + first]);
        let (group, rest): (Vec<usize>, Vec<usize>) = pending.iter().partition(|b| same(b));
        pending = rest;
        let mut row = vec![0.0; n];
        let mut matrix = Mat::<f64>::identity(n, n);
        for i in 0..n {
            form_factors.row(i, &mut row);
            let rho = reflectance[i * bands + first];
            for (j, f) in row.iter().enumerate() {
                matrix[(i, j)] -= rho * f;
            }
        }
        let mut solution = Mat::from_fn(n, group.len(), |i, k| emission[i * bands + group[k]]);
        factor_and_substitute(&mut matrix, &mut solution);
        for (k, b) in group.iter().enumerate() {
            for i in 0..n {
                radiosity[i * bands + b] = solution[(i, k)];
            }
        }
    }
    let unshot = residual(system, &irradiance(system, &radiosity), &radiosity);
    // One step is all there is: if its residual misses the tolerance, more steps would not mend it.
    run.step(&radiosity, &unshot, 1)?;
    Ok(radiosity)
}

/// Replaces `matrix` by its factors, L below the diagonal and U above, and `rhs` by the solution.
fn factor_and_substitute(matrix: &mut Mat<f64>, rhs: &mut Mat<f64>) {
    let (n, columns, par) = (matrix.nrows(), rhs.ncols(), Par::rayon(SPLIT));
    let (mut forward, mut backward) = (vec![0usize; n], vec![0usize; n]);
    let mut memory = MemBuffer::new(factor::lu_in_place_scratch::<usize, f64>(n, n, par, Default::default()));
    let (_, permutation) = factor::lu_in_place(
        matrix.as_mut(),
        &mut forward,
        &mut backward,
        par,
        MemStack::new(&mut memory),
        Default::default(),
    );
    let mut memory = MemBuffer::new(substitute::solve_in_place_scratch::<usize, f64>(n, columns, par));
    let factors = matrix.as_ref();
    let stack = MemStack::new(&mut memory);
    substitute::solve_in_place_with_conj(factors, factors, permutation, Conj::No, rhs.as_mut(), par, stack);
}
