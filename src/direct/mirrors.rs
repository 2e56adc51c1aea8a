//! Flat mirrors, and the lamps seen in them.
//!
//! A lamp of emission E before a flat mirror that reflects the part m shines like a lamp of emission m E at its image behind the
//! mirror, on all points from which the image is seen within the mirror's frame (virtual worlds: Rushmeier 1986; Wallace, Cohen
//! & Greenberg, "A two-pass solution to the rendering equation", SIGGRAPH 1987). So lamps in mirrors have closed forms like
//! all lamps, where rays would have to find a small lamp by way of the mirror.
//!
//! Exact for one reflection. Light by way of two mirrors, of bent ones or of glass is left to rays.

use super::flat_parts::{flat_parts, groups};
use super::lamp::{GRAIN, Lamp};
use crate::error::Result;
use crate::geometry::Vec3;
use crate::geometry::polygon::{Plane, area_vector, clip_to_front};
use crate::scene::{Material, Scene};
use crate::visibility::{NO_PATCH, Segment};

/// Mirrors smaller than this part of the scene's area are left to rays.
const SMALLEST: f64 = 1.0 / 256.0;

/// A flat convex mirror.
#[derive(Debug, Clone)]
pub struct FlatMirror {
    ring: Vec<Vec3>,
    plane: Plane,
    /// The part of the light that it reflects.
    reflected: f64,
    pub(super) patches: Vec<u32>,
}

impl FlatMirror {
    /// The flat mirrors of a scene that are not small, the largest first.
    pub(super) fn of_scene(scene: &Scene) -> Result<Vec<FlatMirror>> {
        let reflected = |i: usize| match scene.material(i) {
            Material::Mirror(reflected) if reflected > 0.0 => Some(reflected),
            _ => None,
        };
        let mut mirrors = Vec::new();
        for group in groups(scene, |i| reflected(i).map(|part| vec![part.to_bits()])) {
            let reflected = reflected(group[0] as usize).unwrap_or(0.0);
            for (ring, patches) in flat_parts(scene, &group)? {
                mirrors.push(FlatMirror { plane: Plane::of(&ring), ring, reflected, patches });
            }
        }
        let least = SMALLEST * scene.areas().iter().sum::<f64>();
        let area = |mirror: &FlatMirror| area_vector(&mirror.ring).length();
        mirrors.retain(|mirror| area(mirror) >= least);
        mirrors.sort_by(|a, b| area(b).total_cmp(&area(a)));
        Ok(mirrors)
    }

    /// What a point looks like in the mirror.
    fn image(&self, x: Vec3) -> Vec3 {
        x - 2.0 * self.plane.distance(x) * self.plane.normal
    }

    /// What a lamp looks like in the mirror; nothing where the mirror is behind the lamp or the lamp behind the mirror.
    pub(super) fn images(&self, lamp: &Lamp) -> Vec<Lamp> {
        let mut before = Vec::new();
        clip_to_front(lamp.corners(), &self.plane, &mut before);
        let is_lit = self.ring.iter().any(|corner| lamp.shines_on(*corner));
        if before.len() < 3 || !is_lit || !(area_vector(&before).length() > 0.0) {
            return Vec::new();
        }
        // A mirror turns the order of corners round.
        let corners: Vec<Vec3> = before.iter().rev().map(|corner| self.image(*corner)).collect();
        let emission: Vec<f64> = lamp.emission.iter().map(|e| self.reflected * e).collect();
        Lamp::fan_of(&corners, &emission)
    }

    /// The way of a segment to a point of an image, by way of the mirror: to the mirror, and on to the point itself. `None` where
    /// the image is not seen in the mirror.
    pub(super) fn folded(&self, segment: &Segment) -> Option<[Segment; 2]> {
        let (before, behind) = (self.plane.distance(segment.start), self.plane.distance(segment.end));
        // On its own back a point lies in the plane of the mirror, not before it, as far as rounding lets one tell.
        let largest = self.ring.iter().map(|v| v.abs().max_element()).fold(0.0, f64::max);
        let least = GRAIN * (largest + segment.start.abs().max_element());
        if !(before > least && behind < 0.0) {
            return None;
        }
        let on = segment.start + before / (before - behind) * (segment.end - segment.start);
        let is_left = |k: usize| {
            let (a, b) = (self.ring[k], self.ring[(k + 1) % self.ring.len()]);
            (b - a).cross(on - a).dot(self.plane.normal) >= 0.0
        };
        (0..self.ring.len()).all(is_left).then(|| {
            let [start, _] = segment.exclude;
            [
                Segment { start: segment.start, end: on, exclude: [start, NO_PATCH] },
                Segment { start: on, end: self.image(segment.end), exclude: [NO_PATCH; 2] },
            ]
        })
    }
}
