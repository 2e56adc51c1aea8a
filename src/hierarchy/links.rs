//! Links: the form factors of a scene, each between the two largest nodes of the tree that it can stand for.
//!
//!   H = push S pull B,    S symmetric
//!
//! The product pulls radiosity up the tree, lets every node gather over its links, and pushes irradiance down (Hanrahan, Salzman
//! & Aupperle 1991, section 4.1). Each link is stored once and read from both sides: A_i F_ij = A_j F_ji to rounding.

use rayon::prelude::*;

use super::oracle::{Exchange, Visibility};
use super::push_pull::{Layout, pull, push, up};
use super::refine::Found;
use super::tree::Tree;
use crate::assembly::{FormFactors, Order};

/// The place of the matrix of a link that carries nothing.
pub const NO_MATRIX: usize = usize::MAX;

/// A pair of nodes that exchange light, or would if nothing stood between.
#[derive(Debug, Clone, Copy)]
pub struct Link {
    /// One node.
    pub p: u32,
    /// The other.
    pub q: u32,
    /// Where its S starts; [`NO_MATRIX`] for a link that carries nothing.
    pub at: usize,
    /// What the two exchange.
    pub exchange: Exchange,
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
    /// Links of node k: `of_node[start[k]..start[k + 1]]`, each with whether the node is its q.
    start: Vec<u32>,
    of_node: Vec<(u32, bool)>,
    /// The leaf of every row, the function, and the area.
    rows: Vec<(u32, u32)>,
    areas: Vec<f64>,
}

impl Links {
    /// Of a tree and its links.
    pub fn new(tree: Tree, found: Found) -> Links {
        let count = tree.nodes.len();
        let mut start = vec![0u32; count + 1];
        let carrying = || found.links.iter().enumerate().filter(|(_, link)| link.at != NO_MATRIX);
        carrying().for_each(|(_, link)| [link.p, link.q].iter().for_each(|&k| start[k as usize + 1] += 1));
        (0..count).for_each(|k| start[k + 1] += start[k]);
        let mut of_node = vec![(0, false); start[count] as usize];
        let mut next = start.clone();
        for (number, link) in carrying() {
            for (node, is_second) in [(link.p, false), (link.q, true)] {
                of_node[next[node as usize] as usize] = (number as u32, is_second);
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
        Links { layout: Layout::new(&tree), tree, found, start, of_node, rows, areas }
    }

    /// The tree and the links apart, for more refinement.
    pub fn into_parts(self) -> (Tree, Found) {
        (self.tree, self.found)
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
        pull(&self.tree, &self.layout, bands, &mut moments);
        moments
    }

    /// Adds to `out` what a node gathers over its own links.
    fn gather_at(&self, node: usize, moments: &[f64], bands: usize, out: &mut [f64]) {
        for &(number, is_second) in &self.of_node[self.start[node] as usize..self.start[node + 1] as usize] {
            let link = &self.found.links[number as usize];
            let other = if is_second { link.p } else { link.q } as usize;
            let from = &moments[self.layout.of(other, bands)];
            self.carry(link, is_second, from, bands, out);
        }
    }

    /// out_k += sum over l of S_kl from_l, or of S_lk when `transposed`.
    fn carry(&self, link: &Link, transposed: bool, from: &[f64], bands: usize, out: &mut [f64]) {
        let columns = self.tree.nodes[link.q as usize].functions.len();
        let rows = self.tree.nodes[link.p as usize].functions.len();
        let matrix = &self.found.matrices[link.at..][..rows * columns];
        for (k, numbers) in matrix.chunks_exact(columns).enumerate() {
            for (l, s) in numbers.iter().enumerate() {
                let [to, of] = if transposed { [l, k] } else { [k, l] };
                for b in 0..bands {
                    out[to * bands + b] += s * from[of * bands + b];
                }
            }
        }
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
        push(&self.tree, &self.layout, bands, &mut arriving);
        arriving
    }

    /// An estimate of the largest sum over j of |dF_ij|, and the node's share of it for every patch: what its links and those of
    /// all above it may be wrong by.
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

    /// How many links end at each level of the tree, the root's first; every link has two ends.
    pub fn levels(&self) -> Vec<[u64; 3]> {
        let deepest = self.tree.nodes.iter().map(|node| node.level).max().unwrap_or(0);
        let mut counts = vec![[0; 3]; deepest as usize + 1];
        for link in &self.found.links {
            for node in [link.p, link.q] {
                counts[self.tree.nodes[node as usize].level as usize][link.exchange.visibility as usize] += 1;
            }
        }
        counts
    }

    /// Links of which it is known that they carry something, and those that are known not to.
    pub fn count(&self, visibility: Visibility) -> usize {
        self.found.links.iter().filter(|link| link.exchange.visibility == visibility).count()
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
        let above: Vec<usize> = up(&self.tree, leaf as usize).collect();
        let mut arriving: Vec<f64> = Vec::new();
        for &node in above.iter().rev() {
            let mut own = vec![0.0; self.layout.of(node, bands).len()];
            if !arriving.is_empty() {
                super::push_pull::push_one(&self.tree, node, bands, &arriving, &mut own);
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
        for node in up(&self.tree, leaf) {
            let own = moments[self.layout.of(node, bands)].to_vec();
            for &(number, is_second) in &self.of_node[self.start[node] as usize..self.start[node + 1] as usize] {
                let link = &self.found.links[number as usize];
                let other = if is_second { link.p } else { link.q } as usize;
                self.carry(link, !is_second, &own, bands, &mut arriving[self.layout.of(other, bands)]);
            }
            super::push_pull::pull_one(&self.tree, &self.layout, node, bands, &mut moments);
        }
        push(&self.tree, &self.layout, bands, &mut arriving);
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
            + size_of_val(self.of_node.as_slice())
            + size_of_val(self.start.as_slice())
            + size_of_val(self.rows.as_slice())
            + size_of_val(self.areas.as_slice())
    }
}
