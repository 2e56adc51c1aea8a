//! A string of bytes as a scene, a matrix, polygons or rays, and all that a user may ask of them.
//!
//! Whatever the bytes say, the core answers with numbers or with an [`Error`]: it never panics, and what it returns obeys the
//! laws that hold for every input. The fuzzer (tests/fuzz) and the tests of [`crate::fuzz`] both end here.

use arbitrary::{Result, Unstructured};

use radiosity::accuracy;
use radiosity::assembly::balance::{balanced, balanced_exchange};
use radiosity::assembly::matrix::{DenseMatrix, SparseMatrix};
use radiosity::assembly::{Blockers, Dense, DenseOptions, Estimator, FormFactors, Order, Sampled, SampledOptions};
use radiosity::direct::Lights;
use radiosity::form_factor::{Accuracy, Shape, exchange};
use radiosity::geometry::Vec3;
use radiosity::geometry::polygon::defect;
use radiosity::hierarchy::{self, HierarchicalOptions, Solver};
use radiosity::instant::{self, InstantOptions};
use radiosity::render::{self, Camera, Corners, GatherOptions, Image, Shading};
use radiosity::scene::{Description, Material, Scene, Sides};
use radiosity::solve::{self, METHODS, System};
use radiosity::visibility::{Bvh, Instructions, NO_PATCH, Ray, Segment};
use radiosity::{Error, Progress};

/// Enough for every case, and little enough that a forecast gone wrong shows.
const MEMORY: u64 = 1 << 26;
/// Loose, so that a case takes milliseconds.
const TOLERANCE: f64 = 0.2;

/// Does what the bytes say.
pub fn run(bytes: &[u8]) {
    // When the bytes end early there is nothing to do.
    let _ = case(&mut Unstructured::new(bytes));
}

fn case(u: &mut Unstructured) -> Result<()> {
    match u.int_in_range(0..=12)? {
        0 => polygons(u),
        1 => matrices(u),
        2 => exchanges(u),
        3 => cameras(u),
        _ => scenes(u),
    }
}

/// A result that may be refused, but for a good reason only.
fn accepted<T>(outcome: radiosity::Result<T>) -> Option<T> {
    match outcome {
        Ok(value) => Some(value),
        Err(Error::Interrupted) => panic!("nobody has asked to stop"),
        Err(error) => {
            assert!(!error.to_string().is_empty(), "an error says what is wrong");
            None
        }
    }
}

/// Any number at all, but often one that meets others: on a grid, at an extreme, or a few roundings beside.
fn number(u: &mut Unstructured) -> Result<f64> {
    const EXTREMES: [f64; 16] = [
        0.0,
        -0.0,
        f64::MIN_POSITIVE,
        5e-324,
        1e-300,
        1e-160,
        1e-17,
        1e-9,
        1e9,
        1e17,
        1e160,
        1e300,
        f64::MAX,
        f64::INFINITY,
        f64::NEG_INFINITY,
        f64::NAN,
    ];
    let value = match u.int_in_range(0..=15)? {
        0 => f64::from_bits(u.arbitrary()?),
        1 => *u.choose(&EXTREMES)?,
        2..=4 => f64::from(u.arbitrary::<i16>()?) / 8192.0,
        _ => f64::from(u.int_in_range(-4..=4)?) / 2.0,
    };
    Ok(match u.int_in_range(0..=7)? {
        0 => f64::from_bits(value.to_bits().wrapping_add(u.int_in_range(0..=8)?)),
        1 => value * (1.0 + 1e-9),
        _ => value,
    })
}

/// In [0, 1], or now and then anything.
fn share(u: &mut Unstructured) -> Result<f64> {
    match u.int_in_range(0..=15)? {
        0 => number(u),
        1 => Ok(1.0),
        k => Ok(f64::from(k - 2) / 16.0),
    }
}

fn numbers(u: &mut Unstructured, count: usize, one: fn(&mut Unstructured) -> Result<f64>) -> Result<Vec<f64>> {
    (0..count).map(|_| one(u)).collect()
}

fn point(u: &mut Unstructured) -> Result<Vec3> {
    Ok(Vec3::new(number(u)?, number(u)?, number(u)?))
}

fn points(u: &mut Unstructured, most: usize) -> Result<Vec<Vec3>> {
    (0..u.int_in_range(0..=most)?).map(|_| point(u)).collect()
}

fn finite_point(u: &mut Unstructured) -> Result<Vec3> {
    let v = point(u)?;
    Ok(if v.is_finite() { v } else { Vec3::ONE })
}

fn tolerance(u: &mut Unstructured) -> Result<f64> {
    if u.ratio(1, 16)? { number(u) } else { Ok(TOLERANCE) }
}

/// Corners and triangles: a soup, or a room that is bent a little, with a body in it or not.
fn mesh(u: &mut Unstructured) -> Result<(Vec<Vec3>, Vec<[i64; 3]>)> {
    const CUBE: [[i64; 3]; 12] = [
        [0, 1, 3],
        [0, 3, 2],
        [4, 7, 5],
        [4, 6, 7],
        [0, 5, 1],
        [0, 4, 5],
        [2, 3, 7],
        [2, 7, 6],
        [0, 2, 6],
        [0, 6, 4],
        [1, 7, 3],
        [1, 5, 7],
    ];
    let corner = |k: usize| Vec3::new((k & 1) as f64, (k >> 1 & 1) as f64, (k >> 2) as f64);
    if u.ratio(1, 3)? {
        let mut vertices: Vec<Vec3> = (0..8).map(|k| 2.0 * corner(k)).collect();
        let mut faces = CUBE.to_vec();
        if u.ratio(1, 2)? {
            let (low, size) = (Vec3::new(0.25, 0.5, 0.75), Vec3::new(1.0, 0.5, number(u)?));
            vertices.extend((0..8).map(|k| low + size * corner(k)));
            faces.extend(CUBE.map(|[a, b, c]| [a + 8, c + 8, b + 8]));
        }
        for _ in 0..u.int_in_range(0..=3)? {
            let k = u.choose_index(vertices.len())?;
            vertices[k] = if u.ratio(1, 2)? { point(u)? } else { vertices[k] + 1e-3 * point(u)? };
        }
        for _ in 0..u.int_in_range(0..=2)? {
            faces.swap_remove(u.choose_index(faces.len())?);
        }
        let scale = if u.ratio(1, 8)? { number(u)? } else { 1.0 };
        return Ok((vertices.into_iter().map(|v| scale * v).collect(), faces));
    }
    let vertices = points(u, 14)?;
    let index = |u: &mut Unstructured| {
        if u.ratio(1, 64)? { u.arbitrary() } else { u.int_in_range(0..=vertices.len().max(1) as i64 - 1) }
    };
    let faces = (0..u.int_in_range(0..=14)?).map(|_| Ok([index(u)?, index(u)?, index(u)?])).collect::<Result<_>>()?;
    Ok((vertices, faces))
}

fn material(u: &mut Unstructured) -> Result<Material> {
    Ok(match u.int_in_range(0..=3)? {
        0 => Material::Mirror(share(u)?),
        1 => Material::Glass(if u.ratio(1, 4)? { number(u)? } else { 1.5 }),
        _ => Material::Diffuse,
    })
}

fn description(u: &mut Unstructured) -> Result<Description> {
    let (vertices, faces) = mesh(u)?;
    let bands = if u.ratio(1, 64)? { 0 } else { u.int_in_range(1..=3)? };
    let count = faces.len() * bands;
    let (mut reflectance, mut emission) = (numbers(u, count, share)?, vec![0.0; count]);
    for _ in 0..u.int_in_range(0..=3)? {
        if count > 0 {
            let k = u.choose_index(count)?;
            emission[k] = number(u)?.abs();
        }
    }
    let mut materials = Vec::new();
    if u.ratio(1, 6)? {
        materials = (0..faces.len()).map(|_| material(u)).collect::<Result<_>>()?;
        for (i, material) in materials.iter().enumerate() {
            if *material != Material::Diffuse && !u.ratio(1, 32)? {
                reflectance[i * bands..][..bands].fill(0.0);
                emission[i * bands..][..bands].fill(0.0);
            }
        }
    }
    if u.ratio(1, 64)? {
        reflectance.pop();
    }
    let sides = if u.ratio(1, 4)? { Sides::Both } else { Sides::Front };
    Ok(Description { vertices, faces, bands, reflectance, emission, materials, sides })
}

fn scenes(u: &mut Unstructured) -> Result<()> {
    let Some(scene) = accepted(Scene::new(description(u)?)) else { return Ok(()) };
    assert!(scene.areas().iter().all(|area| *area > 0.0 && area.is_finite()));
    let progress = Progress::default();
    let scene = match u.int_in_range(0..=7)? {
        0 => {
            let Some((fine, parent)) = accepted(scene.subdivide(number(u)?, 1 << 15, &progress)) else { return Ok(()) };
            assert_eq!(fine.len(), parent.len());
            fine
        }
        _ => scene,
    };
    match u.int_in_range(0..=7)? {
        0 => rays(u, &scene),
        1 => form_factors(u, &scene),
        2 => sampled(u, &scene),
        3 => hierarchical(u, &scene),
        4 => pictures(u, &scene),
        5 => lights(u, &scene),
        _ => solved(u, &scene),
    }
}

fn rays(u: &mut Unstructured, scene: &Scene) -> Result<()> {
    let tree = Bvh::of_scene(scene);
    let (mut rays, mut segments) = (Vec::new(), Vec::new());
    for _ in 0..u.int_in_range(0..=20)? {
        let (p, q) = (finite_point(u)?, finite_point(u)?);
        let direction = if q == Vec3::ZERO { Vec3::X } else { q };
        rays.push(Ray { origin: p, direction, exclude: NO_PATCH });
        segments.push(Segment { start: p, end: q, exclude: [NO_PATCH; 2] });
    }
    let (hits, blocked) = (tree.closest(&rays), tree.blocked(&segments));
    for instructions in Instructions::available() {
        let tree = Bvh::of_scene(scene).with_instructions(instructions);
        assert_eq!(hits, tree.closest(&rays), "{instructions:?}");
        assert_eq!(blocked, tree.blocked(&segments), "{instructions:?}");
    }
    for hit in hits.into_iter().flatten() {
        assert!((hit.patch as usize) < scene.len());
        assert!(hit.t >= 0.0, "{hit:?}");
        let [v, w] = hit.barycentric;
        // Of a watertight test: weights are rounded, never outside by more.
        assert!(v >= -1e-6 && w >= -1e-6 && v + w <= 1.0 + 1e-6, "{hit:?}");
    }
    Ok(())
}

/// F_ij in [`least`, 1 + `slack`]. Rows may sum to more here: of patches that overlap in one plane all are seen.
fn check_operator(scene: &Scene, f: &dyn FormFactors, least: f64, slack: f64) {
    // The normal of a needle is rounding.
    let longest = |[a, b, c]: [Vec3; 3]| a.distance(b).max(b.distance(c)).max(c.distance(a));
    let is_needle = |i: usize| scene.areas()[i] < 1e-6 * longest(scene.triangle(i)).powi(2);
    if (0..scene.len()).any(is_needle) {
        return;
    }
    let mut row = vec![0.0; f.len()];
    for i in 0..f.len() {
        f.row(i, &mut row);
        assert!(row.iter().all(|value| *value >= least && *value <= 1.0 + slack), "row {i}: {row:?}");
    }
}

fn form_factors(u: &mut Unstructured, scene: &Scene) -> Result<()> {
    let options = DenseOptions { tolerance: tolerance(u)?, seed: 0, memory: MEMORY };
    let progress = Progress::default();
    let Some(dense) = accepted(Dense::new(scene, options, &progress)) else { return Ok(()) };
    check_operator(scene, &dense, 0.0, 2.0 * dense.error_estimate().max(TOLERANCE));
    if let Some((balanced, _)) = accepted(balanced(&dense, MEMORY, &progress)) {
        check_operator(scene, &balanced, 0.0, 1e-6);
    }
    solve_system(u, &dense, scene.bands(), scene.emission(), scene.reflectance())
}

fn sampled(u: &mut Unstructured, scene: &Scene) -> Result<()> {
    let estimator = if u.ratio(1, 2)? { Estimator::MonteCarlo } else { Estimator::Hemicube };
    // A hemicube of many cells takes seconds.
    let options = SampledOptions { tolerance: tolerance(u)?.max(0.5), seed: 0, memory: MEMORY };
    if let Some(f) = accepted(Sampled::new(scene, estimator, options, &Progress::default())) {
        check_operator(scene, &f, 0.0, 1e-9);
    }
    Ok(())
}

fn hierarchical(u: &mut Unstructured, scene: &Scene) -> Result<()> {
    let progress = Progress::default();
    let tolerance = tolerance(u)?;
    let options = HierarchicalOptions { tolerance, seed: 0, memory: MEMORY };
    if let Some((links, reached)) = accepted(hierarchy::form_factors(scene, &options, &progress)) {
        // A linear function has no floor: factors may fall a little below 0, by the error of their row at most.
        let error = 2.0 * reached.error_estimate.max(TOLERANCE);
        check_operator(scene, &links, -error, error);
    }
    let blockers = Blockers::of_scene(scene);
    let Some(mut solver) = accepted(Solver::new(scene, &blockers, 0, 1 << 22)) else { return Ok(()) };
    if accepted(solver.refine_to(tolerance.clamp(0.1, 0.9), &progress)).is_some() {
        // A linear function has no floor: what arrives may fall a little below 0.
        assert!(solver.patch_irradiance().iter().all(|h| h.is_finite()));
        let (mesh, on_faces) = solver.mesh();
        assert_eq!(mesh.faces.len() * scene.bands(), on_faces.len());
        let _ = solver.audit();
    }
    Ok(())
}

fn camera(u: &mut Unstructured) -> Result<Option<Camera>> {
    let up = if u.ratio(1, 8)? { point(u)? } else { Vec3::new(0.1, 0.2, 1.0) };
    let fov = if u.ratio(1, 8)? { number(u)? } else { 60.0 };
    Ok(accepted(Camera::new(point(u)?, point(u)?, up, fov)))
}

fn cameras(u: &mut Unstructured) -> Result<()> {
    if let Some(camera) = camera(u)? {
        let (x, y) = (f64::from(u.arbitrary::<u8>()?), f64::from(u.arbitrary::<u8>()?));
        assert!(camera.direction(x, y, 256, 256).is_finite());
    }
    Ok(())
}

/// Light on every patch and band: what a solution would say, or far from it.
fn light(u: &mut Unstructured, scene: &Scene) -> Result<Vec<f64>> {
    let mut light = numbers(u, scene.len() * scene.bands(), share)?;
    light.iter_mut().for_each(|x| *x = if x.is_finite() { x.abs() } else { 1.0 });
    Ok(light)
}

fn pictures(u: &mut Unstructured, scene: &Scene) -> Result<()> {
    let Some(camera) = camera(u)? else { return Ok(()) };
    let (tree, light, progress) = (Bvh::of_scene(scene), light(u, scene)?, Progress::default());
    let (width, height) = (u.int_in_range(0..=9)?, u.int_in_range(0..=9)?);
    let corners = Corners::new(scene);
    let shading = if u.ratio(1, 2)? { Shading::Flat(&light) } else { Shading::Smooth(&corners, &light) };
    let image = Image { width, height, shading };
    if let Some(pixels) = accepted(render::render(scene, &tree, &camera, image, MEMORY, &progress)) {
        assert_eq!(pixels.len(), width * height * scene.bands());
    }
    let options = GatherOptions { width, height, tolerance: tolerance(u)?.max(0.1), seed: 0, memory: MEMORY };
    // A spot of light through glass that few pixels see takes as many passes as there may be: some are enough here.
    let mut passes = 0;
    let mut observe = |_: &[f64], _: f64| {
        passes += 1;
        if passes < 8 { Ok(()) } else { Err(Error::Interrupted) }
    };
    match render::gather(scene, &tree, &Lights::default(), &light, &camera, &options, &mut observe, &progress) {
        Err(Error::Interrupted) => assert_eq!(passes, 8),
        other => drop(accepted(other)),
    }
    Ok(())
}

fn lights(u: &mut Unstructured, scene: &Scene) -> Result<()> {
    let (tree, progress) = (Bvh::of_scene(scene), Progress::default());
    let count = u.int_in_range(0..=40)?;
    let Some(lights) = accepted(instant::virtual_lights(scene, &tree, count, 0, MEMORY, &progress)) else {
        return Ok(());
    };
    let Some(camera) = camera(u)? else { return Ok(()) };
    let bound = if u.ratio(1, 4)? { number(u)? } else { instant::default_bound(scene) };
    let (width, height) = (u.int_in_range(0..=9)?, u.int_in_range(0..=9)?);
    let compensate = u.arbitrary()?;
    let options = InstantOptions { width, height, bound, compensate, lit: true, seed: 0, memory: MEMORY };
    accepted(instant::places(scene, &tree, &camera, 3, &options, &progress));
    accepted(instant::gather(scene, &tree, &lights, &camera, &options, &progress));
    Ok(())
}

fn solved(u: &mut Unstructured, scene: &Scene) -> Result<()> {
    let order = if u.arbitrary()? { Order::Linear } else { Order::Constant };
    let tolerance = if u.ratio(1, 16)? { number(u)? } else { 0.5 };
    let options =
        accuracy::Options { tolerance: tolerance.max(0.3), order, refine: u.arbitrary()?, seed: 0, memory: 1 << 24 };
    let (progress, none) = (Progress::default(), Lights::default());
    if let Some(outcome) = accepted(accuracy::solve(scene, &none, &options, &progress)) {
        // The probe's correction has either sign: radiosity may fall below the emission by a part of its standard error.
        assert!(outcome.radiosity.iter().all(|b| b.is_finite()), "{:?}", outcome.radiosity);
        assert!(outcome.error_estimate() >= 0.0);
        accepted(accuracy::assess(scene, &none, &outcome.irradiance, &options, &progress));
    }
    accepted(accuracy::forecast(scene, &none, &options, &progress));
    Ok(())
}

/// Every solver on any system: sizes and values that fit, or do not.
fn solve_system(
    u: &mut Unstructured,
    form_factors: &dyn FormFactors,
    bands: usize,
    emission: &[f64],
    reflectance: &[f64],
) -> Result<()> {
    let system = System { form_factors, emission, reflectance, bands };
    let (_, method) = *u.choose(&METHODS)?;
    let max_iterations = if u.ratio(1, 4)? { None } else { Some(u.int_in_range(0..=40)?) };
    let options = solve::Options { tolerance: tolerance(u)?, max_iterations, memory: MEMORY };
    // White rooms take some ten thousand steps: some hundred are enough here.
    let mut steps = 0;
    let mut observe = |_: &solve::Step, _: &[f64], _: &[f64]| {
        steps += 1;
        if steps < 500 { Ok(()) } else { Err(Error::Interrupted) }
    };
    match solve::solve(&system, method, &options, &mut observe) {
        Err(Error::Interrupted) => assert_eq!(steps, 500),
        other => {
            if let Some(solved) = accepted(other) {
                assert_eq!(solved.radiosity.len(), emission.len());
                assert!(solved.error_estimate >= 0.0, "{}", solved.error_estimate);
            }
        }
    }
    Ok(())
}

fn matrices(u: &mut Unstructured) -> Result<()> {
    let n = u.int_in_range(0..=6)?;
    let bands = u.int_in_range(0..=2)?;
    let form_factors: Option<Box<dyn FormFactors>> = if u.arbitrary()? {
        let mut values = numbers(u, n * n, share)?;
        if u.ratio(7, 8)? {
            values.iter_mut().for_each(|value| *value /= n as f64);
        }
        accepted(DenseMatrix::new(n, values)).map(|matrix| Box::new(matrix) as _)
    } else {
        let entries = u.int_in_range(0..=12)?;
        let mut start = (0..=n).map(|_| u.int_in_range(0..=entries)).collect::<Result<Vec<usize>>>()?;
        if u.ratio(7, 8)? {
            start.sort_unstable();
            start[0] = 0;
            start[n] = if n == 0 { 0 } else { entries };
        }
        let index = (0..entries).map(|_| u.int_in_range(0..=n as u32)).collect::<Result<_>>()?;
        accepted(SparseMatrix::new(start, index, numbers(u, entries, share)?)).map(|matrix| Box::new(matrix) as _)
    };
    let Some(form_factors) = form_factors else { return Ok(()) };
    let count = form_factors.len() * bands + usize::from(u.ratio(1, 64)?);
    let emission = numbers(u, count, number)?.into_iter().map(f64::abs).collect::<Vec<_>>();
    let reflectance = numbers(u, count, share)?;
    solve_system(u, form_factors.as_ref(), bands, &emission, &reflectance)
}

fn exchanges(u: &mut Unstructured) -> Result<()> {
    let n = u.int_in_range(1..=6)?;
    let areas: Vec<f64> = numbers(u, n, number)?.into_iter().map(f64::abs).collect();
    let exchange: Vec<f64> = numbers(u, n * (n - 1) / 2, number)?.into_iter().map(f64::abs).collect();
    if let Some((changed, _)) = accepted(balanced_exchange(&areas, &exchange, &Progress::default())) {
        assert!(changed.iter().all(|g| *g >= 0.0), "{changed:?}");
    }
    Ok(())
}

fn polygons(u: &mut Unstructured) -> Result<()> {
    let Some(accuracy) = accepted(Accuracy::new(tolerance(u)?)) else { return Ok(()) };
    let (a, b) = (points(u, 6)?, points(u, 6)?);
    if defect(&a).is_some() || defect(&b).is_some() {
        return Ok(());
    }
    let (a, b) = (Shape::new(&a), Shape::new(&b));
    let there = exchange(&a, &b, &accuracy);
    let back = exchange(&b, &a, &accuracy);
    assert!(there == back, "{there:e} and {back:e}");
    assert!(there >= 0.0);
    // The kernels' own relative error, and a little for polygons that touch.
    let most = (1.0 + 2.0 * accuracy.tolerance().max(1e-3)) * a.area.min(b.area);
    assert!(there <= most, "{there:e} m^2 between {:e} and {:e}", a.area, b.area);
    Ok(())
}
