//! The goal of a solve: links are as good as the light that they carry asks for (BF refinement; Hanrahan, Salzman & Aupperle 1991,
//! section 4.2).
//!
//! A link from q to p that is wrong by dG, the integral of |d(K V)|, puts the error
//!
//!   A_p (rho_p B_q dG / A_p)^2  /  sum over i of A_i (rho_i H_i)^2
//!
//! into the squared relative error of the reflected radiosity, and one like it the other way. It is allowed as much as any
//! other link: a sum is least for its number of terms when all are alike. B_q^2 is the mean square on q, so that a lamp in a dark
//! cluster counts. In a closed scene, where light that is the same everywhere makes no error ([`super::balanced`]), it is
//! the mean of (B_q - B_p)^2: a furnace is not refined at all.

use super::link::Link;
use super::links::Links;
use super::refine::Goal;
use super::tree::Tree;
use crate::scene::Scene;

/// Segments that settle what is visible between two elements of the smallest size.
const MOST_SEGMENTS: u32 = 256;

/// Errors on a cluster are alike where its links come from one side, and add up: to about so many times what they would be if they
/// knew nothing of each other (measured on fine meshes; on elements they come out of the mean).
const ALIKE: f64 = 2.0;

/// What every node sends and reflects, in units in which the reflected radiosity of the scene has the norm 1 in each band.
#[derive(Debug, Clone)]
pub struct Light {
    bands: usize,
    /// Mean of B and of its square, a row a node.
    means: Vec<f64>,
    squares: Vec<f64>,
    /// Mean square of what a node reflects of what arrives, a row a node.
    reflectances: Vec<f64>,
    areas: Vec<f64>,
    surroundings: Surroundings,
    /// Error that a link may put in.
    limit: f64,
}

/// What does not change from one light to the next.
#[derive(Debug, Clone)]
pub struct Surroundings {
    /// What counts of the irradiance of every patch, n x b: rho, or 1 in bands in which nothing reflects.
    pub weights: Vec<f64>,
    /// Whether light that is the same everywhere makes no error.
    pub is_closed: bool,
    /// Radius below which no leaf is cut.
    pub smallest: f64,
}

impl Surroundings {
    /// Of a scene, closed or not.
    pub fn new(scene: &Scene, is_closed: bool, smallest: f64) -> Surroundings {
        let (bands, rho) = (scene.bands(), scene.reflectance());
        let is_black: Vec<bool> =
            (0..bands).map(|b| rho.iter().skip(b).step_by(bands).all(|rho| *rho == 0.0)).collect();
        let weights = rho.iter().enumerate().map(|(k, rho)| if is_black[k % bands] { 1.0 } else { *rho }).collect();
        Surroundings { weights, is_closed, smallest }
    }
}

impl Light {
    /// For a tree without links, from emission alone: the light that is reflected is taken to be even.
    pub fn of_emission(scene: &Scene, tree: &Tree, surroundings: Surroundings) -> Light {
        let bands = scene.bands();
        let total: f64 = scene.areas().iter().sum();
        let mean = |values: &[f64], b: usize| -> f64 {
            scene.areas().iter().zip(values.iter().skip(b).step_by(bands)).map(|(area, x)| area / total * x).sum()
        };
        let reflected = |b: usize| {
            let rho = mean(scene.reflectance(), b).min(0.99);
            mean(scene.emission(), b) * if rho > 0.0 { rho / (1.0 - rho) } else { 1.0 }
        };
        let norms: Vec<f64> = (0..bands).map(|b| reflected(b) * total.sqrt()).collect();
        let mut light = Light::dark(bands, tree, surroundings);
        for (k, node) in tree.nodes.iter().enumerate().filter(|(_, node)| node.is_leaf()) {
            let emission = &scene.emission()[node.patch as usize * bands..][..bands];
            light.set(k, 0, emission, &norms);
        }
        light.average(tree);
        light
    }

    /// For links with a solution on them: B and H of every row.
    pub fn of_solution(
        links: &Links,
        bands: usize,
        radiosity: &[f64],
        irradiance: &[f64],
        surroundings: Surroundings,
    ) -> Light {
        // In units of the largest, squares neither overflow nor vanish.
        let mut peaks = vec![f64::MIN_POSITIVE; bands];
        for row in irradiance.chunks_exact(bands) {
            peaks.iter_mut().zip(row).for_each(|(peak, h)| *peak = peak.max(h.abs()));
        }
        let mut squares = vec![0.0; bands];
        for (r, &(leaf, _)) in links.rows().iter().enumerate() {
            let node = &links.tree.nodes[leaf as usize];
            for b in 0..bands {
                let h = irradiance[r * bands + b] / peaks[b];
                let reflected = surroundings.weights[node.patch as usize * bands + b] * h;
                squares[b] += node.area * reflected * reflected;
            }
        }
        let norms: Vec<f64> =
            squares.into_iter().zip(peaks).map(|(square, peak): (f64, f64)| square.sqrt() * peak).collect();
        let mut light = Light::dark(bands, &links.tree, surroundings);
        for (&(leaf, function), radiosity) in links.rows().iter().zip(radiosity.chunks_exact(bands)) {
            light.set(leaf as usize, function as usize, radiosity, &norms);
        }
        light.average(&links.tree);
        light
    }

    fn dark(bands: usize, tree: &Tree, surroundings: Surroundings) -> Light {
        let mut reflectances = vec![0.0; tree.nodes.len() * bands];
        for (k, node) in tree.nodes.iter().enumerate().filter(|(_, node)| node.is_leaf()) {
            let weights = &surroundings.weights[node.patch as usize * bands..][..bands];
            reflectances[k * bands..][..bands].iter_mut().zip(weights).for_each(|(square, w)| *square = w * w);
        }
        let areas = tree.nodes.iter().map(|node| node.area).collect();
        let (means, squares) = (vec![0.0; reflectances.len()], vec![0.0; reflectances.len()]);
        Light { bands, means, squares, reflectances, areas, surroundings, limit: 0.0 }
    }

    /// Adds a coefficient of B on a leaf. The functions are orthonormal: squares add up.
    fn set(&mut self, leaf: usize, function: usize, coefficient: &[f64], norms: &[f64]) {
        for (b, (x, norm)) in coefficient.iter().zip(norms).enumerate() {
            let of_norm = if *norm > 0.0 { x / norm } else { 0.0 };
            self.squares[leaf * self.bands + b] += of_norm * of_norm;
            if function == 0 {
                self.means[leaf * self.bands + b] = of_norm;
            }
        }
    }

    /// From leaves to all nodes.
    fn average(&mut self, tree: &Tree) {
        for values in [&mut self.means, &mut self.squares, &mut self.reflectances] {
            // Parents come first.
            for (k, node) in tree.nodes.iter().enumerate().skip(1).rev() {
                let parent = node.parent as usize;
                let share = node.area / tree.nodes[parent].area;
                let (above, own) = values.split_at_mut(k * self.bands);
                let above = &mut above[parent * self.bands..][..self.bands];
                above.iter_mut().zip(own).for_each(|(above, own)| *above += share * *own);
            }
        }
        for (k, _) in tree.nodes.iter().enumerate().filter(|(_, node)| !node.is_element()) {
            self.reflectances[k * self.bands..][..self.bands].iter_mut().for_each(|square| *square *= ALIKE * ALIKE);
        }
    }

    /// For a tree that has grown: new elements are as what they are part of was.
    pub fn follow(&mut self, tree: &Tree) {
        for node in &tree.nodes[self.areas.len()..] {
            self.areas.push(node.area);
            let parent = node.parent as usize * self.bands;
            for values in [&mut self.means, &mut self.squares, &mut self.reflectances] {
                values.extend_from_within(parent..parent + self.bands);
            }
        }
    }

    /// The same with a limit on the error of a link.
    pub fn with_limit(self, limit: f64) -> Light {
        Light { limit, ..self }
    }

    /// The squared error that a link which is wrong by `error`, m^2, puts in, the worst band.
    pub fn squared_error(&self, p: usize, q: usize, error: f64) -> f64 {
        let (p, q, bands) = (p * self.bands, q * self.bands, self.bands);
        let of_band = |b: usize| {
            let [mut to_p, mut to_q] = [self.squares[q + b], self.squares[p + b]];
            if self.surroundings.is_closed {
                // The mean of (B_q - B_p)^2.
                to_p = (to_p + to_q - 2.0 * self.means[p + b] * self.means[q + b]).max(0.0);
                to_q = to_p;
            }
            self.reflectances[p + b] * to_p / self.areas[p / bands]
                + self.reflectances[q + b] * to_q / self.areas[q / bands]
        };
        error * error * (0..bands).map(of_band).fold(0.0, f64::max)
    }

    /// The error that links put in, if they know nothing of each other.
    pub fn error<'a>(&self, links: impl Iterator<Item = &'a Link>) -> f64 {
        let of_link = |link: &Link| self.squared_error(link.p as usize, link.q as usize, link.exchange.error());
        links.map(of_link).sum::<f64>().sqrt()
    }
}

impl Goal for Light {
    fn allows(&self, p: usize, q: usize, error: f64) -> bool {
        self.squared_error(p, q, error) <= self.limit * self.limit
    }

    fn may_divide(&self, tree: &Tree, leaf: usize) -> bool {
        tree.nodes[leaf].radius > self.surroundings.smallest
    }

    fn most_segments(&self) -> u32 {
        MOST_SEGMENTS
    }

    fn holds_each(&self) -> bool {
        false
    }

    fn grown(&mut self, tree: &Tree) {
        self.follow(tree);
    }
}
