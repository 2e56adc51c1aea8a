//! Shadows of convex bodies against segments, patch by patch; the rules that average them against exact moments.

use radiosity::form_factor::occluded::{End, visible_fraction};
use radiosity::form_factor::shadow::{COARSE, POINTS, Shadows};
use radiosity::form_factor::{Accuracy, Batch, Patch};
use radiosity::geometry::Vec3;
use radiosity::scene::Scene;
use radiosity::visibility::Bvh;
use radiosity::visibility::bodies::Bodies;
use radiosity::visibility::shaft::Shaft;

use crate::common::{
    Mesh, Random, assert_close, box_from, box_in_box, cube, dense, icosphere, plate, rotated, table, vec3,
};

#[test]
fn the_rule_is_exact_to_degree_3_and_the_coarse_ones_to_degree_2() {
    // Symmetric rules are exact to degree 3 when they are for 1, e2 = ab + bc + ca and e3 = abc, whose means over a
    // triangle are 1/4 and 1/60 (Stroud 1971).
    let e2 = |[a, b, c]: [f64; 3]| a * b + b * c + c * a;
    let e3 = |[a, b, c]: [f64; 3]| a * b * c;
    let sum = |weights: [f64; 3], f: &dyn Fn([f64; 3]) -> f64| -> f64 {
        POINTS.iter().enumerate().map(|(k, p)| weights[[0, 0, 0, 1, 1, 1, 2][k]] * f(p.barycentric)).sum()
    };
    let fine = [POINTS[0].weight, POINTS[3].weight, POINTS[6].weight];
    for (k, point) in POINTS.iter().enumerate() {
        assert_eq!(point.weight, fine[[0, 0, 0, 1, 1, 1, 2][k]]);
        assert_close(point.barycentric.iter().sum(), 1.0, 1e-15);
    }
    // Seven terms below 1: some ulp.
    for weights in [fine, COARSE[0], COARSE[1]] {
        assert_close(sum(weights, &|_| 1.0), 1.0, 1e-15);
        assert_close(sum(weights, &e2), 0.25, 1e-15);
    }
    assert_close(sum(fine, &e3), 1.0 / 60.0, 1e-15);
    assert!(COARSE.iter().all(|&weights| (sum(weights, &e3) - 1.0 / 60.0).abs() > 1e-4), "they would tell no error");
}

/// A turned copy of a mesh about its own middle.
fn turned(mesh: Mesh, random: &Random) -> Mesh {
    let rotation = random.rotation();
    let middle = vec3(0.5, 0.45, 0.5);
    mesh.map(|v| middle + rotated(&rotation, v - middle))
}

fn scenes() -> Vec<(&'static str, Scene)> {
    let random = Random::new(71);
    let block = box_from(vec3(0.3, 0.25, 0.35), vec3(0.7, 0.65, 0.6), 2).reversed();
    let post = |x: f64| box_from(vec3(x, 0.4, 0.0), vec3(x + 0.15, 0.55, 0.7), 1).reversed();
    // Three plates that meet at a corner, one of them in two parts: sheets with common edges, seen from everywhere.
    let corner = plate(vec3(0.4, 0.4, 0.4), 0.3 * Vec3::X, 0.3 * Vec3::Y, 1)
        .and(&plate(vec3(0.4, 0.4, 0.4), 0.3 * Vec3::Y, 0.3 * Vec3::Z, 1))
        .and(&plate(vec3(0.4, 0.4, 0.4), 0.15 * Vec3::Z, 0.3 * Vec3::X, 1))
        .and(&plate(vec3(0.4, 0.4, 0.55), 0.15 * Vec3::Z, 0.3 * Vec3::X, 1));
    let ball = icosphere(1).map(|v| vec3(0.5, 0.5, 0.5) + 0.25 * v);
    vec![
        ("a box", box_in_box(2).scene()),
        ("a turned box", cube(2).and(&turned(block, &random)).scene()),
        ("two posts, one behind the other", cube(2).and(&post(0.2)).and(&post(0.6)).scene()),
        ("plates with common edges", cube(2).and(&turned(corner.clone(), &random)).scene()),
        ("plates parallel to the walls", cube(2).and(&corner).scene()),
        ("a ball", cube(2).and(&ball).scene()),
    ]
}

#[test]
fn shadows_leave_what_segments_reach() {
    const SEGMENTS: u32 = 1024;
    for (name, scene) in scenes() {
        let patches: Vec<Patch> = (0..scene.len()).map(|i| Patch::new(scene.triangle(i))).collect();
        let (bodies, tree) = (Bodies::of_scene(&scene), Bvh::of_scene(&scene));
        let (mut batch, mut shadows) = (Batch::new(), Shadows::default());
        let accuracy = Accuracy::new(1e-3).unwrap();
        let (mut partly, mut bias) = (0.0, 0.0);
        for i in 0..scene.len() {
            for j in 0..i {
                let exchange = batch.exchange(&patches[i].shape(), &patches[j].shape(), &accuracy);
                if exchange <= 0.0 {
                    continue;
                }
                let shaft = Shaft::new(&patches[i].corners, &patches[j].corners);
                let in_shaft = bodies.in_shaft(&shaft, [i as u32, j as u32], 8).expect("few bodies");
                let end = |k: usize| End { patch: k as u32, triangle: patches[k].corners, normal: patches[k].normal };
                let sampled = visible_fraction(&tree, &end(i), &end(j), SEGMENTS, 7);
                if sampled.standard_error > 0.02 {
                    // Next to no segment lies before the planes of both.
                    continue;
                }
                let Some(seen) = shadows.visible(&patches[i], &patches[j], &in_shaft, exchange, 1e-3) else { continue };
                let v = seen.fraction;
                // Random segments would have this standard error, quasi-random ones have less; of some thousand pairs none
                // is five of them off. What hides in a corner may be missed by all.
                // As many as count: some weigh much more than others.
                let m = sampled.effective;
                let slack = 5.0 * (v * (1.0 - v) / m).sqrt() + 5.0 / m + seen.error;
                let slack = slack + 5.0 * sampled.standard_error;
                assert!((sampled.value - v).abs() <= slack, "{name}: {i} and {j}: {} sampled, {v}", sampled.value);
                if v > 0.0 && v < 1.0 {
                    partly += 1.0;
                    bias += sampled.value - v;
                }
            }
        }
        // Errors of a few hundredths that have nothing to do with each other: a percent would be systematic.
        assert!(partly > 50.0, "{name}: {partly} pairs are partly hidden");
        assert!((bias / partly).abs() < 1e-3, "{name}: on the average of {partly} pairs {:e} off", bias / partly);
    }
}

#[test]
fn every_row_is_within_its_tolerance_of_converged_factors() {
    for (name, scene) in scenes() {
        let n = scene.len();
        let converged = table(&dense(&scene, 1e-5, 0));
        for tolerance in [1e-2, 1e-3, 1e-4] {
            let f = dense(&scene, tolerance, 0);
            let errors = table(&f).iter().zip(&converged).map(|(a, b)| (a - b).abs()).collect::<Vec<_>>();
            let worst = errors.chunks(n).map(|row| row.iter().sum::<f64>()).fold(0.0, f64::max);
            // The converged factors are off by a tenth of the tightest tolerance themselves.
            assert!(f.error_estimate() <= tolerance && worst <= tolerance + 1e-5, "{name}: {worst:e} at {tolerance:e}");
        }
    }
}

#[test]
fn what_passes_next_to_a_large_patch_is_not_missed() {
    // A box of small patches, just before a wall, that reaches through the ceiling.
    let scene = cube(2).and(&box_from(vec3(0.7, 0.4, 0.75), vec3(0.992, 0.6, 1.2), 7).reversed()).scene();
    let converged = table(&dense(&scene, 2e-3, 0));
    for tolerance in [1e-1, 3e-2] {
        let f = dense(&scene, tolerance, 0);
        let errors = table(&f).iter().zip(&converged).map(|(a, b)| (a - b).abs()).collect::<Vec<_>>();
        let worst = errors.chunks(scene.len()).map(|row| row.iter().sum::<f64>()).fold(0.0, f64::max);
        // The converged factors are off themselves.
        assert!(worst <= tolerance + 2e-3, "{worst} at {tolerance}");
    }
}

#[test]
fn far_from_the_origin_shadows_are_the_same() {
    const TOLERANCE: f64 = 1e-3;
    let inner = box_from(Vec3::splat(-10.0), Vec3::splat(10.0), 1).reversed();
    let mesh = box_from(Vec3::splat(-20.0), Vec3::splat(20.0), 2).and(&inner);
    let random = Random::new(3);
    for _ in 0..3 {
        let rotation = random.rotation();
        let at = |off: f64| {
            let way = off * vec3(1.0, 0.7, -0.4);
            let scene = mesh.clone().map(|v| rotated(&rotation, v) + way).scene();
            let f = dense(&scene, TOLERANCE, 0);
            (table(&f), f.error_estimate(), f.segments())
        };
        let (near, near_error, _) = at(0.0);
        let n = mesh.faces.len();
        for off in [1e3, 1e5, 1e6, 1e7] {
            let (far, error, segments) = at(off);
            assert_eq!(segments, 0, "at {off:e}");
            assert!(error <= TOLERANCE);
            for (i, (far, near)) in far.chunks(n).zip(near.chunks(n)).enumerate() {
                let sum: f64 = far.iter().sum();
                let difference: f64 = far.iter().zip(near).map(|(a, b)| (a - b).abs()).sum();
                // The scene is closed. Rounding moves the corners by 1e-11 of the size at most, far below the estimates.
                assert!((sum - 1.0).abs() <= error, "patch {i} at {off:e}: the row adds up to {sum}");
                assert!(difference <= error + near_error, "patch {i} at {off:e}: {difference:e} from the factors at 0");
            }
        }
    }
}

#[test]
fn slivers_are_not_hidden_by_their_own_body() {
    // A strip along an edge of the box inside the room; so thin that rounding turns its plane into the box.
    const STRIP: f64 = 1e-5;
    const TOLERANCE: f64 = 1e-3;
    let (low, high) = (Vec3::splat(-10.0), Vec3::splat(10.0));
    let mut inner = box_from(low, high, 1).reversed();
    let on_top = |f: &[i64; 3]| f.iter().all(|&v| inner.vertices[v as usize].z == high.z);
    let sides: Vec<[i64; 3]> = inner.faces.iter().filter(|f| !on_top(f)).copied().collect();
    inner.faces = sides;
    let corner = vec3(low.x, low.y, high.z);
    let strip = plate(corner, 20.0 * Vec3::X, STRIP * Vec3::Y, 1);
    let rest = plate(corner + STRIP * Vec3::Y, 20.0 * Vec3::X, (20.0 - STRIP) * Vec3::Y, 1);
    let mesh = box_from(Vec3::splat(-20.0), Vec3::splat(20.0), 2).and(&inner).and(&strip).and(&rest);
    let random = Random::new(5);
    for off in [0.0, 1e3, 1e4] {
        let rotation = random.rotation();
        let scene = mesh.clone().map(|v| rotated(&rotation, v) + off * vec3(1.0, 0.7, -0.4)).scene();
        let f = dense(&scene, TOLERANCE, 0);
        assert!(f.error_estimate() <= TOLERANCE);
        // Rounding by 4 ulp moves the strip's sides by so much of its width, which is how far its own area may be off.
        let rounding = 4.0 * f64::EPSILON * off / STRIP;
        for (i, row) in table(&f).chunks(scene.len()).enumerate() {
            let sum: f64 = row.iter().sum();
            assert!(
                (sum - 1.0).abs() <= f.error_estimate() + rounding,
                "patch {i} at {off:e}: the row adds up to {sum}"
            );
        }
    }
}

#[test]
fn bodies_of_many_edges_are_left_to_segments() {
    let ball = |level| icosphere(level).map(|v| vec3(0.5, 0.5, 0.5) + 0.25 * v);
    for (level, known) in [(2, true), (3, false)] {
        let scene = cube(1).and(&ball(level)).scene();
        let bodies = Bodies::of_scene(&scene);
        let [a, b] = [0, 3].map(|i| Patch::new(scene.triangle(i)));
        let exchange = Batch::new().exchange(&a.shape(), &b.shape(), &Accuracy::new(1e-3).unwrap());
        let solids: Vec<_> = bodies.bodies.iter().collect();
        // 480 edges, and 1920.
        assert_eq!(solids.len(), 1);
        assert_eq!(
            Shadows::default().visible(&a, &b, &solids, exchange, 1e-2).is_some(),
            known,
            "{} edges",
            solids[0].edges.len()
        );
    }
}
