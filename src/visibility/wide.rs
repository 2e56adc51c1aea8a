//! The tree as it is traversed: nodes of eight boxes, leaves of up to eight triangles, both laid out lane by lane.
//!
//! Made from a binary tree by the cheapest choice of which binary nodes to keep (Ylitie, Karras & Laine 2017, "Efficient
//! Incoherent Ray Traversal on GPUs Through Compressed Wide BVHs", section 3). With A the area of a box,
//!
//!   C(n, 1) = min( A_n c_leaf  if n holds at most 8 triangles,   D(n, 8) + A_n c_node )
//!   C(n, k) = min( D(n, k), C(n, k - 1) )          n as at most k children of one wide node
//!   D(n, k) = min over 0 < m < k of C(left, m) + C(right, k - m)

use super::build::{BinaryNode, Content};
use crate::geometry::{Triangle, Vec3};
use crate::simd::prefetch;

/// Boxes a node, triangles a leaf.
pub(super) const WIDTH: usize = 8;

/// A child that is a leaf: the rest of the number is that of its pack.
pub(super) const LEAF: u32 = 1 << 31;

/// No child: there is nothing more to visit.
pub(super) const DONE: u32 = u32::MAX;

/// Cost of a node and of a leaf, relative: measured, and flat around the optimum.
const NODE_COST: f32 = 1.0;
const LEAF_COST: f32 = 2.0;

/// Eight boxes.
#[derive(Debug, Clone)]
#[repr(C, align(64))]
pub(super) struct Node {
    /// Low x, high x, low y, high y, low z, high z of the children. Those that are not there have boxes that nothing enters.
    pub(super) bounds: [[f32; WIDTH]; 6],
    /// Node number, or pack number with [`LEAF`].
    pub(super) children: [u32; WIDTH],
}

/// Up to eight triangles, in f32: enough to tell which of them a ray may hit.
#[derive(Debug, Clone)]
#[repr(C, align(64))]
pub(super) struct Pack {
    /// Corner, axis, lane.
    pub(super) corners: [[[f32; WIDTH]; 3]; 3],
    /// The longest side of the box around all of them.
    pub(super) extent: f32,
    /// By how much rounding may falsify an edge function of any of them, for a ray that meets this box.
    pub(super) error: f32,
    /// The first triangle, in leaf order.
    pub(super) first: u32,
    /// One bit a triangle.
    pub(super) lanes: u32,
}

/// The wide tree.
#[derive(Debug, Default)]
pub(super) struct Wide {
    pub(super) nodes: Vec<Node>,
    pub(super) packs: Vec<Pack>,
    /// Levels of nodes.
    pub(super) depth: usize,
}

/// By how much the f32 coordinates of a corner, relative to a ray's origin and sheared along it, may be off, in a box of
/// size 2. Corner, origin and shear carry 2^-24 each, of values up to 1, 1 and 2; differences up to 2 and their sum up
/// to 4 are rounded once more: 9e-7.
pub(super) const COORDINATE_ERROR: f32 = 1e-6;

/// A bound on the error of an edge function  x_c y_b - y_c x_b  of triangles in a box with sides up to `extent`, which the
/// ray's axis passes through or within the padding of.
///
/// Sheared coordinates are then at most 2 extent: COORDINATE_ERROR (|x_b| + |y_b| + |x_c| + |y_c|), three roundings of
/// products up to 4 extent^2, extent <= 2, and second order: below 11 COORDINATE_ERROR extent + 2e-11.
fn edge_error(extent: f64) -> f32 {
    (12.0 * f64::from(COORDINATE_ERROR) * extent + 3e-11) as f32
}

/// What is decided for one binary node: the costs C(n, k), and how D(n, k) divides the children.
#[derive(Clone, Copy)]
struct Choice {
    cost: [f32; WIDTH],
    /// Children for the left half in D(n, k); 0 where C(n, k) = C(n, k - 1).
    left: [u8; WIDTH],
    is_leaf: bool,
    triangles: u32,
}

impl Wide {
    /// The wide form of `tree`, whose leaves stand for triangles by number; and the order in which packs hold these.
    pub(super) fn new(tree: &[BinaryNode], triangle: impl Fn(u32) -> Triangle) -> (Wide, Vec<u32>) {
        let mut wide = Wide::default();
        let mut order = Vec::with_capacity(tree.len() / 2 + 1);
        if tree.is_empty() {
            return (wide, order);
        }
        let choices = choose(tree);
        wide.nodes.push(EMPTY);
        // (node to fill, binary node it stands for, level)
        let mut open = vec![(0usize, 0usize, 1usize)];
        while let Some((at, from, level)) = open.pop() {
            wide.depth = wide.depth.max(level);
            let mut children = Vec::with_capacity(WIDTH);
            if choices[from].is_leaf {
                children.push(from);
            } else {
                divide(tree, &choices, from, WIDTH, &mut children);
            }
            let lanes = lanes(tree, from, &children);
            for (&child, &lane) in children.iter().zip(&lanes) {
                let bounds = &tree[child].bounds;
                for axis in 0..3 {
                    wide.nodes[at].bounds[2 * axis][lane] = bounds.low[axis];
                    wide.nodes[at].bounds[2 * axis + 1][lane] = bounds.high[axis];
                }
                wide.nodes[at].children[lane] = if choices[child].is_leaf {
                    let first = order.len();
                    collect(tree, child, &mut order);
                    wide.packs.push(Pack::new(&order[first..], first as u32, &triangle));
                    LEAF | (wide.packs.len() - 1) as u32
                } else {
                    wide.nodes.push(EMPTY);
                    open.push((wide.nodes.len() - 1, child, level + 1));
                    (wide.nodes.len() - 1) as u32
                };
            }
        }
        wide.nodes.shrink_to_fit();
        wide.packs.shrink_to_fit();
        (wide, order)
    }

    /// Asks the memory for a node or a pack that is visited soon: large trees wait for little else.
    #[inline(always)]
    pub(super) fn prefetch(&self, child: u32) {
        let node = self.nodes.as_ptr().wrapping_add(child as usize).cast::<u8>();
        let pack = self.packs.as_ptr().wrapping_add((child & !LEAF) as usize).cast::<u8>();
        // Chosen without a branch, and as many bytes as the larger has.
        prefetch(if child & LEAF == 0 { node } else { pack }, size_of::<Pack>().max(size_of::<Node>()));
    }

    pub(super) fn nbytes(&self) -> usize {
        size_of_val(self.nodes.as_slice()) + size_of_val(self.packs.as_slice())
    }
}

const EMPTY: Node = Node {
    bounds: {
        const NOWHERE: [[f32; WIDTH]; 2] = [[f32::INFINITY; WIDTH], [f32::NEG_INFINITY; WIDTH]];
        [NOWHERE[0], NOWHERE[1], NOWHERE[0], NOWHERE[1], NOWHERE[0], NOWHERE[1]]
    },
    children: [DONE; WIDTH],
};

impl Pack {
    /// The lane of the triangle at `place`, as a bit, if it is here.
    #[inline(always)]
    pub(super) fn lane_of(&self, place: u32) -> u32 {
        let lane = place.wrapping_sub(self.first);
        if lane < WIDTH as u32 { 1 << lane } else { 0 }
    }

    fn new(members: &[u32], first: u32, triangle: &impl Fn(u32) -> Triangle) -> Pack {
        let mut pack =
            Pack { corners: [[[0.0; WIDTH]; 3]; 3], extent: 0.0, error: 0.0, first, lanes: (1 << members.len()) - 1 };
        let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for (lane, &k) in members.iter().enumerate() {
            let corners = triangle(k);
            for (corner, v) in corners.iter().enumerate() {
                for axis in 0..3 {
                    pack.corners[corner][axis][lane] = v[axis] as f32;
                }
            }
            corners.iter().for_each(|v| (low, high) = (low.min(*v), high.max(*v)));
        }
        let extent = (high - low).max_element();
        (pack.extent, pack.error) = ((extent as f32).next_up(), edge_error(extent));
        pack
    }
}

/// C(n, k) of all binary nodes, children before parents.
fn choose(tree: &[BinaryNode]) -> Vec<Choice> {
    let unset = Choice { cost: [0.0; WIDTH], left: [0; WIDTH], is_leaf: true, triangles: 1 };
    let mut choices = vec![unset; tree.len()];
    for (index, node) in tree.iter().enumerate().rev() {
        let area = node.bounds.half_area();
        let Content::Children(first) = node.content else {
            choices[index].cost = [area * LEAF_COST; WIDTH];
            continue;
        };
        let [l, r] = [first as usize, first as usize + 1].map(|child| choices[child]);
        let mut choice = Choice { triangles: l.triangles + r.triangles, ..unset };
        let node_cost = best_division(&l, &r, WIDTH).0 + area * NODE_COST;
        let leaf_cost = if choice.triangles as usize <= WIDTH { area * LEAF_COST } else { f32::INFINITY };
        choice.is_leaf = leaf_cost <= node_cost;
        choice.cost[0] = leaf_cost.min(node_cost);
        for k in 2..=WIDTH {
            let (cost, left) = best_division(&l, &r, k);
            let one_less = choice.cost[k - 2];
            (choice.cost[k - 1], choice.left[k - 1]) = if cost < one_less { (cost, left) } else { (one_less, 0) };
        }
        choices[index] = choice;
    }
    choices
}

/// D(n, k), and how many of the k children go to the left half.
fn best_division(left: &Choice, right: &Choice, k: usize) -> (f32, u8) {
    (1..k).fold((f32::INFINITY, 1), |best, m| {
        let cost = left.cost[m - 1] + right.cost[k - m - 1];
        if cost < best.0 { (cost, m as u8) } else { best }
    })
}

/// The at most `k` binary nodes that become the children for node `n`, which is opened.
fn divide(tree: &[BinaryNode], choices: &[Choice], n: usize, k: usize, children: &mut Vec<usize>) {
    let Content::Children(first) = tree[n].content else { return };
    let first = first as usize;
    let left = usize::from(best_division(&choices[first], &choices[first + 1], k).1);
    place(tree, choices, first, left, children);
    place(tree, choices, first + 1, k - left, children);
}

/// Node `n` as at most `k` children.
fn place(tree: &[BinaryNode], choices: &[Choice], n: usize, k: usize, children: &mut Vec<usize>) {
    // C(n, k) = C(n, k - 1) = ... down to the first number of children that is worth having.
    match (2..=k).rev().find(|&k| choices[n].left[k - 1] != 0) {
        Some(worth) => divide(tree, choices, n, worth, children),
        None => children.push(n),
    }
}

/// Lanes for the children of a node: bit k of a child's lane says on which side it lies along axis k, so that a ray that goes
/// up along all axes meets them about in the order of their lanes, and any other in that order with some bits inverted
/// (Ylitie, Karras & Laine 2017, section 3.3, by their greedy assignment).
fn lanes(tree: &[BinaryNode], node: usize, children: &[usize]) -> [usize; WIDTH] {
    let mut lanes = [0; WIDTH];
    let (mut placed, mut taken) = ([false; WIDTH], [false; WIDTH]);
    for _ in children {
        let mut best = (f32::NEG_INFINITY, 0, 0);
        for child in (0..children.len()).filter(|&k| !placed[k]) {
            let offset = tree[children[child]].bounds.twice_centre() - tree[node].bounds.twice_centre();
            for lane in (0..WIDTH).filter(|&k| !taken[k]) {
                let along = |axis: usize| if lane >> axis & 1 != 0 { offset[axis] } else { -offset[axis] };
                let gain = along(0) + along(1) + along(2);
                if gain > best.0 {
                    best = (gain, child, lane);
                }
            }
        }
        lanes[best.1] = best.2;
        (placed[best.1], taken[best.2]) = (true, true);
    }
    lanes
}

/// The triangles below node `n`.
fn collect(tree: &[BinaryNode], n: usize, out: &mut Vec<u32>) {
    match tree[n].content {
        Content::Leaf(number) => out.push(number),
        Content::Children(first) => {
            collect(tree, first as usize, out);
            collect(tree, first as usize + 1, out);
        }
    }
}
