//! Functions that are linear in position and normal: what radiosity and irradiance are taken for on a node of the tree.
//!
//! What arrives at a place z = (x, n) from far away changes slowly with x, and like n . Phi with the direction that it faces: to
//! first order it is linear in z. On the places of a node (its patches, or all points of its triangle)
//!
//!   f(z) = sum over k < K of  a_k psi_k(z),    psi_0 = 1,    mean of psi_k psi_l = [k = l]
//!
//! with psi_k made from the covariance C of the places by Cholesky's factorisation with pivoting: z - mean = L psi, C = L L^T.
//! What does not vary takes no function: one patch has K = 1, what is flat K = 3, a part of a sphere, on which n says no more
//! than x, K = 4; of a heap of triangles the three that vary most are kept. After linear wavelets on flat elements (Gortler, Schroeder, Cohen & Hanrahan 1993)
//! and vector irradiance on clusters (Willmott, Heckbert & Garland 1999).

use crate::geometry::{Triangle, Vec3};

/// A position and the normal there.
pub type Place = [f64; 6];

/// Most functions of a node: with more, values at [`super::tree::SAMPLES`] places would be fitted whatever they are.
pub const MOST: usize = 4;

/// Variances below this, of positions in units of the squared radius and of unit normals, are none.
const NO_VARIANCE: f64 = 1e-5;

/// Where the places of a node lie: area, mean, and the sum of A dz dz^T.
#[derive(Debug, Clone)]
pub struct Moments {
    /// Area, m^2.
    pub area: f64,
    /// Mean position and normal.
    pub mean: Place,
    scatter: [[f64; 6]; 6],
}

impl Moments {
    /// Of a patch that is known by its mean.
    pub fn of_patch(area: f64, centre: Vec3, normal: Vec3) -> Moments {
        Moments { area, mean: place(centre, normal), scatter: [[0.0; 6]; 6] }
    }

    /// Of all points of a triangle.
    pub fn of_triangle(triangle: &Triangle, area: f64, normal: Vec3) -> Moments {
        let centre = crate::geometry::polygon::centre(triangle);
        let mut moments = Moments::of_patch(area, centre, normal);
        // The mean of dx dx^T over a triangle is a twelfth of its sum over the corners.
        triangle.iter().for_each(|corner| moments.scatter(area / 12.0, &place(*corner - centre, Vec3::ZERO)));
        moments
    }

    /// Of all that others hold.
    pub fn of_all<'a>(parts: impl Iterator<Item = &'a Moments> + Clone) -> Moments {
        let area: f64 = parts.clone().map(|part| part.area).sum();
        let mut mean = [0.0; 6];
        for part in parts.clone() {
            (0..6).for_each(|k| mean[k] += part.area / area * part.mean[k]);
        }
        let mut all = Moments { area, mean, scatter: [[0.0; 6]; 6] };
        for part in parts {
            all.scatter(part.area, &difference(&part.mean, &mean));
            for (row, part) in all.scatter.iter_mut().zip(&part.scatter) {
                row.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
            }
        }
        all
    }

    /// Variance of positions, m^2.
    pub fn variance(&self) -> f64 {
        (0..3).map(|k| self.scatter[k][k]).sum::<f64>() / self.area
    }

    fn scatter(&mut self, area: f64, dz: &Place) {
        for k in 0..6 {
            (0..6).for_each(|l| self.scatter[k][l] += area * dz[k] * dz[l]);
        }
    }
}

/// A position and a normal as a place.
pub fn place(x: Vec3, n: Vec3) -> Place {
    [x.x, x.y, x.z, n.x, n.y, n.z]
}

/// a - b.
pub fn difference(a: &Place, b: &Place) -> Place {
    std::array::from_fn(|k| a[k] - b[k])
}

/// The functions psi of a node.
#[derive(Debug, Clone)]
pub struct Functions {
    mean: Place,
    /// Columns of L with the coordinate that was the pivot of each, K - 1 of them.
    columns: Vec<(usize, Place)>,
}

impl Functions {
    /// Those of the places that have these moments, within `radius` of their mean.
    pub fn new(moments: &Moments, radius: f64) -> Functions {
        let unit = |k: usize| if k < 3 { radius } else { 1.0 };
        let mut rest = moments.scatter;
        rest.iter_mut().flatten().for_each(|value| *value /= moments.area);
        let mut columns: Vec<(usize, Place)> = Vec::new();
        while columns.len() < MOST - 1 {
            let relative = |k: usize| rest[k][k] / (unit(k) * unit(k));
            let pivot = (0..6).max_by(|a, b| relative(*a).total_cmp(&relative(*b))).unwrap_or(0);
            if !(relative(pivot) > NO_VARIANCE) {
                break;
            }
            let root = rest[pivot][pivot].sqrt();
            let column: Place = std::array::from_fn(|k| rest[k][pivot] / root);
            for k in 0..6 {
                (0..6).for_each(|l| rest[k][l] -= column[k] * column[l]);
            }
            // What is left there is rounding.
            (0..6).for_each(|k| (rest[k][pivot], rest[pivot][k]) = (0.0, 0.0));
            columns.push((pivot, column));
        }
        Functions { mean: moments.mean, columns }
    }

    /// The mean place.
    pub fn mean(&self) -> &Place {
        &self.mean
    }

    /// Bytes held beside the struct itself.
    pub fn nbytes(&self) -> usize {
        size_of_val(self.columns.as_slice())
    }

    /// K.
    #[expect(clippy::len_without_is_empty, reason = "psi_0 is always there")]
    pub fn len(&self) -> usize {
        1 + self.columns.len()
    }

    /// psi_0 .. psi_K-1 at a place.
    pub fn at(&self, z: &Place) -> [f64; MOST] {
        let mut values = self.slopes(difference(z, &self.mean));
        values[0] = 1.0;
        values
    }

    /// What dz changes psi_1, psi_2, ... by.
    fn slopes(&self, mut dz: Place) -> [f64; MOST] {
        let mut values = [0.0; MOST];
        for (value, (pivot, column)) in values[1..].iter_mut().zip(&self.columns) {
            *value = dz[*pivot] / column[*pivot];
            (0..6).for_each(|k| dz[k] -= *value * column[k]);
        }
        values
    }

    /// The functions of a parent in terms of these: K rows, a row for each of these functions, a column for each of the parent's.
    /// A linear function keeps all that it is on the child.
    pub fn of_parent(&self, parent: &Functions) -> Vec<f64> {
        let (rows, columns) = (self.len(), parent.len());
        let mut matrix = vec![0.0; rows * columns];
        matrix[..columns].copy_from_slice(&parent.at(&self.mean)[..columns]);
        for (row, (_, column)) in self.columns.iter().enumerate() {
            matrix[(row + 1) * columns..][..columns].copy_from_slice(&parent.slopes(*column)[..columns]);
        }
        matrix
    }
}
