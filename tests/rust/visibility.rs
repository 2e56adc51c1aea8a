//! Rays against brute force in f64, watertightness where it is hardest, and the proof of empty shafts against segments.

use radiosity::Progress;
use radiosity::form_factor::area_quadrature::kernel;
use radiosity::geometry::sampling::point_in_triangle;
use radiosity::geometry::{Triangle, Vec3};
use radiosity::scene::{Scene, Sides};
use radiosity::visibility::{Bvh, NO_PATCH};

use crate::common::{Mesh, PLENTY, Random, box_in_box, cube, icosphere, plate, rotated, two_plates, vec3};

const NOBODY: [u32; 2] = [NO_PATCH; 2];

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
            let found = bvh.closest(origin, direction);
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
        let (mut blocked, mut free) = (0, 0);
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
            assert_eq!(bvh.blocked(p, q, exclude), expected, "{count} triangles, segment {k}");
            assert_eq!(bvh.blocked(q, p, exclude), expected, "{count} triangles, segment {k} turned round");
            if expected { blocked += 1 } else { free += 1 }
        }
        assert!(blocked + free > 2900);
        assert!(free > 100 && (blocked > 100 || count == 1), "{count} triangles: {blocked} blocked, {free} free");
    }
}

#[test]
fn a_plate_blocks_what_passes_through_it_and_nothing_else() {
    let scene = plate(vec3(-1.0, -1.0, 0.0), 2.0 * Vec3::X, 2.0 * Vec3::Y, 1).scene();
    let bvh = Bvh::of_scene(&scene);
    let segment = |x: f64, from: f64, to: f64, exclude| bvh.blocked(vec3(x, 0.3, from), vec3(x, 0.3, to), exclude);
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
    assert!(!bvh.blocked(vec3(-0.5, 0.0, 0.0), vec3(0.5, 0.2, 0.0), NOBODY), "within the plate: seen edge-on");
    // Patch 0 lies below the diagonal y = x, patch 1 above.
    let [below, above] = [vec3(0.5, -0.5, 1.0), vec3(-0.5, 0.5, 1.0)];
    for (p, patch) in [(below, 0), (above, 1)] {
        assert!(bvh.blocked(p, p - 2.0 * Vec3::Z, [1 - patch, NO_PATCH]));
        assert!(!bvh.blocked(p, p - 2.0 * Vec3::Z, [patch, NO_PATCH]), "the excluded patch does not block");
        assert!(!bvh.blocked(p, p - 2.0 * Vec3::Z, [NO_PATCH, patch]), "in either place");
    }
    assert!(!bvh.blocked(below, below, NOBODY), "a segment without length has no inside");
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
            let hit = bvh.closest(origin, direction);
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
        let (a, b) = (bvh_here.closest(origin, direction), bvh_there.closest(origin + shift, direction));
        assert_eq!(a.map(|h| h.patch), b.map(|h| h.patch));
        if let (Some(a), Some(b)) = (a, b) {
            // The boxes' centres differ by less than an ulp of the shift, 2^-22: other roundings of numbers of size 1, on a
            // surface that is met at a grazing angle now and then.
            assert!((a.t - b.t).abs() < 1e-11, "{} and {}", a.t, b.t);
        }
        let end = origin + direction;
        assert_eq!(bvh_here.blocked(origin, end, NOBODY), bvh_there.blocked(origin + shift, end + shift, NOBODY));
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
                let hit = bvh.closest(origin, direction).expect("the cube is closed");
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
                let hit = bvh.closest(origin, target - origin).expect("a corner seen from outside");
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
            let hit = bvh.closest(origin, direction);
            assert_eq!(hit.map(|h| h.patch), Some(0), "case {case}: {triangle:?} from {origin} along {direction}");
            // Both ends within the size of the scene.
            let (p, q) = (target - direction.normalize(), target + direction.normalize());
            assert!(bvh.blocked(p, q, [1, NO_PATCH]), "case {case}: {triangle:?} from {p} to {q}");
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
            assert!(bvh.blocked(p, q, NOBODY) && bvh.blocked(q, p, NOBODY), "segment {k} at distance {distance}");
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
    let (mut blocked, mut free) = (0, 0);
    for _ in 0..20_000 {
        let (i, j) = (random.below(scene.len()), random.below(scene.len()));
        let Some((p, q)) = lit_segment(&random, &scene, i, j) else { continue };
        let exclude = [i as u32, j as u32];
        let expected = all.blocked(p, q, exclude);
        assert_eq!(blockers.blocked(p, q, exclude), expected, "patches {i} and {j}, from {p} to {q}");
        if expected { blocked += 1 } else { free += 1 }
    }
    assert!(blocked > 1000 && free > 1000, "{blocked} blocked, {free} free");
}

/// Over every pair of `scene`: how many shafts are declared empty, how many are not although no segment is blocked, and how
/// many are truly blocked. Fails when a shaft that was declared empty blocks a segment.
fn shafts(scene: &Scene, random: &Random, segments: usize) -> [usize; 3] {
    let blockers = Bvh::of_blockers(scene);
    let all = Bvh::of_scene(scene);
    let [mut empty, mut unproven, mut occluded] = [0; 3];
    for i in 0..scene.len() {
        for j in 0..i {
            let exclude = [i as u32, j as u32];
            let says_empty = blockers.shaft_is_empty(&scene.triangle(i), &scene.triangle(j), exclude);
            let mut is_blocked = false;
            let mut cast = 0;
            for _ in 0..segments {
                let Some((p, q)) = lit_segment(random, scene, i, j) else { break };
                is_blocked |= all.blocked(p, q, exclude);
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
        let hit = bvh.closest(origin, target - origin).expect("the plate");
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
fn of_exact_duplicates_the_first_is_hit() {
    let sheet = plate(Vec3::ZERO, Vec3::X, Vec3::Y, 1);
    let scene = sheet.clone().and(&sheet).and(&plate(Vec3::Z, Vec3::X, Vec3::Y, 1)).scene();
    let bvh = Bvh::of_scene(&scene);
    for (x, y) in [(0.7, 0.2), (0.3, 0.6)] {
        for direction in [Vec3::Z, -Vec3::Z] {
            let hit = bvh.closest(vec3(x, y, 0.0) - 0.5 * direction, direction).expect("the sheet");
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
        let hit = bvh.closest(origin, direction).expect("the sphere is closed");
        for exponent in [-1000, -500, -3, 5, 500, 1000] {
            // Powers of two, whose squares leave the range of numbers: the same ray, digit by digit.
            let scaled = bvh.closest(origin, 2f64.powi(exponent) * direction).expect("the same ray");
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
                    assert!(!bvh.blocked(p, q, NOBODY), "offset {offset}, slope {slope}: the start");
                    assert!(!bvh.blocked(q, p, NOBODY), "offset {offset}, slope {slope}: the end");
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
        let hit = bvh.closest(target - direction, direction).expect("the plate");
        assert!(fine.normals()[hit.patch as usize].dot(direction) < 0.0, "patch {} shows its back", hit.patch);
    }
}
