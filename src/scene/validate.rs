//! Validation at the door: every problem of a scene, found at once, named by patch.

use std::collections::HashMap;

use super::{Description, Scene};
use crate::error::{Error, Result};

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

/// Lengths, finiteness and index ranges: what must hold before any geometry can be computed.
pub(super) fn shapes(description: &Description) -> Result<()> {
    let Description { vertices, faces, bands, reflectance, emission, .. } = description;
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
    for (name, values) in [("reflectance", reflectance), ("emission", emission)] {
        if values.len() != faces.len() * bands {
            problems.push(format!(
                "{name} has {} values; {} patches of {bands} bands need {}",
                values.len(),
                faces.len(),
                faces.len() * bands
            ));
        }
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
    offenders.report(&mut problems);
    Error::from_problems(problems)
}

/// Areas and materials.
pub(super) fn values(scene: &Scene) -> Result<()> {
    let mut problems = Vec::new();
    let mut offenders = Offenders::new();
    for i in 0..scene.len() {
        let [a, b, c] = scene.triangle(i);
        let longest = a.distance_squared(b).max(b.distance_squared(c)).max(c.distance_squared(a));
        // A cross product of edges is known to a few ulp of their squared length: below that it is no area.
        if !(scene.areas[i] > 8.0 * f64::EPSILON * longest && scene.areas[i].is_normal()) {
            offenders.add(|| format!("patch {i}: area {:e} m^2 is zero (corners on a line)", scene.areas[i]));
        }
    }
    offenders.report(&mut problems);
    for (name, values, limit, range) in
        [("reflectance", &scene.reflectance, 1.0, "[0, 1]"), ("emission", &scene.emission, f64::MAX, "[0, inf)")]
    {
        let mut offenders = Offenders::new();
        for (k, value) in values.iter().enumerate().filter(|(_, v)| !(**v >= 0.0 && **v <= limit)) {
            let (patch, band) = (k / scene.bands, k % scene.bands);
            offenders.add(|| format!("patch {patch}: {name} {value} is outside {range} (band {band})"));
        }
        offenders.report(&mut problems);
    }
    for band in 0..scene.bands {
        if scene.reflectance.iter().skip(band).step_by(scene.bands).all(|&rho| rho == 1.0) && is_closed(scene) {
            problems.push(format!(
                "every patch of this closed scene has reflectance 1 in band {band}: light never leaves it and there \
                 is no finite solution; at least one patch must have a reflectance below 1"
            ));
        }
    }
    Error::from_problems(problems)
}

/// Whether the patches enclose their fronts: every edge is shared by as many patches in one direction as in the other
/// (corners compared by position), and the signed volume says that the fronts look inward. A closed body seen from outside
/// loses its light to the surroundings.
fn is_closed(scene: &Scene) -> bool {
    let origin = scene.vertices[scene.faces[0][0] as usize];
    let volume: f64 =
        (0..scene.len()).map(|i| scene.triangle(i).map(|v| v - origin)).map(|[a, b, c]| a.dot(b.cross(c))).sum();
    if volume >= 0.0 {
        return false;
    }
    // Adding 0.0 makes -0.0 and 0.0 the same position.
    let key = |v: u32| scene.vertices[v as usize].to_array().map(|x| (x + 0.0).to_bits());
    let mut balance: HashMap<_, i64> = HashMap::new();
    for face in &scene.faces {
        for k in 0..3 {
            let (a, b) = (key(face[k]), key(face[(k + 1) % 3]));
            if a < b {
                *balance.entry((a, b)).or_default() += 1;
            } else {
                *balance.entry((b, a)).or_default() -= 1;
            }
        }
    }
    balance.values().all(|&count| count == 0)
}
