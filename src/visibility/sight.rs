//! Which patches cannot see each other, told for whole clusters at once.
//!
//! Light may go from x (normal m) to y (normal n) only if m . (y - x) > 0 and n . (x - y) > 0. With intervals for the normals and
//! the places of two clusters, a bound on either product proves that no patch of one faces any of the other.
//!
//! Else one convex body may stand before all: the points of which a given one is hidden by a body make a convex set. What holds for
//! every pair of corners of the clusters' boxes holds for all between them (Cohen-Or, Fibich, Halperin & Zadicario 1998,
//! "Conservative visibility and strong occlusion for viewspace partitioning of densely occluded scenes"). Shadows that only together
//! hide a cluster are not looked for.

use rayon::prelude::*;

use super::bodies::Bodies;
use super::body::extremes;
use super::shaft::Shaft;
use crate::error::Result;
use crate::geometry::{Triangle, Vec3};
use crate::progress::Progress;
use crate::scene::Scene;

/// Most patches in a cluster that is not cut.
const LEAF: usize = 16;
/// Clusters are cut by direction until no component of the normals differs by more, and by place from there on.
const SPREAD: f64 = 0.5;
/// Room for the rounding of normals and places, relative to the size of the scene and its distance from the origin.
const SLACK: f64 = 1e-9;

/// The patches of a scene in clusters, and what each cluster may see.
pub struct Sights {
    /// The patches, those of a cluster one after the other.
    order: Vec<u32>,
    nodes: Vec<Node>,
    /// The cluster, a leaf of the tree, of every patch.
    leaf_of: Vec<u32>,
    /// The leaves that the patches of every leaf may see.
    seen: Vec<Vec<u32>>,
    slack: f64,
}

/// What a patch may see.
#[derive(Debug, Default)]
pub struct View {
    /// Patches, in their order, and for each the number of a list of bodies.
    pub patches: Vec<(u32, u32)>,
    /// Bodies that may stand between the patch and those that have this list.
    pub bodies: Vec<Vec<u32>>,
}

/// Where some patches are, and which way they face.
#[derive(Debug, Clone, Copy)]
struct Extent {
    low: Vec3,
    high: Vec3,
    /// Smallest and largest components of the normals.
    normals: [Vec3; 2],
    /// Whether a patch stands in a body, or reaches into one: that may be open on a side, and hide nothing of what is in it.
    is_entangled: bool,
}

/// A cluster, in the order of a walk from the root.
#[derive(Debug, Clone)]
struct Node {
    extent: Extent,
    /// The node that comes after all below this one.
    beyond: usize,
    /// The patches, in the order of the tree.
    first: usize,
    end: usize,
    is_leaf: bool,
}

impl Extent {
    fn of(scene: &Scene, bodies: &Bodies, i: u32) -> Extent {
        let (low, high) = extremes(scene.triangle(i as usize));
        Extent { low, high, normals: [scene.normals()[i as usize]; 2], is_entangled: bodies.entangled(i) }
    }

    fn joined(self, other: &Extent) -> Extent {
        let [a, b] = [self.normals, other.normals];
        Extent {
            low: self.low.min(other.low),
            high: self.high.max(other.high),
            normals: [a[0].min(b[0]), a[1].max(b[1])],
            is_entangled: self.is_entangled || other.is_entangled,
        }
    }

    fn corners(&self) -> [Vec3; 8] {
        let pick = |bit: usize, k: usize| if bit == 0 { self.low[k] } else { self.high[k] };
        std::array::from_fn(|c| Vec3::new(pick(c & 1, 0), pick(c >> 1 & 1, 1), pick(c >> 2, 2)))
    }

    /// Whether all of `other` lies behind the plane of every patch here.
    fn is_before(&self, other: &Extent, slack: f64) -> bool {
        let (near, far) = (other.low - self.high, other.high - self.low);
        let [m, n] = self.normals;
        let most = (m * near).max(m * far).max((n * near).max(n * far));
        most.element_sum() <= -slack
    }
}

impl Sights {
    /// # Errors
    /// [`crate::Error::Interrupted`].
    pub fn new(scene: &Scene, bodies: &Bodies, progress: &Progress) -> Result<Sights> {
        let extents: Vec<Extent> = (0..scene.len() as u32).map(|i| Extent::of(scene, bodies, i)).collect();
        let mut order: Vec<u32> = (0..scene.len() as u32).collect();
        let mut nodes = Vec::new();
        if !order.is_empty() {
            split(&extents, &mut order, 0, &mut nodes);
        }
        let slack = nodes.first().map_or(0.0, |root: &Node| {
            let Extent { low, high, .. } = root.extent;
            SLACK * (high - low).max(low.abs()).max(high.abs()).max_element()
        });
        let mut leaf_of = vec![0; scene.len()];
        for (k, node) in nodes.iter().enumerate().filter(|(_, node)| node.is_leaf) {
            order[node.first..node.end].iter().for_each(|&i| leaf_of[i as usize] = k as u32);
        }
        let mut sights = Sights { order, nodes, leaf_of, seen: Vec::new(), slack };
        sights.seen = (0..sights.nodes.len())
            .into_par_iter()
            .map(|k| {
                progress.advance(0)?;
                Ok(if sights.nodes[k].is_leaf { sights.leaves_seen_from(k, bodies) } else { Vec::new() })
            })
            .collect::<Result<_>>()?;
        Ok(sights)
    }

    /// The leaves that a leaf may see.
    fn leaves_seen_from(&self, leaf: usize, bodies: &Bodies) -> Vec<u32> {
        let from = &self.nodes[leaf].extent;
        let corners = from.corners();
        let (mut seen, mut k) = (Vec::new(), 0);
        while let Some(node) = self.nodes.get(k) {
            let apart = self.are_turned_away(from, &node.extent)
                || are_hidden(bodies, from, &corners, &node.extent, &node.extent.corners());
            if node.is_leaf && !apart {
                seen.push(k as u32);
            }
            k = if apart { node.beyond } else { k + 1 };
        }
        seen
    }

    fn are_turned_away(&self, a: &Extent, b: &Extent) -> bool {
        a.is_before(b, self.slack) || b.is_before(a, self.slack)
    }

    /// What patch i of a scene may see of the patches j < i.
    pub fn before(&self, i: u32, scene: &Scene, bodies: &Bodies) -> View {
        let (triangle, own) = (scene.triangle(i as usize), Extent::of(scene, bodies, i));
        let mut view = View::default();
        for &k in &self.seen[self.leaf_of[i as usize] as usize] {
            let node = &self.nodes[k as usize];
            let corners = node.extent.corners();
            let patches = || self.order[node.first..node.end].iter().copied().filter(|&j| j < i);
            let is_empty = self.are_turned_away(&own, &node.extent) || patches().next().is_none();
            if is_empty || are_hidden(bodies, &own, &triangle, &node.extent, &corners) {
                continue;
            }
            let shaft = Shaft::between(&triangle, &corners, [Some(scene.plane(i as usize)), None]);
            let ends: Vec<Triangle> = patches().map(|j| scene.triangle(j as usize)).collect();
            view.patches.extend(patches().map(|j| (j, view.bodies.len() as u32)));
            view.bodies.push(bodies.around(&shaft, &[&triangle, ends.as_flattened()]));
        }
        view.patches.sort_unstable();
        view
    }
}

/// Whether one body hides all between the hulls of two sets of points, in which these patches are.
fn are_hidden(bodies: &Bodies, a: &Extent, hull_a: &[Vec3], b: &Extent, hull_b: &[Vec3]) -> bool {
    !a.is_entangled && !b.is_entangled && bodies.hide(hull_a, hull_b)
}

/// Adds the node of some patches, from the place `first` on, and those below it: halves by direction, then by place.
fn split(extents: &[Extent], order: &mut [u32], first: usize, nodes: &mut Vec<Node>) {
    let at = |i: &u32| &extents[*i as usize];
    let whole = order[1..].iter().fold(*at(&order[0]), |sum, i| sum.joined(at(i)));
    let (index, end) = (nodes.len(), first + order.len());
    let is_leaf = order.len() <= LEAF;
    nodes.push(Node { extent: whole, beyond: 0, first, end, is_leaf });
    if !is_leaf {
        let longest = |v: Vec3| (0..3).max_by(|&a, &b| v[a].total_cmp(&v[b])).unwrap_or(0);
        let spread = whole.normals[1] - whole.normals[0];
        let middle = if spread.max_element() > SPREAD {
            let axis = longest(spread);
            let half = 0.5 * (whole.normals[0][axis] + whole.normals[1][axis]);
            order.sort_unstable_by_key(|i| (at(i).normals[0][axis] > half, *i));
            order.partition_point(|i| at(i).normals[0][axis] <= half)
        } else {
            let axis = longest(whole.high - whole.low);
            let place = |i: &u32| 0.5 * at(i).low[axis] + 0.5 * at(i).high[axis];
            let middle = order.len() / 2;
            order.select_nth_unstable_by(middle, |a, b| place(a).total_cmp(&place(b)).then(a.cmp(b)));
            middle
        };
        let (left, right) = order.split_at_mut(middle);
        split(extents, left, first, nodes);
        split(extents, right, first + middle, nodes);
    }
    nodes[index].beyond = nodes.len();
}
