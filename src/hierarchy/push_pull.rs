//! Push and pull: what the nodes of the tree know of each other.
//!
//! Pull: the moments  M_k = integral of B psi_k dA  of a node are those of its parts, in its own functions. Push: what arrives at a
//! node arrives at its parts. Power and area are the same on every level; what is linear on a node is linear on its parts, and lost
//! only as far as a part has no function for it.

use std::ops::Range;

use super::clusters::NONE;
use super::tree::Tree;

/// The tree as products see it, and where the numbers of every node stand in an array that holds K x `bands` of each.
#[derive(Debug, Clone)]
pub struct Layout {
    start: Vec<usize>,
    parents: Vec<u32>,
    /// For each node but the root the parent's functions on it, K rows of as many numbers as the parent has functions.
    push: Vec<f64>,
    push_start: Vec<usize>,
}

impl Layout {
    /// For a tree as it is.
    pub fn new(tree: &Tree) -> Layout {
        let (mut start, mut push_start, mut push) = (vec![0], Vec::with_capacity(tree.nodes.len()), Vec::new());
        for node in &tree.nodes {
            start.push(start[start.len() - 1] + node.functions.len());
            push_start.push(push.len());
            if node.parent != NONE {
                push.extend(node.functions.of_parent(&tree.nodes[node.parent as usize].functions));
            }
        }
        let parents = tree.nodes.iter().map(|node| node.parent).collect();
        Layout { start, parents, push, push_start }
    }

    /// Numbers of one band of all nodes.
    #[expect(clippy::len_without_is_empty, reason = "there is always a root")]
    pub fn len(&self) -> usize {
        self.start[self.start.len() - 1]
    }

    /// K of a node.
    pub fn functions(&self, number: usize) -> usize {
        self.start[number + 1] - self.start[number]
    }

    /// The numbers of one node.
    pub fn of(&self, number: usize, bands: usize) -> Range<usize> {
        self.start[number] * bands..self.start[number + 1] * bands
    }

    /// Adds the moments of all nodes to those of their parents.
    pub fn pull(&self, bands: usize, moments: &mut [f64]) {
        (1..self.parents.len()).rev().for_each(|number| self.pull_one(number, bands, moments));
    }

    /// Adds the moments of a node to those of its parent, if it has one.
    pub fn pull_one(&self, number: usize, bands: usize, moments: &mut [f64]) {
        if self.parents[number] == NONE {
            return;
        }
        let parent = self.parents[number] as usize;
        // Parents come first.
        let (before, own) = moments.split_at_mut(self.start[number] * bands);
        let above = &mut before[self.of(parent, bands)];
        let own = &own[..self.functions(number) * bands];
        multiply(
            &self.push[self.push_start[number]..],
            own.len() / bands,
            above.len() / bands,
            true,
            own,
            bands,
            above,
        );
    }

    /// Adds what arrives at all nodes to what arrives at their parts.
    pub fn push(&self, bands: usize, arriving: &mut [f64]) {
        for number in 1..self.parents.len() {
            let (before, own) = arriving.split_at_mut(self.start[number] * bands);
            let above = &before[self.of(self.parents[number] as usize, bands)];
            self.push_one(number, bands, above, &mut own[..self.functions(number) * bands]);
        }
    }

    /// Adds to `own` what the numbers `above` of the parent are on a node.
    pub fn push_one(&self, number: usize, bands: usize, above: &[f64], own: &mut [f64]) {
        multiply(
            &self.push[self.push_start[number]..],
            own.len() / bands,
            above.len() / bands,
            false,
            above,
            bands,
            own,
        );
    }

    /// A node and all that it is a part of, from itself up.
    pub fn up(&self, number: usize) -> impl Iterator<Item = usize> + '_ {
        std::iter::successors(Some(number), |&k| (self.parents[k] != NONE).then_some(self.parents[k] as usize))
    }

    /// All that products take from here, to be told apart from another layout.
    pub(super) fn words(&self) -> impl Iterator<Item = u64> + '_ {
        let parents = self.parents.iter().map(|&k| u64::from(k));
        self.start.iter().map(|&k| k as u64).chain(parents).chain(self.push.iter().map(|value| value.to_bits()))
    }

    /// Bytes held.
    pub fn nbytes(&self) -> usize {
        size_of_val(self.start.as_slice())
            + size_of_val(self.parents.as_slice())
            + size_of_val(self.push.as_slice())
            + size_of_val(self.push_start.as_slice())
    }
}

/// out += M x, or M^T x, for M of `rows` times `columns` numbers and `bands` numbers an entry of x.
pub fn multiply(
    matrix: &[f64],
    rows: usize,
    columns: usize,
    transposed: bool,
    x: &[f64],
    bands: usize,
    out: &mut [f64],
) {
    // Loops of a fixed length, unrolled: heat, and colours.
    match bands {
        1 => multiply_by::<1>(matrix, rows, columns, transposed, x, out),
        3 => multiply_by::<3>(matrix, rows, columns, transposed, x, out),
        _ => {
            for b in 0..bands {
                for k in 0..rows {
                    for l in 0..columns {
                        let [to, of] = if transposed { [l, k] } else { [k, l] };
                        out[to * bands + b] += matrix[k * columns + l] * x[of * bands + b];
                    }
                }
            }
        }
    }
}

#[inline(always)]
fn multiply_by<const B: usize>(
    matrix: &[f64],
    rows: usize,
    columns: usize,
    transposed: bool,
    x: &[f64],
    out: &mut [f64],
) {
    let (x, _) = x.as_chunks::<B>();
    let (out, _) = out.as_chunks_mut::<B>();
    for (k, numbers) in matrix[..rows * columns].chunks_exact(columns).enumerate() {
        if transposed {
            for (out, s) in out.iter_mut().zip(numbers) {
                (0..B).for_each(|b| out[b] += s * x[k][b]);
            }
        } else {
            for (x, s) in x.iter().zip(numbers) {
                (0..B).for_each(|b| out[k][b] += s * x[b]);
            }
        }
    }
}
