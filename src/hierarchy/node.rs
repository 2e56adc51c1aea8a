//! A node of the tree: where it is, which way it faces, what radiosity is on it; and what can be told of two from that alone.

use std::f64::consts::{FRAC_PI_2, PI};
use std::ops::Range;

use super::functions::{Functions, Place};
use crate::geometry::Vec3;
use crate::geometry::polygon::Plane;
use crate::visibility::NO_PATCH;
use crate::visibility::body::extremes;

/// A cluster, a patch, or an element of one.
#[derive(Debug, Clone)]
pub struct Node {
    /// The node that it is a part of; `u32::MAX` for the root.
    pub parent: u32,
    /// Its parts; none for a leaf.
    pub children: Range<u32>,
    /// How many nodes are above it.
    pub level: u32,
    /// The patch that it is, or is a part of; [`NO_PATCH`] for a cluster.
    pub patch: u32,
    /// Corners of an element.
    pub(super) face: [u32; 3],
    /// Its patches, in the order of the tree.
    pub patches: Range<u32>,
    /// Area, m^2.
    pub area: f64,
    /// Mean position.
    pub centre: Vec3,
    /// Of a sphere around the centre that holds it.
    pub radius: f64,
    /// Its plane, when it is flat.
    pub plane: Option<Plane>,
    /// All its normals are within `spread` of this, an angle.
    pub(super) axis: Vec3,
    pub(super) spread: f64,
    /// The convex body that all of it lies on, if any.
    pub body: u32,
    /// Points whose convex hull holds it.
    pub hull: Vec<Vec3>,
    /// Whether it is all of that hull: a convex polygon.
    pub is_polygon: bool,
    /// What irradiance and radiosity are on it.
    pub functions: Functions,
    /// Places from which it is looked at, each standing for some of its area.
    pub samples: Vec<Place>,
    /// The share of the variance of its positions that is within what the samples stand for.
    pub unresolved: f64,
    /// K numbers a sample: the functions there.
    pub values: Vec<f64>,
    /// K rows of one number a sample: the linear function that fits values at the samples best.
    pub fit: Vec<f64>,
}

impl Node {
    /// Unit normal of an element, mean direction of a cluster.
    pub fn normal(&self) -> Vec3 {
        self.axis
    }

    /// Whether it is part of a patch, or all of it.
    pub fn is_element(&self) -> bool {
        self.patch != NO_PATCH
    }

    /// Whether it has no parts.
    pub fn is_leaf(&self) -> bool {
        self.children.is_empty()
    }

    /// Whether all of `other` is known to lie behind all of this.
    pub fn faces_away(&self, other: &Node) -> bool {
        match &self.plane {
            Some(plane) => other.hull.iter().all(|x| plane.distance(*x) <= self.slack(other)),
            None => self.angles(other).is_some_and(|[least, _]| least >= FRAC_PI_2),
        }
    }

    /// Whether all of `other` is known to lie before all of this.
    pub fn faces(&self, other: &Node) -> bool {
        match &self.plane {
            Some(plane) => other.hull.iter().all(|x| plane.distance(*x) >= -self.slack(other)),
            None => self.angles(other).is_some_and(|[_, most]| most <= FRAC_PI_2),
        }
    }

    /// The most that cos_x cos_y may be between a place x of this and y of `other`: their sum is (n_x - n_y) . w, w the direction from x
    /// to y, so that neither the sum is above |n_x - n_y| nor the product above sin^2 of half the angle between the normals.
    pub fn most_cosines(&self, other: &Node) -> f64 {
        (0.5 * self.between_normals(other)).sin().powi(2)
    }

    /// The most that A F may be of a patch of the smaller and all of the other, in proportion to the area of its node, m^2: what the gap
    /// between them and their normals allow. From where a normal is by no more than phi off all of the other's, these are within
    /// phi of the horizon, which is sin^2 phi of all that can be seen.
    pub fn most_exchange(&self, other: &Node) -> f64 {
        let across = self.most_cosines(other) * self.area * other.area / (PI * self.gap(other).powi(2));
        let of_all = self.between_normals(other).min(FRAC_PI_2).sin().powi(2) * self.area.min(other.area);
        of_all.min(across)
    }

    /// The largest angle between a normal of this and one of `other`.
    fn between_normals(&self, other: &Node) -> f64 {
        (self.axis.dot(other.axis).clamp(-1.0, 1.0).acos() + self.spread + other.spread).min(PI)
    }

    /// No more than the distance of the two: that of boxes around them, along the axes.
    pub fn gap(&self, other: &Node) -> f64 {
        let [(low, high), (other_low, other_high)] = [self, other].map(|node| extremes(node.hull.iter().copied()));
        (low - other_high).max(other_low - high).max(Vec3::ZERO).length()
    }

    /// A length that counts as none beside the two.
    pub fn slack(&self, other: &Node) -> f64 {
        1e-12 * (self.radius + other.radius + self.centre.distance(other.centre))
    }

    /// The least and the largest angle between a normal of this and a direction to `other`; `None` where their spheres meet.
    fn angles(&self, other: &Node) -> Option<[f64; 2]> {
        let way = other.centre - self.centre;
        let (distance, reach) = (way.length(), self.radius + other.radius);
        if distance <= reach {
            return None;
        }
        let angle = (self.axis.dot(way) / distance).clamp(-1.0, 1.0).acos();
        let spread = self.spread + (reach / distance).asin();
        Some([angle - spread, angle + spread])
    }

    /// Bytes held.
    pub fn nbytes(&self) -> usize {
        size_of::<Node>()
            + size_of_val(self.hull.as_slice())
            + size_of_val(self.samples.as_slice())
            + size_of_val(self.values.as_slice())
            + size_of_val(self.fit.as_slice())
            + self.functions.nbytes()
    }
}
