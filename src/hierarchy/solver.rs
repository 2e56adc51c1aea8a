//! A scene solved on elements that are as small as its light asks for.
//!
//! Refine, solve, refine again with what the solution says of the light (multigridding): every round allows a link less error,
//! until all links together put in no more than is asked for.

use super::closed::{Closed, is_closed};
use super::light::{Light, Surroundings};
use super::links::Links;
use super::refine::{Done, Found, Refinement};
use super::tree::Tree;
use crate::assembly::{Blockers, FormFactors, Order};
use crate::error::{Error, Result};
use crate::form_factor::Accuracy;
use crate::progress::Progress;
use crate::scene::Scene;
use crate::solve::{Step, System, propagated};

/// No leaf smaller than this part of the scene is cut.
const SMALLEST: f64 = 1e-3;
/// Of the exact exchange of two triangles.
const KERNEL: f64 = 1e-3;
/// Error of a link in the first round, relative to the norm of the reflected radiosity.
const FIRST: f64 = 3e-3;
/// A round makes it less by a factor between these.
const LEAST: f64 = 0.1;
const MOST: f64 = 0.7;
/// Links are expected to become as many more as their errors become smaller, to this power; and errors add up in squares.
const GROWTH: f64 = 1.0;
/// The part of the errors that has one sign everywhere: that grows from bounce to bounce like the light itself, where a closed
/// scene's does not (measured in white open rooms: light that falls on what is hidden under other things is lost).
const ONE_SIGN: f64 = 0.25;
/// Residual of the solves, relative.
const RESIDUAL: f64 = 1e-4;

/// A scene with its elements, links, and the light on them.
pub struct Solver<'a> {
    refinement: Refinement<'a>,
    links: Option<Links>,
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
    /// What refinement has done.
    pub done: Done,
    /// Of the last solve.
    pub history: Vec<Step>,
}

impl<'a> Solver<'a> {
    /// For a scene with what blocks in it; `memory` bytes for elements and links.
    ///
    /// # Errors
    /// [`Error::Invalid`] never, as long as the scene is valid.
    pub fn new(scene: &'a Scene, blockers: &'a Blockers, seed: u64, memory: u64) -> Result<Solver<'a>> {
        let tree = Tree::new(scene, &blockers.bodies, Order::Linear);
        let smallest = SMALLEST * tree.nodes[0].radius;
        let surroundings = Surroundings::new(scene, is_closed(scene, seed), smallest);
        let light = Light::of_emission(scene, &tree, surroundings.clone());
        let refinement = Refinement { scene, blockers, accuracy: Accuracy::new(KERNEL)?, seed, memory };
        let links = Some(Links::new(tree, Found::default()));
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
            done: Done::default(),
            history: Vec::new(),
        })
    }

    /// The elements and links.
    pub fn links(&self) -> Option<&Links> {
        self.links.as_ref()
    }

    /// Refines until the links say that they are wrong by no more than `target`, or can be refined no more.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a scene without a finite solution, [`Error::Interrupted`].
    pub fn refine_to(&mut self, target: f64, progress: &Progress) -> Result<()> {
        while self.link_error > target && !self.done.out_of_memory {
            if self.link_error.is_finite() {
                // The square of the error is the number of links times that of one.
                let wanted = (0.9 * target / self.link_error).powf(1.0 / (1.0 - 0.5 * GROWTH));
                self.limit *= wanted.clamp(LEAST, MOST);
            }
            let before = self.done.pairs;
            self.round(progress)?;
            if self.done.pairs == before {
                break;
            }
        }
        Ok(())
    }

    fn round(&mut self, progress: &Progress) -> Result<()> {
        let Some(links) = self.links.take() else { return Err(Error::Interrupted) };
        let (mut tree, found) = links.into_parts();
        let found = (!found.links.is_empty()).then_some(found);
        self.done.stopped = 0;
        let mut goal = self.light.clone().with_limit(self.limit);
        let found = self.refinement.refine(&mut tree, found, &mut goal, &mut self.done, progress)?;
        let links = Links::new(tree, found);
        self.solve(&links, progress)?;
        let bands = self.refinement.scene.bands();
        let surroundings = self.surroundings.clone();
        self.light = Light::of_solution(&links, bands, &self.radiosity, &self.irradiance, surroundings);
        self.link_error = self.light.error(&links.found.links) * (ONE_SIGN * self.amplification).hypot(1.0);
        self.links = Some(links);
        Ok(())
    }

    fn solve(&mut self, links: &Links, progress: &Progress) -> Result<()> {
        let scene = self.refinement.scene;
        let bands = scene.bands();
        let (mut emission, mut reflectance) = (Vec::new(), Vec::new());
        for &(leaf, function) in links.rows() {
            let patch = links.tree.nodes[leaf as usize].patch as usize * bands;
            let is_constant = function == 0;
            emission.extend(scene.emission()[patch..patch + bands].iter().map(|e| if is_constant { *e } else { 0.0 }));
            reflectance.extend_from_slice(&scene.reflectance()[patch..patch + bands]);
        }
        let closed = self.surroundings.is_closed.then(|| Closed::new(links));
        let form_factors: &dyn FormFactors = closed.as_ref().map_or(links, |closed| closed);
        let system = System { form_factors, emission: &[], reflectance: &reflectance, bands };
        let mut history = Vec::new();
        let mut observe = |step: &Step, _: &[f64], _: &[f64]| {
            history.push(step.clone());
            progress.advance(0)
        };
        let arriving = propagated(&system, std::slice::from_ref(&emission), RESIDUAL, &mut observe)?;
        let Some(mut arriving) = arriving else {
            return Err(Error::Invalid("the light never dies: every patch reflects all of it, or nearly".to_string()));
        };
        self.irradiance = arriving.remove(0);
        let reflected = self.irradiance.iter().zip(&reflectance).map(|(h, rho)| rho * h);
        self.radiosity = emission.iter().zip(reflected).map(|(e, r)| e + r).collect();
        self.history = history;
        if !self.surroundings.is_closed {
            let mut first = vec![0.0; emission.len()];
            links.apply(&emission, bands, &mut first);
            let amplification = |b: usize| {
                let rows = || links.rows().iter().enumerate().filter(|(_, row)| row.1 == 0).map(|(r, _)| r);
                let power = |h: &[f64]| -> f64 {
                    let of_row = |r: usize| links.tree.nodes[links.rows()[r].0 as usize].area * reflectance[r * bands + b] * h[r * bands + b];
                    rows().map(of_row).sum()
                };
                let first = power(&first);
                if first > 0.0 { power(&self.irradiance) / first } else { 1.0 }
            };
            self.amplification = (0..bands).map(amplification).fold(1.0, f64::max);
        }
        Ok(())
    }

    /// The mean irradiance of every patch, n x b.
    pub fn patch_irradiance(&self) -> Vec<f64> {
        let Some(links) = &self.links else { return Vec::new() };
        let bands = self.refinement.scene.bands();
        let moments = links.pulled(&self.irradiance, bands);
        let of_patch = |&node: &u32| {
            let at = links.layout().of(node as usize, bands).start;
            let area = links.tree.nodes[node as usize].area;
            moments[at..at + bands].iter().map(move |m| m / area).collect::<Vec<f64>>()
        };
        links.tree.node_of.iter().flat_map(of_patch).collect()
    }

    /// How many leaves there are.
    pub fn leaves(&self) -> usize {
        self.links.as_ref().map_or(0, |links| links.tree.nodes.iter().filter(|node| node.is_leaf()).count())
    }
}
