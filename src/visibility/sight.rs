//! Which patches cannot see each other, told for whole clusters at once.
//!
//! Light may go from x (normal m) to y (normal n) only if m . (y - x) > 0 and n . (x - y) > 0. With intervals for the normals and
//! the places of two clusters, a bound on either product proves that no patch of one faces any of the other.
//!
//! Else one convex body may stand before all: the points of which a given one is hidden by a body make a convex set. What holds for
//! every pair of corners of the clusters' boxes holds for all between them (Cohen-Or, Fibich, Halperin & Zadicario 1998,
//! "Conservative visibility and strong occlusion for viewspace partitioning of densely occluded scenes"). Shadows that only together
//! hide a cluster are not looked for.
//!
//! What may stand between two clusters at all is narrowed down on the way from the root: of the bodies in the shaft between two
//! clusters (Haines & Wallace 1991), those count that reach into the shaft between two parts of them. In a bowl none is left soon.

use std::ops::Range;

use super::bodies::Bodies;
use super::body::extremes;
use super::shaft::Shaft;
use crate::error::Result;
use crate::geometry::Vec3;
use crate::geometry::polygon::Plane;
use crate::progress::Progress;
use crate::scene::Scene;

/// Most patches in a cluster that is not cut.
const LEAF: usize = 16;
/// Of more bodies between two parts of the scene some are between most pairs of leaves and patches in them: to tell which would take
/// longer than it saves, as measured with heaps of triangles.
const MANY: usize = 64;
/// Clusters are cut by direction until no component of the normals differs by more, and by place from there on.
const SPREAD: f64 = 0.5;
/// Room for the rounding of normals and places, relative to the size of the scene and its distance from the origin.
const SLACK: f64 = 1e-9;

/// The patches of a scene in clusters.
pub struct Sights {
    /// The patches, those of a cluster one after the other.
    order: Vec<u32>,
    nodes: Vec<Node>,
    /// The corners of the patches of each leaf.
    corners: Vec<Vec<Vec3>>,
    slack: f64,
}

/// What a patch may see.
#[derive(Debug)]
pub struct View {
    /// Patches, in their order, and for each the number of a list of bodies.
    pub patches: Vec<(u32, u32)>,
    /// Bodies that may stand between the patch and those that have this list; the first list is empty.
    pub bodies: Vec<Vec<u32>>,
}

impl View {
    /// The list of no bodies.
    const NOTHING: u32 = 0;
}

/// A node that may be seen, and the bodies that may stand between.
type Seen = (usize, Vec<u32>);

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
    patches: Range<usize>,
    /// The lowest and the highest number of a patch.
    lowest: u32,
    highest: u32,
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
    /// The clusters of a scene.
    pub fn new(scene: &Scene, bodies: &Bodies) -> Sights {
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
        let corners_of = |node: &Node| {
            let patches = if node.is_leaf { &order[node.patches.clone()] } else { &[] };
            let mut faces: Vec<u32> = patches.iter().flat_map(|&i| scene.faces()[i as usize]).collect();
            faces.sort_unstable();
            faces.dedup();
            faces.into_iter().map(|v| scene.vertices()[v as usize]).collect()
        };
        let corners = nodes.iter().map(corners_of).collect();
        Sights { order, nodes, corners, slack }
    }

    /// The two parts of a node that is no leaf.
    fn parts(&self, k: usize) -> [usize; 2] {
        [k + 1, self.nodes[k + 1].beyond]
    }

    fn are_turned_away(&self, a: &Extent, b: &Extent) -> bool {
        a.is_before(b, self.slack) || b.is_before(a, self.slack)
    }

    /// Calls `visit` with what each of some patches may see of the patches with lower numbers; returns what it gave, in the order of
    /// the clusters.
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`], and those of `visit`.
    pub fn visit<T: Send>(
        &self,
        patches: &Range<u32>,
        scene: &Scene,
        bodies: &Bodies,
        progress: &Progress,
        visit: &(impl Fn(u32, &View) -> Result<T> + Sync),
    ) -> Result<Vec<T>> {
        if self.nodes.is_empty() {
            return Ok(Vec::new());
        }
        let all = vec![(0, (0..bodies.bodies.len() as u32).collect())];
        let visit_leaf = |leaf: usize, seen: &[Seen]| {
            let members = self.order[self.nodes[leaf].patches.clone()].iter().copied();
            let of_patch = |i: u32| {
                progress.advance(0)?;
                visit(i, &self.view(i, seen, scene, bodies))
            };
            members.filter(|i| patches.contains(i)).map(of_patch).collect()
        };
        Walk { sights: self, patches, bodies, progress, visit_leaf: &visit_leaf }.below(0, &all)
    }

    /// Whether all of a node lies before a plane, or behind it by no more than `slack`, which is what rounding may do.
    fn lies_before(&self, plane: &Plane, k: usize, slack: f64) -> bool {
        let Extent { low, high, .. } = &self.nodes[k].extent;
        let half = 0.5 * (*high - *low);
        let (middle, reach) = (plane.distance(*low + half), half.dot(plane.normal.abs()));
        if middle - reach >= -slack {
            return true;
        }
        if middle + reach < -slack {
            return false;
        }
        if self.nodes[k].is_leaf {
            return self.corners[k].iter().all(|x| plane.distance(*x) >= -slack);
        }
        self.parts(k).into_iter().all(|part| self.lies_before(plane, part, slack))
    }

    /// What patch i may see of some leaves.
    fn view(&self, i: u32, seen: &[Seen], scene: &Scene, bodies: &Bodies) -> View {
        let (triangle, own) = (scene.triangle(i as usize), Extent::of(scene, bodies, i));
        let mut view = View { patches: Vec::new(), bodies: vec![Vec::new()] };
        for (to, between) in seen {
            let node = &self.nodes[*to];
            if node.lowest >= i || self.are_turned_away(&own, &node.extent) {
                continue;
            }
            let mut near = Vec::new();
            if between.len() > MANY {
                near.clone_from(between);
            } else if !between.is_empty() {
                let corners = node.extent.corners();
                if are_hidden(bodies, between, &own, &triangle, &node.extent, &corners) {
                    continue;
                }
                let shaft = Shaft::between(&triangle, &corners, [Some(scene.plane(i as usize)), None]);
                near = bodies.around(between, &shaft, |face| {
                    triangle.iter().all(|x| face.distance(*x) >= -shaft.slack)
                        && self.lies_before(face, *to, shaft.slack)
                });
            }
            let mut list = View::NOTHING;
            if !near.is_empty() {
                list = view.bodies.len() as u32;
                view.bodies.push(near);
            }
            let patches = self.order[node.patches.clone()].iter().filter(|&&j| j < i);
            view.patches.extend(patches.map(|&j| (j, list)));
        }
        view.patches.sort_unstable();
        view
    }
}

/// A walk from the root, for some patches.
struct Walk<'a, V> {
    sights: &'a Sights,
    patches: &'a Range<u32>,
    bodies: &'a Bodies,
    progress: &'a Progress,
    visit_leaf: &'a V,
}

impl<V> Walk<'_, V> {
    /// What is given for the patches below a cluster, which may see no more than some nodes and all below these.
    fn below<T: Send>(&self, from: usize, above: &[Seen]) -> Result<Vec<T>>
    where
        V: Fn(usize, &[Seen]) -> Result<Vec<T>> + Sync,
    {
        let node = &self.sights.nodes[from];
        if node.lowest >= self.patches.end || node.highest < self.patches.start {
            return Ok(Vec::new());
        }
        let mut seen = Vec::with_capacity(above.len());
        above.iter().try_for_each(|(to, between)| self.look(from, *to, between, &mut seen))?;
        if node.is_leaf {
            return (self.visit_leaf)(from, &seen);
        }
        let [one, other] = self.sights.parts(from);
        let (left, right) = rayon::join(|| self.below(one, &seen), || self.below(other, &seen));
        let mut all = left?;
        all.extend(right?);
        Ok(all)
    }

    /// Adds what may be seen from one cluster of all in another, as nodes no larger than that cluster, or leaves where it is one; with
    /// what of `between` may stand between.
    fn look(&self, from: usize, to: usize, between: &[u32], seen: &mut Vec<Seen>) -> Result<()> {
        self.progress.advance(0)?;
        let Walk { sights, bodies, .. } = self;
        let (a, b) = (&sights.nodes[from], &sights.nodes[to]);
        let boxes = [a, b].map(|node| node.extent.corners());
        let apart = b.lowest >= self.patches.end.min(a.highest)
            || sights.are_turned_away(&a.extent, &b.extent)
            || are_hidden(bodies, between, &a.extent, &boxes[0], &b.extent, &boxes[1]);
        if apart {
            return Ok(());
        }
        let between = if a.is_leaf && b.is_leaf && between.len() > MANY {
            between.to_vec()
        } else {
            let shaft = Shaft::between(&boxes[0], &boxes[1], [None; 2]);
            bodies.around(between, &shaft, |face| [from, to].iter().all(|k| sights.lies_before(face, *k, shaft.slack)))
        };
        if b.is_leaf || (!a.is_leaf && b.patches.len() <= a.patches.len()) {
            seen.push((to, between));
            return Ok(());
        }
        sights.parts(to).into_iter().try_for_each(|part| self.look(from, part, &between, seen))
    }
}

/// Whether one of some bodies hides all between the hulls of two sets of points, in which these patches are.
fn are_hidden(bodies: &Bodies, some: &[u32], a: &Extent, hull_a: &[Vec3], b: &Extent, hull_b: &[Vec3]) -> bool {
    !a.is_entangled && !b.is_entangled && bodies.some_hides(some, hull_a, hull_b)
}

/// Adds the node of some patches, from the place `first` on, and those below it: halves by direction, then by place.
fn split(extents: &[Extent], order: &mut [u32], first: usize, nodes: &mut Vec<Node>) {
    let at = |i: &u32| &extents[*i as usize];
    let whole = order[1..].iter().fold(*at(&order[0]), |sum, i| sum.joined(at(i)));
    let index = nodes.len();
    let patches = first..first + order.len();
    let (lowest, highest) = order.iter().fold((u32::MAX, 0), |(low, high), i| (low.min(*i), high.max(*i)));
    let is_leaf = order.len() <= LEAF;
    nodes.push(Node { extent: whole, beyond: 0, patches, lowest, highest, is_leaf });
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
