//! Planar convex polygons: area, normal, plane, clipping to a half space.
//!
//! The front of a polygon is the side from which its corners run counter-clockwise (right-hand rule).

use super::Vec3;

/// The most corners that a polygon may have. A form factor clips each polygon by one plane, which adds one corner.
pub const MAX_CORNERS: usize = 64;

/// Twice the area times the unit normal: sum over k of (v_k - v_0) x (v_{k+1} - v_0).
///
/// Taken relative to the first corner, so that a polygon far from the origin loses no digits.
pub fn area_vector(corners: &[Vec3]) -> Vec3 {
    let mut sum = Vec3::ZERO;
    for k in 1..corners.len().saturating_sub(1) {
        sum += (corners[k] - corners[0]).cross(corners[k + 1] - corners[0]);
    }
    0.5 * sum
}

/// Area, m^2.
pub fn area(corners: &[Vec3]) -> f64 {
    area_vector(corners).length()
}

/// Mean of the corners: the centre that bounding spheres are drawn around.
pub fn centre(corners: &[Vec3]) -> Vec3 {
    corners.iter().sum::<Vec3>() / corners.len() as f64
}

/// The plane `normal . x = offset` that a polygon lies in, `normal` of unit length on the front side.
#[derive(Debug, Clone, Copy)]
pub struct Plane {
    /// Unit normal, front side.
    pub normal: Vec3,
    /// A point of the plane; distances are measured from it, never from the origin, to keep their digits.
    pub point: Vec3,
}

impl Plane {
    /// The plane through a polygon's corners. The polygon's area must not be zero.
    pub fn of(corners: &[Vec3]) -> Plane {
        Plane { normal: area_vector(corners).normalize(), point: corners[0] }
    }

    /// Signed distance of `x`, positive in front.
    #[inline]
    pub fn distance(&self, x: Vec3) -> f64 {
        self.normal.dot(x - self.point)
    }
}

/// How far a point may lie off a plane and still count as lying in it, relative to its distance from the plane's point.
///
/// 16 ulp covers the rounding of the normal (a cross product and a normalisation) and of the dot product. Without it
/// the corners that two touching polygons share would fall on a random side of each other's plane.
const SNAP: f64 = 16.0 * f64::EPSILON;

/// The side of `plane` on which `x` lies: signed distance, exactly 0 when it is within `slack` or cannot be told from 0.
#[inline]
fn snapped_distance(plane: &Plane, x: Vec3, slack: f64) -> f64 {
    let d = plane.distance(x);
    if d.abs() <= slack + SNAP * (x - plane.point).abs().max_element() { 0.0 } else { d }
}

/// Where a polygon lies as seen from a plane.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// In front, or touching the plane from there.
    Front,
    /// Behind, or in the plane.
    Behind,
    /// On both sides.
    Across,
}

impl Side {
    /// Of something that has points before the plane, behind it, or both.
    pub fn of(before: bool, behind: bool) -> Side {
        match (before, behind) {
            (true, false) => Side::Front,
            (false, _) => Side::Behind,
            (true, true) => Side::Across,
        }
    }
}

/// On which side of `plane` the corners lie, within rounding.
#[inline]
pub fn side_of(corners: &[Vec3], plane: &Plane) -> Side {
    let (mut before, mut behind) = (false, false);
    for &corner in corners {
        let distance = snapped_distance(plane, corner, 0.0);
        before |= distance > 0.0;
        behind |= distance < 0.0;
    }
    Side::of(before, behind)
}

/// The part of a convex polygon in front of a plane, in `out`; empty when nothing of positive area lies there.
///
/// Sutherland & Hodgman 1974, one plane. Corners keep their order; corners within rounding of the plane are kept as
/// they are, so that a polygon that only touches the plane comes back unchanged.
pub fn clip_to_front(corners: &[Vec3], plane: &Plane, out: &mut Vec<Vec3>) {
    clip_with_slack(corners, plane, 0.0, out);
}

/// The same where the plane is known to `slack` only: corners within it are kept as they are.
pub fn clip_with_slack(corners: &[Vec3], plane: &Plane, slack: f64, out: &mut Vec<Vec3>) {
    out.clear();
    let mut in_front = false;
    let mut previous = corners[corners.len() - 1];
    let mut previous_distance = snapped_distance(plane, previous, slack);
    for &corner in corners {
        let distance = snapped_distance(plane, corner, slack);
        if (previous_distance < 0.0 && distance > 0.0) || (previous_distance > 0.0 && distance < 0.0) {
            let t = previous_distance / (previous_distance - distance);
            out.push(previous + t * (corner - previous));
        }
        if distance >= 0.0 {
            in_front |= distance > 0.0;
            out.push(corner);
        }
        previous = corner;
        previous_distance = distance;
    }
    if !in_front || out.len() < 3 {
        out.clear();
    }
}

/// Why `corners` is not a planar convex polygon of positive area, or `None` when it is one.
///
/// Planarity and convexity are judged at 1e-9 of the polygon's size, coarser than the rounding of a rotation and finer
/// than any form factor tolerance of this package, or at the rounding of the coordinates themselves where that is more.
pub fn defect(corners: &[Vec3]) -> Option<String> {
    const RELATIVE: f64 = 1e-9;
    if corners.len() < 3 {
        return Some(format!("has {} vertices; a polygon needs at least 3", corners.len()));
    }
    if corners.len() > MAX_CORNERS {
        return Some(format!("has {} vertices; at most {MAX_CORNERS} are allowed", corners.len()));
    }
    if let Some(k) = corners.iter().position(|v| !v.is_finite()) {
        return Some(format!("vertex {k} is {}; coordinates must be finite", corners[k]));
    }
    let local: Vec<Vec3> = corners.iter().map(|v| *v - corners[0]).collect();
    let size = local.iter().map(|v| v.length()).fold(0.0, f64::max);
    let vector = area_vector(&local);
    // An area below the rounding of its own cross products cannot be told from zero.
    if !(vector.length() > 8.0 * f64::EPSILON * size * size) {
        return Some("has zero area".to_string());
    }
    let normal = vector.normalize();
    let rounding = 4.0 * f64::EPSILON * corners.iter().map(|v| v.abs().max_element()).fold(0.0, f64::max);
    let slack = RELATIVE * size + rounding;
    let middle = centre(&local);
    let mut turned = 0.0;
    for k in 0..local.len() {
        let [corner, next, after] = [local[k], local[(k + 1) % local.len()], local[(k + 2) % local.len()]];
        let off = normal.dot(corner - middle).abs();
        if local.len() > 3 && off > slack {
            return Some(format!("is not planar: vertex {k} lies {off:.3e} off the plane (size {size:.3e})"));
        }
        if (next - corner).cross(after - next).dot(normal) < -slack * size {
            return Some(format!("is not convex at vertex {}", (k + 1) % local.len()));
        }
        turned += (next - corner).angle_between(after - next);
    }
    // A convex border turns once around; a star of five points turns everywhere to the left, but twice.
    (turned > 1.5 * std::f64::consts::TAU).then(|| "is not convex: its border winds around more than once".to_string())
}
