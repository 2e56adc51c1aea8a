//! One lamp: a flat convex polygon that emits evenly.
//!
//! Its form factor from a point x is Lambert's closed form ([`crate::form_factor::point_to_polygon`]) over what lies above the
//! horizon of x. A random point z of it carries a weight w with
//!
//!   E[w V(x, z)] = integral over the lamp of V K dz
//!
//! From afar z is uniform on the area, w = A cos_x cos_z / (pi r^2). Near by that has spikes (1/r^2): there z is uniform
//! in solid angle (Arvo, "Stratified sampling of spherical triangles", 1995), and w = omega cos_x / pi is bounded.

use std::f64::consts::PI;

use crate::form_factor::area_quadrature::kernel;
use crate::form_factor::point_to_polygon::{form_factor, gathered};
use crate::geometry::polygon::{MAX_CORNERS, Plane, area_vector, centre, clip_to_front};
use crate::geometry::sampling::point_in_triangle;
use crate::geometry::{Triangle, Vec3};
use crate::scene::Scene;
use crate::simd::double::{Double, LANES, Vectors};
use crate::simd::{Instructions, Machine, for_every_machine};
use crate::visibility::Hit;

/// Points closer than this many radii see the lamp under so different distances that they sample its solid angle.
const NEAR: f64 = 2.0;
/// Rounding of coordinates, in units of the largest of them: what lies off a plane by less lies in it.
pub(super) const GRAIN: f64 = 64.0 * f64::EPSILON;

/// A point of a surface.
#[derive(Debug, Clone, Copy)]
pub struct Point {
    /// Position.
    pub x: Vec3,
    /// Unit normal.
    pub normal: Vec3,
    /// The patch that it lies on.
    pub patch: u32,
}

impl Point {
    /// Where a ray has met a scene.
    #[inline]
    pub fn of_hit(scene: &Scene, hit: &Hit) -> Point {
        let [a, b, c] = scene.triangle(hit.patch as usize);
        let [v, w] = hit.barycentric;
        Point { x: a + v * (b - a) + w * (c - a), normal: scene.normals()[hit.patch as usize], patch: hit.patch }
    }
}

/// A flat convex polygon that emits evenly.
#[derive(Debug, Clone)]
pub struct Lamp {
    corners: Vec<Vec3>,
    plane: Plane,
    area: f64,
    centre: Vec3,
    radius: f64,
    /// Areas of the triangles of the fan around corner 0, summed up.
    cumulated: Vec<f64>,
    grain: f64,
    /// E, one a band, W/m^2.
    pub emission: Vec<f64>,
    /// The number of the mirror in which it is seen, for the image of a lamp.
    pub(super) mirror: Option<usize>,
}

impl Lamp {
    /// A convex polygon that emits evenly: one lamp, or a fan of lamps where a single form factor kernel could not take so
    /// many corners.
    pub(super) fn fan_of(ring: &[Vec3], emission: &[f64]) -> Vec<Lamp> {
        let part = |k: usize| {
            let last = (k + MAX_CORNERS - 2).min(ring.len() - 1);
            let corners = std::iter::once(ring[0]).chain(ring[k..=last].iter().copied()).collect();
            Lamp::new(corners, emission.to_vec())
        };
        (1..ring.len() - 1).step_by(MAX_CORNERS - 2).map(part).collect()
    }

    /// A lamp with these corners, counter-clockwise seen from the side that it shines to, of positive area.
    pub fn new(corners: Vec<Vec3>, emission: Vec<f64>) -> Lamp {
        let area = area_vector(&corners).length();
        let centre = centre(&corners);
        let radius = corners.iter().map(|v| v.distance(centre)).fold(0.0, f64::max);
        let mut sum = 0.0;
        let fans = (2..corners.len()).map(|k| {
            sum += area_vector(&[corners[0], corners[k - 1], corners[k]]).length();
            sum
        });
        let cumulated = fans.collect();
        let largest = corners.iter().map(|v| v.abs().max_element()).fold(0.0, f64::max);
        let plane = Plane::of(&corners);
        Lamp { plane, area, centre, radius, cumulated, grain: GRAIN * largest, emission, mirror: None, corners }
    }

    /// Its corners.
    pub fn corners(&self) -> &[Vec3] {
        &self.corners
    }

    /// Area, m^2.
    pub fn area(&self) -> f64 {
        self.area
    }

    /// Whether `x` lies before it, as far as rounding lets one tell.
    #[inline]
    pub(super) fn shines_on(&self, x: Vec3) -> bool {
        self.plane.distance(x) > self.grain + GRAIN * x.abs().max_element()
    }

    /// The form factor from a point to what of the lamp lies above its horizon, unoccluded.
    pub fn form_factor(&self, point: &Point) -> f64 {
        if !self.shines_on(point.x) {
            return 0.0;
        }
        let mut above = Vec::with_capacity(self.corners.len() + 1);
        clip_to_front(&self.corners, &Plane { normal: point.normal, point: point.x }, &mut above);
        if above.is_empty() { 0.0 } else { form_factor(point.x, point.normal, &above).max(0.0) }
    }

    /// The same for many points at once.
    pub(super) fn form_factors(&self, instructions: Instructions, points: &[Point], out: &mut [f64]) {
        let mut horizon = vec![false; points.len()];
        unclipped(instructions, self, points, out, &mut horizon);
        for (k, point) in points.iter().enumerate() {
            if !self.shines_on(point.x) {
                out[k] = 0.0;
            } else if horizon[k] {
                out[k] = self.form_factor(point);
            }
        }
    }

    /// The point of the lamp that belongs to (u, v) in the unit square as seen from `point`, and its weight w.
    pub fn sample(&self, point: &Point, u: f64, v: f64) -> (Vec3, f64) {
        if point.x.distance_squared(self.centre) < (NEAR * self.radius).powi(2) {
            return self.sample_solid_angle(point, u, v);
        }
        let (triangle, u) = self.fan(&self.cumulated, u);
        let z = point_in_triangle(&triangle, u, v);
        (z, self.area * kernel(point.x, point.normal, z, self.plane.normal))
    }

    fn sample_solid_angle(&self, point: &Point, u: f64, v: f64) -> (Vec3, f64) {
        let seen: Vec<Vec3> = self.corners.iter().map(|c| (*c - point.x).normalize_or_zero()).collect();
        let mut omega = 0.0;
        let cumulated: Vec<f64> = (2..seen.len())
            .map(|k| {
                omega += solid_angle(&[seen[0], seen[k - 1], seen[k]]);
                omega
            })
            .collect();
        let (triangle, u) = self.fan(&cumulated, u);
        let towards = point_in_spherical_triangle(&triangle.map(|c| (c - point.x).normalize_or_zero()), u, v);
        let down = towards.dot(self.plane.normal);
        // An edge seen at grazing incidence can throw the direction past the plane; the lamp's centre weighs nothing then.
        if !(omega > 0.0 && down < 0.0) {
            return (self.centre, 0.0);
        }
        let distance = -self.plane.distance(point.x) / down;
        (point.x + distance * towards, omega * point.normal.dot(towards).max(0.0) / PI)
    }

    /// The triangle of the fan in which the fraction `u` of the cumulated sizes falls, and where in it, in [0, 1].
    fn fan(&self, cumulated: &[f64], u: f64) -> (Triangle, f64) {
        let wanted = u * cumulated[cumulated.len() - 1];
        let k = cumulated.partition_point(|sum| *sum <= wanted).min(cumulated.len() - 1);
        let below = if k > 0 { cumulated[k - 1] } else { 0.0 };
        let size = cumulated[k] - below;
        let inside = if size > 0.0 { ((wanted - below) / size).clamp(0.0, 1.0) } else { 0.5 };
        ([self.corners[0], self.corners[k + 1], self.corners[k + 2]], inside)
    }
}

/// Solid angle of the triangle between three unit vectors, sr (Van Oosterom & Strackee 1983).
fn solid_angle([a, b, c]: &Triangle) -> f64 {
    let volume = a.dot(b.cross(*c)).abs();
    2.0 * volume.atan2(1.0 + a.dot(*b) + b.dot(*c) + c.dot(*a))
}

/// The point of a spherical triangle, uniform in solid angle, that belongs to (u, v) in the unit square (Arvo 1995).
pub(super) fn point_in_spherical_triangle([a, b, c]: &Triangle, u: f64, v: f64) -> Vec3 {
    let (ab, ac) = (a.cross(*b).normalize_or_zero(), a.cross(*c).normalize_or_zero());
    let alpha = ab.cross(ac).length().atan2(ab.dot(ac));
    let part = u * solid_angle(&[*a, *b, *c]);
    // Where the arc from a to c is cut so that the part between there, a and b has this solid angle.
    let (sine, cosine) = (part - alpha).sin_cos();
    let (sin_alpha, cos_alpha) = alpha.sin_cos();
    let p = cosine - cos_alpha;
    let q = sine + sin_alpha * a.dot(*b);
    let numerator = (q * cosine - p * sine) * cos_alpha - q;
    let denominator = (q * sine + p * cosine) * sin_alpha;
    let along = if denominator == 0.0 { 1.0 } else { (numerator / denominator).clamp(-1.0, 1.0) };
    let cut = on_arc(*a, *c, along);
    on_arc(*b, cut, 1.0 - v * (1.0 - cut.dot(*b)))
}

/// The unit vector on the arc from `from` towards `to` whose cosine with `from` is given.
fn on_arc(from: Vec3, to: Vec3, cosine: f64) -> Vec3 {
    let side = (to - to.dot(from) * from).normalize_or_zero();
    cosine * from + (1.0 - cosine * cosine).max(0.0).sqrt() * side
}

#[inline(always)]
fn by_lanes<M: Machine>(lamp: &Lamp, points: &[Point], out: &mut [f64], horizon: &mut [bool]) {
    let corners: Vec<Vectors<M::Double>> = lamp.corners.iter().map(|v| Vectors::splat(*v)).collect();
    for ((points, out), horizon) in points.chunks(LANES).zip(out.chunks_mut(LANES)).zip(horizon.chunks_mut(LANES)) {
        let (mut x, mut normal) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3]);
        for lane in 0..LANES {
            let point = &points[lane.min(points.len() - 1)];
            for axis in 0..3 {
                x[axis][lane] = point.x[axis];
                normal[axis][lane] = point.normal[axis];
            }
        }
        let (x, normal) = (Vectors::<M::Double>::load(&x), Vectors::<M::Double>::load(&normal));
        let zero = M::Double::splat(0.0);
        let (mut low, mut high) = (M::Double::splat(f64::INFINITY), M::Double::splat(f64::NEG_INFINITY));
        for &corner in &corners {
            let height = normal.dot(corner - x);
            low = low.min(height);
            high = high.max(height);
        }
        let sum = gathered(x, normal, &corners);
        let values = M::Double::select(zero.lt(high), sum.max(zero), zero).to_array();
        let crossed = M::Double::bits(low.lt(zero)) & M::Double::bits(zero.lt(high));
        for lane in 0..out.len() {
            out[lane] = values[lane];
            horizon[lane] = crossed >> lane & 1 != 0;
        }
    }
}

for_every_machine! {
    /// The form factors from points to a lamp; where their horizon crosses it, only the mark is set.
    fn unclipped(lamp: &Lamp, points: &[Point], out: &mut [f64], horizon: &mut [bool]) -> () = by_lanes
}
