//! Validation at the door: every problem of a scene, found at once, named by patch.

use std::collections::HashMap;

use super::{Description, Material, Scene, Sides};
use crate::error::{Error, Result};
use crate::geometry::{Vec3, polygon};

/// At most this many patches are named for each kind of problem; the rest are counted.
const NAMED: usize = 8;

/// Collects the offenders of one kind of problem.
struct Offenders {
    first: Vec<String>,
    count: usize,
}

impl Offenders {
    fn new() -> Offenders {
        Offenders { first: Vec::new(), count: 0 }
    }

    fn add(&mut self, text: impl FnOnce() -> String) {
        if self.count < NAMED {
            self.first.push(text());
        }
        self.count += 1;
    }

    fn report(mut self, problems: &mut Vec<String>) {
        if self.count > NAMED {
            self.first.push(format!("... and {} more of this kind", self.count - NAMED));
        }
        problems.append(&mut self.first);
    }
}

/// Lengths, finiteness, ranges of indices and materials: what can be told of each patch by itself.
pub(super) fn description(given: &Description) -> Result<()> {
    let Description { vertices, faces, bands, reflectance, emission, materials, .. } = given;
    let mut problems = Vec::new();
    if faces.is_empty() {
        problems.push("the scene has no patches".to_string());
    }
    if vertices.len() > u32::MAX as usize || faces.len() > (u32::MAX / 2) as usize {
        problems.push(format!("{} vertices and {} patches exceed 2^32 and 2^31", vertices.len(), faces.len()));
    }
    if *bands == 0 {
        problems.push("the scene has no bands; at least 1 is needed".to_string());
    }
    for (name, values, limit, range) in
        [("reflectance", reflectance, 1.0, "[0, 1]"), ("emission", emission, f64::MAX, "[0, inf)")]
    {
        if values.len() != faces.len() * bands {
            problems.push(format!(
                "{name} has {} values; {} patches of {bands} bands need {}",
                values.len(),
                faces.len(),
                faces.len() * bands
            ));
            continue;
        }
        let mut offenders = Offenders::new();
        for (k, value) in values.iter().enumerate().filter(|(_, v)| !(**v >= 0.0 && **v <= limit)) {
            let (patch, band) = (k / bands, k % bands);
            offenders.add(|| format!("patch {patch}: {name} {value} is outside {range} (band {band})"));
        }
        offenders.report(&mut problems);
    }
    if materials.len() == faces.len() && reflectance.len() == emission.len() && emission.len() == faces.len() * bands {
        specular(given, &mut problems);
    } else if !materials.is_empty() {
        problems.push(format!("there are {} materials for {} patches", materials.len(), faces.len()));
    }
    let mut offenders = Offenders::new();
    for (k, v) in vertices.iter().enumerate().filter(|(_, v)| !v.is_finite()) {
        offenders.add(|| format!("vertex {k} is ({}, {}, {}); coordinates must be finite", v.x, v.y, v.z));
    }
    offenders.report(&mut problems);
    let mut offenders = Offenders::new();
    for (i, face) in faces.iter().enumerate() {
        if let Some(index) = face.iter().find(|&&v| v < 0 || v as usize >= vertices.len()) {
            offenders.add(|| format!("patch {i}: vertex index {index} is outside 0 .. {}", vertices.len()));
        }
    }
    let indices_hold = offenders.count == 0;
    offenders.report(&mut problems);
    if indices_hold {
        areas(vertices, faces, &mut problems);
    }
    Error::from_problems(problems)
}

/// Mirrors and glass out of range, or with light of their own.
fn specular(given: &Description, problems: &mut Vec<String>) {
    let mut offenders = Offenders::new();
    for (i, &material) in given.materials.iter().enumerate() {
        let is_dark = |values: &[f64]| values[i * given.bands..][..given.bands].iter().all(|value| *value == 0.0);
        match material {
            Material::Diffuse => continue,
            Material::Mirror(reflected) if !(0.0..=1.0).contains(&reflected) => {
                offenders.add(|| format!("patch {i}: a mirror that reflects {reflected} is outside [0, 1]"));
            }
            Material::Glass(ior) if !(ior > 0.0 && ior.is_finite()) => {
                offenders.add(|| format!("patch {i}: index of refraction {ior} is outside (0, inf)"));
            }
            Material::Glass(_) if given.sides == Sides::Both => {
                offenders
                    .add(|| format!("patch {i}: glass has one front, towards the outside; it cannot have both sides"));
            }
            _ => {}
        }
        if !is_dark(&given.reflectance) || !is_dark(&given.emission) {
            let name = material.name();
            offenders.add(|| format!("patch {i}: {name} has no reflectance and no emission; they must be 0"));
        }
    }
    offenders.report(problems);
}

/// Patches without area; those with corners that are not finite have been told of already.
fn areas(vertices: &[Vec3], faces: &[[i64; 3]], problems: &mut Vec<String>) {
    let mut offenders = Offenders::new();
    for (i, face) in faces.iter().enumerate() {
        let [a, b, c] = face.map(|v| vertices[v as usize]);
        if ![a, b, c].iter().all(|v| v.is_finite()) {
            continue;
        }
        let longest = a.distance_squared(b).max(b.distance_squared(c)).max(c.distance_squared(a));
        let area = polygon::area(&[a, b, c]);
        // A cross product of edges is known to a few ulp of their squared length: below that it is no area.
        if !area.is_finite() {
            offenders.add(|| format!("patch {i}: its area overflows; choose a larger unit of length"));
        } else if !(area > 8.0 * f64::EPSILON * longest && area.is_normal()) {
            offenders.add(|| format!("patch {i}: area {area:e} m^2 is zero (corners on a line, or too small a unit)"));
        }
    }
    offenders.report(problems);
}

/// Materials with which no light is ever lost.
pub(super) fn scene(scene: &Scene) -> Result<()> {
    let mut problems = Vec::new();
    for band in 0..scene.bands {
        if (0..scene.len()).all(|i| scene.absorptance(i, band) == 0.0) && is_closed(scene) {
            problems.push(format!(
                "every patch of this closed scene has reflectance 1 in band {band}, or is a mirror of 1 or glass: light \
                 never leaves it and there is no finite solution; at least one patch must absorb"
            ));
        }
    }
    Error::from_problems(problems)
}

/// A position as a key. Adding 0.0 makes -0.0 and 0.0 the same.
fn position(scene: &Scene, vertex: u32) -> [u64; 3] {
    scene.vertices[vertex as usize].to_array().map(|x| (x + 0.0).to_bits())
}

/// The first patch with the corners of an earlier one, after that one: in the same orientation, but where patches have two sides.
pub(super) fn repeated(scene: &Scene) -> Option<[usize; 2]> {
    let given = if scene.mirrored { scene.len() / 2 } else { scene.len() };
    let mut known = HashMap::with_capacity(given);
    (0..given).find_map(|i| {
        let mut corners = scene.faces[i].map(|v| position(scene, v));
        if scene.mirrored {
            corners.sort_unstable();
        } else {
            // Where a patch starts says nothing; which way it goes round does.
            let least = (0..3).min_by_key(|&k| corners[k])?;
            corners.rotate_left(least);
        }
        let first = *known.entry(corners).or_insert(i);
        (first != i).then_some([first, i])
    })
}

/// Whether the patches enclose their fronts: every edge is shared by as many patches in one direction as in the other
/// (corners compared by position), and the signed volume says that the fronts look inward. A closed body seen from outside
/// loses its light to the surroundings; one of two-sided patches is closed whichever way it is wound.
fn is_closed(scene: &Scene) -> bool {
    let fronts = if scene.mirrored { &scene.faces[..scene.len() / 2] } else { &scene.faces[..] };
    let mut balance: HashMap<_, i64> = HashMap::new();
    for face in fronts {
        for k in 0..3 {
            let (a, b) = (position(scene, face[k]), position(scene, face[(k + 1) % 3]));
            if a < b {
                *balance.entry((a, b)).or_default() += 1;
            } else {
                *balance.entry((b, a)).or_default() -= 1;
            }
        }
    }
    let origin = scene.vertices[scene.faces[0][0] as usize];
    let mut volume = 0.0;
    for i in 0..fronts.len() {
        let [a, b, c] = scene.triangle(i).map(|v| v - origin);
        volume += a.dot(b.cross(c)) / 6.0;
    }
    // A sheet with two sides given as two patches each encloses nothing but rounding.
    let rounding = 1e-12 * scene.areas.iter().sum::<f64>().powf(1.5);
    balance.values().all(|&count| count == 0) && (volume < -rounding || (scene.mirrored && volume > rounding))
}
