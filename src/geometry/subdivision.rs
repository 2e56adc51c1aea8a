//! Subdivision of a triangle mesh until no edge is longer than asked, without T-junctions.
//!
//! An edge is halved, or not, by its own length alone, so both triangles beside it agree and the finer mesh fits
//! together wherever the coarse one did. A triangle with one, two or three halved edges becomes two, three or four.

use std::collections::HashMap;

use super::{Vec3, polygon};
use crate::error::{Error, Result};
use crate::progress::Progress;

/// A finer mesh, and the face of the coarse mesh that each of its faces comes from.
#[derive(Debug, Clone)]
pub struct Subdivision {
    /// The coarse mesh's vertices, then the new ones.
    pub vertices: Vec<Vec3>,
    /// The pieces of face 0, then those of face 1, ...
    pub faces: Vec<[u32; 3]>,
    /// For each new face the index of the face that it is a part of.
    pub parent: Vec<u32>,
}

/// Bytes that a face takes while it is subdivided: its corners, its origin, its share of vertices and of midpoints, and as
/// much again for the mesh that it replaces.
const BYTES_A_FACE: u64 = 160;

/// Halves edges until none is longer than `max_edge`.
///
/// # Errors
/// [`Error::Invalid`] when `max_edge` is not a positive number or below the rounding of the coordinates, [`Error::Memory`]
/// when the result would exceed `memory` bytes or 2^30 faces, [`Error::Interrupted`].
pub fn subdivide(
    vertices: &[Vec3],
    faces: &[[u32; 3]],
    max_edge: f64,
    memory: u64,
    progress: &Progress,
) -> Result<Subdivision> {
    if !(max_edge > 0.0 && max_edge.is_finite()) {
        return Err(Error::Invalid(format!("max_edge {max_edge} is not a positive finite length")));
    }
    let fits = |count: f64| {
        let available = memory.min((1 << 30) * BYTES_A_FACE);
        if count * BYTES_A_FACE as f64 <= available as f64 {
            return Ok(());
        }
        Err(Error::Memory {
            what: format!("the mesh subdivided to edges of {max_edge} (at least {count:.3e} patches)"),
            needed: (count * BYTES_A_FACE as f64) as u64,
            available,
            remedy: "choose a larger max_edge".to_string(),
        })
    };
    // The largest triangle with such edges is equilateral: so many of them it takes at least to cover the area.
    let area: f64 = faces.iter().map(|face| polygon::area(&face.map(|v| vertices[v as usize]))).sum();
    fits(area / (0.25 * 3f64.sqrt() * max_edge * max_edge))?;
    let mut mesh =
        Subdivision { vertices: vertices.to_vec(), faces: faces.to_vec(), parent: (0..faces.len() as u32).collect() };
    loop {
        let is_long = |a: u32, b: u32| mesh.vertices[a as usize].distance(mesh.vertices[b as usize]) > max_edge;
        // A face becomes one more for each of its long edges: known before anything is allocated.
        let halved: usize = mesh
            .faces
            .iter()
            .map(|&[a, b, c]| [(a, b), (b, c), (c, a)].iter().filter(|e| is_long(e.0, e.1)).count())
            .sum();
        if halved == 0 {
            return Ok(mesh);
        }
        let count = mesh.faces.len() + halved;
        fits(count as f64)?;
        progress.expect(count as u64);
        progress.advance(count as u64)?;
        mesh = halve_long_edges(mesh, max_edge)?;
    }
}

fn halve_long_edges(mesh: Subdivision, max_edge: f64) -> Result<Subdivision> {
    let mut vertices = mesh.vertices;
    let mut midpoints: HashMap<(u32, u32), u32> = HashMap::new();
    let mut faces = Vec::with_capacity(mesh.faces.len());
    let mut parent = Vec::with_capacity(mesh.faces.len());
    for (face, origin) in mesh.faces.iter().zip(&mesh.parent) {
        let mut middle = [None; 3];
        for k in 0..3 {
            let (a, b) = (face[k], face[(k + 1) % 3]);
            let (p, q) = (vertices[a as usize], vertices[b as usize]);
            if p.distance(q) > max_edge {
                let between = 0.5 * (p + q);
                if between == p || between == q {
                    return Err(Error::Invalid(format!(
                        "max_edge {max_edge} is below the rounding of coordinates as large as {:e}",
                        p.abs().max_element()
                    )));
                }
                middle[k] = Some(*midpoints.entry((a.min(b), a.max(b))).or_insert_with(|| {
                    vertices.push(between);
                    (vertices.len() - 1) as u32
                }));
            }
        }
        let start = faces.len();
        split(*face, middle, &vertices, &mut faces);
        parent.resize(parent.len() + faces.len() - start, *origin);
    }
    Ok(Subdivision { vertices, faces, parent })
}

/// The pieces of one face; `middle[k]` is the midpoint of the edge from corner k to corner k + 1, if it is halved.
pub(crate) fn split(face: [u32; 3], middle: [Option<u32>; 3], vertices: &[Vec3], out: &mut Vec<[u32; 3]>) {
    let length = |a: u32, b: u32| vertices[a as usize].distance(vertices[b as usize]);
    match middle {
        [None, None, None] => out.push(face),
        [Some(ab), Some(bc), Some(ca)] => {
            let [a, b, c] = face;
            out.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        _ => {
            // Turn the face so that its first edge is halved and its last one is not.
            let turn = (0..3).find(|&k| middle[k].is_some() && middle[(k + 2) % 3].is_none()).unwrap_or(0);
            let [a, b, c] = [face[turn], face[(turn + 1) % 3], face[(turn + 2) % 3]];
            match (middle[turn], middle[(turn + 1) % 3]) {
                (Some(ab), Some(bc)) => {
                    out.push([ab, b, bc]);
                    // The quadrilateral a, ab, bc, c is cut along its shorter diagonal.
                    if length(a, bc) <= length(ab, c) {
                        out.extend([[a, ab, bc], [a, bc, c]]);
                    } else {
                        out.extend([[a, ab, c], [ab, bc, c]]);
                    }
                }
                (Some(ab), None) => out.extend([[a, ab, c], [ab, b, c]]),
                (None, _) => out.push(face),
            }
        }
    }
}
