//! A triangular patch with what every pair asks of it.

use super::Shape;
use crate::geometry::polygon::Plane;
use crate::geometry::{Triangle, Vec3};

/// A triangle with what every pair asks of it.
#[derive(Debug, Clone, Copy)]
pub struct Patch {
    /// Corners, counter-clockwise seen from the front.
    pub corners: Triangle,
    /// Unit normal, front side.
    pub normal: Vec3,
    /// Area, m^2.
    pub area: f64,
    pub(super) centre: Vec3,
    pub(super) radius: f64,
}

impl Patch {
    /// Measures a triangle. Its area must not be zero.
    pub fn new(corners: Triangle) -> Patch {
        let Shape { normal, area, centre, radius, .. } = Shape::new(&corners);
        Patch { corners, normal, area, centre, radius }
    }

    /// The same in coordinates relative to `origin`.
    pub fn relative_to(&self, origin: Vec3) -> Patch {
        Patch { corners: self.corners.map(|v| v - origin), centre: self.centre - origin, ..*self }
    }

    /// Its plane.
    pub fn plane(&self) -> Plane {
        Plane { normal: self.normal, point: self.corners[0] }
    }

    /// Mean of the corners.
    pub fn centre(&self) -> Vec3 {
        self.centre
    }

    /// The same as a polygon.
    pub fn shape(&self) -> Shape<'_> {
        Shape { corners: &self.corners, normal: self.normal, area: self.area, centre: self.centre, radius: self.radius }
    }
}
