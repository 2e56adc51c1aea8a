//! How well an operator keeps the two laws of form factors, reciprocity and conservation; and the repair of the second
//! where the first is exact.
//!
//! In a closed scene the exchange G_ij = A_i F_ij of a patch with all others sums to its area. Of all symmetric changes
//! D that make it so, the repair takes the one whose relative changes are least in the sense of least squares (van
//! Leersum 1989; Lawson 1995; Vercammen & Froment 1980; reviewed by Daun, Morton & Howell 2005):
//!
//!   minimise    sum over i > j of D_ij^2 / w_ij,   w_ij = G_ij^2
//!   subject to  sum over j of (G_ij + D_ij) = A_i  for every i
//!
//! Pairs that do not see each other have w = 0 and stay as they are. With one multiplier l_i a row the solution is
//!
//!   D_ij = w_ij (l_i + l_j),    (diag(W 1) + W) l = r,    r_i = A_i - sum over j of G_ij
//!
//! The matrix is symmetric and positive semidefinite: conjugate gradients (Hestenes & Stiefel 1952), preconditioned by
//! its diagonal, solve it with products over G alone.

use rayon::prelude::*;

use super::triangle::Pattern;
use super::{Dense, FormFactors};
use crate::error::{Error, Result};
use crate::progress::Progress;

/// What leaves the scene from each patch: 1 - sum over j of F_ij. Slightly negative values are sampling error and are
/// not hidden.
pub fn remainder(f: &dyn FormFactors) -> Vec<f64> {
    f.row_sums().iter().map(|sum| 1.0 - sum).collect()
}

/// The largest |A_i F_ij - A_j F_ji| over the pairs, relative to the largest A_i F_ij; `None` without areas.
pub fn reciprocity_error(f: &dyn FormFactors) -> Option<f64> {
    let areas = f.areas()?;
    let n = f.len();
    let (mut row, mut unit, mut column) = (vec![0.0; n], [0.0], vec![0.0; n]);
    let (mut worst, mut largest) = (0.0f64, 0.0f64);
    for i in 0..n {
        f.row(i, &mut row);
        // Shooting one unit from patch i gives column i: F_ji for every j.
        unit[0] = 1.0;
        column.fill(0.0);
        f.shoot(i, &unit, &mut column);
        for j in 0..n {
            worst = worst.max((areas[i] * row[j] - areas[j] * column[j]).abs());
            largest = largest.max(areas[i] * row[j]);
        }
    }
    Some(if largest > 0.0 { worst / largest } else { 0.0 })
}

/// A row that misses 1 by more than so many row errors is open: |1 - row sum| is at most the row error itself, and the
/// estimate of that is good to a factor.
const OPEN: f64 = 3.0;
/// Row sums are exact when they are off by no more than this.
const EXACT: f64 = 1e-14;
/// Corrections of the solution by the residual that it leaves, which double precision cannot see at once.
const REFINEMENTS: usize = 6;
/// Rounds in which entries may be found to become negative; each fixes some at 0.
const ROUNDS: usize = 20;
/// Steps of conjugate gradients.
const MOST_STEPS: usize = 2000;
/// Fixed number of partial sums in a product, whatever the number of threads: the same bits every time.
const PARTS: usize = 32;

/// The form factors of a closed scene with row sums of 1, and the largest change of a row, max_i sum_j |D_ij| / A_i.
///
/// # Errors
/// [`Error::Invalid`] for a scene that is open, named by its worst patch, or whose rows cannot be made to sum to 1;
/// [`Error::Memory`]; [`Error::Interrupted`].
pub fn balanced(f: &Dense, memory: u64, progress: &Progress) -> Result<(Dense, f64)> {
    let n = f.len();
    // The weights, the changed triangle and the changes, and the vectors of the iteration.
    let (pattern, exchange) = f.exchange();
    let needed = 8 * (3 * exchange.len() + (PARTS + 16) * n) as u64;
    if needed > memory {
        return Err(Error::Memory {
            what: format!("balancing the exchange of {n} patches"),
            needed,
            available: memory,
            remedy: "use fewer patches (a larger max_edge)".to_string(),
        });
    }
    let allowed = OPEN * f.error_estimate();
    let worst = f.row_sums().into_iter().enumerate().max_by(|a, b| (1.0 - a.1).abs().total_cmp(&(1.0 - b.1).abs()));
    if let Some((i, sum)) = worst.filter(|(_, sum)| !((1.0 - sum).abs() <= allowed)) {
        return Err(Error::Invalid(format!(
            "patch {i}: row sum {sum:.6} is further from 1 than {OPEN} times the row error {:.2e}: the scene is not \
             closed, and only a closed one can be balanced",
            f.error_estimate()
        )));
    }
    let areas = f.areas().unwrap_or_default();
    let (exchange, moved) = balanced_entries(areas, pattern, exchange, progress)?;
    Ok((f.with_exchange(exchange, f.error_estimate() + moved), moved))
}

/// The same for a packed triangle (the i entries G_i0 .. G_i,i-1 of every row i): the changed triangle, and the largest
/// change of a row.
///
/// An entry that would become negative is fixed at 0, and the others are found again without it.
///
/// # Errors
/// [`Error::Invalid`] when no symmetric change of the entries makes every row sum to its area; [`Error::Interrupted`].
pub fn balanced_exchange(areas: &[f64], exchange: &[f64], progress: &Progress) -> Result<(Vec<f64>, f64)> {
    balanced_entries(areas, &Pattern::whole(areas.len()), exchange, progress)
}

fn balanced_entries(
    areas: &[f64],
    pattern: &Pattern,
    exchange: &[f64],
    progress: &Progress,
) -> Result<(Vec<f64>, f64)> {
    let mut weights = exchange.to_vec();
    for _ in 0..ROUNDS {
        let changed = least_squares(areas, pattern, &weights, progress)?;
        if changed.iter().all(|g| *g >= 0.0) {
            let moved = largest_change(areas, pattern, exchange, &changed);
            return Ok((changed, moved));
        }
        weights.iter_mut().zip(&changed).filter(|(_, g)| !(**g >= 0.0)).for_each(|(w, _)| *w = 0.0);
    }
    Err(impossible())
}

fn impossible() -> Error {
    Error::Invalid(
        "the rows cannot be made to sum to 1 by changing the exchange of patches that see each other: ask for a \
         tighter tolerance"
            .to_string(),
    )
}

/// The least-squares change, entries of any sign.
fn least_squares(areas: &[f64], pattern: &Pattern, exchange: &[f64], progress: &Progress) -> Result<Vec<f64>> {
    let mut changed = exchange.to_vec();
    let mut before = f64::INFINITY;
    for _ in 0..REFINEMENTS {
        let sums = row_totals(areas.len(), pattern, &changed, |g, _, _| g);
        let missing: Vec<f64> = areas.iter().zip(sums).map(|(area, sum)| area - sum).collect();
        let worst = missing.iter().zip(areas).map(|(r, area)| r.abs() / area).fold(0.0, f64::max);
        // At the limit of rounding it no longer falls.
        if worst <= EXACT || worst >= 0.5 * before && worst <= 100.0 * EXACT {
            return Ok(changed);
        }
        before = worst;
        let multipliers = conjugate_gradients(areas, pattern, exchange, &missing, progress)?;
        for i in 0..areas.len() {
            pattern.lower(i, |j, k| changed[k] += exchange[k] * exchange[k] * (multipliers[i] + multipliers[j]));
        }
    }
    let sums = row_totals(areas.len(), pattern, &changed, |g, _, _| g);
    let exact = areas.iter().zip(sums).all(|(area, sum)| (area - sum).abs() <= 100.0 * EXACT * area);
    if exact { Ok(changed) } else { Err(impossible()) }
}

/// (diag(W 1) + W) l = r.
fn conjugate_gradients(
    areas: &[f64],
    pattern: &Pattern,
    exchange: &[f64],
    r: &[f64],
    progress: &Progress,
) -> Result<Vec<f64>> {
    let n = areas.len();
    let diagonal = row_totals(n, pattern, exchange, |g, _, _| g * g);
    // A patch that sees nobody has no say.
    let precondition =
        |r: &[f64]| -> Vec<f64> { r.iter().zip(&diagonal).map(|(r, d)| if *d > 0.0 { r / d } else { 0.0 }).collect() };
    let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
    let mut solution = vec![0.0; n];
    let mut residual = r.to_vec();
    let mut scaled = precondition(&residual);
    let mut direction = scaled.clone();
    let mut size = dot(&residual, &scaled);
    // A tenth of a millionth of what is missing: refinement does the rest.
    let enough = 1e-14 * size;
    for _ in 0..MOST_STEPS {
        if !(size > enough) {
            break;
        }
        progress.expect(1);
        progress.advance(1)?;
        let image = row_totals(n, pattern, exchange, |g, i, j| g * g * (direction[i] + direction[j]));
        let curvature = dot(&direction, &image);
        if !(curvature > 0.0) {
            break;
        }
        let step = size / curvature;
        for i in 0..n {
            solution[i] += step * direction[i];
            residual[i] -= step * image[i];
        }
        scaled = precondition(&residual);
        let next = dot(&residual, &scaled);
        for i in 0..n {
            direction[i] = scaled[i] + next / size * direction[i];
        }
        size = next;
    }
    Ok(solution)
}

/// sum over j of value(G_ij, i, j) for every i, with a symmetric `value`.
fn row_totals(
    n: usize,
    pattern: &Pattern,
    exchange: &[f64],
    value: impl Fn(f64, usize, usize) -> f64 + Sync,
) -> Vec<f64> {
    let parts: Vec<Vec<f64>> = (0..PARTS)
        .into_par_iter()
        .map(|part| {
            let mut sums = vec![0.0; n];
            // Rows of a triangle grow: boundaries at n sqrt(k / PARTS) give every part the same number of pairs.
            let bound = |k: usize| (n as f64 * (k as f64 / PARTS as f64).sqrt()).round() as usize;
            for i in bound(part)..bound(part + 1) {
                let mut own = 0.0;
                pattern.lower(i, |j, place| {
                    let g = exchange[place];
                    if g != 0.0 {
                        let value = value(g, i, j);
                        own += value;
                        sums[j] += value;
                    }
                });
                sums[i] += own;
            }
            sums
        })
        .collect();
    (0..n).map(|i| parts.iter().map(|sums| sums[i]).sum()).collect()
}

/// max_i sum_j |D_ij| / A_i.
fn largest_change(areas: &[f64], pattern: &Pattern, before: &[f64], after: &[f64]) -> f64 {
    let changes: Vec<f64> = before.iter().zip(after).map(|(a, b)| (a - b).abs()).collect();
    let sums = row_totals(areas.len(), pattern, &changes, |d, _, _| d);
    sums.iter().zip(areas).map(|(sum, area)| sum / area).fold(0.0, f64::max)
}
