//! The tree of elements: clusters of patches, patches, and parts of patches.
//!
//! A patch is cut into elements by halving its edges, each of those again, and so on, where light asks for it (Hanrahan,
//! Salzman & Aupperle 1991). Above the patches are clusters (Smits, Arvo & Greenberg 1994), halved from the top: first
//! what faces different ways is parted, then what lies in different places; what lies in one plane stays together longest,
//! since it is flat and cannot see itself. Parents have lower numbers than their children.

use std::collections::HashMap;
use std::ops::Range;

use super::clusters::{Draft, NONE, SAME, drafts};
use super::functions::{Functions, MOST, Moments, Place, place};
use super::node::Node;
use crate::assembly::Order;
use crate::geometry::polygon::{Plane, area, centre};
use crate::geometry::sampling::point_in_triangle;
use crate::geometry::subdivision::split;
use crate::geometry::{Triangle, Vec3};
use crate::scene::Scene;
use crate::visibility::NO_PATCH;
use crate::visibility::bodies::Bodies;
use crate::visibility::body::extremes;

/// Places from which a node is looked at, at most.
pub const SAMPLES: usize = 8;

/// The tree over a scene.
#[derive(Debug, Clone)]
pub struct Tree {
    /// Parents before children; the root first.
    pub nodes: Vec<Node>,
    order: Order,
    /// The patches so that those of every cluster are together.
    pub sorted: Vec<u32>,
    /// The area up to each of them.
    areas: Vec<f64>,
    /// The node of every patch.
    pub node_of: Vec<u32>,
    /// Those of the scene, then midpoints of edges.
    pub vertices: Vec<Vec3>,
    midpoints: HashMap<[u32; 2], u32>,
}

impl Tree {
    /// The clusters and patches of a scene. Radiosity is constant or linear on its leaves.
    pub fn new(scene: &Scene, bodies: &Bodies, order: Order) -> Tree {
        let mut sorted: Vec<u32> = (0..scene.len() as u32).collect();
        let drafts = drafts(scene, &mut sorted);
        // What meets at one position is to be cut as one.
        let first = scene.first_vertices();
        let mut areas = vec![0.0];
        areas.extend(sorted.iter().scan(0.0, |sum, &i| {
            *sum += scene.areas()[i as usize];
            Some(*sum)
        }));
        let mut tree = Tree {
            nodes: Vec::with_capacity(drafts.len()),
            order,
            node_of: vec![NONE; scene.len()],
            vertices: scene.vertices().to_vec(),
            midpoints: HashMap::new(),
            sorted,
            areas,
        };
        // From the leaves up.
        let mut moments: Vec<Moments> = Vec::with_capacity(drafts.len());
        for (number, draft) in drafts.iter().enumerate().rev() {
            let parts = |moments: &[Moments], k: u32| moments[drafts.len() - 1 - k as usize].clone();
            let (own, node);
            if draft.children.is_empty() {
                let patch = tree.sorted[draft.patches.start];
                tree.node_of[patch as usize] = number as u32;
                let face = scene.faces()[patch as usize].map(|v| first[v as usize]);
                let normal = scene.normals()[patch as usize];
                (node, own) = tree.element(face, normal, patch, bodies.body_of(patch));
            } else {
                let of_children: Vec<Moments> = draft.children.clone().map(|k| parts(&moments, k)).collect();
                own = Moments::of_all(of_children.iter());
                node = tree.cluster(&own, draft, drafts.len(), scene);
            }
            let patches = draft.patches.start as u32..draft.patches.end as u32;
            let Draft { parent, level, children, .. } = draft;
            let children = children.clone();
            tree.nodes.push(Node { parent: *parent, level: *level, children, patches, ..node });
            moments.push(own);
        }
        tree.nodes.reverse();
        for number in 0..tree.nodes.len() {
            if !tree.nodes[number].is_element() {
                tree.look_at(number);
            }
        }
        tree
    }

    /// Without nodes, to hold a place.
    pub(super) fn empty() -> Tree {
        let (sorted, areas, node_of) = (Vec::new(), Vec::new(), Vec::new());
        let (vertices, midpoints) = (Vec::new(), HashMap::new());
        Tree { nodes: Vec::new(), order: Order::Linear, sorted, areas, node_of, vertices, midpoints }
    }

    /// A part of a patch, and its moments.
    fn element(&self, face: [u32; 3], normal: Vec3, patch: u32, body: u32) -> (Node, Moments) {
        let corners = face.map(|v| self.vertices[v as usize]);
        let (size, middle) = (area(&corners), centre(&corners));
        let moments = match self.order {
            Order::Constant => Moments::of_patch(size, middle, normal),
            Order::Linear => Moments::of_triangle(&corners, size, normal),
        };
        let radius = corners.iter().map(|x| x.distance(middle)).fold(0.0, f64::max);
        let functions = Functions::new(&moments, radius);
        let samples: Vec<Place> = quarters(&corners).map(|x| place(x, normal)).to_vec();
        let (values, fit) = fit(&functions, &samples, &[0.25; 4]);
        let node = Node {
            parent: NONE,
            children: 0..0,
            level: 0,
            patch,
            face,
            patches: 0..0,
            area: size,
            centre: middle,
            radius,
            plane: Some(Plane { normal, point: corners[0] }),
            axis: normal,
            spread: 0.0,
            body,
            hull: corners.to_vec(),
            is_polygon: true,
            functions,
            samples,
            // Of a triangle cut into four.
            unresolved: 0.25,
            values,
            fit,
        };
        (node, moments)
    }

    /// A node above patches, of `count` nodes of which those after it stand in reverse order.
    fn cluster(&self, moments: &Moments, draft: &Draft, count: usize, scene: &Scene) -> Node {
        let children = || draft.children.clone().map(|k| &self.nodes[count - 1 - k as usize]);
        let [x, y, z, u, v, w] = moments.mean;
        let (middle, normal) = (Vec3::new(x, y, z), Vec3::new(u, v, w));
        let axis = normal.normalize_or(Vec3::Z);
        let spread = children().map(|child| axis.dot(child.axis).clamp(-1.0, 1.0).acos() + child.spread);
        let spread = spread.fold(0.0, f64::max).min(std::f64::consts::PI);
        let first = children().next().and_then(|child| child.plane);
        let size = children().map(|child| child.radius + child.centre.distance(middle)).fold(0.0, f64::max);
        let is_in = |plane: &Plane, child: &Node| {
            child.plane.is_some_and(|other| other.normal.distance(plane.normal) <= SAME)
                && child.hull.iter().all(|x| plane.distance(*x).abs() <= SAME * size)
        };
        let plane = first.filter(|plane| children().all(|child| is_in(plane, child)));
        let corners = || self.sorted[draft.patches.clone()].iter().flat_map(|&i| scene.triangle(i as usize));
        let hull = match &plane {
            Some(plane) => rectangle(plane, corners()),
            None => corners_of_box(axis, corners()),
        };
        let radius = hull.iter().map(|x| x.distance(middle)).fold(0.0, f64::max).min(size);
        let body = children().map(|child| child.body).reduce(|a, b| if a == b { a } else { NONE }).unwrap_or(NONE);
        Node {
            parent: NONE,
            children: 0..0,
            level: 0,
            patch: NO_PATCH,
            face: [0; 3],
            patches: 0..0,
            area: moments.area,
            centre: middle,
            radius,
            plane,
            axis,
            spread,
            body,
            is_polygon: plane.is_some() && (area(&hull) - moments.area).abs() <= SAME * moments.area,
            hull,
            functions: Functions::new(moments, radius),
            samples: Vec::new(),
            unresolved: moments.variance(),
            values: Vec::new(),
            fit: Vec::new(),
        }
    }

    /// Sets the places from which a cluster is looked at, and how values there are fitted: the means of its largest parts.
    fn look_at(&mut self, number: usize) {
        let mut parts = vec![number];
        while parts.len() < SAMPLES {
            let divisible = parts.iter().enumerate().filter(|(_, part)| !self.nodes[**part].is_leaf());
            let largest = divisible.max_by(|(_, a), (_, b)| self.nodes[**a].area.total_cmp(&self.nodes[**b].area));
            let Some((at, &part)) = largest else { break };
            let children = self.nodes[part].children.clone();
            parts[at] = children.start as usize;
            parts.extend(children.skip(1).map(|child| child as usize));
        }
        // Two triangles alone would not show what is linear on them.
        let whole = self.nodes[number].area;
        let (mut samples, mut weights) = (Vec::new(), Vec::new());
        for &part in &parts {
            let node = &self.nodes[part];
            if node.is_leaf() && 4 * parts.len() <= SAMPLES {
                samples.extend_from_slice(&node.samples);
                weights.resize(samples.len(), 0.25 * node.area / whole);
            } else {
                samples.push(*node.functions.mean());
                weights.push(node.area / whole);
            }
        }
        let node = &mut self.nodes[number];
        let centre = node.centre;
        let offset = |z: &Place| (Vec3::new(z[0], z[1], z[2]) - centre).length_squared();
        let shown: f64 = samples.iter().zip(&weights).map(|(z, weight)| weight * offset(z)).sum();
        node.unresolved = (1.0 - shown / node.unresolved).clamp(0.0, 0.5);
        (node.values, node.fit) = fit(&node.functions, &samples, &weights);
        node.samples = samples;
    }

    /// Cuts a leaf into four; a sliver, whose short edge needs no halving, into three, so that it takes no more elements to come
    /// down to some length than a wide patch does.
    pub fn divide(&mut self, number: usize) {
        /// Edges longer than this are halved, relative to the longest.
        const LONG: f64 = 1.0 / 3.0;
        let Node { face, patch, level, patches, body, axis, .. } = self.nodes[number].clone();
        let edges = [[face[0], face[1]], [face[1], face[2]], [face[2], face[0]]];
        let lengths = edges.map(|[a, b]| self.vertices[a as usize].distance(self.vertices[b as usize]));
        let longest = lengths.into_iter().fold(0.0, f64::max);
        let mut middle = [None; 3];
        for k in 0..3 {
            middle[k] = (lengths[k] > LONG * longest).then(|| self.midpoint(edges[k]));
        }
        let mut parts = Vec::with_capacity(4);
        split(face, middle, &self.vertices, &mut parts);
        let first = self.nodes.len() as u32;
        self.nodes[number].children = first..first + parts.len() as u32;
        for face in parts {
            let (node, _) = self.element(face, axis, patch, body);
            self.nodes.push(Node { parent: number as u32, level: level + 1, patches: patches.clone(), ..node });
        }
    }

    fn midpoint(&mut self, [a, b]: [u32; 2]) -> u32 {
        *self.midpoints.entry([a.min(b), a.max(b)]).or_insert_with(|| {
            self.vertices.push(0.5 * (self.vertices[a as usize] + self.vertices[b as usize]));
            self.vertices.len() as u32 - 1
        })
    }

    /// The middle of an edge, where an element on either side has been cut.
    pub fn midpoint_of(&self, [a, b]: [u32; 2]) -> Option<u32> {
        self.midpoints.get(&[a.min(b), a.max(b)]).copied()
    }

    /// Corner numbers of an element.
    pub fn face(&self, number: usize) -> [u32; 3] {
        self.nodes[number].face
    }

    /// Corners of an element.
    pub fn triangle(&self, number: usize) -> Triangle {
        self.nodes[number].face.map(|v| self.vertices[v as usize])
    }

    /// How radiosity varies on a leaf.
    pub fn order(&self) -> Order {
        self.order
    }

    /// The point of a node, its patch and its normal that belong to two numbers in [0, 1): evenly spread over its area.
    pub fn point(&self, scene: &Scene, number: usize, u: f64, v: f64) -> (Vec3, Vec3, u32) {
        let node = &self.nodes[number];
        if node.is_element() {
            return (point_in_triangle(&self.triangle(number), u, v), node.axis, node.patch);
        }
        let Range { start, end } = node.patches;
        let bounds = &self.areas[start as usize..=end as usize];
        let wanted = bounds[0] + u * (bounds[bounds.len() - 1] - bounds[0]);
        let k = bounds.partition_point(|bound| *bound <= wanted).clamp(1, bounds.len() - 1) - 1;
        // What is left of the number is as good as a new one.
        let rest = ((wanted - bounds[k]) / (bounds[k + 1] - bounds[k])).clamp(0.0, 1.0);
        let patch = self.sorted[start as usize + k];
        (point_in_triangle(&scene.triangle(patch as usize), rest, v), scene.normals()[patch as usize], patch)
    }

    /// For one of `count` numbers u in [0, 1), of which each interval of 1 / count holds one: a first number for [`Self::point`], by which
    /// patches are met as often as each other and none is left out where there are enough; and its weight in means over the area,
    /// up to a factor.
    pub fn over_patches(&self, number: usize, u: f64, count: usize) -> (f64, f64) {
        let node = &self.nodes[number];
        if node.is_element() {
            return (u, 1.0);
        }
        let bounds = &self.areas[node.patches.start as usize..=node.patches.end as usize];
        let patches = bounds.len() - 1;
        let (k, rest, times) = if patches <= count {
            // The intervals go to the patches in their order.
            let interval = ((u * count as f64) as usize).min(count - 1);
            let k = interval * patches / count;
            let first = |k: usize| (k * count).div_ceil(patches);
            let times = first(k + 1) - first(k);
            (k, (u * count as f64 - first(k) as f64) / times as f64, times)
        } else {
            let at = u * patches as f64;
            let k = (at as usize).min(patches - 1);
            (k, at - k as f64, 1)
        };
        let (area, whole) = (bounds[k + 1] - bounds[k], bounds[patches] - bounds[0]);
        ((bounds[k] - bounds[0] + rest * area) / whole, area / (times as f64 * whole))
    }

    /// Whether all patches of a node lie before a plane, or stand out of it by no more than `slack`. Where corners of boxes lie behind
    /// it, patches need not.
    pub fn is_before(&self, plane: &Plane, slack: f64, number: usize) -> bool {
        let node = &self.nodes[number];
        node.hull.iter().all(|x| plane.distance(*x) >= -slack)
            || (plane.distance(node.centre) >= -slack
                && !node.is_polygon
                && node.children.clone().all(|child| self.is_before(plane, slack, child as usize)))
    }

    /// Bytes held.
    pub fn nbytes(&self) -> usize {
        self.nodes.iter().map(Node::nbytes).sum()
    }
}

/// Centroids of the four parts of a triangle.
fn quarters([a, b, c]: &Triangle) -> [Vec3; 4] {
    let part = |x: Vec3, y: Vec3, z: Vec3| (4.0 * x + y + z) / 6.0;
    [part(*a, *b, *c), part(*b, *c, *a), part(*c, *a, *b), (*a + *b + *c) / 3.0]
}

/// The functions at the samples, K numbers each; and K rows of one number a sample: coefficients of the least-squares fit of values
/// there. A function that does not show at the samples takes no part.
fn fit(functions: &Functions, samples: &[Place], weights: &[f64]) -> (Vec<f64>, Vec<f64>) {
    /// Of the variance that a function has.
    const SHOWN: f64 = 0.02;
    let (count, n) = (functions.len(), samples.len());
    let values: Vec<[f64; MOST]> = samples.iter().map(|z| functions.at(z)).collect();
    // Gram-Schmidt: rows q_k orthonormal under the weights, psi_k = sum over l <= k of r_kl q_l.
    let mut rows: Vec<Option<Vec<f64>>> = Vec::new();
    let mut triangle = vec![vec![0.0; count]; count];
    for k in 0..count {
        let mut row: Vec<f64> = values.iter().map(|value| value[k]).collect();
        for (l, q) in rows.iter().enumerate() {
            if let Some(q) = q {
                let r: f64 = (0..n).map(|s| weights[s] * q[s] * row[s]).sum();
                triangle[k][l] = r;
                (0..n).for_each(|s| row[s] -= r * q[s]);
            }
        }
        let norm = (0..n).map(|s| weights[s] * row[s] * row[s]).sum::<f64>().sqrt();
        triangle[k][k] = norm;
        rows.push((norm * norm > SHOWN).then(|| row.iter().map(|x| x / norm).collect()));
    }
    // Back substitution: value = sum over l of (q_l, value) q_l = sum over k of a_k psi_k.
    let mut out = vec![0.0; count * n];
    for k in (0..count).rev() {
        let Some(q) = &rows[k] else { continue };
        for s in 0..n {
            let others: f64 = (k + 1..count).map(|m| triangle[m][k] * out[m * n + s]).sum();
            out[k * n + s] = (weights[s] * q[s] - others) / triangle[k][k];
        }
    }
    (values.iter().flat_map(|value| value[..count].to_vec()).collect(), out)
}

/// Corners of a rectangle in a plane around points of it.
fn rectangle(plane: &Plane, points: impl Iterator<Item = Vec3> + Clone) -> Vec<Vec3> {
    let origin = plane.point;
    // Along the first edge that has a length: that of a mesh of rectangles.
    let mut two = points.clone().take(2);
    let edge = two.next().zip(two.next()).map_or(Vec3::X, |(a, b)| b - a);
    let along = edge.reject_from(plane.normal).normalize_or(plane.normal.any_orthonormal_vector());
    let across = plane.normal.cross(along);
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for x in points {
        for (k, axis) in [along, across].into_iter().enumerate() {
            let t = (x - origin).dot(axis);
            (low[k], high[k]) = (low[k].min(t), high[k].max(t));
        }
    }
    let corner = |s: f64, t: f64| origin + s * along + t * across;
    vec![corner(low[0], low[1]), corner(high[0], low[1]), corner(high[0], high[1]), corner(low[0], high[1])]
}

/// Corners of a box around points: along the axes, or along a direction, which fits a part of a bowl.
fn corners_of_box(direction: Vec3, points: impl Iterator<Item = Vec3> + Clone) -> Vec<Vec3> {
    let (u, v) = direction.any_orthonormal_pair();
    let boxes = [[Vec3::X, Vec3::Y, Vec3::Z], [u, v, direction]].map(|axes| {
        let along = points.clone().map(|x| Vec3::from_array(axes.map(|axis| axis.dot(x))));
        (axes, extremes(along))
    });
    let surface = |(low, high): (Vec3, Vec3)| {
        let size = high - low;
        size.x * size.y + size.y * size.z + size.z * size.x
    };
    let [aligned, turned] = boxes;
    let (axes, (low, high)) = if surface(turned.1) < surface(aligned.1) { turned } else { aligned };
    let pick = |k: usize, bit: usize| if k >> bit & 1 == 0 { low[bit] } else { high[bit] } * axes[bit];
    (0..8).map(|k| pick(k, 0) + pick(k, 1) + pick(k, 2)).collect()
}
