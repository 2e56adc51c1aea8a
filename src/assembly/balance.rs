//! How well an operator keeps the two laws of form factors: reciprocity and conservation.

use super::FormFactors;

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
