//! Instant radiosity: lights that carry the power of each bounce, and pictures that are known.

use std::f64::consts::PI;

use radiosity::geometry::Vec3;
use radiosity::instant::{
    InstantOptions, Lights, Picture, bounds, default_bound, gather, places, sample_of, virtual_lights,
};
use radiosity::render::Camera;
use radiosity::scene::{Scene, Sides};
use radiosity::visibility::Bvh;
use radiosity::{Error, Progress, Result};

use crate::common::{PLENTY, assert_close, box_in_box, cube, invalid, on_threads, plate, vec3};

const OPTIONS: InstantOptions =
    InstantOptions { width: 24, height: 16, bound: 10.0, compensate: true, lit: true, seed: 0, memory: PLENTY };

fn try_lights(scene: &Scene, count: usize, seed: u64) -> Result<Lights> {
    virtual_lights(scene, &Bvh::of_scene(scene), count, seed, PLENTY, &Progress::default())
}

fn lights(scene: &Scene, count: usize, seed: u64) -> Lights {
    try_lights(scene, count, seed).unwrap()
}

fn try_picture(scene: &Scene, lights: &Lights, camera: &Camera, options: InstantOptions) -> Result<Picture> {
    gather(scene, &Bvh::of_scene(scene), lights, camera, &options, &Progress::default())
}

fn picture(scene: &Scene, lights: &Lights, camera: &Camera, options: InstantOptions) -> Picture {
    try_picture(scene, lights, camera, options).unwrap()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Inside the unit cube, looking from one corner to the other.
fn inside() -> Camera {
    Camera::new(vec3(0.05, 0.1, 0.07), vec3(0.9, 0.8, 0.85), Vec3::Z, 70.0).unwrap()
}

/// At height 1 above the origin, looking down at the square [-1, 1]^2 of the plane z = 0.
fn above() -> Camera {
    Camera::new(Vec3::Z, Vec3::ZERO, Vec3::Y, 90.0).unwrap()
}

/// The unit cube of one material, E = 1 and 2 in its two bands.
fn furnace(rho: f64) -> Scene {
    cube(1).scene_with(2, Sides::Front, |_, _| rho, |_, b| 1.0 + b as f64)
}

#[test]
fn the_lights_of_a_bounce_carry_its_power() {
    // In a closed room of one reflectance every particle carries the same, so that sums are exact: A E rho^j.
    for (rho, count) in [(0.5, 1000), (0.8, 200), (0.0, 17), (0.3, 1)] {
        let lights = lights(&furnace(rho), count, 3);
        let last = *lights.bounce.last().unwrap();
        for b in 0..2 {
            for j in 0..=last {
                let of_bounce = (0..lights.points.len()).filter(|&k| lights.bounce[k] == j);
                let power: f64 = of_bounce.map(|k| lights.flux[2 * k + b]).sum();
                let exact = 6.0 * (1.0 + b as f64) * rho.powi(j as i32);
                // A sum of up to 1000 rounded numbers.
                assert_close(power, exact, 1e-13 * exact);
            }
        }
        assert_close(lights.left_out, rho.powi(last as i32 + 1), 1e-15);
    }
}

#[test]
fn there_are_as_many_lights_as_the_walk_allows() {
    let (closed, open) = (furnace(0.6), plate(Vec3::ZERO, Vec3::X, Vec3::Y, 1));
    let open = open.scene_with(1, Sides::Front, |_, _| 0.6, |_, _| 1.0);
    for count in [1, 2, 3, 10, 64, 255, 1024] {
        let inside = lights(&closed, count, 0);
        assert!(inside.points.len() <= count);
        // One particle more would have made up to as many lights more as the longest walk has.
        assert!(inside.points.len() + 1 + *inside.bounce.last().unwrap() as usize >= count);
        // No particle meets anything: all are on the emitter.
        let outside = lights(&open, count, 0);
        assert_eq!((outside.points.len(), outside.particles), (count, count));
    }
    // A white room would keep its particles for 10,000 bounces.
    let white = lights(&furnace(0.9999), 256, 0);
    assert!(white.points.len() <= 256 && white.left_out > 0.9 && *white.bounce.last().unwrap() > 10);
}

#[test]
fn emission_is_shared_out_in_proportion_to_power() {
    // Patches of power 1, 2, .. 12 times 1/2, in the first band and the second by turns.
    let scene = cube(1).scene_with(2, Sides::Front, |_, _| 0.0, |i, b| if i % 2 == b { i as f64 + 1.0 } else { 0.0 });
    let lights = lights(&scene, 780, 5);
    for i in 0..12 {
        let of_patch: Vec<usize> = (0..780).filter(|&k| lights.points[k].patch == i as u32).collect();
        // One in 78 for every unit of power; radical inverses of 780 points put one more or less into an interval.
        assert!(of_patch.len().abs_diff(10 * (i + 1)) <= 4, "{} lights on patch {i}", of_patch.len());
        for k in of_patch {
            assert_close(lights.flux[2 * k + i % 2], 39.0 / 780.0, 1e-15);
            assert_eq!(lights.flux[2 * k + 1 - i % 2], 0.0);
        }
    }
}

#[test]
fn a_furnace_is_as_bright_everywhere() {
    let scene = furnace(0.5);
    for seed in 0..3 {
        let lights = lights(&scene, 1024, seed);
        let options = InstantOptions { bound: default_bound(&scene), seed, ..OPTIONS };
        let pixels = picture(&scene, &lights, &inside(), options).pixels;
        for b in 0..2 {
            let exact = 2.0 * (1.0 + b as f64) / PI;
            let band: Vec<f64> = pixels.iter().skip(b).step_by(2).copied().collect();
            // Bounces beyond the ninth are left out: 1/1024 of all. 384 pixels of 16 paths, the worst of them half of
            // their light by paths: 0.3 %; 1024 lights of a quasi-random sequence: half a per cent.
            assert_close(mean(&band), exact, 0.01 * exact);
        }
    }
}

#[test]
fn light_straight_from_a_lamp_is_its_closed_form() {
    // A black floor would show nothing: rho = 0.5 of what a square lamp of side 1 at height 1/2 sends to the point
    // below its middle, 4 quarters of F = 1 / (2 pi) (2 a / sqrt(1 + a^2) atan(a / sqrt(1 + a^2))) with a = 1
    // (Howell, B-4).
    let floor = plate(vec3(-1.0, -1.0, 0.0), 2.0 * Vec3::X, 2.0 * Vec3::Y, 1);
    let mesh = floor.and(&plate(vec3(-0.5, -0.5, 0.5), Vec3::Y, Vec3::X, 1));
    let scene =
        mesh.scene_with(1, Sides::Front, |i, _| if i < 2 { 0.5 } else { 0.0 }, |i, _| if i < 2 { 0.0 } else { 1.0 });
    // From below the lamp, at the point beneath its middle, through a lens so long that nothing changes across the
    // picture.
    let camera = Camera::new(vec3(0.0, 0.0, 0.25), Vec3::ZERO, Vec3::Y, 0.01).unwrap();
    let root = 2f64.sqrt();
    let form_factor = 4.0 / (2.0 * PI) * 2.0 / root * (1.0 / root).atan();
    let exact = 0.5 * form_factor / PI;
    let error = |count: usize| {
        let of_seed = |seed: u64| {
            let lights = lights(&scene, count, seed);
            let options = InstantOptions { width: 1, height: 1, bound: 1e9, compensate: false, seed, ..OPTIONS };
            (picture(&scene, &lights, &camera, options).pixels[0] / exact - 1.0).powi(2)
        };
        (0..16).map(of_seed).sum::<f64>().sqrt() / 4.0
    };
    let (few, many) = (error(64), error(1024));
    // Random lights would be off by 0.5 / sqrt(64) = 6 %, and 4 times less for 16 times as many; the sequence does
    // better than that, both times by a factor of 2 at least.
    assert!(few < 0.03, "{few}");
    assert!(many < few / 4.0, "{few} {many}");
}

#[test]
fn what_the_bound_cuts_comes_back_by_paths() {
    // In a room with a box, whose picture has corners and shadows; the same lights, so that nothing but the bound
    // differs.
    let scene =
        box_in_box(1).scene_with(1, Sides::Front, |i, _| 0.3 + 0.03 * (i % 7) as f64, |i, _| f64::from(i == 0) * 3.0);
    let camera = Camera::new(vec3(0.05, 0.1, 0.07), vec3(0.5, 0.45, 0.3), Vec3::Z, 50.0).unwrap();
    let light = |bound: f64, compensate: bool| {
        // Over seeds, so that errors of few lights average out.
        let of_seed = |seed: u64| {
            let lights = lights(&scene, 512, seed);
            let picture = picture(&scene, &lights, &camera, InstantOptions { bound, compensate, seed, ..OPTIONS });
            (mean(&picture.pixels), picture.compensated)
        };
        let found: Vec<(f64, f64)> = (0..16).map(of_seed).collect();
        let part = |f: fn(&(f64, f64)) -> f64| mean(&found.iter().map(f).collect::<Vec<f64>>());
        (part(|found| found.0), part(|found| found.1))
    };
    let unbounded = light(1e12, false).0;
    for bound in [1.0, 4.0] {
        let (cut, (whole, share)) = (light(bound, false).0, light(bound, true));
        // 16 runs of 384 pixels; unbounded, single pixels count several times the mean, which makes 1 % of it.
        assert_close(whole, unbounded, 0.02 * unbounded);
        // The emitter is not seen, so that all light is reflected: what is missing is the share that was found.
        assert_close(1.0 - cut / whole, share, 0.005);
        assert!(share > 0.01);
    }
}

#[test]
fn emitters_are_seen_as_they_are_and_backs_are_black() {
    let mesh = plate(vec3(-1.0, -1.0, 0.0), Vec3::X, 2.0 * Vec3::Y, 1).and(&plate(
        Vec3::Z * 0.0 - Vec3::Y,
        2.0 * Vec3::Y,
        Vec3::X,
        1,
    ));
    let scene = mesh.scene_with(1, Sides::Front, |_, _| 0.5, |_, _| 2.0);
    let lights = lights(&scene, 16, 0);
    let pixels = picture(&scene, &lights, &above(), InstantOptions { width: 8, height: 8, ..OPTIONS }).pixels;
    for (k, pixel) in pixels.iter().enumerate() {
        // A mean of 16 equal numbers, added up.
        assert_close(*pixel, if k % 8 < 4 { 2.0 / PI } else { 0.0 }, 1e-14);
    }
}

#[test]
fn the_same_bits_for_any_number_of_threads() {
    let scene = box_in_box(2).scene_with(2, Sides::Front, |_, b| 0.4 + 0.2 * b as f64, |i, _| f64::from(i % 5 == 0));
    let made = |threads: usize| {
        on_threads(threads, || {
            let lights = lights(&scene, 300, 1);
            let options = InstantOptions { width: 70, height: 40, ..OPTIONS };
            let camera = inside();
            let tree = Bvh::of_scene(&scene);
            let seen = places(&scene, &tree, &camera, 3, &options, &Progress::default()).unwrap();
            let seen: Vec<Option<(Vec3, u32)>> = seen.iter().map(|p| p.map(|p| (p.x, p.patch))).collect();
            (lights.flux.clone(), seen, picture(&scene, &lights, &camera, options).pixels)
        })
    };
    let one = made(1);
    assert!(made(2) == one && made(5) == one);
}

#[test]
fn lights_count_once_and_places_get_as_many() {
    let bounce: Vec<u32> = [160, 33, 5].iter().zip(0..).flat_map(|(&count, j)| vec![j; count]).collect();
    let samples = sample_of(&bounce);
    for place in 0..16 {
        assert_eq!(samples[..160].iter().filter(|&&sample| sample == place).count(), 10);
        assert!((2..=3).contains(&samples[160..193].iter().filter(|&&sample| sample == place).count()));
    }
    // Without what the lights send, a picture holds what is emitted, and what paths find.
    let scene = furnace(0.5);
    let lights = lights(&scene, 64, 0);
    let rest = picture(&scene, &lights, &inside(), InstantOptions { lit: false, compensate: false, ..OPTIONS }).pixels;
    assert!(
        rest.chunks_exact(2).all(|pixel| (pixel[0] - 1.0 / PI).abs() < 1e-14 && (pixel[1] - 2.0 / PI).abs() < 1e-14)
    );
    // Lights on a lamp stand for A / n of its area each: c = pi / 4 times the inverse.
    let on_lamp = lights.bounce.iter().filter(|&&j| j == 0).count() as f64;
    let bounds = bounds(&scene, &lights, 3.0);
    assert_close(bounds[0], 0.25 * PI * on_lamp / 6.0, 1e-12);
    assert_close(*bounds.last().unwrap(), 3.0, 0.0);
}

#[test]
fn what_cannot_be_done_is_told() {
    let scene = furnace(0.5);
    let dark = cube(1).scene();
    assert!(invalid(try_lights(&scene, 0, 0)).contains("number of lights"));
    assert!(invalid(try_lights(&dark, 10, 0)).contains("emits nothing"));
    let tree = Bvh::of_scene(&scene);
    let little = virtual_lights(&scene, &tree, 1000, 0, 1000, &Progress::default());
    assert!(matches!(little, Err(Error::Memory { .. })));
    let lights = lights(&scene, 32, 0);
    for bound in [0.0, -1.0, f64::NAN] {
        assert!(
            invalid(try_picture(&scene, &lights, &inside(), InstantOptions { bound, ..OPTIONS })).contains("bound")
        );
    }
    assert!(invalid(try_picture(&scene, &lights, &inside(), InstantOptions { width: 0, ..OPTIONS })).contains("empty"));
    let little = try_picture(&scene, &lights, &inside(), InstantOptions { memory: 1000, ..OPTIONS });
    assert!(matches!(little, Err(Error::Memory { .. })));
    let outside = Camera::new(vec3(-3.0, 0.0, 0.0), Vec3::ZERO, Vec3::Z, 40.0).unwrap();
    assert!(invalid(try_picture(&scene, &lights, &outside, OPTIONS)).contains("backs"));
    let away = Camera::new(vec3(-3.0, 0.0, 0.0), vec3(-4.0, 0.0, 0.0), Vec3::Z, 40.0).unwrap();
    assert!(invalid(try_picture(&scene, &lights, &away, OPTIONS)).contains("looks at nothing"));
    let mut other = lights.clone();
    other.points[3].patch = 12;
    assert!(invalid(try_picture(&scene, &other, &inside(), OPTIONS)).contains("not of this scene"));
    let progress = Progress::default();
    progress.stop();
    let stopped = gather(&scene, &tree, &lights, &inside(), &OPTIONS, &progress);
    assert!(matches!(stopped, Err(Error::Interrupted)));
}
