//! Links: the form factors of a scene, each between the two largest nodes of the tree that it can stand for.
//!
//!   H = push S pull B,    S symmetric
//!
//! The product pulls radiosity up the tree, lets every node gather over its links, and pushes irradiance down (Hanrahan, Salzman
//! & Aupperle 1991, section 4.1). Each link is stored once and read from both sides: A_i F_ij = A_j F_ji to rounding.

use rayon::prelude::*;

use super::link::{Found, NO_MATRIX};
use super::push_pull::{Layout, multiply};
use super::tree::Tree;
use crate::assembly::{FormFactors, Order, apply_reciprocal};
use crate::geometry::sampling::hash;

/// A link as one of its nodes sees it.
#[derive(Debug, Clone, Copy, Default)]
struct End {
    /// The matrix.
    at: usize,
    /// The other node.
    other: u32,
    /// Whether this node is q, and the matrix to be read by columns.
    is_second: bool,
}

/// The links of a scene as an operator.
///
/// A vector has the coefficients of the functions on the leaves: where radiosity is constant, one a patch, in the order of the
/// patches.
#[derive(Debug, Clone)]
pub struct Links {
    /// The elements.
    pub tree: Tree,
    /// The links with their matrices.
    pub found: Found,
    layout: Layout,
    /// Ends of links at node k: `ends[start[k]..start[k + 1]]`.
    start: Vec<usize>,
    ends: Vec<End>,
    /// The leaf of every row, the function, and the area.
    rows: Vec<(u32, u32)>,
    areas: Vec<f64>,
}

impl Links {
    /// Of a tree and its links.
    pub fn new(tree: Tree, found: Found) -> Links {
        let count = tree.nodes.len();
        let mut start = vec![0; count + 1];
        let carrying = || found.links.iter().enumerate().filter(|(_, link)| link.at != NO_MATRIX);
        carrying().for_each(|(_, link)| [link.p, link.q].iter().for_each(|&k| start[k as usize + 1] += 1));
        (0..count).for_each(|k| start[k + 1] += start[k]);
        let mut ends = vec![End::default(); start[count]];
        let mut next = start.clone();
        for (_, link) in carrying() {
            for (node, other, is_second) in [(link.p, link.q, false), (link.q, link.p, true)] {
                ends[next[node as usize]] = End { at: link.at, other, is_second };
                next[node as usize] += 1;
            }
        }
        let rows: Vec<(u32, u32)> = match tree.order() {
            Order::Constant => tree.node_of.iter().map(|&node| (node, 0)).collect(),
            Order::Linear => (0..count as u32)
                .filter(|&k| tree.nodes[k as usize].is_leaf())
                .flat_map(|k| (0..tree.nodes[k as usize].functions.len() as u32).map(move |f| (k, f)))
                .collect(),
        };
        let areas = rows.iter().map(|row| tree.nodes[row.0 as usize].area).collect();
        Links { layout: Layout::new(&tree), tree, found, start, ends, rows, areas }
    }

    /// Nothing, to hold a place.
    pub(super) fn empty() -> Links {
        Links::new(Tree::empty(), Found::default())
    }

    /// The tree and the links apart, for more refinement.
    pub fn into_parts(self) -> (Tree, Found) {
        (self.tree, self.found)
    }

    /// A number that is another one for another tree, or another order of its nodes: what links are worth nothing without.
    pub fn tree_mark(&self) -> u64 {
        let of_nodes = self.tree.nodes.iter().flat_map(|node| {
            let (first, last) = (u64::from(node.patches.start), u64::from(node.patches.end));
            [node.area.to_bits(), first, last, u64::from(node.level)]
        });
        let of_patches = self.tree.sorted.iter().chain(&self.tree.node_of).map(|&k| u64::from(k));
        self.layout.words().chain(of_nodes).chain(of_patches).fold(0, |mark, word| hash(mark ^ word))
    }

    /// The leaf and the function of every row.
    pub fn rows(&self) -> &[(u32, u32)] {
        &self.rows
    }

    /// Numbers of every node: see [`Links::pulled`].
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Places in an array of all nodes of the numbers of row r.
    fn place(&self, r: usize, bands: usize) -> usize {
        let (leaf, function) = self.rows[r];
        self.layout.of(leaf as usize, bands).start + function as usize * bands
    }

    /// The moments of every node for a vector x, `bands` numbers a row.
    pub fn pulled(&self, x: &[f64], bands: usize) -> Vec<f64> {
        let mut moments = vec![0.0; self.layout.len() * bands];
        for (r, row) in x.chunks_exact(bands).enumerate() {
            let at = self.place(r, bands);
            moments[at..at + bands].iter_mut().zip(row).for_each(|(m, x)| *m = self.areas[r] * x);
        }
        self.layout.pull(bands, &mut moments);
        moments
    }

    /// The links that end at a node.
    fn ends(&self, node: usize) -> &[End] {
        &self.ends[self.start[node]..self.start[node + 1]]
    }

    /// Adds to `out` what a node gathers over its own links.
    fn gather_at(&self, node: usize, moments: &[f64], bands: usize, out: &mut [f64]) {
        for end in self.ends(node) {
            let from = &moments[self.layout.of(end.other as usize, bands)];
            self.carry(end, node, !end.is_second, from, bands, out);
        }
    }

    /// out_k += sum over l of S_kl from_l for a link's end at `node`; forwards from its q to its p, or the other way.
    fn carry(&self, end: &End, node: usize, forwards: bool, from: &[f64], bands: usize, out: &mut [f64]) {
        let [here, there] = [node, end.other as usize].map(|k| self.layout.functions(k));
        let [rows, columns] = if end.is_second { [there, here] } else { [here, there] };
        multiply(&self.found.matrices[end.at..], rows, columns, !forwards, from, bands, out);
    }

    /// What arrives at every node from a vector x, pushed down.
    pub fn arriving(&self, x: &[f64], bands: usize) -> Vec<f64> {
        let moments = self.pulled(x, bands);
        let mut arriving = vec![0.0; moments.len()];
        let mut parts = Vec::with_capacity(self.tree.nodes.len());
        let mut rest = arriving.as_mut_slice();
        for number in 0..self.tree.nodes.len() {
            let (own, after) = rest.split_at_mut(self.layout.of(number, bands).len());
            parts.push(own);
            rest = after;
        }
        let gather = |(number, out): (usize, &mut [f64])| self.gather_at(number, &moments, bands, out);
        parts.into_par_iter().with_min_len(64).enumerate().for_each(gather);
        self.layout.push(bands, &mut arriving);
        arriving
    }

    /// 1 - F 1, a number a row: what light that is 1 everywhere does not bring back.
    pub fn missing(&self) -> Vec<f64> {
        let mut one = self.ones();
        let mut sums = vec![0.0; one.len()];
        self.apply(&one, 1, &mut sums);
        one.iter_mut().zip(sums).for_each(|(one, sum)| *one -= sum);
        one
    }

    /// The vector of what is 1 everywhere.
    fn ones(&self) -> Vec<f64> {
        self.rows.iter().map(|&(_, function)| f64::from(u8::from(function == 0))).collect()
    }

    /// For every node the sum over j of |dF_ij|, at most: what its links and those of all above it may be wrong by.
    pub fn row_errors(&self) -> Vec<f64> {
        let mut errors = vec![0.0; self.tree.nodes.len()];
        for link in &self.found.links {
            for node in [link.p, link.q] {
                errors[node as usize] += link.exchange.error() / self.tree.nodes[node as usize].area;
            }
        }
        for number in 1..errors.len() {
            errors[number] += errors[self.tree.nodes[number].parent as usize];
        }
        errors
    }

    /// For every row of leaves the sum over its links, and those of all above it, of what `part` makes of link k and of the error that
    /// it may put in from a vector x.
    fn errors(&self, x: &[f64], bands: usize, part: impl Fn(usize, f64) -> f64) -> Vec<f64> {
        let moments = self.pulled(x, bands);
        let mut errors = vec![0.0; self.tree.nodes.len() * bands];
        for (k, link) in self.found.links.iter().enumerate() {
            let (p, q) = (link.p as usize, link.q as usize);
            let of_kernel = link.exchange.error() / (self.tree.nodes[p].area * self.tree.nodes[q].area);
            for (to, from) in [(p, q), (q, p)] {
                for b in 0..bands {
                    // The first moment is the power.
                    let power = moments[self.layout.of(from, bands).start + b];
                    errors[to * bands + b] += part(k, of_kernel * power);
                }
            }
        }
        for number in 1..self.tree.nodes.len() {
            let parent = self.tree.nodes[number].parent as usize;
            (0..bands).for_each(|b| errors[number * bands + b] += errors[parent * bands + b]);
        }
        let of_row = |&(leaf, function): &(u32, u32)| {
            let factor = f64::from(u8::from(function == 0));
            errors[leaf as usize * bands..][..bands].iter().map(move |e| factor * e).collect::<Vec<f64>>()
        };
        self.rows.iter().flat_map(of_row).collect()
    }
}

impl FormFactors for Links {
    fn len(&self) -> usize {
        self.rows.len()
    }

    fn areas(&self) -> Option<&[f64]> {
        Some(&self.areas)
    }

    fn gather(&self, i: usize, x: &[f64], out: &mut [f64]) {
        let bands = out.len();
        let moments = self.pulled(x, bands);
        let (leaf, function) = self.rows[i];
        let above: Vec<usize> = self.layout.up(leaf as usize).collect();
        let mut arriving: Vec<f64> = Vec::new();
        for &node in above.iter().rev() {
            let mut own = vec![0.0; self.layout.of(node, bands).len()];
            if !arriving.is_empty() {
                self.layout.push_one(node, bands, &arriving, &mut own);
            }
            self.gather_at(node, &moments, bands, &mut own);
            arriving = own;
        }
        out.copy_from_slice(&arriving[function as usize * bands..][..bands]);
    }

    fn shoot(&self, i: usize, amount: &[f64], out: &mut [f64]) {
        let bands = amount.len();
        let leaf = self.rows[i].0 as usize;
        let mut moments = vec![0.0; self.layout.len() * bands];
        let at = self.place(i, bands);
        moments[at..at + bands].iter_mut().zip(amount).for_each(|(m, x)| *m = self.areas[i] * x);
        let mut arriving = vec![0.0; moments.len()];
        for node in self.layout.up(leaf) {
            let own = moments[self.layout.of(node, bands)].to_vec();
            for end in self.ends(node) {
                let to = self.layout.of(end.other as usize, bands);
                self.carry(end, node, end.is_second, &own, bands, &mut arriving[to]);
            }
            self.layout.pull_one(node, bands, &mut moments);
        }
        self.layout.push(bands, &mut arriving);
        for (r, out) in out.chunks_exact_mut(bands).enumerate() {
            let at = self.place(r, bands);
            out.iter_mut().zip(&arriving[at..]).for_each(|(out, h)| *out += h);
        }
    }

    fn apply(&self, x: &[f64], bands: usize, out: &mut [f64]) {
        let arriving = self.arriving(x, bands);
        for (r, out) in out.chunks_exact_mut(bands).enumerate() {
            let at = self.place(r, bands);
            out.copy_from_slice(&arriving[at..at + bands]);
        }
    }

    fn apply_transposed(&self, x: &[f64], bands: usize, out: &mut [f64]) {
        apply_reciprocal(self, &self.areas, x, bands, out);
    }

    fn standard_error(&self, x: &[f64], bands: usize) -> Option<Vec<f64>> {
        // In units of the largest, squares neither overflow nor vanish.
        let peak = x.iter().fold(f64::MIN_POSITIVE, |peak, x| x.abs().max(peak));
        let of_unit: Vec<f64> = x.iter().map(|x| x / peak).collect();
        let variances = self.errors(&of_unit, bands, |_, error| error * error);
        Some(variances.into_iter().map(|v| peak * v.sqrt()).collect())
    }

    fn sampling_error(&self, x: &[f64], bands: usize, draw: u64) -> Option<Vec<f64>> {
        // A random sign has the variance 1, which is all that a sum of many needs.
        Some(self.errors(x, bands, |k, error| if hash(draw ^ hash(k as u64)) & 1 == 0 { error } else { -error }))
    }

    fn row(&self, i: usize, out: &mut [f64]) {
        out.fill(0.0);
        self.shoot(i, &[1.0], out);
        // F_ij = F_ji A_j / A_i.
        out.iter_mut().zip(&self.areas).for_each(|(f, area)| *f *= area / self.areas[i]);
    }

    fn nbytes(&self) -> usize {
        self.tree.nbytes()
            + size_of_val(self.found.links.as_slice())
            + size_of_val(self.found.matrices.as_slice())
            + self.layout.nbytes()
            + size_of_val(self.ends.as_slice())
            + size_of_val(self.start.as_slice())
            + size_of_val(self.rows.as_slice())
            + size_of_val(self.areas.as_slice())
    }
}
