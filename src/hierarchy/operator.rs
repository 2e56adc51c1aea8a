//! The form factors of a scene as links, to a row tolerance.
//!
//! Links are refined where the rows that they belong to are still too far off, from their largest errors down, until every row
//! is within the tolerance: sum over j of |dF_ij|. Pairs of patches between which something may stand are
//! settled by [`crate::assembly`]'s shadows and segments, like those of the dense operator.

use super::link::{Found, NO_MATRIX};
use super::links::Links;
use super::oracle::Visibility;
use super::refine::{Done, Goal, Refinement};
use super::tree::Tree;
use crate::assembly::dense::is_error;
use crate::assembly::{Blockers, Candidate, Order, settle};
use crate::error::{Error, Result};
use crate::form_factor::{Accuracy, Patch};
use crate::memory::room;
use crate::progress::Progress;
use crate::scene::Scene;

/// What to compute, and within what.
#[derive(Debug, Clone, Copy)]
pub struct HierarchicalOptions {
    /// Bound on sum over j of |dF_ij|, for every row i; in [1e-10, 1).
    pub tolerance: f64,
    /// Seed of the quasi-random segments.
    pub seed: u64,
    /// Bytes that may be used.
    pub memory: u64,
}

/// What was reached.
#[derive(Debug, Clone, Copy)]
pub struct Reached {
    /// Estimate of the largest row error; above the tolerance where memory ended the refinement, or what is visible of single pairs of
    /// patches stays in doubt.
    pub error_estimate: f64,
    /// Segments cast.
    pub segments: u64,
}

/// Share of the tolerance for kernels of single pairs of patches.
const KERNEL_SHARE: f64 = 0.02;
/// Share of it for links above patches; the rest is for the visibility of pairs of patches.
const LINK_SHARE: f64 = 0.6;
/// A link may be wrong by this share of what its row may, at first.
const FIRST: f64 = 0.05;
/// A round multiplies the limits on links of rows that are too far off by a factor between these: the errors of rows go about as the root
/// of the limit.
const STEPS: [f64; 2] = [0.5, 0.7];
/// Of the layout of products and the lists of links, and of a matrix row's candidates.
const BYTES_A_NODE: u64 = 256;
/// Rounds, at most.
const ROUNDS: usize = 24;

/// A limit on what a link may be wrong by, for every node.
struct Rows<'a> {
    tree_areas: &'a [f64],
    limits: &'a [f64],
}

impl Goal for Rows<'_> {
    fn allows(&self, p: usize, q: usize, error: f64) -> bool {
        [p, q].iter().all(|&k| error <= self.limits[k] * self.tree_areas[k])
    }

    fn may_divide(&self, _: &Tree, _: usize) -> bool {
        false
    }

    fn most_segments(&self) -> u32 {
        0
    }

    fn holds_each(&self) -> bool {
        true
    }

    fn grown(&mut self, _: &Tree) {}
}

/// Computes the links of a scene.
///
/// # Errors
/// [`crate::Error::Invalid`] for a tolerance out of range or a patch that is there twice, [`crate::Error::Memory`] when not even
/// the patches fit, [`crate::Error::Interrupted`].
pub fn form_factors(scene: &Scene, options: &HierarchicalOptions, progress: &Progress) -> Result<(Links, Reached)> {
    scene.require_diffuse("hierarchical radiosity")?;
    scene.require_distinct("hierarchical radiosity")?;
    Accuracy::new(options.tolerance)?;
    let accuracy = Accuracy::new((KERNEL_SHARE * options.tolerance).max(Accuracy::TIGHTEST))?;
    let blockers = Blockers::of_scene(scene);
    let mut tree = Tree::new(scene, &blockers.bodies, Order::Constant);
    let areas: Vec<f64> = tree.nodes.iter().map(|node| node.area).collect();
    let refinement = Refinement {
        scene,
        blockers: &blockers,
        accuracy,
        seed: options.seed,
        memory: options.memory,
        bytes_a_node: BYTES_A_NODE,
    };
    refinement.check(&tree)?;
    let mut limits = vec![FIRST * options.tolerance; areas.len()];
    let (mut found, mut done): (Option<Found>, Done) = (None, Done::default());
    let budget = LINK_SHARE * options.tolerance;
    let mut round = 0;
    let (mut links, errors) = loop {
        let mut goal = Rows { tree_areas: &areas, limits: &limits };
        let refined = refinement.refine(&mut tree, found.take(), &mut goal, &mut done, progress)?;
        let links = Links::new(tree, refined);
        let errors = links.row_errors();
        round += 1;
        // The worst row under every node, of those that are too far off.
        let is_too_far = |k: usize| links.tree.nodes[k].is_leaf() && errors[k] > budget;
        let mut worst: Vec<f64> = (0..errors.len()).map(|k| if is_too_far(k) { errors[k] } else { 0.0 }).collect();
        for k in (1..worst.len()).rev() {
            let parent = links.tree.nodes[k].parent as usize;
            worst[parent] = worst[parent].max(worst[k]);
        }
        if round == ROUNDS || done.out_of_memory || worst[0] == 0.0 {
            break (links, errors);
        }
        for (limit, worst) in limits.iter_mut().zip(worst).filter(|(_, worst)| *worst > 0.0) {
            *limit *= (budget / worst).powi(2).clamp(STEPS[0], STEPS[1]);
        }
        let refined;
        (tree, refined) = links.into_parts();
        found = Some(refined);
    };
    let above = worst_leaf(&links, &errors);
    // Where memory has run out the links alone may be over the tolerance: what is hidden then gets no less than it would have.
    let left =
        (options.tolerance - above - accuracy.tolerance()).max((1.0 - LINK_SHARE - KERNEL_SHARE) * options.tolerance);
    let (segments, hidden) = settle_patches(scene, &blockers, &mut links, left, options.seed, progress)?;
    let reached = Reached { error_estimate: accuracy.tolerance() + above + hidden, segments: done.segments + segments };
    Ok((links, reached))
}

/// The links of a scene from what was kept of them; the tree is built again, and has to come out as it was (`tree_mark`).
///
/// # Errors
/// [`Error::Invalid`] for what cannot be of this scene, or of any.
pub fn from_kept(scene: &Scene, found: Found, tree_mark: u64, reached: &Reached) -> Result<Links> {
    scene.require_diffuse("hierarchical radiosity")?;
    let blockers = Blockers::of_scene(scene);
    let tree = Tree::new(scene, &blockers.bodies, Order::Constant);
    for (k, link) in found.links.iter().enumerate() {
        let ends = [link.p, link.q].map(|k| tree.nodes.get(k as usize));
        let [Some(p), Some(q)] = ends else {
            let (p, q, count) = (link.p, link.q, tree.nodes.len());
            return Err(Error::Invalid(format!("link {k} is of the nodes {p} and {q}, and there are {count}")));
        };
        let size = p.functions.len() * q.functions.len();
        if link.at != NO_MATRIX && link.at.checked_add(size).is_none_or(|end| end > found.matrices.len()) {
            return Err(Error::Invalid(format!("link {k} has no matrix of {size} numbers from {}", link.at)));
        }
        if ![link.exchange.error(), link.exchange.occluded()].into_iter().all(f64::is_finite) {
            return Err(Error::Invalid(format!("link {k} has an exchange or an error that is not finite")));
        }
    }
    if !found.matrices.iter().all(|s| s.is_finite()) || !is_error(reached.error_estimate) {
        return Err(Error::Invalid("the matrices of the links and their error are not all finite numbers".to_string()));
    }
    let links = Links::new(tree, found);
    if links.tree_mark() != tree_mark {
        return Err(Error::Invalid(
            "the tree over the patches does not come out as it was, on this machine or by this version: compute the form \
             factors again"
                .to_string(),
        ));
    }
    Ok(links)
}

fn worst_leaf(links: &Links, errors: &[f64]) -> f64 {
    let leaves = links.tree.nodes.iter().zip(errors).filter(|(node, _)| node.is_leaf());
    leaves.map(|(_, error)| *error).fold(0.0, f64::max)
}

/// Finds how much is visible of the pairs of patches between which something may stand; returns segments, and the largest row
/// error that is left of it.
fn settle_patches(
    scene: &Scene,
    blockers: &Blockers,
    links: &mut Links,
    budget: f64,
    seed: u64,
    progress: &Progress,
) -> Result<(u64, f64)> {
    let is_open = |links: &Links, k: usize| {
        let link = &links.found.links[k];
        let [p, q] = [link.p, link.q].map(|k| &links.tree.nodes[k as usize]);
        link.exchange.visibility == Visibility::Partial && p.is_leaf() && q.is_leaf()
    };
    let count = (0..links.found.links.len()).filter(|&k| is_open(links, k)).count();
    let mut open: Vec<usize> = room(count)?;
    open.extend((0..links.found.links.len()).filter(|&k| is_open(links, k)));
    if open.is_empty() {
        return Ok((0, 0.0));
    }
    let patches: Vec<Patch> = (0..scene.len()).map(|i| Patch::new(scene.triangle(i))).collect();
    let candidate = |&k: &usize| {
        let link = &links.found.links[k];
        let [i, j] = [link.p, link.q].map(|k| links.tree.nodes[k as usize].patch);
        Candidate::new(i, j, link.exchange.unoccluded)
    };
    let mut candidates: Vec<Candidate> = room(open.len())?;
    candidates.extend(open.iter().map(candidate));
    let settled = settle(&patches, scene.areas(), blockers, &mut candidates, budget, seed, progress)?;
    for (&k, candidate) in open.iter().zip(&candidates) {
        let link = &mut links.found.links[k];
        link.exchange.fraction = candidate.visible;
        link.exchange.fraction_error = candidate.error;
        links.found.matrices[link.at] *= candidate.visible;
        if candidate.visible == 0.0 {
            link.exchange.visibility = Visibility::None;
        } else if candidate.visible == 1.0 && candidate.error == 0.0 {
            link.exchange.visibility = Visibility::Full;
        }
    }
    Ok(settled)
}
