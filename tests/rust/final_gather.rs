//! Final gather: pictures with a known content, to the tolerance, the same for any number of threads.

use std::f64::consts::PI;

use radiosity::direct::Lamp;
use radiosity::direct::Lights;
use radiosity::direct::lamp::Point;
use radiosity::geometry::Vec3;
use radiosity::render::{Camera, GatherOptions, Gathered, gather};
use radiosity::scene::{Scene, Sides};
use radiosity::visibility::Bvh;
use radiosity::{Error, Progress, Result};

use crate::common::{PLENTY, assert_close, box_in_box, cube, invalid, on_threads, plate, vec3};

fn options(tolerance: f64) -> GatherOptions {
    GatherOptions { width: 24, height: 16, tolerance, seed: 0, memory: PLENTY }
}

fn try_gather(scene: &Scene, irradiance: &[f64], camera: &Camera, options: &GatherOptions) -> Result<Gathered> {
    let mut observe = |_: &[f64], _: f64| Ok(());
    gather(
        scene,
        &Bvh::of_scene(scene),
        &Lights::default(),
        irradiance,
        camera,
        options,
        &mut observe,
        &Progress::default(),
    )
}

#[test]
fn a_furnace_has_the_same_radiance_everywhere() {
    // All walls glow: no lamp is worth it, and every ray brings B.
    let (rho, e) = (0.7, 2.0);
    let scene = cube(3).scene_with(1, Sides::Front, |_, _| rho, |_, _| e);
    let camera = Camera::new(Vec3::splat(0.5), vec3(0.9, 0.6, 0.3), Vec3::Z, 100.0).unwrap();
    let b = e / (1.0 - rho);
    let found = try_gather(&scene, &vec![b; scene.len()], &camera, &options(0.5)).unwrap();
    for radiance in found.pixels {
        // Sums of a few dozen equal terms.
        assert_close(radiance, b / PI, 1e-12 * b);
    }
    assert!(found.error_estimate < 1e-12);
}

#[test]
fn light_straight_from_a_lamp_in_full_view_is_exact() {
    // A white floor under a small square lamp, seen from beside it, with nothing else to reflect.
    let corners = [vec3(-0.2, -0.1, 1.0), vec3(-0.2, 0.3, 1.0), vec3(0.3, 0.3, 1.0), vec3(0.3, -0.1, 1.0)];
    let lamp = Lamp::new(corners.to_vec(), vec![3.0]);
    let side = |k: usize| corners[k] - corners[0];
    let mesh =
        plate(vec3(-1.0, -1.0, 0.0), 2.0 * Vec3::X, 2.0 * Vec3::Y, 3).and(&plate(corners[0], side(1), side(3), 2));
    let floor = 18;
    let scene = mesh.scene_with(
        1,
        Sides::Front,
        |i, _| if i < floor { 0.8 } else { 0.0 },
        |i, _| if i < floor { 0.0 } else { 3.0 },
    );
    // A narrow view: a pixel is a square of about 5 mm, over which the light changes by less than 1 %.
    let target = vec3(0.4, 0.3, 0.0);
    let camera = Camera::new(vec3(0.9, 0.0, 2.0), target, Vec3::Y, 2.0).unwrap();
    let found = try_gather(&scene, &vec![0.0; scene.len()], &camera, &options(1e-3)).unwrap();
    let (width, height) = (24, 16);
    for (pixel, radiance) in found.pixels.iter().enumerate() {
        let direction = camera.direction((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5, width, height);
        let x = camera.origin() - camera.origin().z / direction.z * direction;
        let expected = 0.8 * 3.0 * lamp.form_factor(&Point { x, normal: Vec3::Z, patch: 0 }) / PI;
        assert_close(*radiance, expected, 5e-3 * expected);
    }
}

#[test]
fn what_one_lamp_shows_says_nothing_of_another() {
    // Two lamps over a floor; a plate close under one of them hides it from what is seen of the floor, but for its edge.
    let square = |x: f64, y: f64, z: f64, size: f64| plate(vec3(x, y, z), size * Vec3::Y, size * Vec3::X, 1);
    let mesh = plate(vec3(-1.0, -1.0, 0.0), 2.0 * Vec3::X, 2.0 * Vec3::Y, 1)
        .and(&square(-0.7, -0.2, 1.0, 0.4))
        .and(&square(0.3, -0.2, 1.0, 0.4))
        .and(&square(0.2, -0.3, 0.9, 0.6));
    let emission = |i: usize| if (2..6).contains(&i) { 1.0 } else { 0.0 };
    let scene = mesh.scene_with(1, Sides::Front, |i, _| if i < 2 { 1.0 } else { 0.0 }, |i, _| emission(i));
    let lamp = |x: f64| {
        let corners = [vec3(x, -0.2, 1.0), vec3(x, 0.2, 1.0), vec3(x + 0.4, 0.2, 1.0), vec3(x + 0.4, -0.2, 1.0)];
        Lamp::new(corners.to_vec(), vec![1.0])
    };
    let (seen, hidden) = (lamp(-0.7), lamp(0.3));
    // Under the plate, where it hides all of its lamp.
    let camera = Camera::new(vec3(0.5, 0.0, 0.5), vec3(0.5, 0.0, 0.0), Vec3::Y, 20.0).unwrap();
    let found = try_gather(&scene, &vec![0.0; scene.len()], &camera, &options(2e-3)).unwrap();
    for (pixel, radiance) in found.pixels.iter().enumerate() {
        let (x, y) = ((pixel % 24) as f64 + 0.5, (pixel / 24) as f64 + 0.5);
        let direction = camera.direction(x, y, 24, 16);
        let x = camera.origin() - camera.origin().z / direction.z * direction;
        let of = |lamp: &Lamp| lamp.form_factor(&Point { x, normal: Vec3::Z, patch: 0 }) / PI;
        assert!(of(&hidden) > of(&seen), "what is hidden would be brighter");
        assert_close(*radiance, of(&seen), 0.02 * of(&seen));
    }
}

#[test]
fn what_is_smaller_than_a_pixel_counts_as_much_as_it_covers() {
    // White spots on a black floor, far apart, each a twentieth of a pixel: most pairs of samples agree that there is none.
    let (width, height, tolerance) = (24, 16, 0.05);
    let camera = Camera::new(vec3(0.0, 0.0, 1.0), Vec3::ZERO, Vec3::Y, 53.130_102_354_156).unwrap();
    let pixel = 1.0 / height as f64;
    let side = pixel * 0.05f64.sqrt();
    let spots: Vec<Vec3> = (0..24)
        .map(|k| {
            vec3((4 * (k % 6)) as f64 - 9.5, (4 * (k / 6)) as f64 - 5.5, 0.0) * pixel + vec3(0.01, 0.01, 1e-3) * pixel
        })
        .collect();
    let square = |at: Vec3, z: f64, size: f64| {
        plate(vec3(at.x - 0.5 * size, at.y - 0.5 * size, at.z + z), size * Vec3::X, size * Vec3::Y, 1)
    };
    let floor = plate(vec3(-2.0, -2.0, 0.0), 4.0 * Vec3::X, 4.0 * Vec3::Y, 1);
    let lamp = plate(vec3(3.0, -0.5, 2.0), Vec3::Y, Vec3::X, 1);
    let mesh = spots.iter().fold(floor.and(&lamp), |mesh, at| mesh.and(&square(*at, 0.0, side)));
    let emission = |i: usize| f64::from((2..4).contains(&i));
    let scene = mesh.scene_with(1, Sides::Front, |i, _| if i < 4 { 0.0 } else { 1.0 }, |i, _| emission(i));
    let corners = [vec3(3.0, -0.5, 2.0), vec3(3.0, 0.5, 2.0), vec3(4.0, 0.5, 2.0), vec3(4.0, -0.5, 2.0)];
    let light = Lamp::new(corners.to_vec(), vec![1.0]);
    let options = GatherOptions { width, height, tolerance, seed: 1, memory: PLENTY };
    let found = try_gather(&scene, &vec![0.0; scene.len()], &camera, &options).unwrap();
    let of_spot = |x: &Vec3| light.form_factor(&Point { x: *x, normal: Vec3::Z, patch: 4 }) / PI * 0.05;
    let expected: f64 = spots.iter().map(of_spot).sum();
    let sum: f64 = found.pixels.iter().sum();
    // Two dozen spots of 5 % each, in the mean to 5 %.
    assert_close(sum, expected, 0.05 * expected);
}

#[test]
fn pictures_are_the_same_bits_for_any_number_of_threads_and_end_at_the_tolerance() {
    let scene = box_in_box(2).scene_with(2, Sides::Front, |_, b| 0.3 + 0.4 * b as f64, |i, _| f64::from(i < 2));
    let camera = Camera::new(vec3(0.1, 0.1, 0.1), Vec3::splat(0.5), Vec3::Z, 90.0).unwrap();
    let irradiance = vec![0.1; 2 * scene.len()];
    let bits = || {
        let found = try_gather(&scene, &irradiance, &camera, &options(0.015)).unwrap();
        assert!(found.error_estimate <= 0.015 && found.passes > 1);
        found.pixels.iter().map(|x| x.to_bits()).collect::<Vec<u64>>()
    };
    let one = on_threads(1, bits);
    assert_eq!(one, on_threads(2, bits));
    assert_eq!(one, on_threads(5, bits));
}

#[test]
fn what_cannot_be_drawn_is_refused() {
    let scene = cube(1).scene();
    let inside = Camera::new(Vec3::splat(0.5), Vec3::ONE, Vec3::Z, 60.0).unwrap();
    let outside = Camera::new(Vec3::splat(3.0), Vec3::splat(0.5), Vec3::Z, 30.0).unwrap();
    let irradiance = vec![1.0; scene.emission().len()];
    let message = |camera: &Camera, options: &GatherOptions| {
        invalid(try_gather(&scene, &irradiance, camera, options).map(|_| ()))
    };
    assert!(message(&outside, &options(0.1)).contains("sees only the backs"));
    assert!(message(&inside, &GatherOptions { width: 0, ..options(0.1) }).contains("empty"));
    for tolerance in [0.0, 1.0, -1.0, f64::NAN] {
        assert!(message(&inside, &options(tolerance)).contains("tolerance"));
    }
    let small = GatherOptions { memory: 100, ..options(0.1) };
    assert!(matches!(try_gather(&scene, &irradiance, &inside, &small), Err(Error::Memory { .. })));
}

#[test]
fn who_watches_may_stop_it() {
    let scene = cube(1).scene_with(1, Sides::Front, |_, _| 0.5, |i, _| f64::from(i < 2));
    let camera = Camera::new(Vec3::splat(0.5), Vec3::ONE, Vec3::Z, 60.0).unwrap();
    let mut seen = 0;
    let mut observe = |pixels: &[f64], error: f64| {
        seen += 1;
        assert!(pixels.len() == 24 * 16 && error > 0.0);
        if seen == 2 { Err(Error::Interrupted) } else { Ok(()) }
    };
    let irradiance = vec![0.2; scene.len()];
    let tree = Bvh::of_scene(&scene);
    let stopped = gather(
        &scene,
        &tree,
        &Lights::default(),
        &irradiance,
        &camera,
        &options(1e-9),
        &mut observe,
        &Progress::default(),
    );
    assert!(matches!(stopped, Err(Error::Interrupted)));
    assert_eq!(seen, 2);
}
