//! Rays a second of the kernels, against Embree 4's single-ray calls in the same process; run by `visibility.py`, which makes
//! the scenes (`RADIOSITY_SCENES`, a folder) and finds the library (`RADIOSITY_EMBREE`; empty for none).
//!
//! Times are CPU times of the one thread, medians; Embree and ours alternate within each run.
#![expect(clippy::print_stdout, clippy::expect_used, reason = "a bench prints, and stops at what is wrong")]

mod embree;

use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

use cpu_time::ThreadTime;
use embree::{Embree, RayHit};
use radiosity::geometry::Vec3;
use radiosity::geometry::sampling::{hash, point_in_triangle};
use radiosity::scene::{Description, Scene, Sides};
use radiosity::visibility::{Bvh, Instructions, NO_PATCH, Ray, Segment};
use rayon::prelude::*;

const RUNS: usize = 7;
const RAYS: usize = 200_000;
/// Rays that are given to a kernel at a time.
const BATCH: usize = 1024;
const BUNDLE: usize = 64;
/// Embree starts and ends rays from surfaces this far from them, relative to the scene and to the segment.
const EPSILON: f64 = 1e-4;

/// Hashes of 1, 2, 3, ...
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 += 1;
        (hash(self.0) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn in_box(&mut self, low: Vec3, high: Vec3) -> Vec3 {
        low + Vec3::new(self.uniform(), self.uniform(), self.uniform()) * (high - low)
    }

    fn direction(&mut self) -> Vec3 {
        loop {
            let v = self.in_box(-Vec3::ONE, Vec3::ONE);
            if (1e-3..=1.0).contains(&v.length_squared()) {
                return v.normalize();
            }
        }
    }

    fn on_patch(&mut self, scene: &Scene, patch: u32) -> Vec3 {
        point_in_triangle(&scene.triangle(patch as usize), self.uniform(), self.uniform())
    }

    fn patch(&mut self, scene: &Scene) -> u32 {
        (self.uniform() * scene.len() as f64) as u32
    }
}

fn read(stem: &Path) -> Scene {
    let bytes = |extension: &str| std::fs::read(stem.with_extension(extension)).expect("a scene of visibility.py");
    let (vertices, faces) = (bytes("vertices"), bytes("faces"));
    let numbers: Vec<f64> = vertices.as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect();
    let indices: Vec<i64> = faces.as_chunks().0.iter().map(|b| i64::from(u32::from_le_bytes(*b))).collect();
    let faces = indices.as_chunks().0.to_vec();
    Scene::new(Description {
        vertices: numbers.as_chunks().0.iter().map(|v| Vec3::from_array(*v)).collect(),
        bands: 1,
        reflectance: vec![0.5; faces.len()],
        emission: vec![0.0; faces.len()],
        faces,
        materials: vec![],
        sides: Sides::Front,
    })
    .expect("a sound scene")
}

fn single(v: Vec3) -> [f32; 3] {
    v.as_vec3().to_array()
}

fn their_ray(ray: &Ray, near: f64) -> RayHit {
    RayHit::new(single(ray.origin), single(ray.direction), near as f32, f32::INFINITY)
}

fn their_segment(segment: &Segment, epsilon: f64) -> RayHit {
    RayHit::new(single(segment.start), single(segment.end - segment.start), epsilon as f32, 1.0 - epsilon as f32)
}

/// Times two ways to the same `count` answers in turn; prints their rates and how many answers agree.
fn compare<T: PartialEq + Clone>(
    what: &str,
    none: T,
    count: usize,
    theirs: impl Fn(&mut [T]),
    ours: impl Fn(&mut [T]),
) {
    let (mut a, mut b) = (vec![none.clone(); count], vec![none; count]);
    let mut rates = [const { Vec::new() }; 2];
    for _ in 0..RUNS {
        let start = ThreadTime::now();
        theirs(black_box(&mut a));
        rates[0].push(count as f64 / start.elapsed().as_secs_f64() / 1e6);
        let start = ThreadTime::now();
        ours(black_box(&mut b));
        rates[1].push(count as f64 / start.elapsed().as_secs_f64() / 1e6);
    }
    let [theirs, ours] = rates.map(median);
    let same = a.iter().zip(&b).filter(|(a, b)| a == b).count() as f64 / count as f64;
    println!("| {what} | {theirs:.2} | {ours:.2} | {:.2} | {:.3} % |", ours / theirs, 100.0 * same);
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn closest(bvh: &Bvh, rays: &[Ray], out: &mut [Option<u32>]) {
    for (rays, out) in rays.chunks(BATCH).zip(out.chunks_mut(BATCH)) {
        bvh.closest(rays).into_iter().zip(out).for_each(|(hit, out)| *out = hit.map(|hit| hit.patch));
    }
}

fn blocked(bvh: &Bvh, segments: &[Segment], out: &mut [bool]) {
    for (segments, out) in segments.chunks(BATCH).zip(out.chunks_mut(BATCH)) {
        out.copy_from_slice(&bvh.blocked(segments));
    }
}

/// Random rays and segments in the box around the scene.
fn in_space(scene: &Scene, random: &mut Random) -> (Vec<Ray>, Vec<Segment>) {
    let (low, high) = bounds(scene);
    let rays = (0..RAYS)
        .map(|_| Ray { origin: random.in_box(low, high), direction: random.direction(), exclude: NO_PATCH })
        .collect();
    let segments = (0..RAYS)
        .map(|_| {
            let (start, end) = (random.in_box(low, high), random.in_box(low, high));
            Segment { start, end, exclude: [NO_PATCH; 2] }
        })
        .collect();
    (rays, segments)
}

fn bounds(scene: &Scene) -> (Vec3, Vec3) {
    let start = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    scene.vertices().iter().fold(start, |(low, high), v| (low.min(*v), high.max(*v)))
}

/// Cosine-distributed rays from patches, and segments between patches that face each other, `each` a pair.
fn from_surfaces(scene: &Scene, random: &mut Random, each: usize) -> (Vec<Ray>, Vec<Segment>) {
    let rays = (0..RAYS)
        .map(|_| {
            let patch = random.patch(scene);
            let direction = scene.normals()[patch as usize] + 0.999 * random.direction();
            Ray { origin: random.on_patch(scene, patch), direction, exclude: patch }
        })
        .collect();
    let mut segments = Vec::with_capacity(RAYS);
    while segments.len() < RAYS {
        let [i, j] = [random.patch(scene), random.patch(scene)];
        let way = random.on_patch(scene, j) - random.on_patch(scene, i);
        let faces = |patch: u32, way: Vec3| scene.normals()[patch as usize].dot(way) > 1e-6 * way.length();
        if faces(i, way) && faces(j, -way) {
            segments.extend((0..each).map(|_| Segment {
                start: random.on_patch(scene, i),
                end: random.on_patch(scene, j),
                exclude: [i, j],
            }));
        }
    }
    segments.truncate(RAYS);
    (rays, segments)
}

fn against_embree(bvh: &Bvh, embree: &Embree, scene: &Scene) {
    let random = &mut Random(0);
    let ask_closest = |rays: &[RayHit], out: &mut [Option<u32>]| {
        out.iter_mut().zip(rays).for_each(|(out, ray)| *out = embree.closest(*ray));
    };
    let ask_blocked = |rays: &[RayHit], out: &mut [bool]| {
        out.iter_mut().zip(rays).for_each(|(out, ray)| *out = embree.blocked(*ray));
    };
    let (low, high) = bounds(scene);
    let near = EPSILON * (high - low).max_element();
    for (place, (rays, segments), epsilon) in
        [("in space", in_space(scene, random), 0.0), ("from surfaces", from_surfaces(scene, random, 1), 1.0)]
    {
        let theirs: Vec<RayHit> = rays.iter().map(|ray| their_ray(ray, epsilon * near)).collect();
        let what = format!("closest hit, {place}");
        compare(&what, None, RAYS, |out| ask_closest(&theirs, out), |out| closest(bvh, &rays, out));
        let theirs: Vec<RayHit> = segments.iter().map(|segment| their_segment(segment, epsilon * EPSILON)).collect();
        let what = format!("any hit, {place}");
        compare(&what, false, RAYS, |out| ask_blocked(&theirs, out), |out| blocked(bvh, &segments, out));
    }
    let (_, segments) = from_surfaces(scene, random, BUNDLE);
    let theirs: Vec<RayHit> = segments.iter().map(|segment| their_segment(segment, EPSILON)).collect();
    let bundles = |out: &mut [bool]| {
        for (segments, out) in segments.chunks(BUNDLE).zip(out.chunks_mut(BUNDLE)) {
            out.copy_from_slice(&bvh.blocked_between(segments));
        }
    };
    compare("bundles of 64", false, RAYS, |out| ask_blocked(&theirs, out), bundles);
}

/// Million closest hits a second by wall clock on `threads` threads.
fn rate_on(threads: usize, bvh: &Bvh, rays: &[Ray]) -> f64 {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
    let rates = (0..RUNS).map(|_| {
        let start = Instant::now();
        pool.install(|| rays.par_chunks(BATCH).for_each(|rays| drop(black_box(bvh.closest(rays)))));
        rays.len() as f64 / start.elapsed().as_secs_f64() / 1e6
    });
    median(rates.collect())
}

fn main() {
    let folder = std::env::var("RADIOSITY_SCENES").expect("run benches/visibility.py");
    let library = std::env::var("RADIOSITY_EMBREE").unwrap_or_default();
    let mut stems: Vec<_> = std::fs::read_dir(folder)
        .expect("the folder of scenes")
        .filter_map(|entry| Some(entry.ok()?.path()).filter(|path| path.extension().is_some_and(|e| e == "faces")))
        .collect();
    stems.sort();
    println!(
        "Million rays/s on one thread. In space: uniform rays; from surfaces: cosine rays and segments between patches"
    );
    println!(
        "that face each other, Embree's kept {EPSILON:e} off the surfaces. Embree: rtcIntersect1, rtcOccluded1.\n"
    );
    let mut summary = Vec::new();
    for stem in &stems {
        let scene = read(stem);
        let name = stem.file_stem().map(|name| name.to_string_lossy()[2..].to_string()).unwrap_or_default();
        let start = Instant::now();
        let bvh = Bvh::of_scene(&scene);
        let build = start.elapsed().as_secs_f64();
        if !library.is_empty() {
            let vertices: Vec<[f32; 3]> = scene.vertices().iter().map(|&v| single(v)).collect();
            let embree = Embree::new(&library, &vertices, scene.faces()).expect("Embree 4");
            println!(
                "| {name}, {} triangles | Embree | ours | ratio | same answer |\n|---|---|---|---|---|",
                scene.len()
            );
            against_embree(&bvh, &embree, &scene);
            println!();
        }
        let (rays, _) = in_space(&scene, &mut Random(7));
        let (one, two) = (rate_on(1, &bvh, &rays), rate_on(2, &bvh, &rays));
        let bytes = bvh.nbytes() as f64 / 1e6;
        let mut row = format!("| {name} | {:.0} ms | {bytes:.1} MB | {:.2} |", 1e3 * build, two / one);
        let mut bvh = bvh;
        for instructions in Instructions::available() {
            bvh = bvh.with_instructions(instructions);
            row += &format!(" {instructions:?} {:.2} |", rate_on(1, &bvh, &rays));
        }
        summary.push(row);
    }
    println!("| scene | build, all cores | memory | two threads to one | closest hit in space by instructions | | |");
    println!("|---|---|---|---|---|---|---|");
    summary.iter().for_each(|row| println!("{row}"));
}
