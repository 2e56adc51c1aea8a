//! Light straight from lamps: closed forms of points and polygons, unbiased samples, and which emitters are lamps.

use std::f64::consts::{PI, TAU};

use radiosity::Progress;

use radiosity::direct::lamp::Point;
use radiosity::direct::patches::Direct;
use radiosity::direct::{Lamp, Lamps, Lights, SCRAMBLES, Surroundings};
use radiosity::geometry::sampling::Sobol;
use radiosity::scene::Sides;
use radiosity::visibility::Bvh;

use crate::common::{Random, assert_close, cube, plate, vec3};

/// A rectangle from (0, 0, height) to (a, b, height) that shines down.
fn ceiling(a: f64, b: f64, height: f64) -> Lamp {
    let corners = [(0.0, 0.0), (0.0, b), (a, b), (a, 0.0)].map(|(x, y)| vec3(x, y, height));
    Lamp::new(corners.to_vec(), vec![1.0])
}

fn up(x: f64, y: f64) -> Point {
    Point { x: vec3(x, y, 0.0), normal: vec3(0.0, 0.0, 1.0), patch: 0 }
}

#[test]
fn form_factor_from_a_point_to_a_rectangle() {
    // Howell's catalogue B-4: an element parallel to a rectangle, below one of its corners. X = a/c, Y = b/c.
    let b4 = |x: f64, y: f64| {
        let (p, q) = ((1.0 + x * x).sqrt(), (1.0 + y * y).sqrt());
        (x / p * (y / p).atan() + y / q * (x / q).atan()) / TAU
    };
    for (a, b, c) in [(1.0, 1.0, 1.0), (2.0, 0.5, 0.3), (1e-3, 1e-3, 1.0), (1.0, 1.0, 1e-6)] {
        // Some roundings of angles that are added up.
        assert_close(ceiling(a, b, c).form_factor(&up(0.0, 0.0)), b4(a / c, b / c), 1e-14);
    }
    // An element that looks along x sees only the part of the lamp before it: half of one that is as wide on both sides, and
    // that is Howell's B-5, an element perpendicular to a rectangle, below its corner.
    let (b, c) = (0.8, 1.3);
    let (y, r) = (b / c, f64::hypot(1.0, 1.0 / c));
    let b5 = (y.atan() - (1.0 / r) * (b / (c * r)).atan()) / TAU;
    let whole =
        Lamp::new([(-1.0, 0.0), (-1.0, b), (1.0, b), (1.0, 0.0)].map(|(x, y)| vec3(x, y, c)).to_vec(), vec![1.0]);
    let sideways = Point { normal: vec3(1.0, 0.0, 0.0), ..up(0.0, 0.0) };
    assert_close(whole.form_factor(&sideways), b5, 1e-14);
    // From behind, and from the lamp's own plane, there is nothing to see.
    assert_eq!(ceiling(1.0, 1.0, -1.0).form_factor(&up(0.2, 0.2)), 0.0);
    assert_eq!(ceiling(1.0, 1.0, 0.0).form_factor(&up(0.2, 0.2)), 0.0);
}

#[test]
fn samples_have_the_form_factor_as_their_mean() {
    let lamp = ceiling(1.0, 0.7, 0.5);
    let tilted = |x: f64, y: f64, z: f64| Point { normal: vec3(0.6, 0.0, 0.8), x: vec3(x, y, z), patch: 0 };
    // By area from afar, by solid angle near by, across the horizon, and next to the lamp's plane.
    for point in [tilted(-3.0, 2.0, -2.0), tilted(0.3, 0.2, 0.0), tilted(-0.4, 0.3, 0.4), tilted(0.5, 0.3, 0.499_999)] {
        let means: Vec<f64> = (0..32)
            .map(|seed| {
                let sobol = Sobol::new(seed);
                let sum: f64 = (0..256)
                    .map(|k| {
                        let [u, v] = sobol.point(k);
                        let (z, weight) = lamp.sample(&point, u, v);
                        assert!(weight >= 0.0 && (z.z - 0.5).abs() < 1e-9, "{z} weighs {weight}");
                        assert!(
                            (-1e-6..=1.0 + 1e-6).contains(&z.x) && (-1e-6..=0.7 + 1e-6).contains(&z.y),
                            "{z} is off the lamp"
                        );
                        weight
                    })
                    .sum();
                sum / 256.0
            })
            .collect();
        let mean = means.iter().sum::<f64>() / 32.0;
        let error = (means.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / (32.0 * 31.0)).sqrt();
        // 31 degrees of freedom: beyond five standard errors with probability 2e-5.
        assert_close(mean, lamp.form_factor(&point), 5.0 * error + 1e-12);
    }
}

#[test]
fn lamps_are_chosen_where_they_pay() {
    // A small bright square of 32 triangles is one lamp of four corners.
    let lit = cube(4).scene_with(1, Sides::Front, |_, _| 0.5, |i, _| if i < 32 { 10.0 } else { 0.0 });
    let lamps = Lamps::of_scene(&lit).unwrap();
    assert_eq!((lamps.lamps.len(), lamps.lamps[0].corners().len(), lamps.glow.len()), (1, 4, 0));
    assert_close(lamps.lamps[0].area(), 1.0, 1e-12);
    // Walls that all glow alike are none: rays find them anyway.
    let furnace = cube(4).scene_with(1, Sides::Front, |_, _| 0.5, |_, _| 1.0);
    let lamps = Lamps::of_scene(&furnace).unwrap();
    assert_eq!((lamps.lamps.len(), lamps.glow.len()), (0, furnace.len()));
    // A sheet that shines to both sides is two.
    let sheet = plate(vec3(0.0, 0.0, 0.0), vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0), 2);
    let both = sheet.scene_with(1, Sides::Both, |_, _| 0.0, |_, _| 1.0);
    assert_eq!(Lamps::of_scene(&both).unwrap().lamps.len(), 2);
    // And nothing is nothing.
    let dark = cube(1).scene();
    let lamps = Lamps::of_scene(&dark).unwrap();
    assert!(lamps.lamps.is_empty() && lamps.glow.is_empty());
}

/// A floor of one square under a lamp at height 1, and a sheet halfway that hides the side x < 0.
fn half_hidden() -> radiosity::scene::Scene {
    let floor = plate(vec3(-0.5, -0.5, 0.0), vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0), 1);
    let lamp = plate(vec3(-0.5, -0.5, 1.0), vec3(0.0, 1.0, 0.0), vec3(1.0, 0.0, 0.0), 2);
    let sheet = plate(vec3(-5.0, -5.0, 0.5), vec3(5.0, 0.0, 0.0), vec3(0.0, 10.0, 0.0), 1);
    let all = floor.and(&lamp).and(&sheet);
    all.scene_with(1, Sides::Front, |_, _| 0.0, |i, _| if (2..10).contains(&i) { 2.0 } else { 0.0 })
}

#[test]
fn light_at_points_and_on_patches_by_symmetry() {
    let scene = half_hidden();
    let (lamps, tree) = (Lamps::of_scene(&scene).unwrap(), Bvh::of_scene(&scene));
    let (blockers, none) = (Bvh::of_blockers(&scene), Lights::default());
    assert_eq!(lamps.lamps.len(), 1);
    let surroundings = Surroundings { scene: &scene, lamps: &lamps, lights: &none, tree: &tree, blockers: &blockers };
    let mut direct = Direct::new(surroundings, 1e-8, 3, 4, &Progress::default()).unwrap();
    direct.sample(|_| 4096 / SCRAMBLES as u32, &Progress::default()).unwrap();
    // Mirroring at x = 0 exchanges free segments and hidden ones: half of E F is left, F = 0.199824895698 (Howell C-11).
    let mut both = [0.0];
    (0..2).for_each(|i| direct.irradiance(i, &mut both));
    // 2 x 4096 segments: random ones would be off by 0.5 / sqrt(8192) = 0.6 %, quasi-random ones by less.
    assert_close(0.5 * both[0], 0.5 * 2.0 * 0.199_824_895_698, 0.006 * 0.2);
    let by_scramble = (0..SCRAMBLES).map(|s| {
        let mut out = [0.0];
        (0..2).for_each(|i| direct.irradiance_of_scramble(i, s, &mut out));
        out[0]
    });
    assert_close(by_scramble.sum::<f64>() / SCRAMBLES as f64, both[0], 1e-12);
}

#[test]
fn light_at_points_is_right_in_the_mean() {
    // Two lamps of unequal brightness side by side, so that one has to be chosen, and the sheet below.
    let floor = plate(vec3(-0.5, -0.5, 0.0), vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0), 1);
    let lamp = |x: f64| plate(vec3(x, -0.5, 1.0), vec3(0.0, 1.0, 0.0), vec3(0.5, 0.0, 0.0), 1);
    let sheet = plate(vec3(-5.0, -5.0, 0.5), vec3(5.0, 0.0, 0.0), vec3(0.0, 10.0, 0.0), 1);
    let emissions = [0.0, 1.0, 5.0, 0.0];
    let all = floor.and(&lamp(-0.5)).and(&lamp(0.0)).and(&sheet);
    let scene = all.scene_with(1, Sides::Front, |_, _| 0.0, |i, _| emissions[i / 2]);
    let (lamps, blockers) = (Lamps::of_scene(&scene).unwrap(), Bvh::of_blockers(&scene));
    assert_eq!(lamps.lamps.len(), 2);
    let random = Random::new(5);
    for x in [-0.3, 0.2] {
        let point = up(x, 0.1);
        // The free part of a lamp seen from x: what lies beyond the sheet's edge at x = 0, y = any, z = 0.5.
        let free = |from: f64, to: f64| {
            let edge = (-x).clamp(from, to);
            let corners = [(edge, -0.5), (edge, 0.5), (to, 0.5), (to, -0.5)].map(|(x, y)| vec3(x, y, 1.0));
            if edge < to { Lamp::new(corners.to_vec(), vec![1.0]).form_factor(&point) } else { 0.0 }
        };
        let exact = free(-0.5, 0.0) + 5.0 * free(0.0, 0.5);
        // Whatever is said of the view.
        for in_view in [true, false] {
            let points = vec![point; 20_000];
            let mut out = vec![0.0; points.len()];
            let numbers = |_: usize| [random.uniform(), random.uniform()];
            assert!(lamps.light(&points, &blockers, numbers, |_, _| in_view, &mut out) > 0);
            let mean = out.iter().sum::<f64>() / 20_000.0;
            let spread = (out.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 20_000.0f64.powi(2)).sqrt();
            // Five standard errors.
            assert_close(mean, exact, 5.0 * spread);
        }
    }
}

#[test]
fn nothing_is_asked_where_nothing_can_stand_between() {
    let scene = cube(2).scene_with(1, Sides::Front, |_, _| 0.5, |i, _| if i < 8 { PI } else { 0.0 });
    let (lamps, tree) = (Lamps::of_scene(&scene).unwrap(), Bvh::of_scene(&scene));
    let (blockers, none) = (Bvh::of_blockers(&scene), Lights::default());
    let surroundings = Surroundings { scene: &scene, lamps: &lamps, lights: &none, tree: &tree, blockers: &blockers };
    let mut direct = Direct::new(surroundings, 1e-9, 0, 4, &Progress::default()).unwrap();
    direct.sample(|_| 100, &Progress::default()).unwrap();
    assert_eq!(direct.segments, 0);
    // All that the lamp sends arrives; on the opposite wall E F of it, F = 0.199824895698 (Howell C-11).
    let sides: Vec<f64> = (0..scene.len())
        .map(|i| {
            let mut out = [0.0];
            direct.irradiance(i, &mut out);
            out[0] * scene.areas()[i]
        })
        .collect();
    let total: f64 = sides.iter().sum();
    assert_close(total, PI, 1e-8);
    assert!(sides.chunks(8).any(|side| (side.iter().sum::<f64>() - PI * 0.199_824_895_698).abs() < 1e-8));
}
