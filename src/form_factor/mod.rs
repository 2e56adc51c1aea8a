//! Form factors (= view factors, configuration factors) between planar convex polygons.
//!
//! F_ij is the fraction of the light leaving i, diffusely and uniformly, that arrives at j without meeting anything:
//!
//!   F_ij = 1/A_i  integral over A_i  integral over A_j  V K dA_j dA_i,    K = cos_i cos_j / (pi r^2)
//!
//! Row i emits, column j receives. The kernels compute the symmetric exchange G_ij = A_i F_ij = A_j F_ji,
//! m^2, once per unordered pair: reciprocity is exact because both factors come from the same number.
//!
//! | file | kernel | good for |
//! |---|---|---|
//! | [`area_quadrature`] | points x points of a symmetric rule | far pairs; no transcendental functions |
//! | [`point_to_polygon`] | Lambert's closed form from points of the smaller polygon | middle distances, very unequal sizes |
//! | [`contour`] | double line integral, the inner one analytic | touching and close pairs |
//! | [`select`] | which of them, for a tolerance | |
//! | [`pieces`] | cut polygons, where no kernel can do the whole | slivers, very unequal sizes |
//! | [`batch`] | many pairs, eight at a time ([`lanes`]) | |
//! | [`shadow`] | the visible fraction V of a pair, by shadows of convex bodies | few bodies between |
//! | [`occluded`] | the same, by segments | everything else |
//!
//! Two older estimators work row by row instead, occlusion included, with a sampling error in every entry; both send
//! out rays from an [`emitter`]:
//!
//! | file | estimator | good for |
//! |---|---|---|
//! | [`monte_carlo`] | cosine-distributed random rays | an independent check with an error that needs no assumption |
//! | [`hemicube`] | one ray through each cell of half a cube | the classic, and its three assumptions |
//!
//! # Example
//! ```
//! use radiosity::form_factor::{Accuracy, Shape, exchange};
//! use radiosity::geometry::Vec3;
//! // Two unit squares face to face at distance 1: Howell C-11 gives 0.199824895698.
//! let a = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]].map(Vec3::from);
//! let b = [[0., 0., 1.], [0., 1., 1.], [1., 1., 1.], [1., 0., 1.]].map(Vec3::from);
//! let (a, b) = (Shape::new(&a), Shape::new(&b));
//! let f_ab = exchange(&a, &b, &Accuracy::new(1e-8)?) / a.area;
//! assert!((f_ab - 0.199824895698).abs() < 1e-11);
//! # Ok::<(), radiosity::Error>(())
//! ```

pub mod area_quadrature;
pub mod batch;
pub mod contour;
pub mod emitter;
pub mod hemicube;
mod lanes;
pub mod monte_carlo;
pub mod occluded;
mod patch;
mod pieces;
pub mod point_to_polygon;
pub mod select;
pub mod shadow;

pub use batch::Batch;
pub use patch::Patch;
pub use select::{Accuracy, Kernel};

use crate::geometry::Vec3;
use crate::geometry::polygon::{area_vector, centre};
use crate::simd::double::Vectors;

/// A planar convex polygon with what every kernel asks of it.
#[derive(Debug, Clone, Copy)]
pub struct Shape<'a> {
    /// Corners, counter-clockwise seen from the front.
    pub corners: &'a [Vec3],
    /// Unit normal, front side.
    pub normal: Vec3,
    /// Area, m^2.
    pub area: f64,
    /// Mean of the corners.
    pub centre: Vec3,
    /// Radius of the sphere around `centre` that holds all corners.
    pub radius: f64,
}

impl<'a> Shape<'a> {
    /// Measures a polygon. Its area must not be zero (see [`crate::geometry::polygon::defect`]).
    pub fn new(corners: &'a [Vec3]) -> Shape<'a> {
        let vector = area_vector(corners);
        let area = vector.length();
        Shape::with_normal(corners, vector / area, area)
    }

    /// Like [`Shape::new`] for a part of a polygon whose normal is known better than the part could tell.
    fn with_normal(corners: &'a [Vec3], normal: Vec3, area: f64) -> Shape<'a> {
        let centre = centre(corners);
        let radius = corners.iter().map(|v| v.distance_squared(centre)).fold(0.0, f64::max).sqrt();
        Shape { corners, normal, area, centre, radius }
    }
}

/// Polygons side by side, one a lane, padded to the same number of corners by repeating the last: what the kernels work on.
pub(crate) struct Polygons<'a, D> {
    pub(crate) corners: &'a [Vectors<D>],
    pub(crate) normal: Vectors<D>,
}

/// The unoccluded exchange G_ab = A_a F_ab = A_b F_ba of two polygons, m^2, whatever their position.
///
/// Exactly symmetric in its arguments. What lies behind the other polygon's plane is cut off first; 0 for pairs that
/// face away or share a plane.
pub fn exchange(a: &Shape, b: &Shape, accuracy: &Accuracy) -> f64 {
    Batch::new().exchange(a, b, accuracy)
}
