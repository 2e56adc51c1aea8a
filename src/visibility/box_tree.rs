//! A tree of boxes in f64, for questions that are asked of whole objects: what meets a box, a shaft, both sides of a plane.

use crate::geometry::Vec3;
use crate::geometry::polygon::Plane;

/// The most boxes in a leaf of a [`BoxTree`].
const LEAF: usize = 16;

/// Boxes in a binary tree, in the order of a walk from the root: what is not looked into is jumped over.
#[derive(Debug, Clone)]
pub(super) struct BoxTree {
    nodes: Vec<Node>,
    pub(super) items: Vec<(u32, (Vec3, Vec3))>,
}

#[derive(Debug, Clone)]
pub(super) struct Node {
    pub(super) low: Vec3,
    pub(super) high: Vec3,
    /// The node that comes after all below this one.
    beyond: usize,
    /// The boxes of a leaf; empty for an inner node.
    pub(super) items: std::ops::Range<usize>,
}

impl BoxTree {
    pub(super) fn new(items: Vec<(u32, (Vec3, Vec3))>) -> BoxTree {
        let count = items.len();
        let mut tree = BoxTree { nodes: Vec::with_capacity(count / 4 + 1), items };
        if count > 0 {
            tree.split(0, count);
        }
        tree
    }

    /// Halves the boxes at the median along the longest axis: the depth is logarithmic whatever they are.
    fn split(&mut self, first: usize, end: usize) {
        let items = &mut self.items[first..end];
        let low = items.iter().fold(Vec3::INFINITY, |m, (_, (low, _))| m.min(*low));
        let high = items.iter().fold(Vec3::NEG_INFINITY, |m, (_, (_, high))| m.max(*high));
        let index = self.nodes.len();
        self.nodes.push(Node { low, high, beyond: 0, items: first..first });
        if items.len() <= LEAF {
            self.nodes[index].items = first..end;
        } else {
            let extent = (high - low).to_array();
            let axis = (0..3).max_by(|&a, &b| extent[a].total_cmp(&extent[b])).unwrap_or(0);
            let middle = items.len() / 2;
            let place = |(_, (low, high)): &(u32, (Vec3, Vec3))| 0.5 * low[axis] + 0.5 * high[axis];
            items.select_nth_unstable_by(middle, |a, b| place(a).total_cmp(&place(b)).then(a.0.cmp(&b.0)));
            self.split(first, first + middle);
            self.split(first + middle, end);
        }
        self.nodes[index].beyond = self.nodes.len();
    }

    /// Smallest and largest coordinates.
    pub(super) fn bounds(&self) -> (Vec3, Vec3) {
        self.nodes.first().map_or((Vec3::ZERO, Vec3::ZERO), |root| (root.low, root.high))
    }

    /// Calls `opens` with the root, and with the nodes below every one for which it is true.
    pub(super) fn walk(&self, mut opens: impl FnMut(&Node) -> bool) {
        let mut index = 0;
        while let Some(node) = self.nodes.get(index) {
            index = if opens(node) { index + 1 } else { node.beyond };
        }
    }

    /// The boxes that meet a box.
    pub(super) fn meeting(&self, low: Vec3, high: Vec3, mut visit: impl FnMut(u32)) {
        self.walk(|node| {
            let meets = node.low.cmple(high).all() && node.high.cmpge(low).all();
            for (i, (l, h)) in self.items[node.items.clone()].iter().filter(|_| meets) {
                if l.cmple(high).all() && h.cmpge(low).all() {
                    visit(*i);
                }
            }
            meets
        });
    }

    /// Whether any of the points, each a box without extent, lies further before a plane than `beyond[0]`, and whether any
    /// lies further behind it than `beyond[1]`, which is negative.
    pub(super) fn sides(&self, plane: &Plane, beyond: [f64; 2]) -> (bool, bool) {
        let (mut before, mut behind) = (false, false);
        let mut add = |low: f64, high: f64, is_point: bool| {
            let tells = (!before && high > beyond[0]) || (!behind && low < beyond[1]);
            if is_point {
                before |= high > beyond[0];
                behind |= low < beyond[1];
            }
            tells
        };
        self.walk(|node| {
            let half = 0.5 * (node.high - node.low);
            let (middle, reach) = (plane.distance(node.low + half), half.dot(plane.normal.abs()));
            let opens = add(middle - reach, middle + reach, false);
            for (_, (x, _)) in self.items[node.items.clone()].iter().filter(|_| opens) {
                let distance = plane.distance(*x);
                add(distance, distance, true);
            }
            opens
        });
        (before, behind)
    }
}
