//! G X for a symmetric G of which the lower triangle is there, and an X of many columns: tile by tile, by the matrix products of the
//! faer crate.

use std::ops::Range;

use faer::linalg::matmul::matmul;
use faer::mat::{MatMut, MatRef};
use faer::{Accum, Par};
use rayon::prelude::*;

/// Rows and columns of a tile: three of them, and their share of X, fit in a processor's second cache.
const TILE: usize = 96;

/// out = G X, `columns` numbers a row. `fill(i, range, row)` writes G_ij for j in a range below i.
pub(super) fn apply(
    n: usize,
    x: &[f64],
    columns: usize,
    out: &mut [f64],
    fill: impl Fn(usize, Range<usize>, &mut [f64]) + Sync,
) {
    let tile_of = |t: usize| t * TILE..((t + 1) * TILE).min(n);
    out.par_chunks_mut(TILE * columns).enumerate().for_each_init(
        || vec![0.0; TILE * TILE],
        |buffer, (t, out)| {
            let rows = tile_of(t);
            out.fill(0.0);
            let mut sum = MatMut::from_row_major_slice_mut(out, rows.len(), columns);
            for s in 0..n.div_ceil(TILE) {
                let others = tile_of(s);
                // The lower of the two has the numbers.
                let [below, beside] = if s <= t { [&rows, &others] } else { [&others, &rows] };
                let tile = &mut buffer[..rows.len() * others.len()];
                for (i, row) in below.clone().zip(tile.chunks_exact_mut(beside.len())) {
                    if s == t {
                        let known = i - rows.start;
                        row[known..].fill(0.0);
                        fill(i, rows.start..i, &mut row[..known]);
                    } else {
                        fill(i, beside.clone(), row);
                    }
                }
                if s == t {
                    for k in 0..rows.len() {
                        (0..k).for_each(|l| tile[l * rows.len() + k] = tile[k * rows.len() + l]);
                    }
                }
                let tile = MatRef::from_row_major_slice(tile, below.len(), beside.len());
                let tile = if s <= t { tile } else { tile.transpose() };
                let x = &x[others.start * columns..others.end * columns];
                let x = MatRef::from_row_major_slice(x, others.len(), columns);
                matmul(sum.as_mut(), Accum::Add, tile, x, 1.0, Par::Seq);
            }
        },
    );
}
