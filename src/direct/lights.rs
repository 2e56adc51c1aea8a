//! Light that no patch emits: suns, points, spots and skies.
//!
//!   H0(x) = sum over suns    of  E cos V(x, w)                      irradiance E across the direction w
//!         + sum over points  of  I(w) cos / r^2 V(x, p)             intensity I, W/sr
//!         + sum over skies   of  integral over w of L(w) cos V(x, w) dw
//!
//! with cos = (n . w)+, and V(x, w) = 1 when nothing stands on the way from x out of the scene. The radiosity equation stays
//! what it is, with this light beside that of the lamps: B = E + rho (H0 + F B).
//!
//! A sky is asked in one random direction ([`super::sky`]); all other lights have one way to every point, and no noise.

use std::f64::consts::PI;

use super::lamp::{GRAIN, Point};
use super::sky::Sky;
use crate::error::{Error, Result};
use crate::geometry::Vec3;
use crate::visibility::{Bvh, NO_PATCH, Segment};

/// Into which directions a spot shines: fully within `beam` of its axis, falling linearly with the angle, not beyond `cutoff`.
#[derive(Debug, Clone, Copy)]
pub struct Cone {
    /// Unit vector from the light.
    pub axis: Vec3,
    /// Half of the angle of the full beam, radians.
    pub beam: f64,
    /// Half of the angle of all light, radians; not below `beam`.
    pub cutoff: f64,
}

impl Cone {
    /// The angle between the axis and a unit vector.
    pub(super) fn angle(&self, along: Vec3) -> f64 {
        angle_between(self.axis, along)
    }

    /// The solid angle of all light, 2 pi (1 - cos cutoff), sr.
    pub(super) fn size(&self) -> f64 {
        4.0 * PI * (0.5 * self.cutoff).sin().powi(2)
    }

    /// The direction that belongs to (u, v) in the unit square, even over the solid angle.
    pub(super) fn direction(&self, u: f64, v: f64) -> Vec3 {
        // 1 - cos of the angle is even from 0 to that of the cutoff.
        let half = u.sqrt() * (0.5 * self.cutoff).sin();
        let (sin, cos) = (2.0 * half * (1.0 - half * half).sqrt(), 1.0 - 2.0 * half * half);
        let (x, y) = self.axis.any_orthonormal_pair();
        let (s, c) = (2.0 * PI * v).sin_cos();
        (sin * c) * x + (sin * s) * y + cos * self.axis
    }

    /// What part of the intensity goes along a unit vector.
    pub(super) fn part(&self, along: Vec3) -> f64 {
        let angle = self.angle(along);
        if angle <= self.beam {
            1.0
        } else if angle >= self.cutoff {
            0.0
        } else {
            (self.cutoff - angle) / (self.cutoff - self.beam)
        }
    }
}

/// The angle between unit vectors, good at both ends (Kahan 2006, "How futile are mindless assessments", section 12).
pub(super) fn angle_between(a: Vec3, b: Vec3) -> f64 {
    2.0 * (a - b).length().atan2((a + b).length())
}

/// A source of light that is no patch.
#[derive(Debug, Clone)]
pub enum Light {
    /// Far away, in one direction.
    Sun {
        /// Unit vector to where it is seen.
        towards: Vec3,
        /// On a plane across that, one a band, W/m^2.
        irradiance: Vec<f64>,
    },
    /// In one place.
    Point {
        /// Where, m.
        position: Vec3,
        /// One a band, W/sr.
        intensity: Vec<f64>,
        /// For a spot.
        cone: Option<Cone>,
    },
    /// All around.
    Sky(Sky),
}

impl Light {
    /// The spectra of its parts, one a band: one part, or the cells of a sky.
    fn spectra(&self) -> &[f64] {
        match self {
            Light::Sun { irradiance, .. } => irradiance,
            Light::Point { intensity, .. } => intensity,
            Light::Sky(sky) => &sky.radiance,
        }
    }

    /// What to ask from a point with a random (u, v); none where the light brings nothing there.
    fn question(&self, tree: &Bvh, point: &Point, numbers: [f64; 2]) -> Option<Question> {
        match self {
            Light::Sun { towards, .. } => {
                let cos = point.normal.dot(*towards);
                let end = tree.outside(point.x, *towards);
                (cos > 0.0).then_some(Question { end, cell: 0, factor: cos })
            }
            Light::Point { position, cone, .. } => {
                let way = *position - point.x;
                if !is_before(point, *position) {
                    return None;
                }
                let (distance, along) = (way.length(), way.normalize_or_zero());
                let part = cone.map_or(1.0, |cone| cone.part(-along));
                let factor = part * (point.normal.dot(along) / distance) / distance;
                (factor > 0.0).then_some(Question { end: *position, cell: 0, factor })
            }
            Light::Sky(sky) => {
                let look = sky.look(point.normal, numbers)?;
                Some(Question { end: tree.outside(point.x, look.towards), cell: look.cell, factor: look.factor })
            }
        }
    }
}

/// Whether a place lies before the surface at a point, as far as rounding lets one tell.
pub(super) fn is_before(point: &Point, place: Vec3) -> bool {
    let grain = GRAIN * point.x.abs().max_element().max(place.abs().max_element());
    point.normal.dot(place - point.x) > grain
}

/// Does a point see this?
#[derive(Debug, Clone, Copy)]
pub(super) struct Question {
    /// Where the segment from the point ends.
    pub(super) end: Vec3,
    /// Which of the spectra arrives.
    pub(super) cell: usize,
    /// What it is to be multiplied by.
    pub(super) factor: f64,
}

/// The lights around and in a scene, which are no part of it.
#[derive(Debug, Clone, Default)]
pub struct Lights {
    pub(super) lights: Vec<Light>,
    bands: usize,
}

impl Lights {
    /// Lights of `bands` bands; none of them is what [`Lights::default`] is.
    ///
    /// # Errors
    /// [`Error::Invalid`] with every problem found: a spectrum of another length, a value that is negative or not finite.
    pub fn new(lights: Vec<Light>, bands: usize) -> Result<Lights> {
        let mut problems = Vec::new();
        for (k, light) in lights.iter().enumerate() {
            let spectra = light.spectra();
            if spectra.is_empty() || !spectra.len().is_multiple_of(bands.max(1)) {
                problems.push(format!("light {k}: {} numbers are no spectra of {bands} bands", spectra.len()));
            }
            if let Some(x) = spectra.iter().find(|x| !(x.is_finite() && **x >= 0.0)) {
                problems.push(format!("light {k}: its strength {x} is outside [0, inf)"));
            }
            let place = match light {
                Light::Sun { towards, .. } => *towards,
                Light::Point { position, .. } => *position,
                Light::Sky(_) => Vec3::ZERO,
            };
            if !place.is_finite() {
                problems.push(format!("light {k}: its place {place} is not finite"));
            }
        }
        Error::from_problems(problems)?;
        Ok(Lights { lights, bands })
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.lights.is_empty()
    }

    /// Number of lights.
    pub fn len(&self) -> usize {
        self.lights.len()
    }

    /// The question that light `l` has for a point.
    pub(super) fn question(&self, l: usize, tree: &Bvh, point: &Point, numbers: [f64; 2]) -> Option<Question> {
        self.lights[l].question(tree, point, numbers)
    }

    /// out_b += factor times the spectrum of a part of light `l`.
    #[inline]
    pub(super) fn add(&self, l: usize, cell: usize, factor: f64, out: &mut [f64]) {
        let spectrum = &self.lights[l].spectra()[cell * self.bands..][..self.bands];
        out.iter_mut().zip(spectrum).for_each(|(out, x)| *out += factor * x);
    }

    /// out_kb += H0 at point k, W/m^2: an unbiased sample with the random `numbers(k)` in the unit square, exact without skies.
    /// The tree is that of all patches: those on the hull stand between nothing but the scene and its lights. Returns the
    /// segments cast.
    pub fn light(&self, points: &[Point], tree: &Bvh, numbers: impl Fn(usize) -> [f64; 2], out: &mut [f64]) -> usize {
        let (mut asked, mut segments) = (Vec::new(), Vec::new());
        for l in 0..self.lights.len() {
            for (k, point) in points.iter().enumerate() {
                if let Some(question) = self.question(l, tree, point, numbers(k)) {
                    asked.push((k, l, question));
                    segments.push(Segment { start: point.x, end: question.end, exclude: [point.patch, NO_PATCH] });
                }
            }
        }
        for ((k, l, question), blocked) in asked.into_iter().zip(tree.blocked(&segments)) {
            if !blocked {
                self.add(l, question.cell, question.factor, &mut out[k * self.bands..][..self.bands]);
            }
        }
        segments.len()
    }
}
