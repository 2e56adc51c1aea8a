//! Rays against brute force in f64, watertightness where it is hardest, and the proof of empty shafts against segments.

use std::sync::atomic::{AtomicUsize, Ordering};

use radiosity::form_factor::area_quadrature::kernel;
use radiosity::geometry::sampling::point_in_triangle;
use radiosity::geometry::{Triangle, Vec3};
use radiosity::scene::{Scene, Sides};
use radiosity::visibility::bodies::Bodies;
use radiosity::visibility::shaft::Shaft;
use radiosity::visibility::sight::{Sights, View};
use radiosity::visibility::{Bvh, Hit, Instructions, NO_PATCH, Ray, Segment};
use radiosity::{Error, Progress};

use crate::common::{
    Mesh, PLENTY, Random, box_from, box_in_box, cube, icosphere, on_threads, plate, rotated, two_plates, vec3,
};

const NOBODY: [u32; 2] = [NO_PATCH; 2];

fn closest(bvh: &Bvh, origin: Vec3, direction: Vec3) -> Option<Hit> {
    bvh.closest(&[Ray { origin, direction, exclude: NO_PATCH }])[0]
}

fn blocked(bvh: &Bvh, start: Vec3, end: Vec3, exclude: [u32; 2]) -> bool {
    bvh.blocked(&[Segment { start, end, exclude }])[0]
}

/// Moeller & Trumbore 1997: t, and the least barycentric coordinate (negative outside). Another formula than the one
/// under test, in world coordinates, without tree.
fn moeller_trumbore(origin: Vec3, direction: Vec3, [a, b, c]: &Triangle) -> (f64, f64) {
    let (e1, e2, s) = (*b - *a, *c - *a, origin - *a);
    let (h, q) = (direction.cross(e2), s.cross(e1));
    let inverse = 1.0 / e1.dot(h);
    let (u, v) = (inverse * s.dot(h), inverse * direction.dot(q));
    (inverse * e2.dot(q), u.min(v).min(1.0 - u - v))
}

/// Closer to an edge, or to another hit, than this the two formulas may differ by rounding: 1e-16 times a condition number.
const CLEAR: f64 = 1e-9;

/// The first hit by testing every triangle: (t, patch); `Err` when it is too close to call.
fn brute_closest(scene: &Scene, origin: Vec3, direction: Vec3) -> Result<Option<(f64, usize)>, ()> {
    let mut best: Option<(f64, usize)> = None;
    for i in 0..scene.len() {
        let (t, inside) = moeller_trumbore(origin, direction, &scene.triangle(i));
        if !t.is_finite() || inside.abs() < CLEAR || t.abs() < CLEAR || best.is_some_and(|(s, _)| (s - t).abs() < CLEAR)
        {
            return Err(());
        }
        if inside > 0.0 && t > 0.0 && best.is_none_or(|(s, _)| t < s) {
            best = Some((t, i));
        }
    }
    Ok(best)
}

/// `count` random triangles of the size given with centres in the cube [-1, 1]^3.
fn soup(random: &Random, count: usize, size: f64) -> Vec<Triangle> {
    (0..count).map(|_| random.triangle(random.in_cube(), size)).collect()
}

#[test]
fn closest_agrees_with_brute_force() {
    let random = Random::new(11);
    for (count, size) in [(1, 1.0), (9, 0.8), (100, 0.4), (1000, 0.1)] {
        let scene = Mesh::of_triangles(&soup(&random, count, size)).scene();
        let bvh = Bvh::of_scene(&scene);
        assert_eq!((bvh.len(), bvh.is_empty()), (count, false));
        let (mut hits, mut misses) = (0, 0);
        for k in 0..2000 {
            // From inside and from outside, directions of any length.
            let origin = if k % 2 == 0 { random.in_cube() } else { 5.0 * random.direction() };
            let direction = random.between(0.1, 10.0) * (random.in_cube() - origin);
            let Ok(expected) = brute_closest(&scene, origin, direction) else { continue };
            let found = closest(&bvh, origin, direction);
            assert_eq!(found.map(|h| h.patch as usize), expected.map(|(_, i)| i), "{count} triangles, ray {k}");
            let (Some(hit), Some((t, i))) = (found, expected) else {
                misses += 1;
                continue;
            };
            hits += 1;
            // Both are exact up to rounding times the slope of the triangle against the ray.
            let slope = scene.normals()[i].dot(direction.normalize()).abs();
            assert!((hit.t - t).abs() * direction.length() < 1e-13 / slope, "ray {k}: t {} and {t}", hit.t);
            let [a, b, c] = scene.triangle(i);
            let [v, w] = hit.barycentric;
            let on_triangle = (1.0 - v - w) * a + v * b + w * c;
            assert!(on_triangle.distance(origin + hit.t * direction) < 1e-13 / slope, "ray {k}: barycentric");
        }
        assert!(hits + misses > 1900, "{count} triangles: {hits} hits and {misses} misses compared");
        assert!(hits > 20 && (misses > 20 || count > 500), "{count} triangles: {hits} hits, {misses} misses");
    }
}

#[test]
fn blocked_agrees_with_brute_force() {
    let random = Random::new(12);
    for (count, size) in [(1, 1.0), (30, 0.5), (300, 0.2)] {
        let scene = Mesh::of_triangles(&soup(&random, count, size)).scene();
        let bvh = Bvh::of_scene(&scene);
        let (mut hidden, mut free) = (0, 0);
        'rays: for k in 0..3000 {
            let (p, q) = (random.in_cube(), random.in_cube());
            let exclude = [random.below(count) as u32, NO_PATCH];
            let mut expected = false;
            for i in (0..count).filter(|&i| i as u32 != exclude[0]) {
                let (t, inside) = moeller_trumbore(p, q - p, &scene.triangle(i));
                let unclear = inside.abs() < CLEAR || t.abs() < 10.0 * CLEAR || (t - 1.0).abs() < 10.0 * CLEAR;
                if unclear || !t.is_finite() {
                    continue 'rays;
                }
                expected |= inside > 0.0 && t > 0.0 && t < 1.0;
            }
            assert_eq!(blocked(&bvh, p, q, exclude), expected, "{count} triangles, segment {k}");
            assert_eq!(blocked(&bvh, q, p, exclude), expected, "{count} triangles, segment {k} turned round");
            if expected { hidden += 1 } else { free += 1 }
        }
        assert!(hidden + free > 2900);
        assert!(free > 100 && (hidden > 100 || count == 1), "{count} triangles: {hidden} blocked, {free} free");
    }
}

#[test]
fn a_plate_blocks_what_passes_through_it_and_nothing_else() {
    let scene = plate(vec3(-1.0, -1.0, 0.0), 2.0 * Vec3::X, 2.0 * Vec3::Y, 1).scene();
    let bvh = Bvh::of_scene(&scene);
    let segment = |x: f64, from: f64, to: f64, exclude| blocked(&bvh, vec3(x, 0.3, from), vec3(x, 0.3, to), exclude);
    for (from, to) in [(1.0, -1.0), (-1.0, 1.0)] {
        assert!(segment(0.0, from, to, NOBODY), "through, from both sides");
        assert!(segment(0.999_999, from, to, NOBODY), "just inside the border");
        assert!(!segment(1.000_001, from, to, NOBODY), "just beside");
    }
    assert!(!segment(0.0, 1.0, 0.5, NOBODY), "before it");
    assert!(!segment(0.0, 1.0, 1e-6, NOBODY), "ends just before it");
    assert!(segment(0.0, 1.0, -1e-6, NOBODY), "ends just behind it");
    // The segment is open: its ends may lie on a patch, whether that is excluded or not.
    assert!(!segment(0.0, 1.0, 0.0, NOBODY));
    assert!(!segment(0.0, 0.0, 1.0, NOBODY));
    assert!(!blocked(&bvh, vec3(-0.5, 0.0, 0.0), vec3(0.5, 0.2, 0.0), NOBODY), "within the plate: seen edge-on");
    // Patch 0 lies below the diagonal y = x, patch 1 above.
    let [below, above] = [vec3(0.5, -0.5, 1.0), vec3(-0.5, 0.5, 1.0)];
    for (p, patch) in [(below, 0), (above, 1)] {
        assert!(blocked(&bvh, p, p - 2.0 * Vec3::Z, [1 - patch, NO_PATCH]));
        assert!(!blocked(&bvh, p, p - 2.0 * Vec3::Z, [patch, NO_PATCH]), "the excluded patch does not block");
        assert!(!blocked(&bvh, p, p - 2.0 * Vec3::Z, [NO_PATCH, patch]), "in either place");
    }
    assert!(!blocked(&bvh, below, below, NOBODY), "a segment without length has no inside");
}

/// Rays from inside a sphere of 1280 triangles to each of its corners and the middle of each of its edges, where a ray has
/// its chance to slip through; `offset` in units of the radius. Asserts that every ray hits, and at the target.
fn assert_watertight(scale: f64, offset: f64) {
    let shift = offset * vec3(1.0, -0.7, 0.4);
    let place = |v: Vec3| scale * (v + shift);
    let mesh = icosphere(3).reversed().map(place);
    let scene = mesh.scene();
    let bvh = Bvh::of_scene(&scene);
    let mut targets = mesh.vertices.clone();
    for [a, b, c] in mesh.indices() {
        for (p, q) in [(a, b), (b, c), (c, a)].into_iter().filter(|(p, q)| p < q) {
            targets.push(0.5 * (mesh.vertices[p as usize] + mesh.vertices[q as usize]));
        }
    }
    assert_eq!(targets.len(), 642 + 1920);
    // The target itself is rounded to eps/2 x offset in each coordinate; the way to it is between 0.5 and 1.5 radii long
    // and meets the surface at less than 45 degrees. Around the origin only the arithmetic of the test rounds.
    let tolerance = 8.0 * f64::EPSILON * (8.0 + offset);
    let random = Random::new(13);
    let mut rays = 0;
    for _ in 0..40 {
        let origin = place(0.25 * random.in_cube());
        for &target in &targets {
            let direction = target - origin;
            let hit = closest(&bvh, origin, direction);
            let hit = hit.unwrap_or_else(|| panic!("scale {scale}: a ray from {origin} along {direction} has escaped"));
            assert!((hit.t - 1.0).abs() < tolerance, "scale {scale}, offset {offset}: t = {}", hit.t);
            rays += 1;
        }
    }
    assert_eq!(rays, 102_480);
}

#[test]
fn closed_meshes_are_watertight_at_their_corners_and_edges() {
    assert_watertight(1.0, 0.0);
}

#[test]
fn closed_meshes_are_watertight_at_any_scale() {
    assert_watertight(1e-6, 0.0);
    assert_watertight(1e6, 0.0);
}

#[test]
fn closed_meshes_are_watertight_far_from_the_origin() {
    // A millionth of a radius is 4e9 ulp there: the mesh is a slightly different one, but as closed as ever.
    assert_watertight(1.0, 1e6);
    assert_watertight(1e-3, 1e6);
}

#[test]
fn a_scene_that_is_moved_without_rounding_is_hit_where_it_was() {
    // Coordinates in multiples of 2^-20 and a shift by 2^30: every difference is exact, so no digit may be lost.
    let grid = |v: Vec3| (v * 1_048_576.0).round() / 1_048_576.0;
    let shift = 1_073_741_824.0 * vec3(1.0, -1.0, 0.5);
    let here = icosphere(2).map(|v| grid(1.3 * v));
    let there = here.clone().map(|v| v + shift);
    assert!(here.vertices.iter().zip(&there.vertices).all(|(v, w)| *w - shift == *v));
    let (here, there) = (here.scene(), there.scene());
    let (bvh_here, bvh_there) = (Bvh::of_scene(&here), Bvh::of_scene(&there));
    let random = Random::new(24);
    for _ in 0..5000 {
        let origin = grid(3.0 * random.in_cube());
        let direction = grid(random.in_cube() - origin);
        let (a, b) = (closest(&bvh_here, origin, direction), closest(&bvh_there, origin + shift, direction));
        assert_eq!(a.map(|h| h.patch), b.map(|h| h.patch));
        if let (Some(a), Some(b)) = (a, b) {
            // The boxes' centres differ by less than an ulp of the shift, 2^-22: other roundings of numbers of size 1, on a
            // surface that is met at a grazing angle now and then.
            assert!((a.t - b.t).abs() < 1e-11, "{} and {}", a.t, b.t);
        }
        let end = origin + direction;
        assert_eq!(blocked(&bvh_here, origin, end, NOBODY), blocked(&bvh_there, origin + shift, end + shift, NOBODY));
    }
}

#[test]
fn rays_along_the_axes_through_grid_corners_hit() {
    // Directions with zeros, along edges of the mesh, to corners of the grid: every degenerate case of a slab test at once.
    let scene = cube(4).scene();
    let bvh = Bvh::of_scene(&scene);
    let mut rays = 0;
    for k in 0..27 {
        let origin = 0.25 * vec3(f64::from(1 + k % 3), f64::from(1 + k / 3 % 3), f64::from(1 + k / 9));
        for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
            for direction in [axis, -axis] {
                let hit = closest(&bvh, origin, direction).expect("the cube is closed");
                let along = origin.dot(axis);
                // Quarters are exact.
                assert_eq!(hit.t, if direction == axis { 1.0 - along } else { along });
                assert_eq!(scene.normals()[hit.patch as usize], -direction);
                rays += 1;
            }
        }
    }
    assert_eq!(rays, 162);
}

#[test]
fn a_distant_origin_loses_no_hit() {
    let mesh = icosphere(3);
    let scene = mesh.scene();
    let bvh = Bvh::of_scene(&scene);
    let random = Random::new(14);
    let mut rays = 0;
    for distance in [3.0, 1e2, 1e4, 1e6, 1e9] {
        for _ in 0..100 {
            let origin = distance * random.direction();
            // Corners that face the origin, away from the outline.
            for &target in mesh.vertices.iter().filter(|v| v.dot(origin) > 0.5 * distance) {
                let hit = closest(&bvh, origin, target - origin).expect("a corner seen from outside");
                // The ray passes the target within eps x distance, on a surface at less than 60 degrees.
                assert!((hit.t - 1.0).abs() * distance < 16.0 * f64::EPSILON * (8.0 + distance), "{}", hit.t);
                rays += 1;
            }
        }
    }
    assert!(rays > 50_000, "{rays}");
}

#[test]
fn boxes_in_f32_lose_no_triangle_at_its_very_border() {
    // Rays that pass a lone triangle's border within 1e-8 of its size, on the inside: an f32 box of exactly its size, or
    // a slab test that rounds inwards, would miss one in two of them.
    let random = Random::new(15);
    let mut rays = 0;
    for case in 0..400 {
        // Every other one parallel to the axes, with a box that is flat.
        let triangle = if case % 2 == 0 {
            random.triangle(random.in_cube(), 1.0)
        } else {
            let turn = |v: Vec3| if case % 4 == 1 { vec3(v.z, v.x, v.y) } else { v };
            let corner = random.in_cube();
            [Vec3::ZERO, Vec3::X, Vec3::Y].map(|v| turn(corner + v))
        };
        let far = random.triangle(3.0 * random_corner(case), 0.3);
        let scene = Mesh::of_triangles(&[triangle, far]).scene();
        let bvh = Bvh::of_scene(&scene);
        for k in 0..50 {
            let (edge, s) = (k % 3, random.uniform());
            let mut b = [0.0; 3];
            let inside = 10f64.powf(random.between(-8.0, -7.0));
            (b[edge], b[(edge + 1) % 3], b[(edge + 2) % 3]) = (inside, (1.0 - inside) * s, (1.0 - inside) * (1.0 - s));
            let target = b[0] * triangle[0] + b[1] * triangle[1] + b[2] * triangle[2];
            let origin = target + 10f64.powf(random.between(-1.0, 2.0)) * random.direction();
            let direction = target - origin;
            if !matches!(brute_closest(&scene, origin, direction), Ok(Some((_, 0)))) {
                continue;
            }
            let hit = closest(&bvh, origin, direction);
            assert_eq!(hit.map(|h| h.patch), Some(0), "case {case}: {triangle:?} from {origin} along {direction}");
            // Both ends within the size of the scene.
            let (p, q) = (target - direction.normalize(), target + direction.normalize());
            assert!(blocked(&bvh, p, q, [1, NO_PATCH]), "case {case}: {triangle:?} from {p} to {q}");
            rays += 1;
        }
    }
    assert!(rays > 15_000, "{rays}");
}

#[test]
fn a_distant_end_is_blocked_all_the_same() {
    let scene = icosphere(3).scene();
    let bvh = Bvh::of_scene(&scene);
    let random = Random::new(23);
    for distance in [3.0, 1e2, 1e4, 1e6, 1e9] {
        for k in 0..500 {
            let (p, q) = (distance * random.direction(), 0.5 * random.in_cube());
            assert!(blocked(&bvh, p, q, NOBODY) && blocked(&bvh, q, p, NOBODY), "segment {k} at distance {distance}");
        }
    }
}

fn random_corner(case: usize) -> Vec3 {
    let sign = |bit: usize| if case >> bit & 1 == 0 { 1.0 } else { -1.0 };
    vec3(sign(0), sign(1), sign(2))
}

#[test]
fn convex_scenes_have_no_blockers() {
    let random = Random::new(16);
    let convex = [cube(3), icosphere(2).reversed(), two_plates(3)];
    for (k, mesh) in convex.iter().enumerate() {
        assert!(Bvh::of_blockers(&mesh.scene()).is_empty(), "mesh {k}");
        // Rotated, scaled and moved, its planes are planes up to rounding only.
        for size in [1e-6, 1.0, 1e6] {
            let (rotation, shift) = (random.rotation(), 1000.0 * random.in_cube());
            let moved = mesh.clone().map(|v| size * (rotated(&rotation, v) + shift));
            let blockers = Bvh::of_blockers(&moved.scene());
            assert!(blockers.is_empty(), "mesh {k} at size {size}: {} blockers", blockers.len());
        }
    }
    // The walls of a room block nothing, the box inside does: its 12 triangles.
    let blockers = Bvh::of_blockers(&box_in_box(3).scene());
    assert_eq!(blockers.len(), 12);
    assert!(!blockers.is_empty());
}

/// A random segment between two patches along which light can pass, if there is any among the first 20.
fn lit_segment(random: &Random, scene: &Scene, i: usize, j: usize) -> Option<(Vec3, Vec3)> {
    (0..20).find_map(|_| {
        let [u, v, s, t] = [0; 4].map(|_| random.uniform());
        let p = point_in_triangle(&scene.triangle(i), u, v);
        let q = point_in_triangle(&scene.triangle(j), s, t);
        (kernel(p, scene.normals()[i], q, scene.normals()[j]) > 0.0).then_some((p, q))
    })
}

#[test]
fn blockers_alone_block_as_much_as_the_whole_scene() {
    let scene = box_in_box(2).scene();
    let (all, blockers) = (Bvh::of_scene(&scene), Bvh::of_blockers(&scene));
    let random = Random::new(17);
    let (mut hidden, mut free) = (0, 0);
    for _ in 0..20_000 {
        let (i, j) = (random.below(scene.len()), random.below(scene.len()));
        let Some((p, q)) = lit_segment(&random, &scene, i, j) else { continue };
        let exclude = [i as u32, j as u32];
        let expected = blocked(&all, p, q, exclude);
        assert_eq!(blocked(&blockers, p, q, exclude), expected, "patches {i} and {j}, from {p} to {q}");
        if expected { hidden += 1 } else { free += 1 }
    }
    assert!(hidden > 1000 && free > 1000, "{hidden} blocked, {free} free");
}

/// Over every pair of `scene`: how many shafts are declared empty, how many are not although no segment is blocked, and how
/// many are truly blocked. Fails when a shaft that was declared empty blocks a segment.
fn shafts(scene: &Scene, random: &Random, segments: usize) -> [usize; 3] {
    let bodies = Bodies::of_scene(scene);
    let all = Bvh::of_scene(scene);
    let [mut empty, mut unproven, mut occluded] = [0; 3];
    for i in 0..scene.len() {
        for j in 0..i {
            let exclude = [i as u32, j as u32];
            let shaft = Shaft::new(&scene.triangle(i), &scene.triangle(j));
            let says_empty = bodies.in_shaft(&shaft, [i as u32, j as u32], 0).is_some();
            let mut is_blocked = false;
            let mut cast = 0;
            for _ in 0..segments {
                let Some((p, q)) = lit_segment(random, scene, i, j) else { break };
                is_blocked |= blocked(&all, p, q, exclude);
                cast += 1;
            }
            if cast == 0 {
                continue;
            }
            assert!(!(says_empty && is_blocked), "the shaft of {i} and {j} is not empty");
            match (says_empty, is_blocked) {
                (true, _) => empty += 1,
                (false, true) => occluded += 1,
                (false, false) => unproven += 1,
            }
        }
    }
    [empty, unproven, occluded]
}

#[test]
fn empty_shafts_are_empty() {
    let random = Random::new(18);
    let mut total = [0; 3];
    // Of one size, and of sizes from 0.05 to 1, where the larger of a pair decides how wide the shaft is.
    for (count, small, large) in [(12, 0.5, 0.5), (40, 0.15, 0.15), (40, 0.4, 0.4), (40, 0.05, 1.0)] {
        for _ in 0..5 {
            let triangles: Vec<Triangle> = (0..count)
                .map(|_| random.triangle(random.in_cube(), small * f64::powf(large / small, random.uniform())))
                .collect();
            let scene = Mesh::of_triangles(&triangles).scene();
            let found = shafts(&scene, &random, 60);
            (0..3).for_each(|k| total[k] += found[k]);
        }
    }
    let [empty, unproven, occluded] = total;
    // Each of the three happens often: the test sees true proofs, lets failing ones pass, and would notice wrong ones.
    assert!(empty > 300 && occluded > 300, "{empty} empty, {unproven} unproven, {occluded} occluded");
    // A proof that never succeeds would be conservative too. Of the pairs that see each other it finds a good share.
    assert!(empty > unproven / 4, "{empty} empty, {unproven} unproven");
}

#[test]
fn shafts_between_walls_with_a_box_in_the_room() {
    let random = Random::new(19);
    let [empty, unproven, occluded] = shafts(&box_in_box(3).scene(), &random, 40);
    assert!(empty > 1000 && occluded > 1000, "{empty} empty, {unproven} unproven, {occluded} occluded");
}

/// What `Sights` says of the pairs of a scene that light could pass between: how many it leaves out, how many have nothing between,
/// and how many bodies it names in all. Fails when one that is left out sees, or one with nothing between is blocked.
fn sights(scene: &Scene, random: &Random) -> [usize; 3] {
    let bodies = Bodies::of_scene(scene);
    let (all, n) = (Bvh::of_scene(scene), scene.len());
    let collect = |i: u32, view: &View| {
        Ok(view.patches.iter().map(|&(j, list)| (i, j, view.bodies[list as usize].len())).collect::<Vec<_>>())
    };
    let sights = Sights::new(scene, &bodies);
    let mut seen: Vec<Option<usize>> = vec![None; n * n];
    // In two parts, as rows are made in blocks.
    for rows in [0..n as u32 / 3, n as u32 / 3..n as u32] {
        for (i, j, between) in
            sights.visit(&rows, scene, &bodies, &Progress::default(), &collect).unwrap().into_iter().flatten()
        {
            assert!(rows.contains(&i) && j < i);
            assert_eq!(seen[i as usize * n + j as usize].replace(between), None, "{i} and {j} come twice");
        }
    }
    let [mut left_out, mut clear, mut named] = [0; 3];
    for i in 0..n {
        for j in 0..i {
            let segments = (0..5).filter_map(|_| lit_segment(random, scene, i, j));
            let blocked: Vec<bool> = segments.map(|(p, q)| blocked(&all, p, q, [i as u32, j as u32])).collect();
            match seen[i * n + j] {
                None => {
                    assert!(blocked.iter().all(|b| *b), "{i} and {j} see each other");
                    left_out += usize::from(!blocked.is_empty());
                }
                Some(0) => {
                    assert!(!blocked.contains(&true), "something stands between {i} and {j}");
                    clear += 1;
                }
                Some(between) => named += between,
            }
        }
    }
    [left_out, clear, named]
}

#[test]
fn clusters_that_are_left_out_see_nothing_and_what_is_not_named_blocks_nothing() {
    let random = Random::new(21);
    let blocks = (0..6).fold(box_from(Vec3::splat(-3.0), Vec3::splat(3.0), 6), |mesh, _| {
        let (turn, shift) = (random.rotation(), random.in_cube());
        mesh.and(&box_from(Vec3::splat(-0.9), Vec3::splat(0.9), 2).reversed().map(|v| rotated(&turn, v) + shift))
    });
    let heap: Vec<Triangle> = (0..200).map(|_| random.triangle(random.in_cube(), 0.3)).collect();
    // Blocks in one row along an axis: shafts along it have a width of 0.
    let town = (0..16).fold(plate(Vec3::ZERO, 8.0 * Vec3::X, 8.0 * Vec3::Y, 8), |mesh, k| {
        let low = vec3(f64::from(k % 4) * 2.0 + 0.25, f64::from(k / 4) * 2.0 + 0.25, 0.0);
        mesh.and(&box_from(low, low + vec3(1.5, 1.5, 1.5 + 0.1 * f64::from(k % 3)), 2).reversed())
    });
    for (name, mesh) in [("blocks", blocks), ("heap", Mesh::of_triangles(&heap)), ("town", town)] {
        for place in [Vec3::ZERO, Vec3::splat(1e6)] {
            let [left_out, clear, named] = sights(&mesh.clone().map(|v| v + place).scene(), &random);
            // Each happens often, but in a heap no triangle hides a cluster, and all of them are between some others.
            let (often, in_a_heap) = (named > 500, name == "heap");
            assert!(often && (in_a_heap || (left_out > 500 && clear > 500)), "{name}: {left_out} {clear} {named}");
        }
    }
}

#[test]
fn a_wish_to_stop_ends_the_walk() {
    let random = Random::new(23);
    let heap: Vec<Triangle> = (0..400).map(|_| random.triangle(random.in_cube(), 0.3)).collect();
    let scene = Mesh::of_triangles(&heap).scene();
    let bodies = Bodies::of_scene(&scene);
    let (progress, calls) = (Progress::default(), AtomicUsize::new(0));
    let stop = |_: u32, _: &View| {
        calls.fetch_add(1, Ordering::Relaxed);
        progress.stop();
        Ok(())
    };
    let visit = || Sights::new(&scene, &bodies).visit(&(0..400), &scene, &bodies, &progress, &stop);
    assert!(matches!(on_threads(2, visit), Err(Error::Interrupted)));
    // One a thread, at most: each looks at the wish before it goes on.
    let first = calls.load(Ordering::Relaxed);
    assert!((1..=2).contains(&first), "{first} calls");
    assert!(matches!(visit(), Err(Error::Interrupted)));
    assert_eq!(calls.load(Ordering::Relaxed), first);
}

/// All see all, and every triangle is a body of its own.
#[test]
fn nothing_stands_between_the_patches_of_a_bowl() {
    let mut bowl = icosphere(3).reversed();
    let vertices = bowl.vertices.clone();
    bowl.faces.retain(|face| face.iter().map(|&v| vertices[v as usize].z).sum::<f64>() < 0.0);
    let n = bowl.faces.len();
    let [left_out, clear, named] = sights(&bowl.scene(), &Random::new(22));
    assert_eq!([left_out, clear, named], [0, n * (n - 1) / 2, 0]);
}

#[test]
fn empty_shafts_are_empty_in_a_scene_with_one_far_corner() {
    let random = Random::new(20);
    // A corner that no patch uses, 10^10 m away.
    let mut mesh = box_in_box(1);
    mesh.vertices.push(vec3(1e10, 0.0, 0.0));
    let [_, _, occluded] = shafts(&mesh.scene(), &random, 40);
    assert!(occluded > 10);
}

#[test]
fn of_two_equal_triangles_the_one_that_faces_the_ray_is_hit() {
    let mesh = plate(Vec3::ZERO, Vec3::X, Vec3::Y, 3).and(&plate(Vec3::Z, Vec3::X, Vec3::Y, 2));
    let n = mesh.faces.len() as u32;
    let scene = mesh.scene_with(1, Sides::Both, |_, _| 0.5, |_, _| 0.0);
    let bvh = Bvh::of_scene(&scene);
    let random = Random::new(21);
    for k in 0..1000 {
        let target = vec3(random.uniform(), random.uniform(), f64::from(k % 2));
        // From above or from below, between the plates or outside.
        let side = if k % 4 < 2 { 1.0 } else { -1.0 };
        let origin = target + side * random.between(0.1, 0.9) * vec3(random.between(-0.3, 0.3), 0.2, 1.0);
        let hit = closest(&bvh, origin, target - origin).expect("the plate");
        assert_eq!(hit.patch < n, side > 0.0, "fronts look up: patch {} from side {side}", hit.patch);
        assert!(scene.normals()[hit.patch as usize].dot(target - origin) < 0.0);
        // Barycentric coordinates belong to the patch that is named.
        let [a, b, c] = scene.triangle(hit.patch as usize);
        let [v, w] = hit.barycentric;
        // A few operations on coordinates of size 1.
        assert!(((1.0 - v - w) * a + v * b + w * c).distance(target) < 1e-14);
        assert!((hit.t - 1.0).abs() < 1e-14);
    }
}

#[test]
fn of_sheets_on_each_other_the_one_that_faces_the_ray_is_hit_however_they_are_cut() {
    // Two squares back to back that share a diagonal or not, turned so that rounding puts either before the other.
    let random = Random::new(22);
    for case in 0..20 {
        let (x, y) = (random.direction(), random.direction());
        let corners = [Vec3::ZERO, x, x + y, y];
        for second in [[[0, 2, 1], [0, 3, 2]], [[0, 3, 1], [1, 3, 2]]] {
            let faces = [[0, 1, 2], [0, 2, 3], second[0], second[1]];
            let scene = Mesh { vertices: corners.to_vec(), faces: faces.to_vec() }.scene();
            let bvh = Bvh::of_scene(&scene);
            for _ in 0..100 {
                let target = random.between(0.01, 0.99) * x + random.between(0.01, 0.99) * y;
                let direction = random.direction();
                let hit = closest(&bvh, target - direction, direction).expect("the sheet");
                let cosine = scene.normals()[hit.patch as usize].dot(direction);
                assert!(cosine < 0.0, "case {case}: patch {} at a cosine of {cosine}", hit.patch);
            }
        }
    }
}

#[test]
fn of_exact_duplicates_the_first_is_hit() {
    let sheet = plate(Vec3::ZERO, Vec3::X, Vec3::Y, 1);
    let scene = sheet.clone().and(&sheet).and(&plate(Vec3::Z, Vec3::X, Vec3::Y, 1)).scene();
    let bvh = Bvh::of_scene(&scene);
    for (x, y) in [(0.7, 0.2), (0.3, 0.6)] {
        for direction in [Vec3::Z, -Vec3::Z] {
            let hit = closest(&bvh, vec3(x, y, 0.0) - 0.5 * direction, direction).expect("the sheet");
            assert_eq!(hit.patch, if x > y { 0 } else { 1 }, "from {direction}");
        }
    }
}

#[test]
fn directions_of_any_length_hit_the_same() {
    let scene = icosphere(1).scene();
    let bvh = Bvh::of_scene(&scene);
    let random = Random::new(25);
    for _ in 0..200 {
        let (origin, direction) = (0.5 * random.in_cube(), random.direction());
        let hit = closest(&bvh, origin, direction).expect("the sphere is closed");
        for exponent in [-1000, -500, -3, 5, 500, 1000] {
            // Powers of two, whose squares leave the range of numbers: the same ray, digit by digit.
            let scaled = closest(&bvh, origin, 2f64.powi(exponent) * direction).expect("the same ray");
            assert_eq!((scaled.patch, scaled.barycentric), (hit.patch, hit.barycentric), "2^{exponent}");
            assert_eq!(scaled.t, hit.t * 2f64.powi(-exponent), "2^{exponent}");
        }
    }
}

#[test]
fn a_segment_is_not_blocked_by_the_surface_that_it_starts_on() {
    // Points on the edges within a plane mesh that is turned, and up to a million sizes away from the origin: rounding puts
    // them before or behind their plane. Segments leave at down to half a degree, none of the patches excluded.
    let random = Random::new(26);
    let mut segments = 0;
    for offset in [0.0, 1.0, 1e3, 1e6] {
        for _ in 0..20 {
            let (rotation, shift) = (random.rotation(), offset * random.in_cube());
            let mesh = plate(Vec3::ZERO, Vec3::X, Vec3::Y, 4).map(|v| rotated(&rotation, v) + shift);
            let bvh = Bvh::of_scene(&mesh.scene());
            for [a, b, c] in mesh.indices() {
                for (a, b) in [(a, b), (b, c), (c, a)] {
                    let p = mesh.vertices[a as usize].lerp(mesh.vertices[b as usize], random.uniform());
                    let slope = 10f64.powf(random.between(-2.0, 0.0));
                    let along = vec3(random.between(-1.0, 1.0), random.between(-1.0, 1.0), 0.0).normalize();
                    let q = p + rotated(&rotation, along + slope * Vec3::Z);
                    assert!(!blocked(&bvh, p, q, NOBODY), "offset {offset}, slope {slope}: the start");
                    assert!(!blocked(&bvh, q, p, NOBODY), "offset {offset}, slope {slope}: the end");
                    segments += 1;
                }
            }
        }
    }
    assert_eq!(segments, 4 * 20 * 96);
}

#[test]
fn twins_are_found_after_subdivision() {
    let scene = plate(Vec3::ZERO, Vec3::X, Vec3::Y, 1).scene_with(1, Sides::Both, |_, _| 0.5, |_, _| 0.0);
    let (fine, _) = scene.subdivide(0.8, PLENTY, &Progress::default()).unwrap();
    let bvh = Bvh::of_scene(&fine);
    let random = Random::new(22);
    for k in 0..200 {
        let target = vec3(random.uniform(), random.uniform(), 0.0);
        let direction = if k % 2 == 0 { Vec3::Z } else { -Vec3::Z };
        let hit = closest(&bvh, target - direction, direction).expect("the plate");
        assert!(fine.normals()[hit.patch as usize].dot(direction) < 0.0, "patch {} shows its back", hit.patch);
    }
}

/// Rays from `origins` to every corner of the mesh and to random points of every edge.
fn rays_at_edges(mesh: &Mesh, origins: &[Vec3], random: &Random) -> Vec<Ray> {
    let mut targets = mesh.vertices.clone();
    for [a, b, c] in mesh.indices() {
        for (p, q) in [(a, b), (b, c), (c, a)] {
            targets.push(mesh.vertices[p as usize].lerp(mesh.vertices[q as usize], random.uniform()));
        }
    }
    let to =
        |origin: Vec3| targets.iter().map(move |&target| Ray { origin, direction: target - origin, exclude: NO_PATCH });
    origins.iter().flat_map(|&origin| to(origin)).collect()
}

#[test]
fn no_ray_escapes_from_a_closed_mesh_whatever_the_instructions() {
    let random = Random::new(30);
    let mut rays = 0;
    for (case, mesh) in
        [icosphere(3), box_from(-Vec3::ONE, Vec3::ONE, 6), box_from(-Vec3::ONE, Vec3::ONE, 1)].into_iter().enumerate()
    {
        for turn in 0..4 {
            // As it stands, where rays run along edges and axes, and turned.
            let rotation = random.rotation();
            let mesh = if turn == 0 { mesh.clone() } else { mesh.clone().map(|v| rotated(&rotation, v)) };
            let count = [9, 30, 500][case];
            let origins: Vec<Vec3> =
                (0..count).map(|k| if k == 0 { Vec3::ZERO } else { 0.4 * random.in_cube() }).collect();
            let at_edges = rays_at_edges(&mesh, &origins, &random);
            for instructions in Instructions::available() {
                let bvh = Bvh::of_scene(&mesh.scene()).with_instructions(instructions);
                for (ray, hit) in at_edges.iter().zip(bvh.closest(&at_edges)) {
                    let hit = hit.unwrap_or_else(|| panic!("mesh {case}, {instructions:?}: {ray:?} has escaped"));
                    // The target is rounded to an ulp of its coordinates; the way is at least half a radius long.
                    assert!((hit.t - 1.0).abs() < 1e-14, "mesh {case}, {instructions:?}: t = {}", hit.t);
                    rays += 1;
                }
            }
        }
    }
    assert!(rays >= 400_000 * Instructions::available().len(), "{rays}");
}

#[test]
fn nothing_stands_between_the_walls_of_an_empty_convex_room() {
    // A tree over all walls, none of which may block; bundles between pairs of patches, and segments one by one.
    let random = Random::new(31);
    let mut segments = 0;
    for mesh in [cube(3), icosphere(2).reversed(), cube(2).map(|v| rotated(&Random::new(5).rotation(), v))] {
        let scene = mesh.scene();
        let bvh = Bvh::of_scene(&scene);
        while segments % 340_000 != 339_968 {
            let (i, j) = (random.below(scene.len()), random.below(scene.len()));
            let bundle: Vec<Segment> = (0..64)
                .filter_map(|_| {
                    let (start, end) = lit_segment(&random, &scene, i, j)?;
                    Some(Segment { start, end, exclude: [i as u32, j as u32] })
                })
                .collect();
            if bundle.len() < 64 {
                continue;
            }
            assert!(bvh.blocked(&bundle).iter().all(|blocked| !blocked), "patches {i} and {j}");
            assert!(bvh.blocked_between(&bundle).iter().all(|blocked| !blocked), "patches {i} and {j} together");
            segments += 64;
        }
        segments += 64 - 32;
    }
    assert!(segments > 1_000_000, "{segments}");
}

/// Meshes of every kind: soups of triangles, closed ones, touching ones, and very different sizes.
fn assorted(random: &Random) -> Vec<Scene> {
    let mut small_and_large = soup(random, 150, 0.3);
    small_and_large.extend(soup(random, 150, 1e-3));
    small_and_large.push([vec3(-1.0, -1.0, 0.1), vec3(1.0, -1.0, 0.1), vec3(0.0, 1.0, 0.12)]);
    vec![
        Mesh::of_triangles(&soup(random, 1000, 0.2)).scene(),
        Mesh::of_triangles(&small_and_large).scene(),
        Mesh::of_triangles(&needles(random, 200)).scene(),
        box_in_box(3).scene(),
        icosphere(2).and(&icosphere(3).map(|v| 0.3 * v)).scene(),
    ]
}

/// `count` needles, a million times as long as wide.
fn needles(random: &Random, count: usize) -> Vec<Triangle> {
    let needle = |_| {
        let (p, along) = (random.in_cube(), random.direction());
        [p, p + along, p + 0.5 * along + 1e-6 * random.direction()]
    };
    (0..count).map(needle).collect()
}

#[test]
fn needles_are_hit() {
    let random = Random::new(38);
    let triangles = needles(&random, 2000);
    let scene = Mesh::of_triangles(&triangles).scene();
    let bvh = Bvh::of_scene(&scene);
    let (mut first, mut rays) = (0, 0);
    for [a, b, c] in &triangles {
        for _ in 0..20 {
            let (u, v) = (random.between(0.1, 0.4), random.between(0.1, 0.4));
            let target = (1.0 - u - v) * *a + u * *b + v * *c;
            let origin = 3.0 * random.direction();
            let direction = target - origin;
            // Seen nearly edge-on, rounding of the target decides.
            if (*b - *a).cross(*c - *a).normalize().dot(direction.normalize()).abs() < 1e-3 {
                continue;
            }
            let hit = closest(&bvh, origin, direction).expect("a needle");
            // Corners are rounded by eps, edge functions and so weights by eps over the width, 2e-10; the needle is at most 1
            // deep. Or another is before it.
            assert!(hit.t < 1.0 + 1e-9, "{}", hit.t);
            assert!(blocked(&bvh, origin, target + 0.5 * direction, NOBODY));
            first += u32::from((hit.t - 1.0).abs() < 1e-9);
            rays += 1;
        }
    }
    assert!(rays > 35_000 && first > rays / 10 * 9, "{first} of {rays}");
}

#[test]
fn all_instructions_give_the_same_bits() {
    let random = Random::new(32);
    for (case, scene) in assorted(&random).iter().enumerate() {
        let mut rays = Vec::new();
        let mut segments = Vec::new();
        for k in 0..20_000u32 {
            let patch = random.below(scene.len());
            let on_patch = point_in_triangle(&scene.triangle(patch), random.uniform(), random.uniform());
            let exclude = patch as u32;
            // From a surface, from space, from outside.
            rays.push(match k % 3 {
                0 => Ray { origin: on_patch, direction: random.direction(), exclude },
                1 => {
                    let origin = random.in_cube();
                    Ray { origin, direction: on_patch - origin, exclude: NO_PATCH }
                }
                _ => Ray { origin: 5.0 * random.direction(), direction: -random.direction(), exclude: NO_PATCH },
            });
            let start = random.in_cube();
            // Through the patch, or from it.
            let (start, end) =
                if k % 2 == 0 { (start, 2.0 * on_patch - start) } else { (on_patch, 1.5 * random.in_cube()) };
            segments.push(Segment { start, end, exclude: [exclude * (k % 2), NO_PATCH] });
        }
        let answers = Instructions::available().into_iter().map(|instructions| {
            let bvh = Bvh::of_scene(scene).with_instructions(instructions);
            (instructions, bvh.closest(&rays), bvh.blocked(&segments))
        });
        let answers: Vec<_> = answers.collect();
        let (_, hits, blocked) = &answers[0];
        assert!(hits.iter().flatten().count() > 100 && blocked.iter().filter(|b| **b).count() > 100, "scene {case}");
        for (instructions, other_hits, other_blocked) in &answers {
            let differ = hits.iter().zip(other_hits).position(|(a, b)| a != b);
            assert_eq!(differ, None, "ray in scene {case}, {instructions:?}");
            let differ = blocked.iter().zip(other_blocked).position(|(a, b)| a != b);
            assert_eq!(differ, None, "segment in scene {case}, {instructions:?}");
        }
    }
}

#[test]
fn a_bundle_is_blocked_like_its_segments_one_by_one() {
    let random = Random::new(33);
    let (mut hidden, mut free) = (0, 0);
    for scene in assorted(&random) {
        for instructions in Instructions::available() {
            let bvh = Bvh::of_scene(&scene).with_instructions(instructions);
            for pair in 0..300 {
                let (i, j) = (random.below(scene.len()), random.below(scene.len()));
                // Of any number; every other bundle fans out further than one frustum may.
                let count = 1 + random.below(150);
                let spread = if pair % 2 == 0 { 0.0 } else { 2.0 };
                let bundle: Vec<Segment> = (0..count)
                    .map(|_| {
                        let on = |k: usize| point_in_triangle(&scene.triangle(k), random.uniform(), random.uniform());
                        let (start, end) = (on(i), on(j) + spread * random.in_cube());
                        Segment { start, end, exclude: [i as u32, j as u32] }
                    })
                    .collect();
                let expected = bvh.blocked(&bundle);
                assert_eq!(bvh.blocked_between(&bundle), expected, "patches {i} and {j}, {instructions:?}");
                hidden += expected.iter().filter(|blocked| **blocked).count();
                free += expected.iter().filter(|blocked| !**blocked).count();
            }
        }
    }
    assert!(hidden > 10_000 && free > 10_000, "{hidden} blocked, {free} free");
    assert!(Bvh::of_scene(&cube(1).scene()).blocked_between(&[]).is_empty());
}

#[test]
fn hits_do_not_depend_on_scale_and_place() {
    let random = Random::new(34);
    let mesh = Mesh::of_triangles(&soup(&random, 500, 0.3));
    let rays: Vec<(Vec3, Vec3)> = (0..5000).map(|_| (random.in_cube(), random.direction())).collect();
    let unit = mesh.scene();
    for (scale, offset) in [(1e-6, 0.0), (1e-3, 0.0), (1e3, 0.0), (1e6, 0.0), (1.0, 1e6), (1e-3, 1e3)] {
        let shift = offset * vec3(1.0, -0.6, 0.3);
        let place = |v: Vec3| scale * v + shift;
        let moved = mesh.clone().map(place).scene();
        let (here, there) = (Bvh::of_scene(&unit), Bvh::of_scene(&moved));
        // What a coordinate is rounded by, relative to the size of the scene: hits closer to an edge may change sides.
        let rounding = 4.0 * f64::EPSILON * (1.0 + offset / scale);
        let mut compared = 0;
        for &(origin, direction) in &rays {
            let (a, b) = (closest(&here, origin, direction), closest(&there, place(origin), direction));
            let is_inside = a.is_none_or(|hit| {
                let [v, w] = hit.barycentric;
                let slope = unit.normals()[hit.patch as usize].dot(direction).abs();
                v.min(w).min(1.0 - v - w) * slope > 100.0 * rounding
            });
            if !is_inside {
                continue;
            }
            compared += 1;
            assert_eq!(a.map(|hit| hit.patch), b.map(|hit| hit.patch), "scale {scale}, offset {offset}");
            if let (Some(a), Some(b)) = (a, b) {
                let slope = unit.normals()[a.patch as usize].dot(direction).abs();
                assert!((b.t / scale - a.t).abs() * slope < 10.0 * rounding, "scale {scale}: {} and {}", a.t, b.t);
            }
        }
        assert!(compared > 4900, "{compared}");
    }
}

#[test]
fn identical_and_concentric_triangles_make_no_deep_tree() {
    let random = Random::new(35);
    let one = random.triangle(Vec3::ZERO, 1.0);
    let identical = Mesh::of_triangles(&[one; 10_000]).scene();
    let bvh = Bvh::of_scene(&identical);
    assert_eq!(bvh.len(), 1);
    let middle = (one[0] + one[1] + one[2]) / 3.0;
    let normal = identical.normals()[0];
    assert_eq!(closest(&bvh, middle + normal, -normal).map(|hit| hit.patch), Some(0));
    // Parallel triangles around one axis, whose boxes share their centre; and boxes one in the other by geometric steps,
    // of which cuts by area would peel off one at a time.
    let centred = |size: f64| [vec3(-1.0, -1.0, 0.0), vec3(1.0, -1.0, 0.0), vec3(0.0, 1.0, 0.0)].map(|v| size * v);
    let same_centre: Vec<Triangle> = (1..=10_000).map(|k| centred(f64::from(k))).collect();
    let shells: Vec<Triangle> =
        (0..10_000).map(|k| centred(1.001f64.powi(k)).map(|v| v + 0.5 * v.x.abs() * Vec3::Z)).collect();
    for triangles in [same_centre, shells] {
        let scene = Mesh::of_triangles(&triangles).scene();
        let bvh = Bvh::of_scene(&scene);
        // 8 to a leaf and 8 to a node: a few hundred bytes a triangle at the very most.
        assert!(bvh.nbytes() < 600 * scene.len(), "{} bytes", bvh.nbytes());
        let random = Random::new(36);
        for _ in 0..300 {
            let origin = 3.0 * random.in_cube();
            let direction = random.in_cube() - origin;
            let Ok(expected) = brute_closest(&scene, origin, direction) else { continue };
            // What is as near as the own surface, 1e-9 of a scene of up to 22,000, is not asked for.
            if expected.is_some_and(|(t, _)| t * direction.length() < 1e-4) {
                continue;
            }
            let hit = closest(&bvh, origin, direction);
            assert_eq!(hit.map(|hit| hit.patch as usize), expected.map(|(_, i)| i));
        }
    }
}

#[test]
fn a_ray_does_not_meet_the_surface_that_it_starts_on() {
    // From points of a mesh of flat sides, wherever it stands, without naming the patch: the next thing is another side.
    let random = Random::new(37);
    for offset in [0.0, 1e3, 1e6] {
        let (rotation, shift) = (random.rotation(), offset * random.in_cube());
        let scene = cube(3).map(|v| rotated(&rotation, v) + shift).scene();
        let bvh = Bvh::of_scene(&scene);
        let mut rays = Vec::new();
        for k in 0..10_000 {
            let patch = random.below(scene.len());
            let origin = point_in_triangle(&scene.triangle(patch), random.uniform(), random.uniform());
            let direction = scene.normals()[patch] + 0.9 * random.direction();
            rays.push(Ray { origin, direction, exclude: if k % 2 == 0 { NO_PATCH } else { patch as u32 } });
        }
        for (ray, hit) in rays.iter().zip(bvh.closest(&rays)) {
            let hit = hit.expect("the cube is closed");
            let other = scene.plane(hit.patch as usize).distance(ray.origin);
            // The side that is hit is not one that holds the start; corners are rounded to some ulp of the offset.
            assert!(other > 1e-15 * (1.0 + offset), "offset {offset}: {ray:?} meets patch {}", hit.patch);
        }
    }
}

#[test]
fn what_is_no_ray_meets_nothing() {
    let scene = box_in_box(2).map(|v| 0.25 * v).scene();
    let bad = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e308, -1e308];
    for instructions in Instructions::available() {
        let bvh = Bvh::of_scene(&scene).with_instructions(instructions);
        for (k, &x) in bad.iter().enumerate() {
            for mask in 1..8 {
                let at = |axis: usize, good: f64| if mask >> axis & 1 != 0 { x } else { good };
                let point = vec3(at(0, 0.1), at(1, 0.1), at(2, 0.1));
                // In a block with sound rays, which are answered all the same.
                let sound = Ray { origin: Vec3::splat(0.02), direction: Vec3::X, exclude: NO_PATCH };
                let origin = Ray { origin: point, ..sound };
                let direction = Ray { direction: point, ..sound };
                let hits = bvh.closest(&[sound, origin, direction, sound]);
                assert!(hits[0].is_some() && hits[0] == hits[3], "{instructions:?}");
                // From beyond all numbers, or straight to infinity; 1e308 is a direction like any other.
                let aims = k > 2;
                assert!((hits[1].is_none() || aims) && hits[2].is_some() == aims, "{instructions:?}: {point}");
                for (start, end) in [(point, Vec3::splat(0.1)), (Vec3::splat(0.1), point), (point, point)] {
                    let segments = vec![Segment { start, end, exclude: NOBODY }; 3];
                    assert_eq!(bvh.blocked(&segments), bvh.blocked_between(&segments), "{instructions:?}: {point}");
                }
            }
        }
        let none = Ray { origin: Vec3::splat(0.1), direction: Vec3::ZERO, exclude: NO_PATCH };
        assert_eq!(bvh.closest(&[none]), [None]);
    }
}

#[test]
fn bundles_pass_dust_like_single_segments() {
    // Triangles down to 1e-7 of the scene between two large patches: segments far from them must not be told hit.
    let random = Random::new(39);
    let walls = [
        [vec3(-1.0, -1.0, -1.0), vec3(1.0, -1.0, -1.0), vec3(0.0, 1.0, -1.0)],
        [vec3(-1.0, -1.0, 1.0), vec3(0.0, 1.0, 1.0), vec3(1.0, -1.0, 1.0)],
    ];
    let mut near = 0;
    for size in [1e-3, 1e-5, 1e-6, 1e-7] {
        for _ in 0..30 {
            let mut triangles = walls.to_vec();
            let centre = 0.3 * random.in_cube();
            triangles.push(random.triangle(centre, size));
            let scene = Mesh::of_triangles(&triangles).scene();
            // Through the dust, just beside it, and anywhere.
            let segments: Vec<Segment> = (0..256)
                .map(|k| {
                    let start = point_in_triangle(&walls[0], random.uniform(), random.uniform());
                    let other = point_in_triangle(&walls[1], random.uniform(), random.uniform());
                    let through = centre + size * random.in_cube();
                    let end = start + (through - start) * (2.0 / (through.z - start.z));
                    Segment { start, end: if k % 4 == 0 { other } else { end }, exclude: [0, 1] }
                })
                .collect();
            let expected = Bvh::of_scene(&scene).with_instructions(Instructions::Portable).blocked(&segments);
            near += expected.iter().filter(|blocked| **blocked).count();
            for instructions in Instructions::available() {
                let bvh = Bvh::of_scene(&scene).with_instructions(instructions);
                assert_eq!(bvh.blocked(&segments), expected, "{instructions:?}, size {size}");
                assert_eq!(bvh.blocked_between(&segments), expected, "{instructions:?}, size {size}");
            }
        }
    }
    assert!(near > 1000, "{near}");
}

#[test]
fn rays_from_very_far_do_not_escape() {
    // The entry into the scene is rounded to 1e-16 of the distance: the ray is another one, but it meets the closed mesh.
    let mesh = icosphere(3);
    let scene = mesh.scene();
    let bvh = Bvh::of_scene(&scene);
    let random = Random::new(40);
    for distance in [1e10, 1e12, 1e14] {
        for _ in 0..2000 {
            let origin = distance * random.direction();
            let target = 0.3 * random.in_cube();
            let hit = closest(&bvh, origin, target - origin).expect("the sphere");
            // Within the sphere, and what that rounding amounts to.
            assert!((hit.t - 1.0).abs() * distance < 2.0 + 1e-14 * distance, "{}", hit.t);
            assert!(blocked(&bvh, origin, target, NOBODY) && blocked(&bvh, target, origin, NOBODY));
        }
    }
}
