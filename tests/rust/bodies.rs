//! Bodies: counts that geometry dictates, areas that must be kept, and segments against the tree of blockers.

use std::collections::BTreeSet;

use radiosity::Progress;
use radiosity::assembly::{Estimator, FormFactors, Sampled, SampledOptions};
use radiosity::geometry::Vec3;
use radiosity::geometry::polygon::area;
use radiosity::scene::{Scene, Sides};
use radiosity::visibility::bodies::Bodies;
use radiosity::visibility::body::Body;
use radiosity::visibility::{Bvh, Segment};

use super::common::{Mesh, PLENTY, Random, assert_close, box_from, dense, icosphere, plate, rotated, vec3};

/// A closed box with its fronts outside.
fn block(low: Vec3, high: Vec3, k: usize) -> Mesh {
    box_from(low, high, k).reversed()
}

/// The room from -3 to 3.
fn room(k: usize) -> Mesh {
    box_from(Vec3::splat(-3.0), Vec3::splat(3.0), k)
}

/// A box without its face at the smallest z.
fn cover(low: Vec3, high: Vec3, k: usize) -> Mesh {
    let mut mesh = block(low, high, k);
    let vertices = mesh.vertices.clone();
    mesh.faces.retain(|f| f.iter().any(|&v| vertices[v as usize].z > low.z));
    mesh
}

fn subdivided(scene: &Scene, max_edge: f64) -> Scene {
    scene.subdivide(max_edge, PLENTY, &Progress::default()).unwrap().0
}

fn both_sided(mesh: &Mesh) -> Scene {
    mesh.scene_with(1, Sides::Both, |_, _| 0.5, |_, _| 0.0)
}

fn is_sheet(body: &Body) -> bool {
    body.faces.len() == 2
}

fn any_entangled(scene: &Scene, bodies: &Bodies) -> Vec<u32> {
    (0..scene.len() as u32).filter(|&i| bodies.entangled(i)).collect()
}

/// The border of a face of a body, from its edges.
fn border(body: &Body, face: u32) -> Vec<Vec3> {
    let mut sides: Vec<[Vec3; 2]> = Vec::new();
    for edge in &body.edges {
        if edge.left == face {
            sides.push([edge.start, edge.end]);
        }
        if edge.right == face {
            sides.push([edge.end, edge.start]);
        }
    }
    let mut ring = vec![sides[0][0]];
    let mut end = sides[0][1];
    while end != sides[0][0] {
        ring.push(end);
        end = sides.iter().find(|side| side[0] == end).expect("the border is closed")[1];
        assert!(ring.len() <= sides.len());
    }
    assert_eq!(ring.len(), sides.len());
    ring
}

/// Edges and faces fit together, normals point out, all is convex.
#[track_caller]
fn assert_sound(body: &Body, slack: f64) {
    let size = (body.high - body.low).max_element();
    for (k, face) in body.faces.iter().enumerate() {
        assert!((face.normal.length() - 1.0).abs() < 1e-12);
        let ring = border(body, k as u32);
        let n = ring.len();
        assert!(n >= 3);
        let normal = radiosity::geometry::polygon::area_vector(&ring).normalize();
        assert!(normal.dot(face.normal) > 1.0 - 1e-6, "face {k}: {normal} for {}", face.normal);
        for j in 0..n {
            let (v, w, x) = (ring[j], ring[(j + 1) % n], ring[(j + 2) % n]);
            assert!((w - v).cross(x - w).dot(normal) >= 0.0, "face {k} turns right");
            assert!(face.distance(v).abs() <= 1e-9 * size + slack);
        }
        for edge in &body.edges {
            assert!(face.distance(edge.start) <= 1e-9 * size + slack);
        }
    }
    for edge in &body.edges {
        for x in [edge.start, edge.end] {
            assert!(x.cmpge(body.low).all() && x.cmple(body.high).all());
        }
    }
}

#[track_caller]
fn bodies_of(scene: &Scene) -> Bodies {
    let far = scene.vertices().iter().map(|v| v.abs().max_element()).fold(0.0, f64::max);
    let bodies = Bodies::of_scene(scene);
    bodies.bodies.iter().for_each(|body| assert_sound(body, 32.0 * f64::EPSILON * far));
    bodies
}

/// (faces, edges) of every body.
fn counts(bodies: &Bodies) -> Vec<(usize, usize)> {
    bodies.bodies.iter().map(|body| (body.faces.len(), body.edges.len())).collect()
}

/// Area of all sheets, one side each.
fn sheet_area(bodies: &Bodies) -> f64 {
    bodies.bodies.iter().filter(|body| is_sheet(body)).map(|body| area(&border(body, 0))).sum()
}

/// How far the segment runs inside a body moved out by `margin`: 0 when it misses, and the least positive number when it
/// passes through a sheet. Clips the segment by the faces, and for a sheet also by its sides.
fn meets(body: &Body, start: Vec3, end: Vec3, margin: f64) -> bool {
    let (mut from, mut to) = (0.0_f64, 1.0_f64);
    let mut cut = |normal: Vec3, point: Vec3, room: f64| {
        let (a, b) = (normal.dot(start - point) - room, normal.dot(end - point) - room);
        if a > 0.0 && b > 0.0 {
            to = -1.0;
        } else if a > 0.0 {
            from = from.max(a / (a - b));
        } else if b > 0.0 {
            to = to.min(a / (a - b));
        }
    };
    if is_sheet(body) {
        let face = body.faces[0];
        for edge in &body.edges {
            cut((edge.end - edge.start).cross(face.normal).normalize(), edge.start, margin);
        }
        let (a, b) = (face.distance(start), face.distance(end));
        let t = a / (a - b);
        return a * b < 0.0 && from <= t && t <= to;
    }
    body.faces.iter().for_each(|face| cut(face.normal, face.point, margin));
    from < to
}

/// Whether a point lies inside a solid, or within `margin` of it.
fn is_inside(body: &Body, x: Vec3, margin: f64) -> bool {
    !is_sheet(body) && body.faces.iter().all(|face| face.distance(x) < margin)
}

/// Segments between points outside all solids: bodies block what the tree of blockers says, but for grazing ones, which
/// another margin decides otherwise.
#[track_caller]
fn assert_blocks_like_rays(scene: &Scene, low: Vec3, high: Vec3, count: usize, seed: u64) {
    let random = Random::new(seed);
    let bodies = bodies_of(scene);
    let bvh = Bvh::of_blockers(scene);
    let margin = 1e-6 * (high - low).max_element();
    let point = || loop {
        let x = low + vec3(random.uniform(), random.uniform(), random.uniform()) * (high - low);
        if !bodies.bodies.iter().any(|body| is_inside(body, x, margin)) {
            return x;
        }
    };
    let segments: Vec<Segment> = (0..count)
        .map(|_| Segment { start: point(), end: point(), exclude: [radiosity::visibility::NO_PATCH; 2] })
        .collect();
    let (mut blocked, mut grazing) = (0, 0);
    for (segment, is_blocked) in segments.iter().zip(bvh.blocked(&segments)) {
        let by = |margin: f64| bodies.bodies.iter().any(|b| meets(b, segment.start, segment.end, margin));
        let (narrow, wide) = (by(-margin), by(margin));
        if narrow != wide {
            grazing += 1;
            continue;
        }
        blocked += usize::from(is_blocked);
        assert_eq!(narrow, is_blocked, "{segment:?}");
    }
    assert!(grazing * 50 < count, "{grazing} of {count} graze");
    assert!(blocked > 0 && blocked < count, "{blocked} of {count} are blocked");
}

#[test]
fn box_in_a_room_is_one_body() {
    for k in [1, 3] {
        let scene = room(k).and(&block(vec3(-1.0, -0.5, -0.7), vec3(0.5, 1.0, 0.3), k)).scene();
        let bodies = bodies_of(&scene);
        assert_eq!(counts(&bodies), [(6, 12)]);
        assert_eq!(bodies.bodies[0].low, vec3(-1.0, -0.5, -0.7));
        assert!(bodies.bodies[0].high.abs_diff_eq(vec3(0.5, 1.0, 0.3), 1e-15));
        assert!(any_entangled(&scene, &bodies).is_empty());
        for max_edge in [0.6, 0.13] {
            let fine = subdivided(&scene, max_edge);
            let bodies = bodies_of(&fine);
            assert_eq!(counts(&bodies), [(6, 12)]);
            assert!(any_entangled(&fine, &bodies).is_empty());
        }
    }
}

#[test]
fn silhouette_is_one_loop() {
    let random = Random::new(5);
    let ball = icosphere(2).map(|v| 0.5 * v + vec3(0.1, 0.2, 0.3));
    let scene = room(1).and(&ball).and(&block(vec3(-2.0, -2.0, -2.0), vec3(-1.0, -1.0, 0.0), 2)).scene();
    let bodies = bodies_of(&scene);
    assert_eq!(bodies.bodies.len(), 2);
    for _ in 0..200 {
        let x = 2.9 * random.in_cube();
        for body in bodies.bodies.iter().filter(|body| !is_inside(body, x, 1e-9)) {
            let seen: Vec<bool> = body.faces.iter().map(|face| face.distance(x) > 0.0).collect();
            let bits = |v: Vec3| v.to_array().map(f64::to_bits);
            let (mut starts, mut ends) = (BTreeSet::new(), BTreeSet::new());
            for edge in body.edges.iter().filter(|edge| seen[edge.left as usize] != seen[edge.right as usize]) {
                let (start, end) =
                    if seen[edge.left as usize] { (edge.start, edge.end) } else { (edge.end, edge.start) };
                assert!(starts.insert(bits(start)) && ends.insert(bits(end)));
            }
            assert_eq!(starts, ends);
            assert!(starts.len() >= 3);
        }
    }
}

#[test]
fn turned_boxes_stay_solid_at_any_scale() {
    let random = Random::new(7);
    for (scale, offset) in [(1.0, 0.0), (1.0, 1e6), (1e-9, 0.0), (1e9, 0.0), (1e-3, 1.0), (1e3, -1e6)] {
        for _ in 0..4 {
            let (turn, shift) = (random.rotation(), 0.5 * random.in_cube());
            let inner = block(Vec3::splat(-0.5), vec3(0.6, 0.4, 0.5), 3).map(|v| rotated(&turn, v) + shift);
            let scene = room(2).and(&inner).map(|v| scale * v + Vec3::splat(offset)).scene();
            assert_eq!(counts(&bodies_of(&scene)), [(6, 12)], "scale {scale}, offset {offset}");
            let fine = subdivided(&scene, 0.4 * scale);
            let bodies = bodies_of(&fine);
            assert_eq!(counts(&bodies), [(6, 12)], "scale {scale}, offset {offset}, finer");
            assert!(any_entangled(&fine, &bodies).is_empty());
        }
    }
}

#[test]
fn box_on_a_floor_needs_no_bottom() {
    let (low, high) = (vec3(-1.0, -1.0, -3.0), vec3(1.0, 0.5, -1.0));
    for mesh in [cover(low, high, 1), cover(low, high, 4), block(low, high, 2)] {
        for k in [1, 4, 6] {
            let scene = room(k).and(&mesh).scene();
            let bodies = bodies_of(&scene);
            assert_eq!(counts(&bodies), [(6, 12)]);
            assert!(any_entangled(&scene, &bodies).is_empty());
        }
    }
    // A floor with a hole under the box: one closed surface, of which the box alone is convex.
    let mut scene = room(6).and(&cover(vec3(-1.0, -1.0, -3.0), vec3(1.0, 1.0, -1.0), 2));
    let vertices = scene.vertices.clone();
    scene.faces.retain(|f| {
        !f.iter()
            .all(|&v| vertices[v as usize].abs().cmple(vec3(1.0, 1.0, 3.0)).all() && vertices[v as usize].z == -3.0)
    });
    let bodies = bodies_of(&scene.scene());
    assert_eq!(counts(&bodies), [(6, 12)]);
    // A box that hangs open.
    let scene = room(1).and(&cover(Vec3::splat(-1.0), Vec3::ONE, 2)).scene();
    assert_eq!(counts(&bodies_of(&scene)), [(6, 12)]);
}

#[test]
fn what_looks_into_a_box_makes_it_sheets() {
    let base = block(vec3(-1.0, -1.0, -3.0), vec3(1.0, 1.0, -1.0), 1);
    let top = block(vec3(-0.5, -0.5, -1.0), vec3(0.5, 0.5, 0.0), 1);
    // Floor and upper box look into the lower one from two sides; into the upper one looks the lower one only.
    let bodies = bodies_of(&room(1).and(&base).and(&top).scene());
    assert_eq!(bodies.bodies.iter().filter(|body| !is_sheet(body)).count(), 1);
    let bodies = bodies_of(&room(1).and(&base.map(|v| v + vec3(0.0, 0.0, 0.5))).scene());
    assert_eq!(counts(&bodies), [(6, 12)]);
    // From below an open box shows its inside.
    let hanging = cover(vec3(-1.0, -1.0, -2.0), vec3(1.0, 1.0, -1.0), 1);
    let bodies = bodies_of(&room(1).and(&hanging).and(&top).scene());
    assert_eq!(bodies.bodies.iter().filter(|body| !is_sheet(body)).count(), 1);
}

#[test]
fn boxes_apart_touching_and_within_each_other() {
    let first = block(Vec3::splat(-1.0), Vec3::ZERO, 2);
    let scene = room(1).and(&first).and(&block(vec3(0.2, 0.2, 0.2), Vec3::ONE, 2)).scene();
    let bodies = bodies_of(&scene);
    assert_eq!(counts(&bodies), [(6, 12), (6, 12)]);
    assert!(any_entangled(&scene, &bodies).is_empty());
    // Along an edge, at a corner.
    for high in [vec3(1.0, 1.0, 0.0), Vec3::ONE] {
        let low = high - 1.0;
        let scene = room(1).and(&first).and(&block(low, high, 2)).scene();
        let bodies = bodies_of(&scene);
        assert_eq!(counts(&bodies), [(6, 12), (6, 12)]);
        assert!(any_entangled(&scene, &bodies).is_empty());
    }
    let scene = room(1).and(&first).and(&block(Vec3::splat(-0.4), Vec3::ONE, 2)).scene();
    let bodies = bodies_of(&scene);
    assert_eq!(counts(&bodies), [(6, 12), (6, 12)]);
    for i in any_entangled(&scene, &bodies) {
        assert!(scene.triangle(i as usize).iter().all(|v| v.abs().max_element() < 2.0), "the walls are outside");
    }
    // Faces that meet the other box's corner, 3 each with 8 triangles, of which some reach in.
    let found = any_entangled(&scene, &bodies).len();
    assert!((6..=48).contains(&found), "{found} patches reach into a box");
}

#[test]
fn both_sided_box_is_six_sheets() {
    for k in [1, 3] {
        let scene = both_sided(&room(1).and(&block(Vec3::splat(-1.0), Vec3::ONE, k)));
        let bodies = bodies_of(&scene);
        assert_eq!(counts(&bodies), [(2, 4); 6]);
        assert!((sheet_area(&bodies) - 24.0).abs() < 1e-12);
        assert_eq!(counts(&bodies_of(&subdivided(&scene, 0.5))), [(2, 4); 6]);
    }
}

#[test]
fn room_alone_has_none() {
    for scene in [room(1).scene(), room(5).scene(), icosphere(3).reversed().scene(), both_sided(&room(3))] {
        assert!(bodies_of(&scene).bodies.is_empty());
    }
    assert!(bodies_of(&subdivided(&room(1).scene(), 0.3)).bodies.is_empty());
    assert!(bodies_of(&block(Vec3::ZERO, Vec3::ONE, 2).scene()).bodies.is_empty());
}

#[test]
fn icosphere_is_one_solid() {
    for level in 0..4 {
        let scene = room(2).and(&icosphere(level).map(|v| v * vec3(1.0, 2.0, 0.5))).scene();
        let faces = 20 << (2 * level);
        assert_eq!(counts(&bodies_of(&scene)), [(faces, faces * 3 / 2)]);
    }
    // Rounder than a solid may be.
    let scene = room(2).and(&icosphere(5)).scene();
    assert_eq!(bodies_of(&scene).bodies.len(), 20 << 10);
}

/// A wall of 6 x 6 at x = 0 with a door of 2 x 4 in it, in cells of 1 / k.
fn wall_with_a_door(k: usize) -> Mesh {
    let mut wall = plate(vec3(0.0, -3.0, -3.0), vec3(0.0, 6.0, 0.0), vec3(0.0, 0.0, 6.0), 6 * k);
    let vertices = wall.vertices.clone();
    wall.faces.retain(|f| {
        let middle = f.iter().map(|&v| vertices[v as usize]).sum::<Vec3>() / 3.0;
        !(middle.y.abs() < 1.0 && middle.z < 1.0)
    });
    wall
}

#[test]
fn walls_that_are_not_convex_become_few_sheets() {
    for k in [1, 2, 5] {
        for scene in [room(3).and(&wall_with_a_door(k)).scene(), both_sided(&room(3).and(&wall_with_a_door(k)))] {
            let bodies = bodies_of(&scene);
            assert!(bodies.bodies.iter().all(is_sheet));
            assert!(bodies.bodies.len() <= 4, "{} sheets of {k}", bodies.bodies.len());
            assert!((sheet_area(&bodies) - 28.0).abs() < 1e-9);
        }
    }
    for max_edge in [1.0, 0.5, 0.1] {
        let bodies = bodies_of(&subdivided(&room(1).and(&wall_with_a_door(1)).scene(), max_edge));
        assert!(bodies.bodies.len() <= 8, "{} sheets at {max_edge}", bodies.bodies.len());
        assert!((sheet_area(&bodies) - 28.0).abs() < 1e-9);
    }
    // An L, as six triangles, turned.
    let turn = Random::new(3).rotation();
    let (x, y) = (vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0));
    for k in [1, 2, 7] {
        let ell = plate(Vec3::ZERO, x, y, k).and(&plate(x, x, y, k)).and(&plate(y, x, y, k));
        let bodies = bodies_of(&room(1).and(&ell.map(|v| rotated(&turn, v))).scene());
        assert!(bodies.bodies.len() <= 3, "{} sheets of {k}", bodies.bodies.len());
        assert!((sheet_area(&bodies) - 3.0).abs() < 1e-9);
    }
}

#[test]
fn random_plates_keep_their_area() {
    let random = Random::new(11);
    for _ in 0..40 {
        let k = 1 + random.below(12);
        let (turn, u) = (random.rotation(), random.direction());
        let mut mesh = plate(Vec3::splat(-0.5), u, u.cross(random.direction()), k);
        mesh.faces.retain(|_| random.uniform() < 0.8);
        mesh.faces.push([0, 1, k as i64 + 2]);
        mesh.faces.dedup();
        let scene = room(1).and(&mesh.map(|v| rotated(&turn, v))).scene();
        let mut distinct = BTreeSet::new();
        let total: f64 = (12..scene.len())
            .filter(|&i| {
                let mut face = scene.faces()[i];
                face.sort_unstable();
                distinct.insert(face)
            })
            .map(|i| scene.areas()[i])
            .sum();
        assert!((sheet_area(&bodies_of(&scene)) - total).abs() < 1e-9);
    }
}

#[test]
fn soup_is_sheets_of_three_edges() {
    let random = Random::new(13);
    let triangles: Vec<[Vec3; 3]> = (0..2000).map(|_| random.triangle(2.0 * random.in_cube(), 0.5)).collect();
    let scene = room(1).and(&Mesh::of_triangles(&triangles)).scene();
    let bodies = bodies_of(&scene);
    assert_eq!(counts(&bodies), vec![(2, 3); 2000]);
    assert!(any_entangled(&scene, &bodies).is_empty());
}

#[test]
fn odd_meshes_are_taken_as_they_come() {
    let random = Random::new(17);
    // Corners drawn from a small grid: slivers, edges shared by many, duplicates, triangles through each other.
    for size in [2, 3, 5] {
        for _ in 0..30 {
            let corner = || [0; 3].map(|_| random.below(size) as f64);
            let mut triangles = Vec::new();
            while triangles.len() < 150 {
                let t = [0; 3].map(|_| Vec3::from_array(corner()));
                if (t[1] - t[0]).cross(t[2] - t[0]).length() > 0.0 {
                    triangles.push(t);
                }
            }
            let sides = if random.uniform() < 0.5 { Sides::Front } else { Sides::Both };
            let shift = if random.uniform() < 0.5 { 0.0 } else { 1e6 };
            let mesh = Mesh::of_triangles(&triangles).map(|v| v + shift + 1e-12 * random.in_cube() * (shift - 1e6));
            let Ok(scene) = mesh.try_scene(1, sides, |_, _| 0.5, |_, _| 0.0) else { continue };
            let bodies = bodies_of(&scene);
            let again = Bodies::of_scene(&scene);
            assert_eq!(format!("{:?}", bodies.bodies), format!("{:?}", again.bodies));
        }
    }
    // Needles that fan out from one edge, far from the origin.
    let needles: Vec<[Vec3; 3]> =
        (1..200).map(|k| [vec3(0.0, 0.0, 0.0), vec3(1.0, 0.0, 0.0), vec3(0.5, 1e-7 * f64::from(k), 0.3)]).collect();
    bodies_of(&room(1).and(&Mesh::of_triangles(&needles)).map(|v| v + 100.0).scene());
}

#[test]
fn bodies_block_what_rays_find_blocked() {
    let random = Random::new(19);
    let (low, high) = (Vec3::splat(-3.0), Vec3::splat(3.0));
    let boxes = |count: usize| {
        (0..count).fold(room(2), |mesh, _| {
            let (turn, shift) = (random.rotation(), 2.0 * random.in_cube());
            let half = vec3(random.between(0.1, 0.6), random.between(0.1, 0.6), random.between(0.1, 0.6));
            mesh.and(&block(-half, half, 2).map(|v| rotated(&turn, v) + shift))
        })
    };
    let scene = boxes(8).scene();
    assert_eq!(bodies_of(&scene).bodies.len(), 8);
    assert_blocks_like_rays(&scene, low, high, 4000, 1);
    assert_blocks_like_rays(&both_sided(&boxes(4)), low, high, 4000, 2);
    assert_blocks_like_rays(&room(1).and(&icosphere(3)).scene(), low, high, 4000, 3);
    assert_blocks_like_rays(&room(3).and(&wall_with_a_door(2)).scene(), low, high, 4000, 4);
    let standing =
        cover(vec3(-1.0, -2.0, -3.0), vec3(0.7, 0.5, 0.0), 2).and(&cover(vec3(1.0, -2.0, -3.0), Vec3::splat(2.0), 1));
    assert_blocks_like_rays(&room(4).and(&standing).scene(), low, high, 4000, 5);
    let triangles: Vec<[Vec3; 3]> = (0..60).map(|_| random.triangle(2.0 * random.in_cube(), 1.0)).collect();
    assert_blocks_like_rays(&room(1).and(&Mesh::of_triangles(&triangles)).scene(), low, high, 4000, 6);
    for scale in [1e-9, 1e9] {
        let scene = boxes(4).map(|v| scale * v).scene();
        assert_blocks_like_rays(&scene, scale * low, scale * high, 1000, 7);
    }
    let scene = boxes(4).map(|v| v + 1e6).scene();
    assert_blocks_like_rays(&scene, low + 1e6, high + 1e6, 1000, 8);
}

/// A shade open below, and in it a bulb, in a cluster with others beside it: it lights what is under it.
#[test]
fn what_stands_in_an_open_body_is_seen_through_the_opening() {
    let shade = cover(vec3(-1.0, -1.0, 0.0), vec3(1.0, 1.0, 1.0), 1);
    let desk = plate(vec3(-1.0, -1.0, -1.0), 2.0 * Vec3::X, 2.0 * Vec3::Y, 4);
    // Facing down.
    let bulb = plate(vec3(-0.1, -0.1, 0.5), 0.2 * Vec3::Y, 0.2 * Vec3::X, 1);
    let beside =
        (0..6).fold(bulb.clone(), |mesh, k| mesh.and(&bulb.clone().map(|v| v + vec3(2.0 + f64::from(k), 0.0, 0.0))));
    // And a shelf that pierces the sides.
    let shelf = plate(vec3(-3.0, -0.5, 0.4), Vec3::Y, 6.0 * Vec3::X, 1);
    for (name, inside) in [("bulb", beside), ("shelf", shelf)] {
        let scene = shade.clone().and(&desk).and(&inside).scene();
        let (first, lamp) = (shade.faces.len(), shade.faces.len() + desk.faces.len());
        let options = SampledOptions { tolerance: 0.02, seed: 1, memory: PLENTY };
        let rays = Sampled::new(&scene, Estimator::MonteCarlo, options, &Progress::default()).unwrap();
        let sum = |f: &dyn FormFactors| {
            let mut row = vec![0.0; scene.len()];
            f.row(lamp, &mut row);
            row[first..lamp].iter().sum::<f64>()
        };
        let exact = sum(&dense(&scene, 1e-3, 0));
        assert!(exact > 0.1, "{name}: {exact}");
        // Rows by rays are within 2 % in the mean.
        assert_close(exact, sum(&rays), 0.06);
    }
}
