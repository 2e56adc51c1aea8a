//! A scene solved on elements that are as small as its light asks for.
//!
//! Refine, solve, refine again with what the solution says of the light (multigridding): every round allows a link less error,
//! until all links together put in no more than is asked for.

use super::balanced::{Balanced, is_closed};
use super::functions::place;
use super::light::{Light, Surroundings};
use super::link::{Found, Link};
use super::links::Links;
use super::mesh::LeafMesh;
use super::refine::{Done, Refinement, is_final};
use super::tree::Tree;
use crate::assembly::{Blockers, FormFactors, Order};
use crate::error::{Error, Result};
use crate::form_factor::Accuracy;
use crate::progress::Progress;
use crate::scene::Scene;
use crate::solve::{Audit, Step, System, propagated, without_loss};

/// No leaf smaller than this part of the scene is cut.
const SMALLEST: f64 = 1e-3;
/// Of the exact exchange of two triangles.
const KERNEL: f64 = 1e-3;
/// Error of a link in the first round, relative to the norm of the reflected radiosity.
const FIRST: f64 = 3e-3;
/// A round makes it less by a factor between these.
const LEAST: f64 = 0.1;
const MOST: f64 = 0.7;
/// No link is asked for less.
const TIGHTEST: f64 = 1e-9;
/// Rounds in a row without a finite solution before there is none.
const MOST_FAILURES: usize = 3;
/// Bytes of a node beside its own, and of each band: its numbers in products, the vectors of GMRES, and the mesh.
const BYTES_A_NODE: u64 = 600;
const BYTES_A_BAND: u64 = 3 * 8 * 40;
/// The part of the errors that has one sign everywhere: that grows from bounce to bounce like the light itself, where a closed
/// scene's does not (measured in white open rooms: light that falls on what is hidden under other things is lost).
const ONE_SIGN: f64 = 0.25;
/// Residual of the solves, relative.
const RESIDUAL: f64 = 1e-4;
/// What it may take away of the power of the first bounce.
const ROUNDING: f64 = 1e-2;

/// A scene with its elements, links, and the light on them.
pub struct Solver<'a> {
    refinement: Refinement<'a>,
    links: Links,
    light: Light,
    limit: f64,
    surroundings: Surroundings,
    /// All the light over that of the first bounce, the largest of the bands; 0 where it makes no errors larger.
    amplification: f64,
    /// B and H of every row of the links.
    pub radiosity: Vec<f64>,
    /// See above.
    pub irradiance: Vec<f64>,
    /// What links are wrong by, as they say themselves.
    pub link_error: f64,
    /// The part of it that no refinement lowers: of links between elements that are not cut.
    final_error: f64,
    /// How many those are.
    final_links: u64,
    /// What refinement has done.
    pub done: Done,
    /// Of the last solve.
    pub history: Vec<Step>,
}

impl<'a> Solver<'a> {
    /// For a scene with what blocks in it; `memory` bytes for elements and links.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a scene without a finite solution or with a patch twice, [`Error::Memory`] when not even the
    /// patches fit.
    pub fn new(scene: &'a Scene, blockers: &'a Blockers, seed: u64, memory: u64) -> Result<Solver<'a>> {
        scene.require_diffuse("hierarchical radiosity")?;
        scene.require_distinct("hierarchical radiosity")?;
        let is_closed = is_closed(scene, seed);
        let bands = scene.bands();
        let is_white = |b: usize| scene.reflectance().iter().skip(b).step_by(bands).all(|rho| *rho == 1.0);
        if let Some(band) = (0..bands).find(|b| is_closed && is_white(*b)) {
            return Err(without_loss(band));
        }
        let tree = Tree::new(scene, &blockers.bodies, Order::Linear);
        let smallest = SMALLEST * tree.nodes[0].radius;
        let surroundings = Surroundings::new(scene, is_closed, smallest);
        let light = Light::of_emission(scene, &tree, surroundings.clone());
        let bytes_a_node = BYTES_A_NODE + BYTES_A_BAND * bands as u64;
        let accuracy = Accuracy::new(KERNEL)?;
        let refinement = Refinement { scene, blockers, accuracy, seed, memory, bytes_a_node };
        refinement.check(&tree)?;
        let links = Links::new(tree, Found::default());
        Ok(Solver {
            refinement,
            links,
            light,
            limit: FIRST,
            surroundings,
            amplification: 0.0,
            radiosity: Vec::new(),
            irradiance: Vec::new(),
            link_error: f64::INFINITY,
            final_error: 0.0,
            final_links: 0,
            done: Done::default(),
            history: Vec::new(),
        })
    }

    /// The elements and links.
    pub fn links(&self) -> &Links {
        &self.links
    }

    /// Refines until the links say that they are wrong by no more than `target`, or can be refined no more.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a scene without a finite solution, [`Error::Interrupted`].
    pub fn refine_to(&mut self, target: f64, progress: &Progress) -> Result<()> {
        let mut failures = 0;
        // Not a number is not met.
        while !(self.link_error <= target) && !self.done.out_of_memory && self.limit >= TIGHTEST {
            if self.link_error.is_finite() {
                // Errors add up in squares, and as their limit falls, links become as many more.
                self.limit *= (0.9 * target / self.link_error).powi(2).clamp(LEAST, MOST);
            }
            if !self.round(progress)? {
                // So coarse that light would grow without end: finer links may know better.
                self.limit *= LEAST;
                failures += 1;
                if failures == MOST_FAILURES || self.done.out_of_memory {
                    return Err(Error::Invalid(
                        "light grows from bounce to bounce: some patches reflect all that they exchange, or nearly"
                            .to_string(),
                    ));
                }
            } else if self.final_error > target {
                // Together they are wrong by too much, though each alone may be allowed.
                self.done.stopped = self.final_links;
                break;
            }
        }
        Ok(())
    }

    /// Refines and solves once; false when the links have no finite solution.
    fn round(&mut self, progress: &Progress) -> Result<bool> {
        let (mut tree, found) = std::mem::replace(&mut self.links, Links::empty()).into_parts();
        let found = (!found.links.is_empty()).then_some(found);
        let mut goal = self.light.clone().with_limit(self.limit);
        let found = self.refinement.refine(&mut tree, found, &mut goal, &mut self.done, progress)?;
        self.links = Links::new(tree, found);
        let solved = self.solve(progress)?;
        if solved {
            let bands = self.refinement.scene.bands();
            let surroundings = self.surroundings.clone();
            self.light = Light::of_solution(&self.links, bands, &self.radiosity, &self.irradiance, surroundings);
            let grown = (ONE_SIGN * self.amplification).hypot(1.0);
            let links = &self.links.found.links;
            let is_final = |link: &&Link| is_final(&self.links.tree, &self.light, link.p as usize, link.q as usize);
            self.link_error = self.light.error(links.iter()) * grown;
            self.final_error = self.light.error(links.iter().filter(is_final)) * grown;
            self.final_links = links.iter().filter(is_final).filter(|link| link.exchange.error() > 0.0).count() as u64;
        } else {
            self.light.follow(&self.links.tree);
        }
        Ok(solved)
    }

    fn solve(&mut self, progress: &Progress) -> Result<bool> {
        let (links, scene) = (&self.links, self.refinement.scene);
        let bands = scene.bands();
        let (mut emission, mut reflectance) = (Vec::new(), Vec::new());
        for &(leaf, function) in links.rows() {
            let patch = links.tree.nodes[leaf as usize].patch as usize * bands;
            let is_constant = function == 0;
            emission.extend(scene.emission()[patch..patch + bands].iter().map(|e| if is_constant { *e } else { 0.0 }));
            reflectance.extend_from_slice(&scene.reflectance()[patch..patch + bands]);
        }
        let balanced = Balanced::new(links, self.surroundings.is_closed);
        let system = System { form_factors: &balanced, emission: &[], reflectance: &reflectance, bands };
        let mut history = Vec::new();
        let mut observe = |step: &Step, _: &[f64], _: &[f64]| {
            history.push(step.clone());
            progress.advance(0)
        };
        let arriving = propagated(&system, std::slice::from_ref(&emission), RESIDUAL, &mut observe)?;
        let Some(mut arriving) = arriving else { return Ok(false) };
        let irradiance = arriving.remove(0);
        let mut first = vec![0.0; emission.len()];
        balanced.apply(&emission, bands, &mut first);
        // What is taken away from leaves may lower the light by so much.
        let kept = |(k, h): (usize, &f64)| h / (1.0 + reflectance[k] * balanced.taken(k / bands));
        let least: Vec<f64> = first.iter().enumerate().map(kept).collect();
        let power = |h: &[f64], b: usize| -> f64 {
            let of_row = |(r, row): (usize, &(u32, u32))| {
                let area = if row.1 == 0 { links.tree.nodes[row.0 as usize].area } else { 0.0 };
                area * reflectance[r * bands + b] * h[r * bands + b]
            };
            links.rows().iter().enumerate().map(of_row).sum()
        };
        self.amplification = 0.0;
        for b in 0..bands {
            let [first, least, all] = [&first, &least, &irradiance].map(|h| power(h, b));
            // Bounces only add. Beyond the pole of 1 / (1 - rho F), where they would grow without end, there is a solution too.
            if !(all >= (1.0 - ROUNDING) * least) {
                return Ok(false);
            }
            if !self.surroundings.is_closed {
                let grown = if first > 0.0 { all / first } else { 1.0 };
                self.amplification = self.amplification.max(grown);
            }
        }
        self.irradiance = irradiance;
        let reflected = self.irradiance.iter().zip(&reflectance).map(|(h, rho)| rho * h);
        self.radiosity = emission.iter().zip(reflected).map(|(e, r)| e + r).collect();
        self.history = history;
        Ok(true)
    }

    /// The mean irradiance of every patch, n x b.
    pub fn patch_irradiance(&self) -> Vec<f64> {
        let links = &self.links;
        let bands = self.refinement.scene.bands();
        let moments = links.pulled(&self.irradiance, bands);
        let of_patch = |&node: &u32| {
            let at = links.layout().of(node as usize, bands).start;
            let area = links.tree.nodes[node as usize].area;
            moments[at..at + bands].iter().map(move |m| m / area).collect::<Vec<f64>>()
        };
        links.tree.node_of.iter().flat_map(of_patch).collect()
    }

    /// The leaves as a mesh without T-junctions, and the mean irradiance of every face of it.
    pub fn mesh(&self) -> (LeafMesh, Vec<f64>) {
        let (tree, bands) = (&self.links.tree, self.refinement.scene.bands());
        let mesh = LeafMesh::new(tree);
        let mut first = vec![0; tree.nodes.len()];
        self.links.rows().iter().enumerate().for_each(|(r, row)| first[row.0 as usize] = r - row.1 as usize);
        let mut irradiance = vec![0.0; mesh.faces.len() * bands];
        for ((face, &leaf), out) in mesh.faces.iter().zip(&mesh.leaves).zip(irradiance.chunks_exact_mut(bands)) {
            let node = &tree.nodes[leaf as usize];
            // The mean of what is linear is its value at the centroid.
            let [a, b, c] = face.map(|v| tree.vertices[v as usize]);
            let values = node.functions.at(&place((a + b + c) / 3.0, node.normal()));
            for (k, value) in values[..node.functions.len()].iter().enumerate() {
                let row = &self.irradiance[(first[leaf as usize] + k) * bands..][..bands];
                out.iter_mut().zip(row).for_each(|(out, h)| *out += value * h);
            }
        }
        (mesh, irradiance)
    }

    /// Where the power goes.
    pub fn audit(&self) -> Audit {
        let (scene, links) = (self.refinement.scene, &self.links);
        let bands = scene.bands();
        let left = Balanced::new(links, self.surroundings.is_closed).left;
        let mut audit = [(); 4].map(|()| vec![0.0; bands]);
        for (r, &(leaf, function)) in links.rows().iter().enumerate() {
            let node = &links.tree.nodes[leaf as usize];
            for b in 0..bands {
                let k = node.patch as usize * bands + b;
                let (radiosity, irradiance) = (self.radiosity[r * bands + b], self.irradiance[r * bands + b]);
                // Orthonormal functions: the integral of a product is that of its coefficients.
                audit[2][b] += node.area * radiosity * left[r];
                if function == 0 {
                    audit[0][b] += node.area * scene.emission()[k];
                    audit[1][b] += node.area * (1.0 - scene.reflectance()[k]) * irradiance;
                }
            }
        }
        (0..bands).for_each(|b| audit[3][b] = audit[0][b] - audit[1][b] - audit[2][b]);
        let [emitted, absorbed, left, unshot] = audit;
        Audit { emitted, absorbed, left, unshot }
    }

    /// How many leaves there are.
    pub fn leaves(&self) -> usize {
        self.links.tree.nodes.iter().filter(|node| node.is_leaf()).count()
    }
}
