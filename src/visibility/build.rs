//! The binary tree over boxes: where to cut.
//!
//! Binned surface area heuristic (Wald 2007, "On fast Construction of SAH-based Bounding Volume Hierarchies"): of the
//! planes between [`BINS`] bins a side, the one with the least  A_l c(n_l) + A_r c(n_r),  where A is a box's half area
//! and c(n) estimates the work for n triangles. It cuts down to single triangles; which of them share a leaf is decided
//! when the tree is made wide ([`super::wide`]).
//!
//! What has no cut (equal centres), or lies deeper than any sound scene needs, is halved by count: depth and time stay
//! bounded whatever the input.

use glam::Vec3A;

/// Planes that are tried lie between this many bins a side.
const BINS: usize = 32;
/// Cuts by area up to this depth, by count below it. A balanced tree of 10^9 triangles is 30 deep.
const DEEPEST: usize = 64;
/// Parts with more triangles than this are shared between threads.
const PARALLEL: usize = 4096;

/// An axis-parallel box.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bounds {
    pub(super) low: Vec3A,
    pub(super) high: Vec3A,
}

impl Bounds {
    pub(super) const EMPTY: Bounds = Bounds { low: Vec3A::INFINITY, high: Vec3A::NEG_INFINITY };

    /// The box around both.
    #[inline]
    fn with(&self, other: &Bounds) -> Bounds {
        Bounds { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    /// Half the surface.
    #[inline]
    pub(super) fn half_area(&self) -> f32 {
        let size = self.high - self.low;
        size.x * size.y + size.y * size.z + size.z * size.x
    }

    /// Twice the centre.
    #[inline]
    pub(super) fn twice_centre(&self) -> Vec3A {
        self.low + self.high
    }
}

/// A node of the binary tree.
#[derive(Debug, Clone, Copy)]
pub(super) struct BinaryNode {
    pub(super) bounds: Bounds,
    pub(super) content: Content,
}

/// What a binary node holds.
#[derive(Debug, Clone, Copy)]
pub(super) enum Content {
    /// One box, by its number.
    Leaf(u32),
    /// The nodes of this number and the next.
    Children(u32),
}

/// A box and its number.
#[derive(Debug, Clone, Copy)]
struct Item {
    bounds: Bounds,
    number: u32,
}

/// A binary tree with one box a leaf, parents before their children; the root comes first.
pub(super) fn binary_tree(boxes: impl Iterator<Item = Bounds>) -> Vec<BinaryNode> {
    let mut items: Vec<Item> = boxes.enumerate().map(|(k, bounds)| Item { bounds, number: k as u32 }).collect();
    if items.is_empty() {
        return Vec::new();
    }
    let empty = BinaryNode { bounds: Bounds::EMPTY, content: Content::Leaf(0) };
    let mut nodes = vec![empty; 2 * items.len() - 1];
    let (root, rest) = nodes.split_at_mut(1);
    split(&mut items, 0, &mut root[0], rest, 1);
    nodes
}

/// Fills `node` with the tree over `items`; `rest` is room for its descendants, from number `at`.
fn split(items: &mut [Item], depth: usize, node: &mut BinaryNode, rest: &mut [BinaryNode], at: u32) {
    node.bounds = items.iter().fold(Bounds::EMPTY, |all, item| all.with(&item.bounds));
    if let [item] = items {
        node.content = Content::Leaf(item.number);
        return;
    }
    node.content = Content::Children(at);
    let cut = if depth < DEEPEST { best_cut(items).map(|cut| cut.partition(items)) } else { None };
    // A cut that leaves one side empty, by rounding, is none.
    let middle = cut.filter(|&k| k > 0 && k < items.len()).unwrap_or_else(|| halve(items));
    let is_large = items.len() > PARALLEL;
    let (left, right) = items.split_at_mut(middle);
    let (children, rest) = rest.split_at_mut(2);
    let [left_node, right_node] = children else { return };
    let (left_rest, right_rest) = rest.split_at_mut(2 * middle - 2);
    let (left_at, right_at) = (at + 2, at + 2 * middle as u32);
    if is_large {
        rayon::join(
            || split(left, depth + 1, left_node, left_rest, left_at),
            || split(right, depth + 1, right_node, right_rest, right_at),
        );
    } else {
        split(left, depth + 1, left_node, left_rest, left_at);
        split(right, depth + 1, right_node, right_rest, right_at);
    }
}

/// A plane across `axis`: bins below `bin` go left.
struct Cut {
    axis: usize,
    bin: usize,
    low: f32,
    scale: f32,
}

impl Cut {
    /// Brings what goes left to the front; returns how many.
    fn partition(&self, items: &mut [Item]) -> usize {
        let (mut i, mut j) = (0, items.len());
        while i < j {
            let centre = items[i].bounds.twice_centre()[self.axis];
            if bin_of((centre - self.low) * self.scale) < self.bin {
                i += 1;
            } else {
                j -= 1;
                items.swap(i, j);
            }
        }
        i
    }
}

/// NaN (0 times the infinite scale of a flat axis) falls into the first bin.
#[inline]
fn bin_of(place: f32) -> usize {
    (place as usize).min(BINS - 1)
}

/// c(n): packs of eight, which cost the same however full they are; a part of one has the better chance to be small.
fn work(n: u32) -> f32 {
    let packs = n as f32 / 8.0;
    if packs <= 1.0 { 0.5 + 0.5 * packs } else { packs.ceil() }
}

/// The cut of least cost, if the centres can be told apart.
fn best_cut(items: &[Item]) -> Option<Cut> {
    let Bounds { low, high } = centres(items);
    // A little less than BINS, so that the last centre falls into the last bin.
    let scales = (BINS as f32 * (1.0 - 1e-6)) / (high - low);
    let mut bins = [[(Bounds::EMPTY, 0u32); BINS]; 3];
    for item in items {
        let places = (item.bounds.twice_centre() - low) * scales;
        for axis in 0..3 {
            let (bounds, count) = &mut bins[axis][bin_of(places[axis])];
            *bounds = bounds.with(&item.bounds);
            *count += 1;
        }
    }
    let mut best: Option<(f32, Cut)> = None;
    for axis in 0..3 {
        if !(high[axis] > low[axis]) || !scales[axis].is_finite() {
            continue;
        }
        let mut right = [(0.0f32, 0u32); BINS];
        let (mut bounds, mut count) = (Bounds::EMPTY, 0);
        for bin in (1..BINS).rev() {
            bounds = bounds.with(&bins[axis][bin].0);
            count += bins[axis][bin].1;
            right[bin] = (bounds.half_area(), count);
        }
        (bounds, count) = (Bounds::EMPTY, 0);
        for bin in 1..BINS {
            bounds = bounds.with(&bins[axis][bin - 1].0);
            count += bins[axis][bin - 1].1;
            if count == 0 || right[bin].1 == 0 {
                continue;
            }
            let cost = bounds.half_area() * work(count) + right[bin].0 * work(right[bin].1);
            if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                best = Some((cost, Cut { axis, bin, low: low[axis], scale: scales[axis] }));
            }
        }
    }
    best.map(|(_, cut)| cut)
}

/// Halves by count along the widest axis of the centres.
fn halve(items: &mut [Item]) -> usize {
    let Bounds { low, high } = centres(items);
    let size = high - low;
    let axis = if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    };
    let middle = items.len() / 2;
    items.select_nth_unstable_by(middle, |a, b| {
        let [a_centre, b_centre] = [a, b].map(|item| item.bounds.twice_centre()[axis]);
        a_centre.total_cmp(&b_centre).then(a.number.cmp(&b.number))
    });
    middle
}

/// The box around the centres, twice as large.
fn centres(items: &[Item]) -> Bounds {
    items.iter().fold(Bounds::EMPTY, |all, item| {
        let centre = item.bounds.twice_centre();
        Bounds { low: all.low.min(centre), high: all.high.max(centre) }
    })
}
