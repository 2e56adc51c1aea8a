//! Mirrors and glass: the laws of reflection and refraction, and light that arrives by way of them.

use std::f64::consts::PI;

use radiosity::Progress;
use radiosity::accuracy::{Options, solve};
use radiosity::assembly::Order;

use radiosity::direct::patches::Direct;
use radiosity::direct::{Lamps, Lights, SCRAMBLES, Surroundings};
use radiosity::geometry::Vec3;
use radiosity::scene::{Description, Material, Scene, Sides};
use radiosity::visibility::specular::{End, branches, follow};
use radiosity::visibility::{Bvh, NO_PATCH, Ray};

use crate::common::{Mesh, PLENTY, Random, assert_close, cube, icosphere, invalid, plate, rotated, vec3};

/// A scene of one band; mirrors and glass have no reflectance and no emission.
fn scene(
    mesh: &Mesh,
    material: impl Fn(usize) -> Material,
    reflectance: impl Fn(usize) -> f64,
    emission: impl Fn(usize) -> f64,
) -> Scene {
    let materials: Vec<Material> = (0..mesh.faces.len()).map(&material).collect();
    let of_diffuse = |value: &dyn Fn(usize) -> f64| -> Vec<f64> {
        materials.iter().enumerate().map(|(i, m)| if *m == Material::Diffuse { value(i) } else { 0.0 }).collect()
    };
    Scene::new(Description {
        vertices: mesh.vertices.clone(),
        faces: mesh.faces.clone(),
        bands: 1,
        reflectance: of_diffuse(&reflectance),
        emission: of_diffuse(&emission),
        materials: materials.clone(),
        sides: Sides::Front,
    })
    .unwrap()
}

/// What becomes of a ray that goes down at `angle` on a plane z = 0 of this material.
fn at_plane(material: Material, angle: f64, from_above: bool) -> Vec<(Vec3, f64)> {
    let up = if from_above { 1.0 } else { -1.0 };
    let plane = plate(vec3(-1e3, -1e3, 0.0), vec3(2e3, 0.0, 0.0), vec3(0.0, 2e3, 0.0), 1);
    let scene = scene(&plane, |_| material, |_| 0.0, |_| 0.0);
    let ray =
        Ray { origin: vec3(0.3, 0.1, up), direction: vec3(angle.sin(), 0.0, -up * angle.cos()), exclude: NO_PATCH };
    let hit = Bvh::of_scene(&scene).closest(&[ray])[0].unwrap();
    branches(&scene, &ray, &hit).into_iter().flatten().map(|branch| (branch.ray.direction, branch.part)).collect()
}

#[test]
fn a_mirror_turns_the_normal_part_of_a_direction_round() {
    let random = Random::new(7);
    for _ in 0..50 {
        let angle = random.between(0.0, 1.5);
        let ways = at_plane(Material::Mirror(0.8), angle, true);
        assert_eq!(ways.len(), 1);
        assert!(ways[0].0.distance(vec3(angle.sin(), 0.0, angle.cos())) < 1e-15);
        assert_eq!(ways[0].1, 0.8);
    }
}

#[test]
fn glass_follows_snell_and_fresnel() {
    let n: f64 = 1.5;
    // Straight on: R = ((n - 1) / (n + 1))^2 = 0.04.
    let ways = at_plane(Material::Glass(n), 0.0, true);
    assert_close(ways[1].1, 0.04, 1e-15);
    assert!(ways[0].0.distance(-Vec3::Z) < 1e-15);
    for from_above in [true, false] {
        let relative = if from_above { n } else { 1.0 / n };
        for angle in [0.1, 0.5, 0.7] {
            let ways = at_plane(Material::Glass(n), angle, from_above);
            assert_close(ways[0].1 + ways[1].1, 1.0, 1e-15);
            assert_close(ways[0].0.length(), 1.0, 1e-15);
            // n sin' = sin, in the plane of the ray, to the other side.
            assert_close(relative * ways[0].0.x, angle.sin(), 1e-15);
            assert!(ways[0].0.y == 0.0 && (ways[0].0.z < 0.0) == from_above);
        }
    }
    // Brewster's angle, tan = n: the parallel part is not reflected; R = ((n^2 - 1) / (n^2 + 1))^2 / 2.
    let ways = at_plane(Material::Glass(n), n.atan(), true);
    assert_close(ways[1].1, 0.5 * ((n * n - 1.0) / (n * n + 1.0)).powi(2), 1e-15);
    // Beyond sin = 1 / n everything is reflected within.
    let ways = at_plane(Material::Glass(n), (1.0 / n).asin() + 1e-9, false);
    assert_eq!(ways.len(), 1);
    assert_eq!(ways[0].1, 1.0);
    assert!(ways[0].0.z < 0.0);
}

#[test]
fn rays_take_every_way_as_often_as_light_does() {
    // A pane between two plates: of rays that fall straight on it the part ((1 - R)^2 / (1 - R^2)) = 2n / (n^2 + 1) gets
    // through, by all inner reflections (n = 1.5: 12/13).
    let below = plate(vec3(-1e3, -1e3, -1.0), vec3(2e3, 0.0, 0.0), vec3(0.0, 2e3, 0.0), 1);
    let above = plate(vec3(-1e3, -1e3, 2.0), vec3(0.0, 2e3, 0.0), vec3(2e3, 0.0, 0.0), 1);
    let top = plate(vec3(-500.0, -500.0, 0.1), vec3(1e3, 0.0, 0.0), vec3(0.0, 1e3, 0.0), 1);
    let bottom = plate(vec3(-500.0, -500.0, 0.0), vec3(0.0, 1e3, 0.0), vec3(1e3, 0.0, 0.0), 1);
    let mesh = below.and(&above).and(&top).and(&bottom);
    let scene = scene(&mesh, |i| if i < 4 { Material::Diffuse } else { Material::Glass(1.5) }, |_| 0.5, |_| 0.0);
    let random = Random::new(8);
    let count = 40_000;
    // Directions that differ in their last digits only.
    let ray = |_| Ray {
        origin: vec3(random.uniform(), random.uniform(), 1.0),
        direction: vec3(1e-6 * random.uniform(), 1e-6 * random.uniform(), -1.0),
        exclude: NO_PATCH,
    };
    let rays: Vec<Ray> = (0..count).map(ray).collect();
    let ends = follow(&scene, &Bvh::of_scene(&scene), &rays);
    let through = ends.iter().filter(|end| end.arrival().is_some_and(|arrival| arrival.hit.patch < 2)).count();
    let returned = ends.iter().filter(|end| end.arrival().is_some_and(|arrival| (2..4).contains(&arrival.hit.patch)));
    assert_eq!(through + returned.count(), count);
    // Four standard errors of a binomial number.
    let part = 12.0f64 / 13.0;
    assert_close(through as f64 / count as f64, part, 4.0 * (part * (1.0 - part) / count as f64).sqrt());
    // The straight way through is 1 + 1 long.
    let straight = ends.iter().filter_map(|end| end.arrival()).map(|arrival| arrival.distance).fold(f64::MAX, f64::min);
    assert_close(straight, 2.0, 1e-9);
}

#[test]
fn a_mirror_absorbs_its_part_and_backs_are_dark() {
    let mirror = plate(vec3(-1e3, -1e3, 0.0), vec3(2e3, 0.0, 0.0), vec3(0.0, 2e3, 0.0), 1);
    let above = plate(vec3(-1e3, -1e3, 2.0), vec3(0.0, 2e3, 0.0), vec3(2e3, 0.0, 0.0), 1);
    let mesh = mirror.and(&above);
    let scene = scene(&mesh, |i| if i < 2 { Material::Mirror(0.7) } else { Material::Diffuse }, |_| 0.5, |_| 0.0);
    let random = Random::new(9);
    let down = |z: f64, sign: f64| -> Vec<Ray> {
        let ray = |_| {
            let d = random.direction();
            Ray { origin: vec3(0.0, 0.0, z), direction: vec3(d.x, d.y, sign * (d.z.abs() + 0.01)), exclude: NO_PATCH }
        };
        (0..20_000).map(ray).collect()
    };
    let tree = Bvh::of_scene(&scene);
    let ends = follow(&scene, &tree, &down(1.0, -1.0));
    let absorbed = ends.iter().filter(|end| matches!(end, End::Absorbed)).count() as f64 / ends.len() as f64;
    // Four standard errors; a few leave at the sides.
    assert_close(absorbed, 0.3, 4.0 * (0.21f64 / 20_000.0).sqrt() + 0.002);
    assert!(follow(&scene, &tree, &down(-1.0, 1.0)).iter().all(|end| matches!(end, End::Lost)));
}

fn options(tolerance: f64) -> Options {
    Options { tolerance, order: Order::Linear, refine: true, seed: 0, memory: PLENTY }
}

#[test]
fn a_furnace_with_mirrors_and_glass_is_a_furnace() {
    // A closed room of rho = 0.6 that emits 1 everywhere: B = E / (1 - rho), whatever stands in it that takes no light.
    let ball = icosphere(1);
    let at = |centre: Vec3, radius: f64| -> Mesh {
        Mesh { vertices: ball.vertices.iter().map(|v| centre + radius * *v).collect(), ..ball.clone() }
    };
    let room = cube(2);
    let n = room.faces.len();
    let per_ball = ball.faces.len();
    let mesh = room.and(&at(vec3(0.3, 0.3, 0.3), 0.2)).and(&at(vec3(0.7, 0.7, 0.6), 0.2));
    let material = |i: usize| match i {
        i if i < n => Material::Diffuse,
        i if i < n + per_ball => Material::Glass(1.5),
        _ => Material::Mirror(1.0),
    };
    let scene = scene(&mesh, material, |_| 0.6, |_| 1.0);
    let outcome = solve(&scene, &Lights::default(), &options(0.05), &Progress::default()).unwrap();
    // Every ray arrives at the same radiance: rounding only.
    outcome.radiosity[..n].iter().for_each(|b| assert_close(*b, 2.5, 1e-12));
    assert!(outcome.radiosity[n..].iter().all(|b| *b == 0.0));
    let audit = outcome.audit.unwrap();
    assert_close(audit.left[0], 0.0, 0.0);
    assert_close(audit.absorbed[0], audit.emitted[0], 1e-12 * audit.emitted[0]);
}

/// A floor, a lamp above it, and a mirror beside it that reflects 0.9; the mirror is small beside a far plate if wanted.
fn beside_a_mirror(far: bool) -> (Scene, usize) {
    let floor = plate(Vec3::ZERO, Vec3::X, Vec3::Y, 4);
    let lamp = plate(vec3(0.2, 0.4, 0.5), vec3(0.0, 0.2, 0.0), vec3(0.2, 0.0, 0.0), 1);
    let mirror = plate(Vec3::ZERO, Vec3::Y, 0.7 * Vec3::Z, 1);
    let n = floor.faces.len();
    let mut mesh = floor.and(&lamp).and(&mirror);
    if far {
        mesh = mesh.and(&plate(vec3(-20.0, -20.0, -5.0), 40.0 * Vec3::X, 40.0 * Vec3::Y, 1));
    }
    let material = |i: usize| if (n + 2..n + 4).contains(&i) { Material::Mirror(0.9) } else { Material::Diffuse };
    (scene(&mesh, material, |_| 0.0, |i| if (n..n + 2).contains(&i) { PI } else { 0.0 }), n)
}

fn direct_irradiance(scene: &Scene, n: usize, segments: u32) -> (Vec<f64>, usize) {
    let (lamps, tree, blockers) = (Lamps::of_scene(scene).unwrap(), Bvh::of_scene(scene), Bvh::of_blockers(scene));
    let none = Lights::default();
    let surroundings = Surroundings { scene, lamps: &lamps, lights: &none, tree: &tree, blockers: &blockers };
    let mut direct = Direct::new(surroundings, 1e-8, 1, 4, &Progress::default()).unwrap();
    direct.sample(|_| segments, &Progress::default()).unwrap();
    let irradiance = |i: usize| {
        let mut out = [0.0];
        direct.irradiance(i, &mut out);
        out[0]
    };
    ((0..n).map(irradiance).collect(), lamps.lamps.len())
}

#[test]
fn a_lamp_in_a_flat_mirror_is_a_lamp_behind_it() {
    let (mirrored, n) = beside_a_mirror(false);
    let (irradiance, lamps) = direct_irradiance(&mirrored, n, 4096 / SCRAMBLES as u32);
    assert_eq!(lamps, 2);
    // The same with a lamp of 0.9 the emission at x < 0, and nothing else: the mirror is 0.7 high, which shows all of it.
    let floor = plate(Vec3::ZERO, Vec3::X, Vec3::Y, 4);
    let lamp = plate(vec3(0.2, 0.4, 0.5), vec3(0.0, 0.2, 0.0), vec3(0.2, 0.0, 0.0), 1);
    let image = plate(vec3(-0.4, 0.4, 0.5), vec3(0.0, 0.2, 0.0), vec3(0.2, 0.0, 0.0), 1);
    let emission = |i: usize| {
        if i < n {
            0.0
        } else if i < n + 2 {
            PI
        } else {
            0.9 * PI
        }
    };
    let unfolded = scene(&floor.and(&lamp).and(&image), |_| Material::Diffuse, |_| 0.0, emission);
    let (wanted, _) = direct_irradiance(&unfolded, n, 4);
    // Closed forms; all segments to the image go through the mirror.
    for (h, wanted) in irradiance.iter().zip(&wanted) {
        assert_close(*h, *wanted, 1e-9 * wanted);
    }
}

#[test]
fn rays_from_lamps_bring_what_closed_forms_say() {
    // Beside a plate of 1,600 m^2 the mirror is small and left to rays.
    let ((closed, n), (small, _)) = (beside_a_mirror(false), beside_a_mirror(true));
    let (wanted, _) = direct_irradiance(&closed, n, 4);
    let (irradiance, lamps) = direct_irradiance(&small, n, 16_384);
    assert_eq!(lamps, 1);
    let straight = {
        let floor_and_lamp = plate(Vec3::ZERO, Vec3::X, Vec3::Y, 4).and(&plate(
            vec3(0.2, 0.4, 0.5),
            vec3(0.0, 0.2, 0.0),
            vec3(0.2, 0.0, 0.0),
            1,
        ));
        direct_irradiance(
            &scene(&floor_and_lamp, |_| Material::Diffuse, |_| 0.0, |i| if i < n { 0.0 } else { PI }),
            n,
            4,
        )
        .0
    };
    for i in 0..n {
        let by_mirror = wanted[i] - straight[i];
        // 4 x 16,384 x 38 rays, of which a patch gets some thousands: 3 % is four standard errors of the darkest.
        assert_close(irradiance[i] - straight[i], by_mirror, 0.03 * by_mirror + 1e-4);
    }
}

#[test]
fn caustics_keep_the_power() {
    // A lamp and a glass ball in a black closed room: all that is emitted arrives on the walls, straight or by way of glass.
    let ball = icosphere(2);
    let ball = Mesh { vertices: ball.vertices.iter().map(|v| vec3(0.5, 0.5, 0.4) + 0.2 * *v).collect(), ..ball };
    let room = cube(2);
    let n = room.faces.len();
    let lamp = plate(vec3(0.4, 0.4, 0.9), vec3(0.0, 0.2, 0.0), vec3(0.2, 0.0, 0.0), 1);
    let mesh = room.and(&lamp).and(&ball);
    let material = |i: usize| if i < n + 2 { Material::Diffuse } else { Material::Glass(1.5) };
    let scene = scene(&mesh, material, |_| 0.0, |i| if (n..n + 2).contains(&i) { 1.0 } else { 0.0 });
    let (irradiance, _) = direct_irradiance(&scene, n + 2, 512);
    let arriving: f64 = irradiance.iter().zip(scene.areas()).map(|(h, area)| h * area).sum();
    // Some 5 % come by way of glass, by 100,000 rays; the shadow of the ball has an error of 1e-3.
    assert_close(arriving, 0.04, 0.003 * 0.04);
}

#[test]
fn what_is_no_material_is_refused_by_patch() {
    let plane = plate(Vec3::ZERO, Vec3::X, Vec3::Y, 1);
    let described = |materials: Vec<Material>, reflectance: f64, sides: Sides| {
        let description = Description {
            vertices: plane.vertices.clone(),
            faces: plane.faces.clone(),
            bands: 1,
            reflectance: vec![0.0, reflectance],
            emission: vec![0.0; 2],
            materials,
            sides,
        };
        Scene::new(description)
    };
    let diffuse = Material::Diffuse;
    for (material, reflectance, sides, text) in [
        (Material::Mirror(1.2), 0.0, Sides::Front, "patch 1: a mirror that reflects 1.2 is outside [0, 1]"),
        (Material::Mirror(f64::NAN), 0.0, Sides::Front, "patch 1: a mirror that reflects NaN is outside [0, 1]"),
        (Material::Glass(0.0), 0.0, Sides::Front, "patch 1: index of refraction 0 is outside (0, inf)"),
        (Material::Glass(-1.5), 0.0, Sides::Front, "patch 1: index of refraction -1.5 is outside (0, inf)"),
        (Material::Glass(1.5), 0.0, Sides::Both, "patch 1: glass has one front"),
        (Material::Mirror(0.5), 0.5, Sides::Front, "patch 1: a mirror has no reflectance"),
    ] {
        let text_found = invalid(described(vec![diffuse, material], reflectance, sides));
        assert!(text_found.contains(text), "{text_found}");
    }
    assert!(invalid(described(vec![diffuse], 0.0, Sides::Front)).contains("1 materials for 2 patches"));
    let scene = described(vec![diffuse, Material::Glass(1.5)], 0.0, Sides::Front).unwrap();
    let text = invalid(scene.require_diffuse("this"));
    assert!(text.contains("patch 1 is glass, which this cannot carry"), "{text}");
    assert!(described(vec![diffuse, diffuse], 0.5, Sides::Both).unwrap().is_diffuse());
}

#[test]
fn finer_patches_keep_their_material() {
    let plane = plate(Vec3::ZERO, Vec3::X, Vec3::Y, 1);
    let coarse = scene(&plane, |i| if i == 1 { Material::Mirror(0.5) } else { Material::Diffuse }, |_| 0.5, |_| 0.0);
    let (fine, parents) = coarse.subdivide(0.3, PLENTY, &Progress::default()).unwrap();
    for (i, parent) in parents.iter().enumerate() {
        assert_eq!(fine.material(i), coarse.material(*parent as usize));
    }
}

#[test]
fn no_light_gets_behind_a_mirror() {
    // A tilted mirror with a diffuse back, a lamp before it, a screen behind it: rounding puts points of the back on either side
    // of the plane.
    let mirror = plate(vec3(-0.5, -0.5, 0.0), Vec3::X, Vec3::Y, 2);
    let lamp = plate(vec3(-0.1, -0.1, 0.8), 0.2 * Vec3::Y, 0.2 * Vec3::X, 1);
    let screen = plate(vec3(-0.2, -0.2, -0.5), 0.4 * Vec3::X, 0.4 * Vec3::Y, 1);
    let n = mirror.faces.len();
    let mesh = mirror.clone().and(&mirror.reversed()).and(&lamp).and(&screen);
    let rotation = Random::new(3).rotation();
    let mesh = mesh.map(|v| rotated(&rotation, v));
    let material = |i: usize| if i < n { Material::Mirror(0.9) } else { Material::Diffuse };
    let emission = |i: usize| if (2 * n..2 * n + 2).contains(&i) { PI } else { 0.0 };
    let (irradiance, _) = direct_irradiance(&scene(&mesh, material, |_| 0.5, emission), 2 * n + 4, 1024);
    assert!(irradiance[..n].iter().all(|h| *h > 0.0), "{irradiance:?}");
    let behind = irradiance[n..2 * n].iter().chain(&irradiance[2 * n + 2..]);
    assert!(behind.copied().all(|h| h == 0.0), "{irradiance:?}");
}
