//! Refinement: from the pair (root, root) down to links that a goal allows.
//!
//! A pair whose link would be wrong by more is parted at the larger of its nodes, or at that over which visibility varies; a leaf
//! that has to be parted is cut, where it may be. Where each patch matters, so is a pair next to each other, of which
//! samples tell too little. Links that were allowed stay until the goal is raised (multigridding: a coarse solution
//! tells where to refine; Hanrahan, Salzman & Aupperle 1991, section 4.3). Level by level, so that any number of threads finds the
//! same.

use rayon::prelude::*;

use super::functions::MOST;
use super::link::{Found, Link, NO_MATRIX};
use super::oracle::{Across, Ends, Exchange, FIRST_SEGMENTS, Oracle, Visibility};
use super::tree::Tree;
use crate::assembly::Blockers;
use crate::error::{Error, Result};
use crate::form_factor::Accuracy;
use crate::progress::Progress;
use crate::scene::Scene;

/// Which links are good enough.
pub trait Goal: Sync {
    /// Whether a link may be wrong by `error`, the integral of |d(K V)|, m^2.
    fn allows(&self, p: usize, q: usize, error: f64) -> bool;

    /// Whether a leaf may be cut.
    fn may_divide(&self, tree: &Tree, leaf: usize) -> bool;

    /// Segments that a link between nodes that cannot be parted may take; 0 where its visibility is settled elsewhere.
    fn most_segments(&self) -> u32;

    /// Whether a link has to be right for every patch of its nodes, and not only in the mean.
    fn holds_each(&self) -> bool;

    /// Leaves were cut.
    fn grown(&mut self, tree: &Tree);
}

/// Pairs that one task looks at.
const TOGETHER: usize = 256;

/// Two nodes that may exchange light.
#[derive(Debug, Clone, Copy)]
struct Pair {
    p: u32,
    q: u32,
    /// Whether it is known that nothing stands between.
    clear: bool,
    /// The node at which it has to be parted, where that is known.
    part: Option<usize>,
}

/// What refinement has done.
#[derive(Debug, Clone, Copy, Default)]
pub struct Done {
    /// Pairs looked at.
    pub pairs: u64,
    /// Segments cast.
    pub segments: u64,
    /// Links that the goal does not allow between leaves that may not be cut.
    pub stopped: u64,
    /// Whether memory ran out first.
    pub out_of_memory: bool,
}

#[derive(Default)]
struct Part {
    found: Found,
    next: Vec<Pair>,
    waiting: Vec<Pair>,
    divide: Vec<u32>,
    done: Done,
}

/// What is refined, with what it takes.
pub struct Refinement<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// What may stand between.
    pub blockers: &'a Blockers,
    /// Of the exact exchange of two triangles.
    pub accuracy: Accuracy,
    /// Of segments.
    pub seed: u64,
    /// Bytes that may be used.
    pub memory: u64,
    /// What every node of the tree takes beside itself, in those who use the links.
    pub bytes_a_node: u64,
}

/// Vectors grow by doubling: about so many times what they hold is in use.
const GROWTH: u64 = 2;
/// A link with its matrix, and its two ends in [`super::links`].
const BYTES_OF_LINK: u64 = (size_of::<Link>() + 8 * (MOST - 1) * (MOST - 1) + 48) as u64;
/// A node of the tree, about.
const BYTES_OF_NODE: u64 = 1600;
/// Places of two nodes, each looked at from each, that tell over which of the two visibility varies more.
const ACROSS: [u32; 2] = [4, 4];
/// How many times as much counts as clearly more.
const CLEARLY: f64 = 2.0;
/// Places again where that is a leaf that may not be cut, of it and of the other: to find its mean.
const CLOSER: [u32; 2] = [16, 8];
/// Segments, at most, that tell whether every patch of a cluster sees what all see: where there are more patches, so many are looked at.
const EACH: u32 = 1024;
/// What one pair may become on the next level.
const PARTS: u64 = 4;

impl Refinement<'_> {
    /// Replaces the links that the goal does not allow by finer ones; starts from the root where there are none. What has been done
    /// is added to `done`.
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`].
    pub fn refine(
        &self,
        tree: &mut Tree,
        found: Option<Found>,
        goal: &mut impl Goal,
        done: &mut Done,
        progress: &Progress,
    ) -> Result<Found> {
        let holds_each = goal.holds_each();
        let mut kept = Found::default();
        done.stopped = 0;
        let mut frontier = match found {
            None => vec![Pair { p: 0, q: 0, clear: self.blockers.bodies.is_empty(), part: None }],
            Some(found) => {
                let mut frontier = Vec::new();
                for link in &found.links {
                    let (p, q) = (link.p as usize, link.q as usize);
                    let is_final = is_final(tree, goal, p, q);
                    let is_allowed = goal.allows(p, q, link.exchange.error());
                    if is_final || is_allowed {
                        kept.keep(&found, link, tree);
                        done.stopped += u64::from(!is_allowed);
                    } else {
                        let clear = link.exchange.visibility == Visibility::Full;
                        // What is mixed is looked at once more, to tell which end is to be parted; what is not, where more
                        // segments may be enough.
                        let again = link.exchange.is_mixed() || (holds_each && !clear);
                        let larger = || by_size(tree, p, q).into_iter().find(|&k| can_part(tree, goal, k));
                        let part = if again { None } else { larger() };
                        frontier.push(Pair { p: link.p, q: link.q, clear, part });
                    }
                }
                frontier
            }
        };
        while !frontier.is_empty() {
            progress.expect(frontier.len() as u64);
            let pairs = frontier.len() as u64;
            let leaves = tree.nodes.len() as u64;
            let next = PARTS * pairs * (size_of::<Pair>() as u64 + BYTES_OF_LINK)
                + PARTS * pairs.min(leaves) * (BYTES_OF_NODE + self.bytes_a_node);
            done.out_of_memory |= self.used(tree, &kept) + next > self.memory;
            let accept = done.out_of_memory;
            let parts: Result<Vec<Part>> = frontier
                .par_chunks(TOGETHER)
                .map_init(
                    || Oracle::new(self.scene, self.blockers, self.accuracy, holds_each, self.seed),
                    |oracle, pairs| {
                        progress.advance(pairs.len() as u64)?;
                        let mut part = Part::default();
                        pairs.iter().for_each(|pair| look(oracle, tree, goal, *pair, accept, &mut part));
                        Ok(part)
                    },
                )
                .collect();
            frontier.clear();
            let (mut waiting, mut divide) = (Vec::new(), Vec::new());
            for part in parts? {
                kept.append(&part.found);
                frontier.extend(part.next);
                waiting.extend(part.waiting);
                divide.extend(part.divide);
                done.pairs += part.done.pairs;
                done.segments += part.done.segments;
                done.stopped += part.done.stopped;
            }
            divide.sort_unstable();
            divide.dedup();
            divide.into_iter().for_each(|leaf| tree.divide(leaf as usize));
            goal.grown(tree);
            frontier.extend(waiting);
        }
        Ok(kept)
    }

    /// Refuses a tree that is too large even without links.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn check(&self, tree: &Tree) -> Result<()> {
        let needed = self.used(tree, &Found::default());
        if needed <= self.memory {
            return Ok(());
        }
        Err(Error::Memory {
            what: format!("the tree over {} patches", self.scene.len()),
            needed,
            available: self.memory,
            remedy: "use fewer patches (a larger max_edge)".to_string(),
        })
    }

    /// Bytes that tree and links take, with what their users need beside them.
    fn used(&self, tree: &Tree, found: &Found) -> u64 {
        let links = found.links.len() as u64;
        GROWTH * (tree.nbytes() as u64 + links * BYTES_OF_LINK) + tree.nodes.len() as u64 * self.bytes_a_node
    }
}

/// Whether a link between two nodes is as fine as it may be.
pub fn is_final(tree: &Tree, goal: &impl Goal, p: usize, q: usize) -> bool {
    [p, q].into_iter().all(|k| !can_part(tree, goal, k))
}

/// A leaf that may not be cut is never parted.
fn can_part(tree: &Tree, goal: &impl Goal, number: usize) -> bool {
    !tree.nodes[number].is_leaf() || goal.may_divide(tree, number)
}

/// Two nodes, the larger first: that one is to be parted, if it can be.
fn by_size(tree: &Tree, p: usize, q: usize) -> [usize; 2] {
    if tree.nodes[p].radius >= tree.nodes[q].radius { [p, q] } else { [q, p] }
}

/// Looks how much is visible. Where a link has to be right for each patch of a cluster, all of them are looked at, or [`EACH`] of them,
/// and more segments are cast as long as what may have been missed is too much. Once two differ, the link may be as wrong as it is for a
/// patch that sees all or nothing.
///
/// Returns segments, and the ends of one that sees what few others see, where each patch matters.
fn look_between(
    oracle: &Oracle,
    tree: &Tree,
    goal: &impl Goal,
    nodes: [usize; 2],
    exchange: &mut Exchange,
) -> (u64, Option<Ends>) {
    let [p, q] = nodes;
    // Also where memory has run out and nothing is parted: the error is to be told.
    let is_final = is_final(tree, goal, p, q);
    let by_patches = !is_final && goal.holds_each();
    let patches = nodes.map(|k| tree.nodes[k].patches.len() as u32);
    let [least, most] = match (is_final, by_patches) {
        (true, _) => [FIRST_SEGMENTS, goal.most_segments()],
        (false, true) => {
            let least = patches[0].max(patches[1]).min(EACH);
            let can_be_enough = goal.allows(p, q, exchange.unoccluded / f64::from(EACH));
            [least, if can_be_enough { EACH } else { least }]
        }
        (false, false) => [FIRST_SEGMENTS; 2],
    };
    if most == 0 {
        exchange.visibility = Visibility::Partial;
        return (0, None);
    }
    let (mut segments, mut looked) = (FIRST_SEGMENTS, 0);
    loop {
        let rare = oracle.look_between(tree, nodes, segments, by_patches, exchange);
        looked += u64::from(segments);
        if let Some(rare) = rare.filter(|_| by_patches) {
            exchange.unevenness = exchange.fraction.max(1.0 - exchange.fraction);
            return (looked, Some(rare));
        }
        let is_enough = segments >= least && goal.allows(p, q, exchange.unoccluded * exchange.fraction_error);
        if segments >= most || is_enough {
            return (looked, None);
        }
        segments *= 4;
    }
}

/// Looks what is to be parted where only some is visible: the larger, or the smaller if that varies more over it, by [`CLEARLY`].
/// A cluster of which a part lies beneath a block sees little of anything from there: to part what it looks at would be in vain.
///
/// A leaf that may not be cut takes part with its mean alone: what is visible may vary over it, and the mean is looked for.
/// Returns segments and what is to be parted.
fn look_across(
    oracle: &Oracle,
    tree: &Tree,
    goal: &impl Goal,
    nodes: [usize; 2],
    rare: Option<Ends>,
    exchange: &mut Exchange,
) -> (u64, usize) {
    let varies = |across: &Across| if rare.is_some() { across.most } else { across.uneven };
    let uneven = varies(&oracle.look_across(tree, nodes, ACROSS, rare));
    let looked = u64::from(ACROSS[0] * ACROSS[1]);
    let more = usize::from(uneven[1] > CLEARLY * uneven[0]);
    let other = 1 - more;
    if can_part(tree, goal, nodes[more]) {
        return (looked, nodes[more]);
    }
    if !goal.allows(nodes[0], nodes[1], exchange.unoccluded * uneven[other]) {
        return (looked, nodes[other]);
    }
    let mut counts = CLOSER;
    counts.swap(0, more);
    let across = oracle.look_across(tree, nodes, counts, rare);
    exchange.fraction = across.fraction;
    exchange.unevenness = varies(&across)[other];
    exchange.fraction_error = across.error;
    (looked + u64::from(CLOSER[0] * CLOSER[1]), nodes[other])
}

/// Makes a link of a pair, or parts it.
fn look(oracle: &mut Oracle, tree: &Tree, goal: &impl Goal, pair: Pair, accept: bool, out: &mut Part) {
    let (p, q) = (pair.p as usize, pair.q as usize);
    let (a, b) = (&tree.nodes[p], &tree.nodes[q]);
    out.done.pairs += 1;
    if p == q {
        // What is flat does not see itself.
        if a.plane.is_none() && !a.is_leaf() {
            for (k, first) in a.children.clone().enumerate() {
                let others = a.children.clone().skip(k);
                out.next.extend(others.map(|second| Pair { p: first, q: second, clear: pair.clear, part: None }));
            }
        }
        return;
    }
    if a.faces_away(b) || b.faces_away(a) {
        return;
    }
    let larger = by_size(tree, p, q);
    let can = |number: usize| can_part(tree, goal, number);
    let mut to_part = larger.into_iter().find(|&number| can(number)).filter(|_| !accept);
    let part = |clear: bool, number: usize, out: &mut Part| {
        let other = if number == p { pair.q } else { pair.p };
        if tree.nodes[number].is_leaf() {
            out.divide.push(number as u32);
            out.waiting.push(Pair { clear, part: Some(number), ..pair });
        } else {
            let parts = tree.nodes[number].children.clone();
            out.next.extend(parts.map(|part| Pair { p: part.min(other), q: part.max(other), clear, part: None }));
        }
    };
    if let Some(number) = pair.part.filter(|_| !accept) {
        return part(pair.clear, number, out);
    }
    if let Some(number) = to_part.filter(|_| !goal.allows(p, q, oracle.unseen(a, b))) {
        return part(pair.clear, number, out);
    }
    let at = out.found.matrices.len();
    let mut exchange = oracle.seen(a, b, &mut out.found.matrices);
    if let Some(number) = to_part.filter(|_| !goal.allows(p, q, exchange.kernel_error)) {
        out.found.matrices.truncate(at);
        return part(pair.clear, number, out);
    }
    if !oracle.make_exact(a, b, &mut exchange, &mut out.found.matrices[at..]) {
        return out.found.matrices.truncate(at);
    }
    let clear = pair.clear || oracle.is_clear(tree, p, q);
    if !clear {
        let (looked, rare) = look_between(oracle, tree, goal, larger, &mut exchange);
        out.done.segments += looked;
        if to_part.is_some() && exchange.is_mixed() && !goal.allows(p, q, exchange.error()) {
            let (looked, number) = look_across(oracle, tree, goal, larger, rare, &mut exchange);
            out.done.segments += looked;
            to_part = Some(number);
        }
    }
    if accept && larger.into_iter().any(can) && !goal.allows(p, q, oracle.unseen(a, b)) {
        // Of nodes that should have been parted, all that they can exchange is in doubt.
        exchange.kernel_error = exchange.kernel_error.max(a.area.min(b.area));
    }
    if !goal.allows(p, q, exchange.error()) {
        if let Some(number) = to_part {
            out.found.matrices.truncate(at);
            return part(clear, number, out);
        }
        out.done.stopped += 1;
    }
    let is_hidden = exchange.visibility == Visibility::None;
    if is_hidden {
        out.found.matrices.truncate(at);
    } else {
        out.found.matrices[at..].iter_mut().for_each(|s| *s *= exchange.fraction);
    }
    out.found.links.push(Link { p: pair.p, q: pair.q, at: if is_hidden { NO_MATRIX } else { at }, exchange });
}
