//! Small meshes and scenes that several test files use, and random numbers that do not come from the crate under test.

use std::cell::Cell;
use std::collections::HashMap;

use radiosity::assembly::{Dense, DenseOptions, FormFactors};
use radiosity::geometry::Vec3;
use radiosity::scene::{Description, Scene, Sides};
use radiosity::{Error, Progress, Result};

pub fn vec3(x: f64, y: f64, z: f64) -> Vec3 {
    Vec3::new(x, y, z)
}

/// splitmix64 (Steele, Lea & Flood 2014) as a sequence: the same numbers on every machine.
pub struct Random(Cell<u64>);

impl Random {
    pub fn new(seed: u64) -> Random {
        Random(Cell::new(seed))
    }

    fn bits(&self) -> u64 {
        self.0.set(self.0.get().wrapping_add(0x9e37_79b9_7f4a_7c15));
        let mut z = self.0.get();
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in [0, 1).
    pub fn uniform(&self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform in [low, high).
    pub fn between(&self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    pub fn below(&self, n: usize) -> usize {
        (self.uniform() * n as f64) as usize
    }

    /// Uniform in the cube [-1, 1]^3.
    pub fn in_cube(&self) -> Vec3 {
        vec3(self.between(-1.0, 1.0), self.between(-1.0, 1.0), self.between(-1.0, 1.0))
    }

    /// Uniform on the unit sphere.
    pub fn direction(&self) -> Vec3 {
        loop {
            let v = self.in_cube();
            let r2 = v.length_squared();
            if (1e-3..=1.0).contains(&r2) {
                return v / r2.sqrt();
            }
        }
    }

    /// A random rotation, as the images of x, y and z.
    pub fn rotation(&self) -> [Vec3; 3] {
        let x = self.direction();
        let y = loop {
            let side = x.cross(self.direction());
            if side.length() > 0.1 {
                break side.normalize();
            }
        };
        [x, y, x.cross(y)]
    }

    /// A triangle around `centre` whose corners lie within `size` of it, not a sliver.
    pub fn triangle(&self, centre: Vec3, size: f64) -> [Vec3; 3] {
        loop {
            let t = [0; 3].map(|_| centre + size * self.in_cube());
            if (t[1] - t[0]).cross(t[2] - t[0]).length() > 0.2 * size * size {
                return t;
            }
        }
    }
}

pub fn rotated(rotation: &[Vec3; 3], v: Vec3) -> Vec3 {
    v.x * rotation[0] + v.y * rotation[1] + v.z * rotation[2]
}

/// Corners and triangles, without materials.
#[derive(Debug, Clone, Default)]
pub struct Mesh {
    pub vertices: Vec<Vec3>,
    pub faces: Vec<[i64; 3]>,
}

impl Mesh {
    pub fn of_triangles(triangles: &[[Vec3; 3]]) -> Mesh {
        let faces = (0..triangles.len() as i64).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        Mesh { vertices: triangles.as_flattened().to_vec(), faces }
    }

    /// This mesh and another.
    pub fn and(mut self, other: &Mesh) -> Mesh {
        let base = self.vertices.len() as i64;
        self.vertices.extend(&other.vertices);
        self.faces.extend(other.faces.iter().map(|f| f.map(|v| v + base)));
        self
    }

    /// Wound the other way round.
    pub fn reversed(mut self) -> Mesh {
        self.faces.iter_mut().for_each(|f| f.swap(1, 2));
        self
    }

    pub fn map(mut self, f: impl Fn(Vec3) -> Vec3) -> Mesh {
        self.vertices.iter_mut().for_each(|v| *v = f(*v));
        self
    }

    /// The faces as the geometry module wants them.
    pub fn indices(&self) -> Vec<[u32; 3]> {
        self.faces.iter().map(|f| f.map(|v| v as u32)).collect()
    }

    /// One band, the same reflectance everywhere, no emission.
    pub fn scene(&self) -> Scene {
        self.scene_with(1, Sides::Front, |_, _| 0.5, |_, _| 0.0)
    }

    /// Materials given by patch and band.
    pub fn scene_with(
        &self,
        bands: usize,
        sides: Sides,
        reflectance: impl Fn(usize, usize) -> f64,
        emission: impl Fn(usize, usize) -> f64,
    ) -> Scene {
        self.try_scene(bands, sides, reflectance, emission).expect("the mesh is sound")
    }

    pub fn try_scene(
        &self,
        bands: usize,
        sides: Sides,
        reflectance: impl Fn(usize, usize) -> f64,
        emission: impl Fn(usize, usize) -> f64,
    ) -> Result<Scene> {
        let table = |value: &dyn Fn(usize, usize) -> f64| {
            (0..self.faces.len() * bands).map(|k| value(k / bands, k % bands)).collect()
        };
        Scene::new(Description {
            vertices: self.vertices.clone(),
            faces: self.faces.clone(),
            bands,
            reflectance: table(&reflectance),
            emission: table(&emission),
            materials: Vec::new(),
            sides,
        })
    }
}

/// A parallelogram of k x k cells, two triangles each; its normal points along `u` x `v`.
pub fn plate(corner: Vec3, u: Vec3, v: Vec3, k: usize) -> Mesh {
    let mut mesh = Mesh::default();
    let step = 1.0 / k as f64;
    for row in 0..=k {
        for column in 0..=k {
            mesh.vertices.push(corner + column as f64 * step * u + row as f64 * step * v);
        }
    }
    let at = |column: usize, row: usize| (row * (k + 1) + column) as i64;
    for row in 0..k {
        for column in 0..k {
            let [a, b] = [at(column, row), at(column + 1, row)];
            let [d, c] = [at(column, row + 1), at(column + 1, row + 1)];
            mesh.faces.extend([[a, b, c], [a, c, d]]);
        }
    }
    mesh
}

/// A closed box from `low` to `high`, k x k cells a side, fronts inside. 12 k^2 triangles that share their corners.
pub fn box_from(low: Vec3, high: Vec3, k: usize) -> Mesh {
    let e = [vec3(k as f64, 0.0, 0.0), vec3(0.0, k as f64, 0.0), vec3(0.0, 0.0, k as f64)];
    // On the integer grid 0 .. k, so that corners shared by sides are equal.
    let mut grid = Mesh::default();
    for axis in 0..3 {
        let (u, v) = (e[(axis + 1) % 3], e[(axis + 2) % 3]);
        grid = grid.and(&plate(Vec3::ZERO, u, v, k)).and(&plate(e[axis], v, u, k));
    }
    let mut index = HashMap::new();
    let mut mesh = Mesh::default();
    for face in &grid.faces {
        mesh.faces.push(face.map(|v| {
            let at = grid.vertices[v as usize].round();
            *index.entry(at.to_array().map(|x| x as i64)).or_insert_with(|| {
                mesh.vertices.push(low + at / k as f64 * (high - low));
                mesh.vertices.len() as i64 - 1
            })
        }));
    }
    mesh
}

/// The unit cube, fronts inside.
pub fn cube(k: usize) -> Mesh {
    box_from(Vec3::ZERO, Vec3::ONE, k)
}

/// The unit cube with a smaller box inside that hides a good part of it: closed, 12 k^2 + 12 patches.
pub fn box_in_box(k: usize) -> Mesh {
    cube(k).and(&box_from(vec3(0.3, 0.25, 0.2), vec3(0.7, 0.65, 0.6), 1).reversed())
}

/// The unit cube with a stack of ten plates inside, fronts up and down: closed, and so many bodies stand between most pairs
/// that their visibility is sampled by segments. 12 k^2 + 40 patches.
pub fn stack_in_box(k: usize) -> Mesh {
    (0..10).fold(cube(k), |mesh, storey| {
        let corner = vec3(0.3, 0.25, 0.3 + 0.03 * f64::from(storey));
        let plate = plate(corner, 0.4 * Vec3::X, 0.4 * Vec3::Y, 1);
        mesh.and(&plate).and(&plate.reversed())
    })
}

/// An icosahedron whose triangles are quartered `level` times, corners on the unit sphere, fronts outside.
pub fn icosphere(level: usize) -> Mesh {
    let phi = 0.5 * (1.0 + 5f64.sqrt());
    let mut mesh = Mesh::default();
    for (a, b) in [(-1.0, phi), (1.0, phi), (-1.0, -phi), (1.0, -phi)] {
        mesh.vertices.push(vec3(a, b, 0.0).normalize());
    }
    for (a, b) in [(-1.0, phi), (1.0, phi), (-1.0, -phi), (1.0, -phi)] {
        mesh.vertices.push(vec3(0.0, a, b).normalize());
    }
    for (a, b) in [(-1.0, phi), (1.0, phi), (-1.0, -phi), (1.0, -phi)] {
        mesh.vertices.push(vec3(b, 0.0, a).normalize());
    }
    mesh.faces = vec![
        [0, 11, 5],
        [0, 5, 1],
        [0, 1, 7],
        [0, 7, 10],
        [0, 10, 11],
        [1, 5, 9],
        [5, 11, 4],
        [11, 10, 2],
        [10, 7, 6],
        [7, 1, 8],
        [3, 9, 4],
        [3, 4, 2],
        [3, 2, 6],
        [3, 6, 8],
        [3, 8, 9],
        [4, 9, 5],
        [2, 4, 11],
        [6, 2, 10],
        [8, 6, 7],
        [9, 8, 1],
    ];
    for _ in 0..level {
        let mut middle: HashMap<(i64, i64), i64> = HashMap::new();
        let mut faces = Vec::new();
        for &[a, b, c] in &mesh.faces {
            let [ab, bc, ca] = [(a, b), (b, c), (c, a)].map(|(p, q)| {
                *middle.entry((p.min(q), p.max(q))).or_insert_with(|| {
                    let m = mesh.vertices[p as usize] + mesh.vertices[q as usize];
                    mesh.vertices.push(m.normalize());
                    mesh.vertices.len() as i64 - 1
                })
            });
            faces.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        mesh.faces = faces;
    }
    mesh
}

/// Two unit squares face to face at distance 1, k x k cells each: open, nothing between them.
pub fn two_plates(k: usize) -> Mesh {
    let (x, y) = (vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0));
    plate(Vec3::ZERO, x, y, k).and(&plate(vec3(0.0, 0.0, 1.0), y, x, k))
}

/// More memory than any scene of these tests needs.
pub const PLENTY: u64 = 1 << 40;

pub fn dense(scene: &Scene, tolerance: f64, seed: u64) -> Dense {
    Dense::new(scene, DenseOptions { tolerance, seed, memory: PLENTY }, &Progress::default()).unwrap()
}

/// F as a plain n x n table.
pub fn table(f: &dyn FormFactors) -> Vec<f64> {
    let n = f.len();
    let mut out = vec![0.0; n * n];
    for (i, row) in out.chunks_exact_mut(n).enumerate() {
        f.row(i, row);
    }
    out
}

/// What `work` returns on so many threads.
pub fn on_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
}

/// The text of an [`Error::Invalid`].
#[track_caller]
pub fn invalid<T>(outcome: Result<T>) -> String {
    match outcome {
        Err(Error::Invalid(text)) => text,
        Err(other) => panic!("another error: {other}"),
        Ok(_) => panic!("accepted"),
    }
}

#[track_caller]
pub fn assert_close(value: f64, expected: f64, tolerance: f64) {
    assert!(
        (value - expected).abs() <= tolerance,
        "{value:e} is not {expected:e}: off by {:e}, allowed {tolerance:e}",
        (value - expected).abs()
    );
}
