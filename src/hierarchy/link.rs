//! One link: two nodes of the tree that exchange light, and where its numbers are kept.

use super::oracle::Exchange;
use super::tree::Tree;

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

/// Links, and their matrices one after the other.
#[derive(Debug, Clone, Default)]
pub struct Found {
    /// The links.
    pub links: Vec<Link>,
    /// Their S, where they have one.
    pub matrices: Vec<f64>,
}

impl Found {
    /// Adds all that another holds.
    pub(super) fn append(&mut self, other: &Found) {
        let shift = self.matrices.len();
        self.matrices.extend_from_slice(&other.matrices);
        let moved = |link: &Link| Link { at: if link.at == NO_MATRIX { NO_MATRIX } else { link.at + shift }, ..*link };
        self.links.extend(other.links.iter().map(moved));
    }

    /// Adds one of the links of another.
    pub(super) fn keep(&mut self, other: &Found, link: &Link, tree: &Tree) {
        let at = if link.at == NO_MATRIX { NO_MATRIX } else { self.matrices.len() };
        if link.at != NO_MATRIX {
            let size = tree.nodes[link.p as usize].functions.len() * tree.nodes[link.q as usize].functions.len();
            self.matrices.extend_from_slice(&other.matrices[link.at..][..size]);
        }
        self.links.push(Link { at, ..*link });
    }
}
