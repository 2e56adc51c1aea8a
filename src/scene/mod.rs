//! A scene: triangular patches as flat arrays, with reflectance and emission per band, frozen once built.
//!
//! Most patches are diffuse. Others are mirrors or glass ([`Material`]): they have no radiosity of their own, and light goes on
//! from them as [`crate::visibility::specular`] follows it.
//!
//! Surfaces are one-sided: the front is the side from which the corners run counter-clockwise. The back blocks light
//! but neither emits nor reflects. [`Sides::Both`] gives every patch a reversed twin, so that a thin sheet has two
//! radiosities, one for each side: patch i + n is the back of patch i.

mod validate;

use std::collections::HashMap;

use crate::error::{Error, Result};
use crate::geometry::polygon::{Plane, area_vector};
use crate::geometry::subdivision::subdivide;
use crate::geometry::{Triangle, Vec3};
use crate::progress::Progress;

/// Which sides of the given triangles emit and reflect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sides {
    /// The front only (right-hand rule).
    Front,
    /// Both: every triangle becomes two patches.
    Both,
}

/// How a patch sends on the light that it meets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Material {
    /// Evenly in all directions, by its reflectance.
    Diffuse,
    /// A perfect mirror that reflects this fraction, in [0, 1], of every band.
    Mirror(f64),
    /// The smooth surface of a body of this index of refraction, > 0, relative to what is before its front.
    Glass(f64),
}

impl Material {
    /// What a message calls it.
    pub fn name(self) -> &'static str {
        match self {
            Material::Diffuse => "diffuse",
            Material::Mirror(_) => "a mirror",
            Material::Glass(_) => "glass",
        }
    }
}

/// What a scene is made from; row-major, one row a patch.
#[derive(Debug, Clone)]
pub struct Description {
    /// Corners of the patches, m.
    pub vertices: Vec<Vec3>,
    /// Indices of the three corners of each patch.
    pub faces: Vec<[i64; 3]>,
    /// Number of bands b (RGB is three; heat is one).
    pub bands: usize,
    /// Reflectance rho, n x b, each in [0, 1].
    pub reflectance: Vec<f64>,
    /// Self-emitted radiosity E, n x b, W/m^2.
    pub emission: Vec<f64>,
    /// The material of each patch; empty where all are diffuse. Mirrors and glass have neither reflectance nor emission.
    pub materials: Vec<Material>,
    /// Which sides of the triangles are active.
    pub sides: Sides,
}

/// Patches and their materials. All fields are consistent and in range.
#[derive(Debug, Clone)]
pub struct Scene {
    vertices: Vec<Vec3>,
    faces: Vec<[u32; 3]>,
    bands: usize,
    reflectance: Vec<f64>,
    emission: Vec<f64>,
    /// Empty where all are diffuse.
    materials: Vec<Material>,
    areas: Vec<f64>,
    normals: Vec<Vec3>,
    /// Whether patch i + n/2 is the back of patch i, for all i.
    mirrored: bool,
}

impl Scene {
    /// Checks everything and freezes it.
    ///
    /// # Errors
    /// [`Error::Invalid`] with every problem found, each naming its patch, its value and the allowed range.
    pub fn new(description: Description) -> Result<Scene> {
        validate::description(&description)?;
        let Description { vertices, faces, bands, mut reflectance, mut emission, mut materials, sides } = description;
        // Validation has bounded every index by the number of vertices, which is below 2^32.
        let mut faces: Vec<[u32; 3]> = faces.iter().map(|f| f.map(|v| v as u32)).collect();
        if sides == Sides::Both {
            faces.extend(faces.clone().into_iter().map(reversed));
            reflectance.extend_from_within(..);
            emission.extend_from_within(..);
            materials.extend_from_within(..);
        }
        if materials.iter().all(|material| *material == Material::Diffuse) {
            materials.clear();
        }
        let scene = Scene::assemble(vertices, faces, bands, reflectance, emission, materials);
        validate::scene(&scene)?;
        Ok(scene)
    }

    fn assemble(
        vertices: Vec<Vec3>,
        faces: Vec<[u32; 3]>,
        bands: usize,
        reflectance: Vec<f64>,
        emission: Vec<f64>,
        materials: Vec<Material>,
    ) -> Scene {
        let (mut areas, mut normals) = (Vec::with_capacity(faces.len()), Vec::with_capacity(faces.len()));
        for face in &faces {
            let vector = area_vector(&face.map(|v| vertices[v as usize]));
            areas.push(vector.length());
            normals.push(vector.normalize_or_zero());
        }
        let (fronts, backs) = faces.split_at(faces.len() / 2);
        let mirrored = fronts.iter().copied().map(reversed).eq(backs.iter().copied());
        Scene { vertices, faces, bands, reflectance, emission, materials, areas, normals, mirrored }
    }

    /// Number of patches n.
    pub fn len(&self) -> usize {
        self.faces.len()
    }

    /// No scene is empty; here because `len` is.
    pub fn is_empty(&self) -> bool {
        self.faces.is_empty()
    }

    /// Number of bands b.
    pub fn bands(&self) -> usize {
        self.bands
    }

    /// Corners, m.
    pub fn vertices(&self) -> &[Vec3] {
        &self.vertices
    }

    /// Corner indices of each patch.
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.faces
    }

    /// Reflectance rho, n x b.
    pub fn reflectance(&self) -> &[f64] {
        &self.reflectance
    }

    /// Emission E, n x b, W/m^2.
    pub fn emission(&self) -> &[f64] {
        &self.emission
    }

    /// The material of patch `i`.
    #[inline]
    pub fn material(&self, i: usize) -> Material {
        self.materials.get(i).copied().unwrap_or(Material::Diffuse)
    }

    /// Whether all patches are diffuse.
    pub fn is_diffuse(&self) -> bool {
        self.materials.is_empty()
    }

    /// Refuses mirrors and glass where `what` cannot carry them.
    ///
    /// # Errors
    /// [`Error::Invalid`] that names the first patch that is not diffuse, and who can carry it.
    pub fn require_diffuse(&self, what: &str) -> Result<()> {
        let Some(i) = self.materials.iter().position(|material| *material != Material::Diffuse) else { return Ok(()) };
        Err(Error::Invalid(format!(
            "patch {i} is {}, which {what} cannot carry: a solve by rays and two-pass pictures can",
            self.materials[i].name()
        )))
    }

    /// Refuses patches that repeat others where `what` would count the light of both; to rays only the first is there.
    ///
    /// # Errors
    /// [`Error::Invalid`] that names the first patch that repeats another one, corner by corner: seen from the same side, or
    /// from any where patches have two.
    pub fn require_distinct(&self, what: &str) -> Result<()> {
        let Some([first, again]) = validate::repeated(self) else { return Ok(()) };
        Err(Error::Invalid(format!(
            "patch {again} repeats patch {first}, corner by corner, and {what} would count the light of both: \
             leave one out"
        )))
    }

    /// The part of the light that arrives at patch `i` in band `b` that goes no further: 1 - rho.
    pub fn absorptance(&self, i: usize, b: usize) -> f64 {
        match self.material(i) {
            Material::Diffuse => 1.0 - self.reflectance[i * self.bands + b],
            Material::Mirror(reflected) => 1.0 - reflected,
            Material::Glass(_) => 0.0,
        }
    }

    /// Patch areas A, m^2.
    pub fn areas(&self) -> &[f64] {
        &self.areas
    }

    /// Unit normals, front side.
    pub fn normals(&self) -> &[Vec3] {
        &self.normals
    }

    /// For every vertex the first that has its position.
    pub fn first_vertices(&self) -> Vec<u32> {
        let mut first = HashMap::with_capacity(self.vertices.len());
        // Adding 0.0 makes -0.0 and 0.0 the same position.
        let positions = self.vertices.iter().map(|x| x.to_array().map(|x| (x + 0.0).to_bits()));
        positions.enumerate().map(|(v, position)| *first.entry(position).or_insert(v as u32)).collect()
    }

    /// The corners of patch `i`.
    #[inline]
    pub fn triangle(&self, i: usize) -> Triangle {
        self.faces[i].map(|v| self.vertices[v as usize])
    }

    /// The plane of patch `i`.
    #[inline]
    pub fn plane(&self, i: usize) -> Plane {
        Plane { normal: self.normals[i], point: self.vertices[self.faces[i][0] as usize] }
    }

    /// A finer scene with no edge longer than `max_edge`, and for each of its patches the patch that it is a part of.
    /// Where patch i + n is the back of patch i, it stays so.
    ///
    /// # Errors
    /// [`Error::Invalid`] when `max_edge` is not positive or too small for the coordinates' rounding, [`Error::Memory`] when
    /// the result would exceed `memory` bytes, [`Error::Interrupted`].
    pub fn subdivide(&self, max_edge: f64, memory: u64, progress: &Progress) -> Result<(Scene, Vec<u32>)> {
        let fronts = if self.mirrored { self.len() / 2 } else { self.len() };
        let mut fine = subdivide(&self.vertices, &self.faces[..fronts], max_edge, memory, progress)?;
        if self.mirrored {
            fine.faces.extend(fine.faces.clone().into_iter().map(reversed));
            fine.parent.extend(fine.parent.clone().iter().map(|p| p + fronts as u32));
        }
        let rows = |values: &[f64]| {
            let mut out = Vec::with_capacity(fine.parent.len() * self.bands);
            for &p in &fine.parent {
                out.extend_from_slice(&values[p as usize * self.bands..][..self.bands]);
            }
            out
        };
        let (reflectance, emission) = (rows(&self.reflectance), rows(&self.emission));
        let materials = match self.is_diffuse() {
            true => Vec::new(),
            false => fine.parent.iter().map(|&p| self.materials[p as usize]).collect(),
        };
        let scene = Scene::assemble(fine.vertices, fine.faces, self.bands, reflectance, emission, materials);
        if let Some(i) = scene.areas.iter().position(|&area| !(area > 0.0)) {
            return Err(Error::Invalid(format!(
                "max_edge {max_edge} is too small: a piece of patch {} has no area left",
                fine.parent[i]
            )));
        }
        Ok((scene, fine.parent))
    }
}

/// The same triangle seen from behind.
fn reversed([a, b, c]: [u32; 3]) -> [u32; 3] {
    [a, c, b]
}
