//! Suns, points, spots and skies: closed forms, unbiased samples, determinism, and solves under them.

use std::f64::consts::{FRAC_1_SQRT_2, PI};

use radiosity::Progress;
use radiosity::accuracy::{Options, assess, solve};
use radiosity::assembly::Order;
use radiosity::direct::lamp::Point;
use radiosity::direct::sky::Distribution;
use radiosity::direct::{Cone, Irradiance, Light, Lights, Sky, coefficients, irradiance};
use radiosity::geometry::Vec3;
use radiosity::geometry::sampling::Sobol;
use radiosity::scene::{Scene, Sides};
use radiosity::visibility::Bvh;

use crate::common::{Mesh, PLENTY, assert_close, cube, invalid, on_threads, plate, vec3};

const UP: Vec3 = Vec3::Z;
const OPTIONS: Options = Options { tolerance: 0.02, order: Order::Linear, refine: true, seed: 0, memory: PLENTY };

fn of(light: Light) -> Lights {
    Lights::new(vec![light], 1).unwrap()
}

fn sky(distribution: Distribution, radiance: Vec<f64>) -> Lights {
    of(Light::Sky(Sky::new(distribution, UP, Vec3::Y, radiance, 1)))
}

fn sun(towards: Vec3) -> Lights {
    of(Light::Sun { towards: towards.normalize(), irradiance: vec![3.0] })
}

fn point(position: Vec3) -> Light {
    Light::Point { position, intensity: vec![2.0], cone: None }
}

/// A square of side 1 that looks up, at a height.
fn floor(height: f64) -> Mesh {
    plate(vec3(0.0, 0.0, height), Vec3::X, Vec3::Y, 1)
}

fn scene(mesh: &Mesh) -> Scene {
    mesh.clone().scene_with(1, Sides::Front, |_, _| 0.5, |_, _| 0.0)
}

fn found(scene: &Scene, lights: &Lights, tolerance: f64) -> Irradiance {
    irradiance(scene, lights, tolerance, 0, PLENTY, &Progress::default()).unwrap()
}

#[test]
fn an_open_plate_has_closed_forms() {
    let level = scene(&floor(0.0));
    // All of these without noise.
    assert_close(found(&level, &sky(Distribution::Constant, vec![2.0]), 0.1).values[0], 2.0 * PI, 1e-14);
    assert_close(found(&level, &sun(vec3(1.0, 0.0, 1.0)), 0.1).values[0], 3.0 * FRAC_1_SQRT_2, 1e-14);
    assert_eq!(found(&level, &sun(vec3(1.0, 0.0, -1.0)), 0.1).values, [0.0, 0.0]);
    // Moon & Spencer 1942: the integral of L_z (1 + 2 sin) / 3 sin over the dome is 7 pi / 9 L_z; on a wall, which sees half of
    // it, pi / 6 (1 + 8 / (3 pi)) L_z. Noise is measured, 4.5 deviations of the RMS of the patches.
    let overcast = sky(Distribution::Overcast, vec![1.0]);
    let wall = scene(&floor(0.0).map(|v| vec3(0.0, v.x, v.y)));
    for (scene, exact) in [(&level, 7.0 * PI / 9.0), (&wall, PI / 6.0 * (1.0 + 8.0 / (3.0 * PI)))] {
        let told = found(scene, &overcast, 1e-3);
        assert!(told.error_estimate <= 1e-3);
        for (value, error) in told.values.iter().zip(&told.standard_error) {
            assert!((value - exact).abs() < 4.5 * 2.0 * 1e-3 * exact, "{value} +- {error}, not {exact}");
        }
    }
}

#[test]
fn a_point_brings_its_solid_angle() {
    // Above the middle of a square of side s at height h: omega = 4 asin(s^2 / (s^2 + 4 h^2)), that of the base of a pyramid.
    for h in [1e-6, 0.01, 0.5, 3.0, 1e4, 1e9] {
        let scene = scene(&floor(0.0));
        let told = found(&scene, &of(point(vec3(0.5, 0.5, h))), 0.1);
        let omega = 4.0 * (1.0 / (1.0 + 4.0 * h * h)).asin();
        let power: f64 = told.values.iter().zip(scene.areas()).map(|(h, area)| h * area).sum();
        // Some roundings of angles; the position relative to the plane is known to a rounding of its coordinates.
        assert_close(power, 2.0 * omega, 1e-9);
        assert!(told.standard_error.iter().all(|error| *error <= 1e-12 * power), "a point in full view makes no noise");
    }
    assert_eq!(found(&scene(&floor(0.0)), &of(point(vec3(0.5, 0.5, 0.0))), 0.1).values, [0.0, 0.0], "in the plane");
}

#[test]
fn shadows_take_their_part() {
    // A square of side 1/2 at height 1/2 over the middle of a floor: the sun in the zenith loses a quarter; its back is dark.
    let blocker = floor(0.5).map(|v| vec3(0.25 + 0.5 * v.x, 0.25 + 0.5 * v.y, v.z));
    let both = scene(&floor(0.0).and(&blocker));
    let told = found(&both, &sun(UP), 2e-3);
    let power = |h: &[f64]| -> f64 { (0..2).map(|i| h[i] * both.areas()[i]).sum() };
    // The tolerance, three times.
    assert_close(power(&told.values), 0.75 * 3.0, 6e-3);
    assert_close(told.values[2], 3.0, 1e-14);
    // From a point in the middle over it, at height 1, the shadow is as large as the floor.
    let told = found(&both, &of(point(vec3(0.5, 0.5, 1.0))), 1e-2);
    assert_eq!(power(&told.values), 0.0);
    // A lid over all of it, as large as the floor and on its hull, blocks a sky that is not there for patches between.
    let lid = scene(&floor(0.0).and(&floor(1e-3).reversed()));
    let told = found(&lid, &sky(Distribution::Constant, vec![1.0]), 0.05);
    assert!(told.values[0] < 0.01 * PI, "{:?}", told.values);
}

#[test]
fn samples_at_points_have_the_same_mean() {
    // A table with one bright cell, a spot and a sun, at a point: the mean over the square against the patch average.
    let mut radiance = vec![0.1; 8 * 16];
    radiance[16 + 5] = 50.0;
    let cone = Cone { axis: vec3(0.0, 0.0, -1.0), beam: 0.2, cutoff: 0.6 };
    let lights = Lights::new(
        vec![
            Light::Sky(Sky::new(Distribution::Table { rows: 8, columns: 16 }, UP, Vec3::Y, radiance, 1)),
            Light::Point { position: vec3(0.4, 0.5, 1.0), intensity: vec![2.0], cone: Some(cone) },
            Light::Sun { towards: vec3(0.6, 0.0, 0.8), irradiance: vec![1.0] },
        ],
        1,
    )
    .unwrap();
    let scene = scene(&floor(0.0).and(&floor(0.3).map(|v| vec3(0.3 * v.x, v.y, v.z))));
    let (tree, told) = (Bvh::of_scene(&scene), found(&scene, &lights, 2e-3));
    let mean = |i: usize| {
        let sobol: Sobol<4> = Sobol::new(7);
        let [a, b, c] = scene.triangle(i);
        let sum: f64 = (0..1 << 14)
            .map(|k| {
                let [u, v, s, t] = sobol.point(k);
                let x = a + u.sqrt() * ((1.0 - v) * (b - a) + v * (c - a));
                let mut out = [0.0];
                let point = Point { x, normal: scene.normals()[i], patch: i as u32 };
                lights.light(&[point], &tree, |_| [s, t], &mut out);
                out[0]
            })
            .sum();
        sum / f64::from(1 << 14)
    };
    for i in 0..scene.len() {
        // Both to about 2e-3.
        assert_close(mean(i), told.values[i], 1e-2 * told.values[0]);
    }
}

#[test]
fn coefficients_of_a_sky_sum_to_what_is_open() {
    let blocker = floor(0.5).map(|v| vec3(0.25 + 0.5 * v.x, 0.25 + 0.5 * v.y, v.z));
    let scene = scene(&floor(0.0).and(&blocker));
    let (rows, columns) = (6, 12);
    let matrix = coefficients(&scene, [rows, columns], UP, Vec3::Y, 4096, 0, PLENTY, &Progress::default()).unwrap();
    let radiance: Vec<f64> = (0..rows * columns).map(|c| (c % 5) as f64).collect();
    let told = found(&scene, &sky(Distribution::Table { rows, columns }, radiance.clone()), 2e-3);
    for (row, value) in matrix.chunks_exact(rows * columns).zip(told.values) {
        let sum: f64 = row.iter().zip(&radiance).map(|(c, l)| c * l).sum();
        // 4096 quasi-random rays leave less than 1 / 64 of the spread of the cells, 1.4 of 2 in the mean.
        assert_close(sum, value, 0.01 * value);
        assert!(row.iter().sum::<f64>() <= PI * (1.0 + 1e-12));
    }
}

#[test]
fn a_closed_box_around_a_point_is_a_furnace() {
    // All power of the point is absorbed after all bounces: sum A (1 - rho) H = 4 pi I, whatever its place.
    let room = cube(2).scene_with(1, Sides::Front, |_, _| 0.7, |_, _| 0.0);
    let (low, high) =
        room.vertices().iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    let lights = of(point(low + vec3(0.3, 0.4, 0.6) * (high - low)));
    let outcome = solve(&room, &lights, &OPTIONS, &Progress::default()).unwrap();
    let absorbed: f64 = outcome.irradiance.iter().zip(room.areas()).map(|(h, area)| 0.3 * h * area).sum();
    // The solver balances closed scenes: rounding of sums is left.
    assert_close(absorbed, 8.0 * PI, 1e-9);
    let audit = outcome.audit.unwrap();
    assert_close(audit.emitted[0], 8.0 * PI, 1e-9);
    let told = assess(&room, &lights, &outcome.irradiance, &OPTIONS, &Progress::default()).unwrap();
    // The estimate of the solve and that of the error of its solution are about one another.
    assert!(told.error < 0.02, "{}", told.error);
}

#[test]
fn bits_depend_on_the_seed_alone() {
    let room = scene(&floor(0.0).and(&floor(0.5).map(|v| vec3(0.5 * v.x, v.y, v.z))));
    let lights = Lights::new(
        vec![
            Light::Sky(Sky::new(Distribution::Overcast, UP, Vec3::Y, vec![1.0], 1)),
            Light::Sun { towards: vec3(0.6, 0.0, 0.8), irradiance: vec![1.0] },
        ],
        1,
    )
    .unwrap();
    let run = |threads| on_threads(threads, || solve(&room, &lights, &OPTIONS, &Progress::default()).unwrap());
    let first = run(1);
    for threads in [2, 5] {
        assert_eq!(run(threads).radiosity, first.radiosity, "{threads} threads");
        assert_eq!(run(threads).standard_error, first.standard_error, "{threads} threads");
    }
}

#[test]
fn bad_lights_are_named() {
    let bad = Lights::new(
        vec![
            Light::Sun { towards: UP, irradiance: vec![-1.0] },
            Light::Point { position: vec3(f64::NAN, 0.0, 0.0), intensity: vec![1.0, 1.0], cone: None },
        ],
        1,
    );
    let text = invalid(bad.map(|_| ()));
    assert!(text.contains("light 0: its strength -1"), "{text}");
    assert!(text.contains("light 1: its place"), "{text}");
    let one = scene(&floor(0.0));
    let refused = irradiance(&one, &sun(UP), 0.0, 0, PLENTY, &Progress::default()).map(|_| ());
    assert!(invalid(refused).contains("tolerance"));
    let progress = Progress::default();
    progress.stop();
    assert!(irradiance(&one, &sun(UP), 0.1, 0, PLENTY, &progress).is_err());
}

/// Narrow beams on large patches: all of the light arrives, whatever the patches.
#[test]
fn a_spot_is_found_on_a_patch_of_any_size() {
    let large = floor(0.0).map(|v| 100.0 * v - vec3(50.0, 50.0, 0.0));
    for cutoff in [0.5f64, 0.1, 0.01, 1e-4] {
        let cone = Cone { axis: vec3(0.0, 0.0, -1.0), beam: cutoff, cutoff };
        let light = Light::Point { position: vec3(0.3, 0.2, 2.0), intensity: vec![2.0], cone: Some(cone) };
        for seed in 0..4 {
            let told =
                irradiance(&scene(&large), &of(light.clone()), 0.01, seed, PLENTY, &Progress::default()).unwrap();
            // I times the solid angle of the cone, to the tolerance at 3 standard errors.
            let power: f64 = told.values.iter().map(|h| 5000.0 * h).sum();
            let all = 2.0 * 4.0 * PI * (0.5 * cutoff).sin().powi(2);
            assert!((power / all - 1.0).abs() <= 0.03, "cutoff {cutoff}, seed {seed}: {power} of {all}");
        }
    }
    // In the full beam there is no noise, and beside it no light.
    let beam = Cone { axis: vec3(0.0, 0.0, -1.0), beam: 1.2, cutoff: 1.4 };
    let spot = |cone| Light::Point { position: vec3(0.5, 0.5, 1.0), intensity: vec![2.0], cone };
    let level = scene(&floor(0.0));
    assert_eq!(found(&level, &of(spot(Some(beam))), 0.1).values, found(&level, &of(spot(None)), 0.1).values);
    let away = Cone { axis: vec3(1.0, 0.0, 0.0), beam: 0.1, cutoff: 0.2 };
    assert_eq!(found(&level, &of(spot(Some(away))), 0.1).values, [0.0, 0.0]);
}

/// What hides a small part of few patches is met.
#[test]
fn a_narrow_shadow_on_two_patches_is_found() {
    let bar = floor(0.5).map(|v| vec3(v.x, 0.4 + 0.002 * v.y, v.z));
    for seed in 0..4 {
        let lit =
            irradiance(&scene(&floor(0.0).and(&bar)), &sun(UP), 1e-4, seed, PLENTY, &Progress::default()).unwrap();
        // Of 3 W/m^2, 0.2 % are in the shadow; to four standard errors of the tolerance.
        assert_close(0.5 * (lit.values[0] + lit.values[1]), 3.0 * 0.998, 4.0 * 3e-4);
    }
}
