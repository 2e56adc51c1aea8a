//! Scene and its rays.

use std::sync::{Arc, OnceLock};

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use rayon::prelude::*;

use super::convert::{Rows, copied, from_points, points, rows, shape_error, table, values, vector};
use super::error::to_python;
use super::run::{in_pool, run};
use crate::error::{Error, Result};
use crate::geometry::Vec3;
use crate::memory::filled;
use crate::render::Corners;
use crate::scene::{Description, Material, Scene as CoreScene, Sides};
use crate::visibility::{Bvh, NO_PATCH, Ray, Segment};

/// Patch numbers, distances and barycentric coordinates of a batch of hits.
type Hits<'py> = (Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray2<f64>>);

/// Rays answered by one thread at a time.
const BATCH: usize = 1024;
/// Rays answered between two looks for Ctrl-C: a tenth of a second.
const SHARE: usize = 256 * BATCH;

#[pyclass(frozen, module = "radiosity._core")]
pub(super) struct Scene {
    pub(super) scene: Arc<CoreScene>,
    /// The tree over all patches, built when the first ray is cast.
    tree: Arc<OnceLock<Arc<Bvh>>>,
    /// Which patches meet at corners, found when the first smooth picture is made.
    corners: OnceLock<Arc<Corners>>,
}

impl Scene {
    fn wrap(scene: CoreScene) -> Scene {
        Scene { scene: Arc::new(scene), tree: Arc::default(), corners: OnceLock::new() }
    }

    pub(super) fn tree(&self, py: Python<'_>) -> PyResult<Arc<Bvh>> {
        py.detach(|| in_pool(None, self.later_tree()))
    }

    /// Gives the tree, in whatever pool it is called.
    pub(super) fn later_tree(&self) -> impl FnOnce() -> Arc<Bvh> + Send + 'static {
        let (tree, scene) = (Arc::clone(&self.tree), Arc::clone(&self.scene));
        move || Arc::clone(tree.get_or_init(|| Arc::new(Bvh::of_scene(&scene))))
    }

    pub(super) fn corners(&self, py: Python<'_>) -> PyResult<Arc<Corners>> {
        let find = || Arc::clone(self.corners.get_or_init(|| Arc::new(Corners::new(&self.scene))));
        py.detach(|| in_pool(None, find))
    }
}

#[pymethods]
impl Scene {
    #[new]
    fn new(
        vertices: PyReadonlyArray2<f64>,
        faces: PyReadonlyArray2<i64>,
        reflectance: PyReadonlyArray2<f64>,
        emission: PyReadonlyArray2<f64>,
        mirror: PyReadonlyArray1<f64>,
        ior: PyReadonlyArray1<f64>,
        both_sides: bool,
    ) -> PyResult<Scene> {
        let description = Description {
            vertices: points(&vertices)?,
            faces: faces.as_array().rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect(),
            bands: reflectance.as_array().ncols(),
            reflectance: values(&reflectance)?,
            emission: values(&emission)?,
            materials: materials(&mirror, &ior),
            sides: if both_sides { Sides::Both } else { Sides::Front },
        };
        CoreScene::new(description).map(Scene::wrap).map_err(to_python)
    }

    #[getter]
    fn vertices<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        from_points(py, self.scene.vertices())
    }

    #[getter]
    fn faces<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i64>>> {
        table(py, self.scene.faces().iter().flatten().map(|&v| i64::from(v)).collect(), 3)
    }

    #[getter]
    fn reflectance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        table(py, copied(self.scene.reflectance())?, self.scene.bands())
    }

    #[getter]
    fn emission<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        table(py, copied(self.scene.emission())?, self.scene.bands())
    }

    /// Of each patch the fraction that it mirrors, and its index of refraction, nan where it is no glass.
    #[getter]
    fn materials<'py>(&self, py: Python<'py>) -> (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>) {
        let of = |i: usize| match self.scene.material(i) {
            Material::Diffuse => (0.0, f64::NAN),
            Material::Mirror(reflected) => (reflected, f64::NAN),
            Material::Glass(ior) => (0.0, ior),
        };
        let (mirror, ior) = (0..self.scene.len()).map(of).unzip();
        (vector(py, mirror), vector(py, ior))
    }

    #[getter]
    fn areas<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        Ok(vector(py, copied(self.scene.areas())?))
    }

    #[getter]
    fn normals<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        from_points(py, self.scene.normals())
    }

    fn subdivide<'py>(
        &self,
        py: Python<'py>,
        max_edge: f64,
        memory: u64,
    ) -> PyResult<(Scene, Bound<'py, PyArray1<i64>>)> {
        let coarse = Arc::clone(&self.scene);
        let (scene, parent) = run(py, None, None, move |progress| coarse.subdivide(max_edge, memory, progress))?;
        Ok((Scene::wrap(scene), vector(py, parent.into_iter().map(i64::from).collect())))
    }

    fn intersect<'py>(
        &self,
        py: Python<'py>,
        origins: PyReadonlyArray2<f64>,
        directions: PyReadonlyArray2<f64>,
        threads: Option<usize>,
    ) -> PyResult<Hits<'py>> {
        let (origins, directions) = pair(&origins, &directions)?;
        let tree = self.tree(py)?;
        py.detach(|| check_rays(&[("origin", origins), ("direction", directions)])).map_err(to_python)?;
        if let Some(k) = directions.iter().position(|d| *d == [0.0; 3]) {
            return Err(to_python(Error::Invalid(format!("ray {k}: its direction is zero"))));
        }
        let m = origins.len();
        let room = |count| filled(count, 0.0).map_err(to_python);
        let mut patches = filled(m, 0).map_err(to_python)?;
        let (mut distances, mut barycentric) = (room(m)?, room(2 * m)?);
        let answers = patches.chunks_mut(SHARE).zip(distances.chunks_mut(SHARE)).zip(barycentric.chunks_mut(2 * SHARE));
        let questions = origins.chunks(SHARE).zip(directions.chunks(SHARE));
        shares(py, threads, questions.zip(answers), |((origins, directions), ((patches, distances), barycentric))| {
            let questions = origins.par_chunks(BATCH).zip(directions.par_chunks(BATCH));
            let answers = patches.par_chunks_mut(BATCH).zip(distances.par_chunks_mut(BATCH));
            let answers = answers.zip(barycentric.par_chunks_mut(2 * BATCH));
            questions.zip(answers).for_each(|((origins, directions), ((patches, distances), barycentric))| {
                let ray = |(o, d): (&[f64; 3], &[f64; 3])| Ray {
                    origin: Vec3::from_array(*o),
                    direction: Vec3::from_array(*d),
                    exclude: NO_PATCH,
                };
                let rays: Vec<Ray> = origins.iter().zip(directions).map(ray).collect();
                for (k, hit) in tree.closest(&rays).into_iter().enumerate() {
                    patches[k] = hit.map_or(-1, |hit| i64::from(hit.patch));
                    distances[k] = hit.map_or(f64::INFINITY, |hit| hit.t);
                    barycentric[2 * k..][..2].copy_from_slice(&hit.map_or([f64::NAN; 2], |hit| hit.barycentric));
                }
            });
        })?;
        Ok((vector(py, patches), vector(py, distances), table(py, barycentric, 2)?))
    }

    fn occluded<'py>(
        &self,
        py: Python<'py>,
        p: PyReadonlyArray2<f64>,
        q: PyReadonlyArray2<f64>,
        threads: Option<usize>,
    ) -> PyResult<Bound<'py, PyArray1<bool>>> {
        let (p, q) = pair(&p, &q)?;
        let tree = self.tree(py)?;
        py.detach(|| check_rays(&[("start", p), ("end", q)])).map_err(to_python)?;
        let mut blocked = filled(p.len(), false).map_err(to_python)?;
        let questions = p.chunks(SHARE).zip(q.chunks(SHARE));
        shares(py, threads, questions.zip(blocked.chunks_mut(SHARE)), |((p, q), blocked)| {
            let questions = p.par_chunks(BATCH).zip(q.par_chunks(BATCH));
            questions.zip(blocked.par_chunks_mut(BATCH)).for_each(|((p, q), blocked)| {
                let segment = |(p, q): (&[f64; 3], &[f64; 3])| Segment {
                    start: Vec3::from_array(*p),
                    end: Vec3::from_array(*q),
                    exclude: [NO_PATCH; 2],
                };
                let segments: Vec<Segment> = p.iter().zip(q).map(segment).collect();
                blocked.copy_from_slice(&tree.blocked(&segments));
            });
        })?;
        Ok(vector(py, blocked))
    }
}

/// What is neither mirror (0) nor glass (nan) is diffuse; what is both is glass, and named as such where it is refused.
fn materials(mirror: &PyReadonlyArray1<f64>, ior: &PyReadonlyArray1<f64>) -> Vec<Material> {
    let of = |(&mirror, &ior): (&f64, &f64)| match (mirror, ior) {
        (0.0, ior) if ior.is_nan() => Material::Diffuse,
        (mirror, ior) if ior.is_nan() => Material::Mirror(mirror),
        (_, ior) => Material::Glass(ior),
    };
    mirror.as_array().iter().zip(ior.as_array()).map(of).collect()
}

/// Two arrays of as many rows.
fn pair<'a>(a: &'a PyReadonlyArray2<f64>, b: &'a PyReadonlyArray2<f64>) -> PyResult<(Rows<'a>, Rows<'a>)> {
    match (rows(a)?, rows(b)?) {
        (a, b) if a.len() == b.len() => Ok((a, b)),
        (a, b) => Err(shape_error(&format!("({}, 3)", a.len()), &[b.len(), 3])),
    }
}

fn check_rays(ends: &[(&str, Rows)]) -> Result<()> {
    let mut problems = Vec::new();
    for (name, points) in ends {
        let bad = points.iter().enumerate().filter(|(_, p)| !p.iter().all(|x| x.is_finite())).take(8);
        problems.extend(bad.map(|(k, p)| format!("ray {k}: its {name} {} is not finite", Vec3::from_array(*p))));
    }
    Error::from_problems(problems)
}

/// Does `work` on one share after the other, off the GIL, and looks for Ctrl-C in between.
fn shares<S: Send>(
    py: Python<'_>,
    threads: Option<usize>,
    shares: impl Iterator<Item = S>,
    work: impl Fn(S) + Sync,
) -> PyResult<()> {
    for share in shares {
        py.detach(|| in_pool(threads, || work(share)))?;
        py.check_signals()?;
    }
    Ok(())
}
