//! What two nodes of the tree exchange, how much of it is hidden, and how far a link between them would be wrong.
//!
//! The kernel K(y, z), sampled between places of the two, is fitted by what is linear on either:
//!
//!   K(y, z) ~ v  sum over k, l of  S_kl psi_k(y) psi_l(z),      H(y) = sum over k, l of S_kl psi_k(y)  integral of B psi_l
//!
//! S_00 is the mean of K. Where both are triangles it comes from the exact exchange, G / (A_p A_q). What the fit leaves at the
//! samples is the error of the kernel; that of visibility is how far V differs from its mean, or may differ at places where goals ask
//! for that, and how well the mean is known.
//! A shaft that no convex body reaches into proves v = 1; else segments are cast.

use super::functions::{MOST, Place};
use super::node::Node;
use super::tree::Tree;
use crate::assembly::Blockers;
use crate::form_factor::area_quadrature::kernel;
use crate::form_factor::{Accuracy, Batch, Shape};
use crate::geometry::Vec3;
use crate::geometry::polygon::Plane;
use crate::geometry::sampling::{Sobol, hash};
use crate::scene::Scene;
use crate::visibility::Segment;
use crate::visibility::shaft::Shaft;

/// Segments that tell at first how much is visible.
pub const FIRST_SEGMENTS: u32 = 16;
/// Nodes nearer to each other than this, radii over distance, are looked at twice: their exchange is taken exactly where it can.
const NEAR: f64 = 0.25;
/// What samples may not show: of terms of second order, relative to (radius / distance)^2; and of the most that may pass next to each
/// other.
const UNSHOWN: f64 = 0.1;

/// How much of what two nodes exchange passes between them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Visibility {
    /// All, which is proven.
    Full,
    /// None of the segments has passed.
    None,
    /// Some, or all of the segments without a proof.
    Partial,
}

/// What two nodes exchange.
#[derive(Debug, Clone, Copy)]
pub struct Exchange {
    /// G, m^2, as if nothing stood between.
    pub unoccluded: f64,
    /// Error of the kernel, the integral of |dK|, m^2.
    pub kernel_error: f64,
    /// Whether light passes.
    pub visibility: Visibility,
    /// v.
    pub fraction: f64,
    /// The mean of |V - v|, or the largest where each patch matters; and the standard error of v.
    pub unevenness: f64,
    /// See above.
    pub fraction_error: f64,
}

impl Exchange {
    /// How far the link is wrong: the integral of |d(K V)|, m^2.
    pub fn error(&self) -> f64 {
        self.kernel_error + self.unoccluded * (self.unevenness + self.fraction_error)
    }

    /// Whether some segments have passed, and others have not.
    pub fn is_mixed(&self) -> bool {
        self.fraction > 0.0 && self.fraction < 1.0
    }

    /// G, m^2.
    pub fn occluded(&self) -> f64 {
        self.unoccluded * self.fraction
    }
}

/// What is visible of places of one node from places of another, each from each.
pub struct Across {
    /// v.
    pub fraction: f64,
    /// The standard error of v.
    pub error: f64,
    /// How far V varies over either node: the mean of |V - v|, where V is the mean over the other.
    pub uneven: [f64; 2],
    /// The largest |V - v| of a place, times its share of the exchange over the mean share.
    pub most: [f64; 2],
}

/// The two numbers of [`Tree::point`] for a place of one node, and two for a place of another.
pub type Ends = [f64; 4];

/// Looks at pairs of nodes; memory that is used again.
pub struct Oracle<'a> {
    scene: &'a Scene,
    blockers: &'a Blockers,
    accuracy: Accuracy,
    holds_each: bool,
    seed: u64,
    batch: Batch,
    values: Vec<f64>,
    half: Vec<f64>,
}

impl<'a> Oracle<'a> {
    /// For a scene with its blockers; the exact exchange is taken to `accuracy`. With `holds_each` links have to be right for every patch,
    /// else in the mean.
    pub fn new(
        scene: &'a Scene,
        blockers: &'a Blockers,
        accuracy: Accuracy,
        holds_each: bool,
        seed: u64,
    ) -> Oracle<'a> {
        Oracle {
            scene,
            blockers,
            accuracy,
            holds_each,
            seed,
            batch: Batch::new(),
            values: Vec::new(),
            half: Vec::new(),
        }
    }

    /// What samples and segments may have missed, the integral of |dK|, m^2: nothing, but next to each other, or across the other's
    /// horizon. Where each patch matters, it is a share of the most that a patch may exchange: places of a large node show little
    /// of what is next to a small one.
    pub fn unseen(&self, a: &Node, b: &Node) -> f64 {
        let (distance, reach) = (a.centre.distance(b.centre), a.radius + b.radius);
        let is_apart = reach < distance;
        if self.holds_each && !(is_apart && a.gap(b) + 2.0 * a.radius.min(b.radius) >= a.radius.max(b.radius)) {
            return UNSHOWN * a.most_exchange(b);
        }
        if is_apart && a.faces(b) && b.faces(a) {
            return 0.0;
        }
        UNSHOWN * a.most_cosines(b) * a.area * b.area / (std::f64::consts::PI * distance.max(reach).powi(2))
    }

    /// The exchange without what stands between, as the samples show it, and S of it, appended to `matrix`: K_p rows of K_q
    /// numbers.
    pub fn seen(&mut self, a: &Node, b: &Node, matrix: &mut Vec<f64>) -> Exchange {
        let first = matrix.len();
        self.fit(a, b, matrix);
        let squared = (a.radius.powi(2) + b.radius.powi(2)) / a.centre.distance_squared(b.centre);
        let unseen = self.unseen(a, b);
        if unseen == 0.0 {
            matrix[first] += unresolved(a, b, matrix[first]);
        }
        let mean = matrix[first];
        let error = self.left(a, b, &matrix[first..]).max(UNSHOWN * squared * mean).min(mean);
        let whole = a.area * b.area;
        Exchange {
            unoccluded: mean * whole,
            kernel_error: (error * whole).max(unseen),
            visibility: Visibility::Full,
            fraction: 1.0,
            unevenness: 0.0,
            fraction_error: 0.0,
        }
    }

    /// Puts the exact exchange of two convex polygons in place of the sampled one, where that may be wrong; false when there is none.
    pub fn make_exact(&mut self, a: &Node, b: &Node, exchange: &mut Exchange, matrix: &mut [f64]) -> bool {
        // Two patches are known by their exchange alone.
        let is_known = matrix.len() == 1 && a.is_leaf() && b.is_leaf();
        let reach = (a.radius + b.radius) / a.centre.distance(b.centre);
        if !(a.is_polygon && b.is_polygon && (is_known || reach > NEAR || !(exchange.unoccluded > 0.0))) {
            return true;
        }
        let exact = self.batch.exchange(&Shape::new(&a.hull), &Shape::new(&b.hull), &self.accuracy);
        let scale = if exchange.unoccluded > 0.0 { exact / exchange.unoccluded } else { 0.0 };
        matrix.iter_mut().for_each(|s| *s *= scale);
        matrix[0] = exact / (a.area * b.area);
        exchange.unoccluded = exact;
        exchange.kernel_error = if is_known { 0.0 } else { exchange.kernel_error.min(exact) };
        exact > 0.0
    }

    /// Appends S = D_p K D_q^T to `matrix`; K at the samples stays in `values`.
    fn fit(&mut self, a: &Node, b: &Node, matrix: &mut Vec<f64>) {
        let (m, n) = (a.samples.len(), b.samples.len());
        self.values.clear();
        for y in &a.samples {
            self.values.extend(b.samples.iter().map(|z| kernel_between(y, z)));
        }
        // D_p K, a row for each function of p.
        let rows = a.functions.len();
        self.half.clear();
        self.half.resize(rows * n, 0.0);
        for k in 0..rows {
            for s in 0..m {
                let d = a.fit[k * m + s];
                for (sum, value) in self.half[k * n..][..n].iter_mut().zip(&self.values[s * n..][..n]) {
                    *sum += d * value;
                }
            }
        }
        for half in self.half.chunks_exact(n) {
            matrix.extend(b.fit.chunks_exact(n).map(|d| d.iter().zip(half).map(|(d, half)| d * half).sum::<f64>()));
        }
    }

    /// The mean over all pairs of samples of |K - fit|.
    fn left(&self, a: &Node, b: &Node, matrix: &[f64]) -> f64 {
        let (n, columns) = (b.samples.len(), b.functions.len());
        let mut left = 0.0;
        for (s, on_a) in a.values.chunks_exact(a.functions.len()).enumerate() {
            let mut row = [0.0; MOST];
            for (value, numbers) in on_a.iter().zip(matrix.chunks_exact(columns)) {
                row.iter_mut().zip(numbers).for_each(|(row, number)| *row += value * number);
            }
            for (t, on_b) in b.values.chunks_exact(columns).enumerate() {
                let fitted: f64 = row.iter().zip(on_b).map(|(row, value)| row * value).sum();
                // The first row of the fit holds the weights.
                left += a.fit[s] * b.fit[t] * (self.values[s * n + t] - fitted).abs();
            }
        }
        left
    }

    /// Whether nothing is known to stand between two nodes.
    pub fn is_clear(&self, tree: &Tree, p: usize, q: usize) -> bool {
        let (a, b) = (&tree.nodes[p], &tree.nodes[q]);
        let has_before = |face: &Plane| [p, q].iter().all(|&k| tree.is_before(face, a.slack(b), k));
        let bodies = &self.blockers.bodies;
        bodies.is_empty()
            || bodies.is_clear(&Shaft::between(&a.hull, &b.hull, [a.plane, b.plane]), [a.body, b.body], has_before)
    }

    /// Looks what stands between, by so many segments: as many from every patch, or as many from all areas alike. Where they do not
    /// agree, one of those with which fewer agree is returned.
    pub fn look_between(
        &self,
        tree: &Tree,
        nodes: [usize; 2],
        segments: u32,
        by_patches: bool,
        exchange: &mut Exchange,
    ) -> Option<Ends> {
        let sobol = self.sobol(nodes);
        let (mut looks, mut all) = (Vec::with_capacity(segments as usize), Vec::with_capacity(segments as usize));
        for k in 0..segments {
            let mut ends = sobol.point(k);
            let mut weight = 1.0;
            if by_patches {
                for (number, u) in nodes.into_iter().zip([0, 2]) {
                    let of_patch;
                    (ends[u], of_patch) = tree.over_patches(number, ends[u], segments as usize);
                    weight *= of_patch;
                }
            }
            let (segment, kernel) = self.segment(tree, nodes, ends);
            weight *= kernel;
            if weight > 0.0 && weight.is_finite() {
                looks.push((weight, ends));
                all.push(segment);
            }
        }
        // In units of the largest, squares neither overflow nor vanish.
        let unit = looks.iter().fold(f64::MIN_POSITIVE, |peak, look| look.0.max(peak));
        let (mut visible, mut total, mut squares) = (0.0, 0.0, 0.0);
        let blocked = self.blockers.tree.blocked_between(&all);
        for (&(weight, _), blocked) in looks.iter().zip(&blocked) {
            let weight = weight / unit;
            total += weight;
            squares += weight * weight;
            visible += if *blocked { 0.0 } else { weight };
        }
        if !(total > 0.0) {
            // No two sampled places face each other: nothing was learnt, and the exchange is next to nothing.
            (exchange.visibility, exchange.fraction, exchange.fraction_error) = (Visibility::Partial, 0.5, 0.5);
            return None;
        }
        let v = (visible / total).clamp(0.0, 1.0);
        let effective = total * total / squares;
        exchange.fraction = v;
        exchange.visibility = if visible > 0.0 { Visibility::Partial } else { Visibility::None };
        exchange.unevenness = 2.0 * v * (1.0 - v);
        // Laplace's rule of succession where all agree.
        exchange.fraction_error =
            if v > 0.0 && v < 1.0 { (v * (1.0 - v) / effective).sqrt() } else { 1.0 / (effective + 2.0) };
        let is_rare = 2 * blocked.iter().filter(|blocked| **blocked).count() <= blocked.len();
        looks.iter().zip(&blocked).find(|(_, blocked)| **blocked == is_rare).map(|((_, ends), _)| *ends)
    }

    /// Looks from so many places of one node to so many of another. One more of either may be given that was chosen for the `rare` thing
    /// that it sees: it tells only how far that is from the mean.
    pub fn look_across(&self, tree: &Tree, nodes: [usize; 2], counts: [u32; 2], rare: Option<Ends>) -> Across {
        let [m, n] = counts.map(|count| count as usize);
        let sobol = self.sobol(nodes);
        let [starts, ends] = [(m, 0), (n, 2)].map(|(count, u)| {
            let places = (0..count).map(|k| sobol.point(k as u32)).chain(rare);
            places.map(|ends| [ends[u], ends[u + 1]]).collect::<Vec<_>>()
        });
        let (mut pairs, mut all) = (Vec::new(), Vec::new());
        for (k, [u, v]) in starts.iter().enumerate() {
            for (l, [s, t]) in ends.iter().enumerate().filter(|(l, _)| k < m || *l < n) {
                let (segment, weight) = self.segment(tree, nodes, [*u, *v, *s, *t]);
                if weight > 0.0 && weight.is_finite() {
                    pairs.push((k, l, weight));
                    all.push(segment);
                }
            }
        }
        // In units of the largest, squares neither overflow nor vanish.
        let unit = pairs.iter().fold(f64::MIN_POSITIVE, |peak, pair| pair.2.max(peak));
        // What could be seen of every place, and what is.
        let (mut of_starts, mut of_ends) = (vec![[0.0; 2]; starts.len()], vec![[0.0; 2]; ends.len()]);
        for (&(k, l, weight), blocked) in pairs.iter().zip(self.blockers.tree.blocked_between(&all)) {
            let weight = weight / unit;
            let sums = [(l < n).then_some(&mut of_starts[k]), (k < m).then_some(&mut of_ends[l])];
            for [all, seen] in sums.into_iter().flatten() {
                *all += weight;
                *seen += if blocked { 0.0 } else { weight };
            }
        }
        let [total, visible] = of_starts[..m].iter().fold([0.0; 2], |[a, b], sum| [a + sum[0], b + sum[1]]);
        if !(total > 0.0) {
            return Across { fraction: 0.5, error: 0.5, uneven: [0.5; 2], most: [0.5; 2] };
        }
        let v = visible / total;
        let of_places = |sums: &[[f64; 2]], count: usize| {
            let differences: Vec<f64> = sums.iter().map(|[all, seen]| (seen - v * all) / total).collect();
            let squares: f64 = differences[..count].iter().map(|d| d * d).sum();
            let most = differences.iter().fold(0.0, |most: f64, d| most.max(d.abs()));
            (squares, differences[..count].iter().map(|d| d.abs()).sum::<f64>(), most * count as f64)
        };
        let [(of_p, over_p, most_p), (of_q, over_q, most_q)] = [of_places(&of_starts, m), of_places(&of_ends, n)];
        // Laplace's rule of succession where all agree.
        let error = if v > 0.0 && v < 1.0 { (of_p + of_q).sqrt() } else { 1.0 / ((m * n) as f64 + 2.0) };
        Across { fraction: v, error, uneven: [over_p, over_q], most: [most_p, most_q] }
    }

    /// What two nodes are looked at by.
    fn sobol(&self, [p, q]: [usize; 2]) -> Sobol<4> {
        Sobol::new(hash(self.seed ^ hash((p as u64) << 32 | q as u64)))
    }

    /// From a place of one node to a place of another, and K of the two.
    fn segment(&self, tree: &Tree, [p, q]: [usize; 2], [u, v, s, t]: Ends) -> (Segment, f64) {
        let (start, normal, i) = tree.point(self.scene, p, u, v);
        let (end, other, j) = tree.point(self.scene, q, s, t);
        (Segment { start, end, exclude: [i, j] }, kernel(start, normal, end, other))
    }
}

/// K, or 0 where two means of parts are the same place.
fn kernel_between(y: &Place, z: &Place) -> f64 {
    let at = |z: &Place| (Vec3::new(z[0], z[1], z[2]), Vec3::new(z[3], z[4], z[5]));
    let ((x, normal), (other, other_normal)) = (at(y), at(z));
    let k = kernel(x, normal, other, other_normal);
    if k.is_finite() { k } else { 0.0 }
}

/// What the mean of K over the samples lacks, since each stands for a part of its node by the mean of that: to second order as much
/// for its variance as what the samples show more than a single pair of means (Richardson's extrapolation).
fn unresolved(a: &Node, b: &Node, mean: f64) -> f64 {
    let [y, z] = [a, b].map(|node| *node.functions.mean());
    let one = kernel_between(&y, &z);
    let share = 0.5 * (a.unresolved + b.unresolved);
    if one > 0.0 { ((mean - one) * share / (1.0 - share)).clamp(-UNSHOWN * mean, UNSHOWN * mean) } else { 0.0 }
}
