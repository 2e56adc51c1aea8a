//! Push and pull: what the nodes of the tree know of each other.
//!
//! Pull: the moments  M_k = integral of B psi_k dA  of a node are those of its parts, in its own functions. Push: what arrives at a
//! node arrives at its parts. Either is exact, since what is linear on a node is linear on its parts: power and area are
//! the same on every level.

use std::ops::Range;

use super::tree::{NONE, Tree};

/// Where the numbers of every node stand in an array that holds K x `bands` of each.
#[derive(Debug, Clone)]
pub struct Layout {
    start: Vec<usize>,
}

impl Layout {
    /// For a tree as it is.
    pub fn new(tree: &Tree) -> Layout {
        let mut start = vec![0];
        start.extend(tree.nodes.iter().scan(0, |sum, node| {
            *sum += node.functions.len();
            Some(*sum)
        }));
        Layout { start }
    }

    /// Numbers of one band of all nodes.
    pub fn len(&self) -> usize {
        self.start[self.start.len() - 1]
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Those of one node.
    pub fn of(&self, number: usize, bands: usize) -> Range<usize> {
        self.start[number] * bands..self.start[number + 1] * bands
    }
}

/// Adds the moments of all nodes to those of their parents.
pub fn pull(tree: &Tree, layout: &Layout, bands: usize, moments: &mut [f64]) {
    (1..tree.nodes.len()).rev().for_each(|number| pull_one(tree, layout, number, bands, moments));
}

/// Adds the moments of a node to those of its parent, if it has one.
pub fn pull_one(tree: &Tree, layout: &Layout, number: usize, bands: usize, moments: &mut [f64]) {
    let parent = tree.nodes[number].parent;
    if parent == NONE {
        return;
    }
    let columns = tree.nodes[parent as usize].functions.len();
    // Parents come first.
    let (before, own) = moments.split_at_mut(layout.of(number, bands).start);
    let above = &mut before[layout.of(parent as usize, bands)];
    for (row, weights) in tree.push(number).chunks_exact(columns).enumerate() {
        for (column, weight) in weights.iter().enumerate() {
            for b in 0..bands {
                above[column * bands + b] += weight * own[row * bands + b];
            }
        }
    }
}

/// Adds what arrives at all nodes to what arrives at their parts.
pub fn push(tree: &Tree, layout: &Layout, bands: usize, arriving: &mut [f64]) {
    for number in 1..tree.nodes.len() {
        let parent = tree.nodes[number].parent as usize;
        let (before, own) = arriving.split_at_mut(layout.of(number, bands).start);
        let above = &before[layout.of(parent, bands)];
        push_one(tree, number, bands, above, own);
    }
}

/// Adds to `own` what the numbers `above` of the parent are on a node.
pub fn push_one(tree: &Tree, number: usize, bands: usize, above: &[f64], own: &mut [f64]) {
    let columns = tree.nodes[tree.nodes[number].parent as usize].functions.len();
    for (row, weights) in tree.push(number).chunks_exact(columns).enumerate() {
        for (column, weight) in weights.iter().enumerate() {
            for b in 0..bands {
                own[row * bands + b] += weight * above[column * bands + b];
            }
        }
    }
}

/// A node and all that it is a part of, from itself up.
pub fn up(tree: &Tree, number: usize) -> impl Iterator<Item = usize> + '_ {
    std::iter::successors(Some(number), |&k| {
        let parent = tree.nodes[k].parent;
        (parent != NONE).then_some(parent as usize)
    })
}
