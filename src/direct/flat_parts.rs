//! Patches of one kind merged to flat convex polygons: lamps and mirrors, however finely they are meshed.

use std::collections::BTreeMap;

use crate::error::Result;
use crate::geometry::Vec3;
use crate::scene::{Description, Scene, Sides};
use crate::visibility::convex_polygons;

/// The patches that have a `key`, by it and by the side of space that they face: no group holds both sides of a sheet.
pub(super) fn groups(scene: &Scene, key: impl Fn(usize) -> Option<Vec<u64>>) -> Vec<Vec<u32>> {
    let mut groups: BTreeMap<(Vec<u64>, bool), Vec<u32>> = BTreeMap::new();
    for (i, normal) in scene.normals().iter().enumerate() {
        if let Some(key) = key(i) {
            let first = normal.to_array().into_iter().max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or(0.0);
            groups.entry((key, first > 0.0)).or_default().push(i as u32);
        }
    }
    groups.into_values().collect()
}

/// The corners of each part of a group, counter-clockwise seen from the front, and the patches that it is made of.
///
/// # Errors
/// Those of [`Scene::new`] for these patches alone.
pub(super) fn flat_parts(scene: &Scene, patches: &[u32]) -> Result<Vec<(Vec<Vec3>, Vec<u32>)>> {
    let (mut numbers, mut vertices) = (BTreeMap::new(), Vec::new());
    let mut faces = Vec::with_capacity(patches.len());
    for &i in patches {
        faces.push(scene.faces()[i as usize].map(|v| {
            *numbers.entry(v).or_insert_with(|| {
                vertices.push(scene.vertices()[v as usize]);
                vertices.len() as i64 - 1
            })
        }));
    }
    let dark = vec![0.0; patches.len()];
    let part = Description {
        vertices,
        faces,
        bands: 1,
        reflectance: dark.clone(),
        emission: dark,
        materials: Vec::new(),
        sides: Sides::Front,
    };
    let parts = convex_polygons(&Scene::new(part)?).into_iter();
    Ok(parts.map(|(ring, members)| (ring, members.into_iter().map(|k| patches[k as usize]).collect())).collect())
}
