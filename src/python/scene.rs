//! Scene and its rays.

use std::sync::{Arc, OnceLock};

use numpy::{PyArray1, PyArray2, PyReadonlyArray2};
use pyo3::prelude::*;
use rayon::prelude::*;

use super::convert::{from_points, points, table, values, vector};
use super::error::to_python;
use super::run::{in_pool, run};
use crate::error::{Error, Result};
use crate::geometry::Vec3;
use crate::progress::Progress;
use crate::scene::{Description, Scene as CoreScene, Sides};
use crate::visibility::{Bvh, NO_PATCH};

/// Patch numbers, distances and barycentric coordinates of a batch of hits.
type Hits<'py> = (Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray2<f64>>);

/// Rays answered between two looks at the stop flag.
const BATCH: usize = 1024;

#[pyclass(frozen, module = "radiosity._core")]
pub(super) struct Scene {
    pub(super) scene: Arc<CoreScene>,
    /// The tree over all patches, built when the first ray is cast.
    tree: OnceLock<Arc<Bvh>>,
}

impl Scene {
    fn wrap(scene: CoreScene) -> Scene {
        Scene { scene: Arc::new(scene), tree: OnceLock::new() }
    }

    pub(super) fn tree(&self, py: Python<'_>) -> PyResult<Arc<Bvh>> {
        let build = || Arc::clone(self.tree.get_or_init(|| Arc::new(Bvh::of_scene(&self.scene))));
        py.detach(|| in_pool(None, build))
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
        both_sides: bool,
    ) -> PyResult<Scene> {
        let description = Description {
            vertices: points(&vertices)?,
            faces: faces.as_array().rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect(),
            bands: reflectance.as_array().ncols(),
            reflectance: values(&reflectance),
            emission: values(&emission),
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
        table(py, self.scene.reflectance().to_vec(), self.scene.bands())
    }

    #[getter]
    fn emission<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        table(py, self.scene.emission().to_vec(), self.scene.bands())
    }

    #[getter]
    fn areas<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        vector(py, self.scene.areas().to_vec())
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
        let (origins, directions) = (points(&origins)?, points(&directions)?);
        let tree = self.tree(py)?;
        let hits = run(py, threads, None, move |progress| {
            check_rays(&[("origin", &origins), ("direction", &directions)])?;
            if let Some(k) = directions.iter().position(|d| *d == Vec3::ZERO) {
                return Err(Error::Invalid(format!("ray {k}: its direction is zero")));
            }
            batched(&origins, &directions, progress, |o, d| tree.closest(o, d))
        })?;
        let patches = hits.iter().map(|hit| hit.map_or(-1, |hit| i64::from(hit.patch))).collect();
        let distances = hits.iter().map(|hit| hit.map_or(f64::INFINITY, |hit| hit.t)).collect();
        let barycentric = hits.iter().flat_map(|hit| hit.map_or([f64::NAN; 2], |hit| hit.barycentric)).collect();
        Ok((vector(py, patches), vector(py, distances), table(py, barycentric, 2)?))
    }

    fn occluded<'py>(
        &self,
        py: Python<'py>,
        p: PyReadonlyArray2<f64>,
        q: PyReadonlyArray2<f64>,
        threads: Option<usize>,
    ) -> PyResult<Bound<'py, PyArray1<bool>>> {
        let (p, q) = (points(&p)?, points(&q)?);
        let tree = self.tree(py)?;
        let blocked = run(py, threads, None, move |progress| {
            check_rays(&[("start", &p), ("end", &q)])?;
            batched(&p, &q, progress, |p, q| tree.blocked(p, q, [NO_PATCH; 2]))
        })?;
        Ok(vector(py, blocked))
    }
}

fn check_rays(ends: &[(&str, &[Vec3])]) -> Result<()> {
    let mut problems = Vec::new();
    for (name, points) in ends {
        let bad = points.iter().enumerate().filter(|(_, p)| !p.is_finite()).take(8);
        problems.extend(bad.map(|(k, p)| format!("ray {k}: its {name} {p} is not finite")));
    }
    Error::from_problems(problems)
}

fn batched<T: Send>(
    a: &[Vec3],
    b: &[Vec3],
    progress: &Progress,
    answer: impl Fn(Vec3, Vec3) -> T + Sync,
) -> Result<Vec<T>> {
    progress.expect(a.len() as u64);
    let batches: Result<Vec<Vec<T>>> = a
        .par_chunks(BATCH)
        .zip(b.par_chunks(BATCH))
        .map(|(a, b)| {
            progress.advance(a.len() as u64)?;
            Ok(a.iter().zip(b).map(|(a, b)| answer(*a, *b)).collect())
        })
        .collect();
    Ok(batches?.into_iter().flatten().collect())
}
