//! The leaves of the tree as a mesh without T-junctions.
//!
//! Where an element lies beside smaller ones, the middles of its edges are vertices of theirs: it is cut to them, so that what is
//! interpolated between the vertices has no cracks (Baum, Mann, Smith & Winget 1991, "Making radiosity usable").

use super::tree::Tree;
use crate::geometry::Vec3;
use crate::geometry::subdivision::split;

/// Triangles that fit together wherever the patches of the scene do.
#[derive(Debug, Clone)]
pub struct LeafMesh {
    /// Those of the scene, then middles of edges.
    pub vertices: Vec<Vec3>,
    /// Corners of each face.
    pub faces: Vec<[u32; 3]>,
    /// The leaf that each face is, or is a part of.
    pub leaves: Vec<u32>,
    /// The patch of each.
    pub patches: Vec<u32>,
}

impl LeafMesh {
    /// Of a tree.
    pub fn new(tree: &Tree) -> LeafMesh {
        let mut mesh =
            LeafMesh { vertices: tree.vertices.clone(), faces: Vec::new(), leaves: Vec::new(), patches: Vec::new() };
        let mut open = Vec::new();
        // Patch by patch, as the scene has them.
        for (patch, &node) in tree.node_of.iter().enumerate() {
            let mut nodes = vec![node];
            while let Some(number) = nodes.pop() {
                nodes.extend(tree.nodes[number as usize].children.clone().rev());
                if !tree.nodes[number as usize].is_leaf() {
                    continue;
                }
                open.push(tree.face(number as usize));
                while let Some(face) = open.pop() {
                    let [a, b, c] = face;
                    let middle = [[a, b], [b, c], [c, a]].map(|edge| tree.midpoint_of(edge));
                    if middle == [None; 3] {
                        mesh.faces.push(face);
                        mesh.leaves.push(number);
                        mesh.patches.push(patch as u32);
                    } else {
                        split(face, middle, &tree.vertices, &mut open);
                    }
                }
            }
        }
        mesh
    }
}
